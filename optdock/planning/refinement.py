"""Refinement of a guess to a plan by smoothing, certification, timing and a proof of the motion; edits of guesses.

The edits preserve a straight line out of a contact, insert a stop at every bend, and leave out short gears.
"""

from __future__ import annotations

import contextlib
import itertools
import logging
import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from optdock.deadline import Stopwatch
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
from optdock.planning.deformation import Push, deformed, push_off
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
)
from optdock.plugins.registry import create_plugin
from optdock.verification import (
    certify_motion,
    certify_path,
    compiled_clearances,
    end_clearances,
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
    "FEWER_CUSPS",
    "Cancellation",
    "Refinement",
    "at_work",
    "begun_straight",
    "fewer_cusps",
    "plain",
    "ran_out_of_time",
    "returned",
    "sampled_bounds",
    "stopping_at_bends",
    "straight_along_contact",
]

logger = logging.getLogger(__name__)

PLAIN_TIMING = "Windowed"  # its motions need no repair
FEWER_CUSPS = "fewer cusps"  # stage of the guesses of `fewer_cusps`
# Share of the budget, its least and most [s], reserved for timing the path and proving the motion.
_RESERVED_SHARE, _RESERVED_LEAST, _RESERVED_MOST = 0.3, 0.004, 0.03
# Clearance below which the robot touches an obstacle [m]; spacing of the samples along a path [m]; heading tolerance of
# a straight line [rad].
_CONTACT, _CONTACT_SPACING, _STRAIGHT = 1e-3, 0.02, 1e-6
# Rounding of the curvature of a sampled arc [1/m]; with more bends than this within its gears a path is a curve, or
# would stop too often.
_SAME_BEND, _MOST_BENDS = 1e-5, 12
_JOINED_SPACING = 0.02  # [m] between the poses of gears that are joined
_LONGEST_LEFT_OUT = 0.5  # of the robot's length: longer gears cannot be replaced
_DETOUR = 2.0  # least ratio of the lengths of both neighbours of a detour and of the detour
# Largest gap in the heading, as a share of the largest turn of the other short gears, and gap that is always tried
# [rad]. In 36 parking slots the smoother closed gaps up to a share of 0.55, and of 22 larger ones, up to 3.4, not one.
_MADE_UP, _SMALL_GAP = 0.58, 0.05
_PROOF = 0.001  # [s], reserved for the proof of the motion

_T = TypeVar("_T")


class Cancellation:
    """The caller's cancel checker: its exceptions pass through every stage, and a result of True is remembered."""

    def __init__(self, checker: Callable[[], bool]) -> None:
        self._checker, self._cancelled = checker, False
        self.raised: BaseException | None = None

    def __call__(self) -> bool:
        """Whether the caller cancelled."""
        try:
            self._cancelled = self._cancelled or bool(self._checker())
            return self._cancelled
        except BaseException as error:
            self.raised = error
            raise


def straight_along_contact(path: Path, problem: DockingProblem) -> float:
    """Return the length [m] of the straight line on which a robot that starts in contact leaves the obstacle.

    A robot alongside a wall in contact can only drive straight. Smoothers do not reproduce this line exactly, so the
    line of the guess is kept. The length is 0 if the robot touches no obstacle, is in motion or has its wheels turned,
    or if the path begins at another pose or does not lead straight out of the contact.
    """
    first, start = path.segments[0], problem.start.as_array()
    stands = problem.start_speed == 0.0 and problem.start_acceleration == 0.0 and not problem.start_curvature
    if not stands or isinstance(first, TurnSegment) or end_clearances(problem).start > _CONTACT:
        return 0.0
    stations = np.arange(0.0, first.length, _CONTACT_SPACING)
    poses = path.poses_at(stations)
    along = np.array([math.cos(start[2]), math.sin(start[2])]) * stations[:, None] * int(first.direction)
    is_straight = np.abs(poses - start - np.column_stack((along, np.zeros(len(poses))))).max(axis=1) < _STRAIGHT
    if not is_straight[0]:
        return 0.0
    poses = poses[: len(poses) if is_straight.all() else int(is_straight.argmin())]
    clearances, _ = compiled_clearances(poses, problem.robot.footprint, problem.all_obstacles, 2.0 * _CONTACT)
    is_clear = clearances > _CONTACT
    return float(stations[is_clear.argmax()]) if is_clear.any() else 0.0


def begun_straight(start: Pose2, gear: int, length: float, path: Path) -> Path:
    """Return a path preceded by a straight line of a given length [m], from `start` to the beginning of the path.

    If the path begins with a clothoid spline in the same gear, 1 or -1, the line becomes part of the spline.
    """
    first, segments = path.segments[0], path.segments
    knots, curvature = np.array([0.0, length]), np.zeros(2)
    if isinstance(first, ClothoidSegment) and first.spline.sign == gear:
        knots = np.concatenate((knots, length + first.spline.knots[1:]))
        curvature = np.concatenate((curvature[:1], first.spline.curvature))
        segments = segments[1:]
    return Path((ClothoidSegment(ClothoidSpline(start, knots, curvature, gear)), *segments), path.frame)


def stopping_at_bends(path: Path) -> Path | None:
    """Return a path as clothoid segments of constant curvature, with a stop at every jump of the curvature.

    A robot at rest may turn its wheels, so sampled arcs, lines and turns in place can be driven without smoothing. This
    can be the only path if the room is too short for a transition between two curvatures. The result is None if the
    path is not a sequence of arcs, lines and turns in place, or has too many bends.
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
        self.reserve = min(max(_RESERVED_SHARE * self.budget, _RESERVED_LEAST), _RESERVED_MOST)

    @contextlib.contextmanager
    def timed(self, stage: str) -> Iterator[None]:
        """Add the duration of the block to the time of `stage`."""
        watch = Stopwatch(self.deadline)
        try:
            yield
        finally:
            took, worked = watch.read()
            self.longest_wait = max(self.longest_wait, took - worked)
            self.timing_ms[stage] = self.timing_ms.get(stage, 0.0) + 1e3 * took

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
        plan = self.proven(raw, path, so_far)
        report = replace(result.report, sampled=plan.smoothing_report.sampled)
        return replace(plan, completed=result.completed, smoothing_report=report)

    def deformed(
        self, path: Path, most_pushes: int, *, steers: bool = True, speed: float = 0.0
    ) -> tuple[Path, Certificate | None]:
        """Deform the rest of a path to the start of the problem, and push it off obstacles that are too close.

        Args:
            path: The rest of a path, of clothoids and turns in place.
            most_pushes: Largest number of pushes, of two milliseconds each.
            steers: As in `deformation.deformed`.
            speed: As in `deformation.deformed` [m/s].

        Returns:
            The last deformed path with its certificate; `path` itself and None if it cannot be deformed.
        """
        problem, pushes, longest = self.problem, list[Push](), 0.0
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
                    pushes=pushes,
                )
            if moved is None or self.asked_to_stop():
                break
            path = moved
            with self.timed("certify"):
                certificate = certify_path(path, problem, is_late=self.asked_to_stop)
            if any(violation.kind != "clearance" for violation in certificate.violations) or certificate.certified:
                break
            pushes.append(push_off(certificate.violations[0], path, problem))
            longest = max(longest, self.deadline.elapsed - began)
        return path, certificate

    def proven(self, raw: Path, path: Path, so_far: PartialPlan, is_late: Callable[[], bool] | None = None) -> DockPlan:
        """Return the certified plan along a path that needs no smoothing; other arguments are as in `refined`.

        Every path must satisfy the smoother's own bounds at samples, whether the smoother made it or not.

        `is_late` is polled during the certificate of the path; `asked_to_stop` by default.

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
        return DockPlan(motion, raw, smoothing_report=SmoothingReport(sampled=sampled), timing_report=report)

    def _smoothed(
        self, raw: Path, kept: float, most: float, so_far: PartialPlan, begun: Path | None, *, is_given: bool
    ) -> SmoothingResult:
        """Smooth a guess without the straight line of length `kept` [m] at its beginning."""
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
            late = SmootherTimedOut(ran_out_of_time(type(smoother).__name__, self.budget), where=error.where)
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


@contextlib.contextmanager
def at_work(plugin: Plugin, problem: DockingProblem, cancelled: Cancellation) -> Iterator[None]:
    """Configure a plugin for the problem; an error that is not in its interface is converted to a PluginError.

    Raises:
        PluginError: With the plugin's exception as cause; exceptions of the caller's cancel checker are passed on.
        LifecycleError: If the plugin is configured already.
    """
    name = type(plugin).__name__
    if plugin.state is not LifecycleState.UNCONFIGURED:
        raise LifecycleError(f"{name} is {plugin.state.value}, must be unconfigured; plan_dock configures its plugins")
    try:
        plugin.configure(PluginContext(name=plugin.name, problem=problem))
        try:
            yield
        except (InvalidValue, InvalidPath) as error:  # a fault of the plugin, because the problem is valid
            raise PluginError(f"{name} failed: {type(error).__name__}: {error}") from error
        finally:
            plugin.cleanup()
    except GeneratorExit:  # raised when the generator of guesses is closed
        raise
    except BaseException as error:
        if cancelled.raised is not None:
            raise cancelled.raised from None
        if isinstance(error, OptdockError) or not isinstance(error, Exception):
            raise
        raise PluginError(f"{name} failed: {type(error).__name__}: {error}") from error
    if cancelled.raised is not None:  # the plugin suppressed the cancellation
        raise cancelled.raised


def sampled_bounds(
    smoother: Smoother, path: Path, problem: DockingProblem, cancelled: Cancellation, before: float = 0.0
) -> tuple[SampledBound, ...]:
    """Return the smoother's own bounds at samples of a path, `before` metres of driving after its start.

    Raises:
        PluginError: If the smoother fails, or returns something else.
    """
    if type(smoother).sampled_bounds is Smoother.sampled_bounds:
        return ()
    with at_work(smoother, problem, cancelled):
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


def fewer_cusps(path: Path, problem: DockingProblem, *, only_detours: bool = False) -> Iterator[Path]:
    """Yield guesses with one fewer stop: first with two segments of one gear joined, then with one gear left out.

    Searches over arcs often return short gears that can be left out. Every stop takes time, while the smoother can
    remove a jump of the curvature. A gear between two gears in the other direction is left out together with the
    stretch that would then be driven twice, and the smoother closes the gap. The gear with the smallest change of
    heading over its gap is left out first, because the other gears must make up for this change. The first gear can be
    left out if the second gear may begin at the start. Turns in place are never left out.

    `only_detours`: whether to leave out only gears that are much shorter than both of their neighbours, and not gears
    that turn the robot in a narrow area.
    """
    segments = path.segments
    for k, (one, following) in enumerate(itertools.pairwise(() if only_detours else segments)):
        if one.direction == following.direction and not isinstance(one, TurnSegment):
            poses = np.concatenate((_poses(one, 0.0, one.length)[:-1], _poses(following, 0.0, following.length)))
            yield _joined(path, segments[:k], poses, following, segments[k + 2 :])
    gaps = [(_gap_without(path, k, problem, only_detours=only_detours), k) for k in range(len(segments) - 1)]
    for gap, k in sorted(gaps):
        if math.isfinite(gap):
            left_out, following = segments[k].length, segments[k + 1]
            before = problem.start.as_array()[None]
            if k > 0:
                before = _poses(segments[k - 1], 0.0, segments[k - 1].length - left_out)
            poses = np.concatenate((before, _poses(following, left_out, following.length)))
            yield _joined(path, segments[: max(k - 1, 0)], poses, following, segments[k + 2 :])


def _gap_without(path: Path, k: int, problem: DockingProblem, *, only_detours: bool) -> float:
    """Return the change of heading [rad] over the gap without gear `k`, inf if the gear cannot be left out."""
    one, following, left_out = path.segments[k], path.segments[k + 1], path.segments[k].length
    longest = _LONGEST_LEFT_OUT * problem.robot.footprint.length
    if isinstance(one, TurnSegment) or left_out > longest or following.direction != -one.direction:
        return math.inf
    begin, shorter = problem.start.yaw, following.length
    if k > 0:
        previous = path.segments[k - 1]
        shorter = min(shorter, previous.length) if previous.direction == following.direction else 0.0
        begin = float(previous.poses_at(np.array([previous.length - left_out]))[0, 2]) if shorter > left_out else 0.0
    elif problem.start_speed * following.direction < 0.0:
        return math.inf
    is_detour = k > 0 and shorter > max(_DETOUR * left_out, 0.5 * longest)
    if shorter <= left_out or (only_detours and not is_detour):
        return math.inf
    end = float(following.poses_at(np.array([left_out]))[0, 2])
    gap = abs(math.remainder(end - begin, 2.0 * math.pi))
    lengths = [other.length for other in path.segments]
    joined = sum(lengths[max(k - 1, 0) : k + 2]) - (3.0 if k > 0 else 2.0) * left_out
    others = (*lengths[: max(k - 1, 0)], joined, *lengths[k + 2 :])
    most = problem.robot.limits.max_curvature * sum(length for length in others if length <= longest)
    is_too_far = gap > max(_MADE_UP * most, _SMALL_GAP)
    return math.inf if is_too_far and not is_detour else gap


def _poses(segment: Segment, begin: float, end: float) -> FloatArray:
    """Return poses of a segment between two arc lengths [m], empty for an empty interval. Shape (n, 3)."""
    if end <= begin:
        return np.zeros((0, 3))
    return segment.poses_at(np.linspace(begin, end, 2 + int((end - begin) / _JOINED_SPACING)))


def _joined(
    path: Path, before: tuple[Segment, ...], poses: FloatArray, gear: Segment, after: tuple[Segment, ...]
) -> Path:
    """Return the path of `before`, a polyline through `poses` in the direction of `gear`, and `after`."""
    poses = np.column_stack((poses[:, :2], np.unwrap(poses[:, 2])))
    return Path((*before, PolylineSegment(poses, gear.direction), *after), path.frame)
