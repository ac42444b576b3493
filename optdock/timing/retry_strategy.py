"""Strategy for computing a proven time law of a path, with all retries.

The robot is at rest at cusps and at the end, so each segment is planned separately. If the wheels must be steered
between two segments or at the start, the robot waits at rest. A turn in place is one move (`turn_plans`). For other
segments, the first of these cases that applies to the start state is used (`segment_plans`, `judge_start`):

1. At rest: the plans of the method, best first; a plan is made only if the previous plan was rejected.
2. The robot cannot avoid rolling backwards: BAD_START.
3. Full braking needs more distance than the segment has: CANNOT_STOP, with the braking motion.
4. Full braking, and thus every motion, violates a limit: START_INFEASIBLE, with braking past the last violation and
   then a plan, or braking to rest and then a plan from rest.
5. Otherwise: the plans of the method, then stop and go, which is full braking to rest and a plan from there.

The near-optimal method has several plans, listed in `near_optimal`; the windowed method has one plan. The plans of all
segments give a motion (`time_path`), which `certify_trajectory` certifies or rejects; if a segment is rejected, its
next plan is tried. The search ends when the remaining time is just enough for the windowed method and its proof. After
that, no other motion is tried.
"""

from __future__ import annotations

import itertools
import math
from abc import abstractmethod
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np

from optdock.deadline import ENDLESS, Deadline, OutOfTime, Stopwatch, never_late
from optdock.errors import InvalidValue, TimingCancelled
from optdock.model.constant_jerk import TimeLaw
from optdock.model.limits import LIMITS
from optdock.model.path import Path, PolylineSegment, TurnSegment, joint_curvatures
from optdock.model.segments import TURN_RADIUS
from optdock.model.trajectory import Trajectory
from optdock.plugins.interfaces import TimeParameterizer, TimingReport, TimingResult, TimingStatus, never_cancelled
from optdock.timing.jerk_phases import DriveBounds, Motion, MotionState, Phases
from optdock.timing.path_limits import NO_LENGTH, limits_along
from optdock.timing.plan_checks import KEPT, SegmentPlan, end_slack, worst_ratio
from optdock.timing.ruckig_moves import load_ruckig, move
from optdock.timing.start_states import NO_DISTANCE, Braking, judge_start
from optdock.verification import TOLERANCE, certify_trajectory

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from optdock.model.limits import MotionLimits, SpeedZone
    from optdock.timing.path_limits import PathLimits
    from optdock.timing.start_states import StartVerdict
    from optdock.verification import Violation

__all__ = [
    "LONGEST_MOTION",
    "NO_DEADLINES",
    "Deadlines",
    "SegmentPlanner",
    "SegmentTimeParameterizer",
    "TimingStart",
    "best_of",
    "segment_plans",
    "time_path",
    "turn_plans",
]

LONGEST_MOTION = 3600.0  # [s]: longer motions are rejected, because memory and time grow with them
_REST = MotionState()
_NO_WAIT = 0.5 * TOLERANCE  # [s]: shorter waits are omitted
_WITHOUT_MOTION = TimingStatus.FAIL, TimingStatus.BAD_START, TimingStatus.TIMED_OUT
# Reserves of a deadline, as multiples of the time for evaluating the curvature of the path, which depends on path and
# machine: on easy scenes, with kernels in C, the last method of the search takes 4, the windowed method 3 and the
# proof 2.7 in the median.
_WINDOWS_AND_PROOF = 6.0  # with less time left the search for a faster motion ends
_PROOF = 2.5  # with less time left no motion is started
_REFUSAL = 0.02  # [s]: time for the refusal of an impossible request


class Deadlines(NamedTuple):
    """Deadlines of the stages of a call."""

    search: Deadline = ENDLESS  # for all methods except the last
    last: Deadline = ENDLESS  # for the last method

    @classmethod
    def of(cls, whole: Deadline, lookup: float) -> Deadlines:
        """Return the shares of the deadline of a whole call; `lookup` is the time for evaluating the path [s]."""
        search = whole.shortened(_WINDOWS_AND_PROOF * lookup)
        return cls(search, whole.shortened(_PROOF * lookup))

    @property
    def refused(self) -> Deadlines:
        """Deadlines that apply after an impossible start."""
        return self._replace(search=self.search.shortened(at_most=_REFUSAL))


NO_DEADLINES = Deadlines()

SegmentPlanner: TypeAlias = "Callable[[PathLimits, MotionState, Deadlines, Braking | None], Iterator[SegmentPlan]]"
"""A method that plans one segment from a state from which full braking satisfies the speed caps.

The last argument is full braking from a moving start, None from rest.

It yields plans of status OK, best first, each made only if the previous plan was rejected; the last plan may have
status FAIL, with the reason.
"""


class TimingStart(NamedTuple):
    """Start of a motion: speed [m/s], acceleration [m/s^2], and the time at rest before the motion for steering [s]."""

    speed: float
    acceleration: float
    wait: float = 0.0


class SegmentTimeParameterizer(TimeParameterizer):
    """Time parameterizer that plans segment by segment with one method."""

    def on_configure(self) -> None:
        """Import the libraries before the first call.

        Raises:
            PluginError: If the package ruckig is not installed.
        """
        load_ruckig()

    def parameterize(  # noqa: PLR0913 - as TimeParameterizer.parameterize
        self,
        path: Path,
        limits: MotionLimits,
        zone: SpeedZone,
        *,
        start_speed: float = 0.0,
        start_acceleration: float = 0.0,
        start_wait: float = 0.0,
        max_time: float = math.inf,
        cancel_checker: Callable[[], bool] = never_cancelled,
    ) -> TimingResult:
        """Return the time law of a path; see `TimeParameterizer.parameterize`.

        Raises:
            InvalidValue: If the start state or `start_wait` is not finite, the wait is negative, or `max_time` is NaN.
            PluginError: If the package ruckig is not installed.
            TimingCancelled: If `cancel_checker` returned True.
        """
        deadline = Deadline(max_time, stop=never_late if cancel_checker is never_cancelled else cancel_checker)
        start = TimingStart(start_speed, start_acceleration, start_wait)
        return time_path(path, limits, zone, start, self.segment_plans, deadline)

    @abstractmethod
    def segment_plans(
        self, limits: PathLimits, start: MotionState, deadlines: Deadlines, braking: Braking | None
    ) -> Iterator[SegmentPlan]:
        """Yield plans of one segment; implements `SegmentPlanner`."""


class _Request(NamedTuple):
    """Limits and start of a motion; see `time_path`."""

    drive: MotionLimits
    zone: SpeedZone
    start: TimingStart


def time_path(
    path: Path,
    drive: MotionLimits,
    zone: SpeedZone,
    start: TimingStart,
    method: SegmentPlanner,
    deadline: Deadline | None = None,
) -> TimingResult:
    """Return the time law of a path; a result with status OK is certified by `certify_trajectory`.

    Args:
        path: Path to drive.
        drive: Limits of the drive.
        zone: Speed zone at the end of the path.
        start: Start of the motion.
        method: Planner of one segment.
        deadline: Deadline of the whole call; None: no deadline.

    Raises:
        InvalidValue: If the start state or the wait is not finite, the wait is negative, or the deadline is NaN.
        TimingCancelled: If the call was cancelled.
    """
    whole = deadline or Deadline()
    if not (math.isfinite(start.speed) and math.isfinite(start.acceleration)):
        raise InvalidValue(f"timing: start_speed and start_acceleration must be finite, got {start[:2]}")
    if not (math.isfinite(start.wait) and start.wait >= 0.0):
        raise InvalidValue(f"timing: start_wait must be finite and >= 0 s, got {start.wait}")
    if math.isnan(whole.seconds):
        raise InvalidValue("timing: max_time must be a number of seconds, got nan")
    result = _timed(path, _Request(drive, zone, start), method, whole)
    if result.status is TimingStatus.TIMED_OUT and whole.stopped:
        raise TimingCancelled("timing was cancelled")
    return result


def _timed(path: Path, request: _Request, method: SegmentPlanner, whole: Deadline) -> TimingResult:
    drive, zone, start = request
    fault = _undrivable(path)
    if not fault and start.wait > _NO_WAIT and (start.speed, start.acceleration) != (0.0, 0.0):
        fault = f"the wheels may take {start.wait:.4g} s to turn at the start, where the robot does not rest"
    if fault:
        return TimingResult(TimingStatus.FAIL, None, math.inf, reason=fault)
    if whole.passed():
        return TimingResult(TimingStatus.TIMED_OUT, None, reason=f"no time: max_time is {whole.seconds:.3g} s")
    watch = Stopwatch(whole)
    segments = limits_along(path, drive, zone)
    deadlines = Deadlines.of(whole, watch.read()[1])
    waiting: list[Iterator[SegmentPlan]] = []
    plans: list[SegmentPlan] = []
    state = MotionState(0.0, start.speed, start.acceleration)
    for segment, begin, limits in zip(path.segments, path.segment_starts.tolist(), segments, strict=False):
        if isinstance(segment, TurnSegment):
            waiting.append(turn_plans(segment, drive, state, begin))
        else:
            waiting.append(segment_plans(limits, state, method, deadlines))
        plans.append(best_of(waiting[-1]))
        if plans[-1].status >= TimingStatus.FAIL or not plans[-1].arrives:
            break
        state = _REST if plans[-1].phases else state
        deadlines = deadlines if plans[-1].status is TimingStatus.OK else deadlines.refused
    return _proven(path, request, plans, waiting, whole)


def _proven(
    path: Path, request: _Request, plans: list[SegmentPlan], waiting: list[Iterator[SegmentPlan]], whole: Deadline
) -> TimingResult:
    """Return the certified result, with new plans in place of rejected ones, or the failure of a segment."""
    drive, zone, start = request
    while True:
        worst = max(plans, key=lambda plan: plan.status)  # statuses are ordered by severity
        trajectory = None if worst.status in _WITHOUT_MOTION else _driven(path, request, plans)
        if worst.status is not TimingStatus.OK or trajectory is None:
            return _result(plans, worst, trajectory)
        proof = certify_trajectory(
            trajectory,
            drive,
            zone,
            start_speed=start.speed,
            start_acceleration=start.acceleration,
            start_wait=start.wait,
            is_late=whole.passed,
        )
        if proof.certified:
            return _result(plans, worst, trajectory, max(proof.ratios.values()))
        if whole.passed():
            reason = "the time was up before the motion was proven"
            return replace(_result(plans, worst, None), status=TimingStatus.TIMED_OUT, reason=reason)
        first = proof.violations[0]
        i = int(np.clip(np.searchsorted(path.segment_starts, first.s, side="right") - 1, 0, len(plans) - 1))
        plans[i] = best_of(itertools.chain(waiting[i], [_refused(plans[i], first)]))


def _undrivable(path: Path) -> str:
    """Return a description of a turn in place in a polyline, which has no time law; empty if there is none."""
    for segment, begin in zip(path.segments, path.segment_starts[:-1], strict=True):
        if not isinstance(segment, PolylineSegment):
            continue
        first = int(np.argmin(np.isfinite(segment.step_curvature)))  # index of the first step of zero length, or 0
        turn = float(segment.poses[first + 1, 2] - segment.poses[first, 2])
        if not math.isfinite(segment.step_curvature[first]) and turn != 0.0:
            where = f"by {turn:.6g} rad at s = {begin + float(segment.knots[first]):.6g} m"
            return f"path turns in place {where}; a turn in place must be a TurnSegment"
    for segment in path.segments:
        if segment.length > NO_LENGTH:
            return ""
    return "path has no length"


def _driven(path: Path, request: _Request, plans: list[SegmentPlan]) -> Trajectory:
    """Return the motion of all plans, with the rests between them."""
    driven = path if len(plans) == len(path.segments) else Path(path.segments[: len(plans)])
    waits = _waits(path, request)
    parts = [(*waits.get(i, ()), *plan.phases) for i, plan in enumerate(plans)]
    phases = np.array([phase for part in parts for phase in part if phase[0] > 0.0])
    return Trajectory(driven, TimeLaw(phases[:, 0], phases[:, 1], 0.0, *request.start[:2]))


def _result(
    plans: list[SegmentPlan], worst: SegmentPlan, trajectory: Trajectory | None, proven: float | None = None
) -> TimingResult:
    """Return the result with the status of the worst plan; `proven`: largest ratio that was proven."""
    return TimingResult(
        worst.status,
        trajectory,
        max(plan.ratio for plan in plans) if proven is None else proven,
        worst.overshoot,
        TimingReport(tuple(plan.how for plan in plans)),
        reason=worst.reason,
        limit=worst.limit,
        at_s=worst.s,
    )


def _waits(path: Path, request: _Request) -> dict[int, Phases]:
    """Return the phases at rest before the segments for which the wheels must be steered."""
    times = [request.start.wait]
    if len(path.segments) > 1 and math.isfinite(request.drive.max_steering_rate):
        times += request.drive.steering_times(joint_curvatures(path)).tolist()
    return {i: ((time, 0.0),) for i, time in enumerate(times) if time > _NO_WAIT}


def _refused(plan: SegmentPlan, violation: Violation) -> SegmentPlan:
    """Return the failure of a segment whose last plan is rejected by the proof."""
    reason = f"the last method, {plan.how}, is not certified: {violation.message}"
    named = [limit.name for limit in LIMITS.values() if limit.quantity == violation.kind]
    limit = named[0] if len(named) == 1 else ""  # a speed limit may be that of either gear, or of the zone
    return SegmentPlan(TimingStatus.FAIL, how=plan.how, reason=reason, limit=limit, s=violation.s, arrives=False)


def best_of(plans: Iterator[SegmentPlan]) -> SegmentPlan:
    """Return the next plan whose status is not FAIL, or the last plan; TIMED_OUT if the time is up."""
    last: SegmentPlan | None = None
    try:
        for last in plans:
            if last.status is not TimingStatus.FAIL:
                return last
    except OutOfTime:
        return SegmentPlan(TimingStatus.TIMED_OUT, how="none", reason="the time was up before a motion was found")
    nothing = "no method found a motion for this gear"
    return last or SegmentPlan(TimingStatus.FAIL, how="none", reason=nothing, arrives=False)


def segment_plans(
    limits: PathLimits | None, start: MotionState, method: SegmentPlanner, deadlines: Deadlines = NO_DEADLINES
) -> Iterator[SegmentPlan]:
    """Yield plans of one segment from any start state, best first; reject impossible starts with a reason.

    Args:
        limits: Limits along the segment; None if it has no length.
        start: State at s = 0.
        method: Planner for start states from which the limits can be satisfied.
        deadlines: Deadlines in wall-clock time.

    Raises:
        OutOfTime: If a deadline passed between two plans.
    """
    if limits is None:
        yield SegmentPlan(TimingStatus.OK, how="empty")
        return
    longest, duration = LONGEST_MOTION, limits.duration_estimate
    if duration > longest:
        reason = f"the drive would take about {duration:.3g} s; motions of more than {longest:.0f} s are not planned"
        yield SegmentPlan(TimingStatus.FAIL, how="refused", reason=reason, s=limits.begin)
        return
    if start.v == 0.0 and start.a == 0.0:
        yield from method(limits, start, deadlines, None)
        return
    verdict = judge_start(limits, start)
    if verdict.refusal is None:
        plans = method(limits, start, deadlines, verdict.braking)
        yield from (plan for plan in plans if plan.status is TimingStatus.OK)
    elif not verdict.ways_on:
        yield verdict.refusal
        return
    yield _braked_plan(limits, start, verdict, method, deadlines)


def turn_plans(turn: TurnSegment, drive: MotionLimits, start: MotionState, begin: float) -> Iterator[SegmentPlan]:
    """Yield the plan of a turn in place, which is the fastest move from rest to rest within the limits of turning.

    Args:
        turn: The segment.
        drive: Limits of the drive.
        start: State at the start of the segment.
        begin: Start of the segment on the whole path [m].
    """
    rate, acceleration, jerk = (TURN_RADIUS * limit for limit in drive.turning)
    reason = ""
    if not math.isfinite(rate + acceleration):
        needed = "max_yaw_rate and max_yaw_acceleration, or max_wheel_speed and track_width"
        reason = f"the path turns in place at s = {begin:.6g} m, which requires the limits {needed}"
    elif start != MotionState():
        reason = f"the path turns in place at s = {begin:.6g} m, where the robot moves at {start.v:.6g} m/s"
    elif turn.length / rate > LONGEST_MOTION:
        reason = f"a turn by {turn.turn:.6g} rad takes more than {LONGEST_MOTION:.0f} s"
    if reason:
        yield SegmentPlan(TimingStatus.FAIL, how="refused", reason=reason, s=begin)
        return
    phases = move(start, MotionState(turn.length), DriveBounds(rate, acceleration, acceleration, jerk))
    yield SegmentPlan(TimingStatus.OK if phases else TimingStatus.FAIL, phases or (), how="turn in place")


def _braked_plan(
    limits: PathLimits, start: MotionState, verdict: StartVerdict, method: SegmentPlanner, deadlines: Deadlines
) -> SegmentPlan:
    """Return a plan that brakes and then continues; limits are violated only while braking, if at all."""
    phases = _resumed(limits, verdict, method, deadlines if verdict.refusal is None else deadlines.refused)
    motion = Motion.of(start, phases)
    worst, arrives = worst_ratio(limits, motion), motion.end.s >= limits.length - end_slack(limits)
    if verdict.refusal is not None:
        return verdict.refusal._replace(phases=phases, ratio=max(verdict.refusal.ratio, worst.ratio), arrives=arrives)
    if not arrives:
        deadlines.last.look()
        reason, s = "no plan from rest after full braking", limits.begin + motion.end.s
        return SegmentPlan(TimingStatus.FAIL, phases, worst.ratio, 0.0, "stop", reason, s=s)
    if worst.ratio <= KEPT:
        return SegmentPlan(TimingStatus.OK, phases, worst.ratio, 0.0, "stop and go")
    status, s = TimingStatus.START_INFEASIBLE, limits.begin + worst.s
    reason = f"no plan found; full braking reaches {worst.words(limits.begin)}"
    return SegmentPlan(status, phases, worst.ratio, 0.0, "stop and go", reason, worst.limit, s)


def _resumed(limits: PathLimits, verdict: StartVerdict, method: SegmentPlanner, deadlines: Deadlines) -> Phases:
    """Return braking and the first plan for the remaining segment, or braking to rest if no plan is found in time."""
    for phases, state in verdict.ways_on:
        if limits.length - state.s < NO_DISTANCE:
            continue
        rest, begin = limits.after(state.s), MotionState(0.0, max(state.v, 0.0), state.a)
        moves = begin.v > 0.0 or begin.a > 0.0
        found = best_of(method(rest, begin, deadlines, Braking(rest, begin) if moves else None))
        if found.status is TimingStatus.OK and found.phases:
            return phases + found.phases
    return verdict.ways_on[-1][0]
