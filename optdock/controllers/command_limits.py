"""Commands within the limits: what the drive can follow from the command before, jerk included.

The speed is a second-order limiter. Where the wanted command can be reached it is given as it is, so a feed-forward
within the limits passes without any lag; else the acceleration rises and falls by no more than the jerk, and falls
early enough that the speed ends on what is wanted without going beyond: in the frame of the feed-forward, over a
difference d, at a relative acceleration of at most sqrt(2 jerk d).

A limit that speed and turn share (wheels, lateral acceleration, yaw rate of steered wheels) is kept by looking ahead:
a speed that rises goes on rising until its acceleration has come down at the largest jerk, and the turn needs time to
give way. A command is given only where both together stay within the limit until then, so that the next one can do
the same. The speed gives way first, then the turn. A motion within the limits is one such future itself: it passes.

The lateral jerk is kept by the turn alone, which changes no faster than it allows; the limits above come first, and so
does braking in a bend, which no turn makes good without leaving the bend.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

from optdock.geometry.pose import Twist2
from optdock.model.robot import Drive, admissible
from optdock.model.trajectory import braking_phases, constant_jerk

if TYPE_CHECKING:
    from collections.abc import Callable

    from optdock.model.limits import MotionLimits

__all__ = ["CommandLimiter", "rate_limited", "smooth_slope"]

_NO_ARC = 1e-9  # [m/s]: a slower command has no curvature
_ROUNDING = 1e-15  # [m/s]: of a command that is to be the wanted one; a robot at rest is commanded nothing at all
_CREEPING = 0.005  # [m/s]: a slower command says too little of the angle of steered wheels
_SAME_ARC = 1.5  # times as fast as wanted: beyond, the wanted speed was feedback, whose arc means nothing
_EXACT = 1.0 + 1e-12  # a motion at its limits is not beyond them by rounding
_NO_JERK = 1e-6  # of the limit: rounding of what a target leaves
_HALVINGS = 40  # to a rounding error
_EQUAL = 0.99  # of a period: jitter of a clock
_SLOWER = 1.2  # times the usual period: one or two late calls do not change the rate
_QUARTER = 1.57  # [rad]: wheels turn no further


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
        self._period, self._usual = 0.0, math.inf  # the last one, and what those to come are taken to be
        self._feed_forward: float | None = None
        self._feed_slope: float | None = None
        moving = abs(command.linear) >= _CREEPING
        self._curvature = command.angular / command.linear if moving else None

    def stop(self, period: float = 0.0) -> None:
        """Begin again from rest: what a refusal leaves the robot with. An emergency stop keeps no jerk limit.

        Args:
            period: For how long the command has been rest [s]; 0: unknown.
        """
        usual = min(period, _SLOWER * self._usual)
        self.restart(Twist2())
        if period > 0.0:
            self._period, self._usual, self._feed_forward = period, usual, 0.0

    def round_to_rest(self) -> None:
        """Take the last command for rest: what is left of it is rounding."""
        if self._period > 0.0:
            self._acceleration -= self.command.linear / self._period
        self.command = Twist2()

    def follow(  # noqa: PLR0913 - two commands, their time, and what bounds them
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
        """The command nearest to `wanted` that the last one can become.

        Speed, yaw rate, wheel speed, lateral acceleration, acceleration and jerk, yaw acceleration, curvature, and how
        fast steered wheels turn, are within the limits; lateral jerk too, but for what braking in a bend makes of it.
        At rest a command of almost no speed tells steered wheels where to turn.

        Args:
            wanted: Feed-forward and feedback.
            feed_forward: The part of it that moves; how fast it changes is what the command converges to.
            period: Since the last command [s], > 0.
            limits: Of the robot.
            drive: How it steers.
            in_place: Whether a differential drive may turn tighter than its smallest radius: where its reference turns
                in place, or stands at its end.
            room: How far the robot may go on in its direction until it rests [m]. A command is slower than wanted where
                it could not stop within that.
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
        slope = self._leaving_room(slope, turn_at(before + slope * period), period, limits)
        linear = before + slope * period
        if abs(linear - wanted.linear) <= _ROUNDING:
            linear = wanted.linear
        turned = _turned_within(turn_at(linear), linear, slope, period, limits)
        command = Twist2(linear, turned * linear if steered else turned)
        if self._feed_forward is not None:
            self._acceleration, self._period = (command.linear - before) / period, period
            self._usual = min(period, _SLOWER * self._usual)
        self._feed_forward, self.command = feed_forward.linear, command
        if steered:
            self._curvature = turned
        elif abs(linear) >= _CREEPING:
            self._curvature = command.angular / linear
        return command

    def _between(self, period: float) -> float:
        """Time between accelerations, which are those in the middle of their periods [s]."""
        return 0.5 * (period + (self._period or period))

    def _slope(self, wanted: float, feed_forward: float, period: float, limits: MotionLimits) -> float:
        """The acceleration towards the wanted speed, whatever the turn."""
        before = self.command.linear
        if self._feed_forward is None:
            return 0.0  # how long the command has been in force is unknown
        slope, between = (feed_forward - self._feed_forward) / period, self._between(period)
        jerk = 0.0 if self._feed_slope is None else (slope - self._feed_slope) / between
        self._feed_slope = slope
        missing, periods = wanted - slope * period - before, (period, between, min(period, self._usual))
        lasts = (limits.max_acceleration + limits.max_deceleration) / limits.max_jerk
        slope = smooth_slope(missing, slope, self._acceleration, limits.max_jerk, periods, (jerk, lasts))
        braking = before != 0.0 and slope * before < 0.0
        most = _most_braking(abs(before), period, limits) if braking else limits.max_acceleration
        return min(max(slope, -most), most)

    def _stopping_within(self, room: float, slope: float, period: float, limits: MotionLimits) -> float:
        """The acceleration, no larger than lets the robot stop within `room`, as far as its jerk allows.

        Braking comes down with the speed: a robot that is to rest does not set off backwards.
        """
        forward = math.copysign(1.0, self.command.linear if self.command.linear != 0.0 else slope)
        speed = forward * self.command.linear
        least = max(forward * self._acceleration - limits.max_jerk * self._between(period), -limits.max_deceleration)

        def fits(rise: float) -> bool:
            after, end = speed + rise * period, rise - 0.5 * limits.max_jerk * period
            return after * period + _stopping_way(after + 0.5 * end * period, end, limits) <= room

        found = _largest(fits, min(least, forward * slope), forward * slope)
        if speed > 0.0:
            step = limits.max_jerk * period  # that much more where the rest falls into a period
            most = forward * self._acceleration + limits.max_jerk * self._between(period)
            usual = min(period, self._usual)
            found = max(found, min(-_fastest(speed, limits.max_jerk, period, usual) - step, most))
        return forward * found

    def _leaving_room(self, slope: float, turn: _Turn, period: float, limits: MotionLimits) -> float:
        """The acceleration, no larger than what the limits leave beside the turn, and no jump down from the last."""
        forward, rise = math.copysign(1.0, slope), abs(slope)
        speed = forward * self.command.linear  # negative: it falls towards rest
        top = min(limits.max_speed if forward > 0.0 else limits.max_reverse_speed, limits.max_wheel_speed)
        most = min(rise, _rise_to(top - speed, limits.max_jerk, period))
        if turn.steered and turn.least != 0.0:
            most = min(most, (limits.max_yaw_acceleration + turn.fade * max(speed, 0.0)) / abs(turn.least))
        least = max(forward * self._acceleration - limits.max_jerk * self._between(period), 0.0)
        return forward * _largest(
            lambda rise: _fits(
                speed + rise * period, rise - 0.5 * limits.max_jerk * period, abs(turn.wanted), turn, limits
            ),
            min(least, rise),
            most,
        )

    def _turned(self, wanted: float, linear: float, period: float, limits: MotionLimits) -> _Turn:
        """The yaw rate."""
        before, wanted = self.command.angular, _eased(wanted, self.command, linear, period, limits)
        most = (limits.turning.acceleration if linear == 0.0 else limits.max_yaw_acceleration) * period
        least = math.copysign(max(abs(before) - most, 0.0), before)
        return _Turn(_approach(before, wanted, most, most), least, limits.max_yaw_acceleration, steered=False)

    def _steered(self, wanted: Twist2, linear: float, period: float, limits: MotionLimits) -> _Turn:
        """The curvature of steered wheels: first what they can turn to, then what the yaw acceleration allows."""
        before, base = self._curvature, limits.wheelbase
        asked = wanted.angular / wanted.linear if abs(wanted.linear) > _NO_ARC else before or 0.0
        low, high = -limits.max_curvature, limits.max_curvature
        if before is not None and math.isfinite(limits.max_steering_rate):
            angle, turned = math.atan(base * before), limits.max_steering_rate * period
            low = max(low, math.tan(max(angle - turned, -_QUARTER)) / base)
            high = min(high, math.tan(min(angle + turned, _QUARTER)) / base)
        least = min(max(0.0, low), high)
        fade = math.inf
        if math.isfinite(limits.max_steering_rate):
            # The tangent is convex: wheels that turn back keep the curvature below the straight line to nothing.
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
    """What a command turns by: the yaw rate, or the curvature of steered wheels.

    `wanted` is what can be reached; `least` the least that can; `fade` how fast the amount can become less later.
    """

    wanted: float
    least: float
    fade: float
    steered: bool


def _turned_within(turn: _Turn, linear: float, slope: float, period: float, limits: MotionLimits) -> float:
    """The turn nearest to what is wanted that the speed leaves room for, now and while its acceleration comes down."""
    speed, rise = math.copysign(1.0, slope) * linear, abs(slope) - 0.5 * limits.max_jerk * period
    both = ((speed, rise),) if speed >= 0.0 else ((speed, rise), (-speed, 0.0))
    amount = _largest(
        lambda amount: all(_fits(speed, rise, amount, turn, limits) for speed, rise in both),
        min(abs(turn.least), abs(turn.wanted)),
        abs(turn.wanted),
    )
    return math.copysign(amount, turn.wanted)


def _fits(speed: float, rise: float, amount: float, turn: _Turn, limits: MotionLimits) -> bool:
    """Whether a command, and all that must come of it, is within the limits that speed and turn share.

    From now on the acceleration falls by the jerk, and the turn by its `fade`.

    Args:
        speed: In the direction in which it rises [m/s].
        rise: The acceleration at the end of the period [m/s^2].
        amount: Of the yaw rate, or of the curvature.
        turn: What kind of a turn it is.
        limits: Of the robot.
    """
    rise, jerk, lever, fade = max(rise, 0.0), limits.max_jerk, 0.5 * limits.track_width, turn.fade
    shared: tuple[tuple[int, float, float, float], ...]
    shared = ((1, amount, fade, limits.max_lateral_acceleration),)
    if turn.steered:
        if amount * rise > (limits.max_yaw_acceleration + fade * max(speed, 0.0)) * _EXACT:
            return False
        shared = (
            (1, 1.0 + lever * amount, lever * fade, limits.max_wheel_speed),
            (1, amount, fade, limits.max_yaw_rate),
            (2, amount, fade, limits.max_lateral_acceleration),
        )
    else:
        later = max(rise - lever * fade, 0.0) if lever > 0.0 else 0.0
        rim = speed + later * later / (2.0 * jerk) + lever * amount
        if amount > limits.max_yaw_rate * _EXACT or rim > limits.max_wheel_speed * _EXACT:
            return False
    return all(
        math.isinf(bound) or _peak(power, (speed, rise, jerk), (turned, less)) <= bound * _EXACT
        for power, turned, less, bound in shared
    )


def _peak(power: int, speed: tuple[float, float, float], turn: tuple[float, float]) -> float:
    """The largest value of v(t)^power (c - d t), t >= 0, with v(t) = v + u t - jerk t^2 / 2, while it rises.

    Its logarithm is concave. Where it is largest, power v' (c - d t) = d v, a quadratic equation in t.
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
    """The largest acceleration that comes down to nothing within `gap`, however the periods to come are.

    Under the jerk the speed v goes on by u^2 / (2 jerk), u = a - jerk * period / 2 at the end of the period.
    """
    gap = max(gap, 0.0)
    return min(max(math.sqrt(2.0 * jerk * gap) - 0.5 * jerk * period, 0.5 * jerk * period), gap / period)


def _largest(fits: Callable[[float], bool], low: float, high: float) -> float:
    """The largest value that fits; `low` where none does."""
    if high <= low or fits(high):
        return max(low, high)
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if fits(middle) else (low, middle)
    return low


def _stopping_way(v: float, a: float, limits: MotionLimits) -> float:
    """How far a robot goes on until it rests, at full braking from a speed and an acceleration along its travel [m]."""
    if v <= 0.0 or (a < 0.0 and 2.0 * limits.max_jerk * v <= a * a):
        return 0.0
    state = 0.0, v, a
    for duration, jerk in braking_phases(v, a, limits.max_deceleration, limits.max_jerk):
        state = constant_jerk(duration, *state, jerk)
    return state[0]


def _most_braking(speed: float, period: float, limits: MotionLimits) -> float:
    """The largest deceleration of the coming period.

    Through rest the deceleration becomes an acceleration. By then it must have come down to that one's limit: a
    deceleration b needs (b^2 - a^2) / (2 jerk) of the speed to come down to a.
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
    """The slope of the next period, of a value that is to reach a moving target and stay with it.

    The slope that it gains on the target has to be given back at what the target's own jerk leaves of `jerk`; or it is
    so little that the value arrives when that jerk ends at the latest.

    Args:
        missing: By how much the value falls short of the target before the period.
        target_slope: Of the target.
        slope: Of the value in the period before.
        jerk: By how much a slope may change in a unit of time.
        periods: The period, the time between its middle and that of the one before, and those to come [s].
        target_jerk: By how much the target's slope changes in a unit of time, and how long that may go on [s].
    """
    period, between, usual = periods
    changes, lasts = target_jerk
    gap, left = abs(missing), min(jerk, jerk + math.copysign(changes, missing * changes))
    gain = max(_fastest(gap, left, period, usual) if left >= _NO_JERK * jerk else 0.0, gap / lasts)
    gain = min(gap / period, _fastest(gap, jerk, period, usual), gain)
    wanted = target_slope + math.copysign(gain, missing)
    return min(max(wanted, slope - jerk * between), slope + jerk * between)


def _fastest(gap: float, jerk: float, period: float, usual: float) -> float:
    """The largest slope of a period that can still fall to nothing within `gap`, over `usual` periods after it.

    Between the middles of two periods a slope falls by at most `jerk` times the time between.
    """
    if usual >= _EQUAL * period:
        return _fastest_evenly(gap, jerk, period)
    low, high = 0.0, gap / period
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        next_slope = middle - 0.5 * jerk * (period + usual)
        fits = next_slope <= _fastest_evenly(gap - middle * period, jerk, usual)
        low, high = (middle, high) if fits else (low, middle)
    return low


def _fastest_evenly(gap: float, jerk: float, period: float) -> float:
    """The same over equal periods.

    In units of jerk times period: slopes n + f, n - 1 + f, ..., f cover (n + 1) (n / 2 + f) units of jerk * period^2.
    """
    step = jerk * period
    units = max(gap, 0.0) / (step * period)
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
    eased = _eased(wanted.angular, previous, linear, period, limits)
    return Twist2(linear, _approach(previous.angular, eased, turn, turn))


def _eased(angular: float, before: Twist2, linear: float, period: float, limits: MotionLimits) -> float:
    """The yaw rate nearest to `angular` for which the lateral acceleration changes no faster than its jerk allows.

    No more of a turn than both `angular` and the command before: it is braking then that changes it faster.
    """
    if linear == 0.0 or math.isinf(limits.max_lateral_jerk):
        return angular
    sideways, change = before.linear * before.angular, limits.max_lateral_jerk * period
    low, high = sorted(((sideways - change) / linear, (sideways + change) / linear))
    most = max(abs(angular), abs(before.angular))
    return min(max(min(max(angular, low), high), -most), most)


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
