"""The tube monitor: its shortcuts never decide otherwise than the deviations from the path."""

import math
import shutil

import numpy as np
import pytest

from experiments.fuzz.kinds.kernels import replaced
from optdock.executor.planning import DrivenMotion
from optdock.executor.tube_monitor import TubeMonitor, least_excess
from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2, displacement
from optdock.kernels import using_kernels
from optdock.model.clearance_rule import ClearanceRule
from optdock.model.constant_jerk import TimeLaw
from optdock.model.dock import Dock
from optdock.model.limits import MotionLimits
from optdock.model.path import ClothoidSegment, Path
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot, TrackingTube
from optdock.model.trajectory import Trajectory
from optdock.samples.tube import Tube

needs_compiler = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
LANES = ["twin", pytest.param("native", marks=needs_compiler)]
RULES = [
    ClearanceRule(0.05, 0.0, 0.5),
    ClearanceRule(0.05, 0.0, 0.1, dock_run=0.2),
    ClearanceRule(0.05, 0.0, 0.0, dock_run=0.3),
    ClearanceRule(0.05, 0.05, 0.0),
    ClearanceRule(0.08, 0.02, 0.4, at_start=0.0),
]
ROBOT = Robot(Footprint.rectangle(0.45, 0.45, 0.6), MotionLimits(), tracking=TrackingTube(cross=0.02, yaw=0.03))
BESIDE = [[[0.2, 0.32], [0.6, 0.32], [0.6, 0.4], [0.2, 0.4]]]  # 2 cm beside the robot at the start


def motion_with(rule):
    spline = ClothoidSpline(Pose2(0.0, 0.0, 0.0), [0.0, 0.5, 1.0, 1.5], [0.0, -0.8, 0.5, 0.0])
    path = Path((ClothoidSegment(spline),))
    jerk = path.length / 2.0
    dock, law = Dock(path.end), TimeLaw([1.0, 2.0, 1.0], [jerk, -jerk, jerk])
    return DrivenMotion(Trajectory(path, law), DockingProblem(path.start, dock, ROBOT, BESIDE, rule), None, 0.0)


@pytest.fixture(params=RULES, ids=range(len(RULES)))
def motion(request):
    return motion_with(request.param)


def test_the_least_width_is_below_every_width(motion):
    monitor = TubeMonitor(motion, ROBOT, is_stop=False, report=lambda *_: None)
    path = motion.trajectory.path
    places = np.linspace(0.0, path.length, 2000)
    widths = Tube(path, motion.problem, 0.0).width_at(places)
    least = np.array([monitor._least_width_at(s) for s in places.tolist()])
    assert np.all(least <= widths)
    if motion.problem.clearance.taper > 0.3:
        assert np.quantile(widths - least, 0.9) < 0.003  # otherwise it would decide nothing


def random_poses(motion, count):
    """Poses of the robot near the path, and the arc lengths of the path there."""
    random, path = np.random.default_rng(7), motion.trajectory.path
    places = random.uniform(0.0, path.length, count)
    offsets = random.normal(size=(count, 3)) * random.choice([0.001, 0.01, 0.05], (count, 1))
    return [
        (Pose2(*pose) @ Pose2(*off), s) for pose, off, s in zip(path.poses_at(places), offsets, places, strict=True)
    ]


@pytest.mark.parametrize("lane", LANES)
def test_the_least_excess_is_below_that_of_every_pose_of_the_path(motion, lane):
    monitor = TubeMonitor(motion, ROBOT, is_stop=False, report=lambda *_: None)
    tube, path = Tube(motion.trajectory.path, motion.problem, 0.0), motion.trajectory.path
    places = np.linspace(0.0, path.length, 20_000)
    poses, widths, loose = path.poses_at(places), tube.width_at(places), []
    for robot, _ in random_poses(motion, 30):
        with using_kernels(lane):
            least = least_excess(monitor._samples, (robot.x, robot.y, robot.yaw), monitor._radius)
        off = np.hypot(poses[:, 0] - robot.x, poses[:, 1] - robot.y)
        exact = float(np.min(displacement(off, poses[:, 2] - robot.yaw, monitor._radius) - widths))
        assert least <= exact
        loose.append(exact - least)
    if motion.problem.clearance.taper > 0.3:
        assert np.median(loose) < 0.001  # otherwise it would decide nothing


def test_a_robot_outside_is_compared_with_all_poses_only_if_it_may_have_returned(motion):
    monitor = TubeMonitor(motion, ROBOT, is_stop=False, report=lambda *_: None)
    tube = Tube(motion.trajectory.path, motion.problem, 0.0)
    for robot, s in random_poses(motion, 60):
        if monitor._is_surely_outside(robot, s):
            assert tube.deviations(robot.as_array()[None], near=s, within=0.25).excess[0] > 0.0


@needs_compiler
def test_both_lanes_are_equal_up_to_rounding():
    random = np.random.default_rng(1)
    for _ in range(30):
        samples, pose = random.normal(size=(int(random.integers(2, 40)), 4)), tuple(random.normal(size=3).tolist())
        samples[1] = samples[0]  # a turn in place
        found = []
        for lane in ("twin", "native"):
            with using_kernels(lane):
                found.append(least_excess(samples, pose, 0.4))
        assert found[0] == pytest.approx(found[1], abs=1e-13)
    assert replaced() == ""


def test_the_monitor_reports_where_the_deviations_leave_the_tube(motion):
    told = []
    monitor = TubeMonitor(motion, ROBOT, is_stop=False, report=lambda name, _: told.append(name))
    random, tube, is_outside = np.random.default_rng(2), Tube(motion.trajectory.path, motion.problem, 0.0), False
    for time in np.linspace(0.0, motion.trajectory.duration, 120).tolist():
        on_path = motion.trajectory.at(time).pose
        off = random.choice([0.003, 0.02, 0.05])
        robot = on_path @ Pose2(*random.uniform(-off, off, 2).tolist(), float(random.uniform(-off, off)))
        told.clear()
        monitor.update(robot, time)
        near = motion.trajectory.at(time).s
        found = tube.deviations(robot.as_array()[None], near=near, within=0.25)
        if abs(float(found.excess[0])) > 2e-4:  # the resolution of the search
            assert bool(told) == (bool(found.excess[0] > 0.0) != is_outside)
        is_outside = is_outside != bool(told)


def test_deviations_of_one_pose_and_of_many_are_the_same():
    """One pose is compared with all candidates at once, many poses in two rounds."""
    motion = motion_with(RULES[0])
    tube, random = Tube(motion.trajectory.path, motion.problem, 0.0), np.random.default_rng(4)
    poses = motion.trajectory.path.poses_at(random.uniform(0.0, 1.5, 30)) + random.normal(0.0, 0.01, (30, 3))
    many = tube.deviations(poses)
    for k, pose in enumerate(poses):
        one = tube.deviations(pose[None])
        assert one.excess[0] == pytest.approx(many.excess[k], abs=1e-9)
        assert one.s[0] == pytest.approx(many.s[k], abs=1e-9)
        assert math.hypot(one.along[0], one.cross[0]) <= one.displacement[0] + 1e-12
