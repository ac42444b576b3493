"""The tracking problem over a short horizon as a quadratic program, solved by DAQP.

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

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.kernels import Kernel, twin_of
from optdock.quadratic_program import UNBOUNDED, DenseProgram

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
_SAME_TIME = 1e-6  # [s]: a smaller change of the steps counts as zero
_MOST_ITERATIONS = 300  # of the active-set method, about 3 ms; a warm start takes 20


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


_CONDENSE = Kernel("optdock_condense", sizes=1, numbers=1)


def _condensed_natively(
    poses: FloatArray, h: FloatArray, lag: float, state: FloatArray, weights: FloatArray, after: FloatArray
) -> CondensedErrors:
    n = h.size
    ends = 2 * n, 5 * n, 5 * n + 6 * n * n, 5 * n + 10 * n * n, 7 * n + 10 * n * n
    out = np.empty(ends[-1] + 10 * n)
    arrays = (poses, 6 * (n + 1)), (h, n), (state, 5), (weights, 3), (after, 9), (out, out.size)
    _CONDENSE((n,), (lag,), arrays)
    return CondensedErrors(
        out[: ends[0]].reshape(n, 2),
        out[ends[0] : ends[1]].reshape(n, 3),
        out[ends[1] : ends[2]].reshape(n, 3, 2 * n),
        out[ends[2] : ends[3]].reshape(2 * n, 2 * n),
        out[ends[3] : ends[4]],
    )


@twin_of(_condensed_natively)
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
    """Lower and upper bounds of n commands, Shape (2, n) each; infinite without a limit."""

    limits: MotionLimits  # limits of the robot, for bounds that are the same in all steps
    speed: FloatArray  # [m/s]
    acceleration: FloatArray  # between the speeds, the first from the last command [m/s^2]
    lateral: FloatArray  # of speed times yaw rate, linearized about the last command and then the nominal ones [m/s^2]
    curvature: FloatArray | None  # of steered wheels [1/m]; None for a differential drive
    gear: (
        FloatArray | None
    )  # sign of the speeds of steered wheels, Shape (n,); 0 while unknown: the robot keeps straight


class MpcCycle(NamedTuple):
    """Data of the program for one control cycle."""

    condensed: CondensedErrors  # errors as a function of the commands
    nominal_before: tuple[float, float]  # command that follows the reference, from the last cycle
    h: FloatArray  # length of each step, Shape (n,) [s]
    elapsed: float  # time since the last command [s]
    bounds: CommandBounds  # bounds of the commands
    last: tuple[float, float]  # command of the last cycle
    last_acceleration: float  # acceleration of that command [m/s^2]
    tube: tuple[float, float] | None  # half width [m] and yaw error [rad] of the tube; None without a tube


class Solution(NamedTuple):
    """Commands, Shape (n, 2), largest excess [m] over the tube, and excess [m/s^3] of the next jerk over its limit."""

    commands: FloatArray
    outside: float
    over_jerk: float


class TrackingProgram:
    """Program of a robot that is built once, then filled and solved in every cycle.

    Args:
        steps: Number of steps n.
        weights: Weights of the cost.
        ackermann: Whether the curvature of the commands is bounded.
        in_tube: Whether the errors are bounded by a tube.
    """

    def __init__(self, steps: int, weights: MpcWeights, *, ackermann: bool, in_tube: bool) -> None:
        self._steps, self._weights = steps, weights
        steered = steps if ackermann else 0
        counts = [steps, steps, 2 * steps, 2 * steps, steps, 2 * steered, steered, 4 * steps * in_tube]
        ends = [int(end) for end in np.cumsum(counts)]
        blocks = [slice(end - count, end) for count, end in zip(counts, ends, strict=True)]
        self._speed_changes, self._yaw_rate_changes, self._jerks, self._wheels, self._lateral = blocks[:5]
        self._curvature, self._curvature_changes, self._tube = blocks[5:]
        self._program = program = DenseProgram(2 * steps + 2, ends[-1], _MOST_ITERATIONS)
        program.lbx[-2:] = 0.0
        program.h[[-2, -1], [-2, -1]] = 1.0  # DAQP requires a positive definite cost
        program.g[-2:] = _EXACT
        self._h: FloatArray = np.zeros(steps)
        self._spans = self._jerk_spans = self._h
        self._changes = np.zeros((steps, steps))
        self._effort = np.zeros((2 * steps, 2 * steps))
        self._limits: MotionLimits | None = None
        # Views of the coefficients that change in every cycle, which are as quick to fill as a whole array.
        self._cost = program.h.T[:-2, :-2]
        rows, width = program.a.shape[0], program.a.T.reshape(-1)
        self._by_speed, self._by_yaw_rate = (
            width[i * rows + self._lateral.start :: 2 * rows + 1][:steps] for i in range(2)
        )
        halves = (2 * steps, 2, 2, steps) if in_tube else (2 * steps, 0, 2, steps)
        tube = program.a.T[:-2, self._tube].reshape(halves)  # by command, by error, upper and lower, by step
        self._tube_upper, self._tube_lower = tube[:, :, 0], tube[:, :, 1]
        self._tube_bounds = program.uba[self._tube].reshape(halves[1:])

    def solve(self, cycle: MpcCycle) -> Solution | None:
        """Return the optimal commands; None if no solution is found within the iteration limit."""
        if max(abs(cycle.elapsed - self._spans[0]), float(np.abs(cycle.h - self._h).max())) > _SAME_TIME:
            self._use_steps(cycle.h, cycle.elapsed)
        if cycle.bounds.limits is not self._limits:
            self._use_limits(cycle.bounds.limits)
        self._fill_cost(cycle)
        self._fill_bounds(cycle)
        if cycle.bounds.curvature is not None and cycle.bounds.gear is not None:
            self._fill_curvature(cycle, cycle.bounds.curvature, cycle.bounds.gear)
        if cycle.tube is not None:
            self._fill_tube(cycle.condensed, cycle.tube)
        # The next command must keep the jerk limit; later ones, on a coarse grid, may exceed it a little.
        self._soften_next_jerk(0.0)
        found, exceeded = self._program.solve(), 0.0
        if found is None:
            self._soften_next_jerk(-1.0)
            changes = self._curvature_changes
            self._program.lba[changes], self._program.uba[changes] = -UNBOUNDED, UNBOUNDED
            found = self._program.solve()
            exceeded = 0.0 if found is None else float(found[-1])
        return None if found is None else Solution(found[:-2].reshape(-1, 2), float(found[-2]), exceeded)

    def _soften_next_jerk(self, slack: float) -> None:
        """Set the coefficient of the slack in the bounds of the next jerk."""
        self._program.a[self._jerks.start, -1] = self._program.a[self._jerks.start + self._steps, -1] = slack

    def _use_steps(self, h: FloatArray, elapsed: float) -> None:
        """Update the differences of the commands and the cost of effort, which depend on the steps alone.

        A command is the mean over its step, so the time between two commands is half the sum of both steps. Their
        difference is the acceleration averaged over a triangular window around the border of the steps; the jerk is
        measured between the centroids of these windows.
        """
        n, program = self._steps, self._program
        self._h = h.copy()
        self._spans = np.concatenate(([elapsed], 0.5 * (h[:-1] + h[1:])))
        centroids = np.cumsum(h[:-1]) + np.diff(h) / 3.0
        self._jerk_spans = np.concatenate(([elapsed], np.diff(centroids, prepend=(h[0] - elapsed) / 3.0)))
        difference = np.eye(n) - np.eye(n, k=-1)
        self._changes = difference / self._spans[:, None]
        program.a[self._speed_changes, 0:-2:2] = self._changes
        program.a[self._yaw_rate_changes, 1:-2:2] = self._changes
        up = slice(self._jerks.start, self._jerks.start + n)
        down = slice(up.stop, self._jerks.stop)
        program.a[up, 0:-2:2] = difference @ self._changes / self._jerk_spans[:, None]
        program.a[down, 0:-2:2] = -program.a[up, 0:-2:2]
        program.a[self._jerks, -1] = -1.0
        for i in range(2):
            smooth = self._changes.T @ ((self._weights.change[i] * self._spans)[:, None] * self._changes)
            self._effort[i::2, i::2] = np.diag(self._weights.effort[i] * h) + smooth

    def _use_limits(self, limits: MotionLimits) -> None:
        """Update the rows that depend on the limits alone."""
        program, at, self._limits = self._program, np.arange(self._steps), limits
        lower, upper = program.lba, program.uba

        def bounded(value: float) -> float:
            return min(value, UNBOUNDED)

        program.lbx[1:-2:2], program.ubx[1:-2:2] = -bounded(limits.max_yaw_rate), bounded(limits.max_yaw_rate)
        most = bounded(limits.max_yaw_acceleration)
        lower[self._yaw_rate_changes], upper[self._yaw_rate_changes] = -most, most
        upper[self._jerks] = bounded(limits.max_jerk)
        most = bounded(limits.max_wheel_speed)
        lower[self._wheels], upper[self._wheels] = -most, most
        for half, sign in ((0, 1.0), (1, -1.0)):
            row = self._wheels.start + half * self._steps + at
            program.a[row, 2 * at], program.a[row, 2 * at + 1] = 1.0, sign * 0.5 * limits.track_width

    def _fill_cost(self, cycle: MpcCycle) -> None:
        program, errors, (v, w) = self._program, cycle.condensed, cycle.nominal_before
        np.add(errors.hessian, self._effort, out=self._cost)
        gradient = errors.gradient - self._effort @ errors.nominal.reshape(-1)
        # The first change starts at the deviation of the last command from its nominal one.
        per_speed, per_yaw_rate = (self._weights.change / self._spans[0]).tolist()
        gradient[0] -= per_speed * (cycle.last[0] - v)
        gradient[1] -= per_yaw_rate * (cycle.last[1] - w)
        program.g[:-2] = gradient

    def _fill_bounds(self, cycle: MpcCycle) -> None:
        program, bounds, (last_v, last_w), limits = self._program, cycle.bounds, cycle.last, cycle.bounds.limits
        lower, upper, speeds, turns = program.lba, program.uba, self._speed_changes, self._yaw_rate_changes.start
        (span, *_), (first, second, *_) = self._spans.tolist(), self._jerk_spans.tolist()
        program.lbx[0:-2:2], program.ubx[0:-2:2] = bounds.speed
        lower[speeds], upper[speeds] = bounds.acceleration
        lower[speeds.start] += last_v / span
        upper[speeds.start] += last_v / span
        lower[turns] = last_w / span - limits.max_yaw_acceleration
        upper[turns] = last_w / span + limits.max_yaw_acceleration
        # jerk = (second differences of u) with the last command and its acceleration before the first
        up, down = self._jerks.start, self._jerks.start + self._steps
        known = -(last_v / span + cycle.last_acceleration) / first, last_v / span / second
        for k, value in enumerate(known):
            upper[up + k], upper[down + k] = limits.max_jerk - value, limits.max_jerk + value
        v, w = self._by_yaw_rate, self._by_speed
        v[:], w[:] = cycle.condensed.nominal.T
        v[0], w[0] = last_v, last_w
        lower[self._lateral], upper[self._lateral] = bounds.lateral + v * w
        for values in (lower, upper, program.lbx, program.ubx):  # several times as fast as np.clip
            np.minimum(np.maximum(values, -UNBOUNDED, out=values), UNBOUNDED, out=values)

    def _fill_curvature(self, cycle: MpcCycle, curvature: FloatArray, gear: FloatArray) -> None:
        """Bound the curvature of the commands of steered wheels, and its changes."""
        program, at, nominal, steering = self._program, np.arange(self._steps), cycle.condensed.nominal, gear != 0.0
        slow = np.maximum(np.abs(curvature).max() * np.abs(nominal[:, 0]), abs(cycle.last[1]))
        for half, sign in ((0, 1.0), (1, -1.0)):
            row = self._curvature.start + half * self._steps + at
            program.a[row, 2 * at] = -sign * gear * curvature[1 - half]
            program.a[row, 2 * at + 1] = sign * np.where(steering, gear, 1.0)
            program.uba[row] = np.where(steering, 0.0, slow)
        self._fill_curvature_changes(nominal, gear, cycle.bounds.limits)

    def _fill_curvature_changes(self, nominal: FloatArray, gear: FloatArray, limits: MotionLimits) -> None:
        """Bound the change of the curvature w / v between commands in motion, linearized about the nominal commands."""
        program, (v, w) = self._program, nominal.T
        moving = np.abs(v) > _IN_MOTION
        speed = np.where(moving, v, 1.0)
        curvature = w / speed
        both = np.flatnonzero(moving[1:] & moving[:-1] & (gear[1:] == gear[:-1]) & (gear[1:] != 0.0))
        rows = self._curvature_changes
        program.a[rows] = 0.0
        program.lba[rows], program.uba[rows] = -UNBOUNDED, UNBOUNDED
        row, change = rows.start + both + 1, curvature[both + 1] - curvature[both]
        for k, sign in ((both + 1, 1.0), (both, -1.0)):
            program.a[row, 2 * k], program.a[row, 2 * k + 1] = -sign * curvature[k] / speed[k], sign / speed[k]
        base = limits.wheelbase
        fastest = limits.max_steering_rate / base if base > 0.0 else np.inf  # change of the curvature [1/(m s)]
        most = np.minimum(fastest * self._spans[both + 1], UNBOUNDED)
        program.lba[row], program.uba[row] = -most - change, most - change

    def _fill_tube(self, found: CondensedErrors, tube: tuple[float, float]) -> None:
        """Bound cross and yaw errors after every step in both directions, relaxed by the slack."""
        by = found.by_commands[:, 1:].transpose(2, 1, 0)
        self._tube_upper[...] = by
        np.negative(by, out=self._tube_lower)
        errors, widths = found.errors[:, 1:].T, np.array([[tube[0]], [tube[1]]])
        self._tube_bounds[:, 0], self._tube_bounds[:, 1] = widths - errors, widths + errors
        # The slack scales the widths of cross and yaw error alike.
        slack = self._program.a[self._tube, -2]
        slack[: slack.size // 2], slack[slack.size // 2 :] = -1.0, -tube[1] / tube[0]
