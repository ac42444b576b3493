"""Interior point method: a banded primal-dual method for the reference program, on plain arrays.

    minimize   sum_m h_m / sqrt(c_{m+1}) + c' Q c / 2
    subject to A c <= 1,   B c <= f / sqrt(c_{m+1}),   two coefficients given at each end,

where f is sqrt(c) divided by a speed in the cell and is kept constant after some iterations. Each row of B limits the
product of a linear term and the speed, such as the jerk |x''| v / 2.

Every row contains three neighbouring coefficients, so Newton's normal matrix is pentadiagonal. Q, the penalty on jerk
steps, adds one band. The right side of the rows B is convex in c; its linearization, which omits the curvature, is an
inner approximation as in the convex-concave procedure [Lipp2016]. The method of [Wright1997] is used with slack
variables S, where S + G = 0 and S Z = mu, and with separate primal and dual steps.

The kernel evaluates all sums in the order of its twin, so sums over rows or cells are sums in index order here:
`np.dot`, `np.einsum` and LAPACK use other orders, which depend on the machine.
"""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.kernels import Kernel, twin_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from optdock.geometry.arrays import FloatArray

__all__ = [
    "AT_ONCE",
    "MOST_ITERATIONS",
    "SETTINGS",
    "Iterate",
    "Program",
    "advanced",
    "applied",
    "iterations_at_once",
    "solve",
]

_LEAST_SHARE = 1e-6  # share of the cell's coefficient: lower bound of v^2 at a place, so that f stays below 1000
MOST_ITERATIONS = 40  # after these the last iterate is used, because any iterate is a motion
AT_ONCE = 1000  # cells times iterations between two polls of the deadline, 0.2 ms in C
_GAP = 1e-2  # duality gap relative to the objective; the margins of the reference are larger
_RESIDUAL = 6e-3  # relative tolerance of every bound
_FREEZE = 8  # iterations after which f is fixed, because further updates of f converge only linearly
_TO_BOUNDARY = 0.99  # share of the way to the next bound that a step may take
_LARGEST_DECREASE = 0.9  # share of a coefficient in one step
_SMALLEST_SLACK = 0.2  # at the start, so that rows violated by the first iterate do not start on their bound
_FIRST_GAP = 0.2  # initial duality gap relative to the objective
# The next target gap is a share of the present gap that depends on the length of the step.
_CENTERING = 0.85, 0.08, 0.4, 0.25, 0.6  # least length and share, twice, and the share for shorter steps


def applied(stencil: FloatArray, c: FloatArray) -> FloatArray:
    """Apply stencils on three neighbouring coefficients, Shape (3, ..., M), to coefficients, Shape (M + 2,)."""
    total: FloatArray = stencil[0] * c[:-2] + stencil[1] * c[1:-1] + stencil[2] * c[2:]
    return total


class Program(NamedTuple):
    """Program with M cells and M + 2 coefficients; the two coefficients at each end are given.

    Its parts are listed in `of`.
    """

    data: FloatArray  # all parts, one after the other
    m: int  # number of cells
    linear: int  # number of rows A
    curved: int  # number of rows B

    @classmethod
    def of(cls, *parts: FloatArray) -> Program:
        """Return the program with these parts.

        Args:
            parts: Lengths of the cells h, Shape (M,) [m]; linear constraints A c <= 1 as stencils, Shape (3, rows, M);
                B c v <= 1 as stencils, Shape (3, rows, M), v in rows 0, 1: the largest in the cell; v^2 for the other
                rows as stencils, Shape (3, rows - 2, M); weight of c_{i+1} in the value at knot i, Shape (M + 1,);
                upper bands of Q, Shape (4, M + 2): entry (3 - d, j) is Q[j - d, j].
        """
        data = np.concatenate([part.ravel() for part in parts])
        return cls(data, parts[0].size, parts[1].shape[1], parts[2].shape[1])

    @property
    def parts(self) -> tuple[FloatArray, ...]:
        """Views of the parts, see `of`."""
        m, linear, curved = self[1:]
        shapes = (m,), (3, linear, m), (3, curved, m), (3, curved - 2, m), (m + 1,), (4, m + 2)
        ends = list(itertools.accumulate([math.prod(shape) for shape in shapes], initial=0))
        return tuple(self.data[a:b].reshape(shape) for a, b, shape in zip(ends[:-1], ends[1:], shapes, strict=True))


class Iterate(NamedTuple):
    """Iterate of a program with R rows, first those of A and then those of B."""

    # The coefficients, Shape (M + 2,), slack variables S and Z, Shape (R, M) each, f, Shape (rows of B, M), the target
    # of S Z, and 1 if the method has converged or failed, one after the other. In iteration 0, only the coefficients.
    state: FloatArray
    iteration: int = 0  # number of iterations so far
    ended: bool = False  # whether the method has ended


def solve(program: Program, iterate: Iterate, look: Callable[[], None]) -> Iterate:
    """Return the last iterate, whose coefficients nearly minimize the program.

    Args:
        program: The program.
        iterate: An iterate; the first one has positive coefficients, with the given values of the two at each end.
        look: Called before every `iterations_at_once` iterations; it may raise.
    """
    while not iterate.ended:
        look()
        iterate = advanced(program, iterate, iterations_at_once(program.m))
    return iterate


def iterations_at_once(m: int) -> int:
    """Return the number of iterations of a program with m cells between two polls of the deadline."""
    return max(1, AT_ONCE // m)


_KERNEL = Kernel("optdock_interior_point", sizes=5, numbers=12)
# For the kernels, in the order of `Settings` there.
SETTINGS = (_LEAST_SHARE, _GAP, _RESIDUAL, _TO_BOUNDARY, _LARGEST_DECREASE, *_CENTERING, _SMALLEST_SLACK, _FIRST_GAP)
assert _FREEZE == 8  # a constant of the kernel


def _advanced_native(program: Program, iterate: Iterate, most: int) -> Iterate:
    m, linear, curved, before = program.m, program.linear, program.curved, iterate.iteration
    size, work = (2 * linear + 3 * curved + 1) * m + 4, (5 * linear + 8 * curved + 17) * m + 4
    state = np.zeros(size)
    state[: iterate.state.size] = iterate.state
    count = before + _KERNEL(
        (m, linear, curved, before, min(most, MOST_ITERATIONS - before)),
        SETTINGS,
        (
            (program.data, 6 * m + 9 + 3 * (linear + 2 * curved - 2) * m),
            (state, size),
            (np.empty(work), work),
        ),
    )
    if count < before:
        raise ValueError("program: must have at least 4 cells and 2 rows with speed")
    return Iterate(state, count, bool(state[-1]) or count == MOST_ITERATIONS)


@twin_of(_advanced_native)
def advanced(program: Program, iterate: Iterate, most: int) -> Iterate:
    """Return the iterate after at most `most` iterations of the program."""
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # slacks without a feasible spline
        variables = _first(program, iterate.state) if iterate.iteration == 0 else _unpacked(program, iterate.state)
        iteration = iterate.iteration
        last = min(iteration + most, MOST_ITERATIONS)
        while iteration < last and not variables.ended:
            iteration += 1
            variables = _next(program, variables, iteration)
    parts = [part.ravel() for part in variables[:4]]
    state = np.concatenate((*parts, (variables.mu, variables.ended)))
    return Iterate(state, iteration, variables.ended or iteration == MOST_ITERATIONS)


class _Variables(NamedTuple):
    """Parts of the state of an iterate."""

    c: FloatArray  # coefficients, Shape (M + 2,)
    slack: FloatArray  # S, Shape (R, M)
    dual: FloatArray  # Z, Shape (R, M)
    share: FloatArray  # f, Shape (rows of B, M)
    mu: float  # target of S Z
    ended: bool  # whether the method has converged or failed


def _unpacked(program: Program, state: FloatArray) -> _Variables:
    m, rows = program.m, program.linear + program.curved
    slack, dual = state[m + 2 : m + 2 + 2 * rows * m].reshape(2, rows, m)
    mu, ended = state[-2:].tolist()
    return _Variables(state[: m + 2], slack, dual, state[m + 2 + 2 * rows * m : -2].reshape(-1, m), mu, bool(ended))


def _first(program: Program, c: FloatArray) -> _Variables:
    share = _shares(program, c)
    slack = np.maximum(-_values(program, c, share), _SMALLEST_SLACK)
    mu = _FIRST_GAP * _objective(program, c) / slack.size
    return _Variables(c, slack, mu / slack, share, mu, ended=False)


def _next(program: Program, variables: _Variables, iteration: int) -> _Variables:
    c, slack, dual, share, mu, _ended = variables
    stencil, value = _stencils(program, c, share), _values(program, c, share)
    primal, weight = value + slack, dual / slack
    change = _newton_change(program, c, stencil, weight, mu / slack + weight * primal)
    if not np.isfinite(change).all():  # no spline satisfies the limits; the last iterate is still a motion
        return variables._replace(ended=True)
    slack_change = -primal - applied(stencil, change)
    dual_change = mu / slack - dual - weight * slack_change
    step = min(
        _fraction_to_boundary(slack, slack_change, _TO_BOUNDARY),
        _fraction_to_boundary(c[1:-1], change[1:-1], _LARGEST_DECREASE),
    )
    dual_step = _fraction_to_boundary(dual, dual_change, _TO_BOUNDARY)
    c, slack, dual = c + step * change, slack + step * slack_change, dual + dual_step * dual_change
    if iteration <= _FREEZE:
        share = _shares(program, c)
    gap = float(np.cumsum(slack * dual)[-1])
    residual = float(np.abs(_values(program, c, share) + slack).max())
    ended = gap < _GAP * _objective(program, c) and residual < _RESIDUAL
    if not ended:
        mu = _centering(min(step, dual_step)) * gap / slack.size
    return _Variables(c, slack, dual, share, mu, ended)


def _centering(step: float) -> float:
    long, long_share, middle, middle_share, short_share = _CENTERING
    return long_share if step > long else middle_share if step > middle else short_share


def _shares(program: Program, c: FloatArray) -> FloatArray:
    """Return f, sqrt(c) divided by the speed of each row of B in its cell, Shape (rows of B, M)."""
    *_, places, right_share, _quadratic = program.parts
    knot = c[:-1] + right_share * (c[1:] - c[:-1])
    largest = np.maximum(np.maximum(knot[:-1], knot[1:]), c[1:-1])
    there = np.maximum(applied(places, c), _LEAST_SHARE * c[1:-1])
    shares: FloatArray = np.sqrt(c[1:-1] / np.concatenate(([largest, largest], there)))
    return shares


def _values(program: Program, c: FloatArray, share: FloatArray) -> FloatArray:
    """Return the values of all constraints, at most 0 if satisfied; rows B are in units of 1 / sqrt(c)."""
    _steps, rows, with_speed, *_ = program.parts
    scaled = with_speed * np.sqrt(c[1:-1])
    return np.concatenate((applied(rows, c) - 1.0, applied(scaled, c) - share))


def _stencils(program: Program, c: FloatArray, share: FloatArray) -> FloatArray:
    """Return the derivatives of all constraints as stencils, Shape (3, rows, M)."""
    _steps, rows, with_speed, *_ = program.parts
    root = np.sqrt(c[1:-1])
    scaled = with_speed * root
    scaled[1] += 0.5 * share / (root * root)
    return np.concatenate((rows, scaled), axis=1)


def _objective(program: Program, c: FloatArray) -> float:
    """Return the duration of the reference [s]."""
    return float(np.cumsum(program.parts[0] / np.sqrt(c[1:-1]))[-1])


def _newton_change(
    program: Program, c: FloatArray, stencil: FloatArray, weight: FloatArray, target: FloatArray
) -> FloatArray:
    """Return the solution of (H + A' W A) dc = -grad - A' target; zero at the two given coefficients on each side.

    Args:
        program: The program.
        c: Coefficients, Shape (M + 2,).
        stencil: The matrix A of all constraints, Shape (3, R, M).
        weight: The diagonal of W, Shape (R, M).
        target: Shape (R, M).
    """
    # Products of the stencil's columns 00, 11, 22, 01, 12, 02, summed over the rows.
    products = weight * (stencil[[0, 1, 2, 0, 1, 0]] * stencil[[0, 1, 2, 1, 2, 2]])
    normal, slope = np.add.reduce(products, axis=1), np.add.reduce(target * stencil, axis=1)
    root = np.sqrt(c[1:-1])
    square = root * root
    steps, *_, quadratic = program.parts
    cube = steps / (root * square)
    band = quadratic[:, 2:-2].copy()
    band[3] += normal[0, 2:] + normal[1, 1:-1] + normal[2, :-2] + (0.75 * cube / square)[1:-1]
    band[2, 1:] += (normal[3, 2:] + normal[4, 1:-1])[:-1]
    band[1, 2:] += normal[5, 2:-2]
    force = (0.5 * cube)[1:-1] - (slope[0, 2:] + slope[1, 1:-1] + slope[2, :-2])
    force -= _band_product(quadratic, c)[2:-2]
    change = np.zeros(c.size)
    change[2:-2] = _band_solution(band, force)
    return change


def _band_product(bands: FloatArray, c: FloatArray) -> FloatArray:
    """Return the product of a symmetric matrix, given by its upper bands, Shape (4, n), and `c`, Shape (n,)."""
    product: FloatArray = bands[3] * c
    for distance in range(1, 4):
        band = bands[3 - distance, distance:]
        product[distance:] += band * c[:-distance]
        product[:-distance] += band * c[distance:]
    return product


def _band_solution(bands: FloatArray, force: FloatArray) -> FloatArray:
    """Solve a positive definite system, given by its upper bands, Shape (4, n), by its factors L D L'. Shape (n,).

    The solution is zero if the matrix is not positive definite.
    """
    pivots, forced, factors = [math.inf] * 3, [0.0] * 3, [(0.0, 0.0, 0.0)] * 3  # rows before the first
    for third, above, beside, own, value in zip(*bands.tolist(), force.tolist(), strict=True):
        second = above - third * factors[-2][0]
        first = beside - (third * factors[-1][1] + second * factors[-1][0])
        c, b, a = third / pivots[-3], second / pivots[-2], first / pivots[-1]
        pivot = own - (third * c + second * b + first * a)
        if pivot <= 0.0:
            return np.zeros(force.size)
        pivots.append(pivot)
        factors.append((a, b, c))
        forced.append(value - (a * forced[-1] + b * forced[-2] + c * forced[-3]))
    factors += [(0.0, 0.0, 0.0)] * 3
    solution = [0.0] * 3
    for i in range(len(pivots) - 1, 2, -1):
        known = factors[i + 1][0] * solution[-1] + factors[i + 2][1] * solution[-2] + factors[i + 3][2] * solution[-3]
        solution.append(forced[i] / pivots[i] - known)
    return np.array(solution[:2:-1])


def _fraction_to_boundary(values: FloatArray, change: FloatArray, share: float) -> float:
    """Return the largest step, at most 1, for which no value decreases by more than `share` of itself."""
    worst = float((change / values).min())
    return min(1.0, -share / worst) if worst < 0.0 else 1.0
