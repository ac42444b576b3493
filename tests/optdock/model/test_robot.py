"""Commands within the limits of a drive."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from optdock.geometry.pose import Twist2
from optdock.model.limits import MotionLimits
from optdock.model.robot import Drive, admissible

LIMITS = MotionLimits(
    max_speed=0.5,
    max_reverse_speed=0.3,
    max_yaw_rate=1.0,
    max_lateral_acceleration=0.3,
    max_wheel_speed=0.6,
    track_width=0.5,
    max_curvature=2.0,
)
commands = st.builds(Twist2, st.floats(-2.0, 2.0), st.floats(-4.0, 4.0))


@settings(max_examples=20)
@given(commands, st.sampled_from(Drive))
def test_an_admissible_command_keeps_every_limit(command, drive):
    found = admissible(command, LIMITS, drive)
    v, w = found.linear, found.angular
    assert -LIMITS.max_reverse_speed - 1e-12 <= v <= LIMITS.max_speed + 1e-12
    assert abs(w) <= 1.0 + 1e-12
    assert abs(v * w) <= 0.3 + 1e-12
    assert abs(v) + 0.25 * abs(w) <= 0.6 + 1e-12
    if drive is Drive.ACKERMANN:
        assert abs(w) <= 2.0 * abs(v) + 1e-12


@settings(max_examples=20)
@given(commands, st.sampled_from(Drive))
def test_an_admissible_command_stays_as_it_is(command, drive):
    once = admissible(command, LIMITS, drive)
    twice = admissible(once, LIMITS, drive)
    assert (twice.linear, twice.angular) == pytest.approx((once.linear, once.angular), rel=1e-12, abs=1e-15)


@settings(max_examples=20)
@given(commands)
def test_a_differential_drive_keeps_the_curvature(command):
    found = admissible(command, LIMITS)
    assert found.linear * command.angular == pytest.approx(found.angular * command.linear, abs=1e-12)
    assert found.linear * command.linear >= 0.0


def test_commands_within_the_limits_are_unchanged():
    assert admissible(Twist2(0.4, -7.0), MotionLimits()) == Twist2(0.4, -7.0)
    assert admissible(Twist2(0.4, 0.1, 0.2), MotionLimits()) == Twist2(0.4, 0.1)
    assert math.isfinite(admissible(Twist2(0.0, 3.0), LIMITS, Drive.ACKERMANN).angular)
