"""The interior point method: closed forms, and the kernel equal to its twin to the last bit."""

import shutil

import numpy as np
import pytest

from experiments.fuzz.kinds.kernels import is_equal, replaced
from experiments.fuzz.kinds.timing_kernels import DEGENERATE_PROGRAMS, LANES, drawn_program
from optdock.kernels import using_kernels
from optdock.timing import interior_point
from optdock.timing.interior_point import (
    Iterate,
    Program,
    _advanced_native,
    _band_product,
    _band_solution,
    advanced,
    iterations_at_once,
    solve,
)
from optdock.timing.jerk_phases import MotionState
from optdock.timing.reference_program import coefficients_of, spline_of

needs_compiler = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")


@pytest.fixture(autouse=True)
def _no_kernel_is_replaced():
    """A kernel whose first result differs is replaced by its twin, and would be equal to it."""
    yield
    assert replaced() == ""


def capped(cells, most, places=0):
    """A program of equal cells whose only effective limit is the speed squared at the knots, and its first iterate."""
    spline = spline_of(np.full(cells, 0.1))
    rows = (spline.right_value / most)[:, None]
    with_speed = np.zeros((3, 2 + places, cells))
    stencil = np.repeat(spline.right_value[:, None], places, axis=1)
    program = Program.of(np.full(cells, 0.1), rows, with_speed, stencil, spline.right_share, np.zeros((4, cells + 2)))
    return program, np.full(cells + 2, 0.5 * most)


def test_the_fastest_speeds_below_a_cap_are_at_the_cap():
    program, c = capped(40, 0.3)
    last = solve(program, Iterate(c), lambda: None)
    found = last.state[: c.size]
    assert last.iteration < 15
    assert np.array_equal(found[[0, 1, -2, -1]], c[[0, 1, -2, -1]])
    # The given coefficients at the ends displace their neighbours, and the effect alternates and fades.
    assert found[12:-12] == pytest.approx(0.3, rel=0.02)


def test_the_deadline_is_polled_before_every_share_of_the_iterations_and_may_raise(monkeypatch):
    class Late(Exception):
        pass

    def look():
        polls.append(1)
        if len(polls) == 4:
            raise Late

    program, c = capped(40, 0.3)
    polls = []
    iterations = solve(program, Iterate(c), lambda: polls.append(1)).iteration
    assert len(polls) == 1
    assert iterations_at_once(40) > iterations > 4
    monkeypatch.setattr(interior_point, "AT_ONCE", 40)
    with pytest.raises(Late):
        solve(program, Iterate(c), look)


def test_iterations_between_two_polls_take_less_than_a_millisecond():
    """The kernel takes 0.2 us for a cell in an iteration; without a poll, 5 ms may pass on a slow machine."""
    for m in (8, 50, 300, 1000, 5000):
        assert iterations_at_once(m) == 1 or m * iterations_at_once(m) <= 1000
    assert iterations_at_once(8) >= 40


@pytest.mark.parametrize("seed", range(5))
def test_band_solutions_and_products_are_those_of_the_full_matrix(seed):
    draw = np.random.default_rng(seed)
    n = int(draw.integers(1, 30))
    bands = draw.normal(size=(4, n))
    bands[3] = np.abs(bands).sum() + 1.0
    full = np.diag(bands[3])
    for distance in range(1, min(4, n)):
        full += np.diag(bands[3 - distance, distance:], distance) + np.diag(bands[3 - distance, distance:], -distance)
    force = draw.normal(size=n)
    np.testing.assert_allclose(_band_solution(bands, force), np.linalg.solve(full, force), rtol=1e-12)
    if n > 3:
        np.testing.assert_allclose(_band_product(bands, force), full @ force, rtol=1e-12)


def test_a_matrix_that_is_not_positive_definite_has_the_solution_zero():
    assert np.array_equal(_band_solution(np.array([[0.0], [0.0], [0.0], [-1.0]]), np.array([1.0])), [0.0])


def test_the_result_does_not_depend_on_the_iterations_at_once():
    program, c = drawn_program(np.random.default_rng(5), "none")
    whole, parts = advanced(program, Iterate(c), 40), Iterate(c)
    while not parts.ended:
        parts = advanced(program, parts, 2)
    assert is_equal(whole, parts)


# Both lanes


@needs_compiler
@pytest.mark.parametrize("degenerate", DEGENERATE_PROGRAMS)
@pytest.mark.parametrize("seed", range(12))
def test_iterates_of_both_lanes_are_equal_to_the_last_bit(degenerate, seed):
    program, c = drawn_program(np.random.default_rng(seed), degenerate)
    found = {}
    for lane in LANES:
        with using_kernels(lane), np.errstate(all="ignore"):
            iterate = Iterate(c)
            found[lane] = [iterate := advanced(program, iterate, most) for most in (1, 2, 40)]
    for twin, native in zip(*found.values(), strict=True):
        assert is_equal(twin, native)


def test_degenerate_programs_do_not_converge_and_others_do():
    ended = {}
    for degenerate in DEGENERATE_PROGRAMS:
        iterations = []
        for seed in range(12):
            program, c = drawn_program(np.random.default_rng(seed), degenerate)
            with np.errstate(all="ignore"):
                iterations.append(advanced(program, Iterate(c), 40).iteration)
        ended[degenerate] = np.array(iterations)
    assert np.median(ended["none"]) < 30
    assert np.sum(ended["infeasible"] == 40) > 6
    assert np.sum(ended["nan"] == 1) > 3


@needs_compiler
def test_nan_stays_in_the_iterate():
    program, c = capped(8, 0.3, places=1)
    c[4] = np.nan
    found = _advanced_native(program, Iterate(c), 40)
    assert (found.iteration, found.ended) == (1, True)
    assert np.isnan(found.state[4])
    assert np.isnan(found.state[-2])


@needs_compiler
@pytest.mark.parametrize("part", range(6))
def test_arrays_of_wrong_sizes_are_errors(part):
    program, c = capped(8, 0.3, places=1)
    parts = list(program.parts)
    parts[part] = parts[part][..., :-1]
    with pytest.raises(ValueError, match="contiguous with"):
        _advanced_native(Program.of(*parts), Iterate(c), 1)


@needs_compiler
def test_a_program_with_too_few_cells_is_an_error():
    program, c = capped(3, 0.3)
    with pytest.raises(ValueError, match="at least 4 cells"):
        _advanced_native(program, Iterate(c), 1)


@needs_compiler
def test_coefficients_of_a_segment_without_length_end_both_lanes_alike():
    steps = np.zeros(8)
    with np.errstate(all="ignore"):
        spline = spline_of(steps)
        rows = spline.right_value[:, None]
        program = Program.of(
            steps, rows, np.zeros((3, 2, 8)), np.zeros((3, 0, 8)), spline.right_share, np.zeros((4, 10))
        )
        c = coefficients_of(steps, np.zeros(9), MotionState(), MotionState())
        found = []
        for lane in LANES:
            with using_kernels(lane):
                found.append(advanced(program, Iterate(c), 40))
    assert is_equal(*found)
    assert found[0].ended
