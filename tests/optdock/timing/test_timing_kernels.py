"""The kernels of the reference and of the moves: equal to their twins to the last bit, and checked at the door."""

import shutil
from dataclasses import replace

import numpy as np
import pytest

from experiments.fuzz.case import rng_of
from experiments.fuzz.kinds import timings
from experiments.fuzz.kinds.kernels import is_equal, replaced
from experiments.fuzz.kinds.timing_kernels import LANES, judge
from optdock.kernels import using_kernels
from optdock.model.limits import SpeedZone
from optdock.timing import reference_program, ruckig_moves
from optdock.timing.forward_backward import forward_backward_pass
from optdock.timing.jerk_phases import MotionState
from optdock.timing.path_limits import ReferenceBounds, Tightening, limits_along
from optdock.timing.reference_grid import grid_of, launch_arc, stop_arc
from optdock.timing.reference_program import prepared

pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")


@pytest.fixture(autouse=True)
def _no_kernel_is_replaced():
    """A kernel whose first result differs is replaced by its twin, and would be equal to it."""
    yield
    assert replaced() == ""


NO_TURNING = {"max_yaw_acceleration": np.inf, "max_lateral_jerk": np.inf}
CASES = {
    "all limits": ({}, {}, MotionState()),
    "infinite limits": (NO_TURNING, {}, MotionState()),
    "lateral jerk alone": ({"max_yaw_acceleration": np.inf}, {}, MotionState()),
    "yaw acceleration alone": ({"max_lateral_jerk": np.inf}, {}, MotionState()),
    "tight yaw acceleration": ({"max_lateral_jerk": np.inf, "max_yaw_acceleration": 0.1}, {}, MotionState()),
    "steering": ({"wheelbase": 0.5, "max_steering_rate": 1.0, "max_lateral_jerk": np.inf}, {}, MotionState()),
    "moving": ({"max_lateral_jerk": np.inf}, {"relief": 0.3}, MotionState(0.0, 0.1, -0.05)),
    "tightened": ({"max_lateral_jerk": np.inf}, {"tightenings": (Tightening(0.4, 1.0, 0.5),)}, MotionState()),
    "smooth": ({}, {"smooth": True}, MotionState()),
}


@pytest.fixture(params=CASES)
def case(request, make, all_limits):
    """Bounds, start, profile, grid and both ends of a reference."""
    changes, options, start = CASES[request.param]
    path = make.random_path(np.random.default_rng(len(request.param)), length=2.0)
    limits = limits_along(path, replace(all_limits, **changes), SpeedZone(0.15, 0.4))[0]
    bounds = ReferenceBounds(limits, **options)
    profile = forward_backward_pass(bounds, start)
    first, last = launch_arc(bounds, start).state, stop_arc(bounds).state
    return bounds, profile, grid_of(bounds, profile, first, last), first, last


def both(function, *args):
    found = []
    for lane in LANES:
        with using_kernels(lane), np.errstate(all="ignore"):
            found.append(function(*args))
    return found


def test_programs_of_both_lanes_are_equal_to_the_last_bit(case):
    twin, native = both(prepared, *case)
    assert is_equal(twin.program, native.program)
    assert is_equal(twin[1:], native[1:])


@pytest.mark.parametrize("name", ["steps", "bound", "curvature", "rate", "centre_curvature", "time"])
def test_nan_and_cells_of_length_zero_are_the_same_in_both_lanes(case, name):
    bounds, profile, grid, first, last = case
    for wrong in (np.nan, 0.0, np.inf):
        spoiled = getattr(grid, name).copy()
        spoiled.flat[3] = wrong
        twin, native = both(prepared, bounds, profile, grid._replace(**{name: spoiled}), first, last)
        assert is_equal(twin.program, native.program)
        assert is_equal(twin[1:], native[1:])
        if np.isnan(wrong) and name in ("steps", "bound", "time"):  # which every program depends on
            assert np.isnan(native.program.data).any() or np.isnan(native.first).any()


@pytest.mark.parametrize("name", ["bound", "centre_curvature", "time"])
def test_a_grid_of_wrong_sizes_is_an_error(case, name):
    bounds, profile, grid, first, last = case
    cut = grid._replace(**{name: getattr(grid, name)[:-1]})
    with pytest.raises(ValueError, match="array . must be contiguous with"):
        reference_program._prepared_native(bounds, profile, cut, first, last)


def drawn_moves(rng, length):
    """Moves forward of up to 2 s from anywhere on a segment, some of a single short phase, some beyond its end."""
    moves = []
    for _ in range(int(rng.integers(1, 6))):
        start = MotionState(float(rng.uniform(0.0, length)), float(rng.uniform(0.0, 0.6)), float(rng.normal(0.0, 0.2)))
        count = int(rng.integers(1, 8))
        durations, jerks = rng.exponential(0.3, count) ** 2 + 1e-12, rng.choice([0.0, 1.2, -1.2], count)
        moves.append((start, tuple(zip(durations.tolist(), jerks.tolist(), strict=True))))
    return moves


@pytest.mark.parametrize("seed", range(6))
def test_excesses_of_both_lanes_are_equal_to_the_last_bit(case, seed):
    bounds = case[0]
    moves = drawn_moves(np.random.default_rng(seed), bounds.limits.length)
    twin, native = both(ruckig_moves._evaluate, bounds, moves)
    assert is_equal(twin, native)
    assert len(native) == len(moves)


def test_the_excess_of_a_move_with_nan_is_nan_or_refused(case):
    bounds = case[0]
    still = [(MotionState(0.1, np.nan), ((0.1, 0.0),))]
    twin, native = both(ruckig_moves._evaluate, bounds, still)
    assert np.isnan(native[0][0])
    assert np.isnan(twin[0][0])
    with pytest.raises(ValueError, match=r"moves: must|cannot convert"):
        ruckig_moves._evaluate_native(bounds, [(MotionState(), ((np.nan, 0.0),))])


def test_a_move_without_phases_is_an_error(case):
    with pytest.raises(ValueError, match="moves: must have phases"):
        ruckig_moves._evaluate_native(case[0], [(MotionState(), ((0.1, 0.0),)), (MotionState(), ())])


@pytest.mark.parametrize("number", range(25))
def test_time_laws_of_both_lanes_are_equal_to_the_last_bit(number):
    found = judge({**timings.draw(rng_of("kernels", 5, number)), "plugin": "NearOptimal"})
    assert found.outcome == "equal timings", found
