import math
import subprocess
import sys
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from optdock.errors import InvalidValue
from optdock.geometry.nurbs import Nurbs, clamped_knots

DIFFERENCE = 1e-5
HALF = math.sqrt(0.5)


def quarter_circle(radius: float, turn: float = 1.0) -> Nurbs:
    """From (r, 0) to (0, +-r) around the origin ([Piegl1997] section 7.3)."""
    return Nurbs([[radius, 0.0], [radius, turn * radius], [0.0, turn * radius]], [1.0, HALF, 1.0])


class Shape(NamedTuple):
    points: list
    weights: list
    degree: int

    def curve(self) -> Nurbs:
        return Nurbs(self.points, self.weights, self.degree)


@st.composite
def shapes(draw, min_leg=0.0):
    degree = draw(st.integers(1, 4))
    count = draw(st.integers(degree + 1, degree + 4))
    coordinate = st.floats(-10.0, 10.0, allow_subnormal=False).map(lambda value: round(value, 6))
    points = draw(st.lists(st.tuples(coordinate, coordinate), min_size=count, max_size=count))
    weights = draw(st.lists(st.floats(0.1, 10.0), min_size=count, max_size=count))
    legs = np.hypot(*np.diff(points, axis=0).T)
    assume(legs.min() >= min_leg)
    return Shape(points, weights, degree)


GRID = np.linspace(0.0, 1.0, 23)


@pytest.mark.parametrize("radius", [0.01, 1.0, 250.0])
@pytest.mark.parametrize("turn", [1.0, -1.0])
def test_quarter_circle_has_curvature_one_over_radius(radius, turn):
    curvature = quarter_circle(radius, turn).curvature_at(np.linspace(0.0, 1.0, 301))
    np.testing.assert_allclose(curvature * radius, turn, atol=1e-9)


def test_quarter_circle_is_a_circle_of_the_right_heading():
    curve = quarter_circle(2.0)
    points = curve.points_at(GRID)
    np.testing.assert_allclose(np.hypot(*points.T), 2.0, atol=1e-14)
    around = np.arctan2(points[:, 1], points[:, 0]) + 0.5 * math.pi
    np.testing.assert_allclose(curve.tangent_yaw_at(GRID), around, atol=1e-12)


def test_a_parabola_has_its_textbook_curvature():
    # y = x^2 for x in [0, 1] as a Bezier curve: curvature 2 / (1 + 4 x^2)^1.5.
    curve = Nurbs([[0.0, 0.0], [0.5, 0.0], [1.0, 1.0]])
    np.testing.assert_allclose(curve.points_at(GRID), np.column_stack((GRID, GRID**2)), atol=1e-15)
    np.testing.assert_allclose(curve.curvature_at(GRID), 2.0 / (1.0 + 4.0 * GRID**2) ** 1.5, rtol=1e-12)


def test_default_knots_are_clamped():
    assert Nurbs(np.zeros((3, 2))).knots.tolist() == [0.0, 0.0, 0.0, 1.0, 1.0, 1.0]
    assert clamped_knots(5, 3).tolist() == [0.0, 0.0, 0.0, 0.0, 0.5, 1.0, 1.0, 1.0, 1.0]


@given(shapes())
def test_rational_basis_sums_to_one(shape):
    # With every control point in one place the curve is that place times the sum of the basis.
    still = Nurbs([(3.0, -2.0)] * len(shape.points), shape.weights, shape.degree)
    np.testing.assert_allclose(still.points_at(GRID), np.tile([3.0, -2.0], (GRID.size, 1)), rtol=1e-13)


@given(shapes())
def test_a_curve_stays_in_the_box_of_its_control_points(shape):
    points, control = shape.curve().points_at(GRID), np.array(shape.points)
    assert np.all(points >= control.min(axis=0) - 1e-12)
    assert np.all(points <= control.max(axis=0) + 1e-12)


@given(shapes(), st.lists(st.floats(-3.0, 3.0), min_size=6, max_size=6))
def test_affine_maps_of_control_points_map_the_curve(shape, numbers):
    matrix, shift = np.reshape(numbers[:4], (2, 2)), np.array(numbers[4:])
    mapped = Nurbs(np.array(shape.points) @ matrix.T + shift, shape.weights, shape.degree)
    np.testing.assert_allclose(mapped.points_at(GRID), shape.curve().points_at(GRID) @ matrix.T + shift, atol=1e-11)


@given(shapes(), st.floats(0.01, 100.0))
def test_scaling_all_weights_changes_nothing(shape, factor):
    scaled = Nurbs(shape.points, np.array(shape.weights) * factor, shape.degree)
    np.testing.assert_allclose(scaled.points_at(GRID), shape.curve().points_at(GRID), atol=1e-12)


@given(shapes(min_leg=0.1))
def test_a_reversed_curve_runs_back_with_opposite_curvature(shape):
    curve, back = shape.curve(), Nurbs(shape.points[::-1], shape.weights[::-1], shape.degree)
    u = np.linspace(0.013, 0.977, 17)  # off the knots, where one-sided derivatives would be compared
    np.testing.assert_allclose(back.points_at(1.0 - u), curve.points_at(u), atol=1e-11)
    np.testing.assert_allclose(back.derivative_at(1.0 - u), -curve.derivative_at(u), atol=1e-9)
    moving = np.hypot(*curve.derivative_at(u).T) > 1.0
    np.testing.assert_allclose(back.curvature_at(1.0 - u)[moving], -curve.curvature_at(u)[moving], atol=1e-6)


@given(shapes(min_leg=0.1))
def test_derivatives_agree_with_finite_differences(shape):
    curve = shape.curve()
    u = np.linspace(0.013, 0.987, 15)
    u = u[np.all(np.abs(u[:, None] - curve.knots) > 2.0 * DIFFERENCE, axis=1)]
    ahead, behind = curve.points_at(u + DIFFERENCE), curve.points_at(u - DIFFERENCE)
    scale = 1.0 + np.abs(curve.derivative_at(u)).max() * 100.0
    np.testing.assert_allclose(curve.derivative_at(u), (ahead - behind) / (2.0 * DIFFERENCE), atol=1e-5 * scale)
    ahead, behind = curve.derivative_at(u + DIFFERENCE), curve.derivative_at(u - DIFFERENCE)
    scale = 1.0 + np.abs(curve.derivative_at(u, 2)).max() * 100.0
    np.testing.assert_allclose(curve.derivative_at(u, 2), (ahead - behind) / (2.0 * DIFFERENCE), atol=1e-5 * scale)


def test_curvature_agrees_with_the_turn_of_the_tangent():
    curve = Nurbs([[0.0, 0.0], [1.0, 2.0], [3.0, -1.0], [4.0, 1.0]], [1.0, 2.0, 0.5, 1.0], degree=3)
    u = np.linspace(0.01, 0.99, 50)
    turn = curve.tangent_yaw_at(u + DIFFERENCE) - curve.tangent_yaw_at(u - DIFFERENCE)
    speed = np.hypot(*curve.derivative_at(u).T)
    np.testing.assert_allclose(curve.curvature_at(u), turn / (2.0 * DIFFERENCE * speed), atol=1e-6)


@given(shapes())
def test_clamped_ends_lie_on_the_outer_control_points_along_the_outer_legs(shape):
    curve = shape.curve()
    ends = curve.points_at([0.0, 1.0])
    np.testing.assert_allclose(ends, np.array(shape.points)[[0, -1]], atol=1e-12)
    legs = np.diff(shape.points, axis=0)[[0, -1]]
    slope = curve.derivative_at([0.0, 1.0])
    cross = slope[:, 0] * legs[:, 1] - slope[:, 1] * legs[:, 0]
    np.testing.assert_allclose(cross, 0.0, atol=1e-8 * (1.0 + np.abs(slope).max()))
    assert np.all(np.sum(slope * legs, axis=1) >= -1e-9)


@given(shapes())
def test_speed_bound_bounds_the_speed(shape):
    for curve in (shape.curve(), Nurbs(shape.points, None, shape.degree)):
        assert np.hypot(*curve.derivative_at(GRID).T).max() <= curve.speed_bound * (1.0 + 1e-9) + 1e-12


def test_speed_bound_is_attained_at_the_ends_of_a_polynomial_curve():
    curve = Nurbs([[0.0, 0.0], [3.0, 4.0], [4.0, 4.0]])
    assert curve.speed_bound == pytest.approx(10.0)
    assert np.hypot(*curve.derivative_at(0.0)[0]) == pytest.approx(10.0)


@given(shapes())
def test_geomdl_agrees(shape):
    from geomdl import NURBS

    other = NURBS.Curve()
    other.degree = shape.degree
    other.ctrlpts = [list(point) for point in shape.points]
    other.weights = list(shape.weights)
    other.knotvector = clamped_knots(len(shape.points), shape.degree).tolist()
    u = [0.0, 0.21, 0.5, 0.77, 1.0]
    np.testing.assert_allclose(shape.curve().points_at(u), other.evaluate_list(u), atol=1e-10)
    order = min(2, shape.degree)
    theirs = np.array(other.derivatives(0.37, order))
    for k in range(1, order + 1):
        ours = shape.curve().derivative_at(0.37, k)[0]
        np.testing.assert_allclose(ours, theirs[k], atol=1e-7 * (1.0 + np.abs(theirs[k]).max()))


def test_where_a_curve_stands_still_the_tangent_is_the_one_it_leaves_or_arrives_with():
    leaving = Nurbs([[0.0, 0.0], [0.0, 0.0], [1.0, 1.0]])
    assert leaving.tangent_yaw_at(0.0)[0] == pytest.approx(math.pi / 4.0)
    arriving = Nurbs(leaving.control_points[::-1])
    np.testing.assert_allclose(arriving.tangent_yaw_at([0.5, 1.0]), -0.75 * math.pi)
    assert math.isnan(leaving.curvature_at(0.0)[0])
    assert leaving.curvature_at(0.5)[0] == pytest.approx(0.0)


def test_a_curve_in_one_point_has_no_tangent_or_curvature():
    still = Nurbs([[1.0, 2.0]] * 3)
    assert np.isnan(still.tangent_yaw_at(GRID)).all()
    assert np.isnan(still.curvature_at(GRID)).all()


def test_arguments_are_clipped_to_the_domain():
    curve = Nurbs([[0.0, 0.0], [1.0, 1.0], [2.0, 0.0]], knots=[2.0, 2.0, 2.0, 6.0, 6.0, 6.0])
    assert curve.domain == (2.0, 6.0)
    np.testing.assert_array_equal(curve.points_at([-1.0, 9.0]), [[0.0, 0.0], [2.0, 0.0]])


def test_arrays_are_copied_and_read_only():
    given_points = np.array([[0.0, 0.0], [1.0, 1.0], [2.0, 0.0]])
    curve = Nurbs(given_points)
    given_points[0] = 9.0
    assert curve.control_points[0, 0] == 0.0
    for array in (curve.control_points, curve.weights, curve.knots):
        assert not array.flags.writeable


THREE = [[0.0, 0.0], [1.0, 1.0], [2.0, 0.0]]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"control_points": [[0.0, 0.0], [1.0, 1.0]]}, "degree 2 needs at least 3, got 2"),
        ({"control_points": [[0.0, 0.0, 0.0]] * 3}, r"control_points: must have shape \(n, 2\)"),
        ({"control_points": [[0.0, 0.0], [math.nan, 0.0], [1.0, 0.0]]}, "control_points: must be finite"),
        ({"degree": 0}, "degree: must be an integer >= 1, got 0"),
        ({"degree": 1.5}, "degree: must be an integer"),
        ({"weights": [1.0, 1.0]}, "weights: must be one per control point = 3, got 2"),
        ({"weights": [1.0, 0.0, 1.0]}, "weights: must be > 0, got 0.0"),
        ({"weights": [1.0, -1.0, 1.0]}, "weights: must be > 0, got -1.0"),
        ({"weights": [1.0, math.inf, 1.0]}, "weights: must be finite"),
        ({"knots": [0.0, 0.0, 1.0, 1.0]}, r"knots: must be control points \+ degree \+ 1 = 6 values, got 4"),
        ({"knots": [0.0, 0.0, 0.5, 0.4, 1.0, 1.0]}, "knots: must never decrease"),
        ({"knots": [0.0, 0.0, 1.0, 1.0, 1.0, 1.0]}, "domain .* is empty"),
        ({"control_points": [*THREE, [3.0, 0.0]], "degree": 1, "knots": [0.0, 0.0, 0.5, 0.5, 1.0, 1.0]}, "repeated"),
    ],
)
def test_broken_curves_are_refused_with_their_rule(arguments, message):
    with pytest.raises(InvalidValue, match=message):
        Nurbs(**{"control_points": THREE, **arguments})


def test_orders_out_of_range_are_refused():
    curve = Nurbs(THREE)
    with pytest.raises(InvalidValue, match="order of a derivative must be 1 or 2, got 3"):
        curve.derivative_at(0.5, order=3)


def test_importing_nurbs_does_not_import_scipy():
    code = "import sys, optdock.geometry.nurbs; sys.exit('scipy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
