"""Planar NURBS curves with unit weights and clamped, evenly spaced knots; such curves are B-splines.

`C(u) = sum_i N_i(u) P_i / sum_i N_i(u)` ([Piegl1997] eq. 4.1).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from optdock.errors import InvalidValue
from optdock.geometry.arrays import FrozenArrays, frozen_array, readonly

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from optdock.geometry.arrays import FloatArray

__all__ = ["Nurbs"]


@dataclass(frozen=True, eq=False)
class Nurbs(FrozenArrays):
    """A curve on [0, 1] from the first to the last control point; arguments `u` are clipped to [0, 1].

    Args:
        control_points: Shape (n, 2) [m], n > degree.
        degree: Polynomial degree, >= 1.

    Attributes:
        knots: Shape (n + degree + 1,).

    Raises:
        InvalidValue: If the points are not finite, the degree is not an integer >= 1, or there are too few points.

    >>> Nurbs([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]]).points_at(0.25).tolist()
    [[0.5, 0.0]]
    """

    control_points: FloatArray
    degree: int = 2
    knots: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        points = frozen_array(self.control_points, "nurbs.control_points", columns=2)
        if not isinstance(self.degree, int | np.integer) or self.degree < 1:
            raise InvalidValue(f"nurbs.degree: must be an integer >= 1, got {self.degree!r}")
        degree, count = int(self.degree), len(points)
        if count <= degree:
            raise InvalidValue(f"nurbs.control_points: degree {degree} needs at least {degree + 1}, got {count}")
        inner = np.linspace(0.0, 1.0, count - degree + 1)
        knots = readonly(np.concatenate((np.zeros(degree), inner, np.ones(degree))))
        vars(self).update(control_points=points, degree=degree, knots=knots)

    @property
    def speed_bound(self) -> float:
        """Upper bound of |dC/du|: the largest norm of a control point of the derivative ([Piegl1997] eq. 3.4)."""
        span = self.knots[self.degree + 1 : -1] - self.knots[1 : -self.degree - 1]
        legs = np.sqrt(np.sum(np.diff(self.control_points, axis=0) ** 2, axis=1))
        return float(np.max(self.degree * legs / span))

    def points_at(self, u: ArrayLike) -> FloatArray:
        """Return the points of the curve at parameters `u`. Shape (m, 2) [m]."""
        return self._derivatives(u, 0)[0]

    def tangent_yaw_at(self, u: ArrayLike) -> FloatArray:
        """Return the direction of travel in (-pi, pi]. Shape (m,) [rad].

        Where the first derivative is zero, the direction follows from the second derivative, reversed at u = 1. The
        result is NaN where both derivatives are zero.
        """
        heading = self._derivatives(u, 1)[1]
        still = ~np.any(heading, axis=1)
        if still.any():
            second = self._derivatives(u, 2)[2]
            at_end = np.atleast_1d(np.asarray(u, dtype=np.float64)) >= 1.0
            heading = np.where(still[:, None], np.where(at_end[:, None], -second, second), heading)
        yaw = np.arctan2(heading[:, 1], heading[:, 0])
        yaw[yaw == -np.pi] = np.pi
        yaw[~np.any(heading, axis=1)] = np.nan
        return yaw

    def _derivatives(self, u: ArrayLike, order: int) -> tuple[FloatArray, ...]:
        """Return C and its derivatives up to `order`, which are B-splines as well ([Piegl1997] eq. 3.3)."""
        at = np.clip(np.atleast_1d(np.asarray(u, dtype=np.float64)), 0.0, 1.0)
        knots, points, degree = self.knots, self.control_points, self.degree
        found = [_spline_at(at, knots, points, degree)]
        for _ in range(order):
            if degree == 0:  # the derivative of a constant
                found.append(np.zeros_like(found[0]))
                continue
            span = knots[degree + 1 : -1] - knots[1 : -degree - 1]
            points, knots, degree = degree * np.diff(points, axis=0) / span[:, None], knots[1:-1], degree - 1
            found.append(_spline_at(at, knots, points, degree))
        return tuple(found)


def _spline_at(u: FloatArray, knots: FloatArray, points: FloatArray, degree: int) -> FloatArray:
    """Return the points of a B-spline at `u` by repeated linear interpolation ([DeBoor1978] ch. X, algorithm 8)."""
    span = np.clip(np.searchsorted(knots, u, side="right") - 1, degree, len(points) - 1)[:, None]
    found = points[span + np.arange(-degree, 1)]
    for r in range(1, degree + 1):
        j = np.arange(r - degree, 1)
        left, right = knots[span + j], knots[span + j + degree + 1 - r]
        share = ((u[:, None] - left) / (right - left))[:, :, None]
        found = (1.0 - share) * found[:, :-1] + share * found[:, 1:]
    curve: FloatArray = found[:, 0]
    return curve
