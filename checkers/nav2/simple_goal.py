"""SimpleGoalChecker: within a radius of the goal, and at its heading."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from checkers._measures import yaw_error
from checkers.nav2.position import PositionGoalChecker, PositionParameters

if TYPE_CHECKING:
    from collections.abc import Sequence

    from optdock.geometry.pose import Pose2, Twist2
    from optdock.plugins.interfaces import Tolerances

__all__ = ["SimpleGoalChecker", "SimpleGoalCheckerParameters"]


class SimpleGoalCheckerParameters(PositionParameters):
    """Nav2's parameters of the SimpleGoalChecker."""

    yaw_goal_tolerance: float = Field(default=0.25, ge=0.0, description="accepted heading error [rad]")
    symmetric_yaw_tolerance: bool = Field(default=False, description="accept the opposite heading as well")


class SimpleGoalChecker(PositionGoalChecker):
    """Nav2's SimpleGoalChecker: position within a radius (latched when stateful) and heading within a tolerance.

    The position is latched even if the heading fails; the heading is checked in every call. Comparisons are inclusive.
    """

    Parameters = SimpleGoalCheckerParameters
    parameters: SimpleGoalCheckerParameters

    def is_goal_reached(self, query_pose: Pose2, goal_pose: Pose2, velocity: Twist2, path: Sequence[Pose2]) -> bool:
        """Whether position and heading are accepted."""
        p = self.parameters
        if not self.is_goal_xy_reached(query_pose, goal_pose, velocity, path):
            return False
        return yaw_error(query_pose, goal_pose, symmetric=p.symmetric_yaw_tolerance) <= p.yaw_goal_tolerance

    @property
    def tolerances(self) -> Tolerances:
        """The radius in x and y, and the heading tolerance."""
        return super().tolerances._replace(yaw=self.parameters.yaw_goal_tolerance)
