"""ObstacleLayer: what sensors see (Nav2: `nav2_costmap_2d::ObstacleLayer`, in the plane)."""

from __future__ import annotations

from functools import reduce
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.costmap.costs import FREE_SPACE, LETHAL, NO_INFORMATION
from optdock.errors import InvalidValue
from optdock.nav2.layers.base import SwitchedLayer
from optdock.nav2.layers.obstacle_parameters import ObstacleLayerParameters, SourceParameters, combined
from optdock.nav2.layers.raster import cells_of_lines, corners_of, fill_footprint
from optdock.nav2.layers.window import EVERYWHERE, NOWHERE, checked_window, grown_by_points, joined, moved_grid
from optdock.plugins.interfaces import Bounds
from optdock.plugins.parameters import closest

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from optdock.costmap.costmap import Costmap
    from optdock.geometry.arrays import BoolArray, FloatArray
    from optdock.geometry.pose import Pose2
    from optdock.nav2.layers.scan import LaserScan

__all__ = ["Observation", "ObstacleLayer", "ObstacleLayerParameters", "apply_observations", "segments_in_box"]


class Observation(NamedTuple):
    """Points to mark (m, 2), and starts (k, 2) and ends (k, 2) of the lines to clear, all in the world [m]."""

    marks: FloatArray
    starts: FloatArray
    ends: FloatArray


def apply_observations(grid: Costmap, observations: list[Observation]) -> None:
    """Clear all lines, then mark all points, so that no line wipes out what another beam has just hit."""
    lower, upper = np.array(grid.lower), np.array(grid.upper)
    for seen in observations:
        starts, ends, meets = segments_in_box(seen.starts, seen.ends, lower, upper)
        cells = cells_of_lines(grid.cell_of(starts[meets]), grid.cell_of(ends[meets])).cells
        cells = cells[grid.has_cell(cells)]
        grid.data[cells[:, 1], cells[:, 0]] = FREE_SPACE
    for seen in observations:
        cells = grid.cell_of(seen.marks)
        cells = cells[grid.has_cell(cells)]
        grid.data[cells[:, 1], cells[:, 0]] = LETHAL


def segments_in_box(
    starts: FloatArray, ends: FloatArray, lower: FloatArray, upper: FloatArray
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Segments cut to a box ([Liang1984]): starts (n, 2), ends (n, 2), and whether they meet it (n,)."""
    move = ends - starts
    still = move == 0.0
    step = np.where(still, 1.0, move)
    to_lower, to_upper = (lower - starts) / step, (upper - starts) / step
    entry = np.where(still, -np.inf, np.minimum(to_lower, to_upper)).max(axis=1, initial=0.0)
    leave = np.where(still, np.inf, np.maximum(to_lower, to_upper)).min(axis=1, initial=1.0)
    beside = np.any(still & ((starts < lower) | (starts > upper)), axis=1)
    meets: BoolArray = (entry <= leave) & ~beside
    return starts + entry[:, None] * move, starts + leave[:, None] * move, meets


_FARTHEST = 1e9  # [m]; points beyond are no measurements


class _Seen(NamedTuple):
    """An observation, and the time until which updates use it again [s]."""

    observation: Observation
    until: float


class ObstacleLayer(SwitchedLayer):
    """Marks the cells of points and clears the lines of sight to them, in a grid of its own that it keeps.

    The grid follows the master's place and size; where they overlap, what was seen stays. Observations wait for the
    next update; later ones use them again for `observation_persistence` seconds. Points that are not finite are
    dropped, as Nav2 does; a point marks its cell from `obstacle_min_range` (included) to `obstacle_max_range`
    (excluded).

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
        self._waiting: list[_Seen] = []
        self._heard: dict[str, float] = {}
        self._began = self.context.clock()
        self._robot: Pose2 | None = None
        self._touched = NOWHERE
        self._was_reset = False

    def on_configure(self) -> None:
        """From now on the sources are expected to speak."""
        self._heard, self._began = {}, self.context.clock()

    def add_scan(self, scan: LaserScan, sensor: Pose2, *, source: str | None = None) -> None:
        """Take a scan made from `sensor`, a pose in the costmap's frame.

        Raises:
            InvalidValue: The source is none of the layer's, or not given where there are several.
        """
        points = scan.points_from(sensor, inf_is_valid=self._rules_of(source).inf_is_valid)
        self.add_points(points, (sensor.x, sensor.y), source=source)

    def add_points(self, points: ArrayLike, sensor: tuple[float, float], *, source: str | None = None) -> None:
        """Take points, Shape (n, 2) [m], seen from `sensor`, all in the costmap's frame.

        Args:
            points: Where the beams ended.
            sensor: Where they came from.
            source: Which source saw them; needed where there are several.

        Raises:
            InvalidValue: Not such numbers, the sensor's position is not finite, or the source is none of the layer's or
                not given where there are several.
        """
        rules = self._rules_of(source)
        seen, origin = _pairs(points), _pairs([sensor])
        if seen is None:
            raise InvalidValue(f"{self.context.name}: points must be numbers of shape (n, 2), got {points!r}")
        if origin is None or not np.all(np.isfinite(origin)):
            raise InvalidValue(f"{self.context.name}: the sensor's position must be two finite numbers, got {sensor}")
        with np.errstate(invalid="ignore"):
            usable = np.all(np.abs(seen) < _FARTHEST, axis=1)
        observation, now = _observed(seen[usable], origin[0], rules), self.context.clock()
        self._waiting.append(_Seen(observation, now + rules.observation_persistence))
        self._heard[source or ""] = now
        self._touched = joined(self._touched, _extent(observation))

    def reset(self) -> None:
        """Forget everything seen; not current until the next update."""
        self._grid, self._waiting, self._touched = None, [], EVERYWHERE
        self._heard, self._began = {}, self.context.clock()
        self._was_reset = True

    def is_clearable(self) -> bool:
        """Always."""
        return True

    def is_current(self) -> bool:
        """False from a reset until the next update, while a source is silent for too long, and where said so."""
        return super().is_current() and not self._was_reset and not self._silent_sources()

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
        apply_observations(grid, [seen.observation for seen in self._waiting])
        footprint = self.context.footprint
        if self.parameters.footprint_clearing_enabled and footprint is not None and self._robot is not None:
            fill_footprint(grid, footprint, self._robot, FREE_SPACE)
        master.data[window] = combined(master.data[window], grid.data[window], self.parameters.combination_method)
        now = self.context.clock()
        self._grid, self._was_reset = grid, False
        self._waiting = [seen for seen in self._waiting if now < seen.until]
        self._touched = reduce(joined, (_extent(seen.observation) for seen in self._waiting), NOWHERE)

    def _rules_of(self, source: str | None) -> SourceParameters:
        p = self.parameters
        known: tuple[str | None, ...] = tuple(p.sources) or (None, *p.observation_sources.split())
        if source not in known:
            names = [name for name in known if name is not None]
            near = closest(source, names) if isinstance(source, str) else ""
            raise InvalidValue(f"{self.context.name}: source must be one of {names}, got {source!r}{near}")
        return p if source is None else p.sources.get(source, p)

    def _silent_sources(self) -> list[str]:
        p, now = self.parameters, self.context.clock()
        rates = {name: rules.expected_update_rate for name, rules in (p.sources or {"": p}).items()}
        last = {name: self._heard.get(name, self._began) for name in rates}
        if not p.sources:
            last[""] = max(self._heard.values(), default=self._began)
        return [name for name, rate in rates.items() if 0.0 < rate < now - last[name]]


def _pairs(values: ArrayLike) -> FloatArray | None:
    """Shape (n, 2), or None where they are no such numbers; an empty list has no pair."""
    try:
        pairs = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        return None
    pairs = pairs.reshape(0, 2) if pairs.shape == (0,) else pairs
    return pairs if pairs.ndim == 2 and pairs.shape[1] == 2 else None


def _extent(observation: Observation) -> Bounds:
    return reduce(grown_by_points, observation, NOWHERE)


def _observed(points: FloatArray, sensor: FloatArray, rules: SourceParameters) -> Observation:
    offset = points - sensor
    distance = np.hypot(offset[:, 0], offset[:, 1])
    near = (distance >= rules.obstacle_min_range) & (distance < rules.obstacle_max_range)
    marks = points[near & rules.marking]
    cleared = (distance >= rules.raytrace_min_range) & (distance > 0.0) & rules.clearing
    unit = offset[cleared] / distance[cleared, None]
    reach = np.minimum(distance[cleared], rules.raytrace_max_range)
    first = np.minimum(rules.raytrace_min_range, reach)
    return Observation(marks, sensor + first[:, None] * unit, sensor + reach[:, None] * unit)
