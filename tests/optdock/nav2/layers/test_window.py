import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from optdock.model.costmap import Costmap
from optdock.nav2.layers.window import EVERYWHERE, NOWHERE, grown_by_points, joined, window_of
from optdock.plugins.interfaces import Bounds

numbers = st.floats(-3.0, 3.0)
GRID = Costmap.writable((6, 8), 0.5, (-1.0, -2.0))


def ordered(a, b, c, d):
    return Bounds(min(a, c), min(b, d), max(a, c), max(b, d))


boxes = st.builds(ordered, numbers, numbers, numbers, numbers)


@given(boxes, boxes, boxes)
def test_joining_is_a_semilattice_with_nowhere_at_the_bottom(a, b, c):
    assert joined(a, a) == joined(a, NOWHERE) == a
    assert joined(a, b) == joined(b, a)
    assert joined(joined(a, b), c) == joined(a, joined(b, c))
    assert joined(a, EVERYWHERE) == EVERYWHERE


@given(boxes, numbers, numbers)
def test_a_window_holds_the_cell_of_every_point_in_the_bounds(box, u, v):
    point = [np.clip(u, box.min_x, box.max_x), np.clip(v, box.min_y, box.max_y)]
    (i, j) = GRID.cell_of([point])[0]
    min_i, min_j, max_i, max_j = window_of(GRID, box)
    if GRID.contains([point])[0]:
        assert min_i <= i < max_i
        assert min_j <= j < max_j
    assert 0 <= min_i <= max_i <= GRID.columns
    assert 0 <= min_j <= max_j <= GRID.rows


@pytest.mark.parametrize(
    ("bounds", "window"),
    [
        (EVERYWHERE, (0, 0, 8, 6)),
        (NOWHERE, (0, 0, 0, 0)),
        (Bounds(-1.0, -2.0, -1.0, -2.0), (0, 0, 1, 1)),
        (Bounds(-0.6, -1.6, 0.1, -1.4), (0, 0, 3, 2)),
    ],
)
def test_windows_by_hand(bounds, window):
    assert window_of(GRID, bounds) == window


def test_bounds_grow_to_points():
    assert grown_by_points(NOWHERE, np.array([[1.0, 2.0], [0.0, 3.0]])) == (0.0, 2.0, 1.0, 3.0)
    assert grown_by_points(NOWHERE, np.zeros((0, 2))) == NOWHERE
