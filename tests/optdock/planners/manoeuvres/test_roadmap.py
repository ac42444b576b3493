"""The roadmap along a route: what it offers is free, begins and ends where it must; the band finds the middle."""

import dataclasses
import itertools
import math

import numpy as np
import pytest

from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.model.clearance_rule import ClearanceRule
from optdock.model.dock import Dock
from optdock.model.limits import MotionLimits
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from optdock.planners.manoeuvres.disc_routes import elastic_band
from optdock.planners.manoeuvres.free_space import FreeSpace
from optdock.planners.manoeuvres.manoeuvre_planner import Stages
from optdock.verification import pose_clearances

LIMITS = MotionLimits(max_curvature=1.5, max_curvature_rate=6.0)
ROBOT = Robot(Footprint.rectangle(0.45, 0.45, 0.6), LIMITS)
RULE = ClearanceRule(0.05, 0.0, 0.5)


def box(x0, y0, x1, y1):
    return [[x0, y0], [x1, y0], [x1, y1], [x0, y1]]


def bent(mirror=1.0, robot=ROBOT, **start):
    """A corridor of 2.4 m with two corners, from one end to the other."""
    walls = [box(-3.0, -2.2, 11.2, -1.2), box(-3.0, 1.2, 8.8, 2.2), box(11.2, -2.2, 12.2, 7.8)]
    walls += [box(7.8, 1.2, 8.8, 8.8), box(8.8, 11.2, 22.0, 12.2), box(11.2, 7.8, 22.0, 8.8), box(7.8, 8.8, 8.8, 12.2)]
    walls += [box(-4.0, -2.2, -3.0, 2.2), box(22.0, 7.8, 23.0, 12.2)]
    scale = np.array([1.0, mirror])
    pose = Pose2(0.0, 0.0, start.pop("yaw", 0.0) * mirror)
    dock = Dock(Pose2(19.0, 10.0 * mirror, 0.0), direction="forward", final_straight=0.3)
    obstacles = [np.array(wall) * scale for wall in walls]
    return DockingProblem(pose, dock, robot, obstacles, RULE, **start)


def offered(problem, most=2):
    stages = Stages(problem, 1.25, lambda: None, lambda: math.inf)
    return [guess.path for guess in itertools.islice(stages._along_routes(), most)]


def test_every_way_is_free_and_leads_from_the_start_into_the_dock_also_mirrored():
    problems = bent(1.0, yaw=1.0), bent(-1.0, yaw=1.0)
    first, second = ways = [offered(problem, most) for problem, most in zip(problems, (2, 1), strict=True)]
    assert first
    assert first[0].length == pytest.approx(second[0].length, rel=0.02)
    assert len(first[0].cusps) == len(second[0].cusps)
    for problem, path in ((problem, path) for problem, found in zip(problems, ways, strict=True) for path in found):
        assert path.start.distance_to(problem.start) < 1e-9
        assert path.end.distance_to(problem.goal) < 1e-9
        assert int(path.segments[-1].direction) == 1
        poses = path.sample(0.02).poses
        clearance, _ = pose_clearances(poses, ROBOT.footprint, problem.all_obstacles)
        to_goal = np.hypot(*(poses[:, :2] - problem.goal.as_array()[:2]).T)
        assert np.all(clearance >= RULE.near_goal(to_goal) - 1e-6)


def test_robot_in_motion_begins_in_its_gear():
    found = offered(bent(start_speed=-0.3))
    assert found
    assert {int(path.segments[0].direction) for path in found} == {-1}


def test_nothing_is_offered_through_a_gap_that_is_too_narrow():
    problem = bent()
    shut = [box(9.2, 5.0, 11.2, 5.2)]  # 0.4 m are left
    obstacles = [*(np.array(one) for one in problem.obstacles.vertices), *shut]
    assert offered(dataclasses.replace(problem, obstacles=obstacles), most=None) == []


@pytest.mark.parametrize("width", [1.6, 2.4])
def test_band_finds_the_middle_of_a_corridor_and_keeps_its_ends(width):
    half = 0.5 * width
    walls = [box(-2.0, half, 12.0, half + 0.5), box(-2.0, -half - 0.5, 12.0, -half)]
    problem = DockingProblem(Pose2(0.0, 0.0, 0.0), Dock(Pose2(10.0, 0.0, 0.0)), ROBOT, walls, RULE)
    x = np.linspace(0.0, 10.0, 20)
    route = np.column_stack((x, 0.4 * half * np.minimum(1.0, np.minimum(x, 10.0 - x))))
    found = elastic_band(route, FreeSpace(problem, lambda: None), 1.5)
    assert np.array_equal(found[[0, -1]], route[[0, -1]])
    assert np.abs(found[:, 1]).max() < 0.1 * half < np.abs(route[:, 1]).max()


def test_in_the_open_the_band_is_pulled_straight():
    problem = DockingProblem(Pose2(0.0, 0.0, 0.0), Dock(Pose2(3.0, 0.0, 0.0)), ROBOT, [box(0.0, 9.0, 1.0, 9.1)], RULE)
    route = np.column_stack((np.linspace(0.0, 3.0, 7), [0.0, 0.3, 0.5, 0.6, 0.5, 0.3, 0.0]))
    assert np.abs(elastic_band(route, FreeSpace(problem, lambda: None), 0.5)[:, 1]).max() < 0.1
