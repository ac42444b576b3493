"""`still_holds` where the tube counts, and where nothing is left to drive: yes only where the whole proof says yes."""

import dataclasses

import numpy as np
import pytest

from optdock.costmap.costmap import Costmap
from optdock.dock import Dock
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.limits import MotionLimits
from optdock.obstacles import ObstacleSet
from optdock.pipeline import plan_dock
from optdock.problem import DockingProblem
from optdock.replanning import still_holds
from optdock.robot import Robot, TrackingTube
from optdock.trajectory import Trajectory
from optdock.verification import certify_path

WIDE = TrackingTube(0.4)


def problem_with(tube=None, obstacles=()):
    robot = Robot(
        Footprint.from_radius(0.3),
        MotionLimits(max_curvature=1.5, max_curvature_rate=6.0),
        tracking=tube or TrackingTube(),
    )
    return DockingProblem(Pose2(-3.0, 0.2, 0.0), Dock(Pose2(0.0, 0.0, 0.0)), robot, obstacles)


def post_beside(plan, gap, share=0.5):
    """A small post so far from the left side of a round robot on its path."""
    pose = plan.path.pose_at(share * plan.path.length)
    x, y = (pose @ Pose2(0.0, 0.3 + gap, 0.0)).as_array()[:2]
    return np.array([[x - 0.01, y], [x + 0.01, y], [x + 0.01, y + 0.02], [x - 0.01, y + 0.02]])


PLANS = {tube.cross: plan_dock(problem_with(tube)) for tube in (TrackingTube(), WIDE)}


@pytest.mark.parametrize("gap", [0.02, 0.2, 0.3, 0.38, 0.5])
@pytest.mark.parametrize("cross", PLANS)
def test_the_tube_counts(cross, gap):
    plan = PLANS[cross]
    obstacles = ObstacleSet.of([post_beside(plan, gap)])
    there = dataclasses.replace(plan.problem, obstacles=obstacles)
    assert still_holds(plan, obstacles).holds is certify_path(plan.path, there).certified


def test_a_wider_tube_is_another_rule():
    plan = plan_dock(problem_with(obstacles=[post_beside(PLANS[0.0], 0.2)]))
    wide = dataclasses.replace(plan.problem, robot=problem_with(WIDE).robot)
    found = still_holds(plan, wide)
    assert not found
    assert found.changed == ("clearance",)
    assert not certify_path(plan.path, wide).certified


@pytest.mark.parametrize("beyond", [0.0, 1.0])
def test_where_nothing_is_left_to_drive_the_robot_must_still_be_clear(beyond):
    plan = PLANS[0.0]
    x, y = plan.path.end.x, plan.path.end.y
    time = plan.trajectory.duration + beyond
    on_the_robot = ObstacleSet.of([np.array([[x, y], [x + 0.1, y], [x, y + 0.1]])])
    assert not still_holds(plan, on_the_robot, time)
    cells = np.zeros((100, 100), dtype=np.uint8)
    assert still_holds(plan, Costmap(cells, 0.1, (-5.0, -5.0)), time)
    cells[50, 50] = 254
    assert not still_holds(plan, Costmap(cells, 0.1, (-5.0, -5.0)), time)


@pytest.mark.parametrize("told", ["costmap", "obstacles"])
def test_a_plan_that_was_moved_meets_all_there_is_now(told):
    """Nothing of it is proven, neither against what was there before nor against what is new."""
    plan = PLANS[0.0]
    path = plan.path.moved(Pose2(0.0, 0.02, 0.0))
    moved = dataclasses.replace(plan, path=path, trajectory=Trajectory(path, plan.trajectory.time_law))
    cells = np.zeros((100, 100), dtype=np.uint8)
    cells[50:53, 35] = 254
    costmap = Costmap(cells, 0.1, (-5.0, -5.0))
    box = ObstacleSet.of([np.array([[-1.5, 0.0], [-1.4, 0.0], [-1.4, 0.3], [-1.5, 0.3]])])
    world, free = (costmap, Costmap(0 * cells, 0.1, (-5.0, -5.0))) if told == "costmap" else (box, ObstacleSet.empty())
    assert not still_holds(moved, world)
    assert still_holds(moved, free)
