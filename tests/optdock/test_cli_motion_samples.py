import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from optdock.cli.motion_samples import motion_faults
from optdock.dock import Dock
from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.interfaces import TimeParameterizer
from optdock.io.plan_file import TrajectoryColumns
from optdock.limits import MotionLimits, SpeedZone
from optdock.path import ClothoidSegment, Path
from optdock.plugins import create_plugin
from optdock.problem import DockingProblem
from optdock.robot import Robot
from optdock.verification import certify_trajectory

LIMITS = MotionLimits(
    max_yaw_rate=0.6, max_yaw_acceleration=1.2, max_lateral_acceleration=0.2, max_wheel_speed=0.5, track_width=0.4
)
ZONE = SpeedZone(0.1, 0.3)
TIMER = create_plugin(TimeParameterizer, "Windowed")


def two_gears(bend, first_length=1.2, second_length=1.0):
    first = ClothoidSpline(Pose2(1.0, -1.0, 0.7), np.array([0.0, first_length]), np.array([0.0, bend]))
    second = ClothoidSpline(first.end, np.array([0.0, second_length]), np.array([-bend, 0.0]), -1)
    return Path((ClothoidSegment(first), ClothoidSegment(second)))


def problem_of(path, limits=LIMITS):
    return DockingProblem(path.start, Dock(path.end, approach=ZONE), Robot(Footprint.from_radius(0.3), limits))


def motion_of(path, period=0.02):
    trajectory = TIMER.parameterize(path, LIMITS, ZONE).trajectory
    assert certify_trajectory(trajectory, LIMITS, ZONE).certified
    return TrajectoryColumns.from_trajectory(trajectory, period)


@settings(max_examples=25)
@given(st.floats(-1.5, 1.5), st.floats(0.3, 2.0), st.floats(0.4, 2.0), st.floats(0.005, 0.2))
def test_samples_of_a_certified_motion_refute_nothing(bend, first, second, period):
    path = two_gears(bend, first, second)
    assert motion_faults(motion_of(path, period), path, problem_of(path)) == []


def test_samples_too_far_apart_are_called_so_and_nothing_else():
    path = two_gears(0.5)
    (fault,) = motion_faults(motion_of(path, 3.0), path, problem_of(path))
    assert fault == "samples up to 3 s apart leave the motion between them open by 1.5 m; sample it finer"


@pytest.mark.parametrize(
    ("limit", "value", "fault"),
    [
        ("max_speed", 0.2, "speed [m/s]: "),
        ("max_reverse_speed", 0.05, "speed [m/s]: "),
        ("max_acceleration", 0.1, "acceleration [m/s^2]: "),
        ("max_deceleration", 0.1, "acceleration [m/s^2]: "),
        ("max_jerk", 1.0, "jerk [m/s^3]: 2 at "),
        ("max_yaw_rate", 0.05, "yaw rate [rad/s]: "),
        ("max_yaw_acceleration", 0.05, "yaw acceleration [rad/s^2]: "),
        ("max_lateral_acceleration", 0.01, "lateral acceleration [m/s^2]: "),
        ("max_wheel_speed", 0.1, "wheel speed [m/s]: "),
    ],
)
def test_every_limit_is_looked_at(limit, value, fault):
    path = two_gears(0.8)
    tighter = dataclasses.replace(LIMITS, **{limit: value})
    faults = motion_faults(motion_of(path), path, problem_of(path, tighter))
    assert any(message.startswith(fault) for message in faults)


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        ({"t": lambda v: 0.5 * v}, "mean acceleration [m/s^2]: "),
        ({"t": lambda v: 2.0 * v}, "distance off its speeds [m]: "),
        ({"acceleration": lambda v: np.where(np.arange(v.size) % 2, v, 0.0)}, "mean jerk [m/s^3]: "),
        ({"x": lambda v: v + 0.002}, "pose at t = "),
        ({"yaw": lambda v: v + 0.002}, "pose at t = "),
        ({name: lambda v: v[:-30] for name in TrajectoryColumns._fields}, "travelled: "),
        ({"speed": lambda v: np.where(np.arange(v.size) < v.size - 1, v, -0.01)}, "end: -0.01 m/s"),
        ({"speed": lambda v: np.where(np.arange(v.size) > 0, v, 0.01)}, "start speed: 0.01 m/s, the robot drives 0"),
        ({"speed": lambda v: v + 0.01}, "cusp at s = 1.200 m: 0.01 m/s"),
        ({"speed": lambda v: v - 0.05}, "approach speed [m/s]: 0.1"),
    ],
)
def test_every_lie_is_found(change, fault):
    path = two_gears(0.8)
    motion = motion_of(path)
    motion = motion._replace(**{name: alter(getattr(motion, name)) for name, alter in change.items()})
    faults = motion_faults(motion, path, problem_of(path))
    assert any(message.startswith(fault) for message in faults), faults
