"""Turn and drive: robots that turn in place get where others do not, and every turn is swept, timed and proven."""

import dataclasses
import functools
import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from experiments.dense_check import dense_check
from optdock.errors import OptdockError
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.model.clearance_rule import ClearanceRule
from optdock.model.dock import Dock
from optdock.model.limits import MotionLimits, TurnLimits
from optdock.model.path import Direction, Path, PolylineSegment, TurnSegment
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from optdock.planners.manoeuvres.manoeuvre_planner import Stages
from optdock.planners.manoeuvres.price import CUSP_PRICE, least_price, stops, turning_times
from optdock.planners.manoeuvres.turns import TurnsAndDrives, turns_and_drives
from optdock.planning.pipeline import plan_dock
from optdock.plugins.interfaces import Controller, GoalChecker
from optdock.plugins.registry import create_plugin
from optdock.simulation import run_closed_loop
from optdock.verification import certify_path, pose_clearances

LIMITS = MotionLimits(max_curvature=1.5, max_curvature_rate=6.0, max_yaw_rate=1.0, max_yaw_acceleration=2.0)
ROBOT = Robot(Footprint.rectangle(0.45, 0.45, 0.6), LIMITS, turns_in_place=True)
CORNER = math.hypot(0.45, 0.3)
RULE = ClearanceRule(0.05, 0.0, 0.5)


def box(x0, y0, x1, y1):
    return np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]], dtype=float)


def without(problem):
    return dataclasses.replace(problem, robot=dataclasses.replace(problem.robot, turns_in_place=False))


@functools.cache
def turning_guesses(problem):
    """What is offered among the first, beside words."""
    found = Stages(problem, 1.25, lambda: None, lambda: math.inf).guesses()
    return [one for one in itertools.islice(found, 6) if one is not None and one.stage == "turn and drive"]


@functools.cache
def ways_of_turns(problem):
    """The first six turns and drives that are searched for, without the words that compete with them."""
    found = Stages(problem, 1.25, lambda: None, lambda: math.inf)._turn_and_drive(turns_and_drives)
    return list(itertools.islice(found, 6))


LORRY = dataclasses.replace(ROBOT, limits=dataclasses.replace(LIMITS, max_curvature=0.4))


def alcove(start, robot=LORRY):
    """A dock at the end of an alcove, across an aisle in which the robot just turns: 1.26 m and 0.74 m wide."""
    wide = CORNER + 0.09
    walls = [
        box(-4.0, wide, 4.0, wide + 0.2),  # the far side of the aisle
        box(-4.0, -3.0, -0.37, -wide),
        box(0.37, -3.0, 4.0, -wide),
        box(-0.37, -3.0, 0.37, -2.8),
        box(-4.2, -3.0, -4.0, wide),
        box(4.0, -3.0, 4.2, wide),
    ]
    dock = Dock(Pose2(0.0, -2.3, -0.5 * math.pi), direction="forward", final_straight=0.3)
    return DockingProblem(start, dock, robot, walls, RULE)


def around_a_rack(start):
    return DockingProblem(
        start, Dock(Pose2(0.0, 0.0, 0.0), final_straight=0.3), ROBOT, [box(0.6, -3.0, 1.6, 3.0)], 0.05
    )


def near_a_kink(poses):
    """Which poses lie within a body's length of a corner that is left to a smoother."""
    step = np.diff(poses, axis=0)
    moved = np.hypot(step[:, 0], step[:, 1])
    slip = np.abs(np.sin(np.arctan2(step[:, 1], step[:, 0]) - poses[:-1, 2])) * (moved > 1e-6)
    kinks = poses[:-1][slip > 0.01, :2]
    away = np.hypot(*(poses[:, None, :2] - kinks[None]).T)
    return (away < 1.0).any(axis=0)


SCENES = {
    "open floor": DockingProblem(Pose2(-1.0, 2.0, 2.0), Dock(Pose2(0.0, 0.0, 0.0), final_straight=0.3), ROBOT),
    "backward": DockingProblem(Pose2(1.0, 1.0, 0.0), Dock(Pose2(0.0, 0.0, 0.0), direction="backward"), ROBOT),
    "alcove": alcove(Pose2(-2.0, 0.02, math.pi)),
    "around a rack": around_a_rack(Pose2(3.0, 0.5, 0.0)),
    "boxed in": DockingProblem(
        Pose2(-3.0, 0.0, math.pi),
        Dock(Pose2(0.0, 0.0, 0.0), final_straight=0.3),
        ROBOT,
        [box(-5.0, 0.36, -2.4, 0.5), box(-5.0, -0.5, -2.4, -0.36)],
        RULE,
    ),
    "turned in the dock": DockingProblem(Pose2(0.0, 0.0, 1.0), Dock(Pose2(0.0, 0.0, 0.0)), ROBOT),
    "round": DockingProblem(
        Pose2(-0.2, 1.5, 2.5),
        Dock(Pose2(0.0, 0.0, 0.0), final_straight=0.3),
        dataclasses.replace(ROBOT, footprint=Footprint.from_radius(0.3)),
        [box(0.35, -3.0, 0.5, 3.0)],
        RULE,
    ),
}


@pytest.mark.parametrize("name", SCENES)
def test_every_guess_leads_from_the_start_into_the_dock_and_is_free(name):
    problem = SCENES[name]
    guesses = turning_guesses(problem)
    assert guesses
    for guess in guesses:
        path = guess.path
        assert path.start.gap_to(problem.start) < 1e-12
        assert path.end.gap_to(problem.goal) < 1e-12
        poses = path.sample(0.01).poses
        found, _ = pose_clearances(poses, problem.robot.footprint, problem.all_obstacles, 1.0)
        from_goal, from_start = (np.hypot(*(poses[:, :2] - [p.x, p.y]).T) for p in (problem.goal, problem.start))
        kept, _ = pose_clearances(poses[:1], problem.robot.footprint, problem.all_obstacles, 1.0)
        required = problem.clearance.required_at(from_goal, from_start, float(kept[0]), problem.start_run)
        # Corners that a smoother rounds are not swept; everything else is driven as it is.
        gap = (found - required)[~near_a_kink(poses)]
        assert gap.size == 0 or gap.min() > -2e-3


@pytest.mark.parametrize("name", ["around a rack", "boxed in", "turned in the dock", "round"])
def test_guesses_become_plans(name):
    problem = SCENES[name]
    plan = plan_dock(problem, planner="ManoeuvrePlanner", time_budget=20.0)
    assert plan.certificate.certified
    assert plan.trajectory_certificate.certified
    assert not dense_check(plan.path, problem).faults
    assert any(one.stage == "turn and drive" for one in plan.tried)


def test_robot_that_turns_gets_into_an_alcove_where_others_do_not():
    problem = SCENES["alcove"]
    plan = plan_dock(problem, time_budget=20.0)
    assert plan.stage == "turn and drive"
    assert plan.path.turns
    with pytest.raises(OptdockError):
        plan_dock(without(problem), time_budget=0.1)
    # The very same path is refused without the permission, for its turns alone, and holds with it.
    refused = certify_path(plan.path, without(problem))
    assert {violation.kind for violation in refused.violations} == {"turn"}
    assert certify_path(plan.path, problem).certified
    checker = create_plugin(GoalChecker, "DockGoalChecker")
    controller = create_plugin(Controller, "TrackingController")
    run = run_closed_loop(plan.trajectory, problem.robot, problem.goal, controller, checker)
    assert run.docked, run.reason
    clearance, _ = pose_clearances(run.poses, ROBOT.footprint, problem.all_obstacles)
    assert clearance.min() > 0.0


def test_robots_that_do_not_turn_in_place_get_no_turns():
    """No stage of turns for robots that do not turn in place, nor for one in motion."""
    problem = SCENES["open floor"]
    assert not turning_guesses(without(problem))
    assert not turning_guesses(dataclasses.replace(problem, start_speed=0.1))


@settings(max_examples=10, deadline=None)
@given(st.floats(-math.pi, math.pi), st.floats(-math.pi, math.pi), st.floats(1.5, 4.0))
def test_on_open_floor_turns_go_the_shorter_way(yaw, bearing, away):
    start = Pose2(away * math.cos(bearing), away * math.sin(bearing), yaw)
    problem = DockingProblem(start, Dock(Pose2(0.0, 0.0, 0.0), final_straight=0.3), ROBOT)
    for guess in ways_of_turns(problem):
        for segment in guess.path.segments:
            if isinstance(segment, TurnSegment):
                assert abs(segment.turn) <= math.pi + 1e-9


def beside_a_post(gap, side):
    """The robot looks along x and must turn by 120 degrees; a post stands in the way of a rear corner alone."""
    out = np.array([math.cos(1.9), -side * math.sin(1.9)])
    across = np.array([-out[1], out[0]])
    near = (CORNER + gap) * out
    post = [near, near + 0.02 * out + 0.02 * across, near + 0.04 * out, near + 0.02 * out - 0.02 * across]
    yaw = side * 2.0 * math.pi / 3.0
    dock = Dock(Pose2(4.0 * math.cos(yaw), 4.0 * math.sin(yaw), yaw), direction="forward", final_straight=0.3)
    return DockingProblem(Pose2(0.0, 0.0, 0.0), dock, ROBOT, [post], RULE)


def first_turns(problem):
    """Turns where the robot starts, of the ways that are offered."""
    found = [guess.path.segments[0] for guess in ways_of_turns(problem)]
    return [one.turn for one in found if isinstance(one, TurnSegment)]


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_post_at_the_radius_of_a_corner_blocks_a_turn(side):
    """Neither drive meets it, nor does the robot before the turn or after it."""
    wanted = side * 2.0 * math.pi / 3.0
    near, free = beside_a_post(0.04, side), beside_a_post(0.07, side)
    assert any(abs(turn - wanted) < 1e-6 for turn in first_turns(free))
    assert not any(abs(turn - wanted) < 1e-6 for turn in first_turns(near))
    # The certificate says so as well, whoever proposes it.
    turn = TurnSegment(near.start, wanted)
    line = PolylineSegment([turn.end.as_array(), near.goal.as_array()], Direction.FORWARD)
    refused = certify_path(Path((turn, line)), near)
    assert [violation.kind for violation in refused.violations] == ["clearance"]
    assert 0.0 < refused.violations[0].s < turn.length
    assert certify_path(Path((turn, line)), free).certified


def test_where_the_turn_to_one_side_is_blocked_the_other_side_is_taken():
    """A post blocks left turns, and walls the way out straight on: it turns right, and drives in reverse at first."""
    near = beside_a_post(0.04, 1.0)
    walls = [box(0.6, -0.05, 0.7, 0.05), box(-0.7, -0.05, -0.6, 0.05)]
    boxed = dataclasses.replace(near, obstacles=(*[one[:4] for one in (near.obstacles.vertices)], *walls))
    turns = first_turns(boxed)
    assert turns
    assert all(turn < 0.0 for turn in turns)


# Prices.


@settings(max_examples=25, deadline=None)
@given(st.floats(0.0, 7.0), st.floats(0.1, 3.0), st.floats(0.1, 5.0))
def test_turn_takes_the_time_of_a_trapezoid(turn, rate, acceleration):
    took = float(turning_times(np.array([turn]), TurnLimits(rate, acceleration, 1.0))[0])
    if turn <= rate**2 / acceleration:
        assert took == pytest.approx(2.0 * math.sqrt(turn / acceleration))
    else:
        assert took == pytest.approx(turn / rate + rate / acceleration)


def test_a_robot_in_the_dock_neither_turns_nor_drives():
    nothing = TurnsAndDrives(np.array([1.0, 2.0, 0.5]), np.zeros(2), np.zeros(2))
    assert nothing.path(0.05, Pose2(1.0, 2.0, 0.5), "map") is None


def test_turn_and_the_rests_around_it_are_one_stop():
    start, middle = Pose2(0.0, 0.0, 0.0), Pose2(1.0, 0.0, 0.0)
    line = PolylineSegment([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    onwards = PolylineSegment([[1.0, 0.0, 1.0], [1.0 + math.cos(1.0), math.sin(1.0), 1.0]])
    assert stops(Path((line,))) == 0
    assert stops(Path((TurnSegment(Pose2(0.0, 0.0, -1.0), 1.0), line))) == 0
    assert stops(Path((line, TurnSegment(middle, 1.0), onwards))) == 1
    back = PolylineSegment([[1.0, 0.0, 0.0], [0.5, 0.0, 0.0]], Direction.REVERSE)
    assert stops(Path((line, back))) == 1
    problem = DockingProblem(start, Dock(middle), ROBOT)
    turned = Path((TurnSegment(Pose2(0.0, 0.0, -1.0), 1.0), line))
    assert least_price(turned, problem) == pytest.approx(
        least_price(Path((line,)), problem) + float(turning_times(np.ones(1), LIMITS.turning)[0])
    )
    assert least_price(Path((line, back)), problem) > least_price(Path((line,)), problem) + CUSP_PRICE
