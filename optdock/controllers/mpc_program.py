"""The tracking problem over a short horizon as a quadratic program.

The state is z = (along, cross, yaw error, speed, yaw rate) relative to the moving reference. Over one step of length h
the reference moves along an arc with the mean velocity (v, w). The errors are linearized about this arc [DeLuca2001],
and the drive is a first-order lag that is integrated exactly: z' = A z + B u + c. The states are eliminated
[Rawlings2017], so the variables are the commands:

    minimize    sum_k h_k |errors_k|^2_Q + |u_k - nominal_k|^2_R + |d(u - nominal)/dt|^2_S  + |errors_N|^2_P
                + exact penalties of the two slacks
    subject to  the robot's limits: speeds, yaw rate, wheel speeds, lateral acceleration, curvature, and changes of the
                commands; jerk, with a slack; the tube around the reference, with a slack.

The limits of the commands do not depend on the measured pose, so the program is feasible for any error.
"""

from __future__ import annotations

import functools
import itertools
import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.geometry.arrays import readonly
from optdock.kernels import Kernel, kernels_lane, twin_of
from optdock.model.constant_jerk import braking_time
from optdock.quadratic_program import EXACT, UNBOUNDED, DenseProgram, QuadraticProgram, minimizer

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray
    from optdock.model.limits import MotionLimits

__all__ = [
    "CondensedErrors",
    "Prediction",
    "ReferenceArcs",
    "arcs_between",
    "condensed",
    "cost_to_go",
    "predicted",
    "riccati_back",
    "step_matrices",
]

_EXACT = 1e4  # penalty per metre and per m/s^3: above every multiplier of errors that weigh 1 to 10
_IN_MOTION = 0.02  # [m/s]: the curvature of slower commands is not linearized
_AT_REST = 1e-6  # [m/s]
_SAME_TIME = 1e-6  # [s]: a smaller change of the steps counts as zero
_MOST_ITERATIONS = 300  # of DAQP, about 3 ms; a warm start takes 20
_NO_GUESS = readonly(np.empty(0, dtype=np.int64))


class ReferenceArcs(NamedTuple):
    """Mean motion of the reference over each step.

    `v`, `w`: mean velocity of the arc, Shape (n,) [m/s, rad/s]; `h`: duration, Shape (n,) [s]; `residual`: offset of
    the reference from the end of the arc, in its frame, Shape (n, 2) [m].
    """

    v: FloatArray
    w: FloatArray
    h: FloatArray
    residual: FloatArray


def arcs_between(poses: FloatArray, times: FloatArray) -> ReferenceArcs:
    """Return the arcs between successive poses, Shape (n + 1, 3), at `times`, Shape (n + 1,) [s].

    Each turn is taken as the equivalent angle in [-pi, pi].
    """
    h, turn = np.diff(times), np.diff(poses[:, 2])
    turn -= 2.0 * np.pi * np.round(turn / (2.0 * np.pi))
    dx, dy = np.diff(poses[:, 0]), np.diff(poses[:, 1])
    c, s = np.cos(poses[:-1, 2] + 0.5 * turn), np.sin(poses[:-1, 2] + 0.5 * turn)
    along, aside = c * dx + s * dy, c * dy - s * dx
    v = along / (h * np.sinc(turn / (2.0 * np.pi)))
    return ReferenceArcs(v, turn / h, h, np.column_stack((np.sin(0.5 * turn) * aside, np.cos(0.5 * turn) * aside)))


def step_matrices(arcs: ReferenceArcs, lags: tuple[float, float]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return A, Shape (n, 5, 5), B, Shape (n, 5, 2), and c, Shape (n, 5); `lags` of speed and yaw rate [s]."""
    v, w, h, n = arcs.v, arcs.w, arcs.h, arcs.h.size
    turn = w * h
    c, s, chord = np.cos(0.5 * turn), np.sin(0.5 * turn), h * np.sinc(turn / (2.0 * np.pi))
    by_yaw = np.column_stack(
        (v * chord * s, v * chord * c)
    )  # displacement per yaw error, in the frame of the arc's end
    by_speed = np.column_stack((chord * c, -chord * s))
    by_rate = 0.5 * h[:, None] * by_yaw  # the mean effect of a yaw rate over the step
    a, b, const = np.zeros((n, 5, 5)), np.zeros((n, 5, 2)), np.zeros((n, 5))
    cw, sw = np.cos(turn), np.sin(turn)
    a[:, 0, 0] = a[:, 1, 1] = cw
    a[:, 0, 1], a[:, 1, 0] = sw, -sw
    a[:, :2, 2], a[:, 2, 2] = by_yaw, 1.0
    for i, (lag, effect) in enumerate(zip(lags, (by_speed, by_rate), strict=True)):
        decay = np.exp(-h / lag) if lag > 0.0 else np.zeros(n)
        kept = (1.0 - decay) * lag / h  # share of the old velocity in the mean one
        a[:, :2, 3 + i], b[:, :2, i] = kept[:, None] * effect, (1.0 - kept)[:, None] * effect
        a[:, 3 + i, 3 + i], b[:, 3 + i, i] = decay, 1.0 - decay
        if i == 1:
            a[:, 2, 4], b[:, 2, 1] = kept * h, (1.0 - kept) * h
    const[:, :2] = -by_speed * v[:, None] - by_rate * w[:, None] - arcs.residual
    const[:, 2] = -turn
    return a, b, const


class Prediction(NamedTuple):
    """Errors after every step as a function of the commands: `errors + by_commands @ u`.

    Shapes (n, 5) and (n, 5, 2 n); `u` contains speed and yaw rate, step by step.
    """

    errors: FloatArray
    by_commands: FloatArray


def predicted(state: FloatArray, matrices: tuple[FloatArray, FloatArray, FloatArray]) -> Prediction:
    """Eliminate the states, given the present state, Shape (5,), and the result of `step_matrices`."""
    a, b, c = matrices
    n = len(a)
    errors, by = np.empty((n, 5)), np.zeros((n, 5, 2 * n))
    now, effect = state, np.zeros((5, 2 * n))
    for k in range(n):
        now = errors[k] = a[k] @ now + c[k]
        effect = np.matmul(a[k], effect, out=by[k])
        effect[:, 2 * k : 2 * k + 2] = b[k]  # earlier states do not depend on this command
    return Prediction(errors, by)


def riccati_back(arcs: ReferenceArcs, stage: FloatArray, effort: FloatArray, final: FloatArray) -> FloatArray:
    """Return the cost to go of the problem without limits and lag, by the finite-horizon Riccati recursion.

    Args:
        arcs: The whole reference in steps.
        stage: Weights of the errors per second, Shape (3,).
        effort: Weights of the commands' deviations per second, Shape (2,).
        final: Weights of the errors at the end, Shape (3,).

    Returns:
        Cost matrices at the borders of the steps, Shape (n + 1, 3, 3).
    """
    a, b, _ = step_matrices(arcs, (0.0, 0.0))
    a, b, h = a[:, :3, :3], b[:, :3, :], arcs.h
    cost = np.empty((h.size + 1, 3, 3))
    p = cost[-1] = np.diag(final)
    q, r = np.diag(stage), np.diag(effort)
    for k in range(h.size - 1, -1, -1):
        pb = p @ b[k]
        m = h[k] * r + b[k].T @ pb
        inverse = np.array([[m[1, 1], -m[0, 1]], [-m[1, 0], m[0, 0]]]) / (m[0, 0] * m[1, 1] - m[0, 1] * m[1, 0])
        bpa = pb.T @ a[k]
        p = a[k].T @ p @ a[k] - bpa.T @ inverse @ bpa + h[k] * q
        p = cost[k] = 0.5 * (p + p.T)
    return cost


class MpcWeights(NamedTuple):
    """Weights of the cost, per second; `final` is added once."""

    errors: FloatArray  # errors along, across [1/m^2] and in yaw [1/rad^2], Shape (3,)
    effort: FloatArray  # deviations of speed and yaw rate from the nominal commands, Shape (2,)
    change: FloatArray  # rates of these deviations, Shape (2,)
    final: FloatArray  # errors at the end of the trajectory, Shape (3,)


_COST_TO_GO = Kernel("optdock_cost_to_go", sizes=1, numbers=0)


def _cost_to_go_natively(poses: FloatArray, times: FloatArray, weights: MpcWeights) -> FloatArray:
    n, numbers = times.size - 1, np.concatenate((weights.errors, weights.effort, weights.final))
    cost = np.empty((n + 1, 3, 3))
    _COST_TO_GO((n,), (), ((poses, 3 * n + 3), (times, n + 1), (numbers, 8), (cost, cost.size)))
    return cost


@twin_of(_cost_to_go_natively)
def cost_to_go(poses: FloatArray, times: FloatArray, weights: MpcWeights) -> FloatArray:
    """Return the cost to go of a reference, see `riccati_back`.

    Args:
        poses: Poses of the whole reference, Shape (n + 1, 3).
        times: Their times, Shape (n + 1,) [s].
        weights: Weights of the cost.

    Returns:
        Shape (n + 1, 3, 3).
    """
    return riccati_back(arcs_between(poses, times), weights.errors, weights.effort, weights.final)


class CondensedErrors(NamedTuple):
    """Errors over the horizon as a function of the commands u, and their cost u' hessian u / 2 + gradient' u.

    `nominal`: mean velocities of the reference when the commands act, Shape (n, 2) [m/s, rad/s]; `errors`, Shape (n,
    3), and `by_commands`, Shape (n, 3, 2 n), are those of `Prediction` without the speeds; `hessian`, Shape (2 n, 2 n);
    `gradient`, Shape (2 n,).
    """

    nominal: FloatArray
    errors: FloatArray
    by_commands: FloatArray
    hessian: FloatArray
    gradient: FloatArray


def condensed(
    poses: FloatArray, h: FloatArray, lag: float, state: FloatArray, weights: FloatArray, after: FloatArray
) -> CondensedErrors:
    """Return the errors over the horizon and their cost.

    Args:
        poses: Poses of the reference at the borders of the steps, and then poses later by `lag`, Shape (2 n + 2, 3).
        h: Length of each step, Shape (n,) [s].
        lag: Lag of the drive, of speed and yaw rate [s].
        state: Present errors, speed and yaw rate, Shape (5,).
        weights: Weights of the errors per second, Shape (3,).
        after: Cost to go after the last step, symmetric, Shape (3, 3).
    """
    n, times = h.size, np.concatenate(([0.0], np.cumsum(h)))
    arcs, leading = arcs_between(poses[: n + 1], times), arcs_between(poses[n + 1 :], times)
    prediction = predicted(state, step_matrices(arcs, (lag, lag)))
    errors, by = prediction.errors[:, :3], prediction.by_commands[:, :3, :]
    heavy = ((h[:, None] * weights)[:, :, None] * by).reshape(3 * n, 2 * n)
    end = by[-1].T @ after
    hessian = heavy.T @ by.reshape(3 * n, 2 * n) + end @ by[-1]
    gradient = heavy.T @ errors.ravel() + end @ errors[-1]
    return CondensedErrors(np.column_stack((leading.v, leading.w)), errors, by, hessian, gradient)


class CommandBounds(NamedTuple):
    """Bounds of the next command, lower and upper; infinite without a limit."""

    speed: tuple[float, float]  # [m/s]
    acceleration: tuple[float, float]  # from the last command [m/s^2]
    lateral: float  # of speed times yaw rate, linearized about the last command; also its lower bound, negated [m/s^2]


class MpcCycle(NamedTuple):
    """Data of the program for one control cycle."""

    poses: FloatArray  # of the reference at the borders of the steps, and then later by the lag, Shape (2 n + 2, 3)
    lengths: tuple[float, float]  # of the first and of every other step [s]
    lag: float  # of the drive, of speed and yaw rate [s]
    state: tuple[float, float, float, float, float]  # present errors, speed and yaw rate
    after: FloatArray  # cost to go after the last step, Shape (3, 3)
    nominal_before: tuple[float, float]  # command that follows the reference, from the last cycle
    last: tuple[float, float]  # command of the last cycle
    last_acceleration: float  # acceleration of that command [m/s^2]
    elapsed: float  # time since the last command [s]
    bounds: CommandBounds  # of the next command
    limits: MotionLimits  # of the robot
    curvature: FloatArray | None  # bounds of the curvature of steered wheels, Shape (2, n) [1/m]; None: differential


class Solution(NamedTuple):
    """Commands, Shape (n, 2), largest excess [m] over the tube, and excess [m/s^3] of the next jerk over its limit."""

    commands: FloatArray
    outside: float
    over_jerk: float


class ProgramRows(NamedTuple):
    """Rows of the program; the upper bounds of all steps come first in blocks with two rows of every step.

    Changes of speed and yaw rate, the jerk, wheel speeds, lateral acceleration, curvature of steered wheels and its
    changes, and the tube: upper and lower bounds of the cross error, then of the yaw error.
    """

    speed_changes: slice
    yaw_rate_changes: slice
    jerks: slice
    wheels: slice
    lateral: slice
    curvature: slice
    curvature_changes: slice
    tube: slice

    @classmethod
    def of(cls, steps: int, *, ackermann: bool, in_tube: bool) -> ProgramRows:
        """Return the rows of a program."""
        steered = steps if ackermann else 0
        counts = steps, steps, 2 * steps, 2 * steps, steps, 2 * steered, steered, 4 * steps * in_tube
        ends = itertools.accumulate(counts)
        return cls(*(slice(end - count, end) for count, end in zip(counts, ends, strict=True)))


class FixedData(NamedTuple):
    """Data of the program that changes with the steps, the limits or the weights.

    `values` contains all other arrays, which are views: `errors` and `change`, see `MpcWeights`; `limits`: largest
    speed in reverse and forward, acceleration, deceleration, yaw acceleration, jerk, lateral acceleration, and the
    widths of the tube, Shape (9,); `spans` of accelerations and of jerks, Shape (n,) [s]; `effort`: cost of the
    deviations from the nominal commands, Shape (2 n, 2 n).
    """

    values: FloatArray
    errors: FloatArray
    change: FloatArray
    limits: FloatArray
    spans: FloatArray
    jerk_spans: FloatArray
    effort: FloatArray

    @classmethod
    def of(cls, steps: int) -> FixedData:
        """Return the data of a program, filled with zeros."""
        counts = 3, 2, 9, steps, steps, 4 * steps**2
        values, ends = np.zeros(sum(counts)), itertools.accumulate(counts)
        errors, change, limits, spans, jerk_spans, effort = (
            values[end - count : end] for count, end in zip(counts, ends, strict=True)
        )
        return cls(values, errors, change, limits, spans, jerk_spans, effort.reshape(2 * steps, 2 * steps))


_FILL = Kernel("optdock_fill_tracking_program", sizes=3, numbers=2)


def _filled_natively(
    program: QuadraticProgram, rows: ProgramRows, fixed: FixedData, cycle: MpcCycle
) -> tuple[FloatArray, ...]:
    n, (m, size) = fixed.spans.size, program.a.shape
    now = (
        *cycle.lengths,
        *cycle.state,
        *cycle.last,
        cycle.last_acceleration,
        *cycle.nominal_before,
        *cycle.bounds.speed,
        *cycle.bounds.acceleration,
        cycle.bounds.lateral,
    )
    work = np.empty(17 * n + 10 * n * n)
    arrays = (
        (cycle.poses, 6 * (n + 1)),
        (cycle.after, 9),
        (np.array(now), 17),
        (fixed.values, 14 + 2 * n + 4 * n * n),
        (program.h, size * size),
        (program.g, size),
        (program.a, m * size),
        (program.bounds, 2 * (m + size)),
        (work, work.size),
    )
    tube = rows.tube.start if rows.tube.stop > rows.tube.start else m
    _FILL((n, m, tube), (UNBOUNDED, cycle.lag), arrays)
    return program.h, program.g, program.a, program.bounds, work[: 2 * n].reshape(n, 2)


def _with_copies(
    program: QuadraticProgram, rows: ProgramRows, fixed: FixedData, cycle: MpcCycle
) -> tuple[QuadraticProgram, ProgramRows, FixedData, MpcCycle]:
    own = (program.h.copy(), program.g.copy(), program.a.copy(), program.bounds.copy())
    return program._replace(h=own[0], g=own[1], a=own[2], bounds=own[3]), rows, fixed, cycle


@twin_of(_filled_natively, _with_copies)
def filled(program: QuadraticProgram, rows: ProgramRows, fixed: FixedData, cycle: MpcCycle) -> tuple[FloatArray, ...]:
    """Fill the part of the program that changes in every cycle, without the curvature of steered wheels.

    Returns:
        The arrays of the program that were changed, `h`, `g`, `a` and `bounds`, and the commands that follow the
        reference, Shape (n, 2).
    """
    n, (first, other) = fixed.spans.size, cycle.lengths
    h = np.full(n, other)
    h[0] = first
    found = condensed(cycle.poses, h, cycle.lag, np.array(cycle.state), fixed.errors, cycle.after)
    program.h[:-2, :-2] = found.hessian + fixed.effort
    program.g[:-2] = found.gradient - fixed.effort @ found.nominal.reshape(-1)
    # The first change starts at the deviation of the last command from its nominal one.
    program.g[:2] -= fixed.change / fixed.spans[0] * (np.array(cycle.last) - cycle.nominal_before)
    _fill_bounds(program, rows, fixed, cycle, found.nominal)
    if rows.tube.stop > rows.tube.start:
        _fill_tube(program, rows.tube, found, fixed.limits[-2:])
    np.clip(program.bounds, -UNBOUNDED, UNBOUNDED, out=program.bounds)
    return program.h, program.g, program.a, program.bounds, found.nominal


def _fill_bounds(
    program: QuadraticProgram, rows: ProgramRows, fixed: FixedData, cycle: MpcCycle, nominal: FloatArray
) -> None:
    """Set the bounds of speeds, accelerations, jerks and lateral accelerations about nominal commands."""
    n, size, (last_v, last_w), (span, *_) = len(nominal), program.g.size, cycle.last, fixed.spans.tolist()
    reverse, forward, rise, fall, yaw_acceleration, jerk, most_lateral, _, _ = fixed.limits.tolist()
    (lowest, highest), (lower, upper) = program.bounds[:, :size], program.bounds[:, size:]
    lowest[0:-2:2], highest[0:-2:2] = -reverse, forward
    lowest[0], highest[0] = cycle.bounds.speed
    speeds, travel = rows.speed_changes, nominal[:, 0] + np.concatenate((nominal[:1, 0], nominal[:-1, 0]))
    either = min(rise, fall)
    lower[speeds] = -np.where(travel > 0.0, fall, np.where(travel < 0.0, rise, either))
    upper[speeds] = np.where(travel > 0.0, rise, np.where(travel < 0.0, fall, either))
    least, most = cycle.bounds.acceleration
    lower[speeds.start], upper[speeds.start] = least + last_v / span, most + last_v / span
    turns = rows.yaw_rate_changes.start
    lower[turns], upper[turns] = last_w / span - yaw_acceleration, last_w / span + yaw_acceleration
    # jerk = (second differences of u) with the last command and its acceleration before the first
    up, down, (first, second, *_) = rows.jerks.start, rows.jerks.start + n, fixed.jerk_spans.tolist()
    known = -(last_v / span + cycle.last_acceleration) / first, last_v / span / second
    for k, value in enumerate(known):
        upper[up + k], upper[down + k] = jerk - value, jerk + value
    # Speed times yaw rate is linearized about the last command and the nominal commands.
    v, w = nominal.T.copy()
    v[0], w[0] = last_v, last_w
    at, sideways = np.arange(n), np.full(n, most_lateral)
    sideways[0] = cycle.bounds.lateral
    program.a[rows.lateral.start + at, 2 * at], program.a[rows.lateral.start + at, 2 * at + 1] = w, v
    lower[rows.lateral], upper[rows.lateral] = -sideways + v * w, sideways + v * w


def _fill_tube(program: QuadraticProgram, rows: slice, found: CondensedErrors, widths: FloatArray) -> None:
    """Bound cross and yaw errors after every step in both directions."""
    n, upper = len(found.errors), program.bounds[1, program.g.size :]
    by, errors = found.by_commands[:, 1:].transpose(1, 0, 2), found.errors[:, 1:].T
    program.a[rows, :-2] = np.stack((by, -by), axis=1).reshape(4 * n, 2 * n)
    upper[rows] = np.stack((widths[:, None] - errors, widths[:, None] + errors), axis=1).reshape(-1)


class TrackingProgram:
    """Program of a robot that is built once, then filled and solved in every cycle.

    Args:
        steps: Number of steps n.
        weights: Weights of the cost.
        ackermann: Whether the curvature of the commands is bounded.
        tube: Half width [m] and yaw error [rad] of the tube by which the errors are bounded; None without a tube.

    Attributes:
        nominal: Commands that follow the reference, of the last cycle, Shape (n, 2) [m/s, rad/s].
    """

    def __init__(self, steps: int, weights: MpcWeights, *, ackermann: bool, tube: tuple[float, float] | None) -> None:
        self._steps, self._weights, self._tube = steps, weights, tube
        self._rows = ProgramRows.of(steps, ackermann=ackermann, in_tube=tube is not None)
        size, rows = 2 * steps + 2, self._rows.tube.stop
        h, bounds = np.zeros((size, size)), np.tile([[-UNBOUNDED], [UNBOUNDED]], size + rows)
        h[[-2, -1], [-2, -1]] = 1.0  # the cost must be positive definite
        bounds[0, size - 2 : size] = 0.0
        self._is_degenerate = ackermann  # bounds of speed and curvature are dependent where steered wheels stand
        g = np.zeros(size)
        g[-2:] = _EXACT
        self._program = QuadraticProgram(h, g, np.zeros((rows, size)), bounds, size - 2, _NO_GUESS, self.load)
        self._fixed = FixedData.of(steps)
        self._fixed.errors[:], self._fixed.change[:] = weights.errors, weights.change
        self._lengths = 0.0, 0.0
        self._limits: MotionLimits | None = None
        self.nominal: FloatArray = np.zeros((steps, 2))

    @functools.cached_property
    def _solver(self) -> DenseProgram:
        rows, size = self._program.a.shape
        return DenseProgram(size, rows, _MOST_ITERATIONS, None if self._is_degenerate else EXACT)

    def load(self) -> DenseProgram:
        """Return DAQP's program, which is made by the first call; this takes longer than a cycle."""
        return self._solver

    def fill(self, cycle: MpcCycle) -> None:
        """Set the data of a cycle."""
        (first, other), (h, h_other), span = cycle.lengths, self._lengths, self._fixed.spans.item(0)
        if max(abs(first - h), abs(other - h_other), abs(cycle.elapsed - span)) > _SAME_TIME:
            self._use_steps(cycle.lengths, cycle.elapsed)
        if cycle.limits is not self._limits:
            self._use_limits(cycle.limits)
        *_, self.nominal = filled(self._program, self._rows, self._fixed, cycle)
        if cycle.curvature is not None:
            self._fill_curvature(cycle, cycle.curvature)

    def solve(self, cycle: MpcCycle) -> Solution | None:
        """Return the optimal commands; None if no solution is found within the iteration limit."""
        self.fill(cycle)
        # The next command must keep the jerk limit; later ones, on a coarse grid, may exceed it a little.
        found, exceeded = self._minimized(), 0.0
        if found is None:
            self._soften_next_jerk(-1.0)
            changes = self._rows.curvature_changes
            self._program.bounds[:, self._program.g.size :][:, changes] = [[-UNBOUNDED], [UNBOUNDED]]
            found = self._minimized()
            exceeded = 0.0 if found is None else found.item(-1)
            self._soften_next_jerk(0.0)
        return None if found is None else Solution(found[:-2].reshape(-1, 2), found.item(-2), exceeded)

    def _minimized(self) -> FloatArray | None:
        """Return the minimizer of the program; the active set of the last cycle is the first guess of the next one.

        DAQP solves degenerate programs, in which `minimizer` may cycle, and those without compiled kernels, because
        `minimizer` in NumPy takes five times as long.
        """
        if not self._is_degenerate and kernels_lane() != "twin":
            found = minimizer(self._program)
            self._program = self._program._replace(guess=_NO_GUESS if found is None else found.active)
            if found is not None:
                return found.solution
        self._solver.fill(self._program)
        return self._solver.solve()

    def _soften_next_jerk(self, slack: float) -> None:
        """Set the coefficient of the slack in the bounds of the next jerk."""
        jerks = self._rows.jerks.start
        self._program.a[jerks, -1] = self._program.a[jerks + self._steps, -1] = slack

    def _use_steps(self, lengths: tuple[float, float], elapsed: float) -> None:
        """Update the differences of the commands and the cost of effort, which depend on the steps alone.

        A command is the mean over its step, so the time between two commands is half the sum of both steps. Their
        difference is the acceleration averaged over a triangular window around the border of the steps; the jerk is
        measured between the centroids of these windows.
        """
        n, a, rows, fixed = self._steps, self._program.a, self._rows, self._fixed
        self._lengths = lengths
        h = np.full(n, lengths[1])
        h[0] = lengths[0]
        fixed.spans[:] = np.concatenate(([elapsed], 0.5 * (h[:-1] + h[1:])))
        centroids = np.cumsum(h[:-1]) + np.diff(h) / 3.0
        fixed.jerk_spans[:] = np.concatenate(([elapsed], np.diff(centroids, prepend=(h[0] - elapsed) / 3.0)))
        difference = np.eye(n) - np.eye(n, k=-1)
        changes = difference / fixed.spans[:, None]
        a[rows.speed_changes, 0:-2:2] = a[rows.yaw_rate_changes, 1:-2:2] = changes
        jerks = difference @ changes / fixed.jerk_spans[:, None]
        a[rows.jerks, 0:-2:2] = np.concatenate((jerks, -jerks))
        a[rows.jerks, -1] = -1.0
        self._soften_next_jerk(0.0)
        for i in range(2):
            smooth = changes.T @ ((self._weights.change[i] * fixed.spans)[:, None] * changes)
            fixed.effort[i::2, i::2] = np.diag(self._weights.effort[i] * h) + smooth

    def _use_limits(self, limits: MotionLimits) -> None:
        """Update the data, rows and bounds that depend on the limits and the tube alone."""
        program, rows, at, self._limits = self._program, self._rows, np.arange(self._steps), limits
        tube = (math.inf, math.inf) if self._tube is None else self._tube
        self._fixed.limits[:] = (
            limits.max_reverse_speed,
            limits.max_speed,
            limits.max_acceleration,
            limits.max_deceleration,
            limits.max_yaw_acceleration,
            limits.max_jerk,
            limits.max_lateral_acceleration,
            *tube,
        )
        size = program.g.size
        both, upper = np.array([[-1.0], [1.0]]), program.bounds[1, size:]
        program.bounds[:, 1 : size - 2 : 2] = both * min(limits.max_yaw_rate, UNBOUNDED)
        most = ((rows.yaw_rate_changes, limits.max_yaw_acceleration), (rows.wheels, limits.max_wheel_speed))
        for block, value in most:
            program.bounds[:, size:][:, block] = both * min(value, UNBOUNDED)
        upper[rows.jerks] = min(limits.max_jerk, UNBOUNDED)
        for half, sign in ((0, 1.0), (1, -1.0)):
            row = rows.wheels.start + half * self._steps + at
            program.a[row, 2 * at], program.a[row, 2 * at + 1] = 1.0, sign * 0.5 * limits.track_width
        # The slack scales the widths of cross and yaw error alike.
        program.a[rows.tube, -2] = np.repeat([-1.0, -tube[1] / tube[0]], 2 * self._steps if self._tube else 0)

    def _fill_curvature(self, cycle: MpcCycle, curvature: FloatArray) -> None:
        """Bound the curvature of the commands of steered wheels, and its changes."""
        program, rows, at, nominal, size = (
            self._program,
            self._rows,
            np.arange(self._steps),
            self.nominal,
            2 * self._steps + 2,
        )
        gear = self._gears(cycle)
        steering, (lowest, highest) = gear != 0.0, program.bounds[:, : size - 2 : 2]
        lowest[gear > 0.0], highest[gear < 0.0] = 0.0, 0.0
        slow = np.maximum(np.abs(curvature).max() * np.abs(nominal[:, 0]), abs(cycle.last[1]))
        for half, sign in ((0, 1.0), (1, -1.0)):
            row = rows.curvature.start + half * self._steps + at
            program.a[row, 2 * at] = -sign * gear * curvature[1 - half]
            program.a[row, 2 * at + 1] = sign * np.where(steering, gear, 1.0)
            program.bounds[1, size + row] = np.where(steering, 0.0, slow)
        self._fill_curvature_changes(nominal, gear, cycle.limits)

    def _gears(self, cycle: MpcCycle) -> FloatArray:
        """Return the signs of the speeds of steered wheels, Shape (n,).

        During a change of gear the sign is unknown; it is 0, and the wheels are kept straight.
        """
        speeds, limits, last = self.nominal[:, 0], cycle.limits, cycle.last[0]
        gear: FloatArray = np.sign(np.where(np.abs(speeds) > _AT_REST, speeds, 0.0))
        braking = braking_time(abs(last), limits.max_deceleration, limits.max_jerk)
        first, other = cycle.lengths
        begins = np.concatenate(([0.0], first + other * np.arange(self._steps - 1)))
        gear[(begins < braking) & (gear != math.copysign(1.0, last))] = 0.0
        return gear

    def _fill_curvature_changes(self, nominal: FloatArray, gear: FloatArray, limits: MotionLimits) -> None:
        """Bound the change of the curvature w / v between commands in motion, linearized about the nominal commands."""
        program, rows, (v, w) = self._program, self._rows.curvature_changes, nominal.T
        lower, upper = program.bounds[:, program.g.size :]
        moving = np.abs(v) > _IN_MOTION
        speed = np.where(moving, v, 1.0)
        curvature = w / speed
        both = np.flatnonzero(moving[1:] & moving[:-1] & (gear[1:] == gear[:-1]) & (gear[1:] != 0.0))
        program.a[rows] = 0.0
        lower[rows], upper[rows] = -UNBOUNDED, UNBOUNDED
        row, change = rows.start + both + 1, curvature[both + 1] - curvature[both]
        for k, sign in ((both + 1, 1.0), (both, -1.0)):
            program.a[row, 2 * k], program.a[row, 2 * k + 1] = -sign * curvature[k] / speed[k], sign / speed[k]
        base = limits.wheelbase
        fastest = limits.max_steering_rate / base if base > 0.0 else np.inf  # change of the curvature [1/(m s)]
        most = np.minimum(fastest * self._fixed.spans[both + 1], UNBOUNDED)
        lower[row], upper[row] = -most - change, most - change
