"""Bicycle model [DeLuca2001] of a car driven by velocity commands, and selection of a plant by the robot's drive.

The robot's origin is the middle of the rear axle; the yaw rate is speed / wheelbase * tan(steering angle). A command
requests the curvature angular / linear, and therefore the steering angle atan(wheelbase * curvature).

A command with zero speed has no curvature. For such a command most base controllers, such as the steering controllers
of ros2_control and the converter of teb_local_planner, steer straight, which is also the default of this model; other
controllers hold the last angle. To steer the wheels of a car at rest, command the required ratio at a speed that has no
effect, such as a speed within the dead band or 1e-6 m/s.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import TYPE_CHECKING

from optdock.errors import InvalidValue
from optdock.geometry.checked import finite_number, member
from optdock.geometry.pose import Pose2, Twist2, arc_end
from optdock.model.robot import Drive, admissible
from optdock.simulation.plant import (
    Actuation,
    DifferentialDrive,
    PlantState,
    Slip,
    arrivals,
    check_duration,
    check_not_negative,
    first_order,
    pieces_of,
)

if TYPE_CHECKING:
    from optdock.model.robot import Robot
    from optdock.simulation.plant import Plant

__all__ = ["Bicycle", "Steering", "SteeringAtRest", "plant_of"]


class SteeringAtRest(str, Enum):
    """Behaviour of the steering at a commanded speed of 0."""

    STRAIGHTEN = "straighten"
    HOLD = "hold"


@dataclass(frozen=True)
class Steering:
    """Response of the front wheels to steering commands; by default, only the limits of the robot apply.

    Args:
        lag: Time constant of the first-order lag [s], in addition to the limit of the steering rate.
        play: Errors of the angle below this value are not corrected [rad].
        gain: Ratio of the true angle to the measured angle [1].
        offset: True angle at a measured angle of 0 [rad].
        at_rest: A `SteeringAtRest` or its value.
        start: Measured angle at the beginning, at rest [rad].

    Raises:
        InvalidValue: If a value is not a number or is not finite, the lag or the play is negative, the gain is not > 0,
            or `at_rest` is unknown.
    """

    lag: float = 0.0
    play: float = 0.0
    gain: float = 1.0
    offset: float = 0.0
    at_rest: SteeringAtRest = SteeringAtRest.STRAIGHTEN
    start: float = 0.0

    def __post_init__(self) -> None:
        check_not_negative(self, "steering", ("lag", "play", "gain"))
        for name in ("offset", "start"):
            object.__setattr__(self, name, finite_number(getattr(self, name), f"steering.{name}"))
        object.__setattr__(self, "at_rest", member(SteeringAtRest, self.at_rest, "steering.at_rest"))
        if self.gain == 0.0:
            raise InvalidValue("steering.gain: must be > 0, got 0.0")


@dataclass(frozen=True, eq=False)
class Bicycle:
    """Plant model of a car; `PlantState.drive` contains the speed and the measured steering angle.

    The result is exact on circles. While speed or angle change, each sub-step follows the arc of its mean speed and yaw
    rate.

    Args:
        robot: Robot with drive ackermann and a wheelbase; its limits apply to speed, curvature and steering.
        actuation: Response of the speed; its angular values must be the defaults.
        period: Default duration of a step [s].
        steering: Response of the front wheels.
        slip: Slip.

    Raises:
        InvalidValue: If the robot has a different drive or no wheelbase, there is an angular lag, dead band or gain, or
            the period is not > 0.
    """

    robot: Robot
    actuation: Actuation = field(default_factory=Actuation)
    period: float = 0.02
    steering: Steering = field(default_factory=Steering)
    slip: Slip = field(default_factory=Slip)

    def __post_init__(self) -> None:
        check_duration(self.period, "plant.period")
        if self.robot.drive is not Drive.ACKERMANN:
            raise InvalidValue(f"plant.robot.drive: must be ackermann for a car, got {self.robot.drive.value}")
        if not self.robot.limits.wheelbase > 0.0:
            raise InvalidValue("plant.robot.limits.wheelbase: must be > 0 m for a car, got 0.0")
        perfect = Actuation()
        for name in ("angular_lag", "angular_dead_band", "angular_gain"):
            if getattr(self.actuation, name) != getattr(perfect, name):
                raise InvalidValue(
                    f"actuation.{name}: must be the default for a car; set lag, play, gain of its steering"
                )

    def at_rest(self, pose: Pose2) -> PlantState:
        """Return the state at rest at a pose, with the wheels at `Steering.start`."""
        return self.moving(pose, Twist2())

    def moving(self, pose: Pose2, twist: Twist2) -> PlantState:
        """Return the state at a pose with a steady body velocity, kept until the first command arrives."""
        if twist.linear != 0.0:
            true = math.atan(self.robot.limits.wheelbase * twist.angular / twist.linear)
        else:
            true = self._true(self.steering.start)
        drive = (twist.linear, (true - self.steering.offset) / self.steering.gain)
        actual = Twist2(twist.linear, self._yaw_rate(twist.linear, true))
        return PlantState(pose, actual, self._encoders(drive), 0.0, drive, drive)

    def step(self, state: PlantState, command: Twist2, duration: float | None = None) -> PlantState:
        """Return the state after `duration` [s], or one period, with a command given at its beginning.

        Raises:
            InvalidValue: If the duration is not finite and > 0.
        """
        if duration is None:
            duration = self.period
        check_duration(duration, "plant.duration")
        noise, drawn = self.slip.after(state.noise, state.drawn, duration)
        sent = self._target(command, (state.pending[-1][1] if state.pending else state.target)[1])
        pieces, target, pending = arrivals(state, self.actuation.latency, sent, duration)
        pose, (v, angle) = (state.pose.x, state.pose.y, state.pose.yaw), state.drive
        for seconds, wanted in pieces:
            count = self._substeps(seconds, (v, angle), wanted)
            span = seconds / count
            for _ in range(count):
                v_mean, w_mean, v, angle = self._follow(v, angle, wanted, span)
                pose = arc_end(*pose, self.slip.ground(v_mean, w_mean, noise), span)
        twist = Twist2(*self.slip.ground(v, self._yaw_rate(v, self._true(angle)), noise))
        end, drive = state.time + duration, (v, angle)
        return PlantState(Pose2(*pose), twist, self._encoders(drive), end, drive, target, pending, noise, drawn)

    def stopped(self, state: PlantState, pose: Pose2, *, stalled: bool) -> PlantState:
        """Return the state after a stop at `pose` by a rigid obstacle; if `stalled`, the wheels also stop."""
        drive = (0.0, state.drive[1]) if stalled else state.drive
        return state._replace(pose=pose, twist=Twist2(), encoders=self._encoders(drive), drive=drive)

    def _target(self, command: Twist2, last_angle: float) -> tuple[float, float]:
        """Return the speed and the steering angle for a command."""
        limits = self.robot.limits
        cut = admissible(command, limits, self.robot.drive)
        speed, _ = self.actuation.target(cut)
        if cut.linear == 0.0:
            return speed, last_angle if self.steering.at_rest is SteeringAtRest.HOLD else 0.0
        angle = math.atan(limits.wheelbase * cut.angular / cut.linear)
        return speed, min(max(angle, -limits.max_steering_angle), limits.max_steering_angle)

    def _substeps(self, seconds: float, drive: tuple[float, float], wanted: tuple[float, float]) -> int:
        """Return the number of sub-steps, which is 1 while speed and angle are constant."""
        steady_speed = self.actuation.linear_lag == 0.0 or drive[0] == wanted[0]
        if steady_speed and (not self._gradual or self._aim(drive[1], wanted[1]) == drive[1]):
            return 1
        return pieces_of(seconds, self.actuation.longest_substep)

    def _follow(
        self, v: float, angle: float, wanted: tuple[float, float], span: float
    ) -> tuple[float, float, float, float]:
        """Return the mean speed and yaw rate of a sub-step by Simpson's rule, and the final speed and angle."""
        lag = self.actuation.linear_lag
        mean, end = first_order(v, wanted[0], lag, span)
        begin, middle = v if lag > 0.0 else end, first_order(v, wanted[0], lag, 0.5 * span)[1]
        half, whole = self._turned(angle, wanted[1], 0.5 * span), self._turned(angle, wanted[1], span)
        first = angle if self._gradual else whole
        rates = (
            self._yaw_rate(begin, self._true(first)),
            self._yaw_rate(middle, self._true(half)),
            self._yaw_rate(end, self._true(whole)),
        )
        return mean, (rates[0] + 4.0 * rates[1] + rates[2]) / 6.0, end, whole

    @property
    def _gradual(self) -> bool:
        return self.steering.lag > 0.0 or math.isfinite(self.robot.limits.max_steering_rate)

    def _aim(self, angle: float, wanted: float) -> float:
        """Return the final angle: the present angle, limited to the range of the play around the commanded angle."""
        return min(max(angle, wanted - self.steering.play), wanted + self.steering.play)

    def _turned(self, angle: float, wanted: float, span: float) -> float:
        """Return the angle after `span` [s]: first at the largest rate, then with exponential decay of the error."""
        rate, lag, aim = self.robot.limits.max_steering_rate, self.steering.lag, self._aim(angle, wanted)
        if math.isfinite(rate):
            too_far = abs(aim - angle) - rate * lag
            if too_far >= rate * span:
                return angle + math.copysign(rate * span, aim - angle)
            if too_far > 0.0:
                angle, span = angle + math.copysign(too_far, aim - angle), span - too_far / rate
        return aim if lag <= 0.0 else aim + (angle - aim) * math.exp(-span / lag)

    def _true(self, angle: float) -> float:
        return self.steering.gain * angle + self.steering.offset

    def _yaw_rate(self, speed: float, angle: float) -> float:
        return speed * math.tan(angle) / self.robot.limits.wheelbase

    def _encoders(self, drive: tuple[float, float]) -> Twist2:
        speed = drive[0]
        return Twist2(speed, self._yaw_rate(speed, drive[1]))


def plant_of(robot: Robot, actuation: Actuation | None = None, *, steering: Steering | None = None) -> Plant:
    """Return the plant of a robot: a `Bicycle` for a car, otherwise a `DifferentialDrive`.

    Args:
        robot: The robot; for a car without a wheelbase, the robot's length is used.
        actuation: Lags, latency, dead bands and gains; None: perfect. The angular lag of a car is the lag of its
            steering.
        steering: Steering of a car; None: perfect except for the angular lag.

    Raises:
        InvalidValue: If a car has an angular dead band or gain, or both an angular lag and a `steering`, or another
            robot has a `steering`.
    """
    actuation = actuation if actuation is not None else Actuation()
    if robot.drive is not Drive.ACKERMANN:
        if steering is not None:
            raise InvalidValue(
                f"steering: must be None unless the drive is ackermann; the drive is {robot.drive.value}"
            )
        return DifferentialDrive(robot, actuation)
    if steering is None:
        actuation, steering = replace(actuation, angular_lag=0.0), Steering(actuation.angular_lag)
    if robot.limits.wheelbase == 0.0:
        robot = replace(robot, limits=replace(robot.limits, wheelbase=robot.footprint.length))
    return Bicycle(robot, actuation, steering=steering)
