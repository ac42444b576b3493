"""One gear, near-optimally: quick exits, an attempt, the check that decides, and repair in a fixed order.

1. The whole motion is checked against the true limits.
2. From rest, a small excess is cured by stretching time: exact, always possible.
3. Otherwise the bad stretches are tightened and the attempt repeated, at most twice; the best is kept.
4. The windowed method. A moving start for which that fails too brakes to rest first; see `start`.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

from optdock.interfaces import TimingStatus
from optdock.timing.attempt import Attempt, Settings, attempt
from optdock.timing.bounds import Bounds, Margins, Tightening
from optdock.timing.braking import Braking
from optdock.timing.check import Worst, refined_times, worst_ratio
from optdock.timing.motion import Motion, Phases, State, stretched
from optdock.timing.pace import expected_duration
from optdock.timing.quick import quick_plan
from optdock.timing.start import GearPlan, checked_plan, judged_plan
from optdock.timing.windowed import plan_windows

if TYPE_CHECKING:
    from optdock.timing.course import Course

__all__ = ["plan_gear"]

_STRETCH_AT_ONCE = 1.012  # up to it stretching time is better than another attempt
_STRETCH_AT_LAST = 1.1  # beyond it the windowed method may be better
_KEPT = 1.0 + 1e-9
_TIGHT = 3.0  # margins: a moving start whose braking is closer to the limits gets none there
_RETRIES = 2
_AROUND = 0.06  # [m]: tightened on both sides of a bad stretch
_WORTHWHILE = 300.0  # [s]: the reference's knots grow with the duration, its gain over windows does not
_EXTRA = 0.006  # tightened beyond the excess


class _Tried(NamedTuple):
    phases: Phases
    worst: Worst
    attempt: Attempt


def plan_gear(course: Course, start: State, settings: Settings) -> GearPlan:
    """A plan of one gear from a state from which the speed caps can be kept; status OK or FAIL."""
    if expected_duration(course) > _WORTHWHILE:
        return plan_windows(course, start)
    if not settings.smooth:
        quick = quick_plan(course, start)
        if quick is not None:
            return quick
    moving = start.v > 0.0 or start.a > 0.0
    margins = Margins()
    relief = Braking(course, start).tight_length(_TIGHT * margins.reference_speed) if moving else 0.0
    best: _Tried | None = None
    tightenings: tuple[Tightening, ...] = ()
    for retry in range(_RETRIES + 1):
        tried = _try(Bounds(course, margins, relief, tightenings), start, settings)
        if tried is None:
            break
        best = tried if best is None or tried.worst.stretch < best.worst.stretch else best
        plan = _accepted(course, start, best, margins, retry)
        if plan is not None:
            return plan
        tightenings += _tightened(tried)
    return _last_resort(course, start, best, margins)


def _try(bounds: Bounds, start: State, settings: Settings) -> _Tried | None:
    found = attempt(bounds, start, settings)
    if found is None:
        return None
    return _Tried(found.phases, worst_ratio(bounds.course, Motion.of(start, found.phases)), found)


def _accepted(course: Course, start: State, tried: _Tried, margins: Margins, retry: int) -> GearPlan | None:
    """A plan where the check is passed, or passed once time is stretched a little."""
    how = "reference" if retry == 0 else f"reference, retry {retry}"
    worst, motion = tried.worst, Motion.of(start, tried.phases)
    if worst.ratio <= _KEPT and worst.path <= 1.0 - 0.5 * margins.check:
        return _if_ok(judged_plan(course, motion, worst, how))
    if start == State():
        return _stretched_plan(course, start, tried, margins, how) if worst.stretch <= _STRETCH_AT_ONCE else None
    worst = worst_ratio(course, motion, refined_times(course, motion, 1.0 - margins.check))
    return _if_ok(judged_plan(course, motion, worst, how))


def _stretched_plan(course: Course, start: State, tried: _Tried, margins: Margins, how: str) -> GearPlan | None:
    factor = max(tried.worst.path + 0.5 * margins.check, tried.worst.drive)
    return _if_ok(checked_plan(course, start, stretched(tried.phases, factor), f"{how}, stretched"))


def _if_ok(plan: GearPlan) -> GearPlan | None:
    return plan if plan.status is TimingStatus.OK else None


def _tightened(tried: _Tried) -> tuple[Tightening, ...]:
    bad = tried.attempt.bad or ((tried.worst.s, tried.worst.s, tried.worst.stretch),)
    return tuple(
        Tightening(left - _AROUND, right + _AROUND, max(0.3, 1.0 / max(excess, 1.0) - _EXTRA))
        for left, right, excess in bad
    )


def _last_resort(course: Course, start: State, best: _Tried | None, margins: Margins) -> GearPlan:
    windowed = plan_windows(course, start)
    if best is None or start.v > 0.0 or start.a > 0.0:
        return windowed
    plan = _stretched_plan(course, start, best, margins, "reference")
    if plan is None or (best.worst.stretch > _STRETCH_AT_LAST and _duration(windowed) < _duration(plan)):
        return windowed
    return plan


def _duration(plan: GearPlan) -> float:
    return sum(time for time, _jerk in plan.phases) if plan.status is TimingStatus.OK else math.inf
