"""The occupancy grid: what map files and SLAM hand over, before any costmap rule is applied to it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from optdock.geometry.arrays import FrozenArrays, readonly
from optdock.model.costmap import Costmap
from optdock.model.costs import OccupancyArray, OccupancyRule, costs_from_occupancy

__all__ = ["OccupancyGrid"]


@dataclass(frozen=True, eq=False)
class OccupancyGrid(FrozenArrays):
    """Occupancies with their place in the world (ROS: `nav_msgs/OccupancyGrid`).

    Args:
        data: Shape (rows, columns), -1 (unknown) or 0..100; row 0 has the lowest y. Copied and made read-only.
        resolution: Side of a cell [m].
        origin: Lower left corner of the first cell, x and y [m].

    Raises:
        InvalidValue: No cell, occupancies outside -1..100, resolution not > 0, origin not finite.
    """

    data: OccupancyArray
    resolution: float
    origin: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        values = np.asarray(self.data)
        grid = Costmap(costs_from_occupancy(values), self.resolution, self.origin)  # checks everything
        occupancy = readonly(values.astype(np.int8, order="C"))
        for name, value in (("data", occupancy), ("resolution", grid.resolution), ("origin", grid.origin)):
            object.__setattr__(self, name, value)

    @property
    def costmap(self) -> Costmap:
        """The costmap by the default rule: unknown cells stay unknown."""
        return self.costmap_by(OccupancyRule())

    def costmap_by(self, rule: OccupancyRule) -> Costmap:
        """The costmap by another rule."""
        return Costmap(costs_from_occupancy(self.data, rule), self.resolution, self.origin)
