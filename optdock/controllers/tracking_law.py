"""The tracking law: feed-forward plus feedback of the pose error, the same formula in both gears.

With the error (x, y, theta) of the reference seen from the robot, reference speed v_r (signed, negative in reverse)
and yaw rate w_r, [Samson1993], [Kanayama1990], [DeLuca2001]:

    v = v_r cos(theta) + k_x x
    w = w_r + k_y v_r sinc(theta) y + k_theta theta

V = k_y (x^2 + y^2) / 2 + theta^2 / 2 gives V' = -k_y k_x x^2 - k_theta theta^2 <= 0 whatever the sign of v_r, so the
law is stable in both gears, and y converges wherever v_r does not vanish (continuous time, commands not saturated).
Linearised, the lateral error obeys s^2 + k_theta s + k_y v_r^2. With k_y = 1 / L^2 and k_theta = 2 zeta |v_r| / L it
decays over the distance L, not over a time: the robot drives the same line at every speed.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

from optdock.geometry.pose import Twist2

if TYPE_CHECKING:
    from optdock.geometry.pose import Pose2

__all__ = ["Gains", "tracking_command"]


class Gains(NamedTuple):
    """Gains of the law.

    `along` k_x [1/s]; `convergence_distance` L [m]; `damping` zeta; `turn` lower bound of k_theta [1/s], which turns
    the robot where the reference stands.
    """

    along: float
    convergence_distance: float
    damping: float
    turn: float


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
