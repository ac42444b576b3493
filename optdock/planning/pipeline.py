"""`plan_dock`: a docking problem in, a certified trajectory out, or a typed error that says why not.

An algorithm portfolio ([Huberman1997]): guesses of the caller, then those of every planner in turn. Each is smoothed,
proven and timed; the plan of the lowest price is returned as soon as no later guess can beat it. Where none succeeds,
what is left of the budget goes into a proof that no motion exists.
"""

from __future__ import annotations

import collections
import contextlib
import functools
import logging
import math
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np

from optdock.deadline import Deadline, garbage_collection_paused
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
from optdock.geometry.checked import instance, number
from optdock.geometry.footprint import Footprint
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
from optdock.planners.manoeuvres.price import least_price
from optdock.planning.failures import Failure, Failures, check_ends, stage_of
from optdock.planning.plan import Attempt, DockPlan, PartialPlan
from optdock.planning.refinement import (
    Cancellation,
    Refinement,
    Stopwatch,
    at_work,
    fewer_cusps,
    plain,
    ran_out_of_time,
    returned,
    stopping_at_bends,
)
from optdock.plugins.interfaces import GlobalPlanner, Smoother, TimeParameterizer, never_cancelled
from optdock.plugins.outcomes import Guess
from optdock.plugins.registry import PluginChoice, plugin_from
from optdock.verification import pose_clearances

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterator

__all__ = [
    "DEFAULT_PLANNERS",
    "DEFAULT_SMOOTHER",
    "DEFAULT_TIME_BUDGET",
    "DEFAULT_TIMING",
    "PlannerLike",
    "SmootherLike",
    "TimingLike",
    "plan_dock",
    "warm_up",
]

logger = logging.getLogger(__name__)

DEFAULT_TIME_BUDGET = 1.0  # [s]: what a hard place may take; most calls need a fiftieth of it
DEFAULT_PLANNERS = ("DockPlanner", "ManoeuvrePlanner")  # the cheap one first, then the one that searches
DEFAULT_SMOOTHER, DEFAULT_TIMING = "CasadiSmoother", "NearOptimal"
# While nothing is certified and more guesses may follow, smoothing one of them may take this share of what is left, or
# so long [s] where that is more: the hard ones that succeed at all are done by then. One that lies in obstacles
# anywhere gets half of it.
_SMOOTHING_SHARE, _SMOOTHING_LEAST = 0.4, 0.06
# A guess that overlaps obstacles at more than this share of its poses, of so many, is put off until nothing else is
# left to be tried; but where it overlaps them along less than so many robot lengths it is first smoothed for so long
# [s]. Of 150 such guesses of the dock planner (families of `optdock.testing` and of `experiments.manoeuvres`) 43 of the
# 66 shorter ones could be smoothed, most of them in 20 to 45 ms, and 6 of the others.
_PUT_OFF, _LOOKS, _SHORTLY, _BRIEFLY = 0.2, 24, 2.5, 0.045
# Shares of what is left that a proof of impossibility may take: when a planner pauses before it searches far afield,
# and what the last planner must leave for it.
_EARLY_PROOF, _LAST_PROOF = 0.1, 0.2
# Likewise for the robot's largest disc alone, after a planner in vain: it mostly ends by itself within 3 ms where there
# is a way, and the gap that it finds too narrow is measured in 30 ms more.
_DISC_PROOF = 0.25
# A guess is worth a try only if its least price is below this share of the best plan's price; on easy scenes a plan
# costs 0.2 % more than the least price of its path. Of 352 cases, against the longer search before: with 0.95, 25 plans
# were dearer by more than 0.5 % and 2 cheaper; with 0.98, 2 and 9, in a tenth more time. 0.97 lies between.
_WORTH_A_TRY = 0.97
# Share of the budget from which on a guess that lies in no obstacle and was cut short is gone on with.
_GOING_ON = 0.5
_MOST_LEFT_OUT = 6  # gears of the best plan
_WARM_UP = 3.0  # [s], budget of the plan that warms up; a planner that uses all it gets takes that long, once

# A plugin by its name, by its name with parameters, or the object itself.
PlannerLike: TypeAlias = "str | PluginChoice | GlobalPlanner"
SmootherLike: TypeAlias = "str | PluginChoice | Smoother"
TimingLike: TypeAlias = "str | PluginChoice | TimeParameterizer"


def plan_dock(  # noqa: PLR0913 - what may be chosen is chosen by name
    problem: DockingProblem,
    *,
    time_budget: float = DEFAULT_TIME_BUDGET,
    planner: PlannerLike | Sequence[PlannerLike] = DEFAULT_PLANNERS,
    smoother: SmootherLike = DEFAULT_SMOOTHER,
    timing: TimingLike = DEFAULT_TIMING,
    guesses: Iterable[Path] = (),
    warm_start: DockPlan | Path | None = None,
    cancel_checker: Callable[[], bool] = never_cancelled,
) -> DockPlan:
    """Plan, smooth, prove and time a docking motion.

    It ends in one of three words: certified; impossible, which is proven (`NoMotionExists`); or not found, with the
    reason that stood in the way of the guess that came furthest, or because the time was over.

    Planner, smoother and time parameterizer are names of installed plugins, or plugins: `CasadiSmoother(spans=32)`. An
    object must not be configured; it is for the time of the call, and serves one call at a time.

    Args:
        problem: From where, to where, with what, among what.
        time_budget: Wall-clock seconds for the whole call, but for the first call of a process with these plugins:
            there the clock starts when they are warm; see `warm_up`. The call returns as soon as no later guess can
            beat what it has, mostly long before.
        planner: Makes the guesses; several are asked in this order.
        smoother: Makes them drivable.
        timing: Gives them their time law.
        guesses: Raw paths of the caller, from any source, which are tried first: of another planner, or a recorded
            drive.
        warm_start: An earlier plan, or its path, for a problem much like this one: the smoother may begin there.
        cancel_checker: Polled at least every 5 ms by the stages that take long; what it raises is passed on as it is.

    Returns:
        The certified plan of the lowest price found (see `DockPlan.price`); `tried` names every guess, and what became
        of it.

    Raises:
        InvalidValue: The budget is not a finite number > 0, an argument is of another class, or a parameter of a plugin
            is wrong.
        InvalidPath: A guess stands in another frame than the problem.
        StartOccupied: Also GoalOccupied, StartOutsideMapBounds, GoalOutsideMapBounds: an end pose is impossible.
        NoMotionExists: It is proven that nothing of this shape can come from the start to the goal.
        NoValidPathCouldBeFound: No planner finds a raw path.
        FailedToSmoothPath: No path near a raw one keeps every bound.
        FailedToTimePath: No time law keeps the motion limits.
        TimedOut: Nothing was found, and a stage ran out of time on the way: a planner (PlannerTimedOut), the smoothing
            of a guess or its proof (SmootherTimedOut), or the time law or its proof (TimingTimedOut). With a larger
            `time_budget` there may be a plan, whatever the other guesses failed for.
        Cancelled: `cancel_checker` returned True; PlannerCancelled, SmootherCancelled or TimingCancelled.
        CertificationFailed: A plugin returned something that cannot be proven.
        PluginError: A plugin is unknown, returned something of another type, or raised what its interface does not
            name; that is the cause.
        LifecycleError: A plugin is configured already.

    Every error carries `partial`, a `PartialPlan`, once the plugins are at work.
    """
    time_budget = number(time_budget, "time_budget")
    if not (math.isfinite(time_budget) and time_budget > 0.0):
        raise InvalidValue(f"time_budget: must be finite and > 0 s, got {time_budget}")
    instance(DockingProblem, problem, "problem")
    if isinstance(warm_start, DockPlan):
        warm_start = warm_start.path
    if warm_start is not None:
        instance(Path, warm_start, "warm_start")
    given = _paths(guesses, problem.frame)
    if not callable(cancel_checker):
        raise InvalidValue(f"cancel_checker: must be a function that says whether to stop, got {cancel_checker!r}")
    so_far, began = PartialPlan(), time.monotonic()
    try:
        plugins = _Plugins.chosen(planner, smoother, timing)
        _warm_once(*plugins.classes)
        began = time.monotonic()
        run = _Portfolio(problem, plugins, given, warm_start, Cancellation(cancel_checker), time_budget, so_far)
        try:
            with garbage_collection_paused():
                plan = run.plan()
        finally:
            _WAITS.append(run.watch.longest_wait)
        logger.info("%s; %s", plan, ", ".join(f"{stage} {ms:.1f} ms" for stage, ms in plan.timing_ms.items()))
        return plan
    except OptdockError as error:
        so_far.timing_ms["total"] = 1e3 * (time.monotonic() - began)
        error.partial = so_far
        logger.info("no plan after %.1f ms: %s", so_far.timing_ms["total"], error)
        raise


def _paths(guesses: Iterable[Path], frame: str) -> tuple[Path, ...]:
    """The caller's guesses, in the frame of the problem."""
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
    """Load libraries and build what plugins build once, so that later calls do not wait for it.

    Takes about a second the first time in a process, nothing after that. Plans a small problem; what is wrong with a
    plugin shows when it meets a real one.

    Args:
        planner: As of `plan_dock`.
        smoother: As of `plan_dock`.
        timing: As of `plan_dock`.
        robot: Of the problems to come: what proofs know of its footprint is made now, which takes up to 0.1 s.

    Raises:
        PluginError: A plugin is unknown or cannot be built.
        InvalidValue: A parameter of a plugin is wrong, or `robot` is not a `Robot`.
    """
    _warm_once(*_Plugins.chosen(planner, smoother, timing).classes)
    if robot is not None:
        prepare_footprint(instance(Robot, robot, "robot").footprint)


@functools.cache
def _warm_once(
    planners: tuple[type[GlobalPlanner], ...], smoother: type[Smoother], timing: type[TimeParameterizer]
) -> None:
    limits = MotionLimits(max_curvature=2.0, max_curvature_rate=8.0)
    outline = Footprint.rectangle(0.6, -0.4, 0.5)
    problem = DockingProblem(
        Pose2(-2.0, 0.1, 0.1), Dock(Pose2(0.0, 0.0, 0.0), outline), Robot(Footprint.rectangle(0.3, 0.3, 0.5), limits)
    )
    clock = Deadline(_WARM_UP)
    for planner in planners:
        with contextlib.suppress(Exception):  # also of constructors that need parameters: what is wrong shows later
            plugins = _Plugins((planner(),), smoother(), timing())
            never = Cancellation(never_cancelled)
            _Portfolio(problem, plugins, (), None, never, clock.seconds, PartialPlan()).plan()
    with contextlib.suppress(Exception):
        smoother().warm_up()
    walled = ObstacleSet.from_polygons([[[-1.2, -3.0], [-1.0, -3.0], [-1.0, 3.0], [-1.2, 3.0]]])
    prove_impossible(replace(problem, obstacles=walled), time_budget=0.05)
    logger.info("libraries loaded and caches filled in %.1f s, once per process", clock.elapsed)


class _Plugins(NamedTuple):
    planners: tuple[GlobalPlanner, ...]
    smoother: Smoother
    timing: TimeParameterizer

    @classmethod
    def chosen(
        cls, planner: PlannerLike | Sequence[PlannerLike], smoother: SmootherLike, timing: TimingLike
    ) -> _Plugins:
        asked = tuple(planner) if isinstance(planner, list | tuple) else (planner,)
        if not asked:
            raise InvalidValue("planner: must be one planner or several, got none")
        return cls(
            tuple(plugin_from(GlobalPlanner, one, "planner") for one in asked),
            plugin_from(Smoother, smoother, "smoother"),
            plugin_from(TimeParameterizer, timing, "timing"),
        )

    @property
    def classes(self) -> tuple[tuple[type[GlobalPlanner], ...], type[Smoother], type[TimeParameterizer]]:
        return tuple(map(type, self.planners)), type(self.smoother), type(self.timing)


# How long the machine kept each of the last calls waiting [s]; on a quiet one about none.
_WAITS: collections.deque[float] = collections.deque(maxlen=9)
_MARGIN_SHARE, _MARGIN_MOST = 0.3, 0.006  # of the budget; [s]: what is longer is rare at the end of a call


def _margin(budget: float) -> float:
    """Seconds before the end of the budget at which a call stops working, on a machine with other work to do.

    A process that shares a core waits for some milliseconds whenever it is the others' turn. Where that happened to
    two of the last calls or more it may happen to the next one, just before its deadline; one alone is an accident.
    """
    usual = sorted(_WAITS)[-2] if len(_WAITS) > 1 else 0.0
    return min(usual, _MARGIN_SHARE * budget, _MARGIN_MOST)


_END = object()  # of a planner's guesses
_UNPROVEN = "{} says that no motion exists, without a proof that holds"


class _CutShort(NamedTuple):
    """A guess that had too little time, how far the smoother came with it, and its share of poses in obstacles."""

    guess: Guess
    begun: Path | None
    overlapping: float


@dataclass(eq=False)
class _Portfolio:
    """One call of `plan_dock`: its guesses in order, the best plan so far, and why the others failed."""

    problem: DockingProblem
    plugins: _Plugins
    given: tuple[Path, ...]
    warm_start: Path | None
    cancelled: Cancellation
    budget: float
    so_far: PartialPlan
    deadline: Deadline = field(init=False)
    watch: Stopwatch = field(init=False)
    refinement: Refinement = field(init=False)
    best: DockPlan | None = None
    last_resort: DockPlan | None = None  # along a guess as it is, with a stop at every bend
    tried: list[Attempt] = field(default_factory=list)
    failures: Failures = field(init=False)
    cut_short: list[_CutShort] = field(default_factory=list)
    is_cut_off: bool = False  # by the clock, with guesses not made, or not tried, yet

    def __post_init__(self) -> None:
        self.deadline = Deadline(self.budget - _margin(self.budget))
        self.watch = Stopwatch(self.deadline, self.so_far.timing_ms)
        self.failures = Failures(self.problem, self.budget)
        _, smoother, timing = self.plugins
        self.refinement = Refinement(
            self.problem, smoother, timing, self.warm_start, self.cancelled, self.budget, self.deadline, self.watch
        )

    @functools.cached_property
    def impossibility(self) -> ImpossibilitySearch:
        """The search for a proof, which goes on where it was interrupted."""
        return ImpossibilitySearch(self.problem)

    def plan(self) -> DockPlan:
        """The best plan; `so_far` holds what exists of the guess that came furthest when there is none."""
        with self.watch.timed("plan"):
            check_ends(self.problem)
            blocked = prove_straight_blocked(self.problem)
        if blocked is not None:
            raise NoMotionExists(blocked.message, proof=blocked, where=blocked.where)
        with contextlib.closing(self._guesses()) as guesses:
            for guess, is_last in guesses:
                self._try(guess, is_last=is_last)
                if self._is_late() or self._must_go_on():
                    self.is_cut_off |= not is_last
                    break
        again, self.cut_short = sorted(self.cut_short, key=lambda one: one.overlapping), []
        for guess, begun, _ in again:  # nothing else is left to be tried
            if self.best is None and self._is_late():
                self.is_cut_off = True
            elif self.best is None:
                self.failures.forget(guess.path)
                self._try(guess, begun, is_last=True)
        plans = [plan for plan in (self.best, self.last_resort) if plan is not None]
        if not plans:
            self._leave_furthest()
            raise self.failures.refusal(is_cut_off=self.is_cut_off, is_late=self._is_late())
        self.best = min(plans, key=lambda plan: plan.price)
        self._leave_out_gears()
        timing = {**self.so_far.timing_ms, "total": 1e3 * self.deadline.elapsed}
        return replace(self.best, completed=self._is_complete(self.best), timing_ms=timing, tried=tuple(self.tried))

    def _is_complete(self, plan: DockPlan) -> bool:
        """Whether more time would not change anything."""
        is_cut_short = self.is_cut_off or any(isinstance(failure.error, TimedOut) for failure in self.failures)
        return plan.completed and not self.deadline.passed() and not (plan is self.last_resort and is_cut_short)

    def _leave_out_gears(self) -> None:
        """Try the best plan without one of its shorter gears, as long as that helps."""
        tried: set[str] = set()
        while self.best is not None and len(tried) < _MOST_LEFT_OUT and not self._is_late():
            simpler = (path for path in fewer_cusps(self.best.path, self.problem) if path.digest not in tried)
            path = next((one for one in simpler if least_price(one, self.problem) < self._worth_a_try()), None)
            if path is None:
                return
            tried.add(path.digest)
            self._try(Guess(path, "fewer cusps"), is_last=True)

    def _guesses(self) -> Generator[tuple[Guess, bool], None, None]:
        """Every guess, and whether it is known to be the last one; a proof that there is no way ends them.

        Raises:
            NoMotionExists: That is proven.
        """
        for path in self.given:
            yield Guess(path, "given"), False
        last = self.plugins.planners[-1]
        for planner in self.plugins.planners:
            makes_one = type(planner).create_plans is GlobalPlanner.create_plans
            try:
                with at_work(planner, self.problem, self.cancelled):
                    for guess in self._guesses_of(planner, is_last=planner is last):
                        yield guess, makes_one and planner is last
            except (PlannerException, PluginError) as error:
                broken = isinstance(error, PluginError) and self.best is None
                if broken or isinstance(error, Cancelled | NoMotionExists):
                    raise
                self._fail(Failure(error, PartialPlan(), 0), type(planner).__name__)
            if self._is_late():
                self.is_cut_off |= planner is not last
                break
            self._look_for_a_proof(_DISC_PROOF, only_disc=True)
        self._look_for_a_proof(0.5 if self.cut_short else 1.0)

    def _guesses_of(self, planner: GlobalPlanner, *, is_last: bool) -> Iterator[Guess]:
        """The guesses of a planner, which is at work while it makes them.

        The last of several must leave time for a proof while nothing is found.

        Raises:
            PlannerException: It has none, or none any more.
            PlannerTimedOut: Its share of the time is used up.
            NoMotionExists: That was proven while it paused.
        """
        share = 1.0 - _LAST_PROOF if is_last and len(self.plugins.planners) > 1 else 1.0
        until = self.deadline.elapsed + share * self.deadline.left

        def is_used_up() -> bool:
            return self.best is None and self.deadline.elapsed > until

        def asked_to_stop() -> bool:
            return is_used_up() or self.refinement.asked_to_stop()

        ends = self.problem.start, self.problem.goal
        guesses = iter(planner.create_plans(*ends, asked_to_stop, self._worth_a_try))
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
        raise PlannerTimedOut(ran_out_of_time(type(planner).__name__, self.budget))

    def _next(self, guesses: Iterator[Guess | None], planner: GlobalPlanner) -> object:
        """What a planner offers next: a guess, a pause, or `_END`."""
        late = ran_out_of_time(type(planner).__name__, self.budget)
        try:
            with self.watch.timed("plan"):
                found = next(guesses, _END)
        except PlannerCancelled as error:
            if self.cancelled():
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

    def _lowest_price(self) -> float:
        return self.best.price if self.best is not None else math.inf

    def _worth_a_try(self) -> float:
        return _WORTH_A_TRY * self._lowest_price()

    def _must_go_on(self) -> bool:
        """Whether the time left is better spent on a free guess that was cut short than on others."""
        is_one = any(one.begun is not None and one.overlapping == 0.0 for one in self.cut_short)
        return is_one and self.best is None and self.deadline.left < _GOING_ON * self.budget

    def _is_late(self) -> bool:
        """Whether no time is left for another guess."""
        return self.deadline.left <= self.refinement.reserve

    def _try(self, guess: Guess, begun: Path | None = None, *, is_last: bool) -> None:
        """Make a plan of a guess, going on where it was cut short; it becomes the best one, or a failure."""
        unhurried = is_last or self.best is not None
        overlapping = 0.0 if unhurried else self._overlapping(guess.path)
        if overlapping > 0.0:
            self._look_for_a_proof(_DISC_PROOF, only_disc=True)
        is_long = overlapping * guess.path.length > _SHORTLY * self.problem.robot.footprint.length
        if overlapping > _PUT_OFF and is_long:
            reason = f"put off: {100.0 * overlapping:.0f} % of its poses lie in obstacles"
            self.tried.append(Attempt(guess.stage, guess.path, reason=reason))
            self.cut_short.append(_CutShort(guess, None, overlapping))
            return
        share = _SMOOTHING_SHARE * (0.5 if overlapping > 0.0 else 1.0)
        most = math.inf if unhurried else max(share * self.deadline.left, _SMOOTHING_LEAST)
        most = min(most, _BRIEFLY) if overlapping > _PUT_OFF else most
        left, began = PartialPlan(timing_ms=self.so_far.timing_ms), self.deadline.elapsed
        try:
            plan = self.refinement.refined(guess.path, left, most, is_given=guess.stage == "given", begun=begun)
        except NoMotionExists as error:  # of the smoother or the time parameterizer, which look for no proof
            names = " or ".join(type(plugin).__name__ for plugin in self.plugins[1:])
            raise PluginError(_UNPROVEN.format(names)) from error
        except OptdockError as error:
            stage = stage_of(error)
            if isinstance(error, Cancelled) or (stage is None and self.best is None):
                self._leave(left)
                raise
            if isinstance(error, SmootherTimedOut) and not unhurried:
                self.cut_short.append(_CutShort(guess, PartialPlan.left_by(error).path, overlapping))
            self._fail(Failure(error, left, stage or 0), guess.stage, guess.path, self.deadline.elapsed - began)
            self._stop_at_bends(guess)
            return
        self.tried.append(Attempt(guess.stage, guess.path, self.deadline.elapsed - began, plan.price))
        self.so_far.timing_ms.setdefault("first", 1e3 * self.deadline.elapsed)
        if plan.price < self._lowest_price():
            self.best = plan

    def _stop_at_bends(self, guess: Guess) -> None:
        """Keep a plan along a guess that failed, as it is, in case that nothing better is found."""
        if guess.stage == "given" or self.best is not None or self.deadline.left <= 2.0 * self.refinement.reserve:
            return  # where time is left for a timing alone, the certificate before it would end too late
        known = self.last_resort.price if self.last_resort is not None else math.inf
        path = stopping_at_bends(guess.path)
        if path is None or least_price(path, self.problem) >= known:
            return
        began = self.deadline.elapsed
        with contextlib.suppress(OptdockError):  # what is said of the guess is why it could not be smoothed
            plan = self.refinement.proven(guess.path, path, PartialPlan(), is_late=self._is_late)
            if plan.price < known:
                self.last_resort = plan
                stage, seconds = f"{guess.stage}, stopping at bends", self.deadline.elapsed - began
                self.tried.append(Attempt(stage, guess.path, seconds, plan.price))
                self.so_far.timing_ms.setdefault("first", 1e3 * self.deadline.elapsed)

    def _overlapping(self, path: Path) -> float:
        """Share of the poses of a guess that lie in obstacles."""
        poses = path.poses_at(np.linspace(0.0, path.length, _LOOKS))
        clearances, _ = pose_clearances(poses, self.problem.robot.footprint, self.problem.all_obstacles, within=0.1)
        return float(np.mean(clearances < 0.0))

    def _fail(self, failure: Failure, stage: str, path: Path | None = None, seconds: float = 0.0) -> None:
        reason = f"{type(failure.error).__name__}: {failure.error}"
        self.tried.append(Attempt(stage, path, seconds, reason=reason))
        self.failures.add(failure)

    def _leave_furthest(self) -> None:
        """Hand out what exists of the guess that came furthest."""
        self._leave(self.failures.furthest().left if self.failures else PartialPlan())

    def _leave(self, left: PartialPlan) -> None:
        """Hand out what exists of a guess."""
        self.so_far.raw_path, self.so_far.path, self.so_far.certificate = left.raw_path, left.path, left.certificate
        self.so_far.tried = tuple(self.tried)

    def _look_for_a_proof(self, share: float = 1.0, *, only_disc: bool = False) -> None:
        """Spend a share of what is left on a proof that no motion exists, or at first only on what is cheap to prove.

        Raises:
            NoMotionExists: That is proven.
            PlannerCancelled: The caller wants an end.
        """
        if self.best is not None or self.last_resort is not None or self.deadline.left <= 0.0:
            return
        with self.watch.timed("prove"):
            if self.impossibility.ended:
                return
            allowed = share * self.deadline.left
            proof = self.impossibility.proof(allowed, self.cancelled, only_disc=only_disc)
        if self.cancelled():
            raise PlannerCancelled("cancelled while a proof that there is no way was looked for")
        if proof is not None:
            self._leave_furthest()
            raise NoMotionExists(proof.message, proof=proof, where=proof.where)
