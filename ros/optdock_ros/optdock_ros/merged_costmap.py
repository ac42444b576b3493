"""Costmaps of several topics merged into one in the planning frame.

Unknown cells count as occupied, and the cost of a cell that overlaps several cells of another grid is the worst of
their costs: a certificate for the merged costmap also holds for its sources.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import maximum_filter

from optdock.geometry.pose import Pose2, transform_points
from optdock.model.costmap import FREE_SPACE, LETHAL, NO_INFORMATION, Costmap

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray

__all__ = ["Box", "cropped", "joined", "moved"]

_ALIGNED = 1e-6  # [cells], [rad]: grids that are closer are regarded as equal
_RANK = np.arange(256, dtype=np.uint8)  # costs ordered by severity; the array is its own inverse
_RANK[[LETHAL, NO_INFORMATION]] = NO_INFORMATION, LETHAL
_TOUCHED = math.sqrt(0.5)  # distance between corner and centre of a cell, in cells

Box = tuple[float, float, float, float]  # least x and y, largest x and y [m]


def moved(costmap: Costmap, frame: Pose2, box: Box | None = None) -> Costmap:
    """Return a costmap, or the part in a box, in another frame, in which its own frame has the pose `frame`.

    The resolution is kept. A cell has the worst cost of the cells it overlaps, NO_INFORMATION outside.
    """
    side, (ox, oy) = costmap.resolution, costmap.origin
    if abs(frame.yaw) < _ALIGNED:
        shifted = Costmap(costmap.data, side, (ox + frame.x, oy + frame.y))
        return shifted if box is None else cropped(shifted, box)
    low, high = _bounds(frame, (*costmap.lower, *costmap.upper))
    if box is not None:
        low, high = np.maximum(low, box[:2]), np.maximum(np.minimum(high, box[2:]), np.maximum(low, box[:2]) + side)
        around = np.concatenate(_bounds(frame.inverse(), (*low, *high))) + 2.0 * side * np.array([-1, -1, 1, 1])
        costmap = cropped(costmap, tuple(around.tolist()))
    columns, rows = np.maximum(1, np.ceil((high - low) / side - _ALIGNED)).astype(int)
    back = transform_points(frame.inverse().as_array()[None], _centres(low, side, columns, rows))[0]
    costs = _spread(costmap, math.ceil(_TOUCHED)).cost_at(back).reshape(rows, columns)
    return Costmap(costs, side, (float(low[0]), float(low[1])))


def cropped(costmap: Costmap, box: Box) -> Costmap:
    """Return the cells of a costmap that a box overlaps, at least one; all cells outside become unknown."""
    first, last = costmap.cell_of([box[:2], box[2:]])
    size = (costmap.columns, costmap.rows)
    (i, j), (i_end, j_end) = np.clip(first, 0, np.subtract(size, 1)), np.clip(last + 1, 1, size)
    part = costmap.data[j : max(j_end, j + 1), i : max(i_end, i + 1)]
    if part.shape == costmap.data.shape:
        return costmap
    side = costmap.resolution
    return Costmap(part, side, (costmap.origin[0] + int(i) * side, costmap.origin[1] + int(j) * side))


def joined(wide: Costmap, local: Costmap) -> Costmap:
    """Merge a wide map with the local costmap: the larger of both costs, the local cost where the map is unknown.

    Both are in one frame; the grid is that of `local`.
    """
    side = local.resolution
    low = np.minimum(np.floor((np.array(wide.lower) - local.lower) / side + _ALIGNED), 0.0).astype(int)
    high = np.maximum(
        np.ceil((np.array(wide.upper) - local.lower) / side - _ALIGNED), (local.columns, local.rows)
    ).astype(int)
    columns, rows = (high - low).tolist()
    origin = (local.origin[0] + low[0] * side, local.origin[1] + low[1] * side)
    ratio = side / wide.resolution
    offset = np.abs((np.array(origin) - wide.origin) / wide.resolution)
    same = abs(ratio - 1.0) < _ALIGNED and bool(np.abs(offset - np.round(offset)).max() < _ALIGNED)
    reach = 0 if same else math.ceil(0.5 * ratio)
    data = _spread(wide, reach).cost_at(_centres(origin, side, columns, rows)).reshape(rows, columns)
    i, j = (-low).tolist()
    window = data[j : j + local.rows, i : i + local.columns]  # a view, not a copy
    is_seen = local.data != NO_INFORMATION
    before = np.where(window == NO_INFORMATION, FREE_SPACE, window)
    window[is_seen] = np.maximum(before, local.data)[is_seen]
    return Costmap(data, side, origin)


def _bounds(frame: Pose2, box: Box) -> tuple[FloatArray, FloatArray]:
    """Return the least and largest x and y of a box whose own frame has the pose `frame`."""
    x0, y0, x1, y1 = box
    corners = transform_points(frame.as_array()[None], np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]]))[0]
    return corners.min(axis=0), corners.max(axis=0)


def _centres(low: FloatArray | tuple[float, float], side: float, columns: int, rows: int) -> FloatArray:
    """Return the centres of the cells of a grid, shape (rows * columns, 2)."""
    x, y = low[0] + (np.arange(columns) + 0.5) * side, low[1] + (np.arange(rows) + 0.5) * side
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)


def _spread(costmap: Costmap, reach: int) -> Costmap:
    """Give every cell the worst cost within `reach` cells; occupied is worse than unknown.

    The grid is extended by one more cell, for cells of another grid that extend half a cell beyond it.
    """
    edge = reach + 1
    padded = np.pad(_RANK[costmap.data], edge, constant_values=int(_RANK[NO_INFORMATION]))
    spread = maximum_filter(padded, size=2 * reach + 1, mode="nearest") if reach else padded
    x, y = (value - edge * costmap.resolution for value in costmap.origin)
    return Costmap(_RANK[spread], costmap.resolution, (x, y))
