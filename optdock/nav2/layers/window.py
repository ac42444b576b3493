"""Boxes in metres, windows of cells, and grids that move by whole cells: what layers and the layered costmap share."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from optdock.errors import InvalidValue
from optdock.model.costmap import Costmap
from optdock.plugins.interfaces import Bounds

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray
    from optdock.model.costs import CostArray

__all__ = [
    "EVERYWHERE",
    "NOWHERE",
    "CellWindow",
    "checked_window",
    "grown_by_points",
    "joined",
    "moved_grid",
    "shifted",
    "window_of",
]

NOWHERE = Bounds(math.inf, math.inf, -math.inf, -math.inf)
EVERYWHERE = Bounds(-math.inf, -math.inf, math.inf, math.inf)

CellWindow = tuple[slice, slice]
"""Rows and columns, ready to index a grid's data."""


def joined(first: Bounds, second: Bounds) -> Bounds:
    """The smallest box around both.

    >>> joined(NOWHERE, Bounds(0.0, 0.0, 1.0, 1.0))
    Bounds(min_x=0.0, min_y=0.0, max_x=1.0, max_y=1.0)
    """
    return Bounds(
        min(first.min_x, second.min_x),
        min(first.min_y, second.min_y),
        max(first.max_x, second.max_x),
        max(first.max_y, second.max_y),
    )


def grown_by_points(bounds: Bounds, points: FloatArray) -> Bounds:
    """`bounds` grown to hold points, Shape (n, 2) [m]."""
    if not len(points):
        return bounds
    low, high = points.min(axis=0), points.max(axis=0)
    return joined(bounds, Bounds(float(low[0]), float(low[1]), float(high[0]), float(high[1])))


def window_of(grid: Costmap, bounds: Bounds) -> tuple[int, int, int, int]:
    """First column and row, and the column and row after the last, of the cells of `grid` that meet `bounds`."""
    if bounds.min_x > bounds.max_x or bounds.min_y > bounds.max_y:
        return 0, 0, 0, 0
    corners = np.array([[bounds.min_x, bounds.min_y], [bounds.max_x, bounds.max_y]])
    first, last = grid.cell_of(corners)
    stop = np.clip(last + 1, 0, (grid.columns, grid.rows))
    first = np.clip(first, 0, stop)
    return int(first[0]), int(first[1]), int(stop[0]), int(stop[1])


def checked_window(grid: Costmap, min_i: int, min_j: int, max_i: int, max_j: int) -> CellWindow:
    """Rows and columns of the window [min_i, max_i) x [min_j, max_j).

    Raises:
        InvalidValue: The window is not within the grid, or the grid is read-only.
    """
    if not (0 <= min_i <= max_i <= grid.columns and 0 <= min_j <= max_j <= grid.rows):
        raise InvalidValue(
            f"window: columns [{min_i}, {max_i}), rows [{min_j}, {max_j}) are not within the master grid of "
            f"{grid.columns} columns and {grid.rows} rows"
        )
    if not grid.data.flags.writeable:
        raise InvalidValue("master grid: is read-only; layers need a grid made by Costmap.writable")
    return slice(min_j, max_j), slice(min_i, max_i)


def shifted(data: CostArray, columns: int, rows: int, fill: int) -> CostArray:
    """The view of a window moved by whole cells: `result[j, i] = data[j + rows, i + columns]`, else `fill`.

    Args:
        data: Shape (m, n).
        columns: How far the window moves right.
        rows: How far it moves up.
        fill: What lies outside.
    """
    moved: CostArray = np.full_like(data, fill)
    height, width = data.shape
    if abs(columns) >= width or abs(rows) >= height:
        return moved
    to_j, to_i = slice(max(0, -rows), height - max(0, rows)), slice(max(0, -columns), width - max(0, columns))
    from_j, from_i = slice(max(0, rows), height - max(0, -rows)), slice(max(0, columns), width - max(0, -columns))
    moved[to_j, to_i] = data[from_j, from_i]
    return moved


def moved_grid(grid: Costmap | None, target: Costmap, fill: int) -> Costmap:
    """A writable grid in the target's place and size with what `grid` holds there, `fill` elsewhere.

    A grid of another size or resolution, or off the target's raster by more than a hundredth of a cell, is not kept.
    """
    rows, columns = target.data.shape
    moved = Costmap.writable((rows, columns), target.resolution, target.origin, fill)
    if grid is None or grid.data.shape != target.data.shape or grid.resolution != target.resolution:
        return moved
    steps = [(new - old) / grid.resolution for new, old in zip(target.origin, grid.origin, strict=True)]
    if all(abs(step - round(step)) < 0.01 for step in steps):
        moved.data[:] = shifted(grid.data, round(steps[0]), round(steps[1]), fill)
    return moved
