import numpy as np
import shapely
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from optdock.nav2.layers.raster import cells_of_lines, cells_of_polygon

cells = hnp.arrays(np.int64, st.tuples(st.integers(0, 5), st.just(2), st.just(2)), elements=st.integers(-20, 20))


def bresenham(start, end):
    """The textbook loop with Nav2's accumulator."""
    (x, y), (x1, y1) = start, end
    dx, dy = abs(x1 - x), abs(y1 - y)
    sx, sy = np.sign(x1 - x), np.sign(y1 - y)
    den, add, is_x = (dx, dy, True) if dx >= dy else (dy, dx, False)
    num, out = den // 2, []
    for _ in range(den + 1):
        out.append([x, y])
        num += add
        over = den and num >= den
        num -= den if over else 0
        x += sx if is_x or over else 0
        y += sy if not is_x or over else 0
    return out


@settings(max_examples=25)
@given(cells)
def test_lines_are_bresenhams(segments):
    found = cells_of_lines(segments[:, 0], segments[:, 1])
    expected = [cell for start, end in segments.tolist() for cell in bresenham(start, end)]
    assert found.cells.reshape(-1, 2).tolist() == expected
    assert np.all(np.diff(found.owner) >= 0)


@settings(max_examples=20)
@given(hnp.arrays(float, (3, 2), elements=st.floats(-6, 6, width=32)))
def test_polygons_meet_the_cells_that_shapely_finds(corners):
    hull = shapely.convex_hull(shapely.MultiPoint(corners))
    assume(isinstance(hull, shapely.Polygon) and hull.area > 1e-3)
    found = cells_of_polygon(np.asarray(shapely.geometry.polygon.orient(hull).exterior.coords)[:3])
    mine = {tuple(cell) for cell in found.tolist()}
    for i, j in np.ndindex(14, 14):
        square = shapely.box(i - 7, j - 7, i - 6, j - 6)
        if hull.intersection(square).area > 1e-9:
            assert (i - 7, j - 7) in mine
        elif hull.distance(square) > 1e-6:
            assert (i - 7, j - 7) not in mine


def test_a_cell_owns_its_lower_and_left_sides():
    found = cells_of_polygon(np.array([[4.0, 4.0], [6.0, 4.0], [6.0, 6.0], [4.0, 6.0]]))
    assert {tuple(c) for c in found.tolist()} == {(i, j) for i in (4, 5, 6) for j in (4, 5, 6)}
