"""Measurements as broken drivers send them: no exception, no command beyond a limit, a name for what was not used."""

import math

import pytest

from optdock.executor import DockingExecutor
from optdock.geometry.pose import Pose2, Twist2
from optdock.measurements import Detection, Measurements
from tests.optdock.executor.conftest import BEFORE_DOCK, LIMITS, problem_with

SEEN = Detection(0.0, Pose2(0.0, 0.0, 0.0).in_frame_of(BEFORE_DOCK), 0.003, 0.005)


@pytest.mark.parametrize("sigma", [1e200, 1e3, math.inf, math.nan, -1.0])
@pytest.mark.parametrize("which", ["position_sigma", "yaw_sigma"])
def test_a_detection_that_says_nothing_is_not_used(which, sigma):
    executor = DockingExecutor(problem_with())
    executor.step(Measurements(0.0, BEFORE_DOCK))
    step = executor.step(Measurements(0.02, BEFORE_DOCK, detections=(SEEN._replace(**{which: sigma}),)))
    assert "detection not used" in [event.name for event in step.events]


@pytest.mark.parametrize("twist", [Twist2(5.0, 0.0), Twist2(0.0, -1000.0), Twist2(-1e6, 1e6)])
def test_the_first_command_keeps_the_limits_whatever_odometry_says(twist):
    command = DockingExecutor(problem_with()).step(Measurements(0.0, BEFORE_DOCK, twist)).command
    assert -LIMITS.max_reverse_speed <= command.linear <= LIMITS.max_speed
    assert abs(command.angular) <= LIMITS.max_yaw_rate


def test_a_clock_that_goes_back_by_years_and_stands_still_goes_on():
    executor = DockingExecutor(problem_with())
    stamps = [0.0, 0.02, 0.0401, -1999994.5197, -1999994.5197, -1999994.4797, -1999994.4797, -5e6, -5e6, -5e6 + 0.02]
    for _ in range(20):
        for stamp in stamps:
            executor.step(Measurements(stamp, BEFORE_DOCK))
        stamps = [stamp * 1.7 + 0.0130001 for stamp in stamps]
