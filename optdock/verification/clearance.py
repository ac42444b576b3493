"""The proof of clearance between samples: conservative advancement of second order.

Let n be the axis that attains the exact distance d of the footprint at u0 to an obstacle. A fixed axis is a valid
lower bound at every other u as well, and along n every footprint vertex v moves by at least
`n.v'(u0) du - M du^2 / 2`, M a bound of its acceleration. So at u0 + du the distance is at least

    d + min_v (n.v + n.v' du) - min_v n.v - M du^2 / 2                                    (*)

which is concave in du: on a stretch it is smallest at one of the two ends. A cell is cleared when its first half is
cleared from its first pose and its last half from its last pose; a cell that is not is cut in two. Motion along a
wall costs nothing, as n.v' = 0 there; first-order advancement, which knows no direction, would have to creep.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.geometry.pose import transform_points
from optdock.geometry.separation import separation
from optdock.verification.motion import PathMotion

if TYPE_CHECKING:
    from optdock.geometry.arrays import BoolArray, FloatArray, IntArray
    from optdock.geometry.footprint import Footprint
    from optdock.geometry.pose import Pose2
    from optdock.geometry.separation import ConvexBody
    from optdock.obstacles import ObstacleSet
    from optdock.path import Path
    from optdock.problem import DockingProblem
    from optdock.verification.motion import CellMotion, Cells, Nodes

__all__ = ["ClearanceProof", "pose_clearance", "prove_clearance"]

TOLERANCE = 1e-6  # [m], accepted shortfall; covers rounding where contact is allowed
SHARPNESS = 1e-3  # [m]: the reported minimum is at most this far below a clearance that occurs
_MAX_STEP = 0.08  # [m], first cells
_MAX_LEVELS = 24
_MAX_POSES = 60_000
_CROP = 1.0  # [m]: obstacles further from the swept area than this are looked at only when nothing is nearer


class ClearanceProof(NamedTuple):
    """What the proof found.

    `proven`: lower bound of the clearance, everywhere on the path; without a proof the smallest clearance seen. `at_s`,
    `required`, `row`: where that is, what was required there, which obstacle (-1: none). `margin`: lower bound of
    clearance - required. `violations`: (s, clearance, required, row) of poses that break the rule, Shape (n, 4).
    `unproven`: (s, bound - required) of cells given up, Shape (m, 2). `poses`: poses looked at.
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
    """One round over a set of cells: lower bound, requirement, obstacle and place per cell; over all of them the
    violating poses and the smallest clearance that a pose has.
    """

    bound: FloatArray
    required: FloatArray
    row: IntArray
    s: FloatArray
    violations: FloatArray
    attained: float

    def rows(self, keep: BoolArray) -> _Round:
        """The cells at `keep`, with all violations."""
        return self._replace(bound=self.bound[keep], required=self.required[keep], row=self.row[keep], s=self.s[keep])


def pose_clearance(pose: Pose2, footprint: Footprint, obstacles: ObstacleSet) -> tuple[float, int]:
    """Signed clearance of one pose [m] and the row of the nearest obstacle; (inf, -1) without obstacles."""
    if len(obstacles) == 0:
        return float("inf"), -1
    poses = pose.as_array()[None]
    best, row = np.inf, -1
    for body in footprint.bodies:
        apart = _box_gaps(body, poses, obstacles)[0]
        order = np.argsort(apart)
        for chunk in (order[:8], order[8:]):
            rows = chunk[apart[chunk] < best]
            if rows.size == 0:
                continue
            distance = separation(body, np.repeat(poses, rows.size, axis=0), obstacles.pieces(rows)).distance
            k = int(np.argmin(distance))
            if distance[k] < best:
                best, row = float(distance[k]), int(rows[k])
    return best, row


def _box_gaps(body: ConvexBody, poses: FloatArray, obstacles: ObstacleSet) -> FloatArray:
    """Lower bound of the distance from every pose's body to every obstacle, by circle and box. Shape (n, m) [m]."""
    centre = 0.5 * (body.vertices.min(axis=0) + body.vertices.max(axis=0))
    radius = float(np.max(np.hypot(*(body.vertices - centre).T)))
    gaps: FloatArray = obstacles.box_distance(transform_points(poses, centre[None])[:, 0]) - radius
    return gaps


def prove_clearance(path: Path, problem: DockingProblem) -> ClearanceProof:
    """Prove the clearance rule of `problem` for every point of `path`, or find the poses that break it."""
    footprint, obstacles = problem.robot.footprint, problem.all_obstacles
    if len(obstacles) == 0:
        nothing = np.zeros((0, 4))
        return ClearanceProof(np.inf, 0.0, problem.clearance.required, -1, np.inf, nothing, nothing[:, :2], 0)
    start_clearance, _ = pose_clearance(problem.start, footprint, obstacles)
    prover = _Prover(PathMotion(path), problem, start_clearance)
    return prover.run()


class _Prover:
    """Carries the fixed inputs of one proof through its rounds."""

    def __init__(self, motion: PathMotion, problem: DockingProblem, start_clearance: float) -> None:
        self.motion, self.problem, self.start_clearance = motion, problem, start_clearance
        self.bodies = problem.robot.footprint.bodies
        self.obstacles = problem.all_obstacles
        end_clearance, _ = pose_clearance(motion.path.end, problem.robot.footprint, self.obstacles)
        self.end_clearance = min(start_clearance, end_clearance)
        self.attained = np.inf
        self.poses = 0

    def run(self) -> ClearanceProof:
        """Rounds of cells until each is proven, violated or given up."""
        cells = self.motion.cells(_MAX_STEP)
        self.rows = self._crop(cells)
        rounds: list[_Round] = []
        violations: list[FloatArray] = []
        given_up = np.zeros((0, 2))
        for level in range(_MAX_LEVELS + 1):
            result = self._round(cells)
            self.attained = min(self.attained, result.attained)
            sharp = result.bound >= self.attained - SHARPNESS
            proven = (result.bound >= result.required - TOLERANCE) & (sharp | (level == _MAX_LEVELS))
            violations.append(result.violations)
            rounds.append(result.rows(proven))
            open_cells = np.flatnonzero(~(proven | self._touches_violation(cells, result)))
            if open_cells.size == 0:
                break
            if level == _MAX_LEVELS or self.poses > _MAX_POSES:
                given_up = np.column_stack((result.s, result.bound - result.required))[open_cells]
                break
            cells = cells.rows(open_cells).halves()
        return self._summary(rounds, np.concatenate(violations), given_up)

    def _crop(self, cells: Cells) -> ObstacleSet:
        """The obstacles near the swept area, or all of them where none is near."""
        nodes = self.motion.nodes(cells.segment, cells.first)
        reach = self.problem.robot.footprint.circumscribed_radius + _MAX_STEP + _CROP + self.problem.clearance.required
        near = self.obstacles.in_box(nodes.poses[:, :2].min(axis=0) - reach, nodes.poses[:, :2].max(axis=0) + reach)
        return near if len(near) else self.obstacles

    def _touches_violation(self, cells: Cells, result: _Round) -> BoolArray:
        """Cells that hold a violating pose: no refinement can prove them."""
        if len(result.violations) == 0:
            return np.zeros(cells.first.size, dtype=bool)
        low = self.motion.nodes(cells.segment, cells.first).s
        high = self.motion.nodes(cells.segment, cells.last).s
        s = result.violations[:, 0]
        touched: BoolArray = np.any((s >= low[:, None] - 1e-9) & (s <= high[:, None] + 1e-9), axis=1)
        return touched

    def _round(self, cells: Cells) -> _Round:
        first = self.motion.nodes(cells.segment, cells.first)
        last = self.motion.nodes(cells.segment, cells.last)
        bounds = self.motion.bounds(cells, first, last)
        self.poses += cells.first.size + 1
        required = self._required_in_cells(first, last, bounds)
        sides = [_Side(first, bounds.velocity_first), _Side(last, -bounds.velocity_last)]
        per_side = [self._side(side, bounds, required) for side in sides]
        bound = np.minimum(per_side[0].bound, per_side[1].bound)
        earlier = per_side[0].bound <= per_side[1].bound
        row = np.where(earlier, per_side[0].row, per_side[1].row)
        s = np.where(earlier, first.s, last.s)
        violations = np.concatenate([side.violations for side in per_side])
        return _Round(bound, required, row, s, violations, min(side.attained for side in per_side))

    def _required_in_cells(self, first: Nodes, last: Nodes, bounds: CellMotion) -> FloatArray:
        """Largest requirement within each cell: distance to a fixed point is convex along the chord."""
        sag = bounds.bend * bounds.width**2 / 8.0
        return self._required(
            np.maximum(self._from(self.problem.goal, first), self._from(self.problem.goal, last)) + sag,
            np.maximum(self._from(self.problem.start, first), self._from(self.problem.start, last)) + sag,
        )

    def _required(self, from_goal: FloatArray, from_start: FloatArray) -> FloatArray:
        return self.problem.clearance.required_at(from_goal, from_start, self.start_clearance)

    @staticmethod
    def _from(point: Pose2, nodes: Nodes) -> FloatArray:
        distance: FloatArray = np.hypot(nodes.poses[:, 0] - point.x, nodes.poses[:, 1] - point.y)
        return distance

    def _side(self, side: _Side, bounds: CellMotion, required: FloatArray) -> _SideBound:
        """Lower bounds over the half cell next to each node, over all bodies and obstacles."""
        half = 0.5 * bounds.width
        total = _SideBound(np.full(half.size, np.inf), np.full(half.size, -1, dtype=np.int64), np.zeros((0, 4)), np.inf)
        for body in self.bodies:
            total = total.merged(self._body_side(body, side, bounds, half, required))
        return total

    def _body_side(
        self, body: ConvexBody, side: _Side, bounds: CellMotion, half: FloatArray, required: FloatArray
    ) -> _SideBound:
        obstacles, poses = self.rows, side.nodes.poses
        reach = float(np.max(np.hypot(*body.vertices.T)))
        travel = half * (bounds.speed + reach * bounds.turn)
        apart = _box_gaps(body, poses, obstacles) - travel[:, None]
        # Anything that may come closer than the two end poses is looked at exactly: the reported minimum is sharp.
        i, o = np.nonzero(apart < np.maximum(required, self.end_clearance)[:, None])
        exact = separation(body, poses[i], obstacles.pieces(o))
        stray = _directional(body, poses[i], side.velocity[i], exact.axis, half[i])
        bend = 0.5 * (bounds.bend + reach * bounds.twist)[i] * half[i] ** 2
        bound = np.minimum(exact.distance, exact.distance + stray - bend)
        apart[i, o] = bound
        row = np.argmin(apart, axis=1)
        violations = self._violations(side, i, o, exact.distance)
        attained = float(np.min(exact.distance, initial=np.inf))
        return _SideBound(apart[np.arange(half.size), row], row, violations, attained)

    def _violations(self, side: _Side, i: IntArray, o: IntArray, distance: FloatArray) -> FloatArray:
        """Poses, not bounds, that are too close: (s, clearance, required, row)."""
        required = self._required(
            self._from(self.problem.goal, side.nodes), self._from(self.problem.start, side.nodes)
        )[i]
        bad = np.flatnonzero(distance < required - TOLERANCE)
        return np.column_stack((side.nodes.s[i[bad]], distance[bad], required[bad], o[bad]))

    def _summary(self, rounds: list[_Round], violations: FloatArray, given_up: FloatArray) -> ClearanceProof:
        bound, required, row, s = (np.concatenate([r[k] for r in rounds]) for k in range(4))
        if len(violations):
            worst = violations[np.argmin(violations[:, 1])]
            margin = float(np.min(violations[:, 1] - violations[:, 2]))
            proven, at, need, which = float(worst[1]), float(worst[0]), float(worst[2]), int(worst[3])
        else:
            k = int(np.argmin(bound)) if bound.size else 0
            margin = float(np.min(bound - required)) if bound.size else -np.inf
            found = (float(bound[k]), float(s[k]), float(required[k]), int(row[k])) if bound.size else _NOTHING
            proven, at, need, which = found
        name_row = which if self.rows is self.obstacles else self._original(which)
        return ClearanceProof(proven, at, need, name_row, margin, self._named(violations), given_up, self.poses)

    def _original(self, row: int) -> int:
        """Row in the problem's obstacles of a row of the cropped ones."""
        if row < 0 or self.rows is self.obstacles:
            return row
        return int(np.argmax(np.all(self.obstacles.vertices == self.rows.vertices[row], axis=(1, 2))))

    def _named(self, violations: FloatArray) -> FloatArray:
        named = violations.copy()
        named[:, 3] = [self._original(int(row)) for row in violations[:, 3]]
        return named


_NOTHING = (-np.inf, 0.0, 0.0, -1)


class _Side(NamedTuple):
    """The nodes at one end of the cells, and the velocity there that points into the cell."""

    nodes: Nodes
    velocity: FloatArray


class _SideBound(NamedTuple):
    """Lower bound and obstacle row per half cell; violating poses; smallest clearance of a pose."""

    bound: FloatArray
    row: IntArray
    violations: FloatArray
    attained: float

    def merged(self, other: _SideBound) -> _SideBound:
        """The smaller bound of the two, and both lists of violations."""
        mine = self.bound <= other.bound
        return _SideBound(
            np.where(mine, self.bound, other.bound),
            np.where(mine, self.row, other.row),
            np.concatenate((self.violations, other.violations)),
            min(self.attained, other.attained),
        )


def _directional(
    body: ConvexBody, poses: FloatArray, velocity: FloatArray, axis: FloatArray, half: FloatArray
) -> FloatArray:
    """First-order part of (*): min_v (n.v + n.v' du) - min_v n.v at du = half. Shape (m,) [m]."""
    offset = transform_points(poses, body.vertices) - poses[:, None, :2]  # (m, v, 2)
    height = axis[:, 0, None] * offset[..., 0] + axis[:, 1, None] * offset[..., 1]
    linear = axis[:, 0] * velocity[:, 0] + axis[:, 1] * velocity[:, 1]
    swing = velocity[:, 2, None] * (axis[:, 1, None] * offset[..., 0] - axis[:, 0, None] * offset[..., 1])
    moved = height + half[:, None] * (linear[:, None] + swing)
    change: FloatArray = moved.min(axis=1) - height.min(axis=1)
    return change
