"""StoppedGoalChecker: the SimpleGoalChecker, and the robot stands still."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from checkers._errors import is_stopped, yaw_error
from checkers._plan import longer_than
from checkers._position import PositionLatch
from checkers.simple import SimpleGoalCheckerParameters
from optdock.interfaces import GoalChecker, Tolerances

if TYPE_CHECKING:
    from collections.abc import Sequence

    from optdock.geometry.pose import Pose2, Twist2

__all__ = ["StoppedGoalChecker", "StoppedGoalCheckerParameters"]


class StoppedGoalCheckerParameters(SimpleGoalCheckerParameters):
    """Nav2's parameters of the StoppedGoalChecker."""

    trans_stopped_velocity: float = Field(default=0.25, ge=0.0, description="largest speed at rest [m/s]")
    rot_stopped_velocity: float = Field(default=0.25, ge=0.0, description="largest yaw rate at rest [rad/s]")


class StoppedGoalChecker(GoalChecker):
    """Nav2's StoppedGoalChecker: position (latched), heading, and both speeds within tolerance, inclusively.

    Args:
        **parameters: Fields of `StoppedGoalCheckerParameters`.

    Raises:
        InvalidValue: A parameter is unknown, of the wrong type or negative.
    """

    Parameters = StoppedGoalCheckerParameters
    parameters: StoppedGoalCheckerParameters

    def __init__(self, **parameters: object) -> None:
        super().__init__(**parameters)
        self._latch = PositionLatch()

    def is_goal_reached(self, query_pose: Pose2, goal_pose: Pose2, velocity: Twist2, path: Sequence[Pose2]) -> bool:
        """Whether position, heading and rest are accepted; a remaining path that is too long is not judged."""
        p = self.parameters
        if longer_than(path, p.path_length_tolerance):
            return False
        if not self._latch.accepts(query_pose.distance_to(goal_pose), p):
            return False
        aligned = yaw_error(query_pose, goal_pose, symmetric=p.symmetric_yaw_tolerance) <= p.yaw_goal_tolerance
        return aligned and is_stopped(velocity, p.trans_stopped_velocity, p.rot_stopped_velocity)

    @property
    def tolerances(self) -> Tolerances:
        """Radius, heading tolerance and the speeds that count as rest."""
        p = self.parameters
        return Tolerances(
            x=p.xy_goal_tolerance,
            y=p.xy_goal_tolerance,
            yaw=p.yaw_goal_tolerance,
            linear_speed=p.trans_stopped_velocity,
            angular_speed=p.rot_stopped_velocity,
            path_length=p.path_length_tolerance,
        )

    def reset(self) -> None:
        """Forget the latch."""
        self._latch.reset()
