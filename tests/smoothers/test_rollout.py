"""Roll-out, cost and goal projection against clothoid splines, finite differences and the symbolic model."""

import dataclasses

import casadi
import numpy as np
import pytest

from experiments.benchmarks.symbolic_program import cost_expression, model_for
from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.pose import Pose2
from smoothers.scp.basis import basis_for
from smoothers.scp.cost import CostModel, InputNodes, Weights
from smoothers.scp.goal_projection import end_pose, end_sensitivity, onto_goal
from smoothers.scp.nlp import Ends, VariableBounds
from smoothers.scp.rollout import Variables, roll_out, sensitivity
from smoothers.scp.settings import DEFAULT_SETTINGS

FORWARD_TWICE = ((6, 2), (5, 3))
STEP = 1e-6
PROJECTION = DEFAULT_SETTINGS.projection
SEEDS = range(6)


def split(basis, flat):
    return Variables(flat[: basis.num_knots], flat[basis.num_knots :])


def differences(function, flat):
    columns = []
    for i in range(flat.size):
        shift = np.zeros(flat.size)
        shift[i] = STEP
        columns.append((function(flat + shift) - function(flat - shift)) / (2.0 * STEP))
    return np.stack(columns, axis=-1)


def chained_splines(basis, variables, start, signs):
    pose, splines = Pose2.from_sequence(start), []
    for m, (first, last) in enumerate(zip(basis.first_knots, basis.last_knots, strict=True)):
        knots = np.linspace(0.0, variables.lengths[m], last - first + 1)
        splines.append(ClothoidSpline(pose, knots, variables.curvature[first : last + 1], int(signs[m])))
        pose = splines[-1].end
    return splines


@pytest.mark.parametrize("seed", SEEDS)
def test_roll_out_is_the_clothoid_spline(cases, seed):
    basis, variables, start, signs = cases.random_path(seed, ((8, 12), (6, 12)))
    rollout = roll_out(basis, variables, start, signs)
    for m, spline in enumerate(chained_splines(basis, variables, start, signs)):
        mine = basis.node_gear == m
        s = basis.fraction[mine] * spline.length
        assert np.abs(rollout.poses[mine] - spline.poses_at(s)).max() < 1e-8
        assert rollout.curvature[mine] == pytest.approx(spline.curvature_at(s), abs=1e-12)
        middle = 0.5 * (s[:-1] + s[1:])
        assert rollout.rate[basis.interval_gear == m] == pytest.approx(spline.curvature_rate_at(middle), abs=1e-9)


@pytest.mark.parametrize("seed", SEEDS)
def test_sensitivities_are_the_finite_differences(cases, seed):
    basis, variables, start, signs = cases.random_path(seed)
    by = sensitivity(basis, variables, roll_out(basis, variables, start, signs))
    found = differences(lambda flat: roll_out(basis, split(basis, flat), start, signs).poses, np.concatenate(variables))
    for axis, exact in enumerate(by):
        assert exact == pytest.approx(found[:, axis], abs=1e-7)


@pytest.mark.parametrize("seed", SEEDS)
def test_sensitivities_are_the_symbolic_jacobian(cases, seed):
    basis, variables, start, signs = cases.random_path(seed)
    model = model_for(basis.shape)
    jacobian = casadi.Function(
        "j",
        [model.variables, model.start, model.signs],
        [casadi.jacobian(model.poses[:, axis], model.variables) for axis in range(3)],
    )
    exact = jacobian(np.concatenate(variables), start, signs)
    by = sensitivity(basis, variables, roll_out(basis, variables, start, signs))
    for hand, symbolic in zip(by, exact, strict=True):
        assert hand == pytest.approx(np.array(symbolic), abs=1e-11)


@pytest.mark.parametrize("seed", SEEDS)
def test_the_cheap_end_is_the_end(cases, seed):
    basis, variables, start, signs = cases.random_path(seed)
    rollout = roll_out(basis, variables, start, signs)
    by = sensitivity(basis, variables, rollout)
    pose, moves = end_pose(basis, variables, start, signs)
    assert pose == pytest.approx(rollout.poses[-1], abs=1e-12)
    last = np.stack([rows[-1] for rows in by])
    assert end_sensitivity(basis, variables, moves) == pytest.approx(last, abs=1e-12)


def random_cost(basis, rng):
    positions = rng.uniform(-1.0, 1.0, (basis.num_nodes, 2))
    yaw = rng.uniform(-3.0, 3.0, basis.num_nodes)
    reference = InputNodes(positions, np.column_stack((-np.sin(yaw), np.cos(yaw))))
    return CostModel(basis, Weights(1.0, 0.4, 0.15, 0.3), (1.5, 6.0), reference)


@pytest.mark.parametrize("seed", SEEDS)
def test_the_cost_and_its_gradient_are_the_symbolic_ones(cases, seed):
    basis, variables, start, signs = cases.random_path(seed)
    cost, model = random_cost(basis, np.random.default_rng(seed)), model_for(basis.shape)
    expression = cost_expression(model, cost)
    function = casadi.Function(
        "c",
        [model.variables, model.start, model.signs],
        [expression, casadi.gradient(expression, model.variables)],
    )
    value, gradient = function(np.concatenate(variables), start, signs)
    rollout = roll_out(basis, variables, start, signs)
    found = cost.quadratic(variables, rollout, sensitivity(basis, variables, rollout))
    assert cost.value(variables, rollout) == pytest.approx(float(value), rel=1e-12)
    assert found.gradient == pytest.approx(np.array(gradient).ravel(), abs=1e-9)


@pytest.mark.parametrize("seed", SEEDS)
def test_the_gradient_of_steered_robots_is_that_of_differences(cases, seed):
    basis, variables, start, signs = cases.random_path(seed)
    rng = np.random.default_rng(seed)
    easing = rng.uniform(0.01, 1.0, basis.span_slopes.shape[0])
    cost = dataclasses.replace(random_cost(basis, rng), turning_at_cusps=1.7, easing=easing)
    rollout = roll_out(basis, variables, start, signs)
    found = cost.quadratic(variables, rollout, sensitivity(basis, variables, rollout)).gradient

    def value(flat):
        moved = split(basis, flat)
        return cost.value(moved, roll_out(basis, moved, start, signs))

    assert found == pytest.approx(differences(value, np.concatenate(variables)), rel=1e-5, abs=1e-5)


def test_an_easing_of_one_changes_nothing_and_less_costs_less(cases):
    basis, variables, start, signs = cases.random_path(2)
    cost, rollout = random_cost(basis, np.random.default_rng(2)), roll_out(basis, variables, start, signs)
    spans = basis.span_slopes.shape[0]
    plain, same, less = (
        dataclasses.replace(cost, easing=easing).value(variables, rollout)
        for easing in (None, np.ones(spans), np.full(spans, 0.5))
    )
    assert same == pytest.approx(plain, rel=1e-12)
    assert less < plain


@pytest.mark.parametrize("seed", SEEDS)
def test_the_cost_is_curved_upwards_in_the_model(cases, seed):
    basis, variables, start, signs = cases.random_path(seed)
    rollout = roll_out(basis, variables, start, signs)
    cost = random_cost(basis, np.random.default_rng(seed))
    hessian = cost.quadratic(variables, rollout, sensitivity(basis, variables, rollout)).hessian
    assert hessian == pytest.approx(hessian.T, abs=1e-12)
    assert np.linalg.eigvalsh(hessian).min() > -1e-9


@pytest.mark.parametrize("seed", SEEDS)
def test_projection_reaches_a_goal_nearby_inside_the_bounds(cases, seed):
    basis, variables, start, signs = cases.random_path(seed)
    rollout = roll_out(basis, variables, start, signs)
    target = rollout.poses[-1] + np.random.default_rng(seed).uniform(-0.1, 0.1, 3)
    free = np.concatenate((np.full(basis.num_knots, 3.0), np.full(basis.num_gears, 5.0)))
    lower = np.concatenate((np.full(basis.num_knots, -3.0), np.full(basis.num_gears, 0.1)))
    bounds = VariableBounds(lower, free, np.inf)
    closed = onto_goal(basis, variables, Ends(start, target, signs), bounds, PROJECTION)
    driven = roll_out(basis, closed, start, signs)
    assert np.abs(driven.poses[-1] - target).max() < 1e-7
    flat = np.concatenate(closed)
    assert np.all((flat >= lower) & (flat <= free))


def test_projection_leaves_fixed_variables_alone(cases):
    basis, variables, start, signs = cases.random_path(1)
    rollout = roll_out(basis, variables, start, signs)
    flat = np.concatenate(variables)
    lower, upper = flat - 1.0, flat + 1.0
    lower[0] = upper[0] = flat[0]
    ends = Ends(start, rollout.poses[-1] + 0.05, signs)
    closed = onto_goal(basis, variables, ends, VariableBounds(lower, upper, np.inf), PROJECTION)
    assert closed.curvature[0] == flat[0]


def test_projection_never_makes_an_unreachable_goal_worse(cases):
    basis, variables, start, signs = cases.random_path(2)
    rollout = roll_out(basis, variables, start, signs)
    flat = np.concatenate(variables)
    bounds = VariableBounds(flat - 0.01, flat + 0.01, np.inf)
    ends = Ends(start, rollout.poses[-1] + np.array([2.0, 2.0, 0.5]), signs, reach=9.0)
    driven = roll_out(basis, onto_goal(basis, variables, ends, bounds, PROJECTION), start, signs)
    assert np.abs(ends.error(driven)).max() <= np.abs(ends.error(rollout)).max()


def test_a_basis_is_built_once():
    assert basis_for(FORWARD_TWICE) is basis_for(FORWARD_TWICE)


def test_constant_curvature_has_the_integral_of_its_square():
    basis = basis_for(((5, 2),))
    ones = np.ones(basis.num_knots)
    assert ones @ basis.mass @ ones == pytest.approx(1.0)
    assert ones @ basis.stiffness @ ones == pytest.approx(0.0, abs=1e-12)


def test_a_ramp_has_the_integral_of_its_slope_squared():
    basis = basis_for(((5, 2),))
    ramp = np.linspace(0.0, 2.0, basis.num_knots)
    assert ramp @ basis.mass @ ramp == pytest.approx(4.0 / 3.0)
    assert ramp @ basis.stiffness @ ramp == pytest.approx(4.0)
