"""Contracts of planners, smoothers and time parameterizers."""

from __future__ import annotations

import dataclasses
import math
from functools import partial
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from optdock.errors import (
    InvalidValue,
    PlannerCancelled,
    PlannerException,
    SmootherCancelled,
    SmootherException,
    SmootherTimedOut,
    TimingCancelled,
)
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import Pose2
from optdock.model.limits import LIMITS, LimitKind, MotionLimits, SpeedZone
from optdock.model.path import Path
from optdock.plugins.interfaces import (
    GlobalPlanner,
    PluginContext,
    Smoother,
    SmoothingReport,
    SmoothingResult,
    TimeParameterizer,
    TimingResult,
    TimingStatus,
)
from optdock.testing.contracts.contract_scene import (
    GOAL,
    ORIGIN,
    bent_path,
    cusp_path,
    moved_path,
    post_inside_the_bend,
    raw_path,
    scene_context,
    scene_problem,
)
from optdock.testing.contracts.plugin import (
    PluginContract,
    attempted,
    refused,
    require,
    require_cancellable,
    require_same_ends,
    sampled,
)
from optdock.testing.drives import clothoid, cusp_drive, s_curve_drive, straight_drive
from optdock.verification import certify_path, certify_trajectory, pose_clearances

if TYPE_CHECKING:
    from collections.abc import Iterator

    from optdock.model.problem import DockingProblem
    from optdock.model.trajectory import Trajectory

__all__ = ["GlobalPlannerContract", "SmootherContract", "TimeParameterizerContract"]

_MOTION = Pose2(1.3, -0.7, 2.5)
_AMPLE = 20.0  # [s]
_SHORT = 0.05  # [m]
_TURNING = 0.3  # [m/s], [rad/s], ...: value of every limit that depends on curvature; each limit is active somewhere


class GlobalPlannerContract(PluginContract[GlobalPlanner]):
    """Rules of `optdock.plugins.interfaces.GlobalPlanner`.

    Attributes:
        is_equivariant: Whether the path moves with the start and the goal; False for planners on a grid.
    """

    interface: ClassVar[type[GlobalPlanner]] = GlobalPlanner
    is_equivariant: ClassVar[bool] = True

    def queries(self) -> tuple[tuple[Pose2, Pose2], ...]:
        """Return pairs of start and goal for which the planner must find a path."""
        return ((ORIGIN, GOAL), (Pose2(0.2, -0.8, 0.3), GOAL), (Pose2(-0.5, 1.2, -0.2), Pose2(2.8, 0.0, 0.1)))

    def exercise(self, plugin: GlobalPlanner) -> object:
        """Return the poses of the path of the first query."""
        return sampled(plugin.create_plan(*self.queries()[0]))

    def test_the_path_leads_from_start_to_goal_in_their_frame(self) -> None:
        """`create_plan`: the path has a positive length and leads from `start` to `goal` in the problem's frame."""
        planner = self.make_plugin()
        planner.configure(scene_context(dataclasses.replace(scene_problem(), frame="contract frame")))
        for start, goal in self.queries():
            path = planner.create_plan(start, goal)
            require(
                isinstance(path, Path) and path.length > 0.0, f"the result is a Path of positive length, got {path!r}"
            )
            require_same_ends(path, start, goal)
            require(path.frame in ("", "contract frame"), f"the frame is the frame of the problem, got {path.frame!r}")

    def test_a_motion_of_the_task_moves_the_path(self) -> None:
        """`create_plan`: the path moves with its ends, see `is_equivariant`; full turns of a yaw have no effect."""
        planner, turn = self.ready_plugin(), 2.0 * math.pi
        for start, goal in self.queries():
            path = planner.create_plan(start, goal)
            turned = planner.create_plan(Pose2(start.x, start.y, start.yaw + turn), goal @ Pose2(0.0, 0.0, -turn))
            _require_close(turned, path, ORIGIN)
            if self.is_equivariant:
                _require_close(planner.create_plan(_MOTION @ start, _MOTION @ goal), path, _MOTION)

    def test_it_stops_when_cancelled_and_plans_again(self) -> None:
        """`create_plan`: `cancel_checker` is polled, and PlannerCancelled is raised if it returned True."""
        planner = self.ready_plugin()
        start, goal = self.queries()[0]
        before = self.exercise(planner)
        require_cancellable(lambda cancelled: planner.create_plan(start, goal, cancelled), PlannerCancelled)
        require(self.exercise(planner) == before, "after a cancellation, the planner plans as before")

    def test_it_fails_by_name(self) -> None:
        """`create_plan`: if no path is found, a PlannerException with a reason is raised, and no other exception."""
        planner, draw = self.ready_plugin(), np.random.default_rng(3)
        odd = [(GOAL, GOAL), (GOAL @ Pose2(1e-9, 0.0, 0.0), GOAL), (Pose2(1e6, -1e6, 9.0), GOAL)]
        odd += [(GOAL @ Pose2(*draw.normal(size=3)), GOAL) for _ in range(12)]
        for start, goal in odd:
            path = attempted(partial(planner.create_plan, start, goal), PlannerException)
            if path is not None:
                require_same_ends(path, start, goal)


class SmootherContract(PluginContract[Smoother]):
    """Rules of `optdock.plugins.interfaces.Smoother`."""

    interface: ClassVar[type[Smoother]] = Smoother

    def tasks(self) -> tuple[tuple[Path, DockingProblem | None], ...]:
        """Return paths with their problems; None: the configured problem."""
        return ((raw_path(), scene_problem()), (raw_path(), None), (cusp_path(), None))

    def exercise(self, plugin: Smoother) -> object:
        """Return the result of the first task, with ample time."""
        path, problem = self.tasks()[0]
        result = plugin.smooth(path, _AMPLE, problem=problem)
        return result.completed, sampled(result.path)

    def test_the_result_replaces_the_input(self) -> None:
        """`smooth`: the SmoothingResult has the same ends, gears and frame; the input path is not changed."""
        smoother = self.ready_plugin()
        for given, problem in self.tasks():
            path = given.with_frame(scene_problem().frame)
            segments, before = path.segments, sampled(path)
            result = smoother.smooth(path, _AMPLE, problem=problem)
            require(path.segments is segments and sampled(path) == before, "the input path is not changed")
            require(
                isinstance(result, SmoothingResult), f"smooth returns a SmoothingResult, got {type(result).__name__}"
            )
            require(isinstance(result.completed, bool), f"completed is a bool, got {result.completed!r}")
            require(
                isinstance(result.report, SmoothingReport), f"the report is a SmoothingReport, got {result.report!r}"
            )
            found = result.path
            require_same_ends(found, path.start, path.end)
            require(found.frame in ("", path.frame), f"the frame remains {path.frame!r}, got {found.frame!r}")
            wanted, gears = ([segment.direction for segment in one.segments] for one in (path, found))
            require(gears == wanted, f"the gears remain {wanted}, got {gears}")

    def test_obstacles_that_the_path_clears_stay_clear(self) -> None:
        """`smooth`: the result touches no obstacle of problem or context, or the path is refused with a reason."""
        path, with_post = bent_path(), scene_problem(obstacles=post_inside_the_bend())
        smoother = self.make_plugin()
        smoother.configure(scene_context(with_post))
        before = _least_clearance(path, with_post)
        for problem in (with_post, None):
            result = attempted(partial(smoother.smooth, path, _AMPLE, problem=problem), SmootherException)
            if result is not None:
                after = _least_clearance(result.path, with_post)
                require(after >= before - 1e-6, f"a path that cleared all obstacles touches one by {-after:.4f} m")

    def test_a_problem_counts_the_same_configured_and_in_the_call(self) -> None:
        """`problem`: None stands for the configured problem and its obstacles; a reported certificate is correct."""
        for top in (-0.08, 0.12):  # obstacles next to the path and on it
            rock = [[1.4, -0.3], [1.6, -0.3], [1.6, top], [1.4, top]]
            problem = scene_problem(obstacles=ObstacleSet.from_polygons([rock]))
            configured, called = self.make_plugin(), self.make_plugin()
            configured.configure(PluginContext(name="contract", problem=problem))
            called.configure(PluginContext(name="contract", footprint=problem.robot.footprint))
            found, wanted = _outcome(configured, problem, None), _outcome(called, problem, problem)
            require(
                found == wanted, f"a configured problem gives the same result as in the call, {wanted}; got {found}"
            )

    def test_a_rigid_motion_of_the_task_moves_the_result(self) -> None:
        """`smooth`: moving the path and the problem together moves the result in the same way."""
        smoother = self.ready_plugin()
        here = smoother.smooth(raw_path(), _AMPLE, problem=scene_problem()).path
        goal = _MOTION @ GOAL
        moved = smoother.smooth(raw_path(_MOTION, goal), _AMPLE, problem=scene_problem(_MOTION, goal)).path
        _require_close(moved, here, _MOTION, 1e-5)  # rounding may end an iteration at another point

    def test_a_path_too_short_is_refused_or_returned(self) -> None:
        """`smooth`: the call raises an OptdockError with a reason or returns a result with the same ends."""
        smoother = self.ready_plugin()
        for end in (*(Pose2(length, 0.0, 0.0) for length in (1e-6, 1e-3, 0.3)), Pose2(0.0, 0.0, 0.5)):
            path = Path.from_poses([Pose2(0.0, 0.0, 0.0), end])
            result = attempted(partial(smoother.smooth, path, _AMPLE), SmootherException)
            if result is not None:
                require_same_ends(result.path, path.start, path.end)

    def test_little_time_is_a_time_out_or_a_usable_path(self) -> None:
        """`max_time`: little time gives a usable result or SmootherTimedOut; an invalid time gives InvalidValue."""
        smoother = self.ready_plugin()
        for path, problem in self.tasks():
            for max_time in (1e-9, 1e-4):
                result = attempted(partial(smoother.smooth, path, max_time, problem=problem), SmootherTimedOut)
                if result is not None:
                    require_same_ends(result.path, path.start, path.end)
            for bad in (math.nan, math.inf, -math.inf, -1.0):
                call = partial(smoother.smooth, path, bad, problem=problem)
                refused(call, InvalidValue, f"max_time {bad} is refused")

    def test_it_stops_when_cancelled_and_smooths_again(self) -> None:
        """`smooth`: `cancel_checker` is polled, and SmootherCancelled is raised if it returned True."""
        smoother = self.ready_plugin()
        path, problem = self.tasks()[0]
        before = self.exercise(smoother)
        require_cancellable(
            lambda cancelled: smoother.smooth(path, _AMPLE, problem=problem, cancel_checker=cancelled),
            SmootherCancelled,
        )
        require(self.exercise(smoother) == before, "after a cancellation, the smoother works as before")

    def test_a_warm_start_keeps_the_ends(self) -> None:
        """`warm_start`: an earlier result, or a path for a different problem, does not change the ends."""
        smoother = self.ready_plugin()
        path, problem = self.tasks()[0]
        earlier = smoother.smooth(path, _AMPLE, problem=problem).path
        for warm in (earlier, cusp_path(), raw_path(goal=GOAL @ Pose2(-1.0, -0.3, 0.0))):
            found = smoother.smooth(path, _AMPLE, problem=problem, warm_start=warm).path
            require_same_ends(found, path.start, path.end)


class TimeParameterizerContract(PluginContract[TimeParameterizer]):
    """Rules of `optdock.plugins.interfaces.TimeParameterizer`; infeasible motions are statuses, not exceptions."""

    interface: ClassVar[type[TimeParameterizer]] = TimeParameterizer

    def limits(self) -> tuple[MotionLimits, ...]:
        """Return the default limits, and a set in which every bound on the motion is finite."""
        turning = {name: _TURNING for name, limit in LIMITS.items() if limit.kind is LimitKind.TURNING}
        return MotionLimits(), MotionLimits(track_width=0.4, wheelbase=0.5, **turning)

    def paths(self) -> tuple[Path, ...]:
        """Return a line, an S of clothoids, a path with a cusp, and the S as a polyline."""
        curved = s_curve_drive(ORIGIN).path
        return straight_drive(ORIGIN).path, curved, cusp_drive(ORIGIN).path, moved_path(curved, ORIGIN)

    def exercise(self, plugin: TimeParameterizer) -> object:
        """Return the statuses and phases of all paths under the default limits."""
        results = [plugin.parameterize(path, MotionLimits(), SpeedZone()) for path in self.paths()]
        return tuple((int(result.status), _phases(result.trajectory)) for result in results)

    def cases(self) -> Iterator[tuple[Path, MotionLimits, SpeedZone, tuple[float, float]]]:
        """Yield every path under every set of limits, with speed zone, start speed and start acceleration."""
        for path in self.paths():
            for limits in self.limits():
                for zone in (SpeedZone(), SpeedZone(0.15, 0.4)):
                    for start in ((0.0, 0.0), (0.2, -0.2), (0.15, 0.1)):
                        yield path, limits, zone, start

    def test_a_motion_that_is_ok_is_certified(self) -> None:
        """`parameterize`: a motion with status OK passes `certify_trajectory`; from rest, every path here is OK."""
        plugin = self.ready_plugin()
        for path, limits, zone, (speed, acceleration) in self.cases():
            result = plugin.parameterize(path, limits, zone, start_speed=speed, start_acceleration=acceleration)
            require(
                isinstance(result, TimingResult), f"parameterize returns a TimingResult, got {type(result).__name__}"
            )
            require(result.status is TimingStatus.OK or speed > 0.0, f"a motion from rest is OK, got {result.status!r}")
            if result.status is TimingStatus.OK:
                _require_start(result.trajectory, speed, acceleration)
                _require_certified(result, path, limits, zone)
                require(result.reason == "", f"a result that is OK has no reason, got {result.reason!r}")

    def test_moving_the_path_changes_no_time(self) -> None:
        """`parameterize`: the duration depends only on the shape of the path."""
        plugin, motion = self.ready_plugin(), Pose2(3.0, -2.0, 0.8)
        for path in self.paths():
            here, there = (
                plugin.parameterize(moved_path(path, pose), MotionLimits(), SpeedZone()).trajectory
                for pose in (ORIGIN, motion)
            )
            durations = [math.nan if found is None else found.duration for found in (here, there)]
            change = abs(durations[1] - durations[0])
            require(change <= 1e-6, f"the duration remains {durations[0]} s, changed by {change} s")

    def test_infeasible_starts_are_statuses(self) -> None:
        """`TimingResult`: a status other than OK has a reason; an exceeded limit has `limit` and `at_s`."""
        plugin, path, limits = self.ready_plugin(), straight_drive(ORIGIN).path, MotionLimits()
        starts = {
            "1.2 times the speed limit": (1.2 * limits.max_speed, 0.0),
            "twice the speed limit": (2.0 * limits.max_speed, 0.0),
            "against the direction of travel": (-0.1, 0.0),
            "twice the acceleration limit": (0.1, 2.0 * limits.max_acceleration),
        }
        for what, (speed, acceleration) in starts.items():
            result = plugin.parameterize(path, limits, SpeedZone(), start_speed=speed, start_acceleration=acceleration)
            require(isinstance(result.status, TimingStatus), f"the status is a TimingStatus, got {result.status!r}")
            require(result.status is not TimingStatus.OK, f"a start {what} is not OK")
            require(result.reason, f"{result.status!r} has a reason")
            _require_start(result.trajectory, speed, acceleration)
            if speed > limits.max_speed:
                require(result.limit == "max_speed", f"the exceeded limit is max_speed, got {result.limit!r}")
                inside = result.at_s is not None and 0.0 <= result.at_s <= path.length
                require(inside, f"at_s is on the path, got {result.at_s}")

    def test_a_path_too_short_to_stop_on_has_an_overshoot(self) -> None:
        """`TimingResult`: CANNOT_STOP has the braking motion and its overshoot; otherwise the overshoot is 0."""
        limits, speed = MotionLimits(), MotionLimits().max_speed
        short = Path.from_poses([ORIGIN, Pose2(_SHORT, 0.0, 0.0)])
        result = self.ready_plugin().parameterize(short, limits, SpeedZone(), start_speed=speed)
        require(
            result.status is TimingStatus.CANNOT_STOP,
            f"5 cm are too short to stop from {speed} m/s, got {result.status!r}",
        )
        braking = speed**2 / (2.0 * limits.max_deceleration) - _SHORT
        require(result.overshoot >= 0.9 * braking, f"overshoot at least {braking:.3f} m, got {result.overshoot}")
        _require_start(result.trajectory, speed, 0.0)

    def test_degenerate_paths_and_starts_have_a_status(self) -> None:
        """`TimingStatus`: a turn in place gives FAIL; NaN gives BAD_START or InvalidValue, and no other exception."""
        plugin, path = self.ready_plugin(), straight_drive(ORIGIN).path
        turn = Path.from_poses([ORIGIN, Pose2(0.0, 0.0, 0.5)])
        result = plugin.parameterize(turn, MotionLimits(), SpeedZone())
        failed = result.status is TimingStatus.FAIL and result.trajectory is None
        require(failed, f"a turn in place fails without a motion, got {result.status!r}")
        for exponent in range(-13, -2):
            tiny = Path((clothoid(ORIGIN, [0.0, 10.0**exponent], [0.0, 0.0]),))
            result = plugin.parameterize(tiny, MotionLimits(), SpeedZone())
            require(isinstance(result.status, TimingStatus), f"the status is a TimingStatus, got {result.status!r}")
            has_motion = result.trajectory is not None
            require(has_motion or result.status is not TimingStatus.OK, "a result that is OK has a trajectory")
        for v, a in ((math.nan, 0.0), (0.0, math.nan), (math.inf, 0.0), (0.0, math.inf)):
            start = partial(plugin.parameterize, path, MotionLimits(), start_speed=v, start_acceleration=a)
            found = attempted(partial(start, zone=SpeedZone()), InvalidValue)
            is_bad = found is None or found.status is TimingStatus.BAD_START
            require(is_bad, f"speed {v}, acceleration {a} is a bad start, got {found}")

    def test_little_time_is_a_status(self) -> None:
        """`max_time`: no time gives TIMED_OUT without a motion; a motion found in a short time is certified."""
        plugin = self.ready_plugin()
        for path, limits, zone, (speed, _) in self.cases():
            for max_time in (0.0, 0.001, 0.01) if speed == 0.0 else ():
                result = plugin.parameterize(path, limits, zone, max_time=max_time)
                late = result.status is TimingStatus.TIMED_OUT
                require(late or max_time > 0.0, f"with no time the status is TIMED_OUT, got {result.status!r}")
                require(not late or result.trajectory is None, "TIMED_OUT has no motion")
                if result.status is TimingStatus.OK:
                    _require_certified(result, path, limits, zone)

    def test_it_stops_when_cancelled_and_times_again(self) -> None:
        """`parameterize`: `cancel_checker` is polled, and TimingCancelled is raised if it returned True."""
        plugin = self.ready_plugin()
        path, limits, zone, _start = next(self.cases())
        before = self.exercise(plugin)
        require_cancellable(
            lambda cancelled: plugin.parameterize(path, limits, zone, cancel_checker=cancelled), TimingCancelled
        )
        require(self.exercise(plugin) == before, "after a cancellation, the time parameterizer works as before")


def _require_close(found: Path, path: Path, motion: Pose2, within: float = 1e-6) -> None:
    """Require that `found` is `path` moved by `motion`, at samples every 10 cm."""
    poses, wanted = found.sample(0.1).poses[:, :2], path.sample(0.1).poses
    moved = np.array([(motion @ Pose2.from_sequence(row)).as_array()[:2] for row in wanted])
    require(len(poses) == len(moved), f"the length of the path does not change: {len(moved)} samples, got {len(poses)}")
    worst = float(np.max(np.abs(poses - moved)))
    require(worst <= within, f"the path is the same within {within} m, got {worst:.3g} m")


def _outcome(smoother: Smoother, problem: DockingProblem, in_call: DockingProblem | None) -> object:
    """Return the sampled result for the raw path, or its error; a certificate in the report must be valid."""
    try:
        result = smoother.smooth(raw_path(), _AMPLE, problem=in_call)
    except SmootherException as error:
        return type(error), str(error)
    claim = result.report.certificate
    if claim is not None and claim.certified:
        verdict = certify_path(result.path, problem)
        require(verdict.certified, f"a path reported as certified is certified: {verdict.reason}")
    return sampled(result.path)


def _least_clearance(path: Path, problem: DockingProblem) -> float:
    """Return the least clearance of the poses of `path`, or 0 if they touch no obstacle [m]."""
    poses = path.sample(0.02).poses
    return float(pose_clearances(poses, problem.robot.footprint, problem.all_obstacles, within=0.0)[0].min())


def _require_start(trajectory: Trajectory | None, speed: float, acceleration: float) -> None:
    if trajectory is not None:
        law = trajectory.time_law
        found, wanted = (law.start_speed, law.start_acceleration), (speed, acceleration)
        require(found == wanted, f"a motion begins with the start state {wanted}, got {found}")


def _require_certified(result: TimingResult, path: Path, limits: MotionLimits, zone: SpeedZone) -> None:
    require(result.trajectory is not None, "a result that is OK has a trajectory")
    if result.trajectory is not None:
        proof = certify_trajectory(result.trajectory, limits, zone)
        require(proof.certified, f"a result that is OK is certified: {proof.reason}")
        require(abs(result.trajectory.path.length - path.length) <= 1e-9, "a result that is OK covers the whole path")
        require(
            result.worst_ratio <= 1.0 + 1e-6,
            f"the worst ratio of a result that is OK is at most 1, got {result.worst_ratio}",
        )
        require(result.overshoot == 0.0, f"the overshoot is 0 unless the status is CANNOT_STOP, got {result.overshoot}")


def _phases(trajectory: Trajectory | None) -> tuple[tuple[float, float], ...]:
    if trajectory is None:
        return ()
    return tuple(zip(trajectory.time_law.durations.tolist(), trajectory.time_law.jerks.tolist(), strict=True))
