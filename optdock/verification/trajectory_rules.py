"""The rules of a trajectory: that its time law covers the path, rests where it must, and keeps every motion limit.

Speed, acceleration and jerk are polynomials of degree 2, 1 and 0 in each phase of the time law: their extremes are
exact. The limits that depend on curvature are proven by `turning_rules`.

Where the curvature jumps between two segments the wheels turn at rest, and the rest must be long enough for that; so
must the rest at the start, where they may stand at any angle.

A turn in place is driven over the path coordinate, so its yaw rate, acceleration and jerk are the time law's own: exact
extremes, against limits of their own (`MotionLimits.turning`). The phases between the rests at its ends are the turn's.

A finite limit that has no rule here, and none of the path certificate either, is a violation: whatever field
`MotionLimits` gets, a motion is certified only where it has been proven.
"""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.model.limits import LIMITS, LimitKind, finite_limits
from optdock.model.path import (
    Direction,
    PolylineSegment,
    TurnSegment,
    driven_stretches,
    joint_curvatures,
    place_before_end,
)
from optdock.model.segments import TURN_RADIUS
from optdock.verification.certificate import TOLERANCE, Violation
from optdock.verification.turning_rules import (
    Instants,
    Judge,
    TurningRule,
    crossings,
    initial_cells,
    path_pieces,
    subdivide,
    turning_rules,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from optdock.geometry.arrays import FloatArray, IntArray
    from optdock.model.limits import MotionLimits, SpeedZone
    from optdock.model.path import Path
    from optdock.model.trajectory import TimeLaw, Trajectory

__all__ = ["trajectory_violations"]

REST_TOLERANCE = TOLERANCE  # [m], [m/s], [m/s^2] at cusps and at the ends
REST_YAW_TOLERANCE = 1e-5  # [rad] at the ends: what a curvature of 10 1/m turns within `REST_TOLERANCE`


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
    rules = turning_rules(finite)
    stretches, judge = _segment_limits(path, limits, zone), Judge(rules, limits)
    borders = stretches[:, :2].ravel()
    with np.errstate(over="ignore", invalid="ignore"):
        pieces = path_pieces(path) if judge.rules else None
        asked = borders if pieces is None else np.concatenate((borders, pieces.begin[1:]))
        reached = crossings(law, asked)  # one bisection for all places that are asked for
        if pieces is not None:
            knots = reached.rows(slice(borders.size, None))
            subdivide(initial_cells(law, pieces, knots, has_turns=path.turns), judge, is_late)
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


def _turning_points(law: TimeLaw) -> Instants:
    """Where the speed of each phase is stationary, or the end of the phase nearest to that."""
    a = law.states[:-1, 2]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        dt = np.where(law.jerks != 0.0, -a / law.jerks, 0.0)
    return Instants(np.arange(law.durations.size), np.clip(dt, 0.0, law.durations))


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
    turned = limits.steering_times(joint_curvatures(path)) if cusps else ()
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
        begin = place_before_end(path, zone.distance)
        rows += [(max(a, begin), b, zone.speed) for a, b in driven_stretches(path) if b > begin]
    return np.array(rows).reshape(-1, 3)


class _Peak(NamedTuple):
    """Largest speed within a stretch of one limit [m/s], when [s] and where [m]."""

    limit: float
    speed: float
    t: float
    s: float


def _stretch_peaks(law: TimeLaw, stretches: FloatArray, entries: Instants, found: _Extremes) -> Iterator[_Peak]:
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


_EXTREMES = {"max_speed", "max_reverse_speed", "max_acceleration", "max_deceleration", "max_jerk"}  # exact: `_rates`


def _without_rule(finite: Mapping[str, float], rules: Mapping[str, TurningRule]) -> Iterator[Violation]:
    """Finite limits that nothing here proves; those of `LimitKind.PATH` are left to the path certificate."""
    for name, value in finite.items():
        if not (name in _EXTREMES or name in rules or (name in LIMITS and LIMITS[name].kind is LimitKind.PATH)):
            yield Violation("unproven", f"no rule proves {name} = {value:.4g}", 0.0, np.inf)
