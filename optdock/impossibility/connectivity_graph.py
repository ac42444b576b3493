"""Connectivity graph of a cell decomposition: each node is a set of connected cells of one kind in one tile.

Cells lie in tiles of a quadtree of the plane, with all headings ([Brooks1985], [Zhang2008]). A tile that was not
examined is one cell.
"""

from __future__ import annotations

import functools
import heapq
import itertools
import math
from collections import deque
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np

from optdock.geometry.arrays import readonly
from optdock.impossibility.proof import CELLS, SLACK
from optdock.kernels import Kernel, twin_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from numpy.typing import NDArray

    from optdock.geometry.arrays import BoolArray, FloatArray, IntArray

__all__ = [
    "FINEST",
    "GOAL",
    "OPEN",
    "OUTSIDE",
    "ROOM",
    "START",
    "CellGrid",
    "ConnectivityGraph",
    "Kinds",
    "PlaceGraph",
    "Tile",
    "by_certainty",
    "by_margin",
    "connected_cells",
    "predecessors",
]

OPEN = 1e-6  # cost of an open node, or one outside: of two open routes the shorter one is taken
ROOM = 1e3  # [m] of clearance: larger than the clearance of any place
FINEST = 4  # level of the finest tiles


class CellGrid(NamedTuple):
    """Grid of cells at every level, as in `ImpossibilityProof`; the single tile of level `-above` covers the grid."""

    origin: FloatArray
    cell: float
    headings: int
    above: int

    def half(self, level: int) -> float:
        """Return half the side of a cell [m]."""
        return self.cell * 0.5**level

    def side(self, level: int) -> float:
        """Return the side of a tile [m]."""
        return 2.0 * CELLS * self.half(level)

    def count(self, level: int) -> int:
        """Return the number of headings at a level."""
        return self.headings << level


class Tile(NamedTuple):
    """One tile of the quadtree; a tile that was not examined has neither `blocked` nor `margin`.

    `blocked`: which cells are blocked, Shape (headings, rows, columns). `margin`: approximate clearance above the
    required one at their centres, same shape [m].
    """

    level: int
    column: int
    row: int
    blocked: BoolArray | None = None
    margin: NDArray[np.float32] | None = None

    def split(self) -> list[tuple[int, int, int]]:
        """Return level, column and row of the quarters of the tile."""
        return [(self.level + 1, 2 * self.column + i, 2 * self.row + j) for i in (0, 1) for j in (0, 1)]


Kinds: TypeAlias = "Callable[[Tile], tuple[BoolArray, BoolArray]]"
_ONE = readonly(np.ones((1, 1, 1), dtype=np.bool_))
_NONE = readonly(np.zeros((0, 2), dtype=np.int64))
_AT_ONCE = 8  # steps of an addition between two readings of the clock, 0.3 ms


def by_certainty(grid: CellGrid) -> Kinds:
    """Return a function that selects the open and the narrow cells of a tile; unexamined tiles count as narrow.

    Cells whose margin exceeds half a cell appear open. All other cells that are not blocked are narrow.
    """

    def kinds(tile: Tile) -> tuple[BoolArray, BoolArray]:
        if tile.blocked is None or tile.margin is None:
            return ~_ONE, _ONE
        is_open = ~tile.blocked & (tile.margin > grid.half(tile.level))
        return is_open, ~(tile.blocked | is_open)

    return kinds


def by_margin(low: float, high: float) -> Kinds:
    """Return a function that selects the cells with margins of at least `high`, and from `low` to below `high`."""

    def kinds(tile: Tile) -> tuple[BoolArray, BoolArray]:
        if tile.margin is None:
            return _ONE, ~_ONE
        return tile.margin >= high, (tile.margin >= low) & (tile.margin < high)

    return kinds


OUTSIDE, START, GOAL = range(3)  # nodes


class ConnectivityGraph:
    """Graph of the open and narrow cells of adjacent tiles, as selected by `kinds`; other cells are omitted.

    `ends`: poses of the centre at the start and the goal.
    """

    def __init__(self, grid: CellGrid, ends: list[FloatArray], kinds: Kinds) -> None:
        self.grid, self.ends, self.kinds = grid, ends, kinds
        self.tiles: list[Tile] = []  # including removed ones
        self.labels: list[IntArray] = []
        self.tile_at = np.full((2 ** (grid.above + FINEST),) * 2, -1, dtype=np.int32)
        self.cost, self.tile_of = [OPEN] * 3, [-1] * 3
        self.joints: dict[tuple[int, int], IntArray] = {}
        self._unlabelled: deque[Tile] = deque()
        self._joined = 0  # number of tiles that are joined to their neighbours

    def add(self, tiles: Iterable[Tile], look: Callable[[], None] = lambda: None) -> None:
        """Add tiles to the plane in place of removed tiles, and join them to their neighbours.

        `look` is called every few steps. If it raises an exception, the graph is not complete until another call,
        with further tiles or none, has returned.
        """
        self._unlabelled.extend(tiles)
        while self._unlabelled:
            if len(self._unlabelled) % _AT_ONCE == 0:
                look()
            self._label(self._unlabelled.popleft())
        for key in range(self._joined, len(self.tiles)):
            if key % _AT_ONCE == 0:
                look()
            rows, columns = self._place(key)
            self._join(key, 0, 0, columns.start - 1, rows)
            self._join(key, 0, -1, columns.stop, rows)
            self._join(key, 1, 0, rows.start - 1, columns)
            self._join(key, 1, -1, rows.stop, columns)
            self._joined = key + 1

    def remove(self, keys: set[int]) -> None:
        """Remove tiles; the caller must add other tiles in their place."""
        self.joints = {pair: joint for pair, joint in self.joints.items() if keys.isdisjoint(pair)}

    def present(self) -> list[int]:
        """Return the keys of the tiles that have not been removed."""
        return [key for key in range(len(self.tiles)) if (key, key) in self.joints]

    def _label(self, tile: Tile) -> None:
        key, first = len(self.tiles), len(self.cost)
        is_open, is_narrow = self.kinds(tile)
        labels, counts = connected_cells(is_open + 2 * is_narrow.astype(np.int64))
        labels[labels >= 0] += first
        for count, cost in zip(counts.tolist(), (OPEN, self.grid.side(tile.level)), strict=True):
            self.cost += [cost] * count
            self.tile_of += [key] * count
        self.tiles.append(tile)
        self.labels.append(labels)
        self.tile_at[self._place(key)] = key
        self.joints[key, key] = _met_within(labels, kinds=int(np.count_nonzero(counts))) if labels.size > 1 else _NONE

    def _join(self, key: int, axis: int, edge: int, beyond: int, along: slice) -> None:
        """Join a tile to its neighbours across its lower (0) or upper (-1) side along an axis."""
        if not 0 <= beyond < len(self.tile_at):
            nodes = np.unique(np.take(self.labels[key], edge, axis=2 - axis))
            nodes = nodes[nodes >= 0]
            known = self.joints.get((key, -1), _NONE)
            self.joints[key, -1] = np.vstack((known, np.column_stack((nodes, np.full_like(nodes, OUTSIDE)))))
            return
        strip = self.tile_at[along, beyond] if axis == 0 else self.tile_at[beyond, along]
        for other in np.unique(strip).tolist():
            pair = (min(key, other), max(key, other))
            if other >= 0 and pair not in self.joints:
                self.joints[pair] = self._met_over(key, other, axis, edge)

    def _met_over(self, key: int, other: int, axis: int, edge: int) -> IntArray:
        """Return the pairs of nodes of two tiles that share a face across a side of the first tile, Shape (n, 2)."""
        if self.labels[key].size == self.labels[other].size == 1:
            met = np.array([(int(self.labels[key][0, 0, 0]), int(self.labels[other][0, 0, 0]))])
            return met if met.min() >= 0 else _NONE
        both = ((key, edge), (other, -1 - edge))
        sides = tuple((*self.tiles[k][:3], self.labels[k].shape[1], self.labels[k].shape[0], side) for k, side in both)
        first, second = (
            self.labels[k].ravel().take(place) for (k, _), place in zip(both, _beside(sides, axis), strict=True)
        )
        return _pairs(first, second, len(self.cost))

    def _place(self, key: int) -> tuple[slice, slice]:
        """Return rows and columns of a tile in `tile_at`."""
        tile = self.tiles[key]
        size = 2 ** (FINEST - tile.level)
        return slice(tile.row * size, (tile.row + 1) * size), slice(tile.column * size, (tile.column + 1) * size)

    def _nodes_at(self, pose: FloatArray) -> list[int]:
        """Return the nodes of the cells that contain a pose of the centre, up to `SLACK`."""
        found: set[int] = set()
        size, near = self.grid.side(FINEST), (-SLACK, SLACK)
        for dx, dy, turned in itertools.product(near, near, near):
            x, y, yaw = pose + np.array([dx, dy, turned])
            i, j = math.floor(x / size), math.floor(y / size)
            if not (0 <= i < len(self.tile_at) and 0 <= j < len(self.tile_at)):
                found.add(OUTSIDE)
                continue
            key = int(self.tile_at[j, i])
            tile, (headings, n, _) = self.tiles[key], self.labels[key].shape
            side = self.grid.side(tile.level)
            row, column = (math.floor((v / side - first) * n) for v, first in ((y, tile.row), (x, tile.column)))
            layer = math.floor(yaw * headings / (2.0 * math.pi)) % headings
            found.add(int(self.labels[key][layer, min(max(row, 0), n - 1), min(max(column, 0), n - 1)]))
        return sorted(found - {-1})

    def _all_joints(self) -> IntArray:
        """Return all pairs of adjacent nodes, Shape (n, 2)."""
        ends = [
            np.array([(k, node) for node in self._nodes_at(end)]).reshape(-1, 2) for k, end in enumerate(self.ends, 1)
        ]
        return np.concatenate((*ends, *self.joints.values())).astype(np.int64)

    def route(self) -> list[int]:
        """Return the nodes of the cheapest route from goal to start; empty if there is none."""
        return _route(predecessors(self._all_joints(), np.array(self.cost), START, GOAL, is_minimax=False))

    def reached(self, node: int) -> BoolArray:
        """Return a mask of the nodes that are connected to a node."""
        first, second = self._all_joints().T
        found: BoolArray = np.arange(len(self.cost)) == node
        while True:
            met = np.flatnonzero(found[first] != found[second])
            if met.size == 0:
                return found
            found[first[met]] = found[second[met]] = True


class PlaceGraph(ConnectivityGraph):
    """Graph with a node per position cell, whose cost is a lower bound on the clearance that is missing for a disc.

    Costs are negative if the disc fits. Unexamined tiles have the lowest cost.
    """

    def _label(self, tile: Tile) -> None:
        key, first = len(self.tiles), len(self.cost)
        if tile.margin is None:
            labels, cost = np.full((1, 1, 1), first), [-ROOM]
        else:
            best = tile.margin.max(axis=0) + math.sqrt(2.0) * self.grid.half(tile.level)
            labels, cost = np.arange(first, first + best.size).reshape(1, *best.shape), (-best).ravel().tolist()
        self.cost += cost
        self.tile_of += [key] * len(cost)
        self.tiles.append(tile)
        self.labels.append(labels)
        self.tile_at[self._place(key)] = key
        self.joints[key, key] = _met_within(labels, kinds=2)

    def route(self) -> list[int]:
        """Return the nodes of the minimax route, which has the lowest maximum node cost.

        It is the route in a minimum spanning tree ([Hu1961]), which grows from the start.
        """
        cost = np.maximum(np.array(self.cost), -ROOM)
        cost[: GOAL + 1] = -ROOM
        return _route(predecessors(self._all_joints(), cost, START, GOAL, is_minimax=True))


def _route(before: IntArray) -> list[int]:
    """Return the nodes from goal to start, given the predecessors of all nodes; empty if the goal was not reached."""
    route = [GOAL]
    while route[-1] != START:
        route.append(int(before[route[-1]]))
        if route[-1] < 0:
            return []
    return route


_COMPONENTS = Kernel("optdock_connected_cells", sizes=3, numbers=0)
_PREDECESSORS = Kernel("optdock_predecessors", sizes=5, numbers=0)


def _connected_cells_native(kinds: IntArray) -> tuple[IntArray, IntArray]:
    labels, room, counts = np.empty_like(kinds), np.empty_like(kinds), np.empty(2, dtype=np.int64)
    arrays = ((kinds, kinds.size), (room, kinds.size), (labels, kinds.size), (counts, 2))
    _COMPONENTS(kinds.shape, (), arrays)
    return labels, counts


@twin_of(_connected_cells_native)
def connected_cells(kinds: IntArray) -> tuple[IntArray, IntArray]:
    """Return the connected components of cells of one kind that share faces, in the order of their first cells.

    Args:
        kinds: 1 or 2, or 0 for cells that are omitted, Shape (layers, rows, columns).

    Returns:
        The number of each cell's component, all components of kind 1 before those of kind 2 and -1 for omitted cells,
        Shape (layers, rows, columns), and the numbers of components of either kind, Shape (2,).
    """
    cells = np.arange(kinds.size).reshape(kinds.shape)
    joints = []
    for axis in range(3):
        a, b = (np.swapaxes(part, 0, axis) for part in (cells, kinds))
        is_one = (b[1:] == b[:-1]) & (b[1:] > 0)
        joints.append(np.column_stack((a[:-1][is_one], a[1:][is_one])))
    lowest = _lowest_connected(kinds.size, np.concatenate(joints))
    labels, counts, flat = np.full(kinds.size, -1), [0, 0], kinds.ravel()
    for k in (1, 2):
        some = np.flatnonzero(flat == k)
        first, labels[some] = np.unique(lowest[some], return_inverse=True)
        labels[some] += counts[0] if k == 2 else 0
        counts[k - 1] = first.size
    return labels.reshape(kinds.shape), np.array(counts)


def _lowest_connected(count: int, joints: IntArray) -> IntArray:
    """Return the lowest number that is connected to each number below `count` by joints, Shape (n, 2)."""
    lowest = np.arange(count)
    while True:
        first, second = lowest[joints].T
        apart = first != second
        if not apart.any():
            return lowest
        np.minimum.at(lowest, np.maximum(first, second)[apart], np.minimum(first, second)[apart])
        while True:
            further = lowest[lowest]
            if np.array_equal(further, lowest):
                break
            lowest = further


def _predecessors_native(joints: IntArray, cost: FloatArray, start: int, goal: int, *, is_minimax: bool) -> IntArray:
    n, m = cost.size, len(joints)
    before = np.empty(n, dtype=np.int64)
    arrays = (
        (np.ascontiguousarray(joints), 2 * m),
        (cost, n),
        (np.empty(n + 1, dtype=np.int64), n + 1),
        (np.empty(2 * m, dtype=np.int64), 2 * m),
        (np.empty(2 * m + 1, dtype=np.int64), 2 * m + 1),
        (np.empty(2 * m + 1), 2 * m + 1),
        (np.empty(n), n),
        (before, n),
    )
    if _PREDECESSORS((n, m, start, goal, int(is_minimax)), (), arrays):
        raise IndexError("a joint names no node")
    return before


@twin_of(_predecessors_native)
def predecessors(joints: IntArray, cost: FloatArray, start: int, goal: int, *, is_minimax: bool) -> IntArray:
    """Return the predecessor of every node on the best route from `start`; -1 if none is known.

    The search ends when the goal is reached; only its own route is then certain to be the best one.

    Args:
        joints: Pairs of adjacent nodes, Shape (n, 2).
        cost: Costs of the nodes, Shape (m,).
        start: First node.
        goal: Last node.
        is_minimax: Whether the best route has the lowest maximum cost of its nodes instead of the lowest sum.
    """
    beside: list[list[int]] = [[] for _ in range(cost.size)]
    for first, second in joints.tolist():
        beside[first].append(second)
        beside[second].append(first)
    costs, before, best = cost.tolist(), [-1] * cost.size, [math.inf] * cost.size
    waiting = [(-math.inf, start)]
    best[start] = -math.inf
    while waiting:
        key, node = heapq.heappop(waiting)
        if node == goal:
            break
        if key > best[node]:
            continue
        spent, best[node] = key if node != start else 0.0, -math.inf
        for other in beside[node]:
            reached = max(costs[node], costs[other]) if is_minimax else spent + costs[other]
            if reached < best[other]:
                best[other], before[other] = reached, node
                heapq.heappush(waiting, (reached, other))
    return np.array(before)


@functools.lru_cache(maxsize=4096)
def _beside(sides: tuple[tuple[int, ...], ...], axis: int) -> tuple[IntArray, IntArray]:
    """Return the flat indices of the cells of two tiles that share a face along an axis (0: x), Shape (n,) each.

    `sides`: for each tile its level, column, row, number of cells along a side, number of headings, and the shared side
    (0 for the lower, -1 for the upper one).
    """
    finest = max(side[0] for side in sides)
    size = [CELLS << (finest - side[0]) for side in sides]  # in cells of the finer one
    low = [side[2 - axis] * n for side, n in zip(sides, size, strict=True)]
    step = min(n // side[3] for side, n in zip(sides, size, strict=True))
    along = np.arange(max(low), min(first + n for first, n in zip(low, size, strict=True)), step)
    headings = max(side[4] for side in sides)
    places = []
    for side, n, first in zip(sides, size, low, strict=True):
        across, layer = (along - first) * side[3] // n, np.arange(headings) * side[4] // headings
        face = np.full_like(across, side[5] % side[3])
        row, column = (across, face) if axis == 0 else (face, across)
        places.append(((layer[:, None] * side[3] + row) * side[3] + column).ravel())
    return readonly(places[0]), readonly(places[1])


def _met_within(labels: IntArray, kinds: int) -> IntArray:
    """Return pairs of adjacent nodes of one tile, Shape (n, 2).

    Two nodes of one kind are adjacent only where the heading wraps around.
    """
    most = int(labels.max()) + 1
    found = [_pairs(labels[0], labels[-1], most)]
    if kinds > 1:
        found += [
            _pairs(labels[:, :, 1:], labels[:, :, :-1], most),
            _pairs(labels[:, 1:], labels[:, :-1], most),
            _pairs(labels[1:], labels[:-1], most),
        ]
    return np.concatenate(found)


def _pairs(first: IntArray, second: IntArray, most: int) -> IntArray:
    """Return the distinct pairs of different nodes, all below `most`, at equal indices of two arrays, Shape (n, 2)."""
    met = (first >= 0) & (second >= 0) & (first != second)
    codes = first[met] * most + second[met]
    changes = np.ones(codes.size, dtype=np.bool_)
    changes[1:] = codes[1:] != codes[:-1]
    return np.column_stack(np.divmod(np.unique(codes[changes]), most))
