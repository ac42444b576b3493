"""The convex programs against closed forms, and their failures."""

import numpy as np
import pytest

from smoothers.scp.qp_step import UNBOUNDED, DenseProgram, ProgramPool


def filled(seed, size=6, rows=5):
    rng = np.random.default_rng(seed)
    program = DenseProgram(size, rows)
    root = rng.normal(size=(size, size))
    program.h[:] = root @ root.T + 0.1 * np.eye(size)
    program.g[:] = rng.normal(size=size)
    program.lbx[:], program.ubx[:] = -UNBOUNDED, UNBOUNDED
    return program, rng


@pytest.mark.parametrize("seed", range(5))
def test_without_bounds_it_solves_the_linear_system(seed):
    program, _ = filled(seed)
    assert program.solve() == pytest.approx(-np.linalg.solve(program.h, program.g), abs=1e-8)


@pytest.mark.parametrize("seed", range(5))
def test_both_solvers_agree(seed):
    program, rng = filled(seed)
    program.a[:] = rng.normal(size=program.a.shape)
    program.lba[:3], program.uba[:3] = -0.2, 0.1
    program.lbx[:], program.ubx[:] = -0.3, 0.3
    fast, slow = program.solve(), program.solve_slowly()
    assert fast == pytest.approx(slow, abs=1e-5)
    assert np.all(np.abs(fast) <= 0.3 + 1e-9)


def test_a_program_is_solved_anew_after_its_arrays_change():
    program, _ = filled(1)
    first = program.solve()
    program.g[:] *= -1.0
    assert program.solve() == pytest.approx(-first, abs=1e-8)


def test_contradicting_bounds_have_no_solution():
    program, _ = filled(2)
    program.a[0, 0] = program.a[1, 0] = 1.0
    program.lba[0], program.uba[1] = 1.0, -1.0
    assert program.solve() is None


def test_crossed_bounds_have_no_solution():
    program, _ = filled(4)
    program.lbx[0], program.ubx[0] = 1.0, -1.0
    assert program.solve() is None


def test_nan_has_no_solution():
    program, _ = filled(3)
    program.g[0] = np.nan
    assert program.solve() is None


def test_the_pool_builds_each_size_once_and_counts_the_time():
    pool = ProgramPool()
    assert pool.program(4, 3) is pool.program(4, 3)
    assert pool.program(4, 2) is not pool.program(4, 3)
    assert pool.build_time > 0.0
