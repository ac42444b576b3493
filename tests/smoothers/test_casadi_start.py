"""First variables: fitted to headings, pursued, taken from an earlier result, and brought within the curvature rate."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from optdock.geometry.pose import Pose2
from optdock.path import Path
from optdock.verification import certify_path
from smoothers._ck.closing import Bounds, Ends, clipped, rate_kept, rate_limited
from smoothers._ck.guesses import Guesses
from smoothers._ck.initial import Resolution, shape_for, trace
from smoothers._ck.layout import layout_for
from smoothers._ck.pursuit import pursued_variables
from smoothers._ck.rollout import Variables, roll_out
from smoothers._ck.warm import remaining
from smoothers.casadi_smoother import CasadiSmoother

LAYOUT = layout_for(((6, 2), (5, 2)))
LENGTHS = np.array([1.5, 0.8])


def bounds_of(layout, limit, rate):
    lower = np.concatenate((np.full(layout.num_knots, -limit), np.full(layout.num_gears, 0.05)))
    upper = np.concatenate((np.full(layout.num_knots, limit), np.full(layout.num_gears, 20.0)))
    return Bounds(lower, upper, rate)


curvatures = st.lists(st.floats(-3.0, 3.0), min_size=LAYOUT.num_knots, max_size=LAYOUT.num_knots).map(np.array)


@given(curvatures, st.floats(0.1, 50.0))
def test_limiting_the_rate_keeps_it(curvature, rate):
    bounds = bounds_of(LAYOUT, 3.0, rate)
    limited = rate_limited(LAYOUT, Variables(curvature, LENGTHS), bounds)
    assert rate_kept(LAYOUT, limited, bounds)
    assert np.abs(limited.curvature).max() <= 3.0 + 1e-12


@given(curvatures, st.floats(0.1, 50.0))
def test_limiting_the_rate_twice_changes_nothing(curvature, rate):
    bounds = bounds_of(LAYOUT, 3.0, rate)
    once = rate_limited(LAYOUT, Variables(curvature, LENGTHS), bounds)
    assert rate_limited(LAYOUT, once, bounds).curvature == pytest.approx(once.curvature, abs=1e-9)


@given(curvatures)
def test_limiting_the_rate_leaves_fixed_ends_alone(curvature):
    bounds = bounds_of(LAYOUT, 3.0, 4.0)
    bounds.lower[0] = bounds.upper[0] = curvature[0] = 0.7
    bounds.lower[LAYOUT.num_knots - 1] = bounds.upper[LAYOUT.num_knots - 1] = curvature[-1] = 0.0
    limited = rate_limited(LAYOUT, Variables(curvature, LENGTHS), bounds)
    assert limited.curvature[0] == pytest.approx(0.7, abs=1e-12)
    assert limited.curvature[-1] == pytest.approx(0.0, abs=1e-12)


def test_an_unlimited_rate_is_left_alone():
    wild = Variables(np.tile([3.0, -3.0], 7)[: LAYOUT.num_knots], LENGTHS)
    assert rate_limited(LAYOUT, wild, bounds_of(LAYOUT, 3.0, np.inf)) is wild


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("turned", [-1.0, 0.0, 1.2])
def test_a_pursuit_ends_on_the_line_it_pursues(sign, turned):
    layout = layout_for(((24, 3),))
    x = sign * np.linspace(0.0, 6.0, layout.num_nodes)
    ends = Ends(np.array([0.0, 0.0, turned]), np.array([6.0 * sign, 0.0, 0.0]), np.array([sign]))
    bounds = bounds_of(layout, 1.5, 6.0)
    variables = clipped(pursued_variables(layout, np.column_stack((x, 0.0 * x)), ends, bounds), bounds)
    driven = roll_out(layout, variables, ends.start, ends.signs)
    assert abs(driven.poses[-1, 1]) < 0.15
    assert abs(driven.poses[-1, 0] - 6.0 * sign) < 0.3
    assert abs(driven.poses[-1, 2]) < 0.2
    assert np.abs(driven.curvature).max() <= 1.5 + 1e-9


def guesses_for(points, start_yaw=0.0):
    layout = layout_for(((24, 3),))
    path = Path.from_poses(points)
    start = np.array([*points[0, :2], start_yaw])
    lengths = np.array([path.length])
    traced = trace(path, layout, lengths, start_yaw)
    ends = Ends(start, np.array(points[-1]), np.array([1.0]))
    return Guesses(layout, traced, lengths, ends, bounds_of(layout, 1.5, 6.0))


def test_a_smooth_input_is_fitted_and_driving_it_gives_much_the_same():
    angle = np.linspace(0.0, 1.2, 60)
    guesses = guesses_for(np.column_stack((3.0 * np.sin(angle), 3.0 - 3.0 * np.cos(angle), angle)))
    assert guesses.first is guesses.fitted
    assert guesses.other() is None


def test_an_input_that_starts_sideways_is_driven_and_the_fit_is_the_other_guess():
    points = np.column_stack((np.linspace(0.0, 4.0, 60), np.zeros(60), np.zeros(60)))
    guesses = guesses_for(points, start_yaw=1.4)
    assert guesses.first is guesses.pursued
    assert guesses.other() is guesses.fitted


@pytest.mark.parametrize("turned", [-1.3, 1.0])
def test_a_start_that_looks_the_wrong_way_is_turned_round_while_driving(cases, turned):
    problem = cases.open_problem(Pose2(5.0, 0.0, 0.0), start=Pose2(0.0, 0.0, turned))
    raw = cases.kinked((0.0, 0.0), (2.5, 0.0), (5.0, 0.0))
    result = CasadiSmoother().smooth(raw, 30.0, problem=problem)
    assert certify_path(result.path, problem).certified


def test_spans_follow_the_lengths_and_are_never_too_few():
    shape = shape_for(np.array([4.0, 1.0, 0.05]), Resolution(24, 1.0, 0.0625))
    spans = [q for q, _ in shape]
    assert spans[0] > spans[1] >= spans[2] >= 4
    assert all(2 <= r <= 12 for _, r in shape)


def test_a_long_path_has_more_spans():
    few, many = (sum(q for q, _ in shape_for(np.array([x]), Resolution(24, 0.8, 0.0625))) for x in (5.0, 30.0))
    assert few == 24
    assert many >= 30.0 / 0.8


def test_headings_follow_the_motion_and_not_the_yaws_of_the_input():
    straight = np.column_stack((np.linspace(0.0, 2.0, 30), np.zeros(30), 0.4 * np.ones(30)))
    path, layout = Path.from_poses(straight), layout_for(((8, 2),))
    assert trace(path, layout, np.array([2.0]), 0.0).headings == pytest.approx(0.0, abs=1e-9)


def test_headings_are_continuous_over_a_full_turn():
    angle = np.linspace(0.0, 2.5 * math.pi, 200)
    circle = np.column_stack((np.sin(angle), 1.0 - np.cos(angle), np.remainder(angle + math.pi, 2 * math.pi) - math.pi))
    path, layout = Path.from_poses(circle), layout_for(((24, 3),))
    headings = trace(path, layout, np.array([path.length]), 0.0).headings
    assert np.diff(headings) == pytest.approx(2.5 * math.pi / layout.num_intervals, rel=0.05)


def test_an_earlier_result_is_of_no_use_to_a_robot_far_from_it(cases):
    smoother, raw, goal = CasadiSmoother(), cases.kinked((0.0, 0.0), (2.0, 0.2), (4.0, 0.0)), Pose2(4.0, 0.0, 0.0)
    near, far = cases.open_problem(goal), cases.open_problem(goal, start=Pose2(0.0, 3.0, 0.0))
    earlier = smoother.smooth(raw, 30.0, problem=near).path
    assert remaining(earlier, raw, near) is not None
    assert remaining(earlier, raw, far) is None
    assert remaining(raw, raw, near) is None
    assert remaining(None, raw, near) is None
