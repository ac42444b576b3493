from __future__ import annotations

import dataclasses
import pickle
import subprocess
import sys

import numpy as np
import pytest

from optdock.errors import FailedToTimePath, InvalidValue
from optdock.geometry.pose import Pose2
from optdock.model.dock import Dock
from optdock.model.limits import MotionLimits, SpeedZone
from optdock.model.path import Path
from optdock.model.problem import DockingProblem
from optdock.model.robot import Footprint, Robot
from optdock.plugins.interfaces import TimeParameterizer, TimingStatus
from optdock.plugins.registry import PluginChoice, create_plugin, timed_by
from optdock.timing.near_optimal import NearOptimal
from optdock.timing.windowed import Windowed
from optdock.verification import certify_trajectory

NO_ZONE = SpeedZone()
ZONE = SpeedZone(0.12, 0.4)


def _timed(path, limits, zone=NO_ZONE, start=(0.0, 0.0), **parameters):
    method = NearOptimal(**parameters)
    return method.parameterize(path, limits, zone, start_speed=start[0], start_acceleration=start[1])


@pytest.mark.parametrize("smooth", [False, True])
@pytest.mark.parametrize("seed", range(6))
def test_the_certificate_proves_every_limit(seed, smooth, make, dense, all_limits):
    path = make.random_path(np.random.default_rng(seed), gears=1 + seed % 3)
    result = _timed(path, all_limits, ZONE, smooth=smooth)
    assert result.status is TimingStatus.OK
    proof = certify_trajectory(result.trajectory, all_limits, ZONE, start_speed=0.0, start_acceleration=0.0)
    assert proof.certified, proof.violations
    assert max(dense.ratios(result.trajectory, all_limits, ZONE).values()) <= 1.0 + 1e-6
    assert dense.rests(result.trajectory)
    assert result.worst_ratio <= 1.0 + 1e-6


@pytest.mark.parametrize("length", [0.3, 1.5, 6.0])
def test_straight_line_is_close_to_the_closed_form(length, make):
    # Rest to rest with A = D; V reached or not.
    limits = MotionLimits(max_speed=0.5, max_acceleration=0.4, max_deceleration=0.4, max_jerk=2.0)
    v, a, j = 0.5, 0.4, 2.0
    least = length / v + v / a + a / j if length > v * v / a + v * a / j else None
    if least is None:
        top = 0.5 * (-a * a / j + np.sqrt((a * a / j) ** 2 + 4.0 * a * length))
        least = 2.0 * (top / a + a / j)
    found = _timed(Path((make.spline([length], [0.0, 0.0]),)), limits).trajectory.duration
    assert least * (1.0 - 1e-9) <= found <= least * 1.005


@pytest.mark.parametrize("seed", range(3))
def test_duration_is_between_the_bound_without_jerk_and_the_windowed_method(seed, make, dense, all_limits):
    path = make.random_path(np.random.default_rng(100 + seed), length=4.0)
    found = _timed(path, all_limits, ZONE).trajectory.duration
    windowed = Windowed().parameterize(path, all_limits, ZONE).trajectory.duration
    assert dense.least_duration(path, all_limits, ZONE) * 0.999 <= found <= windowed


@pytest.mark.parametrize(
    ("name", "limit", "value"),
    [
        ("speed", "max_speed", 0.3),
        ("acceleration", "max_acceleration", 0.2),
        ("deceleration", "max_deceleration", 0.2),
        ("jerk", "max_jerk", 0.5),
        ("yaw rate", "max_yaw_rate", 0.3),
        ("lateral", "max_lateral_acceleration", 0.1),
        ("wheel", "max_wheel_speed", 0.4),
        ("yaw acceleration", "max_yaw_acceleration", 0.3),
        ("lateral jerk", "max_lateral_jerk", 0.15),
    ],
)
def test_each_limit_is_necessary_and_used_up(name, limit, value, make, dense):
    segment = make.random_path(np.random.default_rng(3), length=4.0).segments[0]
    path = Path((make.spline(np.diff(segment.knots), segment.spline.curvature),))
    free = MotionLimits(track_width=0.4)
    bound = dataclasses.replace(free, **{limit: value})
    for method, least in ((NearOptimal(), 0.9), (Windowed(), 0.0)):
        without, kept = (method.parameterize(path, limits, NO_ZONE).trajectory for limits in (free, bound))
        assert dense.ratios(without, bound, NO_ZONE)[name] > 1.05
        assert least < dense.ratios(kept, bound, NO_ZONE)[name] <= 1.0 + 1e-6


def test_speed_zone_is_necessary_and_used_up(make, dense, all_limits):
    path = make.random_path(np.random.default_rng(5), length=3.0)
    assert dense.ratios(_timed(path, all_limits).trajectory, all_limits, ZONE)["zone"] > 1.5
    assert 0.98 < dense.ratios(_timed(path, all_limits, ZONE).trajectory, all_limits, ZONE)["zone"] <= 1.0 + 1e-6


def test_the_zone_may_reach_over_a_cusp(make, dense, all_limits):
    path = make.random_path(np.random.default_rng(6), gears=2, length=1.5)
    zone = SpeedZone(0.1, path.segments[1].length + 0.5)
    result = _timed(path, all_limits, zone)
    assert result.status is TimingStatus.OK
    assert dense.ratios(result.trajectory, all_limits, zone)["zone"] <= 1.0 + 1e-6


def test_mirroring_the_path_keeps_its_duration(make, all_limits):
    lengths, curvature = [0.5, 1.0, 0.7], np.array([0.0, 1.0, -1.2, 0.0])
    paths = [Path((make.spline(lengths, sign * curvature),)) for sign in (1, -1)]
    durations = [_timed(path, all_limits, ZONE).trajectory.duration for path in paths]
    assert durations[0] == pytest.approx(durations[1], rel=1e-9)


def test_scaling_lengths_and_times_scales_the_result(make, all_limits):
    # Lengths by L, times by T: speeds by L/T, accelerations by L/T^2, jerk by L/T^3, yaw rates by 1/T ...
    lengths, curvature = np.array([0.5, 1.0, 0.7]), np.array([0.0, 1.0, -1.2, 0.0])
    big, slow = 1.7, 1.3
    scaled = dataclasses.replace(
        all_limits,
        max_speed=all_limits.max_speed * big / slow,
        max_acceleration=all_limits.max_acceleration * big / slow**2,
        max_deceleration=all_limits.max_deceleration * big / slow**2,
        max_jerk=all_limits.max_jerk * big / slow**3,
        max_yaw_rate=all_limits.max_yaw_rate / slow,
        max_yaw_acceleration=all_limits.max_yaw_acceleration / slow**2,
        max_lateral_acceleration=all_limits.max_lateral_acceleration * big / slow**2,
        max_wheel_speed=all_limits.max_wheel_speed * big / slow,
        track_width=all_limits.track_width * big,
        max_lateral_jerk=all_limits.max_lateral_jerk * big / slow**3,
    )
    one = _timed(Path((make.spline(lengths, curvature),)), all_limits).trajectory.duration
    other = _timed(Path((make.spline(lengths * big, curvature / big),)), scaled).trajectory.duration
    assert other == pytest.approx(one * slow, rel=3e-3)


@pytest.mark.parametrize("start", [(0.3, 0.0), (0.25, 0.3), (0.2, -0.2), (0.0, 0.3), (0.002, 0.0), (0.01, -0.1)])
def test_moving_starts_are_certified(start, make, all_limits):
    path = Path((make.spline([0.5, 1.0, 0.7], [0.0, 1.0, -1.2, 0.0]),))
    result = _timed(path, all_limits, ZONE, start)
    assert result.status is TimingStatus.OK
    proof = certify_trajectory(result.trajectory, all_limits, ZONE, start_speed=start[0], start_acceleration=start[1])
    assert proof.certified, proof.violations


def test_a_start_exactly_at_the_speed_limit_is_fine(make, all_limits):
    path = Path((make.spline([3.0], [0.0, 0.0]),))
    result = _timed(path, all_limits, ZONE, (all_limits.max_speed, 0.0))
    assert result.status is TimingStatus.OK
    assert certify_trajectory(result.trajectory, all_limits, ZONE, start_speed=all_limits.max_speed).certified


@pytest.mark.parametrize(
    ("start", "ratio"), [((0.72, 0.0), 1.2), ((0.3, 0.6), 1.5), ((0.3, -0.6), 1.2), ((0.6, 0.1), None)]
)
def test_a_start_outside_the_limits_is_infeasible_and_brakes(start, ratio, make, dense, all_limits):
    path = Path((make.spline([3.0], [0.0, 0.0]),))
    result = _timed(path, all_limits, ZONE, start)
    assert result.status is TimingStatus.START_INFEASIBLE
    if ratio is not None:
        assert result.worst_ratio == pytest.approx(ratio, rel=1e-9)
    law = result.trajectory.time_law
    assert law.jerks[0] == pytest.approx(np.copysign(all_limits.max_jerk, -1.0 if start != (0.3, -0.6) else 1.0))
    assert dense.rests(result.trajectory)
    found = dense.ratios(result.trajectory, all_limits, ZONE)
    assert max(found.values()) <= result.worst_ratio * (1.0 + 1e-6)


def test_start_too_fast_for_a_bend_reports_limit_and_place(make, all_limits):
    path = Path((make.spline([0.2, 0.3, 1.0], [0.0, 2.5, 2.5, 0.0]),))
    result = _timed(path, all_limits, NO_ZONE, (0.6, 0.0))
    assert result.status is TimingStatus.START_INFEASIBLE
    assert result.worst_ratio > 1.05
    assert "yaw acceleration 4.5 rad/s^2 at s = 0.0000 m is 3.75 times max_yaw_acceleration = 1.2" in result.reason
    assert (result.limit, result.at_s) == ("max_yaw_acceleration", 0.0)


def test_start_too_fast_for_a_cusp_reports_the_overshoot(make, all_limits):
    path = Path((make.spline([0.1], [0.0, 0.0]), make.spline([1.0], [0.0, 0.0], sign=-1)))
    result = _timed(path, all_limits, NO_ZONE, (0.6, 0.0))
    assert result.status is TimingStatus.CANNOT_STOP
    assert result.overshoot == pytest.approx(0.36 / 1.0 + 0.6 * 0.5 / 2.4 - 0.1, rel=1e-9)
    assert (result.limit, result.at_s) == ("max_deceleration", pytest.approx(0.1))
    assert "the stop at s = 0.1 m is 0.1 m away" in result.reason
    assert result.trajectory.path.segments == path.segments[:1]
    assert tuple(result.trajectory.time_law.states[-1, 1:]) == pytest.approx((0.0, 0.0), abs=1e-12)


@pytest.mark.parametrize("start", [(-0.1, 0.0), (0.0, -0.1), (0.01, -0.4)])
def test_rolling_backwards_is_a_bad_start(start, make, all_limits):
    result = _timed(Path((make.spline([2.0], [0.0, 0.0]),)), all_limits, NO_ZONE, start)
    assert (result.status, result.trajectory) == (TimingStatus.BAD_START, None)
    assert (result.limit, result.at_s) == ("" if start[0] < 0.0 else "max_jerk", 0.0)


def test_turn_in_place_fails_with_its_place_and_angle(all_limits):
    path = Path.from_poses(np.array([[0, 0, 0], [1, 0, 0], [1, 0, 0.7], [1.5, 0.42, 0.7]], dtype=float))
    result = _timed(path, all_limits)
    assert (result.status, result.trajectory) == (TimingStatus.FAIL, None)
    assert "0.7 rad at s = 1 m" in result.reason


def test_the_result_needs_no_ruckig(make, all_limits, tmp_path):
    result = _timed(Path((make.spline([2.0], [0.0, 1.0]),)), all_limits, ZONE)
    file = tmp_path / "trajectory.pickle"
    file.write_bytes(pickle.dumps(result.trajectory))
    code = (
        "import pickle, pathlib, sys\n"
        "sys.modules['ruckig'] = None\n"
        f"law = pickle.loads(pathlib.Path({str(file)!r}).read_bytes())\n"
        "print(float(law.sample_at(law.duration).s[0]))\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert float(done.stdout) == pytest.approx(2.0, abs=1e-9)


def test_the_smooth_mode_changes_its_jerk_in_smaller_steps(make, all_limits):
    path = make.random_path(np.random.default_rng(1), length=4.0)
    steps = []
    for smooth in (False, True):
        law = _timed(path, all_limits, ZONE, smooth=smooth).trajectory.time_law
        steps.append(np.sqrt(np.sum(np.diff(law.jerks) ** 2)))
    assert steps[1] < 0.7 * steps[0]


def test_plugin_refuses_unknown_parameters(make, all_limits):
    plugin = create_plugin(TimeParameterizer, "NearOptimal", {"step": 0.1})
    result = plugin.parameterize(Path((make.spline([1.5], [0.0, 0.5]),)), all_limits, NO_ZONE)
    assert result.status is TimingStatus.OK
    with pytest.raises(InvalidValue, match="did you mean smooth"):
        NearOptimal(smoth=True)


def test_configuring_imports_what_the_first_call_needs():
    code = (
        "import sys\n"
        "from optdock.timing.near_optimal import NearOptimal\n"
        "from optdock.plugins.lifecycle import PluginContext\n"
        "assert 'ruckig' not in sys.modules\n"
        "NearOptimal().configure(PluginContext())\n"
        "assert 'ruckig' in sys.modules and 'scipy' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_timed_by_name_parameters_or_plugin(make, all_limits):
    path = Path((make.spline([1.5], [0.0, 0.5]),))
    dock = Dock(Pose2(0.0, 0.0, 0.0), approach_speed=0.12, approach_distance=0.4)
    robot = Robot(Footprint.rectangle(0.2, 0.2, 0.4), all_limits)
    problem = DockingProblem(Pose2(-2.0, 0.0, 0.0), dock, robot)
    plugin = Windowed(max_window=0.5)
    found = [
        timed_by(timing, path, problem) for timing in (PluginChoice("Windowed", {"max_window": 0.5}), plugin, plugin)
    ]
    result = plugin.parameterize(path, all_limits, problem.dock.approach)
    for trajectory in found:
        np.testing.assert_array_equal(trajectory.time_law.durations, result.trajectory.time_law.durations)
    fast = timed_by("NearOptimal", path, problem).duration
    assert timed_by("NearOptimal", path, problem, zone=NO_ZONE).duration < fast < result.trajectory.duration
    unlimited = _timed(path, MotionLimits()).trajectory.duration
    assert timed_by("NearOptimal", path, None).duration == pytest.approx(unlimited)
    with pytest.raises(FailedToTimePath, match="timed: .* max_speed = 0.6 m/s allows") as error:
        timed_by("NearOptimal", path, problem, start_speed=0.7)
    assert error.value.where["limit"] == "max_speed"
