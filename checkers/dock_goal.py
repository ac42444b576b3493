"""DockGoalChecker: tolerances along, across and in heading in the frame of the dock, and rest."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

from pydantic import Field

from checkers._measures import is_stopped, longer_than, yaw_error
from optdock.model.dock import DockTolerances
from optdock.plugins.interfaces import GoalChecker, Tolerances
from optdock.plugins.parameters import PluginParameters

if TYPE_CHECKING:
    from collections.abc import Sequence

    from optdock.geometry.pose import Pose2, Twist2

__all__ = ["DockGoalChecker", "DockGoalCheckerParameters"]


class DockGoalCheckerParameters(PluginParameters):
    """Tolerances of a dock; by default the first three are the tolerances of the dock in the configured problem."""

    along_tolerance: float | None = Field(default=None, ge=0.0, description="accepted error along the heading [m]")
    cross_tolerance: float | None = Field(default=None, ge=0.0, description="accepted error across the heading [m]")
    yaw_goal_tolerance: float | None = Field(default=None, ge=0.0, description="accepted heading error [rad]")
    path_length_tolerance: float = Field(
        default=1.0, ge=0.0, description="remaining path length above which the goal is not reached [m]"
    )
    stopped: bool = Field(default=True, description="require the robot to be at rest")
    trans_stopped_velocity: float = Field(default=0.01, ge=0.0, description="largest speed at rest [m/s]")
    rot_stopped_velocity: float = Field(default=0.02, ge=0.0, description="largest yaw rate at rest [rad/s]")
    stateful: bool = Field(default=True, description="a reached goal stays reached until reset")


class _Accepted(NamedTuple):
    """Accepted errors along and across [m] and of heading [rad]."""

    along: float
    cross: float
    yaw: float


class DockGoalChecker(GoalChecker):
    """Goal checker that accepts a robot at rest in the dock, with the dock's heading.

    The axis is the heading of the goal, so the shape of the remaining path has no influence. The errors along and
    across, the heading and rest (if `stopped`) must be accepted in the same call. All comparisons are inclusive. When
    stateful, an accepted arrival stays accepted until `reset`, even with noise in the measured pose. Tolerances that
    are not given are those of the dock of the configured problem, or else the defaults of `DockTolerances` (2 cm, 2 cm,
    0.05 rad).

    >>> from optdock.geometry.pose import Pose2, Twist2
    >>> checker = DockGoalChecker(along_tolerance=0.01)
    >>> checker.is_goal_reached(Pose2(0.01, 0.02, 0.05), Pose2(0.0, 0.0, 0.0), Twist2(), [])
    True
    """

    Parameters = DockGoalCheckerParameters
    parameters: DockGoalCheckerParameters

    def __init__(self, **parameters: object) -> None:
        super().__init__(**parameters)
        self._reached = False

    def is_goal_reached(self, query_pose: Pose2, goal_pose: Pose2, velocity: Twist2, path: Sequence[Pose2]) -> bool:
        """Whether the robot is docked."""
        p = self.parameters
        in_position = self.is_goal_xy_reached(query_pose, goal_pose, velocity, path)
        at_rest = not p.stopped or is_stopped(velocity, p.trans_stopped_velocity, p.rot_stopped_velocity)
        aligned = yaw_error(query_pose, goal_pose) <= self._accepted.yaw
        self._reached = self._is_latched or (in_position and at_rest and aligned)
        return self._reached

    def is_goal_xy_reached(self, query_pose: Pose2, goal_pose: Pose2, velocity: Twist2, path: Sequence[Pose2]) -> bool:  # noqa: ARG002 - the interface's
        """Whether the errors along and across are accepted, or the arrival is latched; the latch is not changed."""
        p = self.parameters
        if self._is_latched:
            return True
        if longer_than(path, p.path_length_tolerance):
            return False
        dx, dy = query_pose.x - goal_pose.x, query_pose.y - goal_pose.y
        c, s = math.cos(goal_pose.yaw), math.sin(goal_pose.yaw)
        accepted = self._accepted
        return abs(c * dx + s * dy) <= accepted.along and abs(c * dy - s * dx) <= accepted.cross

    @property
    def tolerances(self) -> Tolerances:
        """The tolerances along (in x), across (in y) and of the heading, and the speeds at rest."""
        p, accepted = self.parameters, self._accepted
        return Tolerances(
            x=accepted.along,
            y=accepted.cross,
            yaw=accepted.yaw,
            linear_speed=p.trans_stopped_velocity if p.stopped else None,
            angular_speed=p.rot_stopped_velocity if p.stopped else None,
            path_length=p.path_length_tolerance,
        )

    def reset(self) -> None:
        """Clear the latched arrival before a new attempt."""
        self._reached = False

    @property
    def _accepted(self) -> _Accepted:
        p, problem = self.parameters, self.context.problem
        dock = problem.dock.tolerances if problem is not None else DockTolerances()
        return _Accepted(
            dock.along if p.along_tolerance is None else p.along_tolerance,
            dock.cross if p.cross_tolerance is None else p.cross_tolerance,
            dock.yaw if p.yaw_goal_tolerance is None else p.yaw_goal_tolerance,
        )

    @property
    def _is_latched(self) -> bool:
        return self._reached and self.parameters.stateful
