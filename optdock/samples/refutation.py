"""Timed motions that are given by samples only: what the samples refute, and what they leave unproven.

Samples prove nothing about the instants between them, `certify_trajectory` needs the time law for that. But every
motion within the limits keeps inequalities that hold between *any* two instants; samples that break one refute the
motion, and no honest file breaks any, however far apart its samples are. Along the travel, with speed v, acceleration
a = v', jerk |a'| <= J, -D <= a <= A, and samples h apart:

    speeds               -D h <= v1 - v0 <= A h
    accelerations        |a1 - a0| <= J h
    speed, acceleration  |v1 - v0 - h (a0 + a1) / 2| <= J h^2 / 4               (trapezoid of a function of slope J)
    speed, jerk          |(v2 - v1) / h1 - (v1 - v0) / h0| <= J (h0 + h1) / 2   (means of a over neighbours)
    place, speed         |s1 - s0 - h (v0 + v1) / 2 + h^2 (a1 - a0) / 12| <= J h^3 sqrt(3) / 54, see `step_lengths`
    yaw rates            |w1 - w0| <= limit * h,  and |v1 w1 - v0 w0| <= limit * h of the lateral jerk

They are asked of neighbours and of samples 2, 4, 8, ... apart, where the rounding of the numbers weighs less. At one
instant the path, whose curvature k and its rate r are known, ties the columns: w = v k, w' = a k + v^2 r. And a robot
that rests at a cusp between two samples, at time c, has v0 <= J (c - t0)^2 / 2, a0 <= J (c - t0), and lies at most
J (c - t0)^3 / 6 before the cusp. Between a sample before a cusp and one behind it steered wheels have the time to turn.

Where the path turns in place the samples are cut into those that drive and those that turn, and each stretch is judged
by itself: a turn by its yaw, yaw rate w and yaw acceleration, for which the inequalities above hold as well, at a place
that stays. What happens between the last sample of one stretch and the first of the next is left open.

What is left open: if the jerk keeps its limit between the samples too, speed leaves the chord between two of them by
at most J h^2 / 8 (and A D h / (A + D)), acceleration by J h / 2, place by J h^3 / 12. If it does not, nothing is known
there. So a motion is refuted here, or not refuted, never certified.

Numbers of a column that all have three to five decimals stand for whatever rounds to them; the others are taken to
1e-6. That too is left open.

Numbers may differ from what they stand for by their rounding, so what is compared with a limit is the smallest value
that the numbers allow.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.geometry.pose import normalize_angle, wrap_angles
from optdock.model.limits import LIMITS
from optdock.model.path import ClothoidSegment, PolylineSegment, TurnSegment
from optdock.samples.sampled_motion import (
    EXACT,
    REACH,
    Places,
    Rounding,
    SampledMotion,
    Stretch,
    half_unit,
    places_of,
    step_lengths,
    stretches_of,
)
from optdock.verification.certificate import TOLERANCE, Violation
from optdock.verification.conservative_advancement import prove_clearance
from optdock.verification.proximity import end_clearances
from optdock.verification.trajectory_rules import STEP_RTOL

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from optdock.geometry.arrays import BoolArray, FloatArray, IntArray
    from optdock.model.limits import MotionLimits
    from optdock.model.path import Path
    from optdock.model.problem import DockingProblem
    from optdock.model.trajectory import Trajectory

__all__ = ["SampledMotionVerdict", "are_rounded_phases", "check_sampled_motion", "check_samples_of"]

ON_PATH = math.sqrt(2.0) * EXACT  # [m], [rad]: x and y each to that
_STEEPEST = 10.0  # [1/m]: no more of a curvature counts for that
# [m], [rad]: how far poses may be off the path, where the clearance covers it. Three decimals move a pose by 0.7 mm;
# along a curve of 2 1/m that is 1.4e-3 rad.
OFF_PATH = 2e-3
_DECIMALS = 6  # that a file's rounded phases keep
_ROUNDED = 1e-5  # [s], [m/s^3], ...: of every number of such phases; ten units, as programs round what was rounded
_STEERED = 1e-4  # of a steering time: six decimals of a curvature, and the tolerance of the proof
_ARITHMETIC = 1e-9  # rounding of what is computed here from numbers around 1
_UNEXPLAINED = 0.5  # of the time in which a rate matters
_MATTERS = 0.05  # of its limit
_FEWEST = 4  # steps


@dataclass(frozen=True)
class SampledMotionVerdict:
    """What the samples of a motion say; it counts as true where they do not refute it, which is no proof of it.

    Args:
        violations: Every broken rule; empty when the samples do not refute the motion.
        samples: How many there are.
        step: Longest time between two of them [s].
        offset: How far the poses are off the path at most: distance [m], turn [rad].
        unproven: By how much speed [m/s], acceleration [m/s^2], place [m], yaw rate [rad/s] may differ between samples
            from what they say, if the jerk keeps its limit there; what nothing limits is left out.
    """

    violations: tuple[Violation, ...]
    samples: int
    step: float
    offset: tuple[float, float] = (0.0, 0.0)
    unproven: Mapping[str, float] = field(default_factory=dict)

    @property
    def off_path(self) -> bool:
        """Whether poses lie beside the path, so that it takes its clearance to cover them."""
        return max(self.offset) > ON_PATH

    def __bool__(self) -> bool:
        return not self.refuted

    @property
    def refuted(self) -> bool:
        """Whether no motion within the limits has these samples."""
        return bool(self.violations)


def check_sampled_motion(motion: SampledMotion, path: Path, problem: DockingProblem) -> SampledMotionVerdict:
    """Look for whatever refutes a motion that is known by its samples only.

    Every column is compared with every other, with the path and with the limits. Poses may be off the path by up to
    2e-3 m and rad where the path keeps the required clearance with that much to spare; else they must lie on it to
    1e-6.

    Args:
        motion: The samples.
        path: The path they claim to follow; see `certify_path` for its own verdict.
        problem: What must hold.

    Returns:
        The verdict; nothing is ever proven by samples alone.
    """
    step, rounding = float(np.max(np.diff(motion.t))), Rounding.of(motion)
    with np.errstate(over="ignore", invalid="ignore"):
        found = _too_coarse(motion, problem.robot.limits) or _turn_in_place(path)
        if found is not None:
            return SampledMotionVerdict((found,), motion.t.size, step)
        if not path.turns:
            return _checked_drive(motion, path, problem, rounding, (_begin, _end))
        stretches = stretches_of(motion, path, problem.robot.limits, rounding)
        if isinstance(stretches, Violation):
            return SampledMotionVerdict((stretches,), motion.t.size, step)
        verdicts = list(_checked_stretches(motion, path, stretches, problem, rounding))
    violations = tuple(violation for verdict in verdicts for violation in verdict.violations)
    offsets = zip(*(verdict.offset for verdict in verdicts), strict=True)
    unproven = max((verdict.unproven for verdict in verdicts), key=len, default={})
    apart, turned = (max(values) for values in offsets)
    return SampledMotionVerdict(violations, motion.t.size, step, (apart, turned), unproven)


def _checked_stretches(
    motion: SampledMotion, path: Path, stretches: Sequence[Stretch], problem: DockingProblem, rounding: Rounding
) -> Iterator[SampledMotionVerdict]:
    """The verdict on every stretch of a motion that turns in place, and on its ends."""
    yield SampledMotionVerdict(tuple(_ends_of_turns(motion, path, rounding)), motion.t.size, 0.0)
    dock, slow = problem.dock, path.before_end(problem.dock.approach.distance)
    for part, begin, (first, last) in stretches:
        rows = SampledMotion(*(column[first:last] for column in motion))
        if isinstance(part, TurnSegment):
            yield _checked_turn(rows, part, begin, path, problem, rounding)
        elif rows.t.size > 1:
            zone = min(part.length, max(0.0, begin + part.length - slow))
            here = replace(problem, dock=replace(dock, approach_distance=zone))
            ends = (*((_begin,) if first == 0 else ()), *((_end,) if last == motion.t.size else ()))
            yield _checked_drive(rows, part, here, rounding, ends)


def _checked_drive(
    motion: SampledMotion,
    path: Path,
    problem: DockingProblem,
    rounding: Rounding,
    ends: tuple[Callable[[_Judged, DockingProblem], Iterator[Violation]], ...],
) -> SampledMotionVerdict:
    """The verdict on samples of a path that turns nowhere in place; `ends`: what must hold at which of its ends."""
    step, limits = float(np.max(np.diff(motion.t))), problem.robot.limits
    places = places_of(motion, path, limits, (rounding.speed, rounding.acceleration))
    if isinstance(places, Violation):
        return SampledMotionVerdict((places,), motion.t.size, step)
    judged = _judged(motion, path, problem, places, rounding)
    offset, off = _off_path(judged, problem)
    violations = tuple(off)
    if max(offset) <= OFF_PATH:
        violations += tuple(_at_samples(judged, problem))
        sure = judged if places.sure.all() else judged.rows(places.sure, limits)
        violations += () if sure is judged else tuple(_through_rests(judged, problem))
        rules = (_by_curvature, _between_samples, _at_knots, *ends, _rests, _explained_rates)
        violations += tuple(violation for rule in rules for violation in rule(sure, problem))
    return SampledMotionVerdict(violations, motion.t.size, step, offset, _unproven(judged, limits))


def _ends_of_turns(motion: SampledMotion, path: Path, rounding: Rounding) -> Iterator[Violation]:
    """The first sample is at the start of the path, the last at rest at its end, also where it turns there."""
    for name, i, pose, s in (("begin", 0, path.start, 0.0), ("end", -1, path.end, path.length)):
        away = math.hypot(motion.x[i] - pose.x, motion.y[i] - pose.y)
        turned = abs(normalize_angle(float(motion.yaw[i]) - pose.yaw))
        if not max(away, turned) <= OFF_PATH:
            message = f"the samples {name} {away:.3g} m and {turned:.3g} rad from where the path does"
            yield Violation("coverage", message, s, max(away, turned))
    for name, value, allowed, unit in (
        ("yaw rate", motion.yaw_rate[-1], rounding.yaw_rate, "rad/s"),
        ("yaw acceleration", motion.yaw_acceleration[-1], rounding.yaw_acceleration, "rad/s^2"),
    ):
        if not abs(value) <= allowed + _ARITHMETIC:
            message = f"end: {name} {value:.6g} {unit} at t = {motion.t[-1]:.3f} s, must rest"
            yield Violation("rest", message, path.length, abs(float(value)))


class _Turning(NamedTuple):
    """The samples of a turn in place along it, Shape (n,) each.

    `turned`: how far it has turned [rad]; `rate`, `acceleration`: of that; `begin`: where the turn is on the path [m].
    """

    motion: SampledMotion
    turned: FloatArray
    rate: FloatArray
    acceleration: FloatArray
    begin: float
    rounding: Rounding

    def worst(
        self, kind: str, values: FloatArray, limit: FloatArray | float, rough: FloatArray | float = 0.0, lag: int = 0
    ) -> Iterator[Violation]:
        """As `_worst`; the values are of samples `lag` apart."""
        t = self.motion.t[lag:]
        at = np.column_stack((t, np.full(t.size, self.begin)))
        return _worst_at(at, kind, values, limit, rough)


def _checked_turn(
    motion: SampledMotion, turn: TurnSegment, begin: float, path: Path, problem: DockingProblem, rounding: Rounding
) -> SampledMotionVerdict:
    """The verdict on the samples of one turn in place, which begins at `begin` [m] on the path."""
    half, sign, whole = 0.5 * abs(turn.turn), math.copysign(1.0, turn.turn), 2.0 * np.pi
    off = np.unwrap(wrap_angles(motion.yaw - turn.pose.yaw))
    turned = sign * off
    turned += whole * np.rint((half - 0.5 * (turned[0] + turned[-1])) / whole)
    apart = float(np.max(np.hypot(motion.x - turn.pose.x, motion.y - turn.pose.y)))
    beyond = float(np.max(np.abs(turned - half))) - half
    offset = (apart, max(beyond, 0.0))
    turning = _Turning(motion, turned, sign * motion.yaw_rate, sign * motion.yaw_acceleration, begin, rounding)
    found = [*_turning_at_samples(turning, problem), *_turning_between_samples(turning, problem)]
    if not max(offset) <= OFF_PATH or (max(offset) > ON_PATH and not _covers(path, problem, offset)):
        message = f"samples of the turn at s = {begin:.3f} m are up to {apart:.4g} m and {beyond:.4g} rad off it"
        found.append(Violation("off_path", message, begin, max(offset)))
    return SampledMotionVerdict(tuple(found), motion.t.size, float(np.max(np.diff(motion.t), initial=0.0)), offset)


def _turning_at_samples(turning: _Turning, problem: DockingProblem) -> Iterator[Violation]:
    """Every column within its limit; those of driving are none."""
    motion, rounding, most = turning.motion, turning.rounding, problem.robot.limits.turning
    yield from turning.worst("speed in a turn [m/s]", np.abs(motion.speed), 0.0, rounding.speed)
    turns = turning.rate > rounding.yaw_rate  # a sample at rest may have what comes next
    found, rough = np.where(turns, np.abs(motion.acceleration), 0.0), rounding.acceleration
    yield from turning.worst("acceleration in a turn [m/s^2]", found, 0.0, rough)
    yield from turning.worst("jerk in a turn [m/s^3]", np.where(turns, np.abs(motion.jerk), 0.0), 0.0, rounding.jerk)
    yield from turning.worst("yaw rate against the turn [rad/s]", -turning.rate, 0.0, rounding.yaw_rate)
    yield from turning.worst("yaw rate [rad/s]", turning.rate, most.rate, rounding.yaw_rate)
    gain = np.abs(turning.acceleration)
    yield from turning.worst("yaw acceleration [rad/s^2]", gain, most.acceleration, rounding.yaw_acceleration)


def _turning_between_samples(turning: _Turning, problem: DockingProblem) -> Iterator[Violation]:
    """As `_between_samples`, of a turn."""
    t, rounding, most = turning.motion.t, turning.rounding, problem.robot.limits.turning
    lag = 1
    while lag < t.size:
        columns = (t, turning.turned, turning.rate, turning.acceleration)
        h, yaw, w, a = (column[lag:] - column[:-lag] for column in columns)
        mean, steady = (0.5 * (column[lag:] + column[:-lag]) for column in columns[2:])
        rough = 2.0 * rounding.yaw_rate + 2.0 * rounding.time * most.acceleration
        yield from turning.worst("mean yaw acceleration [rad/s^2]", np.abs(w), most.acceleration * h, rough, lag)
        gain = 2.0 * rounding.yaw_acceleration + 2.0 * rounding.time * most.jerk
        yield from turning.worst("mean yaw jerk [rad/s^3]", np.abs(a), most.jerk * h, gain, lag)
        by_jerk = 0.25 * most.jerk * h**2
        off = np.abs(w - h * steady)
        allowed = rough + rounding.yaw_acceleration * h
        yield from turning.worst("yaw rate off its accelerations [rad/s]", off, by_jerk, allowed, lag)
        bound = np.minimum(h**3 * most.jerk / 12.0, 0.25 * h**2 * most.acceleration)
        allowed = 2.0 * rounding.yaw + rounding.yaw_rate * h + 2.0 * rounding.time * most.rate
        yield from turning.worst("yaw off its rates [rad]", np.abs(yaw - h * mean), bound, allowed, lag)
        lag *= 2


def _too_coarse(motion: SampledMotion, limits: MotionLimits) -> Violation | None:
    """Samples between which the robot may be anywhere within centimetres."""
    dt = float(np.max(np.diff(motion.t)))
    open_ = float(np.max(step_lengths(motion.t, np.abs(motion.speed), 0.0 * motion.t, limits).error))
    if open_ <= REACH:
        return None
    message = f"samples up to {dt:.3g} s apart leave the motion between them open by {open_:.3g} m; sample it finer"
    return Violation("too_coarse", message, 0.0, open_)


def _turn_in_place(path: Path) -> Violation | None:
    """As for a time law, distance is what places a motion on its path."""
    for segment, start in zip(path.segments, path.segment_starts[:-1], strict=True):
        still = np.flatnonzero(np.diff(segment.knots) <= 0.0)
        if still.size:
            s = float(start + segment.knots[still[0]])
            message = f"the path turns in place at s = {s:.3f} m, where samples of a motion along it cannot be judged"
            return Violation("coverage", message, s, 1.0)
    return None


def _judged(motion: SampledMotion, path: Path, problem: DockingProblem, places: Places, rounding: Rounding) -> _Judged:
    poses = places.poses
    apart = np.hypot(motion.x - poses[:, 0], motion.y - poses[:, 1])
    turned = np.abs(wrap_angles(motion.yaw - poses[:, 2]))
    # A pose that is on the path but `ON_PATH` further along it has turned by that much.
    turned = np.maximum(turned - ON_PATH * np.minimum(np.abs(path.curvature_at(places.s)), _STEEPEST), 0.0)
    v, a, j = (places.gear * column for column in (motion.speed, motion.acceleration, motion.jerk))
    sums = _Sums.of(motion, v, a, problem.robot.limits)
    return _Judged(motion, path, places.s, v, a, j, apart, turned, sums, rounding, math.sqrt(2.0) * rounding.place)


def _off_path(judged: _Judged, problem: DockingProblem) -> tuple[tuple[float, float], list[Violation]]:
    """The largest distance and turn off the path, and what is wrong with them."""
    motion, apart, turned = judged.motion, judged.apart, judged.turned
    i = int(np.argmax(np.maximum(apart, turned)))
    offset = (float(np.max(apart)), float(np.max(turned)))
    place = f"pose at t = {motion.t[i]:.3f} s is {apart[i]:.4g} m and {turned[i]:.4g} rad off the path"
    if not max(offset) <= OFF_PATH:
        in_degrees = np.remainder(np.radians(motion.yaw) - judged.path.poses_at(judged.s)[:, 2] + np.pi, 2.0 * np.pi)
        hint = "; is yaw in degrees?" if turned[i] > 0.1 and np.max(np.abs(in_degrees - np.pi)) < 0.1 else ""
        return offset, [Violation("off_path", place + hint, float(judged.s[i]), max(offset))]
    if max(offset) <= ON_PATH or _covers(judged.path, problem, offset):
        return offset, []
    message = f"{place}, and the clearance does not cover it"
    return offset, [Violation("off_path", message, float(judged.s[i]), max(offset))]


def _covers(path: Path, problem: DockingProblem, offset: tuple[float, float]) -> bool:
    """Whether footprints that far off the path keep what is required beside it.

    A pose off by e and turned by w moves no point of the footprint by more than e + R w, R the circumscribed radius.
    So it is enough that the path keeps that much more than required, everywhere. The start may be closer than required
    and has nothing to spare then.
    """
    more, at_start = offset[0] + problem.robot.footprint.circumscribed_radius * offset[1], end_clearances(problem).start
    raised = replace(problem, clearance=problem.clearance.raised(more))
    return prove_clearance(path, raised).holds and at_start >= raised.path_clearance.required


def _unproven(judged: _Judged, limits: MotionLimits) -> dict[str, float]:
    """See the module; the rounding of the numbers is added."""
    h, rounding = float(np.max(np.diff(judged.motion.t))), judged.rounding
    speed = min(limits.max_jerk * h**2 / 8.0, h / (1.0 / limits.max_acceleration + 1.0 / limits.max_deceleration))
    bounds = {
        "speed": speed + rounding.speed,
        "acceleration": limits.max_jerk * h / 2.0 + rounding.acceleration,
        "place": min(limits.max_jerk * h**3 / 12.0, speed * h) + judged.slack,
    }
    if np.isfinite(limits.max_yaw_rate) and all(isinstance(one, ClothoidSegment) for one in judged.path.segments):
        steepest = max(float(np.max(np.abs(one.curvature_at(one.knots)))) for one in judged.path.segments)
        bounds["yaw rate"] = steepest * bounds["speed"] + rounding.yaw_rate
    return bounds


class _Sums(NamedTuple):
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
    def of(cls, motion: SampledMotion, v: FloatArray, a: FloatArray, limits: MotionLimits) -> _Sums:
        """The sums along the travel, speeds `v` and accelerations `a` being positive there."""
        h = np.diff(motion.t)
        steps = step_lengths(motion.t, v, a, limits)
        turn = wrap_angles(np.diff(motion.yaw))
        error = np.minimum(0.25 * limits.max_jerk * h**2, (limits.max_acceleration + limits.max_deceleration) * h)
        columns = (steps.length, steps.error, 0.5 * h * (a[:-1] + a[1:]), error, turn, np.abs(turn))
        return cls(*(np.concatenate(([0.0], np.cumsum(column))) for column in columns))


class _Judged(NamedTuple):
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
    sums: _Sums
    rounding: Rounding
    slack: float

    def rows(self, keep: BoolArray, limits: MotionLimits) -> _Judged:
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
            sums=_Sums.of(motion, v, a, limits),
        )


class _Bends(NamedTuple):
    """Curvature [1/m] and its rate [1/m^2] just before, at and just after the samples, Shape (3, n) each."""

    curvature: FloatArray
    rate: FloatArray


def _worst(
    judged: _Judged,
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
    yield from _worst_at(at, kind, values, limit, rough)


def _limited(
    judged: _Judged,
    limits: MotionLimits,
    values: Mapping[str, FloatArray],
    said: str = "{}",
    rough: FloatArray | float = 0.0,
    at: FloatArray | None = None,
) -> Iterator[Violation]:
    """As `_worst`, of values of limited quantities.

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
            yield from _worst(judged, f"{said.format(quantity)} [{unit}", value, most, rough, at)


def _worst_at(
    at: FloatArray, kind: str, values: FloatArray, limit: FloatArray | float, rough: FloatArray | float
) -> Iterator[Violation]:
    """As `_worst`."""
    if values.size == 0:
        return
    limits = np.broadcast_to(np.asarray(limit, dtype=np.float64), values.shape)
    beyond = values - rough - limits * (1.0 + TOLERANCE) - _ARITHMETIC
    beyond = np.where(np.isnan(beyond), np.inf, beyond)
    i = int(np.argmax(beyond))
    if beyond[i] > 0.0:
        t, s = at[i]
        message = f"{kind}: {values[i]:.6g} at t = {t:.3f} s, limit {limits[i]:.6g}"
        yield Violation(kind.partition(" [")[0].replace(" ", "_"), message, float(s), float(beyond[i]))


def _bends(judged: _Judged) -> _Bends:
    near = judged.slack + _ARITHMETIC
    places = [np.clip(judged.s + shift, 0.0, judged.path.length) for shift in (-near, 0.0, near)]
    return _Bends(
        np.array([np.clip(judged.path.curvature_at(s), -1e9, 1e9) for s in places]),
        np.array([judged.path.curvature_rate_at(s) for s in places]),
    )


def _at_samples(judged: _Judged, problem: DockingProblem) -> Iterator[Violation]:
    """Every column along the travel within its limit."""
    limits, zone, rounding = problem.robot.limits, problem.dock.approach, judged.rounding
    v = np.maximum(judged.v, 0.0)
    fastest = np.where(judged.motion.speed >= 0.0, limits.max_speed, limits.max_reverse_speed)
    yield from _worst(judged, "speed [m/s]", v, fastest, rounding.speed)
    slow = judged.s > judged.path.length - zone.distance + judged.slack + _ARITHMETIC
    yield from _worst(judged, "approach speed [m/s]", np.where(slow, v, 0.0), zone.speed, rounding.speed)
    gains = {"max_acceleration": judged.a, "max_deceleration": -judged.a}
    yield from _limited(judged, limits, gains, rough=rounding.acceleration)
    yield from _limited(judged, limits, {"max_jerk": np.abs(judged.j)}, rough=rounding.jerk)


def _by_curvature(judged: _Judged, problem: DockingProblem) -> Iterator[Violation]:
    """Every column that depends on the curvature within its limit, and as the path has it at its place."""
    bends = _bends(judged)
    yield from _curved(judged, problem.robot.limits, bends, np.maximum(judged.v - judged.rounding.speed, 0.0))
    yield from _ties(judged, bends)


def _curved(judged: _Judged, limits: MotionLimits, bends: _Bends, v: FloatArray) -> Iterator[Violation]:
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


def _turning_rates(judged: _Judged, bends: _Bends, order: int = 1) -> tuple[FloatArray, FloatArray]:
    """The smallest and the largest n a k + v^2 r that path and numbers allow, k and r to 1e-6. Shape (n,) each.

    Of order n = 1 that is the yaw acceleration; of order 2, times v, the lateral jerk.
    """
    k, r, v, a, rounding = bends.curvature, bends.rate, judged.v, order * judged.a, judged.rounding
    rough = order * rounding.acceleration * np.abs(k) + (2.0 * np.abs(v) + rounding.speed) * rounding.speed * np.abs(r)
    rough = rough + judged.slack * np.abs(a * r) + EXACT * (np.abs(a) + v**2)
    value = a * k + v**2 * r
    return (value - rough).min(axis=0), (value + rough).max(axis=0)


def _ties(judged: _Judged, bends: _Bends) -> Iterator[Violation]:
    """Yaw rate is speed times curvature, yaw acceleration its rate of change."""
    motion, rounding = judged.motion, judged.rounding
    low, high = _curvature_range(judged, bends)
    noise = _noise(judged) + EXACT
    low, high = low - noise, high + noise
    ends = np.array([v * k for v in (judged.v - rounding.speed, judged.v + rounding.speed) for k in (low, high)])
    off = np.maximum(ends.min(axis=0) - motion.yaw_rate, motion.yaw_rate - ends.max(axis=0)) - rounding.yaw_rate
    yield from _worst(judged, "yaw rate off speed times curvature [rad/s]", off, 0.0)
    least, most = _turning_rates(judged, bends)
    off = np.maximum(least - motion.yaw_acceleration, motion.yaw_acceleration - most) - rounding.yaw_acceleration
    off = np.where(_on_clothoids(judged), off, 0.0)
    yield from _worst(judged, "yaw acceleration off the path's [rad/s^2]", off, 0.0)


def _owners(judged: _Judged) -> IntArray:
    found = np.searchsorted(judged.path.segment_starts, judged.s, side="right") - 1
    owners: IntArray = np.clip(found, 0, len(judged.path.segments) - 1)
    return owners


def _on_clothoids(judged: _Judged) -> BoolArray:
    exact = np.array([isinstance(segment, ClothoidSegment) for segment in judged.path.segments])
    on: BoolArray = exact[_owners(judged)]
    return on


def _noise(judged: _Judged) -> FloatArray:
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


def _step_of(judged: _Judged, segment: PolylineSegment, rows: IntArray, i: int) -> IntArray:
    """The step of segment number `i` on which each of these samples lies."""
    local = judged.s[rows] - judged.path.segment_starts[i]
    found: IntArray = np.clip(np.searchsorted(segment.knots, local, side="right") - 1, 0, segment.knots.size - 2)
    return found


def _curvature_range(judged: _Judged, bends: _Bends) -> tuple[FloatArray, FloatArray]:
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


def _between_samples(judged: _Judged, problem: DockingProblem) -> Iterator[Violation]:
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


def _means(judged: _Judged, limits: MotionLimits, rows: IntArray, lag: int) -> Iterator[Violation]:
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
    yield from _worst(judged, "speed off its accelerations [m/s]", off, allowed, at=at)
    off = np.abs(change(judged.s) - change(sums.place))
    fastest = max(limits.max_speed, limits.max_reverse_speed)
    allowed = change(sums.place_error) + 2.0 * judged.slack + rounding.speed * t + early * fastest
    # Beside a curve the way is longer or shorter than on it.
    allowed = allowed + float(np.max(judged.apart)) * change(sums.turn)
    yield from _worst(judged, "distance off its speeds [m]", off, allowed, at=at)


def _through_rests(judged: _Judged, problem: DockingProblem) -> Iterator[Violation]:
    """Speeds and accelerations with their signs, which lead through the rest at a cusp without a jump.

    So this holds as well for samples of which nobody knows on which side of the cusp they are.
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
        found = list(_worst(judged, "speed off its accelerations [m/s]", np.abs(change - by_sums), allowed, at=at))
        if found:
            yield from found
            return
        lag *= 2


def _at_knots(judged: _Judged, problem: DockingProblem) -> Iterator[Violation]:
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


def _begin(judged: _Judged, problem: DockingProblem) -> Iterator[Violation]:
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


def _end(judged: _Judged, problem: DockingProblem) -> Iterator[Violation]:  # noqa: ARG001 - one shape for all rules
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


def _rests(judged: _Judged, problem: DockingProblem) -> Iterator[Violation]:
    """The motion rests at every cusp."""
    for cusp in judged.path.cusps:
        yield from _no_rest(judged, problem.robot.limits, cusp)
    if np.isfinite(problem.robot.limits.max_steering_rate):
        yield from _unsteered(judged, problem)


def _no_rest(judged: _Judged, limits: MotionLimits, cusp: float) -> Iterator[Violation]:
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
    missing = needed - given * (1.0 + TOLERANCE) - 2.0 * rounding.time - _ARITHMETIC
    k = int(np.argmin(missing))
    if missing[k] > 0.0:
        i = int(steps[k])
        i = i if judged.v[i] > judged.v[i + 1] else i + 1
        message = (
            f"cusp at s = {cusp:.3f} m: {abs(motion.speed[i]):.6g} m/s at t = {motion.t[i]:.3f} s, must rest: "
            f"that takes {needed[k]:.3g} s, the samples are {given[k]:.3g} s apart"
        )
        yield Violation("rest", message, cusp, float(missing[k]))


def _unsteered(judged: _Judged, problem: DockingProblem) -> Iterator[Violation]:
    """Whether the samples at the start, or before and behind a cusp, are too close together for the wheels to turn.

    The ends of a polyline have the curvature of a difference quotient, so only clothoids are asked.
    """
    path, motion, slack, limits = judged.path, judged.motion, 2.0 * judged.slack, problem.robot.limits
    needed = limits.steering_times(path.joint_curvatures)
    exact = [isinstance(segment, ClothoidSegment) for segment in path.segments]
    under_way = np.flatnonzero(judged.s > slack)
    if exact[0] and under_way.size:
        wait, t = problem.start_wait(path), motion.t[under_way[0]]
        missing = float(wait * (1.0 - _STEERED) - (t - motion.t[0]) - 2.0 * judged.rounding.time - _ARITHMETIC)
        if missing > 0.0:
            message = f"start: the wheels turn for {wait:.4g} s, the robot is under way at t = {t:.3f} s"
            yield Violation("rest", message, 0.0, missing)
    for i in (i for i in range(needed.size) if exact[i] and exact[i + 1]):
        before = np.flatnonzero(judged.s < path.cusps[i] - slack)
        behind = np.flatnonzero(judged.s > path.cusps[i] + slack)
        if before.size and behind.size:
            t0, t1 = motion.t[before[-1]], motion.t[behind[0]]
            missing = float(needed[i] * (1.0 - _STEERED) - (t1 - t0) - 2.0 * judged.rounding.time - _ARITHMETIC)
            if missing > 0.0:
                message = (
                    f"cusp at s = {path.cusps[i]:.3f} m: the wheels turn for {needed[i]:.4g} s, the robot is before "
                    f"it at t = {t0:.3f} s and behind it at t = {t1:.3f} s"
                )
                yield Violation("rest", message, path.cusps[i], missing)


def _explained_rates(judged: _Judged, problem: DockingProblem) -> Iterator[Violation]:
    """Jerk leads to the accelerations, and beside polylines yaw acceleration to the yaw rates.

    Both may jump between samples, so no step refutes them. But the mean rate of a step lies between the rates at its
    ends unless it jumped twice within the step. A column is refuted where that would have been so for most of the time
    in which it matters.
    """
    limits, rounding, motion = problem.robot.limits, judged.rounding, judged.motion
    rough = (rounding.acceleration, rounding.jerk)
    yield from _unexplained(judged, "jerk", judged.a, judged.j, limits.max_jerk, rough)
    if not _on_clothoids(judged).all():
        fastest = float(np.max(np.abs(np.diff(motion.yaw_rate) / np.diff(motion.t))))
        bound = min(limits.max_yaw_acceleration, fastest)
        rough = (rounding.yaw_rate, rounding.yaw_acceleration)
        yield from _unexplained(judged, "yaw acceleration", motion.yaw_rate, motion.yaw_acceleration, bound, rough)


def _unexplained(
    judged: _Judged, name: str, values: FloatArray, rates: FloatArray, bound: float, rounding: tuple[float, float]
) -> Iterator[Violation]:
    """Whether `rates` are mostly not the rates of `values`."""
    h = np.diff(judged.motion.t)
    mean = np.diff(values) / h
    rough = 2.0 * rounding[0] / h + rounding[1] + TOLERANCE * bound + _ARITHMETIC
    low, high = np.minimum(rates[:-1], rates[1:]), np.maximum(rates[:-1], rates[1:])
    outside = (mean < low - rough) | (mean > high + rough)
    matters = np.maximum(np.abs(mean), np.maximum(np.abs(low), np.abs(high))) > _MATTERS * bound + rough
    share = float(np.sum(h[outside & matters])) / max(float(np.sum(h[matters])), 1e-300)
    if np.count_nonzero(outside & matters) >= _FEWEST and share > _UNEXPLAINED:
        i = int(np.argmax(outside & matters))
        message = (
            f"{name}: the column does not lead to what it is the rate of in {100.0 * share:.0f} % of the time, "
            f"first at t = {judged.motion.t[i]:.3f} s"
        )
        yield Violation(name.replace(" ", "_"), message, float(judged.s[i]), share)


def are_rounded_phases(trajectory: Trajectory, motion: SampledMotion) -> bool:
    """Whether phases that miss their samples or a limit may do so because somebody rounded them.

    They have six decimals at most, and lead no further from the samples than numbers that are off by r = 1e-5 each can
    lead. With n phases of durations d and jerks j, the borders are off by n r, the acceleration by what its own
    numbers add up to, e = r (1 + sum |j| + sum d), and by as much as it changes while the borders are off; speed and
    distance by the integrals of that. What is further off is another motion.

    Args:
        trajectory: The path and the motion by the phases.
        motion: The samples.
    """
    law = trajectory.time_law
    if not np.array_equal(np.round(law.durations, _DECIMALS), law.durations):
        return False
    t, early = law.duration, _ROUNDED * law.durations.size
    by_phases = trajectory.sample_at(motion.t)
    steepest = float(np.max(np.abs(motion.acceleration))) + _ROUNDED
    fastest = float(np.max(np.abs(motion.speed))) + _ROUNDED
    e = _ROUNDED * (1.0 + float(np.sum(np.abs(law.jerks))) + t)
    speed = _ROUNDED + t * e + early * steepest
    place = _ROUNDED + t * speed + early * fastest + OFF_PATH
    apart = np.hypot(motion.x - by_phases.x, motion.y - by_phases.y)
    rough = Rounding.of(motion)
    return bool(
        abs(t - motion.t[-1]) <= early + rough.time
        and np.max(np.abs(motion.acceleration - by_phases.acceleration))
        <= e + early * float(np.max(np.abs(law.jerks))) + rough.acceleration
        and np.max(np.abs(motion.speed - by_phases.speed)) <= speed + rough.speed
        and np.max(apart) <= place + rough.place
    )


def check_samples_of(trajectory: Trajectory, motion: SampledMotion, problem: DockingProblem) -> SampledMotionVerdict:
    """Whether samples are those of `trajectory`, to 1e-6 or to the rounding of their columns.

    Poses that are further off than 1e-6 need the clearance to cover that. Where jerk and yaw acceleration jump, the
    values on both sides count, and whatever lies between them.

    Args:
        trajectory: The motion; see `certify_trajectory` for its own verdict.
        motion: The samples.
        problem: What must hold.
    """
    step, count, rounding = float(np.max(np.diff(motion.t))), motion.t.size, Rounding.of(motion)
    for name, found, wanted in (("begin", motion.t[0], 0.0), ("end", motion.t[-1], trajectory.duration)):
        if not abs(found - wanted) <= EXACT + rounding.time:
            message = f"the samples {name} at t = {found:.6g} s, the phases at {wanted:.6g} s"
            violation = Violation("phases", message, 0.0, abs(float(found - wanted)))
            return SampledMotionVerdict((violation,), count, step)
    near = EXACT + rounding.time
    exact, *sides = (trajectory.sample_at(motion.t + shift) for shift in (0.0, -near, near))
    violations = []
    for name in SampledMotion._fields[1:]:
        found = getattr(motion, name)
        around = np.array([getattr(samples, name) for samples in (exact, *sides)])
        if name == "yaw":
            around = found + wrap_angles(around - found)
        off = np.maximum(around.min(axis=0) - found, found - around.max(axis=0))
        allowed = rounding.place if name in ("x", "y") else getattr(rounding, name)
        off = off - 4.0 * np.spacing(np.abs(found)) - allowed
        i = int(np.argmax(off))
        if not off[i] <= 0.0:
            message = f"{name} at t = {motion.t[i]:.3f} s is {found[i]:.6g}, by the phases {around[0, i]:.6g}"
            violations.append(Violation("phases", message, float(exact.s[i]), float(off[i] + allowed)))
    apart = float(np.max(np.hypot(motion.x - exact.x, motion.y - exact.y)))
    turned = float(np.max(np.abs(wrap_angles(motion.yaw - exact.yaw))))
    offset = (apart, turned)
    if not violations and max(offset) > ON_PATH and not _covers(trajectory.path, problem, offset):
        message = (
            f"samples are up to {apart:.3g} m and {turned:.3g} rad off the path, and the clearance does not cover it"
        )
        violations.append(Violation("off_path", message, 0.0, max(offset)))
    return SampledMotionVerdict(tuple(violations), count, step, offset)
