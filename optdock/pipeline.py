"""`plan_dock`: a docking problem in, a certified trajectory out, or a typed error that says why not."""

from __future__ import annotations

import collections
import contextlib
import functools
import logging
import math
import time
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple, TypeVar

from optdock.deadline import Deadline, garbage_collection_paused
from optdock.dock import Dock
from optdock.end_poses import check_ends
from optdock.errors import (
    CertificationFailed,
    FailedToTimePath,
    InvalidValue,
    OptdockError,
    PlannerCancelled,
    PlannerTimedOut,
    PluginError,
    SmootherTimedOut,
    TimingTimedOut,
)
from optdock.geometry.checked import instance, number
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.interfaces import (
    GlobalPlanner,
    PluginContext,
    Smoother,
    SmoothingResult,
    TimeParameterizer,
    TimingResult,
    TimingStatus,
    never_cancelled,
)
from optdock.limits import MotionLimits
from optdock.path import Path
from optdock.plugins import create_plugin
from optdock.problem import DockingProblem
from optdock.robot import Robot
from optdock.trajectory import Trajectory
from optdock.verification import certify_path, certify_trajectory

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from optdock.lifecycle import Plugin
    from optdock.verification import Certificate, TrajectoryCertificate

__all__ = ["DockPlan", "PartialPlan", "PluginChoice", "PluginChoices", "plan_dock", "warm_up"]

logger = logging.getLogger(__name__)

DEFAULT_TIME_BUDGET = 0.1  # [s]
# Share of the budget, its least and most [s], kept back from the smoother for timing the path and proving the motion.
_RESERVED_SHARE, _RESERVED_LEAST, _RESERVED_MOST = 0.3, 0.004, 0.03
_PROOF = 0.001  # [s], kept back from the time parameterizer for the proof of its motion

P = TypeVar("P", bound="Plugin")
_T = TypeVar("_T")


@dataclass(frozen=True)
class PluginChoice:
    """Which plugin fills a role, and its parameters.

    Raises:
        InvalidValue: The name is no text.
    """

    name: str
    parameters: Mapping[str, object] = field(default_factory=dict)

    def __post_init__(self) -> None:
        instance(str, self.name, "plugin choice: name")


_PLAIN_TIMING = PluginChoice("Windowed")


@dataclass(frozen=True)
class PluginChoices:
    """The three plugins of the pipeline.

    Raises:
        InvalidValue: One of them is no `PluginChoice`.
    """

    planner: PluginChoice = PluginChoice("DockPlanner")
    smoother: PluginChoice = PluginChoice("CasadiSmoother")
    timing: PluginChoice = PluginChoice("NearOptimal")

    def __post_init__(self) -> None:
        for role in ("planner", "smoother", "timing"):
            instance(PluginChoice, getattr(self, role), f"plugin choices: {role}")


@dataclass(frozen=True, eq=False)
class DockPlan:
    """A certified plan.

    Args:
        raw_path: What the planner made; not certified, kept for comparison.
        path: The certified path.
        trajectory: The certified motion along it.
        certificate: The proof of the path.
        trajectory_certificate: The proof of the motion limits.
        completed: False when the deadline stopped the smoothing early; the result is certified all the same.
        timing_ms: Wall-clock milliseconds per stage: plan, smooth, certify, time, total.
        smoothing_report: What the smoother says about its work.
        timing_report: What the time parameterizer says about its work.
    """

    raw_path: Path
    path: Path
    trajectory: Trajectory
    certificate: Certificate
    trajectory_certificate: TrajectoryCertificate
    completed: bool
    timing_ms: Mapping[str, float]
    smoothing_report: Mapping[str, object] = field(default_factory=dict)
    timing_report: Mapping[str, object] = field(default_factory=dict)

    @property
    def frame(self) -> str:
        """Name of the coordinate frame that every pose of the plan stands in."""
        return self.path.frame


@dataclass(eq=False)
class PartialPlan:
    """Whatever exists of a plan so far; hangs as `partial` on the error that ended it.

    Args:
        raw_path: The planner's path, or None.
        path: The smoothed path, or None; not necessarily certified.
        certificate: The verdict on `path`, or None.
        timing_ms: Wall-clock milliseconds of the stages that ran.
    """

    raw_path: Path | None = None
    path: Path | None = None
    certificate: Certificate | None = None
    timing_ms: dict[str, float] = field(default_factory=dict)

    @classmethod
    def left_by(cls, error: OptdockError) -> PartialPlan:
        """What a call had finished when it failed; nothing where the error does not say."""
        return error.partial if isinstance(error.partial, cls) else cls()


def plan_dock(
    problem: DockingProblem,
    *,
    time_budget: float = DEFAULT_TIME_BUDGET,
    plugins: PluginChoices | None = None,
    cancel_checker: Callable[[], bool] = never_cancelled,
) -> DockPlan:
    """Plan, smooth, prove and time a docking motion.

    Args:
        problem: From where, to where, with what, among what.
        time_budget: Wall-clock seconds for the whole call, but for the first call of a process with these plugins:
            there the clock starts when they are warm; see `warm_up`.
        plugins: Which planner, smoother and time parameterizer to use.
        cancel_checker: Polled at least every 5 ms by the stages that take long.

    Returns:
        The certified plan.

    Raises:
        InvalidValue: The budget is not a finite number > 0, an argument is of another class, or a parameter of a plugin
            is wrong.
        StartOccupied: Also GoalOccupied, StartOutsideMapBounds, GoalOutsideMapBounds: an end pose is impossible.
        NoValidPathCouldBeFound: The planner finds no raw path.
        FailedToSmoothPath: No path near the raw one keeps every bound.
        SmootherTimedOut: The deadline came before the first certified path.
        FailedToTimePath: No time law keeps the motion limits.
        TimingTimedOut: The deadline came before the time law, or before its proof.
        PlannerTimedOut: The deadline came before the raw path.
        CertificationFailed: A plugin returned something that cannot be proven.
        PluginError: A plugin is unknown, returned something of another type, or raised what is no error of ours; that
            is the cause.

    Every error carries `partial`, a `PartialPlan`.
    """
    time_budget = number(time_budget, "time_budget")
    if not (math.isfinite(time_budget) and time_budget > 0.0):
        raise InvalidValue(f"time_budget: must be finite and > 0 s, got {time_budget}")
    instance(DockingProblem, problem, "problem")
    choices = PluginChoices() if plugins is None else instance(PluginChoices, plugins, "plugins")
    warm_up(choices)
    run = _Run(problem, Deadline(time_budget - _margin(time_budget)), cancel_checker, time_budget)
    try:
        with garbage_collection_paused():
            plan = run.plan(choices)
        stages = ", ".join(f"{stage} {ms:.1f} ms" for stage, ms in plan.timing_ms.items())
        logger.info("certified plan: %.2f m, %.2f s; %s", plan.path.length, plan.trajectory.duration, stages)
        return plan
    except OptdockError as error:
        run.so_far.timing_ms["total"] = 1e3 * run.deadline.elapsed
        error.partial = run.so_far
        logger.info("no plan after %.1f ms: %s", 1e3 * run.deadline.elapsed, error)
        raise
    finally:
        _WAITS.append(run.longest_wait)


# How long the machine kept each of the last calls waiting [s]; on a quiet one about none.
_WAITS: collections.deque[float] = collections.deque(maxlen=9)
_MARGIN_SHARE, _MARGIN_MOST = 0.3, 0.006  # of the budget; [s]: what is longer is rare at the end of a call


def _margin(budget: float) -> float:
    """Seconds before the end of the budget at which a call stops working, on a machine with other work to do.

    Whoever shares a core is kept waiting for some milliseconds whenever it is the others' turn. Where that happened to
    two of the last calls or more it may happen to the next one, just before its deadline; one alone is an accident.
    """
    usual = sorted(_WAITS)[-2] if len(_WAITS) > 1 else 0.0
    return min(usual, _MARGIN_SHARE * budget, _MARGIN_MOST)


def warm_up(plugins: PluginChoices | None = None) -> None:
    """Load libraries and build what the plugins build once, so that no later call pays for it.

    Takes about a second the first time in a process, nothing after that. Plans a small problem; what is wrong with a
    plugin shows when it meets a real one.

    Args:
        plugins: Which planner, smoother and time parameterizer; None: the default ones.
    """
    choices = plugins or PluginChoices()
    _warm_once(choices.planner.name, choices.smoother.name, choices.timing.name)


@functools.cache
def _warm_once(planner: str, smoother: str, timing: str) -> None:
    choices = PluginChoices(PluginChoice(planner), PluginChoice(smoother), PluginChoice(timing))
    limits = MotionLimits(max_curvature=2.0, max_curvature_rate=8.0)
    outline = Footprint.rectangle(0.6, -0.4, 0.5)
    problem = DockingProblem(
        Pose2(-2.0, 0.1, 0.1), Dock(Pose2(0.0, 0.0, 0.0), outline), Robot(Footprint.rectangle(0.3, 0.3, 0.5), limits)
    )
    clock = Deadline(10.0)
    with contextlib.suppress(OptdockError):
        _Run(problem, clock, never_cancelled, 10.0).plan(choices)
        with _typed(choices.smoother):
            create_plugin(Smoother, smoother).warm_up()
    logger.info("libraries loaded and caches filled in %.1f s, once per process", clock.elapsed)


@dataclass(eq=False)
class _Run:
    """One call of `plan_dock`."""

    problem: DockingProblem
    deadline: Deadline
    cancel_checker: Callable[[], bool]
    budget: float
    so_far: PartialPlan = field(default_factory=PartialPlan)
    longest_wait: float = 0.0

    def plan(self, choices: PluginChoices) -> DockPlan:
        """All stages in turn; `so_far` holds what exists when one of them raises."""
        self._timed("plan", lambda: check_ends(self.problem))
        raw = self._timed("plan", lambda: self._raw_path(choices.planner))
        self.so_far.raw_path = raw
        result = self._timed("smooth", lambda: self._smooth(choices.smoother, raw))
        self.so_far.path = path = _plain(result.path).with_frame(self.problem.frame)
        certificate = self._timed("certify", lambda: self._certified(path))
        motion = self._certified_motion(choices.timing, path)
        completed = result.completed and not self.deadline.passed()
        timing = {**self.so_far.timing_ms, "total": 1e3 * self.deadline.elapsed}
        return DockPlan(
            raw, path, motion.trajectory, certificate, motion.proof, completed, timing, result.report, motion.report
        )

    def _timed(self, stage: str, work: Callable[[], _T]) -> _T:
        began, worked = self.deadline.elapsed, time.thread_time()
        try:
            return work()
        finally:
            took = self.deadline.elapsed - began
            self.longest_wait = max(self.longest_wait, took - (time.thread_time() - worked))
            self.so_far.timing_ms[stage] = self.so_far.timing_ms.get(stage, 0.0) + 1e3 * took

    def _configured(self, interface: type[P], choice: PluginChoice) -> P:
        plugin = create_plugin(interface, choice.name, choice.parameters)
        plugin.configure(self._context(choice))
        return plugin

    def _context(self, choice: PluginChoice) -> PluginContext:
        return PluginContext(name=choice.name, problem=self.problem)

    def _asked_to_stop(self) -> bool:
        return self.cancel_checker() or self.deadline.passed()

    def _raw_path(self, choice: PluginChoice) -> Path:
        late = f"the planner used up the time budget of {self.budget:.3g} s"
        try:
            with _typed(choice):
                planner = self._configured(GlobalPlanner, choice)
                path = planner.create_plan(self.problem.start, self.problem.goal, self._asked_to_stop)
        except PlannerCancelled as error:
            if self.deadline.passed():
                raise PlannerTimedOut(late) from error
            raise
        if self.deadline.passed():
            raise PlannerTimedOut(late)
        return _plain(_returned(path, Path, choice)).with_frame(self.problem.frame)

    def _smooth(self, choice: PluginChoice, raw: Path) -> SmoothingResult:
        allowance = self.deadline.left - _reserve(self.budget)
        if allowance <= 0.0:
            raise SmootherTimedOut(f"nothing is left of the time budget of {self.budget:.3g} s for smoothing")
        with _typed(choice):
            smoother = self._configured(Smoother, choice)
            result = smoother.smooth(raw, allowance, problem=self.problem, cancel_checker=self.cancel_checker)
        _returned(_returned(result, SmoothingResult, choice).path, Path, choice, "the path of its result")
        return result

    def _certified(self, path: Path) -> Certificate:
        certificate = certify_path(path, self.problem, is_late=self.deadline.passed)
        self.so_far.certificate = certificate
        if certificate.certified:
            return certificate
        reason, where = certificate.reason, _where(certificate)
        if self._was_cut_short(certificate):
            raise SmootherTimedOut(f"the proof of the smoothed path was cut short: {reason}", where=where)
        raise CertificationFailed(f"the smoothed path is not certified: {reason}", where=where)

    def _was_cut_short(self, proof: Certificate | TrajectoryCertificate) -> bool:
        """Whether nothing but the deadline stands in the way of a proof, as far as it went."""
        return self.deadline.passed() and all(violation.kind == "unproven" for violation in proof.violations)

    def _certified_motion(self, choice: PluginChoice, path: Path) -> _Motion:
        """The motion of the chosen method, or where that fails its proof, of the method that never needs repair.

        That the path cannot be timed is an answer; any other error of the method is its own mistake.
        """
        parameterizer = create_plugin(TimeParameterizer, choice.name, choice.parameters)
        try:
            return self._proven_motion(choice, parameterizer, path)
        except FailedToTimePath:
            raise
        except OptdockError as error:
            if choice.name == _PLAIN_TIMING.name:
                raise
            logger.warning("%s: %s; timed by %s instead", choice.name, error, _PLAIN_TIMING.name)
            try:
                plain = create_plugin(TimeParameterizer, _PLAIN_TIMING.name)
                motion = self._proven_motion(_PLAIN_TIMING, plain, path)
            except FailedToTimePath:
                raise error from None
            return motion._replace(report={**motion.report, "replaced": f"{choice.name}: {error}"})

    def _proven_motion(self, choice: PluginChoice, parameterizer: TimeParameterizer, path: Path) -> _Motion:
        robot, dock, deadline = self.problem.robot, self.problem.dock, self.deadline
        result = self._timed("time", lambda: self._time(choice, parameterizer, path))
        if result.status is not TimingStatus.OK:
            raise _timing_failure(result)
        trajectory = _returned(result.trajectory, Trajectory, choice, "the trajectory of its result")
        if trajectory.path is not path and trajectory.path.digest != path.digest:
            message = f"{choice.name} timed another path than the certified one"
            raise CertificationFailed(message, where={"kind": "path"})
        if type(trajectory) is not Trajectory or trajectory.path is not path:
            trajectory = Trajectory(path, trajectory.time_law)
        speed = abs(self.problem.start_speed)
        proof = self._timed(
            "certify",
            lambda: certify_trajectory(
                trajectory,
                robot.limits,
                dock.approach,
                start_speed=speed,
                start_acceleration=0.0,
                is_late=deadline.passed,
            ),
        )
        if not proof.certified:
            if self._was_cut_short(proof):
                raise TimingTimedOut(f"the proof of the motion was cut short: {proof.reason}", where=_where(proof))
            raise CertificationFailed(f"the trajectory is not certified: {proof.reason}", where=_where(proof))
        return _Motion(Trajectory(path, trajectory.time_law, self.problem.fingerprint), proof, result.report)

    def _time(self, choice: PluginChoice, parameterizer: TimeParameterizer, path: Path) -> TimingResult:
        robot, dock = self.problem.robot, self.problem.dock
        allowance = self.deadline.left - _PROOF
        if allowance <= 0.0:
            raise TimingTimedOut(f"nothing is left of the time budget of {self.budget:.3g} s for timing")
        with _typed(choice):
            parameterizer.configure(self._context(choice))
            result = parameterizer.parameterize(
                path, robot.limits, dock.approach, start_speed=abs(self.problem.start_speed), max_time=allowance
            )
        _returned(_returned(result, TimingResult, choice).status, TimingStatus, choice, "the status of its result")
        return result


class _Motion(NamedTuple):
    """A certified trajectory, its proof, and what the time parameterizer says about its work."""

    trajectory: Trajectory
    proof: TrajectoryCertificate
    report: Mapping[str, object]


def _reserve(budget: float) -> float:
    """Seconds kept back from the smoother for timing the path and proving the motion."""
    return min(max(_RESERVED_SHARE * budget, _RESERVED_LEAST), _RESERVED_MOST)


@contextlib.contextmanager
def _typed(choice: PluginChoice) -> Iterator[None]:
    """Whatever a plugin raises that is no error of ours is an error of the plugin.

    Raises:
        PluginError: With the foreign exception as its cause.
    """
    try:
        yield
    except OptdockError:
        raise
    except Exception as error:
        raise PluginError(f"{choice.name} failed: {type(error).__name__}: {error}") from error


def _returned(value: object, kind: type[_T], choice: PluginChoice, part: str = "") -> _T:
    """What a plugin returned, or a part of it, of the type that its interface promises.

    Raises:
        PluginError: It is of another type.
    """
    if not isinstance(value, kind):
        promised = f"{choice.name} must return a {kind.__name__}{part and ' as '}{part}"
        raise PluginError(f"{promised}, got {type(value).__name__}")
    return value


def _plain(path: Path) -> Path:
    """The path, of no subclass: one could have other poses than the segments that are proven."""
    return path if type(path) is Path else Path(path.segments, path.frame)


def _timing_failure(result: TimingResult) -> FailedToTimePath:
    where = {"status": result.status.name, "worst_ratio": result.worst_ratio, "overshoot": result.overshoot}
    if result.limit:
        where["limit"] = result.limit
    if result.at_s is not None:
        where["s"] = result.at_s
    kind = TimingTimedOut if result.status is TimingStatus.TIMED_OUT else FailedToTimePath
    return kind(f"the path cannot be timed: {result.status.name}: {result.reason or 'no reason given'}", where=where)


def _where(certificate: Certificate | TrajectoryCertificate) -> Mapping[str, object]:
    first = certificate.violations[0]
    return {"kind": first.kind, "s": first.s, "amount": first.amount, **first.where}
