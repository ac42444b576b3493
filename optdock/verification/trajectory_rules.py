"""The rules of a trajectory: that its time law covers the path, rests where it must, and keeps every motion limit.

Speed, acceleration and jerk are polynomials of degree 2, 1 and 0 in each phase of the time law: their extremes are
exact. The limits that depend on curvature are proven by subdivision. Within a cell (no phase border, no knot of the
path inside) jerk and curvature rate are constant, so every limited quantity f(t) is smooth and
`max |f| <= max(|f(t0)|, |f(t1)|) + width^2 / 8 * max |f''|`. With v the speed, a its rate, j the jerk, k the curvature
and r its rate per metre:

    yaw rate v k          f'' = j k + 3 a v r
    lateral v^2 k         f'' = 2 a^2 k + 2 v j k + 5 v^2 a r
    yaw acc. a k + v^2 r  f'' = 4 j v r + 3 a^2 r
    lateral jerk          f'' = 6 a j k + 12 v a^2 r + 7 v^2 j r
     2 v a k + v^3 r
    wheel v (1 +- b k/2)  f'' = j +- b/2 (j k + 3 a v r)

and of steered wheels, at wheelbase L, the steering angle atan(u), u = L k, turns at f = u' / (1 + u^2), so that

    f'' = u'''/(1 + u^2) - 6 u u' u''/(1 + u^2)^2 + u'^3 (6 u^2 - 2)/(1 + u^2)^3
    |f''| <= |u'''| + 2 |u' u''| + 2 |u'|^3,   u' = L r v, u'' = L r a, u''' = L r j.

Where the curvature jumps between two segments the wheels turn at rest, and the rest must be long enough for that; so
must the rest at the start, where they may stand at any angle.

A turn in place is driven over the path coordinate, so its yaw rate, acceleration and jerk are the time law's own: exact
extremes, against limits of their own (`MotionLimits.turning`). The phases between the rests at its ends are the turn's.

Cells that the bound does not clear are bisected.

A finite limit that has no rule here, and none of the path certificate either, is a violation: whatever field
`MotionLimits` gets, a motion is certified only where it has been proven.

Time within a cell counts from the start of its phase, and arc length from the knot before it, so that neither a long
wait nor a long path costs digits. The cells of a phase run from event to event (its start, knots of the path, a grid),
each in the phase and the piece of the path that are in force then; an event later in the list is in force later, also
where two fall on the same instant. So every piece of the path has a cell, however short: where its width in time is
none, what it asks of the drive is still looked at, and a jump of curvature within less than the resolution of time
counts with the rate at which it jumps.

A polyline is judged three times: with the curvature that it claims between its poses, with that of its steps, and with
the rate at which that swings from step to step, where the means at the poses hide it.
"""

from __future__ import annotations

import itertools
from collections import deque
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.model.limits import LIMITS, LimitKind, finite_limits
from optdock.model.path import Direction, PolylineSegment, TurnSegment
from optdock.model.segments import TURN_RADIUS
from optdock.model.trajectory import constant_jerk
from optdock.verification.certificate import TOLERANCE, Violation

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from optdock.geometry.arrays import FloatArray, IntArray
    from optdock.model.limits import MotionLimits, SpeedZone
    from optdock.model.path import Path, Segment
    from optdock.model.trajectory import TimeLaw, Trajectory

__all__ = ["STEP_RTOL", "trajectory_violations"]

REST_TOLERANCE = TOLERANCE  # [m], [m/s], [m/s^2] at cusps and at the ends
REST_YAW_TOLERANCE = 1e-5  # [rad] at the ends: what a curvature of 10 1/m turns within `REST_TOLERANCE`
STEP_RTOL = 0.05  # accepted excess over a limit, relative, of a polyline's step: its curvature is a difference quotient
_MAX_WIDTH = 0.05  # [s], first cells
_MAX_GRID = 20_000  # first cells of a long motion are wider
_MAX_LEVELS = 22  # of bisection
_MAX_CELLS = 1_000_000  # added by refinement; some seconds
_BLOCK = 8_000  # cells judged in one go, some milliseconds; a deadline is looked at in between
_BISECTIONS = 60  # leave 1e-18 of a phase
_STEEPEST = 1e300  # [1/m^2]: a curvature rate beyond counts as this one, which no limit allows either


def trajectory_violations(
    trajectory: Trajectory,
    limits: MotionLimits,
    zone: SpeedZone,
    start: tuple[float | None, float | None, float],
    is_late: Callable[[], bool],
) -> tuple[tuple[Violation, ...], dict[str, float]]:
    """Every broken rule, and the proven ratio of each quantity to its limit; see `certify_trajectory`."""
    path, law = trajectory.path, trajectory.time_law
    extremes = _speed_extremes(law)
    waits = _waits(trajectory, limits, start[2])
    structure = (*_coverage(trajectory, extremes), *_rest(trajectory), *_too_short(waits), *_start(law, *start[:2]))
    if any(v.kind == "coverage" for v in structure):
        return structure, {}
    finite = finite_limits(limits)
    rules = _turning_rules(finite)
    stretches, judge = _segment_limits(path, limits, zone), _Judge(rules, limits)
    borders = stretches[:, :2].ravel()
    with np.errstate(over="ignore", invalid="ignore"):
        pieces = _path_pieces(path) if judge.rules else None
        asked = borders if pieces is None else np.concatenate((borders, pieces.begin[1:]))
        reached = _crossings(law, asked)  # one bisection for all places that are asked for
        if pieces is not None:
            knots = reached.rows(slice(borders.size, None))
            _subdivide(_initial_cells(law, pieces, knots, has_turns=path.turns), judge, is_late)
    peaks = tuple(_stretch_peaks(law, stretches, reached.rows(slice(borders.size)), extremes))
    driven, turns = _phases_apart(trajectory)
    plain = {violation.kind: violation for violation in (*_speed(peaks), *_rates(law, driven, limits))}
    ratios = {**_plain_ratios(driven, limits, peaks), **judge.ratios}
    turning = tuple(peak for turn in turns for peak in _turn_peaks(law, turn, extremes, limits))
    more = [(peak.kind, peak.ratio) for peak in turning] + [("steering_rate", wait.ratio) for wait in waits]
    for kind, ratio in more:
        ratios[kind] = max(ratios.get(kind, 0.0), ratio)
    unruled = _without_rule(finite, rules)
    return (*structure, *plain.values(), *judge.violations(), *_turned_too_fast(turning), *unruled), ratios


def _coverage(trajectory: Trajectory, extremes: _Extremes) -> Iterator[Violation]:
    law, length = trajectory.time_law, trajectory.path.length
    for name, found, wanted in (("begins", law.states[0, 0], 0.0), ("ends", law.states[-1, 0], length)):
        if not abs(found - wanted) <= REST_TOLERANCE:
            message = f"the motion {name} at s = {found:.6g} m, not at {wanted:.6g} m"
            yield Violation("coverage", message, float(found), float(abs(found - wanted)))
    yield from _turns_beyond(trajectory)
    k = int(np.argmin(extremes.v))
    slowest, at = float(extremes.v[k]), float(extremes.t[k])
    if slowest < -REST_TOLERANCE:
        yield Violation("coverage", f"the motion runs backwards at {-slowest:.3g} m/s, t = {at:.3f} s", 0.0, -slowest)
    back = _distance_back(law, extremes)
    if not back <= REST_TOLERANCE:
        yield Violation("coverage", f"the motion runs backwards by up to {back:.3g} m in all", 0.0, back)
    yield from _turns_in_place(trajectory.path)


def _turns_beyond(trajectory: Trajectory) -> Iterator[Violation]:
    """What a motion leaves out at either end within the tolerance must not hold a turn."""
    law, path = trajectory.time_law, trajectory.path
    ends = ("begins", law.states[0, 0], 0.0), ("ends", law.states[-1, 0], path.length)
    yaws = path.poses_at([s for _, found, wanted in ends for s in (found, wanted)])[:, 2]
    for (name, found, wanted), there, here in zip(ends, yaws[::2], yaws[1::2], strict=True):
        missed = abs(float(here - there))
        if abs(found - wanted) <= REST_TOLERANCE and not missed <= REST_YAW_TOLERANCE:
            message = f"the motion {name} {missed:.3g} rad from where the path does"
            yield Violation("coverage", message, wanted, missed)


def _turns_in_place(path: Path) -> Iterator[Violation]:
    """A law over distance has no time for a turn that covers no distance."""
    for segment, start in zip(path.segments, path.segment_starts[:-1], strict=True):
        if isinstance(segment, PolylineSegment):
            still = np.flatnonzero(~np.isfinite(segment.step_curvature))
            if still.size:
                s = float(start + segment.knots[still[0]])
                turn = float(np.sum(np.abs(np.diff(segment.poses[:, 2])[still])))
                message = f"the path turns in place at s = {s:.3f} m, where the motion takes no time to turn"
                yield Violation("coverage", message, s, turn)


def _turning_points(law: TimeLaw) -> _Instants:
    """Where the speed of each phase is stationary, or the end of the phase nearest to that."""
    a = law.states[:-1, 2]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        dt = np.where(law.jerks != 0.0, -a / law.jerks, 0.0)
    return _Instants(np.arange(law.durations.size), np.clip(dt, 0.0, law.durations))


class _Extremes(NamedTuple):
    """Moments among which every phase's extreme speeds are: time [s], distance [m], speed [m/s], Shape (n,) each."""

    t: FloatArray
    s: FloatArray
    v: FloatArray


def _speed_extremes(law: TimeLaw) -> _Extremes:
    """First the borders of the phases, then the stationary points inside."""
    inside = _turning_points(law)
    s, v, _ = inside.motion(law).T
    borders = law.states
    return _Extremes(
        np.concatenate((law.times, inside.times(law))),
        np.concatenate((borders[:, 0], s)),
        np.concatenate((borders[:, 1], v)),
    )


def _distance_back(law: TimeLaw, extremes: _Extremes) -> float:
    """Upper bound of the distance that the motion runs backwards [m]."""
    borders, inside = extremes.v[: law.times.size], extremes.v[law.times.size :]
    slowest = np.minimum(np.minimum(borders[:-1], borders[1:]), inside)
    return float(np.sum(law.durations * np.maximum(-slowest, 0.0)))


def _rest(trajectory: Trajectory) -> Iterator[Violation]:
    law = trajectory.time_law
    for name, s in (*(("cusp", s) for s in trajectory.path.cusps), ("end", trajectory.path.length)):
        k = -1 if name == "end" else _border_at(law, s)
        miss = float(np.max(np.abs(law.states[k] - [s, 0.0, 0.0])))
        if not miss <= REST_TOLERANCE:
            at, v, a = law.states[k]
            message = (
                f"no rest at the {name} s = {s:.4f} m: nearest phase border s = {at:.4f} m, v = {v:.3g}, a = {a:.3g}"
            )
            yield Violation("rest", message, s, miss)


def _border_at(law: TimeLaw, s: float) -> int:
    """The phase border at `s` that is nearest to rest; where none is at `s`, the nearest."""
    off = np.abs(law.states[:, 0] - s)
    moving = np.max(np.abs(law.states[:, 1:]), axis=1)
    at = off <= REST_TOLERANCE
    return int(np.argmin(np.where(at, moving, np.inf) if at.any() else off))


def _rest_at(law: TimeLaw, s: float) -> int:
    """The phase border at rest that is nearest to `s`: a turn smaller than the tolerance has ends of its own."""
    still = np.max(np.abs(law.states[:, 1:]), axis=1) <= REST_TOLERANCE
    off = np.where(still, np.abs(law.states[:, 0] - s), np.inf)
    k = int(np.argmin(off))
    return k if off[k] <= REST_TOLERANCE else _border_at(law, s)


class _Wait(NamedTuple):
    """A rest at one place: where [m], the time that the wheels need there and that they have [s]."""

    s: float
    needed: float
    given: float

    @property
    def ratio(self) -> float:
        """Steering rate over its limit, if the wheels turn evenly."""
        return self.needed / self.given if self.given > 0.0 else np.inf


def _waits(trajectory: Trajectory, limits: MotionLimits, start_wait: float) -> list[_Wait]:
    """Where the wheels are turned at rest, by more than the tolerance: at the start and at cusps.

    A phase at rest lies between two borders at rest: its acceleration, linear, is none within it, nor is its speed.
    Cusps that one border may stand for share the phases there, so what they need is added up.
    """
    law, path = trajectory.time_law, trajectory.path
    cusps = path.cusps if limits.max_steering_rate < np.inf else ()
    if not (cusps or start_wait > 0.0):
        return []
    turned = limits.steering_times(path.joint_curvatures) if cusps else ()
    places, needed = np.array([0.0, *cusps]), np.array([start_wait, *turned])
    still = np.max(np.abs(law.states[:, 1:]), axis=1) <= REST_TOLERANCE
    waits = []
    for group in np.split(np.arange(places.size), np.flatnonzero(np.diff(places) > 2.0 * REST_TOLERANCE) + 1):
        first, last = places[group[[0, -1]]] + (-REST_TOLERANCE, REST_TOLERANCE)
        at_rest = still & (law.states[:, 0] >= first) & (law.states[:, 0] <= last)
        given = float(np.sum(law.durations[at_rest[:-1] & at_rest[1:]]))
        wait = _Wait(float(places[group[0]]), float(np.sum(needed[group])), given)
        if wait.needed > TOLERANCE:
            waits.append(wait)
    return waits


def _too_short(waits: Sequence[_Wait]) -> Iterator[Violation]:
    for s, needed, given in waits:
        if not given >= needed * (1.0 - TOLERANCE):
            where = f"at the cusp s = {s:.4f} m" if s > 0.0 else "at the start"
            message = f"the wheels take {needed:.4g} s to turn {where}, the motion rests {given:.4g} s"
            yield Violation("rest", message, s, needed - given)


def _start(law: TimeLaw, speed: float | None, acceleration: float | None) -> Iterator[Violation]:
    for name, found, wanted in (
        ("speed", float(law.states[0, 1]), speed),
        ("acceleration", float(law.states[0, 2]), acceleration),
    ):
        if wanted is not None and not abs(found - wanted) <= REST_TOLERANCE:
            message = f"the motion begins with {name} {found:.4g}, the robot has {wanted:.4g}"
            yield Violation("start_state", message, 0.0, abs(found - wanted))


def _segment_limits(path: Path, limits: MotionLimits, zone: SpeedZone) -> FloatArray:
    """Stretches with one speed limit, turns left out: begin, end, limit. Shape (n, 3) [m, m, m/s]."""
    top = {Direction.FORWARD: limits.max_speed, Direction.REVERSE: limits.max_reverse_speed}
    rows = [
        (a, b, top[segment.direction])
        for segment, a, b in zip(path.segments, path.segment_starts[:-1], path.segment_starts[1:], strict=True)
        if segment.direction in top
    ]
    if zone.distance > 0.0:
        begin = path.before_end(zone.distance)
        rows += [(max(a, begin), b, zone.speed) for a, b in path.driven_stretches if b > begin]
    return np.array(rows).reshape(-1, 3)


class _Peak(NamedTuple):
    """Largest speed within a stretch of one limit [m/s], when [s] and where [m]."""

    limit: float
    speed: float
    t: float
    s: float


def _stretch_peaks(law: TimeLaw, stretches: FloatArray, entries: _Instants, found: _Extremes) -> Iterator[_Peak]:
    """The peak within every stretch, whose begins and ends the motion reaches at `entries`, in turn."""
    entry_times, entry_states = entries.times(law).reshape(-1, 2), entries.motion(law)[:, :2].reshape(-1, 2, 2)
    for (begin, end, limit), when, states in zip(stretches, entry_times, entry_states, strict=True):
        inside = (found.s >= begin) & (found.s <= end)
        t = np.concatenate((found.t[inside], when))
        s, v = np.concatenate((np.column_stack((found.s, found.v))[inside], states)).T
        k = int(np.argmax(v))
        yield _Peak(float(limit), float(v[k]), float(t[k]), float(s[k]))


def _speed(peaks: Sequence[_Peak]) -> Iterator[Violation]:
    for limit, speed, t, s in peaks:
        if not speed <= limit * (1.0 + TOLERANCE):
            message = f"speed {speed:.4g} m/s at t = {t:.3f} s, s = {s:.3f} m exceeds {limit:.4g} m/s"
            yield Violation("speed", message, s, speed - limit)


class _Phases(NamedTuple):
    """Some phases of a time law, and the borders that belong to them: which they are, and their columns."""

    inside: IntArray
    borders: IntArray
    jerks: FloatArray
    a: FloatArray

    @classmethod
    def of(cls, law: TimeLaw, inside: IntArray) -> _Phases:
        """The phases `inside`, with the borders at both their ends."""
        borders = np.union1d(inside, inside + 1)
        return cls(inside, borders, law.jerks[inside], law.states[borders, 2])


def _phases_apart(trajectory: Trajectory) -> tuple[_Phases, list[_Phases]]:
    """The phases that drive, and those of every turn in place: between the rests at its ends, as `_rest` finds them."""
    law, path = trajectory.time_law, trajectory.path
    if not path.turns:
        return _Phases(np.arange(law.durations.size), np.arange(law.times.size), law.jerks, law.states[:, 2]), []
    cuts = [0, *(_rest_at(law, s) for s in path.cusps), law.durations.size]
    owned = [np.arange(first, last) for first, last in itertools.pairwise(cuts)]
    turns = [isinstance(segment, TurnSegment) for segment in path.segments]
    driven = np.setdiff1d(np.arange(law.durations.size), np.concatenate(list(itertools.compress(owned, turns))))
    return _Phases.of(law, driven), [_Phases.of(law, phases) for phases in itertools.compress(owned, turns)]


class _TurnPeak(NamedTuple):
    """The largest yaw rate, acceleration or jerk of a turn, its limit, when [s] and where [m]."""

    kind: str
    limit: float
    value: float
    t: float
    s: float

    @property
    def ratio(self) -> float:
        """Over its limit."""
        return self.value / self.limit


def _turn_peaks(law: TimeLaw, turn: _Phases, found: _Extremes, limits: MotionLimits) -> Iterator[_TurnPeak]:
    """Of one turn; exact."""
    if turn.inside.size == 0:
        return
    rows = np.concatenate((turn.borders, law.times.size + turn.inside))  # borders of phases, then speeds inside them
    turning, at, inside = limits.turning, turn.borders, turn.inside
    for kind, limit, value, t, s in (
        ("yaw_rate", turning.rate, found.v[rows], found.t[rows], found.s[rows]),
        ("yaw_acceleration", turning.acceleration, np.abs(turn.a), law.times[at], law.states[at, 0]),
        ("yaw_jerk", turning.jerk, np.abs(turn.jerks), law.times[inside], law.states[inside, 0]),
    ):
        k = int(np.argmax(value))
        yield _TurnPeak(kind, limit, float(value[k]) / TURN_RADIUS, float(t[k]), float(s[k]))


def _turned_too_fast(peaks: Sequence[_TurnPeak]) -> Iterator[Violation]:
    for kind, limit, value, t, s in peaks:
        if not value <= limit * (1.0 + TOLERANCE):
            name = kind.replace("_", " ")
            message = f"{name} {value:.5g} at t = {t:.3f} s, in the turn at s = {s:.3f} m, exceeds {limit:.5g}"
            yield Violation(kind, message, s, value - limit)


def _rates(law: TimeLaw, driven: _Phases, limits: MotionLimits) -> Iterator[Violation]:
    for kind, value, limit, rows in (
        ("acceleration", driven.a, limits.max_acceleration, driven.borders),
        ("deceleration", -driven.a, limits.max_deceleration, driven.borders),
        ("jerk", np.abs(driven.jerks), limits.max_jerk, driven.inside),
    ):
        if value.size == 0:
            continue
        i = int(np.argmax(value))
        if not value[i] <= limit * (1.0 + TOLERANCE):
            k, s = rows[i], law.states[rows[i], 0]
            message = f"{kind} {value[i]:.4g} at t = {law.times[k]:.3f} s, s = {s:.3f} m exceeds {limit:.4g}"
            yield Violation(kind, message, float(s), float(value[i] - limit))


def _plain_ratios(driven: _Phases, limits: MotionLimits, peaks: Sequence[_Peak]) -> dict[str, float]:
    return {
        "speed": max((peak.speed / peak.limit for peak in peaks), default=0.0),
        "acceleration": float(np.max(driven.a, initial=0.0)) / limits.max_acceleration,
        "deceleration": float(np.max(-driven.a, initial=0.0)) / limits.max_deceleration,
        "jerk": float(np.max(np.abs(driven.jerks), initial=0.0)) / limits.max_jerk,
    }


class _Instants(NamedTuple):
    """Moments of a motion, Shape (n,) each: the phase, and the time since its start [s]."""

    phase: IntArray
    since: FloatArray

    def motion(self, law: TimeLaw) -> FloatArray:
        """Distance, speed and acceleration, Shape (n, 3)."""
        s, v, a = law.states[self.phase].T
        return np.column_stack(constant_jerk(self.since, s, v, a, law.jerks[self.phase]))

    def rows(self, keep: slice) -> _Instants:
        """The moments at `keep`."""
        return _Instants(self.phase[keep], self.since[keep])

    def times(self, law: TimeLaw) -> FloatArray:
        """The moments as times since the start of the motion, for messages. Shape (n,) [s]."""
        times: FloatArray = law.times[self.phase] + self.since
        return times


def _crossings(law: TimeLaw, s: FloatArray) -> _Instants:
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
    return _Instants(phase, 0.5 * (low + high))


class _Pieces(NamedTuple):
    """Stretches of a path with a constant curvature rate, Shape (n,) each.

    `begin`: arc length [m]; `first`, `last`: curvature at the ends; `rate`: its slope; `step`: the curvature of the
    polyline's step, NaN on a clothoid; infinite on a turn in place, which is judged by itself; `swing`: how fast the
    curvature of a polyline swings over the step, 0 on others.
    """

    begin: FloatArray
    first: FloatArray
    last: FloatArray
    rate: FloatArray
    step: FloatArray
    swing: FloatArray


def _path_pieces(path: Path) -> _Pieces:
    parts = [
        _segment_pieces(segment, float(start))
        for segment, start in zip(path.segments, path.segment_starts[:-1], strict=True)
    ]
    return _Pieces(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def _segment_pieces(segment: Segment, start: float) -> _Pieces:
    knots, step, swing = segment.knots, np.full(segment.knots.size - 1, np.nan), np.zeros(segment.knots.size - 1)
    curvature = segment.curvature_at(knots)
    if isinstance(segment, TurnSegment):
        step[:] = np.inf
    elif isinstance(segment, PolylineSegment):
        # Repeated poses have no length: the curvature between the poses beside them is what counts.
        kept = np.flatnonzero(np.diff(knots, prepend=-1.0) > 0.0)
        step, swing = (
            column[kept[1:] - 1] / (1.0 + STEP_RTOL) for column in (segment.step_curvature, segment.step_swing)
        )
        knots, curvature = knots[kept], curvature[kept]
    with np.errstate(over="ignore"):
        rate = np.clip(np.diff(curvature) / np.diff(knots), -_STEEPEST, _STEEPEST)
    return _Pieces(start + knots[:-1], curvature[:-1], curvature[1:], rate, step, swing)


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
        gain, v, a = constant_jerk(dt, np.zeros(dt.size), self.v, self.a, self.j)
        k = np.clip(self.k + self.r * gain, self.low, self.high)
        return self._replace(t=self.t + dt, width=self.width - dt, s=self.s + gain, v=v, a=a, k=k)

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


def _initial_cells(law: TimeLaw, pieces: _Pieces, knots: _Instants, *, has_turns: bool) -> _Cells:
    """Cells from event to event: starts of phases, knots of the path, and a grid of `_MAX_WIDTH` within each phase."""
    phases = np.arange(law.durations.size)
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
    s, v, a = _Instants(phase, since).motion(law).T
    s = np.where(at_knot, begins, s)
    first, last, rate = pieces.first[piece], pieces.last[piece], pieces.rate[piece]
    low, high = np.minimum(first, last), np.maximum(first, last)
    k = np.where(at_knot, first, np.clip(first + rate * (s - begins), low, high))
    cells = _Cells(law.times[phase] + since, width, s, v, a, law.jerks[phase], k, rate, low, high)
    if has_turns:
        driven = np.flatnonzero(~np.isinf(pieces.step[piece]))
        cells, piece = cells.rows(driven), piece[driven]
    # A polyline once more, turning as its steps do: their curvature is constant, not that between poses.
    step = pieces.step[piece]
    turning = cells._replace(k=step, r=np.zeros(step.size), low=step, high=step)
    swinging = cells._replace(r=np.copysign(pieces.swing[piece], cells.r))
    hidden = np.flatnonzero(np.abs(swinging.r) > np.abs(cells.r))
    return cells.and_also(turning.rows(np.flatnonzero(np.isfinite(step)))).and_also(swinging.rows(hidden))


class _Sizes(NamedTuple):
    """Bounds of |speed|, |acceleration|, |jerk|, |curvature| and |curvature rate| over cells, Shape (n,) each."""

    v: FloatArray
    a: FloatArray
    j: FloatArray
    k: FloatArray
    r: FloatArray

    @classmethod
    def over(cls, first: _Cells, last: _Cells) -> _Sizes:
        """Over the cells from their first to their last instants."""
        # Speed is a parabola with second derivative j: it leaves the chord by at most |j| width^2 / 8.
        v = np.maximum(np.abs(first.v), np.abs(last.v)) + np.abs(first.j) * first.width**2 / 8.0
        a, k = np.maximum(np.abs(first.a), np.abs(last.a)), np.maximum(np.abs(first.k), np.abs(last.k))
        return cls(v, a, np.abs(first.j), k, np.abs(first.r))


def _yaw_rate_bend(b: _Sizes) -> FloatArray:
    return b.j * b.k + 3.0 * b.a * b.v * b.r


def _steering_rate_bend(b: _Sizes, drive: MotionLimits) -> FloatArray:
    steepest = drive.wheelbase * b.r
    turned = steepest * b.v
    return steepest * b.j + 2.0 * turned * steepest * b.a + 2.0 * turned**3


# Bounds of |f''| over cells, of quantities f of `LimitKind.TURNING`, by the names of their limits.
_BENDS: dict[str, Callable[[_Sizes, MotionLimits], FloatArray]] = {
    "max_yaw_rate": lambda b, _: _yaw_rate_bend(b),
    "max_lateral_acceleration": lambda b, _: (
        2.0 * b.a * b.a * b.k + 2.0 * b.v * b.j * b.k + 5.0 * b.v * b.v * b.a * b.r
    ),
    "max_yaw_acceleration": lambda b, _: 4.0 * b.j * b.v * b.r + 3.0 * b.a * b.a * b.r,
    "max_lateral_jerk": lambda b, _: 6.0 * b.a * b.j * b.k + 12.0 * b.v * b.a * b.a * b.r + 7.0 * b.v * b.v * b.j * b.r,
    "max_wheel_speed": lambda b, drive: b.j + 0.5 * drive.track_width * _yaw_rate_bend(b),
    "max_steering_rate": _steering_rate_bend,
}
_EXTREMES = {"max_speed", "max_reverse_speed", "max_acceleration", "max_deceleration", "max_jerk"}  # exact: `_rates`


class _TurningRule(NamedTuple):
    """How a finite limit is proven: its value, |f| at the first instant of cells, and a bound of |f''| over cells."""

    limit: float
    size: Callable[[_Cells, MotionLimits], FloatArray]
    bend: Callable[[_Sizes, MotionLimits], FloatArray]


def _turning_rules(finite: Mapping[str, float]) -> dict[str, _TurningRule]:
    """Of every finite limit that depends on curvature, by its name in `LIMITS`."""
    found = ((name, LIMITS[name].size) for name in _BENDS if name in finite)
    return {name: _TurningRule(finite[name], size, _BENDS[name]) for name, size in found if size is not None}


def _without_rule(finite: Mapping[str, float], rules: Mapping[str, _TurningRule]) -> Iterator[Violation]:
    """Finite limits that nothing here proves; those of `LimitKind.PATH` are left to the path certificate."""
    for name, value in finite.items():
        if not (name in _EXTREMES or name in rules or (name in LIMITS and LIMITS[name].kind is LimitKind.PATH)):
            yield Violation("unproven", f"no rule proves {name} = {value:.4g}", 0.0, np.inf)


def _subdivide(first: _Cells, judge: _Judge, is_late: Callable[[], bool]) -> None:
    """Judge cells, and bisect those that are neither cleared nor broken.

    Cells that are not cleared when `is_late()` turns true, or when there have been too many, are `unproven`; the
    ratios are infinite then.
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


class _Judge:
    """Looks at cells and keeps the worst of each quantity."""

    def __init__(self, rules: Mapping[str, _TurningRule], drive: MotionLimits) -> None:
        self.drive = drive
        self.rules = {LIMITS[name].quantity: rule for name, rule in rules.items()}
        self.ratios = dict.fromkeys(self.rules, 0.0)
        self.found: dict[str, Violation] = {}

    def look_at(self, cells: _Cells) -> IntArray:
        """Judge cells; the rows of those that are neither cleared nor broken."""
        last = cells.advanced(cells.width)
        most = _Sizes.over(cells, last)
        open_cells = np.zeros(cells.t.size, dtype=np.bool_)
        for kind, (limit, size, bend) in self.rules.items():
            at_ends = size(cells, self.drive), size(last, self.drive)
            # What is no number proves nothing: it counts as infinite where it arises.
            seen = np.nan_to_num(np.maximum(*at_ends), nan=np.inf, posinf=np.inf)
            stray = np.where(cells.width > 0.0, bend(most, self.drive) * cells.width**2 / 8.0, 0.0)
            proven = np.nan_to_num(seen + stray, nan=np.inf, posinf=np.inf)
            broken = seen > limit * (1.0 + TOLERANCE)
            cleared = proven <= limit * (1.0 + TOLERANCE)
            self._raise_ratio(kind, float(np.max(np.where(cleared, proven, seen), initial=0.0)))
            if broken.any():
                ends = (cells, at_ends[0]), (last, at_ends[1])
                worst = int(np.argmax(np.where(broken, seen, -1.0)))
                self._note(kind, max((_exceeded(kind, limit, *end, worst) for end in ends), key=lambda one: one.amount))
            open_cells |= ~cleared & ~broken
        return np.flatnonzero(open_cells)

    def give_up(self, cells: _Cells) -> None:
        """Nothing is known of these cells."""
        for kind in self.rules:
            self._raise_ratio(kind, np.inf)
        k = int(np.argmin(cells.t))
        message = f"the limits on turning near t = {cells.t[k]:.3f} s, s = {cells.s[k]:.3f} m are not proven"
        self._note("unproven", Violation("unproven", message, float(cells.s[k]), np.inf))

    def violations(self) -> Iterator[Violation]:
        """The worst of each quantity that breaks its limit, and of what is not proven."""
        return (self.found[kind] for kind in (*self.rules, "unproven") if kind in self.found)

    def _raise_ratio(self, kind: str, value: float) -> None:
        self.ratios[kind] = max(self.ratios[kind], value / self.rules[kind].limit)

    def _note(self, kind: str, violation: Violation) -> None:
        if kind not in self.found or violation.amount > self.found[kind].amount:
            self.found[kind] = violation


def _exceeded(kind: str, limit: float, cells: _Cells, value: FloatArray, k: int) -> Violation:
    name, found = kind.replace("_", " "), float(np.nan_to_num(value[k], nan=np.inf, posinf=np.inf))
    message = f"{name} {found:.5g} at t = {cells.t[k]:.3f} s, s = {cells.s[k]:.3f} m exceeds {limit:.5g}"
    return Violation(kind, message, float(cells.s[k]), max(found - limit, 0.0))
