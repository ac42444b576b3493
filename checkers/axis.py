"""AxisGoalChecker: separate tolerances along the end of the path and across it."""

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

_AT_GOAL = 1e-6  # [m]: nearer than this Nav2's variants call the goal reached whatever the tolerances
_DISTINCT = 1e-6  # [m]: poses nearer than this to each other give no direction


class AxisGoalCheckerParameters(PluginParameters):
    """Nav2's parameters of the AxisGoalChecker; the defaults give the documented behaviour.

    Three are Nav2's later repairs. `direction_estimation_distance` 0 takes the axis from the last two
    distinct poses; above 0 from the first pose, walking back, at least that far away, and the axis found is kept
    for when the remaining path has become too short. Nav2 as merged in #5746: axis_end goal and a radial fallback of
    hypot(along, cross). In #6345: axis_end goal and a baseline of 0.15 m, `reset` before every call. In #6420: the
    same without the resets; #6513 adds the radial parameter.

    The document's checker looks at positions only, so a robot may pass through the goal at speed; `stopped` and the two
    velocities, named as in Nav2's StoppedGoalChecker, make it wait for rest: what a dock needs.
    """

    along_path_tolerance: float = Field(default=0.25, ge=0.0, description="accepted error along the axis [m]")
    cross_track_tolerance: float = Field(default=0.25, ge=0.0, description="accepted error across the axis [m]")
    path_length_tolerance: float = Field(default=1.0, ge=0.0, description="longer remaining paths are not judged [m]")
    is_overshoot_valid: bool = Field(default=False, description="accept any distance past the goal")
    direction_estimation_distance: float = Field(default=0.0, ge=0.0, description="baseline of the axis [m]")
    fallback_radial_goal_tolerance: float | None = Field(
        default=None, ge=0.0, description="radius where there is no axis [m]; None: the smaller tolerance"
    )
    axis_end: Literal["path", "goal"] = Field(
        default="path", description="the axis ends at the last pose of the path, or (Nav2 since #5746) at the goal"
    )
    stopped: bool = Field(default=False, description="the robot must also stand still")
    trans_stopped_velocity: float = Field(default=0.01, ge=0.0, description="largest speed at rest [m/s]")
    rot_stopped_velocity: float = Field(default=0.02, ge=0.0, description="largest yaw rate at rest [rad/s]")


class _EndDirection(NamedTuple):
    """Unit vector of the end of the path."""

    x: float
    y: float


class AxisGoalChecker(GoalChecker):
    """Reached when the robot is within tolerance along the last stretch of the path and across it.

    With u the unit vector of the path's end and g the vector from the robot to the goal, along = g . u (positive
    short of the goal) and cross = g x u: the two dot products that Nav2 writes as d cos(angle) and d sin(angle).
    Every comparison is strict; at exactly a tolerance the goal is not reached. Yaw is not looked at, and velocity only
    if `stopped`.

    In order: a remaining path longer than `path_length_tolerance` is not judged; without an axis (a single pose)
    the distance must be below the radial fallback; else along and cross decide. With `axis_end: goal`, as in every
    release of Nav2, a robot within 1e-6 m of the goal is there before any tolerance is asked. Poses that repeat the
    last one give no direction, so the axis comes from the last pose that differs.

    Args:
        **parameters: Fields of `AxisGoalCheckerParameters`.

    Raises:
        InvalidValue: A parameter is unknown, of the wrong type or negative, or direction_estimation_distance is not
            below path_length_tolerance.

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

    def is_goal_reached(
        self,
        query_pose: Pose2,
        goal_pose: Pose2,
        velocity: Twist2,
        path: Sequence[Pose2],
    ) -> bool:
        """Whether the robot is at the goal, judged along and across the end of `path`, and at rest if `stopped`."""
        p = self.parameters
        in_position = self.is_goal_xy_reached(query_pose, goal_pose, velocity, path)
        return in_position and (not p.stopped or is_stopped(velocity, p.trans_stopped_velocity, p.rot_stopped_velocity))

    def is_goal_xy_reached(
        self,
        query_pose: Pose2,
        goal_pose: Pose2,
        velocity: Twist2,  # noqa: ARG002 - part of the interface
        path: Sequence[Pose2],
    ) -> bool:
        """Whether its position is, at any speed."""
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
        """The smaller tolerance in x and y, as Nav2 reports it; yaw is not measured, speed only if `stopped`."""
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
        """A new path begins: forget the kept axis."""
        self._cached_axis = None

    def check_change(self, changed: PluginParameters) -> None:
        """Refuse a baseline that is not below the path_length_tolerance in force.

        Raises:
            InvalidValue: As described.
        """
        if isinstance(changed, AxisGoalCheckerParameters) and _baseline_changed(self.parameters, changed):
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
    """Direction to `end` from the last pose before the path's own last that is `baseline` or more away."""
    for i in range(len(path) - 2, -1, -1):
        dx, dy = end.x - path[i].x, end.y - path[i].y
        distance = math.hypot(dx, dy)
        if distance >= baseline:
            return _EndDirection(dx / distance, dy / distance)
    return None


def _baseline_changed(old: AxisGoalCheckerParameters, new: AxisGoalCheckerParameters) -> bool:
    return old.direction_estimation_distance != new.direction_estimation_distance


def _check_baseline(parameters: AxisGoalCheckerParameters, path_length_tolerance: float) -> None:
    baseline = parameters.direction_estimation_distance
    if baseline > 0.0 and baseline >= path_length_tolerance:
        raise InvalidValue(
            f"AxisGoalChecker.direction_estimation_distance: must be < path_length_tolerance = "
            f"{path_length_tolerance} m, got {baseline}"
        )
