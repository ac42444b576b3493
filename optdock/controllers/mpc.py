"""MpcController: follows a trajectory with commands that are optimal over a short horizon within the robot's limits."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections import deque
from enum import Enum
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from pydantic import Field

from optdock.controllers.command_limits import CommandLimiter, fastest_slope, rate_limited, reachable_speed
from optdock.controllers.motion_table import motion_table
from optdock.controllers.moving_reference import ReferenceState, TrajectoryReference, peaks
from optdock.controllers.mpc_program import (
    CommandBounds,
    MpcCycle,
    MpcWeights,
    TrackingProgram,
    cost_to_go,
)
from optdock.controllers.tracking_controller import TrackingController, TrackingControllerParameters
from optdock.errors import NoValidControl
from optdock.geometry.pose import Pose2, Twist2, arc_end
from optdock.model.constant_jerk import braking_time
from optdock.model.robot import Drive, TrackingTube, admissible

if TYPE_CHECKING:
    from optdock.controllers.tracking_checks import AcceptedErrors
    from optdock.geometry.arrays import FloatArray
    from optdock.model.limits import MotionLimits
    from optdock.model.path import Path
    from optdock.model.trajectory import Trajectory
    from optdock.plugins.interfaces import GoalChecker

__all__ = ["CycleOutcome", "MpcController", "MpcControllerParameters", "MpcStatus"]

_RICCATI_STEP = 0.1  # [s]: finer steps of the cost to go change commands by less than a percent
_JERK_TOLERANCE = 1e-3  # of the limit
_AT_REST = 1e-6  # [m/s]
_LONGEST_LATENCY = 0.5  # [s], for which commands are kept
_MOST = 1e3  # [m/s], [rad/s]: above every limit, for the reachable interval of a command


class MpcControllerParameters(TrackingControllerParameters):
    """Horizon, weights and drive of the MpcController; gains and preview of the TrackingController are not used.

    The weights are the rounded results of `python -m experiments.benchmarks tracking --tune 120`, except that
    `smoothness`, `along_error` and the weight of the yaw are larger, which halves the effect of noise at 20 Hz.
    """

    horizon: float = Field(
        default=0.7, gt=0.0, le=5.0, description="length of the horizon, at least as long as braking takes [s]"
    )
    steps: int = Field(default=14, ge=3, le=60, description="steps of the horizon")
    latency: float | None = Field(
        default=None,
        ge=0.0,
        le=0.5,
        description="dead time between a command and its first effect [s]; None: identified online",
    )
    lag: float | None = Field(
        default=None, ge=0.0, description="time constant of the drive [s]; None: identified online"
    )
    along_error: float = Field(default=0.015, gt=0.0, description="longitudinal error with unit cost [m]")
    cross_error: float = Field(default=0.0125, gt=0.0, description="lateral error with unit cost [m]")
    yaw_error: float = Field(default=0.05, gt=0.0, description="heading error with unit cost [rad]")
    speed_effort: float = Field(default=0.08, gt=0.0, description="deviation of the speed with unit cost [m/s]")
    yaw_rate_effort: float = Field(default=0.3, gt=0.0, description="deviation of the yaw rate with unit cost [rad/s]")
    smoothness: float = Field(
        default=0.2, ge=0.0, description="time scale of the cost of changes of these deviations [s]"
    )
    final_weight: float = Field(default=20.0, ge=0.0, description="weight of the terminal error, as a duration [s]")
    hold_tube: bool = Field(
        default=True, description="keep the robot within the tracking tube, Robot.tracking, if it is given"
    )


class CycleOutcome(str, Enum):
    """Source of the command in a control cycle."""

    SOLVED = "solved"
    JERK_EXCEEDED = "no commands keep the jerk limit: it is exceeded by the smallest possible amount"
    SHIFTED = "no commands found in time: the commands of the previous cycle continue"


class MpcStatus(NamedTuple):
    """Result of one control cycle."""

    outcome: CycleOutcome  # source of the command
    outside_tube: float  # largest distance of the prediction outside of the tube [m]; 0 inside, or without a tube


class _Plan(NamedTuple):
    """Commands of a cycle solved at `stamp`, Shape (n, 2), and the time after it at which each begins [s]."""

    stamp: float
    times: FloatArray
    commands: FloatArray


class _CostToGo(NamedTuple):
    """Cost matrices of a trajectory, Shape (n, 3, 3), at times on its clock [s]."""

    times: list[float]
    matrices: FloatArray


class _Grid(NamedTuple):
    """Steps of the horizon.

    `times`: borders of the n steps, Shape (n + 1,) [s]; `lengths` of the first and of every other step [s]; `previews`:
    times of the reference poses that the program uses, Shape (2 n + 2,) [s].
    """

    times: FloatArray
    lengths: tuple[float, float]
    previews: FloatArray


class _Built(NamedTuple):
    """Parameters and data of the robot for which the program was built."""

    parameters: MpcControllerParameters
    tube: tuple[float, float] | None
    is_ackermann: bool


class MpcController(TrackingController):
    """Controller that follows a trajectory by model predictive control.

    The class is a TrackingController with a different control law.

    Every cycle minimizes errors and effort over the commands of the next `horizon` seconds, or of the braking time if
    it is longer, subject to all limits of the robot (`mpc_program`), and returns the first command. The cost to go
    accounts for the rest of the trajectory, so errors are corrected before the robot reaches the dock if possible.
    Latency and lag, given or identified, are part of the model. Lateral and heading errors are kept within the robot's
    tube, `Robot.tracking`, if it is given and the limits allow it.

    `status` reports whether no commands satisfy the jerk limit because the reference has jumped, whether the robot is
    outside the tube, and whether the program has no solution. If the program has no solution, the commands of the
    previous cycle are continued; after the last of these commands, NoValidControl is raised.

    Args:
        **parameters: Fields of `MpcControllerParameters`.

    Attributes:
        status: Result of the last cycle.

    Raises:
        InvalidValue: If a parameter is unknown, of the wrong type or out of range.
    """

    Parameters = MpcControllerParameters
    parameters: MpcControllerParameters

    def __init__(self, **parameters: object) -> None:
        super().__init__(**parameters)
        self.status = MpcStatus(CycleOutcome.SOLVED, 0.0)
        self._program: TrackingProgram | None = None
        self._built: _Built | None = None
        self._horizon = self.parameters.horizon
        self._grid: _Grid | None = None
        self._to_go: dict[Trajectory, _CostToGo] = {}
        self._measured = Pose2(0.0, 0.0, 0.0), Twist2()
        self._given: deque[tuple[float, Twist2]] = deque()
        self._plan: _Plan | None = None
        self._nominal: tuple[float, float] | None = None  # nominal command of the last cycle
        self._limiter: _ProgramLimiter = _ProgramLimiter()

    def on_configure(self) -> None:
        """Build the program and load the solver in advance, because this takes longer than a cycle."""
        self._prepare()

    def reset(self) -> None:
        """Discard the path and the identified delay; the speed limit is kept."""
        super().reset()
        self._to_go.clear()
        self._given.clear()
        self._plan = self._nominal = None
        self._limiter = _ProgramLimiter()

    def set_path(self, path: Path | Trajectory, *, start_stamp: float | None = None) -> None:
        """Follow a trajectory, or a path after timing it; see `TrackingController.set_path`."""
        super().set_path(path, start_stamp=start_stamp)
        self._prepare()

    def _prepare(self) -> None:
        """Build the program after a change of parameters or robot, and compute the missing costs to go."""
        p, tube, is_ackermann = self.parameters, self._tube, self._drive is Drive.ACKERMANN
        built = self._built
        if built is None or built.parameters is not p or (built.tube, built.is_ackermann) != (tube, is_ackermann):
            self._program = TrackingProgram(p.steps, self._weights, ackermann=is_ackermann, tube=tube)
            self._program.load()
            self._built = _Built(p, tube, is_ackermann)
            self._to_go.clear()
        self._horizon = p.horizon
        if self._reference is not None:
            live = dict.fromkeys((self._reference.trajectory, self._reference.last))
            self._to_go = {each: self._to_go[each] if each in self._to_go else self._cost_to_go(each) for each in live}
            # The cost to go ignores the limits: with a horizon shorter than the braking time, braking would begin too
            # late.
            fastest = max(peaks(each)[0] for each in live)
            self._horizon = max(
                self._horizon, braking_time(fastest, self._limits.max_deceleration, self._limits.max_jerk)
            )

    def compute_velocity_commands(
        self, pose: Pose2, velocity: Twist2, goal_checker: GoalChecker | None, *, stamp: float | None = None
    ) -> Twist2:
        """Return the command for the coming period; see `TrackingController.compute_velocity_commands`."""
        self._measured, before = (pose, velocity), self._clock.now
        try:
            command = super().compute_velocity_commands(pose, velocity, goal_checker, stamp=stamp)
        except NoValidControl:
            self._plan = self._nominal = None
            self._remember(Twist2())
            raise
        if self._clock.now != before:
            self._remember(command)
        return command

    def _remember(self, command: Twist2) -> None:
        """Record a command that has been sent to the drive."""
        if self._clock.now is None:
            return
        self._given.append((self._clock.now, command))
        while len(self._given) > 2 and self._given[1][0] < self._clock.now - _LONGEST_LATENCY:
            self._given.popleft()

    @property
    def _delays(self) -> tuple[float, float]:
        """Latency and lag [s]."""
        p = self.parameters
        latency, lag = self._delay.latency_and_lag
        return latency if p.latency is None else p.latency, lag if p.lag is None else p.lag

    @property
    def _known_delay(self) -> float:
        p = self.parameters
        return self._delay.delay if p.latency is None and p.lag is None else sum(self._delays)

    @property
    def _tube(self) -> tuple[float, float] | None:
        """Half width [m] and heading error [rad] of the robot's tube; None without a tube."""
        tube = self.context.problem.robot.tracking if self.context.problem else TrackingTube()
        held = self.parameters.hold_tube and tube.cross > 0.0 and tube.yaw > 0.0
        return (tube.cross, tube.yaw) if held else None

    @property
    def _weights(self) -> MpcWeights:
        p = self.parameters
        errors = np.array([p.along_error, p.cross_error, p.yaw_error]) ** -2.0
        effort = np.array([p.speed_effort, p.yaw_rate_effort]) ** -2.0
        return MpcWeights(errors, effort, p.smoothness**2 * effort, p.final_weight * errors)

    def _cost_to_go(self, trajectory: Trajectory) -> _CostToGo:
        times = np.linspace(0.0, trajectory.duration, max(1, math.ceil(trajectory.duration / _RICCATI_STEP)) + 1)
        return _CostToGo(
            times.tolist(), cost_to_go(motion_table(trajectory).at(times)[:, 1:4].copy(), times, self._weights)
        )

    def _wanted(
        self, reference: TrajectoryReference, now: ReferenceState, error: Pose2, accepted: AcceptedErrors
    ) -> Twist2:
        if self._built is None or self._built.parameters is not self.parameters:
            self._prepare()
        # The model contains neither braking after a cancellation nor turning of steered wheels at rest.
        turning = self._drive is Drive.ACKERMANN and now.ahead.speed < _AT_REST and not reference.finished
        if self._cancelled or turning or self._program is None:
            self._nominal = self._limiter.allowed = None
            return super()._wanted(reference, now, error, accepted)
        grid, self._grid = self._grid or self._new_grid(), None
        cycle = self._cycle(reference, grid)
        v, w = self._solved(self._program, cycle, grid.times)
        self._nominal = self._program.nominal.item(0), self._program.nominal.item(1)
        most = self._limits.max_lateral_acceleration / abs(v) if v != 0.0 else math.inf
        w = min(max(w, -most), most)
        if cycle.curvature is not None:
            least, most = sorted((cycle.curvature[:, 0] * v).tolist())
            w = min(max(w, least), most)
        self._limiter.allowed = Twist2(v, w)
        return self._limiter.allowed

    def _horizon_times(self) -> FloatArray:
        if self._built is None or self._cancelled:
            return super()._horizon_times()
        self._grid = self._new_grid()
        return self._grid.previews

    def _new_grid(self) -> _Grid:
        """Return the steps of the horizon, which begins when the next command takes effect."""
        n, period, (latency, lag) = self.parameters.steps, self._clock.period, self._delays
        lengths = period, max(period, (self._horizon - period) / (n - 1))
        times = np.full(n + 1, lengths[1])
        times[0], times[1] = 0.0, period
        times.cumsum(out=times)
        # The nominal commands lead the reference by the lag.
        return _Grid(times, lengths, np.concatenate((latency + times, latency + (times + lag))))

    def _cycle(self, reference: TrajectoryReference, grid: _Grid) -> MpcCycle:
        """Return the data of the program for this cycle, beginning at the time when its command takes effect."""
        (latency, lag), last = self._delays, self._limiter.command
        poses = reference.poses_ahead(grid.previews)
        trajectory, time = reference.trajectory_ahead(latency + grid.times.item(-1))
        times, costs = self._to_go[trajectory]
        pose, velocity = self._at_effect(latency, lag)
        seen = pose.in_frame_of(Pose2(*poses[0].tolist()))
        return MpcCycle(
            poses=poses,
            lengths=grid.lengths,
            lag=lag,
            state=(seen.x, seen.y, seen.yaw, velocity.linear, velocity.angular),
            after=costs[min(bisect_left(times, time), len(times) - 1)],
            nominal_before=(last.linear, last.angular) if self._nominal is None else self._nominal,
            last=(last.linear, last.angular),
            last_acceleration=self._limiter.acceleration,
            elapsed=self._clock.elapsed,
            bounds=self._bounds(),
            limits=self._limits,
            curvature=self._reachable_curvature(grid.times[1:]) if self._drive is Drive.ACKERMANN else None,
        )

    def _at_effect(self, latency: float, lag: float) -> tuple[Pose2, Twist2]:
        """Predict pose and velocity at the time when the next command takes effect, from the previous commands."""
        pose, velocity = self._measured
        x, y, yaw, v, w = pose.x, pose.y, pose.yaw, velocity.linear, velocity.angular
        now = self._clock.now or 0.0
        acting: list[tuple[float, float, Twist2]] = []  # times at which each command begins and ceases to act
        until = now + latency
        for stamp, command in reversed(self._given):
            if until <= now:
                break
            acting.append((max(stamp + latency, now), until, command))
            until = stamp + latency
        for begin, end, command in reversed(acting):
            if end <= begin:
                continue
            decay = math.exp(-(end - begin) / lag) if lag > 0.0 else 0.0
            mean = (1.0 - decay) * lag / (end - begin)
            more_v, more_w = v - command.linear, w - command.angular
            driven = command.linear + mean * more_v, command.angular + mean * more_w, 0.0
            x, y, yaw = arc_end(x, y, yaw, driven, end - begin)
            v, w = command.linear + decay * more_v, command.angular + decay * more_w
        return Pose2(x, y, yaw), Twist2(v, w)

    def _solved(self, program: TrackingProgram, cycle: MpcCycle, times: FloatArray) -> tuple[float, float]:
        """Return speed and yaw rate of the next command, and set `status`; `times`: borders of the steps [s]."""
        now, found = self._clock.now or 0.0, program.solve(cycle)
        if found is not None:
            exceeded = found.over_jerk > _JERK_TOLERANCE * self._limits.max_jerk
            self.status = MpcStatus(CycleOutcome.JERK_EXCEEDED if exceeded else CycleOutcome.SOLVED, found.outside)
            self._plan = _Plan(now, times[:-1], found.commands)
            return found.commands.item(0), found.commands.item(1)
        self.status = MpcStatus(CycleOutcome.SHIFTED, 0.0)
        if self._plan is None or now - self._plan.stamp > self._plan.times[-1]:
            raise NoValidControl(
                f"{self.name}: no commands were found for {self._horizon:g} s, and earlier commands are used "
                f"up; plan again from here"
            )
        begun = int(self._plan.times.searchsorted(now - self._plan.stamp, side="right")) - 1
        v, w = self._plan.commands[max(begun, 0)].tolist()
        return v, w

    def _bounds(self) -> CommandBounds:
        """Return the bounds of the next command."""
        limits, period, last = self._limits, self._clock.elapsed, self._limiter.command.linear
        least, most = ((reachable_speed(last, far, limits, period) - last) / period for far in (-_MOST, _MOST))
        # The next command must be able to level out within the largest speed.
        down, up = limits.max_reverse_speed + last, limits.max_speed - last
        lowest = last - min(down, period * fastest_slope(down, limits.max_jerk, period))
        highest = last + min(up, period * fastest_slope(up, limits.max_jerk, period))
        # The remainder of the linearized lateral acceleration is at most the product of both changes.
        lateral = limits.max_lateral_acceleration
        if math.isfinite(limits.max_yaw_acceleration):
            rest = max(limits.max_acceleration, limits.max_deceleration) * limits.max_yaw_acceleration * period**2
            lateral *= 1.0 - min(0.1, rest / limits.max_lateral_acceleration)
        return CommandBounds((lowest, highest), (least, most), lateral)

    def _reachable_curvature(self, times: FloatArray) -> FloatArray:
        """Return the least and the largest curvature that the wheels can reach at `times`, Shape (2, n)."""
        limits = self._limits
        if not math.isfinite(limits.max_steering_rate):
            return np.repeat([[-limits.max_curvature], [limits.max_curvature]], times.size, axis=1)
        angle = math.atan(limits.wheelbase * (self._limiter.curvature or 0.0))
        turned = np.array([[-1.0], [1.0]]) * limits.max_steering_rate * times
        most = math.atan(limits.wheelbase * limits.max_curvature)
        reached: FloatArray = np.tan(np.clip(angle + turned, -most, most)) / limits.wheelbase
        return reached


class _ProgramLimiter(CommandLimiter):
    """Limiter that returns the program's commands unchanged and limits commands that were changed at the end.

    Attributes:
        allowed: The program's command of this cycle.
    """

    def restart(self, command: Twist2) -> None:
        """Restart at the velocity of the robot, with zero acceleration."""
        super().restart(command)
        self.allowed: Twist2 | None = None

    def follow(  # noqa: PLR0913 - two commands, their time, and their bounds
        self,
        wanted: Twist2,
        feed_forward: Twist2,
        period: float,
        limits: MotionLimits,
        drive: Drive,
        *,
        in_place: bool,
        room: float = math.inf,
    ) -> Twist2:
        """Return the reachable command nearest to `wanted`; see `CommandLimiter.follow`."""
        before, is_first, allowed = self.command, self._feed_forward is None, self.allowed
        is_kept = allowed is not None and not is_first and wanted.linear == allowed.linear
        # The finish leaves out a negligible turn.
        is_kept = is_kept and allowed is not None and wanted.angular in (allowed.angular, 0.0)
        if not is_kept or drive is Drive.ACKERMANN:  # the curvature of steered wheels is defined at rest, too
            command = super().follow(wanted, feed_forward, period, limits, drive, in_place=in_place, room=room)
            if not is_kept:
                return command
        else:
            self._fed_slope(feed_forward.linear, period)
            self._keep(before, feed_forward.linear, period)
        self.command = command = admissible(rate_limited(before, wanted, limits, period), limits, drive)
        self.acceleration = (command.linear - before.linear) / period
        if abs(command.linear) > _AT_REST:
            self.curvature = command.angular / command.linear
        return command
