"""First variables: fitted to headings, pursued, taken from an earlier result, and brought within the curvature rate."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.model.dock import Dock
from optdock.model.limits import MotionLimits
from optdock.model.path import Path
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from optdock.verification import certify_path
from smoothers.casadi_smoother import CasadiSmoother
from smoothers.scp.basis import basis_for
from smoothers.scp.collision.collision_scene import scene_around
from smoothers.scp.cost import Weights
from smoothers.scp.goal_projection import clipped, limit_rate, rate_is_kept
from smoothers.scp.initial_guess import InitialGuesses, pure_pursuit, rest_of_earlier_result
from smoothers.scp.nlp import Ends, Formulation, VariableBounds, formulate, shape_for, trace
from smoothers.scp.rollout import Variables, roll_out
from smoothers.scp.settings import DEFAULT_SETTINGS

SETTINGS = DEFAULT_SETTINGS
FORMULATION = Formulation(Weights(), 24, 0.0625)
BASIS = basis_for(((6, 2), (5, 2)))
LENGTHS = np.array([1.5, 0.8])


def bounds_of(basis, limit, rate):
    lower = np.concatenate((np.full(basis.num_knots, -limit), np.full(basis.num_gears, 0.05)))
    upper = np.concatenate((np.full(basis.num_knots, limit), np.full(basis.num_gears, 20.0)))
    return VariableBounds(lower, upper, rate)


curvatures = st.lists(st.floats(-3.0, 3.0), min_size=BASIS.num_knots, max_size=BASIS.num_knots).map(np.array)


@settings(max_examples=25)
@given(curvatures, st.floats(0.1, 50.0))
def test_limiting_the_rate_keeps_it(curvature, rate):
    bounds = bounds_of(BASIS, 3.0, rate)
    limited = limit_rate(BASIS, Variables(curvature, LENGTHS), bounds)
    assert rate_is_kept(BASIS, limited, bounds)
    assert np.abs(limited.curvature).max() <= 3.0 + 1e-12


@settings(max_examples=25)
@given(curvatures, st.floats(0.1, 50.0))
def test_limiting_the_rate_twice_changes_nothing(curvature, rate):
    bounds = bounds_of(BASIS, 3.0, rate)
    once = limit_rate(BASIS, Variables(curvature, LENGTHS), bounds)
    assert limit_rate(BASIS, once, bounds).curvature == pytest.approx(once.curvature, abs=1e-9)


@settings(max_examples=25)
@given(curvatures)
def test_limiting_the_rate_leaves_fixed_ends_alone(curvature):
    bounds = bounds_of(BASIS, 3.0, 4.0)
    bounds.lower[0] = bounds.upper[0] = curvature[0] = 0.7
    bounds.lower[BASIS.num_knots - 1] = bounds.upper[BASIS.num_knots - 1] = curvature[-1] = 0.0
    limited = limit_rate(BASIS, Variables(curvature, LENGTHS), bounds)
    assert limited.curvature[0] == pytest.approx(0.7, abs=1e-12)
    assert limited.curvature[-1] == pytest.approx(0.0, abs=1e-12)


def test_an_unlimited_rate_is_left_alone():
    wild = Variables(np.tile([3.0, -3.0], 7)[: BASIS.num_knots], LENGTHS)
    assert limit_rate(BASIS, wild, bounds_of(BASIS, 3.0, np.inf)) is wild


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("turned", [-1.0, 0.0, 1.2])
def test_a_pursuit_ends_on_the_line_it_pursues(sign, turned):
    basis = basis_for(((24, 3),))
    x = sign * np.linspace(0.0, 6.0, basis.num_nodes)
    ends = Ends(np.array([0.0, 0.0, turned]), np.array([6.0 * sign, 0.0, 0.0]), np.array([sign]))
    bounds = bounds_of(basis, 1.5, 6.0)
    variables = clipped(pure_pursuit(basis, np.column_stack((x, 0.0 * x)), ends, bounds, SETTINGS.guess), bounds)
    driven = roll_out(basis, variables, ends.start, ends.signs)
    assert abs(driven.poses[-1, 1]) < 0.15
    assert abs(driven.poses[-1, 0] - 6.0 * sign) < 0.3
    assert abs(driven.poses[-1, 2]) < 0.2
    assert np.abs(driven.curvature).max() <= 1.5 + 1e-9


def guesses_for(points, start_yaw=0.0):
    path = Path.from_poses(points)
    start = Pose2(points[0, 0], points[0, 1], start_yaw)
    robot = Robot(Footprint.rectangle(0.45, 0.45, 0.6), MotionLimits(max_curvature=1.5, max_curvature_rate=6.0))
    problem = DockingProblem(start, Dock(path.end), robot)
    scene = scene_around(problem, points[:, :2], 1.0, SETTINGS.collision)
    return InitialGuesses(formulate(path, problem, scene, FORMULATION, None, SETTINGS))


def test_a_smooth_input_is_fitted_and_driving_it_gives_much_the_same():
    angle = np.linspace(0.0, 1.2, 60)
    guesses = guesses_for(np.column_stack((3.0 * np.sin(angle), 3.0 - 3.0 * np.cos(angle), angle)))
    assert guesses.first.variables is guesses.fitted
    assert guesses.other is None


def test_an_input_that_starts_sideways_is_driven_and_the_fit_is_the_other_guess():
    points = np.column_stack((np.linspace(0.0, 4.0, 60), np.zeros(60), np.zeros(60)))
    guesses = guesses_for(points, start_yaw=1.4)
    assert guesses.first.variables is guesses.pursued
    assert guesses.other.variables is guesses.fitted


@pytest.mark.parametrize("turned", [-1.3, 1.0])
def test_a_start_with_another_heading_is_corrected_in_motion(cases, turned):
    problem = cases.open_problem(Pose2(5.0, 0.0, 0.0), start=Pose2(0.0, 0.0, turned))
    raw = cases.kinked((0.0, 0.0), (2.5, 0.0), (5.0, 0.0))
    result = CasadiSmoother().smooth(raw, 30.0, problem=problem)
    assert certify_path(result.path, problem).certified


def test_spans_follow_the_lengths_and_are_never_too_few():
    shape = shape_for(np.array([4.0, 1.0, 0.05]), FORMULATION, 1.0, SETTINGS.resolution)
    spans = [q for q, _ in shape]
    assert spans[0] > spans[1] >= spans[2] >= 4
    assert all(2 <= r <= 12 for _, r in shape)


def test_a_long_path_has_more_spans():
    shapes = [shape_for(np.array([x]), FORMULATION, 0.8, SETTINGS.resolution) for x in (5.0, 30.0)]
    few, many = (sum(q for q, _ in shape) for shape in shapes)
    assert few == 24
    assert many >= 30.0 / 0.8


def test_headings_follow_the_motion_and_not_the_yaws_of_the_input():
    straight = np.column_stack((np.linspace(0.0, 2.0, 30), np.zeros(30), 0.4 * np.ones(30)))
    path, basis = Path.from_poses(straight), basis_for(((8, 2),))
    assert trace(path, basis, np.array([2.0]), np.ones(1), 0.0).headings == pytest.approx(0.0, abs=1e-9)


def test_headings_are_continuous_over_a_full_turn():
    angle = np.linspace(0.0, 2.5 * math.pi, 200)
    circle = np.column_stack((np.sin(angle), 1.0 - np.cos(angle), np.remainder(angle + math.pi, 2 * math.pi) - math.pi))
    path, basis = Path.from_poses(circle), basis_for(((24, 3),))
    headings = trace(path, basis, np.array([path.length]), np.ones(1), 0.0).headings
    assert np.diff(headings) == pytest.approx(2.5 * math.pi / basis.num_intervals, rel=0.05)


def test_an_earlier_result_is_of_no_use_to_a_robot_far_from_it(cases):
    smoother, raw, goal = CasadiSmoother(), cases.kinked((0.0, 0.0), (2.0, 0.2), (4.0, 0.0)), Pose2(4.0, 0.0, 0.0)
    near, far = cases.open_problem(goal), cases.open_problem(goal, start=Pose2(0.0, 3.0, 0.0))
    earlier = smoother.smooth(raw, 30.0, problem=near).path
    assert rest_of_earlier_result(earlier, raw, near, SETTINGS.guess) is not None
    assert rest_of_earlier_result(earlier, raw, far, SETTINGS.guess) is None
    assert rest_of_earlier_result(raw, raw, near, SETTINGS.guess) is None
    assert rest_of_earlier_result(None, raw, near, SETTINGS.guess) is None
