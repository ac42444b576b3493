"""Limits on commands: acceleration, jerk, curvature, steering; no lag within the limits."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from optdock.controllers.command_limits import CommandLimiter, rate_limited
from optdock.geometry.pose import Pose2, Twist2
from optdock.model.limits import MotionLimits
from optdock.model.robot import Drive
from optdock.testing.drives import s_curve_drive

LIMITS = MotionLimits(max_acceleration=0.5, max_deceleration=1.0, max_yaw_acceleration=2.0)
speeds = st.floats(-1.0, 1.0)


@settings(max_examples=25)
@given(speeds, speeds, st.floats(0.001, 0.5))
def test_speeding_up_and_slowing_down_have_their_own_bounds(before, wanted, period):
    after = rate_limited(Twist2(before), Twist2(wanted), LIMITS, period).linear
    low, high = min(before, wanted), max(before, wanted)
    assert low - 1e-12 <= after <= high + 1e-12
    faster = max(0.0, abs(after) - abs(before)) if before * after >= 0.0 else abs(after)
    slower = max(0.0, abs(before) - abs(after)) if before * after >= 0.0 else abs(before)
    assert faster / 0.5 + slower / 1.0 <= period + 1e-12


@settings(max_examples=20)
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


SMOOTH = MotionLimits(
    max_speed=0.4, max_reverse_speed=0.3, max_acceleration=0.5, max_deceleration=0.6, max_jerk=2.0, max_curvature=2.0,
    max_yaw_rate=0.8, max_yaw_acceleration=3.0, track_width=0.4, max_wheel_speed=0.45,
)  # fmt: skip
REST = Twist2()


def followed(wanted, period, limits=SMOOTH, drive=Drive.DIFFERENTIAL, feed_forward=None, in_place=False):
    limiter, found = CommandLimiter(), []
    for k, twist in enumerate(wanted):
        ahead = feed_forward[k] if feed_forward else REST
        found.append(limiter.follow(twist, ahead, period, limits, drive, in_place=in_place))
    return found


def differences(commands, period):
    v = np.array([0.0, *(command.linear for command in commands)])
    acceleration = np.diff(v) / period
    return v, acceleration, np.diff(acceleration, prepend=0.0) / period


@settings(max_examples=20)
@given(
    st.lists(st.tuples(st.floats(-0.6, 0.6), st.floats(-2.0, 2.0)), min_size=1, max_size=6),
    st.sampled_from([0.005, 0.02, 0.05, 0.1]),
    st.integers(1, 20),
)
def test_commands_keep_the_limits(targets, period, held):
    wanted = [Twist2(*target) for target in targets for _ in range(held)]
    commands = followed(wanted, period)
    v, _, jerk = differences(commands, period)
    gained = np.diff(np.abs(v)) / period
    assert v.max() <= 0.4 + 1e-9
    assert v.min() >= -0.3 - 1e-9
    assert gained.max() <= 0.5 + 1e-9
    assert gained.min() >= -0.6 - 1e-9
    assert np.abs(jerk).max() <= 2.0 + 1e-6
    w = np.array([0.0, *(command.angular for command in commands)])
    assert np.abs(w).max() <= 0.8 + 1e-9
    assert np.all(np.abs(v) + 0.2 * np.abs(w) <= 0.45 + 1e-9)


SHARED = {
    "wheels": MotionLimits(
        max_speed=0.6, max_acceleration=0.9, max_jerk=3.8, max_yaw_rate=0.7, max_yaw_acceleration=1.2,
        max_wheel_speed=0.35, track_width=0.4,
    ),
    "lateral": MotionLimits(max_acceleration=0.6, max_jerk=1.0, max_yaw_acceleration=0.6, max_lateral_acceleration=0.1),
    "car": MotionLimits(
        max_acceleration=0.7, max_jerk=1.5, max_curvature=2.0, max_wheel_speed=0.36, track_width=0.4,
        max_lateral_acceleration=0.12, max_yaw_rate=0.5, wheelbase=0.4, max_steering_rate=0.45,
    ),
    "through rest": MotionLimits(max_acceleration=0.48, max_deceleration=0.726, max_jerk=2.46),
}  # fmt: skip


@settings(max_examples=20)
@given(
    st.sampled_from(sorted(SHARED)),
    st.lists(st.tuples(st.floats(-0.6, 0.6), st.floats(-1.5, 1.5)), min_size=1, max_size=6),
    st.lists(st.sampled_from([0.01, 0.02, 0.05, 0.1]), min_size=1, max_size=4),
    st.booleans(),
)
def test_commands_keep_limits_shared_by_speed_and_turn(name, targets, rates, moves):
    limits, drive = SHARED[name], Drive.ACKERMANN if name == "car" else Drive.DIFFERENTIAL
    limiter, commands, periods = CommandLimiter(), [REST], []
    limiter.follow(REST, REST, 0.1, limits, drive, in_place=False)
    for target in targets:
        for k in range(24):
            period, wanted = rates[k % len(rates)], Twist2(*target)
            commands.append(limiter.follow(wanted, wanted if moves else REST, period, limits, drive, in_place=False))
            periods.append(period)
    v, w = np.array([(command.linear, command.angular) for command in commands]).T
    h = np.array(periods)
    acceleration, between = np.diff(v) / h, 0.5 * (h[1:] + h[:-1])
    within = 1.0 + 1e-6
    assert np.all(np.abs(np.diff(acceleration)) <= limits.max_jerk * between * within)
    assert np.all(np.abs(np.diff(w)) <= limits.max_yaw_acceleration * h * within)
    assert np.all(np.abs(v) + 0.5 * limits.track_width * np.abs(w) <= limits.max_wheel_speed * within)
    assert np.all(np.abs(v * w) <= limits.max_lateral_acceleration * within)
    assert np.all(np.abs(w) <= limits.max_yaw_rate * within)
    assert np.all(np.abs(acceleration) <= max(limits.max_acceleration, limits.max_deceleration) * within)
    if drive is Drive.ACKERMANN:
        moving = np.minimum(np.abs(v[1:]), np.abs(v[:-1])) > 1e-3
        angle = np.arctan(limits.wheelbase * w / np.where(v == 0.0, 1.0, v))
        assert np.all(np.abs(np.diff(angle))[moving] <= (limits.max_steering_rate * h * within + 1e-9)[moving])


def lateral_jerks(commands, period, *, steered=False):
    """Changes of speed times yaw rate over the period; only increases while braking reduces it."""
    v, w = np.array([(command.linear, command.angular) for command in commands]).T
    brakes = (np.abs(v[1:]) < np.abs(v[:-1])) & (steered | (np.abs(w[1:]) >= np.abs(w[:-1]) * (1.0 - 1e-12)))
    return np.where(brakes, np.diff(np.abs(v * w)), np.abs(np.diff(v * w))) / period


@settings(max_examples=20)
@given(
    st.lists(st.tuples(st.floats(-0.6, 0.6), st.floats(-1.5, 1.5)), min_size=1, max_size=6),
    st.sampled_from([0.01, 0.02, 0.05]),
    st.sampled_from(Drive),
)
def test_the_turn_changes_the_lateral_acceleration_no_faster_than_its_jerk_allows(targets, period, drive):
    limits = MotionLimits(max_acceleration=0.6, max_jerk=1.5, max_curvature=4.0, wheelbase=0.4, max_lateral_jerk=0.1)
    wanted = [Twist2(*target) for target in targets for _ in range(30)]
    commands = followed(wanted, period, limits, drive)
    jerks = lateral_jerks([REST, *commands], period, steered=drive is Drive.ACKERMANN)
    assert jerks.max() <= 0.1 * (1.0 + 1e-6)


def test_braking_in_a_bend_does_not_increase_the_turn():
    limits = MotionLimits(max_curvature=4.0, max_lateral_jerk=0.02)
    commands = followed([Twist2(0.4, 0.4)] * 500 + [Twist2()] * 100, 0.02, limits)
    assert commands[499] == Twist2(0.4, 0.4)
    assert max(command.angular for command in commands[500:]) <= 0.4
    assert commands[-1] == Twist2()


@pytest.mark.parametrize("drive", Drive)
def test_lateral_jerk_limit_bounds_a_step_of_the_turn(drive):
    def largest(limits):
        wanted = [Twist2(0.3, 0.0)] * 100 + [Twist2(0.3, 0.4)] * 60
        return lateral_jerks(followed(wanted, 0.02, limits, drive), 0.02).max()

    free = MotionLimits(max_acceleration=0.6, max_jerk=1.5, max_curvature=4.0)
    assert largest(free) > 1.0
    assert largest(dataclasses.replace(free, max_lateral_jerk=0.1)) == pytest.approx(0.1, rel=1e-6)
    before, wanted = Twist2(0.3, 0.0), Twist2(0.3, 0.4)
    assert rate_limited(before, wanted, free, 0.02) == wanted
    eased = rate_limited(before, wanted, dataclasses.replace(free, max_lateral_jerk=0.1), 0.02)
    assert eased.angular == pytest.approx(0.1 * 0.02 / 0.3)


@pytest.mark.parametrize("period", [0.005, 0.02, 0.1])
@pytest.mark.parametrize("target", [0.3, -0.25, 1e-4])
def test_step_response_is_fast_without_overshoot(period, target):
    commands = followed([Twist2(target)] * round(3.0 / period), period)
    v, _, _ = differences(commands, period)
    assert np.abs(v).max() <= abs(target) + 1e-9
    assert v[-1] == pytest.approx(target, abs=1e-9)
    # Up to the largest acceleration and down again, or a triangle where the step is too small for that.
    peak = min(0.5, math.sqrt(2.0 * abs(target)))
    soonest = abs(target) / peak + peak / 2.0
    arrived = period * int(np.argmax(np.abs(v) >= abs(target) - 1e-6))
    assert arrived <= soonest + 5.0 * period


@pytest.mark.parametrize("period", [0.005, 0.02, 0.05])
def test_a_feed_forward_within_the_limits_passes_untouched(period):
    trajectory = s_curve_drive(Pose2(0.0, 0.0, 0.0))
    times = np.arange(0.0, trajectory.duration, period) - period
    row = trajectory.sample_at(times)
    wanted = [Twist2(*pair) for pair in zip(row.speed.tolist(), row.yaw_rate.tolist(), strict=True)]
    v, a = np.abs(row.speed), trajectory.time_law.at(row.t)[:, 2]
    bend, rate = trajectory.path.curvature_at(row.s), trajectory.path.curvature_rate_at(row.s)
    limits = MotionLimits(
        max_speed=0.4, max_acceleration=0.4, max_deceleration=0.4, max_jerk=2.0, max_curvature=1.2,
        max_lateral_jerk=1.001 * float(np.max(np.abs(2.0 * v * a * bend + v**3 * rate))),
    )  # fmt: skip
    found = followed(wanted, period, limits, feed_forward=wanted)
    assert max(abs(a.linear - b.linear) for a, b in zip(found, wanted, strict=True)) < 1e-9
    assert max(abs(a.angular - b.angular) for a, b in zip(found, wanted, strict=True)) < 1e-6


def test_smallest_radius_is_kept_except_in_place():
    wanted = [Twist2(0.2, 0.7)] * 100
    driven = followed(wanted, 0.02)
    assert all(abs(c.angular) <= 2.0 * abs(c.linear) + 1e-12 for c in driven)
    assert followed([Twist2(0.0, 0.5)] * 50, 0.02)[-1].angular == 0.0
    assert followed([Twist2(0.0, 0.5)] * 50, 0.02, in_place=True)[-1].angular == pytest.approx(0.5)


def test_steered_wheels_turn_no_faster_than_they_can():
    limits = MotionLimits(wheelbase=0.5, max_steering_angle=0.6, max_steering_rate=0.5)
    wanted = [Twist2(0.3, 0.0)] * 60 + [Twist2(0.3, 0.4)] * 100 + [Twist2(0.3, -0.4)] * 200
    commands = followed(wanted, 0.02, limits, Drive.ACKERMANN)
    angles = np.arctan([0.5 * c.angular / c.linear for c in commands[5:]])
    assert np.abs(np.diff(angles)).max() <= 0.5 * 0.02 + 1e-9
    assert angles.min() == pytest.approx(-0.6, abs=0.02)


def test_stopping_ends_with_exactly_zero_commands():
    periods = np.diff(100.0 + 0.02 * np.arange(91)).tolist()
    for speed in np.linspace(0.01, 0.5, 15).tolist():
        limiter = CommandLimiter()
        limiter.restart(Twist2(speed, 0.1))
        commands = [
            limiter.follow(Twist2(), Twist2(), period, MotionLimits(), Drive.DIFFERENTIAL, in_place=True)
            for period in periods
        ]
        standing = next(k for k, command in enumerate(commands) if abs(command.linear) < 1e-6)
        assert all(command == Twist2() for command in commands[standing + 1 :])
