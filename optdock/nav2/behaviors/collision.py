"""The collision check ahead: the whole footprint, swept continuously."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from optdock.errors import BehaviorException
from optdock.geometry.obstacles import in_words
from optdock.plugins.interfaces import CostmapInfoType
from optdock.verification.time_of_impact import free_motion

if TYPE_CHECKING:
    from optdock.geometry.footprint import Footprint
    from optdock.geometry.pose import Pose2, Twist2
    from optdock.plugins.lifecycle import PluginContext

__all__ = ["CollisionChecker"]


class CollisionChecker:
    """Judges motions among everything that the context holds: the problem's obstacles and the grids asked for.

    Nav2 looks at footprint edges on a grid, at single poses. Here the footprint's interior counts and so does
    everything between the poses.

    Args:
        context: Where problem, costmaps and footprint come from; of a costmap the cells within reach are read anew each
            time, so that a grid that layers write into is seen as it is.
        clearance: Distance to keep [m].
        needs: Which of the two costmaps count beside the problem; where there is no local one, the other serves both.

    Raises:
        BehaviorException: There is no footprint, or neither a problem nor a costmap.
    """

    def __init__(
        self, context: PluginContext, clearance: float, needs: CostmapInfoType = CostmapInfoType.LOCAL
    ) -> None:
        self._context, self._clearance, self._needs = context, clearance, needs
        if context.footprint is None or (context.problem is None and not context.costmaps(needs)):
            raise BehaviorException(
                f"{context.name}: cannot check for collisions: configure it with a problem or with a costmap and a "
                f"footprint, or set disable_collision_checks"
            )
        self._footprint: Footprint = context.footprint

    def refusal(self, pose: Pose2, twist: Twist2, duration: float) -> str:
        """Why this motion must not begin; the empty string when it is free all the way."""
        travel = math.hypot(twist.linear, twist.lateral) * duration
        reach = self._footprint.circumscribed_radius + travel + self._clearance
        centre = np.array([pose.x, pose.y])
        obstacles = self._context.obstacles_near(centre - reach, centre + reach, self._needs)
        found = free_motion(self._footprint, obstacles, pose, twist, duration, self._clearance)
        if found.row < 0:
            return ""
        return f"collision ahead: {in_words(obstacles.name_of(found.row))} in {found.free:.2f} s"
