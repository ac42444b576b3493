"""Quadratic splines of x = v^2 over arc length: their linear maps, and the limits as rows of a linear program.

Knot i: x_i = wl c_i + wr c_{i+1}, wr = h_{i-1} / (h_{i-1} + h_i), a_i = (c_{i+1} - c_i) / (h_{i-1} + h_i).
Cell m, on c_m, c_{m+1}, c_{m+2}: x'' = 2 (a_{m+1} - a_m) / h_m, centre x = (x_m + x_{m+1}) / 2 - x'' h^2 / 8.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray
    from optdock.timing.bounds import Bounds
    from optdock.timing.grid import Grid
    from optdock.timing.motion import State

__all__ = ["Spline", "applied", "coefficients_of", "limit_rows", "ripple_bands", "spline_of"]


class Spline(NamedTuple):
    """Linear maps from the coefficients, as stencils on c_m, c_{m+1}, c_{m+2} of cell m; Shape (3, M) each.

    Attributes:
        right_value: x at the right knot of the cell.
        right_slope: Acceleration there.
        centre_value: x at the centre.
        centre_slope: Acceleration there.
        curve: x''.
        right_share: Weight wr of c_{i+1} in x_i, Shape (M + 1,).
    """

    right_value: FloatArray
    right_slope: FloatArray
    centre_value: FloatArray
    centre_slope: FloatArray
    curve: FloatArray
    right_share: FloatArray


def spline_of(steps: FloatArray) -> Spline:
    """The maps of a spline with cells of lengths `steps`, Shape (M,) [m]."""
    padded = np.concatenate((steps[:1], steps, steps[-1:]))
    both = padded[:-1] + padded[1:]
    right_share = padded[:-1] / both
    value = np.stack((1.0 - right_share, right_share))  # (2, M + 1) on c_i, c_{i+1}
    slope = np.stack((-1.0 / both, 1.0 / both))
    zero = np.zeros((1, steps.size))
    left_value, left_slope = (np.concatenate((part[:, :-1], zero)) for part in (value, slope))
    right_value, right_slope = (np.concatenate((zero, part[:, 1:])) for part in (value, slope))
    curve = 2.0 * (right_slope - left_slope) / steps
    centre_value = 0.5 * (left_value + right_value) - curve * (steps * steps / 8.0)
    return Spline(right_value, right_slope, centre_value, 0.5 * (left_slope + right_slope), curve, right_share)


def applied(stencil: FloatArray, c: FloatArray) -> FloatArray:
    """Stencils, Shape (3, ..., M), times coefficients, Shape (M + 2,)."""
    total: FloatArray = stencil[0] * c[:-2] + stencil[1] * c[1:-1] + stencil[2] * c[2:]
    return total


def coefficients_of(steps: FloatArray, guess: FloatArray, first: State, last: State) -> FloatArray:
    """Coefficients near `guess`, v^2 at the knots; two on each side are exact: c = x -+ a h."""
    middle = 0.5 * (guess[:-1] + guess[1:])
    c = np.concatenate(([0.0], np.maximum(middle, 1e-3 * max(float(middle.max()), 1e-12)), [0.0]))
    x0, x1 = first.v * first.v, last.v * last.v
    c[0], c[1] = x0 - first.a * steps[0], x0 + first.a * steps[0]
    c[-2], c[-1] = x1 - last.a * steps[-1], x1 + last.a * steps[-1]
    return c


def limit_rows(grid: Grid, bounds: Bounds, spline: Spline) -> FloatArray:
    """Constraints A c <= 1: speed, acceleration, deceleration, and yaw acceleration at knots and centres.

    At a knot the yaw rows take the largest and the least of the rates on its two sides: x is never negative.

    Returns:
        Stencils on three neighbouring coefficients each, Shape (3, rows, M); the rows of the last knot, which is
        given, are zero.
    """
    value, slope = spline.right_value, spline.right_slope
    limits, share = bounds.course.limits, 1.0 - bounds.margins.reference_drive
    drive = slope / (share * limits.max_acceleration), -slope / (share * limits.max_deceleration)
    rows = [value / grid.bound[1:], *drive]
    if np.isfinite(limits.max_yaw_acceleration):
        yaw, turn, rate = grid.yaw[1:], grid.curvature[1:] * slope, grid.rate[:, 1:]
        rows += [(turn + rate[0] * value) / yaw, -(turn + rate[1] * value) / yaw]
    for row in rows:
        row[:, -1] = 0.0
    if np.isfinite(limits.max_yaw_acceleration):
        yaw, turn, rate = (
            0.5 * (grid.yaw[:-1] + grid.yaw[1:]),
            grid.centre_curvature * spline.centre_slope,
            grid.centre_rate,
        )
        rows += [(turn + rate[0] * spline.centre_value) / yaw, -(turn + rate[1] * spline.centre_value) / yaw]
    return np.stack(rows, axis=1)


def ripple_bands(spline: Spline, weight: FloatArray) -> FloatArray:
    """Upper bands of the matrix Q with c' Q c / 2 = sum of (weight * step of x'' between neighbouring cells)^2.

    Args:
        spline: The maps.
        weight: Per pair of neighbouring cells, Shape (M - 1,).

    Returns:
        Shape (4, M + 2), LAPACK's storage: entry (3 - d, j) is Q[j - d, j].
    """
    left, right, zero = spline.curve[:, :-1], spline.curve[:, 1:], np.zeros((1, weight.size))
    row = weight * (np.concatenate((zero, right)) - np.concatenate((left, zero)))  # (4, M - 1) on c_m .. c_{m+3}
    bands = np.zeros((4, weight.size + 3), order="F")
    for offset in range(4):
        for i in range(4 - offset):
            bands[3 - offset, i + offset : i + offset + weight.size] += 2.0 * row[i] * row[i + offset]
    return bands
