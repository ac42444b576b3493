"""Sequences of circular arcs and straight lines, and trees of arcs with the start or the goal as root.

An arc has a signed length, negative in reverse, and a curvature d yaw / d length that is positive to the left in either
gear. Sequences are padded with arcs of length zero to a common number of columns.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.kernels import Kernel, twin_of
from optdock.model.path import Path
from optdock.model.segments import Direction, PolylineSegment
from optdock.planners.manoeuvres.price import driving_prices, stopping_cost

if TYPE_CHECKING:
    from collections.abc import Callable

    from optdock.geometry.arrays import BoolArray, FloatArray, IntArray
    from optdock.model.robot import Robot
    from optdock.planners.manoeuvres.free_space import Effort, FreeSpace

__all__ = ["ArcTree", "Arcs", "advance", "are_free", "first_free", "joined", "may_be_free", "moves_of"]

_NOTHING = 1e-9  # [m]: shorter arcs do not count as motion
_BISECTIONS = 4
_FEWEST_POSES = 8  # of a path per arc: the smoother fits curvatures to the directions of the chords
_ROUGH_BATCH = 256  # sequences per rough check
_STRIDE, _ABREAST = 8, 64  # poses per arc, and arcs, per collision check; blocked arcs are dropped after it


def advance(poses: FloatArray, length: FloatArray, curvature: FloatArray) -> FloatArray:
    """Return the poses at the ends of arcs that begin at `poses`, Shape (..., 3); the arguments are broadcast."""
    turn = length * curvature
    chord, middle = _chord(length, turn), poses[..., 2] + 0.5 * turn
    ends = np.empty((*middle.shape, 3))
    ends[..., 0] = poses[..., 0] + chord * np.cos(middle)
    ends[..., 1] = poses[..., 1] + chord * np.sin(middle)
    ends[..., 2] = poses[..., 2] + turn
    return ends


def _chord(length: FloatArray, turn: FloatArray) -> FloatArray:
    """Return the signed distances between the ends of arcs with signed lengths [m] and turns [rad]."""
    share = turn / (2.0 * np.pi)
    half = np.pi * np.where(share == 0.0, 1e-20, share)
    chord: FloatArray = length * (np.sin(half) / half)
    return chord


class Arcs(NamedTuple):
    """Sequences of arcs: `start` Shape (n, 3), `lengths` and `curvatures` Shape (n, k) [m, 1/m]."""

    start: FloatArray
    lengths: FloatArray
    curvatures: FloatArray

    def rows(self, keep: IntArray | slice) -> Arcs:
        """Return the sequences selected by `keep`."""
        return Arcs(self.start[keep], self.lengths[keep], self.curvatures[keep])

    def joints(self) -> FloatArray:
        """Return the poses at the beginning of every arc and at the end of the last. Shape (n, k + 1, 3)."""
        turns = self.lengths * self.curvatures
        poses = np.empty((len(turns), turns.shape[1] + 1, 3))
        poses[:, 0], places, yaws = self.start, poses[..., :2], poses[..., 2]
        yaws[:, 1:] = turns
        yaws.cumsum(axis=1, out=yaws)
        chord, middle = _chord(self.lengths, turns), yaws[:, :-1] + 0.5 * turns
        places[:, 1:, 0] = chord * np.cos(middle)
        places[:, 1:, 1] = chord * np.sin(middle)
        places.cumsum(axis=1, out=places)
        return poses

    def poses_at_shares(self, shares: FloatArray) -> FloatArray:
        """Return poses at shares of the total length of each sequence, Shape (q,) in [0, 1]. Shape (n, q, 3)."""
        ends = np.abs(self.lengths).cumsum(axis=1)
        s = ends[:, -1:] * shares
        owner = (s[:, :, None] > ends[:, None, :-1]).sum(axis=2)
        row = np.arange(len(self.lengths))[:, None]
        before = ends[row, owner] - np.abs(self.lengths[row, owner])
        driven = np.copysign(s - before, self.lengths[row, owner])
        return advance(self.joints()[row, owner], driven, self.curvatures[row, owner])

    def poses_every(self, spacing: float) -> FloatArray:
        """Return poses of a single sequence at most `spacing` [m] apart, including all joints. Shape (q, 3)."""
        assert len(self.lengths) == 1
        joints = self.joints()[0]
        return np.concatenate((self._before_ends(joints, spacing)[0], joints[-1:]))

    def _before_ends(self, joints: FloatArray, spacing: float, fewest: int = 1) -> tuple[FloatArray, IntArray]:
        """Return the poses of a single sequence without the ends of its arcs, (q, 3), and their numbers per arc."""
        lengths, curvatures = self.lengths[0], self.curvatures[0]
        size = np.abs(lengths)
        counts = np.where(size > _NOTHING, np.maximum(np.ceil(size / spacing - 1e-9), fewest), 0.0).astype(np.int64)
        owner = np.arange(counts.size).repeat(counts)
        rank = np.arange(owner.size) - (counts.cumsum() - counts)[owner]
        return advance(joints[owner], lengths[owner] * rank / counts[owner], curvatures[owner]), counts

    def path(self, spacing: float, end: FloatArray, frame: str) -> Path:
        """Return a single sequence as polylines with poses at most `spacing` [m] apart, ending exactly at `end`."""
        assert len(self.lengths) == 1
        poses, counts = _poses_by_gear(self, spacing)
        turns = round((poses[-1, 2] - end[2]) / (2.0 * np.pi))
        poses[-1] = end
        poses[-1, 2] += 2.0 * np.pi * turns
        segments, first = [], 0
        for count in counts.tolist():
            gear = Direction.FORWARD if count > 0 else Direction.REVERSE
            segments.append(PolylineSegment(poses[first : first + abs(count)], gear))
            first += abs(count)
        return Path(tuple(segments), frame)


_GEARS_KERNEL = Kernel("optdock_poses_by_gear", sizes=2, numbers=1)


def _poses_by_gear_native(arcs: Arcs, spacing: float) -> tuple[FloatArray, IntArray]:
    k = arcs.lengths.size
    most = int(np.abs(arcs.lengths).sum() / spacing) + (_FEWEST_POSES + 2) * k + 1
    poses, counts, found = np.empty((most, 3)), np.empty(k, dtype=np.int64), np.empty(2, dtype=np.int64)
    columns = [(np.ascontiguousarray(column), column.size) for column in arcs]
    _GEARS_KERNEL((k, _FEWEST_POSES), (spacing,), (*columns, (poses, 3 * most), (counts, k), (found, 2)))
    rows, gears = found.tolist()
    return poses[:rows], counts[:gears]


@twin_of(_poses_by_gear_native)
def _poses_by_gear(arcs: Arcs, spacing: float) -> tuple[FloatArray, IntArray]:
    """Return the poses of a single sequence gear by gear, (q, 3), and their numbers, (g,), negative in reverse."""
    joints = arcs.joints()[0]
    poses, counts = arcs._before_ends(joints, spacing, _FEWEST_POSES)
    moving = counts.nonzero()[0]
    ahead = arcs.lengths[0, moving] > 0.0
    last = np.append((ahead[1:] != ahead[:-1]).nonzero()[0], moving.size - 1)  # the last arc of each gear
    cuts = counts.cumsum()[moving[last]]
    signs = np.where(ahead[last], 1, -1)
    return np.insert(poses, cuts, joints[moving[last] + 1], axis=0), signs * (np.diff(cuts, prepend=0) + 1)


def moves_of(signs: tuple[float, ...], curvatures: tuple[float, ...]) -> FloatArray:
    """Return every combination of a sign of the length and a curvature [1/m]. Shape (c, 2)."""
    return np.array([(sign, curvature) for sign in signs for curvature in curvatures])


class ArcTree:
    """Nodes that can be reached from a root pose, Shape (3,), by collision-free arcs.

    `gear` is the gear in which arcs of positive length are driven: 1 for the tree of the start, -1 for the tree of the
    goal, which is built backwards in time.

    Attributes:
        gear: 1 or -1.
        robot: The robot.
        stop: Price of a change of gear [s].
        nodes: Pose, price, sign, length and curvature of each node, Shape (n, 7), with the following columns.
        poses: Shape (n, 3).
        prices: Price of the path between the root and the node, Shape (n,) [s].
        signs: Sign of the length of the last arc, 0 at the root. Shape (n,).
        lengths, curvatures: Of the last arc, Shape (n,) [m, 1/m].
        parents: Row of the node from which the last arc begins, -1 at the root. Shape (n,).
    """

    def __init__(self, root: FloatArray, robot: Robot, gear: int) -> None:
        self.gear, self.robot, self.stop = gear, robot, stopping_cost(robot.limits)
        nodes = np.zeros((1, 7))
        nodes[0, :3] = root
        self._set(np.array([-1]), nodes)

    def _set(self, parents: IntArray, nodes: FloatArray) -> None:
        self.parents, self.nodes, self.poses = parents, nodes, nodes[:, :3]
        self.prices, self.signs, self.lengths, self.curvatures = nodes[:, 3:].T

    def __len__(self) -> int:
        return self.parents.size

    def grow(
        self,
        rows: IntArray,
        moves: FloatArray,
        stations: FloatArray,
        space: FreeSpace,
        effort: Effort,
        is_new: Callable[[FloatArray], BoolArray] | None = None,
    ) -> IntArray:
        """Extend the nodes at `rows` by all moves, up to their first collision, and return the rows of the new nodes.

        `moves`: see `moves_of`. Nodes are added at `stations`, ascending lengths [m], and at the last free pose.
        `is_new` filters the poses found, in ascending order of price; None keeps all poses.
        """
        return self._append(*_extensions(self, rows, moves, stations, space, effort), is_new)

    def add(self, parents: IntArray, lengths: FloatArray, curvatures: FloatArray) -> IntArray:
        """Add nodes at the ends of free arcs, Shape (n,) each, and return their rows, in ascending order of price."""
        return self._append(parents, self.ends_of(parents, lengths, curvatures))

    def ends_of(self, parents: IntArray, lengths: FloatArray, curvatures: FloatArray) -> FloatArray:
        """Return the nodes at the ends of arcs of signed lengths, Shape (n,) each. Shape (n, 7)."""
        signs = np.sign(lengths)
        prices = self.prices[parents] + driving_prices(self.gear * lengths, self.robot)
        prices += self.stop * (self.signs[parents] * signs < 0.0)
        return np.column_stack((advance(self.poses[parents], lengths, curvatures), prices, signs, lengths, curvatures))

    def _append(
        self, parents: IntArray, ends: FloatArray, is_new: Callable[[FloatArray], BoolArray] | None = None
    ) -> IntArray:
        order, first = ends[:, 3].argsort(kind="stable"), self.parents.size
        if is_new is not None:
            order = order[is_new(ends[order, :3])]
        self._set(np.concatenate((self.parents, parents[order])), np.concatenate((self.nodes, ends[order])))
        return np.arange(first, first + order.size)

    def way(self, row: int) -> tuple[FloatArray, FloatArray]:
        """Return lengths and curvatures of the arcs between root and node, in driving order. Shape (k,) each."""
        lengths, curvatures = [], []
        while row > 0:
            lengths.append(self.lengths[row])
            curvatures.append(self.curvatures[row])
            row = int(self.parents[row])
        found = np.array(lengths, dtype=np.float64), np.array(curvatures, dtype=np.float64)
        # The goal's tree is driven from node to root, with the signs of the lengths reversed.
        return (-found[0], found[1]) if self.gear < 0 else (found[0][::-1], found[1][::-1])


_EXTENSIONS_KERNEL = Kernel("optdock_extensions", sizes=5, numbers=9)


def _extensions_native(
    tree: ArcTree, rows: IntArray, moves: FloatArray, stations: FloatArray, space: FreeSpace, effort: Effort
) -> tuple[IntArray, FloatArray]:
    robot, limits, spacing, n = tree.robot, tree.robot.limits, space.spacing(effort), rows.size * len(moves)
    most = n * (stations.size + 1)
    found, parents, ends = np.array([0]), np.empty(most, dtype=np.int64), np.empty((most, 7))
    given = (np.ascontiguousarray(rows), rows.size), (tree.nodes, tree.nodes.size), (moves, 2 * len(moves))
    outputs = (found, 1), (parents, most), (ends, 7 * most)
    numbers = spacing, tree.gear, limits.max_speed, limits.max_reverse_speed, robot.reverse_price, tree.stop
    sizes = n, len(moves), stations.size, _BISECTIONS
    arrays = *given, (stations, stations.size), *outputs
    space.check(_EXTENSIONS_KERNEL, sizes, numbers, arrays, (effort.margin, effort.start_relief))
    count = int(found[0])
    return parents[:count], ends[:count]


@twin_of(_extensions_native)
def _extensions(
    tree: ArcTree, rows: IntArray, moves: FloatArray, stations: FloatArray, space: FreeSpace, effort: Effort
) -> tuple[IntArray, FloatArray]:
    """Return the parents, Shape (m,), and the nodes, Shape (m, 7), that `ArcTree.grow` finds."""
    node, (sign, curvature) = rows.repeat(len(moves)), np.tile(moves, (rows.size, 1)).T
    free = _free_lengths((tree.poses[node], sign, curvature), float(stations[-1]), space, effort)
    reached = np.where(stations <= free[:, None] + 1e-12, stations, 0.0)
    # The end of the free length between two stations is also a station.
    last = np.where(reached.max(axis=1) < free - 0.1 * space.spacing(effort), free, 0.0)
    lengths = np.column_stack((reached, last))
    arc, station = np.nonzero(lengths > 0.0)
    return node[arc], tree.ends_of(node[arc], sign[arc] * lengths[arc, station], curvature[arc])


def _steps(longest: float, spacing: float) -> FloatArray:
    """Return ascending lengths at most `spacing` [m] apart, the last of which is `longest` [m]."""
    return np.append(np.arange(spacing, longest - 1e-9, spacing), longest)


def _free_lengths(
    starts: tuple[FloatArray, FloatArray, FloatArray], longest: float, space: FreeSpace, effort: Effort
) -> FloatArray:
    """Return the collision-free lengths of arcs (start poses, signs, curvatures), up to `longest`. Shape (n,) [m]."""
    poses, signs, curvatures = starts

    def are_free(rows: IntArray, lengths: FloatArray) -> BoolArray:
        space.poll()
        ends = advance(poses[rows, None], signs[rows, None] * lengths, curvatures[rows, None])
        found: BoolArray = space.is_free(ends.reshape(-1, 3), effort.margin, effort.start_relief)
        return found.reshape(ends.shape[:2])

    free = np.zeros(signs.size)
    steps = _steps(longest, space.spacing(effort))
    going, blocked = np.arange(free.size), np.zeros(free.size)
    for k in range(0, steps.size, _STRIDE):
        some = steps[k : k + _STRIDE]
        still = []
        for block in range(0, going.size, _ABREAST):
            mine = going[block : block + _ABREAST]
            good = are_free(mine, some)
            count = np.where(good.all(axis=1), some.size, np.argmin(good, axis=1))
            free[mine] = np.where(count > 0, some[np.maximum(count - 1, 0)], free[mine])
            blocked[mine] = some[np.minimum(count, some.size - 1)]
            still.append(mine[count == some.size])
        going = np.concatenate(still) if still else going
    # Bisection between the last free pose and the first blocked one: in a narrow area every centimetre is important.
    ended = np.setdiff1d(np.arange(free.size), going)
    for _ in range(_BISECTIONS if ended.size else 0):
        middle = 0.5 * (free[ended] + blocked[ended])
        good = are_free(ended, middle[:, None])[:, 0]
        free[ended] = np.where(good, middle, free[ended])
        blocked[ended] = np.where(good, blocked[ended], middle)
    return free


_SEQUENCES_KERNEL = Kernel("optdock_free_sequences", sizes=3, numbers=4)


def _are_free_native(arcs: Arcs, spacing: float, space: FreeSpace, limits: tuple[float, float]) -> BoolArray:
    n, count = arcs.lengths.shape
    if len(space.obstacles) == 0:
        return np.ones(n, dtype=np.bool_)
    columns, free = [(np.ascontiguousarray(column), column.size) for column in arcs], np.empty(n, dtype=np.int64)
    space.check(_SEQUENCES_KERNEL, (n, count), (spacing,), (*columns, (free, n)), limits)
    found: BoolArray = free != 0
    return found


@twin_of(_are_free_native)
def are_free(arcs: Arcs, spacing: float, space: FreeSpace, limits: tuple[float, float]) -> BoolArray:
    """Whether sequences are free at poses at most `spacing` [m] apart, including all joints. Shape (n,).

    `limits`: margin and start relief [m]; see `FreeSpace.is_free`.
    """
    blocks = [arcs.rows(slice(k, k + 1)).poses_every(spacing) for k in range(len(arcs.lengths))]
    free = space.is_free(np.concatenate(blocks), *limits)
    begins = np.cumsum([0, *(len(block) for block in blocks[:-1])])
    found: BoolArray = np.logical_and.reduceat(free, begins)
    return found


_FIRST_KERNEL = Kernel("optdock_first_free", sizes=4, numbers=4)


def _first_free_native(
    arcs: Arcs, shares: FloatArray, spacing: float, space: FreeSpace, limits: tuple[float, float]
) -> int:
    (n, count), first = arcs.lengths.shape, np.array([len(arcs.lengths)])
    if len(space.obstacles) == 0:
        return 0
    columns = [(np.ascontiguousarray(column), column.size) for column in (*arcs, shares)]
    space.check(_FIRST_KERNEL, (n, count, shares.size), (spacing,), (*columns, (first, 1)), limits)
    return int(first[0])


@twin_of(_first_free_native)
def first_free(arcs: Arcs, shares: FloatArray, spacing: float, space: FreeSpace, limits: tuple[float, float]) -> int:
    """Return the row of the first free sequence, or the number of sequences if none is free.

    The sequences are checked at `shares` of their lengths, Shape (q,), ascending; those that pass as by `are_free`.
    """
    poses = arcs.poses_at_shares(shares)
    passed = space.is_free(poses.reshape(-1, 3), *limits).reshape(poses.shape[:2]).all(axis=1)
    for row in np.flatnonzero(passed).tolist():
        space.poll()
        if are_free(arcs.rows(slice(row, row + 1)), spacing, space, limits)[0]:
            return int(row)
    return len(arcs.lengths)


_ROUGH_KERNEL = Kernel("optdock_may_be_free", sizes=4, numbers=3)


def _may_be_free_native(arcs: Arcs, shares: FloatArray, space: FreeSpace) -> BoolArray:
    (n, count), may = arcs.lengths.shape, np.ones(len(arcs.lengths), dtype=np.int64)
    if len(space.obstacles):
        columns = [(np.ascontiguousarray(column), column.size) for column in (*arcs, shares)]
        space.check(_ROUGH_KERNEL, (n, count, shares.size), (), (*columns, (may, n)), (0.0, 0.0))
    return may.astype(np.bool_)


@twin_of(_may_be_free_native)
def may_be_free(arcs: Arcs, shares: FloatArray, space: FreeSpace) -> BoolArray:
    """Whether sequences pass a rough check at `shares` of their lengths, see `FreeSpace.may_be_free`. Shape (n,)."""
    found = np.ones(len(arcs.lengths), dtype=np.bool_)
    for some in (slice(k, k + _ROUGH_BATCH) for k in range(0, found.size, _ROUGH_BATCH)):
        space.poll()
        poses = arcs.rows(some).poses_at_shares(shares)
        found[some] = space.may_be_free(poses.reshape(-1, 3)).reshape(poses.shape[:2]).all(axis=1)
    return found


def joined(start: FloatArray, *parts: tuple[FloatArray, FloatArray]) -> Arcs:
    """Concatenate several sequences of arcs into one sequence that begins at a pose."""
    lengths, curvatures = (np.concatenate([part[i] for part in parts])[None] for i in (0, 1))
    return Arcs(start[None], lengths, curvatures)
