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

    from optdock.geometry.arrays import BoolArray, FloatArray

__all__ = ["TURNS", "reeds_shepp_words"]

_HALF_PI = 0.5 * np.pi
_ROUNDING = 1e-10  # [rad]: tolerance of the sign of an arc


def reeds_shepp_words(starts: FloatArray, goals: FloatArray, radius: float) -> FloatArray:
    """Return the signed lengths of all words between pairs of poses, Shape (n, 3) each; `TURNS` lists the steering.

    Args:
        starts: Start poses.
        goals: Goal poses.
        radius: Turning radius of all arcs [m].

    Returns:
        Shape (44, n, 5) [m]; NaN if a form has no solution.
    """
    dx, dy = (goals[:, :2] - starts[:, :2]).T / radius
    c, s = np.cos(starts[:, 2]), np.sin(starts[:, 2])
    x, y, phi = c * dx + s * dy, c * dy - s * dx, goals[:, 2] - starts[:, 2]
    # The four mirrors: identity, time reversal, reflection, both.
    mirror_x, mirror_y = np.array([1.0, -1.0, 1.0, -1.0])[:, None], np.array([1.0, 1.0, -1.0, -1.0])[:, None]
    x, y, phi = mirror_x * x, mirror_y * y, mirror_x * mirror_y * phi
    back_x, back_y = x * np.cos(phi) + y * np.sin(phi), x * np.sin(phi) - y * np.cos(phi)
    found = np.empty((len(_FORMS), 4, starts.shape[0], 5))
    for form, out in zip(_FORMS, found, strict=True):
        parts = form.solve(back_x, back_y, phi) if form.is_backward else form.solve(x, y, phi)
        for k in range(5):
            out[..., k] = parts[k] if k < len(parts) else 0.0
        # A form that is solved backwards returns the last arc first.
        if form.is_backward:
            out[..., : len(parts)] = out[..., len(parts) - 1 :: -1].copy()
    found *= mirror_x[:, :, None] * radius
    return found.reshape(-1, starts.shape[0], 5)


def _within_half_turn(angle: FloatArray) -> FloatArray:
    folded: FloatArray = angle - 2.0 * np.pi * np.round(angle / (2.0 * np.pi))
    return folded


def _where(valid: BoolArray, *parts: FloatArray | float) -> tuple[FloatArray, ...]:
    with np.errstate(invalid="ignore"):
        return tuple(np.where(valid, part, np.nan) for part in parts)


def _left_straight_left(x: FloatArray, y: FloatArray, phi: FloatArray) -> tuple[FloatArray, ...]:
    """L+S+L+, equation 8.1."""
    xi, eta = x - np.sin(phi), y - 1.0 + np.cos(phi)
    t = np.arctan2(eta, xi)
    v = _within_half_turn(phi - t)
    return _where((t >= -_ROUNDING) & (v >= -_ROUNDING), t, np.hypot(xi, eta), v)


def _left_straight_right(x: FloatArray, y: FloatArray, phi: FloatArray) -> tuple[FloatArray, ...]:
    """L+S+R+, equation 8.2."""
    xi, eta = x + np.sin(phi), y - 1.0 - np.cos(phi)
    squared = xi * xi + eta * eta
    u = np.sqrt(np.maximum(squared - 4.0, 0.0))
    t = _within_half_turn(np.arctan2(eta, xi) + np.arctan2(2.0, u))
    v = _within_half_turn(t - phi)
    return _where((squared >= 4.0) & (t >= -_ROUNDING) & (v >= -_ROUNDING), t, u, v)


def _left_right_left(x: FloatArray, y: FloatArray, phi: FloatArray) -> tuple[FloatArray, ...]:
    """L+R-L, with the last arc in either gear, equations 8.3 and 8.4."""
    xi, eta = x - np.sin(phi), y - 1.0 + np.cos(phi)
    apart = np.hypot(xi, eta)
    u = -2.0 * np.arcsin(np.minimum(0.25 * apart, 1.0))
    t = _within_half_turn(np.arctan2(eta, xi) + 0.5 * u + np.pi)
    v = _within_half_turn(phi - t + u)
    return _where((apart <= 4.0) & (t >= -_ROUNDING) & (u <= _ROUNDING), t, u, v)


def _outer_arcs(
    u: FloatArray, v: FloatArray, xi: FloatArray, eta: FloatArray, phi: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the first and the last arc of four arcs with the inner arcs u and v, equations 8.7 and 8.8."""
    delta = _within_half_turn(u - v)
    a, b = np.sin(u) - np.sin(delta), np.cos(u) - np.cos(delta) - 1.0
    turned = np.arctan2(eta * a - xi * b, xi * a + eta * b)
    flipped = 2.0 * (np.cos(delta) - np.cos(v) - np.cos(u)) + 3.0 < 0.0
    t = _within_half_turn(np.where(flipped, turned + np.pi, turned))
    return t, _within_half_turn(t - u + v - phi)


def _four_arcs_with_one_cusp(x: FloatArray, y: FloatArray, phi: FloatArray) -> tuple[FloatArray, ...]:
    """L+R+L-R-, equation 8.7."""
    xi, eta = x + np.sin(phi), y - 1.0 - np.cos(phi)
    rho = 0.25 * (2.0 + np.hypot(xi, eta))
    u = np.arccos(np.minimum(rho, 1.0))
    t, v = _outer_arcs(u, -u, xi, eta, phi)
    return _where((rho <= 1.0) & (t >= -_ROUNDING) & (v <= _ROUNDING), t, u, -u, v)


def _four_arcs_with_two_cusps(x: FloatArray, y: FloatArray, phi: FloatArray) -> tuple[FloatArray, ...]:
    """L+R-L-R+, equation 8.8."""
    xi, eta = x + np.sin(phi), y - 1.0 - np.cos(phi)
    rho = (20.0 - xi * xi - eta * eta) / 16.0
    u = -np.arccos(np.clip(rho, 0.0, 1.0))
    t, v = _outer_arcs(u, u, xi, eta, phi)
    return _where((rho >= 0.0) & (rho <= 1.0) & (t >= -_ROUNDING) & (v >= -_ROUNDING), t, u, u, v)


def _quarter_turn_then_left(x: FloatArray, y: FloatArray, phi: FloatArray) -> tuple[FloatArray, ...]:
    """L+R-S-L- with a quarter turn of R, equation 8.9."""
    xi, eta = x - np.sin(phi), y - 1.0 + np.cos(phi)
    apart = np.hypot(xi, eta)
    r = np.sqrt(np.maximum(apart * apart - 4.0, 0.0))
    t = _within_half_turn(np.arctan2(eta, xi) + np.arctan2(r, -2.0))
    u, v = 2.0 - r, _within_half_turn(phi - _HALF_PI - t)
    return _where((apart >= 2.0) & (t >= -_ROUNDING) & (u <= _ROUNDING) & (v <= _ROUNDING), t, -_HALF_PI, u, v)


def _quarter_turn_then_right(x: FloatArray, y: FloatArray, phi: FloatArray) -> tuple[FloatArray, ...]:
    """L+R-S-R- with a quarter turn of R, equation 8.10."""
    xi, eta = x + np.sin(phi), y - 1.0 - np.cos(phi)
    apart, t = np.hypot(xi, eta), np.arctan2(xi, -eta)
    u, v = 2.0 - apart, _within_half_turn(t + _HALF_PI - phi)
    return _where((apart >= 2.0) & (t >= -_ROUNDING) & (u <= _ROUNDING) & (v <= _ROUNDING), t, -_HALF_PI, u, v)


def _two_quarter_turns(x: FloatArray, y: FloatArray, phi: FloatArray) -> tuple[FloatArray, ...]:
    """L+R-S-L-R+ with quarter turns before and after the straight line, equation 8.11."""
    xi, eta = x + np.sin(phi), y - 1.0 - np.cos(phi)
    apart = np.hypot(xi, eta)
    u = 4.0 - np.sqrt(np.maximum(apart * apart - 4.0, 0.0))
    t = _within_half_turn(np.arctan2((4.0 - u) * xi - 2.0 * eta, -2.0 * xi + (u - 4.0) * eta))
    v = _within_half_turn(t - phi)
    valid = (apart >= 2.0) & (u <= _ROUNDING) & (t >= -_ROUNDING) & (v >= -_ROUNDING)
    return _where(valid, t, -_HALF_PI, u, -_HALF_PI, v)


class _Form(NamedTuple):
    """A closed form: the steering of its arcs as driven, and whether it is solved from the goal back to the start."""

    solve: Callable[[FloatArray, FloatArray, FloatArray], tuple[FloatArray, ...]]
    turns: tuple[float, ...]
    is_backward: bool = False


_FORMS = (
    _Form(_left_straight_left, (1, 0, 1)),
    _Form(_left_straight_right, (1, 0, -1)),
    _Form(_left_right_left, (1, -1, 1)),
    _Form(_left_right_left, (1, -1, 1), is_backward=True),
    _Form(_four_arcs_with_one_cusp, (1, -1, 1, -1)),
    _Form(_four_arcs_with_two_cusps, (1, -1, 1, -1)),
    _Form(_quarter_turn_then_left, (1, -1, 0, 1)),
    _Form(_quarter_turn_then_left, (1, 0, -1, 1), is_backward=True),
    _Form(_quarter_turn_then_right, (1, -1, 0, -1)),
    _Form(_quarter_turn_then_right, (-1, 0, -1, 1), is_backward=True),
    _Form(_two_quarter_turns, (1, -1, 0, 1, -1)),
)


def _turns() -> FloatArray:
    rows = np.zeros((len(_FORMS), 4, 5))
    for form, row in zip(_FORMS, rows, strict=True):
        row[:, : len(form.turns)] = form.turns
        row[2:] *= -1.0
    return readonly(rows.reshape(-1, 5))


TURNS = _turns()
"""Shape (44, 5): 1 left, -1 right, 0 straight on, for every form in each of its four mirrors."""
