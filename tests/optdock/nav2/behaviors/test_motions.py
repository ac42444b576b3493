"""BackUp and DriveOnHeading: error codes, time limits, ramps and the collision check ahead."""

import dataclasses

import numpy as np
import pytest

from optdock.errors import BehaviorException
from optdock.geometry.footprint import Footprint
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import Pose2, Twist2
from optdock.model.cell_obstacles import obstacles_from_costmap
from optdock.model.costmap import Costmap
from optdock.model.dock import Dock
from optdock.model.limits import MotionLimits
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from optdock.nav2.behaviors.drive import BackUp, DriveOnHeading
from optdock.plugins.interfaces import Behavior, BehaviorStatus, CostmapInfoType, PluginContext
from optdock.plugins.registry import create_plugin
from optdock.verification import pose_clearance

ORIGIN = Pose2(0.0, 0.0, 0.0)
BOX = Footprint.rectangle(0.4, 0.3, 0.5)
SUCCEEDED, FAILED, RUNNING = BehaviorStatus.SUCCEEDED, BehaviorStatus.FAILED, BehaviorStatus.RUNNING


class World:
    """A clock, an ideal robot, and obstacles."""

    def __init__(self, *polygons, pose=ORIGIN):
        self.time, self.pose, self.twist = 100.0, pose, Twist2()
        self.obstacles = ObstacleSet.from_polygons(polygons)
        problem = DockingProblem(ORIGIN, Dock(ORIGIN), Robot(BOX, MotionLimits()), self.obstacles)
        self.context = PluginContext(name="test", problem=problem, clock=lambda: self.time)
        self.twists, self.poses = [], [pose]

    def run(self, behavior, command, cycles=400, period=0.1):
        behavior.configure(self.context)
        started = behavior.on_run(command)
        if started.status is not SUCCEEDED:
            return started
        for _ in range(cycles):
            result, self.twist = behavior.on_cycle_update(self.pose, self.twist)
            if result.status is not RUNNING:
                assert self.twist == Twist2()
                return result
            self.pose = self.pose.moved(self.twist, period)
            self.time += period
            self.twists.append(self.twist)
            self.poses.append(self.pose)
        raise AssertionError("the behavior did not end")


def box(x0, y0, x1, y1):
    return [[x0, y0], [x1, y0], [x1, y1], [x0, y1]]


@pytest.mark.parametrize("kind", [BackUp, DriveOnHeading])
def test_a_behavior_is_found_by_nav2s_name_and_needs_the_local_costmap(kind):
    behavior = create_plugin(Behavior, f"nav2_behaviors::{kind.__name__}")
    assert isinstance(behavior, kind)
    assert behavior.resource_info is CostmapInfoType.LOCAL
    with pytest.raises(BehaviorException, match=f"{kind.__name__}: on_run must succeed"):
        behavior.on_cycle_update(ORIGIN, Twist2())


class TestDriveOnHeading:
    def test_it_drives_the_distance_along_its_heading(self):
        world = World(pose=Pose2(1.0, 2.0, 0.7))
        result = world.run(DriveOnHeading(), {"target": 0.8, "speed": 0.3})
        assert result.status is SUCCEEDED
        along = world.pose.in_frame_of(Pose2(1.0, 2.0, 0.7))
        assert along.x == pytest.approx(0.8, abs=0.011)
        assert along.y == pytest.approx(0.0, abs=1e-12)

    def test_speed_ramps_up_and_down_within_its_limits(self):
        world = World()
        limits = {"acceleration_limit": 0.5, "deceleration_limit": -0.5, "minimum_speed": 0.05}
        assert world.run(DriveOnHeading(**limits), {"target": 1.0, "speed": 0.4}).status is SUCCEEDED
        speeds = np.array([0.0] + [twist.linear for twist in world.twists])
        assert np.diff(speeds).max() <= 0.05 + 1e-12
        assert speeds.max() == pytest.approx(0.4)
        assert np.diff(speeds[1:]).min() >= -0.1
        assert speeds[-1] <= 0.1

    def test_both_negative_drives_backwards(self):
        world = World()
        assert world.run(DriveOnHeading(), {"target": -0.4, "speed": -0.2}).status is SUCCEEDED
        assert world.pose.x == pytest.approx(-0.4, abs=0.011)

    @pytest.mark.parametrize(
        "command",
        [{"target": 0.4, "speed": -0.2}, {"target": 0.0, "speed": 0.2}, {"target": 0.4}, {"target": 1.0, "sped": 0.2}],
    )
    def test_invalid_input_is_code_724(self, command):
        result = World().run(DriveOnHeading(), command)
        assert (result.status, result.error_code) == (FAILED, 724)

    def test_too_little_time_is_code_721(self):
        world = World()
        result = world.run(DriveOnHeading(), {"target": 5.0, "speed": 0.2, "time_allowance": 3.0})
        assert (result.status, result.error_code) == (FAILED, 721)
        assert world.time == pytest.approx(103.0, abs=0.11)

    def test_no_allowance_means_no_limit(self):
        result = World().run(DriveOnHeading(), {"target": 4.0, "speed": 0.2, "time_allowance": 0.0})
        assert result.status is SUCCEEDED

    def test_it_stops_before_an_obstacle_with_code_723(self):
        world = World(box(1.5, -0.5, 1.7, 0.5))
        result = world.run(DriveOnHeading(), {"target": 3.0, "speed": 0.3})
        assert (result.status, result.error_code) == (FAILED, 723)
        assert "obstacles[0]" in result.error_msg
        assert 1.1 - 0.3 * 2.0 - 0.04 <= world.pose.x < 1.1 - 0.3 * 1.8

    def test_an_obstacle_behind_the_target_does_not_matter(self):
        world = World(box(1.5, -0.5, 1.7, 0.5))
        assert world.run(DriveOnHeading(), {"target": 1.0, "speed": 0.3}).status is SUCCEEDED
        assert pose_clearance(world.pose, BOX, world.obstacles)[0] >= 0.0

    @pytest.mark.parametrize(
        "polygon",
        [box(0.8, 0.0, 0.8005, 0.0005), box(0.6, 0.2495, 3.0, 0.6), [[0.7, 0.0], [0.71, -0.01], [0.71, 0.01]]],
        ids=["a wire between the samples", "half a millimetre of wall", "smaller than the footprint"],
    )
    def test_obstacles_between_samples_of_the_outline_are_found(self, polygon):
        result = World(polygon).run(DriveOnHeading(), {"target": 3.0, "speed": 0.3})
        assert result.error_code == 723

    def test_the_collision_check_can_be_disabled(self):
        world = World(box(0.6, -0.5, 0.7, 0.5))
        command = {"target": 1.0, "speed": 0.3}
        assert world.run(DriveOnHeading(), command).error_code == 723
        blind = World(box(0.6, -0.5, 0.7, 0.5))
        assert blind.run(DriveOnHeading(), {**command, "disable_collision_checks": True}).status is SUCCEEDED

    def test_without_obstacles_and_footprint_it_is_refused(self):
        behavior = DriveOnHeading()
        result = behavior.on_run({"target": 1.0, "speed": 0.2})
        assert (result.status, result.error_code) == (FAILED, 720)
        assert "disable_collision_checks" in result.error_msg

    def test_a_clearance_is_kept(self):
        wall = box(-5.0, 0.27, 5.0, 0.5)
        assert World(wall).run(DriveOnHeading(clearance=0.01), {"target": 1.0, "speed": 0.3}).status is SUCCEEDED
        tilted = World(wall, pose=Pose2(0.0, 0.0, 0.02))
        assert tilted.run(DriveOnHeading(clearance=0.01), {"target": 1.0, "speed": 0.3}).error_code == 723


class TestBackUp:
    @pytest.mark.parametrize("sign", [-1.0, 1.0])
    def test_it_reverses_for_either_sign(self, sign):
        world = World(box(0.41, -0.5, 0.6, 0.5))
        assert world.run(BackUp(), {"target": sign * 0.3, "speed": 0.1}).status is SUCCEEDED
        assert world.pose.x == pytest.approx(-0.3, abs=0.011)

    def test_it_has_its_own_codes(self):
        assert World().run(BackUp(), {"target": 0.0, "speed": 0.1}).error_code == 713
        assert World().run(BackUp(), {"target": 9.0, "speed": 0.1, "time_allowance": 1.0}).error_code == 711
        assert World(box(-0.5, -0.1, -0.4, 0.1)).run(BackUp(), {"target": 1.0, "speed": 0.1}).error_code == 714
        assert BackUp().on_run({"target": 1.0, "speed": 0.1}).error_code == 710

    def test_a_robot_that_touches_its_dock_can_leave_it(self):
        world = World(box(0.398, -0.5, 0.6, 0.5))
        assert world.run(BackUp(clearance=0.02), {"target": 0.3, "speed": 0.1}).status is SUCCEEDED


def test_a_costmap_and_a_footprint_are_enough():
    data = np.zeros((60, 60), dtype=np.uint8)
    data[25:35, 45] = 254
    costmap = Costmap(data=data, resolution=0.05, origin=(-1.5, -1.5))
    behavior = DriveOnHeading()
    behavior.configure(PluginContext(costmap=costmap, footprint=BOX))
    assert behavior.on_run({"target": 1.0, "speed": 0.2}).status is SUCCEEDED
    result, _ = behavior.on_cycle_update(Pose2(0.1, 0.0, 0.0), Twist2())
    assert (result.error_code, result.error_msg[:21]) == (723, "collision ahead: map ")
    assert behavior.on_run({"target": 0.2, "speed": 0.2}).status is SUCCEEDED
    assert behavior.on_cycle_update(Pose2(0.1, 0.0, 0.0), Twist2())[0].status is RUNNING


def grid(*columns):
    """A map of 3 m x 3 m around the origin with walls across the x axis at these columns of cells."""
    data = np.zeros((60, 60), dtype=np.uint8)
    data[:, list(columns)] = 254
    return Costmap(data=data, resolution=0.05, origin=(-1.5, -1.5))


FREE, WALLS = grid(), grid(10, 45)  # at x = -1 and 0.75 m: within 1 m of the footprint either way


@pytest.mark.parametrize("needs", CostmapInfoType)
def test_the_costmaps_that_a_behavior_needs_are_checked(needs):
    free, problem = FREE, DockingProblem(ORIGIN, Dock(ORIGIN), Robot(BOX, MotionLimits()))

    def outcome(local, around, known=None):
        behavior = type("Asking", (DriveOnHeading,), {"resource_info": needs})()
        world = World()
        world.context = dataclasses.replace(
            world.context, problem=known, costmap=around, local_costmap=local, footprint=BOX
        )
        return world.run(behavior, {"target": 1.0, "speed": 0.3}).error_code

    blocked_by_local = 723 if needs in (CostmapInfoType.LOCAL, CostmapInfoType.BOTH) else 0
    blocked_by_global = 723 if needs in (CostmapInfoType.GLOBAL, CostmapInfoType.BOTH) else 0
    if needs is not CostmapInfoType.NONE:  # which needs something else to check against
        assert outcome(WALLS, free) == blocked_by_local
        assert outcome(free, WALLS) == blocked_by_global
        assert outcome(free, free) == 0
        assert outcome(None, WALLS) == 723  # without a local costmap the global one is used
    assert outcome(WALLS, None, problem) == blocked_by_local
    # The obstacles of the problem are always checked, and the global costmap is one of them.
    in_the_way = dataclasses.replace(problem, obstacles=obstacles_from_costmap(WALLS))
    assert outcome(free, None, in_the_way) == 723
    assert outcome(free, WALLS, problem) == 723


@pytest.mark.parametrize(("kind", "code"), [(BackUp, 713), (DriveOnHeading, 724)])
def test_anything_but_a_command_is_invalid_input(kind, code):
    for command in (None, 3, "target", [("target", 1.0)], {3: 1.0}, {"self": 1}, {"target": "1.0"}):
        result = World().run(kind(), command)
        assert (result.status, result.error_code) == (FAILED, code)
        assert kind.__name__.lower() in result.error_msg.lower() or "test" in result.error_msg
