"""The clearance of poses: broad phase, exact narrow phase, and cached end clearances."""

import dataclasses
import functools
import gc
import weakref

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from experiments.families import FAMILIES, instance
from optdock.geometry.footprint import Footprint
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import Pose2, transform_points
from optdock.geometry.separation import ConvexBody
from optdock.model.dock import Dock
from optdock.model.limits import MotionLimits
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from optdock.verification import clearance_kernel, end_clearances, pose_clearance, pose_clearances
from optdock.verification.proximity import bounded

BAR = Footprint.rectangle(0.9, 0.3, 0.4)
DART = Footprint(np.array([[0.4, 0.0], [-0.4, 0.3], [-0.2, 0.0], [-0.4, -0.3]]))


def test_a_near_post_is_not_hidden_by_far_bars_whose_boxes_reach_closer():
    bars = []
    for k in range(12):
        x, y = np.array([-3.0, 3.0]), np.array([-1.5, 4.5]) + 0.1 * k
        bars.append([(x[0], y[0]), (x[0] + 0.05, y[0]), (x[1] + 0.05, y[1]), (x[1], y[1])])
    post = np.array([1.4, 0.0]) + 0.01 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    obstacles = ObstacleSet.from_polygons([*bars, post])
    clearance, row = pose_clearance(Pose2(0.0, 0.0, 0.0), BAR, obstacles)
    assert row == len(bars)
    assert clearance == pytest.approx(0.49, abs=1e-9)


@given(seed=st.integers(0, 10**6), flat=st.booleans())
def test_the_circles_of_a_body_cover_it_and_its_reach_is_that_of_its_farthest_corner(seed, flat):
    """For several bodies at once, from a micrometre to 100 m in each direction; flat ones have no width."""
    rng = np.random.default_rng(seed)
    corners = [rng.normal(size=(rng.integers(3, 9), 2)) * 10.0 ** rng.uniform(-6.0, 2.0, 2) for _ in range(3)]
    if flat:
        corners[1][:, 1] = corners[1][0, 1]
    bodies = tuple(ConvexBody(one, np.zeros_like(one), np.zeros(len(one))) for one in corners)
    for body, found in zip(bodies, bounded(bodies), strict=True):
        assert found.body is body
        assert found.reach == np.hypot(*body.vertices.T).max()
        inside = rng.dirichlet(np.ones(len(body.vertices)), 50) @ body.vertices
        points = np.concatenate((body.vertices, inside))
        apart = np.hypot(*(points[:, None] - found.centres).transpose(2, 0, 1))
        assert apart.min(axis=1).max() <= found.radius * (1.0 + 1e-12)
        assert len(found.centres) <= 3


def test_the_deepest_of_many_overlaps_is_reported():
    half = np.arange(1.0, 13.0)
    squares = ObstacleSet.from_rectangles(np.column_stack((-half, -half)), np.column_stack((half, half)), "square")
    body = Footprint.rectangle(0.4, 0.4, 0.5)
    assert pose_clearance(Pose2(0.0, 0.0, 0.0), body, squares) == (pytest.approx(-12.25), 11)
    one = squares.subset(np.array([0]))
    poses = np.array([[1.13, 0.0, 0.0]])
    truth, _ = pose_clearance(Pose2.from_sequence(poses[0]), body, one)
    assert -0.3 < truth < -0.2
    for within in (truth + 1e-9, -0.1, 0):
        distance, row = pose_clearances(poses, body, one, within)
        assert distance.tolist() == [truth]
        assert row.tolist() == [0]
    nothing_near, _ = pose_clearances(poses + 5.0, body, one, 0)
    assert nothing_near.dtype == np.float64


def convex(rng):
    angles = np.sort(rng.uniform(0.0, 2.0 * np.pi, 6))
    return np.column_stack((np.cos(angles), np.sin(angles)))


@settings(max_examples=25)
@given(st.integers(0, 10_000))
def test_clearances_of_many_poses_are_those_of_each(seed):
    rng = np.random.default_rng(seed)
    poses = rng.uniform(-2.0, 2.0, (int(rng.integers(1, 6)), 3))
    rocks = [rng.normal(size=2) * 1.5 + rng.uniform(0.02, 0.5) * convex(rng) for _ in range(int(rng.integers(1, 30)))]
    obstacles = ObstacleSet.from_polygons(rocks)
    distance, row = pose_clearances(poses, DART, obstacles)
    outlines = shapely.polygons(transform_points(poses, DART.vertices))
    truth = np.array([[outline.distance(shapely.Polygon(rock)) for rock in rocks] for outline in outlines])
    assert np.maximum(distance, 0.0) == pytest.approx(truth.min(axis=1), abs=1e-9)
    assert truth[np.arange(len(poses)), row] == pytest.approx(truth.min(axis=1), abs=1e-9)
    alone = [pose_clearance(Pose2.from_sequence(pose), DART, obstacles) for pose in poses]
    assert [(float(d), int(r)) for d, r in zip(distance, row, strict=True)] == alone
    within = float(rng.uniform(0.0, 1.0))
    capped, capped_row = pose_clearances(poses, DART, obstacles, within)
    assert capped.tolist() == np.minimum(distance, within).tolist()
    assert capped_row.tolist() == np.where(distance < within, row, -1).tolist()


def test_without_obstacles_the_clearance_of_a_pose_is_infinite():
    distance, row = pose_clearances(np.zeros((2, 3)), BAR, ObstacleSet.empty())
    assert distance.tolist() == [np.inf, np.inf]
    assert row.tolist() == [-1, -1]


@functools.cache
def among_many_boxes():
    """A footprint, 120 boxes, and groups of poses with the distance of each pose from each box alone."""
    rng = np.random.default_rng(5)
    lower = rng.uniform(-20.0, 20.0, (120, 2))
    obstacles = ObstacleSet.from_rectangles(lower, lower + rng.uniform(0.05, 0.6, (120, 2)), "map")
    footprint = Footprint.rectangle(0.4, 0.3, 0.5)
    far = np.array([[60.0, 0.0, 0.3]])
    groups = rng.uniform(-3.0, 3.0, (3, 3)), rng.uniform(-20.0, 20.0, (2, 3)), far
    alone = [obstacles.subset(np.array([k])) for k in range(120)]
    each = [np.stack([pose_clearances(poses, footprint, one)[0] for one in alone], axis=1) for poses in groups]
    return footprint, obstacles, list(zip(groups, each, strict=True))


@pytest.mark.parametrize("within", [np.inf, 0.3, 2.0])
def test_clearances_among_many_obstacles_are_those_of_each_alone(within):
    """Distant obstacles are skipped only if a near one exists."""
    footprint, obstacles, groups = among_many_boxes()
    for poses, each in groups:
        found, rows = pose_clearances(poses, footprint, obstacles, within)
        np.testing.assert_allclose(found, np.minimum(each.min(axis=1), within), atol=1e-12)
        seen = each.min(axis=1) < within
        assert np.array_equal(rows[seen], each.argmin(axis=1)[seen])
        assert np.all(rows[~seen] == -1)


@pytest.mark.parametrize("family", sorted(FAMILIES))
def test_the_clearances_of_the_ends_are_those_of_each_pose_alone(family):
    problem = instance(family, 1).problem
    poses = problem.start, problem.goal
    alone = [pose_clearance(pose, problem.robot.footprint, problem.all_obstacles) for pose in poses]
    assert end_clearances(problem) == (*alone[0], *alone[1])


@pytest.fixture
def looks(monkeypatch):
    made, real = [], clearance_kernel.compiled_clearances
    monkeypatch.setattr(clearance_kernel, "compiled_clearances", lambda *arguments: made.append(1) or real(*arguments))
    return made


def between(x, post):
    """A problem from x = `x` to the origin, with a post at x = `post`."""
    obstacles = ObstacleSet.from_polygons([[[post, 0.0], [post + 0.1, 0.0], [post, 0.1]]])
    return DockingProblem(Pose2(x, 0.0, 0.0), Dock(Pose2(0.0, 0.0, 0.0)), Robot(BAR, MotionLimits()), obstacles)


def test_end_clearances_are_computed_once_per_problem(looks):
    problem = between(-3.0, 2.0)
    found = end_clearances(problem)
    assert found == (pytest.approx(4.1), 0, pytest.approx(1.1), 0)
    assert end_clearances(problem) is found
    assert len(looks) == 1
    assert end_clearances(dataclasses.replace(problem, start=Pose2(-2.0, 0.0, 0.0))).start == pytest.approx(3.1)
    assert end_clearances(dataclasses.replace(problem, obstacles=ObstacleSet.empty())) == (np.inf, -1, np.inf, -1)
    assert len(looks) == 3


class Named(DockingProblem):
    """Problems that are equal if their frames are."""

    def __eq__(self, other):
        return self.frame == other.frame

    def __hash__(self):
        return hash(self.frame)


def test_end_clearances_are_cached_by_identity():
    near, far = (
        Named(**{f.name: getattr(between(-3.0, x), f.name) for f in dataclasses.fields(DockingProblem) if f.init})
        for x in (2.0, 3.0)
    )
    assert near == far
    assert end_clearances(near).goal == pytest.approx(1.1)
    assert end_clearances(far).goal == pytest.approx(2.1)


def test_cached_clearances_keep_no_problem_alive():
    problem = between(-3.0, 2.0)
    end_clearances(problem)
    gone = weakref.ref(problem)
    del problem
    gc.collect()
    assert gone() is None
