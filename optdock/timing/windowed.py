"""The windowed method: constant limits in windows of little variation, one ruckig motion per window.

Simple and never in violation: within a window every limit is taken at its worst, at every window border the
acceleration is zero, and the border speeds are those that the windows on both sides can reach.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from pydantic import Field

from optdock.deadline import Deadline
from optdock.interfaces import TimeParameterizer, TimingStatus
from optdock.parameters import PluginParameters
from optdock.timing.allowance import look
from optdock.timing.gears import time_path
from optdock.timing.motion import Motion, Phases, State, state_after
from optdock.timing.moves import Box, load_ruckig, move
from optdock.timing.start import GearPlan, arrived_plan

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from optdock.geometry.arrays import FloatArray
    from optdock.interfaces import TimingResult
    from optdock.limits import MotionLimits, SpeedZone
    from optdock.path import Path
    from optdock.timing.allowance import Allowance
    from optdock.timing.course import Course

__all__ = ["Windowed", "plan_windows"]

_MARGIN = 1e-3  # of the speed caps: curvature between the nodes of a curve that is no clothoid


class WindowedParameters(PluginParameters):
    """Parameters of `Windowed`."""

    max_window: float = Field(default=1.0, gt=0.0, description="longest window [m]")
    cap_ratio: float = Field(default=1.2, gt=1.0, description="largest quotient of two speed caps in a window")
    yaw_share: float = Field(
        default=0.8, gt=0.0, lt=1.0, description="share of the yaw acceleration for speed^2 * rate"
    )


class Window(NamedTuple):
    """A stretch [m] and the constant limits that keep all others within it."""

    left: float
    right: float
    box: Box


class Windowed(TimeParameterizer):
    """Time laws from constant limits in windows: robust, and 3 % (easy paths) to 17 % slower than need be."""

    Parameters = WindowedParameters
    parameters: WindowedParameters

    def on_configure(self) -> None:
        """Import what the first call would import.

        Raises:
            PluginError: The package ruckig is not installed.
        """
        load_ruckig()

    def parameterize(
        self,
        path: Path,
        limits: MotionLimits,
        zone: SpeedZone,
        *,
        start_speed: float = 0.0,
        start_acceleration: float = 0.0,
        max_time: float = math.inf,
    ) -> TimingResult:
        """See `TimeParameterizer.parameterize`.

        Raises:
            InvalidValue: The start state is not finite, or `max_time` is NaN.
            PluginError: The package ruckig is not installed.
        """
        deadline = Deadline(max_time)
        return time_path(path, limits, zone, (start_speed, start_acceleration), self._plan, deadline)

    def _plan(self, course: Course, start: State, allowance: Allowance) -> Iterator[GearPlan]:
        return plan_windows(course, start, allowance, self.parameters)


_DEFAULTS = WindowedParameters()


def plan_windows(
    course: Course, start: State, allowance: Allowance, parameters: WindowedParameters = _DEFAULTS
) -> Iterator[GearPlan]:
    """Windows over one gear, at most one plan.

    FAIL where they cannot be reached from the start state with the acceleration led to 0.

    Raises:
        OutOfTime: Before anything was found.
    """
    yield _planned(course, start, allowance.is_over, parameters)


def _planned(course: Course, start: State, is_late: Callable[[], bool], parameters: WindowedParameters) -> GearPlan:
    jerk = course.limits.max_jerk
    head: Phases = ((abs(start.a) / jerk, -math.copysign(jerk, start.a)),) if start.a else ()
    level = state_after(start, *head[0]) if head else start
    level = level._replace(v=max(level.v, 0.0))  # below only by rounding: the start need not roll backwards
    if level.s >= course.length:
        reason = "no room to end the start acceleration"
        return GearPlan(TimingStatus.FAIL, how="windowed", reason=reason, limit="max_jerk", s=course.begin)
    windows = _windows(course.after(level.s), parameters, is_late)
    speeds = _border_speeds(windows, level.v, is_late)
    if speeds[0] < level.v:
        reason = f"the windows allow {speeds[0]:.6g} m/s at the start, not {level.v:.6g} m/s"
        return GearPlan(TimingStatus.FAIL, how="windowed", reason=reason, s=course.begin)
    phases = head + _driven(windows, speeds, is_late)
    return arrived_plan(course, Motion.of(start, phases), "windowed")


def _driven(windows: list[Window], speeds: list[float], is_late: Callable[[], bool]) -> Phases:
    """The motions of all windows; they end early at one that cannot be driven."""
    phases: list[tuple[float, float]] = []
    for window, v0, v1 in zip(windows, speeds[:-1], speeds[1:], strict=True):
        look(is_late)
        found = move(State(0.0, v0), State(window.right - window.left, v1), window.box)
        if found is None:
            break
        phases.extend(found)
    return tuple(phases)


def _windows(course: Course, parameters: WindowedParameters, is_late: Callable[[], bool]) -> list[Window]:
    bend = np.maximum(np.abs(course.curvature[:-1]), np.abs(course.curvature[1:]))
    rate = np.maximum(np.abs(course.rate_left), np.abs(course.rate_right))
    yaw_share = parameters.yaw_share * course.limits.max_yaw_acceleration
    slowness = np.maximum(course.cell_slowness, np.sqrt(rate * (1.0 / yaw_share)))
    cuts = _cuts(course, slowness, parameters)
    look(is_late)
    peaks = (np.maximum.reduceat(column, cuts[:-1]) for column in (slowness, bend, rate))
    rows = zip(course.s[cuts[:-1]], course.s[cuts[1:]], *peaks, strict=True)
    return [_window(course, *(float(value) for value in row)) for row in rows]


def _cuts(course: Course, slowness: FloatArray, parameters: WindowedParameters) -> list[int]:
    """Indices of the nodes between windows: where the cap leaves its band, the length runs out, the zone begins."""
    zone = int(np.searchsorted(course.s, course.zone_start - 1e-12)) if course.has_zone else -1
    cuts, low, high, begin = [0], math.inf, 0.0, 0.0
    longest = parameters.max_window * (1.0 + 1e-9)  # rounding of arc lengths must not shift the borders
    for i, (value, s) in enumerate(zip(slowness.tolist(), course.s[1:].tolist(), strict=True)):
        low, high = min(low, value), max(high, value)
        if i > cuts[-1] and (high > parameters.cap_ratio * low or s - begin > longest or i == zone):
            cuts.append(i)
            low = high = value
            begin = float(course.s[i])
    return [*cuts, course.s.size - 1]


def _window(course: Course, left: float, right: float, slowness: float, bend: float, rate: float) -> Window:
    limits = course.limits
    speed = (1.0 - _MARGIN) / slowness
    spare = (limits.max_yaw_acceleration - speed * speed * rate) * (1.0 - _MARGIN)
    ceiling = spare / bend if bend > 0.0 else math.inf
    acceleration, deceleration = min(limits.max_acceleration, ceiling), min(limits.max_deceleration, ceiling)
    return Window(left, right, Box(speed, acceleration, deceleration, limits.max_jerk))


def _border_speeds(windows: list[Window], start_speed: float, is_late: Callable[[], bool]) -> list[float]:
    """Speeds at the window borders, zero acceleration: backward from rest, then forward from `start_speed`."""
    caps = [window.box.speed for window in windows]
    speeds = [caps[0], *map(min, caps[:-1], caps[1:]), 0.0]
    for i in range(len(windows) - 1, -1, -1):
        look(is_late)
        box = windows[i].box
        speeds[i] = min(speeds[i], _reachable(windows[i], speeds[i + 1], box.deceleration, speeds[i]))
    if speeds[0] < start_speed:
        return speeds
    speeds[0] = start_speed
    for i, window in enumerate(windows):
        look(is_late)
        speeds[i + 1] = _reachable(window, speeds[i], window.box.acceleration, speeds[i + 1])
    return speeds


def _reachable(window: Window, slow: float, acceleration: float, wanted: float) -> float:
    """The largest speed <= `wanted` that an S-curve from `slow` reaches within the window."""
    length, jerk = (window.right - window.left) * (1.0 - 1e-9), window.box.jerk
    if wanted <= slow or _ramp_length(slow, wanted, acceleration, jerk) <= length:
        return wanted
    full = acceleration * acceleration / jerk
    if _ramp_length(slow, slow + full, acceleration, jerk) <= length:
        # (v1^2 - v0^2) / (2 A) + (v0 + v1) A / (2 J) = length
        found = math.sqrt((slow - 0.5 * full) ** 2 + 2.0 * acceleration * length) - 0.5 * full
    else:
        # (2 v0 + g) sqrt(g / J) = length with g = v1 - v0: u^3 + p u = q with u = sqrt(g)
        root = _cubic_root(2.0 * slow, length * math.sqrt(jerk))
        found = slow + root * root
    while found > slow and _ramp_length(slow, found, acceleration, jerk) > length:  # a few roundings of a small gain
        found = math.nextafter(found, slow)
    return found


def _cubic_root(p: float, q: float) -> float:
    """The real solution of u^3 + p u = q for p >= 0, q > 0."""
    scale = math.sqrt(p / 3.0)
    if 2.0 * scale**3 <= 1e-12 * q:  # p moves the cube root by less than rounding of the lengths
        return math.exp(math.log(q) / 3.0) * (1.0 - 1e-8)
    return 2.0 * scale * math.sinh(math.asinh(0.5 * q / scale**3) / 3.0)


def _ramp_length(slow: float, fast: float, acceleration: float, jerk: float) -> float:
    """Length of the S-curve between two speeds with zero acceleration at both ends: mean speed * time."""
    gain = fast - slow
    full = acceleration * acceleration / jerk
    time = gain / acceleration + acceleration / jerk if gain >= full else 2.0 * math.sqrt(gain / jerk)
    return 0.5 * (slow + fast) * time
