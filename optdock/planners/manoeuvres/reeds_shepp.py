"""Reeds-Shepp words: candidates for the shortest path of a car that can reverse.

The shortest path with bounded curvature and any number of cusps is one of 48 words of at most five arcs and straight
lines (`L+R-L-` and so on), as proven in [ReedsShepp1990]. The words have eleven closed forms, each with four mirrors:
time reversal, reflection, both, or none. In words of three arcs the sign of the last arc is free, so 44 forms contain
all 48 words. The forms are evaluated for many pairs of poses at once, with the trigonometric functions of the C
library, as in `connections_kernel.c`.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.geometry.arrays import readonly

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import TypeAlias

    from optdock.geometry.arrays import BoolArray, FloatArray

    # Where there is a solution, Shape (1 or 2, 4, n), and the lengths of its arcs, which are broadcast to that shape.
    _Solution: TypeAlias = tuple[FloatArray | BoolArray | float, ...]

__all__ = ["TURNS", "reeds_shepp_words"]

_HALF_PI = 0.5 * np.pi
_ROUNDING = 1e-10  # [rad]: tolerance of the sign of an arc
# The four mirrors: identity, time reversal, reflection, both.
_MIRROR_X, _MIRROR_Y = (
    readonly(np.array([[1.0], [-1.0], [1.0], [-1.0]])),
    readonly(np.array([[1.0], [1.0], [-1.0], [-1.0]])),
)


def reeds_shepp_words(starts: FloatArray, goals: FloatArray, radius: float) -> FloatArray:
    """Return the signed lengths of all words between pairs of poses, Shape (n, 3) each; `TURNS` lists the steering.

    Args:
        starts: Start poses.
        goals: Goal poses.
        radius: Turning radius of all arcs [m].

    Returns:
        Shape (44, n, 5) [m]; NaN if a form has no solution.
    """
    same, other = _centres(starts, goals, radius)
    n, row = len(starts), 0
    # With the arcs along the first axis, all operations run over contiguous memory.
    found, valid = np.zeros((5, len(_TURNS), 4, n)), np.empty((len(_TURNS), 4, n), dtype=np.bool_)
    for form in _FORMS:
        rows = slice(row, row + len(form.turns))
        valid[rows], *parts = form.solve(same if form.is_same else other)
        for k, part in enumerate(parts):
            found[k, rows] = part
        if form.is_backward:  # the solution back from the goal begins with the last arc
            found[: len(parts), row + 1] = found[len(parts) - 1 :: -1, row + 1].copy()
        row = rows.stop
    found *= _MIRROR_X * radius
    np.copyto(found, np.nan, where=~valid)
    return np.moveaxis(found.reshape(5, 4 * len(_TURNS), n), 0, 2)


class _Centres(NamedTuple):
    """Vectors from the centre of the first arc, a left turn, to the centre of the last one, in turning radii.

    `phi`: change of heading, Shape (4, n) for four mirrors and n pairs of poses. `squared`: square of the length of the
    vector; `tangent`, `slope`: length of the line that touches two opposite circles, and its angle to the vector, Shape
    (4, n). `apart`, `bearing`: length and direction of the vector from the start to the goal, and of that back from the
    goal to the start, Shape (2, 4, n).
    """

    phi: FloatArray
    squared: FloatArray
    tangent: FloatArray
    slope: FloatArray
    apart: FloatArray
    bearing: FloatArray


def _by_elements(function: Callable[..., float], *arguments: FloatArray) -> FloatArray:
    """Return the values of a function of the C library, whose last bits may differ from those of NumPy's."""
    values = list(map(function, *(argument.ravel().tolist() for argument in arguments)))
    return np.array(values, dtype=np.float64).reshape(arguments[0].shape)


def _centres(starts: FloatArray, goals: FloatArray, radius: float) -> tuple[_Centres, _Centres]:
    """Return the vectors for a last arc that is driven to the left, and for one to the right."""
    dx, dy = (goals[:, :2] - starts[:, :2]).T / radius
    phi = goals[:, 2] - starts[:, 2]
    (c0, c), (s0, s) = (_by_elements(by, np.stack((starts[:, 2], phi))) for by in (math.cos, math.sin))
    x, y = c0 * dx + s0 * dy, c0 * dy - s0 * dx
    turned, reflection = _MIRROR_X * _MIRROR_Y * phi, _MIRROR_Y[::2]
    left = reflection * y - 1.0
    same = _one_way(x - reflection * s, left + c, turned)
    other = _one_way(x + reflection * s, left - c, turned)
    reflected = [2, 3, 0, 1]
    return (
        same._replace(
            apart=np.concatenate((same.apart, same.apart)),
            bearing=np.concatenate((same.bearing, turned - same.bearing)),
        ),
        other._replace(
            apart=np.concatenate((other.apart, other.apart[:, reflected])),
            bearing=np.concatenate((other.bearing, other.bearing[:, reflected] + turned)),
        ),
    )


def _one_way(xi: FloatArray, eta: FloatArray, turned: FloatArray) -> _Centres:
    """Return the vectors with components of Shape (2, n), without and with reflection, and their time reversals."""
    squared, bearing = xi * xi + eta * eta, _by_elements(math.atan2, eta, xi)
    tangent = np.sqrt(np.maximum(squared - 4.0, 0.0))
    slope = _by_elements(math.atan2, np.full_like(tangent, 2.0), tangent)
    squared, tangent, slope = (part.repeat(2, axis=0) for part in (squared, tangent, slope))
    bearing = np.stack((bearing, np.pi - bearing), axis=1).reshape(4, -1)
    return _Centres(turned, squared, tangent, slope, np.sqrt(squared)[None], bearing[None])


def _within_half_turn(angle: FloatArray) -> FloatArray:
    folded: FloatArray = angle - 2.0 * np.pi * np.rint(angle / (2.0 * np.pi))
    return folded


def _left_straight_left(to: _Centres) -> _Solution:
    """L+S+L+, equation 8.1."""
    t = _within_half_turn(to.bearing[:1])
    v = _within_half_turn(to.phi - t)
    return (t >= -_ROUNDING) & (v >= -_ROUNDING), t, to.apart[:1], v


def _left_straight_right(to: _Centres) -> _Solution:
    """L+S+R+, equation 8.2."""
    t = _within_half_turn(to.bearing[:1] + to.slope)
    v = _within_half_turn(t - to.phi)
    return (to.squared >= 4.0) & (t >= -_ROUNDING) & (v >= -_ROUNDING), t, to.tangent, v


def _left_right_left(to: _Centres) -> _Solution:
    """L+R-L, with the last arc in either gear, equations 8.3 and 8.4."""
    u = -2.0 * _by_elements(math.asin, np.minimum(0.25 * to.apart[0, ::2], 1.0)).repeat(2, axis=0)
    t = _within_half_turn(to.bearing + 0.5 * u + np.pi)
    v = _within_half_turn(to.phi - t + u)
    return (to.apart <= 4.0) & (t >= -_ROUNDING), t, u, v


def _four_arcs(to: _Centres) -> _Solution:
    """L+R+L-R- with one cusp, equation 8.7, and L+R-L-R+ with two cusps, equation 8.8."""
    rho, other = 0.25 * (2.0 + to.apart[0]), (20.0 - to.squared) / 16.0
    kept = np.minimum(np.maximum(other[::2], 0.0), 1.0)
    once, twice = _by_elements(math.acos, np.stack((np.minimum(rho[::2], 1.0), kept))).repeat(2, axis=1)
    towards = _by_elements(math.atan2, kept - 2.0, -np.sqrt(1.0 - kept * kept)).repeat(2, axis=0)
    t = _within_half_turn(np.stack((to.bearing[0] + once + _HALF_PI, to.bearing[0] - towards)))
    v = _within_half_turn(np.stack((t[0] - once - once - to.phi, t[1] - to.phi)))
    valid = np.stack(((rho <= 1.0) & (v[0] <= _ROUNDING), (other >= 0.0) & (other <= 1.0) & (v[1] >= -_ROUNDING)))
    return valid & (t >= -_ROUNDING), t, np.stack((once, -twice)), np.stack((-once, -twice)), v


def _quarter_turn_then_left(to: _Centres) -> _Solution:
    """L+R-S-L- with a quarter turn of R, equation 8.9."""
    t = _within_half_turn(to.bearing + to.slope + _HALF_PI)
    u, v = 2.0 - to.tangent, _within_half_turn(to.phi - _HALF_PI - t)
    return (to.apart >= 2.0) & (t >= -_ROUNDING) & (u <= _ROUNDING) & (v <= _ROUNDING), t, -_HALF_PI, u, v


def _quarter_turn_then_right(to: _Centres) -> _Solution:
    """L+R-S-R- with a quarter turn of R, equation 8.10."""
    t, u = _within_half_turn(to.bearing + _HALF_PI), 2.0 - to.apart
    v = _within_half_turn(t + _HALF_PI - to.phi)
    return (to.apart >= 2.0) & (t >= -_ROUNDING) & (u <= _ROUNDING) & (v <= _ROUNDING), t, -_HALF_PI, u, v


def _two_quarter_turns(to: _Centres) -> _Solution:
    """L+R-S-L-R+ with quarter turns before and after the straight line, equation 8.11."""
    t = _within_half_turn(to.bearing[:1] + to.slope + _HALF_PI)
    u, v = 4.0 - to.tangent, _within_half_turn(t - to.phi)
    valid = (to.apart[:1] >= 2.0) & (u <= _ROUNDING) & (t >= -_ROUNDING) & (v >= -_ROUNDING)
    return valid, t, -_HALF_PI, u, -_HALF_PI, v


class _Form(NamedTuple):
    """A closed form.

    `turns`: steering of the arcs as driven, for every row of the solution. `is_same`: whether the first and the last
    arc have the same steering in the equations. `is_backward`: whether the second row is solved back from the goal.
    """

    solve: Callable[[_Centres], _Solution]
    turns: tuple[tuple[float, ...], ...]
    is_same: bool
    is_backward: bool = False


_FORMS = (
    _Form(_left_straight_left, ((1, 0, 1),), is_same=True),
    _Form(_left_straight_right, ((1, 0, -1),), is_same=False),
    _Form(_left_right_left, ((1, -1, 1), (1, -1, 1)), is_same=True, is_backward=True),
    _Form(_four_arcs, ((1, -1, 1, -1), (1, -1, 1, -1)), is_same=False),
    _Form(_quarter_turn_then_left, ((1, -1, 0, 1), (1, 0, -1, 1)), is_same=True, is_backward=True),
    _Form(_quarter_turn_then_right, ((1, -1, 0, -1), (-1, 0, -1, 1)), is_same=False, is_backward=True),
    _Form(_two_quarter_turns, ((1, -1, 0, 1, -1),), is_same=False),
)
_TURNS = tuple(turns for form in _FORMS for turns in form.turns)


def _turns() -> FloatArray:
    rows = np.zeros((len(_TURNS), 4, 5))
    for turns, row in zip(_TURNS, rows, strict=True):
        row[:, : len(turns)] = turns
        row[2:] *= -1.0
    return readonly(rows.reshape(-1, 5))


TURNS = _turns()
"""Shape (44, 5): 1 left, -1 right, 0 straight on, for every form in each of its four mirrors."""
