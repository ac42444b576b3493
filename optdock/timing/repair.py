"""One gear, near-optimally: every method in its order, each tried only where the one before was refused.

1. One move, where that is all it takes.
2. The reference and the moves along it, as they are.
3. From rest, a small excess is cured by stretching time: exact, always possible.
4. Otherwise the bad stretches are tightened and the attempt repeated, at most twice.
5. From rest, the best attempt stretched as far as it takes; the windowed method, before that where it is quicker.

A moving start for which all that fails brakes to rest first; see `start`. The proof that decides is in `gears`.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

from optdock.interfaces import TimingStatus
from optdock.timing.allowance import OutOfTime, look
from optdock.timing.attempt import Attempt, Settings, attempt
from optdock.timing.bounds import Bounds, Margins, Tightening
from optdock.timing.braking import Braking
from optdock.timing.check import Worst, refined_times, worst_ratio
from optdock.timing.motion import Motion, Phases, State, stretched
from optdock.timing.pace import expected_duration
from optdock.timing.quick import quick_plan
from optdock.timing.start import GearPlan, arrived_plan, checked_plan, judged_plan
from optdock.timing.windowed import plan_windows

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from optdock.timing.allowance import Allowance
    from optdock.timing.course import Course

__all__ = ["plan_gear"]

_STRETCH_AT_ONCE = 1.012  # up to it stretching time is better than another attempt
_STRETCH_AT_LAST = 1.1  # beyond it the windowed method may be better
_KEPT = 1.0 + 1e-9
_TIGHT = 3.0  # margins: a moving start whose braking is closer to the limits gets none there
_RETRIES = 2
_WORTH_RETRYING = 60.0  # [s]: longer motions take 0.3 s and more for every attempt; they are stretched or windowed
_AROUND = 0.06  # [m]: tightened on both sides of a bad stretch
_WORTHWHILE = 150.0  # [s]: the reference's knots grow with the duration, its gain over windows does not
_MOST_KNOTS = 5000  # of a reference: a few MB, and 10 ms for an iteration
_EXTRA = 0.006  # tightened beyond the excess


class _Tried(NamedTuple):
    phases: Phases
    worst: Worst
    attempt: Attempt


def plan_gear(course: Course, start: State, settings: Settings, allowance: Allowance) -> Iterator[GearPlan]:
    """Plans of one gear from a state from which the speed caps can be kept: every method, in order.

    A plan is made only when the one before was refused. The windowed method's may be FAIL.

    Raises:
        OutOfTime: Time is up and no method is left that would need none.
    """
    tried: list[_Tried] = []
    if expected_duration(course) <= min(_WORTHWHILE, _MOST_KNOTS * settings.step):
        try:
            if not settings.smooth:
                yield from _if_ok(quick_plan(course, start))
            yield from _references(course, start, settings, allowance.search_is_over, tried)
        except OutOfTime:
            pass
    yield from _last_resort(course, start, tried, allowance)


def _references(
    course: Course, start: State, settings: Settings, is_late: Callable[[], bool], tried: list[_Tried]
) -> Iterator[GearPlan]:
    """Attempts, each tighter than the one before, as they are or stretched a little; `tried` gets the refused ones."""
    margins = Margins()
    moving = start.v > 0.0 or start.a > 0.0
    relief = Braking(course, start).tight_length(_TIGHT * margins.reference_speed) if moving else 0.0
    tightenings: tuple[Tightening, ...] = ()
    for retry in range(_RETRIES + 1 if expected_duration(course) <= _WORTH_RETRYING else 1):
        how = "reference" if retry == 0 else f"reference, retry {retry}"
        found = attempt(Bounds(course, margins, relief, tightenings), start, settings, is_late)
        if found is None:
            return
        motion = Motion.of(start, found.phases)
        if found.sound:
            yield from _if_ok(arrived_plan(course, motion, how))
        look(is_late)
        tried.append(_Tried(found.phases, worst_ratio(course, motion), found))
        yield from _repaired(course, start, tried[-1], margins, how)
        tightenings += _tightened(tried[-1])


def _repaired(course: Course, start: State, tried: _Tried, margins: Margins, how: str) -> Iterator[GearPlan]:
    """Plans where the dense check is passed, or passed once time is stretched a little."""
    worst, motion = tried.worst, Motion.of(start, tried.phases)
    if not tried.attempt.sound:
        if worst.ratio <= _KEPT and worst.path <= 1.0 - 0.5 * margins.check:
            yield from _if_ok(judged_plan(course, motion, worst, how))
        elif start != State():
            worst = worst_ratio(course, motion, refined_times(course, motion, 1.0 - margins.check))
            yield from _if_ok(judged_plan(course, motion, worst, how))
    if start == State() and worst.stretch <= _STRETCH_AT_ONCE:
        yield from _if_ok(_stretched_plan(course, tried, margins, how))


def _stretched_plan(course: Course, tried: _Tried, margins: Margins, how: str) -> GearPlan:
    factor = max(tried.worst.path + 0.5 * margins.check, tried.worst.drive)
    return checked_plan(course, State(), stretched(tried.phases, factor), f"{how}, stretched")


def _if_ok(plan: GearPlan | None) -> tuple[GearPlan, ...]:
    return (plan,) if plan is not None and plan.status is TimingStatus.OK else ()


def _tightened(tried: _Tried) -> tuple[Tightening, ...]:
    bad = tried.attempt.bad or ((tried.worst.s, tried.worst.s, tried.worst.stretch),)
    return tuple(
        Tightening(left - _AROUND, right + _AROUND, max(0.3, 1.0 / max(excess, 1.0) - _EXTRA))
        for left, right, excess in bad
    )


def _last_resort(course: Course, start: State, tried: list[_Tried], allowance: Allowance) -> Iterator[GearPlan]:
    """The best reference stretched in time, which only a start at rest allows, and windows; the quicker one first."""
    best = min(tried, key=lambda one: one.worst.stretch, default=None)
    slow = _stretched_plan(course, best, Margins(), "reference") if best is not None and start == State() else None
    if slow is None or slow.status is not TimingStatus.OK:
        yield from plan_windows(course, start, allowance)
        return
    if best is None or best.worst.stretch <= _STRETCH_AT_LAST:
        yield slow
        yield from plan_windows(course, start, allowance)
        return
    yield from sorted((*plan_windows(course, start, allowance), slow), key=_duration)


def _duration(plan: GearPlan) -> float:
    return sum(time for time, _jerk in plan.phases) if plan.status is TimingStatus.OK else math.inf
