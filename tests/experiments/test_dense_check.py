import dataclasses
import math

import numpy as np
import pytest

from experiments.dense_check import clearance_at, dense_check
from experiments.families import instance
from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.footprint import Footprint
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import Pose2, transform_points
from optdock.model.camera import Camera
from optdock.model.clearance_rule import ClearanceRule
from optdock.model.dock import Dock
from optdock.model.limits import MotionLimits
from optdock.model.path import ClothoidSegment, Path
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from optdock.verification import certify_path

START, GOAL = Pose2(0.0, 0.0, 0.0), Pose2(4.0, 0.0, 0.0)
ROBOT = Robot(Footprint.rectangle(0.5, 0.5, 0.6), MotionLimits(max_curvature=1.0, max_curvature_rate=4.0))


def straight_line():
    return Path((ClothoidSegment(ClothoidSpline(START, np.array([0.0, 4.0]), np.zeros(2))),))


def problem_with(*polygons, goal=GOAL, robot=ROBOT, clearance=None, straight=0.5):
    return DockingProblem(
        START,
        Dock(goal, final_straight=straight),
        robot,
        ObstacleSet.from_polygons(polygons),
        clearance or ClearanceRule(0.05, 0.0, 0.5),
    )


def box(x0, y0, x1, y1):
    return np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])


def bend(peak=0.8, ramp=0.5):
    """Return a left and a right bend, 4 m forward in total."""
    knots = np.cumsum([0.0, ramp, ramp, ramp, ramp, 2.0])
    return ClothoidSpline(START, knots, np.array([0.0, peak, 0.0, -peak, 0.0, 0.0]))


def test_distance_of_a_line_to_a_box():
    report = dense_check(straight_line(), problem_with(box(1.0, 0.42, 2.0, 1.0)))
    assert report.ok
    assert report.min_clearance == pytest.approx(0.12)
    assert report.worst_margin == pytest.approx(0.07)
    assert report.length == 4.0


@pytest.mark.parametrize(("gap", "broken"), [(0.0501, ()), (0.0499, ("clearance",)), (-0.1, ("clearance",))])
def test_clearance_rule(gap, broken):
    report = dense_check(straight_line(), problem_with(box(1.0, 0.3 + gap, 2.0, 1.0)))
    assert report.broken == broken
    assert report.worst_margin == pytest.approx(gap - 0.05) if gap > 0.0 else report.min_clearance < -0.05


def test_thin_post_is_found_by_fine_samples_only():
    thin = box(2.099, 0.2, 2.1, 0.31)
    robot = Robot(Footprint([[0.01, 0.3], [-0.01, 0.3], [-0.01, -0.3], [0.01, -0.3]]), ROBOT.limits)
    problem = problem_with(thin, robot=robot, clearance=ClearanceRule(0.0, 0.0, 0.0))
    assert dense_check(straight_line(), problem, step=0.4).ok
    assert dense_check(straight_line(), problem).broken == ("clearance",)


def test_required_clearance_grows_away_from_the_goal():
    # Nose to wall: at the distance d from the goal the clearance is 5 mm + d, the required one 0.05 d / 0.5.
    touching = problem_with(box(4.505, -1.0, 5.0, 1.0))
    assert dense_check(straight_line(), touching).ok
    beside = problem_with(box(3.9, 0.302, 4.6, 1.0))  # from 2 mm beside the robot at the goal on
    report = dense_check(straight_line(), beside)
    assert report.broken == ("clearance",)
    assert report.worst_s == pytest.approx(3.5 - 0.1, abs=0.01)


def test_start_that_is_too_close_may_leave():
    leaving = Path((ClothoidSegment(ClothoidSpline(START, np.array([0.0, 4.0]), np.zeros(2))),))
    behind = problem_with(box(-1.0, -0.5, -0.51, 0.5))
    assert dense_check(leaving, behind).ok
    along = problem_with(box(-1.0, 0.31, 3.0, 0.5))  # farther than twice its length
    assert dense_check(leaving, along).broken == ("clearance",)


@pytest.mark.parametrize(
    ("limits", "broken"),
    [
        ({}, ()),
        ({"max_curvature": 0.79}, ("curvature",)),
        ({"max_curvature_rate": 1.59}, ("curvature rate",)),
        ({"max_curvature": 0.8, "max_curvature_rate": 1.6}, ()),
    ],
)
def test_curvature_and_its_rate_are_measured(limits, broken):
    spline = bend()
    robot = Robot(ROBOT.footprint, dataclasses.replace(ROBOT.limits, **limits))
    report = dense_check(Path((ClothoidSegment(spline),)), problem_with(goal=spline.end, robot=robot))
    assert report.broken == broken
    assert report.max_curvature == pytest.approx(0.8, abs=0.01)
    assert report.max_curvature_rate == pytest.approx(1.6, rel=1e-6)


@pytest.mark.parametrize("gap", [(2e-5, 0.0, 0.0), (0.0, 2e-5, 0.0), (0.0, 0.0, 2e-5)])
def test_start_and_goal_poses(gap):
    assert "goal" in dense_check(straight_line(), problem_with(goal=GOAL @ Pose2(*gap))).broken
    moved = dataclasses.replace(problem_with(), start=START @ Pose2(*gap))
    assert dense_check(straight_line(), moved).broken == ("start",)
    assert dense_check(straight_line(), dataclasses.replace(problem_with(), start=Pose2(0.0, 0.0, 2.0 * math.pi))).ok


def test_final_straight():
    spline = bend()
    path = Path((ClothoidSegment(spline),))
    assert dense_check(path, problem_with(goal=spline.end, straight=1.99)).ok
    assert dense_check(path, problem_with(goal=spline.end, straight=2.3)).broken == ("final straight",)
    assert dense_check(straight_line(), problem_with(straight=4.5)).broken == ("final straight",)


def test_gap_between_gears():
    first = ClothoidSpline(START, np.array([0.0, 2.0]), np.zeros(2))
    second = ClothoidSpline(Pose2(2.0, 0.001, 0.0), np.array([0.0, 2.0]), np.zeros(2))
    path = Path((ClothoidSegment(first), ClothoidSegment(second)))
    report = dense_check(path, problem_with(goal=second.end))
    assert report.broken == ("joint",)
    assert report.faults[0].s == pytest.approx(2.0)


def test_slip_and_wrong_gear():
    crab = Path.from_poses(np.column_stack((np.linspace(0, 4, 50), np.linspace(0, 0.4, 50), np.zeros(50))))
    assert "slip" in dense_check(crab, problem_with()).broken
    from optdock.model.path import Direction, PolylineSegment

    line = np.column_stack((np.linspace(0, 4, 50), np.zeros(50), np.zeros(50)))
    assert dense_check(Path((PolylineSegment(line, Direction.REVERSE),)), problem_with()).broken == ("direction",)
    assert dense_check(Path((PolylineSegment(line, Direction.FORWARD),)), problem_with()).ok


@pytest.mark.parametrize("frame", [Pose2(3.0, -2.0, 1.0), Pose2(-70.0, 4.0, -2.6)])
def test_invariance_under_rigid_motion(frame):
    spline = bend()
    walls = [box(0.5, 0.8, 1.0, 1.4), box(1.5, -0.4, 1.8, -0.1)]
    here = dense_check(Path((ClothoidSegment(spline),)), problem_with(*walls, goal=spline.end))
    moved = [transform_points(frame.as_array()[None], wall)[0] for wall in walls]
    there_spline = ClothoidSpline(frame @ START, spline.knots, spline.curvature)
    there_problem = dataclasses.replace(problem_with(*moved, goal=frame @ spline.end), start=frame @ START)
    there = dense_check(Path((ClothoidSegment(there_spline),)), there_problem)
    assert there.broken == here.broken
    assert there.min_clearance == pytest.approx(here.min_clearance, abs=1e-9)
    assert there.worst_s == pytest.approx(here.worst_s, abs=0.005)


def test_clearance_at_a_pose_is_negative_for_overlap():
    problem = problem_with(box(1.0, -0.2, 1.2, 0.2))
    assert clearance_at(START, problem) == pytest.approx(0.5)
    assert clearance_at(Pose2(1.0, 0.0, 0.0), problem) < -0.05
    assert clearance_at(START, problem_with()) == math.inf


FAMILIES = ("alcove", "parallel", "clutter", "corridor", "angled_hexagon", "car_bay")


def held_requirement(drawn, step):
    """Return the largest required clearance accepted by the dense check along the witness, within 1e-6 m."""
    low, high = 0.0, 1.0
    while high - low > 1e-6:
        middle = 0.5 * (low + high)
        problem = dataclasses.replace(drawn.problem, clearance=ClearanceRule(middle, 0.0, 0.5))
        low, high = (middle, high) if dense_check(drawn.witness, problem, step).worst_margin > 0.0 else (low, middle)
    return low


@pytest.mark.parametrize("family", FAMILIES)
def test_certificate_and_samples_agree_on_the_required_clearance(family):
    drawn = instance(family, 5)
    held = held_requirement(drawn, 0.01)
    too_much = dataclasses.replace(drawn.problem, clearance=ClearanceRule(held + 1e-4, 0.0, 0.5))
    a_little_less = dataclasses.replace(drawn.problem, clearance=ClearanceRule(held - 2e-3, 0.0, 0.5))
    assert not certify_path(drawn.witness, too_much).certified
    assert certify_path(drawn.witness, a_little_less).certified


@pytest.mark.parametrize("family", FAMILIES)
def test_proven_clearance_is_at_most_the_measured(family):
    drawn = instance(family, 5)
    certificate, report = certify_path(drawn.witness, drawn.problem), dense_check(drawn.witness, drawn.problem)
    assert certificate.min_clearance <= report.min_clearance + 1e-9
    assert certificate.margin <= report.worst_margin + 1e-9
    assert certificate.max_curvature == pytest.approx(report.max_curvature, abs=0.02)


def test_clothoid_with_unlimited_rate_does_not_slip():
    limits = MotionLimits(max_curvature=math.inf, max_curvature_rate=math.inf)
    spline = ClothoidSpline(Pose2(0.0, 0.0, 0.0), [0.0, 0.05, 0.1], [0.0, 20.0, -20.0])
    path = Path((ClothoidSegment(spline),))
    problem = DockingProblem(path.start, Dock(path.end), Robot(Footprint.rectangle(0.4, 0.4, 0.5), limits))
    assert dense_check(path, problem).faults == ()


@pytest.mark.parametrize(
    ("camera", "broken"),
    [
        (Camera(Pose2(0.4, 0.0, 0.0), 0.9, 0.2, 4.0), ()),
        (Camera(Pose2(0.4, 0.0, 0.0), 0.7, 0.2, 4.0), ("bearing",)),
        (Camera(Pose2(0.4, 0.0, -0.5), 0.9, 0.2, 4.0), ("bearing",)),
        (Camera(Pose2(0.4, 0.0, 0.0), 0.9, 0.7, 4.0), ("min_range",)),
        (Camera(Pose2(0.4, 0.0, 0.0), 0.9, 0.2, 1.6), ("max_range",)),
    ],
)
def test_required_view_of_the_marker(camera, broken):
    # 1 m ahead of the docked robot and 0.25 m to the left: 0.65 m before the camera at the end of the last metre.
    path, task = straight_line(), problem_with(robot=dataclasses.replace(ROBOT, camera=camera))
    dock = dataclasses.replace(task.dock, marker=(1.0, 0.25), visible_distance=1.0)
    seen = dataclasses.replace(task, dock=dock)
    assert dense_check(path, task).ok
    assert dense_check(path, seen).broken == broken
    assert certify_path(path, seen).certified == (not broken)


@pytest.mark.parametrize(("gap", "ok"), [(0.049, True), (0.0505, False)])
def test_start_with_the_required_clearance_has_no_relief(gap, ok):
    """A post 4.6 cm next to the path: too close, except with the relief of a start that is itself too close."""
    leaving = Path((ClothoidSegment(ClothoidSpline(START, np.array([0.0, 4.0]), np.zeros(2))),))
    beside = box(-0.6, 0.3 + gap, -0.2, 0.5), box(0.6, -0.5, 0.62, -0.346)
    assert dense_check(leaving, problem_with(*beside)).ok is ok
    assert certify_path(leaving, problem_with(*beside)).certified is ok
