"""Price of a manoeuvre (duration, price per cusp and price per metre in reverse), and fast estimates of the price."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

import numpy as np

from optdock.kernels import Kernel, twin_of
from optdock.model.dock import DockDirection
from optdock.model.segments import TurnSegment

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray, IntArray
    from optdock.model.limits import MotionLimits, TurnLimits
    from optdock.model.path import Path
    from optdock.model.problem import DockingProblem
    from optdock.model.robot import Robot

__all__ = [
    "CUSP_PRICE",
    "driving_prices",
    "ends_cost",
    "gear_changes",
    "least_price",
    "least_prices",
    "price_of",
    "stopping_cost",
    "stops",
    "turning_times",
]

# [s] in addition to the time for stopping: a change of gear wears the drive, and controllers overshoot at cusps, so
# each cusp must save a second.
CUSP_PRICE = 1.0
_LEAST_MOTION = 1e-6  # [m]: shorter arcs do not count as motion
_STEPS, _EXCESS = 20, 1e-6  # most iterations; tolerance of the length [m]


def price_of(path: Path, duration: float, robot: Robot) -> float:
    """Return the price by which plans are compared [s]: duration, `CUSP_PRICE` per stop, and cost of reversing.

    Args:
        path: Path of any kind.
        duration: Duration of the motion along the path [s].
        robot: Robot with the `reverse_price`.
    """
    reversing = sum([-robot.reverse_price * length for length in path.gear_lengths if length < 0.0])
    return duration + CUSP_PRICE * stops(path) + reversing


def least_price(path: Path, problem: DockingProblem) -> float:
    """Return a lower bound of the price [s] of motions along `path`, given speed, acceleration, jerk and speed zone.

    Curvature and clearance can only raise the price. A smoother may still find a shorter path nearby.
    """
    turned = 0.0
    if path.turns:
        turns = np.array([abs(one.turn) for one in path.segments if isinstance(one, TurnSegment)])
        turned = float(turning_times(turns, problem.robot.limits.turning).sum())
    return price_of(path, turned + float(_durations(np.array([path.gear_lengths]), problem)[0]), problem.robot)


_PRICES_KERNEL = Kernel("optdock_least_prices", sizes=2, numbers=0)
_DURATIONS_KERNEL = Kernel("optdock_durations", sizes=2, numbers=0)


def _rule(problem: DockingProblem) -> FloatArray:
    """Return the numbers of `Rule` in C."""
    robot, zone = problem.robot, problem.dock.approach
    limits = robot.limits
    bounds = limits.max_speed, limits.max_reverse_speed, limits.max_acceleration, limits.max_deceleration
    return np.array((*bounds, limits.max_jerk, problem.start_speed, zone.speed, zone.distance, robot.reverse_price))


def _least_prices_native(lengths: FloatArray, problem: DockingProblem) -> FloatArray:
    (n, k), prices = lengths.shape, np.empty(len(lengths))
    arrays = (_rule(problem), 9), (np.ascontiguousarray(lengths), n * k), (np.empty(k), k), (prices, n)
    _PRICES_KERNEL((n, k), (), arrays)
    return prices


@twin_of(_least_prices_native)
def least_prices(lengths: FloatArray, problem: DockingProblem) -> FloatArray:
    """Compute `least_price` of many paths without turns in place.

    Args:
        lengths: Lengths of the pieces of each path as driven, negative in reverse; neighbours may have the same gear.
            Shape (n, k) [m].
        problem: The planning problem.

    Returns:
        Shape (n,) [s].
    """
    gears, changes = _merged(lengths)
    found = _durations(gears, problem) + CUSP_PRICE * changes
    found += _summed(_reversing(gears, problem.robot))
    return found


def _summed(values: FloatArray) -> FloatArray:
    """Return the sums of rows from left to right, Shape (n, k) to (n,); `numpy.sum` has another order."""
    found: FloatArray = sum(values.T, np.zeros(len(values)))
    return found


def _merged(lengths: FloatArray) -> tuple[FloatArray, IntArray]:
    """Return signed lengths with neighbours of one gear summed, padded with 0, (n, k), and gear changes, (n,)."""
    rows, gear = np.arange(len(lengths)), np.zeros(len(lengths), dtype=np.int64)
    gears, now = np.zeros(lengths.shape), np.zeros(len(lengths))
    for length in lengths.T:
        sign = np.where(np.abs(length) > _LEAST_MOTION, np.sign(length), 0.0)
        gear += sign * now < 0.0
        now = np.where(sign != 0.0, sign, now)
        gears[rows, gear] += np.where(sign != 0.0, length, 0.0)
    return gears, gear


def _durations_native(gears: FloatArray, problem: DockingProblem) -> FloatArray:
    (n, k), found = gears.shape, np.empty(len(gears))
    _DURATIONS_KERNEL((n, k), (), ((_rule(problem), 9), (np.ascontiguousarray(gears), n * k), (found, n)))
    return found


@twin_of(_durations_native)
def _durations(gears: FloatArray, problem: DockingProblem) -> FloatArray:
    """Return the shortest durations [s] of paths of signed lengths [m], Shape (n, k) to (n,); see `least_price`."""
    limits, zone = problem.robot.limits, problem.dock.approach
    length, drives = np.abs(gears), gears != 0.0
    top = np.where(gears > 0.0, limits.max_speed, limits.max_reverse_speed)
    first = np.where(drives & (np.cumsum(drives, axis=1) == 1), abs(problem.start_speed), 0.0)
    is_last = drives & (np.cumsum(drives[:, ::-1], axis=1)[:, ::-1] == 1)
    slow, inside = np.minimum(zone.speed, top), np.zeros(length.shape)
    if np.any(is_slow := is_last & (slow < top)):
        # A gear that begins in the zone, or too close to exceed its speed before, is slow as a whole. A zone that is
        # shorter than the braking distance adds no bound.
        _, rising, _ = _ramp(np.minimum(first, slow), slow, limits.max_acceleration, limits.max_jerk)
        _, falling, _ = _ramp(np.zeros(slow.shape), slow, limits.max_deceleration, limits.max_jerk)
        is_whole = is_slow & (length <= zone.distance + rising)
        top = np.where(is_whole, slow, top)
        inside = np.where(is_slow & ~is_whole & (falling <= zone.distance), zone.distance, 0.0)
    until = np.where(inside > 0.0, slow, 0.0)
    found: FloatArray = np.where(drives, _gear_durations(length - inside, first, until, top, limits), 0.0)
    if np.any(inside > 0.0):
        found += np.where(inside > 0.0, _gear_durations(inside, until, np.zeros(slow.shape), until, limits), 0.0)
    return _summed(found)


def stops(path: Path) -> int:
    """Return the number of intermediate stops for changing gear, turning in place, or both at once."""
    return max(len(path.gear_lengths) - 1, 0)


def _reversing(lengths: FloatArray, robot: Robot) -> FloatArray:
    """Return the price [s] of reversing for signed lengths, negative in reverse, of any shape."""
    prices: FloatArray = robot.reverse_price * np.maximum(-lengths, 0.0)
    return prices


def driving_prices(lengths: FloatArray, robot: Robot) -> FloatArray:
    """Return the prices [s] of driving signed lengths, negative in reverse, at full speed, of any shape."""
    limits = robot.limits
    times: FloatArray = np.where(lengths > 0.0, lengths / limits.max_speed, -lengths / limits.max_reverse_speed)
    return times + _reversing(lengths, robot)


def turning_times(turns: FloatArray, limits: TurnLimits) -> FloatArray:
    """Return the shortest durations [s] of turns in place [rad] from rest to rest, without a bound on jerk."""
    ramps = np.minimum(limits.rate, np.sqrt(turns * limits.acceleration))
    times: FloatArray = ramps / limits.acceleration + turns / np.maximum(ramps, 1e-300)
    return times


def _gear_durations(
    length: FloatArray, first: FloatArray, last: FloatArray, top: FloatArray, limits: MotionLimits
) -> FloatArray:
    """Return the shortest durations [s] of straight motions of given lengths, from speed `first` to speed `last`.

    Speed (by `top`), acceleration, deceleration and jerk are bounded.
    """
    first, last = np.minimum(first, top), np.minimum(last, top)
    low, high = np.maximum(first, last), top
    peak, is_known = high, np.zeros(length.shape, dtype=np.bool_)
    for _ in range(_STEPS):  # Newton's method safeguarded by bisection for the peak speed
        _, rising, faster = _ramp(first, peak, limits.max_acceleration, limits.max_jerk)
        _, falling, later = _ramp(last, peak, limits.max_deceleration, limits.max_jerk)
        excess = rising + falling - length
        is_known = (np.abs(excess) <= _EXCESS) | ((peak >= top) & (excess <= 0.0)) | (high <= low)
        if is_known.all():
            break
        low, high = np.where(excess > 0.0, low, peak), np.where(excess > 0.0, peak, high)
        step = peak - excess / np.maximum(faster + later, 1e-12)
        step = np.where((step > low) & (step < high), step, 0.5 * (low + high))
        peak = np.where(is_known, peak, step)
    peak = np.where(is_known, peak, low)  # `low` also if the length is too short for braking
    up, rising, _ = _ramp(first, peak, limits.max_acceleration, limits.max_jerk)
    down, falling, _ = _ramp(last, peak, limits.max_deceleration, limits.max_jerk)
    cruise = np.maximum(length - rising - falling, 0.0) / np.maximum(peak, 1e-300)
    found: FloatArray = up + down + cruise
    return found


def _ramp(
    slow: FloatArray, fast: FloatArray, acceleration: float, jerk: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the time and distance between two speeds, and d distance / d speed for the faster speed [s, m, s]."""
    change = np.maximum(fast - slow, 0.0)
    full = change >= acceleration * acceleration / jerk  # the acceleration reaches its bound
    root = np.sqrt(change / jerk)
    time = np.where(full, change / acceleration + acceleration / jerk, 2.0 * root)
    slope = np.where(full, 1.0 / acceleration, 1.0 / np.maximum(np.sqrt(change * jerk), 1e-12))
    mean = 0.5 * (slow + fast)
    return time, mean * time, 0.5 * time + mean * slope


def stopping_cost(limits: MotionLimits) -> float:
    """Return the cost [s] of a change of gear beyond the time at full speed, including the price of the cusp."""
    mean = 0.5 * (limits.max_speed + limits.max_reverse_speed)
    return CUSP_PRICE + 0.5 * mean / limits.max_acceleration + 0.5 * mean / limits.max_deceleration


def ends_cost(problem: DockingProblem) -> float:
    """Return a lower bound of the time [s] that the start, the speed zone and the stop add to the time at full speed.

    The bound is exact if the jerk is not limited, the gears are known, and the path is long enough for full speed.
    """
    limits, dock, zone = problem.robot.limits, problem.dock, problem.dock.approach
    speeds = {DockDirection.FORWARD: limits.max_speed, DockDirection.BACKWARD: limits.max_reverse_speed}
    setting_off = min((top - min(abs(problem.start_speed), top)) ** 2 / top for top in speeds.values())
    ending = []
    for top in [speeds[dock.direction]] if dock.direction in speeds else speeds.values():
        last = min(zone.speed, top) if zone.distance > 0.0 else top
        braking = ((top - last) ** 2 / top + last) / (2.0 * limits.max_deceleration)
        ending.append(zone.distance * (1.0 / last - 1.0 / top) + braking)
    return setting_off / (2.0 * limits.max_acceleration) + min(ending)


def gear_changes(lengths: FloatArray) -> IntArray:
    """Return the number of gear changes along signed lengths, without zeros; Shape (n, k) to (n,)."""
    driven = [[one for one in row if not -_LEAST_MOTION <= one <= _LEAST_MOTION] for row in lengths.tolist()]
    return np.array([sum([a * b < 0.0 for a, b in itertools.pairwise(row)]) for row in driven], dtype=np.int64)
