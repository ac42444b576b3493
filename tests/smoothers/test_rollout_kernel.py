"""The kernels of roll-out, sensitivity and goal projection: equal to NumPy to the last bit, but for signs of zeros."""

import shutil

import numpy as np
import pytest

from experiments.fuzz.kinds.kernels import BENT, drawn_program, replaced, rolled
from optdock.kernels import using_kernels
from smoothers.scp.goal_projection import project_and_roll_out, rate_is_kept

pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")

START = np.array([0.3, -1.2, 0.7])


def both_lanes(nlp, variables):
    found = []
    for lane in ("twin", "native"):
        with using_kernels(lane):
            found.append(rolled(nlp, variables))
    assert not replaced()  # a kernel that differs in its first call is replaced by its twin
    return found


@pytest.mark.parametrize("degenerate", BENT)
def test_both_lanes_are_equal_to_the_last_bit(degenerate):
    for seed in range(25):
        nlp, variables = drawn_program(np.random.default_rng(seed), START, degenerate)
        twin, native = both_lanes(nlp, variables)
        assert all(np.array_equal(a, b) for a, b in zip(twin, native, strict=True)), seed


@pytest.mark.parametrize("degenerate", ["none", "fixed", "rate"])
def test_a_projected_path_keeps_its_bounds_and_often_ends_at_the_target(degenerate):
    reached = 0
    for seed in range(30):
        nlp, variables = drawn_program(np.random.default_rng(seed), START, degenerate)
        with using_kernels("native"):
            projected, driven = project_and_roll_out(nlp, variables)
        assert rate_is_kept(nlp.basis, projected, nlp.bounds)
        flat = np.concatenate(projected)
        assert np.all((flat >= nlp.bounds.lower) & (flat <= nlp.bounds.upper))
        reached += np.abs(nlp.ends.error(driven)).max() < 1e-6
    assert 5 < reached < 30
