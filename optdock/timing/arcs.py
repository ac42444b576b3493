"""Launch and stop arcs: constant jerk between rest and the reference, which v = 0 would make singular.

Jerk-limited motion leaves rest as v^2 ~ s^(4/3); no spline of v^2 with zero slope and zero value there ever moves.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.timing.motion import Phases, State, state_after

if TYPE_CHECKING:
    from optdock.timing.bounds import Bounds
    from optdock.timing.course import Course

__all__ = ["Arc", "launch_arc", "stop_arc"]

_DRIVE_SHARE = 0.7  # of the acceleration and of the yaw acceleration that an arc may use
_SPEED_SHARE = 0.6  # of the local cap that an arc and its mirror image reach
_LENGTH_SHARE = 0.1
_SLOW_SHARE = 0.25  # of the local cap: below it a moving start is launched too
_HOLD = 0.1  # [s]: a start with v = 0, a > 0 first holds its acceleration


class Arc(NamedTuple):
    """Phases at one end of the reference, and the state where it meets the reference."""

    phases: Phases
    state: State


def _end_acceleration(bounds: Bounds, drive: float, v: float, a: float, *, at_end: bool) -> float:
    """The acceleration that an arc of jerk J from (or, mirrored, to) speed `v`, acceleration `a` may reach.

    Led back to zero at once it peaks at v + (2 a_end^2 - a^2) / (2 J), which stays well below the local cap.
    """
    course, jerk = bounds.course, bounds.jerk
    top = max(_DRIVE_SHARE * drive, a)
    time = (top - a) / jerk
    window = _window(course, max(time * (v + time * (0.5 * a + time * jerk / 6.0)), 1e-9), at_end=at_end)
    bend = float(np.abs(course.curvature[window]).max())
    rate = float(max(np.abs(course.rate_left[window]).max(), np.abs(course.rate_right[window]).max()))
    yaw = course.limits.max_yaw_acceleration
    local = min(math.sqrt(float(bounds.speed_squared[window].min())), math.sqrt(yaw / rate) if rate > 0.0 else math.inf)
    return min(
        math.sqrt(max(0.0, jerk * (_SPEED_SHARE * local - v) + 0.5 * a * a)),
        top,
        _DRIVE_SHARE * yaw / bend if bend > 0.0 else math.inf,
        math.pow(6.0 * _LENGTH_SHARE * course.length * jerk * jerk, 1.0 / 3.0),
    )


def _window(course: Course, reach: float, *, at_end: bool) -> slice:
    """The cells within `reach` [m] of an end of the course."""
    if at_end:
        return slice(max(0, int(course.s.searchsorted(course.length - reach)) - 1), None)
    return slice(0, int(course.s.searchsorted(reach)) + 1)


def stop_arc(bounds: Bounds) -> Arc:
    """Constant +J into rest at the end: length J t^3 / 6, from v = J t^2 / 2, a = -J t."""
    jerk = bounds.jerk
    a = _end_acceleration(bounds, bounds.course.limits.max_deceleration, 0.0, 0.0, at_end=True)
    time = a / jerk
    state = State(bounds.course.length - jerk * time**3 / 6.0, 0.5 * jerk * time * time, -a)
    return Arc(((time, jerk),), state)


def launch_arc(bounds: Bounds, start: State) -> Arc:
    """Constant +J from rest or from a crawl; nothing where the start is fast enough already."""
    jerk = bounds.jerk
    a = _end_acceleration(bounds, bounds.course.limits.max_acceleration, start.v, start.a, at_end=False)
    if start.v * start.v >= _SLOW_SHARE**2 * float(bounds.cap_squared[0]):
        return Arc((), start)
    if start.a < a:
        phase = ((a - start.a) / jerk, jerk)
    elif start.v < 0.5 * start.a * _HOLD:
        phase = (_HOLD, 0.0)
    else:
        return Arc((), start)
    return Arc((phase,), state_after(start, *phase))
