"""From a planner of one gear to the time law of a whole path: rest at every cusp, the speed zone at the end."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from optdock.errors import InvalidValue
from optdock.interfaces import TimingResult, TimingStatus
from optdock.path import Path, PolylineSegment
from optdock.timing.course import Course, Slowness, course_of
from optdock.timing.motion import Phases, State
from optdock.timing.pace import LONGEST, expected_duration
from optdock.timing.start import GearPlan, plan_from
from optdock.trajectory import TimeLaw, Trajectory

if TYPE_CHECKING:
    from optdock.limits import MotionLimits, SpeedZone
    from optdock.path import Segment
    from optdock.timing.start import GearPlanner

__all__ = ["courses_of", "time_path"]

_NO_LENGTH = 1e-11  # [m]: the knots of a shorter gear are one


def time_path(
    path: Path, limits: MotionLimits, zone: SpeedZone, start: tuple[float, float], plan: GearPlanner
) -> TimingResult:
    """The time law of a path, gear by gear.

    Args:
        path: Where to drive.
        limits: What the drive can do.
        zone: Slow stretch at the end of the path.
        start: Speed [m/s] and acceleration [m/s^2] at the start.
        plan: Plans one gear.

    Raises:
        InvalidValue: The start state is not finite.
    """
    if not all(math.isfinite(value) for value in start):
        raise InvalidValue(f"timing: start_speed and start_acceleration must be finite, got {start}")
    fault = _undrivable(path)
    if fault:
        return TimingResult(TimingStatus.FAIL, None, math.inf, report={"reason": fault})
    state, plans = State(0.0, *start), []
    for course in courses_of(path, limits, zone):
        plans.append(_gear_plan(course, state, plan))
        if plans[-1].status is TimingStatus.FAIL or not plans[-1].arrives:
            break
        state = State() if course is not None else state
    return _result(path, plans, start)


def _gear_plan(course: Course | None, state: State, plan: GearPlanner) -> GearPlan:
    """The plan of one gear; a motion that takes longer than `LONGEST` is none."""
    if course is None:
        return GearPlan(TimingStatus.OK, how="empty")
    duration = expected_duration(course)
    if duration > LONGEST:
        reason = f"the gear would take about {duration:.3g} s; motions of more than {LONGEST:.0f} s are not planned"
        return GearPlan(TimingStatus.FAIL, how="refused", reason=reason)
    return plan_from(course, state, plan)


def courses_of(path: Path, limits: MotionLimits, zone: SpeedZone) -> list[Course | None]:
    """One course per gear; None for a gear of no length."""
    zone_start = path.length - zone.distance if zone.distance > 0.0 and math.isfinite(zone.speed) else math.inf
    return [
        course_of(segment, Slowness(limits, segment.direction), zone_start - float(begin), zone.speed)
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
    report: dict[str, object] = {"gears": [gear.how for gear in plans]}
    if worst.reason:
        report["reason"] = worst.reason
    ratio = max(gear.ratio for gear in plans)
    if worst.status in (TimingStatus.FAIL, TimingStatus.BAD_START):
        return TimingResult(worst.status, None, ratio, report=report)
    driven = path if len(plans) == len(path.segments) else Path(path.segments[: len(plans)])
    phases: Phases = tuple(phase for gear in plans for phase in gear.phases)
    trajectory = Trajectory(driven, _time_law(phases, start))
    return TimingResult(worst.status, trajectory, ratio, worst.overshoot, report)


def _time_law(phases: Phases, start: tuple[float, float]) -> TimeLaw:
    kept = np.array([phase for phase in phases if phase[0] > 0.0])
    return TimeLaw(kept[:, 0], kept[:, 1], 0.0, *start)
