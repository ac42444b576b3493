from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from optdock.model.constant_jerk import TimeLaw
from optdock.model.limits import MotionLimits, SpeedZone
from optdock.model.path import Direction, Path
from optdock.model.trajectory import Trajectory
from optdock.timing.jerk_phases import DriveBounds, Motion, MotionState
from optdock.timing.path_limits import SpeedCaps, limits_along, segment_limits
from optdock.timing.plan_checks import worst_ratio
from optdock.timing.ruckig_moves import move
from optdock.verification import certify_trajectory


@pytest.fixture
def along(make, all_limits):
    segment = make.spline([0.3, 0.2, 0.5], [0.0, 1.0, -0.5, 0.5])
    return segment_limits(segment, SpeedCaps(all_limits, Direction.FORWARD), 0.7, 0.1)


def test_knots_and_the_zone_start_are_nodes(along):
    for s in (0.0, 0.3, 0.5, 0.7, 1.0):
        assert np.min(np.abs(along.s - s)) < 1e-15
    assert np.all(np.diff(along.s) > 0.0)


def test_rates_on_both_sides_of_a_knot_are_kept_apart(along):
    knot = int(np.argmin(np.abs(along.s - 0.3)))
    assert along.rate_right[knot - 1] == pytest.approx(1.0 / 0.3)
    assert along.rate_left[knot] == pytest.approx(-1.5 / 0.2)


def test_slowness_is_the_reciprocal_of_the_strictest_cap(all_limits):
    k = np.linspace(-3.0, 3.0, 41)
    bend, free = np.maximum(np.abs(k), 1e-12), all_limits
    caps = [
        np.full(k.size, free.max_reverse_speed),
        free.max_yaw_rate / bend,
        np.sqrt(free.max_lateral_acceleration / bend),
        free.max_wheel_speed / (1.0 + 0.5 * free.track_width * bend),
    ]
    np.testing.assert_allclose(1.0 / SpeedCaps(free, Direction.REVERSE).slowness(k), np.min(caps, axis=0), rtol=1e-12)


def test_unlimited_bounds_vanish():
    found = SpeedCaps(MotionLimits(), Direction.FORWARD).slowness(np.array([0.0, 100.0]))
    np.testing.assert_array_equal(found, [2.0, 2.0])


def test_the_zone_counts_from_its_start_on(along):
    points = along.points_at(np.array([0.7 - 1e-9, 0.7, 1.0]))
    assert points.slowness[0] < 5.0
    assert points.slowness[1] == points.slowness[2] == 10.0


@pytest.mark.parametrize("start", [0.0, 0.1234, 0.3, 0.7, 0.99])
def test_limits_after_a_place_are_the_same(along, start):
    rest = along.after(start)
    assert rest.length == pytest.approx(along.length - start)
    s = np.linspace(1e-6, rest.length, 300)
    for mine, whole in zip(rest.points_at(s), along.points_at(s + start), strict=True):
        agree = np.abs(mine - whole) < 1e-9
        assert np.mean(agree) > 0.99  # rounding may put a node on its other side


def test_polyline_and_clothoid_of_the_same_arc_agree(all_limits):
    angle = np.linspace(0.0, 1.0, 400)
    arc = Path.from_poses(np.column_stack((np.sin(angle), 1.0 - np.cos(angle), angle)))
    found = segment_limits(arc.segments[0], SpeedCaps(all_limits, Direction.FORWARD), math.inf, math.inf)
    np.testing.assert_allclose(found.curvature, 1.0, atol=1e-9)
    assert found.length == pytest.approx(1.0, abs=1e-9)


def test_cap_binds_where_its_limit_is_tight(make):
    limits = dataclasses.replace(MotionLimits(), max_lateral_acceleration=0.1)
    along = segment_limits(make.spline([1.0], [0.0, 2.0]), SpeedCaps(limits, Direction.FORWARD), math.inf, math.inf)
    assert 1.0 / along.slowness_right[-1] == pytest.approx(math.sqrt(0.05))


@pytest.mark.parametrize("beside", [-1e-13, -(2.0**-52), 0.0, 2.0**-52, 1e-13])
def test_zone_start_within_rounding_of_a_knot_is_its_node(make, all_limits, beside):
    segment = make.spline([0.3, 0.4, 0.3], [0.0, 1.0, 0.0, 0.0])
    along = segment_limits(segment, SpeedCaps(all_limits, Direction.FORWARD), float(segment.knots[2]) + beside, 0.1)
    assert along.zone_start in along.s
    assert np.min(np.diff(along.s)) > 1e-3
    first = int(np.searchsorted(along.s, along.zone_start))
    assert along.points_at(along.s[first : first + 1]).slowness[0] == 10.0
    rest = along.after(0.5)
    assert rest.zone_start in rest.s


def test_a_segment_cut_just_before_its_zone_is_in_the_zone(along):
    rest = along.after(along.zone_start - 1e-13)
    assert rest.zone_start == 0.0
    assert rest.begin == pytest.approx(along.zone_start)


@pytest.mark.parametrize(
    ("limit", "value"),
    [("max_speed", 0.1), ("max_yaw_rate", 0.05), ("max_lateral_acceleration", 0.001), ("max_wheel_speed", 0.02)],
)
def test_cap_at_returns_the_lowest_cap(make, limit, value):
    limits = dataclasses.replace(MotionLimits(track_width=0.4), **{limit: value})
    along = segment_limits(make.spline([1.0], [1.0, 1.0]), SpeedCaps(limits, Direction.FORWARD), 0.8, 0.01)
    name, words = along.cap_at(0.5)
    assert (name, words.split(" = ")[0]) == (limit, limit)
    assert f" = {value:.4g} " in words
    assert along.cap_at(0.9) == ("approach_speed", "approach_speed = 0.01 m/s")


def _driven(along, box):
    return Motion.of(MotionState(), move(MotionState(), MotionState(along.length), box))


def test_a_spike_between_two_time_samples_is_found(make):
    # 2 mm wide, passed in 4 ms at 0.5 m/s: half a period of the check.
    limits = MotionLimits(max_yaw_rate=0.5)
    segment = make.spline([1.0, 0.001, 0.001, 1.0], [0.0, 0.0, 2.0, 0.0, 0.0])
    along = segment_limits(segment, SpeedCaps(limits, Direction.FORWARD), math.inf, math.inf)
    worst = worst_ratio(along, _driven(along, DriveBounds(0.5, 0.5, 0.6, 2.0)))
    assert worst.ratio == pytest.approx(2.0, rel=1e-3)
    assert worst.s == pytest.approx(1.001, abs=1e-9)


@pytest.mark.parametrize("order", [1, -1])
def test_both_curvature_rates_at_a_jump_are_checked(make, order):
    limits = MotionLimits(max_yaw_acceleration=1.0)
    curvature = np.array([0.0, 0.0, 1.0])[::order]
    along = segment_limits(make.spline([1.0, 1.0], curvature), SpeedCaps(limits, Direction.FORWARD), math.inf, math.inf)
    worst = worst_ratio(along, _driven(along, DriveBounds(0.5, 0.5, 0.6, 2.0)))
    assert worst.ratio >= 0.25 - 1e-9  # v^2 k' on the steep side of the jump


@pytest.mark.parametrize("seed", range(6))
def test_agrees_with_the_independent_certificate(make, all_limits, seed):
    path, zone = make.random_path(np.random.default_rng(seed), length=2.0), SpeedZone(0.2, 0.3)
    along = limits_along(path, all_limits, zone)[0]
    motion = _driven(along, DriveBounds(0.3, 0.4, 0.5, 1.2))
    trajectory = Trajectory(path, TimeLaw(motion.durations, motion.jerks))
    proven = max(certify_trajectory(trajectory, all_limits, zone).ratios.values())
    worst = worst_ratio(along, motion, np.linspace(0.0, motion.duration, 20001))
    squared = max(worst.ratio, worst.path**2)  # the certificate does not take the root of the lateral acceleration
    assert worst.ratio * (1.0 - 1e-5) <= proven <= squared * (1.0 + 1e-4)


def test_stretching_by_the_worst_ratio_keeps_every_limit(make, all_limits):
    from optdock.timing.jerk_phases import stretched

    path = make.random_path(np.random.default_rng(2), length=2.0)
    along = limits_along(path, all_limits, SpeedZone())[0]
    motion = _driven(along, DriveBounds(0.6, 0.8, 0.9, 3.0))
    worst = worst_ratio(along, motion)
    assert worst.ratio > 1.2
    cured = worst_ratio(along, Motion.of(MotionState(), stretched(motion.phases, worst.stretch)))
    assert cured.ratio <= 1.0 + 1e-3
    barely = worst_ratio(along, Motion.of(MotionState(), stretched(motion.phases, worst.stretch * 0.98)))
    assert barely.ratio > 1.0
