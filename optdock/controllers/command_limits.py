"""Limits on commands: the reachable command nearest to the desired command, within all limits up to the jerk.

The speed passes through a second-order limiter. The limiter does not change a reachable command, so a feed-forward
within the limits is not delayed. Otherwise, the change of the acceleration is within the jerk limit. The acceleration
decreases early enough for the speed to reach the desired speed without overshoot: at a speed difference d, the
acceleration relative to the feed-forward is at most sqrt(2 jerk d).

A limit that depends on both speed and turn (wheel speeds, lateral acceleration, yaw rate of steered wheels) is checked
over the time in which a positive acceleration decreases to zero at the largest jerk; the turn also decreases during
this time. A command is accepted only if speed and turn satisfy the limit during this time, which ensures that a next
command exists. Otherwise the speed is reduced first, then the turn.

The lateral jerk is limited only by the rate of change of the turn, and the limits above have priority. Braking in a
bend also has priority, because its lateral jerk could only be compensated by leaving the bend.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

from optdock.geometry.pose import Twist2
from optdock.model.constant_jerk import braking_phases, constant_jerk
from optdock.model.robot import Drive, admissible

if TYPE_CHECKING:
    from collections.abc import Callable

    from optdock.model.limits import MotionLimits

__all__ = ["CommandLimiter", "fastest_slope", "rate_limited", "reachable_speed", "smooth_slope"]

_NO_ARC = 1e-9  # [m/s]: the curvature of a slower command is undefined
_ROUNDING = 1e-15  # [m/s]: a smaller difference to the wanted command counts as zero
_CREEPING = 0.005  # [m/s]: the curvature of a slower command is too inaccurate for the angle of steered wheels
_SAME_ARC = 1.5  # ratio of the speed to the desired speed beyond which the curvature is not kept
_EXACT = 1.0 + 1e-12  # rounding of a motion at its limits
_NO_JERK = 1e-6  # share of the limit: rounding of the jerk that the target does not use
_HALVINGS = 40  # of a bisection, to rounding
_EQUAL = 0.99  # of a period: jitter of a clock
_SLOWER = 1.2  # times the usual period: bound on late calls
_QUARTER = 1.57  # [rad]: largest steering angle


class CommandLimiter:
    """Limiter of each command, based on the previous command.

    Attributes:
        command: The last command.
        acceleration: Acceleration of the last command [m/s^2]; 0 after a restart.
        curvature: Curvature of the last command in motion [1/m]; None if unknown.
    """

    def __init__(self) -> None:
        self.restart(Twist2())

    def restart(self, command: Twist2) -> None:
        """Restart at the velocity of the robot, with zero acceleration."""
        self.command = command
        self.acceleration = 0.0
        self._period, self._usual = 0.0, math.inf  # the last period, and the expected ones
        self._feed_forward: float | None = None
        self._feed_slope: float | None = None
        moving = abs(command.linear) >= _CREEPING
        self.curvature: float | None = command.angular / command.linear if moving else None

    def stop(self, period: float = 0.0) -> None:
        """Restart from rest, for instance after an emergency stop, which has no jerk limit.

        Args:
            period: Time for which the command has been zero [s]; 0: unknown.
        """
        usual = min(period, _SLOWER * self._usual)
        self.restart(Twist2())
        if period > 0.0:
            self._period, self._usual, self._feed_forward = period, usual, 0.0

    def round_to_rest(self) -> None:
        """Replace the last command, which is zero up to rounding, by zero."""
        if self._period > 0.0:
            self.acceleration -= self.command.linear / self._period
        self.command = Twist2()

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
        """Return the command nearest to `wanted` that is reachable from the last command.

        Speed, yaw rate, wheel speed, lateral acceleration, acceleration, jerk, yaw acceleration, curvature and steering
        rate are within the limits. The lateral jerk is within its limit except while braking in a bend. At rest a
        command of almost zero speed turns steered wheels.

        Args:
            wanted: Sum of feed-forward and feedback.
            feed_forward: Feed-forward command; the rate of change of the returned command converges to its rate of
                change.
            period: Time since the last command [s], > 0.
            limits: Limits of the robot.
            drive: Kind of drive.
            in_place: Whether a differential drive may turn more tightly than its smallest radius, because the reference
                turns in place or is at its end.
            room: Distance in which the robot must be able to stop [m].
        """
        free = in_place and drive is Drive.DIFFERENTIAL
        wanted = admissible(wanted if free else _bent(wanted, limits.max_curvature), limits, drive)
        before, steered = self.command.linear, drive is Drive.ACKERMANN

        def turn_at(linear: float) -> _Turn:
            if steered:
                return self._steered(wanted, linear, period, limits)
            angular = wanted.angular if free else _on_its_arc(wanted, linear, limits.max_curvature)
            return self._turned(angular, linear, period, limits)

        slope = self._slope(wanted.linear, feed_forward.linear, period, limits)
        if math.isfinite(room):
            slope = self._stopping_within(room, slope, period, limits)
        linear = _equal_up_to_rounding(before + slope * period, wanted.linear)
        turn = turn_at(linear)
        if self._leaves_room(slope, turn, period, limits):
            turned = turn.wanted
        else:
            slope = self._leaving_room(slope, turn, period, limits)
            linear = _equal_up_to_rounding(before + slope * period, wanted.linear)
            turned = _turned_within(turn_at(linear), linear, slope, period, limits)
        command = Twist2(linear, turned * linear if steered else turned)
        self._keep(command, feed_forward.linear, period)
        if steered:
            self.curvature = turned
        elif abs(linear) >= _CREEPING:
            self.curvature = command.angular / linear
        return command

    def _keep(self, command: Twist2, feed_forward: float, period: float) -> None:
        """Record the command of this period, and the speed of its feed-forward."""
        if self._feed_forward is not None:
            self.acceleration, self._period = (command.linear - self.command.linear) / period, period
            self._usual = min(period, _SLOWER * self._usual)
        self._feed_forward, self.command = feed_forward, command

    def _between(self, period: float) -> float:
        """Return the time [s] between the middles of the last and the present period."""
        return 0.5 * (period + (self._period or period))

    def _slope(self, wanted: float, feed_forward: float, period: float, limits: MotionLimits) -> float:
        """Return the acceleration towards the desired speed, without considering the turn."""
        before = self.command.linear
        if self._feed_forward is None:
            return 0.0  # the age of the last command is unknown
        between = self._between(period)
        slope, jerk = self._fed_slope(feed_forward, period)
        missing, periods = wanted - slope * period - before, (period, between, min(period, self._usual))
        lasts = (limits.max_acceleration + limits.max_deceleration) / limits.max_jerk
        slope = smooth_slope(missing, slope, self.acceleration, limits.max_jerk, periods, (jerk, lasts))
        braking = before != 0.0 and slope * before < 0.0
        most = _most_braking(abs(before), period, limits) if braking else limits.max_acceleration
        return min(max(slope, -most), most)

    def _fed_slope(self, feed_forward: float, period: float) -> tuple[float, float]:
        """Return the acceleration and the jerk of the feed-forward, whose last speed is known, and record them."""
        slope, before = (feed_forward - (self._feed_forward or 0.0)) / period, self._feed_slope
        self._feed_slope = slope
        return slope, 0.0 if before is None else (slope - before) / self._between(period)

    def _stopping_within(self, room: float, slope: float, period: float, limits: MotionLimits) -> float:
        """Return the acceleration, reduced within the jerk limit to stop in `room` without reversing."""
        forward = math.copysign(1.0, self.command.linear if self.command.linear != 0.0 else slope)
        speed = forward * self.command.linear
        least = max(forward * self.acceleration - limits.max_jerk * self._between(period), -limits.max_deceleration)

        def fits(rise: float) -> bool:
            after, end = speed + rise * period, rise - 0.5 * limits.max_jerk * period
            return after * period + _stopping_way(after + 0.5 * end * period, end, limits) <= room

        found = _largest(fits, min(least, forward * slope), forward * slope)
        if speed > 0.0:
            step = limits.max_jerk * period  # additional deceleration for a rest within the period
            most = forward * self.acceleration + limits.max_jerk * self._between(period)
            usual = min(period, self._usual)
            found = max(found, min(-_fastest(speed, limits.max_jerk, period, usual) - step, most))
        return forward * found

    def _leaves_room(self, slope: float, turn: _Turn, period: float, limits: MotionLimits) -> bool:
        """Whether an acceleration and the desired turn satisfy the limits on speed and turn."""
        rise, amount = abs(slope), abs(turn.wanted)
        after = math.copysign(1.0, slope) * self.command.linear + rise * period
        return (
            rise <= self._most_rise(slope, turn, period, limits)
            and _fits(after, rise - 0.5 * limits.max_jerk * period, amount, turn, limits)
            and (after >= 0.0 or _fits(-after, 0.0, amount, turn, limits))
        )

    def _most_rise(self, slope: float, turn: _Turn, period: float, limits: MotionLimits) -> float:
        """Return the largest acceleration in the direction of `slope` within the limits of speed and yaw rate."""
        forward = math.copysign(1.0, slope)
        speed = forward * self.command.linear  # negative: the speed decreases towards rest
        top = min(limits.max_speed if forward > 0.0 else limits.max_reverse_speed, limits.max_wheel_speed)
        most = _rise_to(top - speed, limits.max_jerk, period)
        if turn.steered and turn.least != 0.0:
            most = min(most, (limits.max_yaw_acceleration + turn.fade * max(speed, 0.0)) / abs(turn.least))
        return most

    def _leaving_room(self, slope: float, turn: _Turn, period: float, limits: MotionLimits) -> float:
        """Return the acceleration, reduced to the limits on speed and turn as far as the jerk limit permits."""
        forward, rise = math.copysign(1.0, slope), abs(slope)
        speed, most = forward * self.command.linear, min(rise, self._most_rise(slope, turn, period, limits))
        least = max(forward * self.acceleration - limits.max_jerk * self._between(period), 0.0)
        return forward * _largest(
            lambda rise: _fits(
                speed + rise * period, rise - 0.5 * limits.max_jerk * period, abs(turn.wanted), turn, limits
            ),
            min(least, rise),
            most,
        )

    def _turned(self, wanted: float, linear: float, period: float, limits: MotionLimits) -> _Turn:
        """Return the reachable yaw rate."""
        before, wanted = self.command.angular, _eased(wanted, self.command, linear, period, limits)
        most = (limits.turning.acceleration if linear == 0.0 else limits.max_yaw_acceleration) * period
        least = math.copysign(max(abs(before) - most, 0.0), before)
        return _Turn(_approach(before, wanted, most, most), least, limits.max_yaw_acceleration, steered=False)

    def _steered(self, wanted: Twist2, linear: float, period: float, limits: MotionLimits) -> _Turn:
        """Return the reachable curvature of steered wheels within the limits of steering rate and yaw acceleration."""
        before, base = self.curvature, limits.wheelbase
        asked = wanted.angular / wanted.linear if abs(wanted.linear) > _NO_ARC else before or 0.0
        low, high = -limits.max_curvature, limits.max_curvature
        if before is not None and math.isfinite(limits.max_steering_rate):
            angle, turned = math.atan(base * before), limits.max_steering_rate * period
            low = max(low, math.tan(max(angle - turned, -_QUARTER)) / base)
            high = min(high, math.tan(min(angle + turned, _QUARTER)) / base)
        least = min(max(0.0, low), high)
        fade = math.inf
        if math.isfinite(limits.max_steering_rate):
            # The tangent is convex: wheels that turn back keep the curvature below a straight line to zero.
            angle = math.atan(base * abs(least))
            fade = limits.max_steering_rate * (abs(least) / angle if angle > 0.0 else 1.0 / base)
        top = max(limits.max_speed, limits.max_reverse_speed)
        fade = min(fade, limits.max_yaw_acceleration / top)
        if abs(linear) > _NO_ARC:
            change = limits.max_yaw_acceleration * period
            ends = sorted(((self.command.angular - change) / linear, (self.command.angular + change) / linear))
            asked = _eased(asked * linear, self.command, linear, period, limits) / linear
            asked = min(max(asked, ends[0]), ends[1])
        asked = min(max(asked, low), high)
        return _Turn(asked, least, fade, steered=True)


class _Turn(NamedTuple):
    """Reachable yaw rates, or curvatures of steered wheels: the value nearest to the desired one, and the smallest.

    `fade` is the rate at which the magnitude can decrease later.
    """

    wanted: float
    least: float
    fade: float
    steered: bool


def _turned_within(turn: _Turn, linear: float, slope: float, period: float, limits: MotionLimits) -> float:
    """Return the largest turn up to `turn.wanted` that the speed permits, now and while the acceleration decreases."""
    speed, rise = math.copysign(1.0, slope) * linear, abs(slope) - 0.5 * limits.max_jerk * period
    both = ((speed, rise),) if speed >= 0.0 else ((speed, rise), (-speed, 0.0))
    amount = _largest(
        lambda amount: all(_fits(speed, rise, amount, turn, limits) for speed, rise in both),
        min(abs(turn.least), abs(turn.wanted)),
        abs(turn.wanted),
    )
    return math.copysign(amount, turn.wanted)


def _fits(speed: float, rise: float, amount: float, turn: _Turn, limits: MotionLimits) -> bool:
    """Whether a command satisfies the limits on speed and turn, now and while both decrease as fast as possible.

    `rise` is the acceleration at the end of the period; `speed` and `rise` are positive in the direction of this
    acceleration. `amount` is the magnitude of the turn.
    """
    rise, jerk, lever, fade = max(rise, 0.0), limits.max_jerk, 0.5 * limits.track_width, turn.fade
    motion, lateral = (speed, rise, jerk), limits.max_lateral_acceleration
    if turn.steered:
        if amount * rise > (limits.max_yaw_acceleration + fade * max(speed, 0.0)) * _EXACT:
            return False
        return (
            _stays_below(limits.max_wheel_speed, 1, motion, (1.0 + lever * amount, lever * fade))
            and _stays_below(limits.max_yaw_rate, 1, motion, (amount, fade))
            and _stays_below(lateral, 2, motion, (amount, fade))
        )
    later = max(rise - lever * fade, 0.0) if lever > 0.0 else 0.0
    rim = speed + later * later / (2.0 * jerk) + lever * amount
    if amount > limits.max_yaw_rate * _EXACT or rim > limits.max_wheel_speed * _EXACT:
        return False
    return _stays_below(lateral, 1, motion, (amount, fade))


def _stays_below(bound: float, power: int, speed: tuple[float, float, float], turn: tuple[float, float]) -> bool:
    """Whether the maximum of `_peak` is within a bound."""
    return math.isinf(bound) or _peak(power, speed, turn) <= bound * _EXACT


def _peak(power: int, speed: tuple[float, float, float], turn: tuple[float, float]) -> float:
    """Return the maximum of v(t)^power (c - d t), t >= 0, with v(t) = v + u t - jerk t^2 / 2, while v rises.

    The logarithm of the function is concave. At the maximum, power v' (c - d t) = d v holds, which is a quadratic
    equation in t.
    """
    (v, u, jerk), (c, d) = speed, turn
    now = max(v, 0.0) ** power * c
    if u <= 0.0 or math.isinf(d):
        return now
    constant = power * u * c - d * v
    if constant <= 0.0:
        return now
    linear, square = power * jerk * c + (power + 1) * u * d, (power + 0.5) * jerk * d
    t = 2.0 * constant / (linear + math.sqrt(max(linear * linear - 4.0 * square * constant, 0.0)))
    if c - d * t <= 0.0:
        return now
    return max(now, max(v + u * t - 0.5 * jerk * t * t, 0.0) ** power * (c - d * t))


def _rise_to(gap: float, jerk: float, period: float) -> float:
    """Return the largest acceleration a that can decrease to zero within a speed increase `gap`, for any later periods.

    The speed rises by another u^2 / (2 jerk) with u = a - jerk * period / 2, the acceleration at the end of the period.
    """
    gap = max(gap, 0.0)
    return min(max(math.sqrt(2.0 * jerk * gap) - 0.5 * jerk * period, 0.5 * jerk * period), gap / period)


def _largest(fits: Callable[[float], bool], low: float, high: float) -> float:
    """Return the largest value in [low, high] that satisfies `fits`, by bisection; `low` if there is none."""
    if high <= low or fits(high):
        return max(low, high)
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if fits(middle) else (low, middle)
    return low


def _stopping_way(v: float, a: float, limits: MotionLimits) -> float:
    """Return the full braking distance [m] from a speed and an acceleration along the direction of travel."""
    if v <= 0.0 or (a < 0.0 and 2.0 * limits.max_jerk * v <= a * a):
        return 0.0
    state = 0.0, v, a
    for duration, jerk in braking_phases(v, a, limits.max_deceleration, limits.max_jerk):
        state = constant_jerk(duration, *state, jerk)
    return state[0]


def _most_braking(speed: float, period: float, limits: MotionLimits) -> float:
    """Return the largest deceleration of the coming period.

    Once the robot is at rest, the deceleration is an acceleration in the opposite direction, with a different limit a.
    While the deceleration decreases from b to a, the speed changes by (b^2 - a^2) / (2 jerk).
    """
    most, after, jerk = limits.max_deceleration, limits.max_acceleration, limits.max_jerk
    until_rest = speed / most
    if most > after:
        first = math.sqrt(after * after + 2.0 * jerk * speed)
        most, until_rest = min(most, first - 0.5 * jerk * period), max(until_rest, (first - after) / jerk)
    return most if until_rest >= period else (speed + after * (period - until_rest)) / period


def smooth_slope(
    missing: float,
    target_slope: float,
    slope: float,
    jerk: float,
    periods: tuple[float, float, float],
    target_jerk: tuple[float, float] = (0.0, math.inf),
) -> float:
    """Return the slope in the next period of a value that has to reach and follow a moving target.

    The slope relative to the target is limited so that it can decrease to zero with the part of `jerk` that the jerk of
    the target does not use. If the slope at which the value arrives when the jerk of the target ends is larger, this
    slope is the limit instead.

    Args:
        missing: Difference of target and value before the period.
        target_slope: Slope of the target.
        slope: Slope of the value in the previous period.
        jerk: Largest change of a slope per time.
        periods: Next period, time between the middles of the previous and the next period, and expected later periods
            [s].
        target_jerk: Change of the target's slope per time, and its longest possible duration [s].
    """
    period, between, usual = periods
    changes, lasts = target_jerk
    gap, left = abs(missing), min(jerk, jerk + math.copysign(changes, missing * changes))
    gain = max(_fastest(gap, left, period, usual) if left >= _NO_JERK * jerk else 0.0, gap / lasts)
    gain = min(gap / period, _fastest(gap, jerk, period, usual), gain)
    wanted = target_slope + math.copysign(gain, missing)
    return min(max(wanted, slope - jerk * between), slope + jerk * between)


def _fastest(gap: float, jerk: float, period: float, usual: float) -> float:
    """Return the largest slope of a period that can decrease to zero within `gap` over later periods `usual`."""
    if usual >= _EQUAL * period:
        return fastest_slope(gap, jerk, period)
    low, high = 0.0, gap / period
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        next_slope = middle - 0.5 * jerk * (period + usual)
        fits = next_slope <= fastest_slope(gap - middle * period, jerk, usual)
        low, high = (middle, high) if fits else (low, middle)
    return low


def fastest_slope(gap: float, jerk: float, period: float) -> float:
    """Return the largest slope that can decrease to zero within `gap`, by at most `jerk` * `period` per period.

    In units of jerk * period, slopes n + f, n - 1 + f, ..., f cover (n + 1) (n / 2 + f) units of jerk * period^2.
    """
    step = jerk * period
    units = max(gap, 0.0) / (step * period)
    n = math.floor(0.5 * (math.sqrt(1.0 + 8.0 * units) - 1.0))
    return step * (0.5 * n + units / (n + 1))


def reachable_speed(before: float, wanted: float, limits: MotionLimits, period: float) -> float:
    """Return the speed nearest to `wanted` that is reachable from `before` in `period` [s], without a jerk limit.

    Speeding up is bounded by max_acceleration, slowing down by max_deceleration, in either gear.
    """
    return _approach(before, wanted, limits.max_acceleration * period, limits.max_deceleration * period)


def rate_limited(previous: Twist2, wanted: Twist2, limits: MotionLimits, period: float) -> Twist2:
    """Return the command nearest to `wanted` that is reachable from `previous` in `period` [s], without a jerk limit.

    The speed is that of `reachable_speed`.
    """
    linear = reachable_speed(previous.linear, wanted.linear, limits, period)
    turn = limits.max_yaw_acceleration * period
    eased = _eased(wanted.angular, previous, linear, period, limits)
    return Twist2(linear, _approach(previous.angular, eased, turn, turn))


def _eased(angular: float, before: Twist2, linear: float, period: float, limits: MotionLimits) -> float:
    """Return the yaw rate nearest to `angular` within the lateral jerk; at most max(|`angular`|, |last yaw rate|)."""
    if linear == 0.0 or math.isinf(limits.max_lateral_jerk):
        return angular
    sideways, change = before.linear * before.angular, limits.max_lateral_jerk * period
    low, high = sorted(((sideways - change) / linear, (sideways + change) / linear))
    most = max(abs(angular), abs(before.angular))
    return min(max(min(max(angular, low), high), -most), most)


def _approach(value: float, target: float, rise: float, fall: float) -> float:
    """Return `value` moved towards `target`: away from zero by at most `rise`, towards zero by at most `fall`."""
    if value * target < 0.0:
        if abs(value) >= fall:
            return value - math.copysign(fall, value)
        left = 1.0 - abs(value) / fall if math.isfinite(fall) else 1.0
        return _approach(0.0, target, rise * left, fall)
    bound = rise if abs(target) > abs(value) else fall
    return value + min(max(target - value, -bound), bound)


def _equal_up_to_rounding(speed: float, wanted: float) -> float:
    return wanted if abs(speed - wanted) <= _ROUNDING else speed


def _on_its_arc(wanted: Twist2, linear: float, curvature: float) -> float:
    """Return the yaw rate at the speed `linear` that preserves the curvature of `wanted`, if the speeds are similar."""
    share = linear / wanted.linear if wanted.linear != 0.0 else 1.0
    return _bent_rate(linear, wanted.angular * (share if 0.0 <= share <= _SAME_ARC else 1.0), curvature)


def _bent(command: Twist2, curvature: float) -> Twist2:
    """Return the command with its curvature limited."""
    angular = _bent_rate(command.linear, command.angular, curvature)
    return command if angular == command.angular else Twist2(command.linear, angular)


def _bent_rate(linear: float, angular: float, curvature: float) -> float:
    """Return the yaw rate, limited to that of a curvature at a speed."""
    most = curvature * abs(linear) if linear != 0.0 else 0.0
    return min(max(angular, -most), most)
