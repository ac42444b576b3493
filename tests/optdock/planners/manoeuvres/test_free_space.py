"""What the distance field decides is what exact distances say."""

import dataclasses
import math

import numpy as np
import pytest

from optdock.geometry.footprint import Footprint
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import Pose2
from optdock.kernels import using_kernels
from optdock.model.clearance_rule import ClearanceRule
from optdock.model.dock import Dock
from optdock.model.limits import MotionLimits
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from optdock.planners.manoeuvres import free_space
from optdock.planners.manoeuvres.distance_field import DistanceField
from optdock.planners.manoeuvres.free_space import FreeSpace
from optdock.verification import pose_clearances

BENT = np.array([[-0.4, -0.3], [0.5, -0.3], [0.5, 0.1], [0.1, 0.1], [0.1, 0.4], [-0.4, 0.4]])
POINT = Footprint(np.array([[-1e-6, -1e-6], [1e-6, -1e-6], [0.0, 1e-6]]))


def never():
    pass


def scene(seed, footprint):
    draw = np.random.default_rng(seed)
    polygons = []
    for middle in draw.uniform(-4.0, 4.0, (14, 2)):
        angles = np.sort(draw.uniform(0.0, 2.0 * np.pi, 6))
        polygons.append(middle + draw.uniform(0.1, 0.6) * np.column_stack((np.cos(angles), np.sin(angles))))
    low = draw.uniform(-4.0, 4.0, (10, 2))
    boxes = ObstacleSet.from_rectangles(low, low + draw.uniform(0.05, 0.5, (10, 2)), "boxes")
    obstacles = ObstacleSet.from_polygons(polygons) + boxes
    robot = Robot(footprint, MotionLimits(max_curvature=1.5, max_curvature_rate=6.0))
    rule = ClearanceRule(0.05, 0.0, 0.5)
    return DockingProblem(Pose2(-3.0, 0.5, 0.2), Dock(Pose2(3.0, 0.0, 0.0)), robot, obstacles, rule)


def poses_around(seed, count=3000):
    draw = np.random.default_rng(seed)
    return np.column_stack((draw.uniform(-5.0, 5.0, (count, 2)), draw.uniform(-np.pi, np.pi, count)))


@pytest.mark.parametrize("footprint", [Footprint.rectangle(0.5, 0.4, 0.6), Footprint(BENT)], ids=["box", "bent"])
@pytest.mark.parametrize("margin", [0.0, 0.04])
def test_free_is_what_keeps_the_required_clearance(footprint, margin):
    problem = scene(1, footprint)
    space = FreeSpace(problem, never)
    poses = poses_around(2)
    exact, _ = pose_clearances(poses, footprint, problem.all_obstacles)
    required = space.required(poses, margin, 0.0)
    decided = np.abs(exact - required) > 1e-5
    assert 0.2 < np.mean(exact >= required) < 0.8
    assert np.array_equal(space.is_free(poses, margin)[decided], (exact >= required)[decided])


def test_coarse_check_accepts_every_free_pose():
    problem = scene(3, Footprint(BENT))
    space = FreeSpace(problem, never)
    poses = poses_around(4)
    quick, free = space.may_be_free(poses), space.is_free(poses)
    assert not np.any(free & ~quick)
    assert np.sum(~quick) > 0.3 * np.sum(~free)


def test_bounds_of_the_field_hold_and_are_close():
    problem = scene(5, Footprint.rectangle(0.5, 0.4, 0.6))
    field = DistanceField(problem.all_obstacles, np.array([0.0, 0.0, 9.0]), 0.05, 1.0, never)
    points = np.random.default_rng(6).uniform(-4.0, 4.0, (500, 2))
    lower, upper = field.bounds(points)
    at = np.column_stack((points, np.zeros(500)))
    exact, _ = pose_clearances(at, POINT, problem.all_obstacles)
    near = exact < 0.9
    assert np.all(lower[near] <= exact[near] + 1e-5)
    assert np.all(upper[near & (exact > 0.0)] >= exact[near & (exact > 0.0)] - 1e-5)
    assert np.all(upper - lower <= 0.05 * math.sqrt(2.0) + 1e-12)
    assert np.all(np.isneginf(field.bounds(np.array([[50.0, 0.0]]))[0]))


def test_margin_tapers_at_both_ends():
    problem = scene(1, Footprint.rectangle(0.5, 0.4, 0.6))
    space = FreeSpace(problem, never)
    poses = poses_around(7, 400)
    plain, kept = space.required(poses, 0.0, 0.0), space.required(poses, 0.1, 0.0)
    assert np.all(kept >= plain)
    assert np.all(kept <= plain + 0.1 + 1e-12)
    ends = np.stack((problem.start.as_array(), problem.goal.as_array()))
    assert space.is_free(ends, 0.1).tolist() == space.is_free(ends).tolist()


def test_ways_for_a_disc_go_around_walls_and_never_too_far():
    wall = np.array([[-0.1, -3.0], [0.1, -3.0], [0.1, 3.0], [-0.1, 3.0]])
    robot = Robot(Footprint.from_radius(0.25), MotionLimits(max_curvature=2.0))
    problem = DockingProblem(Pose2(-1.0, 0.0, 0.0), Dock(Pose2(1.0, 0.0, 0.0)), robot, [wall])
    wavefront = FreeSpace(problem, never).wavefront(np.array([-1.0, 0.0]))
    inside, beside, behind = wavefront.lengths(np.array([[-0.1, 0.0], [-1.0, 2.0], [1.0, 0.0]]))
    assert np.isinf(inside) or inside > 1.0
    assert 1.8 <= beside <= 2.0
    around = 2.0 * math.hypot(1.0, 3.25)
    assert 0.85 * around <= behind <= around
    walls = [
        wall,
        wall - (3.0, 0.0),
        wall[:, ::-1] * (0.55, 1.0) + (-1.5, 3.0),
        wall[:, ::-1] * (0.55, 1.0) + (-1.5, -3.0),
    ]
    shut = FreeSpace(dataclasses.replace(problem, obstacles=ObstacleSet.of(walls)), never)
    assert np.isinf(shut.wavefront(np.array([-1.0, 0.0])).lengths(np.array([[1.0, 0.0]]))[0])


def test_pieces_of_a_check_are_smaller_for_many_corners_and_do_not_change_the_result(monkeypatch):
    angles = np.linspace(-math.pi, math.pi, 40, endpoint=False)
    round_one = Footprint(0.4 * np.column_stack((np.cos(angles), 0.7 * np.sin(angles))))
    found, polls = [], []
    for footprint, most in (
        (round_one, 1),
        (round_one, 4000),
        (round_one, 10**9),
        (Footprint.rectangle(0.4, 0.4, 0.56), 4000),
    ):
        monkeypatch.setattr(free_space, "_AT_ONCE", most)
        looks = []
        with using_kernels("native"):
            found.append(
                FreeSpace(scene(1, footprint), lambda looks=looks: looks.append(0)).is_free(poses_around(2), 0.0)
            )
        polls.append(len(looks))
    assert 0.2 < found[0].mean() < 0.8
    assert np.array_equal(found[0], found[1])
    assert np.array_equal(found[1], found[2])
    assert polls[0] > polls[1] > polls[3]
