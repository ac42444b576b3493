"""A lazy roadmap along a route: Reeds-Shepp words between poses on the shortest route around the obstacles.

The shortest route of a disc through a building is known from the wavefront. Poses are placed along that route, in both
directions of the route, and neighbours are joined by Reeds-Shepp words. A best-first search finds the cheapest sequence
of words and checks a word for collisions only when the search reaches this word (lazily, as in [Bohlin2000], where the
vertices of the roadmap are random).
"""

from __future__ import annotations

import heapq
import math
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np

from optdock.planners.manoeuvres.arcs import Arcs, are_free, joined
from optdock.planners.manoeuvres.connections import cheapest_words, is_wholly_free
from optdock.planners.manoeuvres.disc_routes import arc_lengths
from optdock.planners.manoeuvres.price import stopping_cost

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from optdock.geometry.arrays import FloatArray, IntArray
    from optdock.planners.manoeuvres.connections import TreeNodes
    from optdock.planners.manoeuvres.free_space import Effort, FreeSpace

__all__ = ["roadmap_ways"]

_SPACING, _MOST_STATIONS = 0.75, 120  # spacing of stations in turning radii, larger on routes with more stations
_AHEAD = 3  # most stations that a word advances
_NEAR_ENDS = 6  # stations joined to the start, and to the dock
_MOST_ENDS = 8  # nodes of each end's tree
_WORDS_PER_PAIR = 3
_BATCH = 16  # words per collision check
_MOST_CHECKS, _MORE_CHECKS = 3000, 200  # words checked before the search ends, and after the first way


class _Edges(NamedTuple):
    """Words between vertices, sorted by source: Shape (m,), with lengths and curvatures of Shape (m, 5)."""

    sources: IntArray
    targets: IntArray
    prices: FloatArray
    begins: FloatArray
    ends: FloatArray
    lengths: FloatArray
    curvatures: FloatArray


class _Labels(NamedTuple):
    """The cheapest known paths to all vertices: their prices, the gears at their ends, and their last edges."""

    prices: list[float]
    gears: list[float]
    edges: list[int]


# Words that leave one vertex, in ascending order: bound of a whole path, price of the path so far, and its last edge.
_Words: TypeAlias = list[tuple[float, float, int]]


def roadmap_ways(
    exits: TreeNodes,
    entries: TreeNodes,
    space: FreeSpace,
    effort: Effort,
    route: FloatArray,
    worthwhile: Callable[[], float],
) -> Iterator[Arcs]:
    """Yield free manoeuvres along a route, Shape (n, 2) [m], as they are found, roughly in ascending order of price.

    `entries` must not contain the root of the goal's tree; `worthwhile` returns the price at or above which a manoeuvre
    is useless.
    """
    for price, way in _LazySearch(exits, entries, space, effort, route).ways():
        if price >= worthwhile():
            return
        if is_wholly_free(way, space, effort):
            yield way


class _LazySearch:
    """Best-first search over words; the vertices are the exits, then poses along the route, then the entries."""

    def __init__(
        self, exits: TreeNodes, entries: TreeNodes, space: FreeSpace, effort: Effort, route: FloatArray
    ) -> None:
        self._exits, self._entries = exits.tree, entries.tree
        self._out, self._into = exits.rows[:_MOST_ENDS], entries.rows[:_MOST_ENDS]
        self._space, self._effort = space, effort
        limits = space.problem.robot.limits
        self._stop, self._speed = stopping_cost(limits), max(limits.max_speed, limits.max_reverse_speed)
        along, self._spacing = _stations(route, effort.radius)
        self._count = len(along)
        poses = np.concatenate((along, along + np.array([0.0, 0.0, np.pi])))
        free = np.flatnonzero(space.is_free(poses, effort.margin, effort.start_relief))
        self._poses = np.concatenate((exits.tree.poses[self._out], poses[free], entries.tree.poses[self._into]))
        first, last = np.zeros(self._out.size, dtype=np.int64), np.full(self._into.size, self._count)
        self._station = np.concatenate((first, free % self._count, last))
        self._begin, self._end = self._out.size, self._out.size + free.size
        self._edges = self._words()
        self._of = np.searchsorted(self._edges.sources, np.arange(len(self._poses) + 1)).tolist()
        # Of the edges; the last ones are bounds of the price from the target to the entries.
        self._targets, self._prices = self._edges.targets.tolist(), self._edges.prices.tolist()
        self._begins = self._edges.begins.tolist()
        left = self._count - self._station[self._edges.targets]
        self._rest = (left * self._spacing / self._speed).tolist()

    def _words(self) -> _Edges:
        """Return words between vertices that are close to each other along the route, in gears allowed at both ends."""
        station, targets = self._station, len(self._poses) - self._begin
        i, j = np.divmod(np.arange(self._end * targets), targets)
        j += self._begin
        on, leaves, arrives = station[j] - station[i], i < self._begin, j >= self._end
        wanted = np.where(leaves, station[j] < _NEAR_ENDS, station[i] >= self._count - _NEAR_ENDS)
        wanted = np.where(leaves | arrives, wanted & (leaves != arrives), (on >= 0) & (on <= _AHEAD) & (i != j))
        i, j = i[wanted], j[wanted]
        ends = self._poses[i], self._poses[j]
        words = cheapest_words(*ends, self._effort.radius, self._space, _WORDS_PER_PAIR)
        i, j, begins = i[words.pair], j[words.pair], words.begins
        prices = words.driven + self._stop * words.changes
        kept = ((begins != 0.0) & ((i > 0) | (begins * self._space.problem.start_speed >= 0.0))).nonzero()[0]
        kept = kept[i[kept].argsort(kind="stable")]
        parts = i, j, prices, begins, words.ends, words.lengths, words.curvatures
        return _Edges(*(part[kept] for part in parts))

    def ways(self) -> Iterator[tuple[float, Arcs]]:
        """Yield complete paths of free words with their prices as they are found."""
        self._space.poll()
        count, opened = len(self._poses), list[_Words]()
        labels = _Labels([math.inf] * count, [0.0] * count, [-1] * count)
        labels.prices[: self._begin], labels.gears[: self._begin] = self._exits.nodes[self._out, 3:5].T.tolist()
        for vertex in range(self._begin):
            self._push(vertex, labels, opened)
        checked, most = 0, _MOST_CHECKS
        while opened and checked < most:
            some = self._next(opened, labels)
            checked += len(some)
            for (price, edge), is_free in zip(some, self._are_free([edge for _, edge in some]), strict=True):
                target = self._targets[edge]
                if not is_free or labels.prices[target] <= price:
                    continue
                labels.prices[target], labels.gears[target], labels.edges[target] = (
                    price,
                    float(self._edges.ends[edge]),
                    edge,
                )
                if target < self._end:
                    self._push(target, labels, opened)
                    continue
                most = min(most, checked + _MORE_CHECKS)
                row = int(self._into[target - self._end])
                turns = bool(labels.gears[target] * -self._entries.signs[row] < 0.0)
                yield price + float(self._entries.prices[row]) + self._stop * turns, self._way(target, labels)

    def _push(self, vertex: int, labels: _Labels, opened: list[_Words]) -> None:
        """Push the words that leave a vertex for a better label, with the price so far plus a bound for the rest."""
        before, gear = labels.prices[vertex], labels.gears[vertex]
        better = [
            (price + self._rest[edge], price, edge)
            for edge in range(self._of[vertex], self._of[vertex + 1])
            if (price := before + self._prices[edge] + self._stop * (self._begins[edge] * gear < 0.0))
            < labels.prices[self._targets[edge]]
        ]
        if better:
            heapq.heappush(opened, sorted(better))

    def _next(self, opened: list[_Words], labels: _Labels) -> list[tuple[float, int]]:
        """Pop the next words to check, with the prices of the paths to their ends."""
        some: list[tuple[float, int]] = []
        while opened and len(some) < _BATCH:
            (_, price, edge), *others = opened[0]
            if others:
                heapq.heapreplace(opened, others)
            else:
                heapq.heappop(opened)
            if price < labels.prices[self._targets[edge]]:
                some.append((price, edge))
        return some

    def _are_free(self, edges: list[int]) -> list[bool]:
        if not edges:
            return []
        sources, spacing = self._poses[self._edges.sources[edges]], self._space.spacing(self._effort)
        words = Arcs(sources, self._edges.lengths[edges], self._edges.curvatures[edges])
        found: list[bool] = are_free(
            words, spacing, self._space, (self._effort.margin, self._effort.start_relief)
        ).tolist()
        return found

    def _way(self, vertex: int, labels: _Labels) -> Arcs:
        """Return the whole path that ends at an entry."""
        parts = [self._entries.way(int(self._into[vertex - self._end]))]
        while (edge := labels.edges[vertex]) >= 0:
            parts.append((self._edges.lengths[edge], self._edges.curvatures[edge]))
            vertex = int(self._edges.sources[edge])
        parts.append(self._exits.way(int(self._out[vertex])))
        return joined(self._space.problem.start.as_array(), *reversed(parts))


def _stations(route: FloatArray, radius: float) -> tuple[FloatArray, float]:
    """Return poses along a route, Shape (n, 3), and their spacing [m]."""
    s = arc_lengths(route)
    spacing = max(_SPACING * radius, s[-1] / _MOST_STATIONS)
    at, near = np.arange(0.5 * spacing, s[-1], spacing), 0.5 * spacing
    x, y = (np.interp(at, s, route[:, i]) for i in (0, 1))
    dx, dy = (np.interp(at + near, s, route[:, i]) - np.interp(at - near, s, route[:, i]) for i in (0, 1))
    poses: FloatArray = np.column_stack((x, y, np.arctan2(dy, dx)))
    return poses, spacing
