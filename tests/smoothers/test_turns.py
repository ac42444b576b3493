"""Paths that turn in place: pieces smoothed between the turns, one certificate of the whole."""

import dataclasses
import math

import numpy as np
import pytest

from optdock.errors import FailedToSmoothPath, SmootherTimedOut
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.model.clearance_rule import ClearanceRule
from optdock.model.dock import Dock
from optdock.model.limits import MotionLimits
from optdock.model.path import ClothoidSegment, Direction, Path, PolylineSegment, TurnSegment
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from optdock.plugins.interfaces import PluginContext, SmoothingStatus
from optdock.verification import certify_path
from smoothers import CasadiSmoother

LIMITS = MotionLimits(max_curvature=1.5, max_curvature_rate=6.0, max_yaw_rate=0.8, max_yaw_acceleration=1.5)
ROBOT = Robot(Footprint.rectangle(0.45, 0.45, 0.6), LIMITS, turns_in_place=True)
CORNER = math.hypot(0.45, 0.3)
RULE = ClearanceRule(0.05, 0.0, 0.5)


def box(x0, y0, x1, y1):
    return np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]], dtype=float)


def drive(pose, *steps, gear=Direction.FORWARD):
    """A polyline that begins at a pose, through points seen from it, with the heading of each step."""
    sign = float(gear)
    points = np.array([(0.0, 0.0), *steps], dtype=float)
    along = sign * np.diff(points, axis=0)
    yaw = np.arctan2(along[:, 1], along[:, 0])
    local = [(*points[0], yaw[0])]
    for a, b, heading in zip(points[:-1], points[1:], yaw, strict=True):
        local += [(*(a + share * (b - a)), heading) for share in np.linspace(0.1, 1.0, 10)]
    x, y, heading = np.array(local).T
    c, s = math.cos(pose.yaw), math.sin(pose.yaw)
    poses = np.column_stack((pose.x + c * x - s * y, pose.y + s * x + c * y, pose.yaw + heading))
    return PolylineSegment(poses, gear)


def chained(start, *parts):
    """A path of turns [rad] and drives (as the arguments of `drive`)."""
    pose, segments = start, []
    for part in parts:
        segments.append(TurnSegment(pose, part) if isinstance(part, float) else drive(pose, *part))
        last = segments[-1]
        pose = Pose2.from_sequence(last.poses_at(last.length)[0])
    return Path(tuple(segments))


def problem_of(path, obstacles=(), *, straight=0.3, robot=ROBOT, **options):
    return DockingProblem(path.start, Dock(path.end, final_straight=straight), robot, obstacles, RULE, **options)


def smoothed(path, problem, seconds=5.0, **options):
    smoother = CasadiSmoother()
    smoother.configure(PluginContext(problem=problem))
    return smoother.smooth(path, seconds, problem=problem, **options)


STRAIGHT = chained(Pose2(0.0, 0.0, 0.4), 1.1, [(1.2, 0.0)], -2.0, [(1.5, 0.0)])
BENT = chained(Pose2(0.0, 0.0, 0.0), [(1.0, 0.0), (1.6, 0.6)], -2.2, [(0.7, 0.0), (1.8, 0.25), (2.4, 0.25)])


def test_straight_pieces_between_turns_are_kept():
    problem = problem_of(STRAIGHT)
    found = smoothed(STRAIGHT, problem)
    assert found.report.status is SmoothingStatus.INPUT_KEPT
    assert [segment.length for segment in found.path.segments] == pytest.approx([1.1, 1.2, 2.0, 1.5], abs=1e-9)
    assert all(np.all(one.spline.curvature == 0.0) for one in found.path.segments if isinstance(one, ClothoidSegment))
    assert certify_path(found.path, problem).certified


def test_other_pieces_are_smoothed_and_turns_stay_where_they_are():
    problem = problem_of(BENT)
    assert not certify_path(BENT, problem).certified  # its corners
    found = smoothed(BENT, problem)
    assert found.report.status is SmoothingStatus.CONVERGED
    first, turn, second = found.path.segments
    assert isinstance(first, ClothoidSegment)
    assert isinstance(second, ClothoidSegment)
    assert turn.turn == pytest.approx(-2.2, abs=1e-6)
    assert turn.pose.gap_to(BENT.segments[1].pose) < 1e-6
    assert certify_path(found.path, problem).certified


def test_the_curvature_is_free_at_turns_and_fixed_at_the_start():
    steered = smoothed(BENT, problem_of(BENT, start_curvature=0.3)).path
    assert steered.curvature_at(0.0)[0] == pytest.approx(0.3, abs=1e-9)
    curve = chained(Pose2(0.0, 0.0, 0.0), 0.5, [(0.5, 0.05), (1.0, 0.2), (1.5, 0.45)])
    turned = smoothed(curve, problem_of(curve, straight=0.0, start_curvature=0.3)).path
    assert isinstance(turned.segments[0], TurnSegment)
    assert abs(turned.segments[1].curvature_at(0.0)[0] - 0.3) > 1e-3


def test_the_ends_of_the_result_are_those_of_the_problem():
    """The first turn begins as the robot stands, and still ends in the heading of the raw path."""
    problem = problem_of(STRAIGHT).starting_at(Pose2(0.03, -0.02, 0.3))
    path = smoothed(STRAIGHT, problem).path
    assert path.start.gap_to(problem.start) == 0.0
    assert path.segments[0].end.yaw == pytest.approx(1.5)
    assert certify_path(path, problem).certified
    goal = Pose2(STRAIGHT.end.x + 0.04, STRAIGHT.end.y, STRAIGHT.end.yaw + 0.05)
    moved = dataclasses.replace(problem, dock=Dock(goal, final_straight=0.3))
    assert certify_path(smoothed(STRAIGHT, moved).path, moved).certified
    # With a turn as its last part, the goal's heading ends that one.
    last = chained(Pose2(0.0, 0.0, 0.0), [(1.0, 0.0)], 0.8)
    other = problem_of(last, straight=0.0)
    other = dataclasses.replace(other, dock=Dock(Pose2(1.05, 0.02, 0.9)))
    path = smoothed(last, other).path
    assert path.segments[-1].turn == pytest.approx(0.9, abs=1e-6)
    assert certify_path(path, other).certified


def test_a_straight_piece_in_the_way_of_an_obstacle_is_bent():
    post = box(0.85, 0.32, 0.95, 0.42)
    raw = chained(Pose2(0.0, 0.0, 0.0), [(2.0, 0.0)], 1.0, [(1.2, 0.0)])
    problem = problem_of(raw, [post])
    found = smoothed(raw, problem)
    assert np.abs(found.path.segments[0].spline.curvature).max() > 0.01
    assert certify_path(found.path, problem).certified


@pytest.mark.parametrize(
    ("path", "options", "word"),
    [
        (STRAIGHT, {"robot": dataclasses.replace(ROBOT, turns_in_place=False)}, "cannot turn in place"),
        (STRAIGHT, {"start_speed": 0.1}, "the robot moves at 0.1 m/s"),
        (chained(Pose2(0.0, 0.0, 0.0), [(1.0, 0.0)], 0.8), {}, "requires a final straight"),
    ],
)
def test_turns_that_cannot_be_are_refused_by_name(path, options, word):
    with pytest.raises(FailedToSmoothPath, match=word) as refused:
        smoothed(path, problem_of(path, **options))
    assert refused.value.where["reason"] == "turn"


def test_a_blocked_turn_is_refused_where_it_is():
    """A post at the radius of the corner: the drives before and after the turn have room, the turn has not."""
    raw = chained(Pose2(0.0, 0.0, 0.0), [(2.0, 0.0)], 1.6, [(2.0, 0.0)])
    angle = math.pi + math.atan2(0.3, 0.45) + 0.75  # beside both drives, in the way of the rear right corner alone
    for gap, fits in ((0.03, False), (0.06, True)):
        x, y = 2.0 + (CORNER + gap) * math.cos(angle), (CORNER + gap) * math.sin(angle)
        needle = [[x, y], [x + 1e-3 * math.cos(angle), y + 1e-3 * math.sin(angle)], [x + 1e-3, y + 1e-3]]
        problem = problem_of(raw, [needle])
        if fits:
            assert certify_path(smoothed(raw, problem).path, problem).certified
            continue
        with pytest.raises(FailedToSmoothPath, match="closer to obstacles") as refused:
            smoothed(raw, problem)
        assert refused.value.where["s"] == pytest.approx(2.75, abs=0.05)
        assert refused.value.where["amount"] == pytest.approx(0.02, abs=1e-3)


def test_the_clearance_tapers_at_the_dock_alone():
    """A turn ends a piece 2 cm from a wall: that is allowed at the goal, and nowhere else."""
    raw = chained(Pose2(0.0, 0.0, 0.0), [(2.0, 0.0)], math.pi, [(4.0, 0.0)])
    wall = box(2.0 + CORNER + 0.02, -1.0, 3.5, 1.0)
    with pytest.raises(FailedToSmoothPath, match="than required"):
        smoothed(raw, problem_of(raw, [wall]))
    parked = chained(Pose2(0.0, 0.0, 0.0), [(2.0, 0.0)])
    assert certify_path(smoothed(parked, problem_of(parked, [wall])).path, problem_of(parked, [wall])).certified


def test_a_refused_piece_is_reported_in_the_coordinates_of_the_path():
    raw = chained(Pose2(0.0, 0.0, 0.0), 1.0, [(1.5, 0.0), (3.0, 0.1)])
    x, y = 1.6 * math.cos(1.0), 1.6 * math.sin(1.0)
    problem = problem_of(raw, [box(x - 3.0, y - 0.2, x + 3.0, y + 0.2)])
    with pytest.raises(
        FailedToSmoothPath, match="of the piece between turns in place that begins at s = 1.000 m"
    ) as no:
        smoothed(raw, problem)
    assert no.value.where["s"] > 1.5
    assert no.value.partial.path is not None
    assert isinstance(no.value.partial.path.segments[0], TurnSegment)


def test_the_time_is_shared_and_kept():
    with pytest.raises(SmootherTimedOut):
        smoothed(BENT, problem_of(BENT), 1e-4)


def test_an_earlier_result_with_the_same_turns_begins_every_piece():
    problem = problem_of(BENT)
    cold = smoothed(BENT, problem)
    again = smoothed(BENT, problem, warm_start=cold.path)
    assert again.report.iterations <= cold.report.iterations
    assert certify_path(again.path, problem).certified


def lattice_plan():
    """A plan that turns in place in steps of a sixteenth of a turn, as lattice planners make them."""
    step = math.pi / 8.0
    ahead = [[x, 0.0, 0.0] for x in np.linspace(0.0, 1.2, 13)]
    around = [[1.2, 0.0, k * step] for k in range(1, 9)]
    back = [[x, 0.0, math.pi] for x in np.linspace(1.1, -0.3, 15)]
    return Path.from_poses(np.array([*ahead, *around, *back]))


def test_a_plan_that_turns_in_place_is_taken_at_its_word_where_the_robot_may():
    raw = lattice_plan()
    assert not raw.turns
    problem = problem_of(raw)
    path = smoothed(raw, problem).path
    assert [type(segment) for segment in path.segments] == [ClothoidSegment, TurnSegment, ClothoidSegment]
    assert path.segments[1].turn == pytest.approx(math.pi)
    assert certify_path(path, problem).certified
    other = problem_of(raw, robot=dataclasses.replace(ROBOT, turns_in_place=False))
    assert not smoothed(raw, other).path.turns


@pytest.mark.parametrize("turn", [0.2, -0.4])
def test_small_turns_within_a_polyline_are_part_of_a_curve(turn):
    raw = Path.from_poses(
        np.array(
            [
                [0.0, 0.0, 0.0],
                [1.0, 0.0, 0.0],
                [1.0, 0.0, turn],
                *([1.0 + s * math.cos(turn), s * math.sin(turn), turn] for s in np.linspace(0.1, 1.5, 15)),
            ]
        )
    )
    assert not smoothed(raw, problem_of(raw)).path.turns
