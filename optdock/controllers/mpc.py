"""MpcController: drives a trajectory by the best commands of a short horizon within the robot's limits."""

from __future__ import annotations

import math
from collections import deque
from enum import Enum
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from pydantic import Field

from optdock.controllers.moving_reference import Reference, ReferenceState
from optdock.controllers.mpc_program import (
    CommandBounds,
    Cycle,
    TrackingProgram,
    Weights,
    arcs_between,
    predicted,
    riccati_back,
    step_matrices,
)
from optdock.controllers.tracking import TrackingController, TrackingControllerParameters, rate_limited
from optdock.errors import NoValidControl
from optdock.geometry.pose import Pose2, Twist2
from optdock.robot import Drive

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray
    from optdock.interfaces import GoalChecker
    from optdock.limits import MotionLimits
    from optdock.path import Path
    from optdock.trajectory import Trajectory

__all__ = ["CycleOutcome", "MpcController", "MpcControllerParameters", "MpcStatus"]

_RICCATI_STEP = 0.1  # [s]: the cost to go is smooth; finer steps change commands by less than a percent
_EXACT = 1e4  # penalty per metre and per m/s^3: above every multiplier of errors that weigh 1 to 10
_JERK_TOLERANCE = 1e-3  # of the limit
_AT_REST = 1e-6  # [m/s]
_MOST = 1e3  # [m/s], [rad/s]: faster than anything, for the reachable interval of a command


class MpcControllerParameters(TrackingControllerParameters):
    """Horizon, weights and drive of the MpcController."""

    horizon: float = Field(default=0.8, gt=0.0, description="how far ahead it looks [s]")
    steps: int = Field(default=16, ge=3, le=60, description="of the horizon")
    latency: float = Field(default=0.0, ge=0.0, description="between a command and its first effect [s]")
    lag: float = Field(default=0.0, ge=0.0, description="time constant of the drive [s]")
    along_error: float = Field(default=0.02, gt=0.0, description="error along that weighs 1 [m]")
    cross_error: float = Field(default=0.01, gt=0.0, description="error across that weighs 1 [m]")
    yaw_error: float = Field(default=0.05, gt=0.0, description="heading error that weighs 1 [rad]")
    speed_effort: float = Field(default=0.1, gt=0.0, description="speed beside the reference's that weighs 1 [m/s]")
    yaw_rate_effort: float = Field(default=0.2, gt=0.0, description="yaw rate beside the reference's that weighs 1")
    smoothness: float = Field(default=0.2, ge=0.0, description="time over which commands should change [s]")
    final_weight: float = Field(default=10.0, ge=0.0, description="weight of errors at the end [s]")
    tube_cross: float = Field(default=0.0, ge=0.0, description="half width of the tube [m]; 0: none")
    tube_yaw: float = Field(default=0.0, ge=0.0, description="yaw error of the tube [rad]; 0: none")


class CycleOutcome(str, Enum):
    """Where the command of a cycle comes from."""

    SOLVED = "solved"
    JERK_EXCEEDED = "no commands keep the jerk limit; exceeded by as little as can be"
    SHIFTED = "the program found no commands; those of the cycle before go on"


class MpcStatus(NamedTuple):
    """How a cycle went: its outcome, and how far the prediction leaves the tube [m]."""

    outcome: CycleOutcome
    outside_tube: float


class MpcController(TrackingController):
    """Follows a trajectory by model predictive control."""

    Parameters = MpcControllerParameters
    parameters: MpcControllerParameters

    def __init__(self, **parameters: object) -> None:
        super().__init__(**parameters)
        self.status = MpcStatus(CycleOutcome.SOLVED, 0.0)
        self._pose, self._velocity = Pose2(0.0, 0.0, 0.0), Twist2()
        self._program: TrackingProgram | None = None
        self._under_way: deque[Twist2] = deque()
        self._previous: tuple[FloatArray, FloatArray] | None = None
        self._acceleration = self._curvature = 0.0
        self._to_go: tuple[FloatArray, FloatArray] | None = None

    def on_configure(self) -> None:
        """Build the program and load the solver, which takes longer than a cycle."""
        self._build()

    def reset(self) -> None:
        super().reset()
        self._under_way.clear()
        self._previous, self._acceleration = None, 0.0

    def set_path(self, path: Path | Trajectory, *, start_stamp: float | None = None) -> None:
        super().set_path(path, start_stamp=start_stamp)
        if self._program is None:
            self._build()
        self._to_go = None
        self._previous = None

    def compute_velocity_commands(
        self, pose: Pose2, velocity: Twist2, goal_checker: GoalChecker | None, *, stamp: float | None = None
    ) -> Twist2:
        self._pose, self._velocity = pose, velocity
        before = self._last
        fresh = not self._anchored
        command = super().compute_velocity_commands(pose, velocity, goal_checker, stamp=stamp)
        if fresh:
            before = Twist2(velocity.linear, velocity.angular)
        self._acceleration = (command.linear - before.linear) / self.parameters.period
        self._under_way.append(command)
        return command

    def _anchor(self, reference: Reference, pose: Pose2, velocity: Twist2) -> None:
        super()._anchor(reference, pose, velocity)
        if reference.time == 0.0 and velocity.linear == 0.0:
            reference.time = -self.parameters.latency

    @property
    def _weights(self) -> Weights:
        p = self.parameters
        errors = np.array([p.along_error, p.cross_error, p.yaw_error]) ** -2.0
        effort = np.array([p.speed_effort, p.yaw_rate_effort]) ** -2.0
        return Weights(errors, effort, p.smoothness**2 * effort, p.final_weight * errors, _EXACT, _EXACT)

    def _build(self) -> None:
        p = self.parameters
        self._program = TrackingProgram(
            p.steps, self._weights, ackermann=self._drive is Drive.ACKERMANN, in_tube=p.tube_cross > 0.0
        )

    def _cost_to_go(self, trajectory: Trajectory, time: float) -> FloatArray:
        if self._to_go is None:
            count = max(1, math.ceil(trajectory.duration / _RICCATI_STEP))
            times = np.linspace(0.0, trajectory.duration, count + 1)
            row = trajectory.sample_at(times)
            arcs = arcs_between(np.column_stack((row.x, row.y, row.yaw)), times)
            w = self._weights
            self._to_go = times, riccati_back(arcs, w.errors, w.effort, w.final)
        times, costs = self._to_go
        at_end: FloatArray = costs[int(np.searchsorted(times, time).clip(0, len(times) - 1))]
        return at_end

    def _wanted(
        self, reference: Reference, now: ReferenceState, error: Pose2, goal_checker: GoalChecker | None
    ) -> Twist2:
        if self._cancelled and reference.rate == 0.0:
            self._previous = None
            return Twist2()
        p, n = self.parameters, self.parameters.steps
        period = p.period
        h = np.full(n, max(period, (p.horizon - period) / (n - 1)))
        h[0] = period
        # From when the command takes effect on: the poses, those of a lag later, and those one period before.
        t = np.concatenate(([0.0], np.cumsum(h)))
        start = reference.time + reference.rate * p.latency
        times = np.concatenate((t, [p.lag - period], t + p.lag))
        trajectory = reference.trajectory
        row = trajectory.sample_at(start + reference.rate * times)
        poses = np.column_stack((row.x, row.y, row.yaw))
        poses[:, 2] = np.unwrap(poses[:, 2])
        arcs = arcs_between(poses[: n + 1], t)
        ahead = arcs_between(poses[n + 1 :], times[n + 1 :])
        nominal = np.column_stack((ahead.v, ahead.w))

        pose, v, w = self._pose, self._velocity.linear, self._velocity.angular
        keep = round(p.latency / period)
        while len(self._under_way) > keep:
            self._under_way.popleft()
        decay = math.exp(-period / p.lag) if p.lag > 0.0 else 0.0
        kept = (1.0 - decay) * p.lag / period
        for command in self._under_way:
            u, r = command.linear, command.angular
            pose = pose.moved(Twist2(u + (v - u) * kept, r + (w - r) * kept), period)
            v, w = u + (v - u) * decay, r + (w - r) * decay
        seen = pose.in_frame_of(Pose2(*poses[0].tolist()))
        state = np.array([seen.x, seen.y, seen.yaw, v, w])
        cycle = Cycle(
            prediction=predicted(state, step_matrices(arcs, (p.lag, p.lag))),
            nominal=nominal,
            cost_to_go=self._cost_to_go(trajectory, start + reference.rate * t[-1]),
            h=h,
            bounds=self._bounds(nominal[1:], h),
            last=np.array([self._last.linear, self._last.angular]),
            last_acceleration=self._acceleration,
            tube=(p.tube_cross, p.tube_yaw) if p.tube_cross > 0.0 else None,
        )
        commands = self._solved(cycle)
        if cycle.bounds.curvature is not None:
            least, most = sorted((cycle.bounds.curvature[:, 0] * commands[0, 0]).tolist())
            commands[0, 1] = min(max(commands[0, 1], least), most)
        self._previous = t, commands
        return Twist2(float(commands[0, 0]), float(commands[0, 1]))

    def _solved(self, cycle: Cycle) -> FloatArray:
        assert self._program is not None
        found = self._program.solve(cycle)
        if found is not None:
            exceeded = found.over_jerk > _JERK_TOLERANCE * cycle.bounds.jerk
            outcome = CycleOutcome.JERK_EXCEEDED if exceeded else CycleOutcome.SOLVED
            self.status = MpcStatus(outcome, found.outside)
            return found.commands
        if self._previous is None:
            raise NoValidControl(f"{self.name}: the program has no solution")  # the server stops the robot
        t, commands = self._previous
        self.status = MpcStatus(CycleOutcome.SHIFTED, 0.0)
        later = np.cumsum(cycle.h) - 0.5 * cycle.h + cycle.h[0]
        index = np.searchsorted(t, later, side="right") - 1
        shifted: FloatArray = commands[index.clip(0, len(commands) - 1)]
        return shifted

    def _bounds(self, nominal: FloatArray, h: FloatArray) -> CommandBounds:
        """What the limits allow from the last command on."""
        n, limits, period, last = self.parameters.steps, self._limits, self.parameters.period, self._last
        lowest = rate_limited(last, Twist2(-_MOST, -_MOST), limits, period)
        highest = rate_limited(last, Twist2(_MOST, _MOST), limits, period)
        v = nominal[:, 0]
        travel = np.sign(v + np.concatenate((v[:1], v[:-1])))
        rise, fall = limits.max_acceleration, limits.max_deceleration
        up = np.select([travel > 0.0, travel < 0.0], [rise, fall], min(rise, fall))
        down = np.select([travel > 0.0, travel < 0.0], [fall, rise], min(rise, fall))
        acceleration = np.array([-down, up])
        acceleration[:, 0] = (lowest.linear - last.linear) / period, (highest.linear - last.linear) / period
        speed = np.tile([[-limits.max_reverse_speed], [limits.max_speed]], n)
        up_to = _landing(limits.max_speed - last.linear, limits.max_jerk, period)
        down_to = _landing(limits.max_reverse_speed + last.linear, limits.max_jerk, period)
        speed[:, 0] = last.linear - down_to, last.linear + up_to
        curvature, gear = None, np.ones(n)
        if self._drive is Drive.ACKERMANN:
            gear, going = np.sign(np.where(np.abs(v) > _AT_REST, v, 0.0)), math.copysign(1.0, last.linear)
            # While it changes gear its speed is of either sign, and it keeps straight as far as it can.
            gear[(np.cumsum(h) - h < _braking_time(abs(last.linear), limits)) & (gear != going)] = 0.0
            speed = np.where([gear > 0.0, gear < 0.0], 0.0, speed)
            curvature = self._reachable_curvature(np.cumsum(h))
        return CommandBounds(
            speed=speed,
            yaw_rate=_both_ways(limits.max_yaw_rate, n),
            acceleration=acceleration,
            yaw_acceleration=_both_ways(limits.max_yaw_acceleration, n),
            jerk=limits.max_jerk,
            wheel_speed=limits.max_wheel_speed,
            half_track=0.5 * limits.track_width,
            lateral=_both_ways(limits.max_lateral_acceleration, n),
            about=nominal,
            curvature=curvature,
            gear=gear,
        )

    def _reachable_curvature(self, times: FloatArray) -> FloatArray:
        """Least and largest curvature that the wheels can have turned to by then, Shape (2, n)."""
        limits = self._limits
        if not math.isfinite(limits.max_steering_rate):
            return _both_ways(limits.max_curvature, times.size)
        if abs(self._last.linear) > _AT_REST:
            self._curvature = self._last.angular / self._last.linear
        angle = math.atan(limits.wheelbase * self._curvature)
        turned = np.array([[-1.0], [1.0]]) * limits.max_steering_rate * times
        most = math.atan(limits.wheelbase * limits.max_curvature)
        reached: FloatArray = np.tan(np.clip(angle + turned, -most, most)) / limits.wheelbase
        return reached


def _both_ways(bound: float, count: int) -> FloatArray:
    return np.array([[-bound] * count, [bound] * count])


def _landing(room: float, jerk: float, period: float) -> float:
    """Largest change of the speed in one period after which it can still level out within `room` [m/s].

    Every later change is smaller by the unit jerk * period^2. A change of m units, n <= m < n + 1, is followed by
    m - 1, m - 2, .. m - n: with it they add up to m (n + 1) - n (n + 1) / 2.
    """
    unit = jerk * period**2
    units = max(room, 0.0) / unit
    n = math.floor(0.5 * (math.sqrt(1.0 + 8.0 * units) - 1.0))
    return min(room, unit * (units / (n + 1) + 0.5 * n))


def _braking_time(speed: float, limits: MotionLimits) -> float:
    """How long a robot takes to stop under its jerk limit [s]."""
    full = limits.max_deceleration**2 / limits.max_jerk
    if speed < full:
        return 2.0 * math.sqrt(speed / limits.max_jerk)
    return speed / limits.max_deceleration + limits.max_deceleration / limits.max_jerk
