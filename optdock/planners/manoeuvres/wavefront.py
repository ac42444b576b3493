"""Lengths of the shortest ways around the obstacles for a disc: what hybrid A* expects of what is still to drive.

A wave runs over a coarse grid from one place, alternately to the four and to the eight neighbours of its front, so that
it grows as an octagon: the number of steps is never more than the length in cells, and at most 11 % less. It goes on
only as far as is asked for.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from optdock.geometry.arrays import readonly

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray, IntArray
    from optdock.planners.manoeuvres.distance_field import DistanceField

__all__ = ["Wavefront"]

_FOUR = readonly(np.array([(1, 0), (-1, 0), (0, 1), (0, -1)]))
_EIGHT = readonly(np.concatenate((_FOUR, [(1, 1), (1, -1), (-1, 1), (-1, -1)])))
_BESIDE = 0.75  # cells: half a diagonal, and rounding
_UNREACHED = np.inf


class Wavefront:
    """Steps of a wave from a place.

    Args:
        field: Distances to the obstacles; its grid is the wave's.
        source: Where the wave begins, Shape (2,) [m].
        radius: Of the disc, whose centre must keep this distance but for what a grid point may lie beside a way [m].
    """

    def __init__(self, field: DistanceField, source: FloatArray, radius: float) -> None:
        self._field, self._radius = field, radius
        self._steps = np.full((field.side, field.side), _UNREACHED)
        self._front: IntArray = np.rint((source - field.origin) / field.spacing).astype(np.int64)[None]
        self._steps[tuple(self._front.T)] = 0.0
        self._count = 0

    def lengths(self, points: FloatArray) -> FloatArray:
        """Lower bounds of the lengths of ways to points, Shape (n, 2) [m]; infinite where there is none. Shape (n,)."""
        field = self._field
        index = np.clip(np.rint((points - field.origin) / field.spacing), 0, field.side - 1).astype(np.int64)
        rows, columns = index.T
        while len(self._front) and np.isinf(self._steps[rows, columns]).any():
            field.poll()
            self._advance()
        reached: FloatArray = np.maximum(self._steps[rows, columns] - 1.0, 0.0) * field.spacing
        return reached

    def way(self, point: FloatArray) -> FloatArray | None:
        """Grid points of a shortest way to a point, Shape (2,); None where there is none. Shape (n, 2) [m]."""
        if np.isinf(self.lengths(point[None])[0]):
            return None
        field = self._field
        cell = np.clip(np.rint((point - field.origin) / field.spacing), 0, field.side - 1).astype(np.int64)
        cells = [cell]
        while self._steps[tuple(cell)] > 0.0:
            around = np.clip(cell + _EIGHT, 0, field.side - 1)
            cell = around[np.argmin(self._steps[tuple(around.T)])]
            cells.append(cell)
        way: FloatArray = field.origin + field.spacing * np.array(cells[::-1])
        return way

    def _advance(self) -> None:
        around = _FOUR if self._count % 2 else _EIGHT
        self._count += 1
        cells = (self._front[:, None] + around).reshape(-1, 2)
        inside = np.all((cells >= 0) & (cells < self._field.side), axis=1)
        cells = cells[inside]
        cells = cells[np.isinf(self._steps[cells[:, 0], cells[:, 1]])]
        flat = np.unique(cells[:, 0] * self._field.side + cells[:, 1])
        cells = np.column_stack(np.divmod(flat, self._field.side))
        free = self._field.at(cells) + _BESIDE * self._field.spacing >= self._radius
        cells = cells[free]
        self._steps[cells[:, 0], cells[:, 1]] = self._count
        self._front = cells
