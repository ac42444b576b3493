"""Commands within the limits: what the drive can follow from the command before, jerk included.

The speed is a second-order limiter. Where the wanted command can be reached it is given as it is, so a feed-forward
within the limits passes without any lag; else the acceleration rises and falls by no more than the jerk, and falls
early enough that the speed ends on what is wanted without going beyond: in the frame of the feed-forward, over a
difference d, at a relative acceleration of at most sqrt(2 jerk d).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from optdock.geometry.pose import Twist2
from optdock.robot import Drive, admissible

if TYPE_CHECKING:
    from optdock.limits import MotionLimits

__all__ = ["CommandLimiter", "rate_limited", "smooth_slope"]

_NO_ARC = 1e-9  # [m/s]: a slower command has no curvature
_ROUNDING = 1e-15  # [m/s]: of a command that is to be the wanted one; a robot at rest is commanded nothing at all
_CREEPING = 0.005  # [m/s]: a slower command says too little of the angle of steered wheels
_SAME_ARC = 1.5  # times as fast as wanted: beyond, the wanted speed was feedback, whose arc means nothing


class CommandLimiter:
    """Remembers the last command, and gives the next one that it can become.

    Attributes:
        command: The last one.
    """

    def __init__(self) -> None:
        self.restart(Twist2())

    def restart(self, command: Twist2) -> None:
        """Begin at what the robot does, at a steady speed."""
        self.command = command
        self._acceleration = 0.0
        self._period = 0.0
        self._feed_forward: float | None = None
        moving = abs(command.linear) >= _CREEPING
        self._curvature = command.angular / command.linear if moving else None

    def stop(self) -> None:
        """Begin again from rest: what a refusal leaves the robot with. An emergency stop keeps no jerk limit."""
        self.restart(Twist2())

    def follow(
        self,
        wanted: Twist2,
        feed_forward: Twist2,
        period: float,
        limits: MotionLimits,
        drive: Drive,
        *,
        in_place: bool,
    ) -> Twist2:
        """The command nearest to `wanted` that the last one can become.

        Speed, yaw rate, wheel speed, lateral acceleration, acceleration and jerk, yaw acceleration, curvature, and how
        fast steered wheels turn, are within the limits. At rest a command of almost no speed tells steered wheels where
        to turn.

        Args:
            wanted: Feed-forward and feedback.
            feed_forward: The part of it that moves; how fast it changes is what the command converges to.
            period: Since the last command [s], > 0.
            limits: Of the robot.
            drive: How it steers.
            in_place: Whether a differential drive may turn tighter than its smallest radius: where its reference turns
                in place, or stands at its end.
        """
        free = in_place and drive is Drive.DIFFERENTIAL
        wanted = admissible(wanted if free else _bent(wanted, limits.max_curvature), limits, drive)
        linear = self._linear(wanted.linear, feed_forward.linear, period, limits)
        if drive is Drive.ACKERMANN:
            angular = self._steered(wanted, linear, period, limits) * linear
        else:
            angular = wanted.angular if free else _on_its_arc(wanted, linear, limits.max_curvature)
        turn = (limits.turning.acceleration if linear == 0.0 else limits.max_yaw_acceleration) * period
        angular = _approach(self.command.angular, angular, turn, turn)
        most = _most_turn(linear, limits)  # the turn gives way: the speed falls as fast as it may
        command = Twist2(linear, min(max(angular, -most), most))
        if self._feed_forward is not None:
            self._acceleration, self._period = (command.linear - self.command.linear) / period, period
        self._feed_forward, self.command = feed_forward.linear, command
        if abs(command.linear) >= _CREEPING:
            self._curvature = command.angular / command.linear
        return command

    def _linear(self, wanted: float, feed_forward: float, period: float, limits: MotionLimits) -> float:
        before = self.command.linear
        if self._feed_forward is None:
            return before  # how long it has been in force nobody knows
        slope = (feed_forward - self._feed_forward) / period
        between = 0.5 * (period + (self._period or period))  # accelerations are those in the middle of their periods
        missing = wanted - slope * period - before
        top, bottom = (
            min(limits.max_speed, limits.max_wheel_speed),
            min(limits.max_reverse_speed, limits.max_wheel_speed),
        )
        up, down = (_fastest(max(gap, 0.0), limits.max_jerk, period) for gap in (top - before, before + bottom))
        slope = smooth_slope(missing, slope, self._acceleration, limits.max_jerk, (period, between))
        slope = min(max(slope, -down, (-bottom - before) / period), up, (top - before) / period)
        # Through rest the deceleration becomes an acceleration: by then it must have come down to that one's limit.
        soon = max(abs(before) - limits.max_deceleration * period, 0.0)
        through = math.sqrt(limits.max_acceleration**2 + 2.0 * limits.max_jerk * soon)
        through = max(through, abs(self._acceleration) - limits.max_jerk * between)
        fall = min(limits.max_deceleration, through)
        linear = _approach(before, before + slope * period, limits.max_acceleration * period, fall * period)
        return wanted if abs(linear - wanted) <= _ROUNDING else linear

    def _steered(self, wanted: Twist2, linear: float, period: float, limits: MotionLimits) -> float:
        """The curvature of steered wheels."""
        before = self._curvature
        asked = wanted.angular / wanted.linear if abs(wanted.linear) > _NO_ARC else before or 0.0
        if before is None:
            return asked
        if math.isfinite(limits.max_steering_rate):
            angle, turned = math.atan(limits.wheelbase * before), limits.max_steering_rate * period
            angle = min(max(math.atan(limits.wheelbase * asked), angle - turned), angle + turned)
            asked = math.tan(angle) / limits.wheelbase
        if abs(linear) < _CREEPING:
            self._curvature = asked  # the wheels turn at rest too
        return asked


def smooth_slope(missing: float, target_slope: float, slope: float, jerk: float, periods: tuple[float, float]) -> float:
    """The slope of the next period, of a value that is to reach a moving target and stay with it.

    Args:
        missing: By how much the value falls short of the target before the period.
        target_slope: Of the target.
        slope: Of the value in the period before.
        jerk: By how much a slope may change in a unit of time.
        periods: The period, and the time between its middle and that of the one before [s].
    """
    period, between = periods
    gap = abs(missing)
    wanted = target_slope + math.copysign(min(gap / period, _fastest(gap, jerk, period)), missing)
    return min(max(wanted, slope - jerk * between), slope + jerk * between)


def _fastest(gap: float, jerk: float, period: float) -> float:
    """The largest slope that can still fall to nothing within `gap`, by at most `jerk` times `period` every period.

    In units of that step: slopes n + f, n - 1 + f, ..., f cover (n + 1) (n / 2 + f) units of jerk * period^2.
    """
    step = jerk * period
    units = gap / (step * period)
    n = math.floor(0.5 * (math.sqrt(1.0 + 8.0 * units) - 1.0))
    return step * (0.5 * n + units / (n + 1))


def rate_limited(previous: Twist2, wanted: Twist2, limits: MotionLimits, period: float) -> Twist2:
    """The command nearest to `wanted` that `previous` can become within `period` [s], whatever the jerk.

    Speeding up is bounded by max_acceleration, slowing down by max_deceleration, in either gear.
    """
    linear = _approach(
        previous.linear, wanted.linear, limits.max_acceleration * period, limits.max_deceleration * period
    )
    turn = limits.max_yaw_acceleration * period
    angular = _approach(previous.angular, wanted.angular, turn, turn)
    return Twist2(linear, angular)


def _approach(value: float, target: float, rise: float, fall: float) -> float:
    """`value` moved towards `target`: away from zero by at most `rise`, towards zero by at most `fall`."""
    if value * target < 0.0:
        if abs(value) >= fall:
            return value - math.copysign(fall, value)
        left = 1.0 - abs(value) / fall if math.isfinite(fall) else 1.0
        return _approach(0.0, target, rise * left, fall)
    bound = rise if abs(target) > abs(value) else fall
    return value + min(max(target - value, -bound), bound)


def _on_its_arc(wanted: Twist2, linear: float, curvature: float) -> float:
    """The yaw rate at the speed `linear` that keeps the arc of `wanted`, where the speeds are much the same."""
    share = linear / wanted.linear if wanted.linear != 0.0 else 1.0
    return _bent(Twist2(linear, wanted.angular * (share if 0.0 <= share <= _SAME_ARC else 1.0)), curvature).angular


def _bent(command: Twist2, curvature: float) -> Twist2:
    """The command, turning no tighter than `curvature`."""
    most = curvature * abs(command.linear) if command.linear != 0.0 else 0.0
    return Twist2(command.linear, min(max(command.angular, -most), most))


def _most_turn(linear: float, limits: MotionLimits) -> float:
    """The largest yaw rate at this speed."""
    speed = abs(linear)
    rim = (limits.max_wheel_speed - speed) / (0.5 * limits.track_width) if limits.track_width > 0.0 else math.inf
    lateral = limits.max_lateral_acceleration / speed if speed > 0.0 else math.inf
    return max(0.0, min(limits.max_yaw_rate, rim, lateral))
