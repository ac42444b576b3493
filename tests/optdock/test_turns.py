"""Turns in place: segment, proof, time law, plan file and tracking."""

from __future__ import annotations

import dataclasses
import itertools
import json
import math

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from experiments.dense_check import dense_check
from optdock.errors import InvalidFile, InvalidPath, InvalidValue
from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.io.plan_file import PlanFile, TrajectoryColumns, load_plan, save_plan
from optdock.model.constant_jerk import TimeLaw
from optdock.model.dock import Dock
from optdock.model.limits import MotionLimits, SpeedZone
from optdock.model.path import (
    ClothoidSegment,
    Direction,
    Path,
    PolylineSegment,
    TurnSegment,
    driven_stretches,
    parts_between_turns,
    place_before_end,
)
from optdock.model.problem import DockingProblem
from optdock.model.robot import Drive, Robot
from optdock.model.trajectory import Trajectory
from optdock.planning.plan import DockPlan
from optdock.plotting import save_profile_picture
from optdock.plugins.interfaces import Controller, GoalChecker, TimingStatus
from optdock.plugins.registry import create_plugin
from optdock.samples import check_sampled_motion, check_samples_of
from optdock.simulation import run_closed_loop
from optdock.timing.near_optimal import NearOptimal
from optdock.timing.windowed import Windowed
from optdock.verification import certify_motion, certify_path, certify_trajectory, prove_motion

LIMITS = MotionLimits(0.5, 0.3, 0.4, 0.6, 2.0, max_yaw_rate=0.8, max_yaw_acceleration=1.5, max_curvature=2.0)
BOX = Footprint.rectangle(0.5, 0.3, 0.4)
NO_ZONE = SpeedZone()
CORNER = float(np.hypot(0.5, 0.2))  # the farthest point of the box
ORIGIN = Pose2(0.0, 0.0, 0.0)
STILL = Path((TurnSegment(Pose2(0.2, -0.1, 0.3), 2.0),))


def gears(*parts, start=ORIGIN):
    """Return a path of consecutive drives (length, curvature, sign) and turns (turn,)."""
    pose, segments = start, []
    for part in parts:
        if len(part) == 1:
            segments.append(TurnSegment(pose, part[0]))
            pose = segments[-1].end
        else:
            length, curvature, sign = part
            spline = ClothoidSpline(pose, [0.0, length], [curvature, curvature], sign)
            segments.append(ClothoidSegment(spline))
            pose = spline.end
    return Path(tuple(segments))


ROUTE = gears((1.0, 0.4, 1), (-2.5,), (0.8, 0.0, -1), (1.0,), (1.2, 0.0, 1))


def problem_of(path, limits=LIMITS, zone=NO_ZONE, *, turns=True, **options):
    robot = Robot(BOX, limits, turns_in_place=turns)
    dock = Dock(path.end, approach_speed=zone.speed, approach_distance=zone.distance, **options.pop("dock", {}))
    return DockingProblem(path.start, dock, robot, **options)


def timed(path, limits=LIMITS, zone=NO_ZONE, method=NearOptimal):
    result = method().parameterize(path, limits, zone)
    assert result.status is TimingStatus.OK, result.reason
    return result.trajectory


def kinds(verdict):
    return [violation.kind for violation in verdict.violations]


# The segment and its path.


def test_turn_is_a_stretch_of_the_path_coordinate():
    turn = TurnSegment(Pose2(1.0, 2.0, 0.5), -3.0)
    assert (turn.length, turn.direction) == (3.0, Direction.IN_PLACE)
    np.testing.assert_allclose(turn.poses_at([-1.0, 0.0, 1.5, 3.0, 9.0])[:, 2], [0.5, 0.5, -1.0, -2.5, -2.5])
    np.testing.assert_array_equal(turn.poses_at([0.0, 2.0])[:, :2], [[1.0, 2.0]] * 2)
    assert turn.end == Pose2(1.0, 2.0, -2.5)
    # Its curvature is what its poses turn per s.
    s = np.linspace(0.0, 3.0, 50)
    np.testing.assert_allclose(np.gradient(turn.poses_at(s)[:, 2], s), turn.curvature_at(s), rtol=1e-9)


@pytest.mark.parametrize("turn", [0.0, math.nan, math.inf, 2e6, "1", True])
def test_invalid_turns_are_rejected(turn):
    with pytest.raises(InvalidValue, match="path: a turn"):
        TurnSegment(ORIGIN, turn)


def test_poses_are_not_driven_in_place():
    with pytest.raises(InvalidValue, match="forward or in reverse; see TurnSegment"):
        PolylineSegment([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]], Direction.IN_PLACE)


def test_driven_distances_exclude_turns():
    assert ROUTE.length == pytest.approx(3.0 + 3.5)
    assert ROUTE.driven == pytest.approx(3.0)
    assert ROUTE.turns
    np.testing.assert_allclose(driven_stretches(ROUTE), [(0.0, 1.0), (3.5, 4.3), (5.3, 6.5)])
    for left, s in ((0.0, 6.5), (1.2, 5.3), (1.5, 4.0), (2.0, 3.5), (2.5, 0.5), (3.0, 0.0)):
        assert place_before_end(ROUTE, left) == pytest.approx(s)
    assert place_before_end(ROUTE, 4.0) < 0.0
    first, turn, second, again, third = parts_between_turns(ROUTE)
    assert (turn, again) == (ROUTE.segments[1], ROUTE.segments[3])
    assert [part.segments for part in (first, second, third)] == [(s,) for s in ROUTE.segments[::2]]
    assert ROUTE.sample(0.02).direction.tolist().count(0) == pytest.approx(3.5 / 0.02, abs=4)


# The robot.


def test_turning_in_place_needs_a_differential_drive_and_limits():
    with pytest.raises(InvalidValue, match="drive: ackermann cannot"):
        Robot(BOX, LIMITS, Drive.ACKERMANN, turns_in_place=True)
    with pytest.raises(InvalidValue, match="turns_in_place: must be a bool"):
        Robot(BOX, LIMITS, turns_in_place=1)
    for limits in (MotionLimits(), MotionLimits(max_yaw_rate=1.0), MotionLimits(max_yaw_acceleration=1.0)):
        with pytest.raises(
            InvalidValue, match="turns_in_place: needs limits: max_yaw_rate and max_yaw_acceleration, or"
        ):
            Robot(BOX, limits, turns_in_place=True)
    wheels = MotionLimits(max_wheel_speed=0.5, track_width=0.5)
    assert Robot(BOX, wheels, turns_in_place=True).limits.turning == pytest.approx((2.0, 2.0, 20.0 / 3.0))


def test_digests_without_turns_in_place_are_unchanged():
    assert Robot(BOX, LIMITS).fingerprint == Robot(BOX, LIMITS, turns_in_place=False).fingerprint
    assert Robot(BOX, LIMITS).fingerprint.limits != Robot(BOX, LIMITS, turns_in_place=True).fingerprint.limits


@settings(max_examples=25)
@given(
    st.floats(0.1, 2.0),
    st.floats(0.1, 2.0),
    st.floats(0.5, 5.0),
    st.floats(0.2, 3.0),
    st.floats(0.2, 3.0),
    st.floats(0.1, 1.0),
)
def test_wheels_of_a_turn_do_no_more_than_straight_on(up, down, jerk, rate, yaw, track):
    limits = MotionLimits(1.0, 1.0, up, down, jerk, rate, yaw, math.inf, 0.7, track)
    lever, most = 0.5 * track, limits.turning
    assert most.rate * lever <= 0.7 * (1.0 + 1e-12)
    assert most.acceleration * lever <= min(up, down) * (1.0 + 1e-12)
    assert most.jerk * lever <= jerk * (1.0 + 1e-12)
    assert most.rate <= rate
    assert most.acceleration <= yaw


# The proof of the path.


def test_turn_is_certified_for_robots_that_turn_in_place_only():
    assert certify_path(ROUTE, problem_of(ROUTE)).certified
    assert kinds(certify_path(ROUTE, problem_of(ROUTE, turns=False))) == ["turn", "turn"]
    free = dataclasses.replace(LIMITS, max_curvature=math.inf)
    assert kinds(certify_path(ROUTE, problem_of(ROUTE, free, turns=False))) == ["turn", "turn"]


def test_turn_beside_the_dock_must_leave_the_final_straight():
    last = gears((1.0, 0.0, 1), (0.5,))
    assert certify_path(last, problem_of(last)).certified
    assert kinds(certify_path(last, problem_of(last, dock={"final_straight": 0.3}))) == ["final_straight"]
    # Also a turn whose stretch is longer than the straight, or that is too small to be seen.
    for turn in (3.0, 1e-3, 1e-5, 2.0 * math.pi):
        path = gears((1.0, 0.0, 1), (turn,))
        found = certify_path(path, problem_of(path, dock={"final_straight": 0.3})).violations
        assert [violation.message for violation in found] == [
            "the last gear is 0.000 m long, the final straight needs 0.300 m"
        ]


def test_gear_into_the_dock_is_the_last_that_drives():
    path = gears((1.0, 0.0, -1), (0.5,))
    assert certify_path(path, problem_of(path, dock={"direction": "backward"})).certified
    assert kinds(certify_path(path, problem_of(path, dock={"direction": "forward"}))) == ["direction"]
    assert certify_path(STILL, problem_of(STILL, dock={"direction": "backward"})).certified


def test_robot_in_motion_does_not_begin_with_a_turn():
    path = gears((0.5,), (1.0, 0.0, 1))
    assert kinds(certify_path(path, problem_of(path, start_speed=0.1))) == ["turn"]
    result = NearOptimal().parameterize(path, LIMITS, SpeedZone(), start_speed=0.1)
    assert result.status is TimingStatus.FAIL
    assert "turns in place at s = 0 m, where the robot moves at 0.1 m/s" in result.reason
    assert certify_path(path, problem_of(path, start_curvature=0.7)).certified  # nothing is steered at rest


def test_a_start_with_an_acceleration_does_not_begin_with_a_turn():
    path = gears((0.5,), (1.0, 0.0, 1))
    assert kinds(certify_path(path, problem_of(path, start_acceleration=0.2))) == ["turn"]


def test_a_turn_must_begin_where_the_gear_before_it_ends():
    first = gears((1.0, 0.0, 1)).segments[0]
    for pose in (Pose2(1.0, 2e-6, 0.0), Pose2(1.0, 0.0, 2e-6)):
        path = Path((first, TurnSegment(pose, 1.0)))
        assert "joint" in kinds(certify_path(path, problem_of(path)))


@pytest.mark.parametrize("turn", [2.0 * math.pi, -4.0, 0.7, -0.05])
@pytest.mark.parametrize("thin", [1e-3, 1e-6])
def test_a_thin_obstacle_in_the_swept_turn_is_found(turn, thin):
    """Only the corner sweeps over the needle, at the middle of the turn."""
    path = Path((TurnSegment(ORIGIN, turn),))
    corner = math.atan2(0.2, 0.5) * (1.0 if turn > 0.0 else -1.0)
    at = 0.5 * turn + corner
    for radius, certified in ((CORNER - 1e-5, False), (CORNER + 1e-5, True)):
        along = np.array([math.cos(at), math.sin(at)])
        aside = np.array([-along[1], along[0]])
        needle = [radius * along - thin * aside, radius * along + thin * aside, (radius + 1e-3) * along]
        problem = problem_of(path, obstacles=[needle], clearance=0.0)
        assert certify_path(path, problem).certified is certified


@pytest.mark.parametrize("turn", [1.2, -1.2, 2.0 * math.pi])
@pytest.mark.parametrize("share", [0.1, 0.37, 0.93])
def test_an_arm_that_swings_around_a_needle_is_found(turn, share):
    """The tip of the arm moves on a circle towards the needle inside it, which its tangent misses."""
    arm = Footprint([(1.0, 0.0), (1.5, 0.3), (1.5, -0.3)])
    path = Path((TurnSegment(ORIGIN, turn),))
    along = np.array([math.cos(share * turn), math.sin(share * turn)])
    aside = 1e-6 * np.array([-along[1], along[0]])
    for reach, certified in ((1.0 + 5e-5, False), (1.0 - 1e-5, True)):
        needle = [0.9 * along, reach * along + aside, reach * along - aside]
        problem = dataclasses.replace(
            problem_of(path, obstacles=[needle], clearance=0.0), robot=Robot(arm, LIMITS, turns_in_place=True)
        )
        assert certify_path(path, problem).certified is certified


@settings(max_examples=12)
@given(
    st.floats(-7.0, 7.0).filter(lambda x: abs(x) > 1e-3), st.floats(0.0, 6.28), st.floats(0.2, 0.9), st.floats(0.0, 0.1)
)
def test_a_proven_clearance_is_that_of_the_swept_turn(turn, bearing, radius, size):
    """Compared with many rotated outlines by shapely: below the true clearance by at most the sharpness."""
    place = radius * np.array([math.cos(bearing), math.sin(bearing)])
    rock = place + (size + 1e-3) * np.array([[1.0, 0.0], [-0.5, 0.8], [-0.5, -0.8]])
    path = Path((TurnSegment(ORIGIN, turn),))
    certificate = certify_path(path, problem_of(path, obstacles=[rock], clearance=0.0))
    yaws = np.linspace(0.0, turn, 700)
    c, s = np.cos(yaws), np.sin(yaws)
    outlines = np.einsum("nij,kj->nki", np.array([[c, -s], [s, c]]).transpose(2, 0, 1), BOX.vertices)
    truth = float(shapely.distance(shapely.polygons(outlines), shapely.Polygon(rock)).min())
    reach = CORNER * abs(turn) / 700  # of any point between two of them
    if certificate.certified:
        assert certificate.min_clearance <= truth + 1e-9
        assert certificate.min_clearance >= truth - reach - 2e-3
        assert truth >= 0.0
    else:
        assert truth <= reach + 1e-5


def test_a_dense_check_agrees_and_rejects_turns_of_other_robots():
    wall = [[[2.6, -1.0], [2.8, -1.0], [2.8, 1.0], [2.6, 1.0]]]
    problem = problem_of(ROUTE, obstacles=wall)
    certificate, report = certify_path(ROUTE, problem), dense_check(ROUTE, problem)
    assert certificate.certified
    assert report.faults == ()
    assert report.min_clearance == pytest.approx(certificate.min_clearance, abs=2e-3)
    assert report.length == pytest.approx(certificate.length) == pytest.approx(3.0)
    assert {fault.bound for fault in dense_check(ROUTE, problem_of(ROUTE, turns=False)).faults} == {"turn"}


def test_many_tiny_turns_are_turns():
    path = gears((1.0, 0.0, 1), *[(1e-4,)] * 20)
    assert certify_path(path, problem_of(path)).certified
    assert kinds(certify_path(path, problem_of(path, turns=False))) == ["turn"] * 20
    motion = timed(path)
    assert certify_trajectory(motion, LIMITS, SpeedZone()).certified


# The time law and its proof.


def jerk_limited(turn, rate, acceleration, jerk):
    """Return the least duration of a turn from rest to rest, in closed form."""
    ramp = min(acceleration, math.sqrt(rate * jerk))
    if turn >= rate * rate / ramp + rate * ramp / jerk:
        return turn / rate + rate / ramp + ramp / jerk
    if turn >= 2.0 * acceleration**3 / jerk**2:
        top = 0.5 * (-(acceleration**2) / jerk + math.sqrt((acceleration**2 / jerk) ** 2 + 4.0 * acceleration * turn))
        return 2.0 * (top / acceleration + acceleration / jerk)
    return 4.0 * (turn / (2.0 * jerk)) ** (1.0 / 3.0)


@pytest.mark.parametrize("method", [NearOptimal, Windowed])
@pytest.mark.parametrize("turn", [1e-6, 0.05, -0.6, 4.0 * math.pi])
def test_a_turn_takes_the_least_time(turn, method):
    motion = timed(Path((TurnSegment(ORIGIN, turn),)), method=method)
    assert motion.duration == pytest.approx(jerk_limited(abs(turn), *LIMITS.turning), rel=1e-9)


@pytest.mark.parametrize("method", [NearOptimal, Windowed])
@pytest.mark.parametrize("seed", range(2))
def test_every_limit_is_kept_at_every_millisecond(seed, method):
    """Yaw acceleration and jerk by finite differences of the sampled yaw rate."""
    rng = np.random.default_rng(seed)
    limits = MotionLimits(
        *rng.uniform(0.3, 0.8, 4), rng.uniform(1.0, 4.0), rng.uniform(0.4, 1.5), rng.uniform(0.5, 2.0), track_width=0.4
    )
    drives = [(rng.uniform(0.3, 1.2), rng.uniform(-1.0, 1.0), int(rng.choice((-1, 1)))) for _ in range(3)]
    path = gears(*itertools.chain.from_iterable((drive, (rng.uniform(-3.0, 3.0),)) for drive in drives))
    zone = SpeedZone(0.1, 0.5)
    motion = timed(path, limits, zone, method)
    proof = certify_trajectory(motion, limits, zone, start_speed=0.0, start_acceleration=0.0)
    assert proof.certified, proof.violations
    t = np.arange(0.0, motion.duration, 1e-3)
    row = motion.sample_at(t)
    turning = path.direction_at(row.s) == 0
    most = limits.turning
    assert np.abs(row.yaw_rate[turning]).max() <= most.rate * (1.0 + 1e-6)
    assert np.abs(row.yaw_acceleration[turning]).max() <= most.acceleration * (1.0 + 1e-6)
    both = turning[1:] & turning[:-1]
    assert (np.abs(np.diff(row.yaw_acceleration)) / 1e-3)[both].max() <= most.jerk * (1.0 + 1e-6)
    np.testing.assert_allclose(np.diff(row.yaw) / 1e-3, 0.5 * (row.yaw_rate[1:] + row.yaw_rate[:-1]), atol=1e-5)
    np.testing.assert_array_equal(row.speed[turning], 0.0)
    assert np.ptp(row.x[turning & (row.s > path.cusps[-1])]) == 0.0
    assert np.abs(row.yaw_rate[~turning]).max() <= limits.max_yaw_rate * (1.0 + 1e-6)
    assert proof.ratios["yaw_jerk"] == pytest.approx(1.0)
    # The slow stretch is that of the last half metre driven, the turn at the end left out.
    left = np.concatenate((np.cumsum((np.abs(row.speed) * 1e-3)[::-1])[::-1], [0.0]))[1:]
    assert np.abs(row.speed[left < 0.49]).max() <= 0.1 * (1.0 + 1e-6)


@pytest.mark.parametrize(
    ("name", "value", "broken"),
    [
        ("max_yaw_rate", 0.7, {"yaw_rate"}),
        ("max_yaw_acceleration", 1.4, {"yaw_acceleration", "yaw_jerk"}),
        ("max_jerk", 1.9, {"jerk", "yaw_jerk"}),
    ],
)
def test_each_limit_of_a_turn_is_proven(name, value, broken):
    motion = timed(ROUTE)
    assert certify_motion(motion, problem_of(ROUTE)).certified
    found = certify_trajectory(motion, dataclasses.replace(LIMITS, **{name: value}), SpeedZone())
    assert set(kinds(found)) == broken
    wheels = dataclasses.replace(LIMITS, max_wheel_speed=0.51, track_width=2.0)
    assert "yaw_rate" in kinds(certify_trajectory(motion, wheels, SpeedZone()))


def test_robot_rests_before_and_behind_a_turn():
    path = gears((1.0, 0.0, 1), (1.0,), (1.0, 0.0, 1))
    law = timed(Path((gears((3.0, 0.0, 1)).segments[0],)), dataclasses.replace(LIMITS, max_speed=0.4)).time_law
    found = certify_trajectory(Trajectory(path, law), LIMITS, SpeedZone())
    assert kinds(found).count("rest") == 2
    wait = TimeLaw([*timed(path).time_law.durations, 1.0], [*timed(path).time_law.jerks, 0.0])
    assert certify_trajectory(Trajectory(path, wait), LIMITS, SpeedZone()).certified


def test_limits_of_driving_do_not_bind_a_turn_nor_those_of_turning_a_drive():
    """Path speeds in a turn are yaw rates: above every speed limit here, and unaffected by the speed zone."""
    limits = MotionLimits(0.2, 0.2, 0.1, 0.1, 1.0, max_yaw_rate=3.0, max_yaw_acceleration=5.0, max_wheel_speed=0.3)
    motion = timed(ROUTE, limits, SpeedZone(0.05, 10.0))
    proof = certify_trajectory(motion, limits, SpeedZone(0.05, 10.0))
    assert proof.certified
    assert np.abs(motion.sample(0.01).yaw_rate).max() > 1.0
    assert np.abs(motion.sample(0.01).speed).max() == pytest.approx(0.05, rel=0.02)


def test_turns_without_limits_cannot_be_timed():
    for limits in (MotionLimits(), MotionLimits(max_yaw_rate=1.0)):
        result = NearOptimal().parameterize(ROUTE, limits, SpeedZone())
        assert result.status is TimingStatus.FAIL
        assert "requires the limits max_yaw_rate and max_yaw_acceleration" in result.reason
    slow = dataclasses.replace(LIMITS, max_yaw_rate=1e-4)
    assert "takes more than 3600 s" in NearOptimal().parameterize(STILL, slow, SpeedZone()).reason


# The file, the drive, the picture.


def plan_of(path=ROUTE, **options):
    problem = problem_of(path, **options)
    return DockPlan(prove_motion(Trajectory(path, timed(path).time_law), problem), path)


def test_plan_file_holds_turns_exactly(tmp_path):
    plan = plan_of()
    plan.save(tmp_path / "plan.json")
    document = json.loads((tmp_path / "plan.json").read_text())
    assert document["path"]["segments"][1] == {"start": [*ROUTE.segments[1].pose.as_array()], "turn": -2.5}
    assert sorted(set(document["path"]["direction"])) == [-1, 0, 1]
    back = DockPlan.load(tmp_path / "plan.json", plan.problem)
    assert back.path.digest == ROUTE.digest
    assert load_plan(tmp_path / "plan.json").trajectory is not None
    again = Path(tuple(TurnSegment(s.pose, s.turn) if isinstance(s, TurnSegment) else s for s in ROUTE.segments))
    assert again.digest == ROUTE.digest
    assert gears((1.0, 0.4, 1), (-2.4,)).digest != gears((1.0, 0.4, 1), (-2.5,)).digest


def test_samples_that_differ_from_their_turn_are_rejected(tmp_path):
    save_plan(tmp_path / "plan.json", PlanFile(path=ROUTE, raw_path=ROUTE))
    document = json.loads((tmp_path / "plan.json").read_text())
    at = document["path"]["direction"].index(0) + 20
    document["path"]["yaw"][at] += 1e-3
    (tmp_path / "off.json").write_text(json.dumps(document))
    with pytest.raises(InvalidFile, match="rad off the segments"):
        load_plan(tmp_path / "off.json")


def test_samples_of_a_turn_are_those_of_its_phases():
    plan = plan_of()
    motion = TrajectoryColumns.from_trajectory(plan.trajectory, 0.02)
    assert not check_samples_of(plan.trajectory, motion, plan.problem).refuted
    bent = motion._replace(yaw_rate=motion.yaw_rate * 1.01)
    assert check_samples_of(plan.trajectory, bent, plan.problem).refuted


@settings(max_examples=15)
@given(
    st.lists(
        st.one_of(
            st.tuples(st.floats(-6.0, 6.0).filter(lambda turn: abs(turn) > 1e-3)),
            st.tuples(st.floats(0.05, 1.5), st.floats(-1.5, 1.5), st.sampled_from((1, -1))),
        ),
        min_size=1,
        max_size=6,
    ),
    st.floats(0.005, 0.3),
    st.sampled_from([None, 9, 6, 5, 4]),
)
def test_samples_of_a_motion_that_turns_refute_nothing(parts, period, decimals):
    path = gears(*parts)
    zone = SpeedZone(0.1, 0.4)
    motion = TrajectoryColumns.from_trajectory(timed(path, zone=zone), period)
    if decimals is not None:
        motion = TrajectoryColumns(motion.t, *(np.round(column, decimals) for column in motion[1:]))
    found = check_sampled_motion(motion, path, problem_of(path, zone=zone))
    assert [violation.message for violation in found.violations] == []


def lie(name, change):
    return lambda motion, turning: motion._replace(
        **{name: np.where(turning, change(getattr(motion, name)), getattr(motion, name))}
    )


LIES = {
    "yaw rate": lie("yaw_rate", lambda w: 1.2 * w),
    "yaw acceleration": lie("yaw_acceleration", lambda a: 1.2 * a),
    "yaw": lie("yaw", lambda yaw: yaw + 0.01),
    "place": lie("x", lambda x: x + 0.005),
    "speed": lie("speed", lambda v: v + 1e-3),
    "the other way": lie("yaw_rate", lambda w: -w),
    "in a hurry": lambda motion, turning: motion._replace(
        t=np.concatenate(([0.0], np.cumsum(np.diff(motion.t) * np.where(turning[1:], 0.8, 1.0))))
    ),
    "cut short": lambda motion, turning: TrajectoryColumns(
        *(column[: np.flatnonzero(turning)[-20]] for column in motion)
    ),
}


@pytest.mark.parametrize("name", sorted(LIES))
@pytest.mark.parametrize("path", [ROUTE, STILL], ids=["route", "still"])
def test_wrong_samples_of_a_turn_are_refuted(name, path):
    honest = TrajectoryColumns.from_trajectory(timed(path), 0.02)
    turning = np.abs(honest.yaw_rate) > 2.0 * np.abs(honest.speed) + 1e-3
    assert not check_sampled_motion(honest, path, problem_of(path)).refuted
    assert check_sampled_motion(LIES[name](honest, turning), path, problem_of(path)).refuted


def test_motion_that_leaves_out_a_turn_is_refuted():
    straight = gears((1.0, 0.0, 1), (2.0 * math.pi,), (1.0, 0.0, 1))
    without = gears((1.0, 0.0, 1), (1.0, 0.0, 1))
    motion = TrajectoryColumns.from_trajectory(timed(without), 0.02)
    found = check_sampled_motion(motion, straight, problem_of(straight))
    assert (
        "the motion drives forward; the path drives forward, turns left, drives forward" in found.violations[0].message
    )


@pytest.mark.parametrize("path", [STILL, gears((0.7,), (1.0, 0.4, 1), (-0.7,), (0.5, 0.0, -1))])
def test_tracking_controller_drives_turns(path):
    plan = plan_of(path)
    checker = create_plugin(GoalChecker, "SimpleGoalChecker", {"xy_goal_tolerance": 0.01, "yaw_goal_tolerance": 0.01})
    controller = create_plugin(Controller, "TrackingController")
    run = run_closed_loop(plan.trajectory, plan.problem.robot, path.end, controller, checker)
    assert run.docked, run.reason
    off = np.abs(run.poses - run.references)
    assert off[:, :2].max() < 0.01
    driving = run.times < plan.trajectory.duration - 0.5
    assert off[driving, 2].max() < 0.01
    assert run.times[-1] < plan.trajectory.duration + 0.5


def test_the_reference_waits_for_a_slow_turn():
    """For a robot that turns at half the rate the reference slows down."""
    path = gears((3.0,))
    plan = plan_of(path)
    slow = Robot(BOX, dataclasses.replace(LIMITS, max_yaw_rate=0.4), turns_in_place=True)
    checker = create_plugin(GoalChecker, "SimpleGoalChecker", {"xy_goal_tolerance": 0.01, "yaw_goal_tolerance": 0.01})
    run = run_closed_loop(plan.trajectory, slow, path.end, create_plugin(Controller, "TrackingController"), checker)
    assert run.docked, run.reason
    assert run.times[-1] > 3.0 / 0.4


def test_turns_are_drawn(tmp_path):
    plan = plan_of(gears((0.3, 0.0, 1), (0.7,)))
    plan.plot(tmp_path / "plan.png")
    save_profile_picture(tmp_path / "profile.png", plan.trajectory, LIMITS, SpeedZone(0.1, 0.3))
    assert (tmp_path / "plan.png").stat().st_size > 10_000


def test_path_of_other_segments_is_still_refused():
    with pytest.raises(InvalidPath, match="or a TurnSegment, got Turn"):
        Path((type("Turn", (TurnSegment,), {})(ORIGIN, 1.0),))
