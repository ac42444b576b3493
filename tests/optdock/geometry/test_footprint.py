"""Footprints in Nav2's syntax, and their measures."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from optdock.errors import InvalidValue
from optdock.geometry.footprint import Footprint


def test_nav2_strings_are_read_with_any_separator():
    for text in (
        "[[0.4, 0.3], [-0.4, 0.3], [-0.4, -0.3], [0.4, -0.3]]",
        "[[0.4 0.3],[-0.4 0.3],\t[-0.4 -0.3] [0.4 -0.3]]",
        " [ [ .4 , .3 ] , [-4e-1, 0.3], [-0.4, -0.3], [0.4, -0.3], ] ",
    ):
        footprint = Footprint.from_string(text)
        assert len(footprint.vertices) == 4
        assert footprint.length == pytest.approx(0.8)
        assert footprint.width == pytest.approx(0.6)


@pytest.mark.parametrize(
    "text",
    [
        *("", "[]", "hello", "[[1, 2], [3, 4]]", "[[1, 2], [3, 4], [5]]", "[[0,0],[1,0],[0,x]]", "[[0,0],[1,0],[0,1]"),
        *("[[1, 2, 3], [4, 5, 6], [7, 8, 9]]", "[[[0,0],[1,0],[0,1]]]", "[[0,0],[1,0],[0,1]] [[2,2]]"),
        "[[0,0],[1,0],[nan,1]]",
    ],
)
def test_anything_else_is_refused(text):
    with pytest.raises(InvalidValue, match="footprint"):
        Footprint.from_string(text)


@settings(max_examples=25)
@given(st.floats(1e-3, 50.0), st.floats(0.0, 1.0))
def test_a_round_robot_is_the_polygon_around_its_circle(radius, padding):
    footprint = Footprint.from_radius(radius)
    assert radius <= footprint.inscribed_radius <= radius * (1.0 + 1e-12)
    assert footprint.circumscribed_radius <= 1.005 * radius
    assert footprint.length == pytest.approx(2.0 * radius, rel=1e-12)
    assert footprint.width == pytest.approx(2.0 * radius, rel=1e-12)
    # Padding by the signs of the coordinates keeps at least its distance from the circle, in every direction.
    assert footprint.padded(padding).inscribed_radius >= (radius + padding) * (1.0 - 1e-12)


@pytest.mark.parametrize("radius", [0.0, -1.0, np.nan, np.inf, True, "0.3", None])
def test_a_radius_is_a_positive_number(radius):
    with pytest.raises(InvalidValue, match="footprint.radius: must be (finite and > 0 m|a number)"):
        Footprint.from_radius(radius)


@pytest.mark.parametrize("bad", [10**400, "1", float("nan"), True])
@pytest.mark.parametrize("name", ["front", "rear", "width"])
def test_a_side_that_is_no_number_is_named(name, bad):
    with pytest.raises(InvalidValue, match=f"footprint: {name}: must be"):
        Footprint.rectangle(**{"front": 0.4, "rear": 0.4, "width": 0.4, name: bad})


def test_radii_of_a_rectangle():
    footprint = Footprint.rectangle(0.5, 0.2, 0.6)
    assert footprint.inscribed_radius == pytest.approx(0.2)
    assert footprint.circumscribed_radius == pytest.approx(np.hypot(0.5, 0.3))


def test_a_non_convex_footprint_has_several_bodies():
    arrow = Footprint(np.array([[0.5, 0.0], [-0.5, 0.4], [-0.2, 0.0], [-0.5, -0.4]]))
    assert len(arrow.bodies) == 2


def test_a_self_crossing_footprint_is_refused():
    with pytest.raises(InvalidValue, match="footprint: must not cross"):
        Footprint(np.array([[0.4, 0.3], [-0.4, -0.3], [-0.4, 0.3], [0.4, -0.3]]))
