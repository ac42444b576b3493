"""Short gears: one ruckig move is all they need."""

from __future__ import annotations

from typing import TYPE_CHECKING

from optdock.interfaces import TimingStatus
from optdock.timing.braking import stop_box
from optdock.timing.check import worst_ratio
from optdock.timing.motion import Motion, Phases, State, stretched
from optdock.timing.moves import Box, move
from optdock.timing.start import checked_plan

if TYPE_CHECKING:
    from optdock.timing.course import Course
    from optdock.timing.start import GearPlan

__all__ = ["quick_plan"]

_SHORT = 1.0  # [m]: longer gears are not tried
_TINY = 0.08  # [m]: below it the reference has no room
_SLOWER = ((1.0, 1.0), (0.5, 1.0), (0.5, 0.5), (0.25, 0.5), (0.25, 0.25))
_SPARE = 1.0005  # stretched by this more than needed: the check samples


def quick_plan(course: Course, start: State) -> GearPlan | None:
    """One move over the whole gear; None where it breaks a limit, and the gear is not tiny."""
    if course.length >= _SHORT:
        return None
    full = stop_box(course)._replace(speed=1.0 / float(course.slowness.min()))
    phases = move(start, State(course.length), full)
    plan = checked_plan(course, start, phases, "one move") if phases else None
    if plan is not None and plan.status is TimingStatus.OK:
        return plan
    return _tiny_plan(course, full) if course.length < _TINY and start == State() else None


def _tiny_plan(course: Course, full: Box) -> GearPlan | None:
    """The shortest of some moves from rest, each stretched in time until it keeps every limit."""
    moves = [move(State(), State(course.length), _share(full, *share)) for share in _SLOWER]
    slowed = [_slowed(course, phases) for phases in moves if phases]
    best = min(slowed, key=lambda phases: sum(duration for duration, _jerk in phases), default=())
    plan = checked_plan(course, State(), best, "one move, stretched")
    return plan if plan.status is TimingStatus.OK else None


def _slowed(course: Course, phases: Phases) -> Phases:
    worst = worst_ratio(course, Motion.of(State(), phases))
    return stretched(phases, max(worst.path * _SPARE, worst.drive))


def _share(box: Box, speed: float, drive: float) -> Box:
    return Box(speed * box.speed, drive * box.acceleration, drive * box.deceleration, box.jerk)
