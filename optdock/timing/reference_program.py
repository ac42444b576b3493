"""The reference program: a quadratic C1 spline of x = v^2 over arc length, convex except for jerk.

With x = v^2, the acceleration is x' / 2 and the yaw acceleration is k x' / 2 + k' x. Both are linear in x and x', and
the duration, the integral of 1 / sqrt(x), is convex [Verscheure2009]. The jerk x'' sqrt(x) / 2 is not linear. A turning
limit of order 2 has the same form, linear in x and x', times the speed. Every quadratic spline of x is a motion, so a
jerk-limited move exists between the states at any two of its knots.

    minimize   sum h_m / sqrt(c_{m+1})  (+ a penalty on jerk steps between cells, which prevents chattering)
    subject to x_i <= X_i,  -D <= a_i <= A,  |n k a + k' x| v^(n - 1) <= the turning limits of order n   at the knots,
               |n k a + k' x| v^(n - 1) <= the same,  |x''| vmax <= 2 J                                    in the cells.

At v = 0 the formulation in x is singular: jerk-limited motion leaves rest as x ~ s^(4/3), and a spline with zero slope
and zero value never moves. Therefore two arcs of constant jerk connect the reference to rest: the launch arc and the
stop arc.

Order of this module: the arcs, the knots and their limits, the linear maps of the spline, the constraints,
the initial guess, the solution, and its motion.
"""

from __future__ import annotations

import bisect
import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.deadline import ENDLESS
from optdock.kernels import Kernel, twin_of
from optdock.timing.forward_backward import SpeedProfile, forward_backward_pass
from optdock.timing.interior_point import Program, applied, solve
from optdock.timing.jerk_phases import MotionState, Phases, state_after

if TYPE_CHECKING:
    from optdock.deadline import Deadline
    from optdock.geometry.arrays import BoolArray, FloatArray, IntArray
    from optdock.timing.path_limits import PathLimits, ReferenceBounds

__all__ = [
    "Arc",
    "Grid",
    "LimitRows",
    "Prepared",
    "ReferenceStates",
    "Spline",
    "coefficients_of",
    "grid_of",
    "initial_guess",
    "jerk_step_bands",
    "launch_arc",
    "limit_rows",
    "prepared",
    "solve_reference",
    "spline_of",
    "spline_phases",
    "stop_arc",
]


_ARC_DRIVE = 0.7  # share of the acceleration and of the yaw acceleration for an arc
_ARC_SPEED = 0.6  # share of the local speed cap that an arc and its mirror image reach
_ARC_LENGTH = 0.1  # largest length of an arc as a share of the segment
_SLOW = 0.25  # share of the local speed cap below which a moving start also has a launch arc
_HOLD = 0.1  # [s]: time for which the acceleration of a start with v = 0, a > 0 is held first
_LEAST_REST = 0.1  # share of the segment that must remain between both arcs

_KNOT_JUMP = 0.02  # share of the yaw acceleration: smaller jumps of v^2 * rate, or of a speed cap, need no knot
_CROWDED = 0.5  # number of jumps per shortest step above which no jump gets a knot
_LEAST_STEP = 0.4  # share of the step: jumps closer together share a cell
_LEAST_CELLS = 8
_CRUISE_DENSITY = 0.5  # factor on the number of knots where the profile is level
_CRUISE_LEVEL = 0.96  # smallest over largest v^2 where the profile is level
_CRUISE_YAW = 0.6  # share of the yaw acceleration above which the profile is not level
_CRUISE_SAMPLE, _CRUISE_REACH = 0.06, 8  # [s]: spacing of the samples; their number on either side

_GUESS_SAMPLE = 0.02  # [s]: sampling period of the filter
_GUESS_SHARE = 0.9  # factor on the filtered v^2, to stay inside the limits
_GUESS_BLEND = 0.6  # [s]: time over which the guess changes from the speed of a moving start

_DRIVE_MARGIN = 0.003  # share of acceleration and deceleration, because ruckig refuses a state beyond them
_JERK_STEP_PRICE = (
    0.002  # [s]: price of a full swing of the jerk between cells; it saves a sixth of the moves for 0.01 % of time
)
_SMOOTH_JERK_STEP_PRICE = 0.1  # [s]: the same if the reference itself is the motion
# A reference that is slower than the bounds by this factor is not a solution. If no spline keeps the limits, the last
# iterate is arbitrary, and the samples of a motion of weeks would exhaust the memory. For solutions the factor is below
# 4.
_HOPELESS = 10.0


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
    if start.v * start.v >= _SLOW**2 * float(bounds.cap_squared[0]):
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
    zone: int  # index of the knot at the zone start; 0 if there is none inside
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
    times = _spread(total, max(2, int(total / _CRUISE_SAMPLE)))
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


def _spread(total: float, count: int) -> FloatArray:
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
    zone = int(knots.searchsorted(limits.zone_start - 1e-12)) if limits.has_zone else 0
    return Grid(
        knots=knots,
        steps=knots[1:] - knots[:-1],
        bound=_least_between(bounds.speed_squared, cells[:-1], cells[1:]),
        curvature=curvature,
        rate=rate,
        turning=tuple(_least_between(bound, cells[:-1], cells[1:]) for bound in bounds.turning),
        centre_curvature=centre_curvature,
        centre_rate=centre_rate,
        zone=0 if zone >= knots.size - 1 else zone,
        time=np.interp(knots, limits.s, profile.time),
    )


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


class Spline(NamedTuple):
    """Linear maps of the coefficients, as stencils on c_m, c_{m+1}, c_{m+2} of cell m; Shape (3, M) each.

    Knot i: x_i = wl c_i + wr c_{i+1}, wr = h_{i-1} / (h_{i-1} + h_i), a_i = (c_{i+1} - c_i) / (h_{i-1} + h_i).
    Cell m: x'' = 2 (a_{m+1} - a_m) / h_m, centre x = (x_m + x_{m+1}) / 2 - x'' h^2 / 8.
    """

    right_value: FloatArray  # x at the right knot of the cell
    right_slope: FloatArray  # acceleration there
    centre_value: FloatArray  # x at the centre
    centre_slope: FloatArray  # acceleration there
    curve: FloatArray  # x''
    right_share: FloatArray  # weight wr of c_{i+1} in x_i, Shape (M + 1,)


def spline_of(steps: FloatArray) -> Spline:
    """Return the maps of a spline with cells of lengths `steps`, Shape (M,) [m]."""
    padded = np.concatenate((steps[:1], steps, steps[-1:]))
    both = padded[:-1] + padded[1:]
    right_share = padded[:-1] / both
    value = np.array((1.0 - right_share, right_share))  # (2, M + 1) on c_i, c_{i+1}
    slope = np.array((-1.0 / both, 1.0 / both))
    zero = np.zeros((1, steps.size))
    left_value, left_slope = (np.concatenate((part[:, :-1], zero)) for part in (value, slope))
    right_value, right_slope = (np.concatenate((zero, part[:, 1:])) for part in (value, slope))
    curve = 2.0 * (right_slope - left_slope) / steps
    centre_value = 0.5 * (left_value + right_value) - curve * (steps * steps / 8.0)
    return Spline(right_value, right_slope, centre_value, 0.5 * (left_slope + right_slope), curve, right_share)


def coefficients_of(steps: FloatArray, guess: FloatArray, first: MotionState, last: MotionState) -> FloatArray:
    """Return coefficients for `guess`, v^2 at the knots; the two coefficients at each end are exact: c = x -+ a h."""
    middle = 0.5 * (guess[:-1] + guess[1:])
    c = np.concatenate(([0.0], np.maximum(middle, 1e-3 * max(float(middle.max()), 1e-12)), [0.0]))
    x0, x1 = first.v * first.v, last.v * last.v
    c[0], c[1] = x0 - first.a * steps[0], x0 + first.a * steps[0]
    c[-2], c[-1] = x1 - last.a * steps[-1], x1 + last.a * steps[-1]
    return c


class LimitRows(NamedTuple):
    """Constraints on the coefficients c as stencils, Shape (3, rows, M); see `applied` for the products A c."""

    linear: FloatArray  # A c <= 1
    with_speed: FloatArray  # A c v <= 1 with the speed v at one place of the cell
    places: FloatArray  # stencils of v^2 at this place, for each of `with_speed`


def limit_rows(grid: Grid, bounds: ReferenceBounds, spline: Spline) -> LimitRows:
    """Return the constraints on speed, acceleration, deceleration and turning at knots and centres.

    At a knot the rows of turning limits use the largest and the least rate of both sides, which suffices because x >=
    0. The rows of the last knot, whose state is given, are zero.
    """
    value, slope = spline.right_value, spline.right_slope
    drive, share = bounds.limits.drive, 1.0 - _DRIVE_MARGIN
    rows = [value / grid.bound[1:], slope / (share * drive.max_acceleration), -slope / (share * drive.max_deceleration)]
    centres: list[FloatArray] = []
    with_speed: tuple[list[FloatArray], list[FloatArray]] = [], []
    for limit, most in zip(bounds.limits.turning, grid.turning, strict=True):
        at_knots = _turning_rows(value, limit.order * grid.curvature[1:] * slope, grid.rate[:, 1:], most[1:])
        turn = limit.order * grid.centre_curvature * spline.centre_slope
        at_centres = _turning_rows(spline.centre_value, turn, grid.centre_rate, 0.5 * (most[:-1] + most[1:]))
        for found, more in zip(
            (rows, centres) if limit.order == 1 else with_speed, (at_knots, at_centres), strict=True
        ):
            found.extend(more)
    for row in (*rows, *with_speed[0]):
        row[:, -1] = 0.0
    places = [value] * len(with_speed[0]) + [spline.centre_value] * len(with_speed[1])
    none = np.zeros((3, 0, grid.steps.size))
    columns = ([*rows, *centres], [*with_speed[0], *with_speed[1]], places)
    return LimitRows(*(np.stack(found, axis=1) if found else none for found in columns))


def _turning_rows(value: FloatArray, turn: FloatArray, rate: FloatArray, most: FloatArray) -> list[FloatArray]:
    """Return both signs of the quantity of a turning limit, without powers of the speed, divided by its bounds."""
    return [(turn + rate[0] * value) / most, -(turn + rate[1] * value) / most]


def jerk_step_bands(spline: Spline, weight: FloatArray) -> FloatArray:
    """Return the bands of Q, c' Q c / 2 = sum of (weight * step of x'' between cells)^2; weight Shape (M - 1,).

    Shape (4, M + 2): entry (3 - d, j) is Q[j - d, j].
    """
    left, right, zero = spline.curve[:, :-1], spline.curve[:, 1:], np.zeros((1, weight.size))
    row = weight * (np.concatenate((zero, right)) - np.concatenate((left, zero)))  # (4, M - 1) on c_m .. c_{m+3}
    bands = np.zeros((4, weight.size + 3))
    for offset in range(4):
        for i in range(4 - offset):
            bands[3 - offset, i + offset : i + offset + weight.size] += 2.0 * row[i] * row[i + offset]
    return bands


def initial_guess(
    grid: Grid, bounds: ReferenceBounds, profile: SpeedProfile, first: MotionState, last: MotionState
) -> FloatArray:
    """Return the initial guess of the interior point method: v^2 at the knots, Shape (M + 1,) [m^2/s^2].

    The guess is the acceleration-limited profile, averaged over the time in which the jerk changes the acceleration
    from one limit to the other, and limited by the launch and stop arcs. This guess halves the number of iterations to
    about 10.
    """
    time = grid.time
    count, samples = _filter(bounds, profile)
    times = _spread(float(profile.time[-1]), count)
    values = np.interp(times, profile.time, profile.speed_squared)
    padded = np.zeros(values.size + 2 * samples + 1)
    padded[samples + 1 : samples + 1 + values.size] = values
    sums = padded.cumsum()
    mean = (sums[2 * samples + 1 :] - sums[: -2 * samples - 1]) / (2 * samples + 1)  # box filter
    x = _GUESS_SHARE * np.interp(time, times, mean)
    since, until = time - time[0], time[-1] - time
    if first.v > 0.0:
        share = np.minimum(1.0, since / _GUESS_BLEND)
        x = (1.0 - share) * first.v**2 + share * x
    jerk = bounds.jerk
    launch = np.maximum(first.v + since * (first.a + 0.5 * jerk * since), 0.1 * first.v + 1e-4)
    stop = last.v + until * (-last.a + 0.5 * jerk * until)
    below: FloatArray = np.minimum(x, np.minimum(launch, stop) ** 2)
    return below


def _filter(bounds: ReferenceBounds, profile: SpeedProfile) -> tuple[int, int]:
    """Return the number of periods of the filtered profile, and half the width of the filter in periods."""
    drive, total = bounds.limits.drive, float(profile.time[-1])
    count = max(2, int(total / _GUESS_SAMPLE))
    # The acceleration cannot exceed sqrt(peak * jerk) before the speed is at its peak.
    reachable = math.sqrt(drive.max_jerk * math.sqrt(float(profile.speed_squared.max())))
    half = 0.5 * (min(drive.max_acceleration, reachable) + min(drive.max_deceleration, reachable)) / drive.max_jerk
    return count, min(count + 1, int(half * count / total) + 1)


class Prepared(NamedTuple):
    """The reference program, with its first coefficients and the stencil of x''."""

    program: Program
    first: FloatArray  # Shape (M + 2,)
    curve: FloatArray  # Shape (3, M)


_KERNEL = Kernel("optdock_reference_program", sizes=6, numbers=15)


def _prepared_native(
    bounds: ReferenceBounds, profile: SpeedProfile, grid: Grid, first: MotionState, last: MotionState
) -> Prepared:
    limits, drive, m = bounds.limits.turning, bounds.limits.drive, grid.steps.size
    curved = sum(limit.order == 2 for limit in limits)
    rows, curved_rows = 3 + 4 * (len(limits) - curved), 2 + 4 * curved
    count, half = _filter(bounds, profile)
    knots = (grid.bound, grid.curvature, *grid.rate, grid.time, *grid.turning)
    cells = (grid.steps, grid.centre_curvature, *grid.centre_rate)
    size, nodes, work = 3 * (rows + 2 * curved_rows) * m + 9, profile.time.size, 17 * m + 3 * count + 2 * half + 5
    data, coefficients = np.empty(size), np.empty(4 * m + 2)
    orders = [*(float(limit.order) for limit in limits), 0.0, 0.0][:2]
    ends = (first.v, first.v**2, first.a, last.v, last.v**2, last.a)
    share = 1.0 - _DRIVE_MARGIN
    most = (share * drive.max_acceleration, share * drive.max_deceleration, bounds.jerk, _price(bounds))
    done = _KERNEL(
        (m, len(limits), curved, nodes, count + 1, half),
        (*most, float(profile.time[-1]), _GUESS_SHARE, _GUESS_BLEND, *ends, *orders),
        (
            (np.concatenate(knots), (5 + len(limits)) * (m + 1)),
            (np.concatenate(cells), 4 * m),
            (np.concatenate(profile), 2 * nodes),
            (data, size),
            (coefficients, 4 * m + 2),
            (np.empty(work), work),
        ),
    )
    if done < 0:
        raise ValueError("reference program: needs at least two cells and at most two turning limits")
    return Prepared(
        Program.packed(data, m, rows, curved_rows), coefficients[: m + 2], coefficients[m + 2 :].reshape(3, m)
    )


@twin_of(_prepared_native)
def prepared(
    bounds: ReferenceBounds, profile: SpeedProfile, grid: Grid, first: MotionState, last: MotionState
) -> Prepared:
    """Return the reference program on a grid from `first` to `last`, and its first coefficients."""
    guess, spline = initial_guess(grid, bounds, profile, first, last), spline_of(grid.steps)
    # A swing from -J to J is a step of x'' by 4 J / v.
    bands = jerk_step_bands(spline, np.sqrt(0.5 * _price(bounds) * guess[1:-1]) / (4.0 * bounds.jerk))
    rows, curve = limit_rows(grid, bounds, spline), spline.curve / (2.0 * bounds.jerk)
    with_speed = np.concatenate((np.stack((curve, -curve), axis=1), rows.with_speed), axis=1)
    program = Program(grid.steps, rows.linear, with_speed, rows.places, spline.right_share, bands)
    return Prepared(program, coefficients_of(grid.steps, guess, first, last), spline.curve)


def _price(bounds: ReferenceBounds) -> float:
    return _SMOOTH_JERK_STEP_PRICE if bounds.smooth else _JERK_STEP_PRICE


class ReferenceStates(NamedTuple):
    """States at the knots of the spline, and the arcs on both sides of it."""

    s: FloatArray  # Shape (M + 1,) [m]
    v: FloatArray  # Shape (M + 1,) [m/s]
    a: FloatArray  # Shape (M + 1,) [m/s^2]
    curve: FloatArray  # x'' of the cells, Shape (M,) [1/s^2]
    grid: Grid  # the knots
    launch: Arc  # arc before the spline, possibly without phases
    stop: Arc  # arc after the spline
    iterations: int  # iterations of the interior point method

    @property
    def durations(self) -> FloatArray:
        """Durations of the cells, in which the acceleration is linear in s, Shape (M,) [s]."""
        durations: FloatArray = 2.0 * (self.s[1:] - self.s[:-1]) / (self.v[:-1] + self.v[1:])
        return durations


def solve_reference(
    bounds: ReferenceBounds, start: MotionState, deadline: Deadline = ENDLESS
) -> ReferenceStates | None:
    """Return the fastest spline under `bounds` from a start state to rest, with its arcs.

    Return None if the launch and stop arcs are too long for the segment, or if no spline satisfies the limits.

    Raises:
        OutOfTime: If the deadline passed.
    """
    deadline.look()
    limits = bounds.limits
    profile = forward_backward_pass(bounds, start)
    launch, stop = launch_arc(bounds, start), stop_arc(bounds)
    first, last = launch.state, stop.state
    if last.s - first.s < _LEAST_REST * limits.length:
        return None
    grid = grid_of(bounds, profile, first, last)
    program, c, curve = prepared(bounds, profile, grid, first, last)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # slacks without a feasible spline
        c, iterations = solve(program, c, deadline.look)
    x = (1.0 - program.right_share) * c[:-1] + program.right_share * c[1:]
    padded = np.concatenate((grid.steps[:1], grid.steps, grid.steps[-1:]))
    slope = 1.0 / (padded[:-1] + padded[1:])
    v, a = np.sqrt(np.maximum(x, 1e-12)), slope * c[1:] - slope * c[:-1]
    a = np.minimum(np.maximum(a, -limits.drive.max_deceleration), limits.drive.max_acceleration)
    v[0], a[0], v[-1], a[-1] = first.v, first.a, last.v, last.a
    found = ReferenceStates(grid.knots, v, a, applied(curve, c), grid, launch, stop, iterations)
    longest = _HOPELESS * max(limits.duration_estimate, float(profile.time[-1]))
    return found if float(found.durations.sum()) <= longest else None


def spline_phases(s: FloatArray, v: FloatArray, a: FloatArray) -> Phases:
    """Return the reference as a motion with two phases of equal duration h per cell, exact at the knots.

    The gains dv and da of speed and acceleration over a cell give j1 = Q - P / 2 and j2 = 3 P / 2 - Q with P = da / h,
    Q = (dv - 2 a h) / h^2. The distance (2 v + dv) h - da h^2 / 3 then determines h. Shapes (n,).
    """
    ds, dv, da = np.diff(s), np.diff(v), np.diff(a)
    both = v[:-1] + v[1:]
    h = 2.0 * ds / (both + np.sqrt(np.maximum(both * both - 4.0 / 3.0 * da * ds, 0.0)))
    gain, curve = da / h, (dv - 2.0 * a[:-1] * h) / (h * h)
    first, second = curve - 0.5 * gain, 1.5 * gain - curve
    phases = np.stack((np.repeat(h, 2), np.stack((first, second), axis=1).ravel()), axis=1)
    return tuple((duration, jerk) for duration, jerk in phases.tolist())
