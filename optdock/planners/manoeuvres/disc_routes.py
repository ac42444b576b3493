"""Shortest routes of a disc among the obstacles, and routes that keep away from them.

The shortest route of a disc passes corners as closely as possible. An elastic band ([Quinlan1993]) moves this route
towards the middle of the free space, until the robot has enough room to turn everywhere on the route.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.geometry.arrays import readonly
from optdock.kernels import Kernel, twin_of

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray, IntArray
    from optdock.planners.manoeuvres.distance_field import DistanceField
    from optdock.planners.manoeuvres.free_space import FreeSpace

__all__ = ["Wavefront", "arc_lengths", "elastic_band"]

_FOUR = readonly(np.array([(1, 0), (-1, 0), (0, 1), (0, -1)]))
_EIGHT = readonly(np.concatenate((_FOUR, [(1, 1), (1, -1), (-1, 1), (-1, -1)])))
_BESIDE = 0.75  # cells: half a diagonal, and rounding
_MOST_STEPS = 64  # of a wave per call of the kernel, at most a millisecond
# Elastic band: iterations, first step size, factors of the iterations: pushes between two walls overshoot the middle.
_PULLS, _STIFFNESS = 80, 0.5
_DAMPED = readonly(np.geomspace(1.0, 0.1, _PULLS))


class _Wave(NamedTuple):
    """A wave: 1 + the steps to every cell, 0 if not reached, (side, side), its front, ascending, and its steps."""

    steps: FloatArray
    front: IntArray
    taken: int


class Wavefront:
    """Lengths of shortest routes around the obstacles for a disc of a given radius [m], from a source, Shape (2,) [m].

    A wave spreads over the grid, alternately to the four and the eight neighbours of its front, so the front is an
    octagon. The number of steps is a lower bound of the length in cells and is too small by at most 11 %. The wave
    advances on demand.
    """

    def __init__(self, field: DistanceField, source: FloatArray, radius: float) -> None:
        self._field, self._radius = field, radius
        front, steps = self._cells(source[None]), np.zeros((field.side, field.side))
        steps.ravel()[front] = 1.0
        self._wave = _Wave(steps, front, 0)

    def _cells(self, points: FloatArray) -> IntArray:
        """Return the nearest grid points, numbered row by row. Shape (n, 2) to (n,)."""
        field = self._field
        cells = np.minimum(np.maximum(np.rint((points - field.origin) / field.spacing), 0.0), field.side - 1.0)
        found: IntArray = (cells[:, 0] * field.side + cells[:, 1]).astype(np.int64)
        return found

    def _reach(self, cells: IntArray) -> FloatArray:
        """Advance the wave to cells, Shape (n,), and return the numbers of steps to them, -1 if unreachable."""
        reached = self._wave.steps.ravel()[cells]
        if self._wave.front.size and not reached.all():
            self._wave = _spread(self._field, self._radius, self._wave, cells)
            reached = self._wave.steps.ravel()[cells]
        found: FloatArray = reached - 1.0
        return found

    def lengths(self, points: FloatArray) -> FloatArray:
        """Return lower bounds of the lengths of routes to points, Shape (n, 2) to (n,) [m]; infinite if none exists."""
        steps = self._reach(self._cells(points))
        return np.where(steps < 0.0, np.inf, np.maximum(steps - 1.0, 0.0) * self._field.spacing)

    def way(self, point: FloatArray) -> FloatArray | None:
        """Return the grid points of a shortest route to a point, Shape (2,), or None. Shape (n, 2) [m]."""
        cells = self._cells(point[None])
        if self._reach(cells)[0] < 0.0:
            return None
        field = self._field
        found = _way_back(self._wave.steps, int(cells[0]))
        way: FloatArray = field.origin + field.spacing * np.column_stack(np.divmod(found, field.side))
        return way


_SPREAD_KERNEL = Kernel("optdock_spread", sizes=2, numbers=2)


def _spread_native(field: DistanceField, radius: float, wave: _Wave, cells: IntArray) -> _Wave:
    """Return the result of `_spread`, whose steps are those of `wave`, changed in place."""
    size, n = field.side**2, wave.front.size
    queue = np.empty(size, dtype=np.int64)
    queue[:n] = wave.front
    front, progress = np.array((0, n)), np.array((wave.taken, 0, 0))
    arrays = (cells, cells.size), (wave.steps, size), (queue, size), (front, 2)
    numbers = _BESIDE * field.spacing, radius
    while not field.call(_SPREAD_KERNEL, (cells.size, _MOST_STEPS), numbers, arrays, progress):
        pass
    return _Wave(wave.steps, np.sort(queue[slice(*front.tolist())]), int(progress[0]))


@twin_of(
    _spread_native, lambda field, radius, wave, cells: (field, radius, wave._replace(steps=wave.steps.copy()), cells)
)
def _spread(field: DistanceField, radius: float, wave: _Wave, cells: IntArray) -> _Wave:
    """Return the wave at the first step after which all cells, Shape (n,), are reached, or when it has ended."""
    steps, count = wave.steps.copy(), wave.taken
    front = np.column_stack(np.divmod(wave.front, field.side))
    while len(front) and not steps.ravel()[cells].all():
        field.poll()
        around = _FOUR if count % 2 else _EIGHT
        count += 1
        near = (front[:, None] + around).reshape(-1, 2)
        near = near[np.all((near >= 0) & (near < field.side), axis=1)]
        near = near[steps[near[:, 0], near[:, 1]] == 0.0]
        near = np.column_stack(np.divmod(np.unique(near[:, 0] * field.side + near[:, 1]), field.side))
        front = near[field.at(near) + _BESIDE * field.spacing >= radius]
        steps[front[:, 0], front[:, 1]] = count + 1
    return _Wave(steps, front[:, 0] * field.side + front[:, 1], count)


_WAY_KERNEL = Kernel("optdock_way_back", sizes=3, numbers=0)


def _way_back_native(steps: FloatArray, cell: int) -> IntArray:
    way = np.empty(int(steps.ravel()[cell]), dtype=np.int64)
    count = _WAY_KERNEL((len(steps), way.size, cell), (), ((steps, steps.size), (way, way.size)))
    assert count > 0  # every cell that is reached has a neighbour with fewer steps
    return way[:count]


@twin_of(_way_back_native)
def _way_back(steps: FloatArray, cell: int) -> IntArray:
    """Return the cells on a shortest route from the source of a wave to a cell that it has reached. Shape (n,)."""
    side, way = len(steps), [cell]
    while steps.ravel()[way[-1]] > 1.0:
        around = np.clip(np.array(divmod(way[-1], side)) + _EIGHT, 0, side - 1)
        near = steps[tuple(around.T)]
        row, column = around[np.argmin(np.where(near > 0.0, near, np.inf))].tolist()
        way.append(row * side + column)
    return np.array(way[::-1])


def arc_lengths(route: FloatArray) -> FloatArray:
    """Return the distances from the first point along a route, Shape (n, 2) to (n,) [m]."""
    return np.concatenate(([0.0], np.hypot(*(route[1:] - route[:-1]).T).cumsum()))


def elastic_band(route: FloatArray, space: FreeSpace, room: float) -> FloatArray:
    """Return a route, Shape (n, 2) [m], straightened and moved away from obstacles nearer than `room` [m].

    The ends of the route are kept, and its points are about one robot width apart.
    """
    s = arc_lengths(route)
    at = np.linspace(0.0, s[-1], max(3, round(s[-1] / space.width) + 1))
    return _pulled(np.column_stack([np.interp(at, s, route[:, i]) for i in (0, 1)]), space.field, room)


_PULLED_KERNEL = Kernel("optdock_pulled", sizes=2, numbers=3)


def _pulled_native(points: FloatArray, field: DistanceField, room: float) -> FloatArray:
    points, n = np.array(points), len(points)
    moved, progress = np.empty_like(points), np.zeros(3, dtype=np.int64)
    arrays = (_DAMPED, _PULLS), (points, 2 * n), (moved, 2 * n)
    while progress[0] < _PULLS:
        field.call(_PULLED_KERNEL, (n, _PULLS), (2.0 * field.spacing, room, _STIFFNESS), arrays, progress)
    return points


@twin_of(_pulled_native)
def _pulled(points: FloatArray, field: DistanceField, room: float) -> FloatArray:
    """Return the points of an elastic band after all iterations. Shape (n, 2) [m]."""
    points, step = np.array(points), 2.0 * field.spacing
    around = step * np.array([(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)])
    for damped in _DAMPED:
        inner = points[1:-1]
        lower, upper = field.bounds(np.concatenate((inner[None], inner + around[:, None])))
        distance = 0.5 * (lower + upper)
        slope = np.column_stack((distance[1] - distance[2], distance[3] - distance[4])) / (2.0 * step)
        pushed = _STIFFNESS * np.maximum(room - distance[0], 0.0)[:, None] * slope
        pulled = _STIFFNESS * (0.5 * (points[:-2] + points[2:]) - inner)
        points[1:-1] += damped * (pulled + pushed)
    return points
