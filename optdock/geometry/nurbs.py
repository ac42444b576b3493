"""Planar NURBS curves with unit weights and clamped, evenly spaced knots; such curves are B-splines.

`C(u) = sum_i N_i(u) P_i / sum_i N_i(u)` ([Piegl1997] eq. 4.1).
"""

from __future__ import annotations

import functools
import itertools
import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from optdock.errors import InvalidValue
from optdock.geometry.arrays import FrozenArrays, frozen_array, readonly, vector
from optdock.kernels import Kernel, twin_of

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from optdock.geometry.arrays import FloatArray, IntArray

__all__ = ["Nurbs", "shares"]


def shares(count: int) -> FloatArray:
    """Return `count` + 1 evenly spaced numbers from 0 to 1, with the values of `numpy.linspace`."""
    found = np.arange(count + 1, dtype=np.float64)
    found *= 1.0 / count
    found[-1] = 1.0
    return found


@functools.lru_cache(maxsize=16)
def _clamped_knots(count: int, degree: int) -> FloatArray:
    """Return the knots of a curve with `count` control points. Shape (count + degree + 1,)."""
    knots = np.zeros(count + degree + 1)
    knots[degree : count + 1] = shares(count - degree)
    knots[count + 1 :] = 1.0
    return readonly(knots)


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
        vars(self).update(control_points=points, degree=degree, knots=_clamped_knots(count, degree))

    @property
    def speed_bound(self) -> float:
        """Upper bound of |dC/du|: the largest norm of a control point of the derivative ([Piegl1997] eq. 3.4)."""
        knots, points, degree = self.knots.tolist(), self.control_points.tolist(), self.degree
        spans = zip(knots[1:], knots[degree + 1 : -1], itertools.pairwise(points), strict=False)
        speeds: list[float] = [degree * math.dist(a, b) / (until - since) for since, until, (a, b) in spans]
        return max(speeds)

    def points_at(self, u: ArrayLike) -> FloatArray:
        """Return the points of the curve at parameters `u`. Shape (m, 2) [m]."""
        return self._derivative(u, 0)

    def tangent_yaw_at(self, u: ArrayLike) -> FloatArray:
        """Return the direction of travel in (-pi, pi], see `poses_at`. Shape (m,) [rad]."""
        return self.poses_at(u)[:, 2]

    def poses_at(self, u: ArrayLike) -> FloatArray:
        """Return the points of the curve at parameters `u`, with the direction of travel. Shape (m, 3) [m, m, rad].

        Where the first derivative is zero, the direction follows from the second derivative, reversed at u = 1. The
        direction is NaN where both derivatives are zero.
        """
        places = vector(u)
        poses, stays = _poses_at(places, self.knots, self.control_points, self.degree)
        if stays.size:
            second = self._derivative(places[stays], 2)
            poses[stays, 2] = _directions(np.where(places[stays, None] >= 1.0, -second, second))
        return poses

    def _derivative(self, u: ArrayLike, order: int) -> FloatArray:
        """Return the derivative of that order, which is a B-spline as well."""
        knots, points, degree = self.knots, self.control_points, self.degree
        for _ in range(order):
            if degree == 0:  # the derivative of a constant
                return np.zeros((vector(u).size, 2))
            points, knots, degree = _slopes(knots, points, degree), knots[1:-1], degree - 1
        return _points_at(_clipped(u), knots, points, degree)


def _clipped(u: ArrayLike) -> FloatArray:
    return np.minimum(np.maximum(vector(u), 0.0), 1.0)


def _slopes(knots: FloatArray, points: FloatArray, degree: int) -> FloatArray:
    """Return the control points of the derivative of a B-spline ([Piegl1997] eq. 3.3), whose degree is one lower."""
    slopes: FloatArray = (
        degree * (points[1:] - points[:-1]) / (knots[degree + 1 : -1] - knots[1 : -degree - 1])[:, None]
    )
    return slopes


def _directions(heading: FloatArray) -> FloatArray:
    """Return the directions of vectors, Shape (m, 2), in (-pi, pi], and NaN for those without length. Shape (m,)."""
    yaw = np.arctan2(heading[:, 1], heading[:, 0])
    yaw[yaw == -np.pi] = np.pi
    yaw[(heading == 0.0).all(axis=1)] = np.nan
    return yaw


_KERNEL = Kernel("optdock_spline_poses", sizes=3, numbers=0)


def _poses_native(u: FloatArray, knots: FloatArray, points: FloatArray, degree: int) -> tuple[FloatArray, IntArray]:
    m, n = u.size, len(points)
    work, poses, stays = np.empty((n + degree, 2)), np.empty((m, 3)), np.empty(m, dtype=np.int64)
    arrays = (u, m), (knots, n + degree + 1), (points, 2 * n), (work, 2 * (n + degree)), (poses, 3 * m), (stays, m)
    return poses, stays[: _KERNEL((m, n, degree), (), arrays)]


@twin_of(_poses_native)
def _poses_at(u: FloatArray, knots: FloatArray, points: FloatArray, degree: int) -> tuple[FloatArray, IntArray]:
    """Return points of a B-spline of degree >= 1 at clipped parameters, with the directions of its first derivative.

    Shape (m, 3), and the rows of those where the derivative is zero, whose direction is NaN.
    """
    u = _clipped(u)
    slopes = _points_at(u, knots[1:-1], _slopes(knots, points, degree), degree - 1)
    poses = np.column_stack((_points_at(u, knots, points, degree), _directions(slopes)))
    return poses, np.isnan(poses[:, 2]).nonzero()[0]


def _points_at(u: FloatArray, knots: FloatArray, points: FloatArray, degree: int) -> FloatArray:
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
