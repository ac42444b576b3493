"""The inequalities that samples of a drive keep, at one instant and between two; see `refutation` for all of them."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.geometry.pose import wrap_angles
from optdock.model.limits import LIMITS
from optdock.model.path import ClothoidSegment, PolylineSegment, joint_curvatures
from optdock.samples.sampled_motion import (
    EXACT,
    Rounding,
    SampledMotion,
    half_unit,
    step_lengths,
)
from optdock.verification.certificate import TOLERANCE, Violation
from optdock.verification.turning_rules import STEP_RTOL

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from optdock.geometry.arrays import BoolArray, FloatArray, IntArray
    from optdock.model.limits import MotionLimits
    from optdock.model.path import Path
    from optdock.model.problem import DockingProblem

__all__ = [
    "ARITHMETIC",
    "SamplesOnPath",
    "Sums",
    "at_knots",
    "at_samples",
    "begins",
    "between_samples",
    "by_curvature",
    "ends_at_rest",
    "rests",
    "through_rests",
    "worst",
    "worst_at",
]

_STEERED = 1e-4  # of a steering time: six decimals of a curvature, and the tolerance of the proof
ARITHMETIC = 1e-9  # rounding of what is computed here from numbers around 1


class Sums(NamedTuple):
    """What steps between samples add up to since the first one, Shape (n,) each.

    `place`, `place_error` [m]: see `step_lengths`; `speed`, `speed_error` [m/s]: likewise by the trapezoid of the
    accelerations; `yaw` [rad]: the column made continuous; `turn` [rad]: the same with every step positive.
    """

    place: FloatArray
    place_error: FloatArray
    speed: FloatArray
    speed_error: FloatArray
    yaw: FloatArray
    turn: FloatArray

    @classmethod
    def of(cls, motion: SampledMotion, v: FloatArray, a: FloatArray, limits: MotionLimits) -> Sums:
        """The sums along the travel, speeds `v` and accelerations `a` being positive there."""
        h = np.diff(motion.t)
        steps = step_lengths(motion.t, v, a, limits)
        turn = wrap_angles(np.diff(motion.yaw))
        error = np.minimum(0.25 * limits.max_jerk * h**2, (limits.max_acceleration + limits.max_deceleration) * h)
        columns = (steps.length, steps.error, 0.5 * h * (a[:-1] + a[1:]), error, turn, np.abs(turn))
        return cls(*(np.concatenate(([0.0], np.cumsum(column))) for column in columns))


class SamplesOnPath(NamedTuple):
    """The samples beside their path, Shape (n,) unless said.

    `s`: arc length [m]; `v`, `a`, `j`: speed, acceleration, jerk along the travel; `apart` [m] and `turned` [rad]: how
    far the pose is off the path; `rounding`: of the numbers; `slack`: of `s` [m].
    """

    motion: SampledMotion
    path: Path
    s: FloatArray
    v: FloatArray
    a: FloatArray
    j: FloatArray
    apart: FloatArray
    turned: FloatArray
    sums: Sums
    rounding: Rounding
    slack: float

    def rows(self, keep: BoolArray, limits: MotionLimits) -> SamplesOnPath:
        """The samples at `keep`."""
        motion = type(self.motion)(*(column[keep] for column in self.motion))
        v, a = self.v[keep], self.a[keep]
        return self._replace(
            motion=motion,
            s=self.s[keep],
            v=v,
            a=a,
            j=self.j[keep],
            apart=self.apart[keep],
            turned=self.turned[keep],
            sums=Sums.of(motion, v, a, limits),
        )


class _Bends(NamedTuple):
    """Curvature [1/m] and its rate [1/m^2] just before, at and just after the samples, Shape (3, n) each."""

    curvature: FloatArray
    rate: FloatArray


def worst(
    judged: SamplesOnPath,
    kind: str,
    values: FloatArray,
    limit: FloatArray | float,
    rough: FloatArray | float = 0.0,
    at: FloatArray | None = None,
) -> Iterator[Violation]:
    """The value furthest beyond its limit, if any is by more than rounding explains.

    Args:
        judged: Says when and where, unless `at` does.
        kind: What the values are, with their unit.
        values: Shape (m,).
        limit: Likewise, or one for all.
        rough: By how much rounding may have raised the values, likewise.
        at: Times and arc lengths of the values, Shape (m, 2); None: those of the samples.
    """
    at = np.column_stack((judged.motion.t, judged.s)) if at is None else at
    yield from worst_at(at, kind, values, limit, rough)


def _limited(
    judged: SamplesOnPath,
    limits: MotionLimits,
    values: Mapping[str, FloatArray],
    said: str = "{}",
    rough: FloatArray | float = 0.0,
    at: FloatArray | None = None,
) -> Iterator[Violation]:
    """As `worst`, of values of limited quantities.

    Args:
        judged: As there.
        limits: Of the robot.
        values: Of each quantity, by the name of its limit in `LIMITS`.
        said: How a message calls them, with `{}` for the quantity.
        rough: As there.
        at: As there.
    """
    for name, value in values.items():
        quantity, unit = LIMITS[name].label.split(" [")
        if math.isfinite(most := getattr(limits, name)):
            yield from worst(judged, f"{said.format(quantity)} [{unit}", value, most, rough, at)


def worst_at(
    at: FloatArray, kind: str, values: FloatArray, limit: FloatArray | float, rough: FloatArray | float
) -> Iterator[Violation]:
    """As `worst`."""
    if values.size == 0:
        return
    limits = np.broadcast_to(np.asarray(limit, dtype=np.float64), values.shape)
    beyond = values - rough - limits * (1.0 + TOLERANCE) - ARITHMETIC
    beyond = np.where(np.isnan(beyond), np.inf, beyond)
    i = int(np.argmax(beyond))
    if beyond[i] > 0.0:
        t, s = at[i]
        message = f"{kind}: {values[i]:.6g} at t = {t:.3f} s, limit {limits[i]:.6g}"
        yield Violation(kind.partition(" [")[0].replace(" ", "_"), message, float(s), float(beyond[i]))


def _bends(judged: SamplesOnPath) -> _Bends:
    near = judged.slack + ARITHMETIC
    places = [np.clip(judged.s + shift, 0.0, judged.path.length) for shift in (-near, 0.0, near)]
    return _Bends(
        np.array([np.clip(judged.path.curvature_at(s), -1e9, 1e9) for s in places]),
        np.array([judged.path.curvature_rate_at(s) for s in places]),
    )


def at_samples(judged: SamplesOnPath, problem: DockingProblem) -> Iterator[Violation]:
    """Every column along the travel within its limit."""
    limits, zone, rounding = problem.robot.limits, problem.dock.approach, judged.rounding
    v = np.maximum(judged.v, 0.0)
    fastest = np.where(judged.motion.speed >= 0.0, limits.max_speed, limits.max_reverse_speed)
    yield from worst(judged, "speed [m/s]", v, fastest, rounding.speed)
    slow = judged.s > judged.path.length - zone.distance + judged.slack + ARITHMETIC
    yield from worst(judged, "approach speed [m/s]", np.where(slow, v, 0.0), zone.speed, rounding.speed)
    gains = {"max_acceleration": judged.a, "max_deceleration": -judged.a}
    yield from _limited(judged, limits, gains, rough=rounding.acceleration)
    yield from _limited(judged, limits, {"max_jerk": np.abs(judged.j)}, rough=rounding.jerk)


def by_curvature(judged: SamplesOnPath, problem: DockingProblem) -> Iterator[Violation]:
    """Every column that depends on the curvature within its limit, and as the path has it at its place."""
    bends = _bends(judged)
    yield from _curved(judged, problem.robot.limits, bends, np.maximum(judged.v - judged.rounding.speed, 0.0))
    yield from _ties(judged, bends)


def _curved(judged: SamplesOnPath, limits: MotionLimits, bends: _Bends, v: FloatArray) -> Iterator[Violation]:
    """Limits that depend on curvature, by the columns and by the path."""
    motion, rounding = judged.motion, judged.rounding
    k = np.min(np.abs(bends.curvature), axis=0)
    straight = bends.curvature.min(axis=0) * bends.curvature.max(axis=0) <= 0.0
    k = np.where(straight, 0.0, k)
    exact = _on_clothoids(judged)
    # Of a polyline the curvature is a difference quotient: as for time laws, 5 % beyond a limit are accepted.
    k = np.where(exact, k, np.maximum(k - _noise(judged), 0.0) / (1.0 + STEP_RTOL))
    stated = np.abs(motion.yaw_acceleration) - rounding.yaw_acceleration
    low, high = _turning_rates(judged, bends)
    by_path = np.where(exact, np.maximum(np.maximum(low, -high), 0.0), 0.0)
    least, most_of_it = _turning_rates(judged, bends, 2)
    sideways = np.where(exact, v * np.maximum(np.maximum(least, -most_of_it), 0.0), 0.0)
    rate, most = np.min(np.abs(bends.rate), axis=0), np.max(np.abs(bends.curvature), axis=0)
    values = {
        "max_yaw_rate": np.maximum(np.abs(motion.yaw_rate) - rounding.yaw_rate, v * k),
        "max_yaw_acceleration": np.maximum(stated, by_path),
        "max_lateral_acceleration": v**2 * k,
        "max_lateral_jerk": sideways,
        "max_wheel_speed": v * (1.0 + 0.5 * limits.track_width * k),
        "max_steering_rate": np.where(exact, v * limits.steering_per_metre(most, rate), 0.0),
    }
    yield from _limited(judged, limits, values)


def _turning_rates(judged: SamplesOnPath, bends: _Bends, order: int = 1) -> tuple[FloatArray, FloatArray]:
    """The smallest and the largest n a k + v^2 r that path and numbers allow, k and r to 1e-6. Shape (n,) each.

    Of order n = 1 that is the yaw acceleration; of order 2, times v, the lateral jerk.
    """
    k, r, v, a, rounding = bends.curvature, bends.rate, judged.v, order * judged.a, judged.rounding
    rough = order * rounding.acceleration * np.abs(k) + (2.0 * np.abs(v) + rounding.speed) * rounding.speed * np.abs(r)
    rough = rough + judged.slack * np.abs(a * r) + EXACT * (np.abs(a) + v**2)
    value = a * k + v**2 * r
    return (value - rough).min(axis=0), (value + rough).max(axis=0)


def _ties(judged: SamplesOnPath, bends: _Bends) -> Iterator[Violation]:
    """Yaw rate is speed times curvature, yaw acceleration its rate of change."""
    motion, rounding = judged.motion, judged.rounding
    low, high = _curvature_range(judged, bends)
    noise = _noise(judged) + EXACT
    low, high = low - noise, high + noise
    ends = np.array([v * k for v in (judged.v - rounding.speed, judged.v + rounding.speed) for k in (low, high)])
    off = np.maximum(ends.min(axis=0) - motion.yaw_rate, motion.yaw_rate - ends.max(axis=0)) - rounding.yaw_rate
    yield from worst(judged, "yaw rate off speed times curvature [rad/s]", off, 0.0)
    least, most = _turning_rates(judged, bends)
    off = np.maximum(least - motion.yaw_acceleration, motion.yaw_acceleration - most) - rounding.yaw_acceleration
    off = np.where(_on_clothoids(judged), off, 0.0)
    yield from worst(judged, "yaw acceleration off the path's [rad/s^2]", off, 0.0)


def _owners(judged: SamplesOnPath) -> IntArray:
    found = np.searchsorted(judged.path.segment_starts, judged.s, side="right") - 1
    owners: IntArray = np.clip(found, 0, len(judged.path.segments) - 1)
    return owners


def _on_clothoids(judged: SamplesOnPath) -> BoolArray:
    exact = np.array([isinstance(segment, ClothoidSegment) for segment in judged.path.segments])
    on: BoolArray = exact[_owners(judged)]
    return on


def _noise(judged: SamplesOnPath) -> FloatArray:
    """What the rounding of a polyline's poses makes of the curvature of its steps, Shape (n,) [1/m]; 0 on clothoids."""
    noise, owners = np.zeros(judged.s.size), _owners(judged)
    for i, segment in enumerate(judged.path.segments):
        if isinstance(segment, PolylineSegment):
            step = _step_of(judged, segment, rows := np.flatnonzero(owners == i), i)
            turn = half_unit(segment.poses[:, 2])
            longer = np.sqrt(2.0) * half_unit(segment.poses[:, 0], segment.poses[:, 1])
            rough = 2.0 * (turn + longer * np.abs(segment.step_curvature)) / np.diff(segment.knots)
            noise[rows] = rough[step]
    return noise


def _step_of(judged: SamplesOnPath, segment: PolylineSegment, rows: IntArray, i: int) -> IntArray:
    """The step of segment number `i` on which each of these samples lies."""
    local = judged.s[rows] - judged.path.segment_starts[i]
    found: IntArray = np.clip(np.searchsorted(segment.knots, local, side="right") - 1, 0, segment.knots.size - 2)
    return found


def _curvature_range(judged: SamplesOnPath, bends: _Bends) -> tuple[FloatArray, FloatArray]:
    """Smallest and largest curvature that a sample may have used, Shape (n,) each.

    A polyline says it by the turns of its steps only, which are means: whatever the neighbouring steps and poses have
    counts, and as much again as these differ, by which the curve that was sampled may go beyond its means.
    """
    low, high = bends.curvature.min(axis=0), bends.curvature.max(axis=0)
    owners = _owners(judged)
    for i, segment in enumerate(judged.path.segments):
        if not isinstance(segment, PolylineSegment):
            continue
        step = _step_of(judged, segment, rows := np.flatnonzero(owners == i), i)
        turn = segment.step_curvature
        for shift in (-1, 0, 1):
            k = turn[np.clip(step + shift, 0, turn.size - 1)]
            low[rows], high[rows] = np.minimum(low[rows], k), np.maximum(high[rows], k)
        spread = high[rows] - low[rows]
        low[rows], high[rows] = low[rows] - spread, high[rows] + spread
    return low, high


def between_samples(judged: SamplesOnPath, problem: DockingProblem) -> Iterator[Violation]:
    """Means over time, of neighbours and of samples further apart; of each rule the worst."""
    found: dict[str, Violation] = {}
    stride = 1
    while stride < judged.motion.t.size:
        rows = np.arange(0, judged.motion.t.size, max(1, stride // 2))
        lag = min(stride, 2)
        if rows.size > lag:
            for violation in _means(judged, problem.robot.limits, rows, lag):
                found.setdefault(violation.kind, violation)
        stride *= 2
    yield from found.values()


def _means(judged: SamplesOnPath, limits: MotionLimits, rows: IntArray, lag: int) -> Iterator[Violation]:
    """The rules between every row of samples and the one `lag` rows later."""
    motion, rounding = judged.motion, judged.rounding
    first, last = rows[:-lag], rows[lag:]
    t = motion.t[last] - motion.t[first]
    at = np.column_stack((motion.t[first], judged.s[first]))
    early = 2.0 * rounding.time
    steepest = max(limits.max_acceleration, limits.max_deceleration)

    def change(column: FloatArray) -> FloatArray:
        gained: FloatArray = column[last] - column[first]
        return gained

    def mean(column: FloatArray, half_unit: float, slope: float) -> tuple[FloatArray, FloatArray]:
        """Mean rate and by how much rounding of values and of times may have changed it."""
        return change(column) / t, (2.0 * half_unit + (early * slope if early else 0.0)) / t

    gain, rough = mean(judged.v, rounding.speed, steepest)
    gains = {"max_acceleration": gain, "max_deceleration": -gain}
    yield from _limited(judged, limits, gains, "mean {}", rough, at)
    bent, both = np.abs(gain[lag:] - gain[:-lag]), rough[lag:] + rough[:-lag]
    apart = 0.5 * (t[lag:] + t[:-lag])
    yield from _limited(judged, limits, {"max_jerk": bent / apart}, "{} of the speeds", both / apart, at)
    top, turning = float(np.max(np.abs(motion.speed))), float(np.max(np.abs(motion.yaw_rate)))
    sideways = (top + rounding.speed) * rounding.yaw_rate + turning * rounding.speed
    for name, column, rounded in (
        ("max_jerk", judged.a, rounding.acceleration),
        ("max_yaw_acceleration", motion.yaw_rate, rounding.yaw_rate),
        ("max_yaw_rate", judged.sums.yaw, rounding.yaw),
        ("max_lateral_jerk", motion.speed * motion.yaw_rate, sideways),
    ):
        if np.isfinite(slope := getattr(limits, name)):
            gain, rough = mean(column, rounded, slope)
            yield from _limited(judged, limits, {name: np.abs(gain)}, "mean {}", rough, at)
    sums = judged.sums
    off = np.abs(change(judged.v) - change(sums.speed))
    allowed = change(sums.speed_error) + 2.0 * rounding.speed + rounding.acceleration * t + early * steepest
    yield from worst(judged, "speed off its accelerations [m/s]", off, allowed, at=at)
    off = np.abs(change(judged.s) - change(sums.place))
    fastest = max(limits.max_speed, limits.max_reverse_speed)
    allowed = change(sums.place_error) + 2.0 * judged.slack + rounding.speed * t + early * fastest
    # Beside a curve the way is longer or shorter than on it.
    allowed = allowed + float(np.max(judged.apart)) * change(sums.turn)
    yield from worst(judged, "distance off its speeds [m]", off, allowed, at=at)


def through_rests(judged: SamplesOnPath, problem: DockingProblem) -> Iterator[Violation]:
    """Speeds and accelerations with their signs, which lead through the rest at a cusp without a jump.

    So this holds as well for samples that may be on either side of the cusp.
    """
    motion, rounding, jerk = judged.motion, judged.rounding, problem.robot.limits.max_jerk
    h, a = np.diff(motion.t), motion.acceleration
    sums = np.concatenate(([0.0], np.cumsum(0.5 * h * (a[:-1] + a[1:]))))
    errors = np.concatenate(([0.0], np.cumsum(0.25 * jerk * h**2)))
    early = 2.0 * rounding.time * max(problem.robot.limits.max_acceleration, problem.robot.limits.max_deceleration)
    lag = 1
    while lag < motion.t.size:
        change, by_sums, error, t = (column[lag:] - column[:-lag] for column in (motion.speed, sums, errors, motion.t))
        allowed = error + 2.0 * rounding.speed + rounding.acceleration * t + early
        at = np.column_stack((motion.t[:-lag], judged.s[:-lag]))
        found = list(worst(judged, "speed off its accelerations [m/s]", np.abs(change - by_sums), allowed, at=at))
        if found:
            yield from found
            return
        lag *= 2


def at_knots(judged: SamplesOnPath, problem: DockingProblem) -> Iterator[Violation]:
    """Limits that depend on curvature where it bends most, however far from a sample that is.

    Between two samples the speed is at least the smaller of theirs less J h^2 / 8, the acceleration at most the larger
    of theirs plus J h / 2; the path has its curvature and one of its two rates at every knot.
    """
    limits, motion = problem.robot.limits, judged.motion
    s, steepest = np.maximum.accumulate(judged.s), max(limits.max_acceleration, limits.max_deceleration)
    for segment, start in zip(judged.path.segments, judged.path.segment_starts[:-1], strict=True):
        if not isinstance(segment, ClothoidSegment):
            continue
        places = segment.knots + start
        i = np.searchsorted(s, places, side="right") - 1
        inside = (i >= 0) & (i < s.size - 1)
        knots, i = np.flatnonzero(inside), i[inside]
        h = motion.t[i + 1] - motion.t[i]
        v = np.minimum(judged.v[i], judged.v[i + 1]) - judged.rounding.speed - limits.max_jerk * h**2 / 8.0
        # The knot may be passed a little before or after it seems to be: v^2 changes by 2 a ds.
        v = np.sqrt(np.maximum(np.maximum(v, 0.0) ** 2 - 4.0 * steepest * judged.slack, 0.0))
        a = np.maximum(np.abs(judged.a[i]), np.abs(judged.a[i + 1]))
        a = a + judged.rounding.acceleration + limits.max_jerk * h / 2.0
        k = np.abs(segment.curvature_at(segment.knots))[knots]
        rate = np.diff(segment.curvature_at(segment.knots)) / np.diff(segment.knots)
        rate = np.maximum(np.abs(np.append(rate[:1], rate)), np.abs(np.append(rate, rate[-1:])))[knots]
        at = np.column_stack((motion.t[i], places[knots]))
        values = {
            "max_yaw_rate": v * k,
            "max_yaw_acceleration": v**2 * rate - a * k,
            "max_lateral_acceleration": v**2 * k,
            "max_lateral_jerk": v * (v**2 * rate - 2.0 * a * k),
            "max_wheel_speed": v * (1.0 + 0.5 * limits.track_width * k),
            "max_steering_rate": v * limits.steering_per_metre(k, rate),
        }
        yield from _limited(judged, limits, values, "{} at a knot", at=at)


def begins(judged: SamplesOnPath, problem: DockingProblem) -> Iterator[Violation]:
    """The motion begins where the path does, as the robot drives."""
    motion, begins = judged.motion, float(judged.s[0])
    if not abs(motion.speed[0] - problem.start_speed) <= judged.rounding.speed:
        message = f"start speed: {motion.speed[0]:.6g} m/s, the robot drives {problem.start_speed:.6g} m/s"
        yield Violation("start_state", message, 0.0, abs(float(motion.speed[0] - problem.start_speed)))
    found, wanted = float(motion.acceleration[0]), problem.start_acceleration
    if not abs(found - wanted) <= judged.rounding.acceleration:
        message = f"start acceleration: {found:.6g} m/s^2, the robot has {wanted:.6g} m/s^2"
        yield Violation("start_state", message, 0.0, abs(found - wanted))
    if begins > 2.0 * judged.slack:
        yield Violation("coverage", f"begins: at s = {begins:.6g} m, the path at 0 m", begins, begins)


def ends_at_rest(judged: SamplesOnPath, problem: DockingProblem) -> Iterator[Violation]:  # noqa: ARG001 - one shape for all rules
    """The motion ends at rest at the end of the path."""
    motion, path, rounding, ends = judged.motion, judged.path, judged.rounding, float(judged.s[-1])
    if ends < path.length - 2.0 * judged.slack:
        message = f"travelled: {ends:.4f} m, the path is {path.length:.4f} m long"
        yield Violation("coverage", message, ends, path.length - ends)
    for name, value, allowed, unit in (
        ("speed", motion.speed[-1], rounding.speed, "m/s"),
        ("acceleration", motion.acceleration[-1], rounding.acceleration, "m/s^2"),
    ):
        if not abs(value) <= allowed:
            message = f"end: {name} {value:.6g} {unit} at t = {motion.t[-1]:.3f} s, must rest"
            yield Violation("rest", message, ends, abs(float(value)))


def rests(judged: SamplesOnPath, problem: DockingProblem) -> Iterator[Violation]:
    """The motion rests at every cusp."""
    for cusp in judged.path.cusps:
        yield from _no_rest(judged, problem.robot.limits, cusp)
    if np.isfinite(problem.robot.limits.max_steering_rate):
        yield from _unsteered(judged, problem)


def _no_rest(judged: SamplesOnPath, limits: MotionLimits, cusp: float) -> Iterator[Violation]:
    """Whether the samples around a cusp are too close together in time for a rest between any two of them."""
    motion, rounding, slack = judged.motion, judged.rounding, 2.0 * judged.slack
    steps = np.flatnonzero((judged.s[:-1] <= cusp + slack) & (judged.s[1:] >= cusp - slack))
    if steps.size == 0:
        return
    needed = np.zeros(steps.size)
    for rows, steepest in ((steps, limits.max_deceleration), (steps + 1, limits.max_acceleration)):
        v = np.maximum(judged.v[rows] - rounding.speed, 0.0)
        a = np.maximum(np.abs(judged.a[rows]) - rounding.acceleration, 0.0)
        way = np.maximum(np.abs(judged.s[rows] - cusp) - slack, 0.0)
        by_jerk = (np.sqrt(2.0 * v / limits.max_jerk), a / limits.max_jerk, np.cbrt(6.0 * way / limits.max_jerk))
        needed += np.max((*by_jerk, v / steepest, np.sqrt(2.0 * way / steepest)), axis=0)
    given = motion.t[steps + 1] - motion.t[steps]
    missing = needed - given * (1.0 + TOLERANCE) - 2.0 * rounding.time - ARITHMETIC
    k = int(np.argmin(missing))
    if missing[k] > 0.0:
        i = int(steps[k])
        i = i if judged.v[i] > judged.v[i + 1] else i + 1
        message = (
            f"cusp at s = {cusp:.3f} m: {abs(motion.speed[i]):.6g} m/s at t = {motion.t[i]:.3f} s, must rest: "
            f"that takes {needed[k]:.3g} s, the samples are {given[k]:.3g} s apart"
        )
        yield Violation("rest", message, cusp, float(missing[k]))


def _unsteered(judged: SamplesOnPath, problem: DockingProblem) -> Iterator[Violation]:
    """Whether the samples at the start, or before and behind a cusp, are too close together for the wheels to turn.

    The ends of a polyline have the curvature of a difference quotient, so only clothoids are asked.
    """
    path, motion, slack, limits = judged.path, judged.motion, 2.0 * judged.slack, problem.robot.limits
    needed = limits.steering_times(joint_curvatures(path))
    exact = [isinstance(segment, ClothoidSegment) for segment in path.segments]
    under_way = np.flatnonzero(judged.s > slack)
    if exact[0] and under_way.size:
        wait, t = problem.start_wait(path), motion.t[under_way[0]]
        missing = float(wait * (1.0 - _STEERED) - (t - motion.t[0]) - 2.0 * judged.rounding.time - ARITHMETIC)
        if missing > 0.0:
            message = f"start: the wheels turn for {wait:.4g} s, the robot is under way at t = {t:.3f} s"
            yield Violation("rest", message, 0.0, missing)
    for i in (i for i in range(needed.size) if exact[i] and exact[i + 1]):
        before = np.flatnonzero(judged.s < path.cusps[i] - slack)
        behind = np.flatnonzero(judged.s > path.cusps[i] + slack)
        if before.size and behind.size:
            t0, t1 = motion.t[before[-1]], motion.t[behind[0]]
            missing = float(needed[i] * (1.0 - _STEERED) - (t1 - t0) - 2.0 * judged.rounding.time - ARITHMETIC)
            if missing > 0.0:
                message = (
                    f"cusp at s = {path.cusps[i]:.3f} m: the wheels turn for {needed[i]:.4g} s, the robot is before "
                    f"it at t = {t0:.3f} s and behind it at t = {t1:.3f} s"
                )
                yield Violation("rest", message, path.cusps[i], missing)
