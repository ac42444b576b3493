"""Hybrid A* from one end to the other, many nodes at a time, with Reeds-Shepp words as shots.

[Dolgov2010] search over poses that are not rounded to a grid, keep one node per cell of a pose grid, and try from nodes
whether the rest can be driven without regard to obstacles. Here the search begins at the end where space is tight,
mostly the goal: every node knows its way there, and each new one is joined to the other end by the cheapest words. The
bound of what is still to drive is the cheaper of all words, and the length of the shortest way among the obstacles for
a disc.
"""

from __future__ import annotations

import heapq
from typing import TYPE_CHECKING

import numpy as np

from optdock.geometry.arrays import readonly
from optdock.planners.manoeuvres.arcs import Moves
from optdock.planners.manoeuvres.connections import Connections, TreeNodes, connections, free_manoeuvres, promising

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from optdock.geometry.arrays import BoolArray, FloatArray, IntArray
    from optdock.planners.manoeuvres.arcs import Arcs, ArcTree
    from optdock.planners.manoeuvres.distance_field import Wavefront
    from optdock.planners.manoeuvres.free_space import Effort, FreeSpace

__all__ = ["FULL_LOCK", "PoseGrid", "hybrid_a_star"]

_EXPANDED = 24  # nodes in one go
_WORDS_PER_NODE = 4
_SHOTS = 48  # words looked at after each expansion
# Headings of the pose grid, times its fineness.
_YAWS_PER_CELL = 6
# Distances to obstacles, in reaches of the distance field, from which cells are so many times as large.
_ROOM, _COARSER, _COARSEST_YAW = readonly(np.array([0.3, 0.5])), readonly(np.array([1.0, 4.0, 10.0])), 4.0
_GREED = 2.5  # weight of what is still to drive
FULL_LOCK = 1.0, -1.0  # left and right, in curvatures of the smallest radius
_STATIONS = readonly(np.array([0.25, 0.5, 1.0, 2.0]))  # where a node is left on an arc, in turning radii


class PoseGrid:
    """Cells of poses, each of which is entered once: fine among obstacles, coarse where there is room.

    Args:
        space: Its distance field says where there is room.
        fineness: The smallest cells are the robot's width divided by this.
    """

    def __init__(self, space: FreeSpace, fineness: int) -> None:
        self._field = space.field
        self._fine, self._headings = space.width / fineness, _YAWS_PER_CELL * fineness
        self._seen: set[int] = set()

    def enter(self, poses: FloatArray) -> BoolArray:
        """Which of the poses, Shape (n, 3), are the first in their cells. Shape (n,)."""
        room, _ = self._field.bounds(poses[:, :2])
        level = np.searchsorted(_ROOM * self._field.reach, room)
        scale = _COARSER[level]
        x, y = np.floor(poses[:, :2] / (self._fine * scale)[:, None]).astype(np.int64).T
        headings = (self._headings / np.minimum(scale, _COARSEST_YAW)).astype(np.int64)
        yaw = np.rint(poses[:, 2] * (headings / (2.0 * np.pi))).astype(np.int64) % headings
        keys = (((x * 0x100000 + y) * self._headings + yaw) * _COARSER.size + level).tolist()
        new = np.zeros(len(poses), dtype=np.bool_)
        for i, key in enumerate(keys):
            if key not in self._seen:
                self._seen.add(key)
                new[i] = True
        return new


def hybrid_a_star(  # noqa: PLR0913 - two ends, a space, and how to search
    exits: TreeNodes,
    entries: TreeNodes,
    space: FreeSpace,
    effort: Effort,
    wavefront: Wavefront,
    worthwhile: Callable[[], float],
    *,
    from_start: bool = False,
    bends: tuple[float, ...] = FULL_LOCK,
) -> Iterator[Arcs]:
    """Free manoeuvres as they are found, whole from start to goal.

    The first way found is seldom the best one: once there is a plan, or a better one, the tree grows no more, but it is
    shot at while that may pay.

    Args:
        exits: The start, from which every node is shot at, and other nodes of its tree, which take turns.
        entries: Nodes of the goal's tree from which the search goes on; its tree grows.
        space: What is free.
        effort: How sharply, how closely and for how long.
        wavefront: Lengths of the shortest ways for a disc from the other end than the one where the search begins.
        worthwhile: The price from which on a way is of no use; infinite while there is no plan.
        from_start: The start's tree grows instead, and from its nodes the entries are shot at.
        bends: Curvatures that are driven beside the straight line, in those of the smallest radius.
    """
    growing, aims = (exits, entries) if from_start else (entries, exits)
    tree, limits, radius = growing.tree, space.problem.robot.limits, effort.radius
    speed = max(limits.max_speed, limits.max_reverse_speed)
    grid = PoseGrid(space, effort.fineness)
    grid.enter(tree.poses)
    moves = Moves.of((1.0, -1.0), (0.0, *(bend / radius for bend in bends)))
    opened: list[tuple[float, int]] = []
    shots: list[Connections] = []
    fresh, nodes = growing.rows, 0
    most = worthwhile()
    while fresh.size and worthwhile() >= most:
        aimed, shooting = _pairs(aims, TreeNodes(tree, fresh))
        pairs = (shooting, aimed) if from_start else (aimed, shooting)
        words = connections(*pairs, radius, space, _WORDS_PER_NODE)
        shooters, aimed_at = (words.exits, words.entries) if from_start else (words.entries, words.exits)
        # What stands between the aim and the end that the wave comes from: a staging pose is before the dock.
        beyond = aims.tree.prices[aimed_at] * speed if from_start else np.where(aimed_at == 0, 0.0, np.inf)
        least = wavefront.lengths(tree.poses[shooters, :2]) - beyond
        long_enough = words.rows(np.flatnonzero(np.abs(words.lengths).sum(axis=1) >= least))
        worth = promising(long_enough, exits.tree, space)
        shots = [Connections.merged([*shots, worth])]
        cheapest = np.full(len(tree), np.inf)
        np.minimum.at(cheapest, shooters, words.prices)
        for bound, row in zip(_bounds(tree, fresh, cheapest, speed, wavefront).tolist(), fresh.tolist(), strict=True):
            if from_start or row > 0:  # what leads into the dock in a gear that it allows is among the entries already
                heapq.heappush(opened, (bound, row))
        looked, shots = shots[0].rows(slice(_SHOTS)), [shots[0].rows(slice(_SHOTS, None))]
        yield from free_manoeuvres(looked, exits.tree, entries.tree, space, effort, worthwhile)
        fresh = fresh[:0]
        while fresh.size == 0 and opened and nodes < effort.nodes:
            rows = np.array([heapq.heappop(opened)[1] for _ in range(min(_EXPANDED, len(opened)))])
            fresh = tree.grow(rows, moves, radius * _STATIONS, space, effort, grid.enter)
            nodes += fresh.size
    for rest in shots:
        yield from free_manoeuvres(rest, exits.tree, entries.tree, space, effort, worthwhile)


def _pairs(aims: TreeNodes, fresh: TreeNodes) -> tuple[TreeNodes, TreeNodes]:
    """The first aim and every node, and every node and one of the other aims."""
    first, others = aims.rows[:1], aims.rows[1:]
    aimed, shooting = np.repeat(first, fresh.rows.size), fresh.rows
    if others.size:
        aimed = np.concatenate((aimed, others[fresh.rows % others.size]))
        shooting = np.concatenate((shooting, shooting))
    return TreeNodes(aims.tree, aimed), TreeNodes(fresh.tree, shooting)


def _bounds(tree: ArcTree, rows: IntArray, cheapest: FloatArray, speed: float, wavefront: Wavefront) -> FloatArray:
    """Estimated prices of the whole manoeuvres through nodes. Shape (n,)."""
    driven = tree.prices[rows]
    left = np.maximum(cheapest[rows] - driven, wavefront.lengths(tree.poses[rows, :2]) / speed)
    found: FloatArray = driven + _GREED * left
    return found
