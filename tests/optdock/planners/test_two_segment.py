import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from optdock.errors import (
    GoalOccupied,
    GoalOutsideMapBounds,
    NoValidPathCouldBeFound,
    PlannerCancelled,
    PlannerException,
    StartOccupied,
    StartOutsideMapBounds,
)
from optdock.geometry.nurbs import Nurbs
from optdock.geometry.pose import Pose2
from optdock.model.costmap import Costmap
from optdock.model.path import Direction
from optdock.planners.two_segment import DockGeometry, DockPlannerParameters, JointKind, plan_two_segment

GEOMETRY = DockGeometry(robot_length=0.8, robot_radius=0.5, dock_length=0.2)  # C at 0.5 m, safety distance 1 m
ORIGIN = Pose2(0.0, 0.0, 0.0)

# One start for each way of joining the axis, as seen from the goal of a forward docking.
STARTS = {
    JointKind.TOWARD: Pose2(-4.0, 0.6, 0.2),
    JointKind.AWAY: Pose2(-0.8, 0.5, 0.0),
    JointKind.CORNER: Pose2(-1.5, 2.5, -1.5),
}
TURNED = Pose2(0.0, 0.0, math.pi)


def plan(start, goal=ORIGIN, geometry=GEOMETRY, costmap=None, **parameters):
    return plan_two_segment(start, goal, geometry, DockPlannerParameters(**parameters), costmap)


def all_poses(path):
    """Every pose of every gear, Shape (n, 3), and its gear, Shape (n,)."""
    gears = np.concatenate([np.full(len(part.poses), int(part.direction)) for part in path.segments])
    return np.vstack([part.poses for part in path.segments]), gears


def assert_same_motion(path, other, mapped=lambda poses: poses):
    (poses, gears), (other_poses, other_gears) = all_poses(path), all_poses(other)
    np.testing.assert_array_equal(gears, other_gears)
    wanted = mapped(poses)
    np.testing.assert_allclose(other_poses[:, :2], wanted[:, :2], atol=1e-7)
    turned = other_poses[:, 2] - wanted[:, 2]
    np.testing.assert_allclose(np.cos(turned), 1.0, atol=1e-7)


def moved(frame):
    def apply(poses):
        return np.array([(frame @ Pose2(*pose)).as_array() for pose in poses])

    return apply


@st.composite
def starts(draw):
    """Starts beyond C, on either side of the axis, none so near to it that rounding decides."""
    along = draw(st.floats(0.51, 12.0))
    across = draw(st.floats(-6.0, 6.0))
    assume(abs(across) > 1e-4)
    return Pose2(-along, across, draw(st.floats(-math.pi, math.pi)))


frames = st.builds(Pose2, st.floats(-50.0, 50.0), st.floats(-50.0, 50.0), st.floats(-math.pi, math.pi))


@pytest.mark.parametrize("kind", JointKind)
@pytest.mark.parametrize("turned", [False, True])
def test_every_way_of_joining_has_a_stated_start_in_both_gears(kind, turned):
    start = STARTS[kind]
    found = plan(Pose2(start.x, start.y, start.yaw + math.pi), TURNED) if turned else plan(start)
    docking = Direction.REVERSE if turned else Direction.FORWARD
    assert found.joint.dir is kind
    assert found.axis.direction is docking
    gears = [part.direction for part in found.path.segments]
    assert gears == ([Direction(-docking), docking] if kind is JointKind.AWAY else [docking])
    assert len(found.path.cusps) == len(gears) - 1


@settings(max_examples=20)
@given(starts())
def test_path_runs_from_the_start_pose_to_the_goal_pose(start):
    path = plan(start).path
    assert path.start == start
    assert path.end.distance_to(ORIGIN) == 0.0
    assert math.cos(path.end.yaw) == pytest.approx(1.0, abs=1e-12)


@settings(max_examples=20)
@given(starts(), st.sampled_from([0.02, 0.05, 0.3]))
def test_spacing_never_exceeds_the_resolution_and_no_pose_repeats(start, resolution):
    for part in plan(start, resolution=resolution).path.segments:
        step = np.hypot(*np.diff(part.poses[:, :2], axis=0).T)
        assert step.max() <= resolution
        assert step.min() > 1e-9


def test_resolution_of_a_costmap_replaces_the_parameter():
    costmap = Costmap(np.zeros((10, 10), dtype=np.uint8), 0.01)
    poses, _ = all_poses(plan(STARTS[JointKind.TOWARD], costmap=costmap, resolution=0.5).path)
    assert np.hypot(*np.diff(poses[:, :2], axis=0).T).max() <= 0.01


@settings(max_examples=20)
@given(starts())
def test_headings_follow_the_gear(start):
    # Every step goes ahead (forward) or astern (reverse) of the pose it leaves. Not held: the start, whose yaw the
    # raw path ignores, and the joint, where it may have a corner.
    found = plan(start)
    for part in found.path.segments:
        step = np.diff(part.poses[:, :2], axis=0)
        from_joint = np.hypot(*(part.poses[:-1, :2] - found.joint.control_points[2]).T)
        held = (from_joint > 1e-9) & (np.arange(len(step)) > 0)
        ahead = step[:, 0] * np.cos(part.poses[:-1, 2]) + step[:, 1] * np.sin(part.poses[:-1, 2])
        assert np.all(ahead[held] * int(part.direction) > 0.0)


@pytest.mark.parametrize("along", [0.5000001, 0.52, 0.6, 25.0])
@pytest.mark.parametrize(
    ("goal", "sign"), [(ORIGIN, -1.0), (Pose2(3.0, -7.0, 2.0), 1.0), (Pose2(1.0, 1.0, -math.pi), 1.0)]
)
def test_straight_start_gives_a_straight_path_of_exact_length(along, goal, sign):
    found = plan(goal @ Pose2(sign * along, 0.0, 0.0), goal)
    assert found.joint.dir is JointKind.TOWARD
    assert len(found.path.segments) == 1
    assert found.path.length == pytest.approx(along, abs=1e-9)
    local = np.array([Pose2(*pose).in_frame_of(goal).as_array() for pose in all_poses(found.path)[0]])
    np.testing.assert_allclose(local[:, 1:], 0.0, atol=1e-6)


@settings(max_examples=20)
@given(starts())
def test_mirrored_problems_have_mirrored_paths(start):
    mirror = np.array([1.0, -1.0, -1.0])
    other = plan(Pose2(start.x, -start.y, -start.yaw))
    assert_same_motion(plan(start).path, other.path, lambda poses: poses * mirror)


@settings(max_examples=20)
@given(starts(), frames)
def test_moving_the_whole_problem_moves_the_path(start, frame):
    found, other = plan(start), plan(frame @ start, frame @ ORIGIN)
    assert other.joint.dir is found.joint.dir
    assert_same_motion(found.path, other.path, moved(frame))


@settings(max_examples=20)
@given(starts())
def test_robot_turned_around_takes_the_same_way_in_the_other_gear(start):
    found, other = plan(start), plan(Pose2(start.x, start.y, start.yaw + math.pi), TURNED)
    assert other.axis.direction is Direction(-found.axis.direction)
    (poses, gears), (other_poses, other_gears) = all_poses(found.path), all_poses(other.path)
    np.testing.assert_array_equal(other_gears, -gears)
    np.testing.assert_allclose(other_poses[:, :2], poses[:, :2], atol=1e-7)
    np.testing.assert_allclose(np.cos(other_poses[:, 2] - poses[:, 2]), -1.0, atol=1e-7)


@settings(max_examples=20)
@given(starts(), st.floats(-math.pi, math.pi))
def test_yaw_of_the_start_changes_only_the_first_pose(start, yaw):
    poses, _ = all_poses(plan(start).path)
    others, _ = all_poses(plan(Pose2(start.x, start.y, yaw)).path)
    np.testing.assert_array_equal(poses[:, :2], others[:, :2])
    np.testing.assert_allclose(np.cos(poses[1:, 2] - others[1:, 2]), 1.0, atol=1e-12)


@settings(max_examples=20)
@given(starts())
def test_control_points_and_knots_are_as_specified(start):
    found = plan(start)
    axis = found.axis
    assert axis.point_f[0] == pytest.approx(axis.point_d[0] - max(1.0, abs(start.y)))
    np.testing.assert_allclose(found.joint.control_points[0], [start.x, start.y])
    assert Nurbs(found.joint.control_points).knots.tolist() == [0.0, 0.0, 0.0, 1.0, 1.0, 1.0]


def test_turn_toward_the_dock_ends_tangent_to_the_axis_and_is_symmetric():
    found = plan(STARTS[JointKind.TOWARD], resolution=0.001)
    legs = np.hypot(*np.diff(found.joint.control_points, axis=0).T)
    assert legs[0] == pytest.approx(legs[1], abs=0.004)
    curve = Nurbs(found.joint.control_points)
    assert curve.tangent_yaw_at(1.0)[0] == pytest.approx(0.0, abs=1e-12)
    turn = np.diff(curve.tangent_yaw_at([0.0, 1e-4, 1.0 - 1e-4, 1.0]))
    assert turn[0] == pytest.approx(turn[2], rel=0.02)


def test_cusp_lies_at_f_with_the_robot_on_the_axis():
    found = plan(STARTS[JointKind.AWAY])
    cusp = found.path.pose_at(found.path.cusps[0])
    np.testing.assert_allclose([cusp.x, cusp.y], found.axis.point_f, atol=1e-12)
    assert cusp.yaw == pytest.approx(0.0, abs=0.05)
    ends = [part.poses[[0, -1]] for part in found.path.segments]
    np.testing.assert_array_equal(ends[0][1], ends[1][0])


def test_corner_turns_by_a_right_angle_on_the_axis():
    found = plan(STARTS[JointKind.CORNER])
    assert found.joint.middle == -1
    assert abs(found.joint.control_points[2][0] - found.axis.point_d[0]) <= 0.025
    assert np.abs(found.path.segments[0].step_curvature).max() > 20.0


def test_first_tangent_of_a_raw_path_ignores_the_yaw_of_the_start():
    # The first tangent points at the joint, whatever the start's yaw; the smoother repairs it.
    start = STARTS[JointKind.TOWARD]
    found = plan(start)
    leg = found.joint.control_points[1] - found.joint.control_points[0]
    second = all_poses(found.path)[0][1, 2]
    assert second == pytest.approx(math.atan2(leg[1], leg[0]), abs=0.05)
    assert abs(second - start.yaw) > 0.5


@pytest.mark.parametrize("angle", [60.0, 75.0, 89.0])
@pytest.mark.parametrize("distance", [1.0, 3.0, 8.0])
def test_starts_far_off_the_axis_as_seen_from_c_are_planned(angle, distance):
    off = math.radians(angle)
    found = plan(Pose2(-0.5 - distance * math.cos(off), distance * math.sin(off), 0.0))
    # Beyond 30 degrees there is no room for a run-in toward C, beyond 0.6 m none for one from F.
    assert found.joint.dir is JointKind.CORNER
    assert found.path.length == pytest.approx(distance * (math.sin(off) + math.cos(off)) + 0.5, abs=0.03)


@pytest.mark.parametrize("distance", [1e3, 4e3])
def test_long_ways_are_planned(distance):
    path = plan(Pose2(-distance, 0.1 * distance, 0.0)).path
    assert distance < path.length < 1.1 * distance


def test_too_long_way_is_refused():
    with pytest.raises(NoValidPathCouldBeFound, match="the centreline would take"):
        plan(Pose2(-1e7, 5.0, 0.0))


def test_tiny_robot_docks_from_next_to_its_goal():
    tiny = DockGeometry(robot_length=1e-9, robot_radius=1e-9)
    path = plan(Pose2(-5e-9, 0.0, 0.0), geometry=tiny).path
    assert path.end.distance_to(ORIGIN) == 0.0


def blocked_at(x, y):
    """A free 12 m x 12 m map around the origin with one blocked cell."""
    data = np.zeros((120, 120), dtype=np.uint8)
    costmap = Costmap(data, 0.1, (-6.0, -6.0))
    i, j = costmap.cell_of([[x, y]])[0]
    data[j, i] = 254
    return costmap.with_data(data)


@pytest.mark.parametrize(
    ("x", "y", "step"),
    [(-4.5, 0.0, "the centreline"), (-3.7, 0.28, "segment 1"), (-0.2, 0.0, "segment 2")],
)
def test_each_curve_is_checked_where_asked(x, y, step):
    start, costmap = STARTS[JointKind.TOWARD], blocked_at(x, y)
    with pytest.raises(NoValidPathCouldBeFound, match=f"{step} is blocked") as caught:
        plan(start, costmap=costmap, check_free_space=True)
    assert caught.value.where["step"] == step
    assert caught.value.where["x"] == pytest.approx(x, abs=0.1)
    assert plan(start, costmap=costmap).joint.dir is JointKind.TOWARD  # by default nothing is checked


def test_ends_on_cells_that_are_not_free_are_refused_by_name_where_asked():
    start, away = STARTS[JointKind.TOWARD], Pose2(-6.5, 0.3, 0.0)
    for costmap, at, error, message in (
        (
            blocked_at(start.x, start.y),
            start,
            StartOccupied,
            "the start .* has cost 254, must be < .* = 200",
        ),
        (blocked_at(0.0, 0.0), start, GoalOccupied, "the goal .* has cost 254"),
        (blocked_at(5.0, 5.0), away, StartOutsideMapBounds, "the start .* is outside the map"),
        (
            Costmap(np.zeros((40, 40), dtype=np.uint8), 0.1, (-5.0, -2.0)),
            start,
            GoalOutsideMapBounds,
            "the goal .* is outside the map",
        ),
    ):
        with pytest.raises(error, match=message):
            plan(at, costmap=costmap, check_free_space=True)
        assert plan(at, costmap=costmap).path.end == ORIGIN


def test_check_without_a_map_is_refused_and_names_its_parameter():
    with pytest.raises(PlannerException, match="check_free_space is true, but there is no costmap") as caught:
        plan(STARTS[JointKind.TOWARD], check_free_space=True)
    assert caught.value.where == {"parameter": "check_free_space"}


@pytest.mark.parametrize("radius", [0.3, 0.5, 0.9])
def test_turn_away_from_the_dock_fits_up_to_six_tenths_of_the_safety_distance(radius):
    """From a start beside C, where the turn toward the dock has no room."""
    geometry = DockGeometry(robot_length=1.0, robot_radius=radius)

    def kind(share):
        start = Pose2(-0.55, share * 2.0 * radius, 0.0)
        return plan_two_segment(start, ORIGIN, geometry, DockPlannerParameters(resolution=0.005)).joint.dir

    assert {kind(share) for share in np.linspace(0.1, 0.55, 10)} == {JointKind.AWAY}
    assert {kind(share) for share in np.linspace(0.62, 3.0, 20)} == {JointKind.CORNER}


def test_free_map_blocks_nothing():
    start = STARTS[JointKind.TOWARD]
    costmap = blocked_at(5.0, 5.0)
    assert_same_motion(plan(start, costmap=costmap).path, plan(start, costmap=costmap, check_free_space=True).path)


def test_degree_one_drives_the_control_polygon():
    found = plan(STARTS[JointKind.TOWARD], degree=1)
    legs = np.hypot(*np.diff(found.joint.control_points, axis=0).T).sum()
    assert found.path.length == pytest.approx(legs - found.joint.control_points[2][0], abs=0.02)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_cancelling_at_any_poll_stops_the_planner(count):
    calls = []

    def cancel():
        calls.append(None)
        return len(calls) == count

    with pytest.raises(PlannerCancelled):
        plan_two_segment(STARTS[JointKind.TOWARD], ORIGIN, GEOMETRY, DockPlannerParameters(), None, cancel)
    assert len(calls) == count
