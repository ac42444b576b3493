"""References of the timing benchmark: the jerk-limited optimum by direct transcription, the bound without jerk.

B is a local optimum of a nonlinear program, not a certificate; the benchmark solves it from two initial guesses and
checks its grid by doubling. A relaxes the jerk limit: a lower bound of the duration.
"""

from __future__ import annotations

import itertools
import logging
import math
from typing import TYPE_CHECKING, NamedTuple

import casadi as ca
import numpy as np

from experiments.benchmarks.timing_paths import GaussianSegment
from optdock.model.path import ClothoidSegment
from optdock.timing.path_limits import limits_along

if TYPE_CHECKING:
    from collections.abc import Callable

    from experiments.benchmarks.timing_paths import Case
    from optdock.geometry.arrays import FloatArray
    from optdock.model.constant_jerk import TimeLaw
    from optdock.model.limits import MotionLimits
    from optdock.model.path import Segment

__all__ = ["acceleration_bound", "jerk_limited_optimum"]

_BOUND_POINTS = 1500


class _Stretch(NamedTuple):
    """A part of a gear with smooth curvature and one speed limit, [left, right] m within the gear."""

    left: float
    right: float
    speed: float
    curve: Callable[[ca.SX], tuple[ca.SX, ca.SX]]


def jerk_limited_optimum(case: Case, guess: TimeLaw, intervals: int = 300) -> float:
    """Return the duration of the whole path under all limits, jerk included [s].

    Args:
        case: The problem.
        guess: Any feasible time law, the initial iterate.
        intervals: Number of intervals of constant jerk, per gear.

    Raises:
        RuntimeError: If IPOPT does not converge.
    """
    total, start = 0.0, case.start
    curves = case.curves or case.path.segments
    for segment, begin in zip(curves, case.path.segment_starts[:-1], strict=True):
        stretches = _stretches(case, segment, float(begin))
        total += _gear_optimum(stretches, case.limits, start, _shifted(guess, float(begin), segment.length), intervals)
        start = (0.0, 0.0)
    return total


def _shifted(guess: TimeLaw, begin: float, length: float) -> FloatArray:
    """Return time, distance, speed, acceleration of one gear of the guess, Shape (4, n)."""
    times = np.linspace(0.0, guess.duration, 20000)
    s, v, a, _j = guess.at(times).T
    inside = (s >= begin) & (s <= begin + length)
    return np.stack((times[inside] - times[inside][0], s[inside] - begin, v[inside], a[inside]))


def _stretches(case: Case, segment: Segment, begin: float) -> list[_Stretch]:
    zone = min(max(case.path.length - case.zone.distance - begin, 0.0), segment.length)
    speed = case.limits.max_speed if segment.direction > 0 else case.limits.max_reverse_speed
    knots = np.union1d(segment.knots, [zone])
    knots = knots[np.concatenate(([True], np.diff(knots) > 1e-9))]
    slow = min(speed, case.zone.speed)
    return [
        _Stretch(float(a), float(b), slow if a >= zone - 1e-9 else speed, _curve_of(segment, float(a), float(b)))
        for a, b in itertools.pairwise(knots)
    ]


def _curve_of(segment: Segment, left: float, right: float) -> Callable[[ca.SX], tuple[ca.SX, ca.SX]]:
    if isinstance(segment, ClothoidSegment):
        k0, k1 = segment.curvature_at([left, right])
        rate = float((k1 - k0) / (right - left))
        return lambda s: (float(k0) + rate * (s - left), ca.SX(rate) + 0.0 * s)
    if not isinstance(segment, GaussianSegment):
        raise TypeError(f"no symbolic curvature for {type(segment).__name__}")
    return lambda s: _gaussian_curve(segment, s)


def _gaussian_curve(segment: GaussianSegment, s: ca.SX) -> tuple[ca.SX, ca.SX]:
    point = ca.SX.sym("s")
    value = sum(
        float(top) * ca.exp(-0.5 * ((point - float(centre)) / float(width)) ** 2)
        for centre, width, top in zip(segment.centres, segment.widths, segment.amplitudes, strict=True)
    )
    curvature = 2.5 * ca.tanh(value / 2.5)
    if segment.tapered:
        curvature = curvature * (1.0 - (point / segment.length) ** 6)
    function = ca.Function("curve", [point], [curvature, ca.gradient(curvature, point)])
    found = function.map(s.numel())(s.T)
    return found[0].T, found[1].T


class _Program:
    """Variables, constraints and initial iterate of one gear's nonlinear program, stretch by stretch."""

    def __init__(self, limits: MotionLimits, guess: FloatArray) -> None:
        self.limits, self.guess = limits, guess
        self.x: list[ca.SX] = []
        self.start: list[FloatArray] = []
        self.lower: list[FloatArray] = []
        self.upper: list[FloatArray] = []
        self.g: list[ca.SX] = []
        self.g_lower: list[FloatArray] = []
        self.g_upper: list[FloatArray] = []
        self.cost = ca.SX(0.0)

    def variable(self, name: str, start: FloatArray, lower: float, upper: float) -> ca.SX:
        found = ca.SX.sym(name, start.size)
        self.x.append(found)
        self.start.append(start)
        self.lower.append(np.full(start.size, lower))
        self.upper.append(np.full(start.size, upper))
        return found

    def bound(self, value: ca.SX, lower: float, upper: float) -> None:
        if np.isfinite(lower) or np.isfinite(upper):
            self.g.append(value)
            self.g_lower.append(np.full(value.numel(), lower))
            self.g_upper.append(np.full(value.numel(), upper))

    def stretch(self, part: _Stretch, intervals: int, before: ca.SX | None) -> ca.SX:
        """Add one stretch of `intervals` constant-jerk intervals; return its last state."""
        limits = self.limits
        t, s, v, a = self.guess
        left, right = np.searchsorted(s, (part.left, part.right - 1e-12))
        times = np.linspace(t[min(left, t.size - 1)], t[min(right, t.size - 1)], intervals + 1)
        s = self.variable("s", np.clip(np.interp(times, t, s), part.left, part.right), part.left, part.right)
        v = self.variable("v", np.maximum(np.interp(times, t, v), 1e-3), 0.0, part.speed)
        a = self.variable("a", np.interp(times, t, a), -limits.max_deceleration, limits.max_acceleration)
        j = self.variable("j", np.zeros(intervals), -limits.max_jerk, limits.max_jerk)
        total = self.variable("T", np.array([max(times[-1] - times[0], 1e-3)]), 1e-4, 1e3)
        dt = total / intervals
        self._dynamics(s, v, a, j, dt)
        self._limits(part, s, v, a)
        self.bound(s[0] - part.left, 0.0, 0.0)
        self.bound(s[-1] - part.right, 0.0, 0.0)
        if before is not None:
            self.bound(ca.vertcat(v[0], a[0]) - before, 0.0, 0.0)
        self.cost += total
        self.first = ca.vertcat(v[0], a[0]) if before is None else self.first
        return ca.vertcat(v[-1], a[-1])

    def _dynamics(self, s: ca.SX, v: ca.SX, a: ca.SX, j: ca.SX, dt: ca.SX) -> None:
        s0, v0, a0 = s[:-1], v[:-1], a[:-1]
        self.bound(s[1:] - (s0 + dt * (v0 + dt * (a0 / 2.0 + dt * j / 6.0))), 0.0, 0.0)
        self.bound(v[1:] - (v0 + dt * (a0 + dt * j / 2.0)), 0.0, 0.0)
        self.bound(a[1:] - (a0 + dt * j), 0.0, 0.0)

    def _limits(self, part: _Stretch, s: ca.SX, v: ca.SX, a: ca.SX) -> None:
        limits = self.limits
        curvature, rate = part.curve(s)
        half = 0.5 * limits.track_width
        for value, top in (
            (v * curvature, limits.max_yaw_rate),
            (v * v * curvature, limits.max_lateral_acceleration),
            (a * curvature + v * v * rate, limits.max_yaw_acceleration),
        ):
            self.bound(value, -top, top)
        if math.isfinite(limits.max_lateral_jerk):
            sideways = v * (2.0 * a * curvature + v * v * rate)
            self.bound(sideways, -limits.max_lateral_jerk, limits.max_lateral_jerk)
        for sign in (1.0, -1.0):
            self.bound(v * (1.0 + sign * half * curvature), -np.inf, limits.max_wheel_speed)

    def solve(self) -> float:
        problem = {"x": ca.vertcat(*self.x), "f": self.cost, "g": ca.vertcat(*self.g)}
        options = {
            "ipopt.print_level": 0,
            "print_time": False,
            "ipopt.sb": "yes",
            "ipopt.max_iter": 600,
            "ipopt.tol": 1e-7,
        }
        solver = ca.nlpsol("timing", "ipopt", problem, options)
        found = solver(
            x0=np.concatenate(self.start),
            lbx=np.concatenate(self.lower),
            ubx=np.concatenate(self.upper),
            lbg=np.concatenate(self.g_lower),
            ubg=np.concatenate(self.g_upper),
        )
        if not solver.stats()["success"]:
            raise RuntimeError(f"IPOPT: {solver.stats()['return_status']}")
        return float(found["f"])


def _gear_optimum(
    stretches: list[_Stretch], limits: MotionLimits, start: tuple[float, float], guess: FloatArray, intervals: int
) -> float:
    program = _Program(limits, guess)
    times = np.interp([part.left for part in stretches] + [stretches[-1].right], guess[1], guess[0])
    state: ca.SX | None = None
    for part, time in zip(stretches, np.diff(times), strict=True):
        count = max(4 if len(stretches) > 2 else 60, round(intervals * time / times[-1]))
        state = program.stretch(part, count, state)
    program.bound(program.first - ca.DM(start), 0.0, 0.0)
    program.bound(state, 0.0, 0.0)
    return program.solve()


def acceleration_bound(case: Case) -> float:
    """Return the duration without the jerk limit by TOPP-RA, with all other limits [s].

    Raises:
        RuntimeError: If TOPP-RA finds no profile.
    """
    logging.getLogger("toppra").setLevel(logging.ERROR)
    total, speed = 0.0, case.start[0]
    for limits in limits_along(case.path, case.limits, case.zone):
        if limits is not None:
            s = np.linspace(0.0, limits.length, _BOUND_POINTS)
            points = limits.points_at(s)
            total += _fastest(s, points.curvature, points.rate, points.slowness**-2.0, speed, case.limits)
        speed = 0.0
    return total


def _fastest(
    s: FloatArray, curvature: FloatArray, rate: FloatArray, cap: FloatArray, speed: float, limits: MotionLimits
) -> float:
    from toppra import SplineInterpolator
    from toppra.algorithm import TOPPRA
    from toppra.constraint import LinearConstraint

    spin = np.full_like(s, min(limits.max_yaw_acceleration, 1e6))
    one, zero = np.ones_like(s), np.zeros_like(s)
    along = np.stack((one, -one, curvature, -curvature), axis=1)  # times d^2 s / dt^2
    bend = np.stack((zero, zero, rate, -rate), axis=1)  # times (ds / dt)^2
    top = np.stack((limits.max_acceleration * one, limits.max_deceleration * one, spin, spin), axis=1)

    class Limits(LinearConstraint):  # type: ignore[misc] # toppra ships no types
        def compute_constraint_params(self, *_args: object, **_options: object) -> tuple[object, ...]:
            rows = np.tile(np.eye(4), (s.size, 1, 1))
            box = np.stack((zero, cap), axis=1)
            return along, bend, np.zeros_like(along), rows, top, None, box

    straight = SplineInterpolator([0.0, s[-1]], [0.0, s[-1]])
    _sdd, speeds, _ = TOPPRA([Limits()], straight, gridpoints=s, parametrizer=None).compute_parameterization(speed, 0.0)
    if speeds is None:
        raise RuntimeError("TOPP-RA: no profile")
    return float(np.sum(2.0 * np.diff(s) / (speeds[:-1] + speeds[1:])))
