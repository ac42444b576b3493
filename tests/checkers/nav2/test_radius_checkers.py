"""Simple, Position and Stopped: what they share, sentence by sentence, and what each adds."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from checkers.nav2.position import PositionGoalChecker
from checkers.nav2.simple_goal import SimpleGoalChecker
from checkers.nav2.stopped import StoppedGoalChecker
from optdock.errors import InvalidValue
from optdock.geometry.pose import Pose2, Twist2
from optdock.plugins.interfaces import GoalChecker
from optdock.plugins.registry import create_plugin

REST = Twist2()
GOAL = Pose2(0.0, 0.0, 0.0)
EPSILON = 2.0**-52
ALL = (SimpleGoalChecker, PositionGoalChecker, StoppedGoalChecker)


def at(x=0.0, y=0.0, yaw=0.0):
    return Pose2(x, y, yaw)


def reached(checker, pose, velocity=REST, path=(), goal=GOAL):
    return checker.is_goal_reached(pose, goal, velocity, path)


@pytest.mark.parametrize("kind", ALL)
class TestEveryRadiusChecker:
    @pytest.mark.parametrize("tolerance", [0.1, 0.25, 1.0])
    def test_the_radius_is_inclusive_and_one_epsilon_past_it_is_outside(self, kind, tolerance):
        side = tolerance / math.sqrt(2.0)
        for inside in (at(tolerance), at(0.0, -tolerance), at(side, side)):
            assert reached(kind(xy_goal_tolerance=tolerance), inside)
        for outside in (at(tolerance + EPSILON), at(0.0, -tolerance - EPSILON), at(side + EPSILON, side + EPSILON)):
            assert not reached(kind(xy_goal_tolerance=tolerance), outside)

    def test_the_path_length_rule_comes_first_and_is_inclusive(self, kind):
        checker = kind()
        assert reached(checker, GOAL, path=[at(-1.0), GOAL])
        assert not reached(checker, GOAL, path=[at(-1.0 - EPSILON), GOAL])
        assert not reached(checker, GOAL, path=[at(-5.0), GOAL])
        assert reached(checker, GOAL, path=[at(5.0)])

    def test_a_long_path_leaves_the_latch_alone(self, kind):
        checker = kind()
        assert reached(checker, GOAL)
        assert not reached(checker, GOAL, path=[at(-5.0), GOAL])
        assert reached(checker, at(0.5))

    def test_the_position_latches_when_stateful_until_reset(self, kind):
        checker = kind()
        assert reached(checker, at(0.2))
        assert reached(checker, at(9.0))
        checker.reset()
        assert not reached(checker, at(9.0))

    def test_the_position_is_checked_at_every_call_when_not_stateful(self, kind):
        checker = kind(stateful=False, xy_goal_tolerance_buffer=0.5)
        assert reached(checker, at(0.2))
        assert not reached(checker, at(0.3))

    def test_the_buffer_unlatches_beyond_tolerance_plus_buffer_and_latches_again_at_the_tolerance(self, kind):
        checker = kind(xy_goal_tolerance=0.25, xy_goal_tolerance_buffer=0.25)
        assert reached(checker, at(0.25))
        assert reached(checker, at(0.5))
        assert not reached(checker, at(0.5 + EPSILON))
        assert not reached(checker, at(0.4))
        assert reached(checker, at(0.25))
        assert reached(checker, at(0.4))

    def test_the_position_alone_honours_and_sets_the_latch(self, kind):
        checker = kind()
        turned, fast = at(0.25, yaw=2.0), Twist2(1.0, 1.0)
        assert not checker.is_goal_xy_reached(at(0.25 + EPSILON), GOAL, fast, [])
        assert not checker.is_goal_xy_reached(turned, GOAL, fast, [at(-5.0), GOAL])
        assert checker.is_goal_xy_reached(turned, GOAL, fast, [])
        assert checker.is_goal_xy_reached(at(9.0), GOAL, fast, [])
        assert reached(checker, at(9.0))
        checker.reset()
        assert not checker.is_goal_xy_reached(at(9.0), GOAL, fast, [])

    def test_negative_or_unknown_parameters_are_refused(self, kind):
        for name in ("xy_goal_tolerance", "path_length_tolerance", "xy_goal_tolerance_buffer"):
            with pytest.raises(InvalidValue, match=name):
                kind(**{name: -0.1})
        with pytest.raises(InvalidValue, match="did you mean xy_goal_tolerance"):
            kind(xy_goal_tolerence=0.1)

    def test_it_is_found_under_nav2s_name(self, kind):
        assert isinstance(create_plugin(GoalChecker, f"nav2_controller::{kind.__name__}"), kind)


@pytest.mark.parametrize("kind", [SimpleGoalChecker, StoppedGoalChecker])
class TestTheHeading:
    @pytest.mark.parametrize("sign", [-1.0, 1.0])
    def test_is_inclusive_and_one_epsilon_past_it_is_outside(self, kind, sign):
        assert reached(kind(), at(yaw=sign * 0.25))
        assert not reached(kind(), at(yaw=sign * (0.25 + EPSILON)))

    @given(turns=st.integers(-3, 3), goal=st.floats(-7.0, 7.0), error=st.floats(-3.1, 3.1))
    def test_is_the_shortest_angle(self, kind, turns, goal, error):
        pose = at(yaw=goal + error + turns * 2.0 * math.pi)
        if abs(abs(error) - 0.25) > 1e-9:
            assert reached(kind(), pose, goal=at(yaw=goal)) is (abs(error) < 0.25)

    def test_is_checked_at_every_call_and_a_failing_one_still_latches_the_position(self, kind):
        checker = kind()
        assert not reached(checker, at(0.2, yaw=1.0))
        assert reached(checker, at(2.0, yaw=0.1))
        assert not reached(checker, at(2.0, yaw=1.0))

    def test_a_symmetric_one_accepts_the_opposite_too(self, kind):
        symmetric = kind(symmetric_yaw_tolerance=True)
        for yaw in (0.2, math.pi + 0.2, -math.pi + 0.2, math.pi - 0.2):
            assert reached(symmetric, at(yaw=yaw))
        assert not reached(symmetric, at(yaw=math.pi / 2.0))
        assert not reached(symmetric, at(yaw=math.pi + 0.3))
        assert not reached(kind(), at(yaw=math.pi))


def test_position_ignores_heading_and_speed():
    assert reached(PositionGoalChecker(), at(0.1, yaw=3.0), Twist2(1.0, 1.0))


def test_simple_ignores_the_speed():
    assert reached(SimpleGoalChecker(), at(0.1), Twist2(1.0, 1.0))


class TestStopped:
    @pytest.mark.parametrize(
        ("inside", "outside"),
        [
            (Twist2(0.25), Twist2(0.25 + EPSILON)),
            (Twist2(-0.25), Twist2(-0.25 - EPSILON)),
            (Twist2(0.0, 0.25), Twist2(0.0, 0.25 + EPSILON)),
            (Twist2(0.0, -0.25), Twist2(0.0, -0.25 - EPSILON)),
            (Twist2(0.25 / math.sqrt(2.0), 0.0, 0.25 / math.sqrt(2.0)), Twist2(0.2, 0.0, 0.2)),
        ],
    )
    def test_both_speeds_are_inclusive_and_sideways_counts(self, inside, outside):
        assert reached(StoppedGoalChecker(), GOAL, inside)
        assert not reached(StoppedGoalChecker(), GOAL, outside)

    def test_a_moving_robot_latches_its_position(self):
        checker = StoppedGoalChecker()
        assert not reached(checker, GOAL, Twist2(1.0))
        assert reached(checker, at(2.0))


def test_tolerances_are_none_where_nothing_is_measured():
    assert PositionGoalChecker(xy_goal_tolerance=0.1).tolerances == (0.1, 0.1, None, None, None, 1.0)
    assert SimpleGoalChecker(xy_goal_tolerance=0.1).tolerances == (0.1, 0.1, 0.25, None, None, 1.0)
    assert StoppedGoalChecker(trans_stopped_velocity=0.1).tolerances == (0.25, 0.25, 0.25, 0.1, 0.25, 1.0)
