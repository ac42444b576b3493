"""The car, compared with closed forms: circles, constant steering rates, commands at rest."""

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
from optdock.simulation import Actuation, Bicycle, DifferentialDrive, Slip, Steering, plant_of

ORIGIN = Pose2(0.0, 0.0, 0.0)
BASE = 0.5


def car(rate=math.inf, actuation=None, **steering):
    limits = MotionLimits(
        max_speed=2.0, max_reverse_speed=2.0, wheelbase=BASE, max_steering_angle=0.6, max_steering_rate=rate
    )
    robot = Robot(Footprint.rectangle(0.6, 0.2, 0.5), limits, Drive.ACKERMANN)
    return Bicycle(robot, actuation or Actuation(), steering=Steering(**steering))


def command(v, angle):
    return Twist2(v, v * math.tan(angle) / BASE)


def drive(plant, commands, state=None, duration=0.02):
    state = state or plant.at_rest(ORIGIN)
    for one in commands:
        state = plant.step(state, one, duration)
    return state


@settings(max_examples=25)
@given(st.floats(-1.0, 1.0), st.floats(-0.59, 0.59), st.lists(st.floats(0.001, 0.2), min_size=1, max_size=10))
def test_constant_steering_angle_drives_an_exact_circle(v, angle, durations):
    state = car().at_rest(ORIGIN)
    for duration in durations:
        state = car().step(state, command(v, angle), duration)
    curvature, way = math.tan(angle) / BASE, v * sum(durations)
    assert state.pose.yaw == pytest.approx(curvature * way, abs=1e-12)
    assert state.pose.gap_to(ORIGIN.moved(Twist2(way, curvature * way), 1.0)) < 1e-9


@pytest.mark.parametrize("v", [0.5, -0.5])
@pytest.mark.parametrize("duration", [0.01, 0.05, 0.13])
def test_constant_steering_rate_drives_the_integrated_curve(v, duration):
    plant, rate, count = car(rate=0.3), 0.3, round(1.3 / duration)
    end = drive(plant, [command(v, 0.59)] * count, plant.moving(ORIGIN, Twist2(v)), duration)
    t = np.linspace(0.0, count * duration, 20001)
    yaw = -v / (BASE * rate) * np.log(np.cos(rate * t))  # the integral of v tan(rate t) / wheelbase
    assert end.drive[1] == pytest.approx(rate * count * duration, abs=1e-12)
    assert end.pose.yaw == pytest.approx(yaw[-1], abs=1e-10)
    expected = np.trapezoid(v * np.cos(yaw), t), np.trapezoid(v * np.sin(yaw), t)
    assert (end.pose.x, end.pose.y) == pytest.approx(expected, abs=2e-6)


@settings(max_examples=15)
@given(st.floats(0.02, 0.5), st.floats(0.1, 2.0), st.floats(-0.5, 0.5), st.floats(0.005, 0.1))
def test_steering_has_a_rate_limit_and_a_lag(lag, rate, wanted, duration):
    end, t, exact = drive(car(rate, lag=lag), [command(0.1, wanted)] * 8, duration=duration), 0.0, 0.0
    step = 8 * duration / 2000
    while t < 8 * duration - 0.5 * step:  # Euler's rule, 2000 steps
        exact += step * min(max((wanted - exact) / lag, -rate), rate)
        t += step
    assert end.drive[1] == pytest.approx(exact, abs=2e-3)


def test_speed_lags_and_latency_delays_both():
    actuation = Actuation(linear_lag=0.2, latency=0.05)
    late = drive(car(1.0, actuation), [command(0.5, 0.3)] * 20)
    prompt = drive(car(1.0, Actuation(linear_lag=0.2)), [command(0.5, 0.3)] * 35, duration=0.01)
    assert late.pose.gap_to(prompt.pose) < 1e-7
    assert late.drive == pytest.approx(prompt.drive, abs=1e-12)
    assert late.drive[0] == pytest.approx(0.5 * (1.0 - math.exp(-0.35 / 0.2)))


def test_the_angle_never_exceeds_its_limit():
    assert drive(car(), [Twist2(0.3, 5.0)] * 3).drive[1] == pytest.approx(0.6)
    assert drive(car(), [Twist2(-0.3, 5.0)] * 3).drive[1] == pytest.approx(-0.6)


class TestAtRest:
    @pytest.mark.parametrize(("word", "angle"), [("straighten", 0.0), ("hold", 0.3)])
    def test_steering_straightens_or_holds(self, word, angle):
        plant = car(at_rest=word)
        end = drive(plant, [command(0.3, 0.3), Twist2(), Twist2(0.0, 1.0)])
        assert end.twist == Twist2(0.0, 0.0)
        assert end.drive == pytest.approx((0.0, angle))

    @pytest.mark.parametrize("sign", [1.0, -1.0])
    def test_commands_within_the_dead_band_steer(self, sign):
        plant = car(0.5, Actuation(linear_dead_band=0.01))
        end = drive(plant, [command(sign * 0.001, 0.3)] * 50)
        assert end.drive == pytest.approx((0.0, 0.3))
        assert end.pose == ORIGIN


def test_play_of_the_steering():
    plant = car(1.0, play=0.02)
    end = drive(plant, [command(0.3, 0.2)] * 50)
    assert end.drive[1] == pytest.approx(0.18)
    assert drive(plant, [command(0.3, 0.165)] * 50, end).drive[1] == pytest.approx(0.18)
    assert drive(plant, [command(0.3, 0.1)] * 50, end).drive[1] == pytest.approx(0.12)


def test_encoders_do_not_show_gain_and_offset_of_the_steering():
    end = drive(car(gain=1.1, offset=0.05), [command(0.3, 0.2)] * 3)
    assert end.encoders.angular == pytest.approx(0.3 * math.tan(0.2) / BASE)
    assert end.twist.angular == pytest.approx(0.3 * math.tan(0.27) / BASE)


def test_slip_of_a_car():
    plant = Bicycle(car().robot, slip=Slip(lost=0.1, drift=0.05))
    end = plant.step(plant.at_rest(ORIGIN), Twist2(1.0), 0.5)
    assert (end.pose.x, end.pose.y) == pytest.approx((0.45, 0.025))


@settings(max_examples=25)
@given(st.floats(0.1, 1.0), st.floats(-0.5, 0.5))
def test_initial_motion_continues_until_a_command_arrives(v, angle):
    plant = car(0.5, Actuation(latency=0.1), gain=1.1, offset=0.02)
    twist = command(v, angle)
    end = plant.step(plant.moving(ORIGIN, twist), Twist2(), 0.1)
    assert end.pose.gap_to(ORIGIN.moved(twist, 0.1)) < 1e-9


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: Bicycle(Robot(Footprint.from_radius(0.3), MotionLimits())), "drive: must be ackermann for a car"),
        (lambda: Bicycle(Robot(Footprint.from_radius(0.3), MotionLimits(), Drive.ACKERMANN)), "wheelbase: must be > 0"),
        (lambda: car(actuation=Actuation(angular_lag=0.1)), "actuation.angular_lag: must be the default for a car"),
        (lambda: car(gain=0.0), "steering.gain"),
        (lambda: car(at_rest="spin"), "steering.at_rest: must be one of straighten, hold"),
        (lambda: DifferentialDrive(car().robot, period=-1.0), "plant.period"),
    ],
)
def test_invalid_values_are_errors(build, message):
    with pytest.raises(InvalidValue, match=message):
        build()


def test_plant_of_each_drive():
    late = Actuation(linear_lag=0.1, angular_lag=0.2, latency=0.06)
    robot = car(0.5).robot
    plant = plant_of(robot, late)
    assert isinstance(plant, Bicycle)
    assert (plant.robot, plant.steering, plant.actuation.angular_lag) == (robot, Steering(0.2), 0.0)
    assert (plant.actuation.linear_lag, plant.actuation.latency) == (0.1, 0.06)
    assert plant_of(robot, steering=Steering(play=0.01)).steering.play == 0.01
    wheels = Robot(Footprint.from_radius(0.3), MotionLimits())
    assert plant_of(wheels, late).actuation == late
    assert isinstance(plant_of(wheels), DifferentialDrive)
    for wrong in (lambda: plant_of(wheels, steering=Steering()), lambda: plant_of(robot, late, steering=Steering())):
        with pytest.raises(InvalidValue):
            wrong()


def test_car_without_a_wheelbase_follows_the_command():
    robot = Robot(Footprint.rectangle(0.6, 0.2, 0.5), MotionLimits(max_curvature=1.0), Drive.ACKERMANN)
    end = drive(plant_of(robot), [Twist2(0.4, 0.2)] * 50)
    expected = drive(DifferentialDrive(robot), [Twist2(0.4, 0.2)] * 50)
    assert end.pose.gap_to(expected.pose) < 1e-9
    assert drive(plant_of(robot), [Twist2(0.0, 0.5)] * 50).pose.gap_to(ORIGIN) < 1e-12  # a car does not turn at rest


@pytest.mark.parametrize("at_rest", ["hold", "straighten"])
def test_initial_steering_angle(at_rest):
    plant = car(0.5, start=0.4, at_rest=at_rest)
    state = plant.at_rest(ORIGIN)
    assert state.drive == pytest.approx((0.0, 0.4))
    after = plant.step(state, Twist2(), 0.2)
    assert after.drive[1] == pytest.approx(0.4 if at_rest == "hold" else 0.3)
