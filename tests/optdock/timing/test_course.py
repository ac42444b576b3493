from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from optdock.limits import MotionLimits
from optdock.path import Direction, Path
from optdock.timing.course import Slowness, course_of


@pytest.fixture
def course(make, all_limits):
    segment = make.spline([0.3, 0.2, 0.5], [0.0, 1.0, -0.5, 0.5])
    return course_of(segment, Slowness(all_limits, Direction.FORWARD), 0.7, 0.1)


def test_knots_and_the_zone_start_are_nodes(course):
    for s in (0.0, 0.3, 0.5, 0.7, 1.0):
        assert np.min(np.abs(course.s - s)) < 1e-15
    assert np.all(np.diff(course.s) > 0.0)


def test_rates_on_both_sides_of_a_knot_are_kept_apart(course):
    knot = int(np.argmin(np.abs(course.s - 0.3)))
    assert course.rate_right[knot - 1] == pytest.approx(1.0 / 0.3)
    assert course.rate_left[knot] == pytest.approx(-1.5 / 0.2)


def test_slowness_is_the_reciprocal_of_the_strictest_cap(all_limits):
    k = np.linspace(-3.0, 3.0, 41)
    bend, free = np.maximum(np.abs(k), 1e-12), all_limits
    caps = [
        np.full(k.size, free.max_reverse_speed),
        free.max_yaw_rate / bend,
        np.sqrt(free.max_lateral_acceleration / bend),
        free.max_wheel_speed / (1.0 + 0.5 * free.track_width * bend),
    ]
    np.testing.assert_allclose(1.0 / Slowness(free, Direction.REVERSE).at(k), np.min(caps, axis=0), rtol=1e-12)


def test_unlimited_bounds_vanish():
    found = Slowness(MotionLimits(), Direction.FORWARD).at(np.array([0.0, 100.0]))
    np.testing.assert_array_equal(found, [2.0, 2.0])


def test_the_zone_counts_from_its_start_on(course):
    points = course.points_at(np.array([0.7 - 1e-9, 0.7, 1.0]))
    assert points.slowness[0] < 5.0
    assert points.slowness[1] == points.slowness[2] == 10.0


@pytest.mark.parametrize("start", [0.0, 0.1234, 0.3, 0.7, 0.99])
def test_the_rest_of_a_course_is_the_course(course, start):
    rest = course.after(start)
    assert rest.length == pytest.approx(course.length - start)
    s = np.linspace(1e-6, rest.length, 300)
    for mine, whole in zip(rest.points_at(s), course.points_at(s + start), strict=True):
        agree = np.abs(mine - whole) < 1e-9
        assert np.mean(agree) > 0.99  # rounding may put a node on its other side


def test_polyline_and_clothoid_of_the_same_arc_agree(all_limits):
    angle = np.linspace(0.0, 1.0, 400)
    arc = Path.from_poses(np.column_stack((np.sin(angle), 1.0 - np.cos(angle), angle)))
    found = course_of(arc.segments[0], Slowness(all_limits, Direction.FORWARD), math.inf, math.inf)
    np.testing.assert_allclose(found.curvature, 1.0, atol=1e-9)
    assert found.length == pytest.approx(1.0, abs=1e-9)


def test_cap_binds_where_its_limit_is_tight(make):
    limits = dataclasses.replace(MotionLimits(), max_lateral_acceleration=0.1)
    course = course_of(make.spline([1.0], [0.0, 2.0]), Slowness(limits, Direction.FORWARD), math.inf, math.inf)
    assert 1.0 / course.slowness[-1] == pytest.approx(math.sqrt(0.05))


@pytest.mark.parametrize("beside", [-1e-13, -(2.0**-52), 0.0, 2.0**-52, 1e-13])
def test_a_zone_that_begins_at_a_knot_give_or_take_rounding_begins_at_its_node(make, all_limits, beside):
    segment = make.spline([0.3, 0.4, 0.3], [0.0, 1.0, 0.0, 0.0])
    course = course_of(segment, Slowness(all_limits, Direction.FORWARD), float(segment.knots[2]) + beside, 0.1)
    assert course.zone_start in course.s
    assert np.min(np.diff(course.s)) > 1e-3
    first = int(np.searchsorted(course.s, course.zone_start))
    assert course.points_at(course.s[first : first + 1]).slowness[0] == 10.0
    rest = course.after(0.5)
    assert rest.zone_start in rest.s


def test_a_course_cut_just_before_its_zone_is_in_the_zone(course):
    rest = course.after(course.zone_start - 1e-13)
    assert rest.zone_start == 0.0
    assert rest.begin == pytest.approx(course.zone_start)


@pytest.mark.parametrize(
    ("limit", "value"),
    [
        ("max_speed", 0.1),
        ("max_yaw_rate", 0.05),
        ("max_lateral_acceleration", 0.001),
        ("max_wheel_speed", 0.02),
    ],
)
def test_the_limit_that_decides_has_its_name(make, limit, value):
    limits = dataclasses.replace(MotionLimits(track_width=0.4), **{limit: value})
    course = course_of(make.spline([1.0], [1.0, 1.0]), Slowness(limits, Direction.FORWARD), 0.8, 0.01)
    name, words = course.cap_at(0.5)
    assert (name, words.split(" = ")[0]) == (limit, limit)
    assert f" = {value:.4g} " in words
    assert course.cap_at(0.9) == ("approach_speed", "approach_speed = 0.01 m/s")
