"""Proofs that the final straight is blocked: against shapely, forged ones, through plan files and the command line."""

import dataclasses
import json
import math

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from optdock.errors import InvalidFile, NoMotionExists
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2, transform_points
from optdock.impossibility import BlockedStraight, check_impossibility, prove_straight_blocked
from optdock.io.plan_file import PlanFile, load_plan, save_plan
from optdock.model.clearance_rule import ClearanceRule
from optdock.model.dock import Dock, DockDirection
from optdock.model.limits import MotionLimits
from optdock.model.path import Path
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from optdock.planning.pipeline import plan_dock
from optdock.reports.plan_file_verdict import judge_plan_file
from optdock.reports.report import failed_plan_file
from optdock.verification import certify_path

ROBOT = Robot(Footprint.rectangle(0.45, 0.45, 0.6), MotionLimits(max_curvature=1.5, max_curvature_rate=6.0))
RULE = ClearanceRule(0.05, 0.0, 0.5)


def asked(*obstacles, straight=0.5, direction="forward", rule=RULE, start=None, goal=None):
    goal = goal or Pose2(0.0, 0.0, 0.0)
    dock = Dock(goal, direction=direction, final_straight=straight)
    return DockingProblem(start or goal @ Pose2(-3.0, 1.0, 0.5), dock, ROBOT, list(obstacles), rule)


def post(x, y, size=0.02):
    return [[x, y], [x + size, y], [x + size, y + size], [x, y + size]]


def straight_in(problem, gear):
    """Straight on into the dock from 4 m before it, and the problem that asks for it."""
    start = problem.goal @ Pose2(-gear * 4.0, 0.0, 0.0)
    poses = [(problem.goal @ Pose2(-gear * back, 0.0, 0.0)).as_array() for back in np.linspace(4.0, 0.0, 401)]
    return Path.from_poses(np.stack(poses)), dataclasses.replace(problem, start=start)


def least_margin(problem, gear):
    """Of distances of shapely every millimetre beyond what is required there [m]."""
    before = np.linspace(0.0, problem.dock.final_straight, 1 + round(1e3 * problem.dock.final_straight))
    world = shapely.union_all([shapely.Polygon(one) for one in problem.obstacles.vertices])
    poses = np.stack([(problem.goal @ Pose2(-gear * back, 0.0, 0.0)).as_array() for back in before])
    bodies = shapely.polygons(transform_points(poses, ROBOT.footprint.vertices))
    return float(np.min(shapely.distance(bodies, world) - problem.clearance.near_goal(before)))


@settings(max_examples=25)
@given(
    st.floats(-1.5, 1.0),
    st.floats(-0.6, 0.6),
    st.sampled_from(list(DockDirection)),
    st.floats(0.05, 1.0),
    st.floats(-3, 3),
)
def test_proof_agrees_with_shapely(x, y, direction, straight, yaw):
    goal = Pose2(2.0, -1.0, yaw)
    placed = transform_points(goal.as_array()[None], np.array(post(x, y)))[0]
    problem = asked(placed, straight=straight, direction=direction, goal=goal)
    proof = prove_straight_blocked(problem)
    gears = {"forward": (1,), "backward": (-1,), "auto": (1, -1)}[direction.value]
    margins = [least_margin(problem, gear) for gear in gears]
    if proof is not None:
        assert max(margins) < 0.0
        assert check_impossibility(proof, problem).proven
        for gear in gears:  # nor does the certificate let anything through
            path, problem_there = straight_in(problem, gear)
            assert not certify_path(path, problem_there).certified
    if max(margins) < -2e-3:
        assert proof is not None
    if max(margins) > 0.0:
        assert proof is None


@pytest.mark.parametrize("spare", [-0.002, 0.0, 1e-6, 0.02])
def test_barely_open_straight_is_not_proven_blocked(spare):
    walls = [
        [[-3.0, side * (0.35 + spare)], [1.0, side * (0.35 + spare)], [1.0, side], [-3.0, side]] for side in (1, -1)
    ]
    proof = prove_straight_blocked(asked(*walls, rule=ClearanceRule(0.05, 0.05, 0.0)))
    assert (proof is None) is (spare >= 0.0)


@pytest.mark.parametrize(
    "forge",
    [
        lambda proof: dataclasses.replace(proof, poses=()),
        lambda proof: dataclasses.replace(proof, poses=tuple(dataclasses.replace(p, before=0.0) for p in proof.poses)),
        lambda proof: dataclasses.replace(proof, poses=tuple(dataclasses.replace(p, before=9.0) for p in proof.poses)),
        lambda proof: dataclasses.replace(
            proof, poses=tuple(dataclasses.replace(p, before=math.nan) for p in proof.poses)
        ),
        lambda proof: dataclasses.replace(proof, poses=tuple(dataclasses.replace(p, gear=-1) for p in proof.poses)),
    ],
)
def test_forged_proof_does_not_hold(forge):
    problem = asked(post(-0.8, 0.2))
    proof = prove_straight_blocked(problem)
    assert check_impossibility(proof, problem)
    assert not check_impossibility(forge(proof), problem)


def test_it_does_not_hold_for_another_problem():
    problem = asked(post(-0.8, 0.2))
    proof = prove_straight_blocked(problem)
    assert check_impossibility(proof, problem)
    for other in (
        asked(post(-0.8, 0.5)),
        asked(post(-0.8, 0.2), straight=0.0),
        asked(),
        asked(post(-0.8, 0.2), direction="auto"),
    ):
        assert not check_impossibility(proof, other)


def test_side_that_is_free_keeps_a_dock_of_either_gear_open():
    behind = post(-0.8, 0.0)
    assert prove_straight_blocked(asked(behind)) is not None
    assert prove_straight_blocked(asked(behind, direction="auto")) is None
    assert prove_straight_blocked(asked(behind, post(0.8, 0.0), direction="auto")) is not None


def test_plan_dock_refuses_at_once_and_certify_checks_the_file(tmp_path):
    problem = asked(post(-0.8, 0.31))
    with pytest.raises(NoMotionExists, match="its final straight is blocked.*0.0100 m from obstacles") as caught:
        plan_dock(problem)
    refusal = caught.value
    assert refusal.where["reason"] == "approach_blocked"
    assert refusal.where["obstacle"] == "obstacles[0]"
    assert refusal.partial.tried == ()
    save_plan(tmp_path / "plan.json", failed_plan_file(refusal, "map"))
    read = load_plan(tmp_path / "plan.json")
    assert read.impossibility == refusal.proof
    assert judge_plan_file(read, problem).outcome == "impossible"
    assert judge_plan_file(read, asked(post(-0.8, 0.5))).outcome == "refuted"


@pytest.mark.parametrize("key", ["gear", "before", "x", "required", "obstacle"])
def test_damaged_proof_is_refused_by_name(key):
    values = json.loads(json.dumps(prove_straight_blocked(asked(post(-0.8, 0.2))).as_dict()))
    assert BlockedStraight.from_dict(values) == prove_straight_blocked(asked(post(-0.8, 0.2)))
    values["straight"][0][key] = [1]
    with pytest.raises(InvalidFile, match=key):
        BlockedStraight.from_dict(values)
    assert PlanFile().impossibility is None
