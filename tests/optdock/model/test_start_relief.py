"""Start relief: a robot along a wall may keep its start clearance over twice its length, as its certificate states."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from experiments.dense_check import dense_check
from optdock.geometry.footprint import Footprint
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import Pose2
from optdock.model.clearance_rule import ClearanceRule
from optdock.model.dock import Dock
from optdock.model.limits import MotionLimits
from optdock.model.path import Path
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from optdock.verification import certify_path
from smoothers.casadi_smoother import CasadiSmoother

ROBOT = Robot(Footprint.rectangle(0.45, 0.45, 0.6), MotionLimits(max_curvature=1.5, max_curvature_rate=6.0))
REQUIRED = 0.05
RUN = 1.8  # [m]: twice the robot's length
WALL = [[-5.0, 0.3], [9.0, 0.3], [9.0, 0.5], [-5.0, 0.5]]


def along_the_wall(length, gap, *others, turned=0.0, required=REQUIRED):
    """Return a robot at `gap` [m] from a wall on its left, and a straight path of `length` [m]."""
    start = Pose2(0.0, -gap, 0.0)
    goal = Pose2(length, -gap + turned, 0.0)
    problem = DockingProblem(
        start, Dock(goal), ROBOT, ObstacleSet.from_polygons([WALL, *others]), ClearanceRule(required, required, 0.0)
    )
    x = np.linspace(0.0, length, 40)
    return Path.from_poses(np.column_stack((x, np.full(40, -gap), np.zeros(40)))), problem


def least(gap):
    """Return the requirement of the weaker rule near a start with this clearance [m]."""
    return max(gap - 0.005, 0.5 * gap)


@settings(max_examples=25)
@given(st.floats(0.2, 4.0), st.floats(0.0, 0.1))
def test_the_start_clearance_suffices_over_twice_the_length_only(length, gap):
    path, problem = along_the_wall(length, gap)
    certificate, run = certify_path(path, problem), problem.start_run
    assert run == pytest.approx(RUN)
    if gap >= REQUIRED:
        assert certificate.certified
        assert certificate.start_relief == 0.0
    elif length <= run:
        assert certificate.certified
        assert certificate.start_relief == run
    elif length > run + 2.0 * (gap - least(gap)) + 1e-5:
        assert not certificate.certified
        assert certificate.start_relief == 0.0
    if abs(length - run - 2.0 * (gap - least(gap))) > 1e-4 and abs(gap - REQUIRED) > 1e-5:
        report = dense_check(path, problem, 0.01)
        assert report.ok is certificate.certified
        assert report.start_relief == pytest.approx(certificate.start_relief)


@pytest.mark.parametrize("ahead", [0.45, 0.85, 0.05])
@pytest.mark.parametrize("beyond", [-1e-4, 1e-4])
def test_the_run_is_twice_the_length_of_the_robot_to_0_1_mm(ahead, beyond):
    """For any origin of the robot; 0.1 mm beyond the run the requirement exceeds twice the tolerance."""
    robot = Robot(Footprint.rectangle(ahead, 0.9 - ahead, 0.6), ROBOT.limits)
    path, problem = along_the_wall(RUN + 0.01 + beyond, 0.01)  # 5 mm less than it has, and a slope of 1/2
    wider = DockingProblem(problem.start, problem.dock, robot, problem.obstacles, ClearanceRule(REQUIRED, 0.01, 0.0))
    certificate = certify_path(path, wider)
    assert wider.start_run == pytest.approx(RUN)
    assert certificate.certified is (beyond < 0.0)
    assert certificate.start_relief == (wider.start_run if beyond < 0.0 else 0.0)


def test_a_plan_file_says_which_rule_holds():
    certificate = certify_path(*along_the_wall(0.8, 0.01))
    assert certificate.as_dict()["start_relief"] == pytest.approx(RUN)
    assert "1.80 m" in repr(certificate)


@pytest.mark.parametrize(("gap", "deep"), [(0.01, 0.002), (0.0, 0.001), (0.045, 0.02)])
def test_no_obstacle_may_come_much_closer_than_at_the_start(gap, deep):
    path, problem = along_the_wall(0.8, gap)
    assert certify_path(path, problem).certified
    # A thin post beside the other side of the robot, closer than what is enough at its start.
    y = -gap - 0.3 - least(gap) + deep
    post = [[0.9, y - 0.1], [0.902, y - 0.1], [0.902, y], [0.9, y]]
    path, problem = along_the_wall(0.8, gap, post)
    certificate = certify_path(path, problem)
    assert not certificate.certified
    assert not dense_check(path, problem, 0.002).ok


def test_a_robot_that_starts_with_enough_clearance_has_no_relief():
    y = -0.06 - 0.3 - 0.03
    post = [[0.9, y - 0.1], [0.902, y - 0.1], [0.902, y], [0.9, y]]
    path, problem = along_the_wall(0.8, 0.06, post)
    assert not certify_path(path, problem).certified
    assert not dense_check(path, problem, 0.002).ok


def test_beyond_the_run_it_must_leave_at_the_slope_of_the_strict_rule():
    for more, holds in ((1e-3, True), (-1e-3, False)):
        run, gap = RUN, 0.01  # it sets off with 5 mm more than it needs
        x = np.linspace(0.0, run + 0.06, 400)
        y = 0.005 - gap - 0.5 * np.maximum(0.0, x - run) - more * np.clip((x - run) / 0.02, 0.0, 1.0)
        y -= 0.005 * np.clip(1.0 - x / 0.1, 0.0, 1.0)
        path = Path.from_poses(np.column_stack((x, y, np.zeros(400))))
        problem = along_the_wall(RUN + 0.1, gap)[1]
        kinds = {violation.kind for violation in certify_path(path, problem).violations}
        assert ("clearance" not in kinds and "unproven" not in kinds) is holds


@pytest.mark.parametrize("gap", [0.004, 0.02])
@pytest.mark.parametrize("mirror", [1.0, -1.0])
def test_the_smoother_leaves_a_wall_by_the_weaker_rule(gap, mirror):
    # Its nose points a little away from the wall, its tail is beside it: straight ahead it gains a tenth of its way.
    wall = np.array(WALL) * [1.0, mirror]
    start = Pose2(0.0, (0.3 - gap - 0.45 * math.sin(0.1) - 0.3 * math.cos(0.1)) * mirror, -0.1 * mirror)
    goal = Pose2(3.5, -0.9 * mirror, 0.0)
    problem = DockingProblem(start, Dock(goal), ROBOT, ObstacleSet.from_polygons([wall]), ClearanceRule(REQUIRED))
    raw = Path.from_poses(
        [start, Pose2(1.2, start.y - 0.12 * mirror, -0.2 * mirror), Pose2(2.4, -0.8 * mirror, 0.0), goal]
    )
    result = CasadiSmoother().smooth(raw, 30.0, problem=problem)
    assert result.report.certificate.certified
    assert result.report.certificate.start_relief == pytest.approx(RUN)
    report = dense_check(result.path, problem)
    assert report.ok
    assert report.start_relief == pytest.approx(RUN)


RULES = st.builds(
    lambda required, share, taper, run, least: ClearanceRule(
        required, share * required, taper, run, None if least is None else least * required
    ),
    st.floats(0.0, 0.2),
    st.floats(0.0, 1.0),
    st.floats(0.0, 1.0),
    st.floats(0.0, 1.5),
    st.none() | st.floats(0.0, 1.0),
)


@settings(max_examples=25)
@given(RULES, st.floats(0.0, 0.2), st.floats(0.0, 3.0), st.floats(0.0, 3.0), st.floats(0.1, 2.0))
def test_the_weaker_rule_is_monotonic_and_never_above_the_strict_one(rule, kept, at, beyond, relief):
    strict, weak = (float(rule.near_start(np.array([at]), kept, run)[0]) for run in (0.0, relief))
    assert weak <= strict
    assert weak <= float(rule.near_start(np.array([at + beyond]), kept, relief)[0])
    if rule.at_start is None:
        assert weak >= least(kept)


def reversed_plan(path, problem):
    """Return the path in the opposite direction: from the dock to the former start."""
    poses = path.sample(0.005).poses[::-1]
    rule = dataclasses.replace(problem.clearance, at_start=problem.clearance.at_dock)
    back = DockingProblem(problem.goal, Dock(problem.start), problem.robot, problem.obstacles, rule)
    return Path.from_poses(poses), back


@settings(max_examples=20)
@given(st.floats(0.0, 0.06), st.floats(0.0, 0.05), st.floats(0.1, 1.0), st.sampled_from([0.0, 0.4]))
def test_a_reversed_docking_path_is_certified(gap, at_dock, taper, run):
    """Along a wall that ends at the distance from the dock at which the taper is satisfied, or slightly later."""
    rule = ClearanceRule(REQUIRED, at_dock, taper, run)
    for beyond in (-0.01, 0.01):
        reach = run + taper * (gap - at_dock) / (REQUIRED - at_dock) if at_dock < REQUIRED else 0.0
        behind = max(reach, 0.0) - 0.45 + beyond  # the nose comes to the wall as far from the dock as the taper allows
        wall = [[-behind, 0.3 + gap], [0.5, 0.3 + gap], [0.5, 0.5 + gap], [-behind, 0.5 + gap]]
        start = Pose2(-2.0, 0.0, 0.0)
        problem = DockingProblem(start, Dock(Pose2(0.0, 0.0, 0.0)), ROBOT, [wall], rule)
        path = Path.from_poses(np.column_stack((np.linspace(-2.0, 0.0, 401), np.zeros(401), np.zeros(401))))
        docked = certify_path(path, problem)
        if docked.certified:
            left = certify_path(*reversed_plan(path, problem))
            assert left.certified, left
            assert dense_check(*reversed_plan(path, problem), 0.002).ok


@pytest.mark.parametrize("gap", [0.0, 0.002, 0.03])
@pytest.mark.parametrize(("run", "holds"), [(0.0, False), (1.4, False), (1.5, True)])
def test_a_dock_along_a_wall_needs_a_dock_run(gap, run, holds):
    """The nose reaches the wall 1.45 m before the dock."""
    wall = [[-1.0, 0.3 + gap], [1.0, 0.3 + gap], [1.0, 0.5 + gap], [-1.0, 0.5 + gap]]
    path = Path.from_poses(np.column_stack((np.linspace(-3.0, 0.0, 301), np.zeros(301), np.zeros(301))))
    problem = DockingProblem(path.start, Dock(path.end), ROBOT, [wall], ClearanceRule(REQUIRED, 0.0, 0.0, run))
    assert certify_path(path, problem).certified is holds
    assert dense_check(path, problem, 0.002).ok is holds


@pytest.mark.parametrize(("gap", "enough"), [(0.004, 0.002), (0.02, 0.015)])
@pytest.mark.parametrize("beyond", [-1e-4, 1e-4])
def test_the_slack_is_five_millimetres_or_half_of_the_start_clearance(gap, enough, beyond):
    """A post that the robot passes within its own length, on the side without a wall."""
    y = -gap - 0.3 - (enough + beyond)
    path, problem = along_the_wall(0.8, gap, [[0.9, y - 0.1], [0.902, y - 0.1], [0.902, y], [0.9, y]])
    assert certify_path(path, problem).certified is (beyond > 0.0)
    assert dense_check(path, problem, 0.002).ok is (beyond > 0.0)


@settings(max_examples=25)
@given(RULES, st.floats(0.0, 0.3), st.floats(0.0, 0.1), st.floats(0.0, 3.0), st.floats(0.0, 3.0))
def test_a_raised_rule_requires_the_increase_everywhere(rule, kept, more, from_goal, from_start):
    at = np.array([from_goal]), np.array([from_start])
    for relief in (0.0, RUN):
        start = rule.raised_start(more, kept, relief)
        raised, plain = rule.raised(more).required_at(*at, start, relief), rule.required_at(*at, kept, relief)
        assert raised == pytest.approx(plain + more, abs=1e-12)
