"""Collision-free durations compared with closed forms and dense sampling."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from optdock.geometry.footprint import Footprint
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import Pose2, Twist2
from optdock.verification import pose_clearance, pose_clearances
from optdock.verification.time_of_impact import free_motion

BOX = Footprint.rectangle(0.4, 0.3, 0.5)
ORIGIN = Pose2(0.0, 0.0, 0.0)


def block(x0, y0, x1, y1):
    return ObstacleSet.from_polygons([[[x0, y0], [x1, y0], [x1, y1], [x0, y1]]])


WALL = block(1.0, -2.0, 1.2, 2.0)


def test_a_straight_motion_is_free_until_contact():
    assert free_motion(BOX, WALL, ORIGIN, Twist2(0.2), 5.0).free == pytest.approx(3.0, abs=1e-4)
    assert free_motion(BOX, WALL, ORIGIN, Twist2(0.2), 5.0).row == 0
    assert free_motion(BOX, WALL, ORIGIN, Twist2(0.2), 5.0, clearance=0.1).free == pytest.approx(2.5, abs=1e-4)
    assert free_motion(BOX, WALL, ORIGIN, Twist2(0.2), 2.9) == (2.9, -1)
    assert free_motion(BOX, WALL, ORIGIN, Twist2(-0.2), 5.0) == (5.0, -1)


def test_a_spin_is_free_until_a_corner_touches():
    gap, radius = 0.45, math.hypot(0.4, 0.25)
    turn = math.atan2(0.25, 0.4) - math.acos(gap / radius)
    found = free_motion(BOX, WALL, Pose2(1.0 - gap, 0.0, 0.0), Twist2(0.0, 0.5), 5.0)
    assert found.free == pytest.approx(turn / 0.5, abs=1e-3)


def test_a_motion_along_a_wall_costs_nothing_even_in_contact():
    for gap in (0.0, 1e-9, 0.01):
        beside = block(-5.0, 0.25 + gap, 5.0, 1.0)
        assert free_motion(BOX, beside, ORIGIN, Twist2(0.2), 5.0) == (5.0, -1)


@pytest.mark.parametrize("overlap", [0.0, 0.005])
def test_a_robot_in_its_dock_may_leave_but_not_go_deeper(overlap):
    dock = block(0.4 - overlap, -0.5, 0.6, 0.5)
    assert free_motion(BOX, dock, ORIGIN, Twist2(-0.2), 3.0, clearance=0.05) == (3.0, -1)
    assert free_motion(BOX, dock, ORIGIN, Twist2(0.2), 3.0).free < 1e-3


def test_a_slow_approach_does_not_creep_through_the_slack():
    assert free_motion(BOX, block(0.4, -0.5, 0.6, 0.5), ORIGIN, Twist2(0.001), 60.0).free < 0.1


def test_a_deep_overlap_blocks_every_motion():
    assert free_motion(BOX, block(0.3, -0.5, 0.6, 0.5), ORIGIN, Twist2(-0.2), 3.0) == (0.0, 0)


def test_an_obstacle_inside_the_footprint_is_found():
    assert free_motion(BOX, block(-0.05, -0.05, 0.05, 0.05), ORIGIN, Twist2(0.2), 3.0).free == 0.0


def test_thin_obstacles_between_samples_are_found():
    post = block(3.0, -0.001, 3.001, 0.001)
    found = free_motion(BOX, post, ORIGIN, Twist2(10.0), 1.0)
    assert found.free == pytest.approx(0.26, abs=1e-4)


def test_without_obstacles_everything_is_free():
    assert free_motion(BOX, ObstacleSet.empty(), ORIGIN, Twist2(1.0, 1.0), 9.0) == (9.0, -1)


@settings(max_examples=25)
@given(st.integers(0, 100_000), st.floats(-0.6, 0.6), st.floats(-1.5, 1.5), st.floats(0.0, 0.1))
def test_it_agrees_with_dense_sampling(seed, v, w, clearance):
    random = np.random.default_rng(seed)
    polygons = [random.uniform(-2.0, 2.0, 2) + random.uniform(-0.4, 0.4, (3, 2)) for _ in range(4)]
    obstacles = ObstacleSet.from_polygons(polygons)
    before, _ = pose_clearance(ORIGIN, BOX, obstacles)
    if before <= clearance:
        return
    found = free_motion(BOX, obstacles, ORIGIN, Twist2(v, w), 3.0, clearance)
    times = np.linspace(0.0, 3.0, 121)
    dense, _ = pose_clearances(np.stack([ORIGIN.moved(Twist2(v, w), t).as_array() for t in times]), BOX, obstacles)
    assert np.all(dense[times <= found.free] >= clearance - 2e-6)
    if found.row >= 0:
        at_stop = pose_clearance(ORIGIN.moved(Twist2(v, w), found.free), BOX, obstacles)[0]
        assert at_stop < clearance + 2e-4


@pytest.mark.parametrize("tip", [60.0, 10.0, 0.5])
def test_a_needle_does_not_slip_between_obstacles_that_touch(tip):
    """Along the seam the needle overlaps each box by a fraction of its depth only."""
    half = 0.3 * math.tan(0.5 * math.radians(tip))
    needle = Footprint([[0.3, 0.0], [0.0, half], [-0.3, max(half, 0.1)], [-0.3, -max(half, 0.1)], [0.0, -half]])
    boxes = ObstacleSet.from_polygons(
        [[[1.0, -1.0], [2.0, -1.0], [2.0, 0.0], [1.0, 0.0]], [[1.0, 0.0], [2.0, 0.0], [2.0, 1.0], [1.0, 1.0]]]
    )
    found = free_motion(needle, boxes, ORIGIN, Twist2(0.1), 20.0)
    assert found.row in (0, 1)
    assert 0.3 + 0.1 * found.free == pytest.approx(1.0, abs=2e-5)
    assert 0.3 + 0.1 * found.free < 1.0 + 4e-6


def test_a_post_does_not_slip_into_a_fan_of_thin_pieces():
    share = np.linspace(-0.4, 0.4, 200)
    notched = Footprint(
        [*np.column_stack((3.0 - 2.6 * np.cos(share), 2.6 * np.sin(share))), (-0.5, 1.02), (-0.5, -1.02)]
    )
    post = block(0.41, 0.0, 0.41 + 4e-7, 4e-7)  # before the bulge of the front
    assert free_motion(notched, post, ORIGIN, Twist2(0.1), 5.0).free == pytest.approx(0.1, abs=1e-3)
    inside = free_motion(notched, post, Pose2(0.3, 0.0, 0.0), Twist2(0.1), 5.0)
    assert inside.free < 1e-3  # it may not go deeper, however thin the pieces are that it lies in


def test_a_motion_between_touching_obstacles_and_out_of_contact_stays_free():
    """A robot touches a row of map cells, and a robot leaves its contact."""
    cells = ObstacleSet.from_rectangles(
        np.array([[0.1 * k, 0.25] for k in range(-10, 30)]),
        np.array([[0.1 * k + 0.1, 0.35] for k in range(-10, 30)]),
        "map",
    )
    assert free_motion(BOX, cells, ORIGIN, Twist2(0.2), 5.0) == (5.0, -1)
    assert free_motion(BOX, cells, ORIGIN, Twist2(0.2, lateral=-0.05), 5.0) == (5.0, -1)
    assert free_motion(BOX, cells, ORIGIN, Twist2(0.2, lateral=0.05), 5.0).free < 1e-3
