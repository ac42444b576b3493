"""Plans while the hand drags and at rest: every answer holds for its own scene, rest does not depend on the drag."""

import dataclasses
import math

import pytest

import optdock as od
from optdock.config import Scenario
from optdock.config.simulated_drive import WorldDeviations
from optdock.deadline import budget_clock
from optdock.errors import NoMotionExists, PlannerCancelled
from optdock.io.plan_file import parse_plan
from optdock.planning.plan import DockPlan
from optdock.reports.plan_file_verdict import judge_plan_file
from optdock.ui import hand_planning
from optdock.ui.hand_planning import HandPlanning, PlanRequest

SHELF = [(1.4, 0.9), (2.4, 0.9), (2.4, 1.3), (1.4, 1.3)]


def scenario_at(x=0.0, y=0.0, yaw=0.2, obstacles=(SHELF,)):
    robot = od.Robot(od.Footprint.rectangle(0.2, 0.2, 0.2), od.MotionLimits(max_curvature=3.0, max_curvature_rate=12.0))
    dock = od.Dock(od.Pose2(3.0, 0.5, 0.0), od.Footprint.rectangle(0.5, -0.25, 0.3), final_straight=0.3)
    start = od.Pose2(x, y, yaw)
    return Scenario(od.DockingProblem(start, dock, robot, obstacles=list(obstacles), clearance=0.02), time_budget=20.0)


def never():
    return False


@pytest.fixture(autouse=True)
def _counted():
    with budget_clock("counted"):
        yield


def test_a_dragged_plan_is_deformed_and_certified_for_its_own_scene():
    planning, methods = HandPlanning(), []
    for k in range(4):
        scenario = scenario_at(0.02 * k, 0.03 * k)
        drawn = planning.answer(PlanRequest(k + 1, f"scene {k}", scenario, in_hand=True), never)
        methods.append(drawn.method)
        assert (drawn.number, drawn.fingerprint, drawn.outcome) == (k + 1, f"scene {k}", "certified")
        plan = parse_plan(drawn.plan_file(scenario.problem).as_json(), "text")
        assert judge_plan_file(plan, scenario.problem)
        other = scenario_at(0.02 * k + 0.01, 0.03 * k)
        assert not judge_plan_file(plan, other.problem)
    assert methods == ["planned", "deformed", "deformed", "deformed"]


def test_a_deformed_plan_that_is_much_dearer_is_planned_anew(monkeypatch):
    planning = HandPlanning()
    planning.planned(scenario_at(), never, in_hand=False)
    farther = scenario_at(-0.1)
    monkeypatch.setattr(hand_planning, "_DEARER", (0.5, 0.0))
    assert planning.planned(farther, never, in_hand=True)[0] == "planned"
    monkeypatch.setattr(hand_planning, "_DEARER", (1.5, 1.0))
    assert planning.planned(farther, never, in_hand=True)[0] == "deformed"


def test_the_plan_at_rest_does_not_depend_on_the_way_of_the_hand():
    scenario = scenario_at(0.1, -0.1, 0.0)
    dragged = HandPlanning()
    for k in range(3):
        dragged.planned(scenario_at(0.1, 0.3 - 0.1 * k), never, in_hand=True)
    in_hand = dragged.planned(scenario, never, in_hand=True)[1]
    method, plan = dragged.planned(scenario, never, in_hand=False)
    fresh = HandPlanning().planned(scenario, never, in_hand=False)[1]
    assert method == "planned"
    assert plan.path.digest == fresh.path.digest
    assert plan.trajectory.duration == fresh.trajectory.duration
    assert in_hand.path.digest != fresh.path.digest


BOX = [
    [(-1.2, 3.0), (4.2, 3.0), (4.2, 3.2), (-1.2, 3.2)],
    [(-1.2, -3.2), (4.2, -3.2), (4.2, -3.0), (-1.2, -3.0)],
    [(-1.2, -3.2), (-1.0, -3.2), (-1.0, 3.2), (-1.2, 3.2)],
    [(4.0, -3.2), (4.2, -3.2), (4.2, 3.2), (4.0, 3.2)],
]


def test_a_kept_proof_has_no_bottleneck_of_another_world():
    """Its width and place are those of the obstacles for which it was made."""

    def proof(gap, x=0.0):
        walls = [[(0.8, -3), (0.9, -3), (0.9, -gap), (0.8, -gap)], [(0.8, gap), (0.9, gap), (0.9, 3), (0.8, 3)]]
        method, error = planning.planned(scenario_at(x, obstacles=walls + BOX), never, in_hand=True)
        return method, error.proof.bottleneck

    planning = HandPlanning()
    assert proof(0.1)[1] is not None
    method, bottleneck = proof(0.1, 0.05)
    assert method == "proven"
    assert bottleneck is not None
    for gap in (0.08, 0.06):
        assert proof(gap) == ("proven", None)


def test_a_proof_is_kept_while_it_holds():
    wall, box = [[(0.8, -3.0), (0.9, -3.0), (0.9, 3.0), (0.8, 3.0)]], BOX
    planning = HandPlanning()
    kept = [planning.planned(scenario_at(0.05 * k, obstacles=wall + box), never, in_hand=True) for k in range(3)]
    assert [method for method, _ in kept] == ["planned", "proven", "proven"]
    assert all(isinstance(result, NoMotionExists) for _, result in kept)
    beyond = planning.planned(scenario_at(1.4, 0.5, obstacles=wall + box), never, in_hand=True)
    assert beyond[0] == "planned"
    assert isinstance(beyond[1], DockPlan)


def test_a_cancelled_call_keeps_the_previous_plan():
    planning = HandPlanning()
    planning.planned(scenario_at(), never, in_hand=False)
    cancelled = planning.answer(PlanRequest(2, "b", scenario_at(0.01)), lambda: True)
    assert (cancelled.outcome, cancelled.error) == ("cancelled", PlannerCancelled.__name__)
    assert planning.planned(scenario_at(0.02), never, in_hand=True)[0] == "deformed"


def test_a_simulated_drive_belongs_to_the_plan_that_was_shown(monkeypatch):
    planning, scenario = HandPlanning(), scenario_at()
    planning.answer(PlanRequest(1, "shown", scenario), never)
    plain = planning._plan
    monkeypatch.setattr(hand_planning, "_planned", None)  # no other plan is made
    drawn = planning.answer(PlanRequest(2, "shown", scenario, drive=(WorldDeviations(), 3)), never)
    assert (drawn.number, drawn.fingerprint, drawn.outcome, drawn.reason) == (2, "shown", "docked", "")
    assert math.dist(drawn.poses[-1, :2], (3.0, 0.5)) < 0.02
    assert drawn.times.size == len(drawn.poses) == len(drawn.errors) <= 800
    assert dict(drawn.rows)["docked"] == "yes"
    assert drawn.times[-1] > plain.trajectory.duration - 1.0
    stopped = planning.answer(PlanRequest(3, "shown", scenario, drive=(WorldDeviations(), 3)), lambda: True)
    assert (stopped.outcome, stopped.times.size) == ("cancelled", 0)


def test_a_drive_of_another_scene_is_planned_first():
    planning = HandPlanning()
    planning.answer(PlanRequest(1, "one", scenario_at()), never)
    blocked = scenario_at(1.5, 1.0)
    drawn = planning.answer(PlanRequest(2, "two", blocked, drive=(WorldDeviations(), 0)), never)
    assert (drawn.outcome, drawn.reason.partition(":")[0]) == ("refused", "StartOccupied")


def test_a_start_in_motion_is_never_deformed():
    planning, scenario = HandPlanning(), scenario_at()
    planning.planned(scenario, never, in_hand=True)
    moving = dataclasses.replace(scenario.problem, start=od.Pose2(0.01, 0.0, 0.2), start_speed=0.1)
    assert planning.planned(dataclasses.replace(scenario, problem=moving), never, in_hand=True)[0] == "planned"
