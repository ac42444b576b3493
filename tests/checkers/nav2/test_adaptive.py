"""AdaptiveToleranceGoalChecker, sentence by sentence."""

import math

import pytest

from checkers.nav2.adaptive import AdaptiveToleranceGoalChecker
from optdock.errors import InvalidValue
from optdock.geometry.pose import Pose2, Twist2

EPSILON = 2.0**-52
GOAL = Pose2(0.0, 0.0, 0.0)
REST, MOVING = Twist2(), Twist2(0.5, 0.3)


def adaptive(cycles=3, **parameters):
    return AdaptiveToleranceGoalChecker(required_stagnation_cycles=cycles, **parameters)


def verdicts(checker, places, velocity=REST):
    """Verdicts of one call per place; a number is x."""
    poses = [place if isinstance(place, Pose2) else Pose2(place, 0.0, 0.0) for place in places]
    return [checker.is_goal_reached(pose, GOAL, velocity, []) for pose in poses]


def test_inside_fine_it_accepts_at_once_at_any_speed_inclusively():
    side = 0.1 / math.sqrt(2.0)
    for place in (0.0, 0.1, Pose2(side, side, 0.0)):
        assert verdicts(adaptive(), [place], MOVING) == [True]
    for place in (0.1 + EPSILON, Pose2(side + EPSILON, side + EPSILON, 0.0)):
        assert verdicts(adaptive(), [place]) == [False]


@pytest.mark.parametrize("velocity", [REST, MOVING])
def test_inside_coarse_the_first_call_only_enters_and_stagnation_accepts(velocity):
    assert verdicts(adaptive(), [-0.25] * 4, velocity) == [False, False, False, True]
    assert verdicts(adaptive(), [-0.25 - EPSILON] * 6, velocity) == [False] * 6


def test_a_stopped_robot_is_accepted_although_it_still_improves():
    assert verdicts(adaptive(), [-0.24, -0.22, -0.20, -0.18]) == [False, False, False, True]


def test_a_new_best_distance_restarts_the_count_of_a_moving_robot():
    places = [-0.24, -0.24, -0.24, -0.2, -0.2, -0.2, -0.2]
    assert verdicts(adaptive(), places, MOVING) == [False] * 6 + [True]


def test_moving_restarts_the_count_of_a_robot_that_improves():
    checker = adaptive()
    assert verdicts(checker, [-0.24, -0.23, -0.22]) == [False] * 3
    assert verdicts(checker, [-0.21], MOVING) == [False]
    assert verdicts(checker, [-0.20, -0.19, -0.18]) == [False, False, True]


@pytest.mark.parametrize("velocity", [Twist2(0.10), Twist2(0.0, -0.10)])
def test_the_stopped_speeds_are_inclusive(velocity):
    assert verdicts(adaptive(), [-0.24, -0.22, -0.20, -0.18], velocity)[-1]


@pytest.mark.parametrize("velocity", [Twist2(0.10 + EPSILON), Twist2(0.0, 0.1 + EPSILON), Twist2(0.08, 0.0, 0.08)])
def test_one_epsilon_faster_is_moving(velocity):
    assert not verdicts(adaptive(), [-0.24, -0.22, -0.20, -0.18], velocity)[-1]


def test_crossing_the_line_through_the_goal_accepts_a_moving_robot():
    entry, just_before = Pose2(-0.2, 0.12, 0.0), Pose2(-0.06, -0.09, 0.0)
    across = Pose2(-0.12, -0.2, 0.0)  # exactly on the line
    assert verdicts(adaptive(9), [entry, just_before, across], MOVING) == [False, False, True]


def test_leaving_coarse_starts_afresh_with_a_new_entry():
    places = [-0.2, -0.2, -0.3, -0.2, -0.2, -0.2, -0.2]
    assert verdicts(adaptive(), places) == [False] * 6 + [True]
    assert verdicts(adaptive(9), [-0.2, -0.3, 0.2, 0.19], MOVING) == [False] * 4


def test_acceptance_latches_until_reset():
    checker = adaptive()
    assert verdicts(checker, [0.05, 0.5]) == [True, True]
    checker.reset()
    assert verdicts(checker, [0.5]) == [False]


def test_without_state_every_call_is_independent():
    assert verdicts(adaptive(stateful=False), [0.05, 0.5]) == [True, False]


def test_the_buffer_counts_from_the_radius_that_accepted():
    fine = adaptive(xy_goal_tolerance_buffer=0.05)
    assert verdicts(fine, [0.1, 0.15, 0.16, 0.15]) == [True, True, False, False]
    coarse = adaptive(xy_goal_tolerance_buffer=0.05)
    assert verdicts(coarse, [-0.2] * 4 + [-0.3, -0.31, -0.2]) == [False] * 3 + [True, True, False, False]


def test_reset_clears_the_counters():
    checker = adaptive()
    assert verdicts(checker, [-0.2] * 3) == [False] * 3
    checker.reset()
    assert verdicts(checker, [-0.2] * 4) == [False, False, False, True]


def test_the_heading_is_checked_at_every_call_and_may_be_symmetric():
    turned = Pose2(0.0, 0.0, math.pi + 0.1)
    checker = adaptive()
    assert verdicts(checker, [turned, Pose2(0.5, 0.0, 0.25)]) == [False, True]
    assert verdicts(adaptive(symmetric_yaw_tolerance=True), [turned]) == [True]
    assert verdicts(adaptive(symmetric_yaw_tolerance=True), [Pose2(0.0, 0.0, math.pi / 2.0)]) == [False]


def test_the_path_length_rule_comes_first():
    checker = adaptive()
    assert not checker.is_goal_reached(GOAL, GOAL, REST, [Pose2(-5.0, 0.0, 0.0), GOAL])
    assert checker.is_goal_reached(GOAL, GOAL, REST, [Pose2(-1.0, 0.0, 0.0), GOAL])


def test_a_coarse_radius_inside_the_fine_one_makes_it_a_simple_checker():
    assert verdicts(adaptive(fine_xy_goal_tolerance=0.3), [0.3, 0.4]) == [True, True]


def test_zero_cycles_and_negative_tolerances_are_refused():
    with pytest.raises(InvalidValue, match="required_stagnation_cycles"):
        adaptive(0)
    with pytest.raises(InvalidValue, match="coarse_xy_goal_tolerance"):
        adaptive(coarse_xy_goal_tolerance=-1.0)
    assert AdaptiveToleranceGoalChecker().parameters.required_stagnation_cycles == 15


def test_tolerances_report_the_coarse_radius():
    assert adaptive().tolerances == (0.25, 0.25, 0.25, 0.1, 0.1, 1.0)


def test_the_position_alone_counts_as_a_cycle_and_latches():
    checker, turned = adaptive(), Pose2(-0.25, 0.0, 2.0)
    assert [checker.is_goal_xy_reached(turned, GOAL, REST, []) for _ in range(4)] == [False, False, False, True]
    assert not checker.is_goal_reached(turned, GOAL, REST, [])
    assert checker.is_goal_reached(Pose2(9.0, 0.0, 0.0), GOAL, REST, [])
