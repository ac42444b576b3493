"""The reference: a C1 quadratic spline of x = v^2 over arc length, by a banded interior-point method.

With x = v^2 acceleration is x' / 2 and yaw acceleration k x' / 2 + k' x, both linear; jerk is x'' sqrt(x) / 2. Every
such spline is a real motion, so a jerk-limited move between the states at any two of its knots exists.

    minimize   sum h_m / sqrt(c_{m+1})  (+ a price on jerk steps between cells)
    subject to x_i <= X_i,  -D <= a_i <= A,  |k a + k' x| <= yaw   at the knots,
               |k a + k' x| <= yaw,  |x''| vmax <= 2 J             in the cells.

The jerk row |x''| - 2 J f c^(-1/2) <= 0, f = sqrt(c) / vmax, is linearized; its right side is convex in c, so the
linear row is an inner approximation. Newton's normal matrix is pentadiagonal; the price on jerk steps, which keeps
the solution from chattering, adds one band.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.deadline import never_late
from optdock.timing.allowance import look
from optdock.timing.spline import Spline, applied, coefficients_of, limit_rows, ripple_bands, spline_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from optdock.geometry.arrays import FloatArray
    from optdock.timing.bounds import Bounds
    from optdock.timing.grid import Grid
    from optdock.timing.motion import State

__all__ = ["Reference", "load_lapack", "solve_reference"]

_MAX_ITERATIONS = 40
_GAP = 1e-2  # relative to the objective
_RESIDUAL = 6e-3  # of every bound; the margins are larger
_FREEZE = 8  # iterations after which f stays: updating it for ever converges only linearly
_TO_BOUNDARY = 0.99
_LARGEST_DECREASE = 0.9  # of a coefficient in one step
_SMALLEST_SLACK = 0.2  # at the start: rows broken by the guess must not start on their bound
_FIRST_GAP = 0.2  # times the objective


class Reference(NamedTuple):
    """States at the knots of the spline.

    Attributes:
        s: Shape (M + 1,) [m].
        v: Shape (M + 1,) [m/s].
        a: Shape (M + 1,) [m/s^2].
        curve: x'' of the cells, Shape (M,) [1/s^2].
        iterations: Of the interior-point method.
    """

    s: FloatArray
    v: FloatArray
    a: FloatArray
    curve: FloatArray
    iterations: int

    @property
    def duration(self) -> float:
        """From the first knot to the last [s]."""
        return float(np.sum(2.0 * np.diff(self.s) / (self.v[:-1] + self.v[1:])))


def solve_reference(
    grid: Grid,
    bounds: Bounds,
    guess: FloatArray,
    ends: tuple[State, State],
    ripple: float,
    is_late: Callable[[], bool] = never_late,
) -> Reference:
    """The fastest spline between two states.

    Args:
        grid: Knots and limits, at least 4 cells.
        bounds: Drive limits and margins.
        guess: Initial v^2 at the knots, Shape (M + 1,) [m^2/s^2].
        ends: States at the first and the last knot.
        ripple: Price of a full swing of the jerk between neighbouring cells [s].
        is_late: Asked between iterations.

    Raises:
        OutOfTime: `is_late` said so.
    """
    first, last = ends
    spline = spline_of(grid.steps)
    rows = limit_rows(grid, bounds, spline)
    # A swing from -J to J is a step of x'' by 4 J / v.
    bands = ripple_bands(spline, np.sqrt(0.5 * ripple * guess[1:-1]) / (4.0 * bounds.jerk))
    program = _Program(grid.steps, spline, rows, 2.0 * bounds.jerk, bands)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # of slacks, where no spline keeps the limits
        c, iterations = _interior_point(program, coefficients_of(grid.steps, guess, first, last), is_late)
    x, a = np.append(0.0, applied(spline.right_value, c)), np.append(0.0, applied(spline.right_slope, c))
    v = np.sqrt(np.maximum(x, 1e-12))
    np.clip(a, -bounds.course.limits.max_deceleration, bounds.course.limits.max_acceleration, out=a)
    v[0], a[0], v[-1], a[-1] = first.v, first.a, last.v, last.a
    return Reference(grid.knots, v, a, applied(spline.curve, c), iterations)


class _Program:
    """The program at the current iterate: constraint values, their stencils, Newton's normal equations."""

    def __init__(
        self, steps: FloatArray, spline: Spline, rows: FloatArray, twice_jerk: float, ripple: FloatArray
    ) -> None:
        self.steps, self.right_share = steps, spline.right_share
        self.ripple = ripple
        self.curve = spline.curve / twice_jerk
        self.linear = rows
        self.products = _products(rows)
        self.stencil = np.concatenate((rows, np.zeros((3, 2, steps.size))), axis=1)
        self.value = np.empty(self.stencil.shape[1:])
        self.root: FloatArray = np.ones(steps.size)
        self.share: FloatArray = np.ones(steps.size)
        self.c: FloatArray = self.root

    def move_to(self, c: FloatArray, *, frozen: bool) -> None:
        """Evaluate everything at `c`; `frozen` keeps f as it is. Jerk rows are in units of 2 J / sqrt(c)."""
        if not frozen:
            self.share = self._jerk_shares(c)
        self.c = c
        root = self.root = np.sqrt(c[1:-1])
        self.value[:-2] = applied(self.linear, c) - 1.0
        scaled = self.curve * root
        bend = applied(scaled, c)
        self.value[-2] = bend - self.share
        self.value[-1] = -bend - self.share
        self.stencil[:, -2] = scaled
        self.stencil[:, -1] = -scaled
        self.stencil[1, -2:] += 0.5 * self.share / (root * root)

    def _jerk_shares(self, c: FloatArray) -> FloatArray:
        """Factor f: sqrt(c) over the largest speed in each cell."""
        knot = c[:-1] + self.right_share * (c[1:] - c[:-1])
        largest = np.maximum(np.maximum(knot[:-1], knot[1:]), c[1:-1])
        shares: FloatArray = np.sqrt(c[1:-1] / largest)
        return shares

    @property
    def objective(self) -> float:
        """Time [s]."""
        return float(np.dot(self.steps, 1.0 / self.root))

    def newton_change(self, weight: FloatArray, target: FloatArray) -> FloatArray:
        """Solution of (H + A' W A) dc = -grad - A' target; zero at the two given coefficients on each side."""
        normal = np.einsum("rm,prm->pm", weight[:-2], self.products)
        normal += np.einsum("rm,prm->pm", weight[-2:], _products(self.stencil[:, -2:]))
        slope = np.einsum("rm,prm->pm", target, self.stencil)
        square = self.root * self.root
        cube = self.steps / (self.root * square)
        band = np.array(self.ripple[:, 2:-2], order="F")
        band[3] += normal[0, 2:] + normal[1, 1:-1] + normal[2, :-2] + (0.75 * cube / square)[1:-1]
        band[2, 1:] += (normal[3, 2:] + normal[4, 1:-1])[:-1]
        band[1, 2:] += normal[5, 2:-2]
        force = (0.5 * cube)[1:-1] - (slope[0, 2:] + slope[1, 1:-1] + slope[2, :-2])
        force -= _lapack().product(3, 1.0, self.ripple, self.c)[2:-2]
        _factor, solution, info = _lapack().solve(band, force)
        change = np.zeros(self.steps.size + 2)
        if info == 0:
            change[2:-2] = solution
        return change


def _interior_point(program: _Program, c: FloatArray, is_late: Callable[[], bool]) -> tuple[FloatArray, int]:
    """Primal-dual iterations with slacks: S + G = 0, S Z = mu, and separate steps for both."""
    program.move_to(c, frozen=False)
    slack = np.maximum(-program.value, _SMALLEST_SLACK)
    mu = _FIRST_GAP * program.objective / slack.size
    dual = mu / slack
    iteration = 0
    for iteration in range(1, _MAX_ITERATIONS + 1):
        look(is_late)
        primal = program.value + slack
        weight = dual / slack
        change = program.newton_change(weight, mu / slack + weight * primal)
        if not np.isfinite(change).all():
            break  # no spline keeps the limits; the last one is still a motion
        slack_change = -primal - applied(program.stencil, change)
        dual_change = mu / slack - dual - weight * slack_change
        step = min(_longest(slack, slack_change), _longest(c[1:-1], change[1:-1], _LARGEST_DECREASE))
        dual_step = _longest(dual, dual_change)
        c, slack, dual = c + step * change, slack + step * slack_change, dual + dual_step * dual_change
        program.move_to(c, frozen=iteration > _FREEZE)
        gap = float(np.vdot(slack, dual))
        if gap < _GAP * program.objective and float(np.abs(program.value + slack).max()) < _RESIDUAL:
            break
        mu = _centering(min(step, dual_step)) * gap / slack.size
    return c, iteration


def _centering(step: float) -> float:
    if step > 0.85:
        return 0.08
    return 0.25 if step > 0.4 else 0.6


def _products(stencil: FloatArray) -> FloatArray:
    """Products of the stencil's columns 00, 11, 22, 01, 12, 02; Shape (6, rows, M)."""
    return stencil[[0, 1, 2, 0, 1, 0]] * stencil[[0, 1, 2, 1, 2, 2]]


def _longest(values: FloatArray, change: FloatArray, share: float = _TO_BOUNDARY) -> float:
    """The longest step, at most 1, along which no value loses more than `share` of itself."""
    worst = float((change / values).min())
    return min(1.0, -share / worst) if worst < 0.0 else 1.0


class _Lapack(NamedTuple):
    """Solver of a banded positive definite system, and product of a banded symmetric matrix with a vector."""

    solve: Callable[[FloatArray, FloatArray], tuple[object, FloatArray, int]]
    product: Callable[[int, float, FloatArray, FloatArray], FloatArray]


def load_lapack() -> None:
    """Import LAPACK now."""
    _lapack()


@cache
def _lapack() -> _Lapack:
    from scipy.linalg.blas import dsbmv
    from scipy.linalg.lapack import dpbsv

    return _Lapack(dpbsv, dsbmv)
