import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from optdock.model.costmap import Costmap
from optdock.nav2.layers.window import moved_grid, shifted


@given(st.integers(1, 6), st.integers(1, 6), st.integers(-8, 8), st.integers(-8, 8))
def test_shifting_moves_the_view_cell_by_cell(height, width, columns, rows):
    data = np.arange(1, height * width + 1, dtype=np.uint8).reshape(height, width)
    moved = shifted(data, columns, rows, 0)
    for j, i in np.ndindex(height, width):
        inside = 0 <= j + rows < height and 0 <= i + columns < width
        assert moved[j, i] == (data[j + rows, i + columns] if inside else 0)


def grid(shape=(3, 3), resolution=0.5, origin=(0.0, 0.0), fill=9):
    return Costmap.writable(shape, resolution, origin, fill)


def test_what_overlaps_is_kept():
    assert moved_grid(grid(), grid(origin=(0.5, -0.5)), 1).data.tolist() == [[1, 1, 1], [9, 9, 1], [9, 9, 1]]


def test_another_size_resolution_or_raster_is_not_kept():
    for target in (grid((3, 4)), grid(resolution=0.4), grid(origin=(0.2, 0.0))):
        assert np.all(moved_grid(grid(), target, 1).data == 1)
    assert np.all(moved_grid(None, grid(), 1).data == 1)
