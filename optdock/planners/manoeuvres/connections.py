"""Reeds-Shepp words between the nodes of two trees, in ascending order of price, and their collision check."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.geometry.arrays import readonly
from optdock.kernels import Kernel, twin_of
from optdock.model.dock import DockDirection
from optdock.planners.manoeuvres.arcs import Arcs, are_free, first_free, joined, may_be_free
from optdock.planners.manoeuvres.price import driving_prices, gear_changes, stopping_cost
from optdock.planners.manoeuvres.reeds_shepp import TURNS, reeds_shepp_words

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from optdock.geometry.arrays import BoolArray, FloatArray, IntArray
    from optdock.model.problem import DockingProblem
    from optdock.model.robot import Robot
    from optdock.planners.manoeuvres.arcs import ArcTree
    from optdock.planners.manoeuvres.free_space import Effort, FreeSpace

__all__ = [
    "Connections",
    "PairWords",
    "TreeNodes",
    "all_pairs",
    "cheapest_words",
    "connections",
    "free_manoeuvres",
    "is_wholly_free",
    "promising",
    "with_last",
    "words_between",
]

_PAIRS = 256  # pairs of poses between two polls, 0.2 ms in C and 2 ms in NumPy
_COARSE = readonly(np.arange(1, 9) / 9.0)  # shares of a word at which the coarse check samples it
_CLOSE_POSES_PER_WIDTH = 40.0  # poses of the final check of a whole manoeuvre, per width of the robot
_BATCH = 24  # words per call of the coarse check
_NOTHING = 1e-6  # [m]: shorter arcs do not count as motion
_WANTED = {DockDirection.FORWARD: 1.0, DockDirection.BACKWARD: -1.0}  # signs of the last gear


class Connections(NamedTuple):
    """Words between nodes in ascending order of the price of the whole manoeuvre, Shape (n,) or (n, 5).

    `changes`: changes of gear within a word and at its ends.
    """

    prices: FloatArray
    changes: FloatArray
    exits: IntArray
    entries: IntArray
    lengths: FloatArray
    curvatures: FloatArray

    def rows(self, keep: IntArray | BoolArray | slice) -> Connections:
        """Return the words selected by `keep`."""
        lengths, curvatures = self.lengths[keep], self.curvatures[keep]
        return Connections(
            self.prices[keep], self.changes[keep], self.exits[keep], self.entries[keep], lengths, curvatures
        )

    def at_prices(self, prices: FloatArray, most: float) -> Connections:
        """Return the words with new prices, Shape (n,), below `most`, in ascending order of the new prices."""
        order = prices.argsort(kind="stable")
        return Connections(prices, *self[1:]).rows(order[prices[order] < most])

    @classmethod
    def merged(cls, blocks: Sequence[Connections]) -> Connections:
        """Merge several sets of words in ascending order of price."""
        whole = blocks[0] if len(blocks) == 1 else cls(*map(np.concatenate, zip(*blocks, strict=True)))
        return whole.rows(whole.prices.argsort(kind="stable"))


class TreeNodes(NamedTuple):
    """A tree and the rows of some of its nodes."""

    tree: ArcTree
    rows: IntArray


def connections(exits: TreeNodes, entries: TreeNodes, radius: float, space: FreeSpace, per_pair: int) -> Connections:
    """Return the cheapest words between pairs of nodes, in gears allowed at both ends, without a collision check."""
    (leaving, i), (arriving, j), blocks = exits, entries, []
    for some in (slice(k, k + _PAIRS) for k in range(0, max(i.size, 1), _PAIRS)):
        space.poll()
        pairs = TreeNodes(leaving, i[some]), TreeNodes(arriving, j[some])
        blocks.append(_connected(*pairs, radius, space.problem, per_pair))
    return Connections.merged(blocks)


_CONNECTIONS_KERNEL = Kernel("optdock_connections", sizes=2, numbers=7)


def _connected_native(
    exits: TreeNodes, entries: TreeNodes, radius: float, problem: DockingProblem, per_pair: int
) -> Connections:
    (leaving, i), (arriving, j), robot, n = exits, entries, problem.robot, exits.rows.size
    most, limits = n * per_pair, robot.limits
    prices, changes, rows = np.empty(most), np.empty(most), np.empty((2, most), dtype=np.int64)
    lengths, curvatures = np.empty((most, 5)), np.empty((most, 5))
    given = np.ascontiguousarray(i), np.ascontiguousarray(j), leaving.nodes, arriving.nodes, TURNS
    arrays = [(part, part.size) for part in (*given, prices, changes, rows, lengths, curvatures)]
    speeds = limits.max_speed, limits.max_reverse_speed, robot.reverse_price
    numbers = *speeds, radius, stopping_cost(limits), _WANTED.get(problem.dock.direction, 0.0), problem.start_speed
    found = slice(_CONNECTIONS_KERNEL((n, per_pair), numbers, tuple(arrays)))
    return Connections(prices[found], changes[found], rows[0, found], rows[1, found], lengths[found], curvatures[found])


@twin_of(_connected_native)
def _connected(
    exits: TreeNodes, entries: TreeNodes, radius: float, problem: DockingProblem, per_pair: int
) -> Connections:
    """Return the result of `connections` in the order of the pairs."""
    (leaving, i), (arriving, j) = exits, entries
    words = words_between(leaving.poses[i], arriving.poses[j], radius, problem.robot, per_pair)
    i, j, begins, ends = i[words.pair], j[words.pair], words.begins, words.ends
    # With the gears in which the nodes are left and reached, cusps at the joints are also counted.
    before, after = leaving.signs[i], -arriving.signs[j]
    stays = begins == 0.0
    changes = words.changes + (before * begins < 0.0) + (ends * after < 0.0) + (stays & (before * after < 0.0))
    prices = words.driven + leaving.prices[i] + arriving.prices[j]
    prices += stopping_cost(problem.robot.limits) * changes
    first = np.where(before != 0.0, before, np.where(stays, after, begins))
    last = np.where(after != 0.0, after, np.where(stays, before, ends))
    allowed = first != 0.0
    if problem.dock.direction in _WANTED:
        allowed &= last * _WANTED[problem.dock.direction] > 0.0
    if problem.start_speed != 0.0:
        allowed &= first * problem.start_speed > 0.0
    return Connections(prices, changes, i, j, words.lengths, words.curvatures).rows(allowed.nonzero()[0])


def all_pairs(exits: TreeNodes, entries: TreeNodes) -> tuple[TreeNodes, TreeNodes]:
    """Return the pairs of each node of the first tree with each node of the second."""
    i, j = exits.rows, entries.rows
    return TreeNodes(exits.tree, i.repeat(j.size)), TreeNodes(entries.tree, j[None].repeat(i.size, axis=0).ravel())


def with_last(lengths: FloatArray, last: FloatArray) -> FloatArray:
    """Return lengths, Shape (n, k), with one more column, Shape (n,)."""
    longer = np.empty((last.size, lengths.shape[1] + 1))
    longer[:, :-1], longer[:, -1] = lengths, last
    return longer


class PairWords(NamedTuple):
    """Words between poses in ascending order of the pair and the price.

    `pair`: index of the pair, `driven`: price at full speed [s], `begins`, `ends`: gears of the first and the last
    motion, 0 without motion, `changes`: number of gear changes, Shape (m,). `lengths`, `curvatures`: Shape (m, 5).
    """

    pair: IntArray
    driven: FloatArray
    begins: FloatArray
    ends: FloatArray
    changes: FloatArray
    lengths: FloatArray
    curvatures: FloatArray


def cheapest_words(starts: FloatArray, ends: FloatArray, radius: float, space: FreeSpace, per_pair: int) -> PairWords:
    """Return for every pair of poses, Shape (n, 3) each, at most `per_pair` words that are cheapest at full speed."""
    blocks = []
    for k in range(0, max(len(starts), 1), _PAIRS):
        space.poll()
        found = words_between(starts[k : k + _PAIRS], ends[k : k + _PAIRS], radius, space.problem.robot, per_pair)
        blocks.append(found._replace(pair=k + found.pair) if k else found)
    return blocks[0] if len(blocks) == 1 else PairWords(*(np.concatenate(part) for part in zip(*blocks, strict=True)))


_WORDS_KERNEL = Kernel("optdock_cheapest_words", sizes=2, numbers=4)


def _words_native(starts: FloatArray, ends: FloatArray, radius: float, robot: Robot, per_pair: int) -> PairWords:
    n, limits = len(starts), robot.limits
    most = n * per_pair
    pair, driven, gears = np.empty(most, dtype=np.int64), np.empty(most), np.empty((most, 3))
    lengths, curvatures = np.empty((most, 5)), np.empty((most, 5))
    outputs = [(part, part.size) for part in (pair, driven, gears, lengths, curvatures)]
    poses = [(np.ascontiguousarray(part), 3 * n) for part in (starts, ends)]
    numbers = limits.max_speed, limits.max_reverse_speed, robot.reverse_price, radius
    found = _WORDS_KERNEL((n, per_pair), numbers, (*poses, (TURNS, TURNS.size), *outputs))
    begins, stops, changes = gears[:found].T
    return PairWords(pair[:found], driven[:found], begins, stops, changes, lengths[:found], curvatures[:found])


@twin_of(_words_native)
def words_between(starts: FloatArray, ends: FloatArray, radius: float, robot: Robot, per_pair: int) -> PairWords:
    """Return the same as `cheapest_words` in one evaluation; `per_pair` is at most `len(TURNS)`."""
    words = reeds_shepp_words(starts, ends, radius)
    driven: FloatArray = sum(np.moveaxis(driving_prices(words, robot), 2, 0), np.zeros(words.shape[:2]))
    few = np.where(np.isnan(driven), np.inf, driven).argsort(axis=0, kind="stable")[:per_pair].T
    pair, rank = np.nonzero(np.isfinite(driven[few, np.arange(len(few))[:, None]]))
    form = few[pair, rank]
    lengths = words[form, pair]
    signs = np.where(np.abs(lengths) > _NOTHING, np.sign(lengths), 0.0)
    rows, is_moving = np.arange(len(signs)), signs != 0.0
    begins, stops = signs[rows, is_moving.argmax(axis=1)], signs[rows, -1 - is_moving[:, ::-1].argmax(axis=1)]
    changes = gear_changes(lengths).astype(np.float64)
    return PairWords(pair, driven[form, pair], begins, stops, changes, lengths, TURNS[form] / radius)


def promising(found: Connections, exits: ArcTree, space: FreeSpace) -> Connections:
    """Return the connections whose words pass a rough collision check at a few poses."""
    words = Arcs(exits.poses[found.exits], found.lengths, found.curvatures)
    return found.rows(may_be_free(words, _COARSE, space).nonzero()[0])


def free_manoeuvres(  # noqa: PLR0913 - words, two ends, a space, and how to search
    found: Connections,
    exits: ArcTree,
    entries: ArcTree,
    space: FreeSpace,
    effort: Effort,
    worthwhile: Callable[[], float],
    *,
    per_change: float = 0.0,
) -> Iterator[Arcs]:
    """Yield collision-free manoeuvres from start to goal in ascending order of price, up to `worthwhile()`.

    `per_change`: expected addition to the price per change of gear [s].
    """
    limits, spacing, row, most = (effort.margin, effort.start_relief), space.spacing(effort), 0, math.inf
    while True:
        if (now := worthwhile()) < most:
            most, found, row = now, found.rows(slice(row, None)), 0
            found = found.rows(found.prices + per_change * found.changes < most)
        if row == found.prices.size:
            return
        some = slice(row, row + _BATCH)
        words = Arcs(exits.poses[found.exits[some]], found.lengths[some], found.curvatures[some])
        first = first_free(words, _COARSE, spacing, space, limits)
        row += first
        if first == len(words.lengths):
            continue
        way_out, way_in = exits.way(int(found.exits[row])), entries.way(int(found.entries[row]))
        whole = joined(space.problem.start.as_array(), way_out, (found.lengths[row], found.curvatures[row]), way_in)
        row += 1
        if is_wholly_free(whole, space, effort):
            yield whole


def is_wholly_free(whole: Arcs, space: FreeSpace, effort: Effort) -> bool:
    """Whether a single manoeuvre is collision-free at finely spaced poses, without the margin."""
    return bool(are_free(whole, space.width / _CLOSE_POSES_PER_WIDTH, space, (0.0, effort.start_relief))[0])
