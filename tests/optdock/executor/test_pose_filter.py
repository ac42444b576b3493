"""Dead reckoning and the pose filter: closed forms, odometry errors, late and wrong measurements."""

import itertools
import math
import shutil

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from experiments.fuzz.kinds.kernels import replaced
from optdock.errors import InvalidValue
from optdock.executor import pose_filter
from optdock.executor.pose_filter import DeadReckoning, OdometryErrors, PoseFilter, corrected, grown
from optdock.geometry.pose import Pose2, Twist2
from optdock.kernels import using_kernels
from optdock.model.measurements import OdometryPose

needs_compiler = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
LANES = ["twin", pytest.param("native", marks=needs_compiler)]
SIGMA = 0.002, math.radians(0.1)
NOISE = np.diag([SIGMA[0] ** 2, SIGMA[0] ** 2, SIGMA[1] ** 2])
START = Pose2(1.0, -2.0, 3.0)
BENT = Twist2(0.2, 0.3)
EXACT = OdometryErrors(0.0, 0.0, 0.0, 0.0, 0.0)
periods = st.lists(st.floats(0.005, 0.2), min_size=5, max_size=30)


def stamps_of(periods):
    return np.concatenate(([10.0], 10.0 + np.cumsum(periods))).tolist()


def drive(periods, twist=BENT, start=START):
    """Stamps, true poses and ways of a steady arc."""
    stamps = stamps_of(periods)
    poses = [start.moved(twist, stamp - 10.0) for stamp in stamps]
    steps = [Pose2(0.0, 0.0, 0.0), *(b.in_frame_of(a) for a, b in itertools.pairwise(poses))]
    return list(zip(stamps, poses, steps, strict=True))


def noisy(pose, random):
    x, y, yaw = random.standard_normal(3) * (SIGMA[0], SIGMA[0], SIGMA[1])
    return Pose2(pose.x + x, pose.y + y, pose.yaw + yaw)


def started(errors=None, pose=START, covariance=NOISE, **kwargs):
    found = PoseFilter(errors or OdometryErrors(), **kwargs)
    found.start(10.0, pose, covariance)
    return found


# Dead reckoning.


@settings(max_examples=25)
@given(periods, st.floats(-1.0, 1.0), st.floats(-1.0, 1.0))
def test_twists_of_a_steady_arc_are_integrated_exactly(periods, linear, angular):
    twist = Twist2(linear, angular)
    reckoning = DeadReckoning(10.0, twist)
    for stamp in stamps_of(periods)[1:]:
        reckoning.advance(stamp, twist)
        assert reckoning.pose.gap_to(Pose2(0.0, 0.0, 0.0).moved(twist, stamp - 10.0)) < 1e-9


@settings(max_examples=25)
@given(periods, st.floats(0.0, 0.1))
def test_increments_of_odometry_poses_are_used_with_any_twist(periods, age):
    """The twist errs; it is integrated from the newest pose until now."""
    frame, lazy = Pose2(-7.0, 3.0, 2.0), Twist2(0.5 * BENT.linear, BENT.angular)
    told = [OdometryPose(stamp - age, frame.moved(BENT, stamp - age - 10.0)) for stamp in stamps_of(periods)]
    reckoning = DeadReckoning(10.0, lazy, told[0])
    for odometry in told[1:]:
        reckoning.advance(odometry.stamp + age, lazy, odometry)
        true = Pose2(0.0, 0.0, 0.0).moved(BENT, odometry.stamp + age - 10.0)
        assert reckoning.pose.distance_to(true) <= 2.0 * age * 0.5 * BENT.linear + 1e-9


def test_steps_add_up_to_the_pose_with_repeated_stamps():
    reckoning, total = DeadReckoning(10.0, BENT, OdometryPose(10.0, START)), Pose2(0.0, 0.0, 0.0)
    for k in range(1, 40):
        stamp = 10.0 + 0.03 * (k // 2)  # every second reading comes again
        odometry = OdometryPose(stamp - 0.01, START.moved(BENT, stamp - 10.01))
        step = reckoning.advance(stamp, BENT, odometry)
        total = total @ step
        assert total.gap_to(reckoning.pose) < 1e-12
        if k % 2 and k > 1:
            assert step.gap_to(Pose2(0.0, 0.0, 0.0)) < 1e-12
    assert reckoning.restarts == 0


def test_restart_of_the_odometry_has_no_effect():
    reckoning = DeadReckoning(10.0, BENT, OdometryPose(10.0, START))
    for k in range(1, 30):
        stamp = 10.0 + 0.02 * k
        frame, since = (START, 10.0) if k < 15 else (Pose2(0.0, 0.0, 0.0), 10.3)
        reckoning.advance(stamp, BENT, OdometryPose(stamp, frame.moved(BENT, stamp - since)))
    assert reckoning.pose.gap_to(Pose2(0.0, 0.0, 0.0).moved(BENT, 0.58)) < 1e-9
    assert reckoning.restarts == 1


def test_constant_odometry_pose_with_a_twist_is_ignored():
    reckoning = DeadReckoning(10.0, BENT, OdometryPose(10.0, Pose2(0.0, 0.0, 0.0)))
    for k in range(1, 200):
        stamp = 10.0 + 0.02 * k
        reckoning.advance(stamp, BENT, OdometryPose(stamp, Pose2(0.0, 0.0, 0.0)))
    assert reckoning.pose.gap_to(Pose2(0.0, 0.0, 0.0).moved(BENT, 3.98)) < 1e-6


@pytest.mark.parametrize("stamp", [math.nan, math.inf, 99.0])
def test_invalid_odometry_stamp_is_ignored(stamp):
    reckoning = DeadReckoning(10.0, BENT, OdometryPose(10.0, START))
    reckoning.advance(10.1, BENT, OdometryPose(stamp, START))
    assert reckoning.pose.gap_to(Pose2(0.0, 0.0, 0.0).moved(BENT, 0.1)) < 1e-12


# The filter.


@settings(max_examples=25)
@given(periods)
def test_exact_measurements_give_exact_estimates_at_any_rate(periods):
    found = started()
    for stamp, pose, step in drive(periods)[1:]:
        found.predict(stamp, step)
        assert found.correct(stamp, pose, NOISE) == "accepted"
        assert found.pose.gap_to(pose) < 1e-9


@settings(max_examples=25)
@given(periods)
def test_covariance_grows_without_measurements(periods):
    found = started()
    before = float(np.trace(found.covariance))
    for stamp, pose, step in drive(periods)[1:]:
        assert found.predict(stamp, step).gap_to(pose) < 1e-9
        doubt = float(np.trace(found.covariance))
        assert doubt > before
        before = doubt


@pytest.mark.parametrize("period", [0.05, 0.02, 0.01])
def test_covariance_bounds_the_filtered_noise(period):
    random, found, misses, promised = np.random.default_rng(1), started(), [], []
    for stamp, pose, step in drive([period] * round(12.0 / period))[1:]:
        found.predict(stamp, step)
        found.correct(stamp, noisy(pose, random), NOISE)
        misses.append(found.pose.as_array() - pose.as_array())
        promised.append(np.sqrt(np.diag(found.covariance)[:3]))
    spread, promised = np.std(misses[100:], axis=0), np.mean(promised[100:], axis=0)
    assert np.all(spread < 0.7 * np.sqrt(np.diag(NOISE)))
    assert np.all(spread < promised)


def test_measurements_of_a_resting_robot_are_averaged():
    """n of them leave sigma / sqrt(n)."""
    random, found = np.random.default_rng(1), started(EXACT, covariance=np.eye(3))
    offsets = random.standard_normal((40, 3)) * np.sqrt(np.diag(NOISE))
    for offset in offsets:
        found.correct(10.0, Pose2.from_sequence(START.as_array() + offset), NOISE)
    assert np.allclose(np.sqrt(np.diag(found.covariance)[:3]), np.sqrt(np.diag(NOISE) / 40.0), rtol=0.01)
    assert np.allclose(found.pose.as_array(), START.as_array() + offsets.mean(axis=0), atol=1e-5)


def test_heading_is_estimated_from_motion():
    vague = np.diag([1e-6, 1e-6, 0.01])
    found = started(pose=Pose2(START.x, START.y, START.yaw + 0.05), covariance=vague)
    for stamp, pose, step in drive([0.02] * 200, Twist2(0.3))[1:]:
        found.predict(stamp, step)
        found.correct(stamp, Pose2(pose.x, pose.y, pose.yaw), vague)
    assert abs(found.pose.yaw - pose.yaw) < 0.005
    assert found.covariance[2, 2] < 0.01**2


@pytest.mark.parametrize("late", [0.0, 0.05, 0.3])
def test_late_measurement_corrects_the_past_pose(late):
    found, at = started(covariance=np.diag([0.01, 0.01, 0.01])), Twist2(0.2, 0.3)
    for stamp, pose, step in drive([0.02] * 50)[1:]:  # noqa: B007 - the last one is looked at
        found.predict(stamp, step)
        if stamp - late > 10.0:
            found.correct(stamp - late, START.moved(at, stamp - late - 10.0), NOISE)
            assert found.pose_at(stamp - late).gap_to(START.moved(at, stamp - late - 10.0)) < 1e-9
    assert found.pose.gap_to(pose) < 1e-9
    assert found.correct(9.9, START, NOISE) == "forgotten"
    assert found.correct(stamp + 1.0, START, NOISE) == "forgotten"
    assert found.correct(math.nan, START, NOISE) == "forgotten"


LEARNING = OdometryErrors(1e-4, 1e-4, 1e-3, 1e-5, 1e-5, scale=0.02, drift=0.02, delay=0.1)


def wrong_wheels(seed, scale, drift, delay):
    """A filter after 4 m with a stop and systematic odometry errors, and the true pose."""
    random = np.random.default_rng(seed)
    found, pose = started(LEARNING, covariance=np.diag([1e-4, 1e-4, 1e-4])), START
    history = [(10.0, START)]
    for k in range(1, 501):
        stamp = 10.0 + 0.02 * k
        speed = 0.5 * min(max(0.02 * (k % 250 - 50), 0.0), max(0.02 * (250 - k % 250), 0.0), 1.0)  # at 0.5 m/s^2
        step = Pose2(0.02 * speed, 0.0, 0.006 * speed)
        pose = pose @ Pose2(step.x * (1.0 + scale), 0.0, step.yaw + drift * step.x)
        history.append((stamp, pose))
        found.predict(stamp, step)
        if k % 5 == 0 and k > 15:
            then = np.interp(stamp - 0.14 - delay, [t for t, _ in history], range(len(history)))
            found.correct(stamp - 0.14, noisy(history[round(then)][1], random), NOISE)
    return found, pose


@pytest.mark.parametrize(("scale", "drift", "delay"), [(0.02, -0.03, 0.0), (-0.01, 0.02, 0.12), (0.0, 0.0, -0.1)])
def test_systematic_errors_are_estimated(scale, drift, delay):
    found, pose = wrong_wheels(1, scale, drift, delay)
    sigma = np.sqrt(np.diag(found.covariance))
    assert np.all(np.abs(found.systematic - (scale, drift, delay)) < (0.002, 0.003, 0.01))
    assert np.all(sigma[3:] < (0.003, 0.003, 0.02))
    assert found.pose.distance_to(pose) < 0.003


def test_covariance_is_consistent():
    """The mean squared Mahalanobis distance of the truth is the number of dimensions, six, over many drives."""
    random, distances = np.random.default_rng(5), []
    for seed in range(10):
        truth = random.standard_normal(3) * (LEARNING.scale, LEARNING.drift, 0.0)
        found, pose = wrong_wheels(seed, *truth)
        off = np.concatenate((found.pose.as_array() - pose.as_array(), found.systematic - truth))[:5]
        distances.append(off @ np.linalg.solve(found.covariance[:5, :5], off))
    assert 3.0 < np.mean(distances) < 7.0


@settings(max_examples=25)
@given(st.floats(-2.0, 2.0))
def test_after_equals_prediction_without_measurements(way):
    errors = LEARNING._replace(wander=0.0, yaw_wander=0.0)
    found = started(errors)
    ahead = found.after(way)
    for k in range(4):
        found.predict(10.0 + 0.1 * (k + 1), Pose2(0.25 * way, 0.0, 0.0))
    assert np.allclose(found.covariance[:3, :3], ahead, atol=1e-15)


# What does not fit.


@pytest.mark.parametrize("offset", [Pose2(0.3, 0.0, 0.0), Pose2(0.0, -0.3, 0.0), Pose2(0.0, 0.0, 0.4)])
def test_single_outlier_has_no_effect(offset):
    random, found, without = np.random.default_rng(2), started(), started()
    for k, (stamp, pose, step) in enumerate(drive([0.05] * 60)[1:]):
        measured = noisy(pose, random)
        found.predict(stamp, step)
        without.predict(stamp, step)
        found.correct(stamp, measured @ offset if k == 30 else measured, NOISE)
        if k != 30:
            without.correct(stamp, measured, NOISE)
        assert found.rejected == (k == 30)
        assert found.jump is None
    assert found.pose == without.pose


@pytest.mark.parametrize("size", [0.03, 0.05, 0.3])
@pytest.mark.parametrize("outliers", [(), (32,), (31, 33)], ids=str)
def test_estimate_jumps_once_after_enough_agreeing_measurements(size, outliers):
    """Outliers in between have no effect."""
    random, found, jumps = np.random.default_rng(3), started(confirmations=3), []
    offset = Pose2(0.0, size, 0.0)
    for k, (stamp, pose, step) in enumerate(drive([0.05] * 60)[1:]):
        true = pose if k < 30 else offset @ pose
        found.predict(stamp, step)
        wild = Pose2(0.1 * (-1.0) ** k, 0.1, 0.1)
        found.correct(stamp, noisy(true, random) @ wild if k in outliers else noisy(true, random), NOISE)
        if found.jump is not None:
            jumps.append((k, found.jump))
        if k >= 33 + len(outliers):
            assert found.pose.distance_to(true) < 0.006
    ((when, jump),) = jumps
    assert when == 32 + len(outliers)
    assert math.hypot(jump.x, jump.y) == pytest.approx(size, abs=0.006)


@pytest.mark.parametrize(("apart", "needed"), [(0.0, 2), (1.5, 2), (3.5, 3)])
def test_one_measurement_fewer_suffices_for_close_agreement(apart, needed):
    """`apart` in standard deviations of the difference of two; beyond 4.0 they do not agree at all."""
    found, there = started(confirmations=3, fewer_when_close=1), START @ Pose2(0.1, 0.0, 0.0)
    verdicts = []
    for k in range(3):
        stamp = 10.1 + 0.1 * k
        found.predict(stamp, Pose2(0.0, 0.0, 0.0))
        aside = apart * math.sqrt(2.0) * SIGMA[0] * (k % 2)
        verdicts.append(found.correct(stamp, there @ Pose2(aside, 0.0, 0.0), NOISE))
    assert verdicts.index("moved") == needed - 1, verdicts


def test_measurements_alternating_between_two_poses_cause_no_jump():
    found, jumps, contradicted = started(confirmations=3), 0, []
    for k, (stamp, pose, step) in enumerate(drive([0.05] * 80)[1:]):
        found.predict(stamp, step)
        found.correct(stamp, Pose2(0.0, 0.2, 0.0) @ pose if k % 2 else pose, NOISE)
        jumps += found.jump is not None
        contradicted.append(found.is_contradicted)
    assert jumps == 0
    assert not any(contradicted), "every other one fits"


def test_two_agreeing_rejected_measurements_contradict_the_estimate():
    found = started(confirmations=9)
    for number, (elsewhere, expected) in enumerate([(1, False), (1, True), (0, False), (1, False), (1, True)]):
        found.predict(10.0 + 0.1 * (number + 1), Pose2(0.0, 0.0, 0.0))
        found.correct(found.stamp, Pose2(0.0, 0.1 * elsewhere, 0.0) @ START, NOISE)
        assert found.is_contradicted is expected
    found.predict(found.stamp + 5.0, Pose2(0.0, 0.0, 0.0))
    assert not found.is_contradicted, "too long ago"


def test_one_measurement_moves_the_estimate_to_a_supposed_pose():
    pushed = Pose2(0.0, 0.08, 0.0) @ START
    for measured in (pushed, START):
        found = started()
        found.suppose(pushed, 4.0 * NOISE)
        assert found.pose == START
        assert not found.is_contradicted
        found.correct(10.0, measured, NOISE)
        assert found.pose.gap_to(measured) < 1e-9


def test_scattered_outliers_cause_no_jump():
    random, found = np.random.default_rng(4), started()
    for k, (stamp, pose, step) in enumerate(drive([0.02] * 100)[1:]):
        found.predict(stamp, step)
        found.correct(stamp, pose @ Pose2(*random.uniform(-1.0, 1.0, 3)) if k % 10 > 3 else noisy(pose, random), NOISE)
        assert found.jump is None
        assert found.pose.distance_to(pose) < 0.006


def test_rotation_by_wheel_slip_is_estimated_quickly(monkeypatch):
    """Four measurements correct 90 % of a slip within the gate; without the test of innovations 60 %."""
    left, slip = [], 3.0 * SIGMA[1]
    for sudden in (pose_filter._SUDDEN, 1):
        monkeypatch.setattr(pose_filter, "_SUDDEN", sudden)
        found, pose = started(), START
        for k in range(1, 64):
            step = Pose2(0.01, 0.0, 0.0)
            pose = pose @ (step @ Pose2(0.0, 0.0, slip) if k == 60 else step)
            found.predict(10.0 + 0.1 * k, step)
            found.correct(found.stamp, pose, NOISE)
        left.append(abs(found.pose.in_frame_of(pose).yaw) / slip)
    assert left[0] < 0.1
    assert left[1] > 0.35


def test_innovations_with_a_persistent_sign_increase_the_covariance():
    """A lateral drift without odometry, each step within the gate."""
    sure = OdometryErrors(1e-4, 1e-4, 1e-4, 1e-5, 1e-5)
    found = started(sure)
    for k in range(1, 120):
        found.predict(10.0 + 0.1 * k, Pose2(0.02, 0.0, 0.0))
        found.correct(found.stamp, START @ Pose2(0.02 * k, 0.0005 * k, 0.0), NOISE)
    assert found.doubts > 0
    assert abs(found.pose.in_frame_of(START).y - 0.0005 * k) < 0.004


# Its memory and its clock.


@settings(max_examples=25)
@given(periods, st.floats(0.0, 1.0))
def test_past_poses_are_interpolated_on_arcs(periods, back):
    found, truth = started(), drive(periods)
    for stamp, pose, step in truth[1:]:
        found.predict(stamp, step)
        found.correct(stamp, pose, NOISE)
    stamp = max(10.0, truth[-1][0] - back)
    assert found.pose_at(stamp).gap_to(START.moved(BENT, stamp - 10.0)) < 1e-8


def test_past_poses_follow_a_jump():
    found, offset = started(), Pose2(0.2, 0.1, 0.3)
    for k, (stamp, pose, step) in enumerate(drive([0.05] * 20)[1:]):
        found.predict(stamp, step)
        found.correct(stamp, pose if k < 10 else offset @ pose, NOISE)
    assert found.pose_at(10.2).gap_to(offset @ START.moved(BENT, 0.2)) < 1e-8


def test_motion_is_stored_for_two_seconds():
    found = started()
    for stamp, _, step in drive([0.05] * 60)[1:]:
        found.predict(stamp, step)
    assert 10.9 < found.remembered_from <= 11.0
    with pytest.raises(InvalidValue, match="stored from"):
        found.pose_at(10.9)


def test_clock_that_goes_back_is_an_error():
    found = started()
    found.predict(12.0, Pose2(0.1, 0.0, 0.0))
    for wrong in (11.9, math.nan):
        with pytest.raises(InvalidValue, match="pose filter: "):
            found.predict(wrong, Pose2(0.0, 0.0, 0.0))


def test_errors_without_a_start_and_with_an_invalid_sigma():
    with pytest.raises(InvalidValue, match="no pose yet"):
        PoseFilter(OdometryErrors()).predict(0.0, Pose2(0.0, 0.0, 0.0))
    with pytest.raises(InvalidValue, match="drift: must be >= 0"):
        PoseFilter(OdometryErrors(drift=-0.1))


def test_expected_errors_increase_after_wheel_slip():
    """Only for a robot in motion; a robot at rest was moved."""
    grown = []
    for speed in (0.3, 0.0):
        found, pose = started(confirmations=3), START
        for k in range(1, 80):
            step = Pose2(0.05 * speed, 0.0, 0.0)
            pose = pose @ (step @ Pose2(0.0, 0.0, 0.08) if k == 40 else step)
            found.predict(10.0 + 0.05 * k, step)
            found.correct(found.stamp, pose, NOISE)
        assert found.pose.gap_to(pose) < 1e-3
        before = found.covariance[2, 2]
        for k in range(80, 88):
            found.predict(10.0 + 0.05 * k, Pose2(0.05, 0.0, 0.0))
        grown.append(math.sqrt(found.covariance[2, 2] - before))
    assert grown[0] > 0.04
    assert grown[1] < 0.01


def test_expected_slip_decays_and_a_wrong_first_pose_is_no_slip():
    grown = []
    for established, way in ((40, 0.0), (40, 6.0), (1, 0.0)):
        found, pose = started(confirmations=3), START
        for k in range(1, 60):
            step = Pose2(0.015, 0.0, 0.0)
            found.predict(10.0 + 0.05 * k, step)
            pose = pose @ (step @ Pose2(0.0, 0.0, 0.08) if k == 40 else step)
            if k == 40 - established or k < 40 < k + established or k >= 40:
                found.correct(found.stamp, pose, NOISE)
        for k in range(60, 60 + round(way / 0.05)):
            pose = pose @ Pose2(0.05, 0.0, 0.0)
            found.predict(10.0 + 0.05 * k, Pose2(0.05, 0.0, 0.0))
            found.correct(found.stamp, pose, NOISE)
        before = found.covariance[2, 2]
        found.predict(found.stamp + 0.05, Pose2(0.4, 0.0, 0.0))
        grown.append(math.sqrt(found.covariance[2, 2] - before))
    assert grown[0] > 0.04
    assert grown[1] < 0.02
    assert grown[2] < 0.01


@pytest.mark.parametrize("yaw", [0.0, 0.7, -2.0])
def test_slip_increases_the_covariance_along_the_heading_and_in_yaw(yaw):
    found = started(pose=Pose2(0.3, 0.2, yaw))
    before = found.covariance.copy()
    vague = 1e14 * np.eye(3)
    assert found.correct(10.0, found.pose, vague, slip=(0.01, 0.02)) == "accepted"
    ahead, aside = np.array([math.cos(yaw), math.sin(yaw)]), np.array([-math.sin(yaw), math.cos(yaw)])
    grown = found.covariance - before
    assert ahead @ grown[:2, :2] @ ahead == pytest.approx(1e-4, rel=1e-9)
    assert np.abs(grown[:2, :2] @ aside).max() < 1e-18
    assert grown[2, 2] == pytest.approx(4e-4, rel=1e-9)
    kept = found.covariance.copy()
    assert found.correct(10.0, found.pose @ Pose2(1.0, 0.0, 0.0), NOISE, slip=(0.01, 0.02)) == "rejected"
    assert np.array_equal(found.covariance, kept), "a rejected measurement has no effect"


@pytest.mark.parametrize("seed", range(10))
def test_whitening_is_the_inverse_of_the_cholesky_factor(seed):
    random = np.random.default_rng(seed)
    root = random.normal(size=(3, 3)) * [1e-3, 1.0, 0.1]
    spread = root @ root.T + 1e-9 * np.eye(3)
    found = pose_filter._whitening(spread)
    assert found @ np.linalg.cholesky(spread) == pytest.approx(np.eye(3), abs=1e-6)
    assert found == pytest.approx(np.tril(found))
    with pytest.raises(np.linalg.LinAlgError):
        pose_filter._whitening(spread - 2.0 * spread[0, 0] * np.diag([1.0, 0.0, 0.0]))


# Covariances in both lanes.


def random_state(random):
    """Covariance of the state, of a measurement, and a lever, a velocity and a difference."""
    roots = random.normal(size=(6, 6)), random.normal(size=(3, 3))
    lever, velocity, miss = (tuple(random.normal(size=size).tolist()) for size in (2, 3, 3))
    return roots[0] @ roots[0].T, roots[1] @ roots[1].T, lever, velocity, miss


@pytest.mark.parametrize("lane", LANES)
@pytest.mark.parametrize("seed", range(10))
def test_a_correction_is_the_conditional_distribution(lane, seed):
    """The information of the measurement is added to that of the state; the change is the gain times the difference."""
    covariance, noise, lever, velocity, miss = random_state(np.random.default_rng(seed))
    with using_kernels(lane):
        found, change, whitened = corrected(covariance, lever, velocity, noise, 0.3, miss)
    seen = np.hstack((np.eye(3), np.zeros((3, 3))))
    seen[0, 2], seen[1, 2], seen[:, 5] = *lever, -np.array(velocity)
    noise = noise + 0.09 * np.outer(velocity, velocity)
    information = np.linalg.inv(covariance) + seen.T @ np.linalg.solve(noise, seen)
    spread = seen @ covariance @ seen.T + noise
    assert found @ information == pytest.approx(np.eye(6), abs=1e-6)
    assert change == pytest.approx(covariance @ seen.T @ np.linalg.solve(spread, miss))
    assert whitened @ whitened == pytest.approx(np.array(miss) @ np.linalg.solve(spread, miss))


@pytest.mark.parametrize("lane", LANES)
def test_an_indefinite_innovation_is_an_error(lane):
    with using_kernels(lane), pytest.raises(np.linalg.LinAlgError):
        corrected(-np.eye(6), (0.0, 0.0), (0.0, 0.0, 0.0), 0.5 * np.eye(3), 0.0, (0.0, 0.0, 0.0))


@needs_compiler
@pytest.mark.parametrize("seed", range(30))
def test_both_lanes_are_equal_up_to_rounding(seed):
    random = np.random.default_rng(seed)
    covariance, noise, lever, velocity, miss = random_state(random)
    (way, heading), added = random.normal(size=2).tolist(), tuple(random.uniform(0.0, 1.0, 3).tolist())
    found = []
    for lane in ("twin", "native"):
        with using_kernels(lane):
            after = corrected(covariance, lever, velocity, noise, 0.3, miss)
            found.append((grown(covariance, lever, way, heading, added), *after))
    assert replaced() == ""
    for one, other in zip(*found, strict=True):
        assert np.abs(one - other).max() <= 1e-11 * max(1.0, np.abs(one).max())
