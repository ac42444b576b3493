"""Clothoid splines: curves whose curvature is piecewise linear in arc length."""

from __future__ import annotations

import functools
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from optdock.errors import InvalidValue
from optdock.geometry.arrays import FrozenArrays, frozen_array, readonly, vector
from optdock.geometry.checked import exactly, finite_number
from optdock.geometry.pose import Pose2, check_range

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from optdock.geometry.arrays import FloatArray, IntArray

__all__ = ["ClothoidSpline", "subdivided"]

# Five Gauss points integrate cos(theta) over a cell that turns by at most 0.5 rad with an error below 1e-15 of its
# length on an arc: error <= length * turn^10 * (5!)^4 / (11 * (10!)^3), [Abramowitz1964] eq. 25.4.30. If the curvature
# changes sign within the cell, the tenth derivative is larger, but the error stays below 1e-9 of the length.
_NODES, _WEIGHTS = map(readonly, np.polynomial.legendre.leggauss(5))
_PLACES = readonly(1.0 + _NODES)  # in halves of a cell
_MAX_TURN_PER_CELL = 0.5
_MAX_CELLS = 100_000


def _refined_breaks(knots: FloatArray, curvature: FloatArray) -> FloatArray:
    """Return the knots with additional knots, such that no cell turns by more than `_MAX_TURN_PER_CELL`."""
    size = np.abs(curvature)
    turn = (knots[1:] - knots[:-1]) * np.maximum(size[:-1], size[1:])
    if turn.max() <= _MAX_TURN_PER_CELL and turn.size <= _MAX_CELLS:
        return knots
    parts = np.ceil(np.minimum(np.maximum(turn / _MAX_TURN_PER_CELL, 1.0), _MAX_CELLS + 1.0)).astype(np.int64)
    if parts.sum() > _MAX_CELLS:
        raise InvalidValue(f"clothoid: turns by {turn.sum():.3g} rad in all, more than can be evaluated")
    return subdivided(knots, parts)


def subdivided(knots: FloatArray, parts: IntArray) -> FloatArray:
    """Return knots, Shape (n + 1,), with interval i divided into parts[i] equal parts."""
    owner = np.arange(parts.size).repeat(parts)
    rank = np.arange(owner.size) - (parts.cumsum() - parts)[owner]
    found = np.empty(owner.size + 1)
    found[:-1] = knots[owner] + (knots[1:] - knots[:-1])[owner] * rank / parts[owner]
    found[-1] = knots[-1]
    return found


@dataclass(frozen=True, eq=False, repr=False)
class ClothoidSpline(FrozenArrays):
    """A drivable curve: `yaw'(s) = curvature(s)`, `(x, y)'(s) = direction * (cos yaw, sin yaw)`.

    `s` is the travelled distance, so a left turn has positive curvature in both gears. Curvature is linear between
    knots. Positions are integrated by Gauss quadrature with an error below 1e-9 of the length.

    Args:
        start: Pose at s = 0.
        knots: Shape (n,) [m], n >= 2, first 0, strictly increasing.
        curvature: Shape (n,) [1/m], curvature at the knots.
        sign: +1 forward, -1 reverse.

    Raises:
        InvalidValue: If shapes differ, knots do not increase from 0, a value is not finite, sign is not +-1, a pose
            exceeds 1e8 m or 1e6 rad, or a turn is shorter than the resolution of floats.
    """

    start: Pose2
    knots: FloatArray
    curvature: FloatArray
    sign: int = 1
    _breaks: FloatArray = field(init=False, repr=False)
    _break_states: FloatArray = field(init=False, repr=False)  # (cells + 1, 4): x, y, yaw, curvature

    def __post_init__(self) -> None:
        knots = frozen_array(self.knots, "clothoid.knots")
        curvature = frozen_array(self.curvature, "clothoid.curvature")
        if knots.size < 2 or knots.size != curvature.size:
            raise InvalidValue(f"clothoid: needs >= 2 knots, each with a curvature, got {knots.size}, {curvature.size}")
        if knots[0] != 0.0 or not (knots[1:] > knots[:-1]).all():
            raise InvalidValue("clothoid.knots: must start at 0 and increase strictly")
        sign = finite_number(self.sign, "clothoid.sign")
        if sign not in (1.0, -1.0):
            raise InvalidValue(f"clothoid.sign: must be 1 or -1, got {self.sign}")
        exactly(Pose2, self.start, "clothoid.start")
        breaks = _refined_breaks(knots, curvature)
        if breaks is not knots and not (breaks[1:] > breaks[:-1]).all():
            raise InvalidValue("clothoid: turns within a distance that floats cannot resolve")
        vars(self).update(knots=knots, curvature=curvature, sign=int(sign), _breaks=readonly(breaks))
        with np.errstate(over="ignore", invalid="ignore"):
            states = self._integrate_breaks()
        if not np.isfinite(states).all():
            raise InvalidValue("clothoid: turns within a distance that floats cannot resolve")
        check_range(states, "clothoid")
        vars(self).update(_break_states=readonly(states))

    def _integrate_breaks(self) -> FloatArray:
        breaks, states = self._breaks, np.zeros((self._breaks.size, 4))
        is_refined = breaks.size > self.knots.size
        kappa = np.interp(breaks, self.knots, self.curvature) if is_refined else self.curvature
        steps, before = breaks[1:] - breaks[:-1], kappa[:-1]
        x, y, yaw, _ = states.T
        (0.5 * steps * (before + kappa[1:])).cumsum(out=yaw[1:])
        yaw += self.start.yaw
        along, across = _displacements(steps, yaw[:-1], before, (kappa[1:] - before) / steps)
        (self.sign * along).cumsum(out=x[1:])
        (self.sign * across).cumsum(out=y[1:])
        x += self.start.x
        y += self.start.y
        states[:, 3] = kappa
        return states

    def __repr__(self) -> str:
        gear = "forward" if self.sign > 0 else "reverse"
        return f"<ClothoidSpline {self.length:.3f} m {gear} from {self.start.brief}, {self.knots.size - 1} pieces>"

    @property
    def length(self) -> float:
        """Arc length [m]."""
        return float(self.knots[-1])

    def poses_at(self, s: ArrayLike) -> FloatArray:
        """Return the poses at arc lengths `s`, Shape (n,) [m], clipped to the curve. Shape (n, 3)."""
        points = np.minimum(np.maximum(vector(s), 0.0), self.length)
        cell = self._breaks[1:-1].searchsorted(points, side="right")
        base, step = self._break_states[cell], points - self._breaks[cell]
        rate, poses = self._cell_rates[cell], np.empty((points.size, 3))
        x, y = _displacements(step, base[:, 2], base[:, 3], rate)
        poses[:, 0] = base[:, 0] + self.sign * x
        poses[:, 1] = base[:, 1] + self.sign * y
        poses[:, 2] = base[:, 2] + step * (base[:, 3] + 0.5 * step * rate)
        return poses

    @functools.cached_property
    def _cell_rates(self) -> FloatArray:
        kappa, breaks = self._break_states[:, 3], self._breaks
        return readonly((kappa[1:] - kappa[:-1]) / (breaks[1:] - breaks[:-1]))

    @functools.cached_property
    def curvature_rates(self) -> FloatArray:
        """Curvature rate d curvature / ds between the knots, Shape (n - 1,) [1/m^2]."""
        curvature, knots = self.curvature, self.knots
        return readonly((curvature[1:] - curvature[:-1]) / (knots[1:] - knots[:-1]))

    def curvature_at(self, s: ArrayLike) -> FloatArray:
        """Return the curvature at arc lengths `s`, Shape (n,) [1/m]."""
        return np.interp(vector(s), self.knots, self.curvature)

    def curvature_rate_at(self, s: ArrayLike) -> FloatArray:
        """Return d curvature / ds at `s`, Shape (n,) [1/m^2]; right-sided at knots, left-sided at the end."""
        piece = self.knots[1:-1].searchsorted(vector(s), side="right")
        rates: FloatArray = self.curvature_rates[piece]
        return rates

    def piece(self, begin: float, end: float) -> ClothoidSpline:
        """Return the piece from arc length `begin` to `end` [m], 0 <= begin < end <= length; its `s` starts at 0."""
        inside = self.knots[(self.knots > begin) & (self.knots < end)]
        knots = np.concatenate(([begin], inside, [end]))
        start = self.start if begin == 0.0 else Pose2.from_sequence(self.poses_at(begin)[0])
        return ClothoidSpline(start, knots - begin, self.curvature_at(knots), self.sign)

    @functools.cached_property
    def end(self) -> Pose2:
        """Pose at s = length."""
        return Pose2.from_sequence(self._break_states[-1, :3])


def _displacements(
    step: FloatArray, yaw: FloatArray, curvature: FloatArray, rate: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the integrals of the cosine and the sine of the quadratic heading over each step, Shape (n,) [m] each."""
    half = 0.5 * step
    u = half[:, None] * _PLACES
    theta = yaw[:, None] + u * (curvature[:, None] + 0.5 * u * rate[:, None])
    return half * (np.cos(theta) @ _WEIGHTS), half * (np.sin(theta) @ _WEIGHTS)
