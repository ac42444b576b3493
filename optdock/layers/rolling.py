"""Grids that move by whole cells and keep what overlaps."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from optdock.costmap.costmap import Costmap

if TYPE_CHECKING:
    from optdock.costmap.costs import CostArray

__all__ = ["moved_grid", "shifted"]


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
