"""Undock: a certified way out, driven within its certificate, or a true reason why not."""

import dataclasses
import math

import numpy as np
import pytest

from optdock.errors import BehaviorException, CertificationFailed, OptdockError
from optdock.geometry.footprint import Footprint
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import Pose2, Twist2
from optdock.model.camera import Camera
from optdock.model.dock import Dock, DockDirection
from optdock.model.limits import MotionLimits
from optdock.model.path import Path
from optdock.model.problem import ClearanceRule, DockingProblem
from optdock.model.robot import Robot
from optdock.nav2.behaviors.undock import Undock
from optdock.nav2.behaviors.undock_plan import plan_undock, reversed_path
from optdock.planning.pipeline import plan_dock
from optdock.plugins.interfaces import Behavior, BehaviorStatus, CostmapInfoType, PluginContext
from optdock.plugins.registry import create_plugin
from optdock.simulation import DifferentialDrive, executed_clearance
from optdock.testing.drives import cusp_drive, s_curve_drive
from optdock.verification import certify_path

GOAL = Pose2(2.0, 1.0, 0.4)
ROBOT = Robot(Footprint.rectangle(0.4, 0.4, 0.6), MotionLimits(max_curvature=2.0, max_curvature_rate=8.0))
STATION = Footprint(np.array([[0.42, -0.4], [0.6, -0.4], [0.6, 0.4], [0.42, 0.4]]))
SUCCEEDED, FAILED, RUNNING = BehaviorStatus.SUCCEEDED, BehaviorStatus.FAILED, BehaviorStatus.RUNNING


def box(x0, y0, x1, y1):
    """A box in the frame of the docked robot."""
    corners = [GOAL @ Pose2(x, y, 0.0) for x, y in ((x0, y0), (x1, y0), (x1, y1), (x0, y1))]
    return [[p.x, p.y] for p in corners]


def problem(*polygons, direction=DockDirection.FORWARD):
    dock = Dock(GOAL, STATION, direction=direction, final_straight=0.2)
    return DockingProblem(GOAL @ Pose2(-2.0, 0.3, 0.2), dock, ROBOT, ObstacleSet.from_polygons(polygons))


class World:
    """A clock and a perfect robot in the dock."""

    def __init__(self, case, pose=GOAL):
        self.time, self.case = 0.0, case
        self.plant = DifferentialDrive(ROBOT)
        self.state = self.plant.at_rest(pose)
        self.poses = [pose]

    def run(self, behavior, command=None):
        behavior.configure(PluginContext(problem=self.case, clock=lambda: self.time))
        started = behavior.on_run(command or {})
        return started if started.status is FAILED else self.drive(behavior)

    def drive(self, behavior):
        for _ in range(3000):
            result, twist = behavior.on_cycle_update(self.state.pose, self.state.twist)
            if result.status is not RUNNING:
                assert twist == Twist2()
                return result
            self.state = self.plant.step(self.state, twist)
            self.poses.append(self.state.pose)
            self.time += 0.02
        raise AssertionError("undocking did not end")


@pytest.mark.parametrize("make", [s_curve_drive, cusp_drive])
@pytest.mark.parametrize("kind", ["clothoid", "polyline"])
def test_a_reversed_path_holds_the_same_poses_with_gears_and_curvature_turned(make, kind):
    path = make(GOAL).path
    path = path if kind == "clothoid" else Path.from_poses(path.sample(0.05).poses)
    back = reversed_path(path)
    s = np.linspace(1e-6, path.length - 1e-6, 101)
    assert back.length == pytest.approx(path.length, abs=1e-12)
    assert np.allclose(back.poses_at(path.length - s), path.poses_at(s), atol=1e-9)
    assert np.array_equal(back.direction_at(path.length - s), -path.direction_at(s))
    assert np.allclose(back.curvature_at(path.length - s), -path.curvature_at(s), atol=1e-6)
    assert np.allclose(reversed_path(back).poses_at(s), path.poses_at(s), atol=1e-9)


def test_it_plans_back_to_staging_and_drives_there_within_its_clearance():
    case = problem(box(-2.0, 0.36, 0.4, 0.6), box(-2.0, -0.6, 0.4, -0.36))  # a bay 6 cm wider than the robot per side
    world, undock = World(case), Undock()
    assert world.run(undock).status is SUCCEEDED
    staging = GOAL @ Pose2(-0.7, 0.0, 0.0)
    assert undock.plan.certificate.certified
    assert undock.plan.trajectory_certificate.certified
    assert undock.plan.trajectory.path.end.distance_to(staging) < 1e-6
    assert world.state.pose.distance_to(staging) < 0.05
    driven = np.array([pose.as_array() for pose in world.poses])
    assert executed_clearance(ROBOT.footprint, driven, case.all_obstacles) > 0.019


def test_a_dock_entered_backwards_is_left_forwards():
    station = Footprint(STATION.vertices * np.array([-1.0, 1.0]))
    dock = Dock(GOAL, station, direction=DockDirection.BACKWARD, final_straight=0.2)
    case = dataclasses.replace(problem(), dock=dock)
    world = World(case)
    assert world.run(Undock()).status is SUCCEEDED
    assert world.state.pose.in_frame_of(GOAL).x == pytest.approx(0.7, abs=0.05)


def test_an_automatic_direction_takes_the_side_that_is_open():
    case = dataclasses.replace(problem(box(-1.6, -1.0, -0.6, 1.0), direction=DockDirection.AUTO))
    case = dataclasses.replace(case, dock=dataclasses.replace(case.dock, footprint=None))
    assert plan_undock(case).trajectory.path.end.in_frame_of(GOAL).x == pytest.approx(0.7, abs=1e-6)


def test_the_path_driven_into_the_dock_leads_out_again():
    case = problem()
    path = plan_dock(case, time_budget=2.0).path
    world = World(case)
    assert world.run(Undock(), {"path": path}).status is SUCCEEDED
    assert world.state.pose.distance_to(case.start) < 0.05


def test_on_the_way_out_nothing_has_to_be_seen():
    path = plan_dock(problem(), time_budget=2.0).path
    blind = Robot(ROBOT.footprint, ROBOT.limits, camera=Camera(Pose2(0.0, 0.0, math.pi), 0.1))
    dock = dataclasses.replace(problem().dock, marker=(1.0, 0.0), visible_distance=1.0)
    case = dataclasses.replace(problem(), robot=blind, dock=dock)
    assert not certify_path(path, case).certified
    for given in (path, None):
        assert plan_undock(case, given).certificate.certified


def test_an_obstacle_that_came_after_docking_is_a_reason_with_code_903():
    path = plan_dock(problem(), time_budget=2.0).path
    blocked = problem(box(-1.0, -0.1, -0.9, 0.1))
    with pytest.raises(CertificationFailed, match="the footprint overlaps"):
        plan_undock(blocked, path)
    result = World(blocked).run(Undock(), {"path": path})
    assert (result.status, result.error_code) == (FAILED, 903)
    assert "CertificationFailed: the way out is not certified" in result.error_msg


def test_a_blocked_staging_pose_is_named_and_the_first_reason_counts():
    blocked = problem(box(-0.8, -0.2, -0.6, 0.2))
    with pytest.raises(OptdockError, match="the footprint at the start overlaps"):
        plan_undock(blocked)
    assert World(blocked).run(Undock()).error_code == 903


def test_a_robot_carried_away_from_its_path_is_stopped_with_code_905():
    world, undock = World(problem()), Undock()
    undock.configure(PluginContext(problem=world.case, clock=lambda: world.time))
    assert undock.on_run({}).status is SUCCEEDED
    result, _ = undock.on_cycle_update(GOAL, Twist2())
    assert result.status is RUNNING
    world.state = world.plant.at_rest(GOAL @ Pose2(0.0, 0.8, 0.0))
    result = world.drive(undock)
    assert (result.status, result.error_code) == (FAILED, 905)


def test_a_command_that_would_touch_something_is_not_given():
    beside = dataclasses.replace(problem(box(-1.2, 0.31, -0.45, 0.35)), clearance=ClearanceRule(required=0.005))
    world, undock = World(beside), Undock()
    undock.configure(PluginContext(problem=beside, clock=lambda: world.time))
    straight = Path.from_poses([GOAL @ Pose2(-0.7, 0.0, 0.0), GOAL])
    assert undock.on_run({"path": straight}).status is SUCCEEDED
    assert undock.on_cycle_update(GOAL, Twist2())[0].status is RUNNING
    world.state = world.plant.at_rest(GOAL @ Pose2(0.0, 0.006, -0.05))  # its rear points at the obstacle
    result = world.drive(undock)
    assert (result.status, result.error_code) == (FAILED, 905)
    assert result.error_msg.startswith("collision ahead: obstacles[0]")
    driven = np.array([pose.as_array() for pose in world.poses])
    assert executed_clearance(ROBOT.footprint, driven, beside.obstacles) >= 0.0


def test_a_robot_that_is_not_in_the_dock_is_refused():
    result = World(problem(), GOAL @ Pose2(-0.3, 0.0, 0.0)).run(Undock())
    assert (result.status, result.error_code) == (FAILED, 999)
    assert result.error_msg == "the robot is not in the dock but 0.300 m from it"


def test_too_little_time_is_code_907():
    world = World(problem())
    assert world.run(Undock(), {"time_allowance": 1.0}).error_code == 907
    assert world.time == pytest.approx(1.02, abs=0.021)


@pytest.mark.parametrize("command", [{"path": "somewhere"}, {"time": 3.0}, {"time_allowance": -1.0}])
def test_a_command_it_cannot_understand_is_code_999(command):
    assert World(problem()).run(Undock(), command).error_code == 999


def test_without_a_problem_it_cannot_know_the_dock():
    undock = create_plugin(Behavior, "Undock")
    assert undock.resource_info is CostmapInfoType.LOCAL
    assert undock.on_run({}).error_code == 999
    with pytest.raises(BehaviorException, match="on_run must succeed"):
        undock.on_cycle_update(GOAL, Twist2())


def test_a_controller_that_cannot_drive_the_way_out_is_code_905():
    behavior = Undock(controller="GracefulController")  # follows no reverse gear unless told
    result = World(problem()).run(behavior)
    assert (result.status, result.error_code) == (FAILED, 905)
    assert "the path has a reverse gear; set allow_backward" in result.error_msg
    assert behavior.plan is None


def test_another_controller_may_drive_the_way_out():
    case = problem(direction=DockDirection.BACKWARD)
    case = dataclasses.replace(case, dock=dataclasses.replace(case.dock, footprint=None))
    world = World(case)
    behavior = Undock(controller="GracefulController", undock_linear_tolerance=0.3, undock_angular_tolerance=0.5)
    world.run(behavior, {"time_allowance": 10.0})  # the law never rests at a heading of its own: it may time out
    assert behavior.plan is not None
    assert world.state.pose.distance_to(GOAL) > 0.3


def test_a_controller_that_does_not_exist_is_code_999_and_leaves_nothing_behind():
    behavior = Undock(controller="TrackingControler")
    result = World(problem()).run(behavior)
    assert (result.status, result.error_code) == (FAILED, 999)
    assert "did you mean TrackingController" in result.error_msg
    assert behavior.plan is None
    with pytest.raises(BehaviorException):
        behavior.on_cycle_update(GOAL, Twist2())
