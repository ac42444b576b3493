import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from optdock.errors import NoValidPathCouldBeFound
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.model.path import Direction
from optdock.planners.two_segment import DockGeometry, DockPlannerParameters, approach_axis

GEOMETRY = DockGeometry(robot_length=0.8, robot_radius=0.5, dock_length=0.2)  # C at 0.5 m, safety distance 1 m
DEFAULTS = DockPlannerParameters()
GOAL = Pose2(4.0, 1.0, 0.0)


def axis_from(x, y, goal=GOAL, geometry=GEOMETRY, **parameters):
    return approach_axis(Pose2(x, y, 0.3), goal, geometry, DockPlannerParameters(**parameters))


def test_sizes_come_from_the_outlines():
    robot = Footprint.rectangle(front=0.6, rear=0.2, width=0.6)
    dock = Footprint.rectangle(front=0.1, rear=0.3, width=1.0)
    sizes = DockGeometry.from_footprints(robot, dock)
    np.testing.assert_allclose(sizes[:3], (0.8, math.hypot(0.6, 0.3), 0.4))
    assert DockGeometry.from_footprints(robot).dock_length == 0.0


def test_points_and_distances_of_a_forward_docking():
    axis = axis_from(1.0, 1.6)
    assert axis.direction is Direction.FORWARD
    assert axis.distance_ad == pytest.approx(0.6)
    np.testing.assert_allclose(axis.point_c, [3.5, 1.0])
    np.testing.assert_allclose(axis.point_d, [1.0, 1.0])
    np.testing.assert_allclose(axis.point_f, [0.0, 1.0])  # the safety distance from D


def test_start_in_front_of_the_docked_robot_docks_backward():
    axis = axis_from(7.0, -0.5)
    assert axis.direction is Direction.REVERSE
    np.testing.assert_allclose(axis.point_c, [4.5, 1.0])
    np.testing.assert_allclose(axis.point_d, [7.0, 1.0])
    np.testing.assert_allclose(axis.point_f, [8.5, 1.0])  # 1.5 m aside: more than the safety distance


@settings(max_examples=25)
@given(st.floats(-math.pi, math.pi), st.floats(0.6, 30.0), st.floats(-20.0, 20.0))
def test_gear_follows_the_side_of_the_start_in_every_frame(yaw, along, across):
    goal = Pose2(-3.0, 2.0, yaw)
    behind = approach_axis(goal @ Pose2(-along, across, 0.0), goal, GEOMETRY, DEFAULTS)
    ahead = approach_axis(goal @ Pose2(along, across, 0.0), goal, GEOMETRY, DEFAULTS)
    assert (behind.direction, ahead.direction) == (Direction.FORWARD, Direction.REVERSE)
    np.testing.assert_allclose(behind.outward, -ahead.outward)
    for axis in (behind, ahead):
        assert axis.along == pytest.approx(along)
        assert axis.distance_ad == pytest.approx(abs(across), abs=1e-12)
        assert np.hypot(*(axis.point_c - axis.goal)) == pytest.approx(0.5)


def test_threshold_angle_grows_with_the_distance_from_the_axis_up_to_gamma():
    on_axis = axis_from(1.0, 1.0).angle_threshold
    assert on_axis == pytest.approx(0.5 * math.pi)
    # 0.25 m aside with 1 m of safety: scale 0.2.
    assert axis_from(1.0, 1.25).angle_threshold == pytest.approx(1.2 * 0.5 * math.pi)
    assert axis_from(1.0, 0.75).angle_threshold == pytest.approx(1.2 * 0.5 * math.pi)
    assert axis_from(1.0, 9.0).angle_threshold == pytest.approx(0.667 * math.pi)
    assert axis_from(1.0, 1.25, alpha=0.8, beta=0.4).angle_threshold == pytest.approx(0.4 * math.pi)
    assert axis_from(1.0, 9.0, gamma=0.55).angle_threshold == pytest.approx(0.55 * math.pi)


def test_calibration_widens_the_safety_distance():
    assert axis_from(1.0, 1.0, calib_safety_distance=0.25).safety_distance == pytest.approx(1.5)


@pytest.mark.parametrize("x", [4.0, 3.6, 3.5, 4.5, 4.2])
@pytest.mark.parametrize("y", [1.0, 3.0])
def test_start_not_beyond_c_is_refused(x, y):
    with pytest.raises(NoValidPathCouldBeFound, match=r"must be more than 0.5 m from it") as e:
        axis_from(x, y)
    assert e.value.where["step"] == "beyond_c"
    assert e.value.where["t"] == pytest.approx(abs(4.0 - x) / 0.5)
    assert e.value.code == 208


def test_start_just_beyond_c_is_accepted():
    assert axis_from(3.5 - 1e-6, 1.0).along == pytest.approx(0.5, abs=1e-5)


@pytest.mark.parametrize(("x", "wanted", "possible"), [(1.0, "backward", "forward"), (7.0, "forward", "backward")])
def test_direction_that_contradicts_the_side_of_the_start_is_refused(x, wanted, possible):
    with pytest.raises(NoValidPathCouldBeFound, match=f"only dock {possible}, but direction is {wanted}"):
        axis_from(x, 1.0, direction=wanted)
    for fine in (possible, "auto"):
        assert axis_from(x, 1.0, direction=fine).direction is axis_from(x, 1.0).direction


def test_robot_without_length_is_refused():
    with pytest.raises(NoValidPathCouldBeFound, match="the robot's length must be > 0 m, got 0 m"):
        axis_from(1.0, 1.0, geometry=GEOMETRY._replace(robot_length=0.0))


@pytest.mark.parametrize("calibration", [-0.5, -2.0])
def test_safety_distance_that_is_not_positive_is_refused(calibration):
    with pytest.raises(NoValidPathCouldBeFound, match=r"safety distance, .* must be > 0 m") as caught:
        axis_from(1.0, 1.0, calib_safety_distance=calibration)
    assert caught.value.where["safety_distance"] == pytest.approx(2.0 * (0.5 + calibration))
    assert axis_from(1.0, 1.0, calib_safety_distance=-0.49).safety_distance == pytest.approx(0.02)


def test_goal_yaws_of_pi_and_minus_pi_give_the_same_axis():
    one, other = (axis_from(6.0, 1.5, goal=Pose2(4.0, 1.0, yaw)) for yaw in (math.pi, -math.pi))
    assert one.direction is other.direction is Direction.FORWARD
    np.testing.assert_allclose(one.point_f, other.point_f, atol=1e-14)
