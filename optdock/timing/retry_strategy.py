"""The strategy: from a path to a proven time law. Every retry is in this list.

At a cusp and at the end the robot rests, so segments do not touch each other; each is planned alone. Where the wheels
must be turned, between two of them or at the start, the robot waits at rest for as long as that takes. A turn in place
is one move
(`turn_plans`). From its start state the first line that fits counts (`segment_plans`, `judge_start`):

1. At rest: the plans of the method, best first; the next one is made only when the one before was refused.
2. It rolls backwards whatever is done: BAD_START.
3. Full braking needs more room than there is: CANNOT_STOP, with the braking.
4. Full braking breaks a limit, and so does every motion: START_INFEASIBLE, braking until past the last broken limit and
   then a plan, or the whole braking and then a plan from rest.
5. Otherwise the plans of the method; then stop and go, full braking to rest and a plan from there.

The near-optimal method has its own list in `near_optimal`; the windowed method has one plan. The plans of all segments
make a motion (`time_path`), which `certify_trajectory` proves or refuses; where it refuses, that segment gets its next
plan. Searching ends when the deadline leaves just enough for windows and their proof; later no motion is begun.
"""

from __future__ import annotations

import itertools
import math
import time
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np

from optdock.deadline import ENDLESS, Deadline, OutOfTime
from optdock.errors import InvalidValue, TimingCancelled
from optdock.model.limits import LIMITS
from optdock.model.path import Path, PolylineSegment, TurnSegment, joint_curvatures
from optdock.model.segments import TURN_RADIUS
from optdock.model.trajectory import TimeLaw, Trajectory
from optdock.plugins.interfaces import TimingReport, TimingResult, TimingStatus
from optdock.timing.jerk_phases import DriveBounds, Motion, MotionState, Phases
from optdock.timing.path_limits import KEPT, NO_LENGTH, limits_along, worst_ratio
from optdock.timing.plan_checks import SegmentPlan, end_slack
from optdock.timing.ruckig_moves import move
from optdock.timing.start_states import NO_DISTANCE, judge_start
from optdock.timing.timing_settings import CLOCK, SAMPLING
from optdock.verification import TOLERANCE, certify_trajectory

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from optdock.model.limits import MotionLimits, SpeedZone
    from optdock.model.path import Segment
    from optdock.timing.path_limits import PathLimits
    from optdock.timing.start_states import StartVerdict
    from optdock.verification import Violation

__all__ = ["NO_DEADLINES", "Deadlines", "SegmentPlanner", "TimingStart", "best_of", "segment_plans", "time_path"]


class Deadlines(NamedTuple):
    """What the stages of a call may use of its deadline.

    Args:
        search: For methods after which another one is left.
        last: For the last method.
    """

    search: Deadline = ENDLESS
    last: Deadline = ENDLESS

    @classmethod
    def of(cls, whole: Deadline, lookup: float) -> Deadlines:
        """Shares of a whole call's deadline; `lookup` is how long its path took to look up [s]."""
        search = whole.shortened(CLOCK.windows_and_proof * lookup)
        return cls(search, whole.shortened(CLOCK.proof * lookup))

    @property
    def refused(self) -> Deadlines:
        """For what is left to do after an impossible start."""
        return self._replace(search=self.search.shortened(at_most=CLOCK.refusal))


NO_DEADLINES = Deadlines()
_NO_WAIT = 0.5 * TOLERANCE  # [s]: wheels that need no more than that do not wait

SegmentPlanner: TypeAlias = "Callable[[PathLimits, MotionState, Deadlines], Iterator[SegmentPlan]]"
"""A method: plans one segment from a state whose full braking keeps the speed caps.

Yields plans of status OK, best first, the next one made only when the one before was refused; at last perhaps one of
status FAIL, which says why there is none.
"""


class TimingStart(NamedTuple):
    """How a motion begins: speed [m/s], acceleration [m/s^2]; how long it rests first while wheels turn [s]."""

    speed: float
    acceleration: float
    wait: float = 0.0


def time_path(
    path: Path,
    drive: MotionLimits,
    zone: SpeedZone,
    start: TimingStart,
    method: SegmentPlanner,
    deadline: Deadline | None = None,
) -> TimingResult:
    """The time law of a path, segment by segment. What it calls OK is proven: `certify_trajectory` decides.

    Args:
        path: Where to drive.
        drive: What the drive can do.
        zone: Slow stretch at the end of the path.
        start: How it begins.
        method: Plans one segment.
        deadline: For all of it, and whether to stop; None: no deadline.

    Raises:
        InvalidValue: The start state or the wait is not finite, the wait negative, or the deadline is NaN.
        TimingCancelled: The deadline was asked to stop.
    """
    whole = deadline or Deadline()
    result = _timed(path, _Asked(drive, zone, start), method, whole)
    if result.status is TimingStatus.TIMED_OUT and whole.stopped:
        raise TimingCancelled("timing was cancelled")
    return result


class _Asked(NamedTuple):
    """What the motion must keep, and how it begins; see `time_path`."""

    drive: MotionLimits
    zone: SpeedZone
    start: TimingStart


def _timed(path: Path, asked: _Asked, method: SegmentPlanner, whole: Deadline) -> TimingResult:
    drive, zone, start = asked
    _check_numbers(start, whole)
    fault = _undrivable(path)
    if not fault and start.wait > _NO_WAIT and (start.speed, start.acceleration) != (0.0, 0.0):
        fault = f"the wheels may take {start.wait:.4g} s to turn at the start, where the robot does not rest"
    if fault:
        return TimingResult(TimingStatus.FAIL, None, math.inf, reason=fault)
    if whole.passed():
        return TimingResult(TimingStatus.TIMED_OUT, None, reason=f"no time: max_time is {whole.seconds:.3g} s")
    began = whole.elapsed, time.thread_time()
    segments = limits_along(path, drive, zone)
    # Of two clocks the smaller: one counts while the machine does something else, the other may tick coarsely.
    deadlines = Deadlines.of(whole, min(whole.elapsed - began[0], time.thread_time() - began[1]))
    waiting, plans = [], []
    state = MotionState(0.0, start.speed, start.acceleration)
    for segment, begin, limits in zip(path.segments, path.segment_starts.tolist(), segments, strict=False):
        if isinstance(segment, TurnSegment):
            waiting.append(turn_plans(segment, drive, state, begin))
        else:
            waiting.append(segment_plans(limits, state, method, deadlines))
        plans.append(best_of(waiting[-1]))
        if plans[-1].status >= TimingStatus.FAIL or not plans[-1].arrives:
            break
        state = MotionState() if plans[-1].phases else state
        deadlines = deadlines if plans[-1].status is TimingStatus.OK else deadlines.refused
    return _proven(path, asked, (plans, waiting), whole)


def _proven(
    path: Path,
    asked: _Asked,
    segments: tuple[list[SegmentPlan], list[Iterator[SegmentPlan]]],
    whole: Deadline,
) -> TimingResult:
    """The result once every refused segment has another plan, or none is left."""
    (drive, zone, start), (plans, waiting) = asked, segments
    while True:
        result = _result(path, asked, plans)
        if result.status is not TimingStatus.OK or result.trajectory is None:
            return result
        proof = certify_trajectory(
            result.trajectory,
            drive,
            zone,
            start_speed=start.speed,
            start_acceleration=start.acceleration,
            start_wait=start.wait,
            is_late=whole.passed,
        )
        if proof.certified:
            return replace(result, worst_ratio=max(proof.ratios.values()))
        if whole.passed():
            reason = "the time was up before the motion was proven"
            return replace(result, status=TimingStatus.TIMED_OUT, trajectory=None, reason=reason)
        first = proof.violations[0]
        i = int(np.clip(np.searchsorted(path.segment_starts, first.s, side="right") - 1, 0, len(plans) - 1))
        plans[i] = best_of(itertools.chain(waiting[i], [_refused(plans[i], first)]))


def _check_numbers(start: TimingStart, whole: Deadline) -> None:
    if not all(math.isfinite(value) for value in start[:2]):
        raise InvalidValue(f"timing: start_speed and start_acceleration must be finite, got {start[:2]}")
    if not (math.isfinite(start.wait) and start.wait >= 0.0):
        raise InvalidValue(f"timing: start_wait must be finite and >= 0 s, got {start.wait}")
    if math.isnan(whole.seconds):
        raise InvalidValue("timing: max_time must be a number of seconds, got nan")


def _undrivable(path: Path) -> str:
    """Where the robot turns on the spot, which no time law over arc length can drive; empty if nowhere."""
    for segment, begin in zip(path.segments, path.segment_starts[:-1], strict=True):
        turn, s = _turn_in_place(segment)
        if turn != 0.0:
            where = f"by {turn:.6g} rad at s = {begin + s:.6g} m"
            return f"path turns in place {where}; a time law over arc length cannot drive that"
    return "" if any(segment.length > NO_LENGTH for segment in path.segments) else "path has no length"


def _turn_in_place(segment: Segment) -> tuple[float, float]:
    if not isinstance(segment, PolylineSegment):
        return 0.0, 0.0
    still = np.flatnonzero(~np.isfinite(segment.step_curvature))
    if still.size == 0:
        return 0.0, 0.0
    first = int(still[0])
    return float(segment.poses[first + 1, 2] - segment.poses[first, 2]), float(segment.knots[first])


def _result(path: Path, asked: _Asked, plans: list[SegmentPlan]) -> TimingResult:
    worst = max(plans, key=lambda plan: plan.status)  # the statuses are in order of gravity
    trajectory = None
    if worst.status not in (TimingStatus.FAIL, TimingStatus.BAD_START, TimingStatus.TIMED_OUT):
        driven = path if len(plans) == len(path.segments) else Path(path.segments[: len(plans)])
        waits = _waits(path, asked)
        parts = [(*waits.get(i, ()), *plan.phases) for i, plan in enumerate(plans)]
        phases = np.array([phase for part in parts for phase in part if phase[0] > 0.0])
        trajectory = Trajectory(driven, TimeLaw(phases[:, 0], phases[:, 1], 0.0, *asked.start[:2]))
    return TimingResult(
        worst.status,
        trajectory,
        max(plan.ratio for plan in plans),
        worst.overshoot,
        TimingReport(tuple(plan.how for plan in plans)),
        reason=worst.reason,
        limit=worst.limit,
        at_s=worst.s,
    )


def _waits(path: Path, asked: _Asked) -> dict[int, Phases]:
    """Phases at rest before those segments that the wheels must be turned for."""
    times = [asked.start.wait]
    if len(path.segments) > 1 and math.isfinite(asked.drive.max_steering_rate):
        times += asked.drive.steering_times(joint_curvatures(path)).tolist()
    return {i: ((time, 0.0),) for i, time in enumerate(times) if time > _NO_WAIT}


def _refused(plan: SegmentPlan, violation: Violation) -> SegmentPlan:
    """What is left to say where the last plan of a segment is refused by the proof."""
    reason = f"the last method, {plan.how}, is not certified: {violation.message}"
    named = [limit.name for limit in LIMITS.values() if limit.quantity == violation.kind]
    limit = named[0] if len(named) == 1 else ""  # of a speed: its gear's, or the zone's
    return SegmentPlan(TimingStatus.FAIL, how=plan.how, reason=reason, limit=limit, s=violation.s, arrives=False)


def best_of(plans: Iterator[SegmentPlan]) -> SegmentPlan:
    """The next plan of what a method yields that is not FAIL, or the last; TIMED_OUT where time is up."""
    last = SegmentPlan(TimingStatus.FAIL, how="none", reason="no method has a motion for this gear", arrives=False)
    try:
        for last in plans:
            if last.status is not TimingStatus.FAIL:
                break
    except OutOfTime:
        return SegmentPlan(TimingStatus.TIMED_OUT, how="none", reason="the time was up before a motion was found")
    return last


def segment_plans(
    limits: PathLimits | None, start: MotionState, method: SegmentPlanner, deadlines: Deadlines = NO_DEADLINES
) -> Iterator[SegmentPlan]:
    """Plans of one segment from any start state, best first; impossible starts are refused by name.

    Args:
        limits: Along the segment; None where it has no length.
        start: At s = 0.
        method: Plans from a state from which the limits can be kept.
        deadlines: Wall-clock time.

    Raises:
        OutOfTime: Between two plans.
    """
    if limits is None:
        yield SegmentPlan(TimingStatus.OK, how="empty")
        return
    longest, duration = SAMPLING.longest_motion, limits.duration_estimate
    if duration > longest:
        reason = f"the drive would take about {duration:.3g} s; motions of more than {longest:.0f} s are not planned"
        yield SegmentPlan(TimingStatus.FAIL, how="refused", reason=reason, s=limits.begin)
        return
    if start.v == 0.0 and start.a == 0.0:
        yield from method(limits, start, deadlines)
        return
    verdict = judge_start(limits, start)
    if verdict.refusal is None:
        yield from (plan for plan in method(limits, start, deadlines) if plan.status is TimingStatus.OK)
    elif not verdict.ways_on:
        yield verdict.refusal
        return
    yield _braked_plan(limits, start, verdict, method, deadlines)


def turn_plans(turn: TurnSegment, drive: MotionLimits, start: MotionState, begin: float) -> Iterator[SegmentPlan]:
    """The plan of a turn in place: one move from rest to rest, the fastest under the limits of turning.

    Args:
        turn: To be driven over its stretch of the path coordinate.
        drive: What the drive can do.
        start: At its beginning.
        begin: Where that is on the whole path [m].
    """
    rate, acceleration, jerk = (TURN_RADIUS * limit for limit in drive.turning)
    if not math.isfinite(rate + acceleration):
        needed = "max_yaw_rate and max_yaw_acceleration, or max_wheel_speed and track_width"
        reason = f"the path turns in place at s = {begin:.6g} m, and nothing limits that: it takes {needed}"
        yield SegmentPlan(TimingStatus.FAIL, how="refused", reason=reason, s=begin)
    elif start != MotionState():
        reason = f"the path turns in place at s = {begin:.6g} m, where the robot moves at {start.v:.6g} m/s"
        yield SegmentPlan(TimingStatus.FAIL, how="refused", reason=reason, s=begin)
    elif turn.length / rate > SAMPLING.longest_motion:
        reason = f"a turn by {turn.turn:.6g} rad takes more than {SAMPLING.longest_motion:.0f} s"
        yield SegmentPlan(TimingStatus.FAIL, how="refused", reason=reason, s=begin)
    else:
        phases = move(start, MotionState(turn.length), DriveBounds(rate, acceleration, acceleration, jerk))
        yield SegmentPlan(TimingStatus.OK if phases else TimingStatus.FAIL, phases or (), how="turn in place")


def _braked_plan(
    limits: PathLimits, start: MotionState, verdict: StartVerdict, method: SegmentPlanner, deadlines: Deadlines
) -> SegmentPlan:
    """Braking, then a plan: always drivable, a violation only where braking itself has one."""
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
    """Braking, and the first plan of what is left of the segment; braking to rest where there is none in time."""
    for phases, state in verdict.ways_on:
        if limits.length - state.s < NO_DISTANCE:
            continue
        found = best_of(method(limits.after(state.s), MotionState(0.0, max(state.v, 0.0), state.a), deadlines))
        if found.status is TimingStatus.OK and found.phases:
            return phases + found.phases
    return verdict.ways_on[-1][0]
