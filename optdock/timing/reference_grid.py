"""The grid of a reference: its speed profile, the arcs at both ends, its knots, and the limits at the knots.

At v = 0 the formulation in x = v^2 is singular: jerk-limited motion leaves rest as x ~ s^(4/3), and a spline with zero
slope and zero value never moves. Therefore two arcs of constant jerk connect the reference to rest: the launch arc and
the stop arc.
"""

from __future__ import annotations

import bisect
import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.timing.jerk_phases import MotionState, Phases, state_after

if TYPE_CHECKING:
    from optdock.geometry.arrays import BoolArray, FloatArray, IntArray
    from optdock.timing.forward_backward import SpeedProfile
    from optdock.timing.path_limits import PathLimits, ReferenceBounds

__all__ = [
    "CRUISE_SAMPLE",
    "LEAST_REST",
    "TUNING",
    "Arc",
    "Grid",
    "grid_of",
    "launch_arc",
    "spread_times",
    "stop_arc",
    "zone_knot",
]

_ARC_DRIVE = 0.7  # share of the acceleration and of the yaw acceleration for an arc
_ARC_SPEED = 0.6  # share of the local speed cap that an arc and its mirror image reach
_ARC_LENGTH = 0.1  # largest length of an arc as a share of the segment
_SLOW = 0.25  # share of the local speed cap below which a moving start also has a launch arc
_HOLD = 0.1  # [s]: time for which the acceleration of a start with v = 0, a > 0 is held first
LEAST_REST = 0.1  # share of the segment that must remain between both arcs

_KNOT_JUMP = 0.02  # share of the yaw acceleration: smaller jumps of v^2 * rate, or of a speed cap, need no knot
_CROWDED = 0.5  # number of jumps per shortest step above which no jump gets a knot
_LEAST_STEP = 0.4  # share of the step: jumps closer together share a cell
_LEAST_CELLS = 8
_CRUISE_DENSITY = 0.5  # factor on the number of knots where the profile is level
_CRUISE_LEVEL = 0.96  # smallest over largest v^2 where the profile is level
_CRUISE_YAW = 0.6  # share of the yaw acceleration above which the profile is not level
CRUISE_SAMPLE, _CRUISE_REACH = 0.06, 8  # [s]: spacing of the samples; their number on either side
# For the kernel, in the order of `Tuning` there.
TUNING = (
    *(_ARC_DRIVE, _ARC_SPEED, _ARC_LENGTH, _SLOW, _HOLD, LEAST_REST),
    *(_KNOT_JUMP, _CROWDED, _LEAST_STEP, _LEAST_CELLS),
    *(_CRUISE_DENSITY, _CRUISE_LEVEL, _CRUISE_YAW, CRUISE_SAMPLE, _CRUISE_REACH),
)


class Arc(NamedTuple):
    """Phases at one end of the reference, and the state at which they join it."""

    phases: Phases
    state: MotionState


def stop_arc(bounds: ReferenceBounds) -> Arc:
    """Return the arc of constant +J to rest at the end, with length J t^3 / 6, from v = J t^2 / 2, a = -J t."""
    jerk = bounds.jerk
    a = _end_acceleration(bounds, bounds.limits.drive.max_deceleration, 0.0, 0.0, at_end=True)
    time = a / jerk
    return Arc(((time, jerk),), MotionState(bounds.limits.length - jerk * time**3 / 6.0, 0.5 * jerk * time * time, -a))


def launch_arc(bounds: ReferenceBounds, start: MotionState) -> Arc:
    """Return the arc of constant +J from rest or a low speed; for a faster start, the arc has no phases."""
    jerk = bounds.jerk
    a = _end_acceleration(bounds, bounds.limits.drive.max_acceleration, start.v, start.a, at_end=False)
    if start.v * start.v >= _SLOW**2 * bounds.first_cap:
        return Arc((), start)
    if start.a < a:
        phase = ((a - start.a) / jerk, jerk)
    elif start.v < 0.5 * start.a * _HOLD:
        phase = (_HOLD, 0.0)
    else:
        return Arc((), start)
    return Arc((phase,), state_after(start, *phase))


def _end_acceleration(bounds: ReferenceBounds, drive: float, v: float, a: float, *, at_end: bool) -> float:
    """Return the end acceleration of an arc of jerk J for which the arc and its mirror image stay below the caps."""
    limits, jerk = bounds.limits, bounds.jerk
    top = max(_ARC_DRIVE * drive, a)
    reach = max(state_after(MotionState(0.0, v, a), (top - a) / jerk, jerk).s, 1e-9)
    if at_end:
        cells = slice(max(0, int(limits.s.searchsorted(limits.length - reach)) - 1), None)
    else:
        cells = slice(0, int(limits.s.searchsorted(reach)) + 1)
    bend, rate = float(np.abs(limits.curvature[cells]).max()), float(limits.steepest[cells].max())
    caps = math.sqrt(float(bounds.speed_squared[cells].min())), *(limit.fastest(rate) for limit in limits.turning)
    return min(
        math.sqrt(max(0.0, jerk * (_ARC_SPEED * min(caps) - v) + 0.5 * a * a)),
        top,
        *(limit.arc_acceleration(v, jerk, bend, _ARC_DRIVE) for limit in limits.turning),
        math.pow(6.0 * _ARC_LENGTH * limits.length * jerk * jerk, 1.0 / 3.0),
    )


class Grid(NamedTuple):
    """Knots of the reference and limits at the knots."""

    knots: FloatArray  # Shape (M + 1,) [m]
    steps: FloatArray  # Shape (M,) [m]
    bound: FloatArray  # largest v^2 at the knots, the minimum over both half cells around, Shape (M + 1,) [m^2/s^2]
    curvature: FloatArray  # at the knots, Shape (M + 1,) [1/m]
    rate: FloatArray  # largest and least of the rates on both sides of the knots, Shape (2, M + 1) [1/m^2]
    turning: tuple[FloatArray, ...]  # turning limits for the reference at the knots, Shape (M + 1,) each
    centre_curvature: FloatArray  # at the cell centres, Shape (M,) [1/m]
    centre_rate: FloatArray  # as `rate`, at the cell centres, Shape (2, M) [1/m^2]
    zone: int  # index of the knot at the zone start; 0 if the zone does not start between the end knots
    time: FloatArray  # pseudo time of the knots, Shape (M + 1,) [s]


def grid_of(bounds: ReferenceBounds, profile: SpeedProfile, first: MotionState, last: MotionState) -> Grid:
    """Return knots from `first` to `last`, at large jumps and every step of profile time, or two at constant speed."""
    limits, step = bounds.limits, bounds.step
    clock = _cruise_clock(bounds, profile)
    jumps = bounds.jumps[_jump_sizes(bounds, profile, bounds.jumps) > _KNOT_JUMP]
    breaks = _breaks(bounds, profile, (first, last), jumps)
    times = np.interp(breaks, limits.s, clock)
    spans = times[1:] - times[:-1]
    parts = np.maximum(1, np.rint(spans / step)).astype(np.int64)
    parts[spans.argmax()] += max(0, _LEAST_CELLS - int(parts.sum()))
    owner = np.arange(parts.size).repeat(parts)
    rank = np.arange(owner.size) - (parts.cumsum() - parts).repeat(parts)
    inner = np.interp(times[owner] + spans[owner] * rank / parts[owner], clock, limits.s)
    knots = np.concatenate((np.where(rank == 0, breaks[owner], inner), breaks[-1:]))
    return _limits_on(bounds, profile, knots, limits.s[jumps])


def _cruise_clock(bounds: ReferenceBounds, profile: SpeedProfile) -> FloatArray:
    """Return the pseudo time at the nodes, slowed down where the speed is constant and needs few knots."""
    limits = bounds.limits
    total = float(profile.time[-1])
    times = spread_times(total, max(2, int(total / CRUISE_SAMPLE)))
    x: FloatArray = np.interp(times, profile.time, profile.speed_squared)
    for limit in limits.turning:
        at_nodes = limit.at_constant_speed(profile.speed_squared[1:], limits.steepest)
        turning = np.interp(times, profile.time[1:], at_nodes)
        x = np.where(turning > _CRUISE_YAW * limit.bound, 0.0, x)
    padded = np.zeros(x.size + 2 * _CRUISE_REACH)
    padded[_CRUISE_REACH:-_CRUISE_REACH] = x
    around = np.ndarray((x.size, 2 * _CRUISE_REACH + 1), np.float64, padded, strides=2 * padded.strides)
    level = np.minimum.reduce(around, axis=1) > _CRUISE_LEVEL * np.maximum.reduce(around, axis=1)
    density = np.where(level, _CRUISE_DENSITY, 1.0)
    gains = 0.5 * (density[:-1] + density[1:]) * (times[1:] - times[:-1])
    clock = np.concatenate(([0.0], gains.cumsum()))
    spread: FloatArray = np.interp(profile.time, times, clock)
    return spread


def spread_times(total: float, count: int) -> FloatArray:
    """Return `count` + 1 times from 0 to `total`."""
    times: FloatArray = np.arange(count + 1, dtype=np.float64) * (total / count)
    times[-1] = total
    return times


def _breaks(
    bounds: ReferenceBounds, profile: SpeedProfile, ends: tuple[MotionState, MotionState], jumps: IntArray
) -> FloatArray:
    """Return the required knots: both ends, the zone start, and the largest jumps that are far enough apart."""
    limits, (first, last) = bounds.limits, ends
    gap = _LEAST_STEP * bounds.step
    fixed = [first.s, last.s]
    if limits.has_zone and first.s + 1e-9 < limits.zone_start < last.s - 1e-9:
        fixed.append(limits.zone_start)
    found = jumps[(limits.s[jumps] > first.s) & (limits.s[jumps] < last.s)]
    if found.size * gap > _CROWDED * (profile.time[-1] - profile.time[0]):
        found = found[:0]
    taken = sorted(np.interp(fixed, limits.s, profile.time).tolist())
    size = _jump_sizes(bounds, profile, found)
    for i in found[(-size).argsort(kind="stable")].tolist():
        time = float(profile.time[i])
        place = min(max(bisect.bisect(taken, time), 1), len(taken) - 1)  # both ends are already in the list
        if taken[place] - time > gap and time - taken[place - 1] > gap:
            taken.insert(place, time)
            fixed.append(float(limits.s[i]))
    if first.a < 0.0:  # the coefficient v^2 + a h of the first cell must stay positive
        nearest = first.s - 0.4 * first.v * first.v / first.a
        if nearest < min(s for s in fixed if s > first.s):
            fixed.append(nearest)
    return np.array(sorted(fixed))


def _jump_sizes(bounds: ReferenceBounds, profile: SpeedProfile, nodes: IntArray) -> FloatArray:
    """Return each node's jump: the larger of its ratio to the turning limits and v times the jump of 1 / speed cap."""
    limits, x = bounds.limits, profile.speed_squared[nodes]
    jump = np.abs(limits.rate_left[nodes] - limits.rate_right[nodes - 1])
    sizes: FloatArray = np.zeros(nodes.size)
    for limit in limits.turning:
        sizes = np.maximum(sizes, limit.at_constant_speed(x, jump) / limit.bound)
    if limits.caps.steering:
        sizes = np.maximum(sizes, np.sqrt(x) * np.abs(limits.slowness_left[nodes] - limits.slowness_right[nodes - 1]))
    return sizes


def _limits_on(bounds: ReferenceBounds, profile: SpeedProfile, knots: FloatArray, jumps: FloatArray) -> Grid:
    limits = bounds.limits
    centres = 0.5 * (knots[:-1] + knots[1:])
    cells = limits.cells_at(np.concatenate((knots[:1], centres, knots[-1:])))
    cells[-1] = limits.s.size - 2
    curvature, right, _slow = bounds.curve_at(knots)
    _k, left, _slow = bounds.curve_at(knots - 1e-9)
    centre_curvature, centre_rate, _slow = bounds.curve_at(centres)
    rate = np.array((np.maximum(left, right), np.minimum(left, right)))
    centre_rate = np.array((centre_rate, centre_rate))
    hidden = _hidden_jumps(jumps, knots)
    if hidden.any():
        rate, centre_rate = _extremes(limits, knots, hidden, rate, centre_rate)
    return Grid(
        knots=knots,
        steps=knots[1:] - knots[:-1],
        bound=_least_between(bounds.speed_squared, cells[:-1], cells[1:]),
        curvature=curvature,
        rate=rate,
        turning=tuple(_least_between(bound, cells[:-1], cells[1:]) for bound in bounds.turning),
        centre_curvature=centre_curvature,
        centre_rate=centre_rate,
        zone=zone_knot(limits, knots),
        time=np.interp(knots, limits.s, profile.time),
    )


def zone_knot(limits: PathLimits, knots: FloatArray) -> int:
    """Return the index of the knot at the zone start, or 0 if the zone does not start between the end knots."""
    zone = int(knots.searchsorted(limits.zone_start - 1e-12)) if limits.has_zone else 0
    return 0 if zone >= knots.size - 1 else zone


def _hidden_jumps(places: FloatArray, knots: FloatArray) -> BoolArray:
    """Return, for each cell of the grid, whether it contains a jump without a knot. Shape (M,)."""
    nearest = knots[np.minimum(knots.searchsorted(places - 1e-9), knots.size - 1)]
    places = places[np.abs(nearest - places) > 1e-9]
    counts = places.searchsorted(knots)
    found: BoolArray = counts[1:] > counts[:-1]
    return found


def _extremes(
    limits: PathLimits, knots: FloatArray, hidden: BoolArray, rate: FloatArray, centre_rate: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the extreme rates at knots and centres, over the half cells around them if a cell hides a jump."""
    quarter = 0.25 * np.diff(knots)
    borders = np.stack((knots[:-1] + quarter, knots[1:] - quarter), axis=1).ravel()
    cells = limits.cells_at(np.concatenate((knots[:1], borders, knots[-1:] - 1e-9)))
    high = np.maximum(limits.rate_left, limits.rate_right)
    low = np.minimum(limits.rate_left, limits.rate_right)
    spread = np.stack((-_least_between(-high, cells[:-1], cells[1:]), _least_between(low, cells[:-1], cells[1:])))
    beside = np.append(hidden, False) | np.insert(hidden, 0, False)
    return np.where(beside, spread[:, ::2], rate), np.where(hidden, spread[:, 1::2], centre_rate)


def _least_between(values: FloatArray, first: IntArray, last: IntArray) -> FloatArray:
    """Return the minimum of `values[first[i] : last[i] + 1]` for every i."""
    pairs = np.empty(2 * first.size, dtype=np.int64)
    pairs[::2], pairs[1::2] = first, last + 1
    least: FloatArray = np.minimum.reduceat(np.concatenate((values, [np.inf])), pairs)[::2]
    return least
