import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from optdock.errors import InvalidValue
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2, transform_points
from optdock.model.cell_obstacles import cell_rectangles, obstacles_from_costmap
from optdock.model.costmap import Costmap
from optdock.verification import pose_clearance

masks = hnp.arrays(np.bool_, st.tuples(st.integers(1, 12), st.integers(1, 12)))
cost_grids = hnp.arrays(
    np.uint8, st.tuples(st.integers(1, 8), st.integers(1, 8)), elements=st.sampled_from([0, 100, 253, 254, 255])
)


def painted(rectangles, shape):
    """Count how often each cell is covered."""
    counts = np.zeros(shape, dtype=int)
    for i0, j0, i1, j1 in rectangles:
        counts[j0:j1, i0:i1] += 1
    return counts


@settings(max_examples=20)
@given(masks)
def test_rectangles_cover_every_occupied_cell_once_and_nothing_else(mask):
    np.testing.assert_array_equal(painted(cell_rectangles(mask), mask.shape), mask.astype(int))


@settings(max_examples=20)
@given(masks)
def test_transposing_the_grid_transposes_the_number_of_rectangles_only(mask):
    assert len(cell_rectangles(mask)) == len(cell_rectangles(mask.T))


@settings(max_examples=20)
@given(masks)
def test_merging_never_makes_more_rectangles_than_runs(mask):
    runs = np.count_nonzero(np.diff(mask.astype(int), axis=1, prepend=0) == 1)
    assert len(cell_rectangles(mask)) <= runs


def test_a_wall_is_one_rectangle_and_a_checkerboard_one_per_cell():
    wall = np.zeros((20, 30), dtype=bool)
    wall[3:17, 5] = True
    assert cell_rectangles(wall).tolist() == [[5, 3, 6, 17]]
    board = np.indices((6, 6)).sum(axis=0) % 2 == 0
    assert len(cell_rectangles(board)) == 18


@settings(max_examples=20)
@given(cost_grids, st.booleans())
def test_the_area_of_the_union_is_the_area_of_the_cells(data, unknown):
    costmap = Costmap(data, 0.05, (-3.7, 1.1))
    obstacles = obstacles_from_costmap(costmap, unknown_is_obstacle=unknown, border=False)
    cells = np.count_nonzero(data == 254) + unknown * np.count_nonzero(data == 255)
    union = shapely.union_all([shapely.Polygon(vertices) for vertices in obstacles.vertices])
    areas = sum(shapely.Polygon(vertices).area for vertices in obstacles.vertices)
    assert union.area == pytest.approx(cells * 0.05**2, abs=1e-12)
    assert areas == pytest.approx(cells * 0.05**2, abs=1e-12)


def test_neighbouring_rectangles_share_their_coordinates_exactly():
    rng = np.random.default_rng(1)
    costmap = Costmap((rng.random((40, 40)) < 0.5).astype(np.uint8) * 254, 0.1, (0.3, -7.7))
    obstacles = obstacles_from_costmap(costmap, border=False)
    x_lines = {0.3 + 0.1 * i for i in range(41)}
    assert set(obstacles.vertices[:, :, 0].ravel().tolist()) <= x_lines


def test_groups_name_cells_and_border():
    obstacles = obstacles_from_costmap(Costmap(np.array([[254, 0, 255]]), 1.0))
    assert [obstacles.name_of(row) for row in range(len(obstacles))] == ["map", "unknown", *["map border"] * 4]


def test_the_border_surrounds_the_map_without_covering_it():
    costmap = Costmap(np.zeros((3, 5), dtype=int), 0.2, (1.0, 2.0))
    border = shapely.union_all([shapely.Polygon(v) for v in obstacles_from_costmap(costmap).vertices])
    inside = shapely.box(1.0, 2.0, *costmap.upper)
    assert border.intersection(inside).area == pytest.approx(0.0, abs=1e-9)
    assert border.union(inside).buffer(0).contains(shapely.box(-3e8, -3e8, 3e8, 3e8))
    assert len(obstacles_from_costmap(costmap, border=False)) == 0


@settings(max_examples=20)
@given(st.floats(-8.0, 8.0), st.floats(-8.0, 8.0), st.floats(0.0, 6.5), st.integers(-4, 7))
def test_everything_off_the_map_is_an_obstacle_however_far(x, y, yaw, power):
    """Inside the map the clearance is the distance to its edge; outside it is the exact penetration depth."""
    costmap = Costmap(np.zeros((100, 120), dtype=int), 0.1, (-6.0, -5.0))
    pose = Pose2(x * 10.0**power, y * 10.0**power, yaw)
    robot = Footprint.rectangle(0.4, 0.2, 0.5)
    clearance, _ = pose_clearance(pose, robot, obstacles_from_costmap(costmap))
    corners = transform_points(pose.as_array()[None], robot.vertices)[0]
    spare = np.minimum(corners - np.array(costmap.lower), np.array(costmap.upper) - corners).min()
    assert clearance == pytest.approx(spare, abs=1e-12 + 1e-15 * abs(spare))


@settings(max_examples=20)
@given(cost_grids, hnp.arrays(int, (2, 2), elements=st.integers(-500, 1500)))
def test_a_region_gives_the_same_obstacles_inside_it(data, millimetres):
    lower, upper = np.sort(millimetres, axis=0) / 1000.0
    costmap = Costmap(data, 0.1)
    box = shapely.box(*lower, *upper)
    part, whole = (
        shapely.union_all([shapely.Polygon(v) for v in obstacles_from_costmap(costmap, region=region).vertices])
        for region in ((lower, upper), None)
    )
    assert part.intersection(box).area == pytest.approx(whole.intersection(box).area, abs=1e-9)


def test_a_region_excludes_cells_outside():
    costmap = Costmap(np.full((100, 100), 254), 0.1)
    obstacles = obstacles_from_costmap(costmap, region=((2.0, 3.0), (2.05, 3.05)))
    assert len(obstacles) == 1
    np.testing.assert_allclose(obstacles.vertices[0, [0, 2]], [[2.0, 3.0], [2.1, 3.1]])


def test_a_region_off_the_map_meets_only_the_border():
    costmap = Costmap(np.full((4, 4), 254), 0.1)
    names = {obstacles_from_costmap(costmap, region=((5.0, 5.0), (6.0, 6.0))).name_of(0)}
    assert names == {"map border"}
    assert len(obstacles_from_costmap(costmap, region=((5.0, 5.0), (6.0, 6.0)), border=False)) == 0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"region": ((1.0, 0.0), (0.0, 1.0))}, "lower = "),
        ({"region": ((np.nan, 0.0), (0.0, 1.0))}, "region.lower: must be finite"),
        ({"region": ((0.0,), (1.0,))}, "lower = "),
    ],
)
def test_invalid_arguments_are_named(arguments, message):
    with pytest.raises(InvalidValue, match=message):
        obstacles_from_costmap(Costmap(np.zeros((2, 2), dtype=int), 1.0), **arguments)
