"""Which cells a line, a convex polygon or a footprint meets, for many at once."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.geometry.pose import transform_points

if TYPE_CHECKING:
    from collections.abc import Iterator

    from optdock.geometry.arrays import BoolArray, FloatArray, IntArray
    from optdock.geometry.footprint import Footprint
    from optdock.geometry.pose import Pose2
    from optdock.model.costmap import Costmap

__all__ = ["CellList", "cells_of_lines", "cells_of_polygons", "corners_of", "fill_footprint"]

_BLOCK = 2_000_000  # cells looked at together; bounds the memory
_SLACK = 1e-9  # in cells; what touches counts as met in spite of rounding


class CellList(NamedTuple):
    """Cells (i, j), Shape (m, 2), and the index of the line or polygon each belongs to, Shape (m,), ascending."""

    cells: IntArray
    owner: IntArray


def cells_of_lines(starts: IntArray, ends: IntArray) -> CellList:
    """The cells of Bresenham lines, both ends included, from start to end (Nav2: `LineIterator`).

    Args:
        starts: Shape (n, 2), cells (i, j).
        ends: Shape (n, 2).
    """
    move = ends - starts
    size, sign = np.abs(move), np.sign(move)
    steps = size.max(axis=1, initial=0)
    counts = steps + 1
    owner = np.repeat(np.arange(len(starts)), counts)
    t = np.arange(owner.size) - np.repeat(np.cumsum(counts) - counts, counts)
    minor_size = size.min(axis=1, initial=np.iinfo(np.int64).max)
    minor = (steps[owner] // 2 + t * minor_size[owner]) // np.maximum(steps[owner], 1)
    is_x_major = (size[:, 0] >= size[:, 1])[owner]
    offset = np.column_stack((np.where(is_x_major, t, minor), np.where(is_x_major, minor, t)))
    return CellList(starts[owner] + sign[owner] * offset, owner)


def cells_of_polygons(vertices: FloatArray) -> CellList:
    """The cells that convex polygons meet, inside included.

    A cell owns its lower and left sides: cell i spans [i, i + 1), as in `floor`. Exact by separating axes: a square
    and a convex polygon are apart only along a side of either.

    Args:
        vertices: Shape (n, k, 2), counter-clockwise, in cells from the grid's origin.
    """
    low = np.floor(vertices.min(axis=1)).astype(np.int64)
    spans = np.floor(vertices.max(axis=1)).astype(np.int64) - low + 1
    cells, owners = [np.zeros((0, 2), dtype=np.int64)], [np.zeros(0, dtype=np.int64)]
    for block in _blocks(spans):
        grid = spans[block].max(axis=0)
        which, j, i = np.nonzero(_meets(vertices[block], low[block], spans[block], grid))
        cells.append(low[block][which] + np.column_stack((i, j)))
        owners.append(which + block.start)
    return CellList(np.concatenate(cells), np.concatenate(owners))


def _blocks(spans: IntArray) -> Iterator[slice]:
    """Slices of the polygons that together need at most about `_BLOCK` cells."""
    if not len(spans):
        return
    step = max(1, _BLOCK // int(np.prod(spans.max(axis=0))))
    for start in range(0, len(spans), step):
        yield slice(start, min(start + step, len(spans)))


def _meets(vertices: FloatArray, low: IntArray, spans: IntArray, grid: IntArray) -> BoolArray:
    """Whether polygon p meets cell low[p] + (i, j), Shape (p, rows, columns) of a common grid."""
    i, j = np.arange(grid[0]), np.arange(grid[1])
    meets: BoolArray = (i < spans[:, None, 0])[:, None, :] & (j < spans[:, None, 1])[:, :, None]
    x, y = i + 0.5 + low[:, None, 0], j + 0.5 + low[:, None, 1]
    edges = np.roll(vertices, -1, axis=1) - vertices
    for k in range(vertices.shape[1]):
        start, edge = vertices[:, k], edges[:, k]
        # Outward normal (dy, -dx); the square's lowest point along it is half a cell per axis below its centre.
        along_x = edge[:, 1, None] * (x - start[:, 0, None])
        along_y = -edge[:, 0, None] * (y - start[:, 1, None])
        reach = 0.5 * np.abs(edge).sum(axis=1) + _SLACK * np.hypot(edge[:, 0], edge[:, 1])
        meets &= along_x[:, None, :] + along_y[:, :, None] <= reach[:, None, None]
    return meets


def corners_of(footprint: Footprint, pose: Pose2) -> FloatArray:
    """Vertices of the footprint at a pose, Shape (n, 2) [m]."""
    corners: FloatArray = transform_points(pose.as_array()[None], footprint.vertices)[0]
    return corners


def fill_footprint(
    grid: Costmap, footprint: Footprint, pose: Pose2, cost: int, window: tuple[slice, slice] | None = None
) -> None:
    """Write `cost` into every cell of a writable grid that the footprint meets, within `window` only."""
    rows, columns = window or (slice(0, grid.rows), slice(0, grid.columns))
    for body in footprint.bodies:
        vertices = transform_points(pose.as_array()[None], body.vertices)
        cells = cells_of_polygons((vertices - np.array(grid.origin)) / grid.resolution).cells
        within = np.all((cells >= (columns.start, rows.start)) & (cells < (columns.stop, rows.stop)), axis=1)
        grid.data[cells[within, 1], cells[within, 0]] = cost
