"""StoppedGoalChecker: the SimpleGoalChecker for a robot at rest."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from checkers._measures import is_stopped
from checkers.nav2.simple_goal import SimpleGoalChecker, SimpleGoalCheckerParameters

if TYPE_CHECKING:
    from collections.abc import Sequence

    from optdock.geometry.pose import Pose2, Twist2
    from optdock.plugins.interfaces import Tolerances

__all__ = ["StoppedGoalChecker", "StoppedGoalCheckerParameters"]


class StoppedGoalCheckerParameters(SimpleGoalCheckerParameters):
    """Nav2's parameters of the StoppedGoalChecker."""

    trans_stopped_velocity: float = Field(default=0.25, ge=0.0, description="largest speed at rest [m/s]")
    rot_stopped_velocity: float = Field(default=0.25, ge=0.0, description="largest yaw rate at rest [rad/s]")


class StoppedGoalChecker(SimpleGoalChecker):
    """Nav2's StoppedGoalChecker: position (latched), heading, and both speeds within tolerance, inclusively."""

    Parameters = StoppedGoalCheckerParameters
    parameters: StoppedGoalCheckerParameters

    def is_goal_reached(self, query_pose: Pose2, goal_pose: Pose2, velocity: Twist2, path: Sequence[Pose2]) -> bool:
        """Whether position and heading are accepted and the robot is at rest."""
        p = self.parameters
        in_place = super().is_goal_reached(query_pose, goal_pose, velocity, path)
        return in_place and is_stopped(velocity, p.trans_stopped_velocity, p.rot_stopped_velocity)

    @property
    def tolerances(self) -> Tolerances:
        """Radius, heading tolerance and the speeds at rest."""
        p = self.parameters
        speeds = {"linear_speed": p.trans_stopped_velocity, "angular_speed": p.rot_stopped_velocity}
        return super().tolerances._replace(**speeds)
