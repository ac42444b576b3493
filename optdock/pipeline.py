"""`plan_dock`: a docking problem in, a certified trajectory out, or a typed error that says why not."""

from __future__ import annotations

import collections
import contextlib
import functools
import logging
import math
import time
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, NamedTuple, TypeAlias, TypeVar

from optdock.deadline import Deadline, garbage_collection_paused
from optdock.dock import Dock
from optdock.errors import (
    Cancelled,
    CertificationFailed,
    FailedToTimePath,
    GoalOccupied,
    GoalOutsideMapBounds,
    InvalidPath,
    InvalidValue,
    LifecycleError,
    OptdockError,
    PlannerCancelled,
    PlannerTimedOut,
    PluginError,
    SmootherCancelled,
    SmootherException,
    SmootherTimedOut,
    StartOccupied,
    StartOutsideMapBounds,
    TimingCancelled,
    TimingTimedOut,
)
from optdock.geometry.checked import instance, number
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.interfaces import (
    GlobalPlanner,
    LifecycleState,
    PluginContext,
    Smoother,
    SmoothingReport,
    SmoothingResult,
    TimeParameterizer,
    TimingReport,
    TimingResult,
    TimingStatus,
    never_cancelled,
)
from optdock.limits import MotionLimits
from optdock.obstacles import in_words
from optdock.path import Path
from optdock.plan import DockPlan, PartialPlan, where_broken
from optdock.plugins import PluginChoice, create_plugin, plugin_from
from optdock.problem import ClearanceRule, DockingProblem
from optdock.robot import Robot
from optdock.trajectory import Trajectory
from optdock.verification import TOLERANCE, certify_motion, certify_path, end_clearances

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from optdock.lifecycle import Plugin
    from optdock.verification import Certificate, TrajectoryCertificate

__all__ = [
    "DEFAULT_PLANNER",
    "DEFAULT_SMOOTHER",
    "DEFAULT_TIME_BUDGET",
    "DEFAULT_TIMING",
    "PlannerLike",
    "SmootherLike",
    "TimingLike",
    "check_ends",
    "plan_dock",
    "warm_up",
]

logger = logging.getLogger(__name__)

DEFAULT_TIME_BUDGET = 0.1  # [s]
DEFAULT_PLANNER, DEFAULT_SMOOTHER, DEFAULT_TIMING = "DockPlanner", "CasadiSmoother", "NearOptimal"
_PLAIN_TIMING = "Windowed"  # needs no repair
# Share of the budget, its least and most [s], kept back from the smoother for timing the path and proving the motion.
_RESERVED_SHARE, _RESERVED_LEAST, _RESERVED_MOST = 0.3, 0.004, 0.03
_WARM_UP = 3.0  # [s], budget of the plan that warms up; a planner that uses all it gets takes that long, once
_PROOF = 0.001  # [s], kept back from the time parameterizer for the proof of its motion

# A plugin by its name, by its name with parameters, or the object itself.
PlannerLike: TypeAlias = "str | PluginChoice | GlobalPlanner"
SmootherLike: TypeAlias = "str | PluginChoice | Smoother"
TimingLike: TypeAlias = "str | PluginChoice | TimeParameterizer"

_T = TypeVar("_T")


def plan_dock(  # noqa: PLR0913 - what may be chosen is chosen by name
    problem: DockingProblem,
    *,
    time_budget: float = DEFAULT_TIME_BUDGET,
    planner: PlannerLike = DEFAULT_PLANNER,
    smoother: SmootherLike = DEFAULT_SMOOTHER,
    timing: TimingLike = DEFAULT_TIMING,
    warm_start: DockPlan | Path | None = None,
    cancel_checker: Callable[[], bool] = never_cancelled,
) -> DockPlan:
    """Plan, smooth, prove and time a docking motion.

    Planner, smoother and time parameterizer are names of installed plugins, or plugins: `CasadiSmoother(spans=32)`. An
    object must not be configured; it is for the time of the call, and serves one call at a time.

    Args:
        problem: From where, to where, with what, among what.
        time_budget: Wall-clock seconds for the whole call, but for the first call of a process with these plugins:
            there the clock starts when they are warm; see `warm_up`.
        planner: Makes the raw path.
        smoother: Makes it drivable.
        timing: Gives it its time law.
        warm_start: An earlier plan, or its path, for a problem much like this one: the smoother may begin there.
        cancel_checker: Polled at least every 5 ms by the stages that take long; what it raises is passed on as it is.

    Returns:
        The certified plan.

    Raises:
        InvalidValue: The budget is not a finite number > 0, an argument is of another class, or a parameter of a plugin
            is wrong.
        StartOccupied: Also GoalOccupied, StartOutsideMapBounds, GoalOutsideMapBounds: an end pose is impossible.
        NoValidPathCouldBeFound: The planner finds no raw path.
        FailedToSmoothPath: No path near the raw one keeps every bound.
        FailedToTimePath: No time law keeps the motion limits.
        TimedOut: The deadline came before the raw path (PlannerTimedOut), before the first certified path
            (SmootherTimedOut), or before the time law or its proof (TimingTimedOut).
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
    if not callable(cancel_checker):
        raise InvalidValue(f"cancel_checker: must be a function that says whether to stop, got {cancel_checker!r}")
    so_far, began = PartialPlan(), time.monotonic()
    try:
        plugins = _Plugins.chosen(planner, smoother, timing)
        _warm_once(*map(type, plugins))
        began = time.monotonic()
        run = _Run(problem, plugins, warm_start, _Cancellation(cancel_checker), time_budget, so_far)
        try:
            with garbage_collection_paused():
                plan = run.plan()
        finally:
            _WAITS.append(run.longest_wait)
        logger.info("%s; %s", plan, ", ".join(f"{stage} {ms:.1f} ms" for stage, ms in plan.timing_ms.items()))
        return plan
    except OptdockError as error:
        so_far.timing_ms["total"] = 1e3 * (time.monotonic() - began)
        error.partial = so_far
        logger.info("no plan after %.1f ms: %s", so_far.timing_ms["total"], error)
        raise


def warm_up(
    planner: PlannerLike = DEFAULT_PLANNER,
    smoother: SmootherLike = DEFAULT_SMOOTHER,
    timing: TimingLike = DEFAULT_TIMING,
) -> None:
    """Load libraries and build what the plugins build once, so that no later call pays for it.

    Takes about a second the first time in a process, nothing after that. Plans a small problem; what is wrong with a
    plugin shows when it meets a real one.

    Args:
        planner: As of `plan_dock`.
        smoother: As of `plan_dock`.
        timing: As of `plan_dock`.

    Raises:
        PluginError: A plugin is unknown or cannot be built.
        InvalidValue: A parameter of a plugin is wrong.
    """
    _warm_once(*map(type, _Plugins.chosen(planner, smoother, timing)))


@functools.cache
def _warm_once(planner: type[GlobalPlanner], smoother: type[Smoother], timing: type[TimeParameterizer]) -> None:
    limits = MotionLimits(max_curvature=2.0, max_curvature_rate=8.0)
    outline = Footprint.rectangle(0.6, -0.4, 0.5)
    problem = DockingProblem(
        Pose2(-2.0, 0.1, 0.1), Dock(Pose2(0.0, 0.0, 0.0), outline), Robot(Footprint.rectangle(0.3, 0.3, 0.5), limits)
    )
    clock = Deadline(_WARM_UP)
    with contextlib.suppress(Exception):  # also of constructors that need parameters: what is wrong shows in its call
        plugins = _Plugins(planner(), smoother(), timing())
        with contextlib.suppress(OptdockError):
            _Run(problem, plugins, None, _Cancellation(never_cancelled), clock.seconds, PartialPlan()).plan()
        plugins.smoother.warm_up()
    logger.info("libraries loaded and caches filled in %.1f s, once per process", clock.elapsed)


class _Plugins(NamedTuple):
    planner: GlobalPlanner
    smoother: Smoother
    timing: TimeParameterizer

    @classmethod
    def chosen(cls, planner: PlannerLike, smoother: SmootherLike, timing: TimingLike) -> _Plugins:
        return cls(
            plugin_from(GlobalPlanner, planner, "planner"),
            plugin_from(Smoother, smoother, "smoother"),
            plugin_from(TimeParameterizer, timing, "timing"),
        )


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


class _Cancellation:
    """The caller's cancel checker: what it raises is the caller's own, whoever polls it; a yes is never taken back."""

    def __init__(self, checker: Callable[[], bool]) -> None:
        self._checker, self._said_yes = checker, False
        self.raised: BaseException | None = None

    def __call__(self) -> bool:
        try:
            self._said_yes = self._said_yes or bool(self._checker())
            return self._said_yes
        except BaseException as error:
            self.raised = error
            raise


@dataclass(eq=False)
class _Run:
    """One call of `plan_dock`: its stages in driving order, and what they share."""

    problem: DockingProblem
    plugins: _Plugins
    warm_start: Path | None
    cancelled: _Cancellation
    budget: float
    so_far: PartialPlan
    deadline: Deadline = field(init=False)
    longest_wait: float = 0.0

    def __post_init__(self) -> None:
        self.deadline = Deadline(self.budget - _margin(self.budget))

    def plan(self) -> DockPlan:
        """All stages in turn; `so_far` holds what exists when one of them raises."""
        with self._timed("plan"):
            check_ends(self.problem)
            raw = self.so_far.raw_path = self._raw_path()
        with self._timed("smooth"):
            result = self._smoothed(raw)
            path = self.so_far.path = _plain(result.path, self.plugins.smoother, self.problem.frame)
        with self._timed("certify"):
            certificate = self._certified(path)
        motion = self._certified_motion(path)
        timing = {**self.so_far.timing_ms, "total": 1e3 * self.deadline.elapsed}
        return DockPlan(
            problem=self.problem,
            raw_path=raw,
            path=path,
            trajectory=motion.trajectory,
            certificate=certificate,
            trajectory_certificate=motion.proof,
            completed=result.completed and not self.deadline.passed(),
            timing_ms=timing,
            smoothing_report=result.report,
            timing_report=motion.report,
        )

    @contextlib.contextmanager
    def _timed(self, stage: str) -> Iterator[None]:
        began, worked = self.deadline.elapsed, time.thread_time()
        try:
            yield
        finally:
            took = self.deadline.elapsed - began
            self.longest_wait = max(self.longest_wait, took - (time.thread_time() - worked))
            self.so_far.timing_ms[stage] = self.so_far.timing_ms.get(stage, 0.0) + 1e3 * took

    @contextlib.contextmanager
    def _at_work(self, plugin: Plugin) -> Iterator[None]:
        """A plugin, configured for the problem; whatever it raises that its interface does not name is its own fault.

        Raises:
            PluginError: With what it raised as the cause.
        """
        name = type(plugin).__name__
        if plugin.state is not LifecycleState.UNCONFIGURED:
            raise LifecycleError(f"{name} is {plugin.state.value}; plan_dock configures the plugins that it is given")
        try:
            plugin.configure(PluginContext(name=plugin.name, problem=self.problem))
            try:
                yield
            except (InvalidValue, InvalidPath) as error:  # nothing that the caller gave: the problem is valid
                raise PluginError(f"{name} failed: {type(error).__name__}: {error}") from error
            finally:
                plugin.cleanup()
        except Exception as error:
            if isinstance(error, OptdockError) or self.cancelled.raised is not None:
                raise
            raise PluginError(f"{name} failed: {type(error).__name__}: {error}") from error
        finally:
            if self.cancelled.raised is not None:
                raise self.cancelled.raised from None

    def _asked_to_stop(self) -> bool:
        return self.cancelled() or self.deadline.passed()

    def _raw_path(self) -> Path:
        planner, late = self.plugins.planner, f"the planner used up the time budget of {self.budget:.3g} s"
        try:
            with self._at_work(planner):
                path = planner.create_plan(self.problem.start, self.problem.goal, self._asked_to_stop)
        except PlannerCancelled as error:
            if self.deadline.passed():
                raise PlannerTimedOut(late) from error
            raise
        if self.deadline.passed():
            raise PlannerTimedOut(late)
        return _plain(_returned(path, Path, planner), planner, self.problem.frame)

    def _smoothed(self, raw: Path) -> SmoothingResult:
        smoother, left, kept_back = self.plugins.smoother, self.deadline.left, _reserve(self.budget)
        kept = f"of {_in_ms(self.budget)}; {_in_ms(kept_back)} are kept back for timing and proof"
        if left <= kept_back:
            raise SmootherTimedOut(f"no time is left for smoothing: {_in_ms(max(left, 0.0))} are left {kept}")
        try:
            with self._at_work(smoother):
                result = smoother.smooth(
                    raw,
                    left - kept_back,
                    problem=self.problem,
                    warm_start=self.warm_start,
                    cancel_checker=self.cancelled,
                )
        except SmootherTimedOut as error:
            raise SmootherTimedOut(f"{error}, the smoother's share {kept}", where=error.where) from error
        except SmootherException as error:
            self.so_far.path = PartialPlan.left_by(error).path
            raise
        _returned(result, SmoothingResult, smoother)
        _returned(result.path, Path, smoother, "the path of its result")
        _returned(result.report, SmoothingReport, smoother, "the report of its result")
        return result

    def _certified(self, path: Path) -> Certificate:
        certificate = certify_path(path, self.problem, is_late=self._asked_to_stop)
        self.so_far.certificate = certificate
        self._require(certificate, "smoothed path", SmootherCancelled, SmootherTimedOut)
        return certificate

    def _certified_motion(self, path: Path) -> _Motion:
        """The motion of the chosen method, or where that fails its proof, of the method that never needs repair.

        That the path cannot be timed is an answer; any other error of the method is its own mistake.
        """
        chosen = self.plugins.timing
        try:
            return self._proven_motion(chosen, path)
        except (FailedToTimePath, Cancelled, LifecycleError):
            raise
        except OptdockError as error:
            plain = create_plugin(TimeParameterizer, _PLAIN_TIMING)
            if type(chosen) is type(plain):
                raise
            logger.warning("%s: %s; timed by %s instead", chosen.name, error, _PLAIN_TIMING)
            try:
                motion = self._proven_motion(plain, path)
            except FailedToTimePath:
                raise error from None
            return motion._replace(report=replace(motion.report, replaced=f"{chosen.name}: {error}"))

    def _proven_motion(self, method: TimeParameterizer, path: Path) -> _Motion:
        with self._timed("time"):
            result = self._timing(method, path)
        if result.status is not TimingStatus.OK:
            raise result.failure()
        trajectory = _returned(result.trajectory, Trajectory, method, "the trajectory of its result")
        if trajectory.path is not path and trajectory.path.digest != path.digest:
            message = f"{method.name} timed another path than the certified one"
            raise CertificationFailed(message, where={"kind": "path"})
        trajectory = Trajectory(path, trajectory.time_law, self.problem.fingerprint)
        with self._timed("certify"):
            proof = certify_motion(trajectory, self.problem, is_late=self._asked_to_stop)
        self._require(proof, "trajectory", TimingCancelled, TimingTimedOut)
        return _Motion(trajectory, proof, result.report)

    def _timing(self, method: TimeParameterizer, path: Path) -> TimingResult:
        allowance = self.deadline.left - _PROOF
        if allowance <= 0.0:
            raise TimingTimedOut(f"nothing is left of the time budget of {self.budget:.3g} s for timing")
        limits, zone, speed = self.problem.robot.limits, self.problem.dock.approach, abs(self.problem.start_speed)
        with self._at_work(method):
            result = method.parameterize(
                path, limits, zone, start_speed=speed, max_time=allowance, cancel_checker=self.cancelled
            )
        _returned(result, TimingResult, method)
        _returned(result.status, TimingStatus, method, "the status of its result")
        _returned(result.report, TimingReport, method, "the report of its result")
        return result

    def _require(
        self,
        verdict: Certificate | TrajectoryCertificate,
        what: str,
        cancelled: type[Cancelled],
        late: type[OptdockError],
    ) -> None:
        """Raise what stands in the way of a proof; where nothing is broken as far as it went, that is the clock."""
        if verdict.certified:
            return
        where = where_broken(verdict)
        if all(violation.kind == "unproven" for violation in verdict.violations):
            if self.cancelled():
                raise cancelled(f"cancelled while the {what} was proven", where=where)
            if self.deadline.passed():
                raise late(f"the proof of the {what} was cut short: {verdict.reason}", where=where)
        raise CertificationFailed(f"the {what} is not certified: {verdict.reason}", where=where)


class _Motion(NamedTuple):
    """A certified trajectory, its proof, and what the time parameterizer says about its work."""

    trajectory: Trajectory
    proof: TrajectoryCertificate
    report: TimingReport


def check_ends(problem: DockingProblem) -> None:
    """Refuse end poses that no path can have.

    Raises:
        StartOutsideMapBounds: Also GoalOutsideMapBounds: the position lies off the problem's costmap.
        StartOccupied: The footprint at the start overlaps an obstacle.
        GoalOccupied: The footprint at the goal is closer to an obstacle than required there.
    """
    found = end_clearances(problem)
    for name, pose, off_map, occupied, clearance, row in (
        ("start", problem.start, StartOutsideMapBounds, StartOccupied, found.start, found.nearest_to_start),
        ("goal", problem.goal, GoalOutsideMapBounds, GoalOccupied, found.goal, found.nearest_to_goal),
    ):
        if problem.costmap is not None and not bool(problem.costmap.contains(pose.as_array()[None, :2])[0]):
            raise off_map(f"the {name} ({pose.x:.3f}, {pose.y:.3f}) lies off the map", where={"pose": [pose.x, pose.y]})
        required = problem.clearance.at_dock if name == "goal" else 0.0
        if clearance < required - TOLERANCE:
            obstacle = problem.all_obstacles.name_of(row)
            what = (
                f"overlaps {in_words(obstacle)} by {-clearance:.4f} m"
                if clearance < 0.0
                else f"is {clearance:.4f} m from {in_words(obstacle)}, required {required:.4f} m"
            )
            # The robot does not overlap its own station, and may touch it: then the number is what asks for too much.
            if obstacle == "dock" and name == "goal" and clearance >= 0.0:
                what += _way_out(problem.clearance)
            raise occupied(f"the footprint at the {name} {what}", where={"obstacle": obstacle, "clearance": clearance})


def _way_out(rule: ClearanceRule) -> str:
    """How to write a clearance that lets the robot touch its station."""
    parts = {"required": rule.required, "at_dock": 0.0}
    if rule.taper != ClearanceRule().taper:
        parts["taper"] = rule.taper
    in_file = ", ".join(f"{key}: {value:g}" for key, value in parts.items())
    in_python = ", ".join(f"{key}={value!r}" for key, value in parts.items())
    return f"; clearance holds at the dock too; give {{{in_file}}} (in Python: ClearanceRule({in_python}))"


def _reserve(budget: float) -> float:
    """Seconds kept back from the smoother for timing the path and proving the motion."""
    return min(max(_RESERVED_SHARE * budget, _RESERVED_LEAST), _RESERVED_MOST)


def _in_ms(seconds: float) -> str:
    return f"{1e3 * seconds:.0f} ms" if seconds >= 0.1 else f"{1e3 * seconds:.3g} ms"


def _returned(value: object, kind: type[_T], plugin: Plugin, part: str = "") -> _T:
    """What a plugin returned, or a part of it, of the type that its interface promises.

    Raises:
        PluginError: It is of another type.
    """
    if not isinstance(value, kind):
        promised = f"{type(plugin).__name__} must return a {kind.__name__}{part and ' as '}{part}"
        raise PluginError(f"{promised}, got {type(value).__name__}")
    return value


def _plain(path: Path, plugin: Plugin, frame: str) -> Path:
    """The path, of no subclass: one could have other poses than the segments that are proven.

    Raises:
        PluginError: It stands in another frame than the problem.
    """
    try:
        return (path if type(path) is Path else Path(path.segments, path.frame)).with_frame(frame)
    except InvalidPath as error:
        raise PluginError(f"{type(plugin).__name__} returned a {error}") from error
