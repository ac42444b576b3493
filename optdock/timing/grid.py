"""The knots of the reference: uniform in pseudo time, on every place where the limits jump."""

from __future__ import annotations

import bisect
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from optdock.geometry.arrays import BoolArray, FloatArray, IntArray
    from optdock.timing.bounds import Bounds
    from optdock.timing.motion import State

__all__ = ["Grid", "Profile", "acceleration_profile", "grid_of"]

_JUMP_SHARE = 0.02  # of the yaw acceleration: smaller jumps of v^2 * rate need no knot
_CROWDED = 0.5  # jumps per shortest step: beyond it no knot is put on any of them
_MIN_STEP_SHARE = 0.4  # of the step: jumps closer together share a knot's cell
_MIN_CELLS = 8
_CRUISE_PACE = 0.5  # knots per knot elsewhere, where the profile stays level
_CRUISE_LEVEL = 0.96  # least over largest v^2 of a level stretch
_CRUISE_YAW = 0.6  # of the yaw acceleration: more needs the knots
_CRUISE_SAMPLE, _CRUISE_REACH = 0.06, 8  # [s] and samples to either side that must be level too
_SLOWEST = 1e-4  # [m/s]: pseudo time counts no speed below this


class Profile(NamedTuple):
    """The acceleration-limited speed profile on the nodes of the course: v^2 [m^2/s^2] and time [s], Shape (n,)."""

    speed_squared: FloatArray
    time: FloatArray


class Grid(NamedTuple):
    """Knots of the reference and the limits there.

    Attributes:
        knots: Shape (M + 1,) [m].
        steps: Shape (M,) [m].
        bound: Largest v^2 at the knots, the least of both half cells around, Shape (M + 1,) [m^2/s^2].
        curvature: At the knots, Shape (M + 1,) [1/m].
        rate: Largest and least of the rates on both sides of the knots, Shape (2, M + 1) [1/m^2].
        yaw: Yaw acceleration for the reference, at the knots, Shape (M + 1,) [rad/s^2].
        centre_curvature: At the cell centres, Shape (M,) [1/m].
        centre_rate: As `rate`, at the cell centres, Shape (2, M) [1/m^2].
        zone: Index of the knot at the zone start; 0 without one inside.
        time: Pseudo time of the knots, Shape (M + 1,) [s].
    """

    knots: FloatArray
    steps: FloatArray
    bound: FloatArray
    curvature: FloatArray
    rate: FloatArray
    yaw: FloatArray
    centre_curvature: FloatArray
    centre_rate: FloatArray
    zone: int
    time: FloatArray


def acceleration_profile(bounds: Bounds, start: State) -> Profile:
    """The fastest v^2 under caps, acceleration and deceleration alone, yaw acceleration as a cap at a = 0."""
    course, limits = bounds.course, bounds.course.limits
    rate = np.maximum(np.abs(course.rate_left), np.abs(course.rate_right))
    cell = np.minimum(bounds.speed_squared, bounds.yaw / np.maximum(rate, 1e-9))
    x = np.minimum(np.append(cell, 0.0), np.insert(cell, 0, start.v * start.v))
    rise, fall = 2.0 * limits.max_acceleration * course.s, 2.0 * limits.max_deceleration * course.s
    x = np.minimum.accumulate(x - rise) + rise
    x = (np.minimum.accumulate((x + fall)[::-1]))[::-1] - fall
    x = np.maximum(x, 0.0)
    v = np.sqrt(x)
    gain = 2.0 * np.diff(course.s) / np.maximum(v[:-1] + v[1:], _SLOWEST)
    return Profile(x, np.concatenate(([0.0], np.cumsum(gain))))


def grid_of(bounds: Bounds, profile: Profile, first: State, last: State, step: float) -> Grid:
    """Knots from `first` to `last`, about `step` [s] of pseudo time apart, wider where the robot cruises."""
    course = bounds.course
    clock = _clock(bounds, profile)
    jumps = _large_jumps(bounds, profile)
    breaks = _breaks(bounds, profile, (first, last), jumps, _MIN_STEP_SHARE * step)
    times = np.interp(breaks, course.s, clock)
    parts = np.maximum(1, np.rint(np.diff(times) / step)).astype(np.int64)
    parts[np.argmax(np.diff(times))] += max(0, _MIN_CELLS - int(parts.sum()))
    owner = np.repeat(np.arange(parts.size), parts)
    rank = np.arange(owner.size) - np.repeat(np.cumsum(parts) - parts, parts)
    inner = np.interp(times[owner] + np.diff(times)[owner] * rank / parts[owner], clock, course.s)
    knots = np.append(np.where(rank == 0, breaks[owner], inner), breaks[-1])
    return _limits_on(bounds, profile, knots, course.s[jumps])


def _clock(bounds: Bounds, profile: Profile) -> FloatArray:
    """Pseudo time at the nodes, running slower where the profile stays level: few knots are needed there."""
    total = float(profile.time[-1])
    times = np.linspace(0.0, total, max(2, int(total / _CRUISE_SAMPLE)) + 1)
    x = np.interp(times, profile.time, profile.speed_squared)
    rate = np.maximum(np.abs(bounds.course.rate_left), np.abs(bounds.course.rate_right))
    turning = np.interp(times, profile.time[1:], profile.speed_squared[1:] * rate)
    x = np.where(turning > _CRUISE_YAW * bounds.course.limits.max_yaw_acceleration, 0.0, x)
    around = np.lib.stride_tricks.sliding_window_view(np.pad(x, _CRUISE_REACH), 2 * _CRUISE_REACH + 1)
    level = around.min(axis=1) > _CRUISE_LEVEL * around.max(axis=1)
    pace = np.where(level, _CRUISE_PACE, 1.0)
    clock = np.concatenate(([0.0], np.cumsum(0.5 * (pace[:-1] + pace[1:]) * np.diff(times))))
    paced: FloatArray = np.interp(profile.time, times, clock)
    return paced


def _breaks(bounds: Bounds, profile: Profile, ends: tuple[State, State], jumps: IntArray, gap: float) -> FloatArray:
    """Where a knot must be: both ends, the zone start; the largest jumps of the rate, at least `gap` [s] apart."""
    course, (first, last) = bounds.course, ends
    fixed = [first.s, last.s]
    if course.has_zone and first.s + 1e-9 < course.zone_start < last.s - 1e-9:
        fixed.append(course.zone_start)
    found = jumps[(course.s[jumps] > first.s) & (course.s[jumps] < last.s)]
    if found.size * gap > _CROWDED * (profile.time[-1] - profile.time[0]):
        found = found[:0]
    taken = np.sort(np.interp(fixed, course.s, profile.time)).tolist()
    size = _jump_sizes(bounds, profile, found)
    for i in found[np.argsort(-size, kind="stable")].tolist():
        time = float(profile.time[i])
        place = min(max(bisect.bisect(taken, time), 1), len(taken) - 1)  # both ends are taken
        if taken[place] - time > gap and time - taken[place - 1] > gap:
            taken.insert(place, time)
            fixed.append(float(course.s[i]))
    if first.a < 0.0:  # the coefficient v^2 + a h of the first cell must stay positive
        nearest = first.s - 0.4 * first.v * first.v / first.a
        if nearest < min(s for s in fixed if s > first.s):
            fixed.append(nearest)
    return np.array(sorted(fixed))


def _jump_sizes(bounds: Bounds, profile: Profile, nodes: IntArray) -> FloatArray:
    """v^2 times the jump of the curvature rate [rad/s^2]."""
    course = bounds.course
    sizes: FloatArray = np.abs(course.rate_left[nodes] - course.rate_right[nodes - 1]) * profile.speed_squared[nodes]
    return sizes


def _large_jumps(bounds: Bounds, profile: Profile) -> IntArray:
    sizes = _jump_sizes(bounds, profile, bounds.jumps)
    return bounds.jumps[sizes > _JUMP_SHARE * bounds.course.limits.max_yaw_acceleration]


def _limits_on(bounds: Bounds, profile: Profile, knots: FloatArray, jumps: FloatArray) -> Grid:
    course = bounds.course
    centres = 0.5 * (knots[:-1] + knots[1:])
    cells = course.cells_at(np.concatenate((knots[:1], centres, knots[-1:])))
    cells[-1] = course.s.size - 2
    bound = _least_between(bounds.speed_squared, cells[:-1], cells[1:])
    yaw = _least_between(bounds.yaw, cells[:-1], cells[1:])
    curvature, right, _slow = bounds.curve_at(knots)
    _k, left, _slow = bounds.curve_at(knots - 1e-9)
    centre_curvature, centre_rate, _slow = bounds.curve_at(centres)
    rate = np.stack((np.maximum(left, right), np.minimum(left, right)))
    hidden = _hidden_jumps(jumps, knots)
    if hidden.any():
        rate, centre_rate = _extremes(bounds, knots, hidden, rate, np.stack((centre_rate, centre_rate)))
    else:
        centre_rate = np.stack((centre_rate, centre_rate))
    zone = int(np.searchsorted(knots, course.zone_start - 1e-12)) if course.has_zone else 0
    time = np.interp(knots, course.s, profile.time)
    zone = 0 if zone >= knots.size - 1 else zone
    return Grid(knots, np.diff(knots), bound, curvature, rate, yaw, centre_curvature, centre_rate, zone, time)


def _hidden_jumps(places: FloatArray, knots: FloatArray) -> BoolArray:
    """Whether each cell of the grid holds a jump that no knot stands on, Shape (M,)."""
    nearest = knots[np.minimum(np.searchsorted(knots, places - 1e-9), knots.size - 1)]
    places = places[np.abs(nearest - places) > 1e-9]
    counts = np.searchsorted(places, knots)
    found: BoolArray = np.diff(counts) > 0
    return found


def _extremes(
    bounds: Bounds, knots: FloatArray, hidden: BoolArray, rate: FloatArray, centre_rate: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Rates at knots and centres, each over the half cell around it where cells hide jumps."""
    course = bounds.course
    quarter = 0.25 * np.diff(knots)
    borders = np.stack((knots[:-1] + quarter, knots[1:] - quarter), axis=1).ravel()
    cells = course.cells_at(np.concatenate((knots[:1], borders, knots[-1:] - 1e-9)))
    high = np.maximum(course.rate_left, course.rate_right)
    low = np.minimum(course.rate_left, course.rate_right)
    spread = np.stack((-_least_between(-high, cells[:-1], cells[1:]), _least_between(low, cells[:-1], cells[1:])))
    beside = np.append(hidden, False) | np.insert(hidden, 0, False)
    return np.where(beside, spread[:, ::2], rate), np.where(hidden, spread[:, 1::2], centre_rate)


def _least_between(values: FloatArray, first: IntArray, last: IntArray) -> FloatArray:
    """Minimum of `values[first[i] : last[i] + 1]` for every i."""
    pairs = np.stack((first, last + 1), axis=1).ravel()
    least: FloatArray = np.minimum.reduceat(np.append(values, np.inf), pairs)[::2]
    return least
