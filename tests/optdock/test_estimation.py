"""The pose filter: exact odometry is followed exactly, noise shrinks, an outlier is left out, a jump is taken up."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from optdock.errors import InvalidValue
from optdock.estimation import PoseFilter
from optdock.geometry.pose import Pose2, Twist2

SIGMA = 0.002, math.radians(0.1)
periods = st.lists(st.floats(0.005, 0.2), min_size=5, max_size=30)


def drive(periods, twist=Twist2(0.2, 0.3), start=Pose2(1.0, -2.0, 3.0)):  # noqa: B008 - frozen
    """Stamps and true poses of a steady arc."""
    stamps = np.concatenate(([10.0], 10.0 + np.cumsum(periods))).tolist()
    return [(stamp, start.moved(twist, stamp - 10.0), twist) for stamp in stamps]


def noisy(pose, random):
    x, y, yaw = random.standard_normal(3) * (SIGMA[0], SIGMA[0], SIGMA[1])
    return Pose2(pose.x + x, pose.y + y, pose.yaw + yaw)


@given(periods)
def test_what_is_measured_exactly_is_believed_exactly_at_any_rate(periods):
    found = PoseFilter(*SIGMA)
    for stamp, pose, twist in drive(periods):
        assert found.update(stamp, pose, twist).gap_to(pose) < 1e-9


@given(periods)
def test_without_measurements_odometry_carries_on_and_the_doubt_grows(periods):
    found, before = PoseFilter(*SIGMA), 0.0
    for k, (stamp, pose, twist) in enumerate(drive(periods)):
        assert found.update(stamp, pose if k == 0 else None, twist).gap_to(pose) < 1e-9
        doubt = float(np.trace(found.covariance))
        assert doubt > before
        before = doubt


@pytest.mark.parametrize("period", [0.05, 0.02, 0.01])
def test_noise_shrinks_and_the_covariance_says_by_how_much(period):
    random, found, misses, promised = np.random.default_rng(1), PoseFilter(*SIGMA), [], []
    for stamp, pose, twist in drive([period] * round(20.0 / period)):
        estimate = found.update(stamp, noisy(pose, random), twist)
        misses.append((estimate.x - pose.x, estimate.y - pose.y, estimate.yaw - pose.yaw))
        promised.append(np.sqrt(np.diag(found.covariance)))
    spread, promised = np.std(misses[100:], axis=0), np.mean(promised[100:], axis=0)
    assert np.all(spread < 0.7 * np.array([SIGMA[0], SIGMA[0], SIGMA[1]]))
    assert np.all(spread < promised)


def test_heading_is_learnt_from_the_way_driven():
    found = PoseFilter(0.001, 0.1)
    for stamp, pose, twist in drive([0.02] * 200, Twist2(0.3)):
        wrong = Pose2(pose.x, pose.y, pose.yaw + (0.05 if stamp == 10.0 else 0.0))
        estimate = found.update(stamp, wrong, twist)
    assert abs(estimate.yaw - pose.yaw) < 0.005
    assert found.covariance[2, 2] < 0.01**2


@pytest.mark.parametrize("offset", [Pose2(0.3, 0.0, 0.0), Pose2(0.0, -0.3, 0.0), Pose2(0.0, 0.0, 0.4)])
def test_a_single_outlier_leaves_no_trace(offset):
    random, found = np.random.default_rng(2), PoseFilter(*SIGMA)
    without = PoseFilter(*SIGMA)
    for k, (stamp, pose, twist) in enumerate(drive([0.05] * 60)):
        measured = noisy(pose, random)
        found.update(stamp, measured @ offset if k == 30 else measured, twist)
        without.update(stamp, None if k == 30 else measured, twist)
        assert found.rejected == (k == 30)
        assert found.jump is None
    assert found.pose == without.pose


@pytest.mark.parametrize("size", [0.03, 0.05, 0.3])
def test_a_jump_that_stays_is_taken_up_within_a_few_cycles_and_reported_once(size):
    random, found, jumps = np.random.default_rng(3), PoseFilter(*SIGMA), []
    offset = Pose2(0.0, size, 0.0)
    for k, (stamp, pose, twist) in enumerate(drive([0.05] * 60)):
        true = pose if k < 30 else offset @ pose
        estimate = found.update(stamp, noisy(true, random), twist)
        if found.jump is not None:
            jumps.append((k, found.jump))
        if k >= 34:
            assert estimate.distance_to(true) < 0.006
    ((when, jump),) = jumps
    assert 30 < when <= 34
    assert math.hypot(jump.x, jump.y) == pytest.approx(size, abs=0.005)


def test_outliers_here_and_there_are_no_jump():
    random, found = np.random.default_rng(4), PoseFilter(*SIGMA)
    for k, (stamp, pose, twist) in enumerate(drive([0.02] * 100)):
        wild = pose @ Pose2(*(random.uniform(-1.0, 1.0, 3)))
        estimate = found.update(stamp, wild if k % 10 > 3 else noisy(pose, random), twist)
        assert found.jump is None
        assert estimate.distance_to(pose) < 0.006


@given(periods, st.floats(0.0, 1.0), st.floats(0.0, 0.3))
def test_the_past_second_and_what_comes_are_known_on_an_arc(periods, back, ahead):
    found = PoseFilter(*SIGMA)
    truth = drive(periods)
    for stamp, pose, twist in truth:
        found.update(stamp, pose, twist)
    start, last = truth[0][1], truth[-1][0]
    for stamp in (max(10.0, last - back), last + ahead):
        assert found.pose_at(stamp).gap_to(start.moved(truth[0][2], stamp - 10.0)) < 1e-8


def test_after_a_jump_the_past_stands_in_the_new_frame():
    found, offset = PoseFilter(*SIGMA), Pose2(0.2, 0.1, 0.3)
    for k, (stamp, pose, twist) in enumerate(drive([0.05] * 20)):
        found.update(stamp, pose if k < 10 else offset @ pose, twist)
    assert found.pose_at(10.2).gap_to(offset @ Pose2(1.0, -2.0, 3.0).moved(Twist2(0.2, 0.3), 0.2)) < 1e-8


def test_it_forgets_what_lies_more_than_a_second_back_and_says_so():
    found = PoseFilter(*SIGMA)
    for stamp, pose, twist in drive([0.05] * 60):
        found.update(stamp, pose, twist)
    found.pose_at(12.0)
    with pytest.raises(InvalidValue, match="remembered from"):
        found.pose_at(11.9)


def test_a_clock_that_goes_back_is_refused_and_one_that_stands_changes_nothing():
    found = PoseFilter(*SIGMA)
    found.update(5.0, Pose2(0.0, 0.0, 0.0), Twist2())
    assert found.update(5.0, Pose2(9.0, 0.0, 0.0), Twist2()) == Pose2(0.0, 0.0, 0.0)
    with pytest.raises(InvalidValue, match="clock went back, from 5.0 s to 4.9 s"):
        found.update(4.9, Pose2(0.0, 0.0, 0.0), Twist2())


def test_it_says_that_it_has_no_pose_and_which_sigma_is_wrong():
    with pytest.raises(InvalidValue, match="no pose yet"):
        PoseFilter(*SIGMA).update(0.0, None, Twist2())
    with pytest.raises(InvalidValue, match="yaw_sigma: must be >= 0"):
        PoseFilter(0.1, -0.1)
