"""DockGoalChecker: all of along, across, heading and rest, in one call, latched."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from checkers.dock_goal import DockGoalChecker
from optdock.errors import InvalidValue
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2, Twist2
from optdock.model.dock import Dock, DockTolerances
from optdock.model.limits import MotionLimits
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from optdock.plugins.interfaces import PluginContext

REST = Twist2()
GOAL = Pose2(3.0, 1.0, 0.4)
goals = st.builds(Pose2, st.floats(-5.0, 5.0), st.floats(-5.0, 5.0), st.floats(-4.0, 4.0))
offsets = st.tuples(st.floats(-0.05, 0.05), st.floats(-0.05, 0.05), st.floats(-0.1, 0.1))


def reached(checker, pose, goal, velocity=REST):
    return checker.is_goal_reached(pose, goal, velocity, [])


@settings(max_examples=25)
@given(goals, offsets)
def test_each_error_binds_in_the_frame_of_the_goal(goal, offset):
    along, cross, yaw = map(abs, offset)
    limits = (0.03, 0.01, 0.05)
    if min(abs(value - limit) for value, limit in zip((along, cross, yaw), limits, strict=True)) > 1e-9:
        checker = DockGoalChecker(along_tolerance=0.03, cross_tolerance=0.01)
        assert reached(checker, goal @ Pose2(*offset), goal) is (along < 0.03 and cross < 0.01 and yaw < 0.05)


def test_comparisons_are_inclusive():
    goal = Pose2(0.0, 0.0, 0.0)
    assert reached(DockGoalChecker(), Pose2(0.02, -0.02, 0.05), goal)
    for past in (Pose2(math.nextafter(0.02, 1), 0, 0), Pose2(0, math.nextafter(0.02, 1), 0), Pose2(0, 0, 0.0500001)):
        assert not reached(DockGoalChecker(), past, goal)


def test_a_moving_robot_is_not_docked_unless_stopped_is_off():
    goal = Pose2(1.0, 2.0, 0.5)
    for moving in (Twist2(0.011), Twist2(0.0, 0.021), Twist2(0.0, 0.0, 0.011)):
        assert not reached(DockGoalChecker(), goal, goal, moving)
        assert reached(DockGoalChecker(stopped=False), goal, goal, moving)
    assert reached(DockGoalChecker(), goal, goal, Twist2(0.01, 0.02))


def test_rolling_through_and_stopping_outside_is_not_docked():
    goal = Pose2(0.0, 0.0, 0.0)
    checker = DockGoalChecker()
    assert not reached(checker, goal, goal, Twist2(0.1))
    assert not reached(checker, Pose2(0.05, 0.0, 0.0), goal)


def test_the_verdict_stays_until_reset_when_stateful():
    goal, drifted = Pose2(0.0, 0.0, 0.0), Pose2(0.03, 0.0, 0.0)
    checker = DockGoalChecker()
    assert reached(checker, goal, goal)
    assert reached(checker, drifted, goal)
    checker.reset()
    assert not reached(checker, drifted, goal)
    stateless = DockGoalChecker(stateful=False)
    assert reached(stateless, goal, goal)
    assert not reached(stateless, drifted, goal)


def test_a_long_remaining_path_is_not_judged():
    goal = Pose2(0.0, 0.0, 0.0)
    assert not DockGoalChecker().is_goal_reached(goal, goal, REST, [Pose2(-2.0, 0.0, 0.0), goal])


def test_defaults_are_those_of_the_dock():
    found, dock = DockGoalChecker().tolerances, DockTolerances()
    assert (found.x, found.y, found.yaw) == (dock.along, dock.cross, dock.yaw)
    assert DockGoalChecker(stopped=False).tolerances.linear_speed is None


def test_negative_tolerances_are_refused():
    with pytest.raises(InvalidValue, match="cross_tolerance"):
        DockGoalChecker(cross_tolerance=-0.01)


def test_the_position_alone_is_no_arrival():
    goal, moving = Pose2(1.0, 2.0, 0.5), Twist2(0.3)
    checker = DockGoalChecker()
    assert checker.is_goal_xy_reached(goal @ Pose2(0.02 - 1e-9, 0.0, 1.0), goal, moving, [])
    assert not checker.is_goal_xy_reached(goal @ Pose2(0.0, 0.021, 0.0), goal, REST, [])
    assert not checker.is_goal_xy_reached(goal, goal, REST, [Pose2(-9.0, 0.0, 0.0), goal])
    assert not reached(checker, goal, goal, moving)
    assert reached(checker, goal, goal)
    assert checker.is_goal_xy_reached(goal @ Pose2(0.5, 0.0, 0.0), goal, moving, [])


def test_a_verdict_of_a_stateless_time_is_not_latched_later():
    goal, away = Pose2(0.0, 0.0, 0.0), Pose2(1.0, 0.0, 0.0)
    checker = DockGoalChecker(stateful=False)
    assert [reached(checker, pose, goal) for pose in (goal, away)] == [True, False]
    checker.set_parameters(stateful=True)
    assert not reached(checker, away, goal)


def test_tolerances_not_given_are_those_of_the_configured_dock():
    dock = Dock(GOAL, tolerances=DockTolerances(along=0.003, cross=0.004, yaw=0.005))
    problem = DockingProblem(Pose2(-2.0, 0.0, 0.0), dock, Robot(Footprint.from_radius(0.3), MotionLimits()))
    checker = DockGoalChecker(cross_tolerance=0.1)
    assert checker.tolerances[:3] == (0.02, 0.1, 0.05)
    checker.configure(PluginContext(problem=problem))
    assert checker.tolerances[:3] == (0.003, 0.1, 0.005)
    assert not checker.is_goal_reached(GOAL @ Pose2(0.0031, 0.0, 0.0), GOAL, Twist2(), [])
    assert checker.is_goal_reached(GOAL @ Pose2(0.0029, 0.05, 0.0), GOAL, Twist2(), [])
