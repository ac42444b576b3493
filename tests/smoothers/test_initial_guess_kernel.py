"""The kernel of the pure pursuit: equal to Python to the last bit."""

import shutil

import numpy as np
import pytest

from experiments.fuzz.kinds.kernels import replaced
from optdock.kernels import using_kernels
from smoothers.scp.basis import basis_for
from smoothers.scp.initial_guess import pure_pursuit
from smoothers.scp.nlp import Ends, VariableBounds
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
