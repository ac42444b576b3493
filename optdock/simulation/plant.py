"""The plant model: a differential drive with latency, lag, dead bands, wheel errors and slip.

The effects are applied in this order: limits of the robot, dead band and gains, latency, wheels (gain, dead band,
saturation), lag, a stuck wheel, slip. Between arrivals of commands the target is constant and the lag is integrated
exactly, so steps may have any duration.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, field, fields
from enum import Enum
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np

from optdock.errors import InvalidValue
from optdock.geometry.checked import finite_number, member, number
from optdock.geometry.pose import Pose2, Twist2, arc_end
from optdock.model.robot import admissible

if TYPE_CHECKING:
    from collections.abc import Iterable

    from optdock.model.robot import Robot

__all__ = ["Actuation", "DifferentialDrive", "Plant", "PlantState", "Slip", "StuckWheel", "Wheel", "Wheels"]

_LONGEST_LATENCY = 10.0  # [s]; every command within the latency is stored
_INSTANT = 1e-9  # [s]: commands that arrive within this time arrive at once
_BLOCK = 512  # random numbers drawn per call, because a call of NumPy takes as long as a hundred of them
_SLIP_CORRELATION = 0.3  # [s]: time constant of the noise of slip
_Target = tuple[float, float]


@dataclass(frozen=True)
class Actuation:
    """Response of the drive to commands; by default, the drive is perfect.

    Args:
        linear_lag: Time constant of the first-order lag of the speed [s]; 0: no lag.
        angular_lag: Time constant of the first-order lag of the yaw rate [s].
        latency: Delay between a command and its first effect [s].
        linear_dead_band: Commanded speeds below this value have no effect [m/s].
        angular_dead_band: Commanded yaw rates below this value have no effect [rad/s].
        linear_gain: Speed per commanded speed [1].
        angular_gain: Yaw rate per commanded yaw rate [1].
        longest_substep: Largest integration step while the velocity changes [s].

    Raises:
        InvalidValue: If a value is not a number, is negative, or is not finite, the latency is above 10 s, or the
            sub-step is 0.
    """

    linear_lag: float = 0.0
    angular_lag: float = 0.0
    latency: float = 0.0
    linear_dead_band: float = 0.0
    angular_dead_band: float = 0.0
    linear_gain: float = 1.0
    angular_gain: float = 1.0
    longest_substep: float = 0.005

    def __post_init__(self) -> None:
        check_not_negative(self, "actuation", (spec.name for spec in fields(self)))
        if self.latency > _LONGEST_LATENCY:
            raise InvalidValue(f"actuation.latency: must be <= {_LONGEST_LATENCY} s, got {self.latency}")
        if self.longest_substep == 0.0:
            raise InvalidValue("actuation.longest_substep: must be > 0 s, got 0.0")

    def target(self, command: Twist2) -> tuple[float, float]:
        """Return the steady speed and yaw rate of a command, after dead bands and gains."""
        linear = self.linear_gain * command.linear if abs(command.linear) >= self.linear_dead_band else 0.0
        angular = self.angular_gain * command.angular if abs(command.angular) >= self.angular_dead_band else 0.0
        return linear, angular


class Wheel(str, Enum):
    """One of the two driven wheels."""

    LEFT = "left"
    RIGHT = "right"


@dataclass(frozen=True)
class StuckWheel:
    """A fault: a wheel that does not turn during an interval.

    Args:
        wheel: A `Wheel` or its value.
        start: Start of the fault on the plant's clock, which starts at 0 [s].
        end: End of the fault [s].

    Raises:
        InvalidValue: If there is no such wheel, or the start is not before the end.
    """

    wheel: Wheel
    start: float = 0.0
    end: float = math.inf

    def __post_init__(self) -> None:
        object.__setattr__(self, "wheel", member(Wheel, self.wheel, "stuck_wheel.wheel"))
        object.__setattr__(self, "start", finite_number(self.start, "stuck_wheel.start"))
        object.__setattr__(self, "end", number(self.end, "stuck_wheel.end"))
        if not self.start < self.end:
            raise InvalidValue(f"stuck_wheel.end: must be > start, {self.start} s, got {self.end}")


@dataclass(frozen=True)
class Wheels:
    """Errors and faults of the two driven wheels; all speeds are rim speeds [m/s].

    The base is assumed to compute wheel speeds from a command with the nominal radius and track width.

    Args:
        track_width: Nominal track width [m].
        left_gain: Ratio of the true to the nominal radius of the left wheel [1].
        right_gain: Ratio of the true to the nominal radius of the right wheel [1].
        left_dead_band: Speeds of the left wheel below this value have no effect.
        right_dead_band: Speeds of the right wheel below this value have no effect.
        max_speed: Saturation speed of each wheel; the wheels saturate separately, which changes the curvature.
        stuck: Faults.

    Raises:
        InvalidValue: If a value is not a number, is negative, or is not finite, or a width, a gain or the largest speed
            is 0.
    """

    track_width: float
    left_gain: float = 1.0
    right_gain: float = 1.0
    left_dead_band: float = 0.0
    right_dead_band: float = 0.0
    max_speed: float = math.inf
    stuck: tuple[StuckWheel, ...] = ()

    def __post_init__(self) -> None:
        check_not_negative(self, "wheels", ("left_dead_band", "right_dead_band"))
        for name in ("track_width", "left_gain", "right_gain", "max_speed"):
            value = number(getattr(self, name), f"wheels.{name}")
            object.__setattr__(self, name, value)
            if not (value > 0.0 and (math.isfinite(value) or name == "max_speed")):
                raise InvalidValue(f"wheels.{name}: must be finite and > 0, got {value}")
        object.__setattr__(self, "stuck", tuple(self.stuck))

    def target(self, linear: float, angular: float) -> _Target:
        """Return the speed and yaw rate of the wheels for a commanded speed and yaw rate."""
        turn = 0.5 * self.track_width * angular
        left = self._rim(linear - turn, self.left_gain, self.left_dead_band)
        right = self._rim(linear + turn, self.right_gain, self.right_dead_band)
        return 0.5 * (left + right), (right - left) / self.track_width

    def _rim(self, speed: float, gain: float, dead_band: float) -> float:
        if abs(speed) < dead_band:
            return 0.0
        return min(max(gain * speed, -self.max_speed), self.max_speed)

    def held(self, linear: float, angular: float, time: float) -> _Target:
        """Return the speed and yaw rate with the faults present at a time [s]."""
        for fault in self.stuck:
            if fault.start - _INSTANT <= time < fault.end - _INSTANT:
                turn = 0.5 * self.track_width * angular
                left, right = linear - turn, linear + turn
                left, right = (0.0, right) if fault.wheel is Wheel.LEFT else (left, 0.0)
                linear, angular = 0.5 * (left + right), (right - left) / self.track_width
        return linear, angular

    def encoders(self, linear: float, angular: float) -> Twist2:
        """Return the body velocity that the base computes from the encoders with the nominal dimensions."""
        turn = 0.5 * self.track_width * angular
        left, right = (linear - turn) / self.left_gain, (linear + turn) / self.right_gain
        return Twist2(0.5 * (left + right), (right - left) / self.track_width)


@dataclass(frozen=True)
class Slip:
    """Wheel slip, which encoders do not measure; its noise is a seeded first-order Gauss-Markov process.

    Args:
        lost: Lost share of speed and yaw rate [1].
        drift: Leftward speed per forward speed, for example on a slope [1].
        turn: Leftward yaw rate per forward speed [rad/m].
        lost_sigma: Standard deviation of the lost share [1].
        drift_sigma: Standard deviation of the drift [1].
        turn_sigma: Standard deviation of the turn [rad/m].
        seed: Seed of the noise.

    Raises:
        InvalidValue: If a value is not a finite number, a sigma is negative, the lost share is not in [0, 1], or the
            seed is not a whole number >= 0.
    """

    lost: float = 0.0
    drift: float = 0.0
    turn: float = 0.0
    lost_sigma: float = 0.0
    drift_sigma: float = 0.0
    turn_sigma: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("lost", "drift", "turn"):
            object.__setattr__(self, name, finite_number(getattr(self, name), f"slip.{name}"))
        check_not_negative(self, "slip", ("lost_sigma", "drift_sigma", "turn_sigma"))
        if not 0.0 <= self.lost <= 1.0:
            raise InvalidValue(f"slip.lost: must be a share from 0 to 1, got {self.lost}")
        check_seed(self.seed, "slip.seed")

    @functools.cached_property
    def _noisy(self) -> bool:
        return max(self.lost_sigma, self.drift_sigma, self.turn_sigma) > 0.0

    @functools.cached_property
    def _drawn(self) -> _Normals:
        return _Normals(self.seed)

    def after(
        self, noise: tuple[float, float, float], drawn: int, duration: float
    ) -> tuple[tuple[float, float, float], int]:
        """Return the three standardized noise values after `duration` [s], and the number of random numbers drawn."""
        if not self._noisy:
            return noise, drawn
        keep = math.exp(-duration / _SLIP_CORRELATION)
        fresh = math.sqrt(1.0 - keep * keep)
        a, b, c = self._drawn.three(drawn)
        return (keep * noise[0] + fresh * a, keep * noise[1] + fresh * b, keep * noise[2] + fresh * c), drawn + 3

    def ground(self, linear: float, angular: float, noise: tuple[float, float, float]) -> tuple[float, float, float]:
        """Return the true body velocity (linear, angular, lateral) for the velocity of the wheels."""
        kept = 1.0 - min(max(self.lost + self.lost_sigma * noise[0], 0.0), 1.0)
        drift = self.drift + self.drift_sigma * noise[1]
        turn = self.turn + self.turn_sigma * noise[2]
        return kept * linear, kept * angular + turn * linear, drift * linear


class PlantState(NamedTuple):
    """Complete state of a plant.

    Attributes:
        pose: True pose.
        twist: True body velocity.
        encoders: Body velocity measured by encoders and steering sensor, without the effects of wheel errors and slip.
        time: Time since the beginning [s].
        drive: State of the actuators, apart from a stuck wheel: speed [m/s] and yaw rate [rad/s], or the steering angle
            of a car [rad].
        target: Target of the actuators.
        pending: Targets that have not yet arrived, each with a time of arrival.
        noise: Standardized noise of the slip.
        drawn: Number of random numbers drawn.
        contact: Whether robot and station touch; None for a plant without a station.
        physics: Additional state of a plant such as `MujocoPhysics`.
    """

    pose: Pose2
    twist: Twist2
    encoders: Twist2
    time: float
    drive: _Target
    target: _Target
    pending: tuple[tuple[float, _Target], ...] = ()
    noise: tuple[float, float, float] = (0.0, 0.0, 0.0)
    drawn: int = 0
    contact: bool | None = None
    physics: object | None = None


class Plant(Protocol):
    """Interface of plant models, which compute the motion of a robot in steps of any duration."""

    @property
    def robot(self) -> Robot:
        """The robot."""

    def moving(self, pose: Pose2, twist: Twist2) -> PlantState:
        """Return the state at a pose with a steady body velocity."""

    def step(self, state: PlantState, command: Twist2, duration: float | None = None) -> PlantState:
        """Return the state after `duration` [s] with a command given at its beginning."""

    def stopped(self, state: PlantState, pose: Pose2, *, stalled: bool) -> PlantState:
        """Return the state after a stop at `pose` by a rigid obstacle; if `stalled`, the wheels also stop."""


@dataclass(frozen=True, eq=False)
class DifferentialDrive:
    """Plant model of a robot with two driven wheels.

    A step is split at the arrivals of commands. Between arrivals, the robot follows the arc of its mean velocity, in
    sub-steps if there is a lag. The result is exact for constant velocities. Accelerations are not limited; the
    controller must limit them. `step` is a pure function.

    Args:
        robot: Robot whose limits are applied to every command.
        actuation: Lags, latency, dead bands and gains.
        period: Default duration of a step [s].
        wheels: Errors and faults of the wheels; None: no errors.
        slip: Slip.

    Raises:
        InvalidValue: If the period is not > 0.
    """

    robot: Robot
    actuation: Actuation = field(default_factory=Actuation)
    period: float = 0.02
    wheels: Wheels | None = None
    slip: Slip = field(default_factory=Slip)

    def __post_init__(self) -> None:
        check_duration(self.period, "plant.period")

    def at_rest(self, pose: Pose2) -> PlantState:
        """Return the state at rest at a pose."""
        return self.moving(pose, Twist2())

    def moving(self, pose: Pose2, twist: Twist2) -> PlantState:
        """Return the state at a pose with a steady body velocity, kept until the first command arrives."""
        drive = (twist.linear, twist.angular)
        return PlantState(pose, twist, self._encoders(drive), 0.0, drive, drive)

    def step(self, state: PlantState, command: Twist2, duration: float | None = None) -> PlantState:
        """Return the state after `duration` [s], or one period, with a command given at its beginning.

        Raises:
            InvalidValue: If the duration is not finite and > 0.
        """
        if duration is None:
            duration = self.period
        check_duration(duration, "plant.duration")
        noise, drawn = self.slip.after(state.noise, state.drawn, duration)
        pieces, target, pending = arrivals(state, self.actuation.latency, self._target(command), duration)
        pose, time, (v, w) = (state.pose.x, state.pose.y, state.pose.yaw), state.time, state.drive
        a = self.actuation
        for seconds, wanted in pieces:
            count = self._substeps(seconds, (v, w), wanted)
            span = seconds / count
            for _ in range(count):
                v_mean, v = first_order(v, wanted[0], a.linear_lag, span)
                w_mean, w = first_order(w, wanted[1], a.angular_lag, span)
                pose = arc_end(*pose, self.slip.ground(*self._held(v_mean, w_mean, time), noise), span)
                time += span
        end = state.time + duration
        turned = self._held(v, w, end)
        twist = Twist2(*self.slip.ground(*turned, noise))
        return PlantState(Pose2(*pose), twist, self._encoders(turned), end, (v, w), target, pending, noise, drawn)

    def stopped(self, state: PlantState, pose: Pose2, *, stalled: bool) -> PlantState:
        """Return the state after a stop at `pose` by a rigid obstacle; if `stalled`, the wheels also stop."""
        drive = (0.0, 0.0) if stalled else state.drive
        return state._replace(pose=pose, twist=Twist2(), encoders=self._encoders(drive), drive=drive)

    def _target(self, command: Twist2) -> _Target:
        target = self.actuation.target(admissible(command, self.robot.limits, self.robot.drive))
        return target if self.wheels is None else self.wheels.target(*target)

    def _substeps(self, seconds: float, drive: _Target, wanted: _Target) -> int:
        """Return the number of sub-steps, which is 1 while the velocity is constant."""
        a = self.actuation
        steady = (a.linear_lag == 0.0 and a.angular_lag == 0.0) or drive == wanted
        if steady and not (self.wheels is not None and self.wheels.stuck):
            return 1
        return pieces_of(seconds, a.longest_substep)

    def _held(self, linear: float, angular: float, time: float) -> _Target:
        return (linear, angular) if self.wheels is None else self.wheels.held(linear, angular, time)

    def _encoders(self, drive: _Target) -> Twist2:
        return Twist2(*drive) if self.wheels is None else self.wheels.encoders(*drive)


def arrivals(
    state: PlantState, latency: float, sent: _Target, duration: float
) -> tuple[list[tuple[float, _Target]], _Target, tuple[tuple[float, _Target], ...]]:
    """Return the targets of a step with their durations [s], the last target, and the targets that have not arrived.

    Args:
        state: State at the beginning of the step.
        latency: Delay of a target [s].
        sent: Target sent at the beginning.
        duration: Duration of the step [s].
    """
    target, at, end = state.target, state.time, state.time + duration
    queue = (*state.pending, (at + latency, sent))
    pieces: list[tuple[float, _Target]] = []
    count = 0
    for due, following in queue:
        if due >= end - _INSTANT:
            break
        if due > at + _INSTANT:
            pieces.append((due - at, target))
            at = due
        target = following
        count += 1
    pieces.append((end - at, target))
    return pieces, target, queue[count:]


def first_order(value: float, target: float, lag: float, step: float) -> tuple[float, float]:
    """Return the exact mean and final value of `lag * x' = target - x` over a step."""
    if lag <= 0.0:
        return target, target
    gap, decayed = value - target, -math.expm1(-step / lag)
    return target + gap * decayed * lag / step, value - gap * decayed


def pieces_of(seconds: float, longest: float) -> int:
    """Return the number of equal pieces of at most `longest` [s] in `seconds`."""
    return max(1, math.ceil(seconds / longest - 1e-6))


class _Normals:
    """Indexed standard normal numbers, which depend on the seed but not on the order of access."""

    def __init__(self, seed: int) -> None:
        self._generator = np.random.default_rng(seed)
        self._values: list[float] = []

    def three(self, index: int) -> list[float]:
        """Return the numbers from `index` to `index + 2`."""
        while len(self._values) < index + 3:
            self._values.extend(self._generator.standard_normal(_BLOCK).tolist())
        return self._values[index : index + 3]


def check_duration(value: float, name: str) -> None:
    """Check the duration of a step.

    Raises:
        InvalidValue: If the duration is not finite and > 0.
    """
    if not finite_number(value, name) > 0.0:
        raise InvalidValue(f"{name}: must be finite and > 0 s, got {value}")


def check_not_negative(settings: object, name: str, keys: Iterable[str]) -> None:
    """Convert attributes of frozen settings to float and check them.

    Raises:
        InvalidValue: If an attribute is negative or not finite.
    """
    for key in keys:
        value = finite_number(getattr(settings, key), f"{name}.{key}")
        object.__setattr__(settings, key, value)
        if value < 0.0:
            raise InvalidValue(f"{name}.{key}: must be finite and >= 0, got {value}")


def check_seed(value: object, name: str) -> None:
    """Check the seed of a random generator.

    Raises:
        InvalidValue: If the seed is not a whole number >= 0.
    """
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise InvalidValue(f"{name}: must be a whole number >= 0, got {value!r}")
