"""Short gears: one ruckig move is all they need."""

from __future__ import annotations

from typing import TYPE_CHECKING

from optdock.interfaces import TimingStatus
from optdock.timing.motion import State
from optdock.timing.moves import Box, move
from optdock.timing.start import checked_plan, stop_box

if TYPE_CHECKING:
    from optdock.timing.course import Course
    from optdock.timing.start import GearPlan

__all__ = ["quick_plan"]

_SHORT = 1.0  # [m]: longer gears are not tried
_TINY = 0.08  # [m]: below it the reference has no room, so slower moves are tried too
_SLOWER = (0.9, 0.8, 0.65, 0.5, 0.35, 0.25, 0.15)


def quick_plan(course: Course, start: State) -> GearPlan | None:
    """One move over the whole gear; None where the check refuses all that are tried."""
    if course.length >= _SHORT:
        return None
    full = stop_box(course)._replace(speed=1.0 / float(course.slowness.min()))
    found = _one_move(course, start, full)
    if found is not None or course.length >= _TINY or start.v > 0.0 or start.a > 0.0:
        return found
    plans = [_one_move(course, start, _slower(full, v, a)) for v in (1.0, *_SLOWER) for a in (1.0, *_SLOWER)]
    return min((plan for plan in plans if plan is not None), key=_duration, default=None)


def _slower(box: Box, speed: float, drive: float) -> Box:
    return Box(speed * box.speed, drive * box.acceleration, drive * box.deceleration, box.jerk)


def _one_move(course: Course, start: State, box: Box) -> GearPlan | None:
    phases = move(start, State(course.length), box)
    if phases is None:
        return None
    plan = checked_plan(course, start, phases, "one move")
    return plan if plan.status is TimingStatus.OK else None


def _duration(plan: GearPlan) -> float:
    return sum(duration for duration, _jerk in plan.phases)
