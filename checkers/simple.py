"""SimpleGoalChecker: within a radius of the goal, and at its heading."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from checkers._errors import yaw_error
from checkers._plan import longer_than
from checkers._position import PositionLatch, PositionParameters
from optdock.interfaces import GoalChecker, Tolerances

if TYPE_CHECKING:
    from collections.abc import Sequence

    from optdock.geometry.pose import Pose2, Twist2

__all__ = ["SimpleGoalChecker", "SimpleGoalCheckerParameters"]


class SimpleGoalCheckerParameters(PositionParameters):
    """Nav2's parameters of the SimpleGoalChecker."""

    yaw_goal_tolerance: float = Field(default=0.25, ge=0.0, description="accepted heading error [rad]")
    symmetric_yaw_tolerance: bool = Field(default=False, description="accept the opposite heading as well")


class SimpleGoalChecker(GoalChecker):
    """Nav2's SimpleGoalChecker: position within a radius (latched when stateful) and heading within a tolerance.

    The position latches also on a call whose heading fails; the heading is checked at every call. Comparisons are
    inclusive.

    Args:
        **parameters: Fields of `SimpleGoalCheckerParameters`.

    Raises:
        InvalidValue: A parameter is unknown, of the wrong type or negative.
    """

    Parameters = SimpleGoalCheckerParameters
    parameters: SimpleGoalCheckerParameters

    def __init__(self, **parameters: object) -> None:
        super().__init__(**parameters)
        self._latch = PositionLatch()

    def is_goal_reached(
        self,
        query_pose: Pose2,
        goal_pose: Pose2,
        velocity: Twist2,  # noqa: ARG002 - part of the interface
        path: Sequence[Pose2],
    ) -> bool:
        """Whether position and heading are accepted; a remaining path that is too long is not judged."""
        p = self.parameters
        if longer_than(path, p.path_length_tolerance):
            return False
        if not self._latch.accepts(query_pose.distance_to(goal_pose), p):
            return False
        return yaw_error(query_pose, goal_pose, symmetric=p.symmetric_yaw_tolerance) <= p.yaw_goal_tolerance

    @property
    def tolerances(self) -> Tolerances:
        """The radius in x and y, and the heading tolerance."""
        p = self.parameters
        radius = p.xy_goal_tolerance
        return Tolerances(x=radius, y=radius, yaw=p.yaw_goal_tolerance, path_length=p.path_length_tolerance)

    def reset(self) -> None:
        """Forget the latch."""
        self._latch.reset()
