"""Refinement of a guess to a plan by smoothing, certification, timing and a proof of the motion."""

from __future__ import annotations

import collections
import logging
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, TypeVar

from optdock.deadline import Stopwatch, clock_name
from optdock.errors import (
    Cancelled,
    CertificationFailed,
    FailedToSmoothPath,
    FailedToTimePath,
    InvalidPath,
    InvalidValue,
    LifecycleError,
    OptdockError,
    PluginError,
    SmootherCancelled,
    SmootherException,
    SmootherTimedOut,
    TimingCancelled,
    TimingTimedOut,
)
from optdock.geometry.pose import Pose2
from optdock.model.path import Path
from optdock.model.trajectory import Trajectory
from optdock.planning.deformation import Push, deformed, push_off, pushes_off
from optdock.planning.guess_edits import begun_straight, straight_along_contact
from optdock.planning.plan import DockPlan, PartialPlan
from optdock.plugins.interfaces import (
    LifecycleState,
    PluginContext,
    SampledBound,
    Smoother,
    SmoothingReport,
    SmoothingResult,
    TimeParameterizer,
    TimingReport,
    TimingResult,
    TimingStatus,
    never_cancelled,
)
from optdock.plugins.registry import create_plugin
from optdock.verification import (
    certify_motion,
    certify_path,
    prove_motion,
    where_broken,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from optdock.deadline import Deadline
    from optdock.model.problem import DockingProblem
    from optdock.plugins.lifecycle import Plugin
    from optdock.verification import Certificate, ProvenMotion, TrajectoryCertificate

__all__ = [
    "AtWork",
    "Cancellation",
    "Refinement",
    "plain",
    "ran_out_of_time",
    "returned",
    "sampled_bounds",
]

logger = logging.getLogger(__name__)

PLAIN_TIMING = "Windowed"  # its motions need no repair
# Time reserved for timing the path and proving the motion: least and largest share of the budget, the limits of the
# latter [s], and the time [s] on the benchmark machine: once, per gear and per metre.
_RESERVED_LEAST, _RESERVED_SHARE, _RESERVED_RANGE, _PREDICTED = 0.15, 0.3, (0.004, 0.03), (5e-4, 1e-3, 7e-5)
_COUNTED_PACE = 1.2  # counted time, relative to that of the benchmark machine; 0.5 to 0.7 in most easy plans
_PROOF = 0.0003  # [s], reserved for the proof of the motion, most of which is made with the timing

_T = TypeVar("_T")

# Durations of the last timings relative to the benchmark machine, for each time parameterizer. Measured times follow
# the speed of the machine, which other processes change.
_PACES: dict[type[TimeParameterizer], collections.deque[float]] = {}
_REMEMBERED = 9  # durations, of which the third longest is expected
_UNFINISHED = 1.5  # factor on the duration of a timing that ran out of time
_HOPELESS = 0.5  # of the expected duration: in less time no timing is begun, because its steps would end late


def _predicted(gears: int, length: float) -> float:
    once, per_gear, per_metre = _PREDICTED
    return once + per_gear * gears + per_metre * length


class Cancellation:
    """The caller's cancel checker: its exceptions pass through every stage, and a result of True is remembered."""

    def __init__(self, checker: Callable[[], bool]) -> None:
        self._checker, self._cancelled = checker, False
        self.raised: BaseException | None = None
        # What plugins poll: a caller who never cancels is not asked.
        self.checker: Callable[[], bool] = never_cancelled if checker is never_cancelled else self

    def __call__(self) -> bool:
        """Whether the caller cancelled."""
        if self._checker is never_cancelled:
            return False
        try:
            self._cancelled = self._cancelled or bool(self._checker())
            return self._cancelled
        except BaseException as error:
            self.raised = error
            raise


@dataclass(eq=False)
class Refinement:
    """The stages that one call of `plan_dock` applies to every guess.

    Args:
        problem: The planning problem.
        smoother: Plugin that makes a guess drivable.
        timing: Plugin that computes the time law.
        warm_start: Earlier path of a similar problem, or None.
        cancelled: The caller's cancel checker.
        budget: Time budget of the call, for messages and shares [s].
        deadline: Deadline of the call.
        timing_ms: Wall-clock milliseconds per stage, over all guesses; updated.
        longest_wait: Longest time for which the operating system suspended a stage [s].
    """

    problem: DockingProblem
    smoother: Smoother
    timing: TimeParameterizer
    warm_start: Path | None
    cancelled: Cancellation
    budget: float
    deadline: Deadline
    timing_ms: dict[str, float]
    longest_wait: float = 0.0

    def __post_init__(self) -> None:
        self._most = min(max(_RESERVED_SHARE * self.budget, _RESERVED_RANGE[0]), _RESERVED_RANGE[1])
        self._least = min(_RESERVED_LEAST * self.budget, _RESERVED_RANGE[1])
        self._pace = self._expected_pace()
        self.reserve = self.reserved(1, 0.0)

    def reserved(self, gears: int, length: float) -> float:
        """Return the time [s] reserved for timing a path of this many gears and this length [m], and for the proof."""
        return max(self._least, min(self._pace * _predicted(gears, length), self._most))

    def _expected_pace(self) -> float:
        """Return the expected pace of a timing; that of a counted clock does not depend on earlier calls."""
        if clock_name() == "counted":
            return _COUNTED_PACE
        measured = _PACES.get(type(self.timing), ())
        return sorted(measured)[3 * (len(measured) - 1) // 4] if measured else 1.0

    def timed(self, stage: str) -> StageTimer:
        """Return a context that adds its duration to the time of `stage`."""
        return StageTimer(self, stage)

    def is_late(self) -> bool:
        """Whether the remaining time is too short for another guess."""
        return self.deadline.left <= self.reserve

    def asked_to_stop(self) -> bool:
        """Whether the caller cancelled, or the time has run out."""
        return self.cancelled() or self.deadline.passed()

    def refined(
        self, raw: Path, so_far: PartialPlan, most: float, *, is_given: bool = False, begun: Path | None = None
    ) -> DockPlan:
        """Return the certified plan near a guess.

        Args:
            raw: The guess.
            so_far: Filled during the work, in case a stage raises.
            most: Longest time for smoothing [s].
            is_given: Whether the guess was given by the caller, so that an error in it is not attributed to a plugin.
            begun: Path of the smoother in an interrupted attempt.

        Raises:
            OptdockError: As `plan_dock`. If the smoother was interrupted, `partial` contains the path that it had
                found, if any.
        """
        so_far.raw_path = raw
        with self.timed("smooth"):
            kept = straight_along_contact(raw, self.problem)
            result = self._smoothed(raw, kept, most, so_far, begun, is_given=is_given)
            path = plain(result.path, self.smoother, self.problem.frame)
            if kept > 0.0:
                path = begun_straight(self.problem.start, int(raw.segments[0].direction), kept, path)
        return self.proven(raw, path, so_far, smoothed=result)

    def deformed(  # noqa: PLR0913 - as `deformation.deformed`
        self,
        path: Path,
        most_pushes: int,
        *,
        steers: bool = True,
        speed: float = 0.0,
        least: float = 0.0,
        pushes: Sequence[Push] = (),
        shortens: bool = False,
    ) -> tuple[Path, Certificate | None]:
        """Deform the rest of a path to the start of the problem, and push it off obstacles that are too close.

        Args:
            path: The rest of a path, of clothoids and turns in place.
            most_pushes: Largest number of pushes, of two milliseconds each.
            steers: As in `deformation.deformed`.
            speed: As in `deformation.deformed` [m/s].
            least: As in `deformation.deformed` [m].
            pushes: As in `deformation.deformed`, from the beginning.
            shortens: As in `deformation.deformed`, before the first push.

        Returns:
            The last deformed path with its certificate; `path` itself and None if it cannot be deformed.
        """
        problem, pushes, longest = self.problem, list(pushes), 0.0
        certificate: Certificate | None = None
        for _ in range(most_pushes + 1):
            if self.deadline.left < longest:  # a smoothing afterwards would not end in time
                break
            began = self.deadline.elapsed
            with self.timed("deform"):
                moved = deformed(
                    path,
                    problem.start,
                    problem.goal,
                    problem.robot.limits,
                    final_straight=problem.dock.final_straight,
                    steers=steers,
                    speed=speed,
                    least=least,
                    pushes=pushes,
                    shortens=shortens and not pushes,
                )
            if moved is None or self.asked_to_stop():
                break
            path, more = moved, pushes_off(moved, problem) if pushes else []
            if not more:
                with self.timed("certify"):
                    certificate = certify_path(path, problem, is_late=self.asked_to_stop)
                if any(violation.kind != "clearance" for violation in certificate.violations) or certificate.certified:
                    break
                more = (not pushes and pushes_off(path, problem)) or [
                    push_off(certificate.violations[0], path, problem)
                ]
            pushes += more
            longest = max(longest, self.deadline.elapsed - began)
        return path, certificate

    def proven(
        self,
        raw: Path,
        path: Path,
        so_far: PartialPlan,
        is_late: Callable[[], bool] | None = None,
        smoothed: SmoothingResult | None = None,
    ) -> DockPlan:
        """Return the certified plan along a path that needs no more smoothing; other arguments are as in `refined`.

        Every path must satisfy the smoother's own bounds at samples, whether the smoother made it or not.

        `is_late` is polled during the certificate of the path; `asked_to_stop` by default. `smoothed`: result of the
        smoother, or None for a path from another source.

        Raises:
            OptdockError: As `refined`.
        """
        so_far.raw_path, so_far.path = raw, path
        with self.timed("certify"):
            certificate = so_far.certificate = certify_path(path, self.problem, is_late=is_late or self.asked_to_stop)
            self._require(certificate, "smoothed path", SmootherCancelled, SmootherTimedOut)
            sampled = sampled_bounds(self.smoother, path, self.problem, self.cancelled)
            broken = next((bound for bound in sampled if not bound.holds), None)
            if broken is not None:
                raise broken.failure(path)
        motion, report = self._certified_motion(path)
        done, completed = (SmoothingReport(), True) if smoothed is None else (smoothed.report, smoothed.completed)
        done = done if done.sampled == sampled else replace(done, sampled=sampled)
        return DockPlan(motion, raw, completed, smoothing_report=done, timing_report=report)

    def _smoothed(
        self, raw: Path, kept: float, most: float, so_far: PartialPlan, begun: Path | None, *, is_given: bool
    ) -> SmoothingResult:
        """Smooth a guess without the straight line of length `kept` [m] at its beginning."""
        smoother, left, problem, earlier = self.smoother, self.deadline.left, self.problem, self.warm_start
        reserve = self.reserved(len(raw.segments), raw.length)
        if left <= reserve:
            raise SmootherTimedOut(ran_out_of_time("smoothing", self.budget))
        if kept > 0.0:
            gear = int(raw.segments[0].direction)
            problem = problem.starting_at(problem.start @ Pose2(gear * kept, 0.0, 0.0), curvature=0.0)
            raw, earlier = raw.piece(kept), None
        try:
            with AtWork(smoother, self.problem, self.cancelled):
                try:
                    result = smoother.smooth(
                        raw,
                        min(left - reserve, most),
                        problem=problem,
                        warm_start=earlier if begun is None else begun,
                        cancel_checker=self.cancelled.checker,
                    )
                except InvalidPath as error:
                    if is_given:
                        raise FailedToSmoothPath(f"the given {error}") from error
                    raise
        except SmootherTimedOut as error:
            late = SmootherTimedOut(ran_out_of_time(type(smoother).__name__, self.budget), where=error.where)
            late.partial = error.partial
            raise late from error
        except SmootherException as error:
            so_far.path = PartialPlan.left_by(error).path
            if kept > 0.0:  # the start for the smoother is the end of the line, where other paths need not begin
                error.where["every_path"] = False
                error.args = (f"{error} (after a straight line of {kept:.3f} m out of contact)", *error.args[1:])
            raise
        returned(result, SmoothingResult, smoother)
        returned(result.path, Path, smoother, "the path of its result")
        returned(result.report, SmoothingReport, smoother, "the report of its result")
        return result

    def _certified_motion(self, path: Path) -> tuple[ProvenMotion, TimingReport]:
        """Return the motion by the chosen method, or by the fallback after any error except `FailedToTimePath`."""
        chosen = self.timing
        try:
            return self._proven_motion(chosen, path)
        except (FailedToTimePath, Cancelled, LifecycleError):
            raise
        except OptdockError as error:
            fallback = create_plugin(TimeParameterizer, PLAIN_TIMING)
            if type(chosen) is type(fallback):
                raise
            logger.warning("%s: %s; timed by %s instead", chosen.name, error, PLAIN_TIMING)
            try:
                motion, report = self._proven_motion(fallback, path)
            except FailedToTimePath:
                raise error from None
            return motion, replace(report, replaced=f"{chosen.name}: {error}")

    def _proven_motion(self, method: TimeParameterizer, path: Path) -> tuple[ProvenMotion, TimingReport]:
        with self.timed("time"):
            result = self._timing(method, path)
        if result.status is TimingStatus.TIMED_OUT:
            failure = result.failure()
            raise TimingTimedOut(ran_out_of_time(type(method).__name__, self.budget), where=failure.where) from failure
        if result.status is not TimingStatus.OK:
            raise result.failure()
        trajectory = returned(result.trajectory, Trajectory, method, "the trajectory of its result")
        if trajectory.path is not path and trajectory.path.digest != path.digest:
            raise CertificationFailed(
                f"{method.name} timed another path than the certified one", where={"kind": "path"}
            )
        trajectory = Trajectory(path, trajectory.time_law)
        with self.timed("certify"):
            try:
                return prove_motion(trajectory, self.problem, is_late=self.asked_to_stop), result.report
            except CertificationFailed:
                proof = certify_motion(trajectory, self.problem, is_late=self.asked_to_stop)
                self._require(proof, "trajectory", TimingCancelled, TimingTimedOut)
                raise

    def _timing(self, method: TimeParameterizer, path: Path) -> TimingResult:
        allowance = self.deadline.left - _PROOF
        predicted = _predicted(len(path.segments), path.length)
        if allowance <= _HOPELESS * min(self._pace * predicted, self._most):
            raise TimingTimedOut(ran_out_of_time("timing", self.budget))
        limits, zone = self.problem.robot.limits, self.problem.dock.approach
        speed, acceleration = self.problem.start_state(int(path.segments[0].direction))
        wait = self.problem.start_wait(path)
        waits: dict[str, Any] = {"start_wait": wait} if wait > 0.0 else {}
        watch = Stopwatch(self.deadline)
        with AtWork(method, self.problem, self.cancelled):
            result = method.parameterize(
                path,
                limits,
                zone,
                start_speed=speed,
                start_acceleration=acceleration,
                max_time=allowance,
                cancel_checker=self.cancelled.checker,
                **waits,
            )
        returned(result, TimingResult, method)
        returned(result.status, TimingStatus, method, "the status of its result")
        pace = watch.read()[1] / predicted
        pace *= _UNFINISHED if result.status is TimingStatus.TIMED_OUT else 1.0
        _PACES.setdefault(type(method), collections.deque(maxlen=_REMEMBERED)).append(pace)
        self._pace = self._expected_pace()
        returned(result.report, TimingReport, method, "the report of its result")
        return result

    def _require(
        self,
        verdict: Certificate | TrajectoryCertificate,
        what: str,
        cancelled: type[Cancelled],
        late: type[OptdockError],
    ) -> None:
        """Raise the violation of a certificate, or the time-out or cancellation that interrupted the proof."""
        if verdict.certified:
            return
        where = where_broken(verdict)
        if all(violation.kind == "unproven" for violation in verdict.violations):
            if self.cancelled():
                raise cancelled(f"cancelled while the {what} was proven", where=where)
            if self.deadline.passed():
                raise late(ran_out_of_time(f"the proof of the {what}", self.budget), where=where)
        raise CertificationFailed(f"the {what} is not certified: {verdict.reason}", where=where)


class StageTimer:
    """Context that adds its duration to the time of a stage; see `Refinement.timed`."""

    __slots__ = ("_stage", "_watch", "_work")

    def __init__(self, work: Refinement, stage: str) -> None:
        self._work, self._stage = work, stage

    def __enter__(self) -> None:
        self._watch = Stopwatch(self._work.deadline)

    def __exit__(self, *_: object) -> None:
        work, (took, worked) = self._work, self._watch.read()
        work.longest_wait = max(work.longest_wait, took - worked)
        work.timing_ms[self._stage] = work.timing_ms.get(self._stage, 0.0) + 1e3 * took


class AtWork:
    """Context that configures a plugin for a problem and converts errors that are not in the plugin's interface.

    Raises on entry and exit:
        PluginError: With the plugin's exception as cause; exceptions of the caller's cancel checker are passed on.
        LifecycleError: If the plugin is configured already.
    """

    __slots__ = ("_cancelled", "_plugin", "_problem")

    def __init__(self, plugin: Plugin, problem: DockingProblem, cancelled: Cancellation) -> None:
        self._plugin, self._problem, self._cancelled = plugin, problem, cancelled

    def __enter__(self) -> None:
        plugin, state = self._plugin, self._plugin.state
        if state is not LifecycleState.UNCONFIGURED:
            name = type(plugin).__name__
            raise LifecycleError(f"{name} is {state.value}, must be unconfigured; plan_dock configures its plugins")
        try:
            plugin.configure(PluginContext(name=plugin.name, problem=self._problem))
        except BaseException as error:
            self._replace(error)
            raise

    def __exit__(self, _kind: object, error: BaseException | None, _traceback: object) -> None:
        try:
            self._plugin.cleanup()
        except BaseException as later:
            self._replace(later)
            raise
        if error is not None:
            # The problem is valid, so that an invalid value is a fault of the plugin.
            self._replace(error, is_fault=isinstance(error, InvalidValue | InvalidPath))
        elif self._cancelled.raised is not None:  # the plugin suppressed the cancellation
            raise self._cancelled.raised

    def _replace(self, error: BaseException, *, is_fault: bool = False) -> None:
        """Raise the error that replaces `error`, if there is one."""
        if isinstance(error, GeneratorExit):  # raised when the generator of guesses is closed
            return
        if self._cancelled.raised is not None:
            raise self._cancelled.raised from None
        if isinstance(error, Exception) and (is_fault or not isinstance(error, OptdockError)):
            raise PluginError(f"{type(self._plugin).__name__} failed: {type(error).__name__}: {error}") from error


def sampled_bounds(
    smoother: Smoother, path: Path, problem: DockingProblem, cancelled: Cancellation, before: float = 0.0
) -> tuple[SampledBound, ...]:
    """Return the smoother's own bounds at samples of a path, `before` metres of driving after its start.

    Raises:
        PluginError: If the smoother fails, or returns something else.
    """
    if type(smoother).sampled_bounds is Smoother.sampled_bounds:
        return ()
    with AtWork(smoother, problem, cancelled):
        found = returned(smoother.sampled_bounds(path, before=before), tuple, smoother, "its sampled bounds")
    return tuple(returned(bound, SampledBound, smoother, "a sampled bound") for bound in found)


def ran_out_of_time(what: str, budget: float) -> str:
    """Return the message of a time-out, which names the stage that ran out of time and the option that allows more.

    >>> ran_out_of_time("ManoeuvrePlanner", 0.05)
    'ManoeuvrePlanner ran out of time; raise time_budget, which is 0.05 s'
    """
    return f"{what} ran out of time; raise time_budget, which is {budget:.3g} s"


def returned(value: object, kind: type[_T], plugin: Plugin, part: str = "") -> _T:
    """Check that a result of a plugin, or a part of it, has the type that its interface requires, and return it.

    Raises:
        PluginError: If the value has the wrong type.
    """
    if not isinstance(value, kind):
        promised = f"{type(plugin).__name__} must return a {kind.__name__}{part and ' as '}{part}"
        raise PluginError(f"{promised}, got {type(value).__name__}")
    return value


def plain(path: Path, plugin: Plugin, frame: str) -> Path:
    """Return the path as an exact `Path`, because a subclass could have other poses than the certified segments.

    Raises:
        PluginError: If the path is not in the frame of the problem.
    """
    try:
        return (path if type(path) is Path else Path(path.segments, path.frame)).with_frame(frame)
    except InvalidPath as error:
        raise PluginError(f"{type(plugin).__name__} returned a {error}") from error
