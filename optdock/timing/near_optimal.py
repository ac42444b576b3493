"""The near-optimal method: within about 1 % of the jerk-limited optimum, in a few milliseconds.

Its plans of one segment (`near_optimal_plans`), each made only when the one before was refused:

1. One ruckig move over the whole segment, where that is all it takes; slower ones on a tiny segment.
2. The reference and the moves along it, as they are.
3. From rest, the same stretched in time by a little: exact, always possible.
4. 2 and 3 again with the bad stretches tightened, at most twice.
5. From rest, the best of them stretched as far as it takes; the windowed method, before that where it is quicker.

For a moving start whose plans are all refused `retry_strategy` stops and goes; the proof that decides is there, too.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

from pydantic import Field

from optdock.deadline import ENDLESS, Deadline, OutOfTime
from optdock.plugins.interfaces import TimeParameterizer, TimingStatus, never_cancelled
from optdock.plugins.parameters import PluginParameters
from optdock.timing.interior_point import load_lapack
from optdock.timing.jerk_phases import DriveBounds, Motion, MotionState, Phases, duration_of, stretched
from optdock.timing.path_limits import KEPT, ReferenceBounds, Tightening, Worst, worst_ratio
from optdock.timing.plan_checks import SegmentPlan, arrived_plan, checked_plan, judged_plan, refined_times
from optdock.timing.reference_program import solve_reference, spline_phases
from optdock.timing.retry_strategy import TimingStart, time_path
from optdock.timing.ruckig_moves import Move, load_ruckig, move, split_into_moves
from optdock.timing.start_states import Braking
from optdock.timing.timing_settings import NEAR_OPTIMAL, NearOptimalSettings
from optdock.timing.windowed import windowed_plans

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from optdock.model.limits import MotionLimits, SpeedZone
    from optdock.model.path import Path
    from optdock.plugins.interfaces import TimingResult
    from optdock.timing.path_limits import PathLimits
    from optdock.timing.retry_strategy import Deadlines

__all__ = ["NearOptimal", "ReferenceMotion", "near_optimal_plans", "reference_motion"]


class NearOptimalParameters(PluginParameters):
    """Parameters of `NearOptimal`."""

    step: float = Field(default=NEAR_OPTIMAL.step, gt=0.01, le=0.5, description="knot spacing of the reference [s]")
    smooth: bool = Field(
        default=NEAR_OPTIMAL.smooth, description="jerk that hardly changes between knots, instead of +-max_jerk"
    )


class NearOptimal(TimeParameterizer):
    """Time laws within about 1 % of the jerk-limited optimum, in a few milliseconds."""

    Parameters = NearOptimalParameters
    parameters: NearOptimalParameters

    def on_configure(self) -> None:
        """Import what the first call would import.

        Raises:
            PluginError: The package ruckig is not installed.
        """
        load_ruckig()
        load_lapack()

    def parameterize(  # noqa: PLR0913 - what to time, and how long to try
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
        """See `TimeParameterizer.parameterize`.

        Raises:
            InvalidValue: The start state or `start_wait` is not finite, the wait negative, or `max_time` is NaN.
            PluginError: The package ruckig is not installed.
            TimingCancelled: `cancel_checker` returned True.
        """
        deadline = Deadline(max_time, stop=cancel_checker)
        start = TimingStart(start_speed, start_acceleration, start_wait)
        return time_path(path, limits, zone, start, self._plans, deadline)

    def _plans(self, limits: PathLimits, start: MotionState, deadlines: Deadlines) -> Iterator[SegmentPlan]:
        chosen = self.parameters
        settings = replace(NEAR_OPTIMAL, step=chosen.step, smooth=chosen.smooth)
        return near_optimal_plans(limits, start, deadlines, settings)


def near_optimal_plans(
    limits: PathLimits, start: MotionState, deadlines: Deadlines, settings: NearOptimalSettings = NEAR_OPTIMAL
) -> Iterator[SegmentPlan]:
    """Plans of one segment from a state from which the speed caps can be kept: every method, in order.

    A plan is made only when the one before was refused. The windowed method's may be FAIL.

    Raises:
        OutOfTime: Time is up and no method is left that would need none.
    """
    tried: list[_Tried] = []
    longest = min(settings.strategy.longest_reference, settings.strategy.most_knots * settings.step)
    if limits.duration_estimate <= longest:
        try:
            if not settings.smooth:
                yield from _single_moves(limits, start, settings)
            yield from _references(limits, start, deadlines.search, settings, tried)
        except OutOfTime:
            pass
    yield from _last_resort(limits, start, deadlines, settings, tried)


def _if_ok(plan: SegmentPlan) -> tuple[SegmentPlan, ...]:
    return (plan,) if plan.status is TimingStatus.OK else ()


def _single_moves(limits: PathLimits, start: MotionState, settings: NearOptimalSettings) -> Iterator[SegmentPlan]:
    """One move over a short segment; on a tiny one the shortest of some, stretched until it keeps every limit."""
    strategy = settings.strategy
    if limits.length >= strategy.single_move_below:
        return
    full = limits.drive_bounds._replace(speed=limits.fastest)
    end = MotionState(limits.length)
    phases = move(start, end, full)
    plan = checked_plan(limits, start, phases, "one move") if phases else None
    if plan is not None and plan.status is TimingStatus.OK:
        yield plan
        return
    if limits.length >= strategy.tiny or start != MotionState():
        return
    shares = (
        DriveBounds(speed * full.speed, drive * full.acceleration, drive * full.deceleration, full.jerk)
        for speed, drive in strategy.slower_moves
    )
    moves = [phases for share in shares if (phases := move(start, end, share))]
    worst = [worst_ratio(limits, Motion.of(start, phases)) for phases in moves]
    slowed = [
        stretched(phases, max(one.path * strategy.single_move_spare, one.drive))
        for phases, one in zip(moves, worst, strict=True)
    ]
    yield from _if_ok(checked_plan(limits, start, min(slowed, key=duration_of, default=()), "one move, stretched"))


class ReferenceMotion(NamedTuple):
    """A motion over a segment along a reference.

    Args:
        phases: The motion.
        moves: It is made of; none where the reference itself is the motion.
    """

    phases: Phases
    moves: tuple[Move, ...] = ()

    @property
    def bad(self) -> tuple[Move, ...]:
        """Moves that break a limit."""
        return tuple(one for one in self.moves if one.excess > 1.0)

    @property
    def sound(self) -> bool:
        """Whether every move was found within the checked limits; the reference itself is not checked."""
        return bool(self.moves) and not self.bad


def reference_motion(
    bounds: ReferenceBounds, start: MotionState, deadline: Deadline = ENDLESS
) -> ReferenceMotion | None:
    """The motion under `bounds` from `start` along a reference; None where there is no reference.

    Raises:
        OutOfTime: The deadline passed.
    """
    reference = solve_reference(bounds, start, deadline)
    if reference is None:
        return None
    if bounds.settings.smooth:
        cells = spline_phases(reference.s, reference.v, reference.a)
        return ReferenceMotion(reference.launch.phases + cells + reference.stop.phases)
    moves = split_into_moves(reference, bounds, start, deadline)
    return ReferenceMotion(tuple(phase for one in moves for phase in one.phases), tuple(moves))


class _Tried(NamedTuple):
    """A reference's motion that was refused, and what is wrong with it."""

    motion: ReferenceMotion
    worst: Worst


def _references(
    limits: PathLimits, start: MotionState, deadline: Deadline, settings: NearOptimalSettings, tried: list[_Tried]
) -> Iterator[SegmentPlan]:
    """References, each tighter than the last, as they are or stretched a little; `tried` gets those refused."""
    margins, strategy = settings.margins, settings.strategy
    moving = start.v > 0.0 or start.a > 0.0
    slack = strategy.relief * margins.speed
    relief = Braking(limits, start).tight_length(slack, settings.tight_yaw) if moving else 0.0
    tightenings: tuple[Tightening, ...] = ()
    for retry in range(strategy.retries + 1 if limits.duration_estimate <= strategy.longest_retried else 1):
        how = "reference" if retry == 0 else f"reference, retry {retry}"
        found = reference_motion(ReferenceBounds(limits, settings, relief, tightenings), start, deadline)
        if found is None:
            return
        motion = Motion.of(start, found.phases)
        if found.sound:
            yield from _if_ok(arrived_plan(limits, motion, how))
        deadline.look()
        tried.append(_Tried(found, worst_ratio(limits, motion)))
        yield from _repaired(limits, motion, tried[-1], settings, how)
        tightenings += _tightened(tried[-1], settings)


def _repaired(
    limits: PathLimits, motion: Motion, tried: _Tried, settings: NearOptimalSettings, how: str
) -> Iterator[SegmentPlan]:
    """Plans where the dense check is passed, or passed once time is stretched a little."""
    worst, check, rests = tried.worst, settings.margins.check, motion.start == MotionState()
    if not tried.motion.sound:
        if worst.ratio <= KEPT and worst.path <= 1.0 - 0.5 * check:
            yield from _if_ok(judged_plan(limits, motion, worst, how))
        elif not rests:
            worst = worst_ratio(limits, motion, refined_times(limits, motion, 1.0 - check))
            yield from _if_ok(judged_plan(limits, motion, worst, how))
    if rests and tried.worst.stretch <= settings.strategy.stretch_at_once:
        yield from _if_ok(_stretched_plan(limits, tried, settings, how))


def _stretched_plan(limits: PathLimits, tried: _Tried, settings: NearOptimalSettings, how: str) -> SegmentPlan:
    factor = max(tried.worst.path + 0.5 * settings.margins.check, tried.worst.drive)
    return checked_plan(limits, MotionState(), stretched(tried.motion.phases, factor), f"{how}, stretched")


def _tightened(tried: _Tried, settings: NearOptimalSettings) -> tuple[Tightening, ...]:
    """Where and by how much the next reference is to be slower."""
    strategy, worst = settings.strategy, tried.worst
    bad = [(one.left, one.right, one.excess) for one in tried.motion.bad] or [(worst.s, worst.s, worst.stretch)]
    around, more, least = strategy.tightened_around, strategy.tightened_more, strategy.least_tightening
    return tuple(
        Tightening(left - around, right + around, max(least, 1.0 / max(excess, 1.0) - more))
        for left, right, excess in bad
    )


def _last_resort(
    limits: PathLimits, start: MotionState, deadlines: Deadlines, settings: NearOptimalSettings, tried: list[_Tried]
) -> Iterator[SegmentPlan]:
    """The best reference stretched in time, which only a start at rest allows, and windows; the quicker one first."""
    best = min(tried, key=lambda one: one.worst.stretch, default=None) if start == MotionState() else None
    slow = _stretched_plan(limits, best, settings, "reference") if best is not None else None
    if best is None or slow is None or slow.status is not TimingStatus.OK:
        yield from windowed_plans(limits, start, deadlines)
    elif best.worst.stretch <= settings.strategy.stretch_at_last:
        yield slow
        yield from windowed_plans(limits, start, deadlines)
    else:
        plans = (*windowed_plans(limits, start, deadlines), slow)
        yield from sorted(plans, key=lambda one: duration_of(one.phases) if one.status is TimingStatus.OK else math.inf)
