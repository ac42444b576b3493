"""Trees of arcs that grow from an end pose of a manoeuvre: out of the dock backwards in time, or away from the start.

What grows is the same in both cases; only the direction of driving differs. From a node the robot drives an arc or a
straight line in either gear as far as it is free, and leaves nodes on its way.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.planners.manoeuvres.arcs import Arcs, advance
from optdock.planners.manoeuvres.price import driving_prices, stopping_cost

if TYPE_CHECKING:
    from collections.abc import Callable

    from optdock.geometry.arrays import BoolArray, FloatArray, IntArray
    from optdock.model.robot import Robot
    from optdock.planners.manoeuvres.free_space import Effort, FreeSpace

__all__ = ["ArcTree", "Moves", "joined"]

_BISECTIONS = 4
_STRIDE, _ABREAST = 8, 64  # poses per arc, and arcs, that are checked in one go; blocked arcs are given up after it


class Moves(NamedTuple):
    """What may be driven from every node: signs of the lengths and curvatures, Shape (c,) each [1/m]."""

    signs: FloatArray
    curvatures: FloatArray

    @classmethod
    def of(cls, signs: tuple[float, ...], curvatures: tuple[float, ...]) -> Moves:
        """Every sign with every curvature."""
        grid = np.array([(sign, curvature) for sign in signs for curvature in curvatures])
        return cls(grid[:, 0], grid[:, 1])


class _Starts(NamedTuple):
    """Where arcs begin, and how: poses (n, 3), signs and curvatures (n,)."""

    poses: FloatArray
    signs: FloatArray
    curvatures: FloatArray

    def are_free(self, rows: IntArray, lengths: FloatArray, space: FreeSpace, effort: Effort) -> BoolArray:
        """Whether the poses after lengths, Shape (k,) or (n, k) [m], on the arcs at `rows` are free. Shape (n, k)."""
        space.poll()
        poses = advance(self.poses[rows, None], self.signs[rows, None] * lengths, self.curvatures[rows, None])
        free: BoolArray = space.is_free(poses.reshape(-1, 3), effort.margin, effort.start_relief).reshape(
            poses.shape[:2]
        )
        return free


class ArcTree:
    """Nodes that are reached from a root by free arcs.

    Args:
        root: The pose where it begins, Shape (3,).
        robot: For the prices of its nodes.
        gear: The sign that a positive length has when it is driven: 1 from the start, -1 from the goal, where growing
            is driving back in time.

    Attributes:
        poses: Shape (n, 3).
        prices: Of the way between root and node, Shape (n,) [s].
        signs: Sign of the length of the last arc, 0 at the root. Shape (n,).
    """

    def __init__(self, root: FloatArray, robot: Robot, gear: int) -> None:
        self.gear, self._robot = gear, robot
        self.poses, self.prices, self.signs = root[None].copy(), np.zeros(1), np.zeros(1)
        self.parents = np.full(1, -1)
        self.lengths, self.curvatures = np.zeros(1), np.zeros(1)
        self._stop = stopping_cost(robot.limits)

    def __len__(self) -> int:
        return len(self.poses)

    def grow(
        self,
        rows: IntArray,
        moves: Moves,
        stations: FloatArray,
        space: FreeSpace,
        effort: Effort,
        is_new: Callable[[FloatArray], BoolArray] | None = None,
    ) -> IntArray:
        """Drive all moves from the nodes at `rows`; the rows of the new nodes.

        Args:
            rows: Where to begin.
            moves: What to drive.
            stations: Ascending lengths after which a node is left, and where the last pose was free [m].
            space: What is free.
            effort: How closely to look.
            is_new: Which of the poses found, in ascending order of price, are worth a node; None: all.
        """
        node = np.repeat(rows, moves.signs.size)
        sign, curvature = np.tile(moves.signs, rows.size), np.tile(moves.curvatures, rows.size)
        free = self._free_lengths(_Starts(self.poses[node], sign, curvature), float(stations[-1]), space, effort)
        reached = np.where(stations <= free[:, None] + 1e-12, stations, 0.0)
        # Where the way ends between two stations, its end is one as well.
        last = np.where(reached.max(axis=1) < free - 0.1 * space.spacing(effort), free, 0.0)
        lengths = np.column_stack((reached, last))
        arc, station = np.nonzero(lengths > 0.0)
        return self.add(node[arc], sign[arc] * lengths[arc, station], curvature[arc], is_new)

    @staticmethod
    def _free_lengths(starts: _Starts, longest: float, space: FreeSpace, effort: Effort) -> FloatArray:
        """How far each arc is free, up to `longest`. Shape (n,) [m]."""
        free = np.zeros(starts.signs.size)
        spacing = space.spacing(effort)
        steps = np.append(np.arange(spacing, longest - 1e-9, spacing), longest)
        going, blocked = np.arange(free.size), np.zeros(free.size)
        for k in range(0, steps.size, _STRIDE):
            some = steps[k : k + _STRIDE]
            still = []
            for block in range(0, going.size, _ABREAST):
                mine = going[block : block + _ABREAST]
                good = starts.are_free(mine, some, space, effort)
                count = np.where(good.all(axis=1), some.size, np.argmin(good, axis=1))
                free[mine] = np.where(count > 0, some[np.maximum(count - 1, 0)], free[mine])
                blocked[mine] = some[np.minimum(count, some.size - 1)]
                still.append(mine[count == some.size])
            going = np.concatenate(still) if still else going
        # Between the last free pose and the first blocked one: in a narrow place every centimetre counts.
        ended = np.setdiff1d(np.arange(free.size), going)
        for _ in range(_BISECTIONS if ended.size else 0):
            middle = 0.5 * (free[ended] + blocked[ended])
            good = starts.are_free(ended, middle[:, None], space, effort)[:, 0]
            free[ended] = np.where(good, middle, free[ended])
            blocked[ended] = np.where(good, blocked[ended], middle)
        return free

    def add(
        self,
        parent: IntArray,
        length: FloatArray,
        curvature: FloatArray,
        is_new: Callable[[FloatArray], BoolArray] | None = None,
    ) -> IntArray:
        """The rows of new nodes at the ends of free arcs, Shape (n,) each; `is_new` as of `grow`."""
        sign = np.sign(length)
        driven = driving_prices(self.gear * length, self._robot)
        price = self.prices[parent] + driven + self._stop * (self.signs[parent] * sign < 0.0)
        poses = advance(self.poses[parent], length, curvature)
        order = np.argsort(price, kind="stable")
        kept = order if is_new is None else order[is_new(poses[order])]
        first = len(self)
        self.poses = np.concatenate((self.poses, poses[kept]))
        self.prices = np.concatenate((self.prices, price[kept]))
        self.signs = np.concatenate((self.signs, sign[kept]))
        self.parents = np.concatenate((self.parents, parent[kept]))
        self.lengths = np.concatenate((self.lengths, length[kept]))
        self.curvatures = np.concatenate((self.curvatures, curvature[kept]))
        return np.arange(first, len(self))

    def way(self, row: int) -> tuple[FloatArray, FloatArray]:
        """Lengths and curvatures of the arcs between root and node, as they are driven. Shape (k,) each."""
        lengths, curvatures = [], []
        while row > 0:
            lengths.append(self.lengths[row])
            curvatures.append(self.curvatures[row])
            row = int(self.parents[row])
        found = np.array(lengths, dtype=np.float64), np.array(curvatures, dtype=np.float64)
        # From node to root is how the way out of the goal is driven, its lengths the other way round.
        return (-found[0], found[1]) if self.gear < 0 else (found[0][::-1], found[1][::-1])


def joined(start: FloatArray, *parts: tuple[FloatArray, FloatArray]) -> Arcs:
    """Ways one after the other, as one sequence of arcs from a pose."""
    lengths, curvatures = (np.concatenate([part[i] for part in parts])[None] for i in (0, 1))
    return Arcs(start[None], lengths, curvatures)
