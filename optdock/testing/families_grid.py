"""Polygons drawn into an occupancy grid."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from optdock.costmap.costmap import FREE_SPACE, LETHAL, Costmap
from optdock.testing.families_scene import swept_area

if TYPE_CHECKING:
    from collections.abc import Sequence

    from optdock.geometry.arrays import FloatArray
    from optdock.path import Path
    from optdock.robot import Robot

__all__ = ["drawn_costmap"]

_BORDER = 1.5  # free cells around the motion and the polygons [m]


def drawn_costmap(polygons: Sequence[FloatArray], robot: Robot, motion: Path, cell: float) -> Costmap:
    """A map, with room around the motion, on which the cells that touch a polygon are occupied.

    Cells near what the robot sweeps along the motion stay free.

    Args:
        polygons: Shape (n, 2) [m] each.
        robot: What drives.
        motion: What must stay possible.
        cell: Side of a cell [m].
    """
    import shapely

    points = np.vstack((*polygons, motion.sample(0.1).poses[:, :2]))
    first = np.floor((points.min(axis=0) - _BORDER) / cell).astype(np.int64)
    size = np.ceil((points.max(axis=0) + _BORDER) / cell).astype(np.int64) - first
    x, y = ((first[axis] + np.arange(size[axis])) * cell for axis in (0, 1))
    left, low = np.meshgrid(x, y)
    cells = shapely.box(left, low, left + cell, low + cell)
    solid = shapely.union_all([shapely.Polygon(polygon) for polygon in polygons])
    shapely.prepare(solid)
    occupied = shapely.intersects(solid, cells) & ~shapely.intersects(swept_area(robot, motion), cells)
    costs = np.where(occupied, LETHAL, FREE_SPACE).astype(np.uint8)
    return Costmap(costs, cell, (float(first[0] * cell), float(first[1] * cell)))
