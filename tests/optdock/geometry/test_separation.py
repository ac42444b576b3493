"""Exact signed distance: shapely for separated shapes, Minkowski differences for overlaps, and the axis as proof."""

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from optdock.geometry.footprint import Footprint
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import transform_points
from optdock.geometry.separation import separation


def random_convex(rng, scale):
    hull = shapely.MultiPoint(rng.normal(size=(rng.integers(3, 9), 2)) * scale).convex_hull
    return np.asarray(hull.exterior.coords)[:-1]


def case(seed):
    rng = np.random.default_rng(seed)
    footprint = Footprint(random_convex(rng, 0.5))
    obstacles = ObstacleSet.from_polygons([random_convex(rng, 0.4) + rng.normal(size=2) for _ in range(5)])
    poses = np.column_stack((rng.normal(size=(5, 2)), rng.uniform(-4.0, 4.0, 5)))
    return footprint, obstacles, poses


@settings(max_examples=25)
@given(st.integers(0, 100_000))
def test_disjoint_distance_agrees_with_shapely(seed):
    footprint, obstacles, poses = case(seed)
    found = separation(footprint.bodies[0], poses, obstacles.pieces(np.arange(5))).distance
    outlines = shapely.polygons(transform_points(poses, footprint.vertices))
    truth = shapely.distance(outlines, shapely.polygons(obstacles.vertices))
    assert np.allclose(np.maximum(found, 0.0), truth, atol=1e-12)
    assert np.array_equal(found > 1e-12, truth > 1e-12)


@settings(max_examples=25)
@given(st.integers(0, 100_000))
def test_the_axis_proves_the_distance(seed):
    footprint, obstacles, poses = case(seed)
    found = separation(footprint.bodies[0], poses, obstacles.pieces(np.arange(5)))
    vertices = transform_points(poses, footprint.vertices)
    low = np.einsum("nj,nkj->nk", found.axis, vertices).min(axis=1)
    high = np.einsum("nj,nkj->nk", found.axis, obstacles.vertices).max(axis=1)
    assert np.allclose(np.hypot(*found.axis.T), 1.0)
    assert np.allclose(low - high, found.distance, atol=1e-12)


@settings(max_examples=25)
@given(st.integers(0, 100_000))
def test_penetration_is_the_least_translation_that_separates(seed):
    footprint, obstacles, poses = case(seed)
    poses[:, :2] = obstacles.vertices.mean(axis=1) + 0.1
    found = separation(footprint.bodies[0], poses, obstacles.pieces(np.arange(5)))
    vertices = transform_points(poses, footprint.vertices)
    for i in np.flatnonzero(found.distance < -1e-6):
        difference = (vertices[i][:, None] - obstacles.vertices[i][None]).reshape(-1, 2)
        boundary = shapely.MultiPoint(difference).convex_hull.exterior
        assert found.distance[i] == pytest.approx(-boundary.distance(shapely.Point(0.0, 0.0)), abs=1e-12)


@pytest.mark.parametrize("gap", [0.0, 1e-12, 1e-9, 1e-3])
def test_touching_and_nearly_touching_squares(gap):
    footprint = Footprint.rectangle(0.5, 0.5, 1.0)
    obstacles = ObstacleSet.from_polygons([[[0.5 + gap, -0.5], [1.0, -0.5], [1.0, 0.5], [0.5 + gap, 0.5]]])
    found = separation(footprint.bodies[0], np.zeros((1, 3)), obstacles.pieces(np.array([0])))
    assert found.distance[0] == pytest.approx(gap, abs=1e-15)
    assert np.allclose(found.axis[0], [-1.0, 0.0])


def test_corner_to_corner_contact_has_distance_zero():
    footprint = Footprint.rectangle(0.5, 0.5, 1.0)
    obstacles = ObstacleSet.from_polygons([[[0.5, 0.5], [1.0, 0.5], [1.0, 1.0], [0.5, 1.0]]])
    assert separation(footprint.bodies[0], np.zeros((1, 3)), obstacles.pieces(np.array([0]))).distance[0] == 0.0


def test_padding_with_repeated_vertices_changes_nothing():
    triangle = [[1.0, -0.2], [2.0, 0.0], [1.0, 0.3]]
    octagon = 5.0 + np.column_stack((np.cos(np.arange(8) * np.pi / 4), np.sin(np.arange(8) * np.pi / 4)))
    alone = ObstacleSet.from_polygons([triangle])
    padded = ObstacleSet.from_polygons([triangle, octagon])
    body, poses = Footprint.rectangle(0.3, 0.3, 0.4).bodies[0], np.array([[0.1, 0.2, 0.7]])
    one = separation(body, poses, alone.pieces(np.array([0])))
    two = separation(body, poses, padded.pieces(np.array([0])))
    assert one.distance[0] == two.distance[0]
