"""StaticLayer: a costmap layer that contains the map (Nav2: `nav2_costmap_2d::StaticLayer`)."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

import numpy as np
from pydantic import Field

from optdock.errors import InvalidValue
from optdock.model.costmap import OccupancyGrid
from optdock.model.costs import FREE_SPACE, OccupancyRule
from optdock.nav2.layers.nav2_layer import LayerParameters, Nav2Layer, checked_window, joined, outline_bounds
from optdock.nav2.layers.raster import fill_footprint
from optdock.plugins.interfaces import Bounds

if TYPE_CHECKING:
    from optdock.geometry.pose import Pose2
    from optdock.model.costmap import Costmap

__all__ = ["StaticLayer", "StaticLayerParameters"]


class StaticLayerParameters(LayerParameters):
    """Nav2's parameters of the StaticLayer; the default of `track_unknown_space` is True instead of False."""

    track_unknown_space: bool = Field(default=True, description="keep unknown cells unknown; False makes them free")
    lethal_cost_threshold: int = Field(default=100, ge=1, le=100, description="occupancy from which a cell is lethal")
    trinary_costmap: bool = Field(
        default=True, description="occupancies below the threshold are free; False scales them to costs"
    )
    unknown_cost_value: int = Field(
        default=255, ge=0, le=255, description="occupancy value, as a byte, of unknown cells"
    )
    inscribed_obstacle_cost_value: int = Field(
        default=99, ge=0, le=255, description="occupancy value of inscribed cells"
    )
    use_maximum: bool = Field(default=False, description="keep higher costs of the layers below")
    footprint_clearing_enabled: bool = Field(default=False, description="clear the cells under the robot")

    graph_names: ClassVar[frozenset[str]] = frozenset(
        {"map_topic", "map_subscribe_transient_local", "subscribe_to_updates", "transform_tolerance"}
    )


class StaticLayer(Nav2Layer):
    """Write a map into the master grid: each master cell gets the cost of the map's cell at its centre.

    Master cells outside the map are not changed. The layer is not current before the first call of `set_map`.

    Args:
        **parameters: Fields of `StaticLayerParameters`.

    Raises:
        InvalidValue: If a parameter is unknown, of the wrong type or out of range.
    """

    Parameters = StaticLayerParameters
    parameters: StaticLayerParameters

    def __init__(self, **parameters: object) -> None:
        super().__init__(**parameters)
        self._map: OccupancyGrid | None = None
        self._robot: Pose2 | None = None

    def set_map(self, grid: OccupancyGrid) -> None:
        """Replace the map.

        Raises:
            InvalidValue: If `grid` is not an OccupancyGrid; the previous map is kept.
        """
        if not isinstance(grid, OccupancyGrid):
            raise InvalidValue(f"{self.context.name}: a map must be an OccupancyGrid, got {type(grid).__name__}")
        self._map = grid

    def is_current(self) -> bool:
        """Whether a map is set and has not been declared out of date."""
        return super().is_current() and self._map is not None

    def update_bounds(self, robot: Pose2, bounds: Bounds) -> Bounds:
        """Return `bounds` extended by the map and by the footprint that is cleared."""
        self._robot = robot
        if self._map is None:
            return bounds
        (x, y), side, (rows, columns) = self._map.origin, self._map.resolution, self._map.data.shape
        grown = joined(bounds, Bounds(x, y, x + columns * side, y + rows * side))
        footprint = self.context.footprint
        if self.parameters.footprint_clearing_enabled and footprint is not None:
            grown = joined(grown, outline_bounds(footprint, robot))
        return grown

    def update_costs(self, master: Costmap, min_i: int, min_j: int, max_i: int, max_j: int) -> None:
        """Write the map into the window.

        Raises:
            InvalidValue: If the window is not within the master grid, or the grid is read-only.
        """
        window = checked_window(master, min_i, min_j, max_i, max_j)
        if self._map is None:
            return
        costs = self._map.costmap_by(self._rule)
        centres = master.origin[0] + (np.arange(min_i, max_i) + 0.5) * master.resolution
        i = np.floor((centres - costs.origin[0]) / costs.resolution).astype(np.int64)
        centres = master.origin[1] + (np.arange(min_j, max_j) + 0.5) * master.resolution
        j = np.floor((centres - costs.origin[1]) / costs.resolution).astype(np.int64)
        on_i, on_j = (i >= 0) & (i < costs.columns), (j >= 0) & (j < costs.rows)
        taken, target = costs.data[np.ix_(j[on_j], i[on_i])], np.ix_(on_j, on_i)
        part = master.data[window]
        part[target] = np.maximum(part[target], taken) if self.parameters.use_maximum else taken
        footprint = self.context.footprint
        if self.parameters.footprint_clearing_enabled and footprint is not None and self._robot is not None:
            fill_footprint(master, footprint, self._robot, FREE_SPACE, window)

    @property
    def _rule(self) -> OccupancyRule:
        p = self.parameters
        return OccupancyRule(
            track_unknown_space=p.track_unknown_space,
            lethal_cost_threshold=p.lethal_cost_threshold,
            trinary_costmap=p.trinary_costmap,
            unknown_cost_value=p.unknown_cost_value,
            inscribed_obstacle_cost_value=p.inscribed_obstacle_cost_value,
        )
