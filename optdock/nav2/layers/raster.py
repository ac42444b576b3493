"""Rasterization: cells of lines, convex polygons and footprints."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.geometry.pose import transform_points

if TYPE_CHECKING:
    from optdock.geometry.arrays import BoolArray, FloatArray, IntArray
    from optdock.geometry.footprint import Footprint
    from optdock.geometry.pose import Pose2
    from optdock.model.costmap import Costmap

__all__ = ["CellList", "cells_of_lines", "cells_of_polygon", "fill_footprint"]

_SLACK = 1e-9  # [cells]: a polygon within this distance of a cell counts as touching it


class CellList(NamedTuple):
    """Cells (i, j), Shape (m, 2), and for each cell the index of its line, ascending, Shape (m,)."""

    cells: IntArray
    owner: IntArray


def cells_of_lines(starts: IntArray, ends: IntArray) -> CellList:
    """Return the cells of Bresenham lines from start to end, including both ends (Nav2: `LineIterator`).

    Args:
        starts: First cells (i, j), Shape (n, 2).
        ends: Last cells, Shape (n, 2).
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


def cells_of_polygon(vertices: FloatArray) -> IntArray:
    """Return the cells (i, j) that a convex polygon overlaps or touches, Shape (m, 2).

    Cell i spans [i, i + 1), as with `floor`. The test uses separating axes and is exact: if a square and a convex
    polygon are disjoint, an edge normal of one of them separates the two.

    Args:
        vertices: Shape (k, 2), counter-clockwise, in cells from the grid's origin.
    """
    low, high = np.floor(vertices.min(axis=0)), np.floor(vertices.max(axis=0))
    x, y = (np.arange(first, last + 1.0) + 0.5 for first, last in zip(low, high, strict=True))
    meets: BoolArray = np.ones((len(y), len(x)), dtype=np.bool_)
    for start, edge in zip(vertices, np.roll(vertices, -1, axis=0) - vertices, strict=True):
        # Outward normal (dy, -dx); the lowest point of a square along the normal is half a cell per axis below the
        # centre.
        reach = 0.5 * np.abs(edge).sum() + _SLACK * np.hypot(*edge)
        meets &= edge[1] * (x - start[0]) - edge[0] * (y[:, None] - start[1]) <= reach
    rows, columns = np.nonzero(meets)
    cells: IntArray = low.astype(np.int64) + np.column_stack((columns, rows))
    return cells


def fill_footprint(
    grid: Costmap, footprint: Footprint, pose: Pose2, cost: int, window: tuple[slice, slice] | None = None
) -> None:
    """Write `cost` into every cell of a writable grid that the footprint overlaps or touches.

    Args:
        grid: Modified in place.
        footprint: Outline.
        pose: Pose of the footprint.
        cost: Cost of the cells.
        window: Rows and columns that may be written; None for all.
    """
    rows, columns = window or (slice(0, grid.rows), slice(0, grid.columns))
    for body in footprint.bodies:
        vertices = transform_points(pose.as_array()[None], body.vertices)[0]
        cells = cells_of_polygon((vertices - np.array(grid.origin)) / grid.resolution)
        within = np.all((cells >= (columns.start, rows.start)) & (cells < (columns.stop, rows.stop)), axis=1)
        grid.data[cells[within, 1], cells[within, 0]] = cost
