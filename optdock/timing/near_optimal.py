"""The near-optimal method: within about 1 % of the jerk-limited optimum, in a few milliseconds.

For each segment the method yields the following plans (`near_optimal_plans`), each only if the previous plan was
rejected:

1. One ruckig move over the whole segment, if it satisfies the limits; on a tiny segment, also slower moves.
2. A reference and the moves along it.
3. From rest, the same motion slightly stretched in time. The stretch is exact and always possible.
4. Steps 2 and 3 again with reduced speeds around violations, at most twice.
5. From rest, the best of these motions, stretched until it satisfies every limit, and the result of the windowed
   method, the faster of the two first.

If the robot moves at the start and all plans are rejected, `retry_strategy` brakes to rest and plans from there. It
also makes the final proof.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

from pydantic import Field

from optdock.deadline import ENDLESS, Deadline, OutOfTime
from optdock.plugins.interfaces import TimingStatus
from optdock.plugins.parameters import PluginParameters
from optdock.timing.jerk_phases import DriveBounds, Motion, MotionState, Phases, duration_of, stretched
from optdock.timing.path_limits import CHECK_MARGIN, KNOT_STEP, SPEED_MARGIN, ReferenceBounds, Tightening
from optdock.timing.plan_checks import (
    KEPT,
    SegmentPlan,
    Worst,
    arrived_plan,
    checked_plan,
    judged_plan,
    refined_times,
    worst_ratio,
)
from optdock.timing.reference_program import solve_reference, spline_phases
from optdock.timing.retry_strategy import SegmentTimeParameterizer
from optdock.timing.ruckig_moves import Move, move, split_into_moves
from optdock.timing.windowed import windowed_plans

if TYPE_CHECKING:
    from collections.abc import Iterator

    from optdock.timing.path_limits import PathLimits
    from optdock.timing.retry_strategy import Deadlines
    from optdock.timing.start_states import Braking

__all__ = ["NearOptimal", "NearOptimalParameters", "ReferenceMotion", "near_optimal_plans", "reference_motion"]

_SINGLE_MOVE_BELOW = 1.0  # [m]: longer segments are not tried with a single move
_TINY = 0.08  # [m]: segments too short for a reference, which are tried with slower single moves
_SLOWER_MOVES = ((1.0, 1.0), (0.5, 1.0), (0.5, 0.5), (0.25, 0.5), (0.25, 0.25))  # shares of speed and drive limits
_SINGLE_MOVE_SPARE = 1.0005  # additional stretch of the slower moves, because the check uses samples
_LONGEST_REFERENCE = 150.0  # [s]: the number of knots grows with the duration, the gain over `Windowed` does not
_MOST_KNOTS = 5000  # of a reference: a few MB, and 10 ms for an iteration
_RELIEF = 3.0  # margins: while the braking of a moving start is closer to the limits, no margins are applied
_TIGHT_YAW = 0.95  # share of a turning limit: while the braking of a moving start is above it, no margins are applied
_STRETCH_AT_ONCE = 1.012  # up to this factor, stretching time is better than another attempt
_STRETCH_AT_LAST = 1.1  # beyond this factor, the windowed method may be better
_RETRIES = 2  # number of attempts with reduced speeds
_LONGEST_RETRIED = 60.0  # [s]: longer motions take 0.3 s and more for every attempt
_AROUND, _MORE = 0.06, 0.006  # [m] around a violation; reduction of the speeds in addition to the excess
_LEAST_FACTOR = 0.3  # least factor on the speeds


class NearOptimalParameters(PluginParameters):
    """Parameters of `NearOptimal`."""

    step: float = Field(default=KNOT_STEP, gt=0.01, le=0.5, description="knot spacing of the reference [s]")
    smooth: bool = Field(default=False, description="nearly continuous jerk between knots, instead of +-max_jerk")


class NearOptimal(SegmentTimeParameterizer):
    """Compute time laws within about 1 % of the jerk-limited optimum, in a few milliseconds."""

    Parameters = NearOptimalParameters
    parameters: NearOptimalParameters

    def segment_plans(
        self, limits: PathLimits, start: MotionState, deadlines: Deadlines, braking: Braking | None
    ) -> Iterator[SegmentPlan]:
        """Yield plans of one segment; see `near_optimal_plans`."""
        step, smooth = self.parameters.step, self.parameters.smooth
        return near_optimal_plans(limits, start, deadlines, braking, step, smooth=smooth)


def near_optimal_plans(
    limits: PathLimits,
    start: MotionState,
    deadlines: Deadlines,
    braking: Braking | None,
    step: float = KNOT_STEP,
    *,
    smooth: bool = False,
) -> Iterator[SegmentPlan]:
    """Yield plans of one segment by every method in order, from a start state that permits the speed caps.

    A plan is made only if the previous plan was rejected. The status of the windowed method's plan may be FAIL.

    Args:
        limits: Limits along the segment.
        start: State at the start of the segment.
        deadlines: Deadlines in wall-clock time.
        braking: Full braking from a moving start; None from rest.
        step: Knot spacing of the reference [s].
        smooth: Whether the reference itself is the motion.

    Raises:
        OutOfTime: If the time is up and the remaining methods need time.
    """
    tried: list[_Tried] = []
    longest = min(_LONGEST_REFERENCE, _MOST_KNOTS * step)
    if limits.duration_estimate <= longest:
        try:
            if not smooth:
                yield from _single_moves(limits, start)
            relief = braking.tight_length(_RELIEF * SPEED_MARGIN, _TIGHT_YAW) if braking is not None else 0.0
            yield from _references(limits, start, deadlines.search, (step, smooth, relief), tried)
        except OutOfTime:
            pass
    yield from _last_resort(limits, start, deadlines, tried)


def _if_ok(plan: SegmentPlan) -> tuple[SegmentPlan, ...]:
    return (plan,) if plan.status is TimingStatus.OK else ()


def _single_moves(limits: PathLimits, start: MotionState) -> Iterator[SegmentPlan]:
    """Yield one move over a short segment; over a tiny segment, the fastest of several stretched moves."""
    if limits.length >= _SINGLE_MOVE_BELOW:
        return
    full = limits.drive_bounds._replace(speed=limits.fastest)
    end = MotionState(limits.length)
    phases = move(start, end, full)
    plan = checked_plan(limits, start, phases, "one move") if phases else None
    if plan is not None and plan.status is TimingStatus.OK:
        yield plan
        return
    if limits.length >= _TINY or start != MotionState():
        return
    shares = (
        DriveBounds(speed * full.speed, drive * full.acceleration, drive * full.deceleration, full.jerk)
        for speed, drive in _SLOWER_MOVES
    )
    moves = [phases for share in shares if (phases := move(start, end, share))]
    worst = [worst_ratio(limits, Motion.of(start, phases)) for phases in moves]
    slowed = [
        stretched(phases, max(one.path * _SINGLE_MOVE_SPARE, one.drive))
        for phases, one in zip(moves, worst, strict=True)
    ]
    yield from _if_ok(checked_plan(limits, start, min(slowed, key=duration_of, default=()), "one move, stretched"))


class ReferenceMotion(NamedTuple):
    """A motion over a segment along a reference."""

    phases: Phases  # the motion
    moves: tuple[Move, ...] = ()  # moves of the motion; empty if the reference itself is the motion

    @property
    def bad(self) -> tuple[Move, ...]:
        """Moves that violate a limit."""
        return tuple([one for one in self.moves if one.excess > 1.0])

    @property
    def sound(self) -> bool:
        """Whether every move is within the checked limits; False if the reference itself is the motion."""
        return bool(self.moves) and not self.bad


def reference_motion(
    bounds: ReferenceBounds, start: MotionState, deadline: Deadline = ENDLESS
) -> ReferenceMotion | None:
    """Return the motion under `bounds` from `start` along a reference, or None if there is no reference.

    Raises:
        OutOfTime: If the deadline passed.
    """
    reference = solve_reference(bounds, start, deadline)
    if reference is None:
        return None
    if bounds.smooth:
        cells = spline_phases(*reference.table[:3])
        return ReferenceMotion(reference.launch.phases + cells + reference.stop.phases)
    moves = split_into_moves(reference, bounds, start, deadline)
    return ReferenceMotion(tuple([phase for one in moves for phase in one.phases]), tuple(moves))


class _Tried(NamedTuple):
    """A rejected motion along a reference, and its worst violation."""

    motion: ReferenceMotion
    worst: Worst


def _references(
    limits: PathLimits, start: MotionState, deadline: Deadline, options: tuple[float, bool, float], tried: list[_Tried]
) -> Iterator[SegmentPlan]:
    """Yield references, each slower than the last, unchanged or slightly stretched; add rejected motions to `tried`."""
    tightenings: tuple[Tightening, ...] = ()
    for retry in range(_RETRIES + 1 if limits.duration_estimate <= _LONGEST_RETRIED else 1):
        how = "reference" if retry == 0 else f"reference, retry {retry}"
        found = reference_motion(ReferenceBounds(limits, *options, tightenings), start, deadline)
        if found is None:
            return
        if found.sound:
            yield from _if_ok(arrived_plan(limits, start, found.phases, how))
        deadline.look()
        motion = Motion.of(start, found.phases)
        tried.append(_Tried(found, worst_ratio(limits, motion)))
        yield from _repaired(limits, motion, tried[-1], how)
        tightenings += _tightened(tried[-1])


def _repaired(limits: PathLimits, motion: Motion, tried: _Tried, how: str) -> Iterator[SegmentPlan]:
    """Yield plans that pass the dense check, unchanged or slightly stretched in time."""
    worst, rests = tried.worst, motion.start == MotionState()
    if not tried.motion.sound:
        if worst.ratio <= KEPT and worst.path <= 1.0 - 0.5 * CHECK_MARGIN:
            yield from _if_ok(judged_plan(limits, motion, worst, how))
        elif not rests:
            worst = worst_ratio(limits, motion, refined_times(limits, motion, 1.0 - CHECK_MARGIN))
            yield from _if_ok(judged_plan(limits, motion, worst, how))
    if rests and tried.worst.stretch <= _STRETCH_AT_ONCE:
        yield from _if_ok(_stretched_plan(limits, tried, how))


def _stretched_plan(limits: PathLimits, tried: _Tried, how: str) -> SegmentPlan:
    factor = max(tried.worst.path + 0.5 * CHECK_MARGIN, tried.worst.drive)
    return checked_plan(limits, MotionState(), stretched(tried.motion.phases, factor), f"{how}, stretched")


def _tightened(tried: _Tried) -> tuple[Tightening, ...]:
    """Return the intervals in which the next reference must be slower, and the factors."""
    worst = tried.worst
    bad = [(one.left, one.right, one.excess) for one in tried.motion.bad] or [(worst.s, worst.s, worst.stretch)]
    return tuple(
        Tightening(left - _AROUND, right + _AROUND, max(_LEAST_FACTOR, 1.0 / max(excess, 1.0) - _MORE))
        for left, right, excess in bad
    )


def _last_resort(
    limits: PathLimits, start: MotionState, deadlines: Deadlines, tried: list[_Tried]
) -> Iterator[SegmentPlan]:
    """Yield the best reference stretched in time (only from rest) and the windowed plan, the faster first."""
    best = min(tried, key=lambda one: one.worst.stretch, default=None) if start == MotionState() else None
    slow = _stretched_plan(limits, best, "reference") if best is not None else None
    if best is None or slow is None or slow.status is not TimingStatus.OK:
        yield from windowed_plans(limits, start, deadlines)
    elif best.worst.stretch <= _STRETCH_AT_LAST:
        yield slow
        yield from windowed_plans(limits, start, deadlines)
    else:
        plans = (*windowed_plans(limits, start, deadlines), slow)
        yield from sorted(plans, key=lambda one: duration_of(one.phases) if one.status is TimingStatus.OK else math.inf)
