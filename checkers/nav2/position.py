"""PositionGoalChecker: within a radius of the goal, at any heading."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from checkers._measures import longer_than
from optdock.plugins.interfaces import GoalChecker, Tolerances
from optdock.plugins.parameters import PluginParameters

if TYPE_CHECKING:
    from collections.abc import Sequence

    from optdock.geometry.pose import Pose2, Twist2

__all__ = ["PositionGoalChecker", "PositionParameters"]


class PositionParameters(PluginParameters):
    """Nav2's parameters of the position check."""

    xy_goal_tolerance: float = Field(default=0.25, ge=0.0, description="accepted distance [m]")
    path_length_tolerance: float = Field(
        default=1.0, ge=0.0, description="remaining path length above which the goal is not reached [m]"
    )
    stateful: bool = Field(default=True, description="an accepted position stays accepted until reset")
    xy_goal_tolerance_buffer: float = Field(default=0.0, ge=0.0, description="drift that ends the acceptance [m]")


class PositionGoalChecker(GoalChecker):
    """Nav2's PositionGoalChecker: the goal is reached when the distance is at most `xy_goal_tolerance`.

    When stateful, an accepted position is latched until `reset`, or, with a buffer, until the distance exceeds
    tolerance + buffer.
    """

    Parameters = PositionParameters
    parameters: PositionParameters

    def __init__(self, **parameters: object) -> None:
        super().__init__(**parameters)
        self._accepted = False

    def is_goal_reached(self, query_pose: Pose2, goal_pose: Pose2, velocity: Twist2, path: Sequence[Pose2]) -> bool:
        """Whether the position is accepted."""
        return self.is_goal_xy_reached(query_pose, goal_pose, velocity, path)

    def is_goal_xy_reached(self, query_pose: Pose2, goal_pose: Pose2, velocity: Twist2, path: Sequence[Pose2]) -> bool:  # noqa: ARG002 - the interface's
        """Whether the position is accepted and the remaining path is not too long."""
        p = self.parameters
        if longer_than(path, p.path_length_tolerance):
            return False
        distance = query_pose.distance_to(goal_pose)
        if self._accepted and p.stateful:
            drifted = p.xy_goal_tolerance_buffer > 0.0 and distance > p.xy_goal_tolerance + p.xy_goal_tolerance_buffer
            self._accepted = not drifted
            return self._accepted
        inside = distance <= p.xy_goal_tolerance
        self._accepted = inside and p.stateful
        return inside

    @property
    def tolerances(self) -> Tolerances:
        """The radius in x and y."""
        p = self.parameters
        return Tolerances(x=p.xy_goal_tolerance, y=p.xy_goal_tolerance, path_length=p.path_length_tolerance)

    def reset(self) -> None:
        """Clear the latch."""
        self._accepted = False
