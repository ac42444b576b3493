"""Manoeuvre benchmark: cases, independent check, tables."""

import csv
import dataclasses
import math

import pytest
import shapely

from experiments.manoeuvres import cases
from experiments.manoeuvres.__main__ import FAMILIES, families, main
from experiments.manoeuvres.check import checked
from experiments.manoeuvres.run import BUDGETS, CERTIFIED, IMPOSSIBLE, NOT_FOUND, Record, csv_text, run_case
from experiments.manoeuvres.tables import budget_table, grid_table, proof_table, summary
from optdock.geometry.pose import Pose2
from optdock.model.dock import Dock
from optdock.model.limits import MotionLimits
from optdock.model.robot import Robot
from optdock.planning.pipeline import plan_dock
from optdock.verification import end_clearances


def solid(problem):
    return shapely.union_all(shapely.polygons(problem.all_obstacles.vertices))


def drawn():
    return [*cases.near_dock(), *cases.blocked(draws=2), *(one for s in (10.0, 60.0) for one in cases.open_hall(s, 4))]


def test_names_are_unique_and_cases_deterministic():
    first, again, other = drawn(), drawn(), cases.open_hall(10.0, 4, seed=1)
    assert len({(case.family, case.name) for case in first}) == len(first)
    assert [case.problem.fingerprint for case in first] == [case.problem.fingerprint for case in again]
    assert other[0].problem.fingerprint != cases.open_hall(10.0, 4)[0].problem.fingerprint
    assert set(FAMILIES) == set(families(1)) == set(BUDGETS)


def test_ends_are_free_except_in_too_short_bays():
    for case in drawn():
        ends = end_clearances(case.problem)
        assert ends.start > 0.01, case.name
        occupied = case.tag == "bay, 30 cm missing"
        assert (ends.goal < 0.0) == occupied, case.name


def test_hall_start_distances_and_pillar_gaps():
    for length in (10.0, 60.0):
        for case in cases.open_hall(length, 4):
            start, goal = case.problem.start, case.problem.goal
            assert math.hypot(start.x - goal.x, start.y - goal.y) == pytest.approx(length)
            pillars = shapely.polygons(case.problem.obstacles.vertices[4:])
            assert len(pillars) == cases.PILLARS
            near = shapely.STRtree(pillars)
            _, gaps = near.query_nearest(pillars, return_distance=True, exclusive=True, all_matches=False)
            assert gaps.min() >= cases.BETWEEN
            assert shapely.distance(shapely.Point(start.x, start.y), pillars).min() >= cases.AROUND_START


def test_gap_of_a_blocked_scene_equals_its_truth():
    needed = cases.ROBOT.footprint.width + 2.0 * cases.RULE.required
    seen = set()
    for case in cases.blocked(draws=2):
        truth = case.truth
        assert truth.missing > 0.0
        seen.add((case.tag.split(",")[0], truth.is_body))
        if truth.place is not None:
            across = truth.heading + 0.5 * math.pi
            beside = 0.5 * (needed - truth.missing)
            far = shapely.distance(shapely.Point(truth.place), solid(case.problem))
            assert far == pytest.approx(beside, abs=1e-9), case.name
            for side in (-1.0, 1.0):
                x, y = (truth.place[0] + side * (beside + 1e-6) * math.cos(across),
                        truth.place[1] + side * (beside + 1e-6) * math.sin(across))  # fmt: skip
                assert shapely.distance(shapely.Point(x, y), solid(case.problem)) == 0.0, case.name
    assert {kind for kind, _ in seen} == {"gap", "bay", "ring", "door"}
    assert {is_body for _, is_body in seen} == {True, False, None}


def test_blocked_scenes_are_impassable_for_the_inscribed_disc():
    """Free space shrunk by half the least width of the body is disconnected between start and dock."""
    half = 0.5 * cases.ROBOT.footprint.width
    for case in cases.blocked(draws=1):
        if case.truth.is_body and not case.tag.startswith("bay"):
            box = shapely.box(-30.0, -30.0, 30.0, 30.0)
            free = shapely.difference(box, shapely.buffer(solid(case.problem), half - 1e-6))
            ends = [shapely.Point(p.x, p.y) for p in (case.problem.start, case.problem.goal)]
            parts = [shapely.intersects(part, ends) for part in shapely.get_parts(free)]
            assert not any(both.all() for both in parts), case.name


def test_starts_around_real_docks(real_data):
    found = cases.dock_starts(per_dock=3)
    assert len(found) == 29 * 3
    assert {case.tag for case in found} == {"before", "oblique", "beside or behind"}
    for case in found[::7]:
        start, goal = case.problem.start, case.problem.goal
        assert cases.NEAREST <= math.hypot(start.x - goal.x, start.y - goal.y) <= cases.FARTHEST
        assert end_clearances(case.problem).start >= cases.FREE_START - 1e-9
        seen = goal.inverse() @ start
        before = seen.x if case.problem.dock.direction.value == "backward" else -seen.x
        assert (before <= 0.0) == (case.tag == "beside or behind")


def test_public_cases_are_complete(real_data):
    assert len(cases.tpcap()) == 10
    assert [case.problem.clearance.required for case in cases.obca()] == [0.05] * 168


@pytest.fixture(scope="module")
def planned():
    case = next(case for case in cases.near_dock() if case.name == "3 cm aside, 1.00 m before")
    return case, plan_dock(case.problem, time_budget=5.0, planner="DockPlanner")


def test_a_certified_plan_is_confirmed(planned):
    case, plan = planned
    found = checked(plan, case.problem)
    assert found.faults == ()
    assert plan.certificate.min_clearance - 1e-6 <= found.min_clearance
    assert found.poses > plan.path.length / 0.01


def test_check_of_both_rules_near_a_start_along_a_wall():
    """A straight motion, 2 cm along a wall: satisfies the weaker rule, violates the strict one."""
    case = next(case for case in cases.near_dock() if case.name == "0 cm aside, 1.00 m before")
    plan = plan_dock(case.problem, time_budget=5.0, planner="DockPlanner")
    outline = case.problem.robot.footprint
    low, high = 0.5 * outline.width + 0.02, 0.5 * outline.width + 0.1
    walled = dataclasses.replace(case.problem, obstacles=[[[-1.45, low], [0.45, low], [0.45, high], [-1.45, high]]])

    def faults(run):
        return checked(plan, walled, start_relief=run).faults

    assert "clearance" in faults(0.0)[0]
    assert faults(2.0 * outline.length) == ()
    assert faults(2.0) == ("start relief of 2.0000 m, 1.8000 m are allowed",)


def with_limits(problem, **limits):
    return dataclasses.replace(
        problem, robot=Robot(problem.robot.footprint, MotionLimits(**limits), problem.robot.drive)
    )


@pytest.mark.parametrize(
    ("changed", "rule"),
    [
        (lambda p: dataclasses.replace(p, obstacles=[[[-0.5, 0.28], [-0.4, 0.28], [-0.4, 0.4]]]), "clearance"),
        (lambda p: dataclasses.replace(p, clearance=0.05), "clearance"),
        (lambda p: p.starting_at(Pose2(-1.0, 0.0301, 0.0)), "start"),
        (lambda p: dataclasses.replace(p, dock=Dock(Pose2(0.0, 1e-5, 0.0), p.dock.footprint)), "goal"),
        (lambda p: dataclasses.replace(p, dock=dataclasses.replace(p.dock, direction="backward")), "direction"),
        (lambda p: dataclasses.replace(p, dock=dataclasses.replace(p.dock, final_straight=0.9)), "final_straight"),
        (lambda p: dataclasses.replace(p, dock=dataclasses.replace(p.dock, approach_speed=0.05)), "speed"),
        (lambda p: with_limits(p, max_curvature=0.01), "curvature"),
        (lambda p: with_limits(p, max_curvature_rate=0.1), "curvature_rate"),
        (lambda p: with_limits(p, max_jerk=1.0), "jerk"),
        (lambda p: with_limits(p, max_acceleration=0.05), "acceleration"),
    ],
)  # fmt: skip
def test_check_finds_a_violated_rule(planned, changed, rule):
    case, plan = planned
    assert rule in " ".join(fault.split(" ")[0].rstrip(",") for fault in checked(plan, changed(case.problem)).faults)


def test_check_of_steering_limits():
    case = next(case for case in cases.near_dock() if case.name == "30 cm aside, 0.70 m before")
    limits = dataclasses.asdict(case.problem.robot.limits)
    plan = plan_dock(case.problem, time_budget=5.0, planner="DockPlanner")
    bend = max(plan.certificate.max_curvature, 1e-3)
    angle = math.atan(0.5 * bend)

    def faults(**wheels):
        robot = Robot(case.problem.robot.footprint, MotionLimits(**{**limits, "wheelbase": 0.5, **wheels}), "ackermann")
        return " ".join(checked(plan, dataclasses.replace(case.problem, robot=robot)).faults)

    assert len(plan.path.cusps) > 0
    assert faults(max_steering_angle=1.001 * angle) == ""
    assert "steering angle" in faults(max_steering_angle=0.99 * angle)
    slow = faults(max_steering_rate=1e-3)
    assert "steering rate" in slow
    assert "the wheels turn by" in slow


def record(outcome, budget=0.1, family="obca", **values):
    return Record("case", family, "parallel", budget, outcome, cpu=0.05, wall=0.05, **values)


def test_tables_count():
    plan = record(CERTIFIED, price=4.0, duration=3.0, length=2.0, cusps=2, first=0.01)
    bad = plan._replace(faults="clearance", cusps=1, tag="backwards")
    table = summary([plan, bad, record(NOT_FOUND, error="TimedOut: 3"), record(IMPOSSIBLE)])
    rows = {row[0].strip(): dict(zip(table.header, row, strict=True)) for row in table.rows}
    assert rows["obca"]["n"] == 4
    assert [rows["obca"][name] for name in ("certified", "impossible", "not found", "refuted")] == [2, 1, 1, 1]
    assert rows["obca"]["certified %"] == 50.0
    assert rows["obca"]["cusps mean"] == 1.5
    assert rows["parallel"]["refuted"] == 0


def test_budget_table_counts_lost_and_worse_plans():
    plan = record(CERTIFIED, price=4.0)
    worse = budget_table({0.1: [plan, plan], 0.2: [plan._replace(price=4.1), record(NOT_FOUND)]})
    row = dict(zip(worse.header, worse.rows[1], strict=True))
    assert (row["lost"], row["worse"], row["certified"]) == (1, 1, 1)


def test_proof_table():
    proof = record(IMPOSSIBLE, bottleneck_error=0.03, missing_error=-0.02, cause="right")
    wrong = proof._replace(bottleneck_error=0.01, cause="wrong", wall=0.2)
    table = proof_table([proof, wrong, record(NOT_FOUND)])
    row = dict(zip(table.header, table.rows[0], strict=True))
    assert (row["n"], row["proven"], row["wrong cause"], row["worst"]) == (3, 2, 1, 200.0)
    assert (row["place off cm worst"], row["width off cm worst"]) == (3.0, 2.0)


def test_grid_table():
    rows = grid_table([record(CERTIFIED), record(NOT_FOUND), record(IMPOSSIBLE)]).rows
    assert rows == (("parallel", "C.I", 1),)


def test_a_refusal_is_recorded_with_its_reason():
    case = next(case for case in cases.blocked(1) if case.tag == "bay, 30 cm missing")
    found = run_case(case)
    assert found.outcome == IMPOSSIBLE
    assert found.error.startswith("GoalOccupied: ")


def test_command_writes_a_row_and_a_picture_per_case(tmp_path, capsys):
    words = ["--family", "near dock", "--every", "60", "--out", str(tmp_path), "--figures", "--budget", "0.2"]
    assert main(words) == 0
    rows = list(csv.DictReader((tmp_path / "cases.csv").read_text().splitlines()))
    assert 0 < len(rows) < 10
    assert {row["name"] for row in rows} < {case.name for case in cases.near_dock()}
    assert len(list((tmp_path / "figures").iterdir())) == len(rows)
    assert (tmp_path / "versions.json").is_file()
    printed = capsys.readouterr().out
    assert "## Manoeuvres" in printed
    assert "near dock" in printed
    assert csv_text([]).splitlines() == [",".join(Record._fields)]
