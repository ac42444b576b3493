"""The pipeline: certified or a true reason, and what a raw path breaks the smoothed one keeps."""

import contextlib
import dataclasses
import itertools
import math

import numpy as np
import pytest

from experiments.dense_check import dense_check
from optdock.errors import (
    Cancelled,
    CertificationFailed,
    FailedToSmoothPath,
    FailedToTimePath,
    GoalOccupied,
    GoalOutsideMapBounds,
    InvalidValue,
    LifecycleError,
    NoMotionExists,
    NoValidPathCouldBeFound,
    OptdockError,
    PlannerCancelled,
    PluginError,
    SmootherCancelled,
    SmootherTimedOut,
    StartOccupied,
    StartOutsideMapBounds,
    TimingCancelled,
)
from optdock.geometry.footprint import Footprint
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import Pose2
from optdock.model.clearance_rule import ClearanceRule
from optdock.model.constant_jerk import TimeLaw
from optdock.model.costmap import Costmap
from optdock.model.dock import Dock, DockDirection
from optdock.model.limits import MotionLimits
from optdock.model.path import Path
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from optdock.model.trajectory import Trajectory
from optdock.planners.dock_planner import DockPlanner
from optdock.planning.pipeline import _warm_once, plan_dock, warm_up
from optdock.planning.plan import PartialPlan
from optdock.plugins.interfaces import (
    GlobalPlanner,
    LifecycleState,
    PluginContext,
    Smoother,
    SmoothingResult,
    TimeParameterizer,
    TimingResult,
    TimingStatus,
    never_cancelled,
)
from optdock.plugins.registry import PluginChoice, create_plugin
from optdock.timing.windowed import Windowed
from optdock.verification import certify_motion, certify_path, certify_trajectory, proven_for
from smoothers import CasadiSmoother

BUDGET = 20.0  # [s]: these tests are about verdicts, not about time
LIMITS = MotionLimits(max_yaw_rate=1.0, max_yaw_acceleration=2.0, max_curvature=1.5, max_curvature_rate=6.0)
ROBOT = Robot(Footprint.rectangle(0.45, 0.45, 0.6), LIMITS)
STATION = Footprint(np.array([[0.455, -0.3], [0.6, -0.3], [0.6, 0.3], [0.455, 0.3]]))
GOAL = Pose2(4.0, 1.0, 0.0)


def dock(**changes):
    return Dock(
        **{
            "pose": GOAL,
            "footprint": STATION,
            "final_straight": 0.3,
            "approach_speed": 0.1,
            "approach_distance": 0.3,
            **changes,
        }
    )


def problem(**changes):
    return DockingProblem(**{"start": Pose2(0.5, 0.3, 0.3), "dock": dock(), "robot": ROBOT, **changes})


@pytest.fixture(scope="module")
def plain():
    return plan_dock(problem(), time_budget=BUDGET)


def test_plan_is_certified_and_every_part_of_it_holds(plain):
    task, plan = problem(), plain
    assert plan.certificate.certified
    assert plan.completed
    assert certify_path(plan.path, task).certified
    assert certify_trajectory(plan.trajectory, LIMITS, task.dock.approach, start_speed=0.0).certified
    assert dense_check(plan.path, task).ok
    assert set(plan.timing_ms) == {"plan", "smooth", "certify", "time", "first", "total"}


def test_raw_path_breaks_what_the_smoothed_one_keeps():
    task = problem(start=Pose2(0.5, 0.3, -0.4))
    plan = plan_dock(task, time_budget=BUDGET)
    raw = {violation.kind for violation in certify_path(plan.raw_path, task).violations}
    assert {"curvature", "curvature_rate"} <= raw
    assert certify_path(plan.path, task).violations == ()


def test_plan_is_independent_of_the_frame_and_symmetric(plain):
    frame = Pose2(-5.0, 40.0, -1.0)
    moved = problem(start=frame @ Pose2(0.5, 0.3, 0.3), dock=dock(pose=frame @ GOAL))
    mirrored = problem(start=Pose2(0.5, 1.7, -0.3))
    for plan in (plan_dock(task, time_budget=BUDGET) for task in (moved, mirrored)):
        assert plan.path.length == pytest.approx(plain.path.length, rel=1e-4)
        assert plan.trajectory.duration == pytest.approx(plain.trajectory.duration, rel=1e-3)
        assert plan.certificate.max_curvature == pytest.approx(plain.certificate.max_curvature, abs=1e-2)


def test_robot_backs_into_a_dock_behind_it():
    rear = Footprint(STATION.vertices * [-1.0, 1.0])
    task = problem(start=Pose2(7.0, 1.5, 0.2), dock=dock(footprint=rear))
    plan = plan_dock(task, time_budget=BUDGET)
    assert [int(segment.direction) for segment in plan.path.segments] == [-1]
    assert plan.trajectory.at(0.5 * plan.trajectory.duration).twist.linear < 0.0


def failure(task, **arguments):
    with pytest.raises(OptdockError) as caught:
        plan_dock(task, **{"time_budget": BUDGET, **arguments})
    assert isinstance(caught.value.partial, PartialPlan)
    assert caught.value.partial.timing_ms["total"] >= 0.0
    return caught.value


def wall(x0, y0, x1, y1):
    return ObstacleSet.from_polygons([[[x0, y0], [x1, y0], [x1, y1], [x0, y1]]])


def test_search_ends_if_the_gain_is_too_small(plain):
    start, ahead = plain.problem.start, plain.path.segments
    behind = start @ Pose2(-0.5, 0.0, 0.0)
    detour = [Path.from_poses(poses).segments[0] for poses in ([start, behind], [behind, start])]
    given = [Path((*detour, *ahead), plain.path.frame)]
    plans = [plan_dock(problem(), time_budget=BUDGET, guesses=given, least_gain=gain) for gain in (0.03, 0.9)]
    further = [[attempt.stage for attempt in plan.tried if attempt.stage == "fewer cusps"] for plan in plans]
    assert [bool(one) for one in further] == [True, False]
    assert plans[0].price < (1.0 - 0.1) * plans[1].tried[0].price
    with pytest.raises(InvalidValue, match="least_gain: must be finite"):
        plan_dock(problem(), least_gain=math.nan)


@pytest.mark.parametrize("budget", [0.0, -1.0, math.nan, math.inf, 10**400])
def test_budget_is_a_positive_number(budget):
    with pytest.raises(InvalidValue, match="time_budget: must be finite"):
        plan_dock(problem(), time_budget=budget)


@pytest.mark.parametrize("lower", [[0.0, 0.0], [[0.0, 0.0, 0.0]], [[0.0, 0.0], [0.0, 0.0]], [[math.nan, 0.0]]])
def test_corners_of_rectangles_come_in_pairs(lower):
    with pytest.raises(InvalidValue, match="posts"):
        ObstacleSet.from_rectangles(np.array(lower), np.array([[1.0, 1.0]]), "posts")


def test_start_in_collision():
    error = failure(problem(obstacles=wall(0.0, 0.5, 0.7, 0.9)))
    assert isinstance(error, StartOccupied)
    assert error.code == 205
    assert "overlaps obstacles[0]" in str(error)


def test_goal_in_collision():
    error = failure(problem(obstacles=wall(4.0, 1.2, 4.4, 1.8)))
    assert isinstance(error, GoalOccupied)
    assert error.code == 206


def test_goal_closer_than_required_at_the_dock():
    error = failure(problem(clearance=ClearanceRule(0.05, 0.02, 0.5)))
    assert isinstance(error, GoalOccupied)
    assert "0.0050 m from dock, required 0.0200 m" in str(error)


@pytest.mark.parametrize(
    ("rule", "in_file", "in_python"),
    [
        (0.08, "{required: 0.08, at_dock: 0}", "ClearanceRule(required=0.08, at_dock=0.0)"),
        (
            ClearanceRule(0.08, 0.02, 0.3),
            "{required: 0.08, at_dock: 0, taper: 0.3}",
            "ClearanceRule(required=0.08, at_dock=0.0, taper=0.3)",
        ),
    ],
)
def test_message_suggests_a_clearance_that_allows_contact_with_the_station(rule, in_file, in_python):
    said = str(failure(problem(clearance=rule)))
    assert f"the clearance also holds at the dock; to reduce it there set {in_file} (in Python: {in_python})" in said
    asked = eval(in_python, {"ClearanceRule": ClearanceRule})  # the advice as it stands
    assert plan_dock(problem(clearance=asked)).certificate.certified


def test_no_clearance_is_suggested_for_other_obstacles():
    said = str(failure(problem(obstacles=wall(3.8, 1.302, 4.2, 1.5), clearance=ClearanceRule(0.05, 0.004))))
    assert "obstacles[0]" in said
    assert "holds at the dock" not in said


def test_unknown_cells_are_named_in_message_and_data():
    cells = np.zeros((80, 120), dtype=np.uint8)
    cells[40:44, 20:24] = 255
    error = failure(problem(start=Pose2(1.1, 1.1, 0.0), obstacles=[], costmap=Costmap(cells, 0.05, (0.0, -1.0))))
    assert "overlaps unknown cells of the map by" in str(error)
    assert error.where["obstacle"] == "unknown"


def test_start_too_close_to_the_dock():
    error = failure(problem(start=Pose2(3.7, 1.0, 0.0)), planner="DockPlanner")
    assert isinstance(error, NoValidPathCouldBeFound)
    assert error.code == 208
    assert plan_dock(problem(start=Pose2(3.7, 1.0, 0.0)), time_budget=BUDGET).certificate.certified


def test_dock_direction_that_contradicts_the_start():
    wrong = problem(dock=dock(direction=DockDirection.BACKWARD))
    assert isinstance(failure(wrong, planner="DockPlanner"), NoValidPathCouldBeFound)
    assert isinstance(failure(wrong), NoMotionExists | NoValidPathCouldBeFound)  # the station stands behind the dock


def test_ends_off_the_map():
    costmap = Costmap(np.zeros((100, 120), dtype=np.uint8), 0.05, (-0.5, -1.5))
    assert plan_dock(problem(costmap=costmap), time_budget=BUDGET).certificate.certified
    assert isinstance(failure(problem(start=Pose2(0.5, -1.6, 0.3), costmap=costmap)), StartOutsideMapBounds)
    assert isinstance(failure(problem(start=Pose2(0.5, -1.3, 0.3), costmap=costmap)), StartOccupied)  # a corner is off
    assert isinstance(failure(problem(dock=dock(pose=Pose2(6.0, 1.0, 0.0)), costmap=costmap)), GoalOutsideMapBounds)


def test_costmap_alone_is_an_obstacle():
    free = Costmap(np.zeros((160, 160), dtype=np.uint8), 0.05, (-1.0, -4.0))
    cells = np.array(free.data)
    cells[:, 60:66] = 254  # x from 2.0 to 2.3 m, right across
    walled = free.with_data(cells)
    assert plan_dock(problem(costmap=free), time_budget=BUDGET).certificate.nearest == "dock"
    error = failure(problem(costmap=walled), planner="DockPlanner")
    assert isinstance(error, NoMotionExists)
    assert "no motion joins start and goal" in str(error)


def test_curvature_the_robot_cannot_drive():
    stiff = Robot(ROBOT.footprint, dataclasses.replace(LIMITS, max_curvature=0.05))
    error = failure(problem(start=Pose2(2.0, 0.0, 1.0), robot=stiff), planner="DockPlanner")
    assert isinstance(error, FailedToSmoothPath)
    assert error.partial.raw_path is not None
    assert error.where["reason"]


def test_start_too_fast_to_stop():
    hasty = problem(start=Pose2(2.9, 1.0, 0.0), start_speed=2.0, start_curvature=0.0)
    error = failure(hasty, planner="DockPlanner")
    assert isinstance(error, FailedToTimePath)
    assert error.where["status"] in ("START_INFEASIBLE", "CANNOT_STOP")
    assert error.partial.path is not None


def test_motion_begins_with_the_acceleration_that_the_robot_has():
    for acceleration in (0.3, -0.4):
        task = problem(start_speed=0.3, start_curvature=0.0, start_acceleration=acceleration)
        plan = plan_dock(task, planner="DockPlanner", time_budget=BUDGET)
        first = plan.trajectory.at(0.0)
        assert (first.twist.linear, first.acceleration) == (0.3, acceleration)
        assert plan.trajectory_certificate.certified
        other = dataclasses.replace(task, start_acceleration=0.0)
        assert not certify_motion(plan.trajectory, other).certified


def test_acceleration_that_cannot_be_kept_is_refused_by_name():
    for speed, acceleration, status in ((0.01, -0.5, "BAD_START"), (0.3, 0.9, "START_INFEASIBLE")):
        task = problem(start_speed=speed, start_curvature=0.0, start_acceleration=acceleration)
        error = failure(task, planner="DockPlanner")
        assert isinstance(error, FailedToTimePath)
        assert error.where["status"] == status


def test_unknown_plugin_is_named():
    assert isinstance(failure(problem(), smoother="CasadiSmother"), PluginError)


@pytest.mark.parametrize(
    ("choice", "error", "message"),
    [
        (PluginChoice("NearOptimol"), PluginError, "did you mean NearOptimal"),
        (PluginChoice("NearOptimal", {"steep": 0.1}), InvalidValue, "NearOptimal.steep: unknown parameter"),
    ],
)
def test_wrong_choice_of_timing_is_not_replaced(choice, error, message):
    found = failure(problem(), timing=choice)
    assert isinstance(found, error)
    assert message in str(found)


@pytest.mark.parametrize(
    ("ask", "message"),
    [
        (lambda: plan_dock(None), "problem: must be a DockingProblem, got NoneType"),
        (lambda: plan_dock(problem(), planner=3), "planner: must be a GlobalPlanner or its name, got int"),
        (
            lambda: plan_dock(problem(), timing=Liar()),
            "timing: must be a TimeParameterizer or its name, got Liar",
        ),
        (lambda: plan_dock(problem(), smoother=Liar), r"got the class Liar; write Liar\(\)"),
        (lambda: plan_dock(problem(), warm_start="plan.json"), "warm_start: must be a Path, got str"),
        (lambda: plan_dock(problem(), cancel_checker=None), "cancel_checker: must be a function"),
        (lambda: PluginChoice(["DockPlanner"]), "name: must be a str, got list"),
    ],
)
def test_invalid_arguments_are_refused_by_name(ask, message):
    with pytest.raises(InvalidValue, match=message):
        ask()


class Liar(Smoother):
    """A smoother that returns its input and calls it good."""

    def smooth(self, path, max_time, *, problem=None, warm_start=None, cancel_checker=None):
        return SmoothingResult(path)


def test_uncertified_result_of_a_smoother_is_refused():
    error = failure(problem(start=Pose2(0.5, 0.3, -0.4)), planner="DockPlanner", smoother=Liar())
    assert isinstance(error, CertificationFailed)
    assert error.partial.certificate is not None
    assert not error.partial.certificate.certified


def test_smoother_time_out_is_passed_on():
    class Slow(Liar):
        def smooth(self, path, max_time, *, problem=None, warm_start=None, cancel_checker=None):
            raise SmootherTimedOut("too slow")

    error = failure(problem(), planner="DockPlanner", smoother=Slow())
    assert error.code == 502
    assert error.partial.raw_path is not None
    assert error.partial.path is None


class Shortcut(TimeParameterizer):
    """Times the chord from start to goal instead of the path."""

    def parameterize(self, path, limits, zone, **start):
        chord = Path.from_poses(np.linspace(path.start.as_array(), path.end.as_array(), 50))
        return create_plugin(TimeParameterizer, "Windowed").parameterize(chord, limits, zone, **start)


class Hasty(TimeParameterizer):
    """Times the path for a drive twice as fast as it is."""

    def parameterize(self, path, limits, zone, **start):
        faster = dataclasses.replace(limits, max_speed=2.0 * limits.max_speed)
        return create_plugin(TimeParameterizer, "Windowed").parameterize(path, faster, zone, **start)


class Broken(TimeParameterizer):
    def parameterize(self, path, limits, zone, **start):
        raise ZeroDivisionError("no time at all")


class Careless(TimeParameterizer):
    def parameterize(self, path, limits, zone, **start):
        raise InvalidValue("durations: must be finite")


class Numbered(TimeParameterizer):
    def parameterize(self, path, limits, zone, **start):
        return TimingResult(0, None)


class Empty(TimeParameterizer):
    def parameterize(self, path, limits, zone, **start):
        return TimingResult(TimingStatus.OK, "a trajectory")


class Kicked(TimeParameterizer):
    """Sets out with an acceleration that the robot, which rests, does not have."""

    def parameterize(self, path, limits, zone, **start):
        jerk, begins, top = 1.0, 0.25, 0.03125
        ends = math.sqrt(top / jerk)
        cruise = (path.length - begins**3 * jerk / 3.0 - top * ends) / top
        law = TimeLaw([begins, cruise, ends, ends], [-jerk, 0.0, -jerk, jerk], 0.0, 0.0, 0.25)
        return TimingResult(TimingStatus.OK, Trajectory(path, law))


@pytest.mark.parametrize(
    ("timing", "why"),
    [
        (Kicked, "the trajectory is not certified: the motion begins with acceleration 0.25, the robot has 0"),
        (Shortcut, "timed another path than the certified one"),
        (Hasty, "the trajectory is not certified: speed"),
        (Broken, "failed: ZeroDivisionError: no time at all"),
        (Careless, "durations: must be finite"),
        (Numbered, "must return a TimingStatus as the status of its result, got int"),
        (Empty, "must return a Trajectory as the trajectory of its result, got str"),
    ],
)
def test_wrong_result_of_a_timing_plugin_is_replaced(timing, why):
    plan = plan_dock(problem(), time_budget=BUDGET, timing=timing())
    assert plan.trajectory.path is plan.path
    assert plan.trajectory_certificate.certified
    assert certify_trajectory(plan.trajectory, LIMITS, dock().approach, start_acceleration=0.0).certified
    assert why in plan.timing_report.replaced


def test_wrong_types_from_a_plugin_raise_plugin_errors(monkeypatch):
    class Careless(Liar):
        def smooth(self, path, max_time, *, problem=None, warm_start=None, cancel_checker=None):
            return path.segments[99]

    error = failure(problem(), smoother=Careless())
    assert isinstance(error, PluginError)
    assert "IndexError" in str(error)
    assert isinstance(error.__cause__, IndexError)
    monkeypatch.setattr(Careless, "smooth", lambda self, path, max_time, **rest: path)
    assert "must return a SmoothingResult, got Path" in str(failure(problem(), smoother=Careless()))
    monkeypatch.setattr(Careless, "smooth", lambda self, path, max_time, **rest: SmoothingResult(None))
    assert "must return a Path as the path of its result, got NoneType" in str(failure(problem(), smoother=Careless()))


class Elsewhere(Path):
    """A path whose poses are not those of the segments that are proven."""

    def poses_at(self, s):
        return super().poses_at(s) + 1.0


def test_path_subclasses_of_plugins_are_replaced_by_plain_paths():
    class Planner(DockPlanner):
        def create_plan(self, start, goal, cancel_checker=never_cancelled):
            return Elsewhere(super().create_plan(start, goal, cancel_checker).segments)

    class Smoothing(CasadiSmoother):
        def smooth(self, *arguments, **more):
            return SmoothingResult(Elsewhere(super().smooth(*arguments, **more).path.segments))

    plan = plan_dock(problem(), time_budget=BUDGET, planner=Planner(), smoother=Smoothing())
    assert type(plan.raw_path) is type(plan.path) is type(plan.trajectory.path) is Path


def test_warming_up_warms_the_smoother_itself(monkeypatch):
    warm_up()  # in earnest, for the tests that follow
    warmed = []
    monkeypatch.setattr("smoothers.casadi_smoother.CasadiSmoother.warm_up", lambda self: warmed.append(self.parameters))
    _warm_once.cache_clear()
    warm_up()
    warm_up()
    assert len(warmed) == 1


def test_plugins_of_others_are_warmed_up_whatever_they_do():
    """They plan small problems and their own warm-up is called; what they raise shows in the first real call."""
    called = []

    class Noting(DockPlanner):
        def create_plan(self, start, goal, cancel_checker=never_cancelled):
            called.append("planner")
            return super().create_plan(start, goal, cancel_checker)

    class Demanding(DockPlanner):
        def __init__(self, reason):
            raise ZeroDivisionError(reason)

    class Failing(Liar):
        def smooth(self, path, max_time, *, problem=None, warm_start=None, cancel_checker=None):
            called.append("smoother")
            raise ZeroDivisionError

        def warm_up(self):
            called.append("warm-up")
            raise ZeroDivisionError

    _warm_once.__wrapped__((Demanding, Noting), Failing, Broken)
    assert called[:2] == ["planner", "smoother"]
    assert called.index("warm-up") == len(called) - 1


class Patience:
    """A cancel checker that runs out when it has been asked `times` times."""

    def __init__(self, times, error=None):
        self.left, self.error = times, error

    def __call__(self):
        self.left -= 1
        if self.left <= 0 and self.error is not None:
            raise self.error
        return self.left <= 0


def test_cancelling_stops_every_stage():
    """Asked once more each time until the plan is made: every stage gives up with its own error, none is left out."""
    asked = Patience(10**9)
    plan_dock(problem(), time_budget=BUDGET, planner="DockPlanner", cancel_checker=asked)
    total = 10**9 - asked.left
    counts = [*range(1, total + 1, 5), total]
    seen = {type(failure(problem(), planner="DockPlanner", cancel_checker=Patience(times))) for times in counts}
    assert seen == {PlannerCancelled, SmootherCancelled, TimingCancelled}
    assert all(issubclass(kind, Cancelled) for kind in seen)


class Unproven(CasadiSmoother):
    """Hands on a path that nobody has proven yet: a copy."""

    def smooth(self, *arguments, **named):
        found = super().smooth(*arguments, **named)
        return dataclasses.replace(found, path=Path(found.path.segments, found.path.frame))


def test_cancelling_is_final():
    asked = Patience(10**9)
    plan_dock(problem(), time_budget=BUDGET, planner="DockPlanner", cancel_checker=asked)
    total = 10**9 - asked.left
    cases = [(kind, times) for k, kind in enumerate((CasadiSmoother, Unproven)) for times in range(2 * k, total, 4)]
    for smoother, times in cases:
        answers = itertools.chain(itertools.repeat(False, times), [True], itertools.repeat(False))
        asks = {"planner": "DockPlanner", "smoother": smoother(), "cancel_checker": lambda a=answers: next(a)}
        error = failure(problem(), **asks)
        assert isinstance(error, Cancelled)


class Once(CasadiSmoother):
    """Fails in its first call, and not again."""

    def smooth(self, *arguments, **named):
        self.smooth = super().smooth
        raise ZeroDivisionError


def test_plugin_can_be_used_again_after_a_failure():
    smoother = Once()
    assert isinstance(failure(problem(), smoother=smoother), PluginError)
    assert smoother.state is LifecycleState.UNCONFIGURED
    assert plan_dock(problem(), time_budget=BUDGET, smoother=smoother).certificate.certified


class Relabelled(Windowed):
    """Says of its motion that it is proven for another problem, along a copy of the path."""

    def parameterize(self, path, limits, zone, **start):
        found = super().parameterize(path, limits, zone, **start)
        motion = Trajectory(Path(path.segments, path.frame), found.trajectory.time_law)
        return dataclasses.replace(found, trajectory=motion)


def test_plan_uses_its_certified_path():
    task = problem()
    plan = plan_dock(task, time_budget=BUDGET, timing=Relabelled())
    assert plan.trajectory.path is plan.path
    assert proven_for(plan.trajectory) == task.fingerprint
    assert not plan.timing_report.replaced


class Interrupted(Exception):
    """The caller's own."""


def test_exception_of_the_cancel_checker_is_passed_on():
    asked = Patience(10**9)
    plan_dock(problem(), time_budget=BUDGET, cancel_checker=asked)
    total = 10**9 - asked.left
    for times in (1, total // 4, total // 2, total):
        with pytest.raises(Interrupted):
            plan_dock(problem(), time_budget=BUDGET, cancel_checker=Patience(times, Interrupted()))


class Raising:
    """A cancel checker that raises where it is armed, and only once: whoever swallows that is never asked again."""

    def __init__(self, error):
        self.error, self.is_armed = error, False

    def __call__(self):
        if self.is_armed:
            self.is_armed = False
            raise self.error
        return False


@pytest.mark.parametrize(
    ("role", "kind", "method"),
    [
        ("planner", DockPlanner, "create_plan"),
        ("smoother", CasadiSmoother, "smooth"),
        ("timing", Windowed, "parameterize"),
    ],
)
def test_exception_of_the_cancel_checker_is_passed_on_if_a_plugin_suppresses_it(role, kind, method):
    error = {"planner": Interrupted("mine"), "smoother": KeyboardInterrupt(), "timing": InvalidValue("mine")}[role]
    checker, swallowing = Raising(error), kind()
    honest = getattr(swallowing, method)

    def work(*arguments, cancel_checker=None, **named):
        checker.is_armed = True
        with contextlib.suppress(BaseException):
            (cancel_checker or arguments[-1])()
        return honest(*arguments, **named)

    setattr(swallowing, method, work)
    plugins = {"planner": DockPlanner(), "timing": "Windowed", role: swallowing}
    with pytest.raises(type(error)) as caught:
        plan_dock(problem(), time_budget=BUDGET, cancel_checker=checker, **plugins)
    assert caught.value is error
    assert not checker.is_armed
    assert swallowing.state is LifecycleState.UNCONFIGURED


@pytest.mark.parametrize(
    ("role", "error"), [("planner", KeyError("oh")), ("smoother", RecursionError("oh")), ("smoother", OSError("oh"))]
)
def test_exception_of_a_plugin_is_the_cause_of_the_plugin_error(role, error):
    class Faulty(GlobalPlanner, Smoother):
        def create_plan(self, start, goal, cancel_checker=never_cancelled):
            raise error

        def smooth(self, path, max_time, *, problem=None, warm_start=None, cancel_checker=None):
            raise error

    found = failure(problem(), **{role: Faulty()})
    assert type(found) is PluginError
    assert found.__cause__ is error
    assert f"Faulty failed: {type(error).__name__}: " in str(found)


@pytest.mark.parametrize("hook", ["on_configure", "on_cleanup"])
def test_exception_in_a_plugin_hook_raises_a_plugin_error(hook):
    error = ZeroDivisionError("oh")

    def fail(self):
        raise error

    found = failure(problem(), smoother=type("Stubborn", (CasadiSmoother,), {hook: fail})())
    assert type(found) is PluginError
    assert found.__cause__ is error


class Mistaken(GlobalPlanner, Smoother):
    """A plugin that makes a value nobody can make, or a path in another frame."""

    def create_plan(self, start, goal, cancel_checker=never_cancelled):
        return Path.from_poses([start])

    def smooth(self, path, max_time, *, problem=None, warm_start=None, cancel_checker=None):
        return SmoothingResult(Path(path.segments, "elsewhere"))


def test_invalid_value_of_a_plugin_is_the_plugins_error():
    for error in (failure(problem(), planner=Mistaken()), failure(problem(), smoother=Mistaken())):
        assert type(error) is PluginError
        assert str(error).startswith("Mistaken ")


def test_plugins_are_names_or_objects_and_give_the_same_plan(plain):
    named = plan_dock(
        problem(), time_budget=BUDGET, timing="Windowed", smoother=PluginChoice("CasadiSmoother", {"spans": 16})
    )
    smoother, timing = CasadiSmoother(spans=16), Windowed()
    for _ in range(2):  # an object is free again afterwards
        made = plan_dock(problem(), time_budget=BUDGET, planner=DockPlanner(), smoother=smoother, timing=timing)
        assert made.path.digest == named.path.digest
        assert made.trajectory.duration == named.trajectory.duration
    assert plain.path.digest != named.path.digest


@pytest.mark.parametrize("role", ["planner", "smoother", "timing"])
def test_configured_plugin_is_refused(role):
    plugin = {"planner": DockPlanner, "smoother": CasadiSmoother, "timing": Windowed}[role]()
    plugin.configure(PluginContext(problem=problem()))
    error = failure(problem(), **{role: plugin})
    assert isinstance(error, LifecycleError)
    assert plugin.context.problem is not None


def test_warm_start_reduces_iterations(plain):
    nearby = problem().starting_at(plain.path.pose_at(0.4))
    cold = plan_dock(nearby, time_budget=BUDGET)
    for earlier in (plain, plain.path):
        again = plan_dock(nearby, time_budget=BUDGET, warm_start=earlier)
        assert again.certificate.certified
        assert again.smoothing_report.iterations <= cold.smoothing_report.iterations
