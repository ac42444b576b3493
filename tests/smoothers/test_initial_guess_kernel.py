"""The kernels of the pure pursuit and of tracking: equal to Python to the last bit, but for signs of zeros."""

import shutil
from dataclasses import replace

import numpy as np
import pytest

from experiments.fuzz.kinds.kernels import BENT, drawn_program, replaced
from optdock.kernels import using_kernels
from smoothers.scp.basis import basis_for
from smoothers.scp.cost import CostModel, InputNodes, Weights
from smoothers.scp.initial_guess import LeastSquares, linearized_tracking, pure_pursuit, tracked_path
from smoothers.scp.nlp import Ends, VariableBounds
from smoothers.scp.rollout import roll_out
from smoothers.scp.settings import DEFAULT_SETTINGS

pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")

SHAPES = (((4, 2),), ((24, 3),), ((12, 3), (8, 2)), ((4, 2), (9, 3), (6, 12)))


def drawn_pursuit(rng, shape, degenerate):
    """The arguments of a pursuit of a random walk in random gears."""
    basis = basis_for(shape)
    limit, rate = 10.0 ** rng.uniform(-1.0, 1.3), np.inf if degenerate == "rate" else 10.0 ** rng.uniform(-1.0, 2.0)
    heading = rng.uniform(-np.pi, np.pi) + np.cumsum(rng.normal(scale=0.3, size=basis.num_nodes))
    chord = 10.0 ** rng.uniform(-3.0, 0.5) * rng.uniform(0.1, 1.0, size=basis.num_nodes)
    if degenerate == "still":
        chord[:] = 0.0
    if degenerate == "repeated":
        chord[rng.random(basis.num_nodes) < 0.5] = 0.0
    positions = rng.normal(size=2) + np.cumsum(chord[:, None] * np.column_stack((np.cos(heading), np.sin(heading))), 0)
    if degenerate == "far":
        positions += 1e7
    start = np.array([*positions[0], heading[0]]) + rng.normal(scale=0.3, size=3)
    ends = Ends(start, np.array([*positions[-1], heading[-1]]), rng.choice([-1.0, 1.0], size=basis.num_gears))
    upper = np.full(basis.size, limit)
    return basis, positions, ends, VariableBounds(-upper, upper, rate), DEFAULT_SETTINGS.guess


@pytest.mark.parametrize("degenerate", ["none", "rate", "still", "repeated", "far"])
def test_both_lanes_pursue_equally_to_the_last_bit(degenerate):
    for seed in range(12):
        rng = np.random.default_rng(seed)
        arguments, found = drawn_pursuit(rng, SHAPES[seed % len(SHAPES)], degenerate), []
        for lane in ("twin", "native"):
            with using_kernels(lane):
                found.append(pure_pursuit(*arguments))
        assert not replaced()  # a kernel that differs in its first call is replaced by its twin
        assert all(np.array_equal(a, b) for a, b in zip(*found, strict=True)), seed


def drawn_least_squares(seed, degenerate):
    """The least squares of a random input around a random path, and variables."""
    rng = np.random.default_rng(seed)
    nlp, variables = drawn_program(rng, rng.normal(size=3), degenerate)
    with using_kernels("twin"):
        poses = roll_out(nlp.basis, variables, nlp.ends.start, nlp.ends.signs).poses
    heading = poses[:, 2] + rng.normal(scale=0.1, size=len(poses))
    normals = np.column_stack((-np.sin(heading), np.cos(heading)))
    input_nodes = InputNodes(poses[:, :2] + rng.normal(scale=0.05, size=normals.shape), normals)
    cost = CostModel(nlp.basis, Weights(), (1.5, 6.0), input_nodes)
    return LeastSquares.of(replace(nlp, cost=cost)), variables


@pytest.mark.parametrize("degenerate", BENT)
def test_both_lanes_have_the_same_least_squares_to_the_last_bit(degenerate):
    for seed in range(12):
        (least, variables), found = drawn_least_squares(seed, degenerate), []
        for lane in ("twin", "native"):
            with using_kernels(lane):
                current = tracked_path(least, np.concatenate(variables))
                around = linearized_tracking(least, current)
            found.append((current.merit, around.values))
        assert not replaced()
        assert all(np.array_equal(a, b, equal_nan=True) for a, b in zip(*found, strict=True)), seed


def test_the_model_of_tracking_has_the_derivatives_of_its_merit():
    least, variables = drawn_least_squares(3, "none")
    nlp, at = least.nlp, np.concatenate(variables)
    knots, step = nlp.basis.num_knots, 1e-6

    def squares(change):
        path = tracked_path(least, np.concatenate((at[:knots] + change[:knots], variables.lengths)))
        missed = float(np.abs(nlp.ends.error(path.rollout)).sum())
        return path.merit - nlp.settings.tracking.goal_weight * missed

    gradient = linearized_tracking(least, tracked_path(least, at)).parts.quadratic.gradient
    for j in range(knots):
        change = step * (np.arange(at.size) == j)
        slope = (squares(change) - squares(-change)) / (2.0 * step)
        assert slope == pytest.approx(gradient[j], rel=1e-5, abs=1e-5 * np.abs(gradient).max())
