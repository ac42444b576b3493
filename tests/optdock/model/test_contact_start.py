"""Starts in contact: a robot along a wall drives straight until it is clear of the wall."""

import dataclasses
import math

import numpy as np
import pytest

import optdock as od
from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.model.clearance_rule import ClearanceRule
from optdock.model.dock import Dock
from optdock.model.limits import MotionLimits
from optdock.model.path import Path
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from optdock.model.segments import ClothoidSegment, Direction, PolylineSegment
from optdock.planning.guess_edits import begun_straight, straight_along_contact

CAR = Robot(Footprint.rectangle(0.7, 0.2, 0.6), MotionLimits(max_curvature=1.2, max_curvature_rate=6.0))
FRAME = Pose2(3.0, -2.0, 0.7)


def flush(gap=0.0, ends=1.0, **start):
    """A robot with its right side along a wall that ends ahead of it, in a turned frame."""
    wall = np.array([[-3.0, -0.3 - gap], [ends, -0.3 - gap], [ends, -1.0], [-3.0, -1.0]])
    c, s = math.cos(FRAME.yaw), math.sin(FRAME.yaw)
    dock = Dock(FRAME @ Pose2(3.0, -2.5, -0.5 * math.pi), direction="forward", final_straight=0.3)
    rule = ClearanceRule(0.05, 0.0, 0.5, dock_run=3.0, at_start=0.0)
    return DockingProblem(FRAME, dock, CAR, [wall @ [[c, s], [-s, c]] + [FRAME.x, FRAME.y]], rule, **start)


def straight_then_arc(straight, gear=1, curvature=0.5):
    line = ClothoidSpline(FRAME, [0.0, straight], [0.0, 0.0], gear)
    first = Path((ClothoidSegment(line),), "map")
    bent = ClothoidSpline(first.end, [0.0, 0.5, 2.0], [0.0, curvature, curvature], gear)
    poses = np.concatenate((first.sample(0.01).poses, Path((ClothoidSegment(bent),), "map").sample(0.01).poses[1:]))
    return Path.from_poses(poses, "map")


def test_a_robot_that_touches_a_wall_leaves_it_straight_on():
    problem = flush()
    plan = od.plan_dock(problem, time_budget=5.0)
    stations = np.linspace(0.0, 1.15, 60)  # the tail is clear of the wall after 1.2 m
    poses = plan.path.poses_at(stations)
    assert np.abs(poses[:, 2] - FRAME.yaw).max() < 1e-9
    assert od.certify_path(plan.path, problem)


@pytest.mark.parametrize("ends", [0.5, 1.0, 1.7])
def test_the_straight_line_ends_where_the_robot_is_clear(ends):
    found = straight_along_contact(straight_then_arc(2.5), flush(ends=ends))
    assert ends + 0.2 < found <= ends + 0.2 + 0.021


def test_no_straight_line_is_kept_where_there_is_no_contact_or_the_path_turns_in_it():
    path = straight_then_arc(2.5)
    assert straight_along_contact(path, flush(gap=0.002)) == 0.0
    assert straight_along_contact(straight_then_arc(0.4), flush()) == 0.0
    assert straight_along_contact(path, flush(start_speed=0.1)) == 0.0
    assert straight_along_contact(path, flush(start_curvature=0.2)) == 0.0
    assert straight_along_contact(path, flush(start_curvature=0.0)) > 0.0
    assert straight_along_contact(path.moved(Pose2(0.1, 0.0, 0.0)), flush()) == 0.0


def test_a_guess_without_length_is_tried_without_an_error():
    """A search with one gear fewer than 5 mm forth and back makes such a guess at the dock."""
    problem = flush()
    nowhere = Path((PolylineSegment(np.tile(FRAME.as_array(), (11, 1)), Direction.FORWARD),), "map")
    assert straight_along_contact(nowhere, problem) == 0.0
    at_goal = dataclasses.replace(problem, dock=Dock(FRAME), clearance=ClearanceRule(0.0, 0.0))
    assert od.plan_dock(at_goal, time_budget=5.0, guesses=[nowhere]).tried[0].stage == "given"


@pytest.mark.parametrize("gear", [1, -1])
def test_a_line_before_a_path_moves_its_start_and_nothing_else(gear):
    whole = ClothoidSpline(FRAME, [0.0, 1.2, 2.0, 3.0], [0.0, 0.0, 0.7, -0.3], gear)
    rest = ClothoidSpline(Pose2(*whole.poses_at(1.2)[0]), [0.0, 0.8, 1.8], [0.0, 0.7, -0.3], gear)
    stations = np.linspace(0.0, 3.0, 50)
    wanted = Path((ClothoidSegment(whole),), "map").poses_at(stations)
    curve = Path((ClothoidSegment(rest),), "map")
    for path in (curve, Path.from_poses(curve.sample(0.005).poses, "map")):
        found = begun_straight(FRAME, gear, 1.2, path)
        assert found.start == FRAME
        assert np.abs(found.poses_at(stations * found.length / 3.0) - wanted).max() < 1e-4
    assert len(begun_straight(FRAME, gear, 1.2, curve).segments) == 1
