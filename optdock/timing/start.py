"""Start states: what can be driven from (v0, a0), and what to do where nothing can."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np

from optdock.interfaces import TimingStatus
from optdock.timing.allowance import Allowance, OutOfTime, look
from optdock.timing.braking import Braking
from optdock.timing.check import Worst, worst_ratio
from optdock.timing.motion import Motion, Phases, State, braking_slack, state_after

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from optdock.timing.course import Course

__all__ = ["GearPlan", "GearPlanner", "arrived_plan", "best_of", "checked_plan", "judged_plan", "plans_from"]

_KEPT = 1.0 + 1e-9
_REACHED = 1e-7  # [m, m/s, m/s^2]: rounding over kilometres and hours; `certify_trajectory` accepts 1e-6
_REACHED_SHARE = 1e-3  # of a gear shorter than that
_CLOSE = 1e-9  # [m]: nothing is left to plan


class GearPlan(NamedTuple):
    """What a planner makes of one gear.

    Args:
        status: How it ended.
        phases: The motion; empty where there is none.
        ratio: Largest quotient of a quantity and its limit along it; 0 where nobody looked.
        overshoot: Distance that full braking needs beyond the end [m].
        how: What led to the result, for the report.
        reason: Why it is not OK.
        limit: Which limit is in the way; empty where none is.
        s: Where that is decided [m]; None where it is not one place.
        arrives: Whether the motion ends at rest at the end of the gear.
    """

    status: TimingStatus
    phases: Phases = ()
    ratio: float = 0.0
    overshoot: float = 0.0
    how: str = ""
    reason: str = ""
    limit: str = ""
    s: float | None = None
    arrives: bool = True


GearPlanner: TypeAlias = "Callable[[Course, State, Allowance], Iterator[GearPlan]]"
"""Plans one gear from a state whose full braking keeps the speed caps.

Yields plans of status OK, best first, the next one made only when the one before was refused; at last perhaps one of
status FAIL, which says why there is none.
"""


def best_of(plans: Iterator[GearPlan]) -> GearPlan:
    """The next plan of what a gear planner yields that is not FAIL, or the last; TIMED_OUT where time is up."""
    last = GearPlan(TimingStatus.FAIL, how="none", reason="no method has a motion for this gear", arrives=False)
    try:
        for last in plans:
            if last.status is not TimingStatus.FAIL:
                break
    except OutOfTime:
        return GearPlan(TimingStatus.TIMED_OUT, how="none", reason="the time was up before a motion was found")
    return last


def checked_plan(course: Course, start: State, phases: Phases, how: str) -> GearPlan:
    """A motion over one gear as a plan: OK only if the dense check finds every limit kept and the end reached."""
    motion = Motion.of(start, phases)
    return judged_plan(course, motion, worst_ratio(course, motion) if phases else Worst(0.0, 0.0, 0.0, 0.0), how)


def arrived_plan(course: Course, motion: Motion, how: str) -> GearPlan:
    """A motion over one gear as a plan, OK where it ends at rest at the end of the gear; its limits are unproven."""
    slack = _slack(course)
    if abs(motion.end.s - course.length) <= slack and max(abs(motion.end.v), abs(motion.end.a)) <= _REACHED:
        return GearPlan(TimingStatus.OK, motion.phases, how=how)
    reason = f"ends at {motion.end}, not at rest after {course.length:.6g} m"
    return GearPlan(TimingStatus.FAIL, motion.phases, how=how, reason=reason)


def _slack(course: Course) -> float:
    """How far from the end of the gear a motion may end [m]."""
    return min(_REACHED, _REACHED_SHARE * course.length)


def judged_plan(course: Course, motion: Motion, worst: Worst, how: str) -> GearPlan:
    """As `checked_plan`, with what the dense check found."""
    plan = arrived_plan(course, motion, how)._replace(ratio=worst.ratio)
    if plan.status is not TimingStatus.OK or worst.ratio <= _KEPT:
        return plan
    words, s = broken_words(course, worst), course.begin + worst.s
    return plan._replace(status=TimingStatus.FAIL, reason=words, limit=worst.limit, s=s)


def broken_words(course: Course, worst: Worst) -> str:
    """What a motion breaks, by how much and where."""
    return f"{worst.ratio:.6g} times {worst.limit or 'a limit'} at s = {course.begin + worst.s:.4f} m"


def plans_from(course: Course, start: State, plan: GearPlanner, allowance: Allowance) -> Iterator[GearPlan]:
    """Plans of one gear from any start state, best first; every impossible start told by its name.

    Args:
        course: The gear.
        start: At s = 0.
        plan: Plans from a state from which the limits can be kept.
        allowance: Wall-clock time.

    Raises:
        OutOfTime: Between two plans.
    """
    if start.v == 0.0 and start.a == 0.0:
        yield from plan(course, start, allowance)
        return
    if start.v < 0.0 or braking_slack(start, course.limits.max_jerk) < 0.0:
        reason = f"from v = {start.v:.6g} m/s, a = {start.a:.6g} m/s^2 the robot rolls backwards whatever is done"
        limit = "" if start.v < 0.0 else "max_jerk"
        yield GearPlan(TimingStatus.BAD_START, how="none", reason=reason, limit=limit, s=course.begin, arrives=False)
        return
    braking = Braking(course, start)
    if not np.isfinite(braking.states).all():
        reason = f"full braking from {start} is beyond all numbers"
        yield GearPlan(TimingStatus.FAIL, how="none", reason=reason, s=course.begin, arrives=False)
        return
    if braking.motion.end.s > course.length + _CLOSE:
        yield _overshooting(course, braking.motion)
        return
    if braking.ratios.max() > _KEPT:
        yield _least_violation(course, braking, plan, allowance.refused)
        return
    for found in plan(course, start, allowance):
        if found.status is TimingStatus.OK:
            yield found
    yield _stop_and_go(course, braking.motion, plan, allowance)


def _overshooting(course: Course, brake: Motion) -> GearPlan:
    needed, left = brake.end.s, course.length
    ratio, end = worst_ratio(course, brake).ratio, course.begin + left
    distances = f"{needed:.6g} m, the stop at s = {end:.6g} m is {left:.6g} m away"
    reason = f"full braking from {brake.start.v:.6g} m/s needs {distances}"
    status, limit = TimingStatus.CANNOT_STOP, "max_deceleration"
    return GearPlan(status, brake.phases, ratio, needed - left, "brake", reason, limit, end, arrives=False)


def _least_violation(course: Course, braking: Braking, plan: GearPlanner, allowance: Allowance) -> GearPlan:
    """Full braking until past the last broken limit, then a plan; the whole braking where that plan fails."""
    ratios, brake = braking.ratios, braking.motion
    broken = np.flatnonzero(ratios > _KEPT)
    worst = int(np.argmax(ratios))
    ratio, where = float(ratios[worst]), course.begin + float(braking.states[0, worst])
    limit, sentence = braking.broken_limit(worst)
    reason = f"{sentence} under full braking; no motion from this start does better"
    after = float(braking.times[min(int(broken[-1]) + 1, braking.times.size - 1)])
    head, state = _cut(brake, after)
    rest = _resumed(course, state, plan, allowance)
    phases = head + rest if rest else brake.phases + _resumed(course, State(brake.end.s), plan, allowance)
    motion = Motion.of(brake.start, phases)
    ratio = max(ratio, worst_ratio(course, motion).ratio)
    arrives = motion.end.s > course.length - _slack(course)
    return GearPlan(TimingStatus.START_INFEASIBLE, phases, ratio, 0.0, "brake", reason, limit, where, arrives)


def _resumed(course: Course, state: State, plan: GearPlanner, allowance: Allowance) -> Phases:
    """The first plan of what is left of the course; nothing where there is none in time."""
    if course.length - state.s < _CLOSE:
        return ()
    found = best_of(plan(course.after(state.s), State(0.0, max(state.v, 0.0), state.a), allowance))
    return found.phases if found.status is TimingStatus.OK else ()


def _stop_and_go(course: Course, brake: Motion, plan: GearPlanner, allowance: Allowance) -> GearPlan:
    """Braking to rest, then a plan from rest: always drivable, a violation only where braking itself has one."""
    phases = brake.phases + _resumed(course, State(brake.end.s), plan, allowance)
    motion = Motion.of(brake.start, phases)
    worst = worst_ratio(course, motion)
    if motion.end.s < course.length - _slack(course):
        look(allowance.is_over)
        reason = "no plan from rest after full braking"
        return GearPlan(TimingStatus.FAIL, phases, worst.ratio, 0.0, "stop", reason, s=course.begin + motion.end.s)
    if worst.ratio <= _KEPT:
        return GearPlan(TimingStatus.OK, phases, worst.ratio, 0.0, "stop and go")
    reason = f"no plan found; full braking reaches {broken_words(course, worst)}"
    status, where = TimingStatus.START_INFEASIBLE, course.begin + worst.s
    return GearPlan(status, phases, worst.ratio, 0.0, "stop and go", reason, worst.limit, where)


def _cut(motion: Motion, t: float) -> tuple[Phases, State]:
    """The phases before time `t`, and the state then."""
    kept: list[tuple[float, float]] = []
    state, left = motion.start, t
    for duration, jerk in motion.phases:
        part = min(duration, left)
        if part <= 0.0:
            break
        kept.append((part, jerk))
        state, left = state_after(state, part, jerk), left - part
    return tuple(kept), state
