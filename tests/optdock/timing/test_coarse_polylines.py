"""Coarse polylines: the caps hold at the curvature of the steps, which the certificate judges."""

import pytest

from optdock.geometry.pose import Pose2
from optdock.limits import MotionLimits, SpeedZone
from optdock.path import Path
from optdock.testing.drives import s_curve_drive
from optdock.timing.near_optimal import NearOptimal
from optdock.timing.windowed import Windowed
from optdock.verification import certify_trajectory

LIMITS = MotionLimits(
    max_yaw_rate=0.4,
    max_yaw_acceleration=1.0,
    max_lateral_acceleration=0.15,
    max_wheel_speed=0.45,
    track_width=0.4,
)
CURVE = s_curve_drive(Pose2(0.0, 0.0, 0.0)).path


@pytest.mark.parametrize("method", [NearOptimal, Windowed])
@pytest.mark.parametrize("spacing", [0.005, 0.02, 0.05, 0.1, 0.2])
def test_what_is_timed_is_certified(method, spacing):
    path = Path.from_poses(CURVE.sample(spacing).poses)
    result = method().parameterize(path, LIMITS, SpeedZone())
    assert certify_trajectory(result.trajectory, LIMITS, SpeedZone()).certified


@pytest.mark.parametrize("spacing", [0.005, 0.05])
def test_sampling_costs_little_time(spacing):
    exact = NearOptimal().parameterize(CURVE, LIMITS, SpeedZone()).trajectory.duration
    sampled = NearOptimal().parameterize(Path.from_poses(CURVE.sample(spacing).poses), LIMITS, SpeedZone())
    assert sampled.trajectory.duration == pytest.approx(exact, rel=0.01)
