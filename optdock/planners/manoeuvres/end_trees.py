"""Straight lines and arcs that leave the start and the dock, whose ends are connected by the search.

A robot alongside a wall cannot turn away from the wall at full lock, because its tail would hit the wall. If the tail
may come a few millimetres closer, the robot can follow the wall while heading and curvature grow exponentially
(equation (R9) of `docs/theory/search.md`). This motion is approximated by chains of short arcs, each as sharp as the
wall allows.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.geometry.arrays import readonly
from optdock.model.dock import DockDirection
from optdock.planners.manoeuvres.arcs import ArcTree, advance, moves_of
from optdock.planners.manoeuvres.connections import TreeNodes
from optdock.planners.manoeuvres.hybrid_a_star import FULL_LOCK, PoseGrid

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray, IntArray
    from optdock.model.dock import Dock
    from optdock.model.problem import DockingProblem
    from optdock.planners.manoeuvres.free_space import Effort, FreeSpace

__all__ = ["BOTH", "EXIT_TURN", "GENTLE", "ROOT", "EndTrees", "gears_into", "sharpest_arcs", "turning_radius"]

# Straight runs in addition to the shortest one, in turning radii.
_RUNS = readonly(np.array([0.0, 0.25, 0.5, 1.0, 1.5, 2.0, 3.0]))
EXIT_TURN = 1.0  # [rad] of arcs out of the start; straight lines are as long
# A robot a few millimetres from a wall cannot turn away from it at full lock: its tail would hit the wall.
GENTLE = (*FULL_LOCK, 0.1, -0.1, 0.015, -0.015)
BOTH = 1.0, -1.0  # gears, or sides
ROOT = readonly(np.zeros(1, dtype=np.int64))  # row of the root of a tree
# Free share of the first arcs below which the start is a slot; most strokes at full lock; least turn of each [rad].
_SLOT, _MOST_STROKES, _LEAST_TURN = 0.15, 30, 0.01
_FREE_EXITS, _MOST_EXITS = 4, 60  # free exits of six that are enough; nodes above which the start's tree stops growing
# Straight runs out of the start before a turn in place, in circumscribed radii, to leave obstacles at the sides.
_TURN_EXITS = readonly(np.array([0.5, 1.0, 1.5, 2.0, 3.0]))
_NO_MORE = readonly(np.zeros(0))
# Sharpest arcs: length in circumscribed radii, arcs of a chain; trial curvatures in those of the smallest radius, then
# factors of the sharpest free one.
_LENGTH, _MOST = 0.25, 24
_COARSE = readonly(2.0 ** -np.arange(0.0, 12.0))
_FINE = readonly(2.0 ** (-np.arange(-7.0, 5.0) / 8.0))
_FEW_POSES, _CLOSE, _MOST_POSES = 4, 60.0, 40  # per arc in the coarse check; per robot width, per arc in the fine one
_AT_ONCE = 2000  # poses per collision check, one to two milliseconds
_MARGIN = 1e-4  # [m]: margin for the smoother, larger than the change of clearance between two poses


class Exits(NamedTuple):
    """Paths out of the start with the given curvatures, and the mean free length of their first arcs [m]."""

    nodes: TreeNodes
    bends: tuple[float, ...]
    room: float


class EndTrees:
    """The trees of arcs at the start and at the dock of one problem."""

    def __init__(self, problem: DockingProblem, space: FreeSpace) -> None:
        self.problem, self.space = problem, space
        self.radius = turning_radius(problem)
        rate = problem.robot.limits.max_curvature_rate
        # Half of the distance in which the steering angle is reached lies before the arc.
        self._wind_up = 0.5 / (self.radius * rate) if math.isfinite(rate) else 0.0
        self._by_effort: dict[tuple[Effort, tuple[float, ...]], Exits] = {}
        # Signs of the lengths of the first motion, and of the last one backwards in time.
        speed = problem.start_speed
        self.start_gears = BOTH if speed == 0.0 else (math.copysign(1.0, speed),)
        self._out_of_dock = tuple(-gear for gear in gears_into(problem.dock))

    def from_start(self) -> ArcTree:
        """Return a tree with the start as its only node."""
        return ArcTree(self.problem.start.as_array(), self.problem.robot, 1)

    def _from_goal(self) -> ArcTree:
        return ArcTree(self.problem.goal.as_array(), self.problem.robot, -1)

    def straight_exits(self, effort: Effort, more: FloatArray) -> TreeNodes:
        """Return nodes at the start and along the free straight lines out of the start; for `more` see `staging`."""
        tree = self.from_start()
        stations = np.unique(np.concatenate((self.space.footprint.circumscribed_radius * _TURN_EXITS, more)))
        tree.grow(ROOT, moves_of((1.0, -1.0), (0.0,)), stations, self.space, effort)
        return TreeNodes(tree, np.arange(len(tree)))

    def straight_runs(self, effort: Effort) -> dict[str, float]:
        """Return the free length [m] in front of the dock in each gear, up to the final straight plus two radii."""
        tree = self._from_goal()
        longest = np.array([self.problem.dock.final_straight + 2.0 * self.radius])
        tree.grow(ROOT, moves_of((-1.0, 1.0), (0.0,)), longest, self.space, effort)
        return {
            DockDirection.FORWARD.value: float(-min(tree.lengths)),
            DockDirection.BACKWARD.value: float(max(tree.lengths)),
        }

    def staging(self, effort: Effort, more: FloatArray = _NO_MORE) -> TreeNodes:
        """Return nodes along the free straight lines out of the dock at which the final straight may begin.

        `more`: additional distances from the dock at which nodes are placed [m].
        """
        tree, straight = self._from_goal(), self.problem.dock.final_straight
        stations = straight + self._wind_up + self.radius * _RUNS
        if more.size:
            stations = np.unique(np.concatenate((stations, more[more > straight])))
        if straight > 0.0:
            stations = np.concatenate(([straight], stations))
        rows = tree.grow(ROOT, moves_of(self._out_of_dock, (0.0,)), stations, self.space, effort)
        rows = rows[np.abs(tree.lengths[rows]) >= straight]
        return TreeNodes(tree, rows if straight > 0.0 else np.concatenate(([0], rows)))

    def exits(self, effort: Effort, bends: tuple[float, ...] = FULL_LOCK) -> Exits:
        """Return the start and the ends of free arcs and lines from it, with more arcs in narrow areas; cached."""
        key = effort._replace(nodes=0), bends
        if key not in self._by_effort:
            tree = self.from_start()
            rows, room = self.grown(TreeNodes(tree, ROOT), self.start_gears, effort, bends)
            self._by_effort[key] = Exits(TreeNodes(tree, np.concatenate((ROOT, rows))), bends, room)
        return self._by_effort[key]

    def entries(self, effort: Effort) -> TreeNodes:
        """Return the staging poses and, if there is no final straight, also the ends of arcs into the dock."""
        tree, rows = self.staging(effort)
        if self.problem.dock.final_straight > 0.0:
            return TreeNodes(tree, rows)
        arcs = moves_of(self._out_of_dock, (1.0 / effort.radius, -1.0 / effort.radius))
        return TreeNodes(tree, np.append(rows, tree.grow(ROOT, arcs, self.radius * _RUNS[1:], self.space, effort)))

    def grown(
        self, end: TreeNodes, gears: tuple[float, ...], effort: Effort, bends: tuple[float, ...] = FULL_LOCK
    ) -> tuple[IntArray, float]:
        """Grow arcs and lines out of the nodes of an end, in several generations if almost all are blocked.

        Returns the rows of the new nodes, empty if all arcs are blocked, and the mean free length of the first arcs
        [m].
        `gears`: signs of the first lengths. `bends`: curvatures of the arcs, relative to the curvature of the smallest
        radius.
        """
        tree, first = end
        station, grid = np.array([effort.radius * EXIT_TURN]), PoseGrid(self.space, effort.fineness)
        moves, onwards = (moves_of(signs, (0.0, *(bend / effort.radius for bend in bends))) for signs in (gears, BOTH))
        rows = fresh = tree.grow(first, moves, station, self.space, effort)
        lengths = np.abs(tree.lengths[rows])
        room = float(lengths.sum()) / (len(moves) * first.size)
        if first.size == 1 and room < _SLOT * station[0] and effort.margin > 0.0:
            return self._strokes(tree, gears, effort), room
        is_boxed_in = np.sum(lengths >= station) < _FREE_EXITS * first.size
        while is_boxed_in and fresh.size and rows.size < _MOST_EXITS:
            fresh = tree.grow(fresh, onwards, station, self.space, effort, grid.enter)
            rows = np.concatenate((rows, fresh))
        if first.size == 1 and room < _SLOT * station[0]:
            rows = np.concatenate((self._strokes(tree, gears, effort), rows))
        return rows if fresh.size else fresh, room

    def _strokes(self, tree: ArcTree, gears: tuple[float, ...], effort: Effort) -> IntArray:
        """Grow arcs at full lock in alternating gears, all turning the robot one way, as a car leaves a short slot."""
        station, found = np.array([effort.radius * EXIT_TURN]), []
        for side in BOTH:
            for gear in gears:
                move, way = moves_of((gear,), (side / effort.radius,)), [0]
                while len(way) <= _MOST_STROKES and abs(tree.lengths[way[-1]]) < station[0]:
                    fresh = tree.grow(np.array(way[-1:]), move, station, self.space, effort)
                    if fresh.size == 0 or abs(tree.lengths[fresh[-1]] * move[0, 1]) < _LEAST_TURN:
                        break
                    way.append(int(fresh[-1]))
                    move = -move
                if abs(tree.lengths[way[-1]]) >= station[0]:
                    found += way[1:]
                    break
        return np.array(found[::-1], dtype=np.int64)

    def room_before_dock(self, effort: Effort) -> float:
        """Return the mean free length of the last arcs [m]; `grown` returns the mean of the first arcs."""
        tree = self._from_goal()
        moves = moves_of(self._out_of_dock, (0.0, 1.0 / effort.radius, -1.0 / effort.radius))
        tree.grow(ROOT, moves, np.array([effort.radius * EXIT_TURN]), self.space, effort)
        return float(np.abs(tree.lengths).sum()) / len(moves)


def turning_radius(problem: DockingProblem) -> float:
    """Return the smallest turning radius [m] that the search uses.

    Turns gain little if they are sharper than the curvature rate allows within one radian, or if their centre is within
    the robot.
    """
    limits = problem.robot.limits
    sharpest = min(limits.max_curvature, 2.0 / problem.robot.footprint.circumscribed_radius)
    return 1.0 / min(sharpest, math.sqrt(2.0 * limits.max_curvature_rate))


def gears_into(dock: Dock) -> tuple[float, ...]:
    """Return the signs that the length of the last motion into a dock may have."""
    return {DockDirection.FORWARD: (1.0,), DockDirection.BACKWARD: (-1.0,)}.get(dock.direction, BOTH)


def sharpest_arcs(tree: ArcTree, rows: IntArray, gears: FloatArray, space: FreeSpace, effort: Effort) -> IntArray:
    """Grow chains of arcs to either side until full lock is free; return the rows at the ends of full-lock arcs.

    The chains begin at the nodes `rows`, Shape (n,); `gears` are the signs of their lengths, Shape (n,).
    """
    node, sign, side = np.repeat(rows, 2), np.repeat(gears, 2), np.tile([1.0, -1.0], rows.size)
    length, full = _LENGTH * space.footprint.circumscribed_radius, 1.0 / effort.radius
    many = min(int(np.ceil(length * _CLOSE / space.width)), _MOST_POSES)
    coarse, close = (length * np.arange(1, n + 1) / n for n in (_FEW_POSES, many))

    def sharpest(curvatures: FloatArray, stations: FloatArray, margin: float) -> IntArray:
        """Return the first column of curvatures (k, m) at which an arc is free, m if all are blocked. Shape (k,)."""
        found = np.empty(node.size, dtype=np.int64)
        step = max(1, _AT_ONCE // (curvatures.shape[1] * stations.size))
        for some in (slice(k, k + step) for k in range(0, node.size, step)):
            space.poll()
            bends = side[some, None, None] * curvatures[some, :, None]
            poses = advance(tree.poses[node[some], None, None], sign[some, None, None] * stations, bends)
            free = space.is_free(poses.reshape(-1, 3), margin, effort.start_relief).reshape(poses.shape[:3])
            is_free = np.column_stack((free.all(axis=2), np.ones(len(free), dtype=np.bool_)))
            found[some] = is_free.argmax(axis=1)
        return found

    ends = [rows[:0]]
    for _ in range(_MOST):
        first = sharpest(np.tile(full * _COARSE, (node.size, 1)), coarse, 0.0)
        finer = np.minimum(full * np.append(_COARSE, 0.0)[first, None] * _FINE, full)
        best = sharpest(finer, close, _MARGIN)
        kept = (first < _COARSE.size) & (best < _FINE.size)
        if not kept.any():
            break
        fresh = tree.add(node[kept], sign[kept] * length, side[kept] * finer[kept, best[kept]])
        is_full = np.abs(tree.curvatures[fresh]) == full
        ends.append(fresh[is_full])
        before = tree.parents[tree.parents[fresh]]  # followed by two arcs at full lock if they are free
        node = fresh[~is_full | (before < 0) | (np.abs(tree.curvatures[before]) < full)]
        sign, side = tree.signs[node], np.sign(tree.curvatures[node])
    return np.concatenate(ends)
