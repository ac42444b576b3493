"""The tracking law: feed-forward plus feedback of the pose error, the same formula in both gears.

With the error (x, y, theta) of the reference seen from the robot, reference speed v_r (signed, negative in reverse)
and yaw rate w_r, [Samson1993], [Kanayama1990], [DeLuca2001]:

    v = v_r cos(theta) + k_x x
    w = w_r + k_y v_r sinc(theta) y + k_theta theta

V = k_y (x^2 + y^2) / 2 + theta^2 / 2 gives V' = -k_y k_x x^2 - k_theta theta^2 <= 0 whatever the sign of v_r, so the
law is stable in both gears, and y converges wherever v_r does not vanish (continuous time, commands not saturated).
Linearised, the lateral error obeys s^2 + k_theta s + k_y v_r^2. With k_y = 1 / L^2 and k_theta = 2 zeta |v_r| / L it
decays over the distance L, not over a time: the robot drives the same line at every speed.

A delay T of the drive takes the phase w T from the open loop, where w is its crossover frequency [Astrom2021]. Where
that is most of the phase margin the robot weaves, the more so where noise or the limits of the yaw acceleration keep it
going. `DelayBounds` are the gains at which the delay takes a fixed share of the margin.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

from optdock.geometry.pose import Twist2

if TYPE_CHECKING:
    from optdock.geometry.pose import Pose2

__all__ = ["DelayBounds", "Gains", "delay_bounds", "left_after", "tracking_command"]

# Of the phase margin, that a delay may take: 0.4 leaves 46 of 76 degrees across at a damping of 1, and 54 of 90 along.
# Textbooks ask for 30 to 60 degrees.
_SHARE = 0.4


_SAME_ROOTS = 1e-6  # half the difference of the two exponents: smaller, their quotient is all rounding


class Gains(NamedTuple):
    """Gains of the law.

    `along` k_x [1/s]; `convergence_distance` L [m]; `damping` zeta; `turn` lower bound of k_theta [1/s], which turns
    the robot where the reference stands.
    """

    along: float
    convergence_distance: float
    damping: float
    turn: float


class DelayBounds(NamedTuple):
    """What a delay leaves to the gains: the largest `rate` of `along` and `turn` [1/s], the least `distance` [m]."""

    rate: float
    distance: float


def delay_bounds(speed: float, delay: float, damping: float) -> DelayBounds:
    """The bounds at which a delay takes 0.4 of the phase margin of the linearised law.

    Across, the open loop is (2 zeta a s + a^2) / s^2 with a = |v| / L. It crosses 1 at
    w = a sqrt(2 zeta^2 + sqrt(4 zeta^4 + 1)), where its phase margin is atan(2 zeta w / a). Along and for turns in
    place it is k / s, which crosses 1 at w = k with a margin of 90 degrees. A lag takes less than a latency as long.

    Args:
        speed: Of the reference [m/s], of either sign.
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
    """What the law leaves of an error across after a distance: offset [m] and slope [rad] (E5).

    With y the offset and y' the slope, y'' + 2 m y' + y / L^2 = 0 over the distance; 2 m is `pull`, or 2 / L where that
    is more: critically damped at least.

    Args:
        distance: To be driven [m], >= 0.
        offset: Now [m].
        slope: By which the offset rises with the distance, now [rad].
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
    """The command of the law, not limited.

    Args:
        error: The reference pose in the robot's frame, yaw in (-pi, pi].
        reference: The reference's body velocity.
        gains: See `Gains`.
    """
    v, theta = reference.linear, error.yaw
    heading_gain = max(gains.turn, 2.0 * gains.damping * abs(v) / gains.convergence_distance)
    lateral = v * _sinc(theta) * error.y / gains.convergence_distance**2
    return Twist2(v * math.cos(theta) + gains.along * error.x, reference.angular + lateral + heading_gain * theta)


def _sinc(angle: float) -> float:
    return math.sin(angle) / angle if abs(angle) > 1e-6 else 1.0 - angle * angle / 6.0
