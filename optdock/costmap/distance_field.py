"""Signed distance to the occupied cells on a grid, for fast queries; the certificate uses exact polygons instead."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.costmap.costs import LETHAL, NO_INFORMATION
from optdock.errors import InvalidValue
from optdock.geometry.arrays import readonly

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from optdock.costmap.costmap import Costmap
    from optdock.geometry.arrays import BoolArray, FloatArray, IntArray

__all__ = ["DistanceField"]

# Cell centres: half a cell is taken off the distance to a centre, which is exact beside a face and wrong by
# (sqrt(2) - 1) / 2 towards a corner. Between centres: a bilinear mean of values that change by at most 1 m per metre
# is off by the mean distance to the four centres, at most sqrt(2) / 2.
_ERROR_IN_CELLS = (math.sqrt(2.0) - 1.0) / 2.0 + math.sqrt(2.0) / 2.0


class _Corners(NamedTuple):
    """The four centres around each query: their values (n,) and the place between them (n,), 0..1."""

    low_left: FloatArray
    low_right: FloatArray
    high_left: FloatArray
    high_right: FloatArray
    u: FloatArray
    v: FloatArray


@dataclass(frozen=True, eq=False)
class DistanceField:
    """Signed distance to the union of the occupied cells (squares), negative inside.

    At a cell centre the value is the exact distance to the nearest centre of the other kind, less half a cell;
    between centres it is bilinear. It differs from the true distance by at most `error_bound` everywhere on the map,
    and is exact beside long straight walls along the axes. Off the map it is the value at the map's edge less the
    distance to the map: a lower bound up to `error_bound`. Without any occupied cell it is infinite.

    Args:
        values: Shape (rows, columns) [m], at the cell centres.
        resolution: Side of a cell [m].
        origin: Lower left corner of cell (0, 0) [m].
    """

    values: FloatArray
    resolution: float
    origin: tuple[float, float]

    @classmethod
    def from_costmap(
        cls, costmap: Costmap, *, unknown_is_obstacle: bool = True, threshold: int = LETHAL
    ) -> DistanceField:
        """The field of the cells that `obstacles_from_costmap` would take, without the border.

        Raises:
            InvalidValue: threshold is not in 1..254.
        """
        if not 1 <= threshold <= LETHAL:
            raise InvalidValue(f"threshold: must be in 1..{LETHAL}, got {threshold}")
        occupied = costmap.data >= threshold
        if not unknown_is_obstacle:
            occupied &= costmap.data != NO_INFORMATION
        values = _signed_cells(occupied) * costmap.resolution
        return cls(readonly(values), costmap.resolution, costmap.origin)

    @property
    def error_bound(self) -> float:
        """Largest difference between the field and the true signed distance on the map [m], 0.915 cells."""
        return _ERROR_IN_CELLS * self.resolution

    def distance_at(self, points: ArrayLike) -> FloatArray:
        """Signed distance at points, Shape (n, 2) [m]. Shape (n,) [m]; NaN where a point is not finite."""
        place = self._place(points)
        inside = self._clipped(place)
        if not np.isfinite(self.values[0, 0]):
            return np.full(len(place), self.values[0, 0])
        c = self._corners(inside)
        low = c.low_left + c.u * (c.low_right - c.low_left)
        high = c.high_left + c.u * (c.high_right - c.high_left)
        off_map = np.maximum(np.abs(place - inside) - 0.5, 0.0)
        distance: FloatArray = low + c.v * (high - low) - np.hypot(off_map[:, 0], off_map[:, 1]) * self.resolution
        return distance

    def gradient_at(self, points: ArrayLike) -> FloatArray:
        """Gradient of the bilinear field, Shape (n, 2); off the map that at its edge, zero if infinite."""
        inside = self._clipped(self._place(points))
        if not np.isfinite(self.values[0, 0]):
            return np.zeros_like(inside)
        c = self._corners(inside)
        along_x = (1.0 - c.v) * (c.low_right - c.low_left) + c.v * (c.high_right - c.high_left)
        along_y = (1.0 - c.u) * (c.high_left - c.low_left) + c.u * (c.high_right - c.low_right)
        return np.column_stack((along_x, along_y)) / self.resolution

    def _place(self, points: ArrayLike) -> FloatArray:
        """Points in cells from the centre of cell (0, 0)."""
        place: FloatArray = (np.asarray(points, dtype=np.float64) - np.array(self.origin)) / self.resolution - 0.5
        return place

    def _clipped(self, place: FloatArray) -> FloatArray:
        clipped: FloatArray = np.clip(place, 0.0, np.array(self.values.shape)[::-1] - 1.0)
        return clipped

    def _corners(self, place: FloatArray) -> _Corners:
        rows, columns = self.values.shape
        cell: IntArray = np.nan_to_num(place).astype(np.int64)
        i = np.minimum(cell[:, 0], max(columns - 2, 0))
        j = np.minimum(cell[:, 1], max(rows - 2, 0))
        right, up = np.minimum(i + 1, columns - 1), np.minimum(j + 1, rows - 1)
        at = self.values
        return _Corners(at[j, i], at[j, right], at[up, i], at[up, right], place[:, 0] - i, place[:, 1] - j)


def _signed_cells(occupied: BoolArray) -> FloatArray:
    """Signed distance at the cell centres, in cells; all infinite when all cells are of one kind."""
    if not occupied.any():
        return np.full(occupied.shape, np.inf)
    if occupied.all():
        return np.full(occupied.shape, -np.inf)
    from scipy.ndimage import distance_transform_edt

    to_occupied, to_free = distance_transform_edt(~occupied), distance_transform_edt(occupied)
    signed: FloatArray = np.where(occupied, 0.5 - to_free, to_occupied - 0.5)
    return signed
