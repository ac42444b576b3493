"""The limits that depend on curvature, proven over the whole motion by subdivision.

Within a cell (no phase border, no knot of the path inside) jerk and curvature rate are constant, so every limited
quantity f(t) is bounded by equation C12 of docs/theory/certificate.md; the table on that page lists f and the bounds of
f''. Cells in which the bound does not prove the limit are bisected.

Time within a cell is measured from the start of its phase, and arc length from the knot before it, so that a long wait
or a long path does not reduce the precision. The cells of a phase extend from event to event: the start of the phase,
the knots of the path, and the points of a grid. Each cell has the phase and the piece of the path at its first event;
of simultaneous events the last is used. Every piece of the path has a cell, and even a cell of width zero is checked at
its first instant. A change of curvature over a time shorter than the resolution of floating-point time is therefore
checked too, with its curvature rate.

A polyline is evaluated three times: with the interpolated curvature between its poses, with the curvature of its steps,
and with the rate at which the curvature oscillates from step to step. The mean curvatures at the poses do not show this
oscillation.
"""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.kernels import Kernel, twin_of
from optdock.model.constant_jerk import constant_jerk
from optdock.model.limits import LIMITS, QUANTITY_UNITS
from optdock.model.path import PolylineSegment, TurnSegment
from optdock.verification.certificate import TOLERANCE, Violation

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from optdock.geometry.arrays import FloatArray, IntArray
    from optdock.model.constant_jerk import TimeLaw
    from optdock.model.limits import MotionLimits
    from optdock.model.path import Path, Segment

__all__ = [
    "STEP_RTOL",
    "Instants",
    "Judge",
    "Sizes",
    "TurningRule",
    "crossings",
    "initial_cells",
    "path_pieces",
    "subdivide",
    "turning_rules",
]

STEP_RTOL = 0.05  # accepted excess over a limit, relative, of a polyline's step: its curvature is a difference quotient
_MAX_WIDTH = 0.05  # [s], width of first cells
_MAX_GRID = 20_000  # first cells; they are wider in a long motion
_MAX_LEVELS = 22  # of bisection
_MAX_CELLS = 1_000_000  # added by refinement; some seconds
_BLOCK = 8_000  # cells evaluated at once, some milliseconds; the deadline is polled in between
_BISECTIONS = 60  # to 1e-18 of a phase
_STEEPEST = 1e300  # [1/m^2]: larger curvature rates are clipped to this one, which no limit allows


class Instants(NamedTuple):
    """Instants of a motion, Shape (n,) each: the phase, and the time since its start [s]."""

    phase: IntArray
    since: FloatArray

    def motion(self, law: TimeLaw) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return distance, speed and acceleration, Shape (n,) each."""
        s, v, a = law.states[self.phase].T
        return constant_jerk(self.since, s, v, a, law.jerks[self.phase])

    def rows(self, keep: slice) -> Instants:
        """Return the instants selected by `keep`."""
        return Instants(self.phase[keep], self.since[keep])

    def times(self, law: TimeLaw) -> FloatArray:
        """Return the times since the start of the motion, for messages. Shape (n,) [s]."""
        times: FloatArray = law.times[self.phase] + self.since
        return times


_CROSSINGS = Kernel("optdock_crossings", sizes=3, numbers=0)


def _crossings_native(law: TimeLaw, s: FloatArray) -> Instants:
    n, phases = s.size, law.durations.size
    phase, since = np.empty(n, dtype=np.int64), np.empty(n)
    arrays = (
        (law.durations, phases),
        (law.jerks, phases),
        (law.states, 3 * phases + 3),
        (s, n),
        (phase, n),
        (since, n),
        (np.empty(phases + 1), phases + 1),
    )
    if _CROSSINGS((n, phases, _BISECTIONS), (), arrays) < 0:
        raise ValueError("time law: must have a phase")
    return Instants(phase, since)


@twin_of(_crossings_native)
def crossings(law: TimeLaw, s: FloatArray) -> Instants:
    """Return the first instants at which the distance reaches `s`, Shape (n,) [m]; s(t) never decreases."""
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


class Pieces(NamedTuple):
    """Stretches of a path with a constant curvature rate, Shape (n,) each.

    `begin`: arc length [m]; `first`, `last`: curvature at the ends; `rate`: its slope; `step`: curvature of a
    polyline's step, NaN on a clothoid, infinite on a turn in place, which is checked separately; `swing`: oscillation
    rate of the curvature of a polyline, otherwise 0.
    """

    begin: FloatArray
    first: FloatArray
    last: FloatArray
    rate: FloatArray
    step: FloatArray
    swing: FloatArray


def path_pieces(path: Path) -> Pieces:
    """Return the pieces of a path, in order."""
    parts = [
        _segment_pieces(segment, float(start))
        for segment, start in zip(path.segments, path.segment_starts[:-1], strict=True)
    ]
    return Pieces(*[np.concatenate(columns) for columns in zip(*parts, strict=True)])


def _segment_pieces(segment: Segment, start: float) -> Pieces:
    knots, step, swing = segment.knots, np.full(segment.knots.size - 1, np.nan), np.zeros(segment.knots.size - 1)
    curvature = segment.curvature_at(knots)
    if isinstance(segment, TurnSegment):
        step[:] = np.inf
    elif isinstance(segment, PolylineSegment):
        # Repeated poses have no length: the curvature between the adjacent poses is used.
        kept = np.flatnonzero(np.diff(knots, prepend=-1.0) > 0.0)
        step, swing = (
            column[kept[1:] - 1] / (1.0 + STEP_RTOL) for column in (segment.step_curvature, segment.step_swing)
        )
        knots, curvature = knots[kept], curvature[kept]
    with np.errstate(over="ignore"):
        rate = np.clip(np.diff(curvature) / np.diff(knots), -_STEEPEST, _STEEPEST)
    return Pieces(start + knots[:-1], curvature[:-1], curvature[1:], rate, step, swing)


class Cells(NamedTuple):
    """Motion at the first instant of each cell, Shape (n,) each; r, j, and the bounds of k are constant within a cell.

    `t`: time since the start of the motion, for messages [s]; `low`, `high`: range of the curvature on the piece of the
    path.
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

    def advanced(self, dt: FloatArray) -> Cells:
        """Return the motion after a time `dt`, from the polynomials of each cell."""
        gain, v, a = constant_jerk(dt, np.zeros(dt.size), self.v, self.a, self.j)
        k = np.minimum(np.maximum(self.k + self.r * gain, self.low), self.high)
        return self._replace(t=self.t + dt, width=self.width - dt, s=self.s + gain, v=v, a=a, k=k)

    def rows(self, keep: IntArray | slice) -> Cells:
        """Return the cells selected by `keep`."""
        return Cells(*[column[keep] for column in self])

    def and_also(self, more: Cells) -> Cells:
        """Return the concatenation of these cells and `more`."""
        return Cells(*[np.concatenate(columns) for columns in zip(self, more, strict=True)])

    def halves(self) -> Cells:
        """Return both halves of every cell."""
        half = 0.5 * self.width
        return self._replace(width=half).and_also(self.advanced(half))

    def blocks(self) -> Iterator[Cells]:
        """Yield the cells in groups that are evaluated at once."""
        for start in range(0, self.t.size, _BLOCK):
            yield self.rows(slice(start, start + _BLOCK))


def initial_cells(law: TimeLaw, pieces: Pieces, knots: Instants, *, has_turns: bool) -> Cells:
    """Return cells between events: starts of phases, knots of the path, and a grid of `_MAX_WIDTH`."""
    phases = np.arange(law.durations.size)
    most = max(1, _MAX_GRID // phases.size)
    parts = np.minimum(np.maximum(np.ceil(law.durations / _MAX_WIDTH), 1.0), most).astype(np.int64)
    owner = phases.repeat(parts)
    rank = np.arange(owner.size) - (parts.cumsum() - parts).repeat(parts)  # 0 is the start of the phase
    phase = np.concatenate((owner, knots.phase))
    since = np.concatenate((law.durations[owner] * rank / parts[owner], knots.since))
    kind = np.concatenate((np.where(rank == 0, 0, -1), np.arange(1, knots.phase.size + 1)))
    order = np.lexsort((kind, since, phase))
    phase, since, kind = phase[order], since[order], kind[order]
    at_knot = kind > 0
    piece = at_knot.cumsum()
    # Rounding may swap simultaneous knots; the order along the path is decisive.
    begins = pieces.begin[piece]
    end = law.durations[phase]
    end[:-1] = np.where(phase[1:] != phase[:-1], end[:-1], since[1:])
    width = end - since
    s, v, a = Instants(phase, since).motion(law)
    s = np.where(at_knot, begins, s)
    first, last, rate = pieces.first[piece], pieces.last[piece], pieces.rate[piece]
    low, high = np.minimum(first, last), np.maximum(first, last)
    k = np.where(at_knot, first, np.minimum(np.maximum(first + rate * (s - begins), low), high))
    cells = Cells(law.times[phase] + since, width, s, v, a, law.jerks[phase], k, rate, low, high)
    if has_turns:
        driven = np.flatnonzero(~np.isinf(pieces.step[piece]))
        cells, piece = cells.rows(driven), piece[driven]
    if np.isnan(pieces.step).all() and not pieces.swing.any():
        return cells
    # A polyline a second time, with the constant curvature of its steps, and a third time with its oscillation.
    step = pieces.step[piece]
    turning = cells._replace(k=step, r=np.zeros(step.size), low=step, high=step)
    swinging = cells._replace(r=np.copysign(pieces.swing[piece], cells.r))
    hidden = np.flatnonzero(np.abs(swinging.r) > np.abs(cells.r))
    return cells.and_also(turning.rows(np.flatnonzero(np.isfinite(step)))).and_also(swinging.rows(hidden))


class Sizes(NamedTuple):
    """Bounds of |speed|, |acceleration|, |jerk|, |curvature| and |curvature rate| over cells, Shape (n,) each."""

    v: FloatArray
    a: FloatArray
    j: FloatArray
    k: FloatArray
    r: FloatArray

    @classmethod
    def over(cls, first: Cells, last: Cells) -> Sizes:
        """Return the bounds over the cells, given their first and last instants."""
        # Speed is a parabola with second derivative j: its deviation from the chord is at most |j| width^2 / 8.
        v = np.maximum(np.abs(first.v), np.abs(last.v)) + np.abs(first.j) * first.width**2 / 8.0
        a, k = np.maximum(np.abs(first.a), np.abs(last.a)), np.maximum(np.abs(first.k), np.abs(last.k))
        return cls(v, a, np.abs(first.j), k, np.abs(first.r))


def _yaw_rate_bend(b: Sizes) -> FloatArray:
    return b.j * b.k + 3.0 * b.a * b.v * b.r


def _steering_rate_bend(b: Sizes, drive: MotionLimits) -> FloatArray:
    steepest = drive.wheelbase * b.r
    turned = steepest * b.v
    return steepest * b.j + 2.0 * turned * steepest * b.a + 2.0 * turned**3


# Bounds of |f''| over cells, of quantities f of `LimitKind.TURNING`, by the names of their limits.
_BENDS: dict[str, Callable[[Sizes, MotionLimits], FloatArray]] = {
    "max_yaw_rate": lambda b, _: _yaw_rate_bend(b),
    "max_lateral_acceleration": lambda b, _: (
        2.0 * b.a * b.a * b.k + 2.0 * b.v * b.j * b.k + 5.0 * b.v * b.v * b.a * b.r
    ),
    "max_yaw_acceleration": lambda b, _: 4.0 * b.j * b.v * b.r + 3.0 * b.a * b.a * b.r,
    "max_lateral_jerk": lambda b, _: 6.0 * b.a * b.j * b.k + 12.0 * b.v * b.a * b.a * b.r + 7.0 * b.v * b.v * b.j * b.r,
    "max_wheel_speed": lambda b, drive: b.j + 0.5 * drive.track_width * _yaw_rate_bend(b),
    "max_steering_rate": _steering_rate_bend,
}


class TurningRule(NamedTuple):
    """A finite limit: its value, |f| at the first instant of cells, and a bound of |f''| over cells."""

    limit: float
    size: Callable[[Cells, MotionLimits], FloatArray]
    bend: Callable[[Sizes, MotionLimits], FloatArray]


def turning_rules(finite: Mapping[str, float]) -> dict[str, TurningRule]:
    """Return the rules of all finite limits that depend on curvature, by their names in `LIMITS`."""
    found = ((name, LIMITS[name].size) for name in _BENDS if name in finite)
    return {name: TurningRule(finite[name], size, _BENDS[name]) for name, size in found if size is not None}


def subdivide(first: Cells, judge: Judge, is_late: Callable[[], bool]) -> None:
    """Evaluate cells, and bisect those that are neither cleared nor violated.

    Cells that are not cleared once `is_late()` is True, or after too many bisections, are recorded as `unproven` with
    infinite ratios.
    """
    waiting = deque((0, block) for block in first.blocks())
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


class Judge:
    """Evaluation of cells that records the worst value of each quantity."""

    def __init__(self, rules: Mapping[str, TurningRule], drive: MotionLimits) -> None:
        self.drive = drive
        self.rules = {LIMITS[name].quantity: rule for name, rule in rules.items()}
        self.ratios = dict.fromkeys(self.rules, 0.0)
        self.found: dict[str, Violation] = {}

    def look_at(self, cells: Cells) -> IntArray:
        """Evaluate cells; return the rows of those that are neither cleared nor violated."""
        last = cells.advanced(cells.width)
        most = Sizes.over(cells, last)
        open_cells = np.zeros(cells.t.size, dtype=np.bool_)
        for kind, (limit, size, bend) in self.rules.items():
            at_ends = size(cells, self.drive), size(last, self.drive)
            seen = _infinite_if_nan(np.maximum(*at_ends))
            stray = np.where(cells.width > 0.0, bend(most, self.drive) * cells.width**2 / 8.0, 0.0)
            proven = _infinite_if_nan(seen + stray)
            broken = seen > limit * (1.0 + TOLERANCE)
            cleared = proven <= limit * (1.0 + TOLERANCE)
            self._raise_ratio(kind, float(np.where(cleared, proven, seen).max(initial=0.0)))
            if broken.any():
                ends = (cells, at_ends[0]), (last, at_ends[1])
                worst = int(np.argmax(np.where(broken, seen, -1.0)))
                self._note(kind, max((_exceeded(kind, limit, *end, worst) for end in ends), key=lambda one: one.amount))
            open_cells |= ~cleared & ~broken
        return open_cells.nonzero()[0]

    def give_up(self, cells: Cells) -> None:
        """Record these cells as unproven."""
        for kind in self.rules:
            self._raise_ratio(kind, np.inf)
        k = int(np.argmin(cells.t))
        message = f"the limits on turning near t = {cells.t[k]:.3f} s, s = {cells.s[k]:.3f} m are not proven"
        self._note("unproven", Violation("unproven", message, float(cells.s[k]), np.inf))

    def violations(self) -> Iterator[Violation]:
        """Return the worst violation of each quantity, and the first unproven cell."""
        return (self.found[kind] for kind in (*self.rules, "unproven") if kind in self.found)

    def _raise_ratio(self, kind: str, value: float) -> None:
        self.ratios[kind] = max(self.ratios[kind], value / self.rules[kind].limit)

    def _note(self, kind: str, violation: Violation) -> None:
        if kind not in self.found or violation.amount > self.found[kind].amount:
            self.found[kind] = violation


def _infinite_if_nan(values: FloatArray) -> FloatArray:
    """Return sizes with infinity in place of NaN, which is no proof. Shape (n,)."""
    return np.where(np.isnan(values), np.inf, values)


def _exceeded(kind: str, limit: float, cells: Cells, value: FloatArray, k: int) -> Violation:
    name, unit, found = (
        kind.replace("_", " "),
        QUANTITY_UNITS[kind],
        float(np.nan_to_num(value[k], nan=np.inf, posinf=np.inf)),
    )
    message = f"{name} {found:.5g} {unit} at t = {cells.t[k]:.3f} s, s = {cells.s[k]:.3f} m exceeds {limit:.5g} {unit}"
    return Violation(kind, message, float(cells.s[k]), max(found - limit, 0.0))
