"""Roll-out, cost and goal closing against clothoid splines, finite differences and the symbolic model."""

import casadi
import numpy as np
import pytest

from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.pose import Pose2
from smoothers._ck.closing import Bounds, Ends, close_goal
from smoothers._ck.layout import layout_for
from smoothers._ck.rollout import Variables, end_pose, end_sensitivity, roll_out, sensitivity
from smoothers._ck.symbolic import cost_expression, model_for
from smoothers._ck.terms import CostModel, Reference, Weights

FORWARD_TWICE = ((6, 2), (5, 3))
STEP = 1e-6
SEEDS = range(6)


def split(layout, flat):
    return Variables(flat[: layout.num_knots], flat[layout.num_knots :])


def differences(function, flat):
    columns = []
    for i in range(flat.size):
        shift = np.zeros(flat.size)
        shift[i] = STEP
        columns.append((function(flat + shift) - function(flat - shift)) / (2.0 * STEP))
    return np.stack(columns, axis=-1)


def chained_splines(layout, variables, start, signs):
    pose, splines = Pose2.from_sequence(start), []
    for m, (first, last) in enumerate(zip(layout.first_knots, layout.last_knots, strict=True)):
        knots = np.linspace(0.0, variables.lengths[m], last - first + 1)
        splines.append(ClothoidSpline(pose, knots, variables.curvature[first : last + 1], int(signs[m])))
        pose = splines[-1].end
    return splines


@pytest.mark.parametrize("seed", SEEDS)
def test_roll_out_is_the_clothoid_spline(cases, seed):
    layout, variables, start, signs = cases.random_path(seed, ((8, 12), (6, 12)))
    rollout = roll_out(layout, variables, start, signs)
    for m, spline in enumerate(chained_splines(layout, variables, start, signs)):
        mine = layout.node_gear == m
        s = layout.fraction[mine] * spline.length
        assert np.abs(rollout.poses[mine] - spline.poses_at(s)).max() < 1e-8
        assert rollout.curvature[mine] == pytest.approx(spline.curvature_at(s), abs=1e-12)
        middle = 0.5 * (s[:-1] + s[1:])
        assert rollout.rate[layout.interval_gear == m] == pytest.approx(spline.curvature_rate_at(middle), abs=1e-9)


@pytest.mark.parametrize("seed", SEEDS)
def test_sensitivities_are_the_finite_differences(cases, seed):
    layout, variables, start, signs = cases.random_path(seed)
    by = sensitivity(layout, variables, roll_out(layout, variables, start, signs))
    found = differences(
        lambda flat: roll_out(layout, split(layout, flat), start, signs).poses, np.concatenate(variables)
    )
    for axis, exact in enumerate(by):
        assert exact == pytest.approx(found[:, axis], abs=1e-7)


@pytest.mark.parametrize("seed", SEEDS)
def test_sensitivities_are_the_symbolic_jacobian(cases, seed):
    layout, variables, start, signs = cases.random_path(seed)
    model = model_for(layout.shape)
    jacobian = casadi.Function(
        "j",
        [model.variables, model.start, model.signs],
        [casadi.jacobian(model.poses[:, axis], model.variables) for axis in range(3)],
    )
    exact = jacobian(np.concatenate(variables), start, signs)
    by = sensitivity(layout, variables, roll_out(layout, variables, start, signs))
    for hand, symbolic in zip(by, exact, strict=True):
        assert hand == pytest.approx(np.array(symbolic), abs=1e-11)


@pytest.mark.parametrize("seed", SEEDS)
def test_the_cheap_end_is_the_end(cases, seed):
    layout, variables, start, signs = cases.random_path(seed)
    rollout = roll_out(layout, variables, start, signs)
    by = sensitivity(layout, variables, rollout)
    pose, moves = end_pose(layout, variables, start, signs)
    assert pose == pytest.approx(rollout.poses[-1], abs=1e-12)
    last = np.stack([rows[-1] for rows in by])
    assert end_sensitivity(layout, variables, moves) == pytest.approx(last, abs=1e-12)


def random_cost(layout, rng):
    positions = rng.uniform(-1.0, 1.0, (layout.num_nodes, 2))
    yaw = rng.uniform(-3.0, 3.0, layout.num_nodes)
    reference = Reference(positions, np.column_stack((-np.sin(yaw), np.cos(yaw))))
    return CostModel(layout, Weights(1.0, 0.4, 0.15, 0.3), (1.5, 6.0), reference)


@pytest.mark.parametrize("seed", SEEDS)
def test_the_cost_and_its_gradient_are_the_symbolic_ones(cases, seed):
    layout, variables, start, signs = cases.random_path(seed)
    cost, model = random_cost(layout, np.random.default_rng(seed)), model_for(layout.shape)
    expression = cost_expression(model, cost)
    function = casadi.Function(
        "c",
        [model.variables, model.start, model.signs],
        [expression, casadi.gradient(expression, model.variables)],
    )
    value, gradient = function(np.concatenate(variables), start, signs)
    rollout = roll_out(layout, variables, start, signs)
    found = cost.quadratic(variables, rollout, sensitivity(layout, variables, rollout))
    assert cost.value(variables, rollout) == pytest.approx(float(value), rel=1e-12)
    assert found.gradient == pytest.approx(np.array(gradient).ravel(), abs=1e-9)


@pytest.mark.parametrize("seed", SEEDS)
def test_the_cost_is_curved_upwards_in_the_model(cases, seed):
    layout, variables, start, signs = cases.random_path(seed)
    rollout = roll_out(layout, variables, start, signs)
    cost = random_cost(layout, np.random.default_rng(seed))
    hessian = cost.quadratic(variables, rollout, sensitivity(layout, variables, rollout)).hessian
    assert hessian == pytest.approx(hessian.T, abs=1e-12)
    assert np.linalg.eigvalsh(hessian).min() > -1e-9


@pytest.mark.parametrize("seed", SEEDS)
def test_closing_reaches_a_goal_nearby_inside_the_bounds(cases, seed):
    layout, variables, start, signs = cases.random_path(seed)
    rollout = roll_out(layout, variables, start, signs)
    target = rollout.poses[-1] + np.random.default_rng(seed).uniform(-0.1, 0.1, 3)
    free = np.concatenate((np.full(layout.num_knots, 3.0), np.full(layout.num_gears, 5.0)))
    lower = np.concatenate((np.full(layout.num_knots, -3.0), np.full(layout.num_gears, 0.1)))
    bounds = Bounds(lower, free, np.inf)
    closed = close_goal(layout, variables, Ends(start, target, signs), bounds)
    driven = roll_out(layout, closed, start, signs)
    assert np.abs(driven.poses[-1] - target).max() < 1e-7
    flat = np.concatenate(closed)
    assert np.all((flat >= lower) & (flat <= free))


def test_closing_leaves_fixed_variables_alone(cases):
    layout, variables, start, signs = cases.random_path(1)
    rollout = roll_out(layout, variables, start, signs)
    flat = np.concatenate(variables)
    lower, upper = flat - 1.0, flat + 1.0
    lower[0] = upper[0] = flat[0]
    ends = Ends(start, rollout.poses[-1] + 0.05, signs)
    closed = close_goal(layout, variables, ends, Bounds(lower, upper, np.inf))
    assert closed.curvature[0] == flat[0]


def test_closing_never_makes_an_unreachable_goal_worse(cases):
    layout, variables, start, signs = cases.random_path(2)
    rollout = roll_out(layout, variables, start, signs)
    flat = np.concatenate(variables)
    bounds = Bounds(flat - 0.01, flat + 0.01, np.inf)
    ends = Ends(start, rollout.poses[-1] + np.array([2.0, 2.0, 0.5]), signs, reach=9.0)
    driven = roll_out(layout, close_goal(layout, variables, ends, bounds), start, signs)
    assert np.abs(ends.error(driven)).max() <= np.abs(ends.error(rollout)).max()


def test_a_layout_is_built_once():
    assert layout_for(FORWARD_TWICE) is layout_for(FORWARD_TWICE)


def test_constant_curvature_has_the_integral_of_its_square():
    layout = layout_for(((5, 2),))
    ones = np.ones(layout.num_knots)
    assert ones @ layout.mass @ ones == pytest.approx(1.0)
    assert ones @ layout.stiffness @ ones == pytest.approx(0.0, abs=1e-12)


def test_a_ramp_has_the_integral_of_its_slope_squared():
    layout = layout_for(((5, 2),))
    ramp = np.linspace(0.0, 2.0, layout.num_knots)
    assert ramp @ layout.mass @ ramp == pytest.approx(4.0 / 3.0)
    assert ramp @ layout.stiffness @ ramp == pytest.approx(4.0)
