"""Dense quadratic programs: closed forms, other solvers, and infeasible programs."""

import numpy as np
import pytest
from scipy.optimize import minimize

from optdock.quadratic_program import DenseProgram


def filled(seed, size=6, rows=5):
    rng = np.random.default_rng(seed)
    program = DenseProgram(size, rows)
    root = rng.normal(size=(size, size))
    program.h[:] = root @ root.T + 0.1 * np.eye(size)
    program.g[:] = rng.normal(size=size)
    return program, rng


def bounded(seed):
    program, rng = filled(seed)
    program.a[:] = rng.normal(size=program.a.shape)
    program.lba[:3], program.uba[:3] = -0.2, 0.1
    program.lbx[:], program.ubx[:] = -0.3, 0.3
    return program


@pytest.mark.parametrize("seed", range(5))
def test_without_bounds_it_solves_the_linear_system(seed):
    program, _ = filled(seed)
    assert program.solve() == pytest.approx(-np.linalg.solve(program.h, program.g), abs=1e-8)


@pytest.mark.parametrize("seed", range(5))
def test_solutions_are_those_of_other_solvers(seed):
    program = bounded(seed)
    used = program.a[:3]
    above = {"type": "ineq", "fun": lambda z: used @ z + 0.2, "jac": lambda z: used}
    below = {"type": "ineq", "fun": lambda z: 0.1 - used @ z, "jac": lambda z: -used}
    other = minimize(
        lambda z: 0.5 * z @ program.h @ z + program.g @ z, np.zeros(6), jac=lambda z: program.h @ z + program.g,
        bounds=[(-0.3, 0.3)] * 6, constraints=[above, below], method="SLSQP", options={"ftol": 1e-14, "maxiter": 200},
    )  # fmt: skip
    found = program.solve()
    assert found == pytest.approx(other.x, abs=1e-5)
    assert found == pytest.approx(program.solve_slowly(), abs=1e-5)
    assert np.all(np.abs(found) <= 0.3 + 1e-9)


def test_a_program_is_solved_anew_after_its_arrays_change():
    program, _ = filled(1)
    first = program.solve()
    program.g[:] *= -1.0
    assert program.solve() == pytest.approx(-first, abs=1e-8)


def test_solutions_are_not_overwritten_by_the_next_one():
    program, _ = filled(1)
    first = program.solve()
    kept = first.copy()
    program.g[:] *= -1.0
    program.solve()
    assert np.array_equal(first, kept)


def contradicting(program):
    program.a[0, 0] = program.a[1, 0] = 1.0
    program.lba[0], program.uba[1] = 1.0, -1.0


def crossed(program):
    program.lbx[0], program.ubx[0] = 1.0, -1.0


def rows_crossed(program):
    program.a[0, 0], program.lba[0], program.uba[0] = 1.0, 1.0, -1.0


def not_a_number(program):
    program.g[0] = np.nan


@pytest.mark.parametrize("spoil", [contradicting, crossed, rows_crossed, not_a_number])
def test_infeasible_programs_have_no_solution(spoil):
    program, _ = filled(2)
    assert program.solve() is not None
    spoil(program)
    assert program.solve() is None
    assert program.solve_slowly() is None


def test_too_many_iterations_give_no_solution():
    def at_two_bounds(most_iterations):
        program = DenseProgram(2, 1, most_iterations)
        program.h[:], program.g[:], program.a[:] = np.eye(2), -5.0, 1.0
        program.uba[:], program.ubx[:] = 1.0, 0.7
        return program.solve()

    assert at_two_bounds(None) == pytest.approx([0.5, 0.5])
    assert at_two_bounds(1) is None
