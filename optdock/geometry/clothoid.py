"""Clothoid splines: curves whose curvature is piecewise linear in arc length."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from optdock.errors import InvalidValue
from optdock.geometry.arrays import FrozenArrays, frozen_array, readonly, vector
from optdock.geometry.checked import exactly, finite_number
from optdock.geometry.lazy import cached_property
from optdock.geometry.pose import Pose2, check_range
from optdock.kernels import Kernel, twin_of

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from optdock.geometry.arrays import FloatArray, IntArray

__all__ = ["QUADRATURE", "ClothoidSpline", "subdivided"]

# Five Gauss points integrate cos(theta) over a cell that turns by at most 0.5 rad with an error below 1e-15 of its
# length on an arc: error <= length * turn^10 * (5!)^4 / (11 * (10!)^3), [Abramowitz1964] eq. 25.4.30. If the curvature
# changes sign within the cell, the tenth derivative is larger, but the error stays below 1e-9 of the length.
_POINTS, _WEIGHTS = np.polynomial.legendre.leggauss(5)
QUADRATURE = readonly(np.array((1.0 + _POINTS, _WEIGHTS)))  # points from the begin of a cell, in halves of it; weights
del _POINTS, _WEIGHTS
_MAX_TURN_PER_CELL = 0.5
_MAX_CELLS = 100_000
_SPARE = 8  # rows for the table of a spline with cells that are divided; with more of them it is computed twice


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

    Attributes:
        table: Breaks between which the curve turns by at most 0.5 rad: arc length, x, y, yaw, curvature, and curvature
            rate behind. Shape (cells + 1, 6).

    Raises:
        InvalidValue: If shapes differ, knots do not increase from 0, a value is not finite, sign is not +-1, a pose
            exceeds 1e8 m or 1e6 rad, or a turn is shorter than the resolution of floats.
    """

    start: Pose2
    knots: FloatArray
    curvature: FloatArray
    sign: int = 1
    table: FloatArray = field(init=False, repr=False)

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
        table = _table_chosen(self.start, knots, curvature, int(sign))
        if not (table[1:, 0] > table[:-1, 0]).all() or not np.isfinite(table).all():
            raise InvalidValue("clothoid: turns within a distance that floats cannot resolve")
        check_range(table[:, 1:], "clothoid")
        vars(self).update(knots=knots, curvature=curvature, sign=int(sign), table=readonly(table))

    def __repr__(self) -> str:
        gear = "forward" if self.sign > 0 else "reverse"
        return f"<ClothoidSpline {self.length:.3f} m {gear} from {self.start.brief}, {self.knots.size - 1} pieces>"

    @property
    def length(self) -> float:
        """Arc length [m]."""
        return float(self.knots[-1])

    def poses_at(self, s: ArrayLike) -> FloatArray:
        """Return the poses at arc lengths `s`, Shape (n,) [m], clipped to the curve. Shape (n, 3)."""
        return _poses_chosen(vector(s), self.table, self.sign)

    @cached_property
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

    @cached_property
    def end(self) -> Pose2:
        """Pose at s = length."""
        return Pose2.from_sequence(self.table[-1, 1:4])


_TABLE = Kernel("optdock_clothoid_table", sizes=3, numbers=5)
_POSES = Kernel("optdock_clothoid_poses", sizes=2, numbers=1)


def _table_native(start: Pose2, knots: FloatArray, curvature: FloatArray, sign: int) -> FloatArray:
    n, room = knots.size, knots.size + _SPARE
    numbers = start.x, start.y, start.yaw, float(sign), _MAX_TURN_PER_CELL
    while True:
        table = np.empty((room, 6))
        arrays = (knots, n), (curvature, n), (QUADRATURE, QUADRATURE.size), (table, 6 * room)
        found = _TABLE((n, room, _MAX_CELLS), numbers, arrays)
        if found < 0:
            return _table_numpy(start, knots, curvature, sign)  # raises the error
        if found <= room:
            return table[:found]
        room = found


@twin_of(_table_native)
def _table_chosen(start: Pose2, knots: FloatArray, curvature: FloatArray, sign: int) -> FloatArray:
    return _table_numpy(start, knots, curvature, sign)


def _table_numpy(start: Pose2, knots: FloatArray, curvature: FloatArray, sign: int) -> FloatArray:
    """Return s, x, y, yaw, curvature at the breaks and the curvature rate behind. Shape (cells + 1, 6)."""
    breaks = _refined_breaks(knots, curvature)
    table = np.zeros((breaks.size, 6))
    s, x, y, yaw, kappa, rate = table.T
    s[:] = breaks
    kappa[:] = np.interp(breaks, knots, curvature)
    steps = breaks[1:] - breaks[:-1]
    with np.errstate(all="ignore"):  # what cannot be represented is rejected by the caller
        rate[:-1] = (kappa[1:] - kappa[:-1]) / steps
        (0.5 * steps * (kappa[:-1] + kappa[1:])).cumsum(out=yaw[1:])
        yaw += start.yaw
        along, across = _displacements(steps, table[:-1])
        (sign * along).cumsum(out=x[1:])
        (sign * across).cumsum(out=y[1:])
    x += start.x
    y += start.y
    return table


def _poses_native(s: FloatArray, table: FloatArray, sign: int) -> FloatArray:
    points, poses = np.ascontiguousarray(s), np.empty((s.size, 3))
    arrays = (points, s.size), (table, table.size), (QUADRATURE, QUADRATURE.size), (poses, poses.size)
    _POSES((s.size, len(table)), (float(sign),), arrays)
    return poses


@twin_of(_poses_native)
def _poses_chosen(s: FloatArray, table: FloatArray, sign: int) -> FloatArray:
    """Return the poses at arc lengths, clipped to the spline."""
    points, poses = np.minimum(np.maximum(s, 0.0), table[-1, 0]), np.empty((s.size, 3))
    base = table[table[1:-1, 0].searchsorted(points, side="right")]
    step = points - base[:, 0]
    along, across = _displacements(step, base)
    poses[:, 0] = base[:, 1] + sign * along
    poses[:, 1] = base[:, 2] + sign * across
    poses[:, 2] = base[:, 3] + step * (base[:, 4] + 0.5 * step * base[:, 5])
    return poses


def _displacements(step: FloatArray, base: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the integrals of the cosine and the sine of the quadratic heading over each step, Shape (n,) [m] each.

    `base`: rows of the table where the steps begin, Shape (n, 6).
    """
    places, weights = QUADRATURE[:, :, None]
    half = 0.5 * step
    u = half * places
    theta = base[:, 3] + u * (base[:, 4] + 0.5 * u * base[:, 5])
    # The sum over the first axis is evaluated in its order, as in C.
    along: FloatArray = half * np.add.reduce(weights * np.cos(theta), axis=0)
    across: FloatArray = half * np.add.reduce(weights * np.sin(theta), axis=0)
    return along, across
