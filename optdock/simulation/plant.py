"""The plant: a differential drive that follows velocity commands late, sluggishly and on wheels that are not perfect.

Between the arrivals of commands the target is constant, and the lag's answer to it is exact; so a step may be as long
or as short as a server makes it. On the way: limits of the robot, dead band and gains, latency, wheels (gain, dead
band, saturation), lag, a stuck wheel, slip.
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

_LONGEST_LATENCY = 10.0  # [s]; every command of it is held in memory
_INSTANT = 1e-9  # [s]: commands that arrive this close together arrive at once
_BLOCK = 512  # random numbers drawn in one go: NumPy's call costs as much as a hundred of them
_Target = tuple[float, float]


@dataclass(frozen=True)
class Actuation:
    """How commands become motion; the default is perfect.

    Args:
        linear_lag: Time constant of the first-order lag on the speed [s]; 0 follows at once.
        angular_lag: Time constant of the first-order lag on the yaw rate [s].
        latency: Delay between a command and its first effect [s].
        linear_dead_band: Commanded speeds smaller than this do nothing [m/s].
        angular_dead_band: Commanded yaw rates smaller than this do nothing [rad/s].
        linear_gain: Speed that the drive makes of a commanded 1 m/s [1].
        angular_gain: Yaw rate that it makes of a commanded 1 rad/s [1].
        longest_substep: While the velocity changes a step is integrated in pieces of at most this [s].

    Raises:
        InvalidValue: A value is not a number, negative or not finite, the latency over 10 s, or the sub-step 0.
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
        """Speed and yaw rate that the drive makes of a command in the end, dead band and gains looked at."""
        linear = self.linear_gain * command.linear if abs(command.linear) >= self.linear_dead_band else 0.0
        angular = self.angular_gain * command.angular if abs(command.angular) >= self.angular_dead_band else 0.0
        return linear, angular


class Wheel(str, Enum):
    """One of the two driven wheels."""

    LEFT = "left"
    RIGHT = "right"


@dataclass(frozen=True)
class StuckWheel:
    """A wheel that stands still for a while, whatever is commanded: a fault.

    Args:
        wheel: Which, a `Wheel` or its word.
        start: On the plant's clock, which is 0 when the robot is set down [s].
        end: When it is free again [s].

    Raises:
        InvalidValue: No such wheel, or not start < end.
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
    """Two driven wheels and what is wrong with them. Speeds are of the rim [m/s].

    The base turns a command into wheel speeds by the radius and the track width that it believes in.

    Args:
        track_width: That the base believes in [m].
        left_gain: True radius of the left wheel over the believed one [1].
        right_gain: Likewise of the right wheel.
        track_gain: True track width over the believed one [1].
        left_dead_band: Speeds smaller than this do nothing on the left.
        right_dead_band: Likewise on the right.
        max_speed: Faster than this a wheel does not turn; it is cut by itself, so that the curvature changes.
        stuck: Faults.

    Raises:
        InvalidValue: A value is not a number, negative or not finite; a width, a gain or the largest speed is 0.
    """

    track_width: float
    left_gain: float = 1.0
    right_gain: float = 1.0
    track_gain: float = 1.0
    left_dead_band: float = 0.0
    right_dead_band: float = 0.0
    max_speed: float = math.inf
    stuck: tuple[StuckWheel, ...] = ()

    def __post_init__(self) -> None:
        check_not_negative(self, "wheels", ("left_dead_band", "right_dead_band"))
        for name in ("track_width", "left_gain", "right_gain", "track_gain", "max_speed"):
            value = number(getattr(self, name), f"wheels.{name}")
            object.__setattr__(self, name, value)
            if not (value > 0.0 and (math.isfinite(value) or name == "max_speed")):
                raise InvalidValue(f"wheels.{name}: must be finite and > 0, got {value}")
        object.__setattr__(self, "stuck", tuple(self.stuck))

    @property
    def true_width(self) -> float:
        """Track width on the floor [m]."""
        return self.track_width * self.track_gain

    def target(self, linear: float, angular: float) -> _Target:
        """Speed and yaw rate that the wheels make of the commanded ones."""
        turn = 0.5 * self.track_width * angular
        left = self._rim(linear - turn, self.left_gain, self.left_dead_band)
        right = self._rim(linear + turn, self.right_gain, self.right_dead_band)
        return 0.5 * (left + right), (right - left) / self.true_width

    def _rim(self, speed: float, gain: float, dead_band: float) -> float:
        if abs(speed) < dead_band:
            return 0.0
        return min(max(gain * speed, -self.max_speed), self.max_speed)

    def held(self, linear: float, angular: float, time: float) -> _Target:
        """The same velocity where no wheel is stuck, else what the other one makes alone."""
        for fault in self.stuck:
            if fault.start - _INSTANT <= time < fault.end - _INSTANT:
                turn = 0.5 * self.true_width * angular
                left, right = linear - turn, linear + turn
                left, right = (0.0, right) if fault.wheel is Wheel.LEFT else (left, 0.0)
                linear, angular = 0.5 * (left + right), (right - left) / self.true_width
        return linear, angular

    def encoders(self, linear: float, angular: float) -> Twist2:
        """The body velocity that the wheels' encoders tell a base which believes in its radii and track width."""
        turn = 0.5 * self.true_width * angular
        left, right = (linear - turn) / self.left_gain, (linear + turn) / self.right_gain
        return Twist2(0.5 * (left + right), (right - left) / self.track_width)


@dataclass(frozen=True)
class Slip:
    """What the floor takes from the wheels, unseen by encoders; its noise is seeded.

    The noises are first-order Gauss-Markov: standard deviation sigma, forgotten with the time constant.

    Args:
        lost: Share of speed and yaw rate that is lost [1].
        drift: Leftward speed per speed, as on a slope across the way [1].
        turn: Leftward yaw rate per speed [rad/m].
        lost_sigma: Of the share lost [1].
        drift_sigma: Of the drift [1].
        turn_sigma: Of the turn [rad/m].
        correlation_time: [s].
        seed: Of the noise; equal seeds give equal floors.

    Raises:
        InvalidValue: A value is not a finite number, a sigma negative, the share lost not in [0, 1], or the time or the
            seed not > 0.
    """

    lost: float = 0.0
    drift: float = 0.0
    turn: float = 0.0
    lost_sigma: float = 0.0
    drift_sigma: float = 0.0
    turn_sigma: float = 0.0
    correlation_time: float = 0.3
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("lost", "drift", "turn"):
            object.__setattr__(self, name, finite_number(getattr(self, name), f"slip.{name}"))
        check_not_negative(self, "slip", ("lost_sigma", "drift_sigma", "turn_sigma", "correlation_time"))
        if not 0.0 <= self.lost <= 1.0:
            raise InvalidValue(f"slip.lost: must be a share from 0 to 1, got {self.lost}")
        if self.correlation_time == 0.0:
            raise InvalidValue("slip.correlation_time: must be > 0 s, got 0.0")
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
        """The three standardized noises `duration` [s] later, and how many random numbers are then drawn."""
        if not self._noisy:
            return noise, drawn
        keep = math.exp(-duration / self.correlation_time)
        fresh = math.sqrt(1.0 - keep * keep)
        a, b, c = self._drawn.three(drawn)
        return (keep * noise[0] + fresh * a, keep * noise[1] + fresh * b, keep * noise[2] + fresh * c), drawn + 3

    def ground(self, linear: float, angular: float, noise: tuple[float, float, float]) -> tuple[float, float, float]:
        """Body velocity on the floor (linear, angular, lateral) of that which the wheels make."""
        kept = 1.0 - min(max(self.lost + self.lost_sigma * noise[0], 0.0), 1.0)
        drift = self.drift + self.drift_sigma * noise[1]
        turn = self.turn + self.turn_sigma * noise[2]
        return kept * linear, kept * angular + turn * linear, drift * linear


class PlantState(NamedTuple):
    """All that a plant needs to go on.

    Attributes:
        pose: True.
        twist: True body velocity.
        encoders: Body velocity that encoders (and the steering's sensor) tell; wheel errors and slip are not in it.
        time: Since the robot was set down [s].
        drive: What the actuators do now, a stuck wheel apart: speed [m/s] and yaw rate [rad/s], or steering angle [rad]
            of a car.
        target: What they were told to do.
        pending: Targets under way, each with the time at which it arrives.
        noise: Of the slip, standardized.
        drawn: Random numbers used up.
        contact: Whether robot and station touch; None where the plant knows of no station.
        physics: What a plant that has more inside goes on from, such as `MujocoPhysics`.
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
    """What drives in a simulation; `step` may be called with any duration, another one each time."""

    @property
    def robot(self) -> Robot:
        """What drives."""

    def moving(self, pose: Pose2, twist: Twist2) -> PlantState:
        """The robot at `pose` with a steady body velocity."""

    def step(self, state: PlantState, command: Twist2, duration: float | None = None) -> PlantState:
        """The state `duration` [s] later, `command` being given now."""

    def stopped(self, state: PlantState, pose: Pose2, *, stalled: bool) -> PlantState:
        """The state after something hard held the robot at `pose`; `stalled`: its wheels stand still too."""


@dataclass(frozen=True, eq=False)
class DifferentialDrive:
    """A robot on two driven wheels that turns velocity commands into motion.

    A step is cut where commands arrive. Between them it follows the arc of its mean velocity, in sub-steps where there
    is lag: exact while the velocity is constant, so exact for every step without lag. Accelerations are not limited
    here: that is the controller's duty. `step` is a function: equal states and commands give equal states.

    Args:
        robot: Whose drive limits cut every command.
        actuation: Lags, latency, dead band and gains.
        period: Duration of a step that does not say its own [s].
        wheels: Their errors and faults; None: none.
        slip: On the floor.

    Raises:
        InvalidValue: The period is not > 0.
    """

    robot: Robot
    actuation: Actuation = field(default_factory=Actuation)
    period: float = 0.02
    wheels: Wheels | None = None
    slip: Slip = field(default_factory=Slip)

    def __post_init__(self) -> None:
        check_duration(self.period, "plant.period")

    def at_rest(self, pose: Pose2) -> PlantState:
        """The robot standing at `pose`, no command under way."""
        return self.moving(pose, Twist2())

    def moving(self, pose: Pose2, twist: Twist2) -> PlantState:
        """The robot at `pose` with a steady body velocity, which goes on until the first command arrives."""
        drive = (twist.linear, twist.angular)
        return PlantState(pose, twist, self._encoders(drive), 0.0, drive, drive)

    def step(self, state: PlantState, command: Twist2, duration: float | None = None) -> PlantState:
        """The state `duration` [s] later, or one period later, `command` being given now.

        Raises:
            InvalidValue: The duration is not finite and > 0.
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
        """The state after something hard held the robot at `pose`; `stalled`: its wheels stand still too."""
        drive = (0.0, 0.0) if stalled else state.drive
        return state._replace(pose=pose, twist=Twist2(), encoders=self._encoders(drive), drive=drive)

    def _target(self, command: Twist2) -> _Target:
        target = self.actuation.target(admissible(command, self.robot.limits, self.robot.drive))
        return target if self.wheels is None else self.wheels.target(*target)

    def _substeps(self, seconds: float, drive: _Target, wanted: _Target) -> int:
        """One where the velocity is constant: no lag, or nothing to follow."""
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
    """The targets of a step, each with the seconds that it acts; the last of them; and what is then under way.

    Args:
        state: At the beginning of the step.
        latency: After which what is sent arrives [s].
        sent: The target sent now.
        duration: Of the step [s].
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
    """Exact mean and final value of `lag * x' = target - x` over a step."""
    if lag <= 0.0:
        return target, target
    gap, decayed = value - target, -math.expm1(-step / lag)
    return target + gap * decayed * lag / step, value - gap * decayed


def pieces_of(seconds: float, longest: float) -> int:
    """How many equal pieces of at most `longest` [s] make up `seconds`."""
    return max(1, math.ceil(seconds / longest - 1e-6))


class _Normals:
    """Standard normal numbers by index: equal seeds give equal numbers, in whatever order they are asked for."""

    def __init__(self, seed: int) -> None:
        self._generator = np.random.default_rng(seed)
        self._values: list[float] = []

    def three(self, index: int) -> list[float]:
        """Those at `index` and the two after it."""
        while len(self._values) < index + 3:
            self._values.extend(self._generator.standard_normal(_BLOCK).tolist())
        return self._values[index : index + 3]


def check_duration(value: float, name: str) -> None:
    """Refuse what is not a duration.

    Raises:
        InvalidValue: Not finite and > 0.
    """
    if not finite_number(value, name) > 0.0:
        raise InvalidValue(f"{name}: must be finite and > 0 s, got {value}")


def check_not_negative(settings: object, name: str, keys: Iterable[str]) -> None:
    """Make these attributes of frozen settings floats, and refuse what is negative or not finite.

    Raises:
        InvalidValue: One of them is.
    """
    for key in keys:
        value = finite_number(getattr(settings, key), f"{name}.{key}")
        object.__setattr__(settings, key, value)
        if value < 0.0:
            raise InvalidValue(f"{name}.{key}: must be finite and >= 0, got {value}")


def check_seed(value: object, name: str) -> None:
    """Refuse what seeds nothing.

    Raises:
        InvalidValue: No whole number >= 0.
    """
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise InvalidValue(f"{name}: must be a whole number >= 0, got {value!r}")
