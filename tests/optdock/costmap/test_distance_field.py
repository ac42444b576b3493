import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from optdock.costmap.costmap import Costmap
from optdock.costmap.distance_field import DistanceField
from optdock.errors import InvalidValue

SIDE = 0.1
masks = hnp.arrays(np.bool_, st.tuples(st.integers(1, 9), st.integers(1, 9)))


def field_of(mask):
    return DistanceField.from_costmap(Costmap(mask.astype(np.uint8) * 254, SIDE, (1.0, -2.0)))


def true_distance(mask, points):
    """Signed distance to the union of the squares, within the map, by shapely."""
    squares = [
        shapely.box(1 + i * SIDE, -2 + j * SIDE, 1 + (i + 1) * SIDE, -2 + (j + 1) * SIDE) for j, i in np.argwhere(mask)
    ]
    free = [
        shapely.box(1 + i * SIDE, -2 + j * SIDE, 1 + (i + 1) * SIDE, -2 + (j + 1) * SIDE) for j, i in np.argwhere(~mask)
    ]
    places = shapely.points(points)
    return shapely.distance(places, shapely.union_all(squares)) - shapely.distance(places, shapely.union_all(free))


@given(masks.filter(lambda m: m.any() and not m.all()), st.integers(0, 2**32 - 1))
def test_the_field_keeps_its_error_bound_on_the_map(mask, seed):
    field = field_of(mask)
    rows, columns = mask.shape
    points = np.array([1.0, -2.0]) + np.random.default_rng(seed).random((30, 2)) * (columns * SIDE, rows * SIDE)
    error = np.abs(field.distance_at(points) - true_distance(mask, points))
    assert error.max() <= field.error_bound + 1e-9


def test_the_bound_is_not_idle():
    mask = np.zeros((9, 9), dtype=bool)
    mask[4, 4] = True
    points = np.array([1.0, -2.0]) + np.random.default_rng(0).random((2000, 2)) * 9 * SIDE
    error = np.abs(field_of(mask).distance_at(points) - true_distance(mask, points))
    assert error.max() > 0.2 * field_of(mask).error_bound


def test_beside_a_long_wall_the_field_is_exact():
    mask = np.zeros((8, 12), dtype=bool)
    mask[:, :3] = True
    x = np.linspace(1.06, 2.14, 40)
    distance = field_of(mask).distance_at(np.column_stack((x, np.full(40, -1.63))))
    np.testing.assert_allclose(distance, x - 1.3, atol=1e-12)


@given(masks, st.integers(0, 2**32 - 1))
def test_off_the_map_the_field_is_a_lower_bound(mask, seed):
    if not mask.any() or mask.all():
        return
    field = field_of(mask)
    points = np.array([1.0, -2.0]) + np.random.default_rng(seed).uniform(-3, 3, (30, 2))
    rows, columns = mask.shape
    off = ~np.all((points >= (1.0, -2.0)) & (points <= (1 + columns * SIDE, -2 + rows * SIDE)), axis=1)
    assert np.all(field.distance_at(points)[off] <= true_distance(mask, points)[off] + field.error_bound + 1e-9)


def test_the_gradient_is_the_slope_of_the_field():
    rng = np.random.default_rng(3)
    field = field_of(rng.random((12, 12)) < 0.2)
    cells, places = rng.integers(1, 10, (200, 2)), rng.uniform(0.1, 0.9, (200, 2))
    points = np.array([1.0, -2.0]) + (cells + 0.5 + places) * SIDE  # between four centres, off the kinks
    eps = 1e-7
    slopes = [
        (field.distance_at(points + step) - field.distance_at(points - step)) / (2 * eps)
        for step in (np.array([eps, 0.0]), np.array([0.0, eps]))
    ]
    np.testing.assert_allclose(field.gradient_at(points), np.column_stack(slopes), atol=1e-6)


def test_without_obstacles_the_distance_is_infinite_and_its_gradient_zero():
    field = field_of(np.zeros((3, 3), dtype=bool))
    assert field.distance_at([[1.1, -1.9]]).tolist() == [np.inf]
    assert field.gradient_at([[1.1, -1.9]]).tolist() == [[0.0, 0.0]]
    assert field_of(np.ones((3, 3), dtype=bool)).distance_at([[1.1, -1.9]]).tolist() == [-np.inf]


def test_a_single_cell_row_works():
    mask = np.array([[False, False, True]])
    np.testing.assert_allclose(field_of(mask).distance_at([[1.05, -1.95], [1.15, -1.99]]), [0.15, 0.05], atol=1e-12)


def test_points_that_are_not_finite_give_nan():
    mask = np.eye(3, dtype=bool)
    assert np.isnan(field_of(mask).distance_at([[np.nan, 0.0]]))[0]


def test_unknown_and_threshold_choose_the_cells():
    costmap = Costmap(np.array([[0, 0, 255], [0, 0, 100]]), 1.0)
    assert DistanceField.from_costmap(costmap).distance_at([[0.5, 0.5]])[0] == pytest.approx(1.5)
    assert DistanceField.from_costmap(costmap, unknown_is_obstacle=False).distance_at([[0.5, 0.5]])[0] == np.inf
    low = DistanceField.from_costmap(costmap, unknown_is_obstacle=False, threshold=100)
    assert low.distance_at([[0.5, 1.5]])[0] == pytest.approx(1.5)
    with pytest.raises(InvalidValue, match="threshold"):
        DistanceField.from_costmap(costmap, threshold=255)
