"""Instants at which a motion reaches places: closed forms, and the kernel equal to its twin to the last bit."""

import shutil

import numpy as np
import pytest

from experiments.fuzz.kinds.kernels import is_equal, replaced
from experiments.fuzz.kinds.timing_kernels import LANES, drawn_law
from optdock.kernels import using_kernels
from optdock.model.constant_jerk import TimeLaw
from optdock.verification.turning_rules import _crossings_native, crossings

needs_compiler = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")


@pytest.fixture(autouse=True)
def _no_kernel_is_replaced():
    """A kernel whose first result differs is replaced by its twin, and would be equal to it."""
    yield
    assert replaced() == ""


@pytest.mark.parametrize("lane", ["twin", pytest.param("native", marks=needs_compiler)])
def test_places_are_reached_at_the_times_of_the_closed_form(lane):
    law = TimeLaw([2.0, 3.0], [0.0, 6.0], start_speed=0.5)  # 1 m at a constant speed, then a cubic
    with using_kernels(lane):
        found = crossings(law, np.array([-1.0, 0.0, 0.25, 1.0, 1.0 + 0.5 + 1.0, 1e9]))
    assert found.phase.tolist() == [0, 0, 0, 0, 1, 1]
    assert found.since == pytest.approx([0.0, 0.0, 0.5, 2.0, 1.0, 3.0], abs=1e-15)


@pytest.mark.parametrize("lane", ["twin", pytest.param("native", marks=needs_compiler)])
def test_places_are_reached_before_a_rest_and_left_after_it(lane):
    law = TimeLaw([1.0, 2.0, 1.0, 5.0], [1.0, -1.0, 1.0, 0.0])
    rest = float(law.states[-1, 0])
    with using_kernels(lane):
        found = crossings(law, np.array([np.nextafter(rest, 0.0), rest]))
    assert found.phase.tolist() == [2, 2]


@needs_compiler
@pytest.mark.parametrize("seed", range(60))
def test_crossings_of_both_lanes_are_equal_to_the_last_bit(seed):
    law, places = drawn_law(np.random.default_rng(seed))
    found = []
    for lane in LANES:
        with using_kernels(lane):
            found.append(crossings(law, places))
    assert is_equal(*found)
    assert np.all((found[0].phase >= 0) & (found[0].phase < law.durations.size))


@needs_compiler
def test_no_places_are_no_crossings():
    law = TimeLaw([1.0], [1.0])
    assert [part.size for part in _crossings_native(law, np.zeros(0))] == [0, 0]


@needs_compiler
@pytest.mark.parametrize("places", [np.zeros((4, 2))[:, 0], np.zeros(3, dtype=np.float32)], ids=["strided", "float32"])
def test_places_must_be_contiguous_doubles(places):
    with pytest.raises(ValueError, match="array 3 must be contiguous"):
        _crossings_native(TimeLaw([1.0], [1.0]), places)
