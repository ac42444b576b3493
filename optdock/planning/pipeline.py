"""`plan_dock`: compute a certified trajectory for a docking problem, or raise a typed error with the reason.

The method is an algorithm portfolio ([Huberman1997]). The guesses of the caller, and then the guesses of each planner
in turn, are smoothed, certified and timed. The plan with the lowest price is returned as soon as no later guess can be
cheaper. If no guess leads to a plan, the remaining time is spent on a proof that no motion exists.
"""

from __future__ import annotations

import collections
import contextlib
import functools
import logging
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np

from optdock.deadline import Deadline, clock_name, garbage_collection_paused
from optdock.errors import (
    Cancelled,
    InvalidValue,
    NoMotionExists,
    OptdockError,
    PlannerCancelled,
    PlannerException,
    PlannerTimedOut,
    PluginError,
    SmootherTimedOut,
    TimedOut,
)
from optdock.geometry.arrays import readonly
from optdock.geometry.checked import finite_number, instance, number
from optdock.geometry.footprint import Footprint
from optdock.geometry.lazy import cached_property
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import Pose2
from optdock.impossibility import (
    ImpossibilitySearch,
    NoMotionProof,
    check_impossibility,
    prepare_footprint,
    prove_impossible,
    prove_straight_blocked,
)
from optdock.model.dock import Dock
from optdock.model.limits import MotionLimits
from optdock.model.path import Path
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from optdock.model.segments import PolylineSegment
from optdock.planners.manoeuvres.price import least_price
from optdock.planning.failures import Failure, check_ends, furthest, refusal, stage_of
from optdock.planning.guess_edits import FEWER_CUSPS, fewer_cusps, stopping_at_bends
from optdock.planning.plan import Attempt, DockPlan, PartialPlan
from optdock.planning.refinement import (
    PLAIN_TIMING,
    AtWork,
    Cancellation,
    Refinement,
    plain,
    ran_out_of_time,
    returned,
)
from optdock.plugins.interfaces import GlobalPlanner, Smoother, TimeParameterizer, never_cancelled
from optdock.plugins.outcomes import Guess
from optdock.plugins.registry import PluginChoice, create_plugin, plugin_from
from optdock.verification import compiled_clearances

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterator

__all__ = [
    "DEFAULT_PLANNERS",
    "DEFAULT_SMOOTHER",
    "DEFAULT_TIME_BUDGET",
    "DEFAULT_TIMING",
    "PlannerLike",
    "Plugins",
    "SmootherLike",
    "TimingLike",
    "plan_dock",
    "warm_up",
]

logger = logging.getLogger(__name__)

DEFAULT_TIME_BUDGET = 1.0  # [s]: enough for difficult scenes; most calls need a fiftieth of this time
DEFAULT_PLANNERS = ("DockPlanner", "ManoeuvrePlanner")  # the fast one first, then the search
DEFAULT_SMOOTHER, DEFAULT_TIMING = "CasadiSmoother", "NearOptimal"
# Share of the remaining time, and least time [s], for smoothing one guess while nothing is certified and more guesses
# may follow: difficult guesses that succeed at all are done by then. A guess with any pose in obstacles gets half.
_SMOOTHING_SHARE, _SMOOTHING_LEAST = 0.4, 0.06
# A guess that overlaps obstacles at more than this share of its sampled poses is put off until no other guess is left.
# If it overlaps them along less than this many robot lengths, it is first smoothed for this time [s]. Of 150 such
# guesses of the dock planner 43 of the 66 shorter ones could be smoothed, most of them in 20 to 45 ms, and 6 of the
# others.
_PUT_OFF, _SHORTLY, _BRIEFLY = 0.2, 2.5, 0.045
_SAMPLES = readonly(np.linspace(0.0, 1.0, 24))  # shares of the length of a guess at which its poses are sampled
# Shares of the remaining time for a proof of impossibility: when a planner pauses before a wider search, and the share
# that the last planner must leave unused.
_EARLY_PROOF, _LAST_PROOF = 0.1, 0.2
# Share for a proof with the robot's largest disc alone, after a planner without result: it mostly ends within 3 ms if a
# way exists, and the width of a gap that is too narrow is measured in 30 ms more. Before the first guess is smoothed,
# it is only tried if it may take the least time [s].
_DISC_PROOF, _DISC_LEAST = 0.25, 0.004
_STRAIGHT_PROOF = 0.001  # [s], time for the proof that the final straight is blocked
# A guess is tried only if its least price is lower than the best plan's price by this share; on easy scenes a plan
# costs 0.2 % more than the least price of its path. In 352 cases, compared with a longer search: with 0.05, 25 plans
# cost over 0.5 % more and 2 less; with 0.02, 2 plans cost more and 9 less, in a tenth more time. 0.03 lies between.
_LEAST_GAIN = 0.03
# Share of the budget below which a collision-free guess that was interrupted is continued before others.
_GOING_ON = 0.5
# Most tries with a gear of the best plan left out, and most failures in a row: in 36 parking slots, 22 of 23 tries that
# succeeded were the first or the second one of their plan.
_MOST_LEFT_OUT, _MOST_FAILURES = 6, 2
# Most gears of a guess that is first tried without one of them: of guesses with more, in tighter slots, the try failed
# in four of six, and delayed the first plan by 0.1 to 0.3 s.
_FEW_GEARS = 12
# Change of heading [rad] at the start above which a guess is put off: a guess of the dock planner that leaves the start
# in the opposite direction becomes a loop that costs 1.6 to 1.8 times as much as a manoeuvre, or fails.
_TURNED_AWAY = 2.0
_WARM_UP = 3.0  # [s], budget of the warm-up plan, used up once by a planner that always uses all its time
_WARM_UP_SEARCH = 0.1  # [s], of a second one, around a wall

# A plugin by its name, by its name with parameters, or the object itself.
PlannerLike: TypeAlias = "str | PluginChoice | GlobalPlanner"
SmootherLike: TypeAlias = "str | PluginChoice | Smoother"
TimingLike: TypeAlias = "str | PluginChoice | TimeParameterizer"


def plan_dock(  # noqa: PLR0913 - every choice is a keyword
    problem: DockingProblem,
    *,
    time_budget: float = DEFAULT_TIME_BUDGET,
    planner: PlannerLike | Sequence[PlannerLike] = DEFAULT_PLANNERS,
    smoother: SmootherLike = DEFAULT_SMOOTHER,
    timing: TimingLike = DEFAULT_TIMING,
    guesses: Iterable[Path] = (),
    warm_start: DockPlan | Path | None = None,
    cancel_checker: Callable[[], bool] = never_cancelled,
    least_gain: float = _LEAST_GAIN,
) -> DockPlan:
    """Plan, smooth, prove and time a docking motion.

    There are three possible outcomes: a certified plan is returned; `NoMotionExists` is raised, with a proof; or
    another error is raised, which is either a time-out or states why the most advanced guess failed.

    Planner, smoother and time parameterizer are names of installed plugins, or plugin objects such as
    `CasadiSmoother(spans=32)`. A plugin object must not be configured, and it can be used by only one call at a time.

    Args:
        problem: Start, dock, robot and obstacles.
        time_budget: Wall-clock seconds for the whole call. In the first call of a process with these plugins the clock
            starts after `warm_up`. The call usually returns much earlier, as soon as no later guess can be cheaper.
        planner: Source of guesses, or several sources, which are used in the given order.
        smoother: Plugin that makes guesses drivable.
        timing: Plugin that computes the time law.
        guesses: Raw paths from any source, such as another planner or a recorded drive, which are tried first.
        warm_start: An earlier plan, or its path, for a similar problem, as warm start of the smoother.
        cancel_checker: Polled at least every 5 ms by the long stages; its exceptions are passed on.
        least_gain: After the first certified plan, planners are only asked for guesses that may reduce the price by
            this share, from 0 to 1.

    Returns:
        The certified plan with the lowest price found (see `DockPlan.price`); `tried` lists every guess with its
        result.

    Raises:
        InvalidValue: If the budget is not a finite number > 0, `least_gain` is not finite, an argument has
            the wrong class, or a parameter of a plugin is wrong.
        InvalidPath: If a guess is not in the frame of the problem.
        StartOccupied: If the robot overlaps an obstacle at the start.
        GoalOccupied: If the clearance at the goal is less than required.
        StartOutsideMapBounds: If the start is outside the costmap.
        GoalOutsideMapBounds: If the goal is outside the costmap.
        NoMotionExists: If it is proven that no motion connects the start to the goal.
        NoValidPathCouldBeFound: If no planner finds a raw path.
        FailedToSmoothPath: If no path near a raw path satisfies every bound.
        FailedToTimePath: If no time law satisfies the motion limits.
        TimedOut: If no plan was found and a stage ran out of time: a planner (PlannerTimedOut), the smoothing of a
            guess or its proof (SmootherTimedOut), or the time law or its proof (TimingTimedOut). A larger `time_budget`
            may give a plan, regardless of why other guesses failed.
        Cancelled: If `cancel_checker` returned True, as PlannerCancelled, SmootherCancelled or TimingCancelled.
        CertificationFailed: If a result of a plugin cannot be proven.
        PluginError: If a plugin is unknown, returned a value of a wrong type, or raised an exception that is not in its
            interface and is then the cause of this error.
        LifecycleError: If a plugin is configured already.

    Errors raised after the plugins were created have the attribute `partial`, a `PartialPlan`.
    """
    time_budget = number(time_budget, "time_budget")
    if not (math.isfinite(time_budget) and time_budget > 0.0):
        raise InvalidValue(f"time_budget: must be finite and > 0 s, got {time_budget}")
    instance(DockingProblem, problem, "problem")
    if isinstance(warm_start, DockPlan):
        warm_start = warm_start.path
    if warm_start is not None:
        instance(Path, warm_start, "warm_start")
    given, least_gain = _paths(guesses, problem.frame), min(max(finite_number(least_gain, "least_gain"), 0.0), 1.0)
    if not callable(cancel_checker):
        raise InvalidValue(f"cancel_checker: must be a function that returns whether to stop, got {cancel_checker!r}")
    so_far, warmed = PartialPlan(), _warm_once.cache_info().misses
    deadline = Deadline(time_budget - _margin(time_budget))
    try:
        plugins = Plugins.ready(planner, smoother, timing)
        if _warm_once.cache_info().misses > warmed:
            deadline = Deadline(deadline.seconds)
        limits = Cancellation(cancel_checker), time_budget, deadline
        work = Refinement(problem, plugins.smoother, plugins.timing, warm_start, *limits, so_far.timing_ms)
        try:
            with garbage_collection_paused():
                plan = _Portfolio(work, plugins.planner, given, so_far, least_gain).plan()
        finally:
            _WAITS.append(work.longest_wait)
        if logger.isEnabledFor(logging.INFO):
            logger.info("%s; %s", plan, ", ".join(f"{stage} {ms:.1f} ms" for stage, ms in plan.timing_ms.items()))
        return plan
    except OptdockError as error:
        so_far.timing_ms["total"] = 1e3 * deadline.elapsed
        error.partial = so_far
        logger.info("no plan after %.1f ms: %s", so_far.timing_ms["total"], error)
        raise


def _paths(guesses: Iterable[Path], frame: str) -> tuple[Path, ...]:
    """Return the caller's guesses with the frame name of the problem."""
    if isinstance(guesses, Path | str) or not isinstance(guesses, Iterable):
        raise InvalidValue(f"guesses: must be a list of paths, got {type(guesses).__name__}")
    paths = tuple(guesses)
    for i, path in enumerate(paths):
        instance(Path, path, f"guesses[{i}]")
    return tuple(Path(path.segments, path.frame).with_frame(frame) for path in paths)


def warm_up(
    planner: PlannerLike | Sequence[PlannerLike] = DEFAULT_PLANNERS,
    smoother: SmootherLike = DEFAULT_SMOOTHER,
    timing: TimingLike = DEFAULT_TIMING,
    *,
    robot: Robot | None = None,
) -> None:
    """Load libraries and build the one-time data of plugins, which makes later calls faster.

    The first call in a process plans a small problem, which takes about a second; later calls return immediately.
    Errors of plugins during this plan are suppressed here; they are raised in the first real call.

    Args:
        planner: As in `plan_dock`.
        smoother: As in `plan_dock`.
        timing: As in `plan_dock`.
        robot: Robot of later problems. If `robot` is given, the footprint data needed for proofs are computed, which
            takes up to 0.1 s.

    Raises:
        PluginError: If a plugin is unknown or cannot be built.
        InvalidValue: If a parameter of a plugin is wrong, or `robot` is not a `Robot`.
    """
    Plugins.ready(planner, smoother, timing)
    if robot is not None:
        prepare_footprint(instance(Robot, robot, "robot").footprint)


@functools.cache
def _warm_once(
    planners: tuple[type[GlobalPlanner], ...], smoother: type[Smoother], timing: type[TimeParameterizer]
) -> None:
    import shapely  # noqa: F401 - otherwise imported by the first proof, within the time budget of its call

    limits = MotionLimits(max_curvature=2.0, max_curvature_rate=8.0)
    dock = Dock(Pose2(0.0, 0.0, 0.0), Footprint.rectangle(0.6, -0.4, 0.5))
    problem = DockingProblem(Pose2(-2.0, 0.1, 0.1), dock, Robot(Footprint.rectangle(0.3, 0.3, 0.5), limits))
    clock, never = Deadline(_WARM_UP), Cancellation(never_cancelled)
    # With a short wall, planners need routes around obstacles. The first call of a kernel is compared with its twin,
    # which fills caches, so that the counted time of a first real call would depend on it.
    walls = ([[-1.2, -y], [-1.0, -y], [-1.0, y], [-1.2, y]] for y in (1.0, 3.0))
    short, long = (ObstacleSet.from_polygons([wall]) for wall in walls)
    plans = [(planner, problem, _WARM_UP) for planner in planners]
    plans += [(planner, replace(problem, obstacles=short), _WARM_UP_SEARCH) for planner in planners[-1:]]
    for planner, given, budget in plans:
        with contextlib.suppress(Exception):  # also of constructors that need parameters; real calls report errors
            work = Refinement(given, smoother(), timing(), None, never, budget, Deadline(budget), {})
            _Portfolio(work, (planner(),), (), PartialPlan()).plan()
    with contextlib.suppress(Exception):
        smoother().warm_up()
    create_plugin(TimeParameterizer, PLAIN_TIMING)  # the first one of a process takes 4 ms
    prove_impossible(replace(problem, obstacles=long), time_budget=0.05)
    logger.info("libraries loaded and caches filled in %.1f s, once per process", clock.elapsed)


class Plugins(NamedTuple):
    """Plugins of a call; the names of the fields are those of the arguments of `plan_dock`."""

    planner: tuple[GlobalPlanner, ...]
    smoother: Smoother
    timing: TimeParameterizer

    @classmethod
    def ready(cls, planner: PlannerLike | Sequence[PlannerLike], smoother: SmootherLike, timing: TimingLike) -> Plugins:
        """Return the plugins, whose classes have been used once in this process.

        Raises:
            InvalidValue: As `warm_up`.
            PluginError: As `warm_up`.
        """
        planners = tuple(planner) if isinstance(planner, list | tuple) else (planner,)
        if not planners:
            raise InvalidValue("planner: must be one planner or several, got none")
        chosen = cls(
            tuple([plugin_from(GlobalPlanner, one, "planner") for one in planners]),
            plugin_from(Smoother, smoother, "smoother"),
            plugin_from(TimeParameterizer, timing, "timing"),
        )
        _warm_once(tuple(map(type, chosen.planner)), type(chosen.smoother), type(chosen.timing))
        return chosen


# Longest times for which the machine suspended each of the last calls [s]; nearly 0 on an idle machine. A process that
# shares a core may be suspended for some milliseconds just before its deadline; a single suspension is an exception.
_WAITS: collections.deque[float] = collections.deque(maxlen=9)
_MARGIN_SHARE, _MARGIN_MOST = 0.3, 0.006  # of the budget; [s]: longer suspensions are rare at the end of a call


def _margin(budget: float) -> float:
    """Return the time [s] by which a call stops before the end of the budget: the second longest suspension so far.

    It is 0 on clocks that do not measure real time, so that a call does not depend on earlier calls.
    """
    if clock_name() != "wall":
        return 0.0
    usual = sorted(_WAITS)[-2] if len(_WAITS) > 1 else 0.0
    return min(usual, _MARGIN_SHARE * budget, _MARGIN_MOST)


_END = object()  # of a planner's guesses
_UNPROVEN = "{} reports that no motion exists, without a valid proof"


class _Interrupted(NamedTuple):
    """Guess whose smoothing was interrupted, with the smoother's path so far and the share of poses in obstacles."""

    guess: Guess
    begun: Path | None
    overlapping: float


def _turned_away(path: Path) -> float:
    """Return the change of heading [rad] between the first two poses of a polyline, 0 for other segments."""
    first = path.segments[0]
    if not isinstance(first, PolylineSegment):
        return 0.0
    return abs(math.remainder(float(first.poses[1, 2] - first.poses[0, 2]), 2.0 * math.pi))


@dataclass(eq=False)
class _Portfolio:
    """One call of `plan_dock`: guesses in order, the best plan so far, and the failures of the other guesses."""

    work: Refinement
    planners: tuple[GlobalPlanner, ...]
    given: tuple[Path, ...]
    so_far: PartialPlan
    least_gain: float = _LEAST_GAIN
    best: DockPlan | None = None
    last_resort: DockPlan | None = None  # along an unsmoothed guess, with a stop at every bend
    tried: list[Attempt] = field(default_factory=list)
    failures: list[Failure] = field(default_factory=list)
    interrupted: list[_Interrupted] = field(default_factory=list)
    left_out: set[str] = field(default_factory=set)  # digests of the tried guesses with a gear left out
    is_straight_checked: bool = False  # whether a proof that the final straight is blocked was tried
    in_vain: int = 0  # tries with a gear of the best plan left out
    is_cut_off: bool = False  # whether the clock ended the call before all guesses were made or tried

    def __post_init__(self) -> None:
        self.problem, self.deadline = self.work.problem, self.work.deadline

    @cached_property
    def impossibility(self) -> ImpossibilitySearch:
        """Search for a proof of impossibility, which continues after interruptions."""
        return ImpossibilitySearch(self.problem)

    def plan(self) -> DockPlan:
        """Return the best plan; on failure, the partial plan of the most advanced guess is copied to `so_far`."""
        with self.work.timed("plan"):
            check_ends(self.problem)
        with contextlib.closing(self._guesses()) as guesses:
            for guess, is_last in guesses:
                self._try_with_fewer_gears(guess, is_last=is_last)
                if self.work.is_late() or self._must_go_on():
                    self.is_cut_off |= not is_last
                    break
        again, self.interrupted = sorted(self.interrupted, key=lambda one: one.overlapping), []
        for guess, begun, _ in again:
            if self.best is None and self.work.is_late():
                self.is_cut_off = True
            elif self.best is None:
                self.failures = [failure for failure in self.failures if failure.left.raw_path is not guess.path]
                self._try(guess, begun, is_last=True)
                self._leave_out_gears()
        plans = [plan for plan in (self.best, self.last_resort) if plan is not None]
        if not plans:
            self._leave()
            raise refusal(self.failures, self.work, is_cut_off=self.is_cut_off)
        self.best = min(plans, key=lambda plan: plan.price)
        timing = {**self.so_far.timing_ms, "total": 1e3 * self.deadline.elapsed}
        return replace(self.best, completed=self._is_complete(self.best), timing_ms=timing, tried=tuple(self.tried))

    def _is_complete(self, plan: DockPlan) -> bool:
        """Whether the result is final, so that more time would not change it."""
        is_cut_short = self.is_cut_off or any(isinstance(failure.error, TimedOut) for failure in self.failures)
        return plan.completed and not self.deadline.passed() and not (plan is self.last_resort and is_cut_short)

    def _leave_out_gears(self) -> None:
        """Try the best plan without one of its short gear segments, and repeat while this may reduce the price.

        This takes place before the next guess is made: guesses of one search have about as many gears, so that most of
        them are no longer worth a try afterwards.
        """
        left = _MOST_LEFT_OUT
        while self.best is not None and left > 0 and self.in_vain < _MOST_FAILURES and not self.work.is_late():
            simpler = (path for path in fewer_cusps(self.best.path, self.problem) if path.digest not in self.left_out)
            path = next((one for one in simpler if least_price(one, self.problem) < self._worth_a_try()), None)
            if path is None:
                return
            left -= 1
            self.left_out.add(path.digest)
            self.in_vain += 1
            self._try(Guess(path, FEWER_CUSPS), is_last=True)

    def _try_with_fewer_gears(self, guess: Guess, *, is_last: bool) -> None:
        """Try the first guess of a search without detours and one more gear, else the guess; then leave out others."""
        for path in () if guess.stage == "given" or self.best is not None else self._shorter(guess.path):
            self._try(Guess(path, guess.stage), is_last=False)
            if self.best is not None:
                break
        else:
            self._try(guess, is_last=is_last)
        self._leave_out_gears()

    def _shorter(self, path: Path) -> Iterator[Path]:
        """Yield a guess without its detours and one more gear, and without its detours, if these differ from it."""
        given = path
        while (shorter := next(fewer_cusps(path, self.problem, only_detours=True), None)) is not None:
            path = shorter
        simpler = next(fewer_cusps(path, self.problem), None)
        if simpler is not None and len(path.segments) <= _FEW_GEARS:
            yield simpler
            self.in_vain += self.best is None
        if path is not given:
            yield path

    def _guesses(self) -> Generator[tuple[Guess, bool], None, None]:
        """Yield every guess, and whether it is known to be the last guess; then search for a proof."""
        for path in self.given:
            yield Guess(path, "given"), False
        last = self.planners[-1]
        for planner in self.planners:
            makes_one = type(planner).create_plans is GlobalPlanner.create_plans
            try:
                with AtWork(planner, self.problem, self.work.cancelled):
                    for guess in self._guesses_of(planner, is_last=planner is last):
                        yield guess, makes_one and planner is last
            except (PlannerException, PluginError) as error:
                broken = isinstance(error, PluginError) and self.best is None
                if broken or isinstance(error, Cancelled | NoMotionExists):
                    raise
                self._fail(Failure(error, PartialPlan()), type(planner).__name__)
            if self.work.is_late():
                self.is_cut_off |= planner is not last
                break
            self._look_for_a_proof(_DISC_PROOF, only_disc=True)
        self._look_for_a_proof(0.5 if self.interrupted else 1.0)

    def _guesses_of(self, planner: GlobalPlanner, *, is_last: bool) -> Iterator[Guess]:
        """Yield the guesses of a planner; the last of several planners must leave time for a proof."""
        share = 1.0 - _LAST_PROOF if is_last and len(self.planners) > 1 else 1.0
        until = self.deadline.elapsed + share * self.deadline.left

        def is_used_up() -> bool:
            return self.best is None and self.deadline.elapsed > until

        def asked_to_stop() -> bool:
            end = self.deadline.seconds if self.best is not None else until
            return self.work.cancelled() or self.deadline.elapsed >= end

        start, goal = self.problem.start, self.problem.goal
        guesses = iter(planner.create_plans(start, goal, asked_to_stop, self._worth_a_try))
        while not is_used_up():
            found = self._next(guesses, planner)
            if found is _END:
                return
            if found is None:
                self._look_for_a_proof(_EARLY_PROOF)
                continue
            guess = returned(found, Guess, planner)
            path = plain(returned(guess.path, Path, planner), planner, self.problem.frame)
            yield Guess(path, guess.stage or type(planner).__name__)
        raise PlannerTimedOut(ran_out_of_time(type(planner).__name__, self.work.budget))

    def _next(self, guesses: Iterator[Guess | None], planner: GlobalPlanner) -> object:
        """Return the next guess of a planner, None for a pause, or `_END`."""
        late = ran_out_of_time(type(planner).__name__, self.work.budget)
        try:
            with self.work.timed("plan"):
                found = next(guesses, _END)
        except PlannerCancelled as error:
            if self.work.cancelled():
                raise
            raise PlannerTimedOut(late) from error
        except PlannerTimedOut as error:
            raise PlannerTimedOut(late, where=error.where) from error
        except NoMotionExists as error:
            proof = error.proof
            if isinstance(proof, NoMotionProof) and check_impossibility(proof, self.problem):
                raise
            raise PluginError(_UNPROVEN.format(type(planner).__name__)) from error
        if self.deadline.passed():
            raise PlannerTimedOut(late)
        return found

    def _worth_a_try(self) -> float:
        """Return the `least_price` below which a guess may reduce the price enough.

        A least price does not contain the time that the steering takes at a start with unknown steering angle.
        """
        if self.best is None:
            return math.inf
        steering = self.problem.robot.limits.steering_time_to(0.0) if self.problem.start_curvature is None else 0.0
        return (1.0 - self.least_gain) * self.best.price - steering

    def _must_go_on(self) -> bool:
        """Whether to continue an interrupted guess without collisions before trying other guesses."""
        is_one = any(one.begun is not None and one.overlapping == 0.0 for one in self.interrupted)
        return is_one and self.best is None and self.deadline.left < _GOING_ON * self.work.budget

    def _try(self, guess: Guess, begun: Path | None = None, *, is_last: bool) -> None:
        """Refine a guess, or continue an interrupted one, and record the plan or the failure."""
        unhurried = is_last or self.best is not None
        overlapping = 0.0 if unhurried else self._overlapping(guess.path)
        if overlapping > 0.0 and _DISC_PROOF * self.deadline.left >= _DISC_LEAST:
            self._look_for_a_proof(_DISC_PROOF, only_disc=True)
        reason = "" if unhurried else self._reason_to_postpone(guess, overlapping)
        if reason:
            self.tried.append(Attempt(guess.stage, guess.path, reason=f"postponed: {reason}"))
            self.interrupted.append(_Interrupted(guess, None, overlapping))
            return
        share = _SMOOTHING_SHARE * (0.5 if overlapping > 0.0 else 1.0)
        most = math.inf if unhurried else max(share * self.deadline.left, _SMOOTHING_LEAST)
        most = min(most, _BRIEFLY) if overlapping > _PUT_OFF else most
        left, began = PartialPlan(timing_ms=self.so_far.timing_ms), self.deadline.elapsed
        try:
            plan = self.work.refined(guess.path, left, most, is_given=guess.stage == "given", begun=begun)
        except NoMotionExists as error:  # the smoother and the time parameterizer have no proofs
            names = f"{type(self.work.smoother).__name__} or {type(self.work.timing).__name__}"
            raise PluginError(_UNPROVEN.format(names)) from error
        except OptdockError as error:
            if isinstance(error, Cancelled) or (stage_of(error) is None and self.best is None):
                self._leave(left)
                raise
            if isinstance(error, SmootherTimedOut) and not unhurried:
                self.interrupted.append(_Interrupted(guess, PartialPlan.left_by(error).path, overlapping))
            self._fail(Failure(error, left), guess.stage, guess.path, self.deadline.elapsed - began)
            self._stop_at_bends(guess)
            return
        self.tried.append(Attempt(guess.stage, guess.path, self.deadline.elapsed - began, plan.price))
        self.so_far.timing_ms.setdefault("first", 1e3 * self.deadline.elapsed)
        if self.best is None or plan.price < self.best.price:
            self.best, self.in_vain = plan, 0

    def _reason_to_postpone(self, guess: Guess, overlapping: float) -> str:
        """Return why a guess is put off until no other guess is left, empty if it is not put off."""
        is_long = overlapping * guess.path.length > _SHORTLY * self.problem.robot.footprint.length
        if overlapping > _PUT_OFF and is_long:
            return f"{100.0 * overlapping:.0f} % of its poses overlap obstacles"
        if guess.stage != "given" and _turned_away(guess.path) > _TURNED_AWAY:
            return "it leaves the start in the opposite direction"
        return ""

    def _stop_at_bends(self, guess: Guess) -> None:
        """Store a plan along a failed guess with a stop at every bend, as a fallback if no better plan is found."""
        if guess.stage == "given" or self.best is not None or self.deadline.left <= 2.0 * self.work.reserve:
            return  # without time for the certificate before the timing
        known = self.last_resort.price if self.last_resort is not None else math.inf
        path = stopping_at_bends(guess.path)
        if path is None or least_price(path, self.problem) >= known:
            return
        began = self.deadline.elapsed
        with contextlib.suppress(OptdockError):  # the failure of the smoothing is reported instead
            plan = self.work.proven(guess.path, path, PartialPlan(), is_late=self.work.is_late)
            if plan.price < known:
                self.last_resort = plan
                stage, seconds = f"{guess.stage}, stopping at bends", self.deadline.elapsed - began
                self.tried.append(Attempt(stage, guess.path, seconds, plan.price))
                self.so_far.timing_ms.setdefault("first", 1e3 * self.deadline.elapsed)

    def _overlapping(self, path: Path) -> float:
        """Return the share of the sampled poses of a guess that lie in obstacles."""
        poses = path.poses_at(path.length * _SAMPLES)
        clearances, _ = compiled_clearances(poses, self.problem.robot.footprint, self.problem.all_obstacles, within=0.1)
        return float((clearances < 0.0).sum()) / _SAMPLES.size

    def _fail(self, failure: Failure, stage: str, path: Path | None = None, seconds: float = 0.0) -> None:
        """Record the failure of a guess or a planner; raise its error if the error holds for every path."""
        self._check_straight()
        reason = f"{type(failure.error).__name__}: {failure.error}"
        self.tried.append(Attempt(stage, path, seconds, reason=reason))
        self.failures.append(failure)
        if failure.error.where.get("every_path") and self.best is None and self.last_resort is None:
            self._leave()
            raise failure.error

    def _leave(self, left: PartialPlan | None = None) -> None:
        """Copy a partial plan to `so_far`, by default the partial plan of the most advanced guess."""
        left = left or (furthest(self.failures).left if self.failures else PartialPlan())
        self.so_far.raw_path, self.so_far.path, self.so_far.certificate = left.raw_path, left.path, left.certificate
        self.so_far.tried = tuple(self.tried)

    def _check_straight(self) -> None:
        """Raise an error with the proof if the final straight is blocked, once and only after a first difficulty."""
        if self.is_straight_checked or self.best is not None or not self.deadline.fits(_STRAIGHT_PROOF):
            return
        self.is_straight_checked = True
        with self.work.timed("prove"):
            proof = prove_straight_blocked(self.problem)
        if proof is not None:
            self._leave()
            raise NoMotionExists(proof.message, proof=proof, where=proof.where)

    def _look_for_a_proof(self, share: float = 1.0, *, only_disc: bool = False) -> None:
        """Search for a proof that no motion exists, in a share of the remaining time; raise an error with the proof."""
        if self.best is not None or self.last_resort is not None or self.deadline.left <= 0.0:
            return
        self._check_straight()
        with self.work.timed("prove"):
            if self.impossibility.ended:
                return
            allowed = share * self.deadline.left
            proof = self.impossibility.proof(allowed, self.work.cancelled, only_disc=only_disc)
        if self.work.cancelled():
            raise PlannerCancelled("cancelled during the search for a proof of impossibility")
        if proof is not None:
            self._leave()
            raise NoMotionExists(proof.message, proof=proof, where=proof.where)
