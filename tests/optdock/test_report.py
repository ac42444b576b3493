import dataclasses
import json
import math

import numpy as np

from optdock.errors import NoValidPathCouldBeFound, OptdockError
from optdock.geometry.footprint import Footprint
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import Pose2
from optdock.model.clearance_rule import ClearanceRule
from optdock.model.dock import Dock
from optdock.model.limits import MotionLimits
from optdock.model.path import Path
from optdock.model.problem import DockingProblem, ProblemFingerprint
from optdock.model.robot import Robot
from optdock.planning.pipeline import plan_dock
from optdock.planning.plan import PartialPlan
from optdock.reports.report import certificate_rows, failed_plan_file, limit_rows, plan_rows, run_json, run_rows, table
from optdock.simulation import Run
from optdock.verification import Certificate


def run_ending_at(pose, **options):
    poses = np.array([[0.0, 0.0, 0.0], pose])
    speeds = np.zeros((2, 2))
    return Run(np.array([0.0, 1.0]), poses, poses, speeds, speeds, np.zeros((2, 3)), Pose2(1.0, 0.0, 0.0), **options)


def test_a_table_is_aligned_and_has_no_trailing_blanks():
    assert table([("a", "bb", "c"), ("aaa", "b", "")]) == "a    bb  c\naaa  b"


def test_limits_say_which_of_them_nobody_gave_and_no_line_tears_one():
    rows = limit_rows(MotionLimits(max_acceleration=0.4), defaults={"max_deceleration", "max_jerk", "max_yaw_rate"})
    lines = [row.value for row in rows[: [row.name for row in rows].index("unlimited")]]
    assert "acceleration 0.4 m/s^2, deceleration 0.6 m/s^2 (default), jerk 2 m/s^3 (default)" in " ".join(lines)
    assert all(line.endswith(",") for line in lines[:-1])
    assert len(lines) > 1
    assert "(default)" not in " ".join(row.value for row in limit_rows(MotionLimits()))


def test_a_run_tells_its_final_error_in_the_frame_of_the_dock():
    run = run_ending_at([0.998, 0.001, 0.01], docked=True, min_clearance=0.02)
    rows = {row.name: row.value for row in run_rows(run)}
    assert rows["docked"] == "yes"
    assert rows["final error"] == "along -2.00 mm, cross +1.00 mm, yaw +0.01000 rad"
    assert rows["min clearance driven"] == "0.0200 m"


def test_a_run_tells_what_every_goal_checker_said():
    run = run_ending_at([1.0, 0.0, 0.2], docked=True, verdicts={"AxisGoalChecker": True, "DockGoalChecker": False})
    rows = [(row.name, row.value) for row in run_rows(run)]
    assert rows[1] == ("goal checkers", "AxisGoalChecker: reached, DockGoalChecker: not reached")
    document = json.loads(run_json(run, 0))
    assert document["goal_checkers"] == {"AxisGoalChecker": True, "DockGoalChecker": False}


def test_a_run_that_failed_says_why_and_stays_strict_json():
    run = run_ending_at([0.5, 0.0, 0.0], docked=False, reason="timeout", min_clearance=math.inf)
    assert {row.name: row.value for row in run_rows(run)}["docked"] == "no: timeout"
    document = json.loads(run_json(run, 7), parse_constant=lambda name: name)
    assert (document["docked"], document["reason"], document["seed"]) == (False, "timeout", 7)
    assert document["min_clearance"] is None
    assert document["final_error"] == {"along": -0.5, "cross": 0.0, "yaw": 0.0}
    assert document["columns"]["error_along"] == [0.0, 0.5]


def test_a_failure_takes_along_whatever_exists():
    raw = Path.from_poses(np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]), "depot")
    error = NoValidPathCouldBeFound("no way", where={"s": 1.0})
    error.partial = PartialPlan(raw_path=raw, timing_ms={"plan": 1.5})
    plan = failed_plan_file(error, "depot")
    assert (plan.status, plan.frame, plan.completed) == ("NoValidPathCouldBeFound", "depot", False)
    assert plan.raw_path is raw
    assert plan.timing_ms == {"plan": 1.5}
    assert plan.error == (208, "no way", {"s": 1.0})


def test_a_failure_before_anything_exists_has_nothing_but_its_reason():
    plan = failed_plan_file(OptdockError("early"), "map")
    assert (plan.raw_path, plan.path, plan.certificate, dict(plan.timing_ms)) == (None, None, None, {})


def test_a_plan_tells_its_least_margin_away_from_the_dock_and_its_straight():
    """By hand: along y = 0 a robot 0.5 m wide is 0.35 m from a wall that begins at y = 0.6."""
    wall = ObstacleSet.from_polygons([[(-4.0, 0.6), (1.0, 0.6), (1.0, 0.8), (-4.0, 0.8)]])
    dock = Dock(Pose2(0.0, 0.0, 0.0), Footprint.rectangle(0.6, -0.3, 0.5), final_straight=0.0)
    robot, rule = Robot(Footprint.rectangle(0.3, 0.3, 0.5), MotionLimits()), ClearanceRule(0.1, 0.0)
    plan = plan_dock(DockingProblem(Pose2(-3.0, 0.0, 0.0), dock, robot, wall, rule), time_budget=20.0)
    rows = {row.name: row.value for row in plan_rows(plan)}
    assert rows["min clearance"].startswith("0.0000 m to dock")
    assert rows["least margin"].startswith("0.2500 m more than the required 0.1000 m, to obstacles[0] at s = ")
    assert rows["final straight"] == "none: dock.final_straight is 0"
    free = plan_dock(dataclasses.replace(plan.problem, obstacles=ObstacleSet.empty()), time_budget=20.0)
    assert "to dock" in {row.name: row.value for row in plan_rows(free)}["least margin"]


def test_a_certificate_without_obstacles_has_no_clearance_to_tell():
    nothing = ProblemFingerprint(*"abcdefg")
    certificate = Certificate((), math.inf, 0.0, 0.0, math.inf, "", 0.5, 1.0, 2.0, 3, nothing, "")
    assert [row.name for row in certificate_rows(certificate)] == ["length", "max curvature"]
