"""Acceleration limits on the commands."""

import math

from hypothesis import given
from hypothesis import strategies as st

from optdock.controllers.command_limits import rate_limited
from optdock.geometry.pose import Twist2
from optdock.limits import MotionLimits

LIMITS = MotionLimits(max_acceleration=0.5, max_deceleration=1.0, max_yaw_acceleration=2.0)
speeds = st.floats(-1.0, 1.0)


@given(speeds, speeds, st.floats(0.001, 0.5))
def test_speeding_up_and_slowing_down_have_their_own_bounds(before, wanted, period):
    after = rate_limited(Twist2(before), Twist2(wanted), LIMITS, period).linear
    low, high = min(before, wanted), max(before, wanted)
    assert low - 1e-12 <= after <= high + 1e-12
    faster = max(0.0, abs(after) - abs(before)) if before * after >= 0.0 else abs(after)
    slower = max(0.0, abs(before) - abs(after)) if before * after >= 0.0 else abs(before)
    assert faster / 0.5 + slower / 1.0 <= period + 1e-12


@given(speeds, speeds)
def test_enough_periods_reach_the_wanted_command(before, wanted):
    command = Twist2(before, before)
    for _ in range(400):
        command = rate_limited(command, Twist2(wanted, wanted), LIMITS, 0.02)
    assert math.isclose(command.linear, wanted, abs_tol=1e-12)
    assert math.isclose(command.angular, wanted, abs_tol=1e-12)


def test_reversing_takes_the_time_to_stop_and_the_time_to_start():
    command, count = Twist2(0.3), 0
    while command.linear > -0.3:
        command, count = rate_limited(command, Twist2(-0.3), LIMITS, 0.02), count + 1
    assert count == math.ceil((0.3 / 1.0 + 0.3 / 0.5) / 0.02 - 1e-9)


def test_the_yaw_rate_is_bounded_and_unlimited_means_unlimited():
    assert rate_limited(Twist2(), Twist2(0.0, 1.0), LIMITS, 0.1).angular == 0.2
    assert rate_limited(Twist2(0.0, -3.0), Twist2(0.0, 3.0), MotionLimits(), 0.1).angular == 3.0
