"""The collision check ahead: the whole footprint, swept continuously."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from optdock.errors import BehaviorException
from optdock.verification.sweep import free_motion

if TYPE_CHECKING:
    from optdock.geometry.footprint import Footprint
    from optdock.geometry.pose import Pose2, Twist2
    from optdock.lifecycle import PluginContext
    from optdock.obstacles import ObstacleSet

__all__ = ["CollisionGate"]


class CollisionGate:
    """Judges motions among the obstacles of the configured problem, or else of the configured costmap.

    Nav2 looks at footprint edges on a grid, at single poses. Here the footprint's interior counts and so does
    everything between the poses.

    Args:
        context: Where problem, costmap and footprint come from; of a costmap the cells within reach are read.
        clearance: Distance to keep [m].

    Raises:
        BehaviorException: There is neither a problem nor a costmap with a footprint.
    """

    def __init__(self, context: PluginContext, clearance: float) -> None:
        self._context, self._clearance = context, clearance
        footprint = context.problem.robot.footprint if context.problem else context.footprint
        if footprint is None or (context.problem is None and context.costmap is None):
            raise BehaviorException(
                f"{context.name}: cannot check for collisions: configure it with a problem or with a costmap and a "
                f"footprint, or set disable_collision_checks"
            )
        self._footprint: Footprint = footprint

    def refusal(self, pose: Pose2, twist: Twist2, duration: float) -> str:
        """Why this motion must not begin; the empty string when it is free all the way."""
        reach = self._footprint.circumscribed_radius + abs(twist.linear) * duration + self._clearance
        obstacles = self._obstacles(pose, reach)
        found = free_motion(self._footprint, obstacles, pose, twist, duration, self._clearance)
        if found.row < 0:
            return ""
        return f"collision ahead: {obstacles.name_of(found.row)} in {found.free:.2f} s"

    def _obstacles(self, pose: Pose2, reach: float) -> ObstacleSet:
        if self._context.problem is not None:
            return self._context.problem.all_obstacles
        from optdock.costmap.cell_obstacles import obstacles_from_costmap

        assert self._context.costmap is not None
        centre = np.array([pose.x, pose.y])
        return obstacles_from_costmap(self._context.costmap, region=(centre - reach, centre + reach))
