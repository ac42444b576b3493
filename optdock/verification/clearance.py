"""The proof of clearance for every point of a path.

The path is cut into cells. A cell is cleared when its first half is cleared from its first pose and its last half
from its last pose (`half_cells`); a cell that is not is cut in two, until it is cleared, a pose in it breaks the rule,
or it is given up, which counts as broken.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.verification.half_cells import HalfCells, half_cell_bounds, pose_clearance
from optdock.verification.motion import PathMotion

if TYPE_CHECKING:
    from optdock.geometry.arrays import BoolArray, FloatArray, IntArray
    from optdock.geometry.pose import Pose2
    from optdock.obstacles import ObstacleSet
    from optdock.path import Path
    from optdock.problem import DockingProblem
    from optdock.verification.motion import CellMotion, Cells, Nodes

__all__ = ["ClearanceProof", "prove_clearance"]

TOLERANCE = 1e-6  # [m], accepted shortfall; covers rounding where contact is allowed
SHARPNESS = 1e-3  # [m]: the reported minimum is at most this far below a clearance that occurs
_MAX_STEP = 0.08  # [m], first cells
_MAX_LEVELS = 24
_MAX_POSES = 60_000  # added by refinement
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


def prove_clearance(path: Path, problem: DockingProblem) -> ClearanceProof:
    """Prove the clearance rule of `problem` for every point of `path`, or find the poses that break it."""
    footprint, obstacles = problem.robot.footprint, problem.all_obstacles
    if len(obstacles) == 0:
        nothing = np.zeros((0, 7))
        return ClearanceProof(np.inf, 0.0, problem.clearance.required, -1, np.inf, nothing, nothing[:, :2], 0)
    start_clearance, _ = pose_clearance(problem.start, footprint, obstacles)
    end_clearance, _ = pose_clearance(path.end, footprint, obstacles)
    ends = min(start_clearance, end_clearance)
    near = _Prover(PathMotion(path), problem, start_clearance, ends).run(crop=_CROP)
    # What was left out is at least `_CROP` away: it cannot break the rule, but it may hold the minimum.
    return near if near.proven <= _CROP else _Prover(PathMotion(path), problem, start_clearance, ends).run(crop=np.inf)


class _Prover:
    """Carries the fixed inputs of one proof, and its counters, through the rounds."""

    def __init__(self, motion: PathMotion, problem: DockingProblem, start_clearance: float, attained: float) -> None:
        self.motion, self.problem, self.start_clearance = motion, problem, start_clearance
        self.attained = attained
        self.poses = 0

    def run(self, crop: float) -> ClearanceProof:
        """Rounds of cells until each is proven, violated or given up; obstacles beyond `crop` [m] are left out."""
        cells = self.motion.cells(_MAX_STEP)
        self.near, original = self._crop(cells, crop)
        budget = _MAX_POSES + cells.first.size
        settled: list[FloatArray] = []
        violations: list[FloatArray] = []
        given_up: FloatArray = np.zeros((0, 4))
        for level in range(_MAX_LEVELS + 1):
            result = self._round(cells)
            self.attained = min(self.attained, result.attained)
            is_last = level == _MAX_LEVELS or self.poses > budget
            sharp = result.bound >= self.attained - SHARPNESS
            proven = (result.bound >= result.required - TOLERANCE) & (sharp | is_last)
            violations.append(result.violations)
            settled.append(result.settled(proven))
            open_cells = np.flatnonzero(~(proven | self._touches_violation(cells, result)))
            if open_cells.size == 0:
                break
            if is_last:
                given_up = result.settled(open_cells)
                break
            cells = cells.rows(open_cells).halves()
        return self._summary(np.concatenate(settled), np.concatenate(violations), given_up, original)

    def _crop(self, cells: Cells, crop: float) -> tuple[ObstacleSet, IntArray]:
        """The obstacles near the swept area, or all of them where none is near; and their rows in the problem."""
        everything = self.problem.all_obstacles
        ends = self.motion.nodes(np.tile(cells.segment, 2), np.concatenate((cells.first, cells.last)))
        at = ends.poses[:, :2]  # a cell strays from its chord by less than `_MAX_STEP`
        reach = self.problem.robot.footprint.circumscribed_radius + _MAX_STEP + crop + self.problem.clearance.required
        rows = everything.rows_in_box(at.min(axis=0) - reach, at.max(axis=0) + reach)
        if rows.size in (0, len(everything)):
            return everything, np.arange(len(everything))
        return everything.subset(rows), rows

    def _touches_violation(self, cells: Cells, result: _Round) -> BoolArray:
        """Cells that hold a violating pose: no refinement can prove them."""
        if len(result.violations) == 0:
            return np.zeros(cells.first.size, dtype=bool)
        low = self.motion.nodes(cells.segment, cells.first).s
        high = self.motion.nodes(cells.segment, cells.last).s
        s = np.sort(result.violations[:, 0])
        touched: BoolArray = np.searchsorted(s, low - 1e-9) < np.searchsorted(s, high + 1e-9, side="right")
        return touched

    def _round(self, cells: Cells) -> _Round:
        n = cells.first.size
        nodes = self.motion.nodes(np.tile(cells.segment, 2), np.concatenate((cells.first, cells.last)))
        bounds = self.motion.bounds(cells, nodes.poses[:n], nodes.poses[n:])
        self.poses += n + 1
        required = self._required_in_cells(nodes, bounds)
        care = np.maximum(required, self.attained)
        halves = half_cell_bounds(self.problem.robot.footprint, _halves(nodes, bounds), self.near, np.tile(care, 2))
        earlier = halves.bound[:n] <= halves.bound[n:]
        pick = np.where(earlier, np.arange(n), np.arange(n) + n)
        required_at_nodes = self._required(*self._distances(nodes))[halves.stretch]
        bad = np.flatnonzero(halves.distance < required_at_nodes - TOLERANCE)
        at_bad = halves.stretch[bad]
        poses = nodes.poses[at_bad]
        violations = np.column_stack(
            (nodes.s[at_bad], halves.distance[bad], required_at_nodes[bad], 1.0 * halves.obstacle[bad], poses)
        )
        attained = float(np.min(halves.distance, initial=np.inf))
        return _Round(halves.bound[pick], required, halves.row[pick], nodes.s[pick], violations, attained)

    def _required_in_cells(self, nodes: Nodes, bounds: CellMotion) -> FloatArray:
        """Largest requirement within each cell: distance to a fixed point is convex along the chord."""
        n = bounds.width.size
        sag = bounds.bend * bounds.width**2 / 8.0
        from_goal, from_start = (np.maximum(d[:n], d[n:]) + sag for d in self._distances(nodes))
        return self._required(from_goal, from_start)

    def _required(self, from_goal: FloatArray, from_start: FloatArray) -> FloatArray:
        return self.problem.clearance.required_at(from_goal, from_start, self.start_clearance)

    def _distances(self, nodes: Nodes) -> tuple[FloatArray, FloatArray]:
        """Distances from the goal and from the start, Shape (n,) [m] each."""
        return _distance(nodes, self.problem.goal), _distance(nodes, self.problem.start)

    def _summary(
        self, settled: FloatArray, violations: FloatArray, given_up: FloatArray, original: IntArray
    ) -> ClearanceProof:
        worst = violations[:, [1, 0, 2, 3]] if len(violations) else np.concatenate((settled, given_up))
        unproven = np.column_stack((given_up[:, 1], given_up[:, 0] - given_up[:, 2]))
        violations = violations.copy()
        violations[:, 3] = original[violations[:, 3].astype(np.int64)]
        proven, s, required, row = (float(value) for value in worst[np.argmin(worst[:, 0])])
        margin = float(np.min(worst[:, 0] - worst[:, 2]))
        return ClearanceProof(proven, s, required, int(original[int(row)]), margin, violations, unproven, self.poses)


def _distance(nodes: Nodes, point: Pose2) -> FloatArray:
    distance: FloatArray = np.hypot(nodes.poses[:, 0] - point.x, nodes.poses[:, 1] - point.y)
    return distance


def _halves(nodes: Nodes, bounds: CellMotion) -> HalfCells:
    """First the first halves, seen from the first poses, then the last halves, seen from the last."""
    velocity = np.concatenate((bounds.velocity_first, -bounds.velocity_last))
    columns = (0.5 * bounds.width, bounds.speed, bounds.turn, bounds.bend, bounds.twist)
    return HalfCells(nodes.poses, velocity, *(np.tile(column, 2) for column in columns))
