"""Setting the cells under a footprint to one cost."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from optdock.costmap.raster import cells_of_polygons
from optdock.geometry.pose import transform_points

if TYPE_CHECKING:
    from optdock.costmap.costmap import Costmap
    from optdock.geometry.arrays import FloatArray
    from optdock.geometry.footprint import Footprint
    from optdock.geometry.pose import Pose2

__all__ = ["corners_of", "fill_footprint"]


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
