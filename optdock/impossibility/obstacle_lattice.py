"""Distances from obstacles on a lattice of positions, from which the clearances of the discs of a body are read."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from optdock.kernels import Kernel, twin_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from optdock.geometry.arrays import BoolArray, FloatArray, IntArray
    from optdock.model.problem import DockingProblem

__all__ = ["ObstacleLattice", "least_and_most", "to_obstacles"]

_COMPARED = 250_000  # pairs of a node and a column per vectorized step, about a millisecond


class ObstacleLattice:
    """Obstacles of a problem relative to an origin, Shape (2,) [m]; `look` is called every few milliseconds."""

    def __init__(self, problem: DockingProblem, origin: FloatArray, look: Callable[[], None]) -> None:
        everything, self.look = problem.all_obstacles, look
        self.normals, self.vertices = everything.normals, everything.vertices - origin
        self.offsets = (self.normals * self.vertices).sum(axis=2)
        self.lower, self.upper = everything.lower - origin, everything.upper - origin

    def distances(self, corner: FloatArray, step: float, count: int) -> FloatArray:
        """Return upper bounds of the distances of lattice nodes from the obstacles, Shape (count, count) [m].

        Rows run along y. The distance of a node is measured to an obstacle point, namely the point next to the closest
        node at an obstacle. Obstacles outside the lattice are ignored.
        """
        self.look()
        found = _distances(self, corner, step, count)
        self.look()
        return found

    def covered(self, corner: FloatArray, step: float, count: int) -> IntArray:
        """Return the nodes inside obstacles: rows, first columns, and columns after the last ones, Shape (n, 3)."""
        low, high = (self.lower - corner) / step, (self.upper - corner) / step
        met = ((high >= 0.0) & (low <= count - 1)).all(axis=1).nonzero()[0]
        first = np.ceil(low[met, 1].clip(0, count - 1)).astype(np.int64)
        number = np.maximum(np.floor(high[met, 1].clip(0, count - 1)).astype(np.int64) + 1 - first, 0)
        piece = np.arange(met.size).repeat(number)
        row = np.arange(piece.size) - (number.cumsum() - number).repeat(number) + first[piece]
        nx, ny = self.normals[met].transpose(2, 0, 1)
        offset = self.offsets[met] - (nx * corner[0] + ny * corner[1])
        # An edge with its normal along y admits all or none of a row.
        room, inf = offset[piece] - ny[piece] * (step * row)[:, None], np.inf
        steep, is_along = step * nx[piece], nx[piece] == 0.0
        bound = np.divide(room, steep, out=np.where(room < 0.0, -inf, inf), where=~is_along)
        until = np.where((steep > 0.0) | is_along, bound, inf).min(axis=1, initial=inf)
        since = np.where(steep < 0.0, bound, -inf).max(axis=1, initial=-inf)
        begin = np.ceil(since.clip(0, count)).astype(np.int64)
        stop = np.maximum(np.floor(until.clip(-1, count - 1)).astype(np.int64) + 1, begin)
        return np.column_stack((row, begin, stop))

    def samples(self, corner: FloatArray, extent: float, spacing: float) -> FloatArray:
        """Return points of the outlines clipped to a square ([Liang1984]), at most `spacing` apart, Shape (n, 2)."""
        start, end = self.vertices.reshape(-1, 2), np.roll(self.vertices, -1, axis=1).reshape(-1, 2)
        low, high = np.minimum(start, end), np.maximum(start, end)
        rows = ((low <= corner + extent) & (high >= corner) & (low != high).any(axis=1, keepdims=True)).all(axis=1)
        start, along = start[rows] - corner, (end - start)[rows]
        with np.errstate(divide="ignore", invalid="ignore"):
            first, second = -start / along, (extent - start) / along
        still = along == 0.0
        enter = np.where(still, 0.0, np.minimum(first, second)).max(axis=1, initial=0.0)
        leave = np.where(still, 1.0, np.maximum(first, second)).min(axis=1, initial=1.0)
        kept = enter <= leave
        enter, leave, start, along = enter[kept], leave[kept], start[kept], along[kept]
        number = np.ceil((leave - enter) * np.hypot(*along.T) / spacing).astype(np.int64) + 1
        edge = np.arange(number.size).repeat(number)
        place = (np.arange(edge.size) - (number.cumsum() - number).repeat(number)) / np.maximum(number - 1, 1)[edge]
        share = enter[edge] + place * (leave - enter)[edge]
        points: FloatArray = np.clip(start[edge] + share[:, None] * along[edge], 0.0, extent)
        return points


_DISTANCES = Kernel("optdock_lattice_distances", sizes=3, numbers=3)
_CLEARANCES = Kernel("optdock_lattice_clearances", sizes=4, numbers=0)


def _distances_native(lattice: ObstacleLattice, corner: FloatArray, step: float, count: int) -> FloatArray:
    """Return the result of `_distances`, computed in C; its arrays are described there."""
    (m, q, _), found = lattice.vertices.shape, np.empty((count, count))
    arrays = (
        (lattice.normals, 2 * m * q),
        (lattice.offsets, m * q),
        (lattice.lower, 2 * m),
        (lattice.upper, 2 * m),
        (lattice.vertices, 2 * m * q),
        (np.empty((count, count, 2)), 2 * count * count),
        (np.empty((3, count, count), dtype=np.int64), 3 * count * count),
        (np.empty((3, count), dtype=np.int64), 3 * count),
        (found, count * count),
    )
    _DISTANCES((count, m, q), (step, *corner.tolist()), arrays)
    return found


@twin_of(_distances_native)
def _distances(lattice: ObstacleLattice, corner: FloatArray, step: float, count: int) -> FloatArray:
    covered = lattice.covered(corner, step, count)
    samples = lattice.samples(corner, step * (count - 1), 0.5 * step)
    lattice.look()
    return to_obstacles(covered, samples, step, count, lattice.look)


def to_obstacles(
    covered: IntArray, samples: FloatArray, step: float, count: int, look: Callable[[], None]
) -> FloatArray:
    """Return the distances of nodes from the obstacle points of the closest sites, Shape (count, count) [m].

    Sites are the nodes inside obstacles, `covered`, Shape (n, 3), and those next to `samples` of the outlines, Shape
    (k, 2), whose points are the samples. Of equally close sites of a row the left one counts, of a column the upper
    one.
    """
    change = np.zeros((count, count + 1), dtype=np.int64)
    np.add.at(change, (covered[:, 0], covered[:, 1]), 1)
    np.add.at(change, (covered[:, 0], covered[:, 2]), -1)
    inside = change.cumsum(axis=1)[:, :-1] > 0
    column, row = np.rint(samples / step).astype(np.int64).T
    x, y = np.meshgrid(step * np.arange(count), step * np.arange(count))
    at_x, at_y, is_site = x.copy(), y.copy(), inside.copy()
    at_x[row, column], at_y[row, column] = samples.T
    is_site[row, column] = True
    if not is_site.any():
        return np.full((count, count), np.inf)
    rows = _nearest_in_column(is_site)
    columns = np.empty_like(rows)
    apart = np.where(rows < 0, 4 * count, np.abs(rows - np.arange(count)[:, None]))
    to_column = (np.arange(count)[:, None] - np.arange(count)) ** 2
    chunk = max(1, _COMPARED // count**2)
    for k in range(0, count, chunk):
        columns[k : k + chunk] = (to_column + apart[k : k + chunk, None, :] ** 2).argmin(axis=2)
        look()
    nearest = np.take_along_axis(rows, columns, axis=1) * count + columns
    right, up = x - at_x.take(nearest), y - at_y.take(nearest)
    found: FloatArray = np.sqrt(right * right + up * up)
    found[inside] = 0.0
    return found


def _nearest_in_column(is_site: BoolArray) -> IntArray:
    """Return the row of the nearest site in the column of every node, the upper one of two; -1 without a site."""
    count = len(is_site)
    row = np.arange(count)[:, None]
    above = np.maximum.accumulate(np.where(is_site, row, -1), axis=0)
    below = np.minimum.accumulate(np.where(is_site, row, 4 * count)[::-1], axis=0)[::-1]
    is_below = (below < count) & ((above < 0) | (below - row < row - above))
    nearest: IntArray = np.where(is_below, below, above)
    return nearest


def _least_and_most_native(
    distance: FloatArray, at: IntArray, shift: IntArray, radius: FloatArray, moved: FloatArray
) -> tuple[FloatArray, FloatArray]:
    headings, cells, discs = len(shift), at.size, radius.size
    least, most = np.empty((headings, cells)), np.empty((headings, cells))
    arrays = (
        (at, cells),
        (np.ascontiguousarray(shift), headings * discs),
        (distance, distance.size),
        (np.ascontiguousarray(radius), discs),
        (moved, discs),
        (least, headings * cells),
        (most, headings * cells),
    )
    if _CLEARANCES((headings, cells, discs, distance.size), (), arrays):
        raise IndexError("a disc is outside the lattice")
    return least, most


@twin_of(_least_and_most_native)
def least_and_most(
    distance: FloatArray, at: IntArray, shift: IntArray, radius: FloatArray, moved: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the smallest clearance of the discs for each heading and cell, and an upper bound within the cell.

    Args:
        distance: Distances of the nodes from the obstacles, Shape (nodes,) [m].
        at: Nodes at the middles of the cells, Shape (cells,).
        shift: From these nodes to those of the discs, Shape (headings, discs).
        radius: Radii of the discs, Shape (discs,) [m].
        moved: Largest displacements of the discs within a cell, Shape (discs,) [m].

    Returns:
        Shape (headings, cells) each [m].

    Raises:
        IndexError: If a disc is outside the lattice.
    """
    read = distance.take(at + shift[:, :, None])
    read -= radius[:, None]
    least = read.min(axis=1)
    read += moved[:, None]
    return least, read.min(axis=1)
