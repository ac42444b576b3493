"""Infeasible starts are reported with limit and place, in bounded time and memory."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from optdock.model.limits import MotionLimits, SpeedZone
from optdock.model.path import Direction, Path
from optdock.plugins.interfaces import TimingStatus
from optdock.timing.jerk_phases import Motion, MotionState, braking_slack
from optdock.timing.near_optimal import NearOptimal
from optdock.timing.path_limits import SpeedCaps, limits_along, segment_limits
from optdock.timing.start_states import Braking
from optdock.timing.windowed import Windowed

STRAIGHT_LIMITS = MotionLimits(max_speed=1.0, max_acceleration=0.4, max_deceleration=0.5, max_jerk=1.5)


@pytest.fixture(scope="module")
def along(make):
    return segment_limits(make.spline([3.0], [0.0, 0.0]), SpeedCaps(STRAIGHT_LIMITS, Direction.FORWARD), 9.0, 9.0)


@settings(max_examples=25)
@given(
    v=st.floats(0.2, 0.8),
    a=st.floats(-0.3, 0.4),
    jerks=st.lists(st.tuples(st.floats(0.05, 0.5), st.floats(-1.5, 1.5)), min_size=1, max_size=8),
)
def test_full_braking_has_the_least_speed_at_every_distance(along, v, a, jerks):
    # da/ds = j / v: with the least jerk from the same state nothing gets below, as long as a >= -D.
    start = MotionState(0.0, v, a)
    assume(braking_slack(start, STRAIGHT_LIMITS.max_jerk) > 0.01)
    brake, other = Braking(along, start).motion, Motion.of(start, jerks)
    t = np.linspace(0.0, other.duration, 200)
    s, speed, acceleration = other.at(t)
    legal = np.cumsum((speed < 0.0) | (acceleration < -STRAIGHT_LIMITS.max_deceleration)) == 0
    settling = brake.times[-2]  # the last phase leads the deceleration back to zero
    inside = legal & (s < brake.at(np.array([settling]))[0, 0])
    assume(inside.any())
    slowest = brake.at(brake.crossing_times(s[inside]))[1]
    assert np.all(speed[inside] >= slowest - 1e-6)


def test_ratios_are_one_exactly_at_the_caps(make):
    limits = MotionLimits(max_yaw_rate=0.5, max_deceleration=0.6, max_jerk=2.0)
    segment = make.spline([0.2, 1.0], [1.0, 1.0, 1.0])
    along = limits_along(Path((segment,)), limits, SpeedZone())[0]
    assert Braking(along, MotionState(0.0, 0.5)).path_ratios.max() == pytest.approx(1.0)
    assert Braking(along, MotionState(0.0, 0.45)).path_ratios.max() == pytest.approx(0.9)


def test_inevitable_yaw_acceleration(make):
    # v^2 k' - D k <= al while braking with D.
    limits = MotionLimits(max_speed=2.0, max_yaw_acceleration=0.5, max_deceleration=0.5, max_jerk=100.0)
    along = limits_along(Path((make.spline([0.2, 2.0], [0.0, 0.4, 0.4]),)), limits, SpeedZone())[0]
    braking = Braking(along, MotionState(0.0, 0.7))
    s, v, _a = braking.states
    rising = (s > 0.0) & (s < 0.2 - 1e-9)
    fastest = np.sqrt((0.5 + 2.0 * s[rising] * 0.5) / 2.0)
    np.testing.assert_allclose(braking.path_ratios[rising], np.maximum(v[rising] / fastest, v[rising] / 2.0))


def test_tight_length_ends_where_braking_leaves_room(make):
    limits = MotionLimits(max_yaw_rate=0.5, max_deceleration=0.6, max_jerk=2.0)
    along = limits_along(Path((make.spline([3.0], [1.0, 1.0]),)), limits, SpeedZone())[0]
    assert Braking(along, MotionState(0.0, 0.3)).tight_length(0.01, 0.95) == 0.0
    length = Braking(along, MotionState(0.0, 0.5)).tight_length(0.01, 0.95)
    assert 0.0 < length < 0.1
    assert Braking(along, MotionState(0.0, 0.5)).tight_length(0.1, 0.95) > length


METHODS = (NearOptimal(), Windowed())
LIMITS = MotionLimits(max_speed=0.5, max_acceleration=0.4, max_deceleration=0.5, max_jerk=2.0, track_width=0.4)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    ("limit", "value", "ratio"),
    [  # at 0.4 m/s on an arc of curvature 1/m; of a square root where the limit is on the speed's square
        ("max_speed", 0.2, 2.0),
        ("max_yaw_rate", 0.25, 1.6),
        ("max_lateral_acceleration", 0.04, 2.0),
        ("max_wheel_speed", 0.3, 1.6),
    ],
)
def test_start_above_a_cap_reports_limit_place_and_ratio(method, limit, value, ratio, make):
    limits = MotionLimits(**{**LIMITS.__dict__, limit: value})
    path = Path((make.spline([3.0], [1.0, 1.0]),))
    result = method.parameterize(path, limits, SpeedZone(), start_speed=0.4)
    assert (result.status, result.limit, result.at_s) == (TimingStatus.START_INFEASIBLE, limit, 0.0)
    assert result.worst_ratio == pytest.approx(ratio, rel=1e-6)
    assert f"{ratio:.4g} times what {limit} = {value:.4g}" in result.reason


@pytest.mark.parametrize("method", METHODS)
def test_start_violating_other_limits_reports_them(method, make):
    straight, bend = Path((make.spline([3.0], [0.0, 0.0]),)), Path((make.spline([0.5, 2.0], [0.0, 1.5, 1.5]),))
    turning = MotionLimits(**{**LIMITS.__dict__, "max_yaw_acceleration": 0.2})
    asked = (
        (straight, LIMITS, SpeedZone(0.1, 2.9), (0.4, 0.0), "approach_speed", 0.1),
        (bend, turning, SpeedZone(), (0.4, 0.0), "max_yaw_acceleration", 0.0),
        (straight, LIMITS, SpeedZone(), (0.2, 0.6), "max_acceleration", 0.0),
        (straight, LIMITS, SpeedZone(), (0.4, -0.7), "max_deceleration", 0.0),
    )
    for path, limits, zone, (speed, acceleration), limit, at_s in asked:
        result = method.parameterize(path, limits, zone, start_speed=speed, start_acceleration=acceleration)
        assert (result.status, result.limit) == (TimingStatus.START_INFEASIBLE, limit)
        assert result.at_s == pytest.approx(at_s, abs=0.005)
        assert limit in result.reason
        assert f"s = {result.at_s:.4f} m" in result.reason


@pytest.mark.parametrize("method", METHODS)
def test_start_violating_the_lateral_jerk_reports_it(method, make):
    """At the start 2 v a k; where the curvature rises v^3 k' - 2 v D k, which no motion keeps."""
    limits = MotionLimits(**{**LIMITS.__dict__, "max_lateral_jerk": 0.1})
    arc, bend = Path((make.spline([3.0], [1.0, 1.0]),)), Path((make.spline([0.05, 0.5, 2.0], [0.0, 0.0, 2.0, 2.0]),))
    result = method.parameterize(arc, limits, SpeedZone(), start_speed=0.3, start_acceleration=0.3)
    assert (result.status, result.limit, result.at_s) == (TimingStatus.START_INFEASIBLE, "max_lateral_jerk", 0.0)
    assert "lateral jerk 0.18 m/s^3 at s = 0.0000 m is 1.8 times max_lateral_jerk = 0.1 m/s^3" in result.reason
    assert result.worst_ratio == pytest.approx(1.8 ** (2.0 / 3.0))
    result = method.parameterize(bend, limits, SpeedZone(), start_speed=0.5)
    assert (result.status, result.limit) == (TimingStatus.START_INFEASIBLE, "max_lateral_jerk")
    assert result.at_s == pytest.approx(0.05, abs=0.02)
    slow = method.parameterize(bend, limits, SpeedZone(), start_speed=0.2)
    assert slow.status is TimingStatus.OK


@pytest.mark.parametrize(("seed", "wheel"), [(0, 0.107), (1, 0.107), (2, 0.02)])
def test_a_start_beyond_the_wheel_speed_on_a_winding_path_is_refused_at_once(seed, wheel, make):
    # No spline keeps the limits behind such a start; its iterations ended at a motion of weeks, sampled every 20 ms.
    limits = MotionLimits(
        max_speed=0.8562,
        max_acceleration=1.1285,
        max_deceleration=1.4352,
        max_jerk=0.8177,
        max_yaw_acceleration=0.5290519638904887,
        max_wheel_speed=wheel,
        track_width=0.8002328573265608,
    )
    knots = np.linspace(0.0, 5.0, 50)
    path = Path((make.spline(np.diff(knots), 0.6 * np.sin(knots + seed)),))
    NearOptimal().parameterize(path, limits, SpeedZone())  # imports
    tracemalloc.start()
    try:
        result = NearOptimal().parameterize(path, limits, SpeedZone(), start_speed=0.2842)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert (result.status, result.limit) == (TimingStatus.START_INFEASIBLE, "max_wheel_speed")
    assert peak < 100e6


@pytest.mark.parametrize("speed", [1e-3, 40.0])
def test_braking_for_days_needs_little_memory(speed, make):
    limits = MotionLimits(**{**LIMITS.__dict__, "max_deceleration": 6e-4, "max_speed": 50.0})
    path = Path((make.spline([300.0], [0.0, 0.0]),))
    tracemalloc.start()
    try:
        result = NearOptimal().parameterize(path, limits, SpeedZone(), start_speed=speed)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert result.status is (TimingStatus.CANNOT_STOP if speed == 40.0 else TimingStatus.OK)
    assert peak < 100e6


def test_samples_of_a_motion_of_a_year_are_bounded():
    motion = Motion.of(MotionState(0.0, 0.0, 0.0), [(1.0, 1e-3), (3e7, 0.0), (1.0, -1e-3)])
    times = motion.sample_times(0.008)
    assert times.size < 50_000
    assert set(motion.times) <= set(times)
    short = Motion.of(MotionState(), [(1.0, 1.0), (1.0, -1.0)]).sample_times(0.008)
    assert np.diff(short).max() <= 0.008 + 1e-12
