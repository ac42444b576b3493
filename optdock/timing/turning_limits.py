"""Turning limits: how fast v^n k may change, the speed v to the power n times the curvature k of the path.

With the acceleration a and the curvature's rate r per metre

    d/dt (v^n k) = v^(n - 1) (n a k + v^2 r),

which is the yaw acceleration for n = 1, the *order* of the limit, and the lateral jerk for n = 2. Over x = v^2 the
second factor is linear in (x, x'), as a = x' / 2. Where time is stretched by c everything falls with c^(n + 1), so
quotients of these quantities and their limits are compared as their powers 2 / (n + 1): all fall with the square of c.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray
    from optdock.model.limits import MotionLimits

__all__ = ["TurningLimit", "turning_limits", "turning_ratio"]

_ORDERS = {"max_yaw_acceleration": 1, "max_lateral_jerk": 2}
_HUGE = 1e12  # stands for a larger bound: products with it stay numbers


class TurningLimit(NamedTuple):
    """A bound on how fast v^order k changes.

    Attributes:
        name: In `MotionLimits`.
        order: Power of the speed, 1 or 2.
        bound: Its value, > 0 and finite.
    """

    name: str
    order: int
    bound: float

    def ratio(self, curvature: FloatArray, rate: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
        """The quantity over its bound, to the power 2 / (order + 1). Shape (n,) as all that is given."""
        ratio: FloatArray = np.abs(self.order * a * curvature + v * v * rate) * (1.0 / self.bound)
        return ratio if self.order == 1 else np.cbrt(v * ratio) ** 2

    def slowness(self, rate: FloatArray, share: float = 1.0) -> FloatArray:
        """1 / the constant speed that uses a share of the bound at curvature rates >= 0. Shape (n,) [s/m]."""
        return self._root(rate * (1.0 / (share * self.bound)))

    def fastest(self, rate: float) -> float:
        """The constant speed that uses up the bound at a curvature rate >= 0 [m/s]."""
        if rate <= 0.0:
            return math.inf
        return math.sqrt(self.bound / rate) if self.order == 1 else math.pow(self.bound / rate, 1.0 / 3.0)

    def at_constant_speed(self, squared: FloatArray, rate: FloatArray) -> FloatArray:
        """The quantity at speeds given by their squares and at curvature rates >= 0. Shape (n,)."""
        power = squared if self.order == 1 else squared * np.sqrt(squared)
        quantity: FloatArray = rate * power
        return quantity

    def most_squared(self, bounds: FloatArray, rate: FloatArray) -> FloatArray:
        """v^2 of the constant speeds that use up other bounds than this one's at rates > 0. Shape (n,) [m^2/s^2]."""
        return bounds / rate if self.order == 1 else np.cbrt(bounds / rate) ** 2

    def bounds(self, shares: FloatArray) -> FloatArray:
        """The bound where speeds are to be smaller by the root of each share. Shape (n,)."""
        bounds: FloatArray = min(self.bound, _HUGE) * (shares if self.order == 1 else shares * np.sqrt(shares))
        return bounds

    def acceleration_beside(self, v: FloatArray, bend: FloatArray, rate: FloatArray, share: float) -> FloatArray:
        """The acceleration for which speeds up to v leave room, at curvatures and rates >= 0. Shape (n,) [m/s^2].

        A share of the room that v^2 rate leaves; infinite where the path is straight.
        """
        power, factor = (1.0, bend) if self.order == 1 else (v, 2.0 * v * bend)
        spare = (self.bound - power * (v * v) * rate) * share
        ceiling: FloatArray = np.divide(spare, factor, out=np.full(bend.size, np.inf), where=factor > 0.0)
        return ceiling

    def arc_acceleration(self, v: float, jerk: float, bend: float, share: float) -> float:
        """The acceleration that an arc of constant jerk from the speed v may reach at a curvature >= 0 [m/s^2].

        There the speed is at most v + a^2 / (2 jerk); each part of it gets half of a share of the bound.
        """
        if bend <= 0.0:
            return math.inf
        if self.order == 1:
            return share * self.bound / bend
        half = 0.5 * share * self.bound
        return min(half / (2.0 * v * bend) if v > 0.0 else math.inf, math.pow(half * jerk / bend, 1.0 / 3.0))

    def inevitable(self, v: FloatArray, curvature: FloatArray, rate: FloatArray, relief: FloatArray) -> FloatArray:
        """What no acceleration of size `relief` keeps at these speeds is above 1: v over a speed. Shape (n,).

        The sign of the acceleration is that which helps. A larger speed is above 1, too.
        """
        bend = np.abs(curvature) if self.order == 1 else 2.0 * v * np.abs(curvature)
        ratio: FloatArray = v * self._root(np.abs(rate) / (self.bound + bend * relief))
        return ratio

    def _root(self, values: FloatArray) -> FloatArray:
        root: FloatArray = np.sqrt(values) if self.order == 1 else np.cbrt(values)
        return root


def turning_limits(drive: MotionLimits) -> tuple[TurningLimit, ...]:
    """Those that are finite."""
    found = ((name, order, float(getattr(drive, name))) for name, order in _ORDERS.items())
    return tuple(TurningLimit(*limit) for limit in found if math.isfinite(limit[2]))


def turning_ratio(
    limits: tuple[TurningLimit, ...], curvature: FloatArray, rate: FloatArray, v: FloatArray, a: FloatArray
) -> FloatArray:
    """The largest of their ratios; 0 where there is none. Shape (n,) as all that is given."""
    if not limits:
        return np.zeros(v.shape)
    largest = limits[0].ratio(curvature, rate, v, a)
    for limit in limits[1:]:
        largest = np.maximum(largest, limit.ratio(curvature, rate, v, a))
    return largest
