"""The rules for a trajectory: coverage of the path, rests, and motion limits.

Speed, acceleration and jerk are polynomials of degree 2, 1 and 0 in each phase of the time law, so their extremes are
exact. The limits that depend on curvature are proven by `turning_rules`.

At a jump of the curvature between two segments, the wheels are steered at rest, and the rest must be long enough. The
same applies to a start with an unknown steering angle.

A turn in place is driven over the path coordinate, so its yaw rate, yaw acceleration and yaw jerk are the speed,
acceleration and jerk of the time law. Their extremes are therefore exact, and separate limits apply
(`MotionLimits.turning`). The phases of a turn lie between the rests at its ends.

A finite limit without a rule here or in the path certificate is a violation, so that a new field of `MotionLimits`
cannot be ignored.
"""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.model.limits import LIMITS, QUANTITY_UNITS, LimitKind, finite_limits
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
    from optdock.model.constant_jerk import TimeLaw
    from optdock.model.limits import MotionLimits, SpeedZone
    from optdock.model.path import Path
    from optdock.model.trajectory import Trajectory

__all__ = ["trajectory_violations"]

REST_TOLERANCE = TOLERANCE  # [m], [m/s], [m/s^2] at cusps and at the ends
REST_YAW_TOLERANCE = 1e-5  # [rad] at the ends: the turn of a curvature of 10 1/m within `REST_TOLERANCE`


def trajectory_violations(
    trajectory: Trajectory,
    limits: MotionLimits,
    zone: SpeedZone,
    start: tuple[float | None, float | None, float],
    is_late: Callable[[], bool],
) -> tuple[tuple[Violation, ...], dict[str, float]]:
    """Return every violation, and the proven ratio of each quantity to its limit; see `certify_trajectory`."""
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
        places = borders if pieces is None else np.concatenate((borders, pieces.begin[1:]))
        reached = crossings(law, places)  # one bisection for all places
        if pieces is not None:
            knots = reached.rows(slice(borders.size, None))
            subdivide(initial_cells(law, pieces, knots, has_turns=path.turns), judge, is_late)
    driven, turns = _phases_apart(trajectory)
    peaks = [*_stretch_peaks(law, stretches, reached.rows(slice(borders.size)), extremes), *_rates(law, driven, limits)]
    turning = [peak for turn in turns for peak in _turn_peaks(law, turn, extremes, limits)]
    ratios = {**dict.fromkeys(("speed", "acceleration", "deceleration", "jerk"), 0.0), **judge.ratios}
    found = [(peak.kind, peak.value / peak.limit) for peak in (*peaks, *turning)]
    for kind, ratio in (*found, *[("steering_rate", wait.ratio) for wait in waits]):
        ratios[kind] = max(ratios.get(kind, 0.0), ratio)
    linear = {violation.kind: violation for violation in _exceeded(peaks, "")}
    unruled = _without_rule(finite, rules)
    return (*structure, *linear.values(), *judge.violations(), *_exceeded(turning, " of a turn"), *unruled), ratios


def _coverage(trajectory: Trajectory, extremes: _Extremes) -> Iterator[Violation]:
    law, length = trajectory.time_law, trajectory.path.length
    for name, found, wanted in (("begins", law.states[0, 0], 0.0), ("ends", law.states[-1, 0], length)):
        if not abs(found - wanted) <= REST_TOLERANCE:
            message = f"the motion {name} at s = {found:.6g} m, not at {wanted:.6g} m"
            yield Violation("coverage", message, float(found), float(abs(found - wanted)))
    yield from _turns_beyond(trajectory)
    k = int(extremes.v.argmin())
    slowest, at = float(extremes.v[k]), float(extremes.t[k])
    if slowest < -REST_TOLERANCE:
        yield Violation("coverage", f"the motion runs backwards at {-slowest:.3g} m/s, t = {at:.3f} s", 0.0, -slowest)
    back = _distance_back(law, extremes)
    if not back <= REST_TOLERANCE:
        yield Violation("coverage", f"the motion runs backwards by up to {back:.3g} m in total", 0.0, back)
    yield from _turns_in_place(trajectory.path)


def _turns_beyond(trajectory: Trajectory) -> Iterator[Violation]:
    """Check that the parts of the path that a motion omits at its ends, within the tolerance, contain no turn."""
    law, path = trajectory.time_law, trajectory.path
    ends = ("begins", law.states[0, 0], 0.0), ("ends", law.states[-1, 0], path.length)
    yaws = path.poses_at([s for _, found, wanted in ends for s in (found, wanted)])[:, 2]
    for (name, found, wanted), there, here in zip(ends, yaws[::2], yaws[1::2], strict=True):
        missed = abs(float(here - there))
        if abs(found - wanted) <= REST_TOLERANCE and not missed <= REST_YAW_TOLERANCE:
            message = f"the motion {name} {missed:.3g} rad away from the path"
            yield Violation("coverage", message, wanted, missed)


def _turns_in_place(path: Path) -> Iterator[Violation]:
    """Check for steps of a polyline that change only the yaw; a time law over distance gives them no duration."""
    for segment, start in zip(path.segments, path.segment_starts[:-1], strict=True):
        if isinstance(segment, PolylineSegment):
            still = np.flatnonzero(~np.isfinite(segment.step_curvature))
            if still.size:
                s = float(start + segment.knots[still[0]])
                turn = float(np.sum(np.abs(np.diff(segment.poses[:, 2])[still])))
                message = f"the path turns in place at s = {s:.3f} m, but the motion has no time for the turn"
                yield Violation("coverage", message, s, turn)


class _Extremes(NamedTuple):
    """Instants that include every phase's extreme speeds: time [s], distance [m], speed [m/s], Shape (n,) each."""

    t: FloatArray
    s: FloatArray
    v: FloatArray


def _speed_extremes(law: TimeLaw) -> _Extremes:
    """Return the borders of the phases, followed by their stationary points of speed, clipped to the phase."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        dt = np.where(law.jerks != 0.0, -law.states[:-1, 2] / law.jerks, 0.0)
    inside = Instants(np.arange(law.durations.size), np.minimum(np.maximum(dt, 0.0), law.durations))
    s, v, _ = inside.motion(law)
    borders = law.states
    return _Extremes(
        np.concatenate((law.times, inside.times(law))),
        np.concatenate((borders[:, 0], s)),
        np.concatenate((borders[:, 1], v)),
    )


def _distance_back(law: TimeLaw, extremes: _Extremes) -> float:
    """Return an upper bound of the distance of backward motion [m]."""
    borders, inside = extremes.v[: law.times.size], extremes.v[law.times.size :]
    slowest = np.minimum(np.minimum(borders[:-1], borders[1:]), inside)
    return float((law.durations * np.maximum(-slowest, 0.0)).sum())


def _rest(trajectory: Trajectory) -> Iterator[Violation]:
    law = trajectory.time_law
    for name, s in (*(("cusp", s) for s in trajectory.path.cusps), ("end", trajectory.path.length)):
        k = -1 if name == "end" else _border_at(law, s)
        miss = float(np.abs(law.states[k] - (s, 0.0, 0.0)).max())  # NaN stays
        if not miss <= REST_TOLERANCE:
            at, v, a = law.states[k]
            nearest = f"nearest phase border s = {at:.4f} m, v = {v:.3g}, a = {a:.3g}"
            message = f"no rest at the {name} s = {s:.4f} m: {nearest}"
            yield Violation("rest", message, s, miss)


def _border_at(law: TimeLaw, s: float) -> int:
    """Return the phase border at `s` that is nearest to rest; if there is none at `s`, the nearest border."""
    off = np.abs(law.states[:, 0] - s)
    moving = np.abs(law.states[:, 1:]).max(axis=1)
    at = off <= REST_TOLERANCE
    return int(np.argmin(np.where(at, moving, np.inf) if at.any() else off))


def _rest_at(law: TimeLaw, s: float) -> int:
    """Return the phase border at rest nearest to `s`, so that turns below the tolerance have distinct ends."""
    still = np.max(np.abs(law.states[:, 1:]), axis=1) <= REST_TOLERANCE
    off = np.where(still, np.abs(law.states[:, 0] - s), np.inf)
    k = int(np.argmin(off))
    return k if off[k] <= REST_TOLERANCE else _border_at(law, s)


class _Peak(NamedTuple):
    """The largest value of a quantity, its limit, its time [s] and arc length [m]."""

    kind: str
    limit: float
    value: float
    t: float
    s: float


class _Wait(NamedTuple):
    """A rest: arc length [m], required and actual duration [s]."""

    s: float
    needed: float
    given: float

    @property
    def ratio(self) -> float:
        """Ratio of the steering rate to its limit, if the wheels turn uniformly during the rest."""
        return self.needed / self.given if self.given > 0.0 else np.inf


def _waits(trajectory: Trajectory, limits: MotionLimits, start_wait: float) -> list[_Wait]:
    """Return the rests at the start and at cusps for which steering takes longer than the tolerance.

    A phase between two borders at rest is entirely at rest, because its linear acceleration is zero at both ends. If
    several cusps share a border, they also share the phases at rest at this border, so their required durations are
    added.
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
            message = f"the wheels take {needed:.4g} s to turn {where}, but the motion rests {given:.4g} s"
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
    """Return begin, end and limit of the driven stretches with a constant speed limit. Shape (n, 3) [m, m, m/s]."""
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


def _stretch_peaks(law: TimeLaw, stretches: FloatArray, entries: Instants, found: _Extremes) -> Iterator[_Peak]:
    """Yield the largest speed of every stretch; `entries` alternates between arrivals at its beginning and its end."""
    at_entries = (entries.times(law), *entries.motion(law)[:2])
    for i, (begin, end, limit) in enumerate(stretches.tolist()):
        inside, ends = (found.s >= begin) & (found.s <= end), slice(2 * i, 2 * i + 2)
        t, s, v = [np.concatenate((all_of[inside], when[ends])) for all_of, when in zip(found, at_entries, strict=True)]
        k = int(v.argmax())
        yield _Peak("speed", limit, float(v[k]), float(t[k]), float(s[k]))


class _Phases(NamedTuple):
    """Selected phases of a time law and their borders: indices, jerks of the phases, accelerations at the borders."""

    inside: IntArray
    borders: IntArray
    jerks: FloatArray
    a: FloatArray

    @classmethod
    def of(cls, law: TimeLaw, inside: IntArray) -> _Phases:
        """Return the phases `inside`, with the borders at both their ends."""
        borders = np.union1d(inside, inside + 1)
        return cls(inside, borders, law.jerks[inside], law.states[borders, 2])


def _phases_apart(trajectory: Trajectory) -> tuple[_Phases, list[_Phases]]:
    """Return the driven phases, and the phases of every turn in place, between the rests at its ends."""
    law, path = trajectory.time_law, trajectory.path
    if not path.turns:
        return _Phases(np.arange(law.durations.size), np.arange(law.times.size), law.jerks, law.states[:, 2]), []
    cuts = [0, *(_rest_at(law, s) for s in path.cusps), law.durations.size]
    owned = [np.arange(first, last) for first, last in itertools.pairwise(cuts)]
    turns = [isinstance(segment, TurnSegment) for segment in path.segments]
    driven = np.setdiff1d(np.arange(law.durations.size), np.concatenate(list(itertools.compress(owned, turns))))
    return _Phases.of(law, driven), [_Phases.of(law, phases) for phases in itertools.compress(owned, turns)]


def _turn_peaks(law: TimeLaw, turn: _Phases, found: _Extremes, limits: MotionLimits) -> Iterator[_Peak]:
    """Yield the exact extremes of yaw rate, yaw acceleration and yaw jerk in one turn."""
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
        yield _Peak(kind, limit, float(value[k]) / TURN_RADIUS, float(t[k]), float(s[k]))


def _exceeded(peaks: Sequence[_Peak], what: str) -> Iterator[Violation]:
    for kind, limit, value, t, s in peaks:
        if not value <= limit * (1.0 + TOLERANCE):
            name, unit = f"{kind.replace('_', ' ')}{what}", QUANTITY_UNITS[kind]
            message = f"{name} {value:.5g} {unit} at t = {t:.3f} s, s = {s:.3f} m exceeds {limit:.5g} {unit}"
            yield Violation(kind, message, s, value - limit)


def _rates(law: TimeLaw, driven: _Phases, limits: MotionLimits) -> Iterator[_Peak]:
    for kind, value, limit, rows in (
        ("acceleration", driven.a, limits.max_acceleration, driven.borders),
        ("deceleration", -driven.a, limits.max_deceleration, driven.borders),
        ("jerk", np.abs(driven.jerks), limits.max_jerk, driven.inside),
    ):
        if value.size:
            i = value.argmax()
            k = rows[i]
            yield _Peak(kind, limit, value.item(i), law.times.item(k), law.states.item(k, 0))


_EXTREMES = {"max_speed", "max_reverse_speed", "max_acceleration", "max_deceleration", "max_jerk"}  # exact: `_rates`


def _without_rule(finite: Mapping[str, float], rules: Mapping[str, TurningRule]) -> Iterator[Violation]:
    """Yield the finite limits without a rule; the path certificate covers limits of `LimitKind.PATH`."""
    for name, value in finite.items():
        if not (name in _EXTREMES or name in rules or (name in LIMITS and LIMITS[name].kind is LimitKind.PATH)):
            yield Violation("unproven", f"no rule proves {name} = {value:.4g}", 0.0, np.inf)
