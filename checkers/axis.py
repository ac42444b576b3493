"""AxisGoalChecker: separate tolerances along and across the end of the path."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Literal, NamedTuple

from pydantic import Field

from checkers._measures import is_stopped, longer_than
from optdock.errors import InvalidValue
from optdock.plugins.interfaces import GoalChecker, Tolerances
from optdock.plugins.parameters import PluginParameters

if TYPE_CHECKING:
    from collections.abc import Sequence

    from optdock.geometry.pose import Pose2, Twist2

__all__ = ["AxisGoalChecker", "AxisGoalCheckerParameters"]

_AT_GOAL = 1e-6  # [m]: within this distance Nav2's versions accept the goal with any tolerances
_DISTINCT = 1e-6  # [m]: closer poses define no direction


class AxisGoalCheckerParameters(PluginParameters):
    """Nav2's parameters of the AxisGoalChecker; the defaults give the documented behaviour.

    If `direction_estimation_distance` is 0, the axis passes through the last two distinct poses; otherwise it begins at
    the last pose at that distance or more from the end, and is kept when the remaining path is shorter. Nav2's
    versions: #5746 has axis_end goal and a radial fallback of hypot(along, cross); #6345 has axis_end goal and a
    baseline of 0.15 m, with `reset` before every call; #6420 is the same without resets; #6513 adds the radial
    parameter.

    If `stopped`, the robot must be at rest; the two velocities have the names of Nav2's StoppedGoalChecker.
    """

    along_path_tolerance: float = Field(default=0.25, ge=0.0, description="accepted error along the axis [m]")
    cross_track_tolerance: float = Field(default=0.25, ge=0.0, description="accepted error across the axis [m]")
    path_length_tolerance: float = Field(
        default=1.0, ge=0.0, description="remaining path length above which the goal is not reached [m]"
    )
    is_overshoot_valid: bool = Field(default=False, description="accept any distance past the goal")
    direction_estimation_distance: float = Field(default=0.0, ge=0.0, description="baseline of the axis [m]")
    fallback_radial_goal_tolerance: float | None = Field(
        default=None, ge=0.0, description="accepted distance if there is no axis [m]; None: the smaller tolerance"
    )
    axis_end: Literal["path", "goal"] = Field(
        default="path", description="the axis ends at the last pose of the path, or (Nav2 since #5746) at the goal"
    )
    stopped: bool = Field(default=False, description="require the robot to be at rest")
    trans_stopped_velocity: float = Field(default=0.01, ge=0.0, description="largest speed at rest [m/s]")
    rot_stopped_velocity: float = Field(default=0.02, ge=0.0, description="largest yaw rate at rest [rad/s]")


class _EndDirection(NamedTuple):
    """Unit vector along the end of the path."""

    x: float
    y: float


class AxisGoalChecker(GoalChecker):
    """Goal checker that accepts a robot within tolerance along and across the end of the path.

    With u the unit vector along the end of the path and g the vector from the robot to the goal, along = g . u
    (positive in front of the goal) and cross = g x u, which Nav2 writes as d cos(angle) and d sin(angle). All
    comparisons are strict. Yaw is not checked; the velocity is checked only if `stopped`.

    The goal is not reached while the remaining path is longer than `path_length_tolerance`. Without an axis (a single
    pose) the distance must be below the radial fallback; otherwise along and cross must be within tolerance. With
    `axis_end: goal`, which is the behaviour of every release of Nav2, a robot within 1e-6 m of the goal is considered
    to have reached it, whatever the tolerances. Poses that are equal to the last pose are skipped.
    `direction_estimation_distance` must be below `path_length_tolerance`.

    >>> from optdock.geometry.pose import Pose2, Twist2
    >>> checker = AxisGoalChecker(along_path_tolerance=0.05, cross_track_tolerance=0.3)
    >>> path = [Pose2(-1.0, 0.0, 0.0), Pose2(0.0, 0.0, 0.0)]
    >>> checker.is_goal_reached(Pose2(-0.04, 0.2, 1.0), path[-1], Twist2(), path)
    True
    >>> checker.is_goal_reached(Pose2(0.06, 0.0, 0.0), path[-1], Twist2(), path)
    False
    """

    Parameters = AxisGoalCheckerParameters
    parameters: AxisGoalCheckerParameters

    def __init__(self, **parameters: object) -> None:
        super().__init__(**parameters)
        _check_baseline(self.parameters, self.parameters.path_length_tolerance)
        self._cached_axis: _EndDirection | None = None

    def is_goal_reached(self, query_pose: Pose2, goal_pose: Pose2, velocity: Twist2, path: Sequence[Pose2]) -> bool:
        """Whether the robot is within tolerance along and across the end of `path`, and at rest if `stopped`."""
        p = self.parameters
        in_position = self.is_goal_xy_reached(query_pose, goal_pose, velocity, path)
        return in_position and (not p.stopped or is_stopped(velocity, p.trans_stopped_velocity, p.rot_stopped_velocity))

    def is_goal_xy_reached(self, query_pose: Pose2, goal_pose: Pose2, velocity: Twist2, path: Sequence[Pose2]) -> bool:  # noqa: ARG002 - the interface's
        """Whether the position is within tolerance, at any speed."""
        p = self.parameters
        if longer_than(path, p.path_length_tolerance):
            return False
        dx, dy = goal_pose.x - query_pose.x, goal_pose.y - query_pose.y
        distance = math.hypot(dx, dy)
        axis = self._axis(goal_pose, path)
        if axis is None:
            return distance < self._radial_tolerance
        if p.axis_end == "goal" and distance < _AT_GOAL:
            return True
        along, cross = dx * axis.x + dy * axis.y, dx * axis.y - dy * axis.x
        near_enough = along if p.is_overshoot_valid else abs(along)
        return near_enough < p.along_path_tolerance and abs(cross) < p.cross_track_tolerance

    @property
    def tolerances(self) -> Tolerances:
        """The smaller tolerance in x and y, as in Nav2, and the speeds if `stopped`; there is no yaw tolerance."""
        p = self.parameters
        radius = min(p.along_path_tolerance, p.cross_track_tolerance)
        return Tolerances(
            x=radius,
            y=radius,
            linear_speed=p.trans_stopped_velocity if p.stopped else None,
            angular_speed=p.rot_stopped_velocity if p.stopped else None,
            path_length=p.path_length_tolerance,
        )

    def reset(self) -> None:
        """Clear the kept axis before a new path."""
        self._cached_axis = None

    def check_change(self, changed: PluginParameters) -> None:
        """Check that a new baseline is below the present path_length_tolerance.

        Raises:
            InvalidValue: If the baseline is not below that tolerance.
        """
        if isinstance(changed, AxisGoalCheckerParameters):
            old, new = self.parameters.direction_estimation_distance, changed.direction_estimation_distance
            if old != new:
                _check_baseline(changed, self.parameters.path_length_tolerance)

    @property
    def _radial_tolerance(self) -> float:
        p = self.parameters
        given = p.fallback_radial_goal_tolerance
        return min(p.along_path_tolerance, p.cross_track_tolerance) if given is None else given

    def _axis(self, goal_pose: Pose2, path: Sequence[Pose2]) -> _EndDirection | None:
        p = self.parameters
        if not path:
            return self._cached_axis
        end = path[-1] if p.axis_end == "path" else goal_pose
        found = _end_axis(path, end, max(_DISTINCT, p.direction_estimation_distance))
        if p.direction_estimation_distance <= 0.0:
            return found
        self._cached_axis = found or self._cached_axis
        return self._cached_axis


def _end_axis(path: Sequence[Pose2], end: Pose2, baseline: float) -> _EndDirection | None:
    """Return the direction to `end` from the last pose before the final pose that is at least `baseline` away."""
    for i in range(len(path) - 2, -1, -1):
        dx, dy = end.x - path[i].x, end.y - path[i].y
        distance = math.hypot(dx, dy)
        if distance >= baseline:
            return _EndDirection(dx / distance, dy / distance)
    return None


def _check_baseline(parameters: AxisGoalCheckerParameters, path_length_tolerance: float) -> None:
    baseline = parameters.direction_estimation_distance
    if baseline > 0.0 and baseline >= path_length_tolerance:
        raise InvalidValue(
            f"AxisGoalChecker.direction_estimation_distance: must be < path_length_tolerance = "
            f"{path_length_tolerance} m, got {baseline}"
        )
