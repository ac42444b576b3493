"""PositionGoalChecker: within a radius of the goal, whatever the heading."""

from __future__ import annotations

from typing import TYPE_CHECKING

from checkers._plan import longer_than
from checkers._position import PositionLatch, PositionParameters
from optdock.interfaces import GoalChecker, Tolerances

if TYPE_CHECKING:
    from collections.abc import Sequence

    from optdock.geometry.pose import Pose2, Twist2

__all__ = ["PositionGoalChecker"]


class PositionGoalChecker(GoalChecker):
    """Nav2's PositionGoalChecker: reached when the distance is at most `xy_goal_tolerance`, latched when stateful.

    Args:
        **parameters: Fields of `PositionParameters`.

    Raises:
        InvalidValue: A parameter is unknown, of the wrong type or negative.
    """

    Parameters = PositionParameters
    parameters: PositionParameters

    def __init__(self, **parameters: object) -> None:
        super().__init__(**parameters)
        self._latch = PositionLatch()

    def is_goal_reached(self, query_pose: Pose2, goal_pose: Pose2, velocity: Twist2, path: Sequence[Pose2]) -> bool:
        """Whether the robot's position is accepted; a remaining path that is too long is not judged."""
        return self.is_goal_xy_reached(query_pose, goal_pose, velocity, path)

    def is_goal_xy_reached(
        self,
        query_pose: Pose2,
        goal_pose: Pose2,
        velocity: Twist2,  # noqa: ARG002 - part of the interface
        path: Sequence[Pose2],
    ) -> bool:
        """Whether the robot's position is accepted; a remaining path that is too long is not judged."""
        if longer_than(path, self.parameters.path_length_tolerance):
            return False
        return self._latch.accepts(query_pose.distance_to(goal_pose), self.parameters)

    @property
    def tolerances(self) -> Tolerances:
        """The radius in x and y."""
        p = self.parameters
        return Tolerances(x=p.xy_goal_tolerance, y=p.xy_goal_tolerance, path_length=p.path_length_tolerance)

    def reset(self) -> None:
        """Forget the latch."""
        self._latch.reset()
