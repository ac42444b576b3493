"""Polygons: checks, convexity, decomposition; compared with shapely."""

import math

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from optdock.errors import InvalidValue
from optdock.geometry.polygon import (
    convex_pieces,
    edge_normals,
    edge_planes,
    is_convex,
    signed_area,
    simple_polygon,
    strictly_convex,
)

L_SHAPE = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [1.0, 1.0], [1.0, 2.0], [0.0, 2.0]])


def star(seed, n=9):
    rng = np.random.default_rng(seed)
    angle = np.sort(rng.uniform(0.0, 2.0 * np.pi, n))
    return rng.uniform(0.3, 1.0, n)[:, None] * np.column_stack((np.cos(angle), np.sin(angle)))


@settings(max_examples=25)
@given(st.integers(0, 3000))
def test_pieces_are_convex_and_cover_exactly_the_polygon(seed):
    points = star(seed)
    if not shapely.Polygon(points).is_valid:
        with pytest.raises(InvalidValue):
            simple_polygon(points, "p")
        return
    polygon = simple_polygon(points, "p")
    pieces = convex_pieces(polygon)
    shapes = [shapely.Polygon(piece) for piece in pieces]
    assert all(is_convex(piece) for piece in pieces)
    assert sum(s.area for s in shapes) == pytest.approx(shapely.Polygon(points).area, rel=1e-9)
    assert shapely.union_all(shapes).symmetric_difference(shapely.Polygon(points)).area < 1e-9


def test_an_l_is_two_pieces_in_both_orientations():
    assert len(convex_pieces(simple_polygon(L_SHAPE, "L"))) == 2
    assert len(convex_pieces(simple_polygon(L_SHAPE[::-1], "L"))) == 2


def test_a_convex_polygon_is_one_piece():
    square = [[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]]
    assert len(convex_pieces(simple_polygon(square, "s"))) == 1


@pytest.mark.parametrize(
    ("points", "message"),
    [
        ([[0, 0], [1, 1]], "at least 3 distinct"),
        ([[0, 0], [0, 0], [1, 1], [1, 1]], "at least 3 distinct"),
        ([[0, 0], [1, 0], [2, 0]], "no area|cross or touch"),
        ([[0, 0], [1, 1], [1, 0], [0, 1]], "cross or touch"),
        ([[0, 0], [1, np.nan], [1, 0]], "must be finite"),
        ([0, 1, 2], "must have shape"),
        ([["a", "b"]], "must be numbers"),
        ([], "must have shape|at least 3"),
    ],
)
def test_invalid_polygons_are_rejected_by_name(points, message):
    with pytest.raises(InvalidValue, match=f"thing.*({message})"):
        simple_polygon(points, "thing")


def test_a_pentagram_turns_twice_and_is_refused():
    angle = np.arange(5) * 4.0 * np.pi / 5.0
    points = np.column_stack((np.cos(angle), np.sin(angle)))
    assert not is_convex(points)
    with pytest.raises(InvalidValue, match="cross or touch"):
        simple_polygon(points, "pentagram")


def test_a_closed_ring_loses_its_repeated_vertex():
    ring = [[0, 0], [1, 0], [1, 1], [0, 1], [0, 0]]
    assert len(simple_polygon(ring, "ring")) == 4


def test_orientation_is_made_counter_clockwise():
    assert signed_area(simple_polygon(L_SHAPE[::-1], "L")) == pytest.approx(3.0)


def test_normals_point_outward_and_padding_repeats_the_last_real_one():
    padded = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.0, 1.0]])
    normals = edge_normals(padded)
    assert np.allclose(normals[0], [0.0, -1.0])
    assert np.allclose(normals[1], np.sqrt([0.5, 0.5]))
    assert np.allclose(normals[2], normals[1])
    assert np.allclose(normals[3], [-1.0, 0.0])


def test_a_star_of_many_points_is_decomposed_quickly_into_few_pieces():
    """The time per vertex must not grow: one pass over the diagonals, no restart after every merge."""
    count = 1200
    angle = 2.0 * np.pi * np.arange(count) / count
    radius = 1.0 + 0.3 * (-1.0) ** np.arange(count)
    star = np.column_stack((radius * np.cos(angle), radius * np.sin(angle)))
    pieces = convex_pieces(simple_polygon(star, "star"))
    assert len(pieces) <= count // 2 + 1
    assert all(is_convex(piece) for piece in pieces)
    assert sum(signed_area(piece) for piece in pieces) == pytest.approx(signed_area(star), rel=1e-12)


def dented_wall(length, dents, depth):
    """A square block whose upper side sags by `depth` along a parabola of reflex vertices."""
    x = np.linspace(0.5 * length, -0.5 * length, dents + 2)
    top = np.column_stack((x, depth * ((2.0 * x / length) ** 2 - 1.0)))
    return np.vstack((top, [[-0.5 * length, -length], [0.5 * length, -length]]))


@pytest.mark.parametrize(("length", "dents"), [(4000.0, 1), (100.0, 200), (100.0, 1000), (1e6, 1)])
def test_flat_dents_do_not_add_up(length, dents):
    """Every single turn is below a billionth of a radian, but their sum makes the wall concave."""
    wall = simple_polygon(dented_wall(length, dents, 0.4e-9 * length * max(dents, 2) / 4.0), "wall")
    assert not is_convex(wall)
    pieces = convex_pieces(wall)
    assert sum(signed_area(piece) for piece in pieces) == pytest.approx(signed_area(wall), rel=1e-9)


@settings(max_examples=25)
@given(st.integers(0, 1000), st.floats(0.0, 3e-9))
def test_pieces_cover_the_polygon_and_exceed_it_by_at_most_a_nanometre(seed, depth):
    rng = np.random.default_rng(seed)
    wall = dented_wall(float(rng.uniform(0.5, 20.0)), int(rng.integers(1, 9)), depth) @ _turned(rng.uniform(0.0, 7.0))
    pieces = convex_pieces(simple_polygon(wall, "wall"))
    reach = [edge_planes(piece) for piece in pieces]
    inside = rng.dirichlet(np.ones(len(wall)), 50) @ wall
    inside = inside[shapely.contains_xy(shapely.Polygon(wall), inside)]
    for point in np.vstack((inside, wall)):
        assert min(float(np.max(normals @ point - offsets)) for normals, offsets in reach) <= 1e-13 * len(wall) * 20.0
    outline = shapely.Polygon(wall)
    for piece in pieces:
        assert max(outline.distance(shapely.Point(corner)) for corner in piece) <= 1.1e-9


def _turned(angle):
    return np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])


@pytest.mark.parametrize("order", [[0, 0, 1, 2], [0, 1, 2, 0], [0, 0, 0, 1], [1, 1, 1, 1]])
def test_vertices_repeated_at_the_beginning_have_normals_as_well(order):
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])[order]
    normals, reach = edge_planes(corners)
    assert np.hypot(*normals.T) == pytest.approx(1.0)
    assert np.all(corners @ normals.T <= reach + 1e-15)


def test_the_normal_of_a_denormal_edge_is_a_unit_vector():
    normals, offsets = edge_planes(np.array([[0.0, 0.0], [1e-323, 5e-324], [1.0, 1.0], [-1.0, 1.0]]))
    assert np.hypot(*normals.T) == pytest.approx(1.0, abs=1e-15)
    assert np.all(normals @ np.array([0.3, 0.9]) <= offsets)


@settings(max_examples=25)
@given(st.integers(0, 3000))
def test_no_vertex_lies_beyond_a_plane(seed):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(6, 2)) * 10.0 ** rng.uniform(-3.0, 5.0)
    normals, offsets = edge_planes(points)
    assert np.all(np.max(normals @ points.T, axis=1) <= offsets + 1e-14 * np.max(np.abs(points)))


COORDINATE = st.one_of(
    st.integers(-2, 2).map(float),
    st.floats(-3.0, 3.0),
    st.sampled_from([math.nan, math.inf, 1e8, -2e8, 5e-324, 1e300]),
    st.builds(lambda whole, part: whole + part, st.integers(-2, 2), st.floats(-1e-9, 1e-9)),
)


@settings(max_examples=100)
@given(st.lists(st.lists(st.tuples(COORDINATE, COORDINATE), min_size=1, max_size=6), min_size=1, max_size=5))
def test_polygons_checked_together_are_those_checked_one_by_one(polygons):
    for polygon, found in zip(polygons, strictly_convex(polygons), strict=True):
        if found is not None:  # others are checked one by one
            (piece,) = convex_pieces(simple_polygon(polygon, "p"))
            assert piece.tobytes() == found.tobytes()


@settings(max_examples=50)
@given(st.integers(0, 3000), st.booleans(), st.sampled_from(["open", "closed", "padded"]))
def test_convex_polygons_of_any_size_are_found_together(seed, is_clockwise, kind):
    rng = np.random.default_rng(seed)
    polygons = []
    for corners in rng.integers(3, 8, 6):
        angle = 2.0 * np.pi * (np.arange(corners) + rng.uniform(0.1, 0.4, corners)) / corners
        circle = rng.uniform(-9.0, 9.0, 2) + rng.uniform(0.01, 5.0) * np.column_stack((np.cos(angle), np.sin(angle)))
        more = {"open": [], "closed": [0], "padded": [-1, -1]}[kind]
        polygons.append(np.concatenate((circle, circle[more]))[:: -1 if is_clockwise and kind != "padded" else 1])
    found = strictly_convex([*polygons, L_SHAPE, "abc", [[0, 0], [1]], np.zeros((3, 2), dtype=bool)])
    assert found[6:] == [None] * 4
    for polygon, one in zip(polygons, found[:6], strict=True):
        (piece,) = convex_pieces(simple_polygon(polygon, "p"))
        assert piece.tobytes() == one.tobytes()
