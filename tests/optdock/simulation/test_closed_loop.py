"""The closed loop: accuracy with errors of drive and sensors, and the reasons of failed runs."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from checkers.axis import AxisGoalChecker
from checkers.dock_goal import DockGoalChecker
from optdock.controllers.tracking_controller import TrackingController
from optdock.errors import InvalidValue
from optdock.geometry.footprint import Footprint
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import Pose2
from optdock.model.dock import Dock
from optdock.model.limits import MotionLimits, SpeedZone
from optdock.model.path import Direction, Path
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from optdock.plugins.interfaces import PluginContext
from optdock.simulation import Actuation, SimulationSettings, pose_errors, run_closed_loop
from optdock.testing.drives import clothoid, cusp_drive, s_curve_drive, straight_drive
from optdock.timing.near_optimal import NearOptimal

START = Pose2(0.4, -0.2, 0.3)
ROBOT = Robot(Footprint.rectangle(0.4, 0.3, 0.5), MotionLimits(max_speed=0.5, max_reverse_speed=0.5))
DRIVES = {
    "straight": straight_drive(START),
    "s curve": s_curve_drive(START),
    "reverse s curve": s_curve_drive(START, Direction.REVERSE),
    "cusp": cusp_drive(START),
}
SLUGGISH = Actuation(linear_lag=0.1, angular_lag=0.1, latency=0.05)


def run(trajectory, settings=None, **parameters):
    settings = settings or SimulationSettings(period=0.04)
    checker = AxisGoalChecker(along_path_tolerance=0.003, cross_track_tolerance=0.02)
    return run_closed_loop(trajectory, ROBOT, trajectory.path.end, TrackingController(**parameters), checker, settings)


@pytest.mark.parametrize("name", DRIVES)
class TestEveryDrive:
    def test_perfect_robot_tracks_to_a_tenth_of_a_millimetre(self, name):
        found = run(DRIVES[name], SimulationSettings())
        assert found.docked, found.reason
        assert np.all(np.abs(found.errors) < 1e-4)
        assert np.hypot(found.final_error.x, found.final_error.y) < 0.003

    def test_recovers_from_an_offset_at_the_start(self, name):
        found = run(DRIVES[name], SimulationSettings(period=0.04, start=START @ Pose2(-0.03, 0.04, 0.1)))
        assert found.docked, found.reason
        assert abs(found.final_error.y) < 0.001
        assert abs(found.final_error.yaw) < math.radians(0.1)


@pytest.mark.parametrize("name", ["reverse s curve", "cusp"])
def test_lag_and_noise_leave_millimetres_with_preview(name):
    world = SimulationSettings(period=0.04, actuation=SLUGGISH, position_noise=0.002, yaw_noise=0.003, seed=4)
    found = run(DRIVES[name], world, preview=0.15)
    assert found.docked, found.reason
    along, cross, _ = np.abs(late(found, DRIVES[name], 0.15)).max(axis=0)
    assert along < 0.015
    assert cross < 0.003
    assert abs(found.final_error.y) < 0.002
    assert abs(found.final_error.yaw) < math.radians(0.4)


@pytest.mark.parametrize(
    ("name", "linear", "angular"),
    [("s curve", 0.93, 1.1), ("cusp", 1.07, 0.9), ("cusp", 0.95, 1.07)],
)
def test_feedback_compensates_gain_errors(name, linear, angular):
    world = SimulationSettings(period=0.04, actuation=Actuation(linear_gain=linear, angular_gain=angular))
    found = run(DRIVES[name], world)
    assert found.docked, found.reason
    assert abs(found.final_error.y) < 0.002
    assert abs(found.final_error.yaw) < math.radians(0.6)


@settings(max_examples=3)
@given(
    st.sampled_from(sorted(DRIVES)),
    st.floats(-0.05, 0.05),
    st.floats(-0.05, 0.05),
    st.floats(-0.15, 0.15),
    st.integers(0, 1000),
)
def test_docks_from_any_small_offset_with_noise(name, along, cross, yaw, seed):
    world = SimulationSettings(
        period=0.04,
        start=START @ Pose2(along, cross, yaw),
        actuation=SLUGGISH,
        position_noise=0.002,
        yaw_noise=0.002,
        seed=seed,
    )
    found = run(DRIVES[name], world)
    assert found.docked, found.reason
    assert abs(found.final_error.y) < 0.006
    assert abs(found.final_error.yaw) < math.radians(1.2)


def test_preview_compensates_the_delay():
    world = SimulationSettings(period=0.04, actuation=SLUGGISH)
    drive = DRIVES["s curve"]
    without, with_preview = (np.abs(late(run(drive, world, preview=p), drive, p)).max(axis=0) for p in (0.0, 0.15))
    assert np.all(with_preview < 0.2 * without)


def late(found, drive, delay):
    """Errors against the trajectory shifted by the delay of the drive, Shape (n, 3)."""
    then = drive.sample_at(found.times - delay)
    return pose_errors(found.poses, np.column_stack((then.x, then.y, then.yaw)))


def overshoot(found):
    """Largest distance beyond the goal in a forward drive [m]."""
    return float(pose_errors(found.poses, np.tile(found.goal.as_array(), (len(found.poses), 1)))[:, 0].max())


def test_unknown_delay_is_estimated_before_the_dock():
    world, drive = SimulationSettings(period=0.04, actuation=SLUGGISH), DRIVES["s curve"]
    at_rest = DockGoalChecker(along_tolerance=0.005, cross_tolerance=0.01)
    found = {
        preview: run_closed_loop(drive, ROBOT, drive.path.end, TrackingController(preview=preview), at_rest, world)
        for preview in (0.0, None)
    }
    assert overshoot(found[0.0]) > 0.02
    assert overshoot(found[None]) < 0.003
    assert found[None].docked


@pytest.mark.parametrize("looks_at_its_room", [True, False])
def test_robot_at_its_largest_speed_brakes_in_time_with_lag(looks_at_its_room, monkeypatch):
    """It cannot catch up, so either the reference waits, or the robot brakes for its goal."""
    if not looks_at_its_room:
        monkeypatch.setattr(TrackingController, "_room", lambda *_: math.inf)
    drive = straight_drive(START)
    robot = Robot(ROBOT.footprint, MotionLimits(max_speed=0.4, max_acceleration=0.4, max_deceleration=0.4))
    problem = DockingProblem(drive.path.start, Dock(drive.path.end), robot)
    found = {}
    for slow_down_lag in (0.05, 0.002):
        controller = TrackingController(slow_down_lag=slow_down_lag)
        controller.configure(PluginContext("controller", None, robot.footprint, problem))
        at_rest, world = DockGoalChecker(along_tolerance=0.03), SimulationSettings(actuation=SLUGGISH)
        found[slow_down_lag] = run_closed_loop(drive, robot, drive.path.end, controller, at_rest, world)
    assert (overshoot(found[0.05]) > 0.001) is not looks_at_its_room
    assert overshoot(found[0.002]) < 0.001
    assert TrackingController().parameters.slow_down_lag == 0.002


@pytest.mark.parametrize("offset", [Pose2(-0.05, 0.05, 0.1), Pose2(0.0, 0.12, 0.0)])
def test_robot_off_its_start_drives_every_gear(offset):
    found = run(DRIVES["cusp"], SimulationSettings(period=0.04, start=START @ offset))
    cusp = DRIVES["cusp"].path.pose_at(DRIVES["cusp"].path.cusps[0])
    assert min(cusp.distance_to(Pose2.from_sequence(pose)) for pose in found.poses) < 0.02
    assert found.docked, found.reason


def test_trajectory_that_begins_in_motion():
    whole = straight_drive(START)
    begun = whole.at(2.0)
    path = Path((clothoid(begun.pose, [0.0, whole.path.length - begun.s], [0.0, 0.0]),))
    rest = NearOptimal().parameterize(path, MotionLimits(), SpeedZone(), start_speed=begun.twist.linear).trajectory
    found = run(rest)
    assert found.docked, found.reason
    assert found.twists[0, 0] == pytest.approx(0.4)
    assert np.all(np.abs(found.errors) < 1e-3)


def test_collision_is_a_fault_of_a_docked_run():
    drive = straight_drive(START)
    side = Pose2.from_sequence(drive.path.poses_at(1.0)[0]) @ Pose2(0.0, 0.28, 0.0)
    faults = []
    for aside in (-0.001, -0.035):
        post = Footprint.rectangle(0.03, 0.03, 0.06)
        obstacles = ObstacleSet.from_footprint(post, side @ Pose2(0.0, aside, 0.0), "post")
        found = run(drive, SimulationSettings(period=0.04, obstacles=obstacles))
        assert found.docked
        assert found.collided is bool(found.fault)
        faults.append(found.fault)
    assert faults[0] == ""
    assert faults[1].startswith("collided: the footprint went 0.03")


def test_reversed_runs_equal_forward_runs():
    there = run(s_curve_drive(Pose2(0.0, 0.0, 0.0)), SimulationSettings(period=0.04, start=Pose2(0.0, 0.03, 0.1)))
    back = run(
        s_curve_drive(Pose2(0.0, 0.0, math.pi), Direction.REVERSE),
        SimulationSettings(period=0.04, start=Pose2(0.0, 0.03, 3.2416)),
    )
    assert there.docked
    assert back.docked
    n = min(len(there.times), len(back.times))
    assert np.allclose(there.poses[:n, :2], back.poses[:n, :2], atol=1e-4)


def test_equal_seeds_give_equal_runs_and_others_differ():
    def commands(seed):
        world = SimulationSettings(position_noise=0.002, yaw_noise=0.002, seed=seed, timeout=1.1)
        return run(DRIVES["straight"], world).commands

    assert np.array_equal(commands(7), commands(7))
    assert not np.array_equal(commands(7)[:50], commands(8)[:50])


def test_shapes_and_periods_of_the_record():
    found = run(DRIVES["straight"], SimulationSettings(position_noise=0.001, seed=1))
    n = len(found.times)
    assert np.allclose(np.diff(found.times), 0.02)
    assert found.poses.shape == found.measured.shape == found.references.shape == found.errors.shape == (n, 3)
    assert found.commands.shape == found.twists.shape == (n, 2)
    assert np.all(found.commands[-1] == 0.0)
    assert 0.0 < np.std(found.measured[:, 0] - found.poses[:, 0]) < 0.002
    assert found.min_clearance is None


def test_clearance_is_that_of_the_true_poses():
    wall = ObstacleSet.from_polygons([[[-1.0, 0.4], [4.0, 0.4], [4.0, 0.6], [-1.0, 0.6]]])
    drive = straight_drive(Pose2(0.0, 0.0, 0.0))
    found = run(drive, SimulationSettings(obstacles=wall, position_noise=0.003, seed=2))
    corners = found.poses[:, 1] + 0.4 * np.sin(found.poses[:, 2]) + 0.25 * np.cos(found.poses[:, 2])
    rear = found.poses[:, 1] - 0.3 * np.sin(found.poses[:, 2]) + 0.25 * np.cos(found.poses[:, 2])
    assert found.min_clearance == pytest.approx(0.4 - max(corners.max(), rear.max()), abs=1e-12)


def test_timeout_is_the_reason_of_an_unfinished_run():
    unreachable = SimulationSettings(timeout=2.0)
    found = run(DRIVES["straight"], unreachable)
    assert not found.docked
    assert found.reason == "timeout: not docked within 2 s"
    assert found.fault == "not docked: timeout: not docked within 2 s"
    assert found.duration == pytest.approx(2.0)


def test_error_of_the_controller_is_the_reason():
    found = run(DRIVES["straight"], SimulationSettings(start=START @ Pose2(0.0, 0.8, 0.0)))
    assert not found.docked
    assert found.reason.startswith("NoValidControl: TrackingController: 0.800 m and 0.000 rad from the reference")
    assert len(found.times) == 1


def test_bad_settings_are_refused():
    with pytest.raises(InvalidValue, match="period"):
        SimulationSettings(period=0.0)
    with pytest.raises(InvalidValue, match="yaw_noise"):
        SimulationSettings(yaw_noise=-1.0)
