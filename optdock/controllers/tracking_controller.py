"""TrackingController: follows a trajectory by feed-forward and pose feedback, and corrects the error at its end."""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING

import numpy as np
from pydantic import Field

from optdock.controllers.command_limits import CommandLimiter
from optdock.controllers.delay_estimate import ControlClock, DelayEstimate
from optdock.controllers.look_ahead import LookAhead, Obstruction, radius_of, stopping_way
from optdock.controllers.moving_reference import (
    ReferenceProgress,
    ReferenceState,
    TrajectoryReference,
    peaks,
    rate_for_turning,
    waiting_rate,
)
from optdock.controllers.tracking_checks import (
    AcceptedErrors,
    ProgressCheck,
    accepted_errors,
    checked_speed_limit,
    checked_task,
)
from optdock.controllers.tracking_law import CREEPING, DeadBandPush, FeedbackGains, Gains, tracking_command
from optdock.errors import ControllerInvalidPath, FailedToTimePath, NoValidControl
from optdock.geometry.arrays import readonly
from optdock.geometry.checked import finite_number
from optdock.geometry.obstacles import in_words
from optdock.geometry.pose import Pose2, Twist2
from optdock.model.limits import MotionLimits
from optdock.model.robot import Drive, admissible
from optdock.model.trajectory import Trajectory
from optdock.plugins.interfaces import Controller
from optdock.plugins.parameters import PluginParameters

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray
    from optdock.model.path import Path
    from optdock.plugins.interfaces import GoalChecker

__all__ = ["TrackingController", "TrackingControllerParameters"]

_NO_TIMES = readonly(np.zeros(0))
_SETTLING = 0.2  # [s], time constant with which the reference's rate approaches its target
_CREEP = 1e-6  # [m/s]: too slow to move the robot, but its curvature turns steered wheels
_TURN_LEVER = 0.5  # [m]: turns in place identify the delay by the speed of a point at this distance
_ROOM = 2e-4  # [m] beyond the next rest: rounding of a motion at full braking
_NOTHING = 5e-5  # [m/s], [rad/s]: smaller commands at the end are zero
_HELD = 0.1  # rate of a waiting reference below which the robot does not follow
_SEEN_NOISE = 2.0  # standard deviations of a pose across the path that are regarded as noise of a depth
_PEAK_MARGIN = 1.2  # without a configured robot: ratio of limits to peaks of the trajectory, for feedback


class TrackingControllerParameters(PluginParameters):
    """Parameters of the TrackingController: gains, time base and behaviour at the end."""

    period: float | None = Field(
        default=None, gt=0.0, description="time between two calls [s]; None: measured from their stamps"
    )
    along_gain: float = Field(default=2.0, gt=0.0, description="gain of the longitudinal error [1/s]")
    convergence_distance: float = Field(
        default=0.25, gt=0.0, description="distance over which lateral errors decay, increased for delayed drives [m]"
    )
    damping: float = Field(default=1.0, gt=0.0, description="damping ratio of the lateral error")
    turn_gain: float = Field(default=1.0, gt=0.0, description="smallest gain of the heading error [1/s]")
    preview: float | None = Field(
        default=None, ge=0.0, description="the drive's latency plus lag, compensated [s]; None: identified online"
    )
    slow_down_lag: float = Field(default=0.002, ge=0.0, description="lag at which the reference begins to wait [m]")
    stop_lag: float = Field(default=0.1, gt=0.0, description="lag at which the reference stops [m]")
    turn_reserve: float = Field(
        default=0.06, ge=0.0, lt=0.5, description="share of max_yaw_acceleration left to feedback by slowing down [1]"
    )
    max_error: float = Field(default=0.5, gt=0.0, description="distance from the reference that ends the task [m]")
    max_yaw_error: float = Field(default=0.8, gt=0.0, description="heading error that ends the task [rad]")
    min_speed: float = Field(default=0.0, ge=0.0, description="dead band of the speed, compensated at the goal [m/s]")
    min_yaw_rate: float = Field(
        default=0.0, ge=0.0, description="dead band of the yaw rate, compensated at the goal [rad/s]"
    )
    finish_tolerance: float = Field(
        default=0.002, gt=0.0, description="error above which the dead band is compensated [m]"
    )
    finish_yaw_tolerance: float = Field(
        default=0.005, gt=0.0, description="heading error above which the dead band is compensated [rad]"
    )
    patience: float = Field(
        default=3.0, gt=0.0, description="time without progress, in motion or at the end, that ends the task [s]"
    )
    use_collision_detection: bool = Field(default=True, description="check the stopping path for obstacles")
    collision_tolerance: float = Field(
        default=0.01, ge=0.0, description="accepted penetration of the station, by noise or a compressed bumper [m]"
    )
    time_parameterizer: str = Field(
        default="NearOptimal", description="time parameterizer for paths given without times"
    )


class TrackingController(Controller):
    """Controller that follows a trajectory in time, in both gears, and corrects the remaining error at its end.

    **Time.** Every call advances the reference by the time since the last call, measured by the stamps or given by
    `period`, times a rate in [0, 1]. Any constant or varying call rate from 10 to 200 Hz is possible. The rate is 1, or
    lower under a speed limit, and falls smoothly to 0 as the lag of the robot increases from `slow_down_lag` to
    `stop_lag`. A robot farther than `max_error` (or `max_yaw_error`) from the reference has left the certified motion,
    and NoValidControl is raised.

    **Law.** See `tracking_law`. The feed-forward is taken at the middle of the coming period, `preview` ahead of the
    reference. Without `preview` the delay of the drive is identified, beginning with the first ramp, and kept until
    `reset`.

    **Finish.** At the end of the trajectory, the same law controls the robot to the last pose. If the drive ignores
    small commands, larger commands are sent until the error is within half of the tolerance of the goal checker (or
    `finish_tolerance`), beginning with `min_speed` and `min_yaw_rate` if given. An error that is not accepted and does
    not decrease for `patience` raises NoValidControl. A robot that does not follow the reference also raises
    NoValidControl.

    **Collisions.** NoValidControl is raised if the robot, after executing the command, could not stop before touching
    an obstacle. The checked motion consists of the commands that the drive has not yet executed, one period of the new
    command, and braking, along the arc of the command or along the path. Contact with the station, and with obstacles
    that the trajectory touches at its start or end, is intended: a penetration of `collision_tolerance` is allowed at
    these contacts. A robot that overlaps an obstacle may move if the depth does not increase. The obstacles are taken
    from the context's problem, and from its costmaps at the time of the call; without a problem and costmaps,
    collisions are not checked.

    **Limits.** The limits of the context's robot apply; without a robot, the defaults of `MotionLimits` apply,
    increased to 1.2 times the peaks of the trajectory if necessary. Commands are admissible for the drive and satisfy
    its acceleration limits.

    Args:
        **parameters: Fields of `TrackingControllerParameters`.

    Raises:
        InvalidValue: If a parameter is unknown, of the wrong type or out of range.
    """

    Parameters = TrackingControllerParameters
    parameters: TrackingControllerParameters

    def __init__(self, **parameters: object) -> None:
        super().__init__(**parameters)
        self._speed_limit: tuple[float, bool] | None = None  # the limit, and whether it is in percent
        # The reference of the last call, and the robot's lag behind it.
        self._last: tuple[ReferenceState, float] | None = None
        self._reference: TrajectoryReference | None = None
        self._starts_at: float | None = None
        self._limits = MotionLimits()
        self._limiter = CommandLimiter()
        self._clock = ControlClock()
        self._delay = DelayEstimate()
        self._look_ahead = LookAhead()
        self._anchored = self._cancelled = False
        self._start_attempt()

    def set_path(self, path: Path | Trajectory, *, start_stamp: float | None = None) -> None:
        """Follow a trajectory, or a path after timing it, beginning with the next call.

        A path is timed from the speed of the last command, so the robot does not have to stop for a new path.

        Args:
            path: Path or trajectory to follow.
            start_stamp: Time of the trajectory's start, on the clock of the stamps [s]. Until that time, the reference
                continues on the previous trajectory, or waits at the start if there is no previous trajectory. The new
                trajectory should begin at the state of the reference at that time. None: the trajectory starts with the
                next call, at the position of the robot.

        Raises:
            ControllerInvalidPath: If `path` is neither a path nor a trajectory, is not in the frame of the configured
                problem, was certified for a different problem, or cannot be timed within the robot's limits.
            PluginError: If the time parameterizer does not exist.
        """
        path = checked_task(path, self.context)
        trajectory = path if isinstance(path, Trajectory) else self._timed(path)
        running, now = self._reference if self._anchored and not self._cancelled else None, self._clock.now
        if running is not None and now is not None and start_stamp is not None:
            running.joined_by(trajectory, finite_number(start_stamp, "TrackingController: start_stamp") - now)
        else:
            self._reference, self._starts_at = TrajectoryReference(trajectory), start_stamp
            self._anchored = self._cancelled = False
            self._start_attempt()
        self._limits = self._limits_for(trajectory)

    def compute_velocity_commands(
        self, pose: Pose2, velocity: Twist2, goal_checker: GoalChecker | None, *, stamp: float | None = None
    ) -> Twist2:
        """Return the command for the coming period.

        Args:
            pose: Measured pose.
            velocity: Measured body velocity, from which the first command starts and which shows the response to the
                last command.
            goal_checker: Goal checker whose position tolerance may widen `finish_tolerance`.
            stamp: Time of the measured pose [s], on any monotonic clock; None: the present time on the context's clock.

        Raises:
            ControllerInvalidPath: If there is no path.
            NoValidControl: If the robot is farther than `max_error` or `max_yaw_error` from the reference, would
                collide, or makes no progress, or the clock went back.
        """
        if self._reference is None:
            raise ControllerInvalidPath("TrackingController: has no path; call set_path first")
        try:
            self._clock.tick(stamp, self.context, self.parameters.period)
            if self._clock.elapsed == 0.0:
                return self._limiter.command
            if self._clock.silent:
                self._limiter.restart(admissible(velocity, self._limits, self._drive))
            return self._command(self._reference, pose, velocity, goal_checker)
        except NoValidControl:
            self._limiter.stop()  # the caller stops the robot
            raise

    def _command(
        self, reference: TrajectoryReference, pose: Pose2, velocity: Twist2, goal_checker: GoalChecker | None
    ) -> Twist2:
        p, period, before = self.parameters, self._clock.elapsed, self._limiter.command
        if self._last is not None and self._last[0].gear == 0.0:
            self._delay.update(_TURN_LEVER * before.angular, _TURN_LEVER * velocity.angular, period)
        else:
            self._delay.update(before.linear, velocity.linear, period)
        if not self._anchored:
            reference.look_ahead(self._preview, at_once=True)
            self._anchor(reference, pose, velocity)
        now = self._advance(reference)
        error = now.pose.in_frame_of(pose)
        self._feedback.learn_noise(pose, velocity, self._clock)
        distance = math.hypot(error.x, error.y)
        if distance > p.max_error or abs(error.yaw) > p.max_yaw_error:
            raise NoValidControl(
                f"TrackingController: {distance:.3f} m and {abs(error.yaw):.3f} rad from the reference, more than "
                f"max_error = {p.max_error} m or max_yaw_error = {p.max_yaw_error} rad; plan again from here",
                where={"along": error.x, "cross": error.y, "yaw": error.yaw},
            )
        accepted, lag = accepted_errors(goal_checker, self.context), now.lag_of(error)
        is_held = not self._cancelled and waiting_rate(lag, p.slow_down_lag, p.stop_lag) <= _HELD
        finished = reference.finished
        left = accepted if finished and not self._cancelled else None
        self._progress_check.check(error, period, p.patience, is_held=is_held, left=left)
        wanted = self._wanted(reference, now, error, accepted)
        if left is not None:
            wanted = self._finishing(wanted, error, accepted, velocity)
        in_place, room = now.gear == 0.0 or finished, self._room(reference, now, lag)
        command = self._limiter.follow(
            wanted, now.ahead.twist, period, self._limits, self._drive, in_place=in_place, room=room
        )
        self._last = (now, lag)
        if p.use_collision_detection:
            self._require_free_stop(reference, now, pose, command, before)
        return command

    def _room(self, reference: TrajectoryReference, now: ReferenceState, lag: float) -> float:
        """Return the distance to the next rest when the command takes effect [m]; infinite at the end.

        The present lag is added, minus the part that will be corrected by commands not yet executed by the drive.
        """
        ahead = now.ahead
        if self._last is None or reference.finished or self._cancelled or ahead.gear == 0.0 or ahead.gear != now.gear:
            return math.inf
        gained = ahead.gear * (self._limiter.command.linear - self._last[0].ahead.twist.linear) * self._known_delay
        return ahead.to_rest + lag - gained + _ROOM

    def _require_free_stop(
        self, reference: TrajectoryReference, now: ReferenceState, pose: Pose2, command: Twist2, before: Twist2
    ) -> None:
        """Raise NoValidControl if a stop would collide both along the arc of the command and along the path."""
        footprint = self.context.footprint
        if footprint is None:
            return
        p, period = self.parameters, self._clock.period
        limits = self._limits
        speed, turn = abs(command.linear), abs(command.angular)
        # Braking covers half of the distance at constant speed.
        braking = 0.5 * max(speed / limits.max_deceleration, turn / limits.turning.acceleration)
        delay = self._known_delay
        driven = ((before, delay), (command, period))
        radius, phases = radius_of(footprint), (*driven, (command, braking))
        reach = delay * (abs(before.linear) + radius * abs(before.angular)) + (period + braking) * (
            speed + radius * turn
        )
        if self._look_ahead.is_clear(self.context, footprint, pose, reach):
            return
        ends, noise = reference.ends, _SEEN_NOISE * math.sqrt(self._feedback.scatter)

        def obstruction(way: FloatArray) -> Obstruction | None:
            return self._look_ahead.obstruction(self.context, way, ends, p.collision_tolerance, noise)

        found = obstruction(stopping_way(pose, footprint, phases))
        if found is None:
            return
        distance = abs(before.linear) * delay + speed * (period + braking)
        along_path = reference.way(distance, now.pose, pose)
        if along_path is not None:
            found = obstruction(stopping_way(pose, footprint, driven)) or obstruction(along_path)
        if found is not None:
            raise NoValidControl(
                f"{self.context.name}: collision ahead: even braking now, the footprint goes {found.depth:.3f} m into "
                f"{in_words(found.obstacle)}",
                where={"obstacle": found.obstacle, "depth": found.depth},
            )

    def set_speed_limit(self, limit: float, percentage: bool) -> None:  # noqa: FBT001 - Nav2's order of arguments
        """Slow the whole reference down, to `limit` percent or to a peak speed of `limit` m/s; 0 removes the limit.

        Raises:
            InvalidValue: If the limit is negative or not finite, or `percentage` is not a bool.
        """
        limit = checked_speed_limit(limit, percentage)
        self._speed_limit = (limit, percentage) if limit > 0.0 else None

    def cancel(self) -> bool:
        """Brake along the path within the limits; return True once the commands are zero."""
        self._cancelled = True
        return (
            self._reference is None
            or not self._anchored
            or (self._reference.rate == 0.0 and self._limiter.command == Twist2())
        )

    def reset(self) -> None:
        """Discard the path and the identified delay; the speed limit is kept."""
        self._reference = self._starts_at = None
        self._clock = ControlClock()
        self._delay = DelayEstimate()
        self._limiter = CommandLimiter()
        self._anchored = self._cancelled = False

    @property
    def progress(self) -> ReferenceProgress | None:
        """Progress of the reference, on the clock of the last given trajectory; None without a path."""
        return None if self._reference is None else self._reference.progress

    def _start_attempt(self) -> None:
        """Reset the state of one attempt; a path that takes over in motion continues the attempt."""
        self._feedback = FeedbackGains()
        self._progress_check, self._push = ProgressCheck(), DeadBandPush()

    @property
    def _drive(self) -> Drive:
        return self.context.problem.robot.drive if self.context.problem else Drive.DIFFERENTIAL

    def _timed(self, path: Path) -> Trajectory:
        from optdock.plugins.registry import timed_by

        problem, timing = self.context.problem, self.parameters.time_parameterizer
        moving = max(0.0, path.segments[0].direction * self._limiter.command.linear)
        moving = moving if moving > _CREEP else 0.0
        # The steering angle of a robot at rest is unknown.
        wait = problem.robot.limits.start_wait(path) if problem is not None and moving == 0.0 else 0.0
        try:
            return timed_by(timing, path, problem, start_speed=moving, start_wait=wait)
        except FailedToTimePath as error:
            raise ControllerInvalidPath(f"TrackingController: {error}") from error

    def _limits_for(self, trajectory: Trajectory) -> MotionLimits:
        if self.context.problem:
            return self.context.problem.robot.limits
        limits, (speed, acceleration) = MotionLimits(), (_PEAK_MARGIN * peak for peak in peaks(trajectory))
        return dataclasses.replace(
            limits,
            max_speed=max(limits.max_speed, speed),
            max_reverse_speed=max(limits.max_reverse_speed, speed),
            max_acceleration=max(limits.max_acceleration, acceleration),
            max_deceleration=max(limits.max_deceleration, acceleration),
        )

    def _anchor(self, reference: TrajectoryReference, pose: Pose2, velocity: Twist2) -> None:
        if self._starts_at is None or self._clock.now is None:
            reference.join(pose, velocity.linear, self._known_delay)
        else:
            reference.time = self._clock.now - self._starts_at
        self._last = None
        self._anchored = True

    def _advance(self, reference: TrajectoryReference) -> ReferenceState:
        """Advance the reference, except on the first call, and return its state."""
        if self._last is not None:
            p, (before, lag) = self.parameters, self._last
            rate, settling = 0.0, 0.0
            if not self._cancelled:
                turning = rate_for_turning(reference, p.turn_reserve, self._limits, self._drive)
                allowed = min(_limited_rate(self._speed_limit, reference.trajectory), turning)
                rate, settling = waiting_rate(lag, p.slow_down_lag, p.stop_lag) * allowed, _SETTLING
            reference.advance(before, self._clock.elapsed, rate, self._limits, settling)
            reference.look_ahead(self._preview, at_once=self._clock.learnt)
        return reference.state(self._horizon_times())

    def _horizon_times(self) -> FloatArray:
        """Return the times ahead whose reference poses the law of a subclass uses, Shape (n,) [s]."""
        return _NO_TIMES

    @property
    def _known_delay(self) -> float:
        return self._delay.delay if self.parameters.preview is None else self.parameters.preview

    @property
    def _preview(self) -> float:
        """Lead of the commands [s]: the delay plus half a period, which leads to the middle of the next period."""
        return self._known_delay + 0.5 * self._clock.period

    def _wanted(
        self, reference: TrajectoryReference, now: ReferenceState, error: Pose2, accepted: AcceptedErrors
    ) -> Twist2:
        if self._cancelled and reference.rate == 0.0:
            return Twist2()
        p, period = self.parameters, self._clock.elapsed
        usual = Gains(p.along_gain, p.convergence_distance, p.damping, p.turn_gain)
        gains = self._feedback.update(
            usual, now, error, accepted, period=period, delay=self._preview, finished=reference.finished
        )
        wanted = tracking_command(error, now.ahead.twist, gains)
        if self._drive is Drive.ACKERMANN and now.ahead.speed < CREEPING:
            # The curvature at rest is undefined, and feedback would swing the wheels; a creeping command defines the
            # curvature.
            arc = reference.next_arc()
            speed = wanted.linear if abs(wanted.linear) > _CREEP or reference.finished else _CREEP * arc.linear
            return Twist2(speed, speed * arc.linear * arc.angular)
        return wanted

    def _finishing(self, wanted: Twist2, error: Pose2, accepted: AcceptedErrors, velocity: Twist2) -> Twist2:
        """Return the command at the end: above the dead band while the error is too large, then zero."""
        p = self.parameters
        near, aligned = max(p.finish_tolerance, 0.5 * accepted.along), max(p.finish_yaw_tolerance, 0.5 * accepted.yaw)
        linear = _at_least(wanted.linear, p.min_speed) if abs(error.x) > near else wanted.linear
        angular = _at_least(wanted.angular, p.min_yaw_rate) if abs(error.yaw) > aligned else wanted.angular
        pushed = self._push.add_to(
            Twist2(linear, angular), error, Pose2(near, 0.0, aligned), velocity, self._clock.elapsed
        )
        return Twist2(
            0.0 if abs(pushed.linear) < _NOTHING else pushed.linear,
            0.0 if abs(pushed.angular) < _NOTHING else pushed.angular,
        )


def _at_least(value: float, least: float) -> float:
    return math.copysign(max(abs(value), least), value) if value != 0.0 else 0.0


def _limited_rate(speed_limit: tuple[float, bool] | None, trajectory: Trajectory) -> float:
    """Return the rate under a speed limit, which is in percent if the second value is True."""
    if speed_limit is None:
        return 1.0
    limit, percentage = speed_limit
    return min(1.0, limit / 100.0 if percentage else limit / max(peaks(trajectory)[0], 1e-9))
