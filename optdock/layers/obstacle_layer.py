"""ObstacleLayer: what sensors see (Nav2: `nav2_costmap_2d::ObstacleLayer`, in the plane)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from pydantic import Field, field_validator, model_validator

from optdock.costmap.costs import FREE_SPACE, NO_INFORMATION
from optdock.errors import InvalidValue
from optdock.interfaces import Bounds, Layer
from optdock.layers.clearing import corners_of, fill_footprint
from optdock.layers.combination import CombinationMethod, combined
from optdock.layers.layer_parameters import LayerParameters
from optdock.layers.observation import Observation, apply_observations
from optdock.layers.rolling import moved_grid
from optdock.layers.window import EVERYWHERE, NOWHERE, checked_window, grown_by_points, joined

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from optdock.costmap.costmap import Costmap
    from optdock.geometry.arrays import FloatArray
    from optdock.geometry.pose import Pose2
    from optdock.layers.scan import LaserScan

__all__ = ["ObstacleLayer", "ObstacleLayerParameters"]

_FARTHEST = 1e9  # [m]; points beyond are no measurements


class ObstacleLayerParameters(LayerParameters):
    """Nav2's parameters of the ObstacleLayer and of its one observation source.

    The source's parameters stand beside the layer's, or, as in Nav2's files, in a block named by
    `observation_sources`. `track_unknown_space` is True here, False in Nav2.
    """

    track_unknown_space: bool = Field(default=True, description="cells never seen are unknown; False: free")
    footprint_clearing_enabled: bool = Field(default=True, description="free the cells under the robot")
    combination_method: CombinationMethod = Field(
        default=CombinationMethod.MAX, description="0 overwrite, 1 max, 2 max_without_unknown_overwrite"
    )
    marking: bool = Field(default=True, description="points become obstacles")
    clearing: bool = Field(default=False, description="lines of sight become free")
    obstacle_max_range: float = Field(default=2.5, ge=0.0, description="points from here on are not marked [m]")
    obstacle_min_range: float = Field(default=0.0, ge=0.0, description="points nearer than this are not marked [m]")
    raytrace_max_range: float = Field(default=3.0, ge=0.0, description="clearing ends here [m]")
    raytrace_min_range: float = Field(default=0.0, ge=0.0, description="clearing begins here [m]")
    inf_is_valid: bool = Field(default=False, description="beams without return clear")
    observation_sources: str = Field(default="", description="name of the source's block, if it has one")

    graph_names: ClassVar[frozenset[str]] = frozenset(
        {"topic", "sensor_frame", "data_type", "expected_update_rate", "transform_tolerance"}
        | {"observation_persistence", "min_obstacle_height", "max_obstacle_height", "tf_filter_tolerance"}
    )

    @model_validator(mode="before")
    @classmethod
    def _flatten_source(cls, values: object) -> object:
        names = values.get("observation_sources") if isinstance(values, Mapping) else None
        if not isinstance(values, Mapping) or not isinstance(names, str):
            return values
        blocks = {name: values[name] for name in names.split() if isinstance(values.get(name), Mapping)}
        if len(blocks) > 1:
            raise ValueError(f"observation_sources: one source per layer; give a layer each to {', '.join(blocks)}")
        flat = {name: value for name, value in values.items() if name not in blocks}
        for block in blocks.values():
            flat.update(cls.without_graph_names(block))
        return flat

    @field_validator("combination_method", mode="before")
    @classmethod
    def _by_name(cls, value: object) -> object:
        if not isinstance(value, str):
            return value
        names = {method.name.lower(): method for method in CombinationMethod}
        if value.lower() not in names:
            raise ValueError(f"must be one of {', '.join(names)}, or 0, 1, 2")
        return names[value.lower()]


class ObstacleLayer(Layer):
    """Marks the cells of points and clears the lines of sight to them, in a grid of its own that it keeps.

    The grid follows the master's place and size; where they overlap, what was seen stays. Observations wait for the
    next update and are used once. Points that are not finite are dropped, as Nav2 does; a point marks its cell from
    `obstacle_min_range` (included) to `obstacle_max_range` (excluded).

    Args:
        **parameters: Fields of `ObstacleLayerParameters`.

    Raises:
        InvalidValue: A parameter is unknown, of the wrong type or out of range.
    """

    Parameters = ObstacleLayerParameters
    parameters: ObstacleLayerParameters

    def __init__(self, **parameters: object) -> None:
        super().__init__(**parameters)
        self._grid: Costmap | None = None
        self._waiting: list[Observation] = []
        self._robot: Pose2 | None = None
        self._touched = NOWHERE
        self._was_reset = False

    def add_scan(self, scan: LaserScan, sensor: Pose2) -> None:
        """Take a scan made from `sensor`, a pose in the costmap's frame."""
        points = scan.points_from(sensor, inf_is_valid=self.parameters.inf_is_valid)
        self.add_points(points, (sensor.x, sensor.y))

    def add_points(self, points: ArrayLike, sensor: tuple[float, float]) -> None:
        """Take points, Shape (n, 2) [m], seen from `sensor`, all in the costmap's frame.

        Raises:
            InvalidValue: Not that shape, or the sensor's position is not finite.
        """
        seen = np.asarray(points, dtype=np.float64)
        if seen.ndim != 2 or seen.shape[1] != 2:
            raise InvalidValue(f"{self.context.name}: points must have shape (n, 2), got {seen.shape}")
        if not np.all(np.isfinite(sensor)):
            raise InvalidValue(f"{self.context.name}: the sensor's position must be finite, got {sensor}")
        with np.errstate(invalid="ignore"):
            usable = np.all(np.abs(seen) < _FARTHEST, axis=1)
        observation = self._observed(seen[usable], np.array(sensor, dtype=np.float64))
        self._waiting.append(observation)
        for part in observation:
            self._touched = grown_by_points(self._touched, part)

    def reset(self) -> None:
        """Forget everything seen; not current until the next update."""
        self._grid, self._waiting, self._touched = None, [], EVERYWHERE
        self._was_reset = True

    def is_clearable(self) -> bool:
        """Always."""
        return True

    def is_current(self) -> bool:
        """False from a reset until the next update."""
        return not self._was_reset

    def is_enabled(self) -> bool:
        """Parameter `enabled`."""
        return self.parameters.enabled

    def update_bounds(self, robot: Pose2, bounds: Bounds) -> Bounds:
        """`bounds` grown to what was seen since the last update and to the footprint."""
        self._robot = robot
        grown = joined(bounds, self._touched)
        footprint = self.context.footprint
        if self.parameters.footprint_clearing_enabled and footprint is not None:
            grown = grown_by_points(grown, corners_of(footprint, robot))
        return grown

    def update_costs(self, master: Costmap, min_i: int, min_j: int, max_i: int, max_j: int) -> None:
        """Bring the own grid up to date and combine the window with the master's.

        Raises:
            InvalidValue: The window is not within the master grid.
        """
        window = checked_window(master, min_i, min_j, max_i, max_j)
        unseen = NO_INFORMATION if self.parameters.track_unknown_space else FREE_SPACE
        grid = moved_grid(self._grid, master, unseen)
        apply_observations(grid, self._waiting)
        footprint = self.context.footprint
        if self.parameters.footprint_clearing_enabled and footprint is not None and self._robot is not None:
            fill_footprint(grid, footprint, self._robot, FREE_SPACE)
        master.data[window] = combined(master.data[window], grid.data[window], self.parameters.combination_method)
        self._grid, self._waiting, self._touched, self._was_reset = grid, [], NOWHERE, False

    def _observed(self, points: FloatArray, sensor: FloatArray) -> Observation:
        p = self.parameters
        offset = points - sensor
        distance = np.hypot(offset[:, 0], offset[:, 1])
        near = (distance >= p.obstacle_min_range) & (distance < p.obstacle_max_range)
        marks = points[near] if p.marking else np.zeros((0, 2))
        cleared = (
            (distance >= p.raytrace_min_range) & (distance > 0.0) if p.clearing else np.zeros(len(points), np.bool_)
        )
        unit = offset[cleared] / distance[cleared, None]
        reach = np.minimum(distance[cleared], p.raytrace_max_range)
        first = np.minimum(p.raytrace_min_range, reach)
        return Observation(marks, sensor + first[:, None] * unit, sensor + reach[:, None] * unit)
