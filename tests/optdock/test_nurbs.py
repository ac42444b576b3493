import math
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from optdock.errors import InvalidValue
from optdock.geometry.nurbs import Nurbs

DIFFERENCE = 1e-5
GRID = np.linspace(0.0, 1.0, 23)
THREE = [[0.0, 0.0], [1.0, 1.0], [2.0, 0.0]]


@st.composite
def curves(draw, min_leg=0.0):
    degree = draw(st.integers(1, 4))
    count = draw(st.integers(degree + 1, degree + 4))
    coordinate = st.floats(-10.0, 10.0, allow_subnormal=False).map(lambda value: round(value, 6))
    points = draw(st.lists(st.tuples(coordinate, coordinate), min_size=count, max_size=count))
    assume(np.hypot(*np.diff(points, axis=0).T).min() >= min_leg)
    return Nurbs(points, degree)


def test_a_parabola_has_its_textbook_points_and_tangents():
    # y = x^2 for x in [0, 1] as a Bezier curve.
    curve = Nurbs([[0.0, 0.0], [0.5, 0.0], [1.0, 1.0]])
    np.testing.assert_allclose(curve.points_at(GRID), np.column_stack((GRID, GRID**2)), atol=1e-15)
    np.testing.assert_allclose(curve.tangent_yaw_at(GRID), np.arctan(2.0 * GRID), atol=1e-14)


def test_knots_are_clamped_and_evenly_spaced():
    assert Nurbs(np.zeros((3, 2))).knots.tolist() == [0.0, 0.0, 0.0, 1.0, 1.0, 1.0]
    assert Nurbs(np.zeros((5, 2)), 3).knots.tolist() == [0.0, 0.0, 0.0, 0.0, 0.5, 1.0, 1.0, 1.0, 1.0]


@settings(max_examples=25)
@given(curves())
def test_geomdl_agrees(curve):
    from geomdl import NURBS

    other = NURBS.Curve()
    other.degree = curve.degree
    other.ctrlpts = curve.control_points.tolist()
    other.knotvector = curve.knots.tolist()
    u = [0.0, 0.21, 0.5, 0.77, 1.0]
    np.testing.assert_allclose(curve.points_at(u), other.evaluate_list(u), atol=1e-10)


@settings(max_examples=50)
@given(curves())
def test_curve_and_derivatives_are_those_of_scipy(curve):
    from scipy.interpolate import BSpline

    u = np.concatenate((GRID, curve.knots))
    other = BSpline(curve.knots, curve.control_points, curve.degree)
    for order in range(4):
        found = curve._derivative(u, order)
        expected = other(u, order) if order <= curve.degree else np.zeros_like(found)
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-11)


@settings(max_examples=40)
@given(curves(min_leg=0.1))
def test_tangents_and_speed_bound_agree_with_finite_differences(curve):
    u = np.linspace(0.013, 0.987, 15)
    u = u[np.all(np.abs(u[:, None] - curve.knots) > 2.0 * DIFFERENCE, axis=1)]
    motion = (curve.points_at(u + DIFFERENCE) - curve.points_at(u - DIFFERENCE)) / (2.0 * DIFFERENCE)
    speed = np.hypot(*motion.T)
    assert np.all(speed <= curve.speed_bound * (1.0 + 1e-6) + 1e-6)
    yaw, fast = curve.tangent_yaw_at(u), speed > 1.0
    along = motion[:, 0] * np.cos(yaw) + motion[:, 1] * np.sin(yaw)
    np.testing.assert_allclose(along[fast], speed[fast], rtol=1e-6)


@settings(max_examples=40)
@given(curves(min_leg=0.1))
def test_ends_are_the_outer_control_points_along_the_outer_legs(curve):
    np.testing.assert_allclose(curve.points_at([0.0, 1.0]), curve.control_points[[0, -1]], atol=1e-12)
    legs = np.diff(curve.control_points, axis=0)[[0, -1]]
    apart = curve.tangent_yaw_at([0.0, 1.0]) - np.arctan2(legs[:, 1], legs[:, 0])
    np.testing.assert_allclose(np.remainder(apart + np.pi, 2.0 * np.pi), np.pi, atol=1e-6)


def test_speed_bound_is_attained_at_an_end():
    assert Nurbs([[0.0, 0.0], [3.0, 4.0], [4.0, 4.0]]).speed_bound == pytest.approx(10.0)


def test_where_a_curve_stands_still_the_tangent_is_the_one_it_leaves_or_arrives_with():
    leaving = Nurbs([[0.0, 0.0], [0.0, 0.0], [1.0, 1.0]])
    assert leaving.tangent_yaw_at(0.0)[0] == pytest.approx(math.pi / 4.0)
    arriving = Nurbs(leaving.control_points[::-1])
    np.testing.assert_allclose(arriving.tangent_yaw_at([0.5, 1.0]), -0.75 * math.pi)
    assert np.isnan(Nurbs([[1.0, 2.0]] * 3).tangent_yaw_at(GRID)).all()


def test_the_direction_backwards_is_plus_pi():
    assert Nurbs([[0.0, 0.0], [-1.0, -0.0], [-2.0, -0.0]]).tangent_yaw_at(0.5)[0] == math.pi


def test_arguments_are_clipped_to_the_domain():
    np.testing.assert_array_equal(Nurbs(THREE).points_at([-1.0, 9.0]), [[0.0, 0.0], [2.0, 0.0]])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"control_points": [[0.0, 0.0], [1.0, 1.0]]}, "degree 2 needs at least 3, got 2"),
        ({"control_points": [[0.0, 0.0, 0.0]] * 3}, r"control_points: must have shape \(n, 2\)"),
        ({"control_points": [[0.0, 0.0], [math.nan, 0.0], [1.0, 0.0]]}, "control_points: must be finite"),
        ({"degree": 0}, "degree: must be an integer >= 1, got 0"),
        ({"degree": 1.5}, "degree: must be an integer"),
    ],
)
def test_invalid_curves_are_rejected(arguments, message):
    with pytest.raises(InvalidValue, match=message):
        Nurbs(**{"control_points": THREE, **arguments})


def test_importing_nurbs_does_not_import_scipy():
    code = "import sys, optdock.geometry.nurbs; sys.exit('scipy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
