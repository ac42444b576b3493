"""From a planner of one gear to the time law of a whole path: rest at every cusp, the speed zone at the end."""

from __future__ import annotations

import itertools
import math
import time
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from optdock.deadline import Deadline
from optdock.errors import InvalidValue
from optdock.interfaces import TimingReport, TimingResult, TimingStatus
from optdock.path import Path, PolylineSegment
from optdock.timing.allowance import Allowance
from optdock.timing.course import Course, Slowness, course_of
from optdock.timing.motion import Phases, State
from optdock.timing.pace import LONGEST, expected_duration
from optdock.timing.start import GearPlan, best_of, plans_from
from optdock.trajectory import TimeLaw, Trajectory
from optdock.verification import certify_trajectory

if TYPE_CHECKING:
    from collections.abc import Iterator

    from optdock.limits import MotionLimits, SpeedZone
    from optdock.path import Segment
    from optdock.timing.start import GearPlanner
    from optdock.verification import Violation

__all__ = ["courses_of", "time_path"]

_NO_LENGTH = 1e-11  # [m]: the knots of a shorter gear are one


def time_path(
    path: Path,
    limits: MotionLimits,
    zone: SpeedZone,
    start: tuple[float, float],
    plan: GearPlanner,
    deadline: Deadline | None = None,
) -> TimingResult:
    """The time law of a path, gear by gear. What it calls OK is proven: `certify_trajectory` decides.

    Each gear is planned by the methods of `plan` in their order. Where the proof refuses a gear, its next plan takes
    the place; the gears do not touch each other, since the robot rests between them.

    Args:
        path: Where to drive.
        limits: What the drive can do.
        zone: Slow stretch at the end of the path.
        start: Speed [m/s] and acceleration [m/s^2] at the start.
        plan: Plans one gear.
        deadline: For all of it; None: no deadline.

    Raises:
        InvalidValue: The start state is not finite, or the deadline is NaN.
    """
    if not all(math.isfinite(value) for value in start):
        raise InvalidValue(f"timing: start_speed and start_acceleration must be finite, got {start}")
    whole = deadline or Deadline()
    if math.isnan(whole.seconds):
        raise InvalidValue("timing: max_time must be a number of seconds, got nan")
    fault = _undrivable(path)
    if fault:
        return TimingResult(TimingStatus.FAIL, None, math.inf, reason=fault)
    if whole.passed():
        return TimingResult(TimingStatus.TIMED_OUT, None, reason=f"no time: max_time is {whole.seconds:.3g} s")
    began = whole.elapsed, time.thread_time()
    courses = courses_of(path, limits, zone)
    # Of two clocks the smaller: one counts while the machine does something else, the other may tick coarsely.
    allowance = Allowance(whole, min(whole.elapsed - began[0], time.thread_time() - began[1]))
    gears, plans = [], []
    state = State(0.0, *start)
    for course in courses:
        gears.append(_gear_plans(course, state, plan, allowance))
        plans.append(best_of(gears[-1]))
        if plans[-1].status >= TimingStatus.FAIL or not plans[-1].arrives:
            break
        state = State() if course is not None else state
        allowance = allowance if plans[-1].status is TimingStatus.OK else allowance.refused
    return _proven(path, (limits, zone, start), gears, plans, whole)


def _proven(
    path: Path,
    task: tuple[MotionLimits, SpeedZone, tuple[float, float]],
    gears: list[Iterator[GearPlan]],
    plans: list[GearPlan],
    deadline: Deadline,
) -> TimingResult:
    """The result once every refused gear has another plan, or none is left."""
    limits, zone, (speed, acceleration) = task
    while True:
        result = _result(path, plans, (speed, acceleration))
        if result.status is not TimingStatus.OK or result.trajectory is None:
            return result
        proof = certify_trajectory(
            result.trajectory,
            limits,
            zone,
            start_speed=speed,
            start_acceleration=acceleration,
            is_late=deadline.passed,
        )
        if proof.certified:
            return replace(result, worst_ratio=max(proof.ratios.values()))
        if deadline.passed():
            reason = "the time was up before the motion was proven"
            return replace(result, status=TimingStatus.TIMED_OUT, trajectory=None, reason=reason)
        first = proof.violations[0]
        i = int(np.clip(np.searchsorted(path.segment_starts, first.s, side="right") - 1, 0, len(plans) - 1))
        plans[i] = best_of(itertools.chain(gears[i], [_refused(plans[i], first)]))


def _refused(plan: GearPlan, violation: Violation) -> GearPlan:
    """What is left to say where the last plan of a gear is refused by the proof."""
    reason = f"the last method, {plan.how}, is not certified: {violation.message}"
    return GearPlan(TimingStatus.FAIL, how=plan.how, reason=reason, s=violation.s, arrives=False)


def _gear_plans(course: Course | None, state: State, plan: GearPlanner, allowance: Allowance) -> Iterator[GearPlan]:
    """The plans of one gear, best first; a motion that takes longer than `LONGEST` is none."""
    if course is None:
        yield GearPlan(TimingStatus.OK, how="empty")
        return
    duration = expected_duration(course)
    if duration > LONGEST:
        reason = f"the drive would take about {duration:.3g} s; motions of more than {LONGEST:.0f} s are not planned"
        yield GearPlan(TimingStatus.FAIL, how="refused", reason=reason, s=course.begin)
        return
    yield from plans_from(course, state, plan, allowance)


def courses_of(path: Path, limits: MotionLimits, zone: SpeedZone) -> list[Course | None]:
    """One course per gear; None for a gear of no length."""
    zone_start = path.length - zone.distance if zone.distance > 0.0 and math.isfinite(zone.speed) else math.inf
    return [
        course_of(segment, Slowness(limits, segment.direction), zone_start - float(begin), zone.speed, float(begin))
        if segment.length > _NO_LENGTH
        else None
        for segment, begin in zip(path.segments, path.segment_starts[:-1], strict=True)
    ]


def _undrivable(path: Path) -> str:
    """Where the robot turns on the spot, which no time law over arc length can drive; empty if nowhere."""
    for segment, begin in zip(path.segments, path.segment_starts[:-1], strict=True):
        turn, s = _turn_in_place(segment)
        if turn != 0.0:
            where = f"by {turn:.6g} rad at s = {begin + s:.6g} m"
            return f"path turns in place {where}; a time law over arc length cannot drive that"
    return "" if any(segment.length > _NO_LENGTH for segment in path.segments) else "path has no length"


def _turn_in_place(segment: Segment) -> tuple[float, float]:
    if not isinstance(segment, PolylineSegment):
        return 0.0, 0.0
    still = np.flatnonzero(~np.isfinite(segment.step_curvature))
    if still.size == 0:
        return 0.0, 0.0
    first = int(still[0])
    return float(segment.poses[first + 1, 2] - segment.poses[first, 2]), float(segment.knots[first])


def _result(path: Path, plans: list[GearPlan], start: tuple[float, float]) -> TimingResult:
    worst = max(plans, key=lambda gear: gear.status)  # the statuses are in order of gravity
    report = TimingReport(tuple(gear.how for gear in plans))
    ratio = max(gear.ratio for gear in plans)
    trajectory = None
    if worst.status not in (TimingStatus.FAIL, TimingStatus.BAD_START, TimingStatus.TIMED_OUT):
        driven = path if len(plans) == len(path.segments) else Path(path.segments[: len(plans)])
        phases: Phases = tuple(phase for gear in plans for phase in gear.phases)
        trajectory = Trajectory(driven, _time_law(phases, start))
    return TimingResult(
        worst.status, trajectory, ratio, worst.overshoot, report, reason=worst.reason, limit=worst.limit, at_s=worst.s
    )


def _time_law(phases: Phases, start: tuple[float, float]) -> TimeLaw:
    kept = np.array([phase for phase in phases if phase[0] > 0.0])
    return TimeLaw(kept[:, 0], kept[:, 1], 0.0, *start)
