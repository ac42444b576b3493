"""The tracking tube: what is proven of the path holds for every pose within, and what is outside is seen."""

import dataclasses
import functools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from experiments.dense_check import dense_check
from optdock.errors import InvalidValue, NoMotionExists
from optdock.geometry.footprint import Footprint
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import Pose2
from optdock.model.clearance_rule import ClearanceRule
from optdock.model.dock import Dock
from optdock.model.limits import MotionLimits
from optdock.model.path import Path
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot, TrackingTube
from optdock.planning.pipeline import plan_dock
from optdock.samples.tube import Tube
from optdock.verification import certify_path, pose_clearances

FOOTPRINT = Footprint.rectangle(0.45, 0.45, 0.6)
LIMITS = MotionLimits(max_curvature=1.5, max_curvature_rate=6.0)
RULE = ClearanceRule(0.05, 0.0, 0.5)
POSTS = [[[x, y], [x + 0.1, y], [x + 0.1, y + 0.1], [x, y + 0.1]] for x, y in ((-2.0, 0.45), (-1.1, -0.52), (0.5, 0.1))]


def problem_with(tube, obstacles=POSTS, rule=RULE):
    return DockingProblem(
        Pose2(-3.0, 0.3, 0.1), Dock(Pose2(0.0, 0.0, 0.0)), Robot(FOOTPRINT, LIMITS, tracking=tube), obstacles, rule
    )


def straight_between_walls(gap, tube):
    """A straight drive in the middle of two walls, so far away from the goal that the taper is over."""
    walls = [
        [[-9.0, s * (0.3 + gap)], [9.0, s * (0.3 + gap)], [9.0, s * (0.5 + gap)], [-9.0, s * (0.5 + gap)]]
        for s in (1, -1)
    ]
    problem = DockingProblem(
        Pose2(-3.0, 0.0, 0.0), Dock(Pose2(0.0, 0.0, 0.0)), Robot(FOOTPRINT, LIMITS, tracking=tube), walls, 0.05
    )
    x = np.linspace(-3.0, 0.0, 60)
    return Path.from_poses(np.column_stack((x, 0.0 * x, 0.0 * x))), problem


@settings(max_examples=25)
@given(st.floats(0.0, 0.1), st.floats(0.0, 0.3))
def test_the_width_is_the_farthest_way_of_a_corner(cross, yaw):
    tube = TrackingTube(cross, yaw)
    corners = FOOTPRINT.vertices
    angles = np.linspace(-math.pi, math.pi, 73)
    ways = []
    for turn in (-yaw, 0.3 * yaw, yaw):
        c, s = math.cos(turn), math.sin(turn)
        turned = corners @ np.array([[c, s], [-s, c]])
        for angle in angles:
            moved = turned + cross * np.array([math.cos(angle), math.sin(angle)])
            ways.append(np.hypot(*(moved - corners).T).max())
    assert max(ways) <= tube.width(FOOTPRINT) + 1e-12
    assert max(ways) >= tube.width(FOOTPRINT) * math.cos(math.radians(5.0)) - 1e-12


@pytest.mark.parametrize("values", [(-0.01, 0.0), (math.inf, 0.0), (math.nan, 0.0), (0.0, -0.1), (0.0, 3.2)])
def test_a_tube_that_is_none_is_refused(values):
    with pytest.raises(InvalidValue, match=r"robot\.tracking\.(cross|yaw): must be finite and >= 0"):
        TrackingTube(*values)


@settings(max_examples=20)
@given(st.floats(1e-3, 0.1), st.floats(0.0, 0.1), st.floats(-5e-3, 5e-3))
def test_a_corridor_is_certified_if_and_only_if_the_tube_fits_as_well(cross, yaw, spare):
    tube = TrackingTube(cross, yaw)
    gap = 0.05 + tube.width(FOOTPRINT) + (spare if abs(spare) > 1e-5 else 1e-4)
    path, problem = straight_between_walls(gap, tube)
    # Its end keeps the rule of one number, 0.05 m: the tube tapers with it, and here there is no taper.
    certificate = certify_path(path, problem)
    assert certificate.certified is (gap >= 0.05 + tube.width(FOOTPRINT))
    assert certificate.tube == pytest.approx(tube.width(FOOTPRINT))
    assert dense_check(path, problem, 0.05).ok is certificate.certified
    without = dataclasses.replace(problem, robot=Robot(FOOTPRINT, LIMITS))
    assert certify_path(path, without).certified is (gap >= 0.05)


@settings(max_examples=20)
@given(st.integers(0, 10_000))
def test_every_pose_within_the_tube_keeps_the_clearance(seed):
    problem, plan = planned()
    tube = Tube(plan.path, problem, plan.certificate.start_relief)
    random = np.random.default_rng(seed)
    s = random.uniform(0.0, plan.path.length, 40)
    turns = random.uniform(-1.0, 1.0, 40) * problem.robot.tracking.yaw
    poses = plan.path.poses_at(s)
    widths = tube.width_at(s)
    turns = np.clip(turns, -widths / FOOTPRINT.circumscribed_radius, widths / FOOTPRINT.circumscribed_radius)
    left = widths - 2.0 * FOOTPRINT.circumscribed_radius * np.abs(np.sin(0.5 * turns))
    angle = random.uniform(-math.pi, math.pi, 40)
    off = poses + np.column_stack((left * np.cos(angle), left * np.sin(angle), turns))
    assert np.all(tube.deviations(off).excess <= 2e-4)
    clearances, _ = pose_clearances(off, FOOTPRINT, problem.all_obstacles)
    from_goal = np.hypot(*(poses[:, :2] - [problem.goal.x, problem.goal.y]).T)
    asked = problem.clearance.near_goal(from_goal)
    asked = np.minimum(asked, problem.clearance.near_start(np.hypot(*(poses[:, :2] - poses[0, :2]).T), 1.0))
    assert np.all(clearances >= asked - 1e-6)


@functools.cache
def planned():
    problem = problem_with(TrackingTube(0.02, 0.03))
    return problem, plan_dock(problem)


def test_a_plan_with_a_tube_keeps_away_by_so_much_more_and_tapers_at_the_dock():
    problem, plan = planned()
    width = problem.robot.tracking.width(FOOTPRINT)
    tube = Tube(plan.path, problem)
    assert plan.certificate.tube == pytest.approx(width)
    assert tube.width_at(np.array([0.0, plan.path.length])) == pytest.approx([width, 0.0], abs=1e-8)
    assert dense_check(plan.path, problem, 0.02).ok
    d = np.array([0.1])
    at = plan.path.length - d
    assert tube.width_at(at) == pytest.approx(width * d / 0.5, rel=1e-3)


def test_what_fits_without_a_tube_only_is_refused_by_name():
    walls = [[[-9.0, s * (0.3 + 0.06)], [9.0, s * (0.3 + 0.06)], [9.0, s * 0.5], [-9.0, s * 0.5]] for s in (1, -1)]
    start, dock = Pose2(-3.0, 0.0, 0.0), Dock(Pose2(0.0, 0.0, 0.0))
    narrow = DockingProblem(start, dock, Robot(FOOTPRINT, LIMITS), walls, 0.05)
    assert plan_dock(narrow).certificate.certified
    wide = dataclasses.replace(narrow, robot=Robot(FOOTPRINT, LIMITS, tracking=TrackingTube(0.02)))
    with pytest.raises(NoMotionExists, match=r"0\.02 m too wide .* clearance"):
        plan_dock(wide, time_budget=30.0)


def test_the_start_relief_leaves_no_tube_where_nothing_is_to_spare():
    wall = [[-5.0, 0.64], [9.0, 0.64], [9.0, 0.8], [-5.0, 0.8]]
    problem = problem_with(TrackingTube(0.02), [wall])
    problem = problem.starting_at(Pose2(-3.0, 0.3, -0.05))
    plan = plan_dock(problem, time_budget=30.0)
    tube = Tube(plan.path, problem, plan.certificate.start_relief)
    assert tube.width_at(np.array([0.0]))[0] == 0.0


@settings(max_examples=25)
@given(st.floats(0.0, 1.0), st.floats(-0.05, 0.05), st.floats(-0.1, 0.1))
def test_a_pose_beside_the_path_is_seen_where_it_is(share, cross, yaw):
    problem, plan = planned()
    s = share * plan.path.length
    x, y, heading = plan.path.poses_at(s)[0]
    pose = np.array([[x - cross * math.sin(heading), y + cross * math.cos(heading), heading + yaw]])
    tube = Tube(plan.path, problem)
    everywhere, nearby = tube.deviations(pose), tube.deviations(pose, near=s)
    for found in (everywhere, nearby):
        assert (
            found.displacement[0] <= abs(cross) + 2.0 * FOOTPRINT.circumscribed_radius * abs(math.sin(0.5 * yaw)) + 2e-4
        )
    exact = plan.path.poses_at(nearby.s)[0]
    assert np.hypot(*(pose[0, :2] - exact[:2])) == pytest.approx(np.hypot(nearby.along[0], nearby.cross[0]), abs=1e-9)
    if 0.05 < share < 0.95:
        assert abs(nearby.along[0]) < 2.0 * abs(cross) + 0.06


def test_beyond_the_end_the_way_along_counts():
    problem, plan = planned()
    x, y, heading = plan.path.poses_at(plan.path.length)[0]
    pose = np.array([[x + 0.03 * math.cos(heading), y + 0.03 * math.sin(heading), heading]])
    found = Tube(plan.path, problem).deviations(pose)
    assert found.along[0] == pytest.approx(0.03, abs=1e-6)
    assert found.excess[0] == pytest.approx(0.03, abs=1e-6)


def test_obstacles_are_no_part_of_what_a_tube_of_zero_asks_for():
    plain = problem_with(TrackingTube())
    assert plain.path_clearance == plain.clearance
    assert plain.fingerprint == dataclasses.replace(plain, robot=Robot(FOOTPRINT, LIMITS)).fingerprint
    assert plain.fingerprint != problem_with(TrackingTube(0.01)).fingerprint
    assert ObstacleSet.of(POSTS).digest == plain.obstacles.digest
