"""Checks: the plan that is made of a motion over one segment, whatever proposed it.

The dense check of `path_limits` lets a method be wrong without being unsafe; what decides in the end is the proof of
`optdock.verification`, which knows none of this.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.plugins.interfaces import TimingStatus
from optdock.timing.jerk_phases import Motion, MotionState, Phases
from optdock.timing.path_limits import KEPT, Worst, motion_ratios, worst_ratio
from optdock.timing.timing_settings import SAMPLING

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray
    from optdock.timing.path_limits import PathLimits

__all__ = ["SegmentPlan", "arrived_plan", "checked_plan", "end_slack", "judged_plan", "refined_times"]

_REACHED = 1e-7  # [m, m/s, m/s^2]: rounding over kilometres and hours; `certify_trajectory` accepts 1e-6
_REACHED_SHARE = 1e-3  # of a segment shorter than that


class SegmentPlan(NamedTuple):
    """What a method makes of one segment.

    Args:
        status: How it ended.
        phases: The motion; empty where there is none.
        ratio: Largest quotient of a quantity and its limit along it; 0 where it was not computed.
        overshoot: Distance that full braking needs beyond the end [m].
        how: What led to the result, for the report.
        reason: Why it is not OK.
        limit: Which limit is in the way; empty where none is.
        s: Where that is decided [m]; None where it is not one place.
        arrives: Whether the motion ends at rest at the end of the segment.
    """

    status: TimingStatus
    phases: Phases = ()
    ratio: float = 0.0
    overshoot: float = 0.0
    how: str = ""
    reason: str = ""
    limit: str = ""
    s: float | None = None
    arrives: bool = True


def end_slack(limits: PathLimits) -> float:
    """How far from the end of the segment a motion may end [m]."""
    return min(_REACHED, _REACHED_SHARE * limits.length)


def arrived_plan(limits: PathLimits, motion: Motion, how: str) -> SegmentPlan:
    """A motion as a plan, OK where it ends at rest at the end of the segment; its limits are unproven."""
    off = abs(motion.end.s - limits.length)
    if off <= end_slack(limits) and max(abs(motion.end.v), abs(motion.end.a)) <= _REACHED:
        return SegmentPlan(TimingStatus.OK, motion.phases, how=how)
    reason = f"ends at {motion.end}, not at rest after {limits.length:.6g} m"
    return SegmentPlan(TimingStatus.FAIL, motion.phases, how=how, reason=reason)


def judged_plan(limits: PathLimits, motion: Motion, worst: Worst, how: str) -> SegmentPlan:
    """A motion as a plan: OK only if it arrives and the dense check, which found `worst`, finds every limit kept."""
    plan = arrived_plan(limits, motion, how)._replace(ratio=worst.ratio)
    if plan.status is not TimingStatus.OK or worst.ratio <= KEPT:
        return plan
    s = limits.begin + worst.s
    return plan._replace(status=TimingStatus.FAIL, reason=worst.words(limits.begin), limit=worst.limit, s=s)


def checked_plan(limits: PathLimits, start: MotionState, phases: Phases, how: str) -> SegmentPlan:
    """As `judged_plan`, after the dense check."""
    motion = Motion.of(start, phases)
    return judged_plan(limits, motion, worst_ratio(limits, motion) if phases else Worst(0.0, 0.0, 0.0, 0.0), how)


def refined_times(limits: PathLimits, motion: Motion, close: float) -> FloatArray:
    """The usual times, and half a millisecond apart wherever a limit of the path is used up to `close` or more."""
    t = motion.sample_times(SAMPLING.check_period)
    ratios = motion_ratios(limits, motion, t)
    near = ratios.s[np.maximum(ratios.speed, np.sqrt(ratios.turning)) > close]
    first = np.clip(np.searchsorted(motion.at(t)[0], near) - 1, 0, t.size - 2)
    spans = np.unique(np.concatenate((first, np.minimum(first + 1, t.size - 2), np.maximum(first - 1, 0))))
    steps = np.arange(1, SAMPLING.check_refinement) / SAMPLING.check_refinement
    return np.union1d(t, (t[spans, None] + (t[spans + 1] - t[spans])[:, None] * steps).ravel())
