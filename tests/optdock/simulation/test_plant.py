"""The plant against closed forms."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from optdock.errors import InvalidValue
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2, Twist2
from optdock.limits import MotionLimits
from optdock.robot import Drive, Robot
from optdock.simulation import Actuation, DifferentialDrive

ORIGIN = Pose2(0.0, 0.0, 0.0)
FAST = MotionLimits(max_speed=5.0, max_reverse_speed=5.0)
ROBOT = Robot(Footprint.from_radius(0.3), FAST)


def drive(plant, commands, pose=ORIGIN):
    state = plant.at_rest(pose)
    for command in commands:
        state = plant.step(state, command)
    return state


@given(st.floats(-2.0, 2.0), st.floats(-3.0, 3.0), st.lists(st.floats(0.001, 0.2), min_size=1, max_size=12))
def test_a_constant_command_drives_the_exact_arc_at_any_periods(v, w, durations):
    plant, state = DifferentialDrive(ROBOT), DifferentialDrive(ROBOT).at_rest(ORIGIN)
    for duration in durations:
        state = plant.step(state, Twist2(v, w), duration * 0.8 / sum(durations))
    end = state.pose
    assert end.yaw == pytest.approx(0.8 * w, abs=1e-12)
    if abs(w) > 1e-3:
        assert (end.x, end.y) == pytest.approx((v / w * math.sin(0.8 * w), v / w * (1 - math.cos(0.8 * w))), abs=1e-9)
    else:
        assert end.x == pytest.approx(0.8 * v, abs=1e-6)


@given(st.floats(-2.0, 2.0), st.floats(-1e-6, 1e-6))
def test_an_arc_is_continuous_where_it_becomes_straight(v, w):
    bent, straight = ORIGIN.moved(Twist2(v, w), 1.0), ORIGIN.moved(Twist2(v, 0.0), 1.0)
    assert bent.distance_to(straight) < 2e-6


@given(st.floats(0.01, 1.0), st.floats(0.001, 0.1))
def test_lag_follows_the_exponential_and_its_integral(lag, substep):
    plant = DifferentialDrive(ROBOT, Actuation(linear_lag=lag, angular_lag=0.3, longest_substep=substep))
    end = drive(plant, [Twist2(0.5, 0.0)] * 30)
    decay = math.exp(-0.6 / lag)
    assert end.twist.linear == pytest.approx(0.5 * (1.0 - decay), abs=1e-12)
    assert end.pose.x == pytest.approx(0.5 * (0.6 - lag * (1.0 - decay)), abs=1e-12)


def test_angular_lag_is_its_own():
    end = drive(DifferentialDrive(ROBOT, Actuation(linear_lag=0.1, angular_lag=0.5)), [Twist2(0.0, 1.0)] * 50)
    assert end.pose.yaw == pytest.approx(1.0 - 0.5 * (1.0 - math.exp(-2.0)), abs=1e-12)


def test_finer_substeps_converge_on_a_turn_with_lag():
    def end(substeps):
        actuation = Actuation(linear_lag=0.1, angular_lag=0.2, longest_substep=0.02 / substeps)
        return drive(DifferentialDrive(ROBOT, actuation), [Twist2(0.5, 1.5)] * 50).pose

    exact = end(256)
    errors = [end(n).distance_to(exact) for n in (1, 2, 4, 8)]
    assert errors[0] < 1e-4
    assert np.all(np.diff(errors) < 0.0)


@pytest.mark.parametrize("latency", [0.005, 0.02, 0.055])
def test_latency_shifts_the_motion_in_time(latency):
    commands = [Twist2(0.1 * k, 0.05 * k) for k in range(10)]
    late = DifferentialDrive(ROBOT, Actuation(latency=latency))
    prompt = DifferentialDrive(ROBOT, Actuation(), period=0.005)
    delayed = [Twist2()] * round(latency / 0.005) + [c for c in commands for _ in range(4)]
    expected = drive(prompt, delayed[:40]).pose
    assert drive(late, commands).pose.as_array() == pytest.approx(expected.as_array(), abs=1e-12)


def test_commands_below_the_dead_band_do_nothing():
    plant = DifferentialDrive(ROBOT, Actuation(linear_dead_band=0.02, angular_dead_band=0.1))
    assert drive(plant, [Twist2(0.019, 0.09)]).pose == ORIGIN
    moved = drive(plant, [Twist2(0.02, 0.1)]).pose
    assert moved.x > 0.0
    assert moved.yaw > 0.0


def test_gains_scale_what_becomes_of_a_command():
    plant = DifferentialDrive(ROBOT, Actuation(linear_gain=0.9, angular_gain=1.1))
    end = drive(plant, [Twist2(0.5, 1.0)] * 10)
    assert (end.twist.linear, end.twist.angular) == pytest.approx((0.45, 1.1))
    assert end.pose.yaw == pytest.approx(0.22)


def test_the_drive_limits_cut_the_command_and_keep_its_curvature():
    robot = Robot(ROBOT.footprint, MotionLimits(max_speed=0.5, max_reverse_speed=0.2))
    plant = DifferentialDrive(robot)
    assert drive(plant, [Twist2(1.0, 2.0)]).twist == Twist2(0.5, 1.0)
    assert drive(plant, [Twist2(-1.0, 2.0)]).twist == Twist2(-0.2, 0.4)


def test_an_ackermann_drive_cannot_turn_in_place():
    robot = Robot(ROBOT.footprint, MotionLimits(max_curvature=2.0), Drive.ACKERMANN)
    plant = DifferentialDrive(robot)
    assert drive(plant, [Twist2(0.0, 1.0)]).pose == ORIGIN
    assert drive(plant, [Twist2(0.1, 1.0)]).twist == Twist2(0.1, 0.2)


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: Actuation(linear_lag=-0.1), "linear_lag"),
        (lambda: Actuation(latency=math.inf), "latency"),
        (lambda: Actuation(latency=1e6), "latency: must be <= 10.0 s, got 1000000.0"),
        (lambda: Actuation(longest_substep=0), "longest_substep"),
        (lambda: DifferentialDrive(ROBOT, period=0.0), "period"),
        (lambda: DifferentialDrive(ROBOT).step(None, Twist2(), 0.0), "plant.duration: must be finite and > 0 s"),
    ],
)
def test_bad_values_are_refused(build, message):
    with pytest.raises(InvalidValue, match=message):
        build()
