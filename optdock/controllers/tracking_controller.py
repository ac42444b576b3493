"""TrackingController: drives a trajectory by feed-forward and pose feedback, and finishes it."""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING

from optdock.controllers.call_checks import checked_speed_limit, checked_task
from optdock.controllers.command_limits import CommandLimiter
from optdock.controllers.control_clock import ControlClock
from optdock.controllers.delay_estimate import DelayEstimate
from optdock.controllers.feedback_gains import CREEPING, FeedbackGains
from optdock.controllers.finish import Accepted, DeadBandPush, accepted_errors
from optdock.controllers.look_ahead import LookAhead, collision_ahead, stopping_time, stopping_way
from optdock.controllers.moving_reference import ReferenceProgress, ReferenceState, TrajectoryReference, peaks
from optdock.controllers.progress_check import ProgressCheck
from optdock.controllers.reference_rate import ReferenceRate, waiting_rate
from optdock.controllers.tracking_law import tracking_command
from optdock.controllers.tracking_parameters import TrackingControllerParameters
from optdock.errors import ControllerInvalidPath, FailedToTimePath, NoValidControl
from optdock.geometry.checked import finite_number
from optdock.geometry.pose import Pose2, Twist2
from optdock.model.limits import MotionLimits
from optdock.model.robot import Drive, admissible
from optdock.model.trajectory import Trajectory
from optdock.plugins.interfaces import Controller

if TYPE_CHECKING:
    from optdock.model.path import Path
    from optdock.plugins.interfaces import GoalChecker

__all__ = ["TrackingController", "TrackingControllerParameters"]

_SETTLING = 0.2  # [s], time constant with which the reference's rate approaches its target
_CREEP = 1e-6  # [m/s]: no drive moves at it; steered wheels turn as its arc says
_TURN_LEVER = 0.5  # [m]: a turn in place tells the drive's delay as a drive does at the speed of a point so far off
_ROOM = 2e-4  # [m] beyond the next rest: a motion that brakes as hard as it can is not slowed down by rounding
_NOTHING = 5e-5  # [m/s], [rad/s]: at the end less than this is not commanded
_HELD = 0.1  # rate of a waiting reference below which the robot does not follow
_SEEN_NOISE = 2.0  # standard deviations of a pose across, of depth that is taken for noise
_PEAK_MARGIN = 1.2  # without a configured robot: headroom for feedback above the trajectory's own peaks


class TrackingController(Controller):
    """Follows a trajectory in time, in both gears, and corrects what is left at its end.

    **Time.** Every call lets the reference advance by the time since the last, as the stamps say, or by `period` where
    that is given, times a rate in [0, 1]: any rate of calls from 10 to 200 Hz will do, and it may change. The rate of
    the reference is 1 normally, lower under a speed limit, and falls smoothly to 0 while the robot lags behind by
    `slow_down_lag` to `stop_lag`, so a blocked robot finds its reference waiting. A robot further than `max_error` (or
    `max_yaw_error`) from the reference has left what was certified: NoValidControl, and a new plan is needed. The
    first call after `set_path` starts at the nearest point of the trajectory's first gear when the robot is not at its
    beginning, no faster than the robot is. A call with the stamp of the one before gets the same command. At cusps the
    reference rests as its time law does. A trajectory with a `start_stamp` takes over just then, in motion: the
    reference goes on from one to the other without a jump where they meet, and the feed-forward looks across.

    **Law.** See `tracking_law`; gains are lower where the drive's delay asks for it (`delay_bounds`). The feed-forward
    is that of the middle of the coming period, `preview` ahead. Without a given `preview` it is identified from the
    first ramp on, by comparing the measured speed with the commands
    (`delay_estimate`); it is kept from path to path, until `reset`.

    **Finish.** At the trajectory's end the same law holds the last pose: errors along and in yaw decay exponentially
    to zero, without a dead band of its own. A drive that ignores small commands is told larger ones, at once
    `min_speed` and `min_yaw_rate` where they are given, until within half of what the goal checker accepts (or
    `finish_tolerance`). An error across cannot be removed by a wheeled robot in place: near the end it is corrected
    over a shorter distance than `convergence_distance`, as far as curvature and the drive's delay allow. What is not
    accepted then, and becomes no better for `patience`, is refused by name: NoValidControl, plan again. So is a robot
    that does not follow.

    **Collisions.** A command after which the robot could no longer stop before it touches something is refused:
    NoValidControl, and the server stops the robot. What is looked at is what will be driven: what is under way in the
    drive, one period of the command, and braking, along its arc or along the path. The station, and what the trajectory
    touches where it begins or ends, is touched on purpose: it may be pressed by `collision_tolerance`. A robot that is
    in something already may move unless it goes deeper. What counts is what the context holds: the problem, and the
    costmaps as they are now; without either nothing is checked.

    **Limits.** Those of the context's robot. Without one: the defaults of `MotionLimits`, widened to 1.2 times the
    peaks of the trajectory. Commands are admissible for the drive and change no faster than it can accelerate.

    Args:
        **parameters: Fields of `TrackingControllerParameters`.

    Raises:
        InvalidValue: A parameter is unknown, of the wrong type or out of range.
    """

    Parameters = TrackingControllerParameters
    parameters: TrackingControllerParameters

    def __init__(self, **parameters: object) -> None:
        super().__init__(**parameters)
        self._rate = ReferenceRate()
        # The reference of the last call, and the robot's lag behind it.
        self._seen: tuple[ReferenceState, float] | None = None
        self._reference: TrajectoryReference | None = None
        self._starts_at: float | None = None
        self._limits = MotionLimits()
        self._limiter = CommandLimiter()
        self._clock = ControlClock()
        self._delay = DelayEstimate()
        self._look_ahead = LookAhead()
        self._anchored = self._cancelled = False
        self._attempt()

    def set_path(self, path: Path | Trajectory, *, start_stamp: float | None = None) -> None:
        """Follow a trajectory, or a path after timing it, from the next call on.

        A path is timed from the speed of the last command, so that a new path in motion is taken up without a stop.

        Args:
            path: What to follow.
            start_stamp: When its time 0 is, on the clock of the stamps [s]. Until then the reference goes on along the
                trajectory before; where there is none it waits at the beginning. It should begin where the other one is
                then, just as fast and with the same acceleration. None: with the next call, from where the robot is.

        Raises:
            ControllerInvalidPath: It is neither a path nor a trajectory, it stands in another frame than the configured
                problem or was certified for another one, or it cannot be timed under the robot's limits.
            PluginError: The time parameterizer does not exist.
        """
        path = checked_task(path, self.context, "TrackingController")
        trajectory = path if isinstance(path, Trajectory) else self._timed(path)
        running, now = self._reference if self._anchored and not self._cancelled else None, self._clock.now
        if running is not None and now is not None and start_stamp is not None:
            running.joined_by(trajectory, finite_number(start_stamp, "TrackingController: start_stamp") - now)
        else:
            self._reference, self._starts_at = TrajectoryReference(trajectory), start_stamp
            self._anchored = self._cancelled = False
            self._attempt()
        self._limits = self._limits_for(trajectory)

    def compute_velocity_commands(
        self,
        pose: Pose2,
        velocity: Twist2,
        goal_checker: GoalChecker | None,
        *,
        stamp: float | None = None,
    ) -> Twist2:
        """The command for the coming period; see the class.

        Args:
            pose: Measured pose.
            velocity: Measured body velocity: where the first command starts from, and what the drive made of the last.
            goal_checker: Its position tolerance may widen `finish_tolerance`.
            stamp: When the pose was measured [s], on any monotonic clock; None: now, on the context's clock.

        Raises:
            ControllerInvalidPath: There is no path.
            NoValidControl: The robot is further than `max_error` or `max_yaw_error` from the reference, or would
                collide; or the clock went back.
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
            self._limiter.stop()  # what a refusal leaves the robot with
            raise

    def _command(
        self, reference: TrajectoryReference, pose: Pose2, velocity: Twist2, goal_checker: GoalChecker | None
    ) -> Twist2:
        p, period = self.parameters, self._clock.elapsed
        told, done = self._limiter.command, velocity
        if self._seen is not None and self._seen[0].gear == 0.0:
            self._delay.update(_TURN_LEVER * told.angular, _TURN_LEVER * done.angular, period)
        else:
            self._delay.update(told.linear, done.linear, period)
        if not self._anchored:
            reference.look_ahead(self._known_delay + 0.5 * self._clock.period, at_once=True)
            self._anchor(reference, pose, velocity)
        now = self._advanced(reference)
        error = now.pose.in_frame_of(pose)
        self._feedback.learn_noise(pose, velocity, self._clock)
        self._progress_check.check_error(p, error)
        accepted = accepted_errors(goal_checker, self.context)
        is_held = not self._cancelled and waiting_rate(p, now.lag_of(error)) <= _HELD
        is_finishing = reference.finished and not self._cancelled
        self._progress_check.check_progress(p, error, accepted, period, is_held=is_held, is_finishing=is_finishing)
        wanted = self._wanted(reference, now, error, accepted)
        if reference.finished:
            wanted = self._finishing(wanted, error, accepted, velocity)
        in_place = now.gear == 0.0 or reference.finished
        before = self._limiter.command
        command = self._limiter.follow(
            wanted,
            now.ahead.twist,
            period,
            self._limits,
            self._drive,
            in_place=in_place,
            room=self._room(reference, now, error),
        )
        self._seen = (now, now.lag_of(error))
        if p.use_collision_detection:
            self._require_free_stop(reference, now, pose, command, before)
        return command

    def _room(self, reference: TrajectoryReference, now: ReferenceState, error: Pose2) -> float:
        """How far the robot may go on when the command takes effect, until it is to rest [m]; infinite at the end.

        What it lags behind now comes on top, but for what the commands under way make good.
        """
        ahead = now.ahead
        if self._seen is None or reference.finished or self._cancelled or ahead.gear == 0.0 or ahead.gear != now.gear:
            return math.inf
        gained = ahead.gear * (self._limiter.command.linear - self._seen[0].ahead.twist.linear) * self._known_delay
        return ahead.to_rest + now.lag_of(error) - gained + _ROOM

    def _require_free_stop(
        self, reference: TrajectoryReference, now: ReferenceState, pose: Pose2, command: Twist2, before: Twist2
    ) -> None:
        """Refuse a command after which the robot could stop neither along its arc nor along its path.

        Raises:
            NoValidControl: As described; `where` holds the obstacle and the depth.
        """
        footprint = self.context.footprint
        if footprint is None:
            return
        p, period = self.parameters, self._clock.period
        limits = self._limits
        # Braking covers half of what the command would in that time.
        braking = 0.5 * stopping_time(command, limits.max_deceleration, limits.turning.acceleration)
        driven = ((before, self._known_delay), (command, period))
        straight_on = stopping_way(pose, footprint, (*driven, (command, braking)))
        ends, noise = reference.ends, _SEEN_NOISE * math.sqrt(self._feedback.scatter)
        found = self._look_ahead.obstruction(self.context, straight_on, ends, p.collision_tolerance, noise)
        if found is None:
            return
        distance = abs(before.linear) * self._known_delay + abs(command.linear) * (period + braking)
        along_path = reference.way(distance, now.pose, pose)
        ways = (straight_on,) if along_path is None else (stopping_way(pose, footprint, driven), along_path)
        for way in ways:
            found = self._look_ahead.obstruction(self.context, way, ends, p.collision_tolerance, noise)
            if found is not None:
                raise collision_ahead(self.context, found)

    def set_speed_limit(self, limit: float, percentage: bool) -> None:  # noqa: FBT001 - Nav2's order of arguments
        """Slow the whole reference down, to `limit` percent or to a peak speed of `limit` m/s; 0 removes the limit.

        Raises:
            InvalidValue: The limit is negative or not finite, or `percentage` is not a bool.
        """
        limit = checked_speed_limit(limit, percentage, "TrackingController")
        self._rate.speed_limit = (limit, percentage) if limit > 0.0 else None

    def cancel(self) -> bool:
        """Brake along the path within the limits; True once the commands are zero."""
        self._cancelled = True
        return (
            self._reference is None
            or not self._anchored
            or (self._reference.rate == 0.0 and self._limiter.command == Twist2())
        )

    def reset(self) -> None:
        """Forget the path and what was learnt about the drive; the speed limit stays."""
        self._reference = self._starts_at = None
        self._clock = ControlClock()
        self._delay = DelayEstimate()
        self._limiter = CommandLimiter()
        self._anchored = self._cancelled = False

    @property
    def progress(self) -> ReferenceProgress | None:
        """Where the reference is, on the clock of the trajectory given last; None without a path."""
        return None if self._reference is None else self._reference.progress

    def _attempt(self) -> None:
        """A new path is a new attempt; one that takes over in motion is none: a robot that stands is named still."""
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
        # The steering angle of a robot that stands is unknown.
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
        self._seen = None
        self._anchored = True

    def _advanced(self, reference: TrajectoryReference) -> ReferenceState:
        """The reference now; on the first call, where it begins."""
        if self._seen is not None:
            before, lag = self._seen
            settling = 0.0 if self._cancelled else _SETTLING
            rate = (
                0.0
                if self._cancelled
                else self._rate.target(self.parameters, reference, lag, self._limits, self._drive)
            )
            reference.advance(before, self._clock.elapsed, rate, self._limits, settling)
            reference.look_ahead(self._known_delay + 0.5 * self._clock.period, at_once=self._clock.learnt)
        return reference.state()

    @property
    def _known_delay(self) -> float:
        return self._delay.delay if self.parameters.preview is None else self.parameters.preview

    def _wanted(self, reference: TrajectoryReference, now: ReferenceState, error: Pose2, accepted: Accepted) -> Twist2:
        if self._cancelled and reference.rate == 0.0:
            return Twist2()
        gains = self._feedback.at(
            self.parameters, now, error, accepted, self._clock, delay=self._known_delay, finished=reference.finished
        )
        wanted = tracking_command(error, now.ahead.twist, gains)
        if self._drive is Drive.ACKERMANN and now.ahead.speed < CREEPING:
            # A rest tells no curvature, and the feedback's would swing the wheels; a creeping command does tell it.
            arc = reference.next_arc()
            speed = wanted.linear if abs(wanted.linear) > _CREEP or reference.finished else _CREEP * arc.linear
            return Twist2(speed, speed * arc.linear * arc.angular)
        return wanted

    def _finishing(self, wanted: Twist2, error: Pose2, accepted: Accepted, velocity: Twist2) -> Twist2:
        """The command that ends the drive: above the dead band while more is left than needs to be, then nothing."""
        p = self.parameters
        near, aligned = max(p.finish_tolerance, 0.5 * accepted.along), max(p.finish_yaw_tolerance, 0.5 * accepted.yaw)
        if self._cancelled:
            return wanted
        linear = _at_least(wanted.linear, p.min_speed) if abs(error.x) > near else wanted.linear
        angular = _at_least(wanted.angular, p.min_yaw_rate) if abs(error.yaw) > aligned else wanted.angular
        pushed = self._push.onto(
            Twist2(linear, angular), error, Pose2(near, 0.0, aligned), velocity, self._clock.elapsed
        )
        return Twist2(
            0.0 if abs(pushed.linear) < _NOTHING else pushed.linear,
            0.0 if abs(pushed.angular) < _NOTHING else pushed.angular,
        )


def _at_least(value: float, least: float) -> float:
    return math.copysign(max(abs(value), least), value) if value != 0.0 else 0.0
