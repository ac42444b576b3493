"""The reference program: a quadratic C1 spline of x = v^2 over arc length, convex except for jerk.

With x = v^2, the acceleration is x' / 2 and the yaw acceleration is k x' / 2 + k' x. Both are linear in x and x', and
the duration, the integral of 1 / sqrt(x), is convex [Verscheure2009]. The jerk x'' sqrt(x) / 2 is not linear. A turning
limit of order 2 has the same form, linear in x and x', times the speed. Every quadratic spline of x is a motion, so a
jerk-limited move exists between the states at any two of its knots.

    minimize   sum h_m / sqrt(c_{m+1})  (+ a penalty on jerk steps between cells, which prevents chattering)
    subject to x_i <= X_i,  -D <= a_i <= A,  |n k a + k' x| v^(n - 1) <= the turning limits of order n   at the knots,
               |n k a + k' x| v^(n - 1) <= the same,  |x''| vmax <= 2 J                                    in the cells.

Arcs, knots and limits at the knots are made in `reference_grid`. Order of this module: the linear maps of the spline,
the constraints, the initial guess, the solution, and its motion.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.deadline import ENDLESS
from optdock.geometry.arrays import readonly
from optdock.kernels import Kernel, twin_of
from optdock.timing.forward_backward import SLOWEST, SpeedProfile, forward_backward_pass
from optdock.timing.interior_point import (
    AT_ONCE,
    MOST_ITERATIONS,
    SETTINGS,
    Iterate,
    Program,
    advanced,
    applied,
    iterations_at_once,
    solve,
)
from optdock.timing.jerk_phases import MotionState
from optdock.timing.reference_grid import (
    CRUISE_SAMPLE,
    LEAST_REST,
    TUNING,
    Arc,
    Grid,
    grid_of,
    launch_arc,
    spread_times,
    stop_arc,
    zone_knot,
)

if TYPE_CHECKING:
    from optdock.deadline import Deadline
    from optdock.geometry.arrays import FloatArray
    from optdock.timing.jerk_phases import Phases
    from optdock.timing.path_limits import ReferenceBounds

__all__ = [
    "LimitRows",
    "Prepared",
    "ReferenceStates",
    "Spline",
    "coefficients_of",
    "initial_guess",
    "jerk_step_bands",
    "limit_rows",
    "prepared",
    "program_on",
    "solve_reference",
    "spline_of",
    "spline_phases",
    "states_of",
]


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
    times = spread_times(float(profile.time[-1]), count)
    values = np.interp(times, profile.time, profile.speed_squared)
    padded = np.zeros(values.size + 2 * samples + 1)
    padded[samples + 1 : samples + 1 + values.size] = values
    sums = padded.cumsum()
    mean = (sums[2 * samples + 1 :] - sums[: -2 * samples - 1]) / (2 * samples + 1)  # box filter
    x = _GUESS_SHARE * np.interp(time, times, mean)
    since, until = time - time[0], time[-1] - time
    if first.v > 0.0:
        share = np.minimum(1.0, since / _GUESS_BLEND)
        x = (1.0 - share) * (first.v * first.v) + share * x
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
    """Profile and arcs of a reference, and, if there is room between the arcs, its grid and its program."""

    profile: SpeedProfile
    launch: Arc
    stop: Arc
    grid: Grid | None = None
    curve: FloatArray | None = None  # stencil of x'', Shape (3, M)
    program: Program | None = None
    iterate: Iterate | None = None  # after the first iterations
    table: FloatArray | None = None  # its result of `states_of`, Shape (5, M + 1)


_KERNEL = Kernel("optdock_reference_program", sizes=6, numbers=16)
_TUNING = readonly(
    np.array([SLOWEST, *TUNING, _GUESS_SAMPLE, _GUESS_SHARE, _GUESS_BLEND, 1.0 - _DRIVE_MARGIN, *SETTINGS])
)


def _prepared_native(bounds: ReferenceBounds, start: MotionState) -> Prepared:
    limits, drive, jumps, rows = bounds.limits, bounds.limits.drive, bounds.jumps.size, 6 + len(bounds.turning)
    n, (linear, curved) = limits.s.size, limits.turning_rows
    most = (drive.max_acceleration, drive.max_deceleration, drive.max_jerk, bounds.jerk, _price(bounds), bounds.step)
    zone = limits.zone_start if limits.has_zone else math.inf
    numbers = (*most, zone, limits.caps.steering, bounds.first_cap, *limits.turning_numbers, *start)
    parts, variables = 3 * (linear + 2 * curved), 2 * linear + 3 * curved + 1
    room = 64 + int(2.0 * limits.duration_estimate / min(bounds.step, CRUISE_SAMPLE))
    while True:
        size = 2 * n + rows + 28 + (rows + 12 + parts + variables) * room
        work = max(2 * n + 34 * room + 7 * jumps + 32, (5 * linear + 8 * curved + 17) * room + 4)
        found = np.empty(size)
        m = _KERNEL(
            (n, rows - 6, jumps, room, MOST_ITERATIONS, AT_ONCE),
            numbers,
            (
                (_TUNING, _TUNING.size),
                (limits.table, 13 * n - 9),
                (bounds.table, (rows - 4) * (n - 1)),
                (bounds.jumps, jumps),
                (found, size),
                (np.empty(work), work),
            ),
        )
        if m >= -1:
            break
        room = -m
    if m < 0:
        raise ValueError("reference: needs at least two nodes, jumps at inner nodes, and at most two turning limits")
    launched, jerk, *first, stopped, s, v, a, count = found[:10].tolist()
    launch = Arc(((launched, jerk),) if launched > 0.0 else (), MotionState(*first))
    stop = Arc(((stopped, bounds.jerk),), MotionState(s, v, a))
    profile = SpeedProfile(found[10 : 10 + n], found[10 + n : 10 + 2 * n])
    if m == 0:
        return Prepared(profile, launch, stop)
    knots = 10 + 2 * n
    cells = knots + rows * (m + 1)
    table = cells + 4 * m
    curve = table + 5 * (m + 1)
    state = curve + 3 * m
    data = state + variables * m + 4
    row, cell = found[knots:cells].reshape(rows, m + 1), found[cells:table].reshape(4, m)
    at_zone = zone_knot(limits, row[0])
    grid = Grid(row[0], cell[0], row[1], row[2], row[3:5], tuple(row[6:]), cell[1], cell[2:], at_zone, row[5])
    program = Program(found[data : data + parts * m + 9], m, linear, curved)
    iterate = Iterate(found[state:data], int(count), bool(found[data - 1]) or count == MOST_ITERATIONS)
    states = found[table:curve].reshape(5, m + 1)
    return Prepared(profile, launch, stop, grid, found[curve:state].reshape(3, m), program, iterate, states)


@twin_of(_prepared_native)
def prepared(bounds: ReferenceBounds, start: MotionState) -> Prepared:
    """Return the reference program from a start state to rest, and the iterate after its first iterations."""
    profile = forward_backward_pass(bounds, start)
    launch, stop = launch_arc(bounds, start), stop_arc(bounds)
    if stop.state.s - launch.state.s < LEAST_REST * bounds.limits.length:
        return Prepared(profile, launch, stop)
    grid = grid_of(bounds, profile, launch.state, stop.state)
    program, first, curve = program_on(bounds, profile, grid, launch.state, stop.state)
    iterate = advanced(program, Iterate(first), iterations_at_once(program.m))
    table = states_of(bounds, grid, (launch, stop), curve, iterate.state[: program.m + 2])
    return Prepared(profile, launch, stop, grid, curve, program, iterate, table)


def program_on(
    bounds: ReferenceBounds, profile: SpeedProfile, grid: Grid, first: MotionState, last: MotionState
) -> tuple[Program, FloatArray, FloatArray]:
    """Return the reference program on a grid from `first` to `last`, its first coefficients, and the stencil of x''."""
    guess, spline = initial_guess(grid, bounds, profile, first, last), spline_of(grid.steps)
    # A swing from -J to J is a step of x'' by 4 J / v.
    bands = jerk_step_bands(spline, np.sqrt(0.5 * _price(bounds) * guess[1:-1]) / (4.0 * bounds.jerk))
    rows, curve = limit_rows(grid, bounds, spline), spline.curve / (2.0 * bounds.jerk)
    with_speed = np.concatenate((np.stack((curve, -curve), axis=1), rows.with_speed), axis=1)
    program = Program.of(grid.steps, rows.linear, with_speed, rows.places, spline.right_share, bands)
    return program, coefficients_of(grid.steps, guess, first, last), spline.curve


def _price(bounds: ReferenceBounds) -> float:
    return _SMOOTH_JERK_STEP_PRICE if bounds.smooth else _JERK_STEP_PRICE


class ReferenceStates(NamedTuple):
    """States at the knots of the spline, and the arcs on both sides of it."""

    table: FloatArray  # result of `states_of`, Shape (5, M + 1)
    grid: Grid  # the knots
    launch: Arc  # arc before the spline, possibly without phases
    stop: Arc  # arc after the spline
    iterations: int  # iterations of the interior point method


def solve_reference(
    bounds: ReferenceBounds, start: MotionState, deadline: Deadline = ENDLESS
) -> ReferenceStates | None:
    """Return the fastest spline under `bounds` from a start state to rest, with its arcs.

    Return None if the launch and stop arcs are too long for the segment, or if no spline satisfies the limits.

    Raises:
        OutOfTime: If the deadline passed.
    """
    deadline.look()
    profile, launch, stop, grid, curve, program, iterate, table = prepared(bounds, start)
    if grid is None or curve is None or program is None or iterate is None or table is None:
        return None
    if not iterate.ended:
        iterate = solve(program, iterate, deadline.look)
        table = states_of(bounds, grid, (launch, stop), curve, iterate.state[: program.m + 2])
    longest = _HOPELESS * max(bounds.limits.duration_estimate, float(profile.time[-1]))
    if not float(table[3, :-1].sum()) <= longest:
        return None
    return ReferenceStates(table, grid, launch, stop, iterate.iteration)


def states_of(
    bounds: ReferenceBounds, grid: Grid, arcs: tuple[Arc, Arc], curve: FloatArray, c: FloatArray
) -> FloatArray:
    """Return the states at the knots, and the duration and the jerk of the cells behind them. Shape (5, M + 1).

    The acceleration is linear in s in a cell. The stop arc is behind the last knot.

    Args:
        bounds: Bounds of the reference.
        grid: The knots.
        arcs: Arcs before and after the spline.
        curve: Stencil of x'', Shape (3, M).
        c: Coefficients, Shape (M + 2,).

    Returns:
        Rows: distance [m], speed [m/s], acceleration [m/s^2], duration [s], largest |jerk|, infinite in the arc
        [m/s^3].
    """
    drive, (launch, stop) = bounds.limits.drive, arcs
    padded = np.concatenate((grid.steps[:1], grid.steps, grid.steps[-1:]))
    before = padded[:-1]
    both = before + padded[1:]
    share, slope = before / both, 1.0 / both
    table = np.empty((5, grid.knots.size))
    table[0] = grid.knots
    table[1] = np.sqrt(np.maximum((1.0 - share) * c[:-1] + share * c[1:], 1e-12))
    table[2] = np.minimum(np.maximum(slope * c[1:] - slope * c[:-1], -drive.max_deceleration), drive.max_acceleration)
    table[1:3, 0], table[1:3, -1] = launch.state[1:], stop.state[1:]
    v = table[1]
    table[3, :-1] = 2.0 * grid.steps / (v[:-1] + v[1:])
    table[4, :-1] = 0.5 * np.abs(applied(curve, c)) * np.maximum(v[:-1], v[1:])
    table[3:, -1] = stop.phases[0][0], np.inf
    return table


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
