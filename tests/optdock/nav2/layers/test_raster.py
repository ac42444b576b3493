import numpy as np
import shapely
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from optdock.nav2.layers.raster import cells_of_lines, cells_of_polygons

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


@given(cells)
def test_lines_are_bresenhams(segments):
    found = cells_of_lines(segments[:, 0], segments[:, 1])
    expected = [cell for start, end in segments.tolist() for cell in bresenham(start, end)]
    assert found.cells.tolist() == expected
    assert np.all(np.diff(found.owner) >= 0)


triangles = hnp.arrays(float, (3, 2), elements=st.floats(-6, 6, width=32))


@given(st.lists(triangles, min_size=1, max_size=4))
def test_polygons_meet_the_cells_that_shapely_says_they_meet(corners):
    hulls = [shapely.convex_hull(shapely.MultiPoint(c)) for c in corners]
    assume(all(isinstance(hull, shapely.Polygon) and hull.area > 1e-3 for hull in hulls))
    vertices = np.stack([np.asarray(shapely.geometry.polygon.orient(hull).exterior.coords)[:3] for hull in hulls])
    found = cells_of_polygons(vertices)
    for n, hull in enumerate(hulls):
        mine = {tuple(cell) for cell in found.cells[found.owner == n].tolist()}
        for i, j in np.ndindex(14, 14):
            square = shapely.box(i - 7, j - 7, i - 6, j - 6)
            if hull.intersection(square).area > 1e-9:
                assert (i - 7, j - 7) in mine
            elif hull.distance(square) > 1e-6:
                assert (i - 7, j - 7) not in mine


def test_a_cell_owns_its_lower_and_left_sides():
    square = np.array([[[4.0, 4.0], [6.0, 4.0], [6.0, 6.0], [4.0, 6.0]]])
    found = cells_of_polygons(square).cells
    assert {tuple(c) for c in found.tolist()} == {(i, j) for i in (4, 5, 6) for j in (4, 5, 6)}


def test_no_polygon_meets_no_cell():
    assert cells_of_polygons(np.zeros((0, 4, 2))).cells.shape == (0, 2)
    assert cells_of_lines(np.zeros((0, 2), dtype=np.int64), np.zeros((0, 2), dtype=np.int64)).cells.shape == (0, 2)


def test_many_large_polygons_are_worked_off_in_blocks():
    side = 800.0
    square = np.array([[0.5, 0.5], [side, 0.5], [side, side], [0.5, side]])
    found = cells_of_polygons(np.stack([square, square + 1000.0, square[:, :] * 0.001 + 3.2]))
    assert np.bincount(found.owner).tolist() == [801 * 801, 801 * 801, 4]
