"""Second-order conservative advancement [Mirtich1996]: the proof of clearance for every point of a path.

The axis that attains the exact distance at a pose gives a lower bound of the distance along the motion near this pose
(equation C5 of docs/theory/certificate.md). The path is subdivided into cells. A cell is cleared if the advance from
its first pose clears the first half, and the advance backwards from its last pose clears the second half. Other cells
are bisected until they are cleared, contain a pose that violates the rule, or are given up; a cell that is given up
counts as a violation. The reported minimum is found by branch and bound: cells whose lower bound is well below the
smallest clearance of the poses so far are bisected further. Cells that are cleared only within the tolerance are
checked a second time for deep overlaps (`contact_tolerance`).
"""

from __future__ import annotations

import functools
from collections import deque
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.deadline import never_late
from optdock.geometry.separation import separation, skips_edges
from optdock.kernels import Kernel, twin_of
from optdock.verification.certificate import SHARPNESS, TOLERANCE
from optdock.verification.contact_tolerance import DEPTH, deep_pairs
from optdock.verification.motion_bounds import Cells, PathMotion
from optdock.verification.proximity import bounded, bounded_footprint, broad_phase, pose_clearances

if TYPE_CHECKING:
    from collections.abc import Callable

    from optdock.geometry.arrays import BoolArray, FloatArray, IntArray
    from optdock.geometry.footprint import Footprint
    from optdock.geometry.obstacles import ObstacleSet
    from optdock.geometry.pose import Pose2
    from optdock.geometry.separation import ConvexBody
    from optdock.model.path import Path
    from optdock.model.problem import DockingProblem
    from optdock.verification.motion_bounds import CellEnds, CellMotion, Nodes
    from optdock.verification.proximity import BoundedBody

__all__ = ["AdvanceBounds", "Advances", "Begun", "ClearanceProof", "advance_bounds", "prove_clearance"]

_BLOCK = 4000  # cells evaluated at once, some milliseconds; the deadline is polled in between
_MAX_STEP = 0.08  # [m], length of first cells
_MOST_FIRST = 100_000  # first cells; they are longer on paths beyond 8 km
_MAX_LEVELS = 24  # of bisection
_CHEAP = 48  # cells: smaller rounds take almost the same time, so a few open cells are divided into more parts
_MAX_POSES = 60_000  # added by refinement
_WORTHWHILE = 0.7  # fraction of near obstacles above which cropping takes longer than it saves
_CROP = 1.0  # [m]: obstacles farther from the swept area are evaluated only if no other is as near
_MAX_PAIRS = 200_000  # of an advance and an obstacle evaluated at once; bounds memory and time
_MAX_CORNERS = 50_000  # of body and obstacle times advances evaluated at once; bounds memory and time


class ClearanceProof(NamedTuple):
    """Result of the proof; its truth value is `holds`.

    `proven`: lower bound of the clearance on the whole path; with violations the smallest clearance among them. `at_s`,
    `required`, `row`: arc length at which `proven` occurs, with the required clearance and the obstacle there (-1:
    none). `margin`: lower bound of clearance - required, which is not sharp because cells are bisected only until they
    are proven. `violations`: (s, clearance, required, row, x, y, yaw) of violating poses, Shape (n, 7). `unproven`: (s,
    bound - required) of cells given up, Shape (m, 2). `poses`: number of evaluated poses.
    """

    proven: float
    at_s: float
    required: float
    row: int
    margin: float
    violations: FloatArray
    unproven: FloatArray
    poses: int

    def __bool__(self) -> bool:
        return self.holds

    @property
    def holds(self) -> bool:
        """Whether the rule was proven everywhere."""
        return len(self.violations) == 0 and len(self.unproven) == 0


class _Round(NamedTuple):
    """Result of one round over a set of cells.

    `bound`, `required`, `row`, `s`: lower bound, required clearance, obstacle row and arc length of each cell.
    `violations`: violating poses. `attained`: smallest clearance of a pose.
    """

    bound: FloatArray
    required: FloatArray
    row: IntArray
    s: FloatArray
    violations: FloatArray
    attained: float

    def settled(self, keep: BoolArray | IntArray) -> FloatArray:
        """Return bound, arc length, required clearance and obstacle row of the cells in `keep`, Shape (n, 4)."""
        table: FloatArray = np.column_stack((self.bound, self.s, self.required, self.row.astype(np.float64)))[keep]
        return table


def prove_clearance(  # noqa: PLR0913 - path, problem and options of the proof
    path: Path,
    problem: DockingProblem,
    is_late: Callable[[], bool] = never_late,
    start_relief: float = 0.0,
    *,
    obstacles: ObstacleSet | None = None,
    begun: Begun | None = None,
    sharp: bool = True,
) -> ClearanceProof:
    """Prove the clearance rule of `problem` for every point of `path`, or find the poses that violate it.

    Args:
        path: The path to check.
        problem: The problem.
        is_late: Polled after every round of cells. Once it is True, the minimum is not sharpened further, and open
            cells are given up.
        start_relief: Start relief of the clearance rule [m]; see `ClearanceRule.required_at`.
        obstacles: The obstacles; None for all obstacles of the problem.
        begun: Beginning of the drive if `path` is the rest of a longer path, whose clearance rule then applies; None
            for the start of the problem.
        sharp: Whether `proven` must be the smallest clearance up to `SHARPNESS`; otherwise any bound that satisfies the
            rule suffices.
    """
    footprint = problem.robot.footprint
    obstacles = problem.all_obstacles if obstacles is None else obstacles
    if len(obstacles) == 0:
        nothing = np.zeros((0, 7))
        return ClearanceProof(np.inf, 0.0, problem.path_clearance.required, -1, np.inf, nothing, nothing[:, :2], 0)
    attained = at_end = -np.inf
    if sharp or begun is None:
        ends = np.stack((problem.start.as_array(), path.end.as_array()))
        clearances, _ = pose_clearances(ends, footprint, obstacles)
        attained = at_end = float(clearances[1])
        if begun is None:
            begun, attained = Begun(problem.start, float(clearances[0])), float(clearances.min())
    attained = attained if sharp else -np.inf
    motion = PathMotion(path)
    kept = problem.path_clearance
    rule = functools.partial(kept.required_at, start_clearance=begun.clearance, start_relief=start_relief)
    world = _World(footprint, obstacles, problem.goal, begun.start, rule, kept.required)
    near = _Subdivision(motion, world, attained, _CROP, is_late)
    found = near.run() if len(near.near) else None
    if found is not None and (found.proven <= _CROP or len(near.near) == len(obstacles)):
        return found
    # Obstacles that were left out are at least `far` away and cannot violate the rule. The nearest one may be among
    # them, but it is no farther than the clearance at the end of the path.
    if sharp and not is_late():
        sharper = _Subdivision(motion, world, at_end, at_end, is_late).run()
        if sharper.holds or not (found is None or found.holds):
            return sharper
    far, nothing = _CROP + kept.required, np.zeros((0, 7))
    if found is None:
        return ClearanceProof(far, 0.0, kept.required, -1, _CROP, nothing, nothing[:, :2], 0)
    return found._replace(proven=min(found.proven, far), margin=min(found.margin, _CROP))


class Begun(NamedTuple):
    """Pose at which the drive began, and its clearance [m]."""

    start: Pose2
    clearance: float


class _World(NamedTuple):
    """Outline of the robot, obstacles, and clearance rule.

    `rule`: required clearance as a function of the distances from the goal and the start, Shape (n,) [m] each. `most`:
    largest required clearance.
    """

    footprint: Footprint
    obstacles: ObstacleSet
    goal: Pose2
    start: Pose2
    rule: Callable[[FloatArray, FloatArray], FloatArray]
    most: float


class _Subdivision:
    """Cells of one path, bisected round by round.

    Args:
        motion: The path as cells.
        world: Robot, obstacles and rule.
        attained: Smallest known clearance of a pose on the path [m].
        crop: Distance from the swept area beyond which obstacles are ignored [m].
        is_late: See `prove_clearance`.
    """

    def __init__(
        self,
        motion: PathMotion,
        world: _World,
        attained: float,
        crop: float,
        is_late: Callable[[], bool],
    ) -> None:
        self.motion, self.world, self.rule = motion, world, world.rule
        self.attained, self.is_late = attained, is_late
        self.step = max(_MAX_STEP, motion.path.length / _MOST_FIRST)
        self.poses = 0
        # At the goal the clearance is often just the required one: a last cell of full length needs a second round.
        self.cells = motion.cells(self.step).last_halved()
        self.ends = self._ends(self.cells)
        self.near, self.original = self._crop(self.ends[1], crop)

    def run(self) -> ClearanceProof:
        """Process rounds of cells until each cell is proven, violated or given up."""
        budget = _MAX_POSES + self.cells.first.size
        settled: list[FloatArray] = []
        violations: list[FloatArray] = []
        touched: list[Cells] = []
        given_up: list[FloatArray] = [np.zeros((0, 4))]
        waiting = deque((0, block) for block in self.cells.blocks(_BLOCK))
        while waiting:
            level, cells = waiting.popleft()
            ends, nodes = self.ends if cells is self.cells else self._ends(cells)
            if settled and level == 0 and self.is_late():
                given_up.append(_unknown(nodes.s[ends.first]))  # blocks of a long path that were not started
                continue
            result = self._round(cells, ends, nodes)
            self.attained = min(self.attained, result.attained)
            is_last = level >= _MAX_LEVELS or self.poses > budget or self.is_late()
            sharp = result.bound >= self.attained - SHARPNESS
            proven = (result.bound >= result.required - TOLERANCE) & (sharp | is_last)
            violations.append(result.violations)
            settled.append(result.settled(proven))
            if np.any(touching := proven & (result.bound < 0.0)):
                touched.append(cells.rows(np.flatnonzero(touching)))
            open_cells = np.flatnonzero(~(proven | self._touches_violation(ends, nodes, result)))
            if open_cells.size and is_last:
                given_up.append(result.settled(open_cells))
            elif open_cells.size:
                halvings = max(1, int(np.log2(_CHEAP / open_cells.size)))
                finer = cells.rows(open_cells).cut(2**halvings)
                waiting.extend((level + halvings, block) for block in finer.blocks(_BLOCK))
        if touched and not sum(map(len, violations)):
            deep = self._prove_contact(Cells(*map(np.concatenate, zip(*touched, strict=True))))
            for rows, more in zip((violations, given_up), deep, strict=True):
                rows.append(more)
        return self._summary(np.concatenate(settled), np.concatenate(violations), np.concatenate(given_up))

    def _prove_contact(self, cells: Cells) -> tuple[FloatArray, FloatArray]:
        """Return poses with deep overlaps, and unproven cells, in the form used by `run`."""
        robot = self.world.footprint
        at = self._ends(cells)[1].poses[:, :2]
        reach = robot.circumscribed_radius + self.step
        pairs = deep_pairs(robot, self.near, at.min(axis=0) - reach, at.max(axis=0) + reach)
        found = [self._apart(bounded(bodies), rocks, cells) for bodies, rocks in pairs]
        violations, given_up = zip(*found, strict=True) if found else ((), ())
        return np.concatenate((np.zeros((0, 7)), *violations)), np.concatenate((np.zeros((0, 4)), *given_up))

    def _apart(
        self, bodies: tuple[BoundedBody, ...], rocks: ObstacleSet, cells: Cells
    ) -> tuple[FloatArray, FloatArray]:
        """Prove that the interiors of bodies and obstacles do not intersect in any of the cells."""
        level, budget = 0, self.poses + _MAX_POSES
        while True:
            ends, nodes = self._ends(cells)
            self.poses += nodes.s.size
            bounds = self.motion.bounds(cells, nodes.poses[ends.first], nodes.poses[ends.last])
            n = cells.first.size
            found = advance_bounds(bodies, _from_both_ends(nodes, ends, bounds), rocks, np.zeros(2 * n), self.is_late)
            bound = np.minimum(found.bound[:n], found.bound[n:])
            bad = np.flatnonzero(found.distance < 0.0)
            if bad.size:
                k = bad[np.argmin(found.distance[bad])]
                return self._deep_violation(nodes, int(found.pose[k]), float(found.distance[k])), np.zeros((0, 4))
            open_cells = np.flatnonzero(~(bound >= 0.0))
            if open_cells.size == 0:
                return np.zeros((0, 7)), np.zeros((0, 4))
            if level >= _MAX_LEVELS or self.poses > budget or self.is_late():
                s = nodes.s[ends.first[open_cells]]
                return np.zeros((0, 7)), np.column_stack((bound[open_cells] - DEPTH, s, 0.0 * s, 0.0 * s))
            halvings = max(1, int(np.log2(_CHEAP / open_cells.size)))
            cells, level = cells.rows(open_cells).cut(2**halvings), level + halvings

    def _deep_violation(self, nodes: Nodes, at: int, distance: float) -> FloatArray:
        """Return the pose as in `ClearanceProof.violations`, with the nearest single obstacle piece."""
        pose = nodes.poses[at]
        _, row = pose_clearances(pose[None], self.world.footprint, self.near)
        return np.array([[nodes.s[at], distance - DEPTH, 0.0, row[0], *pose]])

    def _ends(self, cells: Cells) -> tuple[CellEnds, Nodes]:
        ends = cells.ends()
        return ends, self.motion.nodes(ends.segment, ends.u)

    def _crop(self, nodes: Nodes, crop: float) -> tuple[ObstacleSet, IntArray]:
        """Return the obstacles near the swept area, and their rows in the problem."""
        everything = self.world.obstacles
        at = nodes.poses[:, :2]  # the deviation of a cell from its chord is less than its length
        reach = self.world.footprint.circumscribed_radius + self.step + crop + self.world.most
        rows = everything.rows_in_box(at.min(axis=0) - reach, at.max(axis=0) + reach)
        if rows.size > _WORTHWHILE * len(everything):
            return everything, np.arange(len(everything))
        return everything.subset(rows), rows

    def _touches_violation(self, ends: CellEnds, nodes: Nodes, result: _Round) -> BoolArray:
        """Return a mask of the cells that contain a violating pose, so that refinement cannot prove them."""
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
        distances = self._distances(nodes.poses)
        required = self.rule(*(bounds.farthest(ends, distance) for distance in distances))
        exact_within = np.tile(np.maximum(required, self.attained), 2)
        advances = _from_both_ends(nodes, ends, bounds)
        bodies = bounded_footprint(self.world.footprint)
        found = advance_bounds(bodies, advances, self.near, exact_within, self.is_late)
        earlier = found.bound[:n] <= found.bound[n:]
        pick = np.where(earlier, np.arange(n), np.arange(n) + n)
        violations = self._violations(nodes, found, self.rule(*distances))
        attained = float(np.min(found.distance, initial=np.inf))
        place = nodes.s[advances.pose[pick]]
        return _Round(found.bound[pick], required, found.row[pick], place, violations, attained)

    def _violations(self, nodes: Nodes, found: AdvanceBounds, required: FloatArray) -> FloatArray:
        """Return the exactly evaluated poses that violate the rule, Shape (m, 7), see `ClearanceProof`."""
        bad = np.flatnonzero(found.distance < required[found.pose] - TOLERANCE)
        at = found.pose[bad]
        columns = (nodes.s[at], found.distance[bad], required[at], 1.0 * found.obstacle[bad])
        return np.column_stack((*columns, nodes.poses[at]))

    def _distances(self, poses: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the distances of poses, Shape (n, 3), from the goal and from the start, Shape (n,) [m] each."""
        goal, start = self.world.goal, self.world.start
        x, y = poses[:, 0], poses[:, 1]
        return np.hypot(x - goal.x, y - goal.y), np.hypot(x - start.x, y - start.y)

    def _summary(self, settled: FloatArray, violations: FloatArray, given_up: FloatArray) -> ClearanceProof:
        worst = violations[:, [1, 0, 2, 3]] if len(violations) else np.concatenate((settled, given_up))
        unproven = np.column_stack((given_up[:, 1], given_up[:, 0] - given_up[:, 2]))
        violations = violations.copy()
        violations[:, 3] = self.original[violations[:, 3].astype(np.int64)]
        proven, s, required, row = (float(value) for value in worst[np.argmin(worst[:, 0])])
        if len(violations) == 0:  # a cell has its largest requirement; replace it by that at the place
            required = float(self.rule(*self._distances(self.motion.path.poses_at(s)))[0])
        margin = float(np.min(worst[:, 0] - worst[:, 2]))
        return ClearanceProof(
            proven, s, required, int(self.original[int(row)]), margin, violations, unproven, self.poses
        )


def _unknown(s: FloatArray) -> FloatArray:
    """Return rows of cells for which no bound is known, in the form of `_Round.settled`."""
    return np.column_stack((np.full(s.size, -np.inf), s, 0.0 * s, 0.0 * s))


def _from_both_ends(nodes: Nodes, ends: CellEnds, bounds: CellMotion) -> Advances:
    """Return advances over the first halves of cells from the first poses, then over last halves from last poses."""
    velocity = np.concatenate((bounds.velocity_first, -bounds.velocity_last))
    columns = (0.5 * bounds.width, bounds.speed, bounds.turn, bounds.bend, bounds.twist)
    pose = np.concatenate((ends.first, ends.last))
    return Advances(nodes.poses, pose, velocity, *(np.tile(column, 2) for column in columns))


class Advances(NamedTuple):
    """Stretches of motion from known poses: n stretches from k poses, because neighbouring stretches share poses.

    `poses`: Shape (k, 3). `pose`: initial pose of each stretch, Shape (n,). `velocity`: d pose / du at this pose, in
    the direction of the stretch, Shape (n, 3). The others have Shape (n,): `width` in u, and bounds within the cell:
    `speed` of |p'|, `turn` of |yaw'|, `bend` of |p''|, `twist` of |yaw''| + yaw'^2.
    """

    poses: FloatArray
    pose: IntArray
    velocity: FloatArray
    width: FloatArray
    speed: FloatArray
    turn: FloatArray
    bend: FloatArray
    twist: FloatArray

    def rows(self, keep: slice) -> tuple[Advances, IntArray]:
        """Return the stretches selected by `keep`, and the rows of their poses."""
        used, pose = np.unique(self.pose[keep], return_inverse=True)
        return Advances(self.poses[used], pose, *(column[keep] for column in self[2:])), used


class AdvanceBounds(NamedTuple):
    """Lower bound [m] and nearest obstacle row of every stretch, Shape (n,), and the exactly evaluated pairs.

    `pose`, `obstacle`, `distance`: pose index, obstacle row, signed distance [m], Shape (m,) each.
    """

    bound: FloatArray
    row: IntArray
    pose: IntArray
    obstacle: IntArray
    distance: FloatArray

    def merged(self, other: AdvanceBounds) -> AdvanceBounds:
        """Return the smaller of the two bounds, and both lists of pairs."""
        mine = self.bound <= other.bound
        return AdvanceBounds(
            np.where(mine, self.bound, other.bound),
            np.where(mine, self.row, other.row),
            np.concatenate((self.pose, other.pose)),
            np.concatenate((self.obstacle, other.obstacle)),
            np.concatenate((self.distance, other.distance)),
        )


def advance_bounds(
    bodies: tuple[BoundedBody, ...],
    advances: Advances,
    obstacles: ObstacleSet,
    exact_within: FloatArray,
    is_late: Callable[[], bool] = never_late,
) -> AdvanceBounds:
    """Compute lower bounds of the clearance over stretches of motion by equation (C5).

    Args:
        bodies: At least one convex body; all bodies move together.
        advances: The stretches.
        obstacles: At least one.
        exact_within: Shape (n,) [m]: the narrow phase evaluates pairs that may come closer than this; the broad phase
            bounds the others.
        is_late: Polled between blocks of a few milliseconds. Once it is True, the remaining bounds are -inf.
    """
    n = advances.width.size
    corners = max(len(one.body.vertices) for one in bodies) + obstacles.vertices.shape[1]
    block = max(1, min(_MAX_PAIRS // len(obstacles), _MAX_CORNERS // corners))
    if n <= block:
        parts: list[AdvanceBounds] = []
        for body in bodies:
            if parts and is_late():
                return functools.reduce(AdvanceBounds.merged, [*parts, _nothing_known(n)])
            parts.append(_body_bounds(body, advances, obstacles, exact_within))
        return functools.reduce(AdvanceBounds.merged, parts)
    blocks: list[AdvanceBounds] = []
    for rows in (slice(start, start + block) for start in range(0, n, block)):
        if blocks and is_late():
            blocks.append(_nothing_known(n - rows.start))
            break
        some, used = advances.rows(rows)
        found = advance_bounds(bodies, some, obstacles, exact_within[rows], is_late)
        blocks.append(found._replace(pose=used[found.pose]))
    return AdvanceBounds(*(np.concatenate(columns) for columns in zip(*blocks, strict=True)))


def _nothing_known(count: int) -> AdvanceBounds:
    none = np.zeros(0, dtype=np.int64)
    return AdvanceBounds(np.full(count, -np.inf), np.zeros(count, dtype=np.int64), none, none, np.zeros(0))


_KERNEL = Kernel("optdock_advance_bounds", sizes=6, numbers=2)


def _body_bounds_native(
    bounded: BoundedBody, advances: Advances, obstacles: ObstacleSet, exact_within: FloatArray
) -> AdvanceBounds:
    """Return the result of `_body_bounds`, computed in C; its arrays are described there."""
    body, n, k, m = bounded.body, advances.width.size, len(advances.poses), len(obstacles)
    corners, q, circles = len(body.vertices), obstacles.vertices.shape[1], len(bounded.centres)
    yaw = advances.poses[:, 2]
    bound, row = np.empty(n), np.empty(n, dtype=np.int64)
    distance, found = np.empty(k * m), np.empty((2, k * m), dtype=np.int64)
    arrays = (
        (np.concatenate([part.ravel() for part in (*body, bounded.centres)]), 5 * corners + 2 * circles),
        (np.ascontiguousarray(advances.poses), 3 * k),
        (np.stack((np.cos(yaw), np.sin(yaw)), axis=-1), 2 * k),
        (advances.pose, n),
        (np.concatenate((advances.velocity.T, advances[3:])), 8 * n),
        (np.ascontiguousarray(exact_within), n),
        (obstacles.vertices, 2 * m * q),
        (obstacles.normals, 2 * m * q),
        (obstacles.offsets, m * q),
        (obstacles.lower, 2 * m),
        (obstacles.upper, 2 * m),
        (bound, n),
        (row, n),
        (distance, k * m),
        (found[0], k * m),
        (found[1], k * m),
        (np.empty(size := 4 * m + 2 * (corners + q + circles)), size),
        (np.empty(size := 2 * m + n + k + 1, dtype=np.int64), size),
    )
    pairs = _KERNEL((n, k, m, corners, q, circles), (bounded.radius, bounded.reach), arrays)
    if pairs < 0:
        raise IndexError("advances.pose: must be rows of advances.poses")
    return AdvanceBounds(bound, row, found[0, :pairs], found[1, :pairs], distance[:pairs])


@twin_of(_body_bounds_native)
def _body_bounds_chosen(
    bounded: BoundedBody, advances: Advances, obstacles: ObstacleSet, exact_within: FloatArray
) -> AdvanceBounds:
    return _body_bounds_numpy(bounded, advances, obstacles, exact_within)


def _body_bounds(
    bounded: BoundedBody, advances: Advances, obstacles: ObstacleSet, exact_within: FloatArray
) -> AdvanceBounds:
    # The kernel evaluates all edges; of pairs with many corners the twin skips most.
    has_many = skips_edges(len(bounded.body.vertices), obstacles.vertices.shape[1])
    return (_body_bounds_numpy if has_many else _body_bounds_chosen)(bounded, advances, obstacles, exact_within)


def _body_bounds_numpy(
    bounded: BoundedBody, advances: Advances, obstacles: ObstacleSet, exact_within: FloatArray
) -> AdvanceBounds:
    body, reach = bounded.body, bounded.reach
    poses, width, n = advances.poses, advances.width, advances.width.size
    travel = width * (advances.speed + reach * advances.turn)
    gaps = broad_phase(bounded, poses, obstacles)
    within = np.full(len(poses), -np.inf)
    np.maximum.at(within, advances.pose, exact_within + travel)
    at, o = np.nonzero(~(gaps >= within[:, None]))
    exact = separation(body, poses[at], obstacles.pieces(o))
    bounds = gaps[advances.pose] - travel[:, None]
    i, pair = _met(advances.pose, at, len(poses))
    drift = _directional(body, poses[at[pair]], advances.velocity[i], exact.axis[pair], width[i])
    stray = 0.5 * (advances.bend + reach * advances.twist)[i] * width[i] ** 2
    distance = exact.distance[pair]
    bounds[i, o[pair]] = np.minimum(distance, distance + drift - stray)
    bounds[np.isnan(bounds)] = -np.inf  # NaN is no proof and must not be lost in comparisons
    row = np.argmin(bounds, axis=1)
    return AdvanceBounds(bounds[np.arange(n), row], row, at, o, exact.distance)


def _met(pose: IntArray, at: IntArray, count: int) -> tuple[IntArray, IntArray]:
    """Combine each stretch with all pairs of its initial pose; return the indices of stretches and pairs, Shape (q,).

    Args:
        pose: Initial pose of each stretch.
        at: Pose of each pair, ascending.
        count: Number of poses.
    """
    begin = np.searchsorted(at, np.arange(count + 1))
    size = (begin[1:] - begin[:-1])[pose]
    stretch = np.repeat(np.arange(pose.size), size)
    first = begin[pose] - (np.cumsum(size) - size)
    return stretch, np.arange(stretch.size) + first[stretch]


def _directional(
    body: ConvexBody, poses: FloatArray, velocity: FloatArray, axis: FloatArray, width: FloatArray
) -> FloatArray:
    """Return the first-order part of (C5): min_v (n.v + n.v' du) - min_v n.v at du = width. Shape (m,) [m]."""
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    across, along = axis[:, 0] * c + axis[:, 1] * s, axis[:, 1] * c - axis[:, 0] * s  # the axis in the body's frame
    x, y = body.vertices[:, :1], body.vertices[:, 1:]
    height = across * x + along * y  # (v, m)
    rate = axis[:, 0] * velocity[:, 0] + axis[:, 1] * velocity[:, 1] + velocity[:, 2] * (along * x - across * y)
    change: FloatArray = (height + width * rate).min(axis=0) - height.min(axis=0)
    return change
