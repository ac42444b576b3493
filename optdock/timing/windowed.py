"""The windowed method: constant limits in windows where the limits vary little, with one ruckig motion per window.

The method is simple and satisfies every limit by construction. Each window uses the strictest value of every limit, the
acceleration is zero at every window boundary, and the speeds there can be reached in the windows on both sides.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from pydantic import Field

from optdock.plugins.interfaces import TimingStatus
from optdock.plugins.parameters import PluginParameters
from optdock.timing.jerk_phases import DriveBounds, MotionState, Phases, state_after
from optdock.timing.plan_checks import SegmentPlan, arrived_plan
from optdock.timing.retry_strategy import SegmentTimeParameterizer
from optdock.timing.ruckig_moves import move

if TYPE_CHECKING:
    from collections.abc import Iterator

    from optdock.deadline import Deadline
    from optdock.geometry.arrays import FloatArray
    from optdock.timing.path_limits import PathLimits
    from optdock.timing.retry_strategy import Deadlines
    from optdock.timing.start_states import Braking

__all__ = ["Window", "Windowed", "WindowedParameters", "reachable_speed", "s_curve_length", "windowed_plans"]

_MARGIN = 1e-3  # share of the speed caps that is not used, because of the curvature between the nodes of a polyline
_LOOK_EVERY = 500  # number of nodes (half a millisecond) between two checks of the deadline


class WindowedParameters(PluginParameters):
    """Parameters of `Windowed`."""

    max_window: float = Field(default=1.0, gt=0.0, description="longest window [m]")
    cap_ratio: float = Field(default=1.2, gt=1.0, description="largest ratio of two speed caps in a window")
    yaw_share: float = Field(
        default=0.8, gt=0.0, lt=1.0, description="share of yaw acceleration and lateral jerk for the curvature rate"
    )


class Windowed(SegmentTimeParameterizer):
    """Compute time laws from constant limits in windows.

    The method is robust, but its motions are 3 % (easy paths) to 17 % slower than the optimum.
    """

    Parameters = WindowedParameters
    parameters: WindowedParameters

    def segment_plans(
        self, limits: PathLimits, start: MotionState, deadlines: Deadlines, _braking: Braking | None
    ) -> Iterator[SegmentPlan]:
        """Yield the plan of one segment; see `windowed_plans`."""
        return windowed_plans(limits, start, deadlines, self.parameters)


class Window(NamedTuple):
    """Interval [m] with constant limits that are at least as strict as all limits in it."""

    left: float
    right: float
    bounds: DriveBounds


def windowed_plans(
    limits: PathLimits, start: MotionState, deadlines: Deadlines, settings: WindowedParameters | None = None
) -> Iterator[SegmentPlan]:
    """Yield one plan of a segment; its status is FAIL if the first window cannot be reached from the start state.

    Raises:
        OutOfTime: If the deadline passed.
    """
    jerk = limits.drive.max_jerk
    head: Phases = ((abs(start.a) / jerk, -math.copysign(jerk, start.a)),) if start.a else ()
    level = state_after(start, *head[0]) if head else start
    level = level._replace(v=max(level.v, 0.0))  # negative only because of rounding
    if level.s >= limits.length:
        reason = "the path is too short to end the start acceleration"
        yield SegmentPlan(TimingStatus.FAIL, how="windowed", reason=reason, limit="max_jerk", s=limits.begin)
        return
    windows = _windows(limits.after(level.s), settings or WindowedParameters(), deadlines.last)
    speeds = _border_speeds(windows, level.v, deadlines.last)
    if speeds[0] < level.v:
        reason = f"the windows allow {speeds[0]:.6g} m/s at the start, not {level.v:.6g} m/s"
        yield SegmentPlan(TimingStatus.FAIL, how="windowed", reason=reason, s=limits.begin)
        return
    phases = list(head)
    for window, v0, v1 in zip(windows, speeds[:-1], speeds[1:], strict=True):
        deadlines.last.look()
        length = window.right - window.left
        found = move(MotionState(0.0, v0), MotionState(length, v1), window.bounds)
        if found is None and v0 == v1 > 0.0:  # ruckig may find no move over one micrometre
            found = ((length / v0, 0.0),)
        if found is None:
            break  # the motion ends before the end of the segment
        phases.extend(found)
    yield arrived_plan(limits, start, tuple(phases), "windowed")


def _windows(limits: PathLimits, settings: WindowedParameters, deadline: Deadline) -> list[Window]:
    """Return the windows, each with the strictest value of every limit in it."""
    bend = np.maximum(np.abs(limits.curvature[:-1]), np.abs(limits.curvature[1:]))
    slowness = limits.maximum_velocity_curve(settings.yaw_share)
    cuts = _cuts(limits, slowness, settings, deadline)
    deadline.look()
    slowness, bend, rate = (np.maximum.reduceat(column, cuts[:-1]) for column in (slowness, bend, limits.steepest))
    drive, used = limits.drive, 1.0 - _MARGIN
    speed = used / slowness
    ceiling = np.full(bend.size, np.inf)
    for limit in limits.turning:
        ceiling = np.minimum(ceiling, limit.acceleration_beside(speed, bend, rate, used))
    rise, fall = np.minimum(drive.max_acceleration, ceiling), np.minimum(drive.max_deceleration, ceiling)
    columns = (limits.s[cuts[:-1]], limits.s[cuts[1:]], speed, rise, fall)
    return [
        Window(left, right, DriveBounds(fastest, most, least, drive.max_jerk))
        for left, right, fastest, most, least in zip(*(column.tolist() for column in columns), strict=True)
    ]


def _cuts(limits: PathLimits, slowness: FloatArray, settings: WindowedParameters, deadline: Deadline) -> list[int]:
    """Return the indices of the nodes between windows, determined by the ratio of the caps, the length and the zone."""
    zone = int(np.searchsorted(limits.s, limits.zone_start - 1e-12)) if limits.has_zone else -1
    cuts, low, high, begin = [0], math.inf, 0.0, 0.0
    longest = settings.max_window * (1.0 + 1e-9)  # rounding of arc lengths must not shift the boundaries
    for i, (value, s) in enumerate(zip(slowness.tolist(), limits.s[1:].tolist(), strict=True)):
        if i % _LOOK_EVERY == 0:
            deadline.look()
        low, high = min(low, value), max(high, value)
        if i > cuts[-1] and (high > settings.cap_ratio * low or s - begin > longest or i == zone):
            cuts.append(i)
            low = high = value
            begin = float(limits.s[i])
    return [*cuts, limits.s.size - 1]


def _border_speeds(windows: list[Window], start_speed: float, deadline: Deadline) -> list[float]:
    """Return the speeds at window boundaries, by a backward pass from rest and a forward pass from `start_speed`."""
    caps = [window.bounds.speed for window in windows]
    speeds = [caps[0], *map(min, caps[:-1], caps[1:]), 0.0]
    for i in range(len(windows) - 1, -1, -1):
        deadline.look()
        deceleration = windows[i].bounds.deceleration
        speeds[i] = min(speeds[i], reachable_speed(windows[i], speeds[i + 1], deceleration, speeds[i]))
    if speeds[0] < start_speed:
        return speeds
    speeds[0] = start_speed
    for i, window in enumerate(windows):
        deadline.look()
        speeds[i + 1] = reachable_speed(window, speeds[i], window.bounds.acceleration, speeds[i + 1])
    return speeds


def reachable_speed(window: Window, slow: float, acceleration: float, wanted: float) -> float:
    """Return the largest speed <= `wanted` that an S-curve from `slow` reaches within the window."""
    length, jerk = (window.right - window.left) * (1.0 - 1e-9), window.bounds.jerk
    if wanted <= slow or s_curve_length(slow, wanted, acceleration, jerk) <= length:
        return wanted
    full = acceleration * acceleration / jerk
    if s_curve_length(slow, slow + full, acceleration, jerk) <= length:
        # (v1^2 - v0^2) / (2 A) + (v0 + v1) A / (2 J) = length
        found = math.sqrt((slow - 0.5 * full) ** 2 + 2.0 * acceleration * length) - 0.5 * full
    else:
        # (2 v0 + g) sqrt(g / J) = length with g = v1 - v0: u^3 + p u = q with u = sqrt(g)
        root = _cubic_root(2.0 * slow, length * math.sqrt(jerk))
        found = slow + root * root
    while found > slow and s_curve_length(slow, found, acceleration, jerk) > length:  # a small gain is rounded
        found = math.nextafter(found, slow)
    return found


def _cubic_root(p: float, q: float) -> float:
    """Return the real solution of u^3 + p u = q for p >= 0, q > 0."""
    scale = math.sqrt(p / 3.0)
    if 2.0 * scale**3 <= 1e-12 * q:  # p changes the cube root by less than a rounding error
        return math.exp(math.log(q) / 3.0) * (1.0 - 1e-8)
    return 2.0 * scale * math.sinh(math.asinh(0.5 * q / scale**3) / 3.0)


def s_curve_length(slow: float, fast: float, acceleration: float, jerk: float) -> float:
    """Return the length of the S-curve between two speeds with zero acceleration at both ends."""
    gain = fast - slow
    full = acceleration * acceleration / jerk
    time = gain / acceleration + acceleration / jerk if gain >= full else 2.0 * math.sqrt(gain / jerk)
    return 0.5 * (slow + fast) * time
