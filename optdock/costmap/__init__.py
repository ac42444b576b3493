"""Grids of costs and of occupancies, and their cells as obstacles."""

from optdock.costmap.cell_obstacles import obstacles_from_costmap
from optdock.costmap.costmap import Costmap
from optdock.costmap.occupancy import OccupancyGrid

__all__ = ["Costmap", "OccupancyGrid", "obstacles_from_costmap"]
