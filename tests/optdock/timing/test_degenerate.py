"""Any path and start gives a status, and OK means that every limit is kept."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.pose import Pose2
from optdock.model.limits import MotionLimits, SpeedZone
from optdock.model.path import ClothoidSegment, Path
from optdock.plugins.interfaces import TimingStatus
from optdock.testing.drives import s_curve_drive
from optdock.timing.near_optimal import NearOptimal
from optdock.timing.path_limits import limits_along
from optdock.timing.retry_strategy import LONGEST_MOTION
from optdock.timing.windowed import Windowed
from optdock.verification import certify_trajectory

METHODS = (NearOptimal(), NearOptimal(smooth=True), Windowed())
LENGTHS = st.one_of(st.sampled_from([1e-9, 1e-6, 1e-3, 0.05]), st.floats(1e-3, 2.0))
CELLS = st.lists(st.tuples(LENGTHS, st.floats(-2.5, 2.5)), min_size=1, max_size=6)


def assert_honest(result, path, limits, zone, start, dense):
    if result.status is TimingStatus.OK:
        assert max(dense.ratios(result.trajectory, limits, zone).values()) <= 1.0 + 1e-6
        assert dense.rests(result.trajectory)
        assert tuple(result.trajectory.time_law.states[0]) == (0.0, *start)
    else:
        assert result.reason
    if result.status is TimingStatus.START_INFEASIBLE:
        assert result.worst_ratio > 1.0
        assert result.trajectory.time_law.states[-1, 1] == pytest.approx(0.0, abs=1e-9)
    if result.status is TimingStatus.CANNOT_STOP:
        assert result.overshoot > 0.0
    if result.status in (TimingStatus.BAD_START, TimingStatus.FAIL):
        assert result.trajectory is None


@settings(max_examples=20)
@given(
    gears=st.lists(st.tuples(st.floats(-2.5, 2.5), CELLS), min_size=1, max_size=3),
    asked=st.tuples(
        st.builds(SpeedZone, st.floats(0.03, 0.5), st.floats(0.0, 6.0)),
        st.one_of(st.just((0.0, 0.0)), st.tuples(st.floats(0.0, 0.7), st.floats(-0.6, 0.6))),
    ),
    method=st.sampled_from(METHODS),
)
@example([(0.0, [(1e-9, 0.0)])], (SpeedZone(), (0.0, 0.0)), METHODS[0])
@example([(0.0, [(1e-9, 0.0)])], (SpeedZone(0.5, 0.0), (0.0, -2.4e-257)), METHODS[0])
@example([(-2.5, [(0.05, 2.5)])], (SpeedZone(0.05, 1.0), (0.0, 0.0)), METHODS[0])
@example([(0.0, [(1.0, 0.0), (0.005, 2.5), (0.005, 0.0), (1.0, 0.0)])], (SpeedZone(), (0.0, 0.0)), METHODS[0])
@example([(0.0, [(1.0, 0.0), (0.02, 2.5), (0.05, -2.5), (0.02, 0.0)])], (SpeedZone(0.1, 99.0), (0.0, 0.0)), METHODS[0])
@example(
    [(0.0, [(1.0, 0.5)]), (0.5, [(1e-9, 0.5)]), (0.5, [(1.0, 0.0)])], (SpeedZone(0.1, 0.3), (0.0, 0.0)), METHODS[0]
)
def test_any_clothoid_path(make, dense, all_limits, gears, asked, method):
    zone, start = asked
    segments, pose, sign = [], Pose2(0.0, 0.0, 0.0), 1
    for first_curvature, cells in gears:
        lengths, bends = zip(*cells, strict=True)
        segments.append(make.spline(lengths, [first_curvature, *bends], sign, pose))
        pose, sign = segments[-1].spline.end, -sign
    path = Path(tuple(segments))
    result = method.parameterize(path, all_limits, zone, start_speed=start[0], start_acceleration=start[1])
    assert_honest(result, path, all_limits, zone, start, dense)


@pytest.mark.parametrize("method", METHODS[:2])
@pytest.mark.parametrize("count", [100, 3000])
def test_the_number_of_samples_does_not_matter(count, method, make, dense, all_limits):
    s = np.linspace(0.0, 4.0, count)
    curvature = 1.5 * np.sin(2.0 * s) * np.exp(-((s - 2.0) ** 2))
    path = Path((make.spline(np.diff(s), curvature),))
    result = method.parameterize(path, all_limits, SpeedZone(0.1, 0.3))
    assert_honest(result, path, all_limits, SpeedZone(0.1, 0.3), (0.0, 0.0), dense)
    fine = Path((make.spline(np.full(800, 0.005), np.interp(np.linspace(0.0, 4.0, 801), s, curvature)),))
    assert result.trajectory.duration == pytest.approx(
        method.parameterize(fine, all_limits, SpeedZone(0.1, 0.3)).trajectory.duration, rel=1e-2
    )


@pytest.mark.parametrize("amplitude", [0.003, 0.03])
def test_noisy_curvature_is_slower_and_within_limits(amplitude, make, dense, all_limits):
    s = np.linspace(0.0, 3.0, 600)
    noise = np.random.default_rng(4).normal(0.0, amplitude, 600)
    clean, noisy = (Path((make.spline(np.diff(s), np.sin(2.0 * s) + extra),)) for extra in (0.0, noise))
    durations = []
    for path in (clean, noisy):
        result = NearOptimal().parameterize(path, all_limits, SpeedZone(0.1, 0.3))
        assert result.status is TimingStatus.OK
        assert_honest(result, path, all_limits, SpeedZone(0.1, 0.3), (0.0, 0.0), dense)
        durations.append(result.trajectory.duration)
    assert durations[1] > durations[0]


def test_slow_limits(make, dense):
    limits = MotionLimits(0.01, 0.01, 0.005, 0.005, 0.01, max_yaw_rate=0.005, max_yaw_acceleration=0.002)
    path = make.random_path(np.random.default_rng(0), length=0.5)
    result = NearOptimal().parameterize(path, limits, SpeedZone(0.002, 0.05))
    assert_honest(result, path, limits, SpeedZone(0.002, 0.05), (0.0, 0.0), dense)
    assert result.status is TimingStatus.OK


TURNING = MotionLimits(
    max_yaw_rate=1.0,
    max_yaw_acceleration=2.0,
    max_lateral_acceleration=0.5,
    max_wheel_speed=0.7,
    track_width=0.4,
    wheelbase=0.6,
    max_steering_rate=0.5,
)
ZONE = SpeedZone(0.1, 0.3)
PATH = Path((ClothoidSegment(ClothoidSpline(Pose2(0.0, 0.0, 0.0), [0.0, 1.0, 2.0, 3.0], [0.0, 0.8, -0.5, 0.0])),))
NAMES = [
    field.name
    for field in dataclasses.fields(TURNING)
    if field.name.startswith("max_") and "curvature" not in field.name and field.name != "max_steering_angle"
]


@pytest.mark.parametrize("method", [NearOptimal, Windowed])
@pytest.mark.parametrize("name", [name for name in NAMES if name != "max_reverse_speed"])
@pytest.mark.parametrize("value", [1e-12, 1e-5, 1e-2, 1e9])
def test_extreme_limits_give_a_certified_motion_or_a_reason(method, name, value):
    limits = dataclasses.replace(TURNING, **{name: value})
    result = method().parameterize(PATH, limits, ZONE)
    if result.status is TimingStatus.OK:
        assert certify_trajectory(result.trajectory, limits, ZONE, start_speed=0.0).certified
    else:
        assert result.status is TimingStatus.FAIL
        assert result.reason


def test_motions_of_hours_are_refused():
    result = NearOptimal().parameterize(PATH, dataclasses.replace(TURNING, max_speed=1e-5), ZONE)
    assert result.status is TimingStatus.FAIL
    assert "about 3e+05 s; motions of more than 3600 s" in result.reason


@pytest.mark.parametrize("seed", range(6))
def test_duration_estimate_is_close_to_the_duration(seed):
    rng = np.random.default_rng(seed)
    knots = np.linspace(0.0, rng.uniform(0.5, 8.0), 7)
    curve = ClothoidSpline(Pose2(0.0, 0.0, 0.0), knots, np.append(rng.uniform(-1.5, 1.5, 6), 0.0))
    path = Path((ClothoidSegment(curve),))
    (along,) = limits_along(path, TURNING, ZONE)
    true = NearOptimal().parameterize(path, TURNING, ZONE).trajectory.duration
    assert 0.4 * true <= along.duration_estimate <= 1.05 * true
    assert true < LONGEST_MOTION


COARSE = MotionLimits(
    max_yaw_rate=0.4, max_yaw_acceleration=1.0, max_lateral_acceleration=0.15, max_wheel_speed=0.45, track_width=0.4
)
CURVE = s_curve_drive(Pose2(0.0, 0.0, 0.0)).path


@pytest.mark.parametrize("method", [NearOptimal, Windowed])
@pytest.mark.parametrize("spacing", [0.005, 0.05, 0.2])
def test_sampled_paths_get_certified_motions(method, spacing):
    path = Path.from_poses(CURVE.sample(spacing).poses)
    result = method().parameterize(path, COARSE, SpeedZone())
    assert certify_trajectory(result.trajectory, COARSE, SpeedZone()).certified


@pytest.mark.parametrize("spacing", [0.005, 0.05])
def test_sampling_costs_little_time(spacing):
    exact = NearOptimal().parameterize(CURVE, COARSE, SpeedZone()).trajectory.duration
    sampled = NearOptimal().parameterize(Path.from_poses(CURVE.sample(spacing).poses), COARSE, SpeedZone())
    assert sampled.trajectory.duration == pytest.approx(exact, rel=0.01)
