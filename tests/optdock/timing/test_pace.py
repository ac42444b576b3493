"""Limits nobody would set: a named outcome in bounded time and memory, never an exception or a wrong motion."""

import dataclasses

import numpy as np
import pytest

from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.pose import Pose2
from optdock.interfaces import TimingStatus
from optdock.limits import MotionLimits, SpeedZone
from optdock.path import ClothoidSegment, Path
from optdock.timing.gears import courses_of
from optdock.timing.near_optimal import NearOptimal
from optdock.timing.pace import LONGEST, expected_duration
from optdock.timing.windowed import Windowed
from optdock.verification import certify_trajectory

LIMITS = MotionLimits(
    max_yaw_rate=1.0, max_yaw_acceleration=2.0, max_lateral_acceleration=0.5, max_wheel_speed=0.7, track_width=0.4
)
ZONE = SpeedZone(0.1, 0.3)
PATH = Path((ClothoidSegment(ClothoidSpline(Pose2(0.0, 0.0, 0.0), [0.0, 1.0, 2.0, 3.0], [0.0, 0.8, -0.5, 0.0])),))
NAMES = [
    field.name
    for field in dataclasses.fields(LIMITS)
    if field.name.startswith("max_") and "curvature" not in field.name
]


@pytest.mark.parametrize("method", [NearOptimal, Windowed])
@pytest.mark.parametrize("name", [name for name in NAMES if name != "max_reverse_speed"])
@pytest.mark.parametrize("value", [1e-12, 1e-9, 1e-5, 1e-2, 1e3, 1e9])
def test_an_extreme_limit_has_a_named_outcome(method, name, value):
    limits = dataclasses.replace(LIMITS, **{name: value})
    result = method().parameterize(PATH, limits, ZONE)
    if result.status is TimingStatus.OK:
        assert certify_trajectory(result.trajectory, limits, ZONE, start_speed=0.0).certified
    else:
        assert result.status is TimingStatus.FAIL
        assert result.reason


def test_a_motion_of_hours_is_refused_with_its_duration():
    result = NearOptimal().parameterize(PATH, dataclasses.replace(LIMITS, max_speed=1e-5), ZONE)
    assert result.status is TimingStatus.FAIL
    assert "about 3e+05 s; motions of more than 3600 s" in result.reason


@pytest.mark.parametrize("seed", range(12))
def test_the_expected_duration_is_about_the_true_one(seed):
    rng = np.random.default_rng(seed)
    knots = np.linspace(0.0, rng.uniform(0.5, 8.0), 7)
    curve = ClothoidSpline(Pose2(0.0, 0.0, 0.0), knots, np.append(rng.uniform(-1.5, 1.5, 6), 0.0))
    path = Path((ClothoidSegment(curve),))
    (course,) = courses_of(path, LIMITS, ZONE)
    true = NearOptimal().parameterize(path, LIMITS, ZONE).trajectory.duration
    assert 0.4 * true <= expected_duration(course) <= 1.05 * true
    assert true < LONGEST
