"""Costmaps of several topics as one picture in the frame in which is planned.

What is not known counts as occupied, and a cell that another grid covers by parts takes the worst of them: what is
certified in the picture holds in each of its sources.
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

__all__ = ["Box", "joined", "moved"]

_ALIGNED = 1e-6  # [cells], [rad]: grids as near to each other are the same
_RANK = np.arange(256, dtype=np.uint8)  # costs in the order of what is worse; it is its own inverse
_RANK[[LETHAL, NO_INFORMATION]] = NO_INFORMATION, LETHAL
_TOUCHED = math.sqrt(0.5)  # of a cell's side: how far its corners are from its centre

Box = tuple[float, float, float, float]  # least x and y, largest x and y [m]


def moved(costmap: Costmap, frame: Pose2, box: Box | None = None) -> Costmap:
    """A costmap in another frame.

    Args:
        costmap: In its own frame.
        frame: That frame, seen from the other one.
        box: What of it is wanted, in the other frame; None: all.

    Returns:
        A grid of the same resolution; where a cell covers several of the old ones it has the worst of their costs, and
        beyond them NO_INFORMATION.
    """
    side, (ox, oy) = costmap.resolution, costmap.origin
    if abs(frame.yaw) < _ALIGNED:
        shifted = Costmap(costmap.data, side, (ox + frame.x, oy + frame.y))
        return shifted if box is None else _cropped(shifted, box)
    low, high = _bounds(frame, (*costmap.lower, *costmap.upper))
    if box is not None:
        low, high = np.maximum(low, box[:2]), np.maximum(np.minimum(high, box[2:]), np.maximum(low, box[:2]) + side)
        around = np.concatenate(_bounds(frame.inverse(), (*low, *high))) + 2.0 * side * np.array([-1, -1, 1, 1])
        costmap = _cropped(costmap, tuple(around.tolist()))
    columns, rows = np.maximum(1, np.ceil((high - low) / side - _ALIGNED)).astype(int)
    x, y = low[0] + (np.arange(columns) + 0.5) * side, low[1] + (np.arange(rows) + 0.5) * side
    centres = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    back = transform_points(frame.inverse().as_array()[None], centres)[0]
    costs = _spread(costmap, math.ceil(_TOUCHED)).cost_at(back).reshape(rows, columns)
    return Costmap(costs, side, (float(low[0]), float(low[1])))


def _bounds(frame: Pose2, box: Box) -> tuple[FloatArray, FloatArray]:
    """What a box covers in another frame, in which its own stands at `frame`: least and largest x and y."""
    x0, y0, x1, y1 = box
    corners = transform_points(frame.as_array()[None], np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]]))[0]
    return corners.min(axis=0), corners.max(axis=0)


def _cropped(costmap: Costmap, box: Box) -> Costmap:
    """The cells that a box meets, at least one."""
    first, last = costmap.cell_of([box[:2], box[2:]])
    size = (costmap.columns, costmap.rows)
    (i, j), (i_end, j_end) = np.clip(first, 0, np.subtract(size, 1)), np.clip(last + 1, 1, size)
    part = costmap.data[j : max(j_end, j + 1), i : max(i_end, i + 1)]
    side = costmap.resolution
    return Costmap(part, side, (costmap.origin[0] + int(i) * side, costmap.origin[1] + int(j) * side))


def joined(wide: Costmap, local: Costmap) -> Costmap:
    """A wide map with what is seen around the robot: in both the larger cost, but what is seen of the unknown.

    Args:
        wide: In the frame of `local`; its cells may lie elsewhere.
        local: Its resolution and its cells are kept.
    """
    side = local.resolution
    low = np.minimum(np.floor((np.array(wide.lower) - local.lower) / side + _ALIGNED), 0.0).astype(int)
    high = np.maximum(
        np.ceil((np.array(wide.upper) - local.lower) / side - _ALIGNED), (local.columns, local.rows)
    ).astype(int)
    columns, rows = (high - low).tolist()
    origin = (local.origin[0] + low[0] * side, local.origin[1] + low[1] * side)
    x, y = origin[0] + (np.arange(columns) + 0.5) * side, origin[1] + (np.arange(rows) + 0.5) * side
    ratio = side / wide.resolution
    offset = np.abs((np.array(origin) - wide.origin) / wide.resolution)
    same = abs(ratio - 1.0) < _ALIGNED and bool(np.abs(offset - np.round(offset)).max() < _ALIGNED)
    reach = 0 if same else math.ceil(0.5 * ratio)
    centres = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)

    data = _spread(wide, reach).cost_at(centres).reshape(rows, columns)
    i, j = (-low).tolist()
    window = data[j : j + local.rows, i : i + local.columns]  # a view
    is_seen = local.data != NO_INFORMATION
    before = np.where(window == NO_INFORMATION, FREE_SPACE, window)
    window[is_seen] = np.maximum(before, local.data)[is_seen]
    return Costmap(data, side, origin)


def _spread(costmap: Costmap, reach: int) -> Costmap:
    """Every cell with the worst within so many cells around it; what is occupied is worse than what is unknown.

    One cell beyond its edges belongs to it, for cells of another grid that lie half beyond.
    """
    edge = reach + 1
    padded = np.pad(_RANK[costmap.data], edge, constant_values=int(_RANK[NO_INFORMATION]))
    spread = maximum_filter(padded, size=2 * reach + 1, mode="nearest") if reach else padded
    x, y = (value - edge * costmap.resolution for value in costmap.origin)
    return Costmap(_RANK[spread], costmap.resolution, (x, y))
