"""The proof of the limits that depend on curvature.

Within a cell (no phase border, no knot of the path inside) jerk and curvature rate are constant, so every limited
quantity f(t) is smooth and `max |f| <= max(|f(t0)|, |f(t1)|) + width^2 / 8 * max |f''|`. With v the speed, a its rate,
j the jerk, k the curvature and r its rate per metre:

    yaw rate v k          f'' = j k + 3 a v r
    lateral v^2 k         f'' = 2 a^2 k + 2 v j k + 5 v^2 a r
    yaw acc. a k + v^2 r  f'' = 4 j v r + 3 a^2 r
    wheel v (1 +- b k/2)  f'' = j +- b/2 (j k + 3 a v r)

Speed and acceleration are exact: polynomials of degree 2 and 1. Cells that the bound does not clear are cut in two.

A polyline is judged twice: with the curvature that it claims between its poses, and with that of its steps.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.path import PolylineSegment
from optdock.verification.certificate import Violation

if TYPE_CHECKING:
    from collections.abc import Mapping

    from optdock.geometry.arrays import FloatArray, IntArray
    from optdock.limits import MotionLimits
    from optdock.path import Path
    from optdock.trajectory import TimeLaw, Trajectory

__all__ = ["RTOL", "curved_limits", "times_at"]

RTOL = 1e-6  # accepted excess over a limit, relative
SAMPLED_RTOL = 0.05  # likewise of a polyline's step, whose curvature is a difference quotient
_MAX_WIDTH = 0.05  # [s], first cells
_MAX_GRID = 20_000  # first cells of a long motion are wider
_MAX_LEVELS = 22
_BISECTIONS = 50  # leave 1e-15 of a phase


class _Cells(NamedTuple):
    """Motion at the first instant of each cell, Shape (n,) each; everything but r, j, width changes within it."""

    t: FloatArray
    width: FloatArray
    s: FloatArray
    v: FloatArray
    a: FloatArray
    j: FloatArray
    k: FloatArray
    r: FloatArray

    def advanced(self, dt: FloatArray) -> _Cells:
        """The motion `dt` later, by the cell's own polynomials."""
        gain = dt * (self.v + dt * (self.a / 2.0 + dt * self.j / 6.0))
        v = self.v + dt * (self.a + dt * self.j / 2.0)
        return self._replace(
            t=self.t + dt, width=self.width - dt, s=self.s + gain, v=v, a=self.a + dt * self.j, k=self.k + self.r * gain
        )

    def rows(self, keep: IntArray) -> _Cells:
        """The cells at `keep`."""
        return _Cells(*(column[keep] for column in self))

    def and_also(self, more: _Cells) -> _Cells:
        """These cells, then more."""
        return _Cells(*(np.concatenate(columns) for columns in zip(self, more, strict=True)))

    def halves(self) -> _Cells:
        """Every cell cut in two."""
        half = 0.5 * self.width
        return self._replace(width=half).and_also(self.advanced(half))


def times_at(law: TimeLaw, s: FloatArray) -> FloatArray:
    """First times at which the distance reaches `s`, Shape (n,) [s]; bisection, as s(t) never decreases."""
    phase = np.clip(np.searchsorted(law.states[:, 0], s, side="left") - 1, 0, law.durations.size - 1)
    base, v, a = law.states[phase].T
    half_a, sixth_j, wanted = a / 2.0, law.jerks[phase] / 6.0, s - base
    low: FloatArray = np.zeros(s.size)
    high: FloatArray = law.durations[phase]
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        ahead = middle * (v + middle * (half_a + middle * sixth_j)) >= wanted
        low, high = np.where(ahead, low, middle), np.where(ahead, middle, high)
    times: FloatArray = law.times[phase] + 0.5 * (low + high)
    return times


def _initial_cells(trajectory: Trajectory) -> _Cells:
    """Cells between phase borders, knot crossings and a grid of `_MAX_WIDTH`."""
    law, path = trajectory.time_law, trajectory.path
    knots = np.concatenate(
        [segment.knots + start for segment, start in zip(path.segments, path.segment_starts[:-1], strict=True)]
    )
    grid = np.linspace(0.0, law.duration, int(min(np.ceil(law.duration / _MAX_WIDTH), _MAX_GRID)) + 1)
    t = np.unique(np.concatenate((law.times, grid, times_at(law, knots[1:-1]))))
    t = t[np.concatenate(([True], np.diff(t) > 1e-13))]
    middle = 0.5 * (t[:-1] + t[1:])
    phase = np.searchsorted(law.times, middle) - 1
    dt = t[:-1] - law.times[phase]
    s0, v0, a0 = law.states[phase].T
    j = law.jerks[phase]
    s = s0 + dt * (v0 + dt * (a0 / 2.0 + dt * j / 6.0))
    at_middle = law.at(middle)[:, 0]
    r = path.curvature_rate_at(at_middle)
    k = path.curvature_at(at_middle) - r * (at_middle - s)
    cells = _Cells(t[:-1], np.diff(t), s, v0 + dt * (a0 + dt * j / 2.0), a0 + dt * j, j, k, r)
    return cells.and_also(_sampled(cells, path, at_middle))


def _sampled(cells: _Cells, path: Path, at: FloatArray) -> _Cells:
    """The cells within polylines, turning as the steps do: their curvature is constant, not that between poses."""
    owner = np.clip(np.searchsorted(path.segment_starts, at, side="right") - 1, 0, len(path.segments) - 1)
    curvature = np.full(at.size, np.nan)
    for i, segment in enumerate(path.segments):
        if isinstance(segment, PolylineSegment):
            mine = owner == i
            step = np.searchsorted(segment.knots, at[mine] - path.segment_starts[i], side="right") - 1
            curvature[mine] = segment.step_curvature[np.clip(step, 0, segment.knots.size - 2)] / (1.0 + SAMPLED_RTOL)
    keep = np.flatnonzero(np.isfinite(curvature))
    return cells._replace(k=curvature, r=np.zeros(at.size)).rows(keep)


def _quantities(cells: _Cells, track: float) -> Mapping[str, FloatArray]:
    v, a, k, r = cells.v, cells.a, cells.k, cells.r
    return {
        "yaw_rate": np.abs(v * k),
        "lateral_acceleration": v * v * np.abs(k),
        "yaw_acceleration": np.abs(a * k + v * v * r),
        "wheel_speed": np.abs(v) * (1.0 + 0.5 * track * np.abs(k)),
    }


def _bend(first: _Cells, last: _Cells, track: float) -> Mapping[str, FloatArray]:
    """Bounds of |f''| over each cell."""
    # Speed is a parabola with second derivative j: it leaves the chord by at most |j| width^2 / 8.
    v = np.maximum(np.abs(first.v), np.abs(last.v)) + np.abs(first.j) * first.width**2 / 8.0
    a = np.maximum(np.abs(first.a), np.abs(last.a))
    k = np.maximum(np.abs(first.k), np.abs(last.k))
    j, r = np.abs(first.j), np.abs(first.r)
    yaw_rate = j * k + 3.0 * a * v * r
    return {
        "yaw_rate": yaw_rate,
        "lateral_acceleration": 2.0 * a * a * k + 2.0 * v * j * k + 5.0 * v * v * a * r,
        "yaw_acceleration": 4.0 * j * v * r + 3.0 * a * a * r,
        "wheel_speed": j + 0.5 * track * yaw_rate,
    }


def curved_limits(trajectory: Trajectory, limits: MotionLimits) -> tuple[dict[str, float], list[Violation]]:
    """Proven ratio of each curvature-dependent quantity to its limit, and the violations."""
    bounds = {
        "yaw_rate": limits.max_yaw_rate,
        "lateral_acceleration": limits.max_lateral_acceleration,
        "yaw_acceleration": limits.max_yaw_acceleration,
        "wheel_speed": limits.max_wheel_speed,
    }
    finite = {kind: limit for kind, limit in bounds.items() if np.isfinite(limit)}
    ratios, found = dict.fromkeys(finite, 0.0), {}
    cells = _initial_cells(trajectory)
    for level in range(_MAX_LEVELS + 1):
        last = cells.advanced(cells.width)
        at_ends = (_quantities(cells, limits.track_width), _quantities(last, limits.track_width))
        bend = _bend(cells, last, limits.track_width)
        open_cells = np.zeros(cells.t.size, dtype=bool)
        for kind, limit in finite.items():
            seen = np.maximum(at_ends[0][kind], at_ends[1][kind])
            proven = seen + bend[kind] * cells.width**2 / 8.0
            broken = seen > limit * (1.0 + RTOL)
            cleared = proven <= limit * (1.0 + RTOL)
            ratios[kind] = max(ratios[kind], float(np.max(np.where(cleared, proven, seen), initial=0.0)) / limit)
            short = broken if level < _MAX_LEVELS else ~cleared
            if short.any() and kind not in found:
                ends = (cells, at_ends[0][kind]), (last, at_ends[1][kind])
                worst = int(np.argmax(np.where(short, seen, -1.0)))
                found[kind] = max((_exceeded(kind, limit, *end, worst) for end in ends), key=lambda one: one.amount)
            open_cells |= ~cleared & ~broken
        if not open_cells.any():
            break
        cells = cells.rows(np.flatnonzero(open_cells)).halves()
    return ratios, list(found.values())


def _exceeded(kind: str, limit: float, cells: _Cells, value: FloatArray, k: int) -> Violation:
    name = kind.replace("_", " ")
    message = f"{name} {value[k]:.5g} at t = {cells.t[k]:.3f} s, s = {cells.s[k]:.3f} m exceeds {limit:.5g}"
    return Violation(kind, message, float(cells.s[k]), float(max(value[k] - limit, 0.0)))
