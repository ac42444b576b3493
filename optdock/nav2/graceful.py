"""GracefulController: Nav2's path follower around the smooth control law; the baseline to beat."""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING, Final

import numpy as np
from pydantic import Field, model_validator

from optdock.controllers.checks import checked_speed_limit, checked_task
from optdock.controllers.control_clock import ControlClock
from optdock.controllers.look_ahead import LookAhead, collision_ahead, stopping_time, stopping_way
from optdock.errors import ControllerInvalidPath, NoValidControl
from optdock.geometry.pose import Pose2, Twist2, normalize_angle
from optdock.model.path import Direction, Path
from optdock.model.trajectory import Trajectory
from optdock.nav2.graceful_law import GracefulLaw
from optdock.plugins.interfaces import Controller
from optdock.plugins.parameters import PluginParameters
from optdock.verification.time_of_impact import free_motion

if TYPE_CHECKING:
    from typing_extensions import Self

    from optdock.geometry.obstacles import ObstacleSet
    from optdock.plugins.interfaces import GoalChecker

__all__ = ["GracefulController", "GracefulControllerParameters"]

_SPACING: Final = 0.05  # [m], of the poses that a target is chosen from
_SEARCH_WINDOW: Final = 40  # poses ahead that may be the nearest: Nav2's 2 m
_ROLLOUT_STEP: Final = 0.1  # [s]
_ROLLOUT_STEPS: Final = 100
_AT_TARGET: Final = 0.01  # [m]: where a rollout ends
_DEFAULT_XY_TOLERANCE: Final = 0.25  # [m], without a goal checker
_CONTACT: Final = 0.01  # [m]: overlap of a robot at rest in its dock, as in `free_motion`
_CUSP_TOLERANCE: Final = 0.05  # [m]: where the next gear begins


class GracefulControllerParameters(PluginParameters):
    """Nav2's parameters and defaults, and `period`; those about costmap cells and scaled footprints are missing."""

    period: float | None = Field(
        default=None, gt=0.0, description="time between two calls [s]; None: measured from their stamps"
    )

    min_lookahead: float = Field(default=0.25, gt=0.0, description="nearest target [m]")
    max_lookahead: float = Field(default=1.0, gt=0.0, description="furthest target [m]")
    k_phi: float = Field(default=2.0, gt=0.0, description="ratio of the rates of phi and r")
    k_delta: float = Field(default=1.0, gt=0.0, description="convergence of the heading")
    beta: float = Field(default=0.4, ge=0.0, description="how much curvature slows down")
    lambda_: float = Field(default=2.0, gt=0.0, alias="lambda", description="exponent of the same")
    v_linear_min: float = Field(default=0.1, ge=0.0, description="smallest speed on the way [m/s]")
    v_linear_max: float = Field(default=0.5, gt=0.0, description="largest speed [m/s]")
    v_angular_max: float = Field(default=1.0, gt=0.0, description="largest yaw rate [rad/s]")
    v_angular_min_in_place: float = Field(
        default=0.25, ge=0.0, description="smallest yaw rate of a turn in place [rad/s]"
    )
    slowdown_radius: float = Field(
        default=1.5, ge=0.0, description="distance from the target below which the speed falls [m]"
    )
    deceleration_max: float = Field(default=2.5, gt=0.0, description="how hard it may brake towards the target [m/s^2]")
    initial_rotation: bool = Field(default=True, description="turn towards the path first")
    initial_rotation_tolerance: float = Field(
        default=0.75, gt=0.0, description="heading error at which the first turn ends [rad]"
    )
    prefer_final_rotation: bool = Field(default=True, description="ignore the final heading until at the goal")
    rotation_scaling_factor: float = Field(
        default=0.5, gt=0.0, description="yaw rate per angle, in v_angular_max [1/rad]"
    )
    allow_backward: bool = Field(default=False, description="follow reverse gears; excludes initial_rotation")
    use_collision_detection: bool = Field(default=True, description="roll the law out among the obstacles")

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.min_lookahead > self.max_lookahead:
            raise ValueError(
                f"min_lookahead: must be <= max_lookahead = {self.max_lookahead} m, got {self.min_lookahead}"
            )
        if self.v_linear_min > self.v_linear_max:
            raise ValueError(
                f"v_linear_min: must be <= v_linear_max = {self.v_linear_max} m/s, got {self.v_linear_min}"
            )
        if self.v_angular_min_in_place > self.v_angular_max:
            raise ValueError(
                f"v_angular_min_in_place: must be <= v_angular_max = {self.v_angular_max} rad/s, got "
                f"{self.v_angular_min_in_place}"
            )
        if self.allow_backward and self.initial_rotation:
            raise ValueError("allow_backward: needs initial_rotation: false")
        return self


class GracefulController(Controller):
    """Steers towards the furthest path pose within the lookahead whose rollout is free.

    As in Nav2: turn towards the path first, follow with the smooth law, turn to the final heading at the goal. Paths
    are followed one gear at a time; a reverse gear needs `allow_backward`. The rollout moves the footprint continuously
    through whatever the context holds, a problem or costmaps, and no command is given, a turn in place neither, after
    which the robot could not stop before it is in something; without a footprint nothing is checked. Commands step
    from rest to speed, as Nav2's do: neither curvature nor acceleration is limited. A cancelled task, which Nav2's
    drops at full speed, is braked on its arc by `deceleration_max`; a turn in place just ends.

    Args:
        **parameters: Fields of `GracefulControllerParameters`; `lambda` is passed as `**{"lambda": 2.0}`.

    Raises:
        InvalidValue: A parameter is unknown or out of range, a smallest value exceeds its largest, or allow_backward
            is asked for together with initial_rotation, which would turn the robot round.
    """

    Parameters = GracefulControllerParameters
    parameters: GracefulControllerParameters

    def __init__(self, **parameters: object) -> None:
        super().__init__(**parameters)
        self._speed_share = 1.0
        self._legs: list[tuple[Direction, list[Pose2]]] = []
        self._turned = self._arrived = self._cancelled = False
        self._last = Twist2()
        self._clock = ControlClock()
        self._look_ahead = LookAhead()
        self._ends = np.zeros((0, 3))

    def set_path(self, path: Path | Trajectory, *, start_stamp: float | None = None) -> None:  # noqa: ARG002 - no time law
        """Follow a path; the time law of a trajectory is ignored, and with it when it begins.

        Raises:
            ControllerInvalidPath: It is neither a path nor a trajectory, it stands in another frame than the configured
                problem or was certified for another one, or it has a reverse gear and allow_backward is off.
        """
        path = checked_task(path, self.context, "GracefulController")
        path = path.path if isinstance(path, Trajectory) else path
        if path.turns:
            raise ControllerInvalidPath(
                "GracefulController: the path turns in place; only TrackingController does that"
            )
        legs = [
            (segment.direction, [Pose2.from_sequence(row) for row in Path((segment,)).sample(_SPACING).poses])
            for segment in path.segments
        ]
        if not self.parameters.allow_backward and any(gear is Direction.REVERSE for gear, _ in legs):
            raise ControllerInvalidPath("GracefulController: the path has a reverse gear; set allow_backward")
        self._legs = legs
        self._ends = np.array([pose.as_array() for pose in (path.start, path.end)])
        self._arrived = self._cancelled = False
        self._turned = not self.parameters.initial_rotation

    def compute_velocity_commands(
        self,
        pose: Pose2,
        velocity: Twist2,  # noqa: ARG002 - part of the interface
        goal_checker: GoalChecker | None,
        *,
        stamp: float | None = None,
    ) -> Twist2:
        """The command of this cycle.

        Raises:
            ControllerInvalidPath: There is no path.
            NoValidControl: Every rollout collides, the path is out of reach, or the clock went back.
        """
        if not self._legs:
            raise ControllerInvalidPath("GracefulController: has no path; call set_path first")
        self._clock.tick(stamp, self.context, self.parameters.period)
        command = self._braked() if self._cancelled else self._followed(pose, goal_checker)
        self._last = Twist2()  # what a refusal leaves the robot with
        self._require_free_stop(pose, command)
        self._last = command
        return command

    def set_speed_limit(self, limit: float, percentage: bool) -> None:  # noqa: FBT001 - Nav2's order of arguments
        """Scale both speeds, to `limit` percent or to `limit` m/s; never below v_linear_min; 0 removes the limit.

        Raises:
            InvalidValue: The limit is negative or not finite, or `percentage` is no bool.
        """
        limit = checked_speed_limit(limit, percentage, "GracefulController")
        top = self.parameters.v_linear_max
        share = (limit / 100.0 if percentage else limit / top) if limit > 0.0 else 1.0
        self._speed_share = min(1.0, share)

    def cancel(self) -> bool:
        """Brake; True once the commands are zero."""
        self._cancelled = True
        return not self._legs or self._last == Twist2()

    def reset(self) -> None:
        """Forget the path."""
        self._legs = []
        self._cancelled = False
        self._last = Twist2()
        self._clock = ControlClock()

    @property
    def law(self) -> GracefulLaw:
        """The control law with the present speed limit."""
        p, share = self.parameters, self._speed_share
        return GracefulLaw(
            p.k_phi,
            p.k_delta,
            p.beta,
            p.lambda_,
            p.slowdown_radius,
            p.deceleration_max,
            p.v_linear_min,
            max(p.v_linear_min, share * p.v_linear_max),
            share * p.v_angular_max,
        )

    def _followed(self, pose: Pose2, goal_checker: GoalChecker | None) -> Twist2:
        """The command that follows the path."""
        self._drop_driven(pose)
        gear, leg = self._legs[0]
        tolerance = goal_checker.tolerances.x if goal_checker else None
        last_leg = len(self._legs) == 1
        if last_leg and leg[-1].distance_to(pose) < (tolerance or _DEFAULT_XY_TOLERANCE):
            self._arrived = True
        if self._arrived:
            return self._turn(normalize_angle(leg[-1].yaw - pose.yaw))
        if not self._turned:
            angle = _bearing(self._nearest_target(pose, leg), pose)
            self._turned = abs(angle) < self.parameters.initial_rotation_tolerance
            if not self._turned:
                return self._turn(angle)
        return self._towards(pose, gear, leg)

    def _require_free_stop(self, pose: Pose2, command: Twist2) -> None:
        """Refuse a command, a turn in place too, after which the robot could not stop before it is in something."""
        p, footprint = self.parameters, self.context.footprint
        if footprint is None or not p.use_collision_detection:
            return
        braking = 0.5 * stopping_time(command, p.deceleration_max)  # which covers half of what the command would
        way = stopping_way(pose, footprint, ((command, self._clock.period + braking),))
        found = self._look_ahead.obstruction(self.context, way, self._ends, _CONTACT)
        if found is not None:
            raise collision_ahead(self.context, found)

    def _braked(self) -> Twist2:
        """The last command slowed down by one period, its curvature kept."""
        p, speed = self.parameters, abs(self._last.linear)
        share = max(0.0, 1.0 - p.deceleration_max * self._clock.elapsed / speed) if speed > 0.0 else 0.0
        return Twist2(share * self._last.linear, share * self._last.angular)

    def _drop_driven(self, pose: Pose2) -> None:
        """Forget the poses behind the robot, and a leg whose cusp is reached."""
        _, leg = self._legs[0]
        distances = [waypoint.distance_to(pose) for waypoint in leg[:_SEARCH_WINDOW]]
        del leg[: int(np.argmin(distances))]
        if len(self._legs) > 1 and leg[-1].distance_to(pose) < _CUSP_TOLERANCE:
            self._legs.pop(0)

    def _nearest_target(self, pose: Pose2, leg: list[Pose2]) -> Pose2:
        far_enough = (waypoint for waypoint in leg if waypoint.distance_to(pose) >= self.parameters.min_lookahead)
        return next(far_enough, leg[-1])

    def _towards(self, pose: Pose2, gear: Direction, leg: list[Pose2]) -> Twist2:
        """The law towards the furthest pose within the lookahead whose rollout is free."""
        p, obstacles = self.parameters, self._obstacles_around(pose)
        to_goal = sum(before.distance_to(after) for before, after in itertools.pairwise(leg))
        for waypoint in reversed(leg):
            distance = waypoint.distance_to(pose)
            if distance > p.max_lookahead:
                continue
            if to_goal >= p.max_lookahead and distance < p.min_lookahead:
                break
            target = waypoint
            if to_goal < p.max_lookahead and p.prefer_final_rotation:
                target = _facing(waypoint, pose, gear)
            if self._is_free(target, pose, gear, obstacles):
                return self.law.command(target, pose, gear)
        raise NoValidControl("GracefulController: no target within the lookahead can be reached without a collision")

    def _obstacles_around(self, pose: Pose2) -> ObstacleSet:
        """All that a rollout can meet: it approaches a target within the lookahead, step by step."""
        p, outline = self.parameters, self.context.footprint
        reach = 2.0 * p.max_lookahead + _ROLLOUT_STEP * p.v_linear_max
        reach += 0.0 if outline is None else outline.circumscribed_radius
        centre = np.array([pose.x, pose.y])
        return self.context.obstacles_near(centre - reach, centre + reach)

    def _is_free(self, target: Pose2, pose: Pose2, gear: Direction, obstacles: ObstacleSet) -> bool:
        footprint = self.context.footprint
        if footprint is None or not self.parameters.use_collision_detection:
            return True
        law = self.law
        for _ in range(_ROLLOUT_STEPS):
            if target.distance_to(pose) < _AT_TARGET:
                return True
            command = law.command(target, pose, gear)
            if free_motion(footprint, obstacles, pose, command, _ROLLOUT_STEP).row >= 0:
                return False
            before, pose = pose, pose.moved(command, _ROLLOUT_STEP)
            if target.distance_to(pose) >= target.distance_to(before):
                return True
        return True

    def _turn(self, angle: float) -> Twist2:
        """A turn in place by `angle` [rad], never slower than v_angular_min_in_place."""
        p = self.parameters
        top = self._speed_share * p.v_angular_max
        rate = max(min(p.rotation_scaling_factor * abs(angle) * top, top), p.v_angular_min_in_place)
        return Twist2(0.0, math.copysign(rate, angle))


def _bearing(target: Pose2, pose: Pose2) -> float:
    return normalize_angle(math.atan2(target.y - pose.y, target.x - pose.x) - pose.yaw)


def _facing(target: Pose2, pose: Pose2, gear: Direction) -> Pose2:
    """The target with its heading along the line of sight."""
    return Pose2(target.x, target.y, math.atan2(gear * (target.y - pose.y), gear * (target.x - pose.x)))
