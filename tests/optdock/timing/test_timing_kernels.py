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
from optdock.model.path import Direction
from optdock.timing import path_limits, ruckig_moves
from optdock.timing.jerk_phases import MotionState
from optdock.timing.path_limits import PathLimits, ReferenceBounds, SpeedCaps, Tightening, limits_along, segment_limits
from optdock.timing.reference_program import _prepared_native, prepared

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


@pytest.mark.parametrize("seed", range(80))
def test_limits_of_both_lanes_are_equal_to_the_last_bit(seed, make, all_limits):
    """Also with knots and a start of the zone within rounding of each other, and without some of the limits."""
    rng = np.random.default_rng([28, seed])
    pieces = int(rng.integers(1, 40))
    curvature = rng.uniform(-2.0, 2.0, pieces + 1) * rng.choice([0.0, 1.0], pieces + 1)
    lengths = rng.exponential(rng.choice([1e-12, 0.01, 1.0]), pieces) + 1e-13
    lengths[-1] += 1e-3
    spline = make.spline(lengths, curvature).spline
    changes = {name: np.inf for name in ("max_yaw_acceleration", "max_wheel_speed") if rng.uniform() < 0.4}
    changes |= {"wheelbase": 0.5, "max_steering_rate": 1.0} if rng.uniform() < 0.5 else {}
    caps = SpeedCaps(replace(all_limits, max_lateral_jerk=np.inf, **changes), Direction.REVERSE)
    zone_start = float(rng.choice([0.0, spline.length, spline.length * rng.uniform(), rng.choice(spline.knots)]))
    zone_start = min(max(zone_start + float(rng.choice([-1e-12, 0.0, 0.0, 1e-12])), 0.0), spline.length)
    twin, native = both(path_limits._clothoid_chosen, spline, caps, zone_start, float(rng.choice([0.1, np.inf])))
    assert is_equal((twin,), (native,))
    assert PathLimits(native, caps, 0.1).length == spline.length


@pytest.mark.parametrize(("count", "room"), [(2, 10), (1, 1000), (2, 1)])
def test_limits_with_more_nodes_than_room_are_refused(count, room):
    ends, table = np.array([0.0, 1.0]), np.empty(13 * room + count - 8)
    given = ((ends[:count], count), (ends[:count], count), (table, table.size))
    assert path_limits._KERNEL((count, room), (0.005, 1.0, *[1.0] * 9), given) == -1


@pytest.fixture(params=CASES)
def case(request, make, all_limits):
    """Bounds and start of a reference."""
    changes, options, start = CASES[request.param]
    path = make.random_path(np.random.default_rng(len(request.param)), length=2.0)
    limits = limits_along(path, replace(all_limits, **changes), SpeedZone(0.15, 0.4))[0]
    return ReferenceBounds(limits, **options), start


def both(function, *args):
    found = []
    for lane in LANES:
        with using_kernels(lane), np.errstate(all="ignore"):
            found.append(function(*args))
    return found


def is_same(first, second):
    """Whether two flat results are equal to the last bit."""
    return len(first) == len(second) and all(is_equal((a,), (b,)) for a, b in zip(first, second, strict=True))


def test_programs_of_both_lanes_are_equal_to_the_last_bit(case):
    twin, native = both(prepared, *case)
    assert native.program.m > 8
    assert is_same(flat(twin), flat(native))


def flat(found):
    """The parts of a result of `prepared` as one tuple of arrays and numbers."""
    if found is None or isinstance(found, np.ndarray | float | int):
        return (np.array([-1.0]) if found is None else np.asarray(found),)
    return tuple(part for one in found for part in flat(one))


@pytest.mark.parametrize("seed", range(60))
def test_programs_of_random_segments_are_equal_to_the_last_bit(seed, make, all_limits):
    """Also with many jumps, of which some have no knot, with a late zone, and with starts that leave no room."""
    rng = np.random.default_rng([27, seed])
    pieces = int(rng.integers(1, 60))
    curvature = rng.uniform(-2.0, 2.0, pieces + 1) * rng.choice([0.0, 0.1, 1.0], pieces + 1)
    segment = make.spline(rng.exponential(rng.choice([0.01, 0.1, 1.0]), pieces) + 1e-4, curvature)
    changes = {name: np.inf for name in NO_TURNING if rng.uniform() < 0.4}
    if rng.uniform() < 0.3:
        changes |= {"wheelbase": 0.5, "max_steering_rate": float(rng.exponential(1.0)) + 0.05}
    caps = SpeedCaps(replace(all_limits, **changes), Direction.FORWARD)
    zone = (segment.length * rng.uniform(-0.1, 1.1), float(rng.exponential(0.1)) + 1e-3)
    limits = segment_limits(segment, caps, *(zone if rng.uniform() < 0.6 else (np.inf, np.inf)))
    tightenings = (Tightening(0.2, 0.3 + rng.exponential(), rng.uniform(0.3, 1.0)),) * int(rng.integers(2))
    bounds = ReferenceBounds(limits, float(rng.choice([0.011, 0.08, 0.5])), tightenings=tightenings)
    moving = MotionState(0.0, float(rng.exponential(0.1)), float(rng.normal(0.0, 0.1)))
    for start in (MotionState(), moving, MotionState(0.0, 0.0, 0.05)):
        twin, native = both(prepared, bounds, start)
        assert is_same(flat(twin), flat(native))


def test_a_reference_that_takes_longer_than_estimated_gets_more_room(case, monkeypatch):
    bounds, start = case
    monkeypatch.setattr(bounds.limits, "duration_estimate", 0.0)
    bounds.step = 0.005  # many cells
    twin, native = both(prepared, bounds, start)
    assert native.program.m > 100
    assert is_same(flat(twin), flat(native))


@pytest.mark.parametrize("name", ["speed_squared", "steepest", "rate_left", "slowness_left", "curvature"])
def test_nan_and_infinite_bounds_end_both_lanes(case, name):
    """NaN may differ between the lanes, but neither writes beyond its arrays; the sanitizers run this test."""
    bounds, start = case
    spoiled = getattr(bounds if name == "speed_squared" else bounds.limits, name)
    for wrong in (np.nan, 0.0, np.inf):
        spoiled[spoiled.size // 2] = wrong
        with np.errstate(all="ignore"):
            found = _prepared_native(bounds, start)
        assert found.grid is None or found.grid.steps.size == found.program.m


@pytest.mark.parametrize("cut", ["bounds", "limits"])
def test_tables_of_wrong_sizes_are_an_error(case, cut):
    bounds, start = case
    owner = bounds if cut == "bounds" else bounds.limits
    owner.table = owner.table[:-1].copy()
    with pytest.raises(ValueError, match=r"array . must be contiguous with"):
        _prepared_native(bounds, start)


@pytest.mark.parametrize("jump", [-1, 0, 10**9])
def test_a_jump_that_is_no_inner_node_is_an_error(case, jump):
    bounds, start = case
    bounds.jumps = np.array([jump])
    with pytest.raises(ValueError, match="jumps at inner nodes"):
        _prepared_native(bounds, start)
    with pytest.raises(ValueError, match="jumps at inner nodes"):
        ruckig_moves._evaluate_native(bounds, [(start, ((0.1, 0.0),))])


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
