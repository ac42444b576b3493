"""Start states: what can be driven from (v0, a0), and what to do where nothing can."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np

from optdock.interfaces import TimingStatus
from optdock.timing.braking import Braking
from optdock.timing.check import Worst, worst_ratio
from optdock.timing.motion import Motion, Phases, State, braking_slack, state_after

if TYPE_CHECKING:
    from collections.abc import Callable

    from optdock.timing.course import Course

__all__ = ["GearPlan", "GearPlanner", "checked_plan", "judged_plan", "plan_from"]

_KEPT = 1.0 + 1e-9
_REACHED = 1e-9  # [m, m/s, m/s^2]
_CLOSE = 1e-9  # [m]: nothing is left to plan


class GearPlan(NamedTuple):
    """What a planner makes of one gear.

    Args:
        status: How it ended.
        phases: The motion; empty where there is none.
        ratio: Largest quotient of a quantity and its limit along it.
        overshoot: Distance that full braking needs beyond the end [m].
        how: What led to the result, for the report.
        reason: Why it is not OK.
        arrives: Whether the motion ends at rest at the end of the gear.
    """

    status: TimingStatus
    phases: Phases = ()
    ratio: float = 0.0
    overshoot: float = 0.0
    how: str = ""
    reason: str = ""
    arrives: bool = True


GearPlanner: TypeAlias = "Callable[[Course, State], GearPlan]"
"""Plans one gear from a state whose full braking keeps the speed caps; status OK or FAIL."""


def checked_plan(course: Course, start: State, phases: Phases, how: str) -> GearPlan:
    """A motion over one gear as a plan: OK only if the dense check finds every limit kept and the end reached."""
    motion = Motion.of(start, phases)
    return judged_plan(course, motion, worst_ratio(course, motion) if phases else Worst(0.0, 0.0, 0.0, 0.0), how)


def judged_plan(course: Course, motion: Motion, worst: Worst, how: str) -> GearPlan:
    """As `checked_plan`, with what the dense check found."""
    missing = max(abs(motion.end.s - course.length), abs(motion.end.v), abs(motion.end.a))
    status, reason = TimingStatus.OK, ""
    if not missing <= _REACHED:  # true of NaN as well
        status, reason = TimingStatus.FAIL, f"ends at {motion.end}, not at rest at s = {course.length:.6g} m"
    elif not worst.ratio <= _KEPT:
        status, reason = TimingStatus.FAIL, f"{worst.ratio:.6g} times a limit at s = {worst.s:.4f} m"
    return GearPlan(status, motion.phases, worst.ratio, 0.0, how, reason)


def plan_from(course: Course, start: State, plan: GearPlanner) -> GearPlan:
    """A plan of one gear from any start state, every impossible one told by its name.

    Args:
        course: The gear.
        start: At s = 0.
        plan: Plans from a state from which the limits can be kept.
    """
    if start.v == 0.0 and start.a == 0.0:
        return plan(course, start)
    if start.v < 0.0 or braking_slack(start, course.limits.max_jerk) < 0.0:
        reason = f"from v = {start.v:.6g} m/s, a = {start.a:.6g} m/s^2 the robot rolls backwards whatever is done"
        return GearPlan(TimingStatus.BAD_START, how="none", reason=reason, arrives=False)
    braking = Braking(course, start)
    if braking.motion.end.s > course.length + _CLOSE:
        return _overshooting(course, braking.motion)
    if braking.ratios.max() > _KEPT:
        return _least_violation(course, braking, plan)
    found = plan(course, start)
    return found if found.status is TimingStatus.OK else _stop_and_go(course, braking.motion, plan)


def _overshooting(course: Course, brake: Motion) -> GearPlan:
    reason = f"full braking needs {brake.end.s:.6g} m, {course.length:.6g} m are left"
    overshoot, ratio = brake.end.s - course.length, worst_ratio(course, brake).ratio
    return GearPlan(TimingStatus.CANNOT_STOP, brake.phases, ratio, overshoot, "brake", reason, arrives=False)


def _least_violation(course: Course, braking: Braking, plan: GearPlanner) -> GearPlan:
    """Full braking until past the last broken limit, then a plan; the whole braking where that plan fails."""
    ratios, brake = braking.ratios, braking.motion
    broken = np.flatnonzero(ratios > _KEPT)
    ratio, where = float(ratios.max()), float(braking.states[0, int(np.argmax(ratios))])
    reason = (
        f"full braking reaches {ratio:.6g} times a limit at s = {where:.4f} m; no motion from this start does better"
    )
    after = float(braking.times[min(int(broken[-1]) + 1, braking.times.size - 1)])
    head, state = _cut(brake, after)
    rest = _resumed(course, state, plan)
    phases = head + rest if rest else brake.phases + _resumed(course, State(brake.end.s), plan)
    motion = Motion.of(brake.start, phases)
    worst = max(ratio, worst_ratio(course, motion).ratio)
    arrives = motion.end.s > course.length - _CLOSE
    return GearPlan(TimingStatus.START_INFEASIBLE, phases, worst, 0.0, "brake", reason, arrives)


def _resumed(course: Course, state: State, plan: GearPlanner) -> Phases:
    if course.length - state.s < _CLOSE:
        return ()
    found = plan(course.after(state.s), State(0.0, max(state.v, 0.0), state.a))
    return found.phases if found.status is TimingStatus.OK else ()


def _stop_and_go(course: Course, brake: Motion, plan: GearPlanner) -> GearPlan:
    """Braking to rest, then a plan from rest: always drivable, a violation only where braking itself has one."""
    phases = brake.phases + _resumed(course, State(brake.end.s), plan)
    motion = Motion.of(brake.start, phases)
    worst = worst_ratio(course, motion)
    if motion.end.s < course.length - _CLOSE:
        return GearPlan(TimingStatus.FAIL, phases, worst.ratio, 0.0, "stop", "no plan from rest after full braking")
    if worst.ratio <= _KEPT:
        return GearPlan(TimingStatus.OK, phases, worst.ratio, 0.0, "stop and go")
    reason = f"no plan found; full braking reaches {worst.ratio:.6g} times a limit at s = {worst.s:.4f} m"
    return GearPlan(TimingStatus.START_INFEASIBLE, phases, worst.ratio, 0.0, "stop and go", reason)


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
