"""The tracking law: Lyapunov function, symmetries, decay of errors, delay bounds."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from optdock.controllers.tracking_law import Gains, delay_bounds, tracking_command
from optdock.geometry.pose import Pose2, Twist2

GAINS = Gains(along=2.0, convergence_distance=0.25, damping=1.0, turn=1.0)
errors = st.builds(Pose2, st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.floats(-3.0, 3.0))
references = st.builds(Twist2, st.floats(-0.5, 0.5), st.floats(-1.0, 1.0))


def error_rates(error, reference, command):
    """Kinematics of the reference seen from the moving robot."""
    v, w = command.linear, command.angular
    return (
        w * error.y - v + reference.linear * math.cos(error.yaw),
        -w * error.x + reference.linear * math.sin(error.yaw),
        reference.angular - w,
    )


@settings(max_examples=25)
@given(errors, references)
def test_the_lyapunov_function_never_grows_in_either_gear(error, reference):
    command = tracking_command(error, reference, GAINS)
    dx, dy, dyaw = error_rates(error, reference, command)
    lateral = 1.0 / GAINS.convergence_distance**2
    rate = lateral * (error.x * dx + error.y * dy) + error.yaw * dyaw
    heading = max(GAINS.turn, 2.0 * abs(reference.linear) / GAINS.convergence_distance)
    assert rate == pytest.approx(-lateral * GAINS.along * error.x**2 - heading * error.yaw**2, abs=1e-9)


@settings(max_examples=25)
@given(errors, references)
def test_mirroring_the_error_mirrors_the_command(error, reference):
    there = tracking_command(error, reference, GAINS)
    mirrored = Pose2(error.x, -error.y, -error.yaw), Twist2(reference.linear, -reference.angular)
    back = tracking_command(*mirrored, GAINS)
    assert (back.linear, back.angular) == pytest.approx((there.linear, -there.angular))


@settings(max_examples=25)
@given(errors, references)
def test_reverse_is_forward_seen_from_behind(error, reference):
    there = tracking_command(error, reference, GAINS)
    turned = Pose2(-error.x, -error.y, error.yaw), Twist2(-reference.linear, reference.angular)
    back = tracking_command(*turned, GAINS)
    assert (back.linear, back.angular) == pytest.approx((-there.linear, there.angular))


@given(references)
def test_without_an_error_the_command_is_the_feed_forward(reference):
    assert tracking_command(Pose2(0.0, 0.0, 0.0), reference, GAINS) == reference


def lateral_profile(speed):
    """Lateral error at every centimetre of a straight line driven at `speed`, from an offset of 5 cm."""
    gains = GAINS._replace(turn=1e-6)
    step = 0.001 / abs(speed)
    y, yaw, found = 0.05, 0.0, []
    for k in range(1500):
        if k % 10 == 0:
            found.append(y)
        error = Pose2(0.0, y, yaw)
        command = tracking_command(error, Twist2(speed), gains)
        _, dy, dyaw = error_rates(error, Twist2(speed), command)
        y, yaw = y + step * dy, yaw + step * dyaw
    return np.array(found)


@pytest.mark.parametrize("speed", [0.1, 0.5, -0.1, -0.5])
def test_lateral_error_decays_over_a_distance_at_every_speed(speed):
    profile = lateral_profile(speed)
    distance = 0.01 * np.arange(profile.size) / GAINS.convergence_distance
    critically_damped = 0.05 * (1.0 + distance) * np.exp(-distance)
    assert np.allclose(profile, critically_damped, atol=5e-4)


def test_the_law_is_smooth_where_the_sine_quotient_changes_form():
    near, far = (tracking_command(Pose2(0.0, 0.1, angle), Twist2(0.5), GAINS).angular for angle in (0.999e-6, 1.001e-6))
    assert near == pytest.approx(far, abs=1e-7)


def phase_margin(open_loop, delay=0.0):
    """Of an open loop that falls with the frequency, at the last one where its gain is 1 [rad]."""
    frequency = np.geomspace(1e-3, 1e3, 40_001)
    at = 1j * frequency
    response = open_loop(at) * np.exp(-delay * at)
    crossover = np.flatnonzero(np.abs(response) >= 1.0)[-1]
    return math.pi + np.unwrap(np.angle(response))[crossover] - 2.0 * math.pi * (np.angle(response[0]) > 0.0)


@pytest.mark.parametrize("damping", [0.5, 1.0, 2.0])
@pytest.mark.parametrize(("speed", "delay"), [(0.1, 0.3), (-0.5, 0.1), (1.0, 0.25)])
def test_a_delay_takes_no_more_than_two_fifths_of_the_phase_margin(damping, speed, delay):
    bounds = delay_bounds(speed, delay, damping)
    a = abs(speed) / bounds.distance

    def across(s):
        return (2.0 * damping * a * s + a * a) / s**2

    assert phase_margin(across, delay) == pytest.approx(0.6 * phase_margin(across), abs=1e-3)
    assert phase_margin(lambda s: bounds.rate / s, delay) == pytest.approx(0.6 * 0.5 * math.pi, abs=1e-3)
    # A lag takes less than a latency of its length.
    assert phase_margin(lambda s: across(s) / (1.0 + delay * s)) > 0.6 * phase_margin(across)


def test_without_a_delay_nothing_is_bounded():
    assert delay_bounds(0.5, 0.0, 1.0) == (math.inf, 0.0)


def swing(speed, delay, distance):
    """The largest lateral error in the last of twenty metres from a start 1 cm off a line [m]."""
    gains, step = GAINS._replace(convergence_distance=distance, turn=1e-6), 0.004
    y, yaw, told, found = 0.01, 0.0, [0.0] * round(delay / step), []
    for _ in range(round(20.0 / (abs(speed) * step))):
        told.append(tracking_command(Pose2(0.0, y, yaw), Twist2(speed), gains).angular)
        y, yaw = y + step * speed * math.sin(yaw), yaw - step * told[-1 - round(delay / step)]
        yaw = min(max(yaw, -0.5), 0.5)
        found.append(abs(y))
    return max(found[-round(1.0 / (abs(speed) * step)) :])


@pytest.mark.parametrize("speed", [0.5, -1.0])
def test_late_drive_settles_at_the_bound_and_not_well_below(speed):
    delay = 0.2
    distance = delay_bounds(speed, delay, GAINS.damping).distance
    assert swing(speed, delay, distance) < 1e-6
    assert swing(speed, delay, 0.35 * distance) > 0.01
