"""AdaptiveToleranceGoalChecker: a fine radius, and a coarse radius for a robot that makes no progress."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from pydantic import Field

from checkers._measures import is_stopped, longer_than, yaw_error
from optdock.plugins.interfaces import GoalChecker, Tolerances
from optdock.plugins.parameters import PluginParameters

if TYPE_CHECKING:
    from collections.abc import Sequence

    from optdock.geometry.pose import Pose2, Twist2

__all__ = ["AdaptiveToleranceGoalChecker", "AdaptiveToleranceGoalCheckerParameters"]


class AdaptiveToleranceGoalCheckerParameters(PluginParameters):
    """Nav2's parameters of the AdaptiveToleranceGoalChecker."""

    fine_xy_goal_tolerance: float = Field(default=0.10, ge=0.0, description="distance accepted at once [m]")
    coarse_xy_goal_tolerance: float = Field(
        default=0.25, ge=0.0, description="distance accepted without further progress [m]"
    )
    xy_goal_tolerance_buffer: float = Field(default=0.0, ge=0.0, description="drift that ends the acceptance [m]")
    yaw_goal_tolerance: float = Field(default=0.25, ge=0.0, description="accepted heading error [rad]")
    path_length_tolerance: float = Field(
        default=1.0, ge=0.0, description="remaining path length above which the goal is not reached [m]"
    )
    stateful: bool = Field(default=True, description="an accepted position stays accepted until reset")
    symmetric_yaw_tolerance: bool = Field(default=False, description="accept the opposite heading as well")
    trans_stopped_velocity: float = Field(default=0.10, ge=0.0, description="largest speed at rest [m/s]")
    rot_stopped_velocity: float = Field(default=0.10, ge=0.0, description="largest yaw rate at rest [rad/s]")
    required_stagnation_cycles: int = Field(
        default=15, ge=1, description="number of calls without progress after which the coarse tolerance applies"
    )


@dataclass
class _CoarseVisit:
    """State inside the coarse radius: first position relative to the goal [m], cycles without progress."""

    entry_x: float
    entry_y: float
    best_distance: float
    stopped_cycles: int = 0
    stagnant_cycles: int = 0


class AdaptiveToleranceGoalChecker(GoalChecker):
    """Nav2's AdaptiveToleranceGoalChecker.

    Inside the fine radius the position is accepted at any speed. After the first call inside the coarse radius the
    position is accepted once the robot has crossed the line through the goal perpendicular to its entry, after
    `required_stagnation_cycles` calls at rest, or after as many calls without a new least distance. Leaving the coarse
    radius resets this. An accepted position is latched when stateful, until the distance exceeds the radius that
    accepted it plus the buffer (if > 0). The heading is checked in every call. Comparisons are inclusive.
    """

    Parameters = AdaptiveToleranceGoalCheckerParameters
    parameters: AdaptiveToleranceGoalCheckerParameters

    def __init__(self, **parameters: object) -> None:
        super().__init__(**parameters)
        self._visit: _CoarseVisit | None = None
        self._accepted_radius: float | None = None

    def is_goal_reached(self, query_pose: Pose2, goal_pose: Pose2, velocity: Twist2, path: Sequence[Pose2]) -> bool:
        """Whether position and heading are accepted."""
        p = self.parameters
        if not self.is_goal_xy_reached(query_pose, goal_pose, velocity, path):
            return False
        return yaw_error(query_pose, goal_pose, symmetric=p.symmetric_yaw_tolerance) <= p.yaw_goal_tolerance

    def is_goal_xy_reached(self, query_pose: Pose2, goal_pose: Pose2, velocity: Twist2, path: Sequence[Pose2]) -> bool:
        """Whether the position is accepted; as in Nav2, every call counts as a cycle."""
        if longer_than(path, self.parameters.path_length_tolerance):
            return False
        return self._position_accepted(query_pose.x - goal_pose.x, query_pose.y - goal_pose.y, velocity)

    @property
    def tolerances(self) -> Tolerances:
        """The coarse radius, the heading tolerance and the speeds at rest."""
        p = self.parameters
        return Tolerances(
            x=p.coarse_xy_goal_tolerance,
            y=p.coarse_xy_goal_tolerance,
            yaw=p.yaw_goal_tolerance,
            linear_speed=p.trans_stopped_velocity,
            angular_speed=p.rot_stopped_velocity,
            path_length=p.path_length_tolerance,
        )

    def reset(self) -> None:
        """Clear the latch and the counters."""
        self._visit = None
        self._accepted_radius = None

    def _position_accepted(self, dx: float, dy: float, velocity: Twist2) -> bool:
        p, distance = self.parameters, math.hypot(dx, dy)
        if p.stateful and self._accepted_radius is not None:
            drifted = p.xy_goal_tolerance_buffer > 0.0 and distance > self._accepted_radius + p.xy_goal_tolerance_buffer
            if drifted:
                self.reset()
            return not drifted
        radius = self._accepting_radius(dx, dy, velocity)
        self._accepted_radius = radius
        return radius is not None

    def _accepting_radius(self, dx: float, dy: float, velocity: Twist2) -> float | None:
        """Return the radius within which the position is accepted in this call, or None."""
        p, distance = self.parameters, math.hypot(dx, dy)
        if distance <= p.fine_xy_goal_tolerance:
            return p.fine_xy_goal_tolerance
        if distance > p.coarse_xy_goal_tolerance:
            self._visit = None
            return None
        if self._visit is None:
            self._visit = _CoarseVisit(dx, dy, distance)
            return None
        return p.coarse_xy_goal_tolerance if self._has_stagnated(self._visit, dx, dy, velocity) else None

    def _has_stagnated(self, visit: _CoarseVisit, dx: float, dy: float, velocity: Twist2) -> bool:
        p, distance = self.parameters, math.hypot(dx, dy)
        visit.stagnant_cycles = 0 if distance < visit.best_distance else visit.stagnant_cycles + 1
        visit.best_distance = min(visit.best_distance, distance)
        stopped = is_stopped(velocity, p.trans_stopped_velocity, p.rot_stopped_velocity)
        visit.stopped_cycles = visit.stopped_cycles + 1 if stopped else 0
        crossed = dx * visit.entry_x + dy * visit.entry_y <= 0.0
        return crossed or max(visit.stopped_cycles, visit.stagnant_cycles) >= p.required_stagnation_cycles
