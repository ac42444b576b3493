"""Start states: what can be driven from (v0, a0), and what to do where nothing can.

Among all controls from a start state full braking (jerk -J to -D, hold, +J to rest) gives the smallest speed at every
distance: compare da/ds = j / v. So the speed caps can be kept if and only if the full-braking curve stays below them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.interfaces import TimingStatus
from optdock.timing.check import Worst, worst_ratio
from optdock.timing.motion import Motion, Phases, State, braking_slack, state_after
from optdock.timing.moves import Box, full_stop

if TYPE_CHECKING:
    from collections.abc import Callable

    from optdock.geometry.arrays import FloatArray
    from optdock.timing.course import Course

__all__ = ["GearPlan", "GearPlanner", "checked_plan", "judged_plan", "plan_from", "relief_length", "stop_box"]

_KEPT = 1.0 + 1e-9
_TIGHT_YAW = 0.95  # of the yaw acceleration: a start beyond it is planned without margins until it is below
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
    """

    status: TimingStatus
    phases: Phases = ()
    ratio: float = 0.0
    overshoot: float = 0.0
    how: str = ""
    reason: str = ""


if TYPE_CHECKING:
    GearPlanner = Callable[[Course, State], GearPlan]
    """Plans one gear from a state whose full braking keeps the speed caps; status OK or FAIL."""


def checked_plan(course: Course, start: State, phases: Phases, how: str) -> GearPlan:
    """A motion over one gear as a plan: OK only if the dense check finds every limit kept and the end reached."""
    motion = Motion.of(start, phases)
    return judged_plan(course, motion, worst_ratio(course, motion) if phases else Worst(0.0, 0.0, 0.0, 0.0), how)


def judged_plan(course: Course, motion: Motion, worst: Worst, how: str) -> GearPlan:
    """As `checked_plan`, with what the dense check found."""
    missing = max(abs(motion.end.s - course.length), abs(motion.end.v), abs(motion.end.a))
    if missing > _REACHED:
        reason = f"ends at {motion.end}, not at rest at s = {course.length:.6g} m"
        return GearPlan(TimingStatus.FAIL, motion.phases, worst.ratio, 0.0, how, reason)
    if worst.ratio > _KEPT:
        reason = f"{worst.ratio:.6g} times a limit at s = {worst.s:.4f} m"
        return GearPlan(TimingStatus.FAIL, motion.phases, worst.ratio, 0.0, how, reason)
    return GearPlan(TimingStatus.OK, motion.phases, worst.ratio, 0.0, how)


def stop_box(course: Course) -> Box:
    """The drive's own bounds."""
    limits = course.limits
    return Box(course.drive.max_speed, limits.max_acceleration, limits.max_deceleration, limits.max_jerk)


def plan_from(course: Course, start: State, plan: GearPlanner) -> GearPlan:
    """A plan of one gear from any start state, every impossible one told by its name.

    Args:
        course: The gear.
        start: At s = 0.
        plan: Plans from a state from which the limits can be kept.
    """
    if start.v == 0.0 and start.a == 0.0:
        return plan(course, start)
    jerk = course.limits.max_jerk
    if start.v < 0.0 or braking_slack(start, jerk) < 0.0:
        reason = f"from v = {start.v:.6g} m/s, a = {start.a:.6g} m/s^2 the robot rolls backwards whatever is done"
        return GearPlan(TimingStatus.BAD_START, reason=reason)
    brake = Motion.of(start, full_stop(start, stop_box(course)))
    overshoot = brake.end.s - course.length
    if overshoot > 1e-9:
        reason = f"full braking needs {brake.end.s:.6g} m, {course.length:.6g} m are left"
        return GearPlan(TimingStatus.CANNOT_STOP, brake.phases, worst_ratio(course, brake).ratio, overshoot, "", reason)
    ratios = _necessary_ratios(course, brake)
    if ratios.max(initial=0.0) > _KEPT:
        return _least_violation(course, brake, ratios, plan)
    found = plan(course, start)
    return found if found.status is TimingStatus.OK else _stop_and_go(course, brake, plan)


def _necessary_ratios(course: Course, brake: Motion) -> FloatArray:
    """Quotients that full braking has with limits no motion from this state can keep better, at `_brake_times`.

    Speed caps; the speed beyond which no acceleration keeps the yaw acceleration,
    v^2 = (al + |k| * (D if k k' > 0 else A)) / |k'|; the yaw acceleration and the acceleration at the start itself.
    """
    s, v, a = brake.at(_brake_times(course, brake))
    points, limits = course.points_at(np.clip(s, 0.0, course.length)), course.limits
    bend, rate = points.curvature, np.abs(points.rate)
    help_ = np.where(bend * points.rate > 0.0, limits.max_deceleration, limits.max_acceleration)
    yaw = v * np.sqrt(rate / (limits.max_yaw_acceleration + np.abs(bend) * help_))
    ratios: FloatArray = np.maximum(v * points.slowness, yaw)
    first = abs(a[0] * bend[0] + v[0] ** 2 * points.rate[0]) / limits.max_yaw_acceleration
    outside = max(a[0] / limits.max_acceleration, -a[0] / limits.max_deceleration)
    ratios[0] = max(ratios[0], first, outside)
    return ratios


def _brake_times(course: Course, brake: Motion) -> FloatArray:
    nodes = course.s[(course.s > 0.0) & (course.s < brake.end.s)]
    grid = np.union1d(brake.times, np.arange(0.0, brake.duration, 0.004))
    return np.union1d(grid, brake.crossing_times(nodes)) if nodes.size else grid


def relief_length(course: Course, start: State, slack: float) -> float:
    """How far from a moving start full braking comes within `slack`, relative, of the limits [m]."""
    brake = Motion.of(start, full_stop(start, stop_box(course)))
    times = _brake_times(course, brake)
    s, v, a = brake.at(times)
    points = course.points_at(np.clip(s, 0.0, course.length))
    tight = np.flatnonzero(_necessary_ratios(course, brake) > 1.0 - slack)
    yaw = np.abs(a * points.curvature + v * v * points.rate) > _TIGHT_YAW * course.limits.max_yaw_acceleration
    turning = int(np.argmin(yaw)) if yaw[0] and not yaw.all() else 0
    last = max(int(tight[-1]) if tight.size else 0, turning)
    return float(s[min(last + 1, s.size - 1)]) if last or tight.size else 0.0


def _least_violation(course: Course, brake: Motion, ratios: FloatArray, plan: GearPlanner) -> GearPlan:
    """Full braking until past the last broken limit, then a plan; the whole braking where that plan fails."""
    times = _brake_times(course, brake)
    ratio = float(ratios.max())
    where = float(brake.at(times[[int(np.argmax(ratios))]])[0, 0])
    reason = (
        f"full braking reaches {ratio:.6g} times a limit at s = {where:.4f} m; no motion from this start does better"
    )
    after = times[min(int(np.flatnonzero(ratios > _KEPT)[-1]) + 1, times.size - 1)]
    head, state = _cut(brake, float(after))
    rest = _resumed(course, state, plan)
    phases = head + rest if rest else brake.phases + _resumed(course, State(brake.end.s), plan)
    worst = max(ratio, worst_ratio(course, Motion.of(brake.start, phases)).ratio)
    return GearPlan(TimingStatus.START_INFEASIBLE, phases, worst, 0.0, "brake", reason)


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
