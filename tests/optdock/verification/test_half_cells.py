"""Lower bounds over half cells against dense sampling, one half cell at a time."""

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2, transform_points
from optdock.obstacles import ObstacleSet
from optdock.verification import half_cells
from optdock.verification.half_cells import HalfCells, half_cell_bounds, pose_clearance, pose_clearances

BAR = Footprint.rectangle(0.9, 0.3, 0.4)
DART = Footprint(np.array([[0.4, 0.0], [-0.4, 0.3], [-0.2, 0.0], [-0.4, -0.3]]))


def stretch_of(spline, width):
    """The first half of the cell from 0 to 2 `width` on a spline with one piece."""
    at, last = spline.poses_at(0.0), 2.0 * width
    kappa = np.abs(spline.curvature_at([0.0, last])).max()
    velocity = np.array([[np.cos(at[0, 2]), np.sin(at[0, 2]), spline.curvature_at(0.0)[0]]])
    rate = abs(float(spline.curvature_rate_at(0.0)[0]))
    columns = (width, 1.0, kappa, kappa, rate + kappa**2)
    return HalfCells(at, np.array([0]), velocity, *(np.array([value]) for value in columns))


def dense_distance(spline, width, footprint, rocks):
    outlines = shapely.polygons(transform_points(spline.poses_at(np.linspace(0.0, width, 80)), footprint.vertices))
    return float(shapely.distance(outlines[:, None], shapely.polygons(rocks)).min())


@given(st.integers(0, 100_000))
def test_the_bound_holds_along_sharply_curved_stretches(seed):
    rng = np.random.default_rng(seed)
    footprint, width = (BAR, DART)[seed % 2], rng.uniform(0.02, 0.3)
    spline = ClothoidSpline(Pose2(*rng.uniform(-1.0, 1.0, 3)), [0.0, 2.0 * width], rng.uniform(-6.0, 6.0, 2))
    rocks = [rng.uniform(-1.5, 1.5, 2) + 0.01 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) for _ in range(40)]
    distances = [dense_distance(spline, width, footprint, [rock]) for rock in rocks]
    free = [rock for rock, distance in zip(rocks, distances, strict=True) if distance > 0.0]
    found = half_cell_bounds(footprint, stretch_of(spline, width), ObstacleSet.from_polygons(free), np.array([3.0]))
    assert found.bound[0] <= dense_distance(spline, width, footprint, free) + 1e-9


def test_a_body_that_swings_towards_a_post_is_seen_coming():
    # A quarter of a metre on a circle of 0.4 m: the front swings 8 cm further to the left than its tangent says.
    spline = ClothoidSpline(Pose2(0.0, 0.0, 0.0), [0.0, 0.5], [2.5, 2.5])
    post = np.array([0.9, 0.7]) + 0.001 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    truth = dense_distance(spline, 0.25, BAR, [post])
    bound = half_cell_bounds(BAR, stretch_of(spline, 0.25), ObstacleSet.from_polygons([post]), np.array([3.0])).bound[0]
    assert truth < 0.1
    assert bound <= truth


@pytest.mark.parametrize("most", [1, 7, 50, 10_000])
def test_blocks_change_nothing(monkeypatch, most):
    rng = np.random.default_rng(1)
    poses = rng.uniform(-1.0, 1.0, (9, 3))
    pose = rng.integers(0, 9, 14)
    columns = [np.full(14, value) for value in (0.05, 1.0, 0.5, 0.5, 0.5)]
    many = HalfCells(poses, pose, rng.normal(size=(14, 3)), *columns)
    rocks = ObstacleSet.from_polygons(
        [rng.uniform(-2.0, 2.0, 2) + np.array([[0, 0], [0.1, 0], [0, 0.2]]) for _ in range(6)]
    )
    care = np.full(14, 0.4)
    whole = half_cell_bounds(DART, many, rocks, care)
    monkeypatch.setattr(half_cells, "_MAX_PAIRS", most)
    parts = half_cell_bounds(DART, many, rocks, care)
    assert parts.bound.tolist() == whole.bound.tolist()
    assert parts.row.tolist() == whole.row.tolist()
    seen = [set(zip(one.pose, one.obstacle, one.distance, strict=True)) for one in (whole, parts)]
    assert seen[0] == seen[1]


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


def test_the_bound_falls_as_fast_as_a_point_on_a_circle():
    """A body of a millimetre on a circle, a post inside it: the whole second-order term is needed."""
    speck, width = Footprint.rectangle(0.0005, 0.0005, 0.001), 0.1
    spline = ClothoidSpline(Pose2(0.0, 0.0, 0.0), [0.0, 2.0 * width], [2.5, 2.5])
    wall = np.array([[-1.0, 0.05], [1.0, 0.05], [1.0, 0.06], [-1.0, 0.06]])
    truth = dense_distance(spline, width, speck, [wall])
    found = half_cell_bounds(speck, stretch_of(spline, width), ObstacleSet.from_polygons([wall]), np.array([1.0]))
    assert truth - 5e-4 < found.bound[0] <= truth


def test_what_is_not_a_number_proves_nothing():
    one = stretch_of(ClothoidSpline(Pose2(0.0, 0.0, 0.0), [0.0, 0.1], [0.0, 0.0]), 0.05)
    endless = one._replace(twist=np.array([np.inf]), width=np.array([0.0]))  # inf * 0
    post = ObstacleSet.from_polygons([np.array([[1.2, 0.3], [1.3, 0.3], [1.3, 0.4]])])
    with np.errstate(invalid="ignore"):
        for footprint in (BAR, DART):
            assert half_cell_bounds(footprint, endless, post, np.array([3.0])).bound.tolist() == [-np.inf]


def test_the_smaller_of_two_bounds_is_kept_and_minus_infinity_first():
    def bounds(*values):
        count = len(values)
        none = np.zeros(0, dtype=np.int64)
        return half_cells.HalfBounds(np.array(values), np.arange(count), none, none, np.zeros(0))

    first, second = bounds(1.0, -np.inf, 2.0), bounds(0.5, 3.0, -np.inf)
    assert first.merged(second).bound.tolist() == [0.5, -np.inf, -np.inf]
    assert second.merged(first).bound.tolist() == [0.5, -np.inf, -np.inf]


def test_of_many_deep_overlaps_the_deepest_is_named():
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


def test_a_pose_among_nothing_is_infinitely_clear():
    distance, row = pose_clearances(np.zeros((2, 3)), BAR, ObstacleSet.empty())
    assert distance.tolist() == [np.inf, np.inf]
    assert row.tolist() == [-1, -1]


@pytest.mark.parametrize("within", [np.inf, 0.3, 2.0])
def test_clearances_among_many_obstacles_are_those_of_each_alone(within):
    """Most of a map is left out where something is near, and must not be missed where nothing is."""
    rng = np.random.default_rng(5)
    lower = rng.uniform(-20.0, 20.0, (120, 2))
    obstacles = ObstacleSet.from_rectangles(lower, lower + rng.uniform(0.05, 0.6, (120, 2)), "map")
    footprint = Footprint.rectangle(0.4, 0.3, 0.5)
    far = np.array([[60.0, 0.0, 0.3]])
    for poses in (rng.uniform(-3.0, 3.0, (3, 3)), rng.uniform(-20.0, 20.0, (2, 3)), far):
        found, rows = pose_clearances(poses, footprint, obstacles, within)
        each = np.array(
            [
                [pose_clearances(pose[None], footprint, obstacles.subset(np.array([k])))[0][0] for k in range(120)]
                for pose in poses
            ]
        )
        np.testing.assert_allclose(found, np.minimum(each.min(axis=1), within), atol=1e-12)
        seen = each.min(axis=1) < within
        assert np.array_equal(rows[seen], each.argmin(axis=1)[seen])
        assert np.all(rows[~seen] == -1)
