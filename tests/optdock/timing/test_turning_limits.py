"""Turning limits of both orders: consistency of the methods with the limited quantity."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from optdock.model.limits import MotionLimits
from optdock.timing.turning_limits import TurningLimit, turning_limits, turning_ratio

sizes = st.floats(0.05, 20.0)
orders = pytest.mark.parametrize("order", [1, 2])


def ratio(limit, v, a, k, r):
    return float(limit.ratio(*(np.array([value]) for value in (k, r, v, a)))[0])


@orders
@settings(max_examples=20)
@given(sizes, sizes, st.floats(-5.0, 5.0), st.floats(-5.0, 5.0), st.floats(-5.0, 5.0))
def test_ratio_is_a_derivative_and_scales_with_time(order, bound, v, a, k, r):
    limit, h = TurningLimit("", order, bound), 1e-6

    def value(t):
        return (v + a * t) ** order * (k + r * (v * t + 0.5 * a * t * t))

    size = abs(value(h) - value(-h)) / (2.0 * h)
    found = ratio(limit, v, a, k, r)
    assert found == pytest.approx((size / bound) ** (2.0 / (order + 1)), rel=1e-4, abs=1e-4)
    assert ratio(limit, v / 3.0, a / 9.0, k, r) == pytest.approx(found / 9.0)


@orders
@settings(max_examples=20)
@given(sizes, sizes, st.floats(0.1, 1.0))
def test_methods_agree_at_constant_speed(order, bound, rate, share):
    limit, rates = TurningLimit("", order, bound), np.array([rate])
    fastest = limit.fastest(rate)
    assert ratio(limit, fastest, 0.0, 1.0, rate) == pytest.approx(1.0)
    assert 1.0 / float(limit.slowness(rates)[0]) == pytest.approx(fastest)
    assert float(limit.at_constant_speed(np.array([fastest**2]), rates)[0]) == pytest.approx(bound)
    assert float(limit.most_squared(np.array([bound]), rates)[0]) == pytest.approx(fastest**2)
    slower = 1.0 / float(limit.slowness(rates, share)[0])
    assert float(limit.at_constant_speed(np.array([slower**2]), rates)[0]) == pytest.approx(share * bound)
    least = limit.bounds(np.array([share]))
    assert float(limit.most_squared(least, rates)[0]) == pytest.approx(share * fastest**2)
    assert limit.fastest(0.0) == math.inf


@orders
@settings(max_examples=20)
@given(sizes, sizes, sizes, st.floats(0.01, 0.99))
def test_the_acceleration_beside_the_curvature_rate_uses_up_the_rest(order, bound, bend, rate, used):
    limit = TurningLimit("", order, bound)
    v = used * limit.fastest(rate)
    columns = (np.array([value]) for value in (v, bend, rate))
    assert ratio(limit, v, float(limit.acceleration_beside(*columns, 1.0)[0]), bend, rate) == pytest.approx(1.0)
    straight = limit.acceleration_beside(np.array([v]), np.zeros(1), np.array([rate]), 1.0)
    assert straight[0] == math.inf


@orders
@settings(max_examples=20)
@given(sizes, st.floats(0.0, 2.0), sizes, sizes, st.floats(0.1, 1.0))
def test_an_arc_of_constant_jerk_stays_within_its_share(order, bound, v, jerk, bend, share):
    limit = TurningLimit("", order, bound)
    top = limit.arc_acceleration(v, jerk, bend, share)
    for a in np.linspace(0.0, top, 20):
        assert ratio(limit, v + a * a / (2.0 * jerk), a, bend, 0.0) <= share ** (2.0 / (order + 1)) * (1.0 + 1e-9)
    assert ratio(limit, v + top * top / (2.0 * jerk), top, bend, 0.0) > 0.2 * share ** (2.0 / (order + 1))
    assert limit.arc_acceleration(v, jerk, 0.0, share) == math.inf


@orders
@settings(max_examples=20)
@given(sizes, st.floats(-3.0, 3.0), st.floats(0.1, 20.0), sizes, st.floats(0.05, 3.0))
def test_inevitable_ratio_bounds_every_acceleration(order, bound, k, r, relief, v):
    limit = TurningLimit("", order, bound)

    def inevitable(v):
        return float(limit.inevitable(*(np.array([value]) for value in (v, k, r, relief)))[0])

    helps = min(relief, v * v * r / (order * abs(k))) if k else 0.0
    best = ratio(limit, v, -math.copysign(helps, k), k, r)
    if inevitable(v) > 1.0 + 1e-9:
        assert best > 1.0
        assert inevitable(1.3 * v) > 1.0
    elif inevitable(v) < 1.0 - 1e-9:
        assert best < 1.0


def test_turning_ratio_is_the_largest_of_finite_limits():
    columns = [np.array([value]) for value in (1.0, 2.0, 0.5, 0.3)]
    assert turning_limits(MotionLimits()) == ()
    assert turning_ratio((), *columns).tolist() == [0.0]
    both = turning_limits(MotionLimits(max_yaw_acceleration=0.7, max_lateral_jerk=0.2))
    assert [(limit.name, limit.order, limit.bound) for limit in both] == [
        ("max_yaw_acceleration", 1, 0.7),
        ("max_lateral_jerk", 2, 0.2),
    ]
    assert turning_ratio(both, *columns)[0] == max(float(limit.ratio(*columns)[0]) for limit in both)
