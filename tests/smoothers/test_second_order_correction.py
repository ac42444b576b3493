"""The second-order correction: a step that lowers the cost but violates bounds is tried again with more clearance."""

import dataclasses

import numpy as np
import pytest

from experiments.families import instance
from smoothers.casadi_smoother import CasadiSmoother
from smoothers.scp.basis import basis_for
from smoothers.scp.collision.linearization import ClearanceRows
from smoothers.scp.cost import Quadratic
from smoothers.scp.qp_step import Linearization, Subproblem
from smoothers.scp.rollout import Variables
from smoothers.scp.settings import DEFAULT_SETTINGS


def report_of(case, corrected):
    """The report of smoothing the raw path, with a factor of the correction; 0 repeats the step instead."""
    smoother = CasadiSmoother()
    loop = dataclasses.replace(DEFAULT_SETTINGS.loop, corrected=corrected)
    smoother.settings = dataclasses.replace(DEFAULT_SETTINGS, loop=loop)
    return smoother.smooth(case.raw_path, 60.0, problem=case.problem).report


@pytest.mark.parametrize(("family", "seed"), [("long_approach", 0), ("long_approach", 3), ("corridor", 5)])
def test_corrected_searches_take_fewer_iterations_for_the_same_cost(family, seed):
    case = instance(family, seed)
    with_it, without = report_of(case, DEFAULT_SETTINGS.loop.corrected), report_of(case, 0.0)
    assert with_it.iterations < without.iterations
    assert with_it.cost < 1.001 * without.cost


def test_rows_are_tightened_by_the_shortfall_of_their_zone():
    basis, size = basis_for(((4, 3),)), 6
    node = np.array([0, 6, 12])
    rows = ClearanceRows(np.ones((3, size)), np.array([0.1, 0.2, 0.3]), node)
    quadratic = Quadratic(np.zeros(size), np.eye(size))
    goal = np.zeros((3, size)), np.zeros(3)
    parts = Subproblem(Variables(np.zeros(5), np.ones(1)), quadratic, np.eye(size), goal, np.zeros((2, size)), rows)
    around = Linearization.of(basis, parts)
    around.tighten(np.array([0.0, 0.01, 0.02]))
    assert around.parts.rows.gap == pytest.approx([0.1, 0.2 - 0.01, 0.3 - 0.02])
    assert np.all(around.parts.rows.gradient == 1.0)
