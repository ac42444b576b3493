"""`certify_trajectory`: the independent verdict on a motion's limits."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.deadline import never_late
from optdock.path import Direction, PolylineSegment
from optdock.verification.certificate import TrajectoryCertificate, Violation
from optdock.verification.kept_proofs import KeptProofs
from optdock.verification.trajectory_cells import RTOL, Instants, crossings, curved_limits

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from optdock.geometry.arrays import FloatArray
    from optdock.limits import MotionLimits, SpeedZone
    from optdock.path import Path
    from optdock.trajectory import TimeLaw, Trajectory

__all__ = ["certify_trajectory"]

REST_TOLERANCE = 1e-6  # [m], [m/s], [m/s^2] at cusps and at the end
REST_YAW_TOLERANCE = 1e-5  # [rad] at the ends: what a curvature of 10 1/m turns within `REST_TOLERANCE`


def certify_trajectory(
    trajectory: Trajectory,
    limits: MotionLimits,
    zone: SpeedZone,
    *,
    start_speed: float | None = None,
    start_acceleration: float | None = None,
    is_late: Callable[[], bool] = never_late,
) -> TrajectoryCertificate:
    """Prove that a trajectory keeps every motion limit, or name what is broken, when and by how much.

    Within a step of a polyline, whose curvature is a difference quotient, 5 % beyond a limit on turning are accepted.

    A proof is kept for as long as the trajectory lives, as those of paths are.

    It does NOT look at clearance or at the path's own curvature bounds: see `certify_path`.

    Args:
        trajectory: The motion to judge.
        limits: What the drive can do.
        zone: Slow stretch at the end of the path.
        start_speed: Speed along the travel that the motion must begin with [m/s]; None: not checked.
        start_acceleration: Likewise [m/s^2].
        is_late: For callers with a deadline, asked every few milliseconds. Once it is True whatever is not proven yet
            is refused as `unproven`.

    Returns:
        The certificate; `certified` is True only if everything was proven.
    """
    start = (start_speed, start_acceleration)
    return _PROOFS.verdict(
        trajectory, (limits, zone, start), is_late, lambda asked: _judged(trajectory, limits, zone, start, asked)
    )


_PROOFS: KeptProofs[Trajectory, TrajectoryCertificate] = KeptProofs()


def _judged(
    trajectory: Trajectory,
    limits: MotionLimits,
    zone: SpeedZone,
    start: tuple[float | None, float | None],
    is_late: Callable[[], bool],
) -> TrajectoryCertificate:
    law = trajectory.time_law
    structure = (*_coverage(trajectory), *_rest(trajectory), *_start(law, *start))
    if any(v.kind == "coverage" for v in structure):
        return TrajectoryCertificate(structure, {}, law.duration, trajectory.path.digest)
    peaks = tuple(_stretch_peaks(trajectory, limits, zone))
    bounded = [*_speed(peaks), *_rates(law, limits)]
    ratios, curved = curved_limits(trajectory, limits, is_late)
    plain = {violation.kind: violation for violation in bounded}
    ratios = {**_plain_ratios(law, limits, peaks), **ratios}
    violations = (*structure, *plain.values(), *curved)
    return TrajectoryCertificate(violations, ratios, law.duration, trajectory.path.digest)


def _coverage(trajectory: Trajectory) -> Iterator[Violation]:
    law, length = trajectory.time_law, trajectory.path.length
    for name, found, wanted in (("begins", law.states[0, 0], 0.0), ("ends", law.states[-1, 0], length)):
        if not abs(found - wanted) <= REST_TOLERANCE:
            message = f"the motion {name} at s = {found:.6g} m, not at {wanted:.6g} m"
            yield Violation("coverage", message, float(found), float(abs(found - wanted)))
    yield from _turns_beyond(trajectory)
    slowest, at = _lowest_speed(law)
    if slowest < -REST_TOLERANCE:
        yield Violation("coverage", f"the motion runs backwards at {-slowest:.3g} m/s, t = {at:.3f} s", 0.0, -slowest)
    back = _distance_back(law)
    if not back <= REST_TOLERANCE:
        yield Violation("coverage", f"the motion runs backwards by up to {back:.3g} m in all", 0.0, back)
    yield from _turns_in_place(trajectory.path)


def _turns_beyond(trajectory: Trajectory) -> Iterator[Violation]:
    """What a motion leaves out at either end within the tolerance must not hold a turn."""
    law, path = trajectory.time_law, trajectory.path
    for name, found, wanted in (("begins", law.states[0, 0], 0.0), ("ends", law.states[-1, 0], path.length)):
        missed = abs(float(np.diff(path.poses_at([found, wanted])[:, 2])[0]))
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


def _distance_back(law: TimeLaw) -> float:
    """Upper bound of the distance that the motion runs backwards [m]."""
    speeds = _speed_extremes(law).v
    borders, inside = speeds[: law.times.size], speeds[law.times.size :]
    slowest = np.minimum(np.minimum(borders[:-1], borders[1:]), inside)
    return float(np.sum(law.durations * np.maximum(-slowest, 0.0)))


def _lowest_speed(law: TimeLaw) -> tuple[float, float]:
    found = _speed_extremes(law)
    k = int(np.argmin(found.v))
    return float(found.v[k]), float(found.t[k])


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


def _start(law: TimeLaw, speed: float | None, acceleration: float | None) -> Iterator[Violation]:
    for name, found, wanted in (
        ("speed", float(law.states[0, 1]), speed),
        ("acceleration", float(law.states[0, 2]), acceleration),
    ):
        if wanted is not None and not abs(found - wanted) <= REST_TOLERANCE:
            message = f"the motion begins with {name} {found:.4g}, the robot has {wanted:.4g}"
            yield Violation("start_state", message, 0.0, abs(found - wanted))


def _segment_limits(trajectory: Trajectory, limits: MotionLimits, zone: SpeedZone) -> FloatArray:
    """Stretches with one speed limit: begin, end, limit. Shape (n, 3) [m, m, m/s]."""
    path = trajectory.path
    top = {Direction.FORWARD: limits.max_speed, Direction.REVERSE: limits.max_reverse_speed}
    rows = [
        (a, b, top[segment.direction])
        for segment, a, b in zip(path.segments, path.segment_starts[:-1], path.segment_starts[1:], strict=True)
    ]
    if zone.distance > 0.0:
        rows.append((max(0.0, path.length - zone.distance), path.length, zone.speed))
    return np.array(rows)


class _Peak(NamedTuple):
    """Largest speed within a stretch of one limit [m/s], when [s] and where [m]."""

    limit: float
    speed: float
    t: float
    s: float


def _stretch_peaks(trajectory: Trajectory, limits: MotionLimits, zone: SpeedZone) -> Iterator[_Peak]:
    law = trajectory.time_law
    found, stretches = _speed_extremes(law), _segment_limits(trajectory, limits, zone)
    entries = crossings(law, stretches[:, :2].ravel())
    entry_times, entry_states = entries.times(law).reshape(-1, 2), entries.motion(law)[:, :2].reshape(-1, 2, 2)
    for (begin, end, limit), when, states in zip(stretches, entry_times, entry_states, strict=True):
        inside = (found.s >= begin) & (found.s <= end)
        t = np.concatenate((found.t[inside], when))
        s, v = np.concatenate((np.column_stack((found.s, found.v))[inside], states)).T
        k = int(np.argmax(v))
        yield _Peak(float(limit), float(v[k]), float(t[k]), float(s[k]))


def _speed(peaks: Sequence[_Peak]) -> Iterator[Violation]:
    for limit, speed, t, s in peaks:
        if not speed <= limit * (1.0 + RTOL):
            message = f"speed {speed:.4g} m/s at t = {t:.3f} s, s = {s:.3f} m exceeds {limit:.4g} m/s"
            yield Violation("speed", message, s, speed - limit)


def _rates(law: TimeLaw, limits: MotionLimits) -> Iterator[Violation]:
    for kind, value, limit, row in (
        ("acceleration", law.states[:, 2], limits.max_acceleration, law.states[:, 0]),
        ("deceleration", -law.states[:, 2], limits.max_deceleration, law.states[:, 0]),
        ("jerk", np.abs(law.jerks), limits.max_jerk, law.states[:-1, 0]),
    ):
        k = int(np.argmax(value))
        if not value[k] <= limit * (1.0 + RTOL):
            message = f"{kind} {value[k]:.4g} at t = {law.times[k]:.3f} s, s = {row[k]:.3f} m exceeds {limit:.4g}"
            yield Violation(kind, message, float(row[k]), float(value[k] - limit))


def _plain_ratios(law: TimeLaw, limits: MotionLimits, peaks: Sequence[_Peak]) -> dict[str, float]:
    return {
        "speed": max(peak.speed / peak.limit for peak in peaks),
        "acceleration": float(np.max(law.states[:, 2])) / limits.max_acceleration,
        "deceleration": float(np.max(-law.states[:, 2])) / limits.max_deceleration,
        "jerk": float(np.max(np.abs(law.jerks))) / limits.max_jerk,
    }
