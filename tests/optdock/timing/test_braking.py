from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from optdock.limits import MotionLimits, SpeedZone
from optdock.path import Direction, Path
from optdock.timing.braking import Braking
from optdock.timing.course import Slowness, course_of
from optdock.timing.gears import courses_of
from optdock.timing.motion import Motion, State, braking_slack

LIMITS = MotionLimits(max_speed=1.0, max_acceleration=0.4, max_deceleration=0.5, max_jerk=1.5)


@pytest.fixture(scope="module")
def course(make):
    return course_of(make.spline([3.0], [0.0, 0.0]), Slowness(LIMITS, Direction.FORWARD), 9.0, 9.0)


@given(
    v=st.floats(0.2, 0.8),
    a=st.floats(-0.3, 0.4),
    jerks=st.lists(st.tuples(st.floats(0.05, 0.5), st.floats(-1.5, 1.5)), min_size=1, max_size=8),
)
def test_no_control_is_slower_anywhere_than_full_braking(course, v, a, jerks):
    # da/ds = j / v: with the least jerk from the same state nothing gets below, as long as a >= -D.
    start = State(0.0, v, a)
    if braking_slack(start, LIMITS.max_jerk) <= 0.01:
        return
    brake, other = Braking(course, start).motion, Motion.of(start, jerks)
    t = np.linspace(0.0, other.duration, 200)
    s, speed, acceleration = other.at(t)
    legal = np.cumsum((speed < 0.0) | (acceleration < -LIMITS.max_deceleration)) == 0
    settling = brake.times[-2]  # the last phase leads the deceleration back to zero
    inside = legal & (s < brake.at(np.array([settling]))[0, 0])
    if not inside.any():
        return
    slowest = brake.at(brake.crossing_times(s[inside]))[1]
    assert np.all(speed[inside] >= slowest - 1e-6)


def test_ratios_are_one_exactly_at_the_caps(make):
    limits = MotionLimits(max_yaw_rate=0.5, max_deceleration=0.6, max_jerk=2.0)
    segment = make.spline([0.2, 1.0], [1.0, 1.0, 1.0])
    course = courses_of(Path((segment,)), limits, SpeedZone())[0]
    assert Braking(course, State(0.0, 0.5)).path_ratios.max() == pytest.approx(1.0)
    assert Braking(course, State(0.0, 0.45)).path_ratios.max() == pytest.approx(0.9)


def test_the_yaw_cap_is_the_speed_no_acceleration_can_save(make):
    # v^2 k' - D k <= al while braking with D.
    limits = MotionLimits(max_speed=2.0, max_yaw_acceleration=0.5, max_deceleration=0.5, max_jerk=100.0)
    course = courses_of(Path((make.spline([0.2, 2.0], [0.0, 0.4, 0.4]),)), limits, SpeedZone())[0]
    braking = Braking(course, State(0.0, 0.7))
    s, v, _a = braking.states
    rising = (s > 0.0) & (s < 0.2 - 1e-9)
    fastest = np.sqrt((0.5 + 2.0 * s[rising] * 0.5) / 2.0)
    np.testing.assert_allclose(braking.path_ratios[rising], np.maximum(v[rising] / fastest, v[rising] / 2.0))


def test_tight_length_ends_where_braking_leaves_room(make):
    limits = MotionLimits(max_yaw_rate=0.5, max_deceleration=0.6, max_jerk=2.0)
    course = courses_of(Path((make.spline([3.0], [1.0, 1.0]),)), limits, SpeedZone())[0]
    assert Braking(course, State(0.0, 0.3)).tight_length(0.01) == 0.0
    length = Braking(course, State(0.0, 0.5)).tight_length(0.01)
    assert 0.0 < length < 0.1
    assert Braking(course, State(0.0, 0.5)).tight_length(0.1) > length
