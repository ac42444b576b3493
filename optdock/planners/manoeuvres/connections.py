"""Reeds-Shepp words between the nodes of two trees, cheapest first, and which of them are free."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.dock import DockDirection
from optdock.planners.manoeuvres.arcs import Arcs
from optdock.planners.manoeuvres.price import gear_changes, stopping_cost
from optdock.planners.manoeuvres.reeds_shepp import TURNS, reeds_shepp_words
from optdock.planners.manoeuvres.tree import joined

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from optdock.geometry.arrays import BoolArray, FloatArray, IntArray
    from optdock.planners.manoeuvres.free_space import FreeSpace
    from optdock.planners.manoeuvres.tree import ArcTree
    from optdock.problem import DockingProblem

__all__ = ["Connections", "connections", "free_manoeuvres"]

_PAIRS = 128  # whose words are found in one go, about a millisecond
_KEPT = 60  # words kept of each such block
_GLANCE = np.arange(1, 9) / 9.0  # shares of a word at which it is looked at before it is looked at whole
_BATCH = 24  # words glanced at in one go
_NOTHING = 1e-6  # [m]: shorter arcs are no motion


class Connections(NamedTuple):
    """Words between nodes in ascending order of the price of the whole manoeuvre: Shape (n,) and (n, 5)."""

    prices: FloatArray
    exits: IntArray
    entries: IntArray
    lengths: FloatArray
    curvatures: FloatArray

    @property
    def size(self) -> int:
        """How many there are."""
        return int(self.prices.size)

    def cheapest(self, count: int) -> Connections:
        """The first `count`."""
        return Connections(*(column[:count] for column in self))


def connections(  # noqa: PLR0913, PLR0917 - two trees, which of their nodes, how sharply, until when
    exits: ArcTree,
    exit_rows: IntArray,
    entries: ArcTree,
    entry_rows: IntArray,
    radius: float,
    problem: DockingProblem,
    poll: Callable[[], None],
) -> Connections:
    """The cheapest words from nodes of the start's tree to nodes of the goal's."""
    i, j = (grid.ravel() for grid in np.meshgrid(exit_rows, entry_rows, indexing="ij"))
    blocks = []
    for k in range(0, i.size, _PAIRS):
        poll()
        blocks.append(_cheapest(exits, i[k : k + _PAIRS], entries, j[k : k + _PAIRS], radius, problem))
    joined_blocks = [np.concatenate(columns) for columns in zip(*blocks, strict=True)]
    order = np.argsort(joined_blocks[0], kind="stable")
    return Connections(*(column[order] for column in joined_blocks))


def _cheapest(  # noqa: PLR0913, PLR0917 - as connections
    exits: ArcTree, i: IntArray, entries: ArcTree, j: IntArray, radius: float, problem: DockingProblem
) -> Connections:
    limits = problem.robot.limits
    words = reeds_shepp_words(exits.poses[i], entries.poses[j], radius).lengths
    with np.errstate(invalid="ignore"):
        driven = np.where(words > 0.0, words / limits.max_speed, -words / limits.max_reverse_speed).sum(axis=2)
    prices = driven + exits.prices[i] + entries.prices[j]
    form, pair = np.nonzero(np.isfinite(prices))
    prices = prices[form, pair]
    kept = np.argsort(prices, kind="stable")[: 4 * _KEPT]
    form, pair, prices = form[kept], pair[kept], prices[kept]
    lengths = words[form, pair]
    # With the gears in which the nodes are left and reached, cusps at the joints count as well.
    before, after = exits.signs[i[pair]], -entries.signs[j[pair]]
    gears = np.column_stack((before, lengths, after))
    prices = prices + stopping_cost(limits) * gear_changes(gears)
    allowed = _in_allowed_gears(gears, problem)
    order = np.argsort(np.where(allowed, prices, np.inf), kind="stable")[: min(_KEPT, int(allowed.sum()))]
    return Connections(prices[order], i[pair][order], j[pair][order], lengths[order], TURNS[form[order]] / radius)


def _in_allowed_gears(gears: FloatArray, problem: DockingProblem) -> BoolArray:
    """Whether a robot in motion keeps its gear at first, and the last gear is the one that the dock asks for."""
    gears = np.where(np.abs(gears) > _NOTHING, gears, 0.0)
    rows, is_moving = np.arange(len(gears)), gears != 0.0
    allowed = is_moving.any(axis=1)
    wanted = {DockDirection.FORWARD: 1.0, DockDirection.BACKWARD: -1.0}.get(problem.dock.direction)
    if wanted is not None:
        allowed &= gears[rows, -1 - np.argmax(is_moving[:, ::-1], axis=1)] * wanted > 0.0
    if problem.start_speed != 0.0:
        allowed &= gears[rows, np.argmax(is_moving, axis=1)] * problem.start_speed > 0.0
    return allowed


def free_manoeuvres(  # noqa: PLR0913 - what, among what, how closely looked at, until when
    found: Connections,
    exits: ArcTree,
    entries: ArcTree,
    space: FreeSpace,
    margin: float,
    spacing: float,
    poll: Callable[[], None],
) -> Iterator[tuple[float, Arcs]]:
    """Those whose words are free, in ascending order of price: the price, and the whole way from start to goal."""
    for k in range(0, found.size, _BATCH):
        poll()
        some = slice(k, k + _BATCH)
        words = Arcs(exits.poses[found.exits[some]], found.lengths[some], found.curvatures[some])
        glanced = words.poses_at_shares(_GLANCE)
        passed = space.is_free(glanced.reshape(-1, 3), margin).reshape(glanced.shape[:2]).all(axis=1)
        for row in np.flatnonzero(passed).tolist():
            poll()
            word = words.rows(slice(row, row + 1))
            if not space.is_free(word.poses_every(spacing), margin).all():
                continue
            r = k + row
            parts = (
                exits.way(int(found.exits[r])),
                (found.lengths[r], found.curvatures[r]),
                entries.way(int(found.entries[r])),
            )
            yield float(found.prices[r]), joined(space.problem.start.as_array(), *parts)
