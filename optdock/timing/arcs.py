"""Launch and stop arcs: constant jerk between rest and the reference, which v = 0 would make singular.

Jerk-limited motion leaves rest as v^2 ~ s^(4/3); no spline of v^2 with zero slope and zero value there ever moves.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

from optdock.timing.motion import Phases, State, state_after

if TYPE_CHECKING:
    from optdock.timing.bounds import Bounds

__all__ = ["Arc", "launch_arc", "stop_arc"]

_DRIVE_SHARE = 0.7  # of the acceleration and of the yaw acceleration that an arc may use
_SPEED_SHARE = 0.6  # speed after an arc from rest is half of this share of the local cap
_LENGTH_SHARE = 0.1
_SLOW_SHARE = 0.25  # of the local cap: below it a moving start is launched too
_HOLD = 0.1  # [s]: a start with v = 0, a > 0 first holds its acceleration


class Arc(NamedTuple):
    """Phases at one end of the reference, and the state where it meets the reference."""

    phases: Phases
    state: State


def _end_acceleration(bounds: Bounds, drive: float, *, at_end: bool) -> float:
    """The acceleration that an arc from or to rest may reach."""
    course, jerk = bounds.course, bounds.jerk
    reach = max(jerk * (_DRIVE_SHARE * drive / jerk) ** 3 / 6.0, 1e-9)
    window = (
        slice(max(0, int(course.s.searchsorted(course.length - reach)) - 1), None)
        if at_end
        else slice(0, int(course.s.searchsorted(reach)) + 1)
    )
    bend = float(abs(course.curvature[window]).max())
    rate = max(float(abs(course.rate_left[window]).max()), float(abs(course.rate_right[window]).max()))
    cap = math.sqrt(float(bounds.speed_squared[window].min()))
    yaw = course.limits.max_yaw_acceleration
    local = min(cap, math.sqrt(yaw / rate) if rate > 0.0 else math.inf)
    return min(
        math.sqrt(_SPEED_SHARE * local * jerk),
        _DRIVE_SHARE * drive,
        _DRIVE_SHARE * yaw / bend if bend > 0.0 else math.inf,
        math.pow(6.0 * _LENGTH_SHARE * course.length * jerk * jerk, 1.0 / 3.0),
    )


def stop_arc(bounds: Bounds) -> Arc:
    """Constant +J into rest at the end: length J t^3 / 6, from v = J t^2 / 2, a = -J t."""
    jerk = bounds.jerk
    a = _end_acceleration(bounds, bounds.course.limits.max_deceleration, at_end=True)
    time = a / jerk
    state = State(bounds.course.length - jerk * time**3 / 6.0, 0.5 * jerk * time * time, -a)
    return Arc(((time, jerk),), state)


def launch_arc(bounds: Bounds, start: State) -> Arc:
    """Constant +J from rest or from a crawl; nothing where the start is fast enough already."""
    jerk = bounds.jerk
    a = _end_acceleration(bounds, bounds.course.limits.max_acceleration, at_end=False)
    if start.v * start.v >= _SLOW_SHARE**2 * float(bounds.cap_squared[0]):
        return Arc((), start)
    if start.a < a:
        phase = ((a - start.a) / jerk, jerk)
    elif start.v < 0.5 * start.a * _HOLD:
        phase = (_HOLD, 0.0)
    else:
        return Arc((), start)
    return Arc((phase,), state_after(start, *phase))
