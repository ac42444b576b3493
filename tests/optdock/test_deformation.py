"""Laws of deformation: it closes the gap exactly, within the bounds, and changes nothing that need not change."""

from __future__ import annotations

import dataclasses
import math
import shutil

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from experiments.fuzz.kinds.kernels import replaced
from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.footprint import Footprint
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import Pose2
from optdock.geometry.separation import separation
from optdock.kernels import using_kernels
from optdock.model.dock import Dock
from optdock.model.limits import MotionLimits
from optdock.model.path import ClothoidSegment, Path, TurnSegment
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from optdock.planning.deformation import (
    Push,
    _contacts,
    _driven,
    _Gears,
    _moves,
    _Place,
    _pose_at,
    _Pushes,
    deformed,
    pushes_off,
)
from optdock.verification import compiled_clearances

LIMITS = MotionLimits(max_curvature=1.5, max_curvature_rate=6.0)
STRAIGHT = 0.3
needs_compiler = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
SMALL = st.tuples(st.floats(-0.06, 0.06), st.floats(-0.06, 0.06), st.floats(-0.06, 0.06))


ORIGIN = Pose2(0.0, 0.0, 0.0)


def s_curve(start=ORIGIN, sign=1):
    knots, curvature = [0.0, 0.4, 0.8, 1.2, 1.6, 2.0, 2.0 + STRAIGHT], [0.1, 0.8, 0.4, -0.5, -0.6, 0.0, 0.0]
    return ClothoidSegment(ClothoidSpline(start, np.array(knots), np.array(curvature), sign))


def two_gears():
    first = s_curve()
    back = Pose2.from_sequence(first.poses_at(first.length)[0])
    return Path((first, s_curve(back, -1)))


def with_a_turn():
    first = s_curve()
    turn = TurnSegment(Pose2.from_sequence(first.poses_at(first.length)[0]), 0.9)
    return Path((first, turn, s_curve(turn.end)))


PATHS = st.sampled_from([Path((s_curve(),)), Path((s_curve(sign=-1),)), two_gears(), with_a_turn()])


def assert_within(path):
    for segment in path.segments:
        if isinstance(segment, ClothoidSegment):
            assert np.abs(segment.spline.curvature).max() <= LIMITS.max_curvature
            assert np.abs(segment.spline.curvature_rates).max() <= LIMITS.max_curvature_rate


@settings(max_examples=25)
@given(PATHS, SMALL, SMALL)
def test_it_leads_from_the_start_to_the_goal_within_the_bounds_and_straight_at_the_end(path, at_start, at_goal):
    start, goal = path.start @ Pose2(*at_start), path.end @ Pose2(*at_goal)
    found = deformed(path, start, goal, LIMITS, final_straight=STRAIGHT)
    assert found.start.gap_to(start) <= 1e-9
    assert found.end.gap_to(goal) <= 1e-6
    assert [segment.direction for segment in found.segments] == [segment.direction for segment in path.segments]
    assert found.curvature_at(0.0)[0] == pytest.approx(path.curvature_at(0.0)[0], abs=1e-12)
    assert np.abs(found.curvature_at(np.linspace(found.length - STRAIGHT + 1e-6, found.length, 20))).max() <= 1e-12
    assert_within(found)


@settings(max_examples=25)
@given(PATHS)
def test_path_that_fits_is_not_changed(path):
    found = deformed(path, path.start, path.end, LIMITS, final_straight=STRAIGHT)
    s = np.linspace(0.0, path.length, 200)
    np.testing.assert_allclose(found.poses_at(s), path.poses_at(s), atol=1e-9)


@settings(max_examples=15)
@given(PATHS, SMALL, st.floats(-3.0, 3.0), SMALL)
def test_it_does_not_matter_where_the_world_has_its_origin(path, at_goal, turn, shift):
    move = Pose2(100.0 * shift[0], 100.0 * shift[1], turn)
    goal = path.end @ Pose2(*at_goal)
    here = deformed(path, path.start, goal, LIMITS, final_straight=STRAIGHT)
    there = deformed(path.moved(move), move @ path.start, move @ goal, LIMITS, final_straight=STRAIGHT)
    assert there.end.gap_to(move @ here.end) <= 1e-6
    assert there.length == pytest.approx(here.length, abs=1e-6)


def test_change_is_linear_while_it_is_small():
    path = Path((s_curve(),))
    s = np.linspace(0.0, 2.0, 50)
    one, two = (
        deformed(path, path.start, path.end @ Pose2(0.0, d, 0.0), LIMITS, final_straight=STRAIGHT).curvature_at(s)
        for d in (1e-3, 2e-3)
    )
    was = path.curvature_at(s)
    np.testing.assert_allclose(two - was, 2.0 * (one - was), atol=2e-4)


def test_push_moves_the_robot_off_and_the_end_stays():
    path, body = Path((s_curve(),)), Footprint.rectangle(0.4, 0.4, 0.6).bodies[0]
    beside = path.pose_at(1.0) @ Pose2(0.1, -0.42, 0.0)
    piece = ObstacleSet.from_polygons(
        [np.array([[0.1, 0.0], [0.0, 0.1], [-0.1, 0.0], [0.0, -0.1]]) + beside.as_array()[:2]]
    )
    push = Push(0, 1.0 / path.length, body, piece.pieces(np.array([0])), 0.06)

    def distance(found):
        return separation(body, found.poses_at(push.share * found.length), push.piece).distance[0]

    assert distance(path) < 0.04
    found = deformed(path, path.start, path.end, LIMITS, final_straight=STRAIGHT, pushes=[push])
    assert distance(found) >= 0.06 - 1e-4
    assert found.end.gap_to(path.end) <= 1e-6
    assert_within(found)
    idle = deformed(path, path.start, path.end, LIMITS, final_straight=STRAIGHT, pushes=[push._replace(distance=0.0)])
    assert idle.length == pytest.approx(path.length, abs=1e-9)


def test_at_speed_the_curvature_begins_to_change_as_fast_as_the_robot_can_turn():
    limits = MotionLimits(max_curvature=1.5, max_curvature_rate=60.0, max_yaw_acceleration=0.5, max_deceleration=0.3)
    path, speed = Path((s_curve(),)), 0.5
    goal = path.end @ Pose2(0.0, 0.15, 0.0)
    free, slow = (deformed(path, path.start, goal, limits, final_straight=STRAIGHT, speed=v) for v in (0.0, speed))
    most = max(0.8 * 0.5 / speed**2, abs(path.curvature_rate_at(0.0)[0]))
    assert abs(slow.curvature_rate_at(0.0)[0]) <= most + 1e-6
    assert slow.end.gap_to(goal) <= 1e-6
    assert free.end.gap_to(goal) <= 1e-6


def test_first_gear_keeps_the_room_for_braking():
    path = two_gears()
    goal = path.end @ Pose2(-0.1, 0.0, 0.0)
    free = deformed(path, path.start, goal, LIMITS, final_straight=STRAIGHT)
    kept = deformed(path, path.start, goal, LIMITS, final_straight=STRAIGHT, least=2.28)
    assert free.segments[0].length < 2.28 - 1e-3
    assert kept.segments[0].length >= 2.28 - 1e-9
    assert kept.end.gap_to(goal) <= 1e-6
    assert_within(kept)


def test_none_if_the_bounds_allow_no_path():
    path = Path((s_curve(),)).piece(1.4)
    assert deformed(path, path.start, path.end @ Pose2(0.0, 0.3, 0.0), LIMITS, final_straight=STRAIGHT) is None
    assert deformed(path.piece(0.7), path.pose_at(0.7), path.end, LIMITS, final_straight=STRAIGHT) is None
    lane = Path.from_poses([Pose2(0.0, 0.0, 0.0), Pose2(1.0, 0.0, 0.0)])
    assert deformed(lane, lane.start, lane.end, LIMITS) is None


def test_piece_of_a_path_is_that_path():
    for path in (two_gears(), with_a_turn(), Path.from_poses(two_gears().sample(0.05).poses)):
        for begin, end in ((0.0, path.length), (0.3, 3.0), (2.3, 3.1), (1.0, 1.2)):
            part = path.piece(begin, end)
            s = np.linspace(0.0, part.length, 60)[1:-1]
            np.testing.assert_allclose(part.poses_at(s), path.poses_at(s + begin), atol=1e-8)
            assert part.length == pytest.approx(end - begin, abs=1e-9)


def test_moved_path_has_moved_poses():
    move = Pose2(3.0, -1.0, math.pi / 3)
    for path in (two_gears(), with_a_turn(), Path.from_poses(two_gears().sample(0.05).poses)):
        s = np.linspace(0.0, path.length, 50)
        for pose, was in zip(path.moved(move).poses_at(s), path.poses_at(s), strict=True):
            assert Pose2.from_sequence(pose).gap_to(move @ Pose2.from_sequence(was)) <= 1e-9


def random_gears(rng):
    """Return gears and turns in place of any number, each gear with 2 to 6 knots, and a pose."""
    signs = rng.choice([-1.0, 0.0, 1.0], size=rng.integers(1, 5))
    counts = np.where(signs == 0.0, 0, rng.integers(2, 7, size=signs.size))
    steps = [np.append(0.0, rng.uniform(0.02, 0.4, size=count - 1)).cumsum() for count in counts if count]
    knots = np.concatenate([np.zeros(0), *steps])
    gears = _Gears(
        signs,
        np.where(signs == 0.0, 0.0, rng.choice([0.0, 0.3], size=signs.size)),
        np.where(signs == 0.0, rng.uniform(-3.0, 3.0, size=signs.size), 0.0),
        np.append(0, counts).cumsum(),
        knots,
        rng.uniform(-2.0, 2.0, size=knots.size) * rng.choice([0.0, 1.0]),
    )
    gears.curvature[gears.first[1:][gears.tails > 0.0] - 1] = 0.0  # before a straight line
    return gears, rng.uniform(-3.0, 3.0, size=3)


def place_at(gears, drive, gear, share, offset):
    """Return a point of the robot at a place."""
    pose, driven = _pose_at(gears, drive, gear, share)
    last = gears.first[gear + 1] - 1
    robot = drive.at_knots[last] if gears.signs[gear] and driven > gears.knots[last] else pose
    turned = np.array([[math.cos(pose[2]), -math.sin(pose[2])], [math.sin(pose[2]), math.cos(pose[2])]])
    return pose, _Place(tuple(pose[:2] + turned @ offset), gear, share, driven, tuple(robot[:2]))


def test_poses_are_those_of_the_exact_curves():
    rng = np.random.default_rng(1)
    for _ in range(40):
        gears, start = random_gears(rng)
        drive, path = _driven(gears, start), gears.path(Pose2(*start), "map")
        np.testing.assert_allclose(drive.borders[-1, :2], path.end.as_array()[:2], atol=1e-9)
        for gear, segment in enumerate(path.segments):
            share = rng.uniform()
            pose, _ = _pose_at(gears, drive, gear, share)
            np.testing.assert_allclose(pose, segment.poses_at(share * segment.length)[0], atol=1e-9)


def test_derivatives_are_those_of_finite_differences():
    rng, d = np.random.default_rng(2), 1e-6
    for _ in range(40):
        gears, start = random_gears(rng)
        drive, gear, offset = _driven(gears, start), int(rng.integers(gears.signs.size)), rng.uniform(-1.0, 1.0, size=2)
        share = 1.0 if gears.signs[gear] else rng.uniform()  # no piece is driven in part
        pose, place = place_at(gears, drive, gear, share, offset)
        moves = _moves(gears, drive, place)
        for i in range(gears.signs.size):
            first, last = gears.first[i : i + 2]
            for variable in range(first + i, last + i + 1):
                if variable == last + i - 1 and gears.tails[i] > 0.0:  # is fixed
                    continue
                knots, curvature, turns = gears.knots.copy(), gears.curvature.copy(), gears.turns.copy()
                if variable < last + i:
                    curvature[variable - i] += d
                elif gears.signs[i] == 0.0:
                    turns[i] += d
                else:
                    knots[first:last] *= math.exp(d)
                other = gears._replace(knots=knots, curvature=curvature, turns=turns)
                moved, at = place_at(other, _driven(other, start), gear, share, offset)
                change = np.array([*(np.array(at.point) - place.point), moved[2] - pose[2]]) / d
                np.testing.assert_allclose(moves[:, variable], change, atol=1e-4)


def random_push(rng, gears, gear, share):
    """Return a push of a random rectangle off a random polygon near the gears."""
    corners = rng.uniform(0.05, 0.5) * np.exp(2j * math.pi * np.sort(rng.uniform(size=rng.integers(3, 8))))
    outline = np.column_stack((corners.real, corners.imag)) + rng.uniform(-2.0, 2.0, size=2)
    body = Footprint.rectangle(*rng.uniform(0.2, 0.8, size=3)).bodies[0]
    piece = ObstacleSet.from_polygons([outline]).pieces(np.array([0]))
    return Push(gear, share, body, piece, rng.uniform(0.0, 0.2))


def test_contact_has_the_missing_clearance_and_its_derivatives():
    rng, d = np.random.default_rng(5), 1e-6
    for _ in range(40):
        gears, start = random_gears(rng)
        gear = int(rng.integers(gears.signs.size))
        push = random_push(rng, gears, gear, 1.0)  # no piece is driven in part
        drive = _driven(gears, start)
        pushes = _Pushes.of([push])
        contacts = _contacts(pushes, gears, drive)
        pose, _ = _pose_at(gears, drive, gear, 1.0)
        distance = separation(push.body, pose[None], push.piece).distance[0]
        assert contacts.short[0] == pytest.approx(push.distance - distance, abs=1e-9)
        for knot in range(int(gears.first[gear + 1])):
            owner = int(np.searchsorted(gears.first, knot, side="right")) - 1
            if knot == gears.first[owner + 1] - 1 and gears.tails[owner] > 0.0:  # is fixed
                continue
            curvature = gears.curvature.copy()
            curvature[knot] += d
            other = gears._replace(curvature=curvature)
            change = contacts.short[0] - _contacts(pushes, other, _driven(other, start)).short[0]
            assert contacts.moves[0, knot + owner] == pytest.approx(change / d, abs=1e-3)


def test_pushes_are_found_where_the_robot_is_too_close_and_suffice():
    path = Path((s_curve(),))
    beside = path.pose_at(1.0) @ Pose2(0.1, -0.42, 0.0)
    post = np.array([[0.1, 0.0], [0.0, 0.1], [-0.1, 0.0], [0.0, -0.1]]) + beside.as_array()[:2]
    robot = Robot(Footprint.rectangle(0.4, 0.4, 0.6), LIMITS)
    problem = DockingProblem(path.start, Dock(path.end, final_straight=STRAIGHT), robot, [post], clearance=0.05)
    pushes = pushes_off(path, problem)
    assert len(pushes) == 1
    s = np.linspace(0.0, path.length, 2000)
    distances = separation(robot.footprint.bodies[0], path.poses_at(s), problem.obstacles.pieces(np.zeros(2000, int)))
    nearest = s[np.argmin(distances.distance)]
    assert pushes[0].share * path.length == pytest.approx(nearest, abs=0.02)
    assert pushes_off(path, dataclasses.replace(problem, clearance=0.0)) == []
    found = deformed(path, path.start, path.end, LIMITS, final_straight=STRAIGHT, pushes=pushes)
    assert pushes_off(found, problem) == []
    along = [post + 0.05 * k * np.array([1.0, 0.2]) for k in range(-15, 15)]
    wall = dataclasses.replace(problem, obstacles=along)
    worst = pushes_off(path, wall)
    assert 1 < len(worst) <= 8
    s = np.array([push.share * path.length for push in worst])
    clearance, _ = compiled_clearances(path.poses_at(s), robot.footprint, wall.all_obstacles)
    assert np.all(np.diff(clearance) >= -1e-9)  # the closest ones first


@needs_compiler
def test_kernels_return_what_their_twins_do():
    rng = np.random.default_rng(3)
    assert replaced() == ""  # a kernel that differs in its first call is replaced by its twin
    with using_kernels("audit"):  # raises an error if they differ
        for _ in range(200):
            gears, start = random_gears(rng)
            gear, share = int(rng.integers(gears.signs.size)), float(rng.choice([0.0, 0.4, 1.0]))
            drive = _driven(gears, start)
            _moves(gears, drive, place_at(gears, drive, gear, share, np.array([0.3, -0.2]))[1])
            count = int(rng.integers(1, 4))
            _contacts(_Pushes.of([random_push(rng, gears, gear, share) for _ in range(count)]), gears, drive)


@needs_compiler
def test_kernels_reject_other_sizes():
    gears, start = random_gears(np.random.default_rng(4))
    with using_kernels("native"), pytest.raises(ValueError, match="elements"):
        _driven(gears._replace(tails=np.zeros(99)), start)
