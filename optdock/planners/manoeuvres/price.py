"""What a manoeuvre costs: its time-optimal duration plus a price per cusp, and quick estimates of that."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from optdock.dock import DockDirection
from optdock.segments import TurnSegment

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray
    from optdock.limits import MotionLimits, TurnLimits
    from optdock.path import Path
    from optdock.problem import DockingProblem

__all__ = [
    "CUSP_PRICE",
    "driving_times",
    "ends_cost",
    "gear_changes",
    "least_price",
    "stopping_cost",
    "stops",
    "turning_times",
]

# [s] beside the time that stopping takes: a change of gear wears the drive and is where controllers overshoot, so one
# more has to save a second.
CUSP_PRICE = 1.0
_TURNS_GEAR = 1e-6  # [m]: shorter arcs are no motion


def least_price(path: Path, problem: DockingProblem) -> float:
    """The price of the fastest motion along `path` that only speeds, accelerations and the dock's slow zone bound [s].

    Jerk, curvature and clearance can only make it dearer. A smoother may still find a shorter path nearby.
    """
    limits = problem.robot.limits
    lengths = [segment.length for segment in path.segments]
    total = 0.0
    entry_speed = abs(problem.start_speed)
    zone = problem.dock.approach
    for i, (segment, length) in enumerate(zip(path.segments, lengths, strict=True)):
        if isinstance(segment, TurnSegment):
            total += float(turning_times(np.array([abs(segment.turn)]), limits.turning)[0])
            continue
        top = limits.max_speed if int(segment.direction) > 0 else limits.max_reverse_speed
        is_last = i == len(lengths) - 1
        slow = min(zone.distance, length) if is_last and zone.speed < top else 0.0
        total += _gear_duration(length - slow, entry_speed, zone.speed if slow > 0.0 else 0.0, top, limits)
        if slow > 0.0:
            total += _gear_duration(slow, zone.speed, 0.0, zone.speed, limits)
        entry_speed = 0.0
    return total + CUSP_PRICE * stops(path)


def stops(path: Path) -> int:
    """How often the robot stops on its way to change gear, to turn in place, or for both at once."""
    driven = sum(not isinstance(segment, TurnSegment) for segment in path.segments)
    return max(driven - 1, 0)


def driving_times(lengths: FloatArray, limits: MotionLimits) -> FloatArray:
    """Times at full speed of signed lengths, negative in reverse, of any shape [s]."""
    times: FloatArray = np.where(lengths > 0.0, lengths / limits.max_speed, -lengths / limits.max_reverse_speed)
    return times


def turning_times(turns: FloatArray, limits: TurnLimits) -> FloatArray:
    """Shortest durations of turns in place, from rest to rest, without a bound on jerk.

    Args:
        turns: Not negative, of any shape [rad].
        limits: Of turns; finite.
    """
    ramps = np.minimum(limits.rate, np.sqrt(turns * limits.acceleration))
    times: FloatArray = ramps / limits.acceleration + turns / np.maximum(ramps, 1e-300)
    return times


def _gear_duration(length: float, first: float, last: float, top: float, limits: MotionLimits) -> float:
    """Shortest duration of a length between two speeds under a top speed, accelerations bounded, jerk not [s]."""
    up, down = limits.max_acceleration, limits.max_deceleration
    first, last = min(first, top), min(last, top)
    peak = math.sqrt(max((2.0 * up * down * length + down * first**2 + up * last**2) / (up + down), 0.0))
    peak = min(max(peak, first, last), top)
    used = max(peak**2 - first**2, 0.0) / (2.0 * up) + max(peak**2 - last**2, 0.0) / (2.0 * down)
    return (peak - first) / up + (peak - last) / down + max(length - used, 0.0) / peak


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


def gear_changes(lengths: FloatArray) -> FloatArray:
    """How often the gear changes along signed lengths, zero ones left out; Shape (..., k) to (...)."""
    gear = np.where(np.abs(lengths) > _TURNS_GEAR, np.sign(lengths), 0.0)
    changes: FloatArray = np.zeros(gear.shape[:-1])
    now = gear[..., 0]
    for k in range(1, gear.shape[-1]):
        following = gear[..., k]
        changes += now * following < 0.0
        now = np.where(following != 0.0, following, now)
    return changes
