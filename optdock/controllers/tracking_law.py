"""The tracking law: feed-forward plus feedback of the pose error, its gains, and the push through a dead band.

With the error (x, y, theta) of the reference in the robot's frame, reference speed v_r (negative in reverse) and yaw
rate w_r, the command is ([Samson1993], [Kanayama1990], [DeLuca2001]):

    v = v_r cos(theta) + k_x x
    w = w_r + k_y v_r sinc(theta) y + k_theta theta

The Lyapunov function V = k_y (x^2 + y^2) / 2 + theta^2 / 2 has V' = -k_y k_x x^2 - k_theta theta^2 <= 0 for either sign
of v_r, so the law is stable in both gears, and y converges while v_r does not vanish (continuous time, commands not
saturated). The linearized lateral error has the characteristic polynomial s^2 + k_theta s + k_y v_r^2. With gains k_y =
1 / L^2 and k_theta = 2 zeta |v_r| / L the error decays over the distance L at every speed.

A delay T of the drive reduces the phase of the open loop by w T, where w is the crossover frequency [Astrom2021].
`DelayBounds` contains the gains at which the delay consumes a fixed share of the phase margin.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

from optdock.geometry.pose import Pose2, Twist2, arc_end, normalize_angle

if TYPE_CHECKING:
    from optdock.controllers.delay_estimate import ControlClock
    from optdock.controllers.moving_reference import ReferenceState
    from optdock.controllers.tracking_checks import AcceptedErrors

__all__ = [
    "CREEPING",
    "DeadBandPush",
    "DelayBounds",
    "FeedbackGains",
    "Gains",
    "delay_bounds",
    "left_after",
    "tracking_command",
]

# Share of the phase margin that a delay may take: 0.4 leaves 46 of 76 degrees across at a damping of 1, and 54 of 90
# along. Textbooks recommend 30 to 60 degrees.
_SHARE = 0.4
_SAME_ROOTS = 1e-6  # half the difference of the two exponents below which their quotient is rounding

CREEPING = 1e-3  # [m/s]: the curvature of a slower reference is undefined
_SHORTEST_CONVERGENCE = 0.05  # [m]
_QUICKEST_TURN = 4.0  # [1/s], largest heading gain before the end, within the bound of the delay
_AT_END = 0.78  # of the distance that the delay requires, near the end: a phase margin of 37 degrees
_ERROR_SMOOTHING = 0.2  # [s], time constant of the error filter
_SCATTER_SMOOTHING = 1.0  # [s], time constant of the variance filter
_GROWTH, _LEAST_SCATTER = 4.0, 4e-6  # [1], [m^2] or [rad^2]: bound on the increase of the variance by one sample
_NOISES = 3.0  # standard deviations
_NEAR_END, _ROUNDING = 0.5, 1e-6  # [m] before the end in which the gains are adapted, if no rest lies between
_LEFT = 0.25  # share of the accepted errors that the usual gains may leave at the end

_STANDS = Twist2(0.003, 0.01)  # [m/s], [rad/s]: a slower drive is at rest
_PUSH_RATE = Twist2(0.05, 0.2)  # [m/s^2], [rad/s^2]: through a dead band of 0.05 m/s in a second
_MOST_PUSH = Twist2(0.1, 0.3)  # [m/s], [rad/s]: the widest dead band


class Gains(NamedTuple):
    """Gains of the tracking law.

    `along` k_x [1/s]; `convergence_distance` L [m]; `damping` zeta; `turn` lower bound of k_theta [1/s], for turning
    the robot while the reference is at rest.
    """

    along: float
    convergence_distance: float
    damping: float
    turn: float


class DelayBounds(NamedTuple):
    """Bounds on the gains for a given delay: largest `along` and `turn` [1/s], smallest convergence distance [m]."""

    rate: float
    distance: float


def delay_bounds(speed: float, delay: float, damping: float) -> DelayBounds:
    """Return the bounds at which a delay consumes 0.4 of the phase margin of the linearized law.

    Across the path, the open loop is (2 zeta a s + a^2) / s^2 with a = |v| / L. Its gain is 1 at
    w = a sqrt(2 zeta^2 + sqrt(4 zeta^4 + 1)), where its phase margin is atan(2 zeta w / a). Along the path,
    and for turns in place, the open loop is k / s, with a gain of 1 at w = k and a phase margin of 90 degrees. A lag
    reduces the phase less than an equal latency.

    Args:
        speed: Speed of the reference [m/s], of either sign.
        delay: Latency plus lag of the drive, plus half a period of the commands [s], >= 0.
        damping: zeta > 0.
    """
    crossover = math.sqrt(2.0 * damping**2 + math.sqrt(4.0 * damping**4 + 1.0))  # in units of a
    margin = math.atan(2.0 * damping * crossover)
    rate = _SHARE * 0.5 * math.pi / delay if delay > 0.0 else math.inf
    return DelayBounds(rate, abs(speed) * delay * crossover / (_SHARE * margin))


def left_after(
    distance: float, offset: float, slope: float, convergence_distance: float, pull: float = 0.0
) -> tuple[float, float]:
    """Return the lateral offset [m] and slope [rad] that the law leaves after a distance (E5).

    The offset y and the slope y' obey y'' + 2 m y' + y / L^2 = 0 over the distance, where 2 m is the larger of `pull`
    and 2 / L (at least critically damped).

    Args:
        distance: Distance to drive [m], >= 0.
        offset: Present lateral offset [m].
        slope: Present change of the offset per distance [rad].
        convergence_distance: L > 0 [m].
        pull: Curvature per slope [1/m].
    """
    m = max(1.0 / convergence_distance, 0.5 * pull)
    bent = offset / convergence_distance**2
    root = math.sqrt(max(0.0, m * m - convergence_distance**-2.0))
    slow, fast = math.exp(-(m - root) * distance), math.exp(-(m + root) * distance)
    even = 0.5 * (slow + fast)
    odd = distance * slow if root * distance < _SAME_ROOTS else 0.5 * (slow - fast) / root
    return offset * even + (slope + m * offset) * odd, slope * even - (m * slope + bent) * odd


def tracking_command(error: Pose2, reference: Twist2, gains: Gains) -> Twist2:
    """Return the command of the law, without limits.

    Args:
        error: The reference pose in the robot's frame, yaw in (-pi, pi].
        reference: Body velocity of the reference.
        gains: Gains of the law.
    """
    v, theta = reference.linear, error.yaw
    sinc = math.sin(theta) / theta if abs(theta) > 1e-6 else 1.0 - theta * theta / 6.0
    heading_gain = max(gains.turn, 2.0 * gains.damping * abs(v) / gains.convergence_distance)
    lateral = v * sinc * error.y / gains.convergence_distance**2
    return Twist2(v * math.cos(theta) + gains.along * error.x, reference.angular + lateral + heading_gain * theta)


class FeedbackGains:
    """Gains scheduled by the delay of the drive and the distance to the end, with an estimate of the pose noise.

    Attributes:
        scatter: Variance of a measured pose across the robot [m^2].
    """

    def __init__(self) -> None:
        self._offset = self._turn = self.scatter = self._yaw_scatter = 0.0
        self._before: tuple[Pose2, Twist2] | None = None

    def learn_noise(self, pose: Pose2, velocity: Twist2, clock: ControlClock) -> None:
        """Update the variances from measured minus odometric motion, whose variance is twice the variance of a pose."""
        period, before = clock.elapsed, self._before
        self._before = (pose, velocity)
        if before is None or clock.silent:
            return
        last, speed = before
        driven = 0.5 * (speed.linear + velocity.linear), 0.5 * (speed.angular + velocity.angular), 0.0
        x, y, yaw = arc_end(last.x, last.y, last.yaw, driven, period)
        across = math.cos(pose.yaw) * (y - pose.y) - math.sin(pose.yaw) * (x - pose.x)
        turned, share = normalize_angle(yaw - pose.yaw), min(1.0, period / _SCATTER_SMOOTHING)
        most = _GROWTH * self.scatter + _LEAST_SCATTER  # a jump is not noise
        self.scatter += share * (min(0.5 * across * across, most) - self.scatter)
        most = _GROWTH * self._yaw_scatter + _LEAST_SCATTER
        self._yaw_scatter += share * (min(0.5 * turned * turned, most) - self._yaw_scatter)

    def update(  # noqa: PLR0913 - the inputs of the schedule
        self,
        usual: Gains,
        now: ReferenceState,
        error: Pose2,
        accepted: AcceptedErrors,
        *,
        period: float,
        delay: float,
        finished: bool,
    ) -> Gains:
        """Return `usual` within the bounds of the delay, or other gains if the error at the end would be too large.

        Lateral and heading errors are measured in units of the accepted errors. They are smoothed, and errors within
        the noise are ignored, because higher gains would amplify the noise. A lateral error is removed by turning the
        robot; if the remaining distance is too short to turn back, only the heading is corrected.

        Args:
            usual: Gains of the parameters.
            now: State of the reference.
            error: The reference pose in the robot's frame.
            accepted: Accepted errors at the end.
            period: Time since the last call [s].
            delay: Delay of the drive, plus half a period [s].
            finished: Whether the reference is at its end.
        """
        ahead = now.ahead
        bounds = delay_bounds(ahead.twist.linear, delay, usual.damping)
        share = min(1.0, period / _ERROR_SMOOTHING)
        self._offset += share * (error.y - self._offset)
        self._turn += share * (error.yaw - self._turn)
        smoothed = math.sqrt(share / (2.0 - share))
        offset = self._offset if abs(self._offset) > _NOISES * smoothed * math.sqrt(self.scatter) else 0.0
        heading = self._turn if abs(self._turn) > _NOISES * smoothed * math.sqrt(self._yaw_scatter) else 0.0
        slope, speed = now.gear * heading, max(abs(ahead.twist.linear), CREEPING)

        def left_with(distance: float, turn: float) -> float:
            pull = max(turn / speed, 2.0 * usual.damping / distance)
            across, turned = left_after(ahead.left, offset, slope, distance, pull)
            return max(abs(across) / accepted.cross, abs(turned) / accepted.yaw)

        turns = min(usual.turn, bounds.rate), min(_QUICKEST_TURN, bounds.rate)
        longest = max(usual.convergence_distance, bounds.distance)
        shortest = min(max(_SHORTEST_CONVERGENCE, _AT_END * bounds.distance), longest)
        best, is_near = (longest, turns[0]), ahead.left <= min(_NEAR_END, ahead.to_rest + _ROUNDING)
        if finished and abs(heading) > _LEFT * accepted.yaw:
            best = longest, turns[1]
        elif is_near and (least_left := left_with(*best)) > _LEFT:
            distance = longest
            while distance > shortest:
                for turn in turns:
                    if (found := left_with(distance, turn)) < least_left:
                        best, least_left = (distance, turn), found
                distance *= 0.85
        return Gains(min(usual.along, bounds.rate), best[0], usual.damping, best[1])


class DeadBandPush:
    """Offset that is added to the commands at the end and grows until the drive moves."""

    def __init__(self) -> None:
        self._push = [0.0, 0.0]

    def add_to(self, wanted: Twist2, error: Pose2, near: Pose2, velocity: Twist2, period: float) -> Twist2:
        """Return the command `wanted` plus the push of this period; errors within `near` need no push."""
        return Twist2(
            wanted.linear + self._grown(0, error.x, near.x, velocity.linear, period),
            wanted.angular + self._grown(1, error.yaw, near.yaw, velocity.angular, period),
        )

    def _grown(self, axis: int, error: float, near: float, speed: float, period: float) -> float:
        still, rate, most = ((pair.linear, pair.angular)[axis] for pair in (_STANDS, _PUSH_RATE, _MOST_PUSH))
        push = self._push[axis]
        if abs(error) <= near or push * error < 0.0:
            push = 0.0
        elif abs(speed) < still:
            push = math.copysign(min(abs(push) + rate * period, most), error)
        self._push[axis] = push
        return push
