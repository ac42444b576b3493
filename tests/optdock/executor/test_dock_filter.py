"""The dock in the frame of the odometry: averages, late detections, outliers, jumps."""

import math

import numpy as np
import pytest

from optdock.executor.dock_filter import DeadReckoning, DockFilter
from optdock.geometry.pose import Pose2, Twist2
from optdock.measurements import Detection

DOCK = Pose2(2.0, 0.3, 0.4)
HERE = Pose2(0.0, 0.0, 0.0)
BENT = Twist2(0.3, 0.4)


def seen(pose=DOCK, stamp=0.0, sigma=0.003, yaw_sigma=0.005):
    return Detection(stamp, pose, sigma, yaw_sigma)


STORED = Pose2(2.05, 0.25, 0.35)


def filter_at(pose=STORED):
    return DockFilter(pose, 0.1, 0.06)


def test_detections_of_a_resting_dock_are_averaged():
    """n of them leave sigma / sqrt(n), whatever the stored pose was; the mean is that of the measurements."""
    rng = np.random.default_rng(1)
    found, offsets = filter_at(), rng.normal(size=(40, 3)) * (0.003, 0.003, 0.005)
    for dx, dy, turn in offsets:
        assert found.see(seen(Pose2(DOCK.x + dx, DOCK.y + dy, DOCK.yaw + turn)), HERE) == "accepted"
    assert found.position_sigma == pytest.approx(0.003 / math.sqrt(40), rel=0.01)
    assert found.yaw_sigma == pytest.approx(0.005 / math.sqrt(40), rel=0.01)
    mean = DOCK.as_array() + offsets.mean(axis=0)
    assert np.allclose(found.mean.as_array(), mean, atol=2e-4)


def test_late_detections_of_a_moving_robot_fit():
    """Composed with where the robot was then, not with where it is now."""
    reckoning, found = DeadReckoning(0.0, BENT), filter_at()
    for k in range(1, 60):
        now = 0.02 * k
        reckoning.advance(now, BENT)
        then = reckoning.at(now - 0.093)
        if then is not None:
            true = HERE.moved(BENT, now - 0.093)
            assert then.gap_to(true) < 1e-9
            found.see(seen(DOCK.in_frame_of(true), now - 0.093), then)
    assert found.mean.gap_to(DOCK) < 1e-3
    assert reckoning.at(now + 1.0) is None
    assert reckoning.at(-1.0) is None


def test_an_outlier_is_rejected_and_consistent_ones_are_followed():
    found = filter_at()
    for _ in range(10):
        found.see(seen(), HERE)
    before, moved = found.mean, Pose2(DOCK.x + 0.2, DOCK.y - 0.22, DOCK.yaw)
    assert found.see(seen(moved), HERE) == "rejected"
    assert found.mean == before
    assert found.see(seen(), HERE) == "accepted", "one outlier is forgotten"
    assert [found.see(seen(moved), HERE) for _ in range(4)] == ["rejected"] * 3 + ["moved"]
    assert found.mean.gap_to(moved) < 1e-9
    scattered = [Pose2(DOCK.x + 0.3 * k, DOCK.y, DOCK.yaw) for k in (1, 2, 3, 4, 5, 6)]
    assert [found.see(seen(pose), HERE) for pose in scattered] == ["rejected"] * 6, "they do not agree"


def test_an_outlier_is_no_first_detection():
    assert filter_at(DOCK).see(seen(Pose2(DOCK.x, DOCK.y + 0.45, DOCK.yaw)), HERE) == "rejected"


def test_motion_forgets_where_the_odometry_errs():
    """Driving blurs the dock along the heading, turning swings it about the robot: by the distance to it."""
    found = filter_at()
    for _ in range(1000):
        found.see(seen(), HERE)
    found.covariance[:] = 0.0
    found.forget(HERE, 0.01, 0.0, 0.0)
    assert np.allclose(np.sqrt(np.diag(found.covariance)), (0.01, 0.0, 0.0))
    found.covariance[:] = 0.0
    found.forget(HERE, 0.0, 0.01, 0.0)
    away = math.hypot(found.mean.x, found.mean.y)
    assert math.sqrt(found.covariance[0, 0] + found.covariance[1, 1]) == pytest.approx(0.01 * away)
    assert found.yaw_sigma == pytest.approx(0.01)


def test_a_push_that_odometry_does_not_see_is_decided_by_the_next_detection():
    found = filter_at()
    for _ in range(20):
        found.see(seen(), HERE)
    pushed = Pose2(DOCK.x, DOCK.y - 0.05, DOCK.yaw)
    found.widen(0.05, 0.0)
    assert found.see(seen(pushed), HERE) == "accepted"
    assert found.mean.gap_to(pushed) < 0.002
