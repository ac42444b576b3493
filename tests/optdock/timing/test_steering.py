"""The steering rate is kept in motion, and the robot waits at rest until the wheels are turned."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from optdock.errors import InvalidValue
from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.model.constant_jerk import TimeLaw
from optdock.model.dock import Dock
from optdock.model.limits import LIMITS, MotionLimits, SpeedZone
from optdock.model.path import ClothoidSegment, Path, PolylineSegment, joint_curvatures
from optdock.model.problem import DockingProblem
from optdock.model.robot import Drive, Robot
from optdock.model.trajectory import Trajectory
from optdock.planning.pipeline import plan_dock
from optdock.plugins.interfaces import TimingStatus
from optdock.timing.near_optimal import NearOptimal
from optdock.timing.windowed import Windowed
from optdock.verification import certify_motion, certify_trajectory, turning_rules

NO_ZONE = SpeedZone()
CAR = MotionLimits(
    max_speed=2.5,
    max_reverse_speed=2.5,
    max_acceleration=1.0,
    max_deceleration=1.0,
    max_jerk=10.0,
    max_curvature=1.0 / 3.0,
    wheelbase=2.8,
    max_steering_rate=0.5,
)


def timed(path, limits, method=NearOptimal, zone=NO_ZONE):
    result = method().parameterize(path, limits, zone)
    assert result.status is TimingStatus.OK, result.reason
    return result.trajectory


def fold(first=0.3, second=0.3, length=3.0):
    """Forward with curvature `first`, then back with `second`, both along the travel."""
    ahead = ClothoidSpline(Pose2(0.0, 0.0, 0.0), [0.0, length], [first, first])
    back = ClothoidSpline(ahead.end, [0.0, length], [second, second], -1)
    return Path((ClothoidSegment(ahead), ClothoidSegment(back)))


def s_bend(*curvature, cell=1.5):
    knots = cell * np.arange(len(curvature))
    return Path((ClothoidSegment(ClothoidSpline(Pose2(0.0, 0.0, 0.0), knots, np.array(curvature))),))


@pytest.mark.parametrize("method", [NearOptimal, Windowed])
@pytest.mark.parametrize("seed", range(4))
def test_wheels_never_turn_faster_than_their_rate(seed, method, make, dense, all_limits):
    rng = np.random.default_rng(seed)
    path = make.random_path(rng, gears=1 + seed % 3)
    steered = {"wheelbase": rng.uniform(0.2, 1.5), "max_steering_rate": rng.uniform(0.1, 0.8)}
    limits = dataclasses.replace(all_limits if seed % 2 else MotionLimits(), **steered)
    motion = timed(path, limits, method, SpeedZone(0.12, 0.4))
    proof = certify_trajectory(motion, limits, SpeedZone(0.12, 0.4), start_speed=0.0, start_acceleration=0.0)
    ratios = dense.ratios(motion, limits, SpeedZone(0.12, 0.4))
    assert max(ratios.values()) <= 1.0 + 1e-6
    assert ratios["steering rate"] - 1e-6 <= proof.ratios["steering_rate"] <= 1.0 + 1e-6
    assert dense.rests(motion)
    # Without the limit the wheels would have to be quicker, so the test can fail.
    free = timed(path, dataclasses.replace(limits, max_steering_rate=math.inf), method, SpeedZone(0.12, 0.4))
    assert dense.ratios(free, limits, SpeedZone(0.12, 0.4))["steering rate"] > 1.0
    found = certify_trajectory(free, limits, SpeedZone(0.12, 0.4)).violations
    assert {violation.kind for violation in found} <= {"steering_rate", "rest"}
    assert found


@pytest.mark.parametrize("seed", range(2))
def test_a_polyline_is_steered_as_its_poses_turn(seed, make, dense):
    curved = make.random_path(np.random.default_rng(20 + seed), length=2.0)
    path = Path((PolylineSegment(curved.sample(0.02).poses, curved.segments[0].direction),))
    limits = MotionLimits(wheelbase=0.5, max_steering_rate=0.4)
    motion = timed(path, limits)
    assert certify_trajectory(motion, limits, NO_ZONE).certified
    assert dense.ratios(motion, limits, NO_ZONE)["steering rate"] <= 1.0 + 1e-6


@pytest.mark.parametrize(
    "bends",
    [(0.0, 0.3, -0.3, 0.0), (0.3, -0.3, 0.3), (0.0, 0.3, 0.3, 0.0, 0.0), (-0.3, 0.3), (0.0, 0.1, 0.0, -0.1, 0.0)],
)
def test_steering_cap_is_close_to_the_bound_without_jerk(bends, dense):
    path = s_bend(*bends)
    ratio = timed(path, CAR).duration / dense.least_duration(path, CAR, NO_ZONE)
    assert 1.0 <= ratio <= 1.05


def test_no_wait_at_a_cusp_without_a_turn_of_the_wheels():
    """Wheels to the left, forward and then back: the curvature along the travel changes its sign."""
    for kept in ((0.3, -0.3), (0.0, 0.0), (-0.2, 0.2)):
        path = fold(*kept)
        free = dataclasses.replace(CAR, max_steering_rate=math.inf)
        assert timed(path, CAR).duration == timed(path, free).duration


@pytest.mark.parametrize("kept", [(0.3, 0.3), (0.3, 0.0), (-0.1, 0.2)])
def test_wait_at_a_cusp_is_the_time_of_the_turn(kept):
    path = fold(*kept)
    motion, free = timed(path, CAR), timed(path, dataclasses.replace(CAR, max_steering_rate=math.inf))
    wait = abs(math.atan(2.8 * kept[0]) + math.atan(2.8 * kept[1])) / 0.5
    assert motion.duration == pytest.approx(free.duration + wait, rel=1e-12)
    arrival = motion.cusp_times[0]
    assert arrival == pytest.approx(free.cusp_times[0])
    resting = motion.sample_at(np.linspace(arrival, arrival + wait, 50))
    np.testing.assert_allclose(resting.speed, 0.0, atol=1e-9)
    np.testing.assert_allclose(resting.s, path.cusps[0], atol=1e-9)


@pytest.mark.parametrize("method", [NearOptimal, Windowed])
@pytest.mark.parametrize("bend", [-0.3, 0.0, 0.2])
def test_wait_at_the_start_for_unknown_wheel_angle(method, bend):
    path = s_bend(bend, 0.1, 0.0)
    wait = (math.atan(2.8 / 3.0) + abs(math.atan(2.8 * bend))) / 0.5
    assert CAR.start_wait(path) == pytest.approx(wait)
    known = timed(path, CAR, method)
    motion = method().parameterize(path, CAR, NO_ZONE, start_wait=wait).trajectory
    assert motion.duration == pytest.approx(known.duration + wait, rel=1e-12)
    np.testing.assert_allclose(motion.sample_at(np.linspace(0.0, wait, 50)).s, 0.0, atol=1e-12)
    proof = certify_trajectory(motion, CAR, NO_ZONE, start_speed=0.0, start_wait=wait)
    assert proof.certified
    assert proof.ratios["steering_rate"] == pytest.approx(1.0)
    refused = certify_trajectory(known, CAR, NO_ZONE, start_speed=0.0, start_wait=wait)
    assert [(violation.kind, violation.s) for violation in refused.violations] == [("rest", 0.0)]
    law = motion.time_law
    for share, certified in ((1.0, True), (1.0 - 1e-4, False), (1.5, True), (1e-3, False)):
        durations = law.durations.copy()
        durations[0] *= share
        found = certify_trajectory(Trajectory(path, TimeLaw(durations, law.jerks)), CAR, NO_ZONE, start_wait=wait)
        assert found.certified is certified
        assert found.ratios["steering_rate"] >= 1.0 / share - 1e-9 or certified


def test_start_wait_uses_the_largest_wheel_angle():
    """The largest angle: of the steering, of the smallest radius, or a quarter turn."""
    path, wheels = s_bend(-0.2, 0.0), {"wheelbase": 2.0, "max_steering_rate": 0.5}
    begins = math.atan(0.4)
    for limits, farthest in (
        ({"max_steering_angle": 0.7, "max_curvature": 0.25}, 0.7),
        ({"max_curvature": 0.25}, math.atan(0.5)),
        ({}, 0.5 * math.pi),
    ):
        assert MotionLimits(**wheels, **limits).start_wait(path) == pytest.approx((farthest + begins) / 0.5)
    assert MotionLimits(wheelbase=2.0, max_steering_angle=0.7).start_wait(path) == 0.0
    assert MotionLimits(max_curvature=1.0).start_wait(path) == 0.0


def test_waits_at_the_start_and_at_a_near_cusp_add_up():
    """A first gear of a micrometre: the waits at its start and at its end add up."""
    ahead = ClothoidSpline(Pose2(0.0, 0.0, 0.0), [0.0, 1e-7], [0.3, 0.3])
    back = ClothoidSpline(ahead.end, [0.0, 2.0], [0.3, 0.3], -1)
    path = Path((ClothoidSegment(ahead), ClothoidSegment(back)))
    wait = CAR.start_wait(path)
    law = NearOptimal().parameterize(path, CAR, NO_ZONE, start_wait=wait).trajectory.time_law
    assert certify_trajectory(Trajectory(path, law), CAR, NO_ZONE, start_wait=wait).certified
    (cusp,) = np.flatnonzero(
        (law.durations > 0.1)
        & (law.jerks == 0.0)
        & (law.states[:-1, 0] > 5e-8)
        & (law.times[:-1] < 10)
        & (law.states[:-1, 1] < 1e-9)
    )
    shorter = TimeLaw(np.delete(law.durations, cusp), np.delete(law.jerks, cusp))
    assert not certify_trajectory(Trajectory(path, shorter), CAR, NO_ZONE, start_wait=wait).certified


def test_moving_start_with_a_wait_fails():
    path = s_bend(0.0, 0.1, 0.0)
    for method in (NearOptimal, Windowed):
        for start in ({"start_speed": 0.3}, {"start_acceleration": 0.2}):
            result = method().parameterize(path, CAR, NO_ZONE, **start, start_wait=1.0)
            assert result.status is TimingStatus.FAIL
            assert "wheels" in result.reason
    moving = NearOptimal().parameterize(path, CAR, NO_ZONE, start_speed=0.3).trajectory
    proof = certify_trajectory(moving, CAR, NO_ZONE, start_speed=0.3, start_wait=1.0)
    assert [violation.kind for violation in proof.violations] == ["rest"]


@pytest.mark.parametrize("wait", [-1.0, math.nan, math.inf])
def test_a_wait_is_a_number_of_seconds(wait):
    with pytest.raises(InvalidValue, match="start_wait"):
        NearOptimal().parameterize(s_bend(0.0, 0.1), CAR, NO_ZONE, start_wait=wait)


def test_plans_of_a_car_wait_unless_the_start_curvature_is_known():
    start = Pose2(-0.8, 0.7, 0.0)
    limits = MotionLimits(wheelbase=0.6, max_steering_angle=0.7, max_steering_rate=0.5)
    car = Robot(Footprint.rectangle(0.8, 0.2, 0.6), limits, Drive.ACKERMANN)
    problem = DockingProblem(start, Dock(Pose2(0.0, 0.0, 0.0), final_straight=0.2), car)
    plan = plan_dock(problem, time_budget=30.0)
    wait = problem.start_wait(plan.path)
    assert wait >= 1.4
    assert plan.trajectory.at(wait - 1e-6).s == 0.0
    assert plan.trajectory.at(wait + 0.3).s > 0.0
    law = plan.trajectory.time_law
    hasty = Trajectory(plan.path, TimeLaw(law.durations[1:], law.jerks[1:]))
    (violation,) = certify_motion(hasty, problem).violations
    assert (violation.kind, violation.s) == ("rest", 0.0)
    begins = float(plan.path.curvature_at(0.0)[0])
    assert certify_motion(hasty, problem.starting_at(start, curvature=begins)).certified
    free = Robot(car.footprint, MotionLimits(wheelbase=0.6, max_steering_angle=0.7), Drive.ACKERMANN)
    assert DockingProblem(start, problem.dock, free).start_wait(plan.path) == 0.0


def test_a_rest_that_is_too_short_is_refused():
    path = fold()
    law = timed(path, CAR).time_law
    (k,) = np.flatnonzero((law.jerks == 0.0) & (law.states[:-1, 1] < 1e-9) & (law.durations > 1.0))
    for share, certified in ((1.0, True), (1.0 - 1e-4, False), (1.5, True), (1e-3, False)):
        durations = law.durations.copy()
        durations[k] *= share
        proof = certify_trajectory(Trajectory(path, TimeLaw(durations, law.jerks)), CAR, NO_ZONE)
        assert proof.certified is certified, proof.violations
        assert [violation.kind for violation in proof.violations] == ([] if certified else ["rest"])
        assert proof.ratios["steering_rate"] == pytest.approx(1.0 / share, rel=1e-9)
    # A rest in the middle of a gear is none at the cusp.
    elsewhere = Trajectory(path, TimeLaw(np.delete(law.durations, k), np.delete(law.jerks, k)))
    assert [violation.kind for violation in certify_trajectory(elsewhere, CAR, NO_ZONE).violations] == ["rest"]


def test_waiting_at_the_wrong_cusp_is_refused():
    """Three gears between which the wheels turn fully; all the waiting is done at the first cusp."""
    bends = [0.3, 0.3, 0.3]
    pose, segments = Pose2(0.0, 0.0, 0.0), []
    for sign, bend in zip((1, -1, 1), bends, strict=True):
        spline = ClothoidSpline(pose, [0.0, 2.0], [bend, bend], sign)
        segments.append(ClothoidSegment(spline))
        pose = spline.end
    path = Path(tuple(segments))
    law = timed(path, CAR).time_law
    first, second = np.flatnonzero((law.jerks == 0.0) & (law.states[:-1, 1] < 1e-9))
    durations = law.durations.copy()
    durations[first] += durations[second]
    moved = Trajectory(path, TimeLaw(np.delete(durations, second), np.delete(law.jerks, second)))
    found = certify_trajectory(moved, CAR, NO_ZONE).violations
    assert [(violation.kind, violation.s) for violation in found] == [("rest", 4.0)]


@pytest.mark.parametrize("length", [1e-12, 1e-7, 1e-6, 1e-5])
def test_waits_of_cusps_at_one_place_add_up(length):
    """Wheels to the left, right, left within a micrometre: the waits of cusps at one place are added up."""
    bends, pose, segments = (0.3, 0.3, 0.3), Pose2(0.0, 0.0, 0.0), []
    for sign, bend, run in zip((1, -1, 1), bends, (2.0, length, 2.0), strict=True):
        spline = ClothoidSpline(pose, [0.0, run], [bend, bend], sign)
        segments.append(ClothoidSegment(spline))
        pose = spline.end
    path = Path(tuple(segments))
    motion = timed(path, CAR)
    proof = certify_trajectory(motion, CAR, NO_ZONE)
    assert proof.certified
    law, turn = motion.time_law, 4.0 * math.atan(0.84) / 0.5
    waits = np.flatnonzero((law.jerks == 0.0) & (law.states[:-1, 1] < 1e-9) & (law.durations > 0.1))
    assert law.durations[waits].sum() == pytest.approx(turn)
    durations = law.durations.copy()
    durations[waits] *= 0.6
    assert not certify_trajectory(Trajectory(path, TimeLaw(durations, law.jerks)), CAR, NO_ZONE).certified


@pytest.mark.parametrize("seed", range(3))
def test_bicycle_model_with_these_wheel_angles_drives_the_path(seed, make):
    """Steering angle and speed alone, integrated: the angle has the sign it must have in each gear."""
    path = make.random_path(np.random.default_rng(seed), gears=3, length=1.5)
    limits = MotionLimits(wheelbase=0.7, max_steering_rate=0.6)
    motion = timed(path, limits)
    joints = joint_curvatures(path)
    starts = np.concatenate(([0.0], path.cusps))
    pose = path.start.as_array()
    for i, (segment, begin) in enumerate(zip(path.segments, starts, strict=True)):
        ends = limits.steering_angle(int(segment.direction) * segment.curvature_at([0.0, segment.length]))
        if i > 0:
            assert ends[0] == pytest.approx(limits.steering_angle(joints[i - 1, 1]))
        if i < len(path.segments) - 1:
            assert ends[1] == pytest.approx(limits.steering_angle(joints[i, 0]))
        s = np.linspace(begin, begin + segment.length, 3001)
        middle = 0.5 * (s[1:] + s[:-1])
        sign = int(segment.direction)
        angle = limits.steering_angle(sign * path.curvature_at(middle))
        turn = sign * np.diff(s) * np.tan(angle) / limits.wheelbase
        yaw = pose[2] + np.cumsum(turn) - 0.5 * turn
        pose = pose + np.array(
            [np.sum(sign * np.diff(s) * np.cos(yaw)), np.sum(sign * np.diff(s) * np.sin(yaw)), turn.sum()]
        )
    np.testing.assert_allclose(pose, path.end.as_array(), atol=1e-6)
    assert motion.path is path


def test_a_moving_start_is_capped_by_the_steering_rate_too():
    path = s_bend(0.0, 0.3, 0.0)
    allowed = 0.5 / (2.8 * 0.2)
    for speed, status in ((0.98 * allowed, TimingStatus.OK), (1.1 * allowed, TimingStatus.START_INFEASIBLE)):
        for method in (NearOptimal, Windowed):
            result = method().parameterize(path, CAR, NO_ZONE, start_speed=speed)
            assert result.status is status
            if status is not TimingStatus.OK:
                assert result.limit == "max_steering_rate"
                assert "max_steering_rate = 0.5 rad/s" in result.reason


def test_the_curvature_of_the_second_derivative_bounds_the_steering_rate():
    """The closed form of the proof: max |f| <= the ends plus width^2 / 8 of the bound of |f''|, for any cell."""
    rng = np.random.default_rng(0)
    for _ in range(150):
        v, a, j, k, r = rng.uniform(0.0, 3.0), *rng.normal(0.0, 2.0, 2), *rng.normal(0.0, 3.0, 2)
        width = 10.0 ** rng.uniform(-3.0, -0.5)
        t = np.linspace(0.0, width, 400)
        cell = turning_rules.Cells(*(np.array([value]) for value in (0.0, width, 0.0, v, a, j, k, r, -np.inf, np.inf)))
        along = cell.rows(np.zeros(t.size, dtype=int)).advanced(t)
        drive = dataclasses.replace(CAR, wheelbase=rng.uniform(0.1, 3.0))
        rate = LIMITS["max_steering_rate"].size(along, drive)
        sizes = turning_rules.Sizes.over(cell, cell.advanced(cell.width))
        # What moves backwards within a cell is refused elsewhere; speeds count by their size.
        bent = turning_rules._BENDS["max_steering_rate"](sizes, drive)[0]
        bound = max(rate[0], rate[-1]) + width**2 / 8.0 * bent
        assert rate.max() <= bound * (1.0 + 1e-12)


def test_cusps_of_one_path_are_its_joints():
    path = fold(0.2, 0.1)
    np.testing.assert_allclose(joint_curvatures(path), [[0.2, -0.1]], atol=1e-12)
    assert joint_curvatures(s_bend(0.0, 0.1)).shape == (0, 2)


@pytest.mark.parametrize("period", [0.02, 5.0])
def test_samples_show_the_wait_at_the_cusp(period):
    path = fold()
    motion = timed(path, CAR)
    samples = motion.sample(period)
    wait = 2.0 * math.atan(0.84) / 0.5
    arrival = float(motion.cusp_times[0])
    assert arrival == pytest.approx(0.5 * (motion.duration - wait))
    assert arrival in samples.t
    waiting = (samples.t >= arrival) & (samples.t <= arrival + wait)
    np.testing.assert_allclose(samples.speed[waiting], 0.0, atol=1e-9)
    np.testing.assert_allclose(samples.yaw_rate[waiting], 0.0, atol=1e-9)
