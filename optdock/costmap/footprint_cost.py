"""The highest cost under a footprint: outline and inside, and Nav2's outline only for comparison."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from optdock.costmap.costs import LETHAL, CostArray
from optdock.costmap.raster import CellList, cells_of_lines, cells_of_polygons
from optdock.geometry.arrays import frozen_array
from optdock.geometry.pose import transform_points

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from optdock.costmap.costmap import Costmap
    from optdock.geometry.arrays import BoolArray, FloatArray
    from optdock.geometry.footprint import Footprint

__all__ = ["footprint_cost_at", "footprint_is_free", "outline_cost_at"]


def footprint_cost_at(costmap: Costmap, footprint: Footprint, poses: ArrayLike) -> CostArray:
    """Highest cost of any cell that the footprint meets, its inside included; LETHAL where a vertex is off the map.

    Args:
        costmap: The grid.
        footprint: Any simple polygon.
        poses: Shape (n, 3) [m, m, rad].

    Returns:
        Shape (n,); NO_INFORMATION (255) is the highest cost.

    Raises:
        InvalidValue: A pose is not three finite numbers.
    """
    checked = frozen_array(poses, "poses", columns=3)
    on_map = _is_on_map(costmap, footprint, checked)
    costs = np.where(on_map, 0, LETHAL).astype(np.uint8)
    inside = checked[on_map]
    highest = np.zeros(len(inside), dtype=np.uint8)
    for body in footprint.bodies:
        vertices = transform_points(inside, body.vertices)
        _raise_to(highest, costmap, cells_of_polygons((vertices - np.array(costmap.origin)) / costmap.resolution))
    costs[on_map] = highest
    return costs


def outline_cost_at(costmap: Costmap, footprint: Footprint, poses: ArrayLike) -> CostArray:
    """As `footprint_cost_at`, but only the cells of the outline, as Nav2's `footprintCostAtPose` looks at them.

    An obstacle that lies wholly inside the footprint is not seen. For comparison; use `footprint_cost_at`.

    Raises:
        InvalidValue: A pose is not three finite numbers.
    """
    checked = frozen_array(poses, "poses", columns=3)
    on_map = _is_on_map(costmap, footprint, checked)
    costs = np.where(on_map, 0, LETHAL).astype(np.uint8)
    corners = transform_points(checked[on_map], footprint.vertices)
    highest = np.zeros(len(corners), dtype=np.uint8)
    for k in range(corners.shape[1]):
        start, end = corners[:, k], corners[:, (k + 1) % corners.shape[1]]
        _raise_to(highest, costmap, cells_of_lines(costmap.cell_of(start), costmap.cell_of(end)))
    costs[on_map] = highest
    return costs


def footprint_is_free(costmap: Costmap, footprint: Footprint, poses: ArrayLike) -> BoolArray:
    """Whether the footprint meets no lethal and no unknown cell and is on the map. Shape (n,).

    Inscribed cells (253) do not count: they forbid the robot's centre, not its outline.

    Raises:
        InvalidValue: A pose is not three finite numbers.
    """
    is_free: BoolArray = footprint_cost_at(costmap, footprint, poses) < LETHAL
    return is_free


def _is_on_map(costmap: Costmap, footprint: Footprint, poses: FloatArray) -> BoolArray:
    corners = transform_points(poses, footprint.vertices)
    on_map: BoolArray = np.all(costmap.contains(corners), axis=1)
    return on_map


def _raise_to(highest: CostArray, costmap: Costmap, met: CellList) -> None:
    np.maximum.at(highest, met.owner, costmap.data[met.cells[:, 1], met.cells[:, 0]])
