"""Reeds-Shepp words: candidates for the shortest path of a car that can reverse.

The shortest path with bounded curvature and any number of cusps is one of 48 words of at most five arcs and straight
lines (`L+R-L-` and so on), as proven in [ReedsShepp1990]. The words have eleven closed forms, each with four mirrors:
time reversal, reflection, both, or none. In words of three arcs the sign of the last arc is free, so 44 forms contain
all 48 words. The forms are evaluated for many pairs of poses at once.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.geometry.arrays import readonly

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import TypeAlias

    from optdock.geometry.arrays import BoolArray, FloatArray

    # Where there is a solution, Shape (1 or 2, 4, n), and the lengths of its arcs of the same shape.
    _Solution: TypeAlias = tuple[FloatArray | BoolArray | float, ...]

__all__ = ["TURNS", "reeds_shepp_words"]

_HALF_PI = 0.5 * np.pi
_ROUNDING = 1e-10  # [rad]: tolerance of the sign of an arc
# The four mirrors: identity, time reversal, reflection, both.
_MIRROR_X, _MIRROR_Y = (
    readonly(np.array([[1.0], [-1.0], [1.0], [-1.0]])),
    readonly(np.array([[1.0], [1.0], [-1.0], [-1.0]])),
)
_FOUR_ARCS = readonly(
    np.array([1.0, -1.0])[:, None, None]
)  # sign of the second of four arcs, with one cusp and with two


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

    The first row is solved from the start to the goal, the second row back from the goal to the start. `phi`: change of
    heading; `xi`, `eta`, `apart`, `bearing`: components of the vector, its length and its direction. Shape (2, 4, n)
    for four mirrors and n pairs of poses, `phi` (4, n).
    """

    phi: FloatArray
    xi: FloatArray
    eta: FloatArray
    apart: FloatArray
    bearing: FloatArray


def _centres(starts: FloatArray, goals: FloatArray, radius: float) -> tuple[_Centres, _Centres]:
    """Return the vectors for a last arc that is driven to the left, and for one to the right."""
    dx, dy = (goals[:, :2] - starts[:, :2]).T / radius
    c, s = np.cos(starts[:, 2]), np.sin(starts[:, 2])
    phi = goals[:, 2] - starts[:, 2]
    x, y = _MIRROR_X * (c * dx + s * dy), _MIRROR_Y * (c * dy - s * dx)
    c, s = np.cos(phi), _MIRROR_X * _MIRROR_Y * np.sin(phi)
    xi, eta = np.empty((2, 2, 4, len(starts))), np.empty((2, 2, 4, len(starts)))
    for way, (ahead, left) in enumerate(((x, y - 1.0), (x * c + y * s, x * s - y * c - 1.0))):
        xi[0, way], eta[0, way] = ahead - s, left + c
        xi[1, way], eta[1, way] = ahead + s, left - c
    apart, bearing, turned = np.hypot(xi, eta), np.arctan2(eta, xi), _MIRROR_X * _MIRROR_Y * phi
    same, other = (_Centres(turned, xi[i], eta[i], apart[i], bearing[i]) for i in (0, 1))
    return same, other


def _within_half_turn(angle: FloatArray) -> FloatArray:
    folded: FloatArray = angle - 2.0 * np.pi * np.rint(angle / (2.0 * np.pi))
    return folded


def _left_straight_left(to: _Centres) -> _Solution:
    """L+S+L+, equation 8.1."""
    t = to.bearing[:1]
    v = _within_half_turn(to.phi - t)
    return (t >= -_ROUNDING) & (v >= -_ROUNDING), t, to.apart[:1], v


def _left_straight_right(to: _Centres) -> _Solution:
    """L+S+R+, equation 8.2."""
    squared = to.xi[:1] * to.xi[:1] + to.eta[:1] * to.eta[:1]
    u = np.sqrt(np.maximum(squared - 4.0, 0.0))
    t = _within_half_turn(to.bearing[:1] + np.arctan2(2.0, u))
    v = _within_half_turn(t - to.phi)
    return (squared >= 4.0) & (t >= -_ROUNDING) & (v >= -_ROUNDING), t, u, v


def _left_right_left(to: _Centres) -> _Solution:
    """L+R-L, with the last arc in either gear, equations 8.3 and 8.4."""
    u = -2.0 * np.arcsin(np.minimum(0.25 * to.apart, 1.0))
    t = _within_half_turn(to.bearing + 0.5 * u + np.pi)
    v = _within_half_turn(to.phi - t + u)
    return (to.apart <= 4.0) & (t >= -_ROUNDING) & (u <= _ROUNDING), t, u, v


def _four_arcs(to: _Centres) -> _Solution:
    """L+R+L-R- with one cusp, equation 8.7, and L+R-L-R+ with two cusps, equation 8.8."""
    xi, eta = to.xi[0], to.eta[0]
    rho = np.stack((0.25 * (2.0 + to.apart[0]), (20.0 - xi * xi - eta * eta) / 16.0))
    u = _FOUR_ARCS * np.arccos(np.minimum(np.maximum(rho, 0.0), 1.0))
    w = _FOUR_ARCS * -u  # the third arc
    delta = _within_half_turn(u - w)
    cosine, other_cosine = np.cos(u), np.cos(delta)
    a, b = np.sin(u) - np.sin(delta), cosine - other_cosine - 1.0
    turned = np.arctan2(eta * a - xi * b, xi * a + eta * b)
    flipped = 2.0 * (other_cosine - cosine - cosine) + 3.0 < 0.0
    t = _within_half_turn(np.where(flipped, turned + np.pi, turned))
    v = _within_half_turn(t - u + w - to.phi)
    valid = (rho >= 0.0) & (rho <= 1.0) & (t >= -_ROUNDING) & (_FOUR_ARCS * v <= _ROUNDING)
    return valid, t, u, w, v


def _quarter_turn_then_left(to: _Centres) -> _Solution:
    """L+R-S-L- with a quarter turn of R, equation 8.9."""
    r = np.sqrt(np.maximum(to.apart * to.apart - 4.0, 0.0))
    t = _within_half_turn(to.bearing + np.arctan2(r, -2.0))
    u, v = 2.0 - r, _within_half_turn(to.phi - _HALF_PI - t)
    return (to.apart >= 2.0) & (t >= -_ROUNDING) & (u <= _ROUNDING) & (v <= _ROUNDING), t, -_HALF_PI, u, v


def _quarter_turn_then_right(to: _Centres) -> _Solution:
    """L+R-S-R- with a quarter turn of R, equation 8.10."""
    t, u = np.arctan2(to.xi, -to.eta), 2.0 - to.apart
    v = _within_half_turn(t + _HALF_PI - to.phi)
    return (to.apart >= 2.0) & (t >= -_ROUNDING) & (u <= _ROUNDING) & (v <= _ROUNDING), t, -_HALF_PI, u, v


def _two_quarter_turns(to: _Centres) -> _Solution:
    """L+R-S-L-R+ with quarter turns before and after the straight line, equation 8.11."""
    xi, eta, apart = to.xi[:1], to.eta[:1], to.apart[:1]
    u = 4.0 - np.sqrt(np.maximum(apart * apart - 4.0, 0.0))
    t = _within_half_turn(np.arctan2((4.0 - u) * xi - 2.0 * eta, -2.0 * xi + (u - 4.0) * eta))
    v = _within_half_turn(t - to.phi)
    valid = (apart >= 2.0) & (u <= _ROUNDING) & (t >= -_ROUNDING) & (v >= -_ROUNDING)
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
