"""What a manoeuvre costs: its duration, a price per cusp and one per metre in reverse, and quick estimates of that."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

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

# [s] beside the time that stopping takes: a change of gear wears the drive and is where controllers overshoot, so one
# more has to save a second.
CUSP_PRICE = 1.0
_TURNS_GEAR = 1e-6  # [m]: shorter arcs are not motion
_STEPS, _EXCESS = 20, 1e-6  # most iterations; tolerance of the length [m]


def price_of(path: Path, duration: float, robot: Robot) -> float:
    """What plans are chosen by [s]: the duration, `CUSP_PRICE` for every stop on the way, and the metres in reverse.

    Args:
        path: Of any kind.
        duration: Of the motion along it [s].
        robot: Whose `reverse_price` counts.
    """
    gears = np.array([one.direction * one.length for one in path.segments if not isinstance(one, TurnSegment)])
    return duration + CUSP_PRICE * stops(path) + float(_reversing(gears, robot).sum())


def least_price(path: Path, problem: DockingProblem) -> float:
    """The price of the fastest motion along `path` that speed, acceleration, jerk and the dock's slow zone bound [s].

    Curvature and clearance can only make it dearer. A smoother may still find a shorter path nearby.
    """
    gears = np.array([[0.0 if isinstance(one, TurnSegment) else one.direction * one.length for one in path.segments]])
    turns = np.array([abs(one.turn) for one in path.segments if isinstance(one, TurnSegment)])
    turned = float(turning_times(turns, problem.robot.limits.turning).sum()) if turns.size else 0.0
    return price_of(path, turned + float(_durations(gears, problem)[0].sum()), problem.robot)


def least_prices(lengths: FloatArray, problem: DockingProblem) -> FloatArray:
    """As `least_price`, of many ways without turns in place.

    Args:
        lengths: Of the pieces of each way in the order in which they are driven, negative in reverse; those of one gear
            may be several. Shape (n, k) [m].
        problem: From rest or in motion, with which robot, to which dock.

    Returns:
        Shape (n,) [s].
    """
    gears, changes = _merged(lengths)
    found: FloatArray = _durations(gears, problem).sum(axis=1) + CUSP_PRICE * changes
    found += _reversing(gears, problem.robot).sum(axis=1)
    return found


def _merged(lengths: FloatArray) -> tuple[FloatArray, IntArray]:
    """Signed lengths, Shape (n, k), with neighbours of one gear added up, and how often the gear changes, Shape (n,).

    What is shorter than a motion is left out, and 0 fills up the rows.
    """
    rows, gear = np.arange(len(lengths)), np.zeros(len(lengths), dtype=np.int64)
    gears, now = np.zeros(lengths.shape), np.zeros(len(lengths))
    for length in lengths.T:
        sign = np.where(np.abs(length) > _TURNS_GEAR, np.sign(length), 0.0)
        gear += sign * now < 0.0
        now = np.where(sign != 0.0, sign, now)
        gears[rows, gear] += np.where(sign != 0.0, length, 0.0)
    return gears, gear


def _durations(gears: FloatArray, problem: DockingProblem) -> FloatArray:
    """Shortest durations of drives from stop to stop, see `least_price`.

    Args:
        gears: Lengths, negative in reverse, 0: no drive. Shape (n, k) [m].
        problem: As of `least_prices`.

    Returns:
        Shape (n, k) [s].
    """
    limits, zone = problem.robot.limits, problem.dock.approach
    length, drives = np.abs(gears), gears != 0.0
    top = np.where(gears > 0.0, limits.max_speed, limits.max_reverse_speed)
    first = np.where(drives & (np.cumsum(drives, axis=1) == 1), abs(problem.start_speed), 0.0)
    is_last = drives & (np.cumsum(drives[:, ::-1], axis=1)[:, ::-1] == 1)
    slow, inside = np.minimum(zone.speed, top), np.zeros(length.shape)
    if np.any(is_slow := is_last & (slow < top)):
        # A gear that begins in the zone, or too near to it to get faster than it allows, is slow as a whole; where the
        # zone is shorter than braking takes, it bounds nothing that braking does not.
        _, rising, _ = _ramp(np.minimum(first, slow), slow, limits.max_acceleration, limits.max_jerk)
        _, falling, _ = _ramp(np.zeros(slow.shape), slow, limits.max_deceleration, limits.max_jerk)
        is_whole = is_slow & (length <= zone.distance + rising)
        top = np.where(is_whole, slow, top)
        inside = np.where(is_slow & ~is_whole & (falling <= zone.distance), zone.distance, 0.0)
    until = np.where(inside > 0.0, slow, 0.0)
    found: FloatArray = np.where(drives, _gear_durations(length - inside, first, until, top, limits), 0.0)
    if np.any(inside > 0.0):
        found += np.where(inside > 0.0, _gear_durations(inside, until, np.zeros(slow.shape), until, limits), 0.0)
    return found


def stops(path: Path) -> int:
    """How often the robot stops on its way to change gear, to turn in place, or for both at once."""
    driven = sum(not isinstance(segment, TurnSegment) for segment in path.segments)
    return max(driven - 1, 0)


def _reversing(lengths: FloatArray, robot: Robot) -> FloatArray:
    """What signed lengths cost beside their time, of any shape [s]."""
    prices: FloatArray = robot.reverse_price * np.maximum(-lengths, 0.0)
    return prices


def driving_prices(lengths: FloatArray, robot: Robot) -> FloatArray:
    """Prices of signed lengths at full speed, negative in reverse, of any shape [s]."""
    limits = robot.limits
    times: FloatArray = np.where(lengths > 0.0, lengths / limits.max_speed, -lengths / limits.max_reverse_speed)
    return times + _reversing(lengths, robot)


def turning_times(turns: FloatArray, limits: TurnLimits) -> FloatArray:
    """Shortest durations of turns in place, from rest to rest, without a bound on jerk.

    Args:
        turns: Not negative, of any shape [rad].
        limits: Of turns; finite.
    """
    ramps = np.minimum(limits.rate, np.sqrt(turns * limits.acceleration))
    times: FloatArray = ramps / limits.acceleration + turns / np.maximum(ramps, 1e-300)
    return times


def _gear_durations(
    length: FloatArray, first: FloatArray, last: FloatArray, top: FloatArray, limits: MotionLimits
) -> FloatArray:
    """Shortest durations of lengths between two speeds under a top speed, with bounded acceleration and jerk [s]."""
    first, last = np.minimum(first, top), np.minimum(last, top)
    low, high = np.maximum(first, last), top
    peak, is_known = high, np.zeros(length.shape, dtype=np.bool_)
    for _ in range(_STEPS):  # Newton's method, and bisection where it leads astray, for the largest speed with room
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
    peak = np.where(is_known, peak, low)  # `low`: also where no length is left to brake in
    up, rising, _ = _ramp(first, peak, limits.max_acceleration, limits.max_jerk)
    down, falling, _ = _ramp(last, peak, limits.max_deceleration, limits.max_jerk)
    cruise = np.maximum(length - rising - falling, 0.0) / np.maximum(peak, 1e-300)
    found: FloatArray = up + down + cruise
    return found


def _ramp(
    slow: FloatArray, fast: FloatArray, acceleration: float, jerk: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Time [s] and way [m] between two speeds, and how much the way grows with the faster one [s]."""
    change = np.maximum(fast - slow, 0.0)
    full = change >= acceleration**2 / jerk  # the acceleration gets as high as it may
    root = np.sqrt(change / jerk)
    time = np.where(full, change / acceleration + acceleration / jerk, 2.0 * root)
    slope = np.where(full, 1.0 / acceleration, 1.0 / np.maximum(np.sqrt(change * jerk), 1e-12))
    mean = 0.5 * (slow + fast)
    return time, mean * time, 0.5 * time + mean * slope


def stopping_cost(limits: MotionLimits) -> float:
    """What a change of gear adds to the time at full speed, with the price of the cusp [s]."""
    mean = 0.5 * (limits.max_speed + limits.max_reverse_speed)
    return CUSP_PRICE + 0.5 * mean / limits.max_acceleration + 0.5 * mean / limits.max_deceleration


def ends_cost(problem: DockingProblem) -> float:
    """What setting off, the dock's slow stretch and stopping there add to the time at full speed, at least [s].

    Exact for accelerations without a bound on jerk where the gears are known and there is room to reach full speed.
    """
    limits, dock = problem.robot.limits, problem.dock
    speeds = {DockDirection.FORWARD: limits.max_speed, DockDirection.BACKWARD: limits.max_reverse_speed}
    ending = [speeds[dock.direction]] if dock.direction in speeds else list(speeds.values())
    setting_off = min((top - min(abs(problem.start_speed), top)) ** 2 / top for top in speeds.values())
    return setting_off / (2.0 * limits.max_acceleration) + min(_ending(top, problem) for top in ending)


def _ending(top: float, problem: DockingProblem) -> float:
    """What the slow stretch before the dock and stopping add to the time at the speed `top` [s]."""
    zone, down = problem.dock.approach, problem.robot.limits.max_deceleration
    last = min(zone.speed, top) if zone.distance > 0.0 else top
    return zone.distance * (1.0 / last - 1.0 / top) + ((top - last) ** 2 / top + last) / (2.0 * down)


def gear_changes(lengths: FloatArray) -> IntArray:
    """How often the gear changes along signed lengths, zero ones left out; Shape (n, k) to (n,)."""
    return _merged(lengths)[1]
