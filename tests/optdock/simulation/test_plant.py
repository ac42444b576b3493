"""The plant, compared with closed forms."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from optdock.errors import InvalidValue
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2, Twist2
from optdock.model.limits import MotionLimits
from optdock.model.robot import Drive, Robot
from optdock.simulation import Actuation, DifferentialDrive, Slip, StuckWheel, Wheels

ORIGIN = Pose2(0.0, 0.0, 0.0)
FAST = MotionLimits(max_speed=5.0, max_reverse_speed=5.0)
ROBOT = Robot(Footprint.from_radius(0.3), FAST)


def drive(plant, commands, pose=ORIGIN):
    return drive_on(plant, plant.at_rest(pose), commands)


def drive_on(plant, state, commands):
    for command in commands:
        state = plant.step(state, command)
    return state


@settings(max_examples=25)
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


@settings(max_examples=25)
@given(st.floats(-2.0, 2.0), st.floats(-1e-6, 1e-6))
def test_an_arc_is_continuous_where_it_becomes_straight(v, w):
    bent, straight = ORIGIN.moved(Twist2(v, w), 1.0), ORIGIN.moved(Twist2(v, 0.0), 1.0)
    assert bent.distance_to(straight) < 2e-6


@settings(max_examples=25)
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


@settings(max_examples=25)
@given(st.floats(0.0, 0.15), st.lists(st.floats(0.002, 0.12), min_size=1, max_size=10), st.floats(0.0, 0.3))
def test_the_motion_is_independent_of_the_durations_of_the_steps(latency, durations, lag):
    plant = DifferentialDrive(ROBOT, Actuation(linear_lag=lag, latency=latency, longest_substep=0.001))
    whole = cut = plant.at_rest(ORIGIN)
    for k, duration in enumerate(durations):
        command = Twist2(0.1 * k, 0.5 - 0.1 * k)
        whole = plant.step(whole, command, duration)
        for share in (0.3, 0.5, 0.2):
            cut = plant.step(cut, command, share * duration)
    assert cut.pose.gap_to(whole.pose) < 1e-6  # the sub-steps of a lagging turn differ
    assert cut.drive == pytest.approx(whole.drive, abs=1e-9)


def test_a_late_tick_keeps_the_last_command_and_its_moment():
    plant = DifferentialDrive(ROBOT, Actuation(latency=0.05))
    state = plant.step(plant.at_rest(ORIGIN), Twist2(0.5), 0.02)
    state = plant.step(state, Twist2(1.0), 0.1)  # 0.5 m/s from 0.05 s on, 1 m/s from 0.07 s on
    assert state.pose.x == pytest.approx(0.5 * 0.02 + 1.0 * 0.05)


def test_commands_below_the_dead_band_have_no_effect():
    plant = DifferentialDrive(ROBOT, Actuation(linear_dead_band=0.02, angular_dead_band=0.1))
    assert drive(plant, [Twist2(0.019, 0.09)]).pose == ORIGIN
    moved = drive(plant, [Twist2(0.02, 0.1)]).pose
    assert moved.x > 0.0
    assert moved.yaw > 0.0


def test_gains_scale_the_velocity():
    plant = DifferentialDrive(ROBOT, Actuation(linear_gain=0.9, angular_gain=1.1))
    end = drive(plant, [Twist2(0.5, 1.0)] * 10)
    assert (end.twist.linear, end.twist.angular) == pytest.approx((0.45, 1.1))
    assert end.pose.yaw == pytest.approx(0.22)


class TestWheels:
    @settings(max_examples=25)
    @given(st.floats(-1.0, 1.0), st.floats(-2.0, 2.0))
    def test_perfect_wheels_follow_the_command(self, v, w):
        end = drive(DifferentialDrive(ROBOT, wheels=Wheels(0.4)), [Twist2(v, w)])
        assert (end.twist.linear, end.twist.angular) == pytest.approx((v, w), abs=1e-12)

    @settings(max_examples=25)
    @given(st.floats(0.8, 1.2), st.floats(0.8, 1.2), st.floats(-1.0, 1.0), st.floats(-2.0, 2.0))
    def test_encoders_do_not_show_wrong_radii(self, left, right, v, w):
        end = drive(DifferentialDrive(ROBOT, wheels=Wheels(0.4, left, right)), [Twist2(v, w)])
        rims = left * (v - 0.2 * w), right * (v + 0.2 * w)
        assert end.twist.linear == pytest.approx(sum(rims) / 2.0, abs=1e-12)
        assert end.twist.angular == pytest.approx((rims[1] - rims[0]) / 0.4, abs=1e-12)
        assert (end.encoders.linear, end.encoders.angular) == pytest.approx((v, w), abs=1e-12)

    def test_a_larger_left_wheel_makes_straight_on_a_right_hand_circle(self):
        end = drive(DifferentialDrive(ROBOT, wheels=Wheels(0.4, left_gain=1.02)), [Twist2(0.5)] * 50)
        assert end.pose.yaw == pytest.approx(-0.02 * 0.5 / 0.4)

    def test_each_wheel_has_its_own_dead_band(self):
        plant = DifferentialDrive(ROBOT, wheels=Wheels(0.4, left_dead_band=0.05, right_dead_band=0.05))
        end = drive(plant, [Twist2(0.04, 0.1)])  # left 0.02, right 0.06
        assert (end.twist.linear, end.twist.angular) == pytest.approx((0.03, 0.06 / 0.4))
        assert drive(plant, [Twist2(0.04)]).pose == ORIGIN

    def test_saturation_changes_the_curvature(self):
        end = drive(DifferentialDrive(ROBOT, wheels=Wheels(0.4, max_speed=0.5)), [Twist2(0.5, 1.0)])
        assert (end.twist.linear, end.twist.angular) == pytest.approx((0.4, 0.5))  # left 0.3, right 0.7 -> 0.5

    @pytest.mark.parametrize(("word", "side"), [("left", 1.0), ("right", -1.0)])
    def test_a_stuck_wheel_is_the_centre_of_a_circle_until_it_is_free(self, word, side):
        plant = DifferentialDrive(
            ROBOT, Actuation(linear_lag=0.05), wheels=Wheels(0.4, stuck=(StuckWheel(word, 0.5, 1.0),))
        )
        before = drive(plant, [Twist2(0.3)] * 25)
        assert before.pose.yaw == 0.0
        state = before
        for _ in range(24):
            state = plant.step(state, Twist2(0.3))
            assert state.encoders.linear - side * 0.2 * state.encoders.angular == pytest.approx(0.0, abs=1e-12)
        wheel = Pose2(0.0, side * 0.2, 0.0)
        assert (before.pose @ wheel).distance_to(state.pose @ wheel) < 1e-9
        assert side * state.pose.yaw > 0.3
        free = drive_on(plant, state, [Twist2(0.3)] * 2).twist
        assert (free.linear, free.angular) == pytest.approx((0.3, 0.0))


class TestSlip:
    def test_slip_reduces_the_velocity_and_encoders_do_not_show_it(self):
        plant = DifferentialDrive(ROBOT, slip=Slip(lost=0.1, drift=0.02, turn=0.05))
        end = plant.step(plant.at_rest(ORIGIN), Twist2(0.5, 0.4), 0.1)
        assert (end.twist.linear, end.twist.angular, end.twist.lateral) == pytest.approx((0.45, 0.36 + 0.025, 0.01))
        assert end.encoders == Twist2(0.5, 0.4)

    @pytest.mark.parametrize("duration", [0.01, 0.1])
    def test_the_noise_has_the_given_sigma_and_correlation_time(self, duration):
        slip = Slip(drift_sigma=0.05)
        plant, state, lateral = DifferentialDrive(ROBOT, slip=slip), None, []
        for _ in range(round((100.0 if duration < 0.1 else 400.0) / duration)):
            state = plant.step(state or plant.at_rest(ORIGIN), Twist2(1.0), duration)
            lateral.append(state.twist.lateral)
        found = np.array(lateral[50:])
        lag = round(0.2 / duration)
        assert np.std(found) == pytest.approx(0.05, rel=0.1)
        assert np.mean(found[lag:] * found[:-lag]) / np.var(found) == pytest.approx(math.exp(-2.0 / 3.0), abs=0.06)

    def test_a_step_is_a_function_of_its_state(self):
        plant = DifferentialDrive(ROBOT, slip=Slip(lost_sigma=0.1, turn_sigma=0.1, seed=5))
        state = drive(plant, [Twist2(0.5)] * 700)
        after = [plant.step(state, Twist2(0.5)) for _ in range(3)]
        again = DifferentialDrive(ROBOT, slip=Slip(lost_sigma=0.1, turn_sigma=0.1, seed=5))
        assert after[0] == after[1] == after[2] == again.step(state, Twist2(0.5))
        assert after[0] != DifferentialDrive(ROBOT, slip=Slip(lost_sigma=0.1, seed=6)).step(state, Twist2(0.5))


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
        (lambda: Wheels(0.0), "wheels.track_width: must be finite and > 0, got 0.0"),
        (lambda: Wheels(0.4, left_dead_band=-1.0), "wheels.left_dead_band"),
        (lambda: StuckWheel("front"), "stuck_wheel.wheel: must be one of left, right"),
        (lambda: StuckWheel("left", 2.0, 1.0), "stuck_wheel.end: must be > start, 2.0 s, got 1.0"),
        (lambda: Slip(lost=1.5), "slip.lost: must be a share from 0 to 1, got 1.5"),
        (lambda: Slip(seed=0.5), "slip.seed: must be a whole number >= 0, got 0.5"),
        (lambda: DifferentialDrive(ROBOT).step(None, Twist2(), 0.0), "plant.duration: must be finite and > 0 s"),
    ],
)
def test_invalid_values_are_errors(build, message):
    with pytest.raises(InvalidValue, match=message):
        build()
