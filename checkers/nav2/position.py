"""PositionGoalChecker: within a radius of the goal, whatever the heading."""

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
    path_length_tolerance: float = Field(default=1.0, ge=0.0, description="longer remaining paths are not judged [m]")
    stateful: bool = Field(default=True, description="a position once accepted stays accepted until reset")
    xy_goal_tolerance_buffer: float = Field(default=0.0, ge=0.0, description="drift that ends the acceptance [m]")


class _PositionLatch:
    """Remembers that the position was accepted, with a hysteresis buffer."""

    def __init__(self) -> None:
        self._accepted = False

    def reset(self) -> None:
        """Forget it."""
        self._accepted = False

    def accepts(self, distance: float, parameters: PositionParameters) -> bool:
        """Whether the position at `distance` [m] from the goal counts as reached.

        A latched position stays reached until, with a buffer, it drifts beyond tolerance + buffer.
        """
        p = parameters
        if self._accepted and p.stateful:
            drifted = p.xy_goal_tolerance_buffer > 0.0 and distance > p.xy_goal_tolerance + p.xy_goal_tolerance_buffer
            self._accepted = not drifted
            return self._accepted
        inside = distance <= p.xy_goal_tolerance
        self._accepted = inside and p.stateful
        return inside


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
        self._latch = _PositionLatch()

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
