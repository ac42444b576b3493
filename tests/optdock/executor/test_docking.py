"""Whole tasks in simulation: the robot docks, and every fault ends at rest, with a reason and without a collision."""

import dataclasses
import math

import numpy as np
import pytest

from optdock.errors import InvalidValue
from optdock.executor import DockingExecutor, EndingKind, ExecutorSettings, FeedbackState, InlinePlanning, State
from optdock.executor.log import LogWriter, read_log
from optdock.executor.replay import replay
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import Pose2, Twist2
from optdock.model.camera import Camera
from optdock.model.costmap import Costmap
from optdock.model.dock import Dock, DockTolerances
from optdock.model.problem import DockingProblem
from optdock.plugins.registry import PluginChoice
from optdock.simulation import Actuation, DifferentialDrive, SimulatedRobot, Station, StuckWheel, Wheels

from .conftest import LIMITS, PERFECT, ROBOT, SLUGGISH, TRUE_DOCK, once, problem_with, run, simulated, within

NO_STAGING = ExecutorSettings(navigate_to_staging_pose=False)
CLOSE = Pose2(-0.75, 0.02, 0.0)


def pushed(aside):
    """Push the robot to its left [m]."""

    def act(executor, world, measurements):
        world.state = world.state._replace(pose=world.state.pose @ Pose2(0.0, aside, 0.0))

    return act


class Listening(InlinePlanning):
    """Keeps the jobs."""

    def __init__(self):
        super().__init__()
        self.jobs = []

    def submit(self, job):
        self.jobs.append(job)
        super().submit(job)


def test_noisy_robot_docks_at_a_wrongly_stored_dock(lawful, tmp_path):
    """Late noisy detections, a drive with lag and delay, and a push that requires another plan in motion.

    The replay of the log gives the same commands, bit for bit. Detections move the estimated dock, so planning must get
    the displacement of the running motion.
    """
    push, planning = once(within(0.85), pushed(0.025)), Listening()
    with LogWriter(tmp_path / "docking.log") as log:
        world = simulated(Pose2(-1.5, 0.15, 0.1), seed=1)
        docking = run(world, settings=NO_STAGING, log=log, before=push, planning=planning, rate=20.0)
    assert lawful(docking).kind is EndingKind.DOCKED_BY_DISTANCE
    error = docking.world.error
    assert abs(error.x) <= 0.01
    assert abs(error.y) <= 0.006
    assert abs(error.yaw) <= math.radians(0.8)
    assert docking.said("plan requested")
    assert docking.said("plan new")[1:], "it was planned again on the way"
    assert State.STOPPING not in docking.states[20:-20], "in motion"
    states = [step.feedback.state for step in docking.steps]
    assert {FeedbackState.INITIAL_PERCEPTION, FeedbackState.CONTROLLING} <= set(states)
    again = replay(read_log(tmp_path / "docking.log"))
    assert again.differs_at is None
    assert again.cycles == len(docking.steps)
    in_motion = [job for job in planning.jobs if job.running is not None]
    assert any(job.moved.gap_to(Pose2(0.0, 0.0, 0.0)) > 1e-6 for job in in_motion)
    for job in in_motion:
        assert (job.moved @ job.running.problem.goal).gap_to(job.problem.goal) <= 1e-9


@pytest.mark.parametrize("rate", [10.0, 100.0])
def test_any_rate_docks(rate, lawful):
    docking = run(
        simulated(Pose2(-0.3, 0.0, 0.02), sensors=PERFECT, actuation=Actuation()), problem_with(), NO_STAGING, rate=rate
    )
    assert lawful(docking).kind is EndingKind.DOCKED_BY_DISTANCE
    assert abs(docking.world.error.y) <= 0.002


def test_outlier_and_lost_detections_have_no_effect(lawful):
    def outlier(executor, world, measurements):
        world.dock_sensor.displace_next(Pose2(0.2, 0.22, 0.1))

    outlier = once(within(0.7), outlier)
    lose = once(within(0.5), lambda executor, world, measurements: world.dock_sensor.lose(world.time + 2.0))

    def before(executor, world, measurements):
        outlier(executor, world, measurements)
        lose(executor, world, measurements)

    docking = run(simulated(seed=2), before=before)
    assert lawful(docking).kind is EndingKind.DOCKED_BY_DISTANCE
    assert len(docking.said("detection rejected")) == 1
    assert docking.said("detection lost")
    assert abs(docking.world.error.y) <= 0.006


def grid_with(box):
    """A map of 8 x 6 m, free but for a box."""
    cells = np.zeros((120, 160), dtype=np.uint8)
    x0, y0, x1, y1 = box
    rows = slice(max(0, int((y0 + 3) / 0.05)), int((y1 + 3) / 0.05) + 1)
    cells[rows, int((x0 + 5) / 0.05) : int((x1 + 5) / 0.05) + 1] = 254
    return Costmap(cells, 0.05, (-5.0, -3.0))


def put(half_width, ahead=0.85):
    """An obstacle across the robot's way, so far before its origin; half a metre before its front."""

    def act(executor, world, measurements):
        centre = world.state.pose @ Pose2(ahead, 0.0, 0.0)
        box = centre.x - 0.02, centre.y - half_width, centre.x + 0.02, centre.y + half_width
        corners = [[box[0], box[1]], [box[2], box[1]], [box[2], box[3]], [box[0], box[3]]]
        world.put(ObstacleSet.from_polygons([corners]), grid_with(box))

    return once(lambda executor, world: world.state.twist.linear > 0.3, act)


def put_away(executor, world, measurements):
    """Nothing is left of it once the robot is well aside of the straight way."""
    if world.state.pose.y > 0.6 or world.state.pose.y < -0.3:
        world.put(ObstacleSet.from_polygons([]), grid_with((-5.0, -3.0, -4.99, -2.99)))


def test_obstacle_on_the_path_is_driven_around(lawful):
    docking = run(simulated(Pose2(-2.5, 0.3, 0.0)), settings=NO_STAGING, before=put(0.1), rate=10.0)
    assert lawful(docking).kind is EndingKind.DOCKED_BY_DISTANCE
    assert docking.said("motion no longer valid")


# With the shorter budget the robot stops before the wall, with the longer one it finds a way around it in motion.
@pytest.mark.parametrize("replan_budget", [0.002, 0.5])
@pytest.mark.parametrize("goes", [True, False])
def test_detour_around_a_wall_ends_when_the_wall_has_gone(goes, replan_budget, lawful):
    settings = ExecutorSettings(navigate_to_staging_pose=False, time_budget=4.0, replan_budget=replan_budget)
    build, remove = put(1.9, 1.6), put_away if goes else lambda *_: None

    def before(executor, world, measurements):
        build(executor, world, measurements)
        remove(executor, world, measurements)

    docking = run(simulated(Pose2(-3.0, 0.3, 0.0)), settings=settings, before=before, rate=10.0)
    touch = math.inf if goes else 0.004  # it may drive through the place of the wall
    assert lawful(docking, touch).kind is EndingKind.DOCKED_BY_DISTANCE
    assert len(docking.said("shorter way")) == goes
    assert (docking.times[-1] < 18.0) is goes, docking.times[-1]


@pytest.mark.parametrize(("ahead", "staging"), [(1.7, 2.4), (1.0, 0.8)], ids=["before the wall", "beyond the wall"])
def test_robot_stays_at_rest_while_the_dock_is_blocked(ahead, staging, lawful):
    settings = ExecutorSettings(
        navigate_to_staging_pose=False, obstacle_patience=0.5, time_budget=0.1, staging_distance=staging, max_retries=1
    )
    docking = run(simulated(Pose2(-3.0, 0.3, 0.0)), settings=settings, before=put(4.0, ahead))
    ending = lawful(docking)
    assert (ending.kind, ending.num_retries) == (EndingKind.FAILED_TO_CONTROL, 1)
    assert len(docking.said("no way from a staging pose")) == 1
    assert docking.world.clearance() > 0.05
    assert State.RETURNING not in docking.states
    first = docking.states.index(State.WAITING_FOR_OBSTACLE)
    assert {step.command for step in docking.steps[first:]} == {Twist2()}


class Hanging(InlinePlanning):
    """Gives one plan, and then none any more."""

    def poll(self, stamp):
        """The first result."""
        result = super().poll(stamp) if not hasattr(self, "given") else None
        if result is not None:
            self.given = True
        return result


def test_robot_stops_before_a_new_obstacle_without_a_planner():
    """The costmap comes once."""
    settings = ExecutorSettings(navigate_to_staging_pose=False)
    docking = run(
        simulated(Pose2(-3.0, 0.3, 0.0)), settings=settings, before=put(4.0, 1.6), planning=Hanging(), timeout=8.0
    )
    assert docking.said("obstacle ahead")
    assert docking.world.clearance() > 0.05


@pytest.mark.parametrize("watchdog", [True, False])
def test_after_a_pause_commands_continue_from_the_velocity_of_the_robot(watchdog):
    """During a pause of the process the base stops by its watchdog, or keeps the last command."""
    paused = []

    def pause(executor, world, measurements):
        paused.append(executor.step(measurements).command)
        return world.advance(Twist2() if watchdog else world.last, 1.0)

    moves = once(lambda e, world: world.state.twist.linear > 0.3, pause)
    docking = run(simulated(Pose2(-3.0, 0.3, 0.0)), before=moves, timeout=5.0)
    after = [step for step in docking.steps if any(event.name == "no cycle for long" for event in step.events)]
    assert len(after) == 1
    first = docking.steps.index(after[0])
    commands = [step.command.linear for step in docking.steps[first : first + 5]]
    assert max(commands) < 0.02 if watchdog else min(commands) > 0.2, commands


def test_jump_of_the_localization_has_no_effect_at_the_dock(lawful):

    def act(executor, world, measurements):
        world.pose_sensor.jump(Pose2(0.0, 0.05, 0.0))

    docking = run(simulated(seed=3), before=once(within(0.27), act))
    assert lawful(docking).kind is EndingKind.DOCKED_BY_DISTANCE
    assert docking.said("pose jumped")
    assert abs(docking.world.error.y) <= 0.006


@pytest.mark.parametrize(
    ("start", "settings", "docked"),
    [
        (Pose2(0.002, 0.001, 0.0), {}, True),
        (Pose2(-0.002, 0.001, 0.0), {"use_detections": False}, True),
        (Pose2(-0.03, 0.0, 0.0), {}, False),
        (Pose2(0.0, 0.0, 0.04), {}, False),
        (Pose2(0.0, 0.0, 0.0), {"contact": "touch"}, False),
    ],
)
def test_robot_in_its_dock_is_already_docked(start, settings, docked):
    docking = run(simulated(start, PERFECT), problem_with(), ExecutorSettings(**settings), timeout=3.0)
    ended = docking.ending is not None and docking.ending.kind is EndingKind.ALREADY_DOCKED
    assert ended is docked
    assert not docked or not any(step.command != Twist2() for step in docking.steps)


@pytest.mark.parametrize("distance", [0.6, 0.25])
def test_held_robot_stands_and_continues_when_released(distance, lawful):
    """Longer than any timeout; it is no failure."""
    held = []

    def before(executor, world, measurements):
        if not held and within(distance)(executor, world):
            held.append(world.time)
        return measurements._replace(held=bool(held) and world.time < held[0] + 8.0)

    docking = run(simulated(CLOSE, seed=4), settings=NO_STAGING, before=before, rate=10.0)
    ending = lawful(docking)
    assert ending.kind is EndingKind.DOCKED_BY_DISTANCE
    assert ending.num_retries == 0
    waiting = [step.command for step in docking.steps if step.state is State.HELD]
    assert len(waiting) > 6.0 * 10.0
    assert set(waiting) == {Twist2()}
    assert len(docking.said("held")) == 1


def test_pushed_robot_plans_from_its_place(lawful):
    """An error that cannot be corrected interrupts the motion; the next plan changes the gear."""

    docking = run(simulated(seed=3), before=once(within(0.27), pushed(0.03)))
    ending = lawful(docking)
    assert ending.kind is EndingKind.DOCKED_BY_DISTANCE
    assert docking.said("too far off to correct")
    assert ending.num_retries == 0
    assert State.RETURNING not in docking.states
    assert min(step.command.linear for step in docking.steps) < -0.05
    assert abs(docking.world.error.y) <= 0.006


@pytest.mark.parametrize("deep", [0.005, 0.04])
def test_undocking_from_beyond_the_docked_pose(lawful, deep):
    """By late commands, a yielding bumper or a wrong estimate; backing out must not be blocked."""
    docking = run(simulated(Pose2(deep, 0.0, 0.0), sensors=PERFECT), problem_with(), task="undock")
    assert lawful(docking, touch=deep + 1e-3).kind is EndingKind.UNDOCKED
    assert not docking.said("backing out is blocked")


def test_stuck_wheel_ends_the_task(lawful):
    wheels = Wheels(0.4, stuck=(StuckWheel("left", 1.0),))
    plant = DifferentialDrive(ROBOT, Actuation(0.1, 0.1, 0.06), wheels=wheels)
    settings = ExecutorSettings(
        max_retries=0, dock_approach_timeout=2.0, time_budget=0.1, replanning=False, navigate_to_staging_pose=False
    )
    strict = PluginChoice("TrackingController", {"max_yaw_error": 0.4})
    docking = run(simulated(CLOSE, plant=plant), problem_with(), settings, controller=strict)
    assert lawful(docking).kind is EndingKind.FAILED_TO_CONTROL


def test_late_cycles_and_a_clock_that_goes_back(lawful):
    late = once(within(0.6), lambda executor, world, measurements: world.advance(world.last, 0.1))
    back = once(within(0.4), lambda executor, world, measurements: setattr(world, "back", 1.0))

    def before(executor, world, measurements):
        measurements = late(executor, world, measurements) or measurements
        back(executor, world, measurements)
        ago = getattr(world, "back", 0.0)
        detections = tuple(d._replace(stamp=d.stamp - ago) for d in measurements.detections)
        return measurements._replace(stamp=measurements.stamp - ago, detections=detections)

    docking = run(simulated(CLOSE, sensors=PERFECT), problem_with(), NO_STAGING, before=before)
    assert lawful(docking).kind is EndingKind.DOCKED_BY_DISTANCE
    assert len(docking.said("clock went back")) == len(docking.said("late cycle")) == 1


def test_lost_pose_stops_the_robot_until_it_comes_again(lawful):
    lose = once(within(0.5), lambda executor, world, measurements: setattr(world, "until", world.time + 1.5))

    def before(executor, world, measurements):
        lose(executor, world, measurements)
        return measurements._replace(pose=None, detections=()) if world.time < getattr(world, "until", 0.0) else None

    docking = run(simulated(CLOSE, sensors=PERFECT), problem_with(), NO_STAGING, before=before)
    assert lawful(docking).kind is EndingKind.DOCKED_BY_DISTANCE
    assert State.WAITING_FOR_POSE in docking.states


@pytest.mark.parametrize(
    ("silence", "kind"), [(2.0, EndingKind.DOCKED_BY_DISTANCE), (4.5, EndingKind.FAILED_TO_CONTROL)]
)
def test_old_costmap_stops_the_robot(lawful, silence, kind):
    """Only with `costmap_patience`."""
    empty = Costmap(np.zeros((80, 80), dtype=np.uint8), 0.1, (-4.0, -4.0))
    silent = once(within(0.5), lambda executor, world, measurements: setattr(world, "until", world.time + silence))

    def before(executor, world, measurements):
        silent(executor, world, measurements)
        return measurements if world.time < getattr(world, "until", 0.0) else measurements._replace(costmap=empty)

    settings = ExecutorSettings(costmap_patience=0.4, costmap_timeout=3.0, navigate_to_staging_pose=False)
    docking = run(simulated(CLOSE, sensors=PERFECT), problem_with(), settings, before=before)
    assert lawful(docking).kind is kind
    assert State.WAITING_FOR_COSTMAP in docking.states
    assert docking.said("no costmap")
    still = [step.command == Twist2() for step in docking.steps if step.state is State.WAITING_FOR_COSTMAP]
    assert all(still)
    if silence < 3.0:
        unlimited = run(simulated(CLOSE, sensors=PERFECT), problem_with(), NO_STAGING, before=before, timeout=6.0)
        assert State.WAITING_FOR_COSTMAP not in unlimited.states


def test_contact_by_stall_and_by_signal(lawful):
    """The station stops the robot 8 mm beyond the docked pose."""
    touch = ExecutorSettings(contact="touch")
    start = Pose2(-0.5, 0.0, 0.0)
    deaf = simulated(start, sensors=PERFECT, actuation=Actuation(), station=Station(depth=0.008))
    docking = run(deaf, settings=touch, before=lambda e, w, m: m._replace(contact=None))
    assert lawful(docking, touch=0.009).kind is EndingKind.DOCKED_BY_STALL
    assert State.PRESSING in docking.states
    hearing = simulated(start, sensors=PERFECT, actuation=Actuation(), station=Station(depth=0.008))
    docking = run(hearing, settings=touch)
    assert lawful(docking, touch=0.009).kind is EndingKind.DOCKED_BY_SIGNAL
    assert docking.world.station.touched(docking.world.error)


def test_contact_lost_while_stopping_is_made_again(lawful):
    """The feedback of a late drive moves back as the switch closes."""
    docking = run(simulated(seed=3, station=Station()), settings=ExecutorSettings(contact="touch"), rate=50.0)
    assert lawful(docking).kind is EndingKind.DOCKED_BY_SIGNAL
    assert docking.world.measurements.contact


def test_undocking_out_of_contact(lawful):
    """The robot overlaps the station by the noise of its pose: it backs out straight, then follows a plan."""
    world = simulated(Pose2(0.002, 0.001, 0.002), seed=5)
    docking = run(world, problem_with(), task="undock")
    assert lawful(docking).kind is EndingKind.UNDOCKED
    assert State.BACKING_OUT in docking.states
    assert docking.world.error.x < -0.65
    assert abs(docking.world.error.y) < 0.02


@pytest.mark.parametrize(("tolerance", "driven"), [(0.05, 0.95), (0.9, 0.14)])
def test_undocking_ends_within_its_tolerance_of_the_staging_pose(lawful, tolerance, driven):
    """The robot backs straight out of contact first."""
    settings = ExecutorSettings(undock_linear_tolerance=tolerance)
    docking = run(simulated(TRUE_DOCK, sensors=PERFECT), problem_with(TRUE_DOCK), settings, task="undock")
    assert lawful(docking).kind is EndingKind.UNDOCKED
    assert docking.world.error.x == pytest.approx(-driven, abs=0.02)
    assert not docking.said("staging pose missed")


@pytest.mark.parametrize("speed", [None, 0.16])
@pytest.mark.parametrize("task", ["dock", "undock"])
def test_speeds_above_a_wide_dead_band(task, speed):
    """Slower commands do not move this drive: it would not leave the dock, and its rest would count as contact."""
    limits = dataclasses.replace(LIMITS, max_speed=0.18, max_reverse_speed=0.18)
    robot = dataclasses.replace(ROBOT, limits=limits)
    plant = DifferentialDrive(robot, dataclasses.replace(SLUGGISH, linear_dead_band=0.12))
    world = simulated(CLOSE if task == "dock" else TRUE_DOCK, plant=plant, station=Station(), seed=2)
    problem = problem_with(TRUE_DOCK)
    problem = dataclasses.replace(problem, robot=robot, dock=dataclasses.replace(problem.dock, approach_speed=0.16))
    speeds = {"contact_speed": speed, "back_out_speed": speed} if speed else {}
    settings = ExecutorSettings(contact="touch", max_retries=0, **speeds)
    controller = PluginChoice("TrackingController", {"min_speed": speed or 0.0})
    docking = run(world, problem, settings, rate=20.0, task=task, controller=controller)
    if task == "dock":
        assert docking.ending
        assert (abs(world.error.x) < 0.005) is (speed is not None)
    else:
        assert bool(docking.ending) is (speed is not None)


def test_undocking_fails_outside_its_tolerance():
    settings = ExecutorSettings(undock_linear_tolerance=1e-7)
    docking = run(simulated(TRUE_DOCK), problem_with(TRUE_DOCK), settings, task="undock")
    assert docking.ending.kind is EndingKind.FAILED_TO_STAGE
    assert "staging pose missed" in docking.ending.reason


def test_staging_from_afar(lawful):
    docking = run(simulated(Pose2(-1.5, 0.4, 0.4), sensors=PERFECT), problem_with(TRUE_DOCK), rate=10.0)
    assert lawful(docking).kind is EndingKind.DOCKED_BY_DISTANCE
    assert docking.steps[12].feedback.state is FeedbackState.NAV_TO_STAGING_POSE


def test_turn_at_the_end_corrects_the_heading():
    """Rotated by 4 degrees during a turn in the dock."""

    def turned(executor, world, measurements):
        world.state = world.state._replace(pose=world.state.pose @ Pose2(0.0, 0.0, -0.07))

    robot = dataclasses.replace(ROBOT, turns_in_place=True)
    dock = Dock(TRUE_DOCK, direction="forward", tolerances=DockTolerances(0.01, 0.01, 0.026))
    start = Pose2(0.0, 0.0, 0.6)
    settings = ExecutorSettings(navigate_to_staging_pose=False, use_detections=False)
    world = SimulatedRobot(start=start, dock_pose=TRUE_DOCK, sensors=PERFECT, plant=DifferentialDrive(robot))
    push = once(lambda executor, world: abs(world.error.yaw) < 0.3, turned)
    docking = run(world, DockingProblem(start, dock, robot), settings, before=push)
    assert docking.ending.kind is EndingKind.DOCKED_BY_DISTANCE
    assert len(docking.said("plan new")) == 1
    assert not docking.said("too far off to correct")


def seen_ahead(executor, world, measurements):
    """Keep the detections of a front camera, within 30 degrees of straight ahead."""
    ahead = [one for one in measurements.detections if abs(math.atan2(one.pose.y, one.pose.x)) < math.radians(30.0)]
    return measurements._replace(detections=tuple(ahead))


@pytest.mark.parametrize(("turns", "knows_camera"), [(1, False), (0, True)])
def test_robot_turns_to_detect_a_dock_in_reverse_with_a_front_camera(turns, knows_camera, lawful):
    """It backs in by odometry; full turns of the heading have no effect.

    With a known camera it does not try to detect the dock from a pose without a view of it.
    """
    problem = problem_with()
    dock = dataclasses.replace(problem.dock, pose=TRUE_DOCK, direction="backward", footprint=None)
    problem = dataclasses.replace(problem, dock=dock)
    if knows_camera:
        robot = dataclasses.replace(ROBOT, camera=Camera(Pose2(0.0, 0.0, 0.0), math.radians(60.0), max_range=3.0))
        problem = dataclasses.replace(problem, robot=robot, dock=dataclasses.replace(dock, marker=(0.0, 0.0)))
    start = Pose2(0.75, 0.05, 0.1 + 2.0 * math.pi * turns)
    sigmas = {"odometry_sigma": 0.002, "odometry_scale_sigma": 0.001, "odometry_drift_sigma": 0.001}
    chosen = ExecutorSettings(
        **sigmas, odometry_yaw_sigma=0.002, odometry_straight_yaw_sigma=0.003, initial_perception_timeout=1.0
    )
    world = SimulatedRobot(start=start, dock_pose=TRUE_DOCK, sensors=PERFECT, plant=DifferentialDrive(ROBOT, SLUGGISH))
    docking = run(world, problem, chosen, before=seen_ahead, rate=10.0)
    assert lawful(docking).kind is EndingKind.DOCKED_BY_DISTANCE, docking.ending
    assert bool(docking.said("dock not seen from here")) is not knows_camera
    assert max(abs(world.error.x), abs(world.error.y)) < 0.01
    assert abs(math.remainder(world.error.yaw, 2.0 * math.pi)) < math.radians(1.0)
    assert docking.ending.num_retries == 0


def test_robot_stopped_in_its_dock_is_docked():
    """No plan begins in contact; the robot must not back out."""
    stop = once(
        within(0.006), lambda executor, world, measurements: measurements._replace(stamp=measurements.stamp + 5.0)
    )
    world = simulated(Pose2(-0.6, 0.0, 0.0), PERFECT, Actuation())
    docking = run(world, problem_with(), NO_STAGING, before=stop, rate=25.0)
    assert docking.said("no cycle for long")
    assert docking.ending.kind is EndingKind.DOCKED_BY_DISTANCE
    assert len(docking.said("plan new")) == 1
    assert docking.ending.num_retries == 0


def test_takeover_in_motion_continues_from_the_last_command(tmp_path):
    """Independently of a late odometry; in a replay as well."""
    last = Twist2(0.3, 0.1)
    with LogWriter(tmp_path / "taken_over.log") as log:
        executor = DockingExecutor(problem_with(), NO_STAGING, last_command=last, log=log)
        world = simulated(Pose2(-1.2, 0.0, 0.0), PERFECT, Actuation())
        measurements, commands = world.measurements._replace(twist=Twist2(0.1, 0.0)), [last]
        for _ in range(40):
            commands.append(executor.step(measurements).command)
            measurements = world.advance(commands[-1], 0.04)
    assert commands[1] == last
    speeds = np.array([command.linear for command in commands])
    assert np.abs(np.diff(speeds, 2)).max() <= LIMITS.max_jerk * 0.04**2 + 1e-9
    assert speeds.min() == 0.0, "it stops before it plans"
    assert replay(read_log(tmp_path / "taken_over.log")).differs_at is None
    with pytest.raises(InvalidValue, match="last_command: must be a Twist2"):
        DockingExecutor(problem_with(), last_command=(0.3, 0.1))


@pytest.mark.parametrize("seen", [True, False])
def test_detections_replace_a_lost_localization(seen, lawful):
    """Over a metre at most; without detections the robot waits for a pose."""

    def lost(executor, world, measurements):
        near = world.error.x > -0.6
        detections = measurements.detections if seen or not near else ()
        return measurements._replace(pose=None if near else measurements.pose, detections=detections)

    docking = run(simulated(Pose2(-0.9, 0.0, 0.0), seed=3), problem_with(), NO_STAGING, before=lost)
    kind = lawful(docking).kind
    assert kind is (EndingKind.DOCKED_BY_DISTANCE if seen else EndingKind.UNKNOWN)
    assert bool(docking.said("no pose")) is not seen


def test_robot_slows_down_for_a_hidden_dock(lawful):
    """The dock is hidden for 1.5 s; some distance is left when it is detected again."""
    hidden, left = [], []

    def walks_by(executor, world, measurements):
        if not hidden and within(0.2)(executor, world):
            hidden.append(world.time)
        if not hidden or world.time > hidden[0] + 1.5:
            return None
        left.append(-world.error.x)
        return measurements._replace(detections=())

    world = simulated(Pose2(-0.7, 0.02, 0.0), seed=3)
    docking = run(world, problem_with(), NO_STAGING, before=walks_by, rate=25.0)
    assert lawful(docking).kind is EndingKind.DOCKED_BY_DISTANCE
    assert docking.said("dock hidden")
    assert left[-1] > 0.015
    before_end = docking.states[: docking.states.index(State.STOPPING, docking.states.index(State.APPROACHING))]
    assert docking.times[len(before_end)] > hidden[0] + 1.5, "it does not stop for that"
    assert docking.ending.num_retries == 0


@pytest.mark.parametrize("held", [False, True])
def test_heading_error_in_the_dock_is_corrected_in_place(held, lawful):
    """An error of 1.3 degrees, within the tolerance; a robot held during the correction is docked as well."""

    def slip(executor, world, measurements):
        world.state = world.state._replace(pose=world.state.pose @ Pose2(0.0, 0.0, math.radians(1.3)))

    slips, held_at = once(within(0.012), slip), []

    def before(executor, world, measurements):
        slips(executor, world, measurements)
        last = getattr(world, "last", Twist2())
        if held and (held_at or (last.linear == 0.0 and last.angular != 0.0)):
            held_at.append(world.time)
        return measurements._replace(held=bool(held_at) and world.time < held_at[0] + 1.0)

    start = Pose2(-0.6, 0.0, 0.0)
    world = simulated(start, PERFECT, Actuation(), station=Station())
    docking = run(world, problem_with(), NO_STAGING, before=before, rate=25.0)
    assert lawful(docking, touch=0.008).kind is EndingKind.DOCKED_BY_SIGNAL
    assert bool(docking.said("nudged")) is not held
    assert bool(held_at) is held
    assert abs(docking.world.error.yaw) < math.radians(1.4 if held else 0.2)
    assert State.BACKING_OUT not in docking.states
    assert max(abs(docking.world.error.x), abs(docking.world.error.y)) < 0.005


def test_contact_made_again_with_a_heading_error_is_not_docked(lawful):
    """The robot is rotated by 4 degrees as the contact opens; it presses on and is confirmed again."""

    def turned(executor, world, measurements):
        world.state = world.state._replace(pose=world.state.pose @ Pose2(-0.002, 0.0, math.radians(4.0)))
        return measurements._replace(contact=False)

    opens = once(lambda executor, world: executor.state is State.STOPPING and world.measurements.contact, turned)
    lost = []

    def before(executor, world, measurements):
        found = opens(executor, world, measurements)
        lost.extend([world.time] if found else [])
        is_lost = bool(lost) and world.time < lost[0] + 0.5
        return measurements._replace(contact=False) if is_lost else found

    station = Station(depth=0.0)
    world = simulated(Pose2(-0.6, 0.0, 0.0), PERFECT, Actuation(), station=station)
    docking = run(world, problem_with(), NO_STAGING, before=before)
    assert docking.said("contact lost again")
    assert docking.ending.kind.succeeded
    assert abs(world.error.yaw) <= math.radians(1.5)
