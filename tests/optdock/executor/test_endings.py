"""Every ending, cancellation in every state, and commands within the limits for any measurements."""

import dataclasses
import itertools
import math
import re
import time

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from optdock.errors import InvalidValue, PluginError
from optdock.executor import DockingExecutor, EndingKind, ExecutorSettings, InlinePlanning, State, ThreadPlanning
from optdock.executor.planning import DrivenMotion, Outcome, PlanResult, RecordedPlanning, Verdict
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import Pose2, Twist2
from optdock.model.clearance_rule import ClearanceRule
from optdock.model.costmap import Costmap
from optdock.model.measurements import Detection, Measurements
from optdock.model.robot import TrackingTube
from optdock.simulation import Actuation, Station
from optdock.testing.drives import clothoid, rest_to_rest
from optdock.verification import pose_clearance

from .conftest import LIMITS, PERFECT, ROBOT, STATION, TRUE_DOCK, assert_lawful, once, problem_with, run, simulated

QUICK = {"initial_perception_timeout": 0.5, "localization_timeout": 0.5, "wait_charge_timeout": 0.3}
QUICK |= {"obstacle_patience": 0.1, "time_budget": 0.2, "settling_time": 0.5}


AHEAD = Pose2(-0.8, 0.0, 0.0)


def perfect(start=AHEAD, **kwargs):
    """A robot without errors."""
    return simulated(start, sensors=PERFECT, actuation=Actuation(), **kwargs)


class StraightPlanning(RecordedPlanning):
    """Straight motions of this length, at most `most` times, or none; without certificates, as from a log."""

    def __init__(self, length=0.8, reason="", most=math.inf):
        super().__init__()
        self.length, self.reason, self.job, self.most = length, reason, None, most

    def submit(self, job):
        self.job = job

    def poll(self, stamp):
        job, self.job = self.job, None
        if job is None:
            return None
        if self.reason or job.running is not None:
            return PlanResult(job.number, Outcome.FAILED if job.running is None else Outcome.KEPT, reason=self.reason)
        self.most -= 1
        if self.most < 0:
            return PlanResult(job.number, Outcome.FAILED, reason="no other way")
        drive = rest_to_rest([clothoid(job.problem.start, [0.0, self.length], [0.0, 0.0])], speed=0.3)
        return PlanResult(job.number, Outcome.NEW, DrivenMotion(drive, job.problem))

    def still_holds(self, motion, costmap, from_time):
        return Verdict(holds=True)

    def close(self):
        self.job = None


def lose(executor, world, measurements):
    return measurements._replace(detections=())


def blind(executor, world, measurements):
    return measurements._replace(pose=None)


def held(executor, world, measurements):
    """Keep the robot in place while its wheels turn."""
    world.state = world.state._replace(pose=Pose2(-0.8, 0.0, 0.0))


def signal(executor, world, measurements):
    return measurements._replace(contact=True)


SHORT = StraightPlanning(0.7)
NO_WAY = {"planning": StraightPlanning(reason="NoValidPathCouldBeFound: a wall")}
AT_DOCK, AFAR = Pose2(0.0, 0.0, 0.0), Pose2(-2.0, 0.5, 0.3)
ENDINGS = {
    EndingKind.DOCKED_BY_DISTANCE: {},
    EndingKind.ALREADY_DOCKED: {"start": AT_DOCK, "before": signal},
    EndingKind.UNDOCKED: {"start": AT_DOCK, "task": "undock"},
    EndingKind.NOT_DOCKED: {"task": "undock", "use_detections": False},
    EndingKind.FAILED_TO_STAGE: {"start": AFAR, **NO_WAY},
    EndingKind.FAILED_TO_DETECT_DOCK: {"before": lose},
    EndingKind.FAILED_TO_CONTROL: {"planning": StraightPlanning(0.7, most=1), "max_retries": 0},
    EndingKind.FAILED_TO_CHARGE: {"wait_for_charge": True, "max_retries": 0},
    EndingKind.TIMEOUT: {"timeout": 0.4},
    EndingKind.UNKNOWN: {"before": blind},
}


@pytest.mark.parametrize("kind", ENDINGS, ids=lambda kind: kind.name)
def test_every_ending_at_rest(kind, lawful):
    given_ = dict(ENDINGS[kind])
    chosen = {name: given_.pop(name) for name in list(given_) if name in ExecutorSettings.model_fields}
    world = perfect(given_.pop("start", AHEAD))
    docking = run(world, problem_with(), ExecutorSettings(**(QUICK | chosen)), rate=10.0, **given_)
    ending = lawful(docking)
    assert ending.kind is kind, ending
    assert docking.steps[-1].state is State.ENDED
    codes = {"FAILED_TO_STAGE": 903, "FAILED_TO_DETECT_DOCK": 904, "FAILED_TO_CONTROL": 905, "FAILED_TO_CHARGE": 906}
    assert kind.code == (codes | {"TIMEOUT": 907, "UNKNOWN": 999}).get(kind.name, 0)
    assert kind.succeeded == (kind.code == 0)


def test_every_ending_is_tested():
    elsewhere = {EndingKind.DOCKED_BY_STALL, EndingKind.DOCKED_BY_SIGNAL, EndingKind.CANCELLED}
    assert set(ENDINGS) | elsewhere == set(EndingKind)


# How to come to each state.
WAYS = {
    State.STAGING: {"start": AFAR},
    State.PERCEIVING: {},
    State.PLANNING: {},
    State.APPROACHING: {},
    State.PRESSING: {"contact": "touch", "station": Station(depth=0.02), "max_retries": 0},
    State.WAITING_FOR_CHARGE: {"wait_for_charge": True},
    State.WAITING_FOR_OBSTACLE: {**NO_WAY, "obstacle_patience": 1.0},
    State.WAITING_FOR_POSE: {"before": blind},
    State.BACKING_OUT: {"start": Pose2(0.002, 0.0, 0.0), "task": "undock"},
    State.RETURNING: {"wait_for_charge": True, "wait_charge_timeout": 0.1},
    State.UNDOCKING: {"start": AT_DOCK, "task": "undock"},
    State.STOPPING: {"start_twist": Twist2(0.2)},
}


@pytest.mark.parametrize("state", WAYS, ids=lambda state: state.name)
def test_cancel_in_every_state(state, lawful):
    way = dict(WAYS[state])
    chosen = {name: way.pop(name) for name in list(way) if name in ExecutorSettings.model_fields}
    world = perfect(way.pop("start", AHEAD), station=way.pop("station", None), start_twist=way.pop("start_twist", None))
    also, seen = way.pop("before", None), []

    def before(executor, world, measurements):
        if executor.state is state:
            seen.append(state)
            executor.cancel()
        return also(executor, world, measurements) if also else None

    docking = run(world, problem_with(), ExecutorSettings(**(QUICK | chosen)), rate=10.0, before=before, **way)
    ending = lawful(docking, touch=0.02)
    assert seen
    assert ending.kind is EndingKind.CANCELLED
    assert world.time - ending.stamp < 0.2


class Recording(StraightPlanning):
    """Keeps its jobs."""

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.jobs = []

    def submit(self, job):
        self.jobs.append(job)
        super().submit(job)


@pytest.mark.parametrize("state", [State.STAGING, State.RETURNING, State.UNDOCKING], ids=lambda state: state.name)
def test_station_is_an_obstacle_for_staging_poses(state):
    """With the full clearance, as nothing is touched at that pose."""
    way = dict(WAYS[state])
    start, task = way.pop("start", AHEAD), way.pop("task", "dock")
    post = ObstacleSet.from_polygons([[[-1.0, 2.0], [-0.8, 2.0], [-0.8, 2.2], [-1.0, 2.2]]])
    problem = dataclasses.replace(problem_with(obstacles=post), clearance=ClearanceRule(0.03, 0.0, 0.4))
    planning, asked = Recording(), []

    def before(executor, world, measurements):
        if executor.state is state:  # its way has been planned
            asked.append(planning.jobs[-1].problem)
            executor.cancel()

    chosen = ExecutorSettings(**(QUICK | way))
    run(perfect(start), problem, chosen, rate=10.0, task=task, before=before, planning=planning)
    assert asked
    obstacles = asked[0].all_obstacles
    assert asked[0].goal.x < -0.6, "the staging pose, not the docked one"
    assert pose_clearance(Pose2(0.5, 0.0, 0.0), ROBOT.footprint, obstacles)[0] < -0.1, "inside the station"
    assert pose_clearance(Pose2(-0.9, 2.1, 0.0), ROBOT.footprint, obstacles)[0] < 0.0, "inside the post"
    rule = asked[0].clearance
    assert rule.required == rule.at_dock == 0.03


def test_station_is_an_obstacle_at_its_detected_pose():
    """The stored dock is 20 cm to the left."""
    planning, asked, stored = Recording(), [], Pose2(0.0, 0.2, 0.0)

    def before(executor, world, measurements):
        if executor.state is State.RETURNING:
            asked.append(planning.jobs[-1].problem)
            executor.cancel()

    chosen = ExecutorSettings(**(QUICK | {"wait_for_charge": True, "wait_charge_timeout": 0.1}))
    run(perfect(), problem_with(stored), chosen, rate=10.0, before=before, planning=planning)
    beside = Pose2(0.45, 0.7, 0.0)
    clearance = {
        place: pose_clearance(beside, ROBOT.footprint, ObstacleSet.from_footprint(STATION, place, "dock"))[0]
        for place in (TRUE_DOCK, stored)
    }
    assert asked
    found = pose_clearance(beside, ROBOT.footprint, asked[0].all_obstacles)[0]
    assert found == pytest.approx(clearance[TRUE_DOCK], abs=5e-3)
    assert clearance[TRUE_DOCK] - clearance[stored] > 0.1


@pytest.mark.parametrize(("sigma", "is_within"), [(0.06, True), (0.04, False)])
def test_range_of_contact_includes_the_uncertainty(sigma, is_within):
    """0.05 m and three standard deviations, 0.2 m before a dock without detections."""
    chosen = ExecutorSettings(**(QUICK | {"stored_position_sigma": sigma, "contact_range": 0.05}))
    for task, kind, before in (
        ("dock", EndingKind.ALREADY_DOCKED, lambda e, w, m: signal(e, w, lose(e, w, m))),
        ("undock", EndingKind.UNDOCKED, lose),
    ):
        world = perfect(Pose2(-0.2, 0.0, 0.0))
        docking = run(world, problem_with(), chosen, rate=10.0, task=task, before=before)
        assert (docking.ending.kind is kind) is is_within, docking.ending


@pytest.mark.parametrize(("offset", "is_near"), [(0.2, True), (0.4, False)])
def test_detected_dock_beyond_max_detection_offset_is_not_driven_to(offset, is_near, lawful):
    chosen = ExecutorSettings(**QUICK, max_detection_offset=0.25, navigate_to_staging_pose=False)
    docking = run(perfect(), problem_with(Pose2(0.0, offset, 0.0)), chosen, rate=10.0, timeout=12.0)
    assert (State.APPROACHING in docking.states) is is_near
    if not is_near:
        ending = lawful(docking)
        assert ending.kind.code == 904
        assert re.search(r"0\.(399|400) m from the stored dock, max_detection_offset is 0\.250 m", ending.reason)


class Refusing(InlinePlanning):
    """Refuses plans to staging poses while `refuses` is set."""

    refuses = False

    def poll(self, stamp):
        result = super().poll(stamp)
        is_away = result is not None and result.motion is not None and result.motion.problem.goal.x < -0.5
        return PlanResult(result.number, Outcome.FAILED, reason="a wall") if is_away and self.refuses else result


@pytest.mark.parametrize("way", ["free", "blocked", "cancelled", "no retries", "timeout"])
def test_robot_returns_to_the_staging_pose_after_the_last_failure(way, lawful):
    """As Nav2's docking server, with a positive `max_retries`; the first failure is the reason."""
    planning, last = Refusing(), []

    def before(executor, world, measurements):
        if executor._procedure.num_retries == chosen["max_retries"] and executor.state is State.WAITING_FOR_CHARGE:
            last.append(world.time)
        planning.refuses = way == "blocked" and bool(last)
        if way == "cancelled" and last and executor.state is State.RETURNING:
            executor.cancel()

    chosen = QUICK | {"wait_for_charge": True, "max_retries": int(way != "no retries"), "staging_distance": 0.8}
    chosen |= {"timeout": 17.0} if way == "timeout" else {}
    docking = run(perfect(), problem_with(), ExecutorSettings(**chosen), rate=10.0, before=before, planning=planning)
    ending = lawful(docking)
    assert ending.kind is (EndingKind.CANCELLED if way == "cancelled" else EndingKind.FAILED_TO_CHARGE)
    assert ending.reason.startswith("while returning" if way == "cancelled" else "no signal for")
    assert ending.num_retries == chosen["max_retries"]
    away = docking.world.state.pose.distance_to(TRUE_DOCK)
    assert (away == pytest.approx(0.8, abs=0.06)) is (way == "free"), away
    assert (away < 0.01) is (way == "no retries"), away
    assert len(docking.said("not returned to a staging pose")) == (way in {"blocked", "timeout"})


def test_plans_that_run_out_of_time_get_twice_the_time_until_one_succeeds():
    class Slow(Recording):
        """Runs out of time five times, and finds no path once."""

        def poll(self, stamp):
            result = super().poll(stamp)
            late = len(self.jobs) != 3
            if result is None or len(self.jobs) > 6:
                return result
            return result._replace(outcome=Outcome.FAILED, motion=None, code=207 if late else 208)

    planning = Slow()
    chosen = ExecutorSettings(**(QUICK | {"time_budget": 1.0, "obstacle_patience": 60.0}))

    def before(executor, world, measurements):
        if len(planning.jobs) == 7:
            world.state = world.state._replace(pose=AHEAD)
        return measurements._replace(held=executor.state is State.APPROACHING)

    run(perfect(), problem_with(), chosen, rate=10.0, before=before, planning=planning, timeout=12.0)
    assert [job.budget for job in planning.jobs[:8]] == [1.0, 2.0, 4.0, 4.0, 8.0, 8.0, 8.0, 1.0]


def stands_at(distance):
    """Stop the robot at this distance before the dock."""

    def before(executor, world, measurements):
        if world.state.pose.x > -distance:
            world.state = world.state._replace(pose=Pose2(-distance, 0.0, 0.0))
            return world.measurements._replace(twist=Twist2(), pose=world.state.pose)
        return None

    return before


@pytest.mark.parametrize(("distance", "kind"), [(0.03, "DOCKED_BY_STALL"), (0.4, "FAILED_TO_CONTROL")])
def test_stall_is_contact_near_the_dock_only(distance, kind):
    chosen = ExecutorSettings(**QUICK, contact="touch", max_retries=0, progress_time=1.0, use_detections=False)
    docking = run(perfect(), problem_with(), chosen, rate=10.0, before=stands_at(distance), planning=StraightPlanning())
    assert docking.ending.kind is EndingKind[kind], docking.ending


@pytest.mark.parametrize("overrun", [0.02, 0.05])
def test_pressing_without_contact_ends_at_the_overrun(overrun, lawful):
    chosen = ExecutorSettings(**QUICK, contact="touch", contact_overrun=overrun, max_retries=0)
    docking = run(perfect(), problem_with(), chosen, rate=16.0, before=deaf, planning=StraightPlanning())
    assert lawful(docking, touch=overrun + 0.01).kind is EndingKind.FAILED_TO_CONTROL
    assert docking.ending.reason.startswith("no contact: ")
    deepest = docking.world.record().poses[:, 0].max()
    assert overrun - 0.005 <= deepest <= overrun + 0.01


def deaf(executor, world, measurements):
    return measurements._replace(contact=None)


@pytest.mark.parametrize("distance", [0.01, 0.13])
def test_backing_out_is_straight_and_limited(distance, lawful):
    """At least by the final straight of the dock; then it plans."""
    chosen = ExecutorSettings(**QUICK, back_out_distance=distance, use_detections=False)
    planning = Recording(reason="a wall")
    start = Pose2(0.04, 0.0, 0.0)
    docking = run(perfect(start), problem_with(), chosen, rate=25.0, task="undock", planning=planning)
    assert lawful(docking, touch=0.05).kind is EndingKind.FAILED_TO_STAGE
    least = max(distance, problem_with().dock.final_straight) + 0.03  # surely out
    assert abs(start.x - docking.world.error.x - least) <= 0.006, "with the way of braking"
    assert np.abs(docking.world.record().poses[:, 2]).max() < 1e-6
    assert planning.jobs


def test_backing_out_stops_before_obstacles_of_the_costmap(lawful):
    """A box 2 mm behind the robot."""
    cells = np.zeros((80, 80), dtype=np.uint8)
    cells[34:46, 33:34] = 254  # x from -0.35 to -0.3 m: the robot's rear is at -0.298 m
    box = ObstacleSet.from_polygons([[[-0.35, -0.3], [-0.3, -0.3], [-0.3, 0.3], [-0.35, 0.3]]])
    world = perfect(Pose2(0.002, 0.0, 0.0))
    world.put(box, Costmap(cells, 0.05, (-2.0, -2.0)))
    planning = StraightPlanning(reason="a wall")
    docking = run(world, problem_with(), ExecutorSettings(**QUICK), rate=25.0, task="undock", planning=planning)
    assert lawful(docking).kind is EndingKind.FAILED_TO_STAGE
    assert docking.said("backing out is blocked")


class Answering(Recording):
    """Answers jobs in motion after `polls` polls, with a takeover `begins` [s] after the job."""

    def __init__(self, polls=1, begins=0.2):
        super().__init__()
        self.polls, self.begins, self.waiting, self.judged = polls, begins, [], []

    def poll(self, stamp):
        job = self.job
        if job is None or job.running is None:
            return super().poll(stamp)
        self.waiting.append(job)
        if len(self.waiting) < self.polls:
            return None
        self.job, self.waiting = None, []
        motion = DrivenMotion(job.running.trajectory, job.problem)
        return PlanResult(job.number, Outcome.NEW, motion, job.time + self.begins)

    def still_holds(self, motion, costmap, from_time):
        self.judged.append((motion, costmap))
        return Verdict(holds=True)


def with_tube(problem):
    return dataclasses.replace(problem, robot=dataclasses.replace(ROBOT, tracking=TrackingTube(0.02, 0.05)))


def staged(planning, before, **chosen):
    """A straight drive to the staging pose with a tube of 2 cm."""
    settings, world = ExecutorSettings(**QUICK, **chosen), perfect(Pose2(-2.0, 0.0, 0.0))
    return run(world, with_tube(problem_with()), settings, rate=16.0, timeout=6.0, before=before, planning=planning)


def push(executor, world, measurements):
    world.state = world.state._replace(pose=world.state.pose @ Pose2(0.0, 0.06, 0.0))


def driving(speed):
    return lambda executor, world: executor.state is State.STAGING and world.state.twist.linear > speed


@pytest.mark.parametrize("pushed", [True, False])
def test_leaving_the_tube_causes_a_plan(pushed):
    """On the way to the staging pose, where no error at the dock causes one."""
    planning = Answering()
    docking = staged(planning, once(driving(0.25), push) if pushed else None)
    assert bool(docking.said("tube left")) is pushed
    assert any(job.running is not None for job in planning.jobs) is pushed


@pytest.mark.parametrize(("begins", "is_late"), [(0.2, False), (-0.2, True)])
def test_late_plan_is_not_driven(begins, is_late):
    """Its reference would jump; another plan is requested."""
    planning = Answering(begins=begins)
    docking = staged(planning, once(driving(0.25), push))
    assert bool(docking.said("plan came too late")) is is_late
    assert len([job for job in planning.jobs if job.running is not None]) > 1


def test_plan_is_checked_against_a_costmap_newer_than_its_job():
    """Both the running and the new motion must be checked against it."""
    planning, newest = Answering(polls=4), Costmap(np.zeros((40, 40), dtype=np.uint8), 0.1, (-2.0, -2.0))
    pushed = once(driving(0.25), push)

    def before(executor, world, measurements):
        pushed(executor, world, measurements)
        return measurements._replace(costmap=newest) if len(planning.waiting) >= 2 else None

    docking = staged(planning, before)
    assert docking.said("plan new")
    motions = [motion for motion, costmap in planning.judged if costmap is newest]
    assert len(motions) == len({id(motion) for motion in motions}) == 2


@pytest.mark.parametrize(("sigma", "stops"), [(0.1, True), (1e-6, False)])
def test_uncertain_dock_is_detected_again(sigma, stops):
    """With inaccurate odometry, long before `detection_patience`."""
    chosen = ExecutorSettings(**QUICK, odometry_sigma=sigma, detection_patience=60.0)
    lost = []

    def before(executor, world, measurements):
        lost.extend([True] if executor.state is State.APPROACHING else [])
        return lose(executor, world, measurements) if lost else None

    docking = run(perfect(), problem_with(), chosen, rate=12.5, before=before, planning=StraightPlanning(), timeout=8.0)
    assert bool(docking.said("detection missing")) is stops


@pytest.mark.parametrize("start", [AHEAD, AFAR])
def test_plan_from_rest_ignores_the_start_state_of_the_problem(start):
    moving = dataclasses.replace(problem_with(), start_speed=0.2, start_acceleration=0.1, start_curvature=0.5)
    planning = Recording()
    run(perfect(start), moving, ExecutorSettings(**QUICK), rate=10.0, timeout=1.5, planning=planning)
    asked = planning.jobs[0].problem
    assert (asked.start_speed, asked.start_acceleration, asked.start_curvature) == (0.0, 0.0, None)


@pytest.mark.parametrize("count", [0, 1, 3])
def test_late_cycles_do_not_change_the_rate_and_are_counted(count):
    """Periods of 0.1 s at a rate of 50 Hz; the first one is reported at once, the number at the end."""
    executor, stamp, events = DockingExecutor(problem_with(), planning=StraightPlanning()), 0.0, []
    for period in (*[0.02] * 20, *[0.1] * count, *[0.02] * 5):
        stamp += period
        events += executor.step(Measurements(stamp, AHEAD)).events
    executor.cancel()
    events += executor.step(Measurements(stamp + 0.02, AHEAD)).events
    assert [event.detail[:7] for event in events if event.name == "late cycle"] == ["0.100 s"] * min(count, 1)
    counted = [event.detail for event in events if event.name == "late cycles"]
    assert counted == ([f"{count}, the longest of 0.100 s"] if count > 1 else [])
    assert events[-1].name == "cancelled"


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_dock_with_either_gear_is_staged_on_the_side_of_the_robot(side):
    problem = problem_with()
    either = dataclasses.replace(problem, dock=dataclasses.replace(problem.dock, direction="auto", footprint=None))
    planning = Recording()
    run(
        perfect(Pose2(2.0 * side, 0.0, 0.0)),
        either,
        ExecutorSettings(**QUICK),
        rate=10.0,
        timeout=1.5,
        planning=planning,
    )
    assert side * planning.jobs[0].problem.goal.x > 0.6


def test_zero_commands_before_the_first_pose_and_after_the_end():
    executor = DockingExecutor(problem_with(), planning=StraightPlanning())
    for k in range(5):
        assert executor.step(Measurements(0.1 * k, None)).command == Twist2()
    executor.cancel()
    steps = [executor.step(Measurements(0.5 + 0.1 * k, Pose2(-1.0, 0.0, 0.0))) for k in range(5)]
    assert steps[-1].ending.kind is EndingKind.CANCELLED
    assert all(step.command == Twist2() for step in steps)


def test_invalid_arguments_are_errors():
    with pytest.raises(InvalidValue, match="task: must be 'dock' or 'undock'"):
        DockingExecutor(problem_with(), task="park")
    with pytest.raises(InvalidValue, match="ExecutorSettings.max_retries: .*greater than or equal to 0"):
        ExecutorSettings(max_retries=-1)
    with pytest.raises(InvalidValue, match="planning.latency: must be >= 0 s, got -1"):
        InlinePlanning(-1.0)
    with pytest.raises(PluginError, match="unknown plugin 'Nobody'"):
        DockingExecutor(problem_with(), controller="Nobody")


poses = st.builds(Pose2, st.floats(-2.0, 0.5), st.floats(-0.6, 0.6), st.floats(-0.8, 0.8))
surprises = st.lists(
    st.tuples(
        st.integers(1, 30),  # cycles until then
        st.sampled_from(["jump", "lost", "outlier", "silence", "back", "contact", "stuck", "fine"]),
        poses,
    ),
    min_size=1,
    max_size=8,
)


@settings(max_examples=3)
@given(script=surprises, rate=st.sampled_from([10.0, 20.0]))
@example(script=[(5, "jump", Pose2(-0.5, 0.3, 0.5)), (10, "back", TRUE_DOCK), (3, "lost", TRUE_DOCK)], rate=20.0)
def test_commands_keep_the_limits_for_any_measurements_and_the_task_ends(script, rate):
    """A perfect robot with scripted sensor faults."""
    chosen = ExecutorSettings(**(QUICK | {"progress_time": 1.0, "dock_approach_timeout": 3.0, "max_retries": 1}))
    executor = DockingExecutor(problem_with(), chosen, planning=StraightPlanning(0.6))
    robot, stamp, lie = Pose2(-0.8, 0.05, 0.0), 0.0, "fine"
    due = [sum(wait for wait, _, _ in script[: k + 1]) for k in range(len(script))]
    offset, stamps, commands, states, twist = Pose2(0.0, 0.0, 0.0), [], [], [], Twist2()
    for k in range(int(90.0 * rate)):
        period = 1.0 / rate
        if k in due:
            _, lie, offset = script[due.index(k)]
            period = 0.9 if lie == "silence" else period
            stamp -= 5.0 if lie == "back" else 0.0
        stamp += period
        pose = None if lie == "lost" else robot
        seen = TRUE_DOCK.in_frame_of(robot)
        pose = offset if lie == "jump" else pose
        seen = offset if lie == "outlier" else seen
        detections = () if lie == "lost" else (Detection(stamp - 0.04, seen, 0.003, 0.005),)
        told = Twist2() if lie == "stuck" else twist
        step = executor.step(Measurements(stamp, pose, told, detections, lie == "contact"))
        stamps.append(stamps[-1] + period if stamps else 0.0)
        commands.append((step.command.linear, step.command.angular))
        states.append(step.state)
        twist = step.command
        if lie != "stuck":
            robot = robot.moved(twist, 1.0 / rate)
        if step.ending is not None:
            break
    assert step.ending is not None, f"still {step.state.value}"
    assert step.command == Twist2()
    # While nothing is measured the drive holds its command: afterwards it changes from rest, as much as in one period.
    silences = [k for k, period in enumerate(np.diff(stamps), 1) if period > 0.5]
    assert all(np.abs(commands[k][0] - commands[k - 1][0]) <= LIMITS.max_deceleration / rate + 1e-9 for k in silences)
    for begin, end in itertools.pairwise([0, *silences, len(stamps)]):
        if end - begin > 2:
            assert_lawful(np.array(stamps[begin:end]), np.array(commands[begin:end]))


def test_planning_in_a_thread(lawful):
    planning = ThreadPlanning()

    def before(executor, world, measurements):
        if executor.state is State.PLANNING:
            time.sleep(0.005)

    docking = run(perfect(Pose2(-0.6, 0.0, 0.0)), problem_with(), before=before, planning=planning)
    assert lawful(docking).kind is EndingKind.DOCKED_BY_DISTANCE
    assert State.PLANNING in docking.states
    with pytest.raises(RuntimeError, match="shutdown"):
        planning.submit(None)


class Broken(StraightPlanning):
    """Planning that raises an exception."""

    def poll(self, stamp):
        raise ZeroDivisionError("oh")


def test_exception_of_a_part_is_the_reason_of_the_ending(lawful):
    docking = run(perfect(), problem_with(), planning=Broken())
    assert lawful(docking).kind is EndingKind.UNKNOWN
    assert docking.ending.reason == "ZeroDivisionError: oh"


class Unproven(InlinePlanning):
    """Straight motions without a certificate, not from a log."""

    def __init__(self):
        super().__init__()
        self.inner = StraightPlanning()

    def submit(self, job):
        self.inner.submit(job)

    def poll(self, stamp):
        return self.inner.poll(stamp)


def test_motion_without_a_certificate_is_not_driven(lawful):
    docking = run(perfect(), problem_with(), ExecutorSettings(**QUICK), planning=Unproven())
    ending = lawful(docking)
    assert ending.kind is EndingKind.UNKNOWN
    assert "a motion that is not certified" in ending.reason
    assert all(step.command == Twist2() for step in docking.steps)
