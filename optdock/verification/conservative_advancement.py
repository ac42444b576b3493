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

from collections import deque
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.deadline import never_late
from optdock.geometry.arrays import readonly
from optdock.geometry.clothoid import QUADRATURE
from optdock.geometry.separation import skips_edges
from optdock.kernels import Kernel, kernels_lane, twin_of
from optdock.verification.certificate import SHARPNESS, TOLERANCE
from optdock.verification.clearance_kernel import compiled_clearances, end_clearances, packed_footprint
from optdock.verification.clearance_rounds import Near, Rule, World, clearance_round, from_both_ends
from optdock.verification.contact_tolerance import DEPTH, deep_pairs
from optdock.verification.motion_bounds import Cells, PathMotion, divided, first_cells
from optdock.verification.proximity import bounded, pose_clearances
from optdock.verification.stretch_bounds import advance_bounds

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from optdock.geometry.arrays import FloatArray, IntArray
    from optdock.geometry.obstacles import ObstacleSet
    from optdock.geometry.pose import Pose2
    from optdock.model.clearance_rule import ClearanceRule
    from optdock.model.path import Path
    from optdock.model.problem import DockingProblem
    from optdock.verification.clearance_rounds import Round
    from optdock.verification.motion_bounds import CellEnds, Nodes
    from optdock.verification.proximity import BoundedBody

__all__ = ["Begun", "ClearanceProof", "prove_clearance"]

_BLOCK = 4000  # cells evaluated at once, some milliseconds; the deadline is polled in between
_MAX_STEP = 0.08  # [m], length of first cells
_MOST_FIRST = 100_000  # first cells; they are longer on paths beyond 8 km
_MAX_LEVELS = 24  # of bisection
_NO_VIOLATION, _NOTHING_OPEN = readonly(np.zeros((0, 7))), readonly(np.zeros((0, 2)))
_CHEAP = 48  # cells: smaller rounds take almost the same time, so a few open cells are divided into more parts
_MAX_POSES = 60_000  # added by refinement
_WORTHWHILE = 0.7  # fraction of near obstacles above which cropping takes longer than it saves
_MOST_QUICK = 2000  # cells of a round of a proof that does not poll the deadline
_MOST_PAIRS = 50_000  # of poses, obstacles and bodies in a round of such a proof, less than a millisecond
_CROP = 1.0  # [m]: obstacles farther from the swept area are evaluated only if no other is as near


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
    obstacles = problem.all_obstacles if obstacles is None else obstacles
    if len(obstacles) == 0:
        required = problem.path_clearance.required
        return ClearanceProof(np.inf, 0.0, required, -1, np.inf, _NO_VIOLATION, _NOTHING_OPEN, 0)
    known = np.inf
    if begun is None:
        known = _start_clearance(problem, obstacles)
        begun = Begun(problem.start, known)
    motion, rule = PathMotion(path), Rule(problem.path_clearance, begun.clearance, start_relief)
    world = World(problem.robot.footprint, obstacles, problem.goal, begun.start, rule)
    if kernels_lane() != "twin" and not is_late():
        quick = _quick(motion, world, known, sharp=sharp)
        if quick is not None:
            return quick
    return _by_rounds(motion, world, known, is_late, sharp=sharp)


def _by_rounds(
    motion: PathMotion, world: World, known: float, is_late: Callable[[], bool], *, sharp: bool
) -> ClearanceProof:
    """Return the proof of any path; arguments as for `_quick` and `prove_clearance`."""
    end, obstacles, kept = motion.path.end.as_array()[None], world.obstacles, world.rule.kept
    at_end = float(compiled_clearances(end, world.footprint, obstacles)[0][0]) if sharp else -np.inf
    near = _Subdivision(motion, world, min(known, at_end), _CROP, is_late)
    found = near.run() if len(near.near) else None
    if found is not None and (found.proven <= _CROP or len(near.near) == len(obstacles)):
        return found
    # Obstacles that were left out are more than `_CROP` too far to violate the rule. The nearest one may be among
    # them, but it is no farther than the clearance at the end of the path.
    if sharp and not is_late():
        sharper = _Subdivision(motion, world, at_end, at_end, is_late).run()
        if sharper.holds or not (found is None or found.holds):
            return sharper
    if found is None:
        return ClearanceProof(_CROP + kept.required, 0.0, kept.required, -1, _CROP, _NO_VIOLATION, _NOTHING_OPEN, 0)
    return _of_all(found, kept)


def _start_clearance(problem: DockingProblem, obstacles: ObstacleSet) -> float:
    if obstacles is problem.all_obstacles:
        return end_clearances(problem).start
    clearances, _ = compiled_clearances(problem.start.as_array()[None], problem.robot.footprint, obstacles)
    return float(clearances[0])


def _of_all(found: ClearanceProof, rule: ClearanceRule) -> ClearanceProof:
    """Return a proof among the near obstacles as one among all."""
    return found._replace(proven=min(found.proven, _CROP + rule.required), margin=min(found.margin, _CROP))


class Begun(NamedTuple):
    """Pose at which the drive began, and its clearance [m]."""

    start: Pose2
    clearance: float


def _halvings(open_cells: int) -> int:
    """Return how often open cells are bisected before the next round."""
    return max(1, int(np.log2(_CHEAP / open_cells)))


def _reach(world: World, step: float, crop: float) -> float:
    """Return the distance [m] from the poses beyond which obstacles are ignored."""
    return world.footprint.circumscribed_radius + step + crop + world.rule.kept.required


def _quick(motion: PathMotion, world: World, known: float, *, sharp: bool) -> ClearanceProof | None:
    """Return the proof of a path that is proven within a millisecond or so, and None for others.

    Args:
        motion: The path.
        world: Robot, obstacles and rule.
        known: Clearance of a pose of the path [m], or inf.
        sharp: See `prove_clearance`.
    """
    pieces, corners = motion.pieces, world.obstacles.vertices.shape[1]
    if pieces is None or skips_edges(packed_footprint(world.footprint).corners, corners):
        return None
    room = 2 * (int(motion.path.length / _MAX_STEP) + 2 * len(pieces.table)) + 64  # more than twice the first cells
    first = _quick_chosen(motion, world, room, known, _CROP, sharp=sharp) if room <= _MOST_QUICK else None
    if first is None:
        return None
    found, evaluated, at_end = first
    if found.proven <= _CROP or evaluated == len(world.obstacles):
        return found
    if not sharp:
        return _of_all(found, world.rule.kept)
    sharper = _quick_chosen(motion, world, room, np.inf, at_end, sharp=sharp)
    return None if sharper is None else sharper[0]


_KERNEL = Kernel("optdock_clearance_proof", sizes=13, numbers=6)


def _quick_native(
    motion: PathMotion, world: World, room: int, known: float, crop: float, *, sharp: bool
) -> tuple[ClearanceProof, int, float] | None:
    """Return the result of `_quick_chosen`, computed in C; its arrays are described there."""
    pieces, rocks, robot = motion.pieces, world.obstacles, packed_footprint(world.footprint)
    assert pieces is not None
    (m, q, _), bodies, segments, breaks = rocks.vertices.shape, len(robot.sizes), len(pieces.kinds), len(pieces.table)
    pairs = min(_MOST_PAIRS, 2 * room * m * bodies)
    rule = np.array((*world.rule.numbers, world.goal.x, world.goal.y, world.start.x, world.start.y))
    found = np.empty(8)
    arrays = (
        (pieces.kinds, 2 * segments),
        (pieces.table, 6 * breaks),
        (motion.path.segment_starts, segments + 1),
        (QUADRATURE, QUADRATURE.size),
        (rule, 12),
        (robot.sizes, 2 * bodies),
        (robot.numbers, robot.numbers.size),
        (rocks.vertices, 2 * m * q),
        (rocks.normals, 2 * m * q),
        (rocks.offsets, m * q),
        (rocks.lower, 2 * m),
        (rocks.upper, 2 * m),
        (found, 8),
        (np.empty(size := 53 * room + pairs + m + 2 * (robot.corners + q + robot.circles) + 1), size),
        (np.empty(size := 26 * room + 2 * pairs + 2 * m + 3, dtype=np.int64), size),
    )
    sizes = segments, breaks, m, bodies, q, robot.corners, robot.circles, room, pairs, _CHEAP, _MAX_LEVELS, _MAX_POSES
    numbers = _MAX_STEP, known, TOLERANCE, SHARPNESS, _reach(world, _MAX_STEP, crop), _WORTHWHILE
    outcome = _KERNEL((*sizes, int(sharp)), numbers, arrays)
    if outcome < 0:
        raise IndexError("path: must be segments with their breaks")
    if outcome == 0:
        return None
    proven, s, needed, row, margin, poses, evaluated, at_end = found.tolist()
    proof = ClearanceProof(proven, s, needed, int(row), margin, _NO_VIOLATION, _NOTHING_OPEN, int(poses))
    return proof, int(evaluated), at_end


@twin_of(_quick_native)
def _quick_chosen(
    motion: PathMotion, world: World, room: int, known: float, crop: float, *, sharp: bool
) -> tuple[ClearanceProof, int, float] | None:
    """Return the proof among near obstacles, their number, and the clearance at the end if `sharp`, otherwise inf.

    `room`: largest number of cells of a round. `known`: clearance of a pose of the path [m], or inf. `crop`: see
    `_Subdivision`.

    Return None if a pose violates the rule, a cell or the end is in contact, no obstacle is near, or the kernel has too
    little memory for the rounds.
    """
    run = _Subdivision(motion, world, -np.inf, crop, never_late)
    at_end = np.inf
    if sharp:
        last = run.ends[1].poses[-1:]
        at_end = float(compiled_clearances(last, world.footprint, world.obstacles)[0][0])
        run.attained = min(known, at_end)
    found = run.quick(room) if at_end >= 0.0 and len(run.near) else None
    return None if found is None else (found, len(run.near), at_end)


class _Least:
    """The cell of the smallest bound so far, in the form of `Round.rows`, and the smallest margin [m]."""

    def __init__(self) -> None:
        self.row: tuple[float, ...] = (np.inf, 0.0, 0.0, -1.0, 0.0)
        self.margin = np.inf

    def add_all(self, found: Round) -> None:
        """Add all cells of a round."""
        i = int(found.bound.argmin())
        row = [one.item(i) for one in (found.bound, found.s, found.required, found.row)]
        self._add(*row, found.needed.item(found.place.item(i)), margin=(found.bound - found.required).min().item())

    def add(self, table: FloatArray) -> None:
        """Add cells, Shape (n, 5)."""
        if len(table):
            row = table[table[:, 0].argmin()].tolist()
            self._add(*row, margin=float((table[:, 0] - table[:, 2]).min()))

    def _add(self, *row: float, margin: float) -> None:
        if row[0] < self.row[0] or self.row[3] < 0.0:
            self.row = row
        self.margin = float(np.minimum(self.margin, margin))  # NaN remains


class _Tally:
    """What the rounds so far have found.

    `least`: the settled cells. `violations`: violating poses. `touched`: cells that are cleared only within the
    tolerance. `given_up`: cells that are neither proven nor violated, in the form of `Round.rows`.
    """

    def __init__(self) -> None:
        self.rounds, self.least = 0, _Least()
        self.violations: list[FloatArray] = []
        self.touched: list[Cells] = []
        self.given_up: list[FloatArray] = []

    def add(self, found: Round, cells: Cells, nodes: Nodes, *, is_last: bool) -> IntArray:
        """Add a round, and return the cells that are still open; in the last round they are given up."""
        self.rounds += 1
        fates = found.without_sharpness() if is_last else found.fates
        if found.distance.size:
            self.violations.append(found.violations(nodes))
        if not fates.any() and found.bound.min() >= 0.0:
            self.least.add_all(found)
            return fates[:0]
        self.least.add(found.rows(np.flatnonzero(fates == 0)))
        if np.any(touching := (found.bound < 0.0) & (fates == 0)):
            self.touched.append(cells.rows(np.flatnonzero(touching)))
        open_cells = np.flatnonzero(fates == 2)
        if is_last and open_cells.size:
            self.given_up.append(found.rows(open_cells))
        return open_cells[:0] if is_last else open_cells


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
        world: World,
        attained: float,
        crop: float,
        is_late: Callable[[], bool],
    ) -> None:
        self.motion, self.world = motion, world
        self.attained, self.is_late = attained, is_late
        self.step = max(_MAX_STEP, motion.path.length / _MOST_FIRST)
        self.poses = 0
        self.cells, ends = first_cells(motion, self.step)
        self.ends = ends, motion.nodes(ends.segment, ends.u)
        self.near = self._crop(self.ends[1], crop)

    def run(self) -> ClearanceProof:
        """Process rounds of cells until each cell is proven, violated or given up."""
        budget, tally = _MAX_POSES + self.cells.first.size, _Tally()
        waiting = deque((0, block) for block in self._first_blocks())
        while waiting:
            level, (cells, ends, nodes) = waiting.popleft()
            if tally.rounds and level == 0 and self.is_late():
                tally.given_up.append(self._unknown(nodes, ends.first))  # blocks of a long path that were not started
                continue
            block, self.poses = (cells, ends, nodes), self.poses + nodes.s.size
            found = clearance_round(self.motion, self.world, self.near, block, self.attained, self.is_late)
            self.attained = min(self.attained, found.attained)
            is_last = level >= _MAX_LEVELS or self.poses > budget or self.is_late()
            open_cells = tally.add(found, cells, nodes, is_last=is_last)
            if open_cells.size:
                halvings = _halvings(open_cells.size)
                finer = divided(cells, open_cells, 2**halvings)
                waiting.extend((level + halvings, block) for block in self._blocks(*finer))
        if tally.touched and not tally.violations:
            deep = self._prove_contact(Cells(*map(np.concatenate, zip(*tally.touched, strict=True))))
            for rows, more in zip((tally.violations, tally.given_up), deep, strict=True):
                rows.append(more)
        return self._summary(tally)

    def quick(self, room: int) -> ClearanceProof | None:
        """Return the result of `run`, or None as `_quick_chosen`; `room`: largest number of cells of a round."""
        tally, level, cells, (ends, nodes) = _Tally(), 0, self.cells, self.ends
        pairs, budget = len(self.near) * len(self.world.footprint.bodies), _MAX_POSES + cells.first.size
        while nodes.s.size * pairs <= _MOST_PAIRS:
            self.poses += nodes.s.size
            block = (cells, ends, nodes)
            found = clearance_round(self.motion, self.world, self.near, block, self.attained, never_late)
            self.attained = min(self.attained, found.attained)
            open_cells = tally.add(found, cells, nodes, is_last=False)
            if tally.violations or tally.touched:
                break
            if open_cells.size == 0:
                return self._summary(tally)
            halvings = _halvings(open_cells.size)
            if level >= _MAX_LEVELS or self.poses > budget or open_cells.size << halvings > room:
                break
            cells, ends = divided(cells, open_cells, 2**halvings)
            nodes, level = self.motion.nodes(ends.segment, ends.u), level + halvings
        return None

    def _first_blocks(self) -> Iterator[tuple[Cells, CellEnds, Nodes]]:
        if self.cells.first.size <= _BLOCK:
            yield self.cells, *self.ends
        else:
            yield from self._blocks(self.cells, self.ends[0])

    def _blocks(self, cells: Cells, ends: CellEnds) -> Iterator[tuple[Cells, CellEnds, Nodes]]:
        """Yield the cells with their ends, in groups of at most `_BLOCK`."""
        for block in cells.blocks(_BLOCK):
            some = ends if block is cells else block.ends()
            yield block, some, self.motion.nodes(some.segment, some.u)

    def _prove_contact(self, cells: Cells) -> tuple[FloatArray, FloatArray]:
        """Return poses with deep overlaps, and unproven cells, in the form used by `run`."""
        robot = self.world.footprint
        at = self._ends(cells)[1].poses[:, :2]
        reach = robot.circumscribed_radius + self.step
        pairs = deep_pairs(robot, self.near.obstacles, at.min(axis=0) - reach, at.max(axis=0) + reach)
        found = [self._apart(bounded(bodies), rocks, cells) for bodies, rocks in pairs]
        violations, given_up = zip(*found, strict=True) if found else ((), ())
        return np.concatenate((np.zeros((0, 7)), *violations)), np.concatenate((np.zeros((0, 5)), *given_up))

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
            found = advance_bounds(bodies, from_both_ends(nodes, ends, bounds), rocks, np.zeros(2 * n), self.is_late)
            bound = np.minimum(found.bound[:n], found.bound[n:])
            bad = np.flatnonzero(found.distance < 0.0)
            if bad.size:
                k = bad[np.argmin(found.distance[bad])]
                return self._deep_violation(nodes, int(found.pose[k]), float(found.distance[k])), np.zeros((0, 5))
            open_cells = np.flatnonzero(~(bound >= 0.0))
            if open_cells.size == 0:
                return np.zeros((0, 7)), np.zeros((0, 5))
            if level >= _MAX_LEVELS or self.poses > budget or self.is_late():
                given_up = self._unknown(nodes, ends.first[open_cells])
                given_up[:, 0] = bound[open_cells] - DEPTH
                return np.zeros((0, 7)), given_up
            halvings = _halvings(open_cells.size)
            cells, level = cells.rows(open_cells).cut(2**halvings), level + halvings

    def _deep_violation(self, nodes: Nodes, at: int, distance: float) -> FloatArray:
        """Return the pose as in `ClearanceProof.violations`, with the nearest single obstacle piece."""
        pose = nodes.poses[at]
        _, row = pose_clearances(pose[None], self.world.footprint, self.near.obstacles)
        return np.array([[nodes.s[at], distance - DEPTH, 0.0, row[0], *pose]])

    def _ends(self, cells: Cells) -> tuple[CellEnds, Nodes]:
        ends = cells.ends()
        return ends, self.motion.nodes(ends.segment, ends.u)

    def _crop(self, nodes: Nodes, crop: float) -> Near:
        """Return the obstacles near the swept area."""
        everything = self.world.obstacles
        at = nodes.poses[:, :2]  # the deviation of a cell from its chord is less than its length
        reach = _reach(self.world, self.step, crop)
        rows = everything.rows_in_box(at.min(axis=0) - reach, at.max(axis=0) + reach)
        return Near(everything, np.arange(len(everything)) if rows.size > _WORTHWHILE * len(everything) else rows)

    def _unknown(self, nodes: Nodes, at: IntArray) -> FloatArray:
        """Return rows of cells for which no bound is known, in the form of `Round.rows`; `at`: their first ends."""
        needed = self.world.rule(*self.world.distances(nodes.poses[at]))
        return np.column_stack((np.full(at.size, -np.inf), nodes.s[at], np.zeros((at.size, 2)), needed))

    def _summary(self, tally: _Tally) -> ClearanceProof:
        violations, unproven = np.concatenate((np.zeros((0, 7)), *tally.violations)), np.zeros((0, 2))
        least = tally.least
        if tally.given_up:
            left = np.concatenate(tally.given_up)
            unproven = np.column_stack((left[:, 1], left[:, 0] - left[:, 2]))
            least.add(left)
        if len(violations):
            least = _Least()
            least.add(violations[:, [1, 0, 2, 3, 2]])
            violations[:, 3] = self.near.rows[violations[:, 3].astype(np.int64)]
        proven, s, _, row, needed = least.row  # a cell has its largest requirement; `needed` is that at the place
        near = int(self.near.rows[int(row)])
        return ClearanceProof(proven, s, needed, near, least.margin, violations, unproven, self.poses)
