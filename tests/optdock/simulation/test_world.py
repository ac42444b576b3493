"""The simulated robot: measurements, record, contact and reproducible noise."""

import math

import numpy as np
import pytest

from checkers.axis import AxisGoalChecker
from optdock.controllers.tracking_controller import TrackingController
from optdock.errors import InvalidValue
from optdock.geometry.footprint import Footprint
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import Pose2, Twist2
from optdock.model.limits import MotionLimits
from optdock.model.robot import Robot
from optdock.simulation import (
    Actuation,
    DifferentialDrive,
    DockSensor,
    Odometry,
    PoseSensor,
    Sensors,
    SimulatedRobot,
    SimulationSettings,
    Station,
    run_closed_loop,
)
from optdock.testing.drives import s_curve_drive

ROBOT = Robot(Footprint.rectangle(0.4, 0.3, 0.5), MotionLimits())
PLANT = DifferentialDrive(ROBOT, Actuation(linear_lag=0.1, latency=0.06))
NOISY = Sensors(PoseSensor(0.005, 0.009), Odometry(linear_sigma=0.01), DockSensor(position_sigma=0.003))
BENT = Twist2(0.2, 0.1)
ORIGIN, AHEAD = Pose2(0.0, 0.0, 0.0), Pose2(-0.5, 0.02, 0.05)
PERIODS = [0.02, 0.05, 0.01, 0.12, 0.033] * 8


def driven(sensors=None, command=BENT, start=AHEAD, periods=PERIODS, **world):
    robot = SimulatedRobot(world.pop("plant", PLANT), start, world.pop("dock", ORIGIN), sensors, **world)
    measured = [robot.measurements, *(robot.advance(command, period) for period in periods)]
    return robot, measured


def test_perfect_sensors_measure_and_record_the_true_state():
    robot, measured = driven()
    record = robot.record()
    assert record.times == pytest.approx(np.cumsum([0.0, *PERIODS]))
    assert [one.stamp for one in measured] == record.times.tolist()
    assert np.array_equal(record.measured, record.poses)
    assert np.array_equal([one.pose.as_array() for one in measured], record.poses)
    assert np.array_equal(record.odometry, record.twists[:, :2])
    assert np.all(record.commands[:-1] == [0.2, 0.1])
    assert measured[-1].detections == ()
    assert measured[-1].contact is None


def test_forget_has_no_effect_on_later_measurements():
    kept, measured = driven(NOISY, seed=3)
    robot, before = driven(NOISY, seed=3, periods=PERIODS[:20])
    robot.forget()
    after = [robot.advance(BENT, period) for period in PERIODS[20:]]
    assert [*before, *after] == measured
    whole, rest = kept.record(), robot.record()
    assert np.array_equal(rest.poses, whole.poses[20:])
    assert np.array_equal(rest.commands, whole.commands[20:])
    assert 0 < len(rest.detections) < len(whole.detections)
    assert rest.detections == whole.detections[-len(rest.detections) :]


def test_equal_seeds_give_equal_runs_and_others_do_not():
    first, again, other = (driven(NOISY, seed=seed)[1] for seed in (3, 3, 4))
    assert first == again
    assert first != other


@pytest.mark.parametrize("left_out", ["pose", "odometry", "dock"])
def test_switching_a_sensor_off_changes_nothing_in_the_others(left_out):
    _, whole = driven(NOISY, seed=7)
    _, found = driven(Sensors(**{name: getattr(NOISY, name) for name in NOISY.__dict__ if name != left_out}), seed=7)
    keys = {"pose": "pose", "odometry": "twist", "dock": "detections"}
    for name, key in keys.items():
        same = [getattr(one, key) for one in whole] == [getattr(one, key) for one in found]
        assert same is (name != left_out)


def test_no_random_number_is_used_by_two_sensors():
    sensors = Sensors(PoseSensor(1.0), Odometry(linear_sigma=1.0), DockSensor(rate=100.0, position_sigma=1.0))
    _, measured = driven(sensors, Twist2(), ORIGIN, [0.01] * 300)
    poses = [value for one in measured for value in (one.pose.x, one.pose.y)]
    detections = [value for one in measured for seen in one.detections for value in (seen.pose.x, seen.pose.y)]
    noises = np.sort(poses + detections + [one.twist.linear for one in measured])
    assert len(noises) > 1400
    assert np.min(np.diff(noises)) > 1e-12


def test_contact_of_the_plant_without_a_station():
    class Touching(DifferentialDrive):
        def step(self, state, command, duration=None):
            return super().step(state, command, duration)._replace(contact=True)

    assert driven(plant=Touching(ROBOT))[1][-1].contact is True


def test_detector_measures_a_moved_dock():
    robot, _ = driven(Sensors(dock=DockSensor(rate=100.0)), dock=Pose2(0.05, 0.02, 0.03))
    robot.dock_pose = Pose2(0.1, 0.0, 0.0)
    robot.advance(Twist2(), round(robot.time + 0.02, 2) - robot.time)
    measured = robot.measurements
    assert (measured.pose @ measured.detections[-1].pose).gap_to(robot.dock_pose) < 1e-9
    assert np.all(robot.record().docks[-2:] == [[0.05, 0.02, 0.03], [0.1, 0.0, 0.0]])


def test_closed_loop_equals_a_loop_over_the_simulated_robot():
    trajectory = s_curve_drive(Pose2(0.4, -0.2, 0.3))
    checker = AxisGoalChecker(along_path_tolerance=0.003, cross_track_tolerance=0.02)
    run = run_closed_loop(
        trajectory,
        ROBOT,
        trajectory.path.end,
        TrackingController(),
        checker,
        SimulationSettings(period=0.04, actuation=PLANT.actuation),
    )
    first, controller = trajectory.at(0.0), TrackingController()
    controller.set_path(trajectory)
    checker.reset()
    robot = SimulatedRobot(PLANT, first.pose, ORIGIN, start_twist=first.twist)
    for _ in range(len(run.times) - 1):
        now = robot.measurements
        command = controller.compute_velocity_commands(now.pose, now.twist, checker, stamp=now.stamp)
        robot.advance(command, 0.04)
    assert robot.record().poses == pytest.approx(run.poses, abs=1e-9)
    assert robot.record().commands == pytest.approx(run.commands, abs=1e-9)


class TestStation:
    @pytest.mark.parametrize(("direction", "sign"), [("forward", 1.0), ("backward", -1.0)])
    def test_stop_and_switch(self, direction, sign):
        start = Pose2(-sign * 0.3, 0.01, 0.02)
        dock = Pose2(3.0, 2.0, 1.0)
        station = Station(direction, depth=0.005)
        robot, measured = driven(None, Twist2(sign * 0.2), dock @ start, [0.02] * 150, dock=dock, station=station)
        along = np.array([Pose2(*row).in_frame_of(dock).x for row in robot.record().poses])
        assert np.max(sign * along) == pytest.approx(0.005, abs=1e-9)
        assert [one.contact for one in measured] == (sign * along > 0.002 - 1e-9).tolist()
        assert measured[-1].contact is True
        assert measured[-1].twist.linear == 0.0
        assert robot.state.twist.linear == 0.0

    def test_odometry_continues_with_slipping_wheels(self):
        robot, measured = driven(None, Twist2(0.2), periods=[0.02] * 200, station=Station(stalls=False))
        assert measured[-1].twist.linear == pytest.approx(0.2)
        assert robot.state.twist.linear == 0.0

    def test_it_can_be_left_again(self):
        robot, _ = driven(None, Twist2(0.2), Pose2(-0.3, 0.0, 0.0), [0.02] * 200, station=Station())
        assert robot.measurements.contact is True
        for _ in range(50):
            robot.advance(Twist2(-0.2), 0.02)
        assert robot.error.x < -0.1
        assert robot.measurements.contact is False

    @pytest.mark.parametrize(
        ("start", "periods", "x"),
        [(Pose2(-0.3, 0.2, 0.0), 150, 0.268), (Pose2(0.1, 0.0, 0.0), 50, 0.268), (Pose2(-0.3, 0.0, 0.15), 150, 0.0)],
        ids=["no stop beside the station", "no stop from behind", "heading error"],
    )
    def test_no_contact(self, start, periods, x):
        robot, measured = driven(None, Twist2(0.2), start, [0.02] * periods, station=Station())
        assert robot.error.x == pytest.approx(x, abs=0.001)
        assert measured[-1].contact is False


def test_clearance_counts_obstacles_from_the_time_of_put():
    wall = ObstacleSet.from_polygons([[[0.6, -1.0], [0.7, -1.0], [0.7, 1.0], [0.6, 1.0]]])
    behind = ObstacleSet.from_polygons([[[-0.9, -1.0], [-0.7, -1.0], [-0.7, 1.0], [-0.9, 1.0]]])
    robot, _ = driven(None, Twist2(0.2), Pose2(-0.5, 0.0, 0.0), [0.02] * 100, obstacles=wall)
    assert robot.clearance() == pytest.approx(0.6 - robot.state.pose.x - 0.4, abs=1e-12)
    robot.put(behind)
    robot.advance(Twist2(), 0.02)
    assert robot.clearance() == pytest.approx(robot.state.pose.x - 0.3 + 0.7, abs=0.005)  # not -0.1, as at the start
    assert SimulatedRobot(PLANT, ORIGIN, ORIGIN).clearance() == math.inf


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: Station("auto"), "station.direction: must be forward or backward, got auto"),
        (lambda: Station(depth=-1.0), "station.depth"),
        (lambda: SimulatedRobot(PLANT, ORIGIN, ORIGIN, seed=-1), "world.seed: must be a whole number >= 0, got -1"),
        (lambda: SimulatedRobot(PLANT, ORIGIN, ORIGIN).advance(Twist2(), 0.0), "plant.duration"),
    ],
)
def test_invalid_values_are_errors(build, message):
    with pytest.raises(InvalidValue, match=message):
        build()
