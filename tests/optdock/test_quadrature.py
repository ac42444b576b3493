import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from optdock.geometry.quadrature import adaptive_integral


def test_polynomials_up_to_degree_29_are_exact_at_once():
    calls = []

    def monomial(x):
        calls.append(x.size)
        return 30.0 * x**29

    assert adaptive_integral(monomial, np.array([0.0, 1.0])) == pytest.approx(1.0, rel=1e-14)
    assert calls == [16, 32]


@given(st.floats(0.001, 0.999))
def test_a_kink_anywhere_is_found(kink):
    wanted = 0.5 * (kink**2 + (1.0 - kink) ** 2)
    assert adaptive_integral(lambda x: np.abs(x - kink), np.array([0.0, 1.0])) == pytest.approx(wanted, abs=1e-8)


@pytest.mark.parametrize("kink", [0.2505561285961351, 1e-4, 1.0 - 1e-4, 1e-9])
def test_a_kink_between_an_end_and_the_first_inner_node_is_found(kink):
    wanted = 0.5 * (kink**2 + (1.0 - kink) ** 2)
    assert adaptive_integral(lambda x: np.abs(x - kink), np.array([0.0, 1.0])) == pytest.approx(wanted, abs=1e-10)


def test_a_jump_at_a_break_belongs_to_the_panel_after_it():
    step = adaptive_integral(lambda x: np.where(x < 0.3, 1.0, 2.0), np.array([0.0, 0.3, 1.0]))
    assert step == pytest.approx(0.3 + 1.4, abs=1e-13)


def test_one_fixed_panel_would_miss_the_kink():
    nodes, weights = np.polynomial.legendre.leggauss(16)
    fixed = 0.5 * float(weights @ np.abs(0.5 * (nodes + 1.0) - 0.3))
    assert abs(fixed - 0.29) > 1e-4


def test_an_integrable_singular_slope_ends():
    assert adaptive_integral(np.sqrt, np.array([0.0, 1.0])) == pytest.approx(2.0 / 3.0, abs=1e-10)


@given(st.lists(st.floats(0.01, 0.99), max_size=5, unique=True))
def test_breaks_do_not_change_the_integral(inner):
    breaks = np.array([0.0, *sorted(inner), 1.0])
    assert adaptive_integral(np.exp, breaks) == pytest.approx(math.e - 1.0, rel=1e-13)


def test_zero_integrates_to_zero():
    assert adaptive_integral(np.zeros_like, np.array([0.0, 1.0])) == 0.0
