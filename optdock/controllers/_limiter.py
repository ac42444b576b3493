"""Acceleration limits on the stream of commands."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from optdock.geometry.pose import Twist2

if TYPE_CHECKING:
    from optdock.limits import MotionLimits

__all__ = ["rate_limited"]


def rate_limited(previous: Twist2, wanted: Twist2, limits: MotionLimits, period: float) -> Twist2:
    """The command nearest to `wanted` that `previous` can become within `period` [s].

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
        braked = _approach(value, 0.0, rise, fall)
        left = 1.0 - abs(value) / fall if math.isfinite(fall) else 1.0
        return braked if left <= 0.0 else _approach(0.0, target, rise * left, fall)
    bound = rise if abs(target) > abs(value) else fall
    return value + min(max(target - value, -bound), bound)
