import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from optdock.errors import InvalidValue
from optdock.model.costmap import LETHAL, NO_INFORMATION, Costmap


def grid(**changes):
    values = {"data": np.arange(12).reshape(3, 4), "resolution": 0.1, "origin": (1.0, -2.0), **changes}
    return Costmap(**values)


def test_row_zero_is_the_lowest_y_and_column_zero_the_lowest_x():
    costmap = grid()
    assert costmap.cost_at([[1.05, -1.95], [1.15, -1.95], [1.05, -1.85]]).tolist() == [0, 1, 4]
    assert costmap.upper == pytest.approx((1.4, -1.7))


def test_a_cell_owns_its_lower_and_left_sides():
    costmap = grid(resolution=0.5, origin=(0.0, 0.0))
    assert costmap.cell_of([[0.0, 0.0], [0.5, 0.499], [0.499, 0.5]]).tolist() == [[0, 0], [1, 0], [0, 1]]


@settings(max_examples=20)
@given(
    st.integers(-50, 50),
    st.integers(-50, 50),
    st.floats(0.01, 2.0),
    st.floats(-100, 100),
    st.floats(-100, 100),
)
def test_the_centre_of_a_cell_lies_in_it(i, j, resolution, x, y):
    costmap = grid(resolution=resolution, origin=(x, y))
    assert costmap.cell_of(costmap.centre_of([[i, j]])).tolist() == [[i, j]]


@pytest.mark.parametrize(
    "point", [(0.99, -1.9), (1.41, -1.9), (1.1, -2.01), (1.1, -1.69), (np.nan, -1.9), (np.inf, -1.9), (1.1, -1e300)]
)
def test_off_the_map_is_unknown(point):
    costmap = grid()
    assert costmap.cost_at([point]).tolist() == [NO_INFORMATION]
    assert not costmap.contains([point])[0]


def test_costs_are_copied_and_read_only():
    data = np.zeros((2, 2), dtype=np.uint8)
    costmap = Costmap(data, 1.0)
    data[0, 0] = LETHAL
    assert costmap.data[0, 0] == 0
    with pytest.raises(ValueError, match="read-only"):
        costmap.data[0, 0] = 1


def test_a_writable_grid_can_be_written_and_its_frozen_copy_cannot():
    master = Costmap.writable((2, 3), 0.1, (0.0, 0.0), fill=7)
    master.data[0, 0] = 9
    frozen = master.frozen()
    master.data[0, 0] = 1
    assert frozen.data.tolist() == [[9, 7, 7], [7, 7, 7]]
    assert not frozen.data.flags.writeable


def test_with_data_keeps_the_place_and_refuses_another_shape():
    costmap = grid().with_data(np.ones((3, 4), dtype=int))
    assert costmap.origin == (1.0, -2.0)
    assert costmap.data.sum() == 12
    with pytest.raises(InvalidValue, match=r"shape \(3, 4\)"):
        costmap.with_data(np.ones((4, 3), dtype=int))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"resolution": 0.0}, "resolution: must be finite and > 0 m, got 0.0"),
        ({"resolution": -0.1}, "resolution"),
        ({"resolution": np.nan}, "resolution"),
        ({"resolution": np.inf}, "resolution"),
        ({"origin": (np.nan, 0.0)}, "origin"),
        ({"origin": (0.0, 0.0, 0.0)}, "origin"),
        ({"origin": None}, "costmap.origin: must be two finite numbers"),
        ({"resolution": 1e308}, "upper corner must be finite"),
        ({"data": np.zeros((0, 4), dtype=int)}, "at least one cell"),
        ({"data": np.zeros(4, dtype=int)}, r"shape \(rows, columns\)"),
        ({"data": np.zeros((2, 2))}, "must be integers, got float64"),
        ({"data": np.full((2, 2), 256)}, r"0\.\.255, got 256"),
        ({"data": np.full((2, 2), -1)}, r"0\.\.255, got -1"),
    ],
)
def test_invalid_values_are_named(changes, message):
    with pytest.raises(InvalidValue, match=message):
        grid(**changes)
