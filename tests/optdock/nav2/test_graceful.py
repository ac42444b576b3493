"""The graceful law against Nav2's unit-test numbers and published simulation, and the follower around it."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from checkers.nav2.simple import SimpleGoalChecker
from optdock.costmap.costmap import Costmap
from optdock.errors import ControllerInvalidPath, InvalidValue, NoValidControl
from optdock.geometry.footprint import Footprint
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import Pose2, Twist2
from optdock.model.dock import Dock
from optdock.model.limits import MotionLimits
from optdock.model.path import Direction, Path
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from optdock.nav2.graceful import GracefulController
from optdock.nav2.graceful_law import GracefulLaw, egocentric
from optdock.plugins.interfaces import Controller, PluginContext
from optdock.plugins.registry import create_plugin
from optdock.simulation import run_closed_loop
from optdock.testing.drives import s_curve_drive, straight_drive

ORIGIN = Pose2(0.0, 0.0, 0.0)
NAV2_TEST = GracefulLaw(1.0, 10.0, 0.2, 2.0, 0.1, 2.5, 0.0, 1.0, 1.0)
DOCKING = GracefulLaw(3.0, 2.0, 0.4, 2.0, 0.25, 2.5, 0.1, 0.25, 0.75)
BRINGUP = GracefulLaw(3.0, 2.0, 0.4, 2.0, 0.25, 2.5, 0.15, 0.15, 0.75)
ROBOT = Robot(Footprint.rectangle(0.4, 0.3, 0.5), MotionLimits(max_speed=1.0))
poses = st.builds(Pose2, st.floats(-3.0, 3.0), st.floats(-3.0, 3.0), st.floats(-3.0, 3.0))


@pytest.mark.parametrize(
    ("target", "curvature", "linear", "angular"),
    [((0.0, 5.0, 0.0), 5.407042, 0.1460446, 0.7896695), ((4.5, -2.17, -0.785), -0.416228, 0.966512, -0.4022844)],
)
def test_the_law_gives_nav2s_numbers(target, curvature, linear, angular):
    target = Pose2(*target)
    assert NAV2_TEST.curvature(egocentric(target, ORIGIN)) == pytest.approx(curvature, abs=1e-5)
    command = NAV2_TEST.command(target, ORIGIN)
    assert (command.linear, command.angular) == pytest.approx((linear, angular), abs=1e-5)


@pytest.mark.parametrize(
    ("target", "robot", "gear", "expected"),
    [
        ((3.0, 4.0, 0.8), (1.0, 1.0, -0.2), 1, (3.60555, -0.182794, -1.182794)),
        ((3.0, 3.0, math.pi), (0.0, 0.0, 0.0), 1, (4.24264, 2.35619, -0.785398)),
        ((-3.0, -4.0, 0.8), (1.0, 1.0, -0.2), -1, (6.40312, -0.0960555, -1.0960555)),
    ],
)
def test_egocentric_coordinates_are_nav2s(target, robot, gear, expected):
    found = egocentric(Pose2(*target), Pose2(*robot), Direction(gear))
    assert tuple(found) == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize(
    ("lateral", "staging", "final_mm", "final_deg", "peak"),
    [
        (0.05, 0.7, 4.5, 2.4, 0.7),
        (0.10, 0.7, 9.0, 4.8, 1.3),
        (0.20, 0.7, 17.0, 9.3, 2.2),
        (0.30, 0.7, 23.0, 13.1, 2.9),
        (0.20, 1.2, 5.3, 3.0, 1.1),
    ],
)
def test_a_simulated_docking_leaves_the_errors_published_for_the_law(lateral, staging, final_mm, final_deg, peak):
    found = docked_from(Pose2(-staging, lateral, 0.0), DOCKING)
    assert found[0] == pytest.approx(final_mm, abs=0.6)
    assert found[1] == pytest.approx(final_deg, abs=0.2)
    assert found[2] == pytest.approx(peak, abs=0.06)


def docked_from(start, law):
    """Lateral error [mm], yaw error [deg], largest curvature [1/m] and time [s] of a simulated docking, all >= 0."""
    pose, target, peak, steps = start, Pose2(0.25, 0.0, 0.0), 0.0, 0
    while pose.distance_to(ORIGIN) > 0.05:
        peak = max(peak, abs(law.curvature(egocentric(target, pose))))
        pose, steps = pose.moved(law.command(target, pose), 0.02), steps + 1
    return abs(1e3 * pose.y), abs(math.degrees(pose.yaw)), peak, 0.02 * steps


@pytest.mark.parametrize(
    ("radius", "law", "published"),
    [
        # p50 and p95 of lateral, yaw, curvature and time; None where no number is published.
        (0.25, DOCKING, ((8.9, 22.5), (4.7, 12.2), (1.3, 3.2), (3.2, 4.3))),
        (0.10, DOCKING, ((3.7, 8.6), (None, 4.5), (None, None), (None, None))),
        (0.05, DOCKING, ((1.8, 4.2), (None, 2.2), (None, None), (None, None))),
        (0.25, BRINGUP, ((9.5, 22.9), (5.0, 12.3), (1.4, 3.2), (4.5, 5.7))),
    ],
)
def test_starts_that_nav2s_goal_checker_accepts_end_as_far_off_as_published(radius, law, published):
    draw = np.random.default_rng(3)
    runs = []
    for _ in range(400):
        away, angle, yaw = radius * math.sqrt(draw.random()), draw.uniform(0.0, 2.0 * math.pi), draw.uniform(-1.0, 1.0)
        start = Pose2(-0.7 + away * math.cos(angle), away * math.sin(angle), radius * yaw)
        runs.append(docked_from(start, law))
    for values, expected in zip(np.array(runs).T, published, strict=True):
        for share, value in zip((50, 95), expected, strict=True):
            if value is not None:
                assert np.percentile(values, share) == pytest.approx(value, rel=0.12)


@given(poses, poses)
def test_mirrored_targets_give_mirrored_commands(target, robot):
    flip = [Pose2(p.x, -p.y, -p.yaw) for p in (target, robot)]
    there, back = DOCKING.command(target, robot), DOCKING.command(*flip)
    if abs(abs(egocentric(target, robot).phi) - math.pi) > 1e-6:
        assert (back.linear, back.angular) == pytest.approx((there.linear, -there.angular), rel=1e-6, abs=1e-9)


@given(poses, poses)
def test_reverse_is_forward_with_front_and_rear_exchanged(target, robot):
    flip = [Pose2(p.x, p.y, p.yaw + math.pi) for p in (target, robot)]
    there, back = DOCKING.command(*flip), DOCKING.command(target, robot, Direction.REVERSE)
    if min(abs(abs(angle) - math.pi) for angle in egocentric(target, robot)[1:]) > 1e-6:
        assert (back.linear, back.angular) == pytest.approx((-there.linear, there.angular), rel=1e-6, abs=1e-9)


def test_at_the_target_the_curvature_is_zero():
    assert DOCKING.curvature(egocentric(ORIGIN, ORIGIN)) == 0.0


def follow(drive, start=None, **parameters):
    controller = GracefulController(**parameters)
    checker = SimpleGoalChecker(xy_goal_tolerance=0.05, yaw_goal_tolerance=0.05)
    return run_closed_loop(drive, ROBOT, drive.path.end, controller, checker)


def test_it_follows_a_path_to_the_goal_checkers_tolerance():
    found = follow(s_curve_drive(ORIGIN))
    assert found.docked, found.reason
    assert math.hypot(found.final_error.x, found.final_error.y) <= 0.05


def test_a_reverse_gear_needs_allow_backward():
    drive = s_curve_drive(ORIGIN, Direction.REVERSE)
    with pytest.raises(ControllerInvalidPath, match="set allow_backward"):
        follow(drive)
    found = follow(drive, allow_backward=True, initial_rotation=False)
    assert found.docked, found.reason
    assert found.commands[:, 0].min() < -0.1


def ready(obstacles=None, **parameters):
    drive = straight_drive(ORIGIN)
    controller = GracefulController(**parameters)
    if obstacles is not None:
        controller.configure(PluginContext(problem=DockingProblem(ORIGIN, Dock(drive.path.end), ROBOT, obstacles)))
    controller.set_path(drive)
    return controller


def test_it_turns_towards_the_path_first():
    controller = ready()
    command = controller.compute_velocity_commands(Pose2(0.0, 0.0, -1.5), Twist2(), None)
    assert command == Twist2(0.0, 0.75)
    assert controller.compute_velocity_commands(Pose2(0.0, 0.0, -0.7), Twist2(), None).linear > 0.0


def test_at_the_goal_it_only_turns_to_the_final_heading():
    controller = ready()
    command = controller.compute_velocity_commands(Pose2(1.9, 0.0, 0.2), Twist2(), None)
    assert command == Twist2(0.0, -0.25)


def test_a_blocked_path_leaves_no_valid_control():
    wall = ObstacleSet.from_polygons([[[0.6, -1.0], [0.7, -1.0], [0.7, 1.0], [0.6, 1.0]]])
    with pytest.raises(NoValidControl, match="collision"):
        ready(wall, min_lookahead=0.25).compute_velocity_commands(Pose2(0.15, 0.0, 0.0), Twist2(), None)
    blind = ready(wall, use_collision_detection=False)
    assert blind.compute_velocity_commands(Pose2(0.15, 0.0, 0.0), Twist2(), None).linear > 0.0
    assert ready(ObstacleSet.empty()).compute_velocity_commands(ORIGIN, Twist2(), None).linear > 0.0


def test_a_speed_limit_scales_both_speeds_down_to_v_linear_min():
    controller = ready()
    controller.set_speed_limit(50.0, percentage=True)
    assert (controller.law.v_linear_max, controller.law.v_angular_max) == (0.25, 0.5)
    controller.set_speed_limit(0.05, percentage=False)
    assert (controller.law.v_linear_max, controller.law.v_angular_max) == (0.1, 0.1)
    controller.set_speed_limit(0.0, percentage=False)
    assert (controller.law.v_linear_max, controller.law.v_angular_max) == (0.5, 1.0)


@pytest.mark.parametrize("period", [0.02, 0.1])
def test_cancelling_brakes_on_the_arc_and_says_when_it_has_stopped(period):
    controller = GracefulController(period=period, deceleration_max=0.5)
    controller.set_path(s_curve_drive(ORIGIN))
    moving = [controller.compute_velocity_commands(Pose2(0.4, 0.1, -0.1), Twist2(), None)]
    assert moving[0].linear > 0.1
    assert not controller.cancel()
    while not controller.cancel():
        moving.append(controller.compute_velocity_commands(Pose2(0.4, 0.1, -0.1), moving[-1], None))
    drops = -np.diff([twist.linear for twist in moving])
    assert drops[:-1] == pytest.approx(0.5 * period)
    assert 0.0 < drops[-1] <= 0.5 * period + 1e-12
    curvature = moving[0].angular / moving[0].linear
    assert [twist.angular for twist in moving] == pytest.approx([curvature * twist.linear for twist in moving])
    controller.set_path(s_curve_drive(ORIGIN))
    assert controller.compute_velocity_commands(Pose2(0.4, 0.1, -0.1), Twist2(), None) == moving[0]


def test_cancelling_without_a_path_or_before_the_first_command_is_at_rest_at_once():
    assert GracefulController().cancel()
    assert ready().cancel()
    turning = ready()
    assert turning.compute_velocity_commands(Pose2(0.0, 0.0, -1.5), Twist2(), None) == Twist2(0.0, 0.75)
    assert not turning.cancel()
    assert turning.compute_velocity_commands(Pose2(0.0, 0.0, -1.5), Twist2(), None) == Twist2()
    assert turning.cancel()
    turning.reset()
    assert turning.cancel()


@pytest.mark.parametrize("name", ["GracefulController", "TrackingController"])
@pytest.mark.parametrize("bad", [None, [ORIGIN], "path", 3])
def test_what_is_no_path_is_refused_and_the_old_one_stays(name, bad):
    controller = create_plugin(Controller, name)
    controller.set_path(straight_drive(ORIGIN))
    with pytest.raises(ControllerInvalidPath, match=f"{name}: can follow a Path or a Trajectory, got"):
        controller.set_path(bad)
    assert controller.compute_velocity_commands(ORIGIN, Twist2(), None).linear >= 0.0


@pytest.mark.parametrize("name", ["GracefulController", "TrackingController"])
@pytest.mark.parametrize("bad", ["1", None, True, -0.1, math.nan, math.inf])
def test_a_speed_limit_is_a_number(name, bad):
    with pytest.raises(InvalidValue, match=f"{name}: the speed limit must be finite and >= 0, got"):
        create_plugin(Controller, name).set_speed_limit(bad, percentage=False)


@pytest.mark.parametrize("name", ["GracefulController", "TrackingController"])
@pytest.mark.parametrize("limit", [1, np.float32(0.5), np.int64(1)])
def test_any_real_number_is_a_speed_limit(name, limit):
    create_plugin(Controller, name).set_speed_limit(limit, percentage=False)


def test_parameters_carry_nav2s_names_and_rules():
    assert GracefulController(**{"lambda": 3.0}).law.lambda_ == 3.0
    controller = GracefulController()
    controller.set_parameters(beta=0.7)
    assert controller.law.beta == 0.7
    controller.set_parameters(**{"lambda": 1.5})
    assert controller.law.lambda_ == 1.5
    with pytest.raises(InvalidValue, match="min_lookahead"):
        controller.set_parameters(max_lookahead=0.1)
    with pytest.raises(InvalidValue, match="min_lookahead: must be <= max_lookahead = 1.0 m, got 2.0"):
        GracefulController(min_lookahead=2.0)
    with pytest.raises(InvalidValue, match="v_linear_min: must be <= v_linear_max = 0.5 m/s, got 0.6"):
        controller.set_parameters(v_linear_min=0.6)
    with pytest.raises(InvalidValue, match="v_angular_min_in_place: must be <= v_angular_max = 0.2 rad/s, got 0.25"):
        GracefulController(v_angular_max=0.2)
    with pytest.raises(InvalidValue, match="needs initial_rotation: false"):
        GracefulController(allow_backward=True)


def test_without_a_path_it_says_so():
    controller = create_plugin(Controller, "nav2_graceful_controller::GracefulController")
    with pytest.raises(ControllerInvalidPath, match="set_path first"):
        controller.compute_velocity_commands(ORIGIN, Twist2(), None)
    controller.set_path(Path.from_poses([ORIGIN, Pose2(1.0, 0.0, 0.0)]))
    controller.reset()
    with pytest.raises(ControllerInvalidPath):
        controller.compute_velocity_commands(ORIGIN, Twist2(), None)


def boxed_in():
    """A robot whose corners would swing into walls on both sides, in every way a context can say so."""
    walls = [np.array([[-1.0, y], [1.0, y], [1.0, y + 0.2], [-1.0, y + 0.2]]) for y in (0.22, -0.42)]
    cells = np.zeros((40, 60), dtype=np.uint8)
    cells[22 + 3 : 22 + 6, 20:] = cells[40 - 28 : 40 - 25, 20:] = 254
    return walls, Costmap(cells, 0.05, (-1.5, -1.0))


@pytest.mark.parametrize("kind", ["problem", "costmap", "local costmap"])
def test_a_turn_in_place_that_would_touch_something_is_refused(kind):
    walls, grid = boxed_in()
    goal = Pose2(-2.0, 0.0, math.pi)
    context = {
        "problem": PluginContext(problem=DockingProblem(ORIGIN, Dock(goal), ROBOT, ObstacleSet.from_polygons(walls))),
        "costmap": PluginContext(costmap=grid, footprint=ROBOT.footprint),
        "local costmap": PluginContext(local_costmap=grid, footprint=ROBOT.footprint),
    }[kind]
    controller = GracefulController()
    controller.configure(context)
    controller.set_path(Path.from_poses([Pose2(0.0, 0.0, math.pi), goal]))
    turned = [ORIGIN]

    def turn():
        for k in range(100):
            command = controller.compute_velocity_commands(turned[-1], Twist2(), None, stamp=0.05 * k)
            turned.append(turned[-1].moved(command, 0.05))

    with pytest.raises(NoValidControl, match="collision ahead"):
        turn()
    assert abs(turned[-1].yaw) < 0.4
