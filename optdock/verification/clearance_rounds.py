"""One round of the proof of clearance: bounds and fates of all cells of a path at once.

A cell is cleared if the advance from its first pose clears the first half, and the advance backwards from its last pose
clears the second half (equation C8 of docs/theory/certificate.md).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.deadline import never_late
from optdock.geometry.arrays import readonly
from optdock.geometry.separation import skips_edges
from optdock.kernels import Kernel, twin_of
from optdock.model.clearance_rule import START_RELIEF_SLOPE
from optdock.verification.certificate import SHARPNESS, TOLERANCE
from optdock.verification.clearance_kernel import packed_footprint
from optdock.verification.proximity import bounded_footprint
from optdock.verification.stretch_bounds import Advances, advance_bounds, most_at_once

if TYPE_CHECKING:
    from collections.abc import Callable

    from optdock.geometry.arrays import BoolArray, FloatArray, IntArray
    from optdock.geometry.footprint import Footprint
    from optdock.geometry.obstacles import ObstacleSet
    from optdock.geometry.pose import Pose2
    from optdock.model.clearance_rule import ClearanceRule
    from optdock.verification.motion_bounds import CellEnds, CellMotion, Cells, Nodes, PathMotion

__all__ = ["Near", "Round", "Rule", "World", "clearance_round", "from_both_ends"]

_NONE = readonly(np.zeros(0, dtype=np.int64))


class Rule(NamedTuple):
    """The clearance rule with the clearance of the start [m] and the start relief [m]."""

    kept: ClearanceRule
    start_clearance: float
    start_relief: float

    def __call__(self, from_goal: FloatArray, from_start: FloatArray) -> FloatArray:
        """Return the required clearance at distances from the goal and from the start, Shape (n,) [m]."""
        return self.kept.required_at(from_goal, from_start, self.start_clearance, self.start_relief)

    @property
    def numbers(self) -> tuple[float, ...]:
        """The first eight numbers of `Rule` in C."""
        kept, relief = self.kept, self.start_relief
        least = kept.least_leaving(self.start_clearance, relief)
        at_start = np.nan if kept.at_start is None else kept.at_start
        return kept.required, kept.at_dock, kept.taper, kept.dock_run, least, START_RELIEF_SLOPE, relief, at_start


class World(NamedTuple):
    """Outline of the robot, obstacles, and clearance rule."""

    footprint: Footprint
    obstacles: ObstacleSet
    goal: Pose2
    start: Pose2
    rule: Rule

    def distances(self, poses: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the distances of poses, Shape (n, 3), from the goal and from the start, Shape (n,) [m] each."""
        x, y = poses[:, 0], poses[:, 1]
        return np.hypot(x - self.goal.x, y - self.goal.y), np.hypot(x - self.start.x, y - self.start.y)


class Near:
    """Those obstacles of a set that are evaluated, by their rows in ascending order."""

    def __init__(self, everything: ObstacleSet, rows: IntArray) -> None:
        self.everything, self.rows = everything, rows
        self.is_all = rows.size == len(everything)
        self._subset: ObstacleSet | None = everything if self.is_all else None

    def __len__(self) -> int:
        return self.rows.size

    @property
    def obstacles(self) -> ObstacleSet:
        """The obstacles as a set."""
        if self._subset is None:
            self._subset = self.everything.subset(self.rows)
        return self._subset


class Round(NamedTuple):
    """Result of one round over n cells with k ends.

    `bound`, `required`, `s`, `row`, `place`: lower bound and required clearance [m] of each cell, and where the bound
    occurs: arc length [m], row among the near obstacles, end of a cell. `needed`: required clearance at the ends, Shape
    (k,) [m]. `fates`: 0 for proven and sharp cells, 1 for others with a pose that violates the rule, 2 for open cells.
    `pose`, `obstacle`, `distance`: end, row of the obstacle and clearance [m] of the pairs that violate the rule.
    `attained`: smallest clearance of a pose in this round [m].
    """

    bound: FloatArray
    required: FloatArray
    s: FloatArray
    row: IntArray
    place: IntArray
    needed: FloatArray
    fates: IntArray
    pose: IntArray
    obstacle: IntArray
    distance: FloatArray
    attained: float

    def without_sharpness(self) -> IntArray:
        """Return the fates if proven cells need not be sharp."""
        return np.where(self.bound >= self.required - TOLERANCE, 0, self.fates)

    def rows(self, keep: IntArray) -> FloatArray:
        """Return bound, arc length, required clearance, obstacle, and requirement at the pose, of cells. (n, 5)."""
        columns = (self.bound, self.s, self.required, self.row.astype(np.float64), self.needed[self.place])
        table: FloatArray = np.column_stack(columns)[keep]
        return table

    def violations(self, nodes: Nodes) -> FloatArray:
        """Return the poses that violate the rule, Shape (m, 7), in the form of `ClearanceProof`."""
        at = self.pose
        return np.column_stack((nodes.s[at], self.distance, self.needed[at], 1.0 * self.obstacle, nodes.poses[at]))


def clearance_round(
    motion: PathMotion,
    world: World,
    near: Near,
    cells: tuple[Cells, CellEnds, Nodes],
    attained: float,
    is_late: Callable[[], bool],
) -> Round:
    """Return the bounds and fates of cells.

    Args:
        motion: The path.
        world: Robot, goal, start and rule.
        near: At least one obstacle.
        cells: The cells, their ends, and the poses there.
        attained: Smallest clearance of a pose so far [m].
        is_late: Polled between the parts of a round that is too long to be evaluated at once; see `advance_bounds`.
    """
    bodies, corners = bounded_footprint(world.footprint), near.everything.vertices.shape[1]
    at_once = most_at_once(bodies, len(near), corners)
    # The kernel evaluates all edges; of pairs with many corners the twin skips most.
    has_many = skips_edges(packed_footprint(world.footprint).corners, corners)
    if motion.pieces is None or has_many or 2 * len(bodies) * cells[0].first.size > at_once:
        return _round_numpy(motion, world, near, cells, attained, is_late)
    return _round_chosen(motion, world, near, cells, attained)


_KERNEL = Kernel("optdock_clearance_round", sizes=9, numbers=3)


def _round_native(
    motion: PathMotion, world: World, near: Near, cells: tuple[Cells, CellEnds, Nodes], attained: float
) -> Round:
    """Return the result of `_round_numpy`, computed in C; its arrays are described there."""
    (segment, edges), (ends, nodes), rocks = cells[0].packed(), cells[1:], near.everything
    pieces, robot = motion.pieces, packed_footprint(world.footprint)
    assert pieces is not None
    (everything, q, _), bodies, m = rocks.vertices.shape, robot.sizes.shape[0], near.rows.size
    n, k = segment.size, nodes.s.size
    pairs, turned = k * m * bodies, np.empty((k, 2))
    turned[:, 0], turned[:, 1] = np.cos(nodes.poses[:, 2]), np.sin(nodes.poses[:, 2])
    rule = np.array((*world.rule.numbers, world.goal.x, world.goal.y, world.start.x, world.start.y))
    found, needed, distances = np.empty((3, n)), np.empty(k + 1), np.empty(pairs)
    whole, pair_of, counts = np.empty((3, n), dtype=np.int64), np.empty((2, pairs), dtype=np.int64), np.zeros(2, int)
    arrays = (
        (segment, n),
        (edges, 2 * n),
        (ends.packed(), 2 * n),
        (nodes.poses, 3 * k),
        (turned, 2 * k),
        (nodes.s, k),
        (pieces.kinds, pieces.kinds.size),
        (pieces.table, pieces.table.size),
        (rule, 12),
        (robot.sizes, 2 * bodies),
        (robot.numbers, robot.numbers.size),
        (near.rows, m),
        (rocks.vertices, 2 * q * everything),
        (rocks.normals, 2 * q * everything),
        (rocks.offsets, q * everything),
        (rocks.lower, 2 * everything),
        (rocks.upper, 2 * everything),
        (found, 3 * n),
        (whole, 3 * n),
        (needed, k + 1),
        (pair_of, 2 * pairs),
        (distances, pairs),
        (counts, 2),
        (np.empty(size := 22 * n + 2 * k + m + 2 * (robot.corners + q + robot.circles)), size),
        (np.empty(size := 6 * n + m + 2 * k + 1, dtype=np.int64), size),
    )
    sizes = n, k, m, bodies, q, robot.corners, robot.circles, len(pieces.kinds), len(pieces.table)
    if _KERNEL(sizes, (attained, TOLERANCE, SHARPNESS), arrays) < 0:
        raise IndexError("cells: must be rows of ends and segments of the path")
    bad = _NONE
    if counts[1]:
        bad = np.flatnonzero(distances[: counts[0]] < needed[pair_of[0, : counts[0]]] - TOLERANCE)
    violating = pair_of[0, bad], pair_of[1, bad], distances[bad]
    (bound, required, s), (row, place, fates) = found, whole
    return Round(bound, required, s, row, place, needed[:k], fates, *violating, float(needed[k]))


@twin_of(_round_native)
def _round_chosen(
    motion: PathMotion, world: World, near: Near, cells: tuple[Cells, CellEnds, Nodes], attained: float
) -> Round:
    return _round_numpy(motion, world, near, cells, attained, never_late)


def _round_numpy(
    motion: PathMotion,
    world: World,
    near: Near,
    cells: tuple[Cells, CellEnds, Nodes],
    attained: float,
    is_late: Callable[[], bool],
) -> Round:
    some, ends, nodes = cells
    bounds = motion.bounds(some, nodes.poses[ends.first], nodes.poses[ends.last])
    n, distances = some.first.size, world.distances(nodes.poses)
    required = world.rule(*(bounds.farthest(ends, distance) for distance in distances))
    exact_within = np.tile(np.maximum(required, attained), 2)
    advances = from_both_ends(nodes, ends, bounds)
    found = advance_bounds(bounded_footprint(world.footprint), advances, near.obstacles, exact_within, is_late)
    earlier = found.bound[:n] <= found.bound[n:]
    pick = np.where(earlier, np.arange(n), np.arange(n) + n)
    bound, place, needed = found.bound[pick], advances.pose[pick], world.rule(*distances)
    bad = np.flatnonzero(found.distance < needed[found.pose] - TOLERANCE)
    smallest = float(np.min(found.distance, initial=np.inf))
    is_proven = (bound >= required - TOLERANCE) & (bound >= min(attained, smallest) - SHARPNESS)
    fates = np.where(is_proven, 0, np.where(_touch(ends, nodes, found.pose[bad]), 1, 2))
    pairs = found.pose[bad], found.obstacle[bad], found.distance[bad]
    return Round(bound, required, nodes.s[place], found.row[pick], place, needed, fates, *pairs, smallest)


def _touch(ends: CellEnds, nodes: Nodes, bad: IntArray) -> BoolArray:
    """Return a mask of the cells that contain one of the ends `bad`; refinement cannot prove them."""
    if bad.size == 0:
        return np.zeros(ends.first.size, dtype=np.bool_)
    low, high = nodes.s[ends.first], nodes.s[ends.last]
    s = np.sort(nodes.s[bad])
    touched: BoolArray = np.searchsorted(s, low - 1e-9) < np.searchsorted(s, high + 1e-9, side="right")
    return touched


def from_both_ends(nodes: Nodes, ends: CellEnds, bounds: CellMotion) -> Advances:
    """Return advances over the first halves of cells from the first poses, then over last halves from last poses."""
    velocity = np.concatenate((bounds.velocity_first, -bounds.velocity_last))
    columns = (0.5 * bounds.width, bounds.speed, bounds.turn, bounds.bend, bounds.twist)
    pose = np.concatenate((ends.first, ends.last))
    return Advances(nodes.poses, pose, velocity, *(np.tile(column, 2) for column in columns))
