"""Cells of a survey: poses and back, borders, and the room of the robot at each cell."""

import math

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

import optdock as od
from optdock.errors import InvalidValue
from optdock.geometry.pose import Pose2, transform_points, wrap_angles
from optdock.survey.grid import CLEAR, OCCUPIED, TIGHT, Box, SurveyGrid, room_at
from optdock.verification import pose_clearances
from tests.optdock.survey.scenes import box

COORDINATE = st.floats(-50.0, 50.0)


@given(
    st.tuples(st.integers(-1000, 1000), st.integers(-1000, 1000)),
    st.tuples(st.integers(1, 40), st.integers(1, 9), st.integers(1, 9)),
    st.floats(0.001, 3.0),
    st.integers(0, 2**32),
)
@settings(max_examples=50)
def test_every_cell_contains_its_centre_and_the_poses_next_to_it(first, shape, resolution, seed):
    grid = SurveyGrid(first, shape, resolution)
    every = np.arange(math.prod(shape))
    centres = grid.poses(every)
    assert np.array_equal(grid.cells(centres), every)
    assert np.all((-math.pi < centres[:, 2]) & (centres[:, 2] <= math.pi))
    off = np.random.default_rng(seed).uniform(-0.499, 0.499, (every.size, 3))
    off *= [resolution, resolution, 2.0 * math.pi / shape[0]]
    turned = centres + off + [0.0, 0.0, 2.0 * math.pi * 3]
    assert np.array_equal(grid.cells(turned), every)
    turned[:, 2] = wrap_angles(turned[:, 2])
    assert np.array_equal(grid.cells(turned), every)


def test_poses_outside_have_no_cell():
    grid = SurveyGrid((-2, -2), (4, 5, 5), 0.5)
    outside = np.array([[1.26, 0, 0], [-1.26, 0, 0], [0, 1.26, 0], [0, -1.26, 0], [1e300, 0, 0], [0, -1e300, 1e300]])
    assert grid.cells(outside).tolist() == [-1] * 6


def test_positions_are_multiples_of_the_resolution_for_every_box():
    """Surveys of several docks share their cells; the corners of the box belong to it in spite of rounding."""
    grid = SurveyGrid.covering(Box(-0.3, 0.1, 0.3, 0.7), 0.1, 8)
    assert (grid.first, grid.shape) == ((-3, 1), (8, 7, 7))
    x, y = grid.poses(np.arange(49))[:, :2].T
    assert np.allclose(np.unique(x.round(9)), np.arange(-3, 4) / 10)
    assert np.allclose(np.unique(y.round(9)), np.arange(1, 8) / 10)


@given(COORDINATE, COORDINATE, st.floats(0.0, 3.0))
@settings(max_examples=30)
def test_the_region_is_a_disc(x, y, radius):
    grid = SurveyGrid((-7, 3), (1, 9, 11), 0.4)
    centres = grid.poses(np.arange(99))
    apart = np.hypot(centres[:, 0] - x, centres[:, 1] - y)
    decided = np.abs(apart - radius) > 1e-6
    assert np.array_equal(grid.within(x, y, radius).ravel()[decided], (apart <= radius)[decided])


@pytest.mark.parametrize(
    ("box_", "resolution", "headings", "message"),
    [
        ((0, 0, 1, 1), 0.0, 4, r"survey.resolution: must be > 0 m, got 0.0"),
        ((0, 0, 1, 1), math.nan, 4, r"survey.resolution: must be > 0 m, got nan"),
        ((0, 0, 1, 1), 0.1, 0, r"survey.headings: must be >= 1, got 0"),
        ((0, 0, 1, 1), 0.1, 10**9, r"survey: has \d+ cells, must have 1 to 50000000"),
        ((0.1, 0.1, 0.2, 0.2), 1.0, 4, r"survey: has 0 cells"),
        ((0, 0, 1e6, 1e6), 0.1, 4, r"survey: has \d+ cells"),
        ((0, 0, 1e300, 1e300), 0.1, 4, r"survey.region: is too large for cells of 0.1 m"),
        ((1, 0, 0, 1), 0.1, 4, r"survey.region: must be left, lower, right, upper"),
        ((0, 0, math.inf, 1), 0.1, 4, r"survey.region: must be finite"),
        ((0, math.nan, 1, 1), 0.1, 4, r"survey.region: must be finite"),
    ],
)
def test_wrong_settings_are_named(box_, resolution, headings, message):
    with pytest.raises(InvalidValue, match=message):
        SurveyGrid.covering(Box(*box_), resolution, headings)


def outline(seed, count):
    """Return a star-shaped polygon around the origin, usually not convex."""
    random = np.random.default_rng(seed)
    angles = np.sort(random.uniform(0.0, 2.0 * math.pi, count) * 0.2 + np.arange(count) * 2.0 * math.pi / count)
    return np.column_stack((np.cos(angles), np.sin(angles))) * random.uniform(0.1, 0.6, count)[:, None]


@given(st.integers(0, 2**32), st.sampled_from([0.0, 0.05, 0.3]))
@settings(max_examples=25)
def test_room_agrees_with_distances_of_polygons_and_with_pose_clearances(seed, required):
    random = np.random.default_rng(seed)
    footprint = od.Footprint(outline(seed, int(random.integers(3, 8))))
    rocks = [outline(seed + k, int(random.integers(3, 7))) + random.uniform(-2, 2, 2) for k in range(4)]
    problem = od.DockingProblem(
        Pose2(9.0, 9.0, 0.0),
        od.Dock(Pose2(9.0, 9.0, 0.0)),
        od.Robot(footprint, od.MotionLimits()),
        rocks,
        clearance=od.ClearanceRule(required, 0.0, 0.2),
    )
    poses = np.column_stack((random.uniform(-2.5, 2.5, (60, 2)), random.uniform(-4, 4, 60)))
    bodies = shapely.polygons(transform_points(poses, footprint.vertices))
    union = shapely.union_all([shapely.Polygon(rock) for rock in rocks])
    apart = shapely.distance(bodies, union)
    wanted = np.where(apart == 0.0, OCCUPIED, np.where(apart < required, TIGHT, CLEAR))
    decided = (np.abs(apart - required) > 1e-9) & ((apart == 0.0) | (apart > 1e-9))
    assert np.array_equal(room_at(poses, problem)[decided], wanted[decided])
    clearances, _ = pose_clearances(poses, footprint, problem.all_obstacles)
    decided &= np.abs(clearances) > 1e-9
    assert np.array_equal(wanted[decided] == OCCUPIED, clearances[decided] < 0.0)
    assert np.array_equal(wanted[decided] == CLEAR, clearances[decided] >= max(required, 1e-12))


def test_a_robot_around_an_obstacle_is_occupied():
    """The outline need not cross the outline of the obstacle."""
    problem = od.DockingProblem(
        Pose2(9, 9, 0), od.Dock(Pose2(9, 9, 0)), od.Robot(od.Footprint.rectangle(1, 1, 2), od.MotionLimits()),
        [box(0.2, 0.2, 0.3, 0.3)], clearance=od.ClearanceRule(0.05, 0.0, 0.2),
    )  # fmt: skip
    poses = np.array([[0.25, 0.25, 0.3], [1.32, 0.25, 0.0], [1.5, 0.25, 0.0], [1.29, 0.25, 0.0]])
    assert room_at(poses, problem).tolist() == [OCCUPIED, TIGHT, CLEAR, OCCUPIED]


def test_room_without_obstacles():
    problem = od.DockingProblem(
        Pose2(0, 0, 0), od.Dock(Pose2(0, 0, 0)), od.Robot(od.Footprint.rectangle(1, 1, 2), od.MotionLimits())
    )
    assert room_at(np.zeros((3, 3)), problem).tolist() == [CLEAR] * 3
