"""Interior point method: a banded primal-dual method for the reference program, on plain arrays.

    minimize   sum_m h_m / sqrt(c_{m+1}) + c' Q c / 2
    subject to A c <= 1,   B c <= f / sqrt(c_{m+1}),   two coefficients given at each end,

where f is sqrt(c) divided by a speed in the cell and is kept constant after some iterations. Each row of B limits the
product of a linear term and the speed, such as the jerk |x''| v / 2.

Every row contains three neighbouring coefficients, so Newton's normal matrix is pentadiagonal. Q, the penalty on jerk
steps, adds one band. Each iteration is one call of LAPACK's `dpbsv`. The right side of the rows B is convex in c; its
linearization, which omits the curvature, is an inner approximation as in the convex-concave procedure [Lipp2016]. The
method of [Wright1997] is used with slack variables S, where S + G = 0 and S Z = mu, and with separate primal and dual
steps.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable

    from optdock.geometry.arrays import FloatArray

__all__ = ["Program", "applied", "load_lapack", "solve"]

_LEAST_SHARE = 1e-6  # share of the cell's coefficient: lower bound of v^2 at a place, so that f stays below 1000
_MOST_ITERATIONS = 40  # after these the last iterate is used, because any iterate is a motion
_GAP = 1e-2  # duality gap relative to the objective; the margins of the reference are larger
_RESIDUAL = 6e-3  # relative tolerance of every bound
_FREEZE = 8  # iterations after which f is fixed, because further updates of f converge only linearly
_TO_BOUNDARY = 0.99  # share of the way to the next bound that a step may take
_LARGEST_DECREASE = 0.9  # share of a coefficient in one step
_SMALLEST_SLACK = 0.2  # at the start, so that rows violated by the first iterate do not start on their bound
_FIRST_GAP = 0.2  # initial duality gap relative to the objective
# The next target gap is a share of the present gap that depends on the length of the step.
_CENTERING, _SHORT_CENTERING = ((0.85, 0.08), (0.4, 0.25)), 0.6


def applied(stencil: FloatArray, c: FloatArray) -> FloatArray:
    """Apply stencils on three neighbouring coefficients, Shape (3, ..., M), to coefficients, Shape (M + 2,)."""
    total: FloatArray = stencil[0] * c[:-2] + stencil[1] * c[1:-1] + stencil[2] * c[2:]
    return total


class Program(NamedTuple):
    """Program with M cells and M + 2 coefficients; the two coefficients at each end are given."""

    steps: FloatArray  # lengths of the cells h, Shape (M,) [m]
    rows: FloatArray  # linear constraints A c <= 1 as stencils, Shape (3, rows, M)
    with_speed: FloatArray  # B c v <= 1 as stencils, Shape (3, rows, M); v in rows 0, 1: the largest in the cell
    places: FloatArray  # v^2 for the other rows as stencils, Shape (3, rows - 2, M)
    right_share: FloatArray  # weight of c_{i+1} in the value at knot i, Shape (M + 1,)
    quadratic: FloatArray  # upper bands of Q in LAPACK's storage, Shape (4, M + 2)


def solve(program: Program, c: FloatArray, look: Callable[[], None]) -> tuple[FloatArray, int]:
    """Return coefficients that nearly minimize the program, and the number of iterations.

    Args:
        program: The program.
        c: First iterate, positive, with the given values of the two coefficients at each end, Shape (M + 2,).
        look: Called in every iteration; it may raise.
    """
    iterate = _Iterate(program, c)
    slack = np.maximum(-iterate.value, _SMALLEST_SLACK)
    mu = _FIRST_GAP * iterate.objective / slack.size
    dual = mu / slack
    iteration = 0
    for iteration in range(1, _MOST_ITERATIONS + 1):
        look()
        primal = iterate.value + slack
        weight = dual / slack
        change = iterate.newton_change(weight, mu / slack + weight * primal)
        if not np.isfinite(change).all():
            break  # no spline satisfies the limits; the last iterate is still a motion
        slack_change = -primal - applied(iterate.stencil, change)
        dual_change = mu / slack - dual - weight * slack_change
        step = min(
            _fraction_to_boundary(slack, slack_change, _TO_BOUNDARY),
            _fraction_to_boundary(c[1:-1], change[1:-1], _LARGEST_DECREASE),
        )
        dual_step = _fraction_to_boundary(dual, dual_change, _TO_BOUNDARY)
        c, slack, dual = c + step * change, slack + step * slack_change, dual + dual_step * dual_change
        iterate.move_to(c, frozen=iteration > _FREEZE)
        gap = float(np.vdot(slack, dual))
        residual = float(np.abs(iterate.value + slack).max())
        if gap < _GAP * iterate.objective and residual < _RESIDUAL:
            break
        shorter = min(step, dual_step)
        share = next((share for longer, share in _CENTERING if shorter > longer), _SHORT_CENTERING)
        mu = share * gap / slack.size
    return c, iteration


class _Iterate:
    """Constraint values, stencils and Newton's normal equations of the program at the current coefficients."""

    def __init__(self, program: Program, c: FloatArray) -> None:
        self.program = program
        self.products = _products(program.rows)
        self.linear = program.rows.shape[1]
        self.stencil = np.concatenate((program.rows, np.zeros(program.with_speed.shape)), axis=1)
        self.value = np.empty(self.stencil.shape[1:])
        self.move_to(c, frozen=False)

    def move_to(self, c: FloatArray, *, frozen: bool) -> None:
        """Evaluate all values at `c`; `frozen` keeps f unchanged. Rows B are in units of 1 / sqrt(c)."""
        program, linear = self.program, self.linear
        if not frozen:  # f is sqrt(c) divided by the speed of each row in the cell
            knot = c[:-1] + program.right_share * (c[1:] - c[:-1])
            largest = np.maximum(np.maximum(knot[:-1], knot[1:]), c[1:-1])
            self.share: FloatArray = np.sqrt(c[1:-1] / largest)
            if program.places.shape[1]:
                there = np.maximum(applied(program.places, c), _LEAST_SHARE * c[1:-1])
                self.share = np.concatenate((self.share[None].repeat(2, axis=0), np.sqrt(c[1:-1] / there)))
        self.c = c
        root = self.root = np.sqrt(c[1:-1])
        self.value[:linear] = applied(program.rows, c) - 1.0
        scaled = program.with_speed * root
        self.value[linear:] = applied(scaled, c) - self.share
        self.stencil[:, linear:] = scaled
        self.stencil[1, linear:] += 0.5 * self.share / (root * root)

    @property
    def objective(self) -> float:
        """Duration of the reference [s]."""
        return float(np.dot(self.program.steps, 1.0 / self.root))

    def newton_change(self, weight: FloatArray, target: FloatArray) -> FloatArray:
        """Return the solution of (H + A' W A) dc = -grad - A' target; zero at the two given coefficients on each side.

        Args:
            weight: The diagonal of W, Shape (all rows, M).
            target: Shape (all rows, M).
        """
        quadratic = self.program.quadratic
        normal = np.einsum("rm,prm->pm", weight[: self.linear], self.products)
        normal += np.einsum("rm,prm->pm", weight[self.linear :], _products(self.stencil[:, self.linear :]))
        slope = np.einsum("rm,prm->pm", target, self.stencil)
        square = self.root * self.root
        cube = self.program.steps / (self.root * square)
        band = np.array(quadratic[:, 2:-2], order="F")
        band[3] += normal[0, 2:] + normal[1, 1:-1] + normal[2, :-2] + (0.75 * cube / square)[1:-1]
        band[2, 1:] += (normal[3, 2:] + normal[4, 1:-1])[:-1]
        band[1, 2:] += normal[5, 2:-2]
        force = (0.5 * cube)[1:-1] - (slope[0, 2:] + slope[1, 1:-1] + slope[2, :-2])
        band_solve, band_product = _lapack()
        force -= band_product(3, 1.0, quadratic, self.c)[2:-2]
        _factor, solution, info = band_solve(band, force)
        change = np.zeros(self.program.steps.size + 2)
        if info == 0:
            change[2:-2] = solution
        return change


def _products(stencil: FloatArray) -> FloatArray:
    """Return the products of the stencil's columns 00, 11, 22, 01, 12, 02; Shape (6, rows, M)."""
    return stencil[[0, 1, 2, 0, 1, 0]] * stencil[[0, 1, 2, 1, 2, 2]]


def _fraction_to_boundary(values: FloatArray, change: FloatArray, share: float) -> float:
    """Return the largest step, at most 1, for which no value decreases by more than `share` of itself."""
    worst = float((change / values).min())
    return min(1.0, -share / worst) if worst < 0.0 else 1.0


def load_lapack() -> None:
    """Import LAPACK in advance."""
    _lapack()


@cache
def _lapack() -> tuple[Callable[..., tuple[object, FloatArray, int]], Callable[..., FloatArray]]:
    """Return LAPACK's solver for banded positive definite systems and BLAS's banded symmetric matrix product."""
    from scipy.linalg.blas import dsbmv
    from scipy.linalg.lapack import dpbsv

    return dpbsv, dsbmv
