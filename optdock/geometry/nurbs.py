"""Non-uniform rational B-splines in the plane.

`C(u) = sum_i N_i(u) w_i P_i / sum_i N_i(u) w_i`, evaluated as a B-spline of the homogeneous points `(w x, w y, w)`
and divided out ([Piegl1997] ch. 4).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from optdock.errors import InvalidValue
from optdock.geometry.arrays import FrozenArrays, frozen_array, readonly

if TYPE_CHECKING:
    from numpy.typing import ArrayLike
    from scipy.interpolate import BSpline

    from optdock.geometry.arrays import FloatArray

__all__ = ["Nurbs", "clamped_knots"]


def clamped_knots(num_points: int, degree: int) -> FloatArray:
    """Knots on [0, 1] that make a curve begin and end at its outer control points, evenly spaced inside.

    >>> clamped_knots(3, 2).tolist()
    [0.0, 0.0, 0.0, 1.0, 1.0, 1.0]
    """
    inner = np.linspace(0.0, 1.0, num_points - degree + 1)
    return np.concatenate((np.zeros(degree), inner, np.ones(degree)))


@dataclass(frozen=True, eq=False)
class Nurbs(FrozenArrays):
    """A NURBS curve; arguments `u` are clipped to its domain.

    Args:
        control_points: Shape (n, 2) [m], n > degree.
        weights: Shape (n,), all > 0; None means all 1.
        degree: Polynomial degree, >= 1.
        knots: Shape (n + degree + 1,), never decreasing; None means clamped and evenly spaced on [0, 1].

    Raises:
        InvalidValue: A shape, weight or knot breaks these rules, or a knot inside the domain is repeated more than
            `degree` times (the curve would tear).

    >>> Nurbs([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]]).points_at(0.25).tolist()
    [[0.5, 0.0]]
    """

    control_points: FloatArray
    weights: FloatArray = None  # type: ignore[assignment]  # None is replaced below: the attribute is never None
    degree: int = 2
    knots: FloatArray = None  # type: ignore[assignment]  # likewise

    def __post_init__(self) -> None:
        points = frozen_array(self.control_points, "nurbs.control_points", columns=2)
        if not isinstance(self.degree, int | np.integer) or self.degree < 1:
            raise InvalidValue(f"nurbs.degree: must be an integer >= 1, got {self.degree!r}")
        if len(points) <= self.degree:
            raise InvalidValue(
                f"nurbs.control_points: degree {self.degree} needs at least {self.degree + 1}, got {len(points)}"
            )
        weights = np.ones(len(points)) if self.weights is None else self.weights
        knots = clamped_knots(len(points), self.degree) if self.knots is None else self.knots
        object.__setattr__(self, "control_points", points)
        object.__setattr__(self, "degree", int(self.degree))
        object.__setattr__(self, "weights", _checked_weights(weights, len(points)))
        object.__setattr__(self, "knots", _checked_knots(knots, len(points), self.degree))

    @property
    def domain(self) -> tuple[float, float]:
        """First and last `u` of the curve."""
        return float(self.knots[self.degree]), float(self.knots[len(self.control_points)])

    @property
    def is_polynomial(self) -> bool:
        """Whether all weights are equal, so that the curve is a plain B-spline."""
        return bool(np.all(self.weights == self.weights[0]))

    @property
    def speed_bound(self) -> float:
        """An upper bound of |dC/du|, exact at the ends of a clamped polynomial curve.

        Polynomial: the derivative is a B-spline and stays in the hull of its control points ([Piegl1997] eq. 3.4).
        Rational: |C'| <= max |A_i'| spread over the smallest denominator, which is safe but not tight.
        """
        span = self.knots[self.degree + 1 : -1] - self.knots[1 : -self.degree - 1]
        if self.is_polynomial:
            return float(np.max(_scaled_legs(self.control_points, span, self.degree)))
        # About any origin: C' = (A' - w' C) / w; the middle of the control box keeps |C| small.
        local = self.control_points - 0.5 * (self.control_points.min(axis=0) + self.control_points.max(axis=0))
        numerator = np.max(_scaled_legs(local * self.weights[:, None], span, self.degree))
        denominator = np.max(_scaled_legs(self.weights[:, None], span, self.degree))
        reach = float(np.max(np.hypot(local[:, 0], local[:, 1])))
        return float((numerator + denominator * reach) / self.weights.min())

    def points_at(self, u: ArrayLike) -> FloatArray:
        """Points of the curve. Shape (m, 2) [m]."""
        return self._derivatives(u, 0)[0]

    def derivative_at(self, u: ArrayLike, order: int = 1) -> FloatArray:
        """D^order C / du^order; at a knot where it jumps, the value to the right. Shape (m, 2) [m].

        Raises:
            InvalidValue: `order` is neither 1 nor 2.
        """
        if order not in (1, 2):
            raise InvalidValue(f"nurbs: the order of a derivative must be 1 or 2, got {order}")
        return self._derivatives(u, order)[order]

    def curvature_at(self, u: ArrayLike) -> FloatArray:
        """Signed curvature, left turn positive; NaN where the curve stands still. Shape (m,) [1/m]."""
        _, first, second = self._derivatives(u, 2)
        speed = np.hypot(first[:, 0], first[:, 1])
        cross = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
        moving = speed > 0.0
        curvature: FloatArray = np.full(speed.size, np.nan)
        # Dividing by the speed three times does not underflow where its cube would.
        np.divide(cross, speed, out=curvature, where=moving)
        curvature[moving] = curvature[moving] / speed[moving] / speed[moving]
        return curvature

    def tangent_yaw_at(self, u: ArrayLike) -> FloatArray:
        """Direction of travel in (-pi, pi]; NaN where neither first nor second derivative shows one. Shape (m,) [rad].

        Where the curve stands still the second derivative is the direction in which it leaves, and at the end of the
        domain the opposite of the one in which it arrives.
        """
        heading = self._derivatives(u, 1)[1]
        still = ~np.any(heading, axis=1)
        if still.any():
            second = self._derivatives(u, 2)[2]
            at_end = np.atleast_1d(np.asarray(u, dtype=np.float64)) >= self.domain[1]
            heading = np.where(still[:, None], np.where(at_end[:, None], -second, second), heading)
        yaw = np.arctan2(heading[:, 1], heading[:, 0])
        yaw[yaw == -np.pi] = np.pi
        yaw[~np.any(heading, axis=1)] = np.nan
        return yaw

    @property
    def _homogeneous_points(self) -> FloatArray:
        return np.column_stack((self.control_points * self.weights[:, None], self.weights))

    @cached_property
    def _spline(self) -> BSpline:
        from scipy.interpolate import BSpline

        return BSpline(self.knots, self._homogeneous_points, self.degree, extrapolate=False)

    def _derivatives(self, u: ArrayLike, order: int) -> tuple[FloatArray, ...]:
        """C and its derivatives up to `order`, by the quotient rule ([Piegl1997] eq. 4.8)."""
        at = np.clip(np.atleast_1d(np.asarray(u, dtype=np.float64)), *self.domain)
        a: list[FloatArray] = [self._spline(at, nu) for nu in range(order + 1)]
        w = a[0][:, 2:]
        found = [a[0][:, :2] / w]
        if order >= 1:
            found.append((a[1][:, :2] - a[1][:, 2:] * found[0]) / w)
        if order >= 2:
            found.append((a[2][:, :2] - 2.0 * a[1][:, 2:] * found[1] - a[2][:, 2:] * found[0]) / w)
        return tuple(found)


def _scaled_legs(points: FloatArray, span: FloatArray, degree: int) -> FloatArray:
    """Lengths of the derivative's control points; legs over an empty knot span carry no curve."""
    legs = np.sqrt(np.sum(np.diff(points, axis=0) ** 2, axis=1))
    return np.where(span > 0.0, degree * legs / np.where(span > 0.0, span, 1.0), 0.0)


def _checked_weights(values: ArrayLike, count: int) -> FloatArray:
    weights = frozen_array(values, "nurbs.weights")
    if weights.size != count:
        raise InvalidValue(f"nurbs.weights: must be one per control point = {count}, got {weights.size}")
    if not np.all(weights > 0.0):
        raise InvalidValue(f"nurbs.weights: must be > 0, got {weights.min()}")
    return weights


def _checked_knots(values: ArrayLike, count: int, degree: int) -> FloatArray:
    knots = frozen_array(values, "nurbs.knots")
    wanted = count + degree + 1
    if knots.size != wanted:
        raise InvalidValue(f"nurbs.knots: must be control points + degree + 1 = {wanted} values, got {knots.size}")
    if np.any(np.diff(knots) < 0.0):
        raise InvalidValue(f"nurbs.knots: must never decrease, got {knots.tolist()}")
    if not knots[degree] < knots[count]:
        raise InvalidValue(f"nurbs.knots: the domain [knots[degree], knots[n]] is empty at {knots[degree]}")
    inner = knots[(knots > knots[degree]) & (knots < knots[count])]
    repeated = inner[degree:] == inner[:-degree]
    if np.any(repeated):
        raise InvalidValue(f"nurbs.knots: {inner[degree:][repeated][0]} is repeated more than degree = {degree} times")
    return readonly(knots)
