"""Turning limits: bounds on d/dt (v^n k), the speed v to the power n times the curvature k of the path.

With the acceleration a and the curvature's rate r per metre

    d/dt (v^n k) = v^(n - 1) (n a k + v^2 r),

which is the yaw acceleration for n = 1, the *order* of the limit, and the lateral jerk for n = 2. With x = v^2, the
second factor is linear in x and x', because a = x' / 2. Stretching time by c divides the quantity by c^(n + 1). The
ratio of a quantity to its limit is therefore raised to the power 2 / (n + 1), so that a stretch by c divides all ratios
by c^2.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray
    from optdock.model.limits import MotionLimits

__all__ = ["TurningLimit", "turning_limits", "turning_ratio"]

_HUGE = 1e12  # replaces a larger bound, so that products with it do not overflow


class TurningLimit(NamedTuple):
    """Bound on d/dt (v^order k)."""

    name: str  # name in `MotionLimits`
    order: int  # power of the speed, 1 or 2
    bound: float  # value of the bound, > 0 and finite

    def ratio(self, curvature: FloatArray, rate: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
        """Return the ratio of quantity to bound, to the power 2 / (order + 1). Shape (n,), as for all arguments."""
        ratio: FloatArray = np.abs(self.order * a * curvature + v * v * rate) * (1.0 / self.bound)
        return ratio if self.order == 1 else np.cbrt(v * ratio) ** 2

    def slowness(self, rate: FloatArray, share: float = 1.0) -> FloatArray:
        """Return the reciprocal of the constant speed that uses a share of the bound; rates >= 0. Shape (n,) [s/m]."""
        return self._root(rate * (1.0 / (share * self.bound)))

    def fastest(self, rate: float) -> float:
        """Return the constant speed [m/s] at which the quantity reaches its bound, for a curvature rate >= 0."""
        if rate <= 0.0:
            return math.inf
        return math.sqrt(self.bound / rate) if self.order == 1 else math.pow(self.bound / rate, 1.0 / 3.0)

    def at_constant_speed(self, squared: FloatArray, rate: FloatArray) -> FloatArray:
        """Return the quantity for squared speeds and curvature rates >= 0. Shape (n,)."""
        power = squared if self.order == 1 else squared * np.sqrt(squared)
        quantity: FloatArray = rate * power
        return quantity

    def most_squared(self, bounds: FloatArray, rate: FloatArray) -> FloatArray:
        """Return v^2 of the constant speeds that reach the given bounds at rates > 0. Shape (n,) [m^2/s^2]."""
        return bounds / rate if self.order == 1 else np.cbrt(bounds / rate) ** 2

    def bounds(self, shares: FloatArray) -> FloatArray:
        """Return the bounds that reduce the constant speeds by the square root of each share. Shape (n,)."""
        bounds: FloatArray = min(self.bound, _HUGE) * (shares if self.order == 1 else shares * np.sqrt(shares))
        return bounds

    def acceleration_beside(self, v: FloatArray, bend: FloatArray, rate: FloatArray, share: float) -> FloatArray:
        """Return the largest acceleration for speeds up to v, curvatures >= 0 and rates >= 0. Shape (n,) [m/s^2].

        The acceleration uses a share of the bound less v^2 rate; it is infinite on a straight line.
        """
        power, factor = (1.0, bend) if self.order == 1 else (v, 2.0 * v * bend)
        spare = (self.bound - power * (v * v) * rate) * share
        with np.errstate(over="ignore"):  # on a nearly straight line
            ceiling: FloatArray = np.divide(spare, factor, out=np.full(bend.size, np.inf), where=factor > 0.0)
        return ceiling

    def arc_acceleration(self, v: float, jerk: float, bend: float, share: float) -> float:
        """Return the largest acceleration [m/s^2] during a phase of constant jerk that begins at speed v.

        `bend`: curvature >= 0. During the phase, the speed is at most v + a^2 / (2 jerk). Each of these two terms may
            use half of the given share of the bound.
        """
        if bend <= 0.0:
            return math.inf
        if self.order == 1:
            return share * self.bound / bend
        half = 0.5 * share * self.bound
        return min(half / (2.0 * v * bend) if v > 0.0 else math.inf, math.pow(half * jerk / bend, 1.0 / 3.0))

    def inevitable(self, v: FloatArray, curvature: FloatArray, rate: FloatArray, relief: FloatArray) -> FloatArray:
        """Return v divided by the largest speed at which an acceleration of size `relief` meets the limit. Shape (n,).

        The acceleration has the favourable sign. If the ratio is above 1, the limit is violated at v and at any larger
        speed.
        """
        bend = np.abs(curvature) if self.order == 1 else 2.0 * v * np.abs(curvature)
        ratio: FloatArray = v * self._root(np.abs(rate) / (self.bound + bend * relief))
        return ratio

    def _root(self, values: FloatArray) -> FloatArray:
        root: FloatArray = np.sqrt(values) if self.order == 1 else np.cbrt(values)
        return root


def turning_limits(drive: MotionLimits) -> tuple[TurningLimit, ...]:
    """Return the finite turning limits."""
    found: tuple[TurningLimit, ...] = ()
    if drive.max_yaw_acceleration < math.inf:
        found += (TurningLimit("max_yaw_acceleration", 1, drive.max_yaw_acceleration),)
    if drive.max_lateral_jerk < math.inf:
        found += (TurningLimit("max_lateral_jerk", 2, drive.max_lateral_jerk),)
    return found


def turning_ratio(
    limits: tuple[TurningLimit, ...], curvature: FloatArray, rate: FloatArray, v: FloatArray, a: FloatArray
) -> FloatArray:
    """Return the largest ratio of all limits, or 0 if there are none. Shape (n,), as for all arguments."""
    largest: FloatArray = np.zeros(v.shape)
    for limit in limits:
        largest = np.maximum(largest, limit.ratio(curvature, rate, v, a))
    return largest
