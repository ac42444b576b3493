"""Refinement."""

from __future__ import annotations

import contextlib
import itertools
import logging
import math
import time
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

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
from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.pose import Pose2
from optdock.model.path import Path
from optdock.model.segments import ClothoidSegment, PolylineSegment, TurnSegment
from optdock.model.trajectory import Trajectory
from optdock.planning.plan import DockPlan, PartialPlan
from optdock.plugins.interfaces import (
    LifecycleState,
    PluginContext,
    Smoother,
    SmoothingReport,
    SmoothingResult,
    TimeParameterizer,
    TimingReport,
    TimingResult,
    TimingStatus,
)
from optdock.plugins.registry import create_plugin
from optdock.verification import (
    certify_motion,
    certify_path,
    end_clearances,
    pose_clearances,
    prove_motion,
    where_broken,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from optdock.deadline import Deadline
    from optdock.geometry.arrays import FloatArray
    from optdock.model.problem import DockingProblem
    from optdock.model.segments import Segment
    from optdock.plugins.lifecycle import Plugin
    from optdock.verification import Certificate, ProvenMotion, TrajectoryCertificate

__all__ = [
    "Cancellation",
    "Refinement",
    "Stopwatch",
    "at_work",
    "begun_straight",
    "fewer_cusps",
    "plain",
    "ran_out_of_time",
    "returned",
    "stopping_at_bends",
    "straight_along_contact",
]

logger = logging.getLogger(__name__)

PLAIN_TIMING = "Windowed"  # needs no repair
# Share of the budget, its least and most [s], kept back from the smoother for timing the path and proving the motion.
_RESERVED_SHARE, _RESERVED_LEAST, _RESERVED_MOST = 0.3, 0.004, 0.03
# A robot that has no more clearance touches; spacing of the looks at it on the way; what is still straight [m, m, rad].
_CONTACT, _CONTACT_SPACING, _STRAIGHT = 1e-3, 0.02, 1e-6
# The steps of a sampled arc have the same curvature but for rounding [1/m]. A path with more bends than this within its
# gears is a curve, or would stop too often to be of use.
_SAME_BEND, _MOST_BENDS = 1e-5, 12
_PROOF = 0.001  # [s], kept back from the time parameterizer for the proof of its motion

_T = TypeVar("_T")


class Cancellation:
    """The caller's cancel checker: what it raises is the caller's own, in whatever stage; once True it stays True."""

    def __init__(self, checker: Callable[[], bool]) -> None:
        self._checker, self._said_yes = checker, False
        self.raised: BaseException | None = None

    def __call__(self) -> bool:
        """Whether the caller asked to stop."""
        try:
            self._said_yes = self._said_yes or bool(self._checker())
            return self._said_yes
        except BaseException as error:
            self.raised = error
            raise


@dataclass
class Stopwatch:
    """What the stages of a call took.

    Attributes:
        timing_ms: Wall-clock milliseconds of every stage, over all guesses.
        longest_wait: Longest time for which the machine kept a stage waiting [s].
    """

    deadline: Deadline
    timing_ms: dict[str, float]
    longest_wait: float = 0.0

    @contextlib.contextmanager
    def timed(self, stage: str) -> Iterator[None]:
        """Count what is done within as `stage`."""
        began, worked = self.deadline.elapsed, time.thread_time()
        try:
            yield
        finally:
            took = self.deadline.elapsed - began
            self.longest_wait = max(self.longest_wait, took - (time.thread_time() - worked))
            self.timing_ms[stage] = self.timing_ms.get(stage, 0.0) + 1e3 * took


def straight_along_contact(path: Path, problem: DockingProblem) -> float:
    """How far a path leads straight on until a robot that touches something at the start is clear of it [m].

    Along a wall that it touches, a robot can only go straight. Smoothers, which search among curves, do not end up at
    just that line; so it is kept as it is.

    Args:
        path: From the start.
        problem: Where the robot stands, and among what.

    Returns:
        0 where the robot does not touch anything, moves or has its wheels turned, and where the path begins elsewhere
        or does not lead out of the contact straight on.
    """
    first, start = path.segments[0], problem.start.as_array()
    stands = problem.start_speed == 0.0 and problem.start_acceleration == 0.0 and not problem.start_curvature
    if not stands or isinstance(first, TurnSegment) or end_clearances(problem).start > _CONTACT:
        return 0.0
    stations = np.arange(0.0, first.length, _CONTACT_SPACING)
    poses = path.poses_at(stations)
    along = np.array([math.cos(start[2]), math.sin(start[2])]) * stations[:, None] * int(first.direction)
    is_straight = np.abs(poses - start - np.column_stack((along, np.zeros(len(poses))))).max(axis=1) < _STRAIGHT
    if not is_straight[0]:  # a guess may begin elsewhere
        return 0.0
    poses = poses[: len(poses) if is_straight.all() else int(is_straight.argmin())]
    clearances, _ = pose_clearances(poses, problem.robot.footprint, problem.all_obstacles, 2.0 * _CONTACT)
    is_clear = clearances > _CONTACT
    return float(stations[is_clear.argmax()]) if is_clear.any() else 0.0


def begun_straight(start: Pose2, gear: int, length: float, path: Path) -> Path:
    """A path with a straight line before it, which ends where the path begins.

    Args:
        start: Where the line begins.
        gear: In which it is driven, 1 or -1.
        length: Of the line [m].
        path: Of any kind; a clothoid spline in the same gear goes on with the line.
    """
    first, segments = path.segments[0], path.segments
    knots, curvature = np.array([0.0, length]), np.zeros(2)
    if isinstance(first, ClothoidSegment) and first.spline.sign == gear:
        knots = np.concatenate((knots, length + first.spline.knots[1:]))
        curvature = np.concatenate((curvature[:1], first.spline.curvature))
        segments = segments[1:]
    return Path((ClothoidSegment(ClothoidSpline(start, knots, curvature, gear)), *segments), path.frame)


def stopping_at_bends(path: Path) -> Path | None:
    """The same way as clothoid segments of constant curvature, with a stop wherever the curvature jumps.

    A robot that stands may turn its wheels, so a sequence of arcs needs no smoothing to be driven: where room is too
    short for a transition between two curvatures, it can be the only way.

    Args:
        path: Sampled arcs and straight lines, and turns in place.

    Returns:
        None where the path is no such sequence, or a long one.
    """
    found: list[Segment] = []
    room = _MOST_BENDS
    for segment in path.segments:
        if not isinstance(segment, PolylineSegment):
            found.append(segment)
            continue
        curvature = segment.step_curvature
        bends = np.flatnonzero(~(np.abs(np.diff(curvature)) <= _SAME_BEND)) + 1
        room -= bends.size
        if room < 0:
            return None
        for begin, end in itertools.pairwise((0, *bends.tolist(), curvature.size)):
            length = segment.knots[end] - segment.knots[begin]
            bend = (segment.poses[end, 2] - segment.poses[begin, 2]) / length
            pose, gear = Pose2.from_sequence(segment.poses[begin]), int(segment.direction)
            spline = ClothoidSpline(pose, np.array([0.0, length]), np.array([bend, bend]), gear)
            found.append(ClothoidSegment(spline))
    return Path(tuple(found), path.frame)


@dataclass(eq=False)
class Refinement:
    """What one call of `plan_dock` does with every guess.

    Args:
        problem: What must hold.
        smoother: Makes a guess drivable.
        timing: Gives it its time law.
        warm_start: An earlier path for a problem much like this one, or None.
        cancelled: The caller's wish.
        budget: Of the whole call [s], for messages and shares.
        deadline: When it ends.
        watch: Counts what the stages take.
    """

    problem: DockingProblem
    smoother: Smoother
    timing: TimeParameterizer
    warm_start: Path | None
    cancelled: Cancellation
    budget: float
    deadline: Deadline
    watch: Stopwatch
    reserve: float = field(init=False)

    def __post_init__(self) -> None:
        self.reserve = min(max(_RESERVED_SHARE * self.budget, _RESERVED_LEAST), _RESERVED_MOST)

    def refined(
        self, raw: Path, so_far: PartialPlan, most: float, *, is_given: bool = False, begun: Path | None = None
    ) -> DockPlan:
        """The certified plan near a guess; `so_far` holds what exists of it when a stage raises.

        Args:
            raw: The guess.
            so_far: Filled in on the way.
            most: Seconds that smoothing may take.
            is_given: Whether the guess is the caller's, so that a wrong one is not a plugin's fault.
            begun: How far the smoother came with it before it was cut short.

        Raises:
            OptdockError: As `plan_dock`, but for what planners raise. Where the smoother was cut short `partial` holds
                how far it came, if it says so.
        """
        so_far.raw_path = raw
        with self.watch.timed("smooth"):
            kept = straight_along_contact(raw, self.problem)
            result = self._smoothed(raw, kept, most, so_far, begun, is_given=is_given)
            path = plain(result.path, self.smoother, self.problem.frame)
            if kept > 0.0:
                path = begun_straight(self.problem.start, int(raw.segments[0].direction), kept, path)
        plan = self.proven(raw, path, so_far)
        return replace(plan, completed=result.completed, smoothing_report=result.report)

    def proven(self, raw: Path, path: Path, so_far: PartialPlan, is_late: Callable[[], bool] | None = None) -> DockPlan:
        """The certified plan along a path that needs no smoothing; `so_far` as of `refined`.

        Args:
            raw: What the path was made of.
            path: In the problem's frame.
            so_far: Filled in on the way.
            is_late: Asked within the certificate of the path; `asked_to_stop` by default.

        Raises:
            OptdockError: As `refined`.
        """
        so_far.raw_path, so_far.path = raw, path
        with self.watch.timed("certify"):
            certificate = so_far.certificate = certify_path(path, self.problem, is_late=is_late or self.asked_to_stop)
            self._require(certificate, "smoothed path", SmootherCancelled, SmootherTimedOut)
        motion, report = self._certified_motion(path)
        return DockPlan(motion, raw, timing_report=report)

    def asked_to_stop(self) -> bool:
        """Whether the caller asked to stop, or the time is over."""
        return self.cancelled() or self.deadline.passed()

    def _smoothed(
        self, raw: Path, kept: float, most: float, so_far: PartialPlan, begun: Path | None, *, is_given: bool
    ) -> SmoothingResult:
        """What the smoother makes of a guess, but for the straight line at its begin that is `kept` [m]."""
        smoother, left, problem, earlier = self.smoother, self.deadline.left, self.problem, self.warm_start
        if left <= self.reserve:
            raise SmootherTimedOut(ran_out_of_time("smoothing", self.budget))
        if kept > 0.0:
            gear = int(raw.segments[0].direction)
            problem = problem.starting_at(problem.start @ Pose2(gear * kept, 0.0, 0.0), curvature=0.0)
            raw, earlier = raw.piece(kept), None
        try:
            with at_work(smoother, self.problem, self.cancelled):
                try:
                    result = smoother.smooth(
                        raw,
                        min(left - self.reserve, most),
                        problem=problem,
                        warm_start=earlier if begun is None else begun,
                        cancel_checker=self.cancelled,
                    )
                except InvalidPath as error:
                    if is_given:
                        raise FailedToSmoothPath(f"the given {error}") from error
                    raise
        except SmootherTimedOut as error:
            message = ran_out_of_time(type(smoother).__name__, self.budget)
            late = SmootherTimedOut(message, where=error.where)
            late.partial = error.partial
            raise late from error
        except SmootherException as error:
            so_far.path = PartialPlan.left_by(error).path
            raise
        returned(result, SmoothingResult, smoother)
        returned(result.path, Path, smoother, "the path of its result")
        returned(result.report, SmoothingReport, smoother, "the report of its result")
        return result

    def _certified_motion(self, path: Path) -> tuple[ProvenMotion, TimingReport]:
        """The motion of the chosen method, or where that fails its proof, of the method that never needs repair.

        That the path cannot be timed is an answer; any other error of the method is its own mistake.
        """
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
        with self.watch.timed("time"):
            result = self._timing(method, path)
        if result.status is TimingStatus.TIMED_OUT:
            failure = result.failure()
            message = ran_out_of_time(type(method).__name__, self.budget)
            raise TimingTimedOut(message, where=failure.where) from failure
        if result.status is not TimingStatus.OK:
            raise result.failure()
        trajectory = returned(result.trajectory, Trajectory, method, "the trajectory of its result")
        if trajectory.path is not path and trajectory.path.digest != path.digest:
            message = f"{method.name} timed another path than the certified one"
            raise CertificationFailed(message, where={"kind": "path"})
        trajectory = Trajectory(path, trajectory.time_law)
        with self.watch.timed("certify"):
            proof = certify_motion(trajectory, self.problem, is_late=self.asked_to_stop)
            self._require(proof, "trajectory", TimingCancelled, TimingTimedOut)
            return prove_motion(trajectory, self.problem, is_late=self.asked_to_stop), result.report

    def _timing(self, method: TimeParameterizer, path: Path) -> TimingResult:
        allowance = self.deadline.left - _PROOF
        if allowance <= 0.0:
            raise TimingTimedOut(ran_out_of_time("timing", self.budget))
        limits, zone = self.problem.robot.limits, self.problem.dock.approach
        speed, acceleration = self.problem.start_state(int(path.segments[0].direction))
        wait = self.problem.start_wait(path)
        waits: dict[str, Any] = {"start_wait": wait} if wait > 0.0 else {}
        with at_work(method, self.problem, self.cancelled):
            result = method.parameterize(
                path,
                limits,
                zone,
                start_speed=speed,
                start_acceleration=acceleration,
                max_time=allowance,
                cancel_checker=self.cancelled,
                **waits,
            )
        returned(result, TimingResult, method)
        returned(result.status, TimingStatus, method, "the status of its result")
        returned(result.report, TimingReport, method, "the report of its result")
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
                raise late(ran_out_of_time(f"the proof of the {what}", self.budget), where=where)
        raise CertificationFailed(f"the {what} is not certified: {verdict.reason}", where=where)


@contextlib.contextmanager
def at_work(plugin: Plugin, problem: DockingProblem, cancelled: Cancellation) -> Iterator[None]:
    """A plugin, configured for the problem; an error that its interface does not name becomes a PluginError.

    Args:
        plugin: Not configured yet.
        problem: What it is configured for.
        cancelled: What the caller's cancel checker raises goes to the caller as it is.

    Raises:
        PluginError: With what it raised as the cause.
        LifecycleError: It is configured already.
    """
    name = type(plugin).__name__
    if plugin.state is not LifecycleState.UNCONFIGURED:
        raise LifecycleError(f"{name} is {plugin.state.value}; plan_dock configures the plugins that it is given")
    try:
        plugin.configure(PluginContext(name=plugin.name, problem=problem))
        try:
            yield
        except (InvalidValue, InvalidPath) as error:  # nothing that the caller gave: the problem is valid
            raise PluginError(f"{name} failed: {type(error).__name__}: {error}") from error
        finally:
            plugin.cleanup()
    except GeneratorExit:  # the planner's next guess is not wanted
        raise
    except BaseException as error:
        if cancelled.raised is not None:
            raise cancelled.raised from None
        if isinstance(error, OptdockError) or not isinstance(error, Exception):
            raise
        raise PluginError(f"{name} failed: {type(error).__name__}: {error}") from error
    if cancelled.raised is not None:  # swallowed by the plugin
        raise cancelled.raised


def ran_out_of_time(what: str, budget: float) -> str:
    """The message of a time-out: which stage needed more, and which option gives it.

    >>> ran_out_of_time("ManoeuvrePlanner", 0.05)
    'ManoeuvrePlanner ran out of time; raise time_budget, which is 0.05 s'
    """
    return f"{what} ran out of time; raise time_budget, which is {budget:.3g} s"


def returned(value: object, kind: type[_T], plugin: Plugin, part: str = "") -> _T:
    """What a plugin returned, or a part of it, of the type that its interface promises.

    Raises:
        PluginError: It is of another type.
    """
    if not isinstance(value, kind):
        promised = f"{type(plugin).__name__} must return a {kind.__name__}{part and ' as '}{part}"
        raise PluginError(f"{promised}, got {type(value).__name__}")
    return value


def plain(path: Path, plugin: Plugin, frame: str) -> Path:
    """The path, of no subclass: one could have other poses than the segments that are proven.

    Raises:
        PluginError: It stands in another frame than the problem.
    """
    try:
        return (path if type(path) is Path else Path(path.segments, path.frame)).with_frame(frame)
    except InvalidPath as error:
        raise PluginError(f"{type(plugin).__name__} returned a {error}") from error


_SPACING = 0.02  # [m] between the poses of gears that are joined
_LONGEST = 0.5  # of the robot's length: longer gears do what shorter ones cannot


def fewer_cusps(path: Path, problem: DockingProblem) -> Iterator[Path]:
    """Guesses with one stop less each, the shortest gear left out first; turns in place stay where they are.

    Args:
        path: With cusps or without.
        problem: Whose start must be kept, and which robot drives.
    """
    segments = path.segments
    yield from _without_stops_within_gears(path)
    longest = _LONGEST * problem.robot.footprint.length
    rows = [k for k, one in enumerate(segments[:-1]) if not isinstance(one, TurnSegment) and one.length <= longest]
    for k in sorted(rows, key=lambda row: float(segments[row].length)):
        following = segments[k + 1]
        if following.direction != -segments[k].direction:
            continue
        if k == 0:
            after = _poses(following, segments[0].length, following.length)
            if problem.start_speed * following.direction >= 0.0 and len(after):
                first = np.concatenate((problem.start.as_array()[None], after))
                yield _joined(path, (), first, following, segments[2:])
        elif segments[k - 1].direction == following.direction:
            left_out, previous = segments[k].length, segments[k - 1]
            before, after = (
                _poses(previous, 0.0, previous.length - left_out),
                _poses(following, left_out, following.length),
            )
            if len(before) and len(after):
                yield _joined(path, segments[: k - 1], np.concatenate((before, after)), following, segments[k + 2 :])


def _without_stops_within_gears(path: Path) -> Iterator[Path]:
    """Two segments in the same gear as one."""
    for k, (one, following) in enumerate(itertools.pairwise(path.segments)):
        if one.direction == following.direction and not isinstance(one, TurnSegment):
            poses = np.concatenate((_poses(one, 0.0, one.length)[:-1], _poses(following, 0.0, following.length)))
            yield _joined(path, path.segments[:k], poses, following, path.segments[k + 2 :])


def _poses(segment: Segment, begin: float, end: float) -> FloatArray:
    """Poses of a segment between two arc lengths [m], none where nothing is left. Shape (n, 3)."""
    if end <= begin:
        return np.zeros((0, 3))
    return segment.poses_at(np.linspace(begin, end, 2 + int((end - begin) / _SPACING)))


def _joined(
    path: Path,
    before: tuple[Segment, ...],
    poses: FloatArray,
    gear: Segment,
    after: tuple[Segment, ...],
) -> Path:
    """Segments, a polyline in the direction of another one, and segments; headings go on without a whole turn."""
    poses = np.column_stack((poses[:, :2], np.unwrap(poses[:, 2])))
    return Path((*before, PolylineSegment(poses, gear.direction), *after), path.frame)
