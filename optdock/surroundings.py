"""What a configured plugin must not touch: everything that its context holds.

The problem's obstacles always count, and with them the cells of the global costmap: `PluginContext` joins the two.
Beside them stand the costmaps that Nav2's `CostmapInfoType` names; who does not choose sees both.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from optdock.costmap.cell_obstacles import obstacles_from_costmap
from optdock.obstacles import ObstacleSet
from optdock.outcomes import CostmapInfoType

if TYPE_CHECKING:
    from optdock.costmap.costmap import Costmap
    from optdock.geometry.arrays import FloatArray
    from optdock.lifecycle import PluginContext

__all__ = ["asked_costmaps", "obstacles_near"]


def asked_costmaps(context: PluginContext, needs: CostmapInfoType) -> tuple[Costmap, ...]:
    """The costmaps of `context` that `needs` names; where there is no local one, the other serves both."""
    local = context.costmap if context.local_costmap is None else context.local_costmap
    asked = {
        CostmapInfoType.NONE: (),
        CostmapInfoType.LOCAL: (local,),
        CostmapInfoType.GLOBAL: (context.costmap,),
        CostmapInfoType.BOTH: (local, context.costmap),
    }[needs]
    return tuple(grid for grid in dict.fromkeys(asked) if grid is not None)


def obstacles_near(
    context: PluginContext, lower: FloatArray, upper: FloatArray, needs: CostmapInfoType = CostmapInfoType.BOTH
) -> ObstacleSet:
    """The obstacles that meet a box: the problem's, and the cells of the costmaps that `needs` names as they are now.

    Args:
        context: What the plugin is configured with.
        lower: Lower corner, Shape (2,) [m].
        upper: Upper corner, Shape (2,) [m].
        needs: Which costmaps count beside the problem.
    """
    problem = context.problem
    found = ObstacleSet.empty() if problem is None else problem.all_obstacles.in_box(lower, upper)
    for grid in asked_costmaps(context, needs):
        if problem is None or grid is not problem.costmap:
            found = found + obstacles_from_costmap(grid, region=(lower, upper))
    return found
