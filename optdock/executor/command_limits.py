"""The one place through which every command goes: no speed, acceleration or jerk beyond the limits, whatever asks.

Speed follows its target as fast as acceleration and jerk allow and without passing it [Kroeger2010]: with the error e
and an acceleration a relative to the target, a may be as large as it can still be taken back by the largest jerk before
e is gone, a^2 / (2 J) <= e. The target's own acceleration is taken from its last values, so that a target that keeps
the limits itself is followed closely.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from optdock.geometry.pose import Twist2
from optdock.robot import admissible

if TYPE_CHECKING:
    from optdock.robot import Robot

__all__ = ["CommandLimiter"]


class CommandLimiter:
    """Keeps what was commanded last, and lets the next command differ from it by no more than the limits allow.

    Yaw rate keeps the target's curvature where the speed cannot follow; its acceleration is limited where the robot
    says so.

    Args:
        robot: Limits and drive.

    Attributes:
        last: The last command.
        acceleration: With which the speed came there [m/s^2].
    """

    def __init__(self, robot: Robot) -> None:
        self._limits, self._drive = robot.limits, robot.drive
        self.last, self.acceleration = Twist2(), 0.0
        self._target, self._slope = 0.0, 0.0

    @property
    def at_rest(self) -> bool:
        """Whether the robot is commanded to stand still."""
        return self.last.linear == 0.0 and self.last.angular == 0.0

    def restart(self, moving: Twist2) -> None:
        """Begin from a robot that moves already."""
        self.last, self.acceleration = moving, 0.0
        self._target, self._slope = moving.linear, 0.0

    def towards(self, target: Twist2, period: float) -> Twist2:
        """The next command.

        Args:
            target: Wanted.
            period: Since the last command [s]; 0 repeats it.
        """
        if period <= 0.0:
            return self.last
        wanted = admissible(target, self._limits, self._drive)
        self._follow(wanted.linear, period)
        speed = self._speed(wanted.linear, self._slope, period)
        turn = wanted.angular
        if abs(wanted.linear) > _CREEP and speed * wanted.linear > 0.0:
            turn *= speed / wanted.linear
        return self._sent(speed, turn, period)

    def brake(self, period: float) -> Twist2:
        """The next command of a stop along the present curve."""
        if period <= 0.0:
            return self.last
        v, w = self.last.linear, self.last.angular
        self._target = self._slope = 0.0
        speed = self._speed(0.0, 0.0, period)
        turn = w * speed / v if abs(v) > _CREEP else 0.0
        return self._sent(speed, turn, period)

    def _follow(self, target: float, period: float) -> None:
        """Learn how fast the target changes; what it jumps by is no acceleration."""
        limits = self._limits
        steepest = max(limits.max_acceleration, limits.max_deceleration)
        self._slope = min(max((target - self._target) / period, -steepest), steepest)
        self._target = target

    def _speed(self, target: float, slope: float, period: float) -> float:
        limits, v, a = self._limits, self.last.linear, self.acceleration
        if v * target < 0.0:  # through rest, without an acceleration that the other gear would not allow
            target = slope = 0.0
        step = limits.max_jerk * period
        lowest, highest = -limits.max_deceleration, limits.max_acceleration
        if v < 0.0 or (v == 0.0 and target < 0.0):
            lowest, highest = -limits.max_acceleration, limits.max_deceleration
        slope = min(max(slope, lowest), highest)
        gap = target - v - slope * period
        reach = limits.max_jerk * (math.sqrt(0.25 * period * period + 2.0 * abs(gap) / limits.max_jerk) - 0.5 * period)
        wanted = slope + math.copysign(min(abs(gap) / period, reach), gap)
        # Up to the speed limit the rise must end in time, also where it takes no whole number of periods.
        spare = (limits.max_speed if v + a * period >= 0.0 else limits.max_reverse_speed) - abs(v)
        rise = limits.max_jerk * (math.sqrt(max(0.0, 2.0 * spare / limits.max_jerk)) - 0.5 * period)
        if v >= 0.0:
            highest = min(highest, max(0.0, rise))
        else:
            lowest = max(lowest, min(0.0, -rise))
        chosen = min(max(wanted, lowest), highest)
        chosen = min(max(chosen, a - step), a + step)
        speed = v + period * chosen
        if abs(speed) < _STILL and abs(target) < _STILL:
            return 0.0
        return speed

    def _sent(self, speed: float, turn: float, period: float) -> Twist2:
        step, last = self._limits.max_yaw_acceleration * period, self.last
        turn = min(max(turn, last.angular - step), last.angular + step)
        self.acceleration = (speed - last.linear) / period
        self.last = Twist2(speed, turn)
        return self.last


_CREEP = 0.01  # [m/s]: slower than this a curvature says nothing
_STILL = 1e-9  # [m/s]
