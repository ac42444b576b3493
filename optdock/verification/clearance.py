"""The proof of clearance for every point of a path.

The path is cut into cells. A cell is cleared when its first half is cleared from its first pose and its last half
from its last pose (`half_cells`); a cell that is not is cut in two, until it is cleared, a pose in it breaks the rule,
or it is given up, which counts as broken. Cells that are cleared by the tolerance only are proven a second time: there
nothing may lie deep inside anything (`contact`).
"""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.deadline import never_late
from optdock.verification.contact import DEPTH, deep_pairs
from optdock.verification.half_cells import HalfCells, body_bounds, half_cell_bounds, pose_clearances, rounded
from optdock.verification.motion import Cells, PathMotion

if TYPE_CHECKING:
    from collections.abc import Callable

    from optdock.geometry.arrays import BoolArray, FloatArray, IntArray
    from optdock.geometry.pose import Pose2
    from optdock.obstacles import ObstacleSet
    from optdock.path import Path
    from optdock.problem import DockingProblem
    from optdock.verification.half_cells import HalfBounds, RoundedBody
    from optdock.verification.motion import CellEnds, CellMotion, Nodes

__all__ = ["ClearanceProof", "prove_clearance"]

TOLERANCE = 1e-6  # [m], accepted shortfall; covers rounding where contact is allowed
SHARPNESS = 1e-3  # [m]: the reported minimum is at most this far below a clearance that occurs
_BLOCK = 4000  # cells looked at in one go, some milliseconds; a deadline is looked at in between
_MAX_STEP = 0.08  # [m], first cells
_MOST_FIRST = 100_000  # of them; on paths beyond 8 km they are longer
_MAX_LEVELS = 24  # of halving
_CHEAP = 48  # cells: a round of fewer takes hardly less time, so few open ones are cut into many parts at once
_MAX_POSES = 60_000  # added by refinement
_WORTHWHILE = 0.7  # of the obstacles: where more are near, leaving out the rest costs more than it saves
_CROP = 1.0  # [m]: obstacles further from the swept area than this are looked at only when nothing is as near


class ClearanceProof(NamedTuple):
    """What the proof found.

    `proven`: lower bound of the clearance, everywhere on the path; with violations the smallest clearance among them.
    `at_s`, `required`, `row`: where that is, what was required there, which obstacle (-1: none). `margin`: lower bound
    of clearance - required, likewise. `violations`: (s, clearance, required, row, x, y, yaw) of poses that break the
    rule, Shape (n, 7). `unproven`: (s, bound - required) of cells given up, Shape (m, 2). `poses`: poses looked at.
    """

    proven: float
    at_s: float
    required: float
    row: int
    margin: float
    violations: FloatArray
    unproven: FloatArray
    poses: int


class _Round(NamedTuple):
    """One round over a set of cells.

    Per cell: lower bound, requirement, obstacle row, place. Over all: violating poses, smallest clearance of a pose.
    """

    bound: FloatArray
    required: FloatArray
    row: IntArray
    s: FloatArray
    violations: FloatArray
    attained: float

    def settled(self, keep: BoolArray | IntArray) -> FloatArray:
        """Bound, requirement, place and row of the cells at `keep`, Shape (n, 4)."""
        table: FloatArray = np.column_stack((self.bound, self.s, self.required, self.row.astype(np.float64)))[keep]
        return table


def prove_clearance(path: Path, problem: DockingProblem, is_late: Callable[[], bool] = never_late) -> ClearanceProof:
    """Prove the clearance rule of `problem` for every point of `path`, or find the poses that break it.

    Args:
        path: The path to judge.
        problem: What must hold.
        is_late: Polled after every round of cells. Once it is True what is proven counts, the minimum is sharpened no
            further, and cells that are still open are given up.
    """
    footprint, obstacles = problem.robot.footprint, problem.all_obstacles
    if len(obstacles) == 0:
        nothing = np.zeros((0, 7))
        return ClearanceProof(np.inf, 0.0, problem.clearance.required, -1, np.inf, nothing, nothing[:, :2], 0)
    ends = np.stack((problem.start.as_array(), path.end.as_array()))
    clearances, _ = pose_clearances(ends, footprint, obstacles)
    start_clearance, attained = float(clearances[0]), float(clearances.min())
    motion = PathMotion(path)
    prover = _Prover(motion, problem, start_clearance, attained, is_late)
    near = prover.run(crop=_CROP)
    if near.proven <= _CROP or len(prover.near) == len(obstacles):
        return near
    # What was left out is at least `_CROP` away: it cannot break the rule, but it may hold the minimum.
    if is_late():
        margin = min(near.margin, _CROP - problem.clearance.required)
        return near._replace(proven=min(near.proven, _CROP), margin=margin)
    return _Prover(motion, problem, start_clearance, attained, is_late).run(crop=np.inf)


class _Prover:
    """Carries the fixed inputs of one proof, and its counters, through the rounds."""

    def __init__(
        self,
        motion: PathMotion,
        problem: DockingProblem,
        start_clearance: float,
        attained: float,
        is_late: Callable[[], bool],
    ) -> None:
        self.motion, self.problem, self.start_clearance = motion, problem, start_clearance
        self.attained, self.is_late = attained, is_late
        self.step = max(_MAX_STEP, motion.path.length / _MOST_FIRST)
        self.poses = 0

    def run(self, crop: float) -> ClearanceProof:
        """Rounds of cells until each is proven, violated or given up; obstacles beyond `crop` [m] are left out."""
        # At the goal the path often has just what is required: a last cell of full length would need a second round.
        cells = self.motion.cells(self.step).last_halved()
        budget = _MAX_POSES + cells.first.size
        settled: list[FloatArray] = []
        violations: list[FloatArray] = []
        forgiven: list[Cells] = []
        given_up: list[FloatArray] = [np.zeros((0, 4))]
        whole, at_first = cells, self._ends(cells)
        self.near, self.original = self._crop(at_first[1], crop)
        waiting = deque((0, block) for block in cells.blocks(_BLOCK))
        while waiting:
            level, cells = waiting.popleft()
            ends, nodes = at_first if cells is whole else self._ends(cells)
            if settled and level == 0 and self.is_late():
                given_up.append(_unknown(nodes.s[ends.first]))  # of a long path this was not begun with
                continue
            result = self._round(cells, ends, nodes)
            self.attained = min(self.attained, result.attained)
            is_last = level >= _MAX_LEVELS or self.poses > budget or self.is_late()
            sharp = result.bound >= self.attained - SHARPNESS
            proven = (result.bound >= result.required - TOLERANCE) & (sharp | is_last)
            violations.append(result.violations)
            settled.append(result.settled(proven))
            if np.any(touching := proven & (result.bound < 0.0)):
                forgiven.append(cells.rows(np.flatnonzero(touching)))
            open_cells = np.flatnonzero(~(proven | self._touches_violation(ends, nodes, result)))
            if open_cells.size and is_last:
                given_up.append(result.settled(open_cells))
            elif open_cells.size:
                halvings = max(1, int(np.log2(_CHEAP / open_cells.size)))
                finer = cells.rows(open_cells).cut(2**halvings)
                waiting.extend((level + halvings, block) for block in finer.blocks(_BLOCK))
        if forgiven and not sum(map(len, violations)):
            deep = self._look_deep(Cells(*map(np.concatenate, zip(*forgiven, strict=True))))
            for rows, more in zip((violations, given_up), deep, strict=True):
                rows.append(more)
        return self._summary(np.concatenate(settled), np.concatenate(violations), np.concatenate(given_up))

    def _look_deep(self, cells: Cells) -> tuple[FloatArray, FloatArray]:
        """Poses at which something lies deep inside something, and what cannot be proven; as `run` collects them."""
        robot = self.problem.robot.footprint
        at = self._ends(cells)[1].poses[:, :2]
        reach = robot.circumscribed_radius + self.step
        pairs = deep_pairs(robot, self.near, at.min(axis=0) - reach, at.max(axis=0) + reach)
        found = [self._apart(rounded(bodies), rocks, cells) for bodies, rocks in pairs]
        violations, given_up = zip(*found, strict=True) if found else ((), ())
        return np.concatenate((np.zeros((0, 7)), *violations)), np.concatenate((np.zeros((0, 4)), *given_up))

    def _apart(
        self, bodies: tuple[RoundedBody, ...], rocks: ObstacleSet, cells: Cells
    ) -> tuple[FloatArray, FloatArray]:
        """Prove that bodies and obstacles share no interior in any of the cells."""
        level, budget = 0, self.poses + _MAX_POSES
        while True:
            ends, nodes = self._ends(cells)
            self.poses += nodes.s.size
            bounds = self.motion.bounds(cells, nodes.poses[ends.first], nodes.poses[ends.last])
            halves = body_bounds(
                bodies, _halves(nodes, ends, bounds), rocks, np.zeros(2 * cells.first.size), self.is_late
            )
            n = cells.first.size
            bound = np.minimum(halves.bound[:n], halves.bound[n:])
            bad = np.flatnonzero(halves.distance < 0.0)
            if bad.size:
                k = bad[np.argmin(halves.distance[bad])]
                return self._deep_violation(nodes, int(halves.pose[k]), float(halves.distance[k])), np.zeros((0, 4))
            open_cells = np.flatnonzero(~(bound >= 0.0))
            if open_cells.size == 0:
                return np.zeros((0, 7)), np.zeros((0, 4))
            if level >= _MAX_LEVELS or self.poses > budget or self.is_late():
                s = nodes.s[ends.first[open_cells]]
                return np.zeros((0, 7)), np.column_stack((bound[open_cells] - DEPTH, s, 0.0 * s, 0.0 * s))
            halvings = max(1, int(np.log2(_CHEAP / open_cells.size)))
            cells, level = cells.rows(open_cells).cut(2**halvings), level + halvings

    def _deep_violation(self, nodes: Nodes, at: int, distance: float) -> FloatArray:
        """The pose as `ClearanceProof.violations` has it, with the obstacle piece that is nearest by itself."""
        pose = nodes.poses[at]
        _, row = pose_clearances(pose[None], self.problem.robot.footprint, self.near)
        return np.array([[nodes.s[at], distance - DEPTH, 0.0, row[0], *pose]])

    def _ends(self, cells: Cells) -> tuple[CellEnds, Nodes]:
        ends = cells.ends()
        return ends, self.motion.nodes(ends.segment, ends.u)

    def _crop(self, nodes: Nodes, crop: float) -> tuple[ObstacleSet, IntArray]:
        """The obstacles near the swept area, or all of them where none is near; and their rows in the problem."""
        everything = self.problem.all_obstacles
        at = nodes.poses[:, :2]  # a cell strays from its chord by less than its length
        reach = self.problem.robot.footprint.circumscribed_radius + self.step + crop + self.problem.clearance.required
        rows = everything.rows_in_box(at.min(axis=0) - reach, at.max(axis=0) + reach)
        if rows.size == 0 or rows.size > _WORTHWHILE * len(everything):
            return everything, np.arange(len(everything))
        return everything.subset(rows), rows

    def _touches_violation(self, ends: CellEnds, nodes: Nodes, result: _Round) -> BoolArray:
        """Cells that hold a violating pose: no refinement can prove them."""
        if len(result.violations) == 0:
            return np.zeros(ends.first.size, dtype=bool)
        low, high = nodes.s[ends.first], nodes.s[ends.last]
        s = np.sort(result.violations[:, 0])
        touched: BoolArray = np.searchsorted(s, low - 1e-9) < np.searchsorted(s, high + 1e-9, side="right")
        return touched

    def _round(self, cells: Cells, ends: CellEnds, nodes: Nodes) -> _Round:
        bounds = self.motion.bounds(cells, nodes.poses[ends.first], nodes.poses[ends.last])
        n = cells.first.size
        self.poses += nodes.s.size
        distances = self._distances(nodes)
        required = self._required_in_cells(distances, ends, bounds)
        care = np.maximum(required, self.attained)
        stretches = _halves(nodes, ends, bounds)
        halves = half_cell_bounds(self.problem.robot.footprint, stretches, self.near, np.tile(care, 2), self.is_late)
        earlier = halves.bound[:n] <= halves.bound[n:]
        pick = np.where(earlier, np.arange(n), np.arange(n) + n)
        violations = self._violations(nodes, halves, self._required(*distances))
        attained = float(np.min(halves.distance, initial=np.inf))
        place = nodes.s[stretches.pose[pick]]
        return _Round(halves.bound[pick], required, halves.row[pick], place, violations, attained)

    def _violations(self, nodes: Nodes, halves: HalfBounds, required: FloatArray) -> FloatArray:
        """Poses looked at exactly that break the rule, Shape (m, 7), see `ClearanceProof`."""
        bad = np.flatnonzero(halves.distance < required[halves.pose] - TOLERANCE)
        at = halves.pose[bad]
        columns = (nodes.s[at], halves.distance[bad], required[at], 1.0 * halves.obstacle[bad])
        return np.column_stack((*columns, nodes.poses[at]))

    def _required_in_cells(
        self, distances: tuple[FloatArray, FloatArray], ends: CellEnds, bounds: CellMotion
    ) -> FloatArray:
        """Largest requirement within each cell: distance to a fixed point is convex along the chord."""
        sag = bounds.bend * bounds.width**2 / 8.0
        from_goal, from_start = (np.maximum(d[ends.first], d[ends.last]) + sag for d in distances)
        return self._required(from_goal, from_start)

    def _required(self, from_goal: FloatArray, from_start: FloatArray) -> FloatArray:
        return self.problem.clearance.required_at(from_goal, from_start, self.start_clearance)

    def _distances(self, nodes: Nodes) -> tuple[FloatArray, FloatArray]:
        """Distances from the goal and from the start, Shape (n,) [m] each."""
        return _distance(nodes, self.problem.goal), _distance(nodes, self.problem.start)

    def _summary(self, settled: FloatArray, violations: FloatArray, given_up: FloatArray) -> ClearanceProof:
        worst = violations[:, [1, 0, 2, 3]] if len(violations) else np.concatenate((settled, given_up))
        unproven = np.column_stack((given_up[:, 1], given_up[:, 0] - given_up[:, 2]))
        violations = violations.copy()
        violations[:, 3] = self.original[violations[:, 3].astype(np.int64)]
        proven, s, required, row = (float(value) for value in worst[np.argmin(worst[:, 0])])
        margin = float(np.min(worst[:, 0] - worst[:, 2]))
        return ClearanceProof(
            proven, s, required, int(self.original[int(row)]), margin, violations, unproven, self.poses
        )


def _unknown(s: FloatArray) -> FloatArray:
    """Rows of cells of which nothing is known, as `_Round.settled` has them."""
    return np.column_stack((np.full(s.size, -np.inf), s, 0.0 * s, 0.0 * s))


def _distance(nodes: Nodes, point: Pose2) -> FloatArray:
    distance: FloatArray = np.hypot(nodes.poses[:, 0] - point.x, nodes.poses[:, 1] - point.y)
    return distance


def _halves(nodes: Nodes, ends: CellEnds, bounds: CellMotion) -> HalfCells:
    """First the first halves, seen from the first poses, then the last halves, seen from the last."""
    velocity = np.concatenate((bounds.velocity_first, -bounds.velocity_last))
    columns = (0.5 * bounds.width, bounds.speed, bounds.turn, bounds.bend, bounds.twist)
    pose = np.concatenate((ends.first, ends.last))
    return HalfCells(nodes.poses, pose, velocity, *(np.tile(column, 2) for column in columns))
