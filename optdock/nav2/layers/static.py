"""StaticLayer: the map (Nav2: `nav2_costmap_2d::StaticLayer`)."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

import numpy as np
from pydantic import Field

from optdock.errors import InvalidValue
from optdock.model.costmap import OccupancyGrid
from optdock.model.costs import FREE_SPACE, OccupancyRule
from optdock.nav2.layers.base import LayerParameters, SwitchedLayer
from optdock.nav2.layers.raster import corners_of, fill_footprint
from optdock.nav2.layers.window import NOWHERE, CellWindow, checked_window, grown_by_points, joined
from optdock.plugins.interfaces import Bounds

if TYPE_CHECKING:
    from optdock.geometry.pose import Pose2
    from optdock.model.costmap import Costmap

__all__ = ["StaticLayer", "StaticLayerParameters"]


class StaticLayerParameters(LayerParameters):
    """Nav2's parameters of the StaticLayer; `track_unknown_space` is True here, False in Nav2."""

    track_unknown_space: bool = Field(default=True, description="unknown stays unknown; False makes it free")
    lethal_cost_threshold: int = Field(default=100, ge=1, le=100, description="occupancy from which a cell is lethal")
    trinary_costmap: bool = Field(default=True, description="below the threshold is free; False scales")
    unknown_cost_value: int = Field(default=255, ge=0, le=255, description="occupancy, as a byte, that is unknown")
    inscribed_obstacle_cost_value: int = Field(default=99, ge=0, le=255, description="occupancy that is inscribed")
    use_maximum: bool = Field(default=False, description="keep higher costs of the layers below")
    footprint_clearing_enabled: bool = Field(default=False, description="free the cells under the robot")

    graph_names: ClassVar[frozenset[str]] = frozenset(
        {"map_topic", "map_subscribe_transient_local", "subscribe_to_updates", "transform_tolerance"}
    )


class StaticLayer(SwitchedLayer):
    """Writes a map into the master grid, cell by cell: each master cell takes the map's cell at its centre.

    Master cells off the map keep what they have. The layer is not current before `set_map`.

    Args:
        **parameters: Fields of `StaticLayerParameters`.

    Raises:
        InvalidValue: A parameter is unknown, of the wrong type or out of range.
    """

    Parameters = StaticLayerParameters
    parameters: StaticLayerParameters

    def __init__(self, **parameters: object) -> None:
        super().__init__(**parameters)
        self._map: OccupancyGrid | None = None
        self._costs: Costmap | None = None
        self._costs_rule: OccupancyRule | None = None
        self._robot: Pose2 | None = None
        self._pending = NOWHERE
        self._last_footprint = NOWHERE

    def set_map(self, grid: OccupancyGrid) -> None:
        """Take another map; the next update writes all of it.

        Raises:
            InvalidValue: `grid` is no OccupancyGrid; the old map stays.
        """
        if not isinstance(grid, OccupancyGrid):
            raise InvalidValue(f"{self.context.name}: a map must be an OccupancyGrid, got {type(grid).__name__}")
        self._pending = joined(self._pending, self._extent())
        self._map, self._costs = grid, None
        self._pending = joined(self._pending, self._extent())

    def reset(self) -> None:
        """Write the whole map again; the map itself stays."""
        self._pending = self._extent()

    def match_size(self) -> None:
        """Write the whole map again."""
        self.reset()

    def update_bounds(self, robot: Pose2, bounds: Bounds) -> Bounds:
        """`bounds` grown to the map where it must be written, and to the footprint that is cleared."""
        if self._rule() != self._costs_rule:
            self._pending = joined(self._pending, self._extent())
        grown = joined(bounds, self._pending)
        self._robot = robot
        footprint = self.context.footprint
        if self.parameters.footprint_clearing_enabled and footprint is not None:
            here = grown_by_points(NOWHERE, corners_of(footprint, robot))
            grown = joined(grown, joined(here, self._last_footprint))
            self._last_footprint = here
        return grown

    def update_costs(self, master: Costmap, min_i: int, min_j: int, max_i: int, max_j: int) -> None:
        """Write the map into the window.

        Raises:
            InvalidValue: The window is not within the master grid.
        """
        window = checked_window(master, min_i, min_j, max_i, max_j)
        costs = self._current_costs()
        if costs is None:
            return
        self._write(master, costs, window)
        footprint = self.context.footprint
        if self.parameters.footprint_clearing_enabled and footprint is not None and self._robot is not None:
            fill_footprint(master, footprint, self._robot, FREE_SPACE, window)
        self._pending = NOWHERE

    def is_current(self) -> bool:
        """Whether it has a map that was not declared out of date."""
        return super().is_current() and self._map is not None

    def _write(self, master: Costmap, costs: Costmap, window: CellWindow) -> None:
        rows, columns = np.arange(window[0].start, window[0].stop), np.arange(window[1].start, window[1].stop)
        x, y = (
            master.origin[0] + (columns + 0.5) * master.resolution,
            master.origin[1] + (rows + 0.5) * master.resolution,
        )
        i = np.floor((x - costs.origin[0]) / costs.resolution).astype(np.int64)
        j = np.floor((y - costs.origin[1]) / costs.resolution).astype(np.int64)
        on_i, on_j = (i >= 0) & (i < costs.columns), (j >= 0) & (j < costs.rows)
        target = np.ix_(rows[on_j], columns[on_i])
        taken = costs.data[np.ix_(j[on_j], i[on_i])]
        master.data[target] = np.maximum(master.data[target], taken) if self.parameters.use_maximum else taken

    def _extent(self) -> Bounds:
        if self._map is None:
            return NOWHERE
        (x, y), side, (rows, columns) = self._map.origin, self._map.resolution, self._map.data.shape
        return Bounds(x, y, x + columns * side, y + rows * side)

    def _rule(self) -> OccupancyRule:
        p = self.parameters
        return OccupancyRule(
            track_unknown_space=p.track_unknown_space,
            lethal_cost_threshold=p.lethal_cost_threshold,
            trinary_costmap=p.trinary_costmap,
            unknown_cost_value=p.unknown_cost_value,
            inscribed_obstacle_cost_value=p.inscribed_obstacle_cost_value,
        )

    def _current_costs(self) -> Costmap | None:
        """The map's costs by today's parameters; None without a map."""
        rule = self._rule()
        if self._map is not None and (self._costs is None or rule != self._costs_rule):
            self._costs, self._costs_rule = self._map.costmap_by(rule), rule
        return self._costs
