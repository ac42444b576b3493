"""AxisGoalChecker against its document, the trigonometric form, and what separates Nav2's variants."""

import math

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from checkers.axis import AxisGoalChecker
from optdock.errors import InvalidValue
from optdock.geometry.pose import Pose2, Twist2

REST = Twist2()
ORIGIN = Pose2(0.0, 0.0, 0.0)
AHEAD = [Pose2(-0.5, 0.0, 0.0), ORIGIN]  # axis +x

coordinate = st.floats(-0.6, 0.6)
poses = st.builds(Pose2, coordinate, coordinate, st.floats(-4.0, 4.0))


def reached(checker, robot, path=AHEAD, goal=None):
    return checker.is_goal_reached(robot, goal or path[-1], REST, path)


def document_form(robot, path, along_tolerance, cross_tolerance, *, overshoot):
    """The rst's four steps, with its angles."""
    before, goal = path[-2], path[-1]
    end_of_path_yaw = math.atan2(goal.y - before.y, goal.x - before.x)
    robot_to_goal_yaw = math.atan2(goal.y - robot.y, goal.x - robot.x)
    distance = math.hypot(goal.x - robot.x, goal.y - robot.y)
    angle = math.remainder(end_of_path_yaw - robot_to_goal_yaw, 2.0 * math.pi)
    along, cross = distance * math.cos(angle), distance * math.sin(angle)
    near = along if overshoot else abs(along)
    return near < along_tolerance and abs(cross) < cross_tolerance, along, cross


@settings(max_examples=25)
@given(poses, poses, poses, st.floats(0.01, 0.6), st.floats(0.01, 0.6), st.booleans())
def test_two_dot_products_equal_the_documents_trigonometry(robot, before, goal, along, cross, overshoot):
    assume(before.distance_to(goal) > 1e-3)
    wanted, x, y = document_form(robot, [before, goal], along, cross, overshoot=overshoot)
    assume(min(abs(abs(x) - along), abs(abs(y) - cross)) > 1e-9)
    checker = AxisGoalChecker(
        along_path_tolerance=along, cross_track_tolerance=cross, path_length_tolerance=9.0, is_overshoot_valid=overshoot
    )
    assert reached(checker, robot, [before, goal]) is wanted


@settings(max_examples=25)
@given(poses, st.floats(-4.0, 4.0), st.floats(-2.0, 2.0), st.floats(-2.0, 2.0))
def test_yaw_and_velocity_are_not_looked_at(robot, yaw, linear, angular):
    checker = AxisGoalChecker()
    turned = Pose2(robot.x, robot.y, yaw)
    other = checker.is_goal_reached(turned, ORIGIN, Twist2(linear, angular), AHEAD)
    assert reached(checker, robot) is other


@pytest.mark.parametrize(("x", "y"), [(-0.25, 0.0), (0.25, 0.0), (0.0, 0.25), (0.0, -0.25)])
def test_exactly_at_a_tolerance_is_not_reached_and_one_epsilon_inside_is(x, y):
    checker = AxisGoalChecker()
    assert not reached(checker, Pose2(x, y, 0.0))
    assert reached(checker, Pose2(math.nextafter(x, 0.0), math.nextafter(y, 0.0), 0.0))


def test_overshoot_is_unlimited_when_valid_but_cross_track_still_binds():
    lenient = AxisGoalChecker(is_overshoot_valid=True)
    assert reached(lenient, Pose2(50.0, 0.0, 0.0))
    assert not reached(lenient, Pose2(50.0, 0.3, 0.0))
    assert not reached(lenient, Pose2(-0.3, 0.0, 0.0))
    assert not reached(AxisGoalChecker(), Pose2(0.3, 0.0, 0.0))


def test_a_remaining_path_as_long_as_the_tolerance_is_judged_a_longer_one_not():
    checker = AxisGoalChecker()
    assert reached(checker, ORIGIN, [Pose2(-1.0, 0.0, 0.0), ORIGIN])
    assert not reached(checker, ORIGIN, [Pose2(math.nextafter(-1.0, -2.0), 0.0, 0.0), ORIGIN])
    there_and_back = [ORIGIN, Pose2(0.6, 0.0, 0.0), ORIGIN]
    assert not reached(checker, ORIGIN, there_and_back)


def test_a_single_pose_needs_both_tolerances_strictly():
    checker = AxisGoalChecker(along_path_tolerance=0.1, cross_track_tolerance=0.3)
    assert reached(checker, Pose2(0.09, 0.0, 0.0), [ORIGIN])
    assert not reached(checker, Pose2(0.0, 0.2, 0.0), [ORIGIN])
    assert not reached(checker, Pose2(0.1, 0.0, 0.0), [ORIGIN])


def test_an_empty_path_is_judged_by_distance_to_the_goal():
    assert AxisGoalChecker().is_goal_reached(Pose2(0.1, 0.1, 0.0), ORIGIN, REST, [])
    assert not AxisGoalChecker().is_goal_reached(Pose2(0.2, 0.2, 0.0), ORIGIN, REST, [])


def test_the_axis_comes_from_the_last_two_distinct_poses():
    checker = AxisGoalChecker(along_path_tolerance=0.05, cross_track_tolerance=0.5)
    path = [Pose2(-0.5, 0.0, 0.0), Pose2(0.0, -0.2, 0.0), ORIGIN, ORIGIN, ORIGIN]  # axis +y
    assert reached(checker, Pose2(0.4, 0.0, 0.0), path)
    assert not reached(checker, Pose2(0.0, 0.4, 0.0), path)


def test_coincident_poses_only_are_judged_by_distance():
    checker = AxisGoalChecker(along_path_tolerance=0.1, cross_track_tolerance=0.3)
    assert not reached(checker, Pose2(0.0, 0.2, 0.0), [ORIGIN, ORIGIN])


@settings(max_examples=25)
@given(st.floats(-4.0, 4.0))
def test_as_documented_nothing_lies_within_a_zero_tolerance(yaw):
    checker = AxisGoalChecker(along_path_tolerance=0.0, cross_track_tolerance=0.0)
    assert not reached(checker, Pose2(0.0, 0.0, yaw))
    assert document_form(ORIGIN, AHEAD, 0.0, 0.0, overshoot=False)[0] is False


def test_in_nav2s_variants_at_the_goal_wins_over_zero_tolerances_but_not_in_the_radial_fallback():
    checker = AxisGoalChecker(along_path_tolerance=0.0, cross_track_tolerance=0.0, axis_end="goal")
    assert reached(checker, Pose2(9e-7, 0.0, 0.0))
    assert not reached(checker, Pose2(1e-6, 0.0, 0.0))
    assert not reached(checker, ORIGIN, [ORIGIN])


def test_the_direction_distance_is_inclusive_and_reaches_over_a_sharp_end():
    hooked = [Pose2(-0.5, 0.0, 0.0), Pose2(0.0, -0.125, 0.0), ORIGIN]  # last 12.5 cm turn to +y
    robot = Pose2(0.0, 0.2, 0.0)
    tight = {"along_path_tolerance": 0.05, "cross_track_tolerance": 0.5}
    assert not reached(AxisGoalChecker(**tight), robot, hooked)
    assert not reached(AxisGoalChecker(**tight, direction_estimation_distance=0.125), robot, hooked)
    assert reached(AxisGoalChecker(**tight, direction_estimation_distance=math.nextafter(0.125, 1.0)), robot, hooked)


class TestTheAxisOfAPathThatBecameTooShort:
    short = (Pose2(-0.05, 0.0, 0.0), ORIGIN)
    beside = Pose2(0.0, 0.2, 0.0)

    def checker(self):
        return AxisGoalChecker(along_path_tolerance=0.05, cross_track_tolerance=0.3, direction_estimation_distance=0.15)

    def test_is_the_last_one_found(self):
        checker = self.checker()
        assert not reached(checker, self.beside, self.short)  # never an axis: radial
        assert reached(checker, self.beside, AHEAD)
        assert reached(checker, self.beside, self.short)
        assert reached(checker, self.beside, [ORIGIN])

    def test_is_forgotten_by_reset(self):
        checker = self.checker()
        assert reached(checker, self.beside, AHEAD)
        checker.reset()
        assert not reached(checker, self.beside, self.short)

    def test_is_not_kept_in_the_documented_behaviour(self):
        checker = AxisGoalChecker(along_path_tolerance=0.05, cross_track_tolerance=0.3)
        assert reached(checker, self.beside, AHEAD)
        assert not reached(checker, self.beside, [ORIGIN])


def test_the_radial_fallback_can_be_set_apart_from_the_tolerances():
    robot = Pose2(0.0, 0.3, 0.0)
    merged_5746 = math.hypot(0.25, 0.25)
    assert not reached(AxisGoalChecker(), robot, [ORIGIN])
    assert reached(AxisGoalChecker(fallback_radial_goal_tolerance=merged_5746), robot, [ORIGIN])
    assert not reached(AxisGoalChecker(fallback_radial_goal_tolerance=0.3), robot, [ORIGIN])


def test_a_goal_skewed_against_the_path_end_flips_only_the_goal_based_axis():
    # The fleet's false arrival of Nav2 #6345: the path's last pose lies past the goal.
    path = [Pose2(-0.6, 0.0, 0.0), Pose2(-0.1, 0.0, 0.0), Pose2(0.1, 0.0, 0.0)]
    goal, robot = Pose2(-0.2, 0.0, 0.0), Pose2(-0.8, 0.0, 0.0)
    assert not reached(AxisGoalChecker(is_overshoot_valid=True), robot, path, goal)
    assert reached(AxisGoalChecker(is_overshoot_valid=True, axis_end="goal"), robot, path, goal)


# Nav2's variants as parameters; #6345 differs from #6420 by keeping no axis, that is by a reset before every call.
VARIANTS = {
    "document": {},
    "#5746": {"axis_end": "goal", "fallback_radial_goal_tolerance": math.hypot(0.25, 0.25)},
    "#6420": {"axis_end": "goal", "direction_estimation_distance": 0.15},
    "#6513": {"axis_end": "goal", "direction_estimation_distance": 0.15, "fallback_radial_goal_tolerance": 0.3},
}


@pytest.mark.parametrize(
    ("name", "one_pose", "hooked_end", "short_path", "skewed_goal"),
    [
        ("document", False, False, False, False),
        ("#5746", True, False, False, True),
        ("#6420", False, True, True, True),
        ("#6513", True, True, True, True),
    ],
)
def test_the_variants_of_nav2_differ_as_documented(name, one_pose, hooked_end, short_path, skewed_goal):
    def checker(**more):
        return AxisGoalChecker(**{**VARIANTS[name], **more})

    aside = Pose2(0.0, 0.28, 0.0)
    assert reached(checker(), aside, [ORIGIN]) is one_pose
    hooked = [Pose2(-0.5, 0.0, 0.0), Pose2(0.0, -0.05, 0.0), ORIGIN]  # its last 5 cm turn to +y
    tight = {"along_path_tolerance": 0.1, "cross_track_tolerance": 0.3}
    assert reached(checker(**tight), aside, hooked) is hooked_end
    kept = checker(along_path_tolerance=0.1, cross_track_tolerance=0.5)
    assert reached(kept, Pose2(0.0, 0.4, 0.0), AHEAD)
    assert reached(kept, Pose2(0.0, 0.4, 0.0), [Pose2(0.0, -0.05, 0.0), ORIGIN]) is short_path
    past_the_goal = [Pose2(-0.6, 0.0, 0.0), Pose2(-0.1, 0.0, 0.0), Pose2(0.1, 0.0, 0.0)]
    lenient = checker(is_overshoot_valid=True, path_length_tolerance=2.0)
    skewed, far_short = Pose2(-0.3, 0.0, 0.0), Pose2(-0.9, 0.0, 0.0)
    assert reached(lenient, far_short, past_the_goal, skewed) is skewed_goal


def test_tolerances_report_the_smaller_radius_and_leave_the_rest_unmeasured():
    found = AxisGoalChecker(along_path_tolerance=0.2, cross_track_tolerance=0.1).tolerances
    assert (found.x, found.y, found.path_length) == (0.1, 0.1, 1.0)
    assert (found.yaw, found.linear_speed, found.angular_speed) == (None, None, None)


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"along_path_tolerance": -0.1}, "along_path_tolerance"),
        ({"cross_track_tolerance": float("nan")}, "cross_track_tolerance"),
        ({"fallback_radial_goal_tolerance": -1.0}, "fallback_radial_goal_tolerance"),
        ({"along_path_toleranse": 0.1}, "did you mean along_path_tolerance"),
        ({"direction_estimation_distance": 1.0}, "must be < path_length_tolerance = 1.0 m, got 1.0"),
        ({"direction_estimation_distance": 0.4, "path_length_tolerance": 0.3}, "path_length_tolerance = 0.3"),
    ],
)
def test_bad_parameters_are_refused_at_start_up(parameters, message):
    with pytest.raises(InvalidValue, match=message):
        AxisGoalChecker(**parameters)


def test_a_baseline_is_judged_by_the_path_length_in_force_not_by_one_in_the_same_call():
    checker = AxisGoalChecker()
    with pytest.raises(InvalidValue, match=r"path_length_tolerance = 1.0 m, got 1.5"):
        checker.set_parameters(direction_estimation_distance=1.5, path_length_tolerance=2.0)
    assert checker.parameters.path_length_tolerance == 1.0
    checker.set_parameters(direction_estimation_distance=0.5)
    checker.set_parameters(path_length_tolerance=0.2)
    assert checker.parameters.path_length_tolerance == 0.2


@settings(max_examples=25)
@given(poses, st.floats(-0.03, 0.03), st.floats(-0.05, 0.05))
def test_if_stopped_it_waits_for_rest_and_for_nothing_else(robot, linear, angular):
    twist = Twist2(linear, angular)
    plain, stopped = AxisGoalChecker(), AxisGoalChecker(stopped=True)
    at_rest = abs(linear) <= 0.01 and abs(angular) <= 0.02
    in_position = plain.is_goal_reached(robot, ORIGIN, twist, AHEAD)
    assert stopped.is_goal_reached(robot, ORIGIN, twist, AHEAD) is (in_position and at_rest)
    assert stopped.is_goal_xy_reached(robot, ORIGIN, twist, AHEAD) is in_position
    assert (stopped.tolerances.linear_speed, stopped.tolerances.angular_speed) == (0.01, 0.02)


@settings(max_examples=25)
@given(poses, st.booleans())
def test_its_verdict_is_the_position_alone(robot, overshoot):
    checker = AxisGoalChecker(is_overshoot_valid=overshoot)
    assert checker.is_goal_xy_reached(robot, ORIGIN, REST, AHEAD) is reached(checker, robot)
