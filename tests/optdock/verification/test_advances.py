"""Lower bounds of the clearance over one advance from a pose, against dense sampling."""

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2, transform_points
from optdock.obstacles import ObstacleSet
from optdock.verification import conservative_advancement
from optdock.verification.conservative_advancement import AdvanceBounds, Advances, advance_bounds
from optdock.verification.proximity import bounded_footprint

BAR = Footprint.rectangle(0.9, 0.3, 0.4)
DART = Footprint(np.array([[0.4, 0.0], [-0.4, 0.3], [-0.2, 0.0], [-0.4, -0.3]]))


def stretch_of(spline, width):
    """The first half of the cell from 0 to 2 `width` on a spline with one piece."""
    at, last = spline.poses_at(0.0), 2.0 * width
    kappa = np.abs(spline.curvature_at([0.0, last])).max()
    velocity = np.array([[np.cos(at[0, 2]), np.sin(at[0, 2]), spline.curvature_at(0.0)[0]]])
    rate = abs(float(spline.curvature_rate_at(0.0)[0]))
    columns = (width, 1.0, kappa, kappa, rate + kappa**2)
    return Advances(at, np.array([0]), velocity, *(np.array([value]) for value in columns))


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
    found = advance_bounds(
        bounded_footprint(footprint), stretch_of(spline, width), ObstacleSet.from_polygons(free), np.array([3.0])
    )
    assert found.bound[0] <= dense_distance(spline, width, footprint, free) + 1e-9


def test_a_body_that_swings_towards_a_post_is_seen_coming():
    # A quarter of a metre on a circle of 0.4 m: the front swings 8 cm further to the left than its tangent says.
    spline = ClothoidSpline(Pose2(0.0, 0.0, 0.0), [0.0, 0.5], [2.5, 2.5])
    post = np.array([0.9, 0.7]) + 0.001 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    truth = dense_distance(spline, 0.25, BAR, [post])
    bound = advance_bounds(
        bounded_footprint(BAR), stretch_of(spline, 0.25), ObstacleSet.from_polygons([post]), np.array([3.0])
    ).bound[0]
    assert truth < 0.1
    assert bound <= truth


@pytest.mark.parametrize("most", [1, 7, 50, 10_000])
def test_blocks_change_nothing(monkeypatch, most):
    rng = np.random.default_rng(1)
    poses = rng.uniform(-1.0, 1.0, (9, 3))
    pose = rng.integers(0, 9, 14)
    columns = [np.full(14, value) for value in (0.05, 1.0, 0.5, 0.5, 0.5)]
    many = Advances(poses, pose, rng.normal(size=(14, 3)), *columns)
    rocks = ObstacleSet.from_polygons(
        [rng.uniform(-2.0, 2.0, 2) + np.array([[0, 0], [0.1, 0], [0, 0.2]]) for _ in range(6)]
    )
    care = np.full(14, 0.4)
    whole = advance_bounds(bounded_footprint(DART), many, rocks, care)
    monkeypatch.setattr(conservative_advancement, "_MAX_PAIRS", most)
    parts = advance_bounds(bounded_footprint(DART), many, rocks, care)
    assert parts.bound.tolist() == whole.bound.tolist()
    assert parts.row.tolist() == whole.row.tolist()
    seen = [set(zip(one.pose, one.obstacle, one.distance, strict=True)) for one in (whole, parts)]
    assert seen[0] == seen[1]


def test_the_bound_falls_as_fast_as_a_point_on_a_circle():
    """A body of a millimetre on a circle, a post inside it: the whole second-order term is needed."""
    speck, width = Footprint.rectangle(0.0005, 0.0005, 0.001), 0.1
    spline = ClothoidSpline(Pose2(0.0, 0.0, 0.0), [0.0, 2.0 * width], [2.5, 2.5])
    wall = np.array([[-1.0, 0.05], [1.0, 0.05], [1.0, 0.06], [-1.0, 0.06]])
    truth = dense_distance(spline, width, speck, [wall])
    found = advance_bounds(
        bounded_footprint(speck), stretch_of(spline, width), ObstacleSet.from_polygons([wall]), np.array([1.0])
    )
    assert truth - 5e-4 < found.bound[0] <= truth


def test_what_is_not_a_number_proves_nothing():
    one = stretch_of(ClothoidSpline(Pose2(0.0, 0.0, 0.0), [0.0, 0.1], [0.0, 0.0]), 0.05)
    endless = one._replace(twist=np.array([np.inf]), width=np.array([0.0]))  # inf * 0
    post = ObstacleSet.from_polygons([np.array([[1.2, 0.3], [1.3, 0.3], [1.3, 0.4]])])
    with np.errstate(invalid="ignore"):
        for footprint in (BAR, DART):
            assert advance_bounds(bounded_footprint(footprint), endless, post, np.array([3.0])).bound.tolist() == [
                -np.inf
            ]


def test_the_smaller_of_two_bounds_is_kept_and_minus_infinity_first():
    def bounds(*values):
        count = len(values)
        none = np.zeros(0, dtype=np.int64)
        return AdvanceBounds(np.array(values), np.arange(count), none, none, np.zeros(0))

    first, second = bounds(1.0, -np.inf, 2.0), bounds(0.5, 3.0, -np.inf)
    assert first.merged(second).bound.tolist() == [0.5, -np.inf, -np.inf]
    assert second.merged(first).bound.tolist() == [0.5, -np.inf, -np.inf]
