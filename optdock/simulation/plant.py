"""The plant: a differential drive that follows velocity commands late, sluggishly and within its limits."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, NamedTuple

from optdock.errors import InvalidValue
from optdock.geometry.pose import Twist2
from optdock.robot import admissible

if TYPE_CHECKING:
    from optdock.geometry.pose import Pose2
    from optdock.robot import Robot

__all__ = ["Actuation", "DifferentialDrive", "PlantState"]

_LONGEST_LATENCY = 10.0  # [s]; every sub-step of it is held in memory


@dataclass(frozen=True)
class Actuation:
    """How commands become motion; the default is perfect.

    Args:
        linear_lag: Time constant of the first-order lag on the speed [s]; 0 follows at once.
        angular_lag: Time constant of the first-order lag on the yaw rate [s].
        latency: Delay between a command and its first effect [s]; a multiple of the sub-step.
        linear_dead_band: Commanded speeds smaller than this do nothing [m/s].
        angular_dead_band: Commanded yaw rates smaller than this do nothing [rad/s].
        linear_gain: Speed that the wheels make of a commanded 1 m/s (wear, wrong wheel radius) [1].
        angular_gain: Yaw rate that they make of a commanded 1 rad/s (wrong track width) [1].
        substeps: Sub-steps per control period.

    Raises:
        InvalidValue: A value is negative or not finite, the latency over 10 s, or substeps < 1.
    """

    linear_lag: float = 0.0
    angular_lag: float = 0.0
    latency: float = 0.0
    linear_dead_band: float = 0.0
    angular_dead_band: float = 0.0
    linear_gain: float = 1.0
    angular_gain: float = 1.0
    substeps: int = 4

    def __post_init__(self) -> None:
        for spec in fields(self):
            value = getattr(self, spec.name)
            if not (math.isfinite(value) and value >= 0.0):
                raise InvalidValue(f"actuation.{spec.name}: must be finite and >= 0, got {value}")
        if self.latency > _LONGEST_LATENCY:
            raise InvalidValue(f"actuation.latency: must be <= {_LONGEST_LATENCY} s, got {self.latency}")
        if self.substeps < 1:
            raise InvalidValue(f"actuation.substeps: must be >= 1, got {self.substeps}")


class PlantState(NamedTuple):
    """Pose, body velocity, and the commands of the coming sub-steps that are already under way."""

    pose: Pose2
    twist: Twist2
    pending: tuple[Twist2, ...]


@dataclass(frozen=True, eq=False)
class DifferentialDrive:
    """A robot that turns commands into motion, one control period at a time.

    Each sub-step follows the arc of its mean velocity: exact while the velocity is constant, so exact for every step
    without lag. Accelerations are not limited here: that is the controller's duty.

    Args:
        robot: Whose drive limits cut every command.
        actuation: Lags, latency, dead band and gains.
        period: Control period [s].

    Raises:
        InvalidValue: The period is not > 0, or the latency is not a multiple of period / substeps.
    """

    robot: Robot
    actuation: Actuation = field(default_factory=Actuation)
    period: float = 0.02

    def __post_init__(self) -> None:
        if not (math.isfinite(self.period) and self.period > 0.0):
            raise InvalidValue(f"plant.period: must be finite and > 0 s, got {self.period}")
        steps = self.actuation.latency / self._step
        if abs(steps - round(steps)) > 1e-6:
            raise InvalidValue(
                f"actuation.latency: must be a multiple of the sub-step {self._step} s, got {self.actuation.latency}"
            )

    @property
    def _step(self) -> float:
        return self.period / self.actuation.substeps

    def at_rest(self, pose: Pose2) -> PlantState:
        """The robot standing at `pose`, no command under way."""
        return self.moving(pose, Twist2())

    def moving(self, pose: Pose2, twist: Twist2) -> PlantState:
        """The robot at `pose` with a steady body velocity, which the commands under way keep up."""
        return PlantState(pose, twist, (twist,) * round(self.actuation.latency / self._step))

    def step(self, state: PlantState, command: Twist2) -> PlantState:
        """The state one control period later, `command` being given now."""
        wanted = self._effective(admissible(command, self.robot.limits, self.robot.drive))
        pose, twist = state.pose, state.twist
        queue = state.pending + (wanted,) * self.actuation.substeps
        for target in queue[: self.actuation.substeps]:
            mean, twist = self._follow(twist, target)
            pose = pose.moved(mean, self._step)
        return PlantState(pose, twist, queue[self.actuation.substeps :])

    def _effective(self, command: Twist2) -> Twist2:
        a = self.actuation
        linear = command.linear if abs(command.linear) >= a.linear_dead_band else 0.0
        angular = command.angular if abs(command.angular) >= a.angular_dead_band else 0.0
        return Twist2(a.linear_gain * linear, a.angular_gain * angular)

    def _follow(self, twist: Twist2, target: Twist2) -> tuple[Twist2, Twist2]:
        """Mean velocity of the sub-step and velocity after it."""
        v_mean, v = _first_order(twist.linear, target.linear, self.actuation.linear_lag, self._step)
        w_mean, w = _first_order(twist.angular, target.angular, self.actuation.angular_lag, self._step)
        return Twist2(v_mean, w_mean), Twist2(v, w)


def _first_order(value: float, target: float, lag: float, step: float) -> tuple[float, float]:
    """Exact mean and final value of `lag * x' = target - x` over a step."""
    if lag <= 0.0:
        return target, target
    decay = math.exp(-step / lag)
    gap = value - target
    return target + gap * (1.0 - decay) * lag / step, target + gap * decay
