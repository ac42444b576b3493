"""Hard families of the manoeuvre benchmark: seeds, clearances of starts and docks, known truths."""

import dataclasses
import functools
import math

import numpy as np
import pytest

from experiments.manoeuvres import cases, hard_cases, run
from experiments.manoeuvres.cases import RULE, Truth
from experiments.manoeuvres.run import CERTIFIED, IMPOSSIBLE, run_case
from optdock.errors import GoalOccupied
from optdock.geometry.pose import Pose2
from optdock.verification import pose_clearances

DRAWN = {
    "rack halls": lambda seed: hard_cases.rack_halls(3, seed),
    "maze": lambda seed: hard_cases.maze(2, seed),
    "wrong way": lambda seed: hard_cases.wrong_way(2, seed),
    "along a wall": lambda seed: hard_cases.along_a_wall(4, seed),
    "contact": lambda seed: hard_cases.contact(2, seed),
    "bays": lambda seed: hard_cases.bays(3, seed),
    "forklifts": lambda seed: hard_cases.forklifts(2, seed),
    "blocked straight": lambda seed: hard_cases.blocked_straight(2, seed),
    "open straight": lambda seed: hard_cases.open_straight(2, seed),
    "barely open": lambda seed: hard_cases.barely_open(1, seed),
}
TOUCHING = {"along a wall": hard_cases.BESIDE, "contact": (0.0, 0.001)}  # [m]: clearance of starts and docks
ROUNDING = 1e-9  # [m]


@pytest.fixture(autouse=True, scope="module")
def _two_spare_widths():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(hard_cases, "SPARE", (0.002, 0.02))
        yield


@functools.cache
def drawn(family):
    return DRAWN[family](11)


@functools.cache
def witnesses():
    return hard_cases.witnesses(1, 11)


def clearances(problem, poses):
    return pose_clearances(np.asarray(poses), problem.robot.footprint, problem.all_obstacles)[0]


def straight_poses(problem):
    """Every 5 mm of the straight before the dock; the docked pose is the first."""
    dock = problem.dock
    back = 1.0 if dock.direction.value == "backward" else -1.0
    ways = np.arange(0.0, dock.final_straight, 0.005)
    return ways, [(dock.pose @ Pose2(back * way, 0.0, 0.0)).as_array() for way in ways.tolist()]


@pytest.mark.parametrize("family", DRAWN)
def test_cases_are_deterministic_with_unique_names(family):
    first, other = drawn(family), DRAWN[family](12)
    again = [one.case for one in witnesses()] if family == "barely open" else DRAWN[family](11)
    assert [one.problem.fingerprint for one in first] == [one.problem.fingerprint for one in again]
    assert all(a.problem.fingerprint != b.problem.fingerprint for a, b in zip(first, other, strict=True))
    assert len({one.name for one in first}) == len(first)
    assert {one.family for one in first} == {family}


@pytest.mark.parametrize("family", DRAWN)
def test_starts_and_docks_are_free(family):
    """By the required clearances, and at walls by the clearance of the family."""
    for case in drawn(family):
        problem = case.problem
        rule = problem.clearance
        start, goal = clearances(problem, [problem.start.as_array(), problem.goal.as_array()])
        low, high = TOUCHING.get(family, (rule.required, math.inf))
        if not case.tag.startswith("dock"):
            assert low - ROUNDING <= start <= high + ROUNDING, case.name
        if case.tag.startswith(("dock", "both")):
            assert low - ROUNDING <= goal <= high + ROUNDING, case.name
        assert goal >= rule.at_dock - ROUNDING, case.name


def test_rack_hall_starts_are_along_other_aisles():
    for case in drawn("rack halls"):
        problem = case.problem
        apart = problem.start.in_frame_of(problem.goal)
        assert math.hypot(apart.x, apart.y) > 2.0
        assert abs(math.sin(problem.start.yaw)) > 0.99


def test_straight_motion_past_the_end_of_the_wall_is_feasible():
    for case in hard_cases.along_a_wall():
        problem = case.problem
        if case.tag == "start, wall ends":
            ways = np.arange(0.0, 2.0, 0.005)
            poses = [(problem.start @ Pose2(way, 0.0, 0.0)).as_array() for way in ways.tolist()]
            found = clearances(problem, poses)
            needed = np.minimum(RULE.required, RULE.near_start(ways, found[0], problem.start_run))
        elif case.tag == "dock, wall ends":
            ways, poses = straight_poses(problem)
            found, needed = clearances(problem, poses), RULE.near_goal(ways)
        else:
            continue
        assert np.all(found >= needed - ROUNDING), case.name


def test_missing_width_of_the_straight_equals_the_truth():
    for case in (*drawn("blocked straight"), *drawn("open straight")):
        problem, truth = case.problem, case.truth
        ways, poses = straight_poses(problem)
        station = len(problem.all_obstacles) - 1
        alone = dataclasses.replace(problem, dock=dataclasses.replace(problem.dock, footprint=None))
        assert len(alone.all_obstacles) == station
        found = clearances(alone, poses)
        margin = float((found - RULE.near_goal(ways)).min())
        if math.isinf(truth.missing):
            assert margin < -RULE.required
            continue
        beside = truth.missing if case.tag.startswith("post") else 0.5 * truth.missing
        if beside < RULE.required:  # else the body overlaps, and its distance is that along the shortest way out
            assert margin == pytest.approx(-beside, abs=1e-6), case.name
        if truth.is_body is not None:
            assert truth.is_body == (float(found.min()) < 0.0), case.name


def test_witness_has_the_spare_width():
    for one in witnesses():
        problem = one.case.problem
        needed = RULE.near_goal(np.hypot(*(one.poses[:, :2] - one.poses[-1, :2]).T))
        margin = float((clearances(problem, one.poses) - needed).min())
        assert one.spare <= margin <= one.spare + 0.001, one.case.name
        assert one.poses[-1] == pytest.approx(problem.goal.as_array())
        assert one.case.truth == Truth(-2.0 * one.spare)


def full_lock(start, gear, curvature):
    """1.5 m of an arc, millimetre by millimetre."""
    turned = start[2] + gear * curvature * np.arange(1500) * 0.001
    middle = turned + 0.5 * gear * curvature * 0.001
    x, y = (start[i] + np.cumsum(gear * 0.001 * f(middle)) for i, f in ((0, np.cos), (1, np.sin)))
    return np.vstack((start, np.column_stack((x, y, turned + gear * curvature * 0.001))))


def test_full_lock_manoeuvre_leaves_a_bay_of_1_2_lengths():
    """Forward to the left and back to the right, each up to the required clearance, until the car has turned out."""
    case = next(case for case in hard_cases.bays(1) if case.tag == "out of 1.2")
    limits, pose, gear = hard_cases.CAR.limits, case.problem.start.as_array(), 1.0
    for _ in range(20):
        way = full_lock(pose, gear, gear * limits.max_curvature)
        blocked = np.flatnonzero(clearances(case.problem, way) < hard_cases.CAR_RULE.required)
        way = way[: blocked[0]] if blocked.size else way
        if way[-1, 2] - case.problem.start.yaw > 1.2:
            break
        pose, gear = way[-1], -gear
    assert way[-1, 2] - case.problem.start.yaw > 1.2


def test_starts_in_buildings_are_far_and_free(real_data):
    found = hard_cases.buildings()
    again = hard_cases.buildings()
    assert [one.problem.start for one in found] == [one.problem.start for one in again]
    assert {one.tag for one in found} == {"depot", "warehouse"}
    assert len(found) == len(hard_cases.SCENARIOS)
    for case in found:
        assert clearances(case.problem, [case.problem.start.as_array()])[0] >= RULE.required


def test_proof_for_an_open_scene_is_a_fault(monkeypatch):
    def refuse(*_, **__):
        raise GoalOccupied("no room")

    monkeypatch.setattr(run, "plan_dock", refuse)
    for truth, fault in ((Truth(-0.002), "impossible (proven), but -2 mm are missing"), (Truth(0.02), "")):
        record = run_case(cases.near_dock()[0]._replace(truth=truth))
        assert (record.outcome, record.faults) == (IMPOSSIBLE, fault)


def test_a_plan_through_a_blocked_scene_is_a_fault():
    case = next(case for case in cases.near_dock() if case.name == "0 cm aside, 1.00 m before")
    for truth, fault in ((Truth(0.02), "certified, but 20 mm are missing"), (Truth(-0.02), "")):
        record = run_case(case._replace(truth=truth))
        assert (record.outcome, record.faults) == (CERTIFIED, fault)
