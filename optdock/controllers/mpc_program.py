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

from optdock.quadratic_program import UNBOUNDED, DenseProgram

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray
    from optdock.model.limits import MotionLimits

__all__ = ["Prediction", "ReferenceArcs", "arcs_between", "predicted", "riccati_back", "step_matrices"]

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
    """Return the arcs between successive poses, Shape (n + 1, 3), yaw continuous, at `times`, Shape (n + 1,) [s]."""
    h, turn = np.diff(times), np.diff(poses[:, 2])
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


class CommandBounds(NamedTuple):
    """Lower and upper bounds of n commands, Shape (2, n) each; infinite without a limit."""

    limits: MotionLimits  # limits of the robot, for bounds that are the same in all steps
    speed: FloatArray  # [m/s]
    acceleration: FloatArray  # between the speeds, the first from the last command [m/s^2]
    lateral: FloatArray  # of speed times yaw rate, linearized about `about` [m/s^2]
    about: FloatArray  # commands, Shape (n, 2)
    curvature: FloatArray | None  # of steered wheels [1/m]; None for a differential drive
    gear: FloatArray  # sign of the speeds of steered wheels, Shape (n,); 0 while unknown: the robot keeps straight


class MpcCycle(NamedTuple):
    """Data of the program for one control cycle."""

    prediction: Prediction  # errors as a function of the commands
    nominal: FloatArray  # commands that follow the reference, first row from the last cycle, Shape (n + 1, 2)
    cost_to_go: FloatArray  # after the last step, Shape (3, 3)
    h: FloatArray  # length of each step, Shape (n,) [s]
    elapsed: float  # time since the last command [s]
    bounds: CommandBounds  # bounds of the commands
    last: FloatArray  # command of the last cycle, Shape (2,)
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
        self._program = DenseProgram(2 * steps + 2, ends[-1], _MOST_ITERATIONS)
        self._program.lbx[-2:] = 0.0
        self._program.h[[-2, -1], [-2, -1]] = 1.0  # DAQP requires a positive definite cost
        self._program.g[-2:] = _EXACT
        self._h: FloatArray = np.zeros(steps)
        self._spans = self._jerk_spans = self._h
        self._changes = np.zeros((steps, steps))
        self._effort = np.zeros((2 * steps, 2 * steps))

    def solve(self, cycle: MpcCycle) -> Solution | None:
        """Return the optimal commands; None if no solution is found within the iteration limit."""
        if max(abs(cycle.elapsed - self._spans[0]), float(np.abs(cycle.h - self._h).max())) > _SAME_TIME:
            self._use_steps(cycle.h, cycle.elapsed)
        self._fill_cost(cycle)
        self._fill_bounds(cycle)
        if cycle.tube is not None:
            self._fill_tube(cycle.prediction, cycle.tube)
        # The next command must keep the jerk limit; later ones, on a coarse grid, may exceed it a little.
        next_command = [self._jerks.start, self._jerks.start + self._steps]
        self._program.a[next_command, -1] = 0.0
        found, exceeded = self._program.solve(), 0.0
        if found is None:
            self._program.a[next_command, -1] = -1.0
            changes = self._curvature_changes
            self._program.lba[changes], self._program.uba[changes] = -UNBOUNDED, UNBOUNDED
            found = self._program.solve()
            exceeded = 0.0 if found is None else float(found[-1])
        return None if found is None else Solution(found[:-2].reshape(-1, 2), float(found[-2]), exceeded)

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

    def _fill_cost(self, cycle: MpcCycle) -> None:
        n, program, weights = self._steps, self._program, self._weights
        errors, by = cycle.prediction.errors[:, :3], cycle.prediction.by_commands[:, :3, :]
        heavy = (cycle.h[:, None] * weights.errors)[:, :, None] * by
        flat = by.reshape(3 * n, 2 * n)
        end = by[-1].T @ cycle.cost_to_go
        program.h[:-2, :-2] = heavy.reshape(3 * n, 2 * n).T @ flat + end @ by[-1] + self._effort
        nominal = cycle.nominal[1:].ravel()
        gradient = heavy.reshape(3 * n, 2 * n).T @ errors.ravel() + end @ errors[-1] - self._effort @ nominal
        # The first change starts at the deviation of the last command from its nominal one.
        gradient[:2] -= weights.change / self._spans[0] * (cycle.last - cycle.nominal[0])
        program.g[:-2] = gradient

    def _fill_bounds(self, cycle: MpcCycle) -> None:
        program, bounds, last, limits = self._program, cycle.bounds, cycle.last, cycle.bounds.limits
        lower, upper, a = program.lba, program.uba, program.a
        program.lbx[0:-2:2], program.ubx[0:-2:2] = bounds.speed
        program.lbx[1:-2:2], program.ubx[1:-2:2] = -limits.max_yaw_rate, limits.max_yaw_rate
        lower[self._speed_changes], upper[self._speed_changes] = bounds.acceleration
        most = limits.max_yaw_acceleration
        lower[self._yaw_rate_changes], upper[self._yaw_rate_changes] = -most, most
        for i, rows in enumerate((self._speed_changes, self._yaw_rate_changes)):
            lower[rows.start] += last[i] / self._spans[0]
            upper[rows.start] += last[i] / self._spans[0]
        # jerk = (second differences of u) with the last command and its acceleration before the first
        known = np.zeros(self._steps)
        known[0] = -(last[0] / self._spans[0] + cycle.last_acceleration) / self._jerk_spans[0]
        known[1] = last[0] / self._spans[0] / self._jerk_spans[1]
        upper[self._jerks] = limits.max_jerk - np.concatenate((known, -known))
        at = np.arange(self._steps)
        for half, sign in ((0, 1.0), (1, -1.0)):
            row = self._wheels.start + half * self._steps + at
            a[row, 2 * at], a[row, 2 * at + 1] = 1.0, sign * 0.5 * limits.track_width
            lower[row], upper[row] = -limits.max_wheel_speed, limits.max_wheel_speed
        row, (v, w) = self._lateral.start + at, bounds.about.T
        a[row, 2 * at], a[row, 2 * at + 1] = w, v
        lower[row], upper[row] = bounds.lateral + v * w
        if bounds.curvature is not None:
            steering = bounds.gear != 0.0
            slow = np.maximum(np.max(np.abs(bounds.curvature)) * np.abs(cycle.nominal[1:, 0]), abs(last[1]))
            for half, sign in ((0, 1.0), (1, -1.0)):
                row = self._curvature.start + half * self._steps + at
                a[row, 2 * at] = -sign * bounds.gear * bounds.curvature[1 - half]
                a[row, 2 * at + 1] = sign * np.where(steering, bounds.gear, 1.0)
                upper[row] = np.where(steering, 0.0, slow)
            self._fill_curvature_changes(cycle.nominal[1:], bounds)
        for values in (lower, upper, program.lbx, program.ubx):  # several times as fast as np.clip
            np.minimum(np.maximum(values, -UNBOUNDED, out=values), UNBOUNDED, out=values)

    def _fill_curvature_changes(self, nominal: FloatArray, bounds: CommandBounds) -> None:
        """Bound the change of the curvature w / v between commands in motion, linearized about the nominal commands."""
        program, (v, w) = self._program, nominal.T
        moving = np.abs(v) > _IN_MOTION
        speed = np.where(moving, v, 1.0)
        curvature = w / speed
        both = np.flatnonzero(
            moving[1:] & moving[:-1] & (bounds.gear[1:] == bounds.gear[:-1]) & (bounds.gear[1:] != 0.0)
        )
        rows = self._curvature_changes
        program.a[rows] = 0.0
        program.lba[rows], program.uba[rows] = -UNBOUNDED, UNBOUNDED
        row, change = rows.start + both + 1, curvature[both + 1] - curvature[both]
        for k, sign in ((both + 1, 1.0), (both, -1.0)):
            program.a[row, 2 * k], program.a[row, 2 * k + 1] = -sign * curvature[k] / speed[k], sign / speed[k]
        base = bounds.limits.wheelbase
        fastest = bounds.limits.max_steering_rate / base if base > 0.0 else np.inf  # change of the curvature [1/(m s)]
        most = np.minimum(fastest * self._spans[both + 1], UNBOUNDED)
        program.lba[row], program.uba[row] = -most - change, most - change

    def _fill_tube(self, prediction: Prediction, tube: tuple[float, float]) -> None:
        """Bound cross and yaw errors after every step in both directions, relaxed by the slack."""
        program, n = self._program, self._steps
        for i, width in enumerate(tube):
            by, errors = prediction.by_commands[:, 1 + i, :], prediction.errors[:, 1 + i]
            for half, sign in ((0, 1.0), (1, -1.0)):
                first = self._tube.start + (2 * i + half) * n
                program.a[first : first + n, :-2] = sign * by
                # The slack scales the widths of cross and yaw error alike.
                program.a[first : first + n, -2] = -width / tube[0]
                program.uba[first : first + n] = width - sign * errors
