"""Reeds-Shepp words between the nodes of two trees, in ascending order of price, and their collision check."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.geometry.arrays import readonly
from optdock.model.dock import DockDirection
from optdock.planners.manoeuvres.arcs import Arcs, are_free, joined
from optdock.planners.manoeuvres.price import driving_prices, gear_changes, stopping_cost
from optdock.planners.manoeuvres.reeds_shepp import TURNS, reeds_shepp_words

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from optdock.geometry.arrays import BoolArray, FloatArray, IntArray
    from optdock.planners.manoeuvres.arcs import ArcTree
    from optdock.planners.manoeuvres.free_space import Effort, FreeSpace

__all__ = [
    "Connections",
    "PairWords",
    "TreeNodes",
    "all_pairs",
    "cheapest_words",
    "connections",
    "end_gears",
    "free_manoeuvres",
    "is_wholly_free",
    "promising",
]

_PAIRS = 128  # pairs of poses per call of the closed forms, about a millisecond
_COARSE = readonly(np.arange(1, 9) / 9.0)  # shares of a word at which the coarse check samples it
_CLOSE_POSES_PER_WIDTH = 40.0  # poses of the final check of a whole manoeuvre, per width of the robot
_ROUGH_BATCH = 64  # words per call of the rough check
_BATCH = 24  # words per call of the coarse check
_NOTHING = 1e-6  # [m]: shorter arcs do not count as motion


class Connections(NamedTuple):
    """Words between nodes in ascending order of the price of the whole manoeuvre, Shape (n,) or (n, 5)."""

    prices: FloatArray
    exits: IntArray
    entries: IntArray
    lengths: FloatArray
    curvatures: FloatArray

    def rows(self, keep: IntArray | BoolArray | slice) -> Connections:
        """Return the words selected by `keep`."""
        return Connections(
            self.prices[keep], self.exits[keep], self.entries[keep], self.lengths[keep], self.curvatures[keep]
        )

    def at_prices(self, prices: FloatArray, most: float) -> Connections:
        """Return the words with new prices, Shape (n,), below `most`, in ascending order of the new prices."""
        order = np.argsort(prices, kind="stable")
        return self._replace(prices=prices).rows(order[prices[order] < most])

    @classmethod
    def merged(cls, blocks: Sequence[Connections]) -> Connections:
        """Merge several sets of words in ascending order of price."""
        columns = [np.concatenate(column) for column in zip(*blocks, strict=True)]
        return cls(*columns).rows(np.argsort(columns[0], kind="stable"))


class TreeNodes(NamedTuple):
    """A tree and the rows of some of its nodes."""

    tree: ArcTree
    rows: IntArray


def connections(exits: TreeNodes, entries: TreeNodes, radius: float, space: FreeSpace, per_pair: int) -> Connections:
    """Return the cheapest words between pairs of nodes, in gears allowed at both ends, without a collision check."""
    problem, (leaving, i), (arriving, j) = space.problem, exits, entries
    pair, driven, lengths, curvatures = cheapest_words(leaving.poses[i], arriving.poses[j], radius, space, per_pair)
    # With the gears in which the nodes are left and reached, cusps at the joints are also counted.
    gears = np.column_stack((leaving.signs[i[pair]], lengths, -arriving.signs[j[pair]]))
    prices = driven + leaving.prices[i[pair]] + arriving.prices[j[pair]]
    prices += stopping_cost(problem.robot.limits) * gear_changes(gears)
    first, last = end_gears(gears)
    allowed = first != 0.0
    wanted = {DockDirection.FORWARD: 1.0, DockDirection.BACKWARD: -1.0}.get(problem.dock.direction)
    if wanted is not None:
        allowed &= last * wanted > 0.0
    if problem.start_speed != 0.0:
        allowed &= first * problem.start_speed > 0.0
    kept = np.flatnonzero(allowed)
    kept = kept[np.argsort(prices[kept], kind="stable")]
    return Connections(prices[kept], i[pair[kept]], j[pair[kept]], lengths[kept], curvatures[kept])


def all_pairs(exits: TreeNodes, entries: TreeNodes) -> tuple[TreeNodes, TreeNodes]:
    """Return the pairs of each node of the first tree with each node of the second."""
    i, j = (grid.ravel() for grid in np.meshgrid(exits.rows, entries.rows, indexing="ij"))
    return TreeNodes(exits.tree, i), TreeNodes(entries.tree, j)


class PairWords(NamedTuple):
    """Words between poses: index of the pair and price at full speed [s], (m,); lengths and curvatures, (m, 5)."""

    pair: IntArray
    driven: FloatArray
    lengths: FloatArray
    curvatures: FloatArray


def cheapest_words(starts: FloatArray, ends: FloatArray, radius: float, space: FreeSpace, per_pair: int) -> PairWords:
    """Return for every pair of poses, Shape (n, 3) each, at most `per_pair` words that are cheapest at full speed."""
    blocks = [PairWords(np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros((0, 5)), np.zeros((0, 5)))]
    for k in range(0, len(starts), _PAIRS):
        space.poll()
        words = reeds_shepp_words(starts[k : k + _PAIRS], ends[k : k + _PAIRS], radius)
        with np.errstate(invalid="ignore"):
            driven = driving_prices(words, space.problem.robot).sum(axis=2)
        driven = np.where(np.isnan(driven), np.inf, driven)
        few = np.argpartition(driven, per_pair, axis=0)[:per_pair]
        columns = np.arange(driven.shape[1])
        is_one = np.isfinite(driven[few, columns])
        pair, form = np.broadcast_to(columns, few.shape)[is_one], few[is_one]
        blocks.append(PairWords(k + pair, driven[form, pair], words[form, pair], TURNS[form] / radius))
    return PairWords(*(np.concatenate(column) for column in zip(*blocks, strict=True)))


def end_gears(lengths: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the signs of the first and the last nonzero signed length, Shape (n, k) to (n,); 0 if there is none."""
    signs = np.where(np.abs(lengths) > _NOTHING, np.sign(lengths), 0.0)
    rows, is_moving = np.arange(len(signs)), signs != 0.0
    return signs[rows, is_moving.argmax(axis=1)], signs[rows, -1 - is_moving[:, ::-1].argmax(axis=1)]


def promising(found: Connections, exits: ArcTree, space: FreeSpace) -> Connections:
    """Return the connections whose words pass a rough collision check at a few poses."""
    kept = []
    for k in range(0, found.prices.size, _ROUGH_BATCH):
        space.poll()
        some = slice(k, k + _ROUGH_BATCH)
        words = Arcs(exits.poses[found.exits[some]], found.lengths[some], found.curvatures[some])
        poses = words.poses_at_shares(_COARSE)
        kept.append(space.may_be_free(poses.reshape(-1, 3)).reshape(poses.shape[:2]).all(axis=1))
    return found.rows(np.flatnonzero(np.concatenate(kept))) if kept else found


def free_manoeuvres(
    found: Connections,
    exits: ArcTree,
    entries: ArcTree,
    space: FreeSpace,
    effort: Effort,
    worthwhile: Callable[[], float],
) -> Iterator[Arcs]:
    """Yield collision-free manoeuvres from start to goal in ascending order of price, up to `worthwhile()`."""
    for k in range(0, found.prices.size, _BATCH):
        space.poll()
        if found.prices[k] >= worthwhile():
            return
        some = slice(k, k + _BATCH)
        words = Arcs(exits.poses[found.exits[some]], found.lengths[some], found.curvatures[some])
        coarse = words.poses_at_shares(_COARSE)
        limits = effort.margin, effort.start_relief
        passed = space.is_free(coarse.reshape(-1, 3), *limits).reshape(coarse.shape[:2]).all(axis=1)
        for row in np.flatnonzero(passed).tolist():
            space.poll()
            if found.prices[k + row] >= worthwhile():
                return
            word = words.rows(slice(row, row + 1))
            if not are_free(word, space.spacing(effort), space, limits)[0]:
                continue
            r = k + row
            way_out, way_in = exits.way(int(found.exits[r])), entries.way(int(found.entries[r]))
            whole = joined(space.problem.start.as_array(), way_out, (found.lengths[r], found.curvatures[r]), way_in)
            if is_wholly_free(whole, space, effort):
                yield whole


def is_wholly_free(whole: Arcs, space: FreeSpace, effort: Effort) -> bool:
    """Whether a single manoeuvre is collision-free at finely spaced poses, without the margin."""
    space.poll()
    return bool(are_free(whole, space.width / _CLOSE_POSES_PER_WIDTH, space, (0.0, effort.start_relief))[0])
