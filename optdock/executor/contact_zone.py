"""The contact zone: what a costmap shows of the dock where the docked robot touches it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from optdock.geometry.pose import transform_points
from optdock.model.costmap import Costmap
from optdock.model.costs import FREE_SPACE
from optdock.model.dock import DockDirection

if TYPE_CHECKING:
    from optdock.geometry.footprint import Footprint
    from optdock.model.dock import Dock

__all__ = ["contact_reach", "with_contact_zone"]


def contact_reach(costmap: Costmap, margin: float) -> float:
    """How far around the edge that touches `with_contact_zone` frees cells, by their centres [m]."""
    return max(margin, 1.5 * costmap.resolution)


def with_contact_zone(costmap: Costmap, dock: Dock, footprint: Footprint, margin: float) -> Costmap:
    """The costmap without the cells that the docked robot's front touches.

    A dock that scanners see stands a cell or two too fat in a costmap: the docked robot would collide with what it is
    to touch. Cells are freed within the margin, or a cell and a half, of the edge that touches, and nowhere else: what
    stands in the robot's way still counts.

    Args:
        costmap: In the dock's frame.
        dock: Where the robot stands docked, and its gear.
        footprint: Of the robot.
        margin: [m].
    """
    ahead = -1.0 if dock.direction is DockDirection.BACKWARD else 1.0
    vertices = footprint.vertices
    front, half = float((ahead * vertices[:, 0]).max()), float(np.abs(vertices[:, 1]).max())
    reach = contact_reach(costmap, margin)
    radius = math.hypot(front + reach, half + reach)
    centre = np.array([dock.pose.x, dock.pose.y])
    low = np.clip(costmap.cell_of([centre - radius])[0], 0, (costmap.columns, costmap.rows))
    high = np.clip(costmap.cell_of([centre + radius])[0] + 1, 0, (costmap.columns, costmap.rows))
    if np.any(high <= low):
        return costmap
    i, j = np.meshgrid(np.arange(low[0], high[0]), np.arange(low[1], high[1]))
    cells = np.column_stack((i.ravel(), j.ravel()))
    seen = transform_points(dock.pose.inverse().as_array()[None], costmap.centre_of(cells))[0]
    touches = (np.abs(ahead * seen[:, 0] - front) <= reach) & (np.abs(seen[:, 1]) <= half + reach)
    freed = cells[touches]
    if not np.any(costmap.data[freed[:, 1], freed[:, 0]] != FREE_SPACE):
        return costmap
    data = costmap.data.copy()
    data[freed[:, 1], freed[:, 0]] = FREE_SPACE
    return Costmap(data, costmap.resolution, costmap.origin)
