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

The jerk may jump at any time, twice within a step as well, so no step refutes the column of jerks but by the limit and
by what it does to the accelerations; likewise the yaw accelerations beside a polyline.

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
from optdock.model.path import ClothoidSegment, TurnSegment, place_before_end
from optdock.samples.sample_rules import (
    ARITHMETIC,
    SamplesOnPath,
    Sums,
    at_knots,
    at_samples,
    begins,
    between_samples,
    by_curvature,
    ends_at_rest,
    rests,
    through_rests,
    worst_at,
)
from optdock.samples.sampled_motion import (
    EXACT,
    REACH,
    Places,
    Rounding,
    SampledMotion,
    Stretch,
    places_of,
    step_lengths,
    stretches_of,
)
from optdock.verification.certificate import Violation
from optdock.verification.conservative_advancement import prove_clearance
from optdock.verification.proximity import end_clearances

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from optdock.geometry.arrays import FloatArray
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


@dataclass(frozen=True)
class SampledMotionVerdict:
    """What the samples of a motion say; it counts as true where they do not refute it, which is not a proof of it.

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
            return _checked_drive(motion, path, problem, rounding, (begins, ends_at_rest))
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
    dock, slow = problem.dock, place_before_end(path, problem.dock.approach.distance)
    for part, begin, (first, last) in stretches:
        rows = SampledMotion(*(column[first:last] for column in motion))
        if isinstance(part, TurnSegment):
            yield _checked_turn(rows, part, begin, path, problem, rounding)
        elif rows.t.size > 1:
            zone = min(part.length, max(0.0, begin + part.length - slow))
            here = replace(problem, dock=replace(dock, approach_distance=zone))
            ends = (*((begins,) if first == 0 else ()), *((ends_at_rest,) if last == motion.t.size else ()))
            yield _checked_drive(rows, part, here, rounding, ends)


def _checked_drive(
    motion: SampledMotion,
    path: Path,
    problem: DockingProblem,
    rounding: Rounding,
    ends: tuple[Callable[[SamplesOnPath, DockingProblem], Iterator[Violation]], ...],
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
        violations += tuple(at_samples(judged, problem))
        sure = judged if places.sure.all() else judged.rows(places.sure, limits)
        violations += () if sure is judged else tuple(through_rests(judged, problem))
        rules = (by_curvature, between_samples, at_knots, *ends, rests)
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
        if not abs(value) <= allowed + ARITHMETIC:
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
        """As `worst`; the values are of samples `lag` apart."""
        t = self.motion.t[lag:]
        at = np.column_stack((t, np.full(t.size, self.begin)))
        return worst_at(at, kind, values, limit, rough)


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
    """As `between_samples`, of a turn."""
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


def _judged(
    motion: SampledMotion, path: Path, problem: DockingProblem, places: Places, rounding: Rounding
) -> SamplesOnPath:
    poses = places.poses
    apart = np.hypot(motion.x - poses[:, 0], motion.y - poses[:, 1])
    turned = np.abs(wrap_angles(motion.yaw - poses[:, 2]))
    # A pose that is on the path but `ON_PATH` further along it has turned by that much.
    turned = np.maximum(turned - ON_PATH * np.minimum(np.abs(path.curvature_at(places.s)), _STEEPEST), 0.0)
    v, a, j = (places.gear * column for column in (motion.speed, motion.acceleration, motion.jerk))
    sums = Sums.of(motion, v, a, problem.robot.limits)
    return SamplesOnPath(
        motion, path, places.s, v, a, j, apart, turned, sums, rounding, math.sqrt(2.0) * rounding.place
    )


def _off_path(judged: SamplesOnPath, problem: DockingProblem) -> tuple[tuple[float, float], list[Violation]]:
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


def _unproven(judged: SamplesOnPath, limits: MotionLimits) -> dict[str, float]:
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


def are_rounded_phases(trajectory: Trajectory, motion: SampledMotion) -> bool:
    """Whether phases that miss their samples or a limit may do so because they were rounded.

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
