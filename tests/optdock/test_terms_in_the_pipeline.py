"""Own bounds of a smoother hold in every plan of `plan_dock` and `replan`, also along paths that were not smoothed."""

import dataclasses
import json
import math

import casadi
import numpy as np
import pytest

import optdock as od
from optdock.errors import FailedToSmoothPath, InvalidValue, PluginError
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.model.dock import Dock
from optdock.model.limits import MotionLimits
from optdock.model.path import TurnSegment
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from optdock.planners.manoeuvres.arcs import Arcs
from optdock.planning.pipeline import plan_dock
from optdock.planning.replanning import DriveState, ReplanOutcome, replan
from optdock.plugins.interfaces import GlobalPlanner, SampledBound, Smoother, never_cancelled
from optdock.plugins.outcomes import Guess
from optdock.plugins.registry import PluginChoice
from smoothers import CasadiSmoother, HardTerm

BUDGET, LEAD = 30.0, 0.06  # no clock decides here
ROBOT = Robot(Footprint.rectangle(0.45, 0.45, 0.6), MotionLimits(max_curvature=1.5, max_curvature_rate=6.0))
PROBLEM = DockingProblem(Pose2(0.0, 0.0, 0.0), Dock(Pose2(3.0, 0.8, 0.0), final_straight=0.3), ROBOT)


def least(path, term):
    """The smallest value of a term of x and y at samples of 1 mm, by its expression on arrays."""
    x, y, _ = path.poses_at(np.arange(0.0, path.length, 1e-3)).T
    return float(np.min(term(x, y)))


def lane(x, y, room=0.15):
    return room + 0.8 / 3.0 * x - y


def kept_lane(**values):
    return HardTerm("lane", lambda p: p.room + 0.8 / 3.0 * p.x - p.y, **{"room": 0.15, **values})


def test_a_plan_keeps_the_terms_and_says_that_they_are_sampled(tmp_path):
    free = plan_dock(PROBLEM, time_budget=BUDGET)
    assert least(free.path, lane) < -0.001
    plan = plan_dock(PROBLEM, time_budget=BUDGET, smoother=CasadiSmoother(terms=[kept_lane()]))
    assert least(plan.path, lane) > -1e-4
    (bound,) = plan.smoothing_report.sampled
    assert bound.name == "lane"
    assert bound.holds
    assert "sampled, not proven: lane" in str(plan)
    plan.save(tmp_path / "plan.json")
    (written,) = json.loads((tmp_path / "plan.json").read_text())["certificate"]["sampled"]
    assert written == {**bound._asdict(), "verdict": "sampled, not proven"}
    again = od.DockPlan.load(tmp_path / "plan.json", PROBLEM)
    assert again.certificate.certified
    assert "sampled" not in json.dumps(free.as_file().certificate)


def test_an_impossible_term_is_the_reason_of_the_failure():
    smoother = CasadiSmoother(terms=[HardTerm("wall", lambda p: 2.0 - p.x)])
    with pytest.raises(FailedToSmoothPath) as no:
        plan_dock(PROBLEM, time_budget=1.0, planner="DockPlanner", smoother=smoother)
    assert no.value.where["term"] == "wall"


def on_the_straight(p):
    return (p.x - 2.8) ** 2 - 0.001


@pytest.mark.parametrize(
    ("term", "direction"),
    [
        (lambda p: p.x - 0.5, "auto"),
        (lambda p: 2.9 - p.x, "auto"),
        (lambda p: p.remaining - 0.1, "auto"),
        (lambda p: casadi.if_else(p.x > 1.0, p.y - 5.0, 1.0), "auto"),  # equally low on the whole straight
        (on_the_straight, "forward"),
    ],
)
def test_a_term_that_every_path_violates_ends_the_call_at_the_first_guess(term, direction):
    problem = dataclasses.replace(PROBLEM, dock=dataclasses.replace(PROBLEM.dock, direction=direction))
    with pytest.raises(FailedToSmoothPath, match="where every path") as no:
        plan_dock(problem, time_budget=BUDGET, smoother=CasadiSmoother(terms=[HardTerm("mine", term)]))
    assert no.value.where["every_path"]
    assert len(no.value.partial.tried) == 1


@pytest.mark.parametrize("term", [on_the_straight, lambda p: 10.0 * p.x - p.gear])
def test_a_term_that_may_hold_in_other_gears_does_not_end_the_call(term):
    smoother = CasadiSmoother(terms=[HardTerm("mine", term)])
    with pytest.raises(FailedToSmoothPath, match="where every path in these gears") as no:
        plan_dock(PROBLEM, time_budget=BUDGET, smoother=smoother)
    assert no.value.where["every_path"] is False
    assert len(no.value.partial.tried) > 1


TURNING = dataclasses.replace(ROBOT.limits, max_yaw_rate=1.0, max_yaw_acceleration=2.0)


@pytest.mark.parametrize(("curvature", "terms"), [(2.0, []), (-0.5, [HardTerm("left", lambda p: p.curvature + 0.2)])])
def test_a_turn_in_place_begins_a_path_where_no_drive_can(curvature, terms):
    """A turn in place has no start curvature, and as a symbol of terms one of its own."""
    robot = dataclasses.replace(ROBOT, limits=TURNING, turns_in_place=True)
    start = Pose2(0.0, 0.0, math.copysign(1.6, curvature))
    problem = DockingProblem(start, Dock(Pose2(3.0, 0.0, 0.0), final_straight=0.3), robot, start_curvature=curvature)
    plan = plan_dock(problem, time_budget=BUDGET, smoother=CasadiSmoother(terms=terms))
    assert isinstance(plan.path.segments[0], TurnSegment)
    moving = dataclasses.replace(problem, start_speed=0.1)
    with pytest.raises(FailedToSmoothPath) as no:
        plan_dock(moving, time_budget=BUDGET, smoother=CasadiSmoother(terms=terms))
    assert no.value.where["every_path"]


def test_a_term_broken_behind_the_straight_line_out_of_contact_does_not_end_the_call():
    """Other paths need not begin with this line."""
    wall = [[-0.2, 0.3], [0.3, 0.3], [0.3, 0.6], [-0.2, 0.6]]
    problem = dataclasses.replace(PROBLEM, obstacles=[wall], dock=Dock(Pose2(3.0, -1.5, 0.0)))
    post = HardTerm("post", lambda p: casadi.hypot(p.x - 0.76, p.y) - 0.05)
    plan = plan_dock(problem, time_budget=BUDGET, smoother=CasadiSmoother(terms=[post]))
    assert least(plan.path, lambda x, y: np.hypot(x - 0.76, y) - 0.05) > -1e-4
    reasons = [attempt.reason for attempt in plan.tried if "post" in attempt.reason]
    assert "after a straight line of 0.760 m out of contact" in reasons[0]


CAR = Robot(
    Footprint.rectangle(3.76, 0.929, 1.942),
    MotionLimits(max_curvature=0.33, max_curvature_rate=0.36, wheelbase=2.8, max_steering_rate=0.5),
    "ackermann",
)
BENDS = Arcs(
    np.array([[1.0, -2.0, 0.4]]), np.array([[0.5, 0.8, -0.7, -0.4, 1.2]]), np.array([[0.33, -0.33, -0.33, 0.0, 0.2]])
)


class OffersArcs(GlobalPlanner):
    """Offers arcs that cannot be smoothed."""

    def create_plan(self, start, goal, cancel_checker=never_cancelled):
        return next(iter(self.create_plans(start, goal))).path

    def create_plans(self, start, goal, cancel_checker=never_cancelled, better_than=lambda: math.inf):
        yield Guess(BENDS.path(0.075, BENDS.joints()[0, -1], "map"), "arcs")


class Fails(CasadiSmoother):
    """Cannot smooth anything, but has terms."""

    def smooth(self, path, max_time, **options):
        raise FailedToSmoothPath("nothing can be smoothed")


def test_a_plan_that_stops_at_bends_keeps_the_terms_or_does_not_exist():
    start, goal = (Pose2(*pose) for pose in BENDS.joints()[0, [0, -1]].tolist())
    problem = DockingProblem(start, Dock(goal), CAR)
    unsmoothed = plan_dock(problem, planner=OffersArcs(), smoother=Fails(), time_budget=BUDGET)
    reached = float(unsmoothed.path.sample(0.01).x.max())
    wide, tight = (HardTerm("wall", lambda p: p.at - p.x, at=reached + way) for way in (0.05, -0.05))
    plan = plan_dock(problem, planner=OffersArcs(), smoother=Fails(terms=[wide]), time_budget=BUDGET)
    assert plan.smoothing_report.sampled[0].least == pytest.approx(0.05, abs=1e-3)
    with pytest.raises(FailedToSmoothPath):
        plan_dock(problem, planner=OffersArcs(), smoother=Fails(terms=[tight]), time_budget=5.0)


def test_the_straight_line_out_of_contact_is_sampled_too():
    """The pipeline puts a line before the smoothed path, of which the smoother knows nothing."""
    wall = [[0.0, 0.3], [1.0, 0.3], [1.0, 0.6], [0.0, 0.6]]
    problem = dataclasses.replace(PROBLEM, obstacles=[wall], dock=Dock(Pose2(4.0, 0.0, 0.0), final_straight=0.3))

    def planned(*terms):
        smoother = CasadiSmoother(terms=terms)
        return plan_dock(problem, time_budget=2.0, planner="DockPlanner", smoother=smoother)

    length = HardTerm("length", lambda p: p.most - p.s, most=4.02)
    assert planned(length).smoothing_report.sampled[0].least == pytest.approx(0.02, abs=1e-6)
    with pytest.raises(FailedToSmoothPath) as no:
        planned(HardTerm("gap", lambda p: casadi.fabs(p.x - 0.5) - 0.1))
    assert no.value.where["term"] == "gap"
    assert 0.4 < no.value.where["s"] < 0.6


@pytest.fixture(scope="module", name="running")
def _running():
    return plan_dock(PROBLEM, time_budget=BUDGET)


def at_rest(plan, share=0.0):
    return DriveState(share * plan.trajectory.duration)


def test_a_deformed_path_keeps_the_terms_or_is_smoothed(running):
    moved = PROBLEM.goal @ Pose2(0.02, 0.01, 0.0)
    free = replan(running, moved, at_rest(running), BUDGET, lead=LEAD)
    assert free.plan.tried[-1].stage == "deformed"
    assert least(free.plan.path, lane) < -0.001
    room = 0.16  # the goal has moved
    smoother = CasadiSmoother(terms=[kept_lane(room=room)])
    found = replan(running, moved, at_rest(running), BUDGET, lead=LEAD, smoother=smoother)
    if found.outcome is ReplanOutcome.NEW:
        assert least(found.plan.path, lambda x, y: lane(x, y, room)) > -1e-4
        assert found.plan.smoothing_report.sampled[0].holds
    else:
        assert found.outcome is ReplanOutcome.STOP
    wide = CasadiSmoother(terms=[kept_lane(room=1.0)])
    same = replan(running, moved, at_rest(running), BUDGET, lead=LEAD, smoother=wide)
    assert same.plan.tried[-1].stage == "deformed"
    assert same.plan.smoothing_report.sampled[0].holds


def test_the_old_plan_is_kept_only_if_its_rest_keeps_the_terms(running):
    late = 0.9  # on the final straight: there is no new plan
    kept = replan(running, PROBLEM, at_rest(running, late), BUDGET, lead=LEAD)
    assert kept.outcome is ReplanOutcome.KEPT
    begins = running.trajectory.at(late * running.trajectory.duration).s
    behind = HardTerm("behind", lambda p: p.s - p.begins, begins=begins - 0.01)  # broken only where it has driven
    smoother = CasadiSmoother(terms=[behind])
    assert (
        replan(running, PROBLEM, at_rest(running, late), BUDGET, lead=LEAD, smoother=smoother).outcome is kept.outcome
    )
    ahead = HardTerm("ahead", lambda p: p.remaining - 0.05)
    smoother = CasadiSmoother(terms=[ahead])
    found = replan(
        running, PROBLEM, at_rest(running, late), BUDGET, lead=LEAD, smoother=smoother, planner="DockPlanner"
    )
    assert found.outcome is ReplanOutcome.STOP
    assert found.plan is None


class Answers(Smoother):
    """Returns anything as its own bounds."""

    answer = ()

    def smooth(self, path, max_time, **options):
        return CasadiSmoother().smooth(path, max_time, **options)

    def sampled_bounds(self, path, *, before=0.0):
        if isinstance(self.answer, Exception):
            raise self.answer
        return self.answer


@pytest.mark.parametrize("answer", [None, [], ("text",), ValueError("broken"), InvalidValue("broken")])
def test_a_smoother_that_answers_wrongly_is_a_faulty_plugin(answer):
    smoother = Answers()
    smoother.answer = answer
    with pytest.raises(PluginError):
        plan_dock(PROBLEM, time_budget=BUDGET, smoother=smoother)


@pytest.mark.parametrize("value", [math.nan, -math.inf, -2e-6])
def test_a_bound_without_a_value_does_not_hold(value):
    smoother = Answers()
    smoother.answer = (SampledBound("mine", value, 0.5, 0.01),)
    with pytest.raises(FailedToSmoothPath) as no:
        plan_dock(PROBLEM, time_budget=1.0, planner="DockPlanner", smoother=smoother)
    assert no.value.where["term"] == "mine"


def test_terms_have_no_name_in_files():
    with pytest.raises(InvalidValue, match="terms: unknown parameter"):
        plan_dock(PROBLEM, smoother=PluginChoice("CasadiSmoother", {"terms": [kept_lane()]}))
