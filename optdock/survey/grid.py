"""The questions of a survey: start poses on a grid of positions and headings.

Cell (k, j, i) has the heading 2 pi k / n and its centre at (i r, j r), where n is the number of headings and r the
resolution. The centres are multiples of the resolution in the frame of the problem, so that surveys of several docks
share their cells. A cell contains the poses that are nearer to its centre than to other centres.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from optdock.errors import InvalidValue
from optdock.geometry.pose import transform_points
from optdock.verification import compiled_clearances

if TYPE_CHECKING:
    from optdock.geometry.arrays import BoolArray, FloatArray, IntArray
    from optdock.model.problem import DockingProblem

__all__ = ["Box", "SurveyGrid", "room_at"]

_MOST_CELLS = 50_000_000
_FARTHEST = 2.0**53  # cells: whole numbers are exact up to this one
_BATCH = 20_000  # poses per query of the spatial index


@dataclass(frozen=True)
class Box:
    """Axis-parallel region of positions [m]."""

    left: float
    lower: float
    right: float
    upper: float

    def __post_init__(self) -> None:
        if not (math.isfinite(self.left + self.lower + self.right + self.upper)):
            raise InvalidValue("survey.region: must be finite")
        if not (self.left < self.right and self.lower < self.upper):
            raise InvalidValue(f"survey.region: must be left, lower, right, upper in this order, got {self}")


@dataclass(frozen=True)
class SurveyGrid:
    """Cells of a survey.

    Args:
        first: Column i and row j of the first position.
        shape: Number of headings, rows and columns.
        resolution: Distance between neighbouring positions [m].

    Raises:
        InvalidValue: If there are too many cells, or the resolution is not > 0.
    """

    first: tuple[int, int]
    shape: tuple[int, int, int]
    resolution: float

    def __post_init__(self) -> None:
        if not (math.isfinite(self.resolution) and self.resolution > 0.0):
            raise InvalidValue(f"survey.resolution: must be > 0 m, got {self.resolution}")
        if min(self.shape) < 1 or math.prod(self.shape) > _MOST_CELLS:
            raise InvalidValue(f"survey: has {math.prod(self.shape)} cells, must have 1 to {_MOST_CELLS}")

    @classmethod
    def covering(cls, box: Box, resolution: float, headings: int) -> SurveyGrid:
        """Return the grid of all positions in a box.

        Raises:
            InvalidValue: If there are too many cells or no position, or a value is not > 0.
        """
        if not (math.isfinite(resolution) and resolution > 0.0):
            raise InvalidValue(f"survey.resolution: must be > 0 m, got {resolution}")
        if headings < 1:
            raise InvalidValue(f"survey.headings: must be >= 1, got {headings}")
        ends = np.array([[box.left, box.lower], [box.right, box.upper]]) / resolution
        if np.abs(ends).max() > _FARTHEST:
            raise InvalidValue(f"survey.region: is too large for cells of {resolution} m, got {box}")
        low, high = np.ceil(ends[0] - 1e-9).astype(int), np.floor(ends[1] + 1e-9).astype(int)
        columns, rows = np.maximum(high - low + 1, 0).tolist()
        return cls((int(low[0]), int(low[1])), (headings, rows, columns), resolution)

    @property
    def headings(self) -> FloatArray:
        """Heading of each layer, Shape (headings,) [rad]."""
        found: FloatArray = 2.0 * math.pi * np.arange(self.shape[0]) / self.shape[0]
        return np.where(found > math.pi, found - 2.0 * math.pi, found)

    def poses(self, cells: IntArray) -> FloatArray:
        """Return the centres of cells, given by flat indices, Shape (n,). Shape (n, 3) [m, m, rad]."""
        k, j, i = np.unravel_index(cells, self.shape)
        x, y = (i + self.first[0]) * self.resolution, (j + self.first[1]) * self.resolution
        return np.column_stack((x, y, self.headings[k]))

    def cells(self, poses: FloatArray) -> IntArray:
        """Return the flat indices of the cells that contain poses, Shape (n, 3); -1 outside the grid. Shape (n,)."""
        n, rows, columns = self.shape
        steps = poses / [self.resolution, self.resolution, 2.0 * math.pi / n]
        i, j, k = np.clip(np.rint(steps), -_FARTHEST, _FARTHEST).astype(np.int64).T
        i, j, k = i - self.first[0], j - self.first[1], k % n
        inside = (i >= 0) & (i < columns) & (j >= 0) & (j < rows)
        found: IntArray = np.where(inside, (k * rows + j) * columns + i, -1)
        return found

    def within(self, x: float, y: float, radius: float) -> BoolArray:
        """Return whether positions lie within a radius [m] of a point, Shape (rows, columns)."""
        _, rows, columns = self.shape
        dx = (np.arange(columns) + self.first[0]) * self.resolution - x
        dy = (np.arange(rows) + self.first[1]) * self.resolution - y
        inside: BoolArray = np.hypot(dx, dy[:, None]) <= radius + 1e-9
        return inside


OCCUPIED, TIGHT, CLEAR = 0, 1, 2


def room_at(poses: FloatArray, problem: DockingProblem) -> IntArray:
    """Return whether the robot at each pose, Shape (n, 3), overlaps an obstacle, is too close, or is clear.

    Returns:
        `OCCUPIED` if the footprint overlaps an obstacle, `TIGHT` if its clearance is less than required away from the
        dock, otherwise `CLEAR`. Shape (n,).
    """
    import shapely

    obstacles, footprint = problem.all_obstacles, problem.robot.footprint
    found = np.full(len(poses), CLEAR)
    if len(obstacles) == 0:
        return found
    tree = shapely.STRtree(shapely.polygons(obstacles.vertices))
    required = problem.path_clearance.required
    for begin in range(0, len(poses), _BATCH):
        some = poses[begin : begin + _BATCH]
        bodies = shapely.polygons(transform_points(some, footprint.vertices))
        near = np.unique(tree.query(bodies, predicate="dwithin", distance=required + 1e-6)[0])
        over = np.unique(tree.query(bodies[near], predicate="intersects")[0])
        found[begin + near] = OCCUPIED
        close = np.setdiff1d(near, near[over])
        if close.size == 0:
            continue
        clearances, _ = compiled_clearances(some[close], footprint, obstacles, within=required + 0.01)
        found[begin + close] = np.where(clearances < required, TIGHT, CLEAR)
    return found
