"""The dense check of a motion over one segment, and the resulting segment plan.

The check detects errors of a method early. Only the proof by `optdock.verification` decides whether a motion is
accepted.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.model.constant_jerk import constant_jerk
from optdock.plugins.interfaces import TimingStatus
from optdock.timing.jerk_phases import Motion, MotionState, Phases
from optdock.timing.turning_limits import turning_ratio

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray
    from optdock.timing.path_limits import PathLimits

__all__ = [
    "KEPT",
    "SegmentPlan",
    "Worst",
    "arrived_plan",
    "checked_plan",
    "end_slack",
    "judged_plan",
    "motion_ratios",
    "refined_times",
    "worst_ratio",
]

KEPT = 1.0 + 1e-9  # largest ratio that counts as 1, because of rounding
_PERIOD = 0.008  # [s]: sampling period of the check
_REFINEMENT = 16  # factor on the sampling rate where a limit is nearly reached
_REACHED = 1e-7  # [m, m/s, m/s^2]: tolerance for rounding over kilometres and hours; `certify_trajectory` accepts 1e-6
_REACHED_SHARE = 1e-3  # share of the length of very short segments, if smaller


class Worst(NamedTuple):
    """Largest ratio of a quantity to its limit along a motion."""

    ratio: float  # largest ratio
    s: float  # place of the largest ratio [m]
    path: float  # factor on time for which speeds and turning limits, which depend on the path, are kept
    drive: float  # factor on time for which acceleration and jerk limits are kept
    limit: str = ""  # name of the limit if the ratio is above 1; otherwise empty

    @property
    def stretch(self) -> float:
        """Factor by which time must be stretched to satisfy every limit."""
        return max(self.path, self.drive)

    def words(self, begin: float) -> str:
        """Describe the violation; the segment begins at `begin` [m] of the path."""
        return f"{self.ratio:.6g} times {self.limit or 'a limit'} at s = {begin + self.s:.4f} m"


class _Ratios(NamedTuple):
    """Ratios of speeds (square root for the lateral acceleration) and turning limits at distances `s`, Shape (n,).

    `drive`, the ratio of the acceleration, is computed only at the time samples, which come first, because the
    acceleration is linear between them.
    """

    s: FloatArray
    speed: FloatArray
    turning: FloatArray
    drive: FloatArray


def motion_ratios(limits: PathLimits, motion: Motion, times: FloatArray | None = None) -> _Ratios:
    """Return the ratios of all limits except the jerk at time samples, phase boundaries, and both sides of every node.

    Between nodes curvature and its rate are linear and the motion is smooth, so the maxima are at the nodes, up to the
    time sampling; time samples alone would miss narrow peaks. At the nodes speed and acceleration are interpolated
    between time samples, with an error of at most period^2 * jerk / 8.
    """
    t = motion.sample_times(_PERIOD) if times is None else times
    s, v, a = motion.at(t)
    s = np.minimum(np.maximum.accumulate(s), limits.length)
    inner, drive = limits.s[1:-1], limits.drive
    first, last = np.searchsorted(inner, (s[0], s[-1]))
    nodes = inner[first:last]
    node_v, node_a = np.interp(nodes, s, v), np.interp(nodes, s, a)
    points = limits.points_at(s)
    slowness = limits.slowness_left[1:][first:last]
    if limits.caps.steering:
        slowness = np.maximum(slowness, limits.slowness_right[:-1][first:last])
    if limits.has_zone:
        slowness = np.where(nodes >= limits.zone_start, np.maximum(slowness, 1.0 / limits.zone_speed), slowness)
    curvature = limits.curvature[1:-1][first:last]
    left = turning_ratio(limits.turning, curvature, limits.rate_right[:-1][first:last], node_v, node_a)
    right = turning_ratio(limits.turning, curvature, limits.rate_left[1:][first:last], node_v, node_a)
    turning = turning_ratio(limits.turning, points.curvature, points.rate, v, a)
    return _Ratios(
        s=np.concatenate((s, nodes)),
        speed=np.concatenate((v * points.slowness, node_v * slowness)),
        turning=np.concatenate((turning, np.maximum(left, right))),
        drive=np.maximum(a * (1.0 / drive.max_acceleration), a * (-1.0 / drive.max_deceleration)),
    )


def worst_ratio(limits: PathLimits, motion: Motion, times: FloatArray | None = None) -> Worst:
    """Return the worst ratio of all limits (including jerk) along a motion, at `times` if given, Shape (n,) [s]."""
    ratios = motion_ratios(limits, motion, times)
    largest = np.maximum(ratios.speed, ratios.turning)
    np.maximum(largest[: ratios.drive.size], ratios.drive, out=largest[: ratios.drive.size])
    worst = int(np.argmax(largest))
    steepest = int(np.argmax(np.abs(motion.jerks)))
    jerk = abs(float(motion.jerks[steepest])) / limits.drive.max_jerk
    path = max(float(ratios.speed.max()), math.sqrt(float(ratios.turning.max())))
    drive = max(math.sqrt(max(0.0, float(ratios.drive.max()))), jerk ** (1.0 / 3.0))
    if jerk > largest[worst] * KEPT:
        return Worst(jerk, float(motion.states[0, steepest]), path, drive, "max_jerk" if jerk > 1.0 else "")
    limit = _limit_name(limits, motion, ratios, worst) if largest[worst] > 1.0 else ""
    return Worst(float(largest[worst]), float(ratios.s[worst]), path, drive, limit)


def _limit_name(limits: PathLimits, motion: Motion, ratios: _Ratios, k: int) -> str:
    """Return the name of the limit with the largest of the k-th ratios."""
    if k < ratios.drive.size and ratios.drive[k] >= max(ratios.speed[k], ratios.turning[k]):
        rising = float(motion.states[2].max()) / limits.drive.max_acceleration >= ratios.drive[k] * (1.0 - 1e-9)
        return "max_acceleration" if rising else "max_deceleration"
    s = float(ratios.s[k])
    if ratios.turning[k] >= ratios.speed[k] and limits.turning:
        _s, v, a = motion.at(motion.crossing_times(np.array([s])))
        return limits.turning_limit_at(s, float(v[0]), float(a[0])).name
    return limits.cap_at(s)[0]


class SegmentPlan(NamedTuple):
    """Motion planned by a method for one segment, with its status."""

    status: TimingStatus  # status of the timing
    phases: Phases = ()  # the motion; empty if there is none
    ratio: float = 0.0  # largest ratio of a quantity to its limit along the motion; 0 if it was not computed
    overshoot: float = 0.0  # distance that full braking needs beyond the end [m]
    how: str = ""  # the method, for the report
    reason: str = ""  # why the status is not OK
    limit: str = ""  # name of the violated limit, or empty
    s: float | None = None  # place of the violation [m], or None
    arrives: bool = True  # whether the motion ends at rest at the end of the segment


def end_slack(limits: PathLimits) -> float:
    """Return the largest distance [m] from the end of the segment at which a motion may end."""
    return min(_REACHED, _REACHED_SHARE * limits.length)


def arrived_plan(limits: PathLimits, start: MotionState, phases: Phases, how: str) -> SegmentPlan:
    """Return the plan of a motion, OK if the motion ends at rest at the end of the segment; limits are not checked."""
    s, v, a = start
    for duration, jerk in phases:
        s, v, a = constant_jerk(duration, s, v, a, jerk)
    if abs(s - limits.length) <= end_slack(limits) and max(abs(v), abs(a)) <= _REACHED:
        return SegmentPlan(TimingStatus.OK, phases, how=how)
    reason = f"ends at {MotionState(s, v, a)}, not at rest after {limits.length:.6g} m"
    return SegmentPlan(TimingStatus.FAIL, phases, how=how, reason=reason)


def judged_plan(limits: PathLimits, motion: Motion, worst: Worst, how: str) -> SegmentPlan:
    """Return the plan of a motion, OK if it ends as required and `worst`, from the dense check, violates no limit."""
    plan = arrived_plan(limits, motion.start, motion.phases, how)._replace(ratio=worst.ratio)
    if plan.status is not TimingStatus.OK or worst.ratio <= KEPT:
        return plan
    s = limits.begin + worst.s
    return plan._replace(status=TimingStatus.FAIL, reason=worst.words(limits.begin), limit=worst.limit, s=s)


def checked_plan(limits: PathLimits, start: MotionState, phases: Phases, how: str) -> SegmentPlan:
    """Run the dense check of a motion and return its plan; see `judged_plan`."""
    motion = Motion.of(start, phases)
    return judged_plan(limits, motion, worst_ratio(limits, motion) if phases else Worst(0.0, 0.0, 0.0, 0.0), how)


def refined_times(limits: PathLimits, motion: Motion, close: float) -> FloatArray:
    """Return the times of the check, half a millisecond apart where a ratio of the path is above `close`."""
    t = motion.sample_times(_PERIOD)
    ratios = motion_ratios(limits, motion, t)
    near = ratios.s[np.maximum(ratios.speed, np.sqrt(ratios.turning)) > close]
    first = np.clip(np.searchsorted(motion.at(t)[0], near) - 1, 0, t.size - 2)
    spans = np.unique(np.concatenate((first, np.minimum(first + 1, t.size - 2), np.maximum(first - 1, 0))))
    steps = np.arange(1, _REFINEMENT) / _REFINEMENT
    return np.union1d(t, (t[spans, None] + (t[spans + 1] - t[spans])[:, None] * steps).ravel())
