"""Clearance of driven poses against shapely."""

import math

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from optdock.geometry.footprint import Footprint
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import transform_points
from optdock.simulation import executed_clearance

FOOTPRINT = Footprint(np.array([[0.4, 0.3], [-0.4, 0.3], [-0.4, -0.3], [0.4, -0.3], [0.1, 0.0]]))  # not convex


@settings(max_examples=15)
@given(st.integers(0, 10_000))
def test_equals_the_smallest_distance_of_any_pair(seed):
    random = np.random.default_rng(seed)
    poses = random.uniform([-1.0, -1.0, -4.0], [1.0, 1.0, 4.0], (30, 3))
    polygons = [random.uniform(-4.0, 4.0, 2) + random.uniform(-0.8, 0.8, (3, 2)) for _ in range(6)]
    outlines = [shapely.Polygon(points) for points in transform_points(poses, FOOTPRINT.vertices)]
    apart = min(a.distance(shapely.Polygon(b)) for a in outlines for b in polygons)
    found = executed_clearance(FOOTPRINT, poses, ObstacleSet.from_polygons(polygons))
    assert found == pytest.approx(apart, abs=1e-12) if apart > 0.0 else found <= 1e-12


def test_infinite_without_obstacles():
    assert executed_clearance(FOOTPRINT, np.zeros((3, 3)), ObstacleSet.empty()) == math.inf


def test_many_poses_in_blocks():
    x = np.linspace(0.0, 10.0, 1001)
    poses = np.column_stack((x, np.zeros(1001), np.zeros(1001)))
    wall = ObstacleSet.from_polygons([[[12.0, -1.0], [13.0, -1.0], [13.0, 1.0], [12.0, 1.0]]])
    assert executed_clearance(FOOTPRINT, poses, wall) == pytest.approx(1.6, abs=1e-12)
