from __future__ import annotations

import math

import numpy as np
import pytest

from optdock.limits import MotionLimits, SpeedZone
from optdock.path import Direction
from optdock.timing.check import worst_ratio
from optdock.timing.course import Slowness, course_of
from optdock.timing.gears import courses_of
from optdock.timing.motion import Motion, State
from optdock.timing.moves import Box, move
from optdock.trajectory import TimeLaw, Trajectory
from optdock.verification import certify_trajectory


def _driven(course, box):
    return Motion.of(State(), move(State(), State(course.length), box))


def test_a_spike_between_two_time_samples_is_found(make):
    # 2 mm wide, passed in 4 ms at 0.5 m/s: half a period of the check.
    limits = MotionLimits(max_yaw_rate=0.5)
    segment = make.spline([1.0, 0.001, 0.001, 1.0], [0.0, 0.0, 2.0, 0.0, 0.0])
    course = course_of(segment, Slowness(limits, Direction.FORWARD), math.inf, math.inf)
    worst = worst_ratio(course, _driven(course, Box(0.5, 0.5, 0.6, 2.0)))
    assert worst.ratio == pytest.approx(2.0, rel=1e-3)
    assert worst.s == pytest.approx(1.001, abs=1e-9)


@pytest.mark.parametrize("order", [1, -1])
def test_both_rates_at_a_jump_count(make, order):
    limits = MotionLimits(max_yaw_acceleration=1.0)
    curvature = np.array([0.0, 0.0, 1.0])[::order]
    course = course_of(make.spline([1.0, 1.0], curvature), Slowness(limits, Direction.FORWARD), math.inf, math.inf)
    worst = worst_ratio(course, _driven(course, Box(0.5, 0.5, 0.6, 2.0)))
    assert worst.ratio >= 0.25 - 1e-9  # v^2 k' on the steep side of the jump


@pytest.mark.parametrize("seed", range(6))
def test_agrees_with_the_independent_certificate(make, all_limits, seed):
    path, zone = make.random_path(np.random.default_rng(seed), length=2.0), SpeedZone(0.2, 0.3)
    course = courses_of(path, all_limits, zone)[0]
    motion = _driven(course, Box(0.3, 0.4, 0.5, 1.2))
    trajectory = Trajectory(path, TimeLaw(motion.durations, motion.jerks))
    proven = max(certify_trajectory(trajectory, all_limits, zone).ratios.values())
    worst = worst_ratio(course, motion, np.linspace(0.0, motion.duration, 20001))
    squared = max(worst.ratio, worst.path**2)  # the certificate does not take the root of the lateral acceleration
    assert worst.ratio * (1.0 - 1e-5) <= proven <= squared * (1.0 + 1e-4)


def test_stretching_by_what_the_check_says_cures_every_limit(make, all_limits):
    from optdock.timing.motion import stretched

    path = make.random_path(np.random.default_rng(2), length=2.0)
    course = courses_of(path, all_limits, SpeedZone())[0]
    motion = _driven(course, Box(0.6, 0.8, 0.9, 3.0))
    worst = worst_ratio(course, motion)
    assert worst.ratio > 1.2
    cured = worst_ratio(course, Motion.of(State(), stretched(motion.phases, worst.stretch)))
    assert cured.ratio <= 1.0 + 1e-3
    barely = worst_ratio(course, Motion.of(State(), stretched(motion.phases, worst.stretch * 0.98)))
    assert barely.ratio > 1.0
