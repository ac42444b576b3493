"""Hybrid A* from one end to the other, with many nodes per step and Reeds-Shepp words as analytic expansions.

The search of [Dolgov2010] expands poses that are not rounded to a grid, keeps one node per cell of a pose grid, and
tries the shortest path from a node to the goal without regard to obstacles. Here the search begins at the tighter end,
usually the goal, and each new node is joined to the other end by the cheapest words. The cost to go is the larger of
the cheapest word and the length of the shortest route of a disc among the obstacles.
"""

from __future__ import annotations

import heapq
from typing import TYPE_CHECKING

import numpy as np

from optdock.geometry.arrays import readonly
from optdock.planners.manoeuvres.arcs import moves_of
from optdock.planners.manoeuvres.connections import Connections, TreeNodes, connections, free_manoeuvres, promising

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from optdock.geometry.arrays import BoolArray, FloatArray
    from optdock.planners.manoeuvres.arcs import Arcs
    from optdock.planners.manoeuvres.disc_routes import Wavefront
    from optdock.planners.manoeuvres.free_space import Effort, FreeSpace

__all__ = ["FULL_LOCK", "PoseGrid", "hybrid_a_star"]

_EXPANDED = 24  # nodes per expansion
_WORDS_PER_NODE = 4
_SHOTS = 48  # words checked after each expansion
_YAWS_PER_CELL = 6  # headings of the pose grid divided by its fineness
# Distances to obstacles, in reaches of the distance field, above which cells are larger, and their factors.
_ROOM, _COARSER, _COARSEST_YAW = readonly(np.array([0.3, 0.5])), readonly(np.array([1.0, 4.0, 10.0])), 4.0
_GREED = 2.5  # weight of the cost to go
FULL_LOCK = 1.0, -1.0  # left and right, in curvatures of the smallest radius
_STATIONS = readonly(np.array([0.25, 0.5, 1.0, 2.0]))  # distances of nodes along an arc, in turning radii


class PoseGrid:
    """Grid of pose cells, fine near obstacles and coarse in open space, with at most one node per cell.

    The smallest cells are the width of the robot divided by `fineness`.
    """

    def __init__(self, space: FreeSpace, fineness: int) -> None:
        self._field = space.field
        self._fine, self._headings = space.width / fineness, _YAWS_PER_CELL * fineness
        self._seen: set[int] = set()

    def enter(self, poses: FloatArray) -> BoolArray:
        """Return a mask of the poses, Shape (n, 3), that are the first in their cells; mark the cells. Shape (n,)."""
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
    """Yield free manoeuvres from start to goal as they are found.

    The first manoeuvre found is seldom the best. Once there is a plan, no more nodes are added to the tree, but the
    remaining words are tried while they may be cheaper.

    Args:
        exits: The start and other nodes of its tree. Every node of the search is joined to the start and to one of the
            other nodes of this tree, in turn.
        entries: Nodes of the goal's tree from which the search continues; nodes are added to this tree.
        space: Free space.
        effort: Turning radius, resolution and number of nodes.
        wavefront: Wavefront from the end where the search does not begin.
        worthwhile: Function that returns the price at or above which a manoeuvre is useless; infinite while there is no
            plan.
        from_start: Whether to grow the start's tree instead and join its nodes to the entries.
        bends: Curvatures of the arcs that are used in addition to straight lines, relative to the curvature of the
            smallest radius.
    """
    growing, aims = (exits, entries) if from_start else (entries, exits)
    tree, limits, radius = growing.tree, space.problem.robot.limits, effort.radius
    speed = max(limits.max_speed, limits.max_reverse_speed)
    grid = PoseGrid(space, effort.fineness)
    grid.enter(tree.poses)
    moves = moves_of((1.0, -1.0), (0.0, *(bend / radius for bend in bends)))
    opened: list[tuple[float, int]] = []
    shots: list[Connections] = []
    fresh, nodes = growing.rows, 0
    most = worthwhile()
    while fresh.size and worthwhile() >= most:
        aimed, shooting = _pairs(aims, TreeNodes(tree, fresh))
        pairs = (shooting, aimed) if from_start else (aimed, shooting)
        words = connections(*pairs, radius, space, _WORDS_PER_NODE)
        shooters, aimed_at = (words.exits, words.entries) if from_start else (words.entries, words.exits)
        # Distance between the target and the source of the wavefront: a staging pose lies in front of the dock.
        beyond = aims.tree.prices[aimed_at] * speed if from_start else np.where(aimed_at == 0, 0.0, np.inf)
        routes, cheapest = np.empty(len(tree)), np.full(len(tree), np.inf)
        routes[fresh] = wavefront.lengths(tree.poses[fresh, :2])
        long_enough = words.rows(np.flatnonzero(np.abs(words.lengths).sum(axis=1) >= routes[shooters] - beyond))
        worth = promising(long_enough, exits.tree, space)
        shots = [Connections.merged([*shots, worth])]
        np.minimum.at(cheapest, shooters, words.prices)
        space.poll()
        left = np.maximum(cheapest[fresh] - tree.prices[fresh], routes[fresh] / speed)
        for bound, row in zip((tree.prices[fresh] + _GREED * left).tolist(), fresh.tolist(), strict=True):
            if from_start or row > 0:  # the entries already contain the motions into the dock in an allowed gear
                heapq.heappush(opened, (bound, row))
        cheap, shots = shots[0].rows(slice(_SHOTS)), [shots[0].rows(slice(_SHOTS, None))]
        yield from free_manoeuvres(cheap, exits.tree, entries.tree, space, effort, worthwhile)
        fresh = fresh[:0]
        while fresh.size == 0 and opened and nodes < effort.nodes:
            rows = np.array([heapq.heappop(opened)[1] for _ in range(min(_EXPANDED, len(opened)))])
            fresh = tree.grow(rows, moves, radius * _STATIONS, space, effort, grid.enter)
            nodes += fresh.size
    for rest in shots:
        yield from free_manoeuvres(rest, exits.tree, entries.tree, space, effort, worthwhile)


def _pairs(aims: TreeNodes, fresh: TreeNodes) -> tuple[TreeNodes, TreeNodes]:
    """Return pairs: the first target with every node, and every node with one of the other targets."""
    first, others = aims.rows[:1], aims.rows[1:]
    aimed, shooting = np.repeat(first, fresh.rows.size), fresh.rows
    if others.size:
        aimed = np.concatenate((aimed, others[fresh.rows % others.size]))
        shooting = np.concatenate((shooting, shooting))
    return TreeNodes(aims.tree, aimed), TreeNodes(fresh.tree, shooting)
