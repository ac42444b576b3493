"""Minimizers of quadratic programs: optimality, and the kernel in C against DAQP."""

import shutil

import numpy as np
import pytest

from optdock import quadratic_program
from optdock.kernels import using_kernels
from optdock.quadratic_program import EXACT, UNBOUNDED, DenseProgram, QuadraticProgram, minimizer

in_both_lanes = pytest.mark.parametrize(
    "lane",
    ["twin", pytest.param("native", marks=pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler"))],
)
NO_GUESS = np.empty(0, dtype=np.int64)


def program_of(h, g, a, lower, upper, *, leading=1):
    n, m = len(g), len(a)
    bounds = np.clip(np.stack((lower, upper)).astype(np.float64), -UNBOUNDED, UNBOUNDED)
    return QuadraticProgram(h, g, a, bounds, leading, NO_GUESS, lambda: DenseProgram(n, m + 2, tolerance=EXACT))


def random_program(seed):
    """A feasible program with equalities, free and fixed variables, two-sided, repeated, dependent and empty rows."""
    rng = np.random.default_rng(seed)
    n, m = int(rng.integers(6, 30)), int(rng.integers(12, 60))
    root, inside = rng.normal(size=(n, n)), rng.normal(size=n)
    a = rng.normal(size=(m, n)) * (rng.uniform(size=(m, n)) < rng.uniform(0.3, 1.0))
    a[m // 2 :: 5] = a[3]
    a[m // 2 + 1 :: 5] = 0.5 * a[3] - 2.0 * a[4]
    a[m // 2 + 2 :: 5] = 0.0
    values = np.concatenate((inside, a @ inside))
    room = np.where(rng.uniform(size=(2, n + m)) < 0.7, rng.uniform(0.0, 0.5, size=(2, n + m)), np.inf)
    room[:, [0, n, n + 1]] = 0.0  # a fixed variable and two equalities
    h = root @ root.T + 10.0 ** rng.uniform(-3.0, 0.0) * np.eye(n)
    h *= 1.0 + 1e-16 * rng.integers(-2, 3, size=h.shape)  # symmetric except for rounding
    return program_of(h, 5.0 * rng.normal(size=n), a, values - room[0], values + room[1], leading=n // 2)


def degenerate_program(seed):
    """A program with a point at which all constraints are active, which depend on each other except for rounding."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 16))
    k, m = int(rng.integers(1, n + 1)), int(rng.integers(n, 40))
    a, corner = rng.integers(-2, 3, size=(m, k)) @ rng.normal(size=(k, n)), rng.normal(size=n)
    values, is_lower = np.concatenate((corner, a @ corner)), rng.uniform(size=n + m) < 0.5
    lower, upper = np.where(is_lower, values, -np.inf), np.where(is_lower, np.inf, values)
    root = rng.normal(size=(n, n))
    return program_of(root @ root.T + 1e-3 * np.eye(n), 5.0 * rng.normal(size=n), a, lower, upper, leading=n // 2)


def solution_of(program, lane):
    with using_kernels(lane):
        return minimizer(program)


def assert_optimal(program, solution, active):
    """The gradient is a combination of the normals of active constraints, with multipliers of the right signs."""
    n = len(solution)
    values = np.concatenate((solution, program.a @ solution))
    assert np.all(values >= program.bounds[0] - 1e-8)
    assert np.all(values <= program.bounds[1] + 1e-8)
    gradient = program.h @ solution + program.g
    normals = np.sign(active)[:, None] * np.vstack((np.eye(n), program.a))[np.abs(active) - 1]
    both = program.bounds[0] == program.bounds[1]
    # Least squares with multipliers >= 0, except for equalities, which have both signs.
    from scipy.optimize import nnls

    signed = np.vstack((normals, -normals[both[np.abs(active) - 1]]))
    _, left = nnls(signed.T, gradient) if len(signed) else (None, np.linalg.norm(gradient))
    assert left < 1e-6 * (1.0 + np.linalg.norm(gradient))


@in_both_lanes
@pytest.mark.parametrize("seed", range(30))
def test_solutions_are_optimal(seed, lane):
    program = random_program(seed)
    found = solution_of(program, lane)
    assert found is not None
    assert_optimal(program, *found)


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
@pytest.mark.parametrize("seed", range(30, 150))
def test_both_lanes_find_the_same_solution(seed):
    program = random_program(seed)
    twin, native = (solution_of(program, lane) for lane in ("twin", "native"))
    assert twin.active.tolist() == native.active.tolist()
    assert native.solution == pytest.approx(twin.solution, rel=1e-12, abs=1e-12)


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
def test_the_solution_on_the_active_set_is_equal_to_the_last_bit():
    equal = 0
    for seed in range(30):
        twin, native = (solution_of(random_program(seed), lane).solution for lane in ("twin", "native"))
        equal += twin.tobytes() == native.tobytes()
    assert equal > 25  # dependent constraints can be active in different sets


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
@pytest.mark.parametrize("seed", range(40))
def test_the_guess_does_not_change_the_solution(seed):
    program, rng, found = random_program(seed), np.random.default_rng(seed), quadratic_program._by_kernel
    total = program.bounds.shape[1]
    first, right = found(program)
    wrong = rng.permutation(np.concatenate((np.arange(1, total + 1), -np.arange(1, total + 1))))
    beyond = np.array([0, total + 1, -total - 1, 10 * total])
    for guess in (right, right[::2].copy(), beyond, wrong, wrong[: total // 2], np.concatenate((right, -right))):
        assert found(program._replace(guess=guess)).solution == pytest.approx(first, rel=1e-8, abs=1e-8)


@in_both_lanes
def test_programs_of_dependent_constraints_are_solved(lane):
    found = [(program, solution_of(program, lane)) for program in map(degenerate_program, range(60))]
    solved = [(program, minimum) for program, minimum in found if minimum is not None]
    assert len(solved) >= {"twin": 60, "native": 55}[lane]
    for program, minimum in solved:
        assert_optimal(program, *minimum)


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
@pytest.mark.parametrize("seed", [20, 99, 169, 398, 509])
def test_constraints_that_rounding_leaves_violated_in_turn_end_the_search(seed, monkeypatch):
    """Without the end of a stalled search, these programs have no solution after 1000 rounds."""
    monkeypatch.setattr(quadratic_program, "MOST_ROUNDS", 150)
    program = degenerate_program(seed)
    assert_optimal(program, *solution_of(program, "native"))


@in_both_lanes
def test_closed_forms(lane):
    h, g, free = np.diag([2.0, 4.0]), np.array([-2.0, -4.0]), np.full(2, UNBOUNDED)
    row = np.array([[1.0, 1.0]])
    assert solution_of(program_of(h, g, np.empty((0, 2)), -free, free), lane).solution == pytest.approx([1.0, 1.0])
    at_bound = solution_of(program_of(h, g, np.empty((0, 2)), -free, np.array([0.5, np.inf])), lane)
    assert at_bound.solution == pytest.approx([0.5, 1.0])
    assert at_bound.active.tolist() == [-1]
    below, above = np.array([-np.inf, -np.inf, 3.0]), np.full(3, np.inf)
    # The multiplier is 4 / 3: h z + g = 4 / 3 (1, 1).
    on_row = solution_of(program_of(h, g, row, below, above), lane)
    assert on_row.solution == pytest.approx([5.0 / 3.0, 4.0 / 3.0])
    assert on_row.active.tolist() == [3]


def contradicting_rows():
    below, above = np.array([-1e30, -1e30, 1.0, -1e30]), np.array([1e30, 1e30, 1e30, -1.0])
    return np.eye(2), np.ones(2), np.array([[1.0, 1.0], [2.0, 2.0]]), below, above


def crossed_bounds():
    return np.eye(2), np.ones(2), np.empty((0, 2)), np.array([1.0, 0.0]), np.array([-1.0, 1.0])


def row_of_zeros():
    return np.eye(2), np.ones(2), np.zeros((1, 2)), np.array([-1.0, -1.0, 1.0]), np.ones(3)


def not_a_number():
    return np.eye(2), np.array([np.nan, 1.0]), np.empty((0, 2)), -np.ones(2), np.ones(2)


def indefinite():
    return np.diag([1.0, -1.0]), np.ones(2), np.empty((0, 2)), -np.full(2, 1e30), np.full(2, 1e30)


@in_both_lanes
@pytest.mark.parametrize("made", [contradicting_rows, crossed_bounds, row_of_zeros, not_a_number, indefinite])
def test_without_a_minimizer_none_is_found(made, lane):
    assert solution_of(program_of(*made()), lane) is None


def test_more_than_the_usual_violation_is_found_only_with_the_exact_tolerance():
    """The default tolerance of DAQP leaves a constraint out that is violated by less than 1e-6 of its scale."""
    h, g, a = np.eye(1), np.array([-1.0]), np.empty((0, 1))
    program = program_of(h, g, a, np.array([-1e30]), np.array([1.0 - 5e-7]))
    usual = DenseProgram(1, 1)
    usual.fill(program)
    assert usual.solve() == pytest.approx([1.0], abs=1e-12)
    assert solution_of(program, "twin").solution == pytest.approx([1.0 - 5e-7], abs=1e-12)
