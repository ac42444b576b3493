"""Start states: a closed-form test, based on full braking, of whether a start (v0, a0) is feasible.

Viability: among all controls from a start state, full braking (jerk -J to -D, hold, +J to rest) gives the least speed
at every distance, because da/ds = j / v. Therefore the speed caps can be satisfied if and only if the full-braking
curve stays below them; otherwise, no other motion violates them less.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.model.constant_jerk import braking_phases
from optdock.model.limits import LIMITS
from optdock.plugins.interfaces import TimingStatus
from optdock.timing.jerk_phases import DriveBounds, Motion, MotionState, Phases, braking_slack
from optdock.timing.plan_checks import KEPT, SegmentPlan, worst_ratio
from optdock.timing.turning_limits import turning_ratio

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray
    from optdock.model.limits import MotionLimits
    from optdock.timing.path_limits import PathLimits

__all__ = ["NO_DISTANCE", "Braking", "StartVerdict", "full_stop", "judge_start", "stopping_distance"]

NO_DISTANCE = 1e-9  # [m]: a shorter remainder of a segment needs no plan
_PERIOD = 0.004  # [s]: sampling period of full braking


def full_stop(start: MotionState, bounds: DriveBounds) -> Phases:
    """Return full braking to rest; see `braking_phases`."""
    return braking_phases(start.v, start.a, bounds.deceleration, bounds.jerk)


def stopping_distance(start: MotionState, limits: MotionLimits) -> float:
    """Return the distance of full braking to rest [m].

    It is 0 if the start brakes so hard that, within the jerk limit, the robot would roll back behind it.
    """
    bounds = DriveBounds(limits.max_speed, limits.max_acceleration, limits.max_deceleration, limits.max_jerk)
    return max(0.0, Motion.of(start, full_stop(start, bounds)).end.s)


class Braking:
    """Full braking from a start state on a segment.

    Args:
        limits: The segment's limits.
        start: Start state, moving forward or at rest with acceleration > 0.

    Attributes:
        motion: The braking motion; it may end beyond the segment.
        times: Sample times: phase boundaries, a grid, and every node of the limits, Shape (n,) [s].
        states: Distance, speed, acceleration at these times, Shape (3, n).
        path_ratios: Ratios of the limits that depend on the path, which no other motion from this start can reduce,
            Shape (n,): the ratios to the speed caps, to the speed above which no acceleration satisfies a turning limit
            (the acceleration is -D if k k' > 0, otherwise A), and to the turning limits at the start.
        cap_ratios: Ratios of the speed caps, Shape (n,).
        inevitable: Ratios of the turning limits, Shape (n,) each.
        turning_ratios: Result of `turning_ratio`, Shape (n,).
        drive_ratios: Ratios of the acceleration, which full braking reduces as fast as possible.
        ratios: The larger of `path_ratios` and `drive_ratios`, Shape (n,).
    """

    def __init__(self, limits: PathLimits, start: MotionState) -> None:
        self.motion = Motion.of(start, full_stop(start, limits.drive_bounds))
        inside = limits.s[(limits.s > 0.0) & (limits.s < self.motion.end.s)]
        grid = self.motion.sample_times(_PERIOD)
        self.times = np.union1d(grid, self.motion.crossing_times(inside)) if inside.size else grid
        self.states = self.motion.at(self.times)
        s, v, a = self.states
        drive, points = limits.drive, limits.points_at(np.clip(s, 0.0, limits.length))
        self.turning_ratios = turning_ratio(limits.turning, points.curvature, points.rate, v, a)
        relief = np.where(points.curvature * points.rate > 0.0, drive.max_deceleration, drive.max_acceleration)
        self.cap_ratios = v * points.slowness
        self.inevitable = [limit.inevitable(v, points.curvature, points.rate, relief) for limit in limits.turning]
        self.path_ratios = np.max([self.cap_ratios, *self.inevitable], axis=0)
        self.path_ratios[0] = max(self.path_ratios[0], self.turning_ratios[0])
        self.drive_ratios = np.maximum(a / drive.max_acceleration, -a / drive.max_deceleration)
        self.ratios: FloatArray = np.maximum(self.path_ratios, self.drive_ratios)

    def tight_length(self, slack: float, turning_share: float) -> float:
        """Return the distance [m] from the start within which braking leaves no room for margins.

        Args:
            slack: Relative distance from the limits at which margins are possible.
            turning_share: Ratio of a turning limit at which margins are possible.
        """
        tight = np.flatnonzero(self.path_ratios > 1.0 - slack)
        turning = np.flatnonzero(self.turning_ratios <= turning_share)
        last = max(int(tight[-1]) + 1 if tight.size else 0, int(turning[0]) if turning.size else self.times.size)
        return float(self.states[0, min(last, self.times.size - 1)])


class StartVerdict(NamedTuple):
    """Result of full braking for a moving start; true if there is no refusal.

    Args:
        refusal: Reason why no motion satisfies every limit, or None if such a motion may exist.
        ways_on: Phases after which a plan may continue, and the state after them, best first.
        braking: Full braking; None for a refusal.
    """

    refusal: SegmentPlan | None
    ways_on: tuple[tuple[Phases, MotionState], ...] = ()
    braking: Braking | None = None

    def __bool__(self) -> bool:
        return self.refusal is None


def judge_start(limits: PathLimits, start: MotionState) -> StartVerdict:
    """Return whether a motion from a moving start can satisfy the limits of a segment, with the reason if not."""
    begin = limits.begin
    if start.v < 0.0 or braking_slack(start, limits.drive.max_jerk) < 0.0:
        reason = f"from v = {start.v:.6g} m/s, a = {start.a:.6g} m/s^2 the robot cannot avoid rolling backwards"
        limit = "" if start.v < 0.0 else "max_jerk"
        status = TimingStatus.BAD_START
        return StartVerdict(SegmentPlan(status, how="none", reason=reason, limit=limit, s=begin, arrives=False))
    braking = Braking(limits, start)
    brake = braking.motion
    if not np.isfinite(braking.states).all():
        reason = f"full braking from {start} overflows"
        return StartVerdict(SegmentPlan(TimingStatus.FAIL, how="none", reason=reason, s=begin, arrives=False))
    needed, left = brake.end.s, limits.length
    if needed > left + NO_DISTANCE:
        distances = f"{needed:.6g} m, the stop at s = {begin + left:.6g} m is {left:.6g} m away"
        reason = f"full braking from {start.v:.6g} m/s needs {distances}"
        ratio, status, limit = worst_ratio(limits, brake).ratio, TimingStatus.CANNOT_STOP, "max_deceleration"
        return StartVerdict(
            SegmentPlan(status, brake.phases, ratio, needed - left, "brake", reason, limit, begin + left, arrives=False)
        )
    stopped = brake.phases, MotionState(needed)
    broken = np.flatnonzero(braking.ratios > KEPT)
    if broken.size == 0:
        return StartVerdict(None, (stopped,), braking)
    worst = int(np.argmax(braking.ratios))
    limit, sentence = _broken_limit(braking, worst, limits)
    reason = f"{sentence} under full braking; no motion from this start does better"
    ratio, where = float(braking.ratios[worst]), begin + float(braking.states[0, worst])
    kept_again = float(braking.times[min(int(broken[-1]) + 1, braking.times.size - 1)])
    status = TimingStatus.START_INFEASIBLE
    refusal = SegmentPlan(status, brake.phases, ratio, 0.0, "brake", reason, limit, where)
    return StartVerdict(refusal, (brake.cut(kept_again), stopped))


def _broken_limit(braking: Braking, k: int, limits: PathLimits) -> tuple[str, str]:
    """Return the limit with the largest ratio at the k-th of `times`, and a description of its violation."""
    s, v, a = (float(value) for value in braking.states[:, k])
    ratio, turning, drive = float(braking.ratios[k]), float(braking.turning_ratios[0]), limits.drive
    inside = min(max(s, 0.0), limits.length)
    where = f"at s = {limits.begin + s:.4f} m is"
    if braking.drive_ratios[k] > braking.path_ratios[k]:
        name = "max_acceleration" if a > 0.0 else "max_deceleration"
        return name, f"acceleration {a:.4g} m/s^2 {where} {ratio:.4g} times {_valued(name, drive)}"
    if k == 0 and turning >= ratio:
        limit = limits.turning_limit_at(inside, v, a)
        quotient, (quantity, unit) = turning ** (0.5 * (limit.order + 1)), LIMITS[limit.name].label.split(" [")
        value = f"{quantity} {quotient * limit.bound:.4g} {unit.removesuffix(']')}"
        return limit.name, f"{value} {where} {quotient:.4g} times {_valued(limit.name, drive)}"
    name, words = limits.cap_at(inside)
    if braking.cap_ratios[k] < ratio:
        name = limits.turning[int(np.argmax([ratios[k] for ratios in braking.inevitable]))].name
        words = _valued(name, drive)
    return name, f"speed {v:.4g} m/s {where} {ratio:.4g} times what {words} allows"


def _valued(name: str, drive: MotionLimits) -> str:
    return f"{name} = {getattr(drive, name):.4g} {LIMITS[name].unit}"
