"""Polygons drawn into an occupancy grid, and its occupied cells merged into rectangles."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from optdock.testing.families_scene import swept_area

if TYPE_CHECKING:
    from collections.abc import Sequence

    from optdock.geometry.arrays import BoolArray, FloatArray
    from optdock.path import Path
    from optdock.robot import Robot

__all__ = ["merged_rectangles", "occupied_rectangles"]


def occupied_rectangles(
    polygons: Sequence[FloatArray], robot: Robot, motion: Path, cell: float
) -> tuple[FloatArray, FloatArray]:
    """Cells that touch a polygon and keep away from what the motion sweeps, as rectangles.

    Returns:
        Lower and upper corners, Shape (m, 2) [m] each.
    """
    import shapely

    points = np.vstack(polygons)
    first = np.floor(points.min(axis=0) / cell).astype(np.int64)
    count = np.ceil(points.max(axis=0) / cell).astype(np.int64) - first
    x, y = ((first[axis] + np.arange(count[axis])) * cell for axis in (0, 1))
    columns, rows = np.meshgrid(x, y)
    cells = shapely.box(columns, rows, columns + cell, rows + cell)
    solid = shapely.union_all([shapely.Polygon(polygon) for polygon in polygons])
    shapely.prepare(solid)
    occupied = shapely.intersects(solid, cells) & ~shapely.intersects(swept_area(robot, motion), cells)
    low, high = merged_rectangles(occupied)
    return (first + low) * cell, (first + high) * cell


def merged_rectangles(occupied: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Rectangles that cover exactly the occupied cells: runs in rows, merged with equal runs in the rows above.

    Args:
        occupied: Shape (rows, columns).

    Returns:
        Lower and upper corners in cells, Shape (m, 2) each, columns first.
    """
    padded = np.pad(occupied.astype(np.int8), ((0, 1), (1, 1)))
    open_runs: dict[tuple[int, int], int] = {}
    found: list[tuple[int, int, int, int]] = []
    for row, edges in enumerate(np.diff(padded, axis=1)):
        runs = list(zip(np.flatnonzero(edges == 1).tolist(), np.flatnonzero(edges == -1).tolist(), strict=True))
        ended = [run for run in open_runs if run not in runs]
        found += [(run[0], open_runs.pop(run), run[1], row) for run in ended]
        for run in runs:
            open_runs.setdefault(run, row)
    corners = np.array(found, dtype=np.float64).reshape(-1, 4)
    return corners[:, :2], corners[:, 2:]
