"""The proof of the limits that depend on curvature.

Within a cell (no phase border, no knot of the path inside) jerk and curvature rate are constant, so every limited
quantity f(t) is smooth and `max |f| <= max(|f(t0)|, |f(t1)|) + width^2 / 8 * max |f''|`. With v the speed, a its rate,
j the jerk, k the curvature and r its rate per metre:

    yaw rate v k          f'' = j k + 3 a v r
    lateral v^2 k         f'' = 2 a^2 k + 2 v j k + 5 v^2 a r
    yaw acc. a k + v^2 r  f'' = 4 j v r + 3 a^2 r
    wheel v (1 +- b k/2)  f'' = j +- b/2 (j k + 3 a v r)

Speed and acceleration are exact: polynomials of degree 2 and 1. Cells that the bound does not clear are cut in two.

Time within a cell counts from the start of its phase, and arc length from the knot before it, so that neither a long
wait nor a long path costs digits. The cells of a phase run from event to event (its start, knots of the path, a grid),
each in the phase and the piece of the path that are in force then; an event later in the list is in force later, also
where two fall on the same instant. So every piece of the path has a cell, however short: where its width in time is
none, what it asks of the drive is still looked at, and a jump of curvature within less than the resolution of time
counts with the rate at which it jumps.

A polyline is judged twice: with the curvature that it claims between its poses, and with that of its steps.
"""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.path import PolylineSegment
from optdock.verification.certificate import Violation

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from optdock.geometry.arrays import FloatArray, IntArray
    from optdock.limits import MotionLimits
    from optdock.path import Path, Segment
    from optdock.trajectory import TimeLaw, Trajectory

__all__ = ["RTOL", "Instants", "crossings", "curved_limits"]

RTOL = 1e-6  # accepted excess over a limit, relative
SAMPLED_RTOL = 0.05  # likewise of a polyline's step, whose curvature is a difference quotient
_MAX_WIDTH = 0.05  # [s], first cells
_MAX_GRID = 20_000  # first cells of a long motion are wider
_MAX_LEVELS = 22
_MAX_CELLS = 1_000_000  # added by refinement; some seconds
_BLOCK = 8_000  # cells judged in one go, some milliseconds; a deadline is looked at in between
_BISECTIONS = 60  # leave 1e-18 of a phase
_STEEPEST = 1e300  # [1/m^2]: a curvature rate beyond counts as this one, which no limit allows either


class Instants(NamedTuple):
    """Moments of a motion, Shape (n,) each: the phase, and the time since its start [s]."""

    phase: IntArray
    since: FloatArray

    def motion(self, law: TimeLaw) -> FloatArray:
        """Distance, speed and acceleration, Shape (n, 3)."""
        s, v, a = law.states[self.phase].T
        dt, j = self.since, law.jerks[self.phase]
        return np.column_stack((s + dt * (v + dt * (a / 2.0 + dt * j / 6.0)), v + dt * (a + dt * j / 2.0), a + dt * j))

    def times(self, law: TimeLaw) -> FloatArray:
        """The moments as times since the start of the motion, for messages. Shape (n,) [s]."""
        times: FloatArray = law.times[self.phase] + self.since
        return times


def crossings(law: TimeLaw, s: FloatArray) -> Instants:
    """First moments at which the distance reaches `s`, Shape (n,) [m], by bisection, as s(t) never decreases."""
    reached = np.maximum.accumulate(law.states[:, 0])
    phase = np.clip(np.searchsorted(reached, s, side="left") - 1, 0, law.durations.size - 1)
    base, v, a = law.states[phase].T
    half_a, sixth_j, wanted = a / 2.0, law.jerks[phase] / 6.0, s - base
    low: FloatArray = np.zeros(s.size)
    high: FloatArray = law.durations[phase]
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        ahead = middle * (v + middle * (half_a + middle * sixth_j)) >= wanted
        low, high = np.where(ahead, low, middle), np.where(ahead, middle, high)
    return Instants(phase, 0.5 * (low + high))


class _Pieces(NamedTuple):
    """Stretches of a path with a constant curvature rate, Shape (n,) each.

    `begin`: arc length [m]; `first`, `last`: curvature at the ends; `rate`: its slope; `step`: the curvature of the
    polyline's step, NaN on a clothoid.
    """

    begin: FloatArray
    first: FloatArray
    last: FloatArray
    rate: FloatArray
    step: FloatArray


def _path_pieces(path: Path) -> _Pieces:
    parts = [
        _segment_pieces(segment, float(start))
        for segment, start in zip(path.segments, path.segment_starts[:-1], strict=True)
    ]
    return _Pieces(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def _segment_pieces(segment: Segment, start: float) -> _Pieces:
    knots, step = segment.knots, np.full(segment.knots.size - 1, np.nan)
    curvature = segment.curvature_at(knots)
    if isinstance(segment, PolylineSegment):
        # Repeated poses have no length: the curvature between the poses beside them is what counts.
        kept = np.flatnonzero(np.diff(knots, prepend=-1.0) > 0.0)
        step = segment.step_curvature[kept[1:] - 1] / (1.0 + SAMPLED_RTOL)
        knots, curvature = knots[kept], curvature[kept]
    with np.errstate(over="ignore"):
        rate = np.clip(np.diff(curvature) / np.diff(knots), -_STEEPEST, _STEEPEST)
    return _Pieces(start + knots[:-1], curvature[:-1], curvature[1:], rate, step)


class _Cells(NamedTuple):
    """Motion at the first instant of each cell, Shape (n,) each; r, j, the bounds of k and width do not change in it.

    `t`: since the start of the motion, for messages [s]; `low`, `high`: curvature of the whole piece of the path.
    """

    t: FloatArray
    width: FloatArray
    s: FloatArray
    v: FloatArray
    a: FloatArray
    j: FloatArray
    k: FloatArray
    r: FloatArray
    low: FloatArray
    high: FloatArray

    def advanced(self, dt: FloatArray) -> _Cells:
        """The motion `dt` later, by the cell's own polynomials."""
        gain = dt * (self.v + dt * (self.a / 2.0 + dt * self.j / 6.0))
        v = self.v + dt * (self.a + dt * self.j / 2.0)
        k = np.clip(self.k + self.r * gain, self.low, self.high)
        return self._replace(t=self.t + dt, width=self.width - dt, s=self.s + gain, v=v, a=self.a + dt * self.j, k=k)

    def rows(self, keep: IntArray | slice) -> _Cells:
        """The cells at `keep`."""
        return _Cells(*(column[keep] for column in self))

    def and_also(self, more: _Cells) -> _Cells:
        """These cells, then more."""
        return _Cells(*(np.concatenate(columns) for columns in zip(self, more, strict=True)))

    def halves(self) -> _Cells:
        """Every cell cut in two."""
        half = 0.5 * self.width
        return self._replace(width=half).and_also(self.advanced(half))

    def blocks(self) -> Iterator[_Cells]:
        """The cells in groups that are judged in one go."""
        for start in range(0, self.t.size, _BLOCK):
            yield self.rows(slice(start, start + _BLOCK))


def _initial_cells(trajectory: Trajectory) -> _Cells:
    """Cells from event to event: starts of phases, knots of the path, and a grid of `_MAX_WIDTH` within each phase."""
    law, pieces = trajectory.time_law, _path_pieces(trajectory.path)
    phases = np.arange(law.durations.size)
    knots = crossings(law, pieces.begin[1:])
    most = max(1, _MAX_GRID // phases.size)
    parts = np.clip(np.ceil(law.durations / _MAX_WIDTH), 1.0, most).astype(np.int64)
    owner = np.repeat(phases, parts)
    rank = np.arange(owner.size) - np.repeat(np.cumsum(parts) - parts, parts)  # 0 is the start of the phase
    phase = np.concatenate((owner, knots.phase))
    since = np.concatenate((law.durations[owner] * rank / parts[owner], knots.since))
    kind = np.concatenate((np.where(rank == 0, 0, -1), np.arange(1, knots.phase.size + 1)))
    order = np.lexsort((kind, since, phase))
    phase, since, kind = phase[order], since[order], kind[order]
    piece = np.cumsum(kind > 0)
    at_knot = kind > 0
    # Rounding may swap knots of one instant; the order along the path is the one that holds.
    begins = pieces.begin[piece]
    end = np.append(since[1:], 0.0)
    is_last = np.append(phase[1:] != phase[:-1], True)
    width = np.where(is_last, law.durations[phase], end) - since
    s, v, a = Instants(phase, since).motion(law).T
    s = np.where(at_knot, begins, s)
    first, last, rate = pieces.first[piece], pieces.last[piece], pieces.rate[piece]
    low, high = np.minimum(first, last), np.maximum(first, last)
    k = np.where(at_knot, first, np.clip(first + rate * (s - begins), low, high))
    cells = _Cells(law.times[phase] + since, width, s, v, a, law.jerks[phase], k, rate, low, high)
    # A polyline once more, turning as its steps do: their curvature is constant, not that between poses.
    step = pieces.step[piece]
    turning = cells._replace(k=step, r=np.zeros(step.size), low=step, high=step)
    return cells.and_also(turning.rows(np.flatnonzero(np.isfinite(step))))


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


def curved_limits(
    trajectory: Trajectory, limits: MotionLimits, is_late: Callable[[], bool]
) -> tuple[dict[str, float], list[Violation]]:
    """Proven ratio of each curvature-dependent quantity to its limit, and the violations.

    Cells that are not cleared when `is_late()` turns true, or when there have been too many, are `unproven`; the
    ratios are infinite then.
    """
    bounds = {
        "yaw_rate": limits.max_yaw_rate,
        "lateral_acceleration": limits.max_lateral_acceleration,
        "yaw_acceleration": limits.max_yaw_acceleration,
        "wheel_speed": limits.max_wheel_speed,
    }
    finite = {kind: limit for kind, limit in bounds.items() if np.isfinite(limit)}
    if not finite:
        return {}, []
    judge = _Judge(finite, limits.track_width)
    with np.errstate(over="ignore", invalid="ignore"):
        waiting = deque((0, block) for block in _initial_cells(trajectory).blocks())
        added = 0
        while waiting:
            level, cells = waiting.popleft()
            if is_late():
                judge.give_up(cells)
                break
            open_cells = judge.look_at(cells)
            if open_cells.size == 0:
                continue
            rest = cells.rows(open_cells)
            if level == _MAX_LEVELS or added > _MAX_CELLS:
                judge.give_up(rest)
                continue
            halves = rest.halves()
            added += halves.t.size
            waiting.extend((level + 1, block) for block in halves.blocks())
    return judge.ratios, [judge.found[kind] for kind in (*finite, "unproven") if kind in judge.found]


class _Judge:
    """Looks at cells and keeps the worst of each quantity."""

    def __init__(self, limits: Mapping[str, float], track: float) -> None:
        self.limits, self.track = limits, track
        self.ratios = dict.fromkeys(limits, 0.0)
        self.found: dict[str, Violation] = {}

    def look_at(self, cells: _Cells) -> IntArray:
        """Judge cells; the rows of those that are neither cleared nor broken."""
        last = cells.advanced(cells.width)
        at_ends = (_quantities(cells, self.track), _quantities(last, self.track))
        bend = _bend(cells, last, self.track)
        open_cells = np.zeros(cells.t.size, dtype=np.bool_)
        for kind, limit in self.limits.items():
            # What is no number proves nothing: it counts as infinite where it arises.
            seen = np.nan_to_num(np.maximum(at_ends[0][kind], at_ends[1][kind]), nan=np.inf, posinf=np.inf)
            stray = np.where(cells.width > 0.0, bend[kind] * cells.width**2 / 8.0, 0.0)
            proven = np.nan_to_num(seen + stray, nan=np.inf, posinf=np.inf)
            broken = seen > limit * (1.0 + RTOL)
            cleared = proven <= limit * (1.0 + RTOL)
            self._raise_ratio(kind, float(np.max(np.where(cleared, proven, seen), initial=0.0)))
            if broken.any():
                ends = (cells, at_ends[0][kind]), (last, at_ends[1][kind])
                worst = int(np.argmax(np.where(broken, seen, -1.0)))
                self._note(kind, max((_exceeded(kind, limit, *end, worst) for end in ends), key=lambda one: one.amount))
            open_cells |= ~cleared & ~broken
        return np.flatnonzero(open_cells)

    def give_up(self, cells: _Cells) -> None:
        """Nothing is known of these cells."""
        for kind in self.limits:
            self._raise_ratio(kind, np.inf)
        k = int(np.argmin(cells.t))
        message = f"the limits on turning near t = {cells.t[k]:.3f} s, s = {cells.s[k]:.3f} m are not proven"
        self._note("unproven", Violation("unproven", message, float(cells.s[k]), np.inf))

    def _raise_ratio(self, kind: str, value: float) -> None:
        self.ratios[kind] = max(self.ratios[kind], value / self.limits[kind])

    def _note(self, kind: str, violation: Violation) -> None:
        if kind not in self.found or violation.amount > self.found[kind].amount:
            self.found[kind] = violation


def _exceeded(kind: str, limit: float, cells: _Cells, value: FloatArray, k: int) -> Violation:
    name, found = kind.replace("_", " "), float(np.nan_to_num(value[k], nan=np.inf, posinf=np.inf))
    message = f"{name} {found:.5g} at t = {cells.t[k]:.3f} s, s = {cells.s[k]:.3f} m exceeds {limit:.5g}"
    return Violation(kind, message, float(cells.s[k]), max(found - limit, 0.0))
