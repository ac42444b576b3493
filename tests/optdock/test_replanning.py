"""Laws of replanning in motion: no jump at the joint, every limit kept, nothing called proven that is not."""

from __future__ import annotations

import dataclasses
import functools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from experiments.dense_check import dense_check
from optdock.deadline import TICK, budget_clock
from optdock.errors import InvalidValue
from optdock.geometry.footprint import Footprint
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import Pose2
from optdock.model.camera import Camera
from optdock.model.dock import Dock, DockDirection
from optdock.model.limits import MotionLimits, SpeedZone
from optdock.model.path import Path, TurnSegment
from optdock.model.problem import DockingProblem
from optdock.model.robot import Drive, Robot
from optdock.planning.pipeline import plan_dock
from optdock.planning.replanning import DriveState, ReplanOutcome, replan
from optdock.planning.running_drive import RunningDrive, braking
from optdock.verification import certify_motion, certify_path, certify_trajectory

LIMITS = MotionLimits(max_curvature=1.5, max_curvature_rate=6.0, max_yaw_rate=1.2, max_yaw_acceleration=2.0)
STEERED = MotionLimits(
    max_curvature=1.5, max_curvature_rate=4.0, wheelbase=0.4, max_steering_angle=0.5, max_steering_rate=0.8
)
OUTLINE = Footprint.rectangle(0.45, 0.45, 0.6)
BUDGET, LEAD = 30.0, 0.06  # no clock decides here


def box_at(x, y):
    """A square of 0.2 m."""
    return np.array([[x - 0.1, y - 0.1], [x + 0.1, y - 0.1], [x + 0.1, y + 0.1], [x - 0.1, y + 0.1]])


def dock_of(sign):
    """A dock that is entered in the gear `sign`, its station 5 mm before the robot."""
    near, far = (0.455, 0.7) if sign > 0 else (-0.7, -0.455)
    station = Footprint([[near, -0.3], [far, -0.3], [far, 0.3], [near, 0.3]])
    direction = DockDirection.FORWARD if sign > 0 else DockDirection.BACKWARD
    return Dock(Pose2(0.0, 0.0, 0.0), station, direction, 0.3, approach_speed=0.15, approach_distance=0.3)


@functools.cache
def running(sign=1, drive=Drive.DIFFERENTIAL):
    """A plan of an S, in either gear."""
    limits = LIMITS if drive is Drive.DIFFERENTIAL else STEERED
    start = Pose2(-sign * 2.8, 0.7, 0.1)
    obstacles = [box_at(-sign * 1.5, 1.4), box_at(-sign * 1.0, -0.9)]
    return plan_dock(DockingProblem(start, dock_of(sign), Robot(OUTLINE, limits, drive), obstacles), time_budget=BUDGET)


def moved(plan, dx, dy, turn):
    return plan.problem.goal @ Pose2(dx, dy, turn)


def with_obstacle(plan, at):
    obstacles = plan.problem.obstacles + ObstacleSet.from_polygons([box_at(at.x, at.y)], "new")
    return dataclasses.replace(plan.problem, obstacles=obstacles)


def assert_continuous(plan, found, rate=1.0):
    """At the joint the new motion is where the running one is, and drives as it does."""
    before, after = plan.trajectory.at(found.starts_at), found.trajectory.at(0.0)
    assert before.pose.gap_to(after.pose) <= 1e-6
    assert after.twist.linear == pytest.approx(rate * before.twist.linear, abs=1e-6)
    assert after.twist.angular == pytest.approx(rate * before.twist.angular, abs=1e-6)
    assert after.acceleration == pytest.approx(rate * rate * before.acceleration, abs=1e-6)
    if rate * abs(before.twist.linear) > 1e-6:
        bent = plan.path.curvature_at(before.s)[0]
        assert found.trajectory.path.curvature_at(0.0)[0] == pytest.approx(bent, abs=1e-6)


def assert_lawful(found):
    """Certified, and by the independent check, too."""
    plan = found.plan
    assert certify_path(plan.path, plan.problem).certified
    assert certify_motion(plan.trajectory, plan.problem).certified
    assert dense_check(plan.path, plan.problem).ok


@pytest.mark.parametrize("drive", list(Drive))
@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("share", [0.0, 0.35])
def test_new_plan_begins_where_the_running_one_is_as_it_drives(sign, drive, share):
    plan = running(sign, drive)
    goal = moved(plan, 0.02, -0.02, 0.02)
    found = replan(plan, goal, DriveState(share * plan.trajectory.duration), BUDGET, lead=LEAD)
    assert found.outcome is ReplanOutcome.NEW
    wheels_turned = plan.problem.start_wait(plan.path)  # until then the robot rests at its start
    assert found.starts_at == pytest.approx(max(share * plan.trajectory.duration + LEAD, wheels_turned))
    assert found.plan.path.end.gap_to(goal) <= 1e-6
    assert_continuous(plan, found)
    assert_lawful(found)


@settings(max_examples=15)
@given(
    share=st.floats(0.0, 1.2),
    rate=st.floats(0.0, 1.0),
    shift=st.tuples(st.floats(-0.1, 0.1), st.floats(-0.1, 0.1), st.floats(-0.09, 0.09)),
    sign=st.sampled_from([1, -1]),
)
def test_random_replans_are_continuous_and_proven(share, rate, shift, sign):
    plan = running(sign)
    state = DriveState(share * plan.trajectory.duration, rate)
    found = replan(plan, moved(plan, *shift), state, 0.05, lead=LEAD)
    if found.outcome is ReplanOutcome.KEPT:
        assert found.trajectory is plan.trajectory
        assert found.reason
        assert found.starts_at == 0.0
        return
    assert_continuous(plan, found, rate)
    if found.outcome is ReplanOutcome.NEW:
        assert_lawful(found)
        return
    assert found.reason
    assert abs(found.trajectory.at(found.trajectory.duration).twist.linear) <= 1e-9
    assert not found.proven or certify_trajectory(found.trajectory, LIMITS, SpeedZone()).certified


def commands(running, found, rate, period):
    """Speed, acceleration and yaw rate of the drive over a whole replan: the running motion, then the new one."""
    joint = found.starts_at
    t = np.arange(max(0.0, joint - 0.5), joint, rate * period)
    before, after = running.sample_at(t), found.trajectory.sample_at(np.arange(0.0, 0.5, period))
    scaled = [(before.speed, after.speed, rate), (before.acceleration, after.acceleration, rate**2)]
    return [np.concatenate((scale * first, second)) for first, second, scale in scaled]


@pytest.mark.parametrize(("share", "rate"), [(0.05, 0.6), (0.2, 1.0), (0.5, 0.6)])
def test_limits_hold_across_the_joint(share, rate):
    plan, period = running(), 0.002
    state = DriveState(share * plan.trajectory.duration, rate)
    found = replan(plan, moved(plan, 0.03, 0.02, -0.02), state, BUDGET, lead=LEAD)
    assert found.outcome is ReplanOutcome.NEW
    speed, acceleration = commands(plan.trajectory, found, rate, period)
    assert np.abs(np.diff(speed)).max() <= 1.01 * period * max(LIMITS.max_acceleration, LIMITS.max_deceleration)
    # Two samples apart the acceleration moves by the jerk at most; at the joint they lie closer together.
    assert np.abs(np.diff(acceleration)).max() <= 1.01 * period * LIMITS.max_jerk


def test_offset_of_the_robot_is_carried_to_the_joint():
    plan, offset = running(), Pose2(0.01, 0.04, 0.03)
    measured = plan.trajectory.at(2.0).pose @ offset
    found = replan(plan, plan.problem.goal, DriveState(2.0, pose=measured), BUDGET, lead=LEAD)
    assert found.outcome is ReplanOutcome.NEW
    moved_by = measured @ plan.trajectory.at(2.0).pose.inverse()
    predicted = moved_by @ plan.trajectory.at(2.0 + LEAD).pose
    assert found.trajectory.at(0.0).pose.gap_to(predicted) <= 1e-6
    assert_lawful(found)


def test_new_plan_begins_at_the_robot_for_any_offset():
    plan = running()
    reference = plan.trajectory.at(2.0).pose
    for off in (1e-7, 1e-4, 0.005):
        measured = reference @ Pose2(off, off, off)
        found = replan(plan, moved(plan, 0.0, 0.03, 0.0), DriveState(2.0, pose=measured), BUDGET, lead=LEAD)
        assert found.outcome is ReplanOutcome.NEW
        begins = measured @ reference.inverse() @ plan.trajectory.at(2.0 + LEAD).pose
        assert found.trajectory.at(0.0).pose.gap_to(begins) <= 1e-6
        assert found.way.pose.gap_to(measured) <= 1e-6


def test_moved_trajectory_continues_at_its_new_place():
    plan, by = running(), Pose2(0.03, -0.02, 0.05)
    dock = by @ plan.problem.goal @ Pose2(0.0, 0.03, 0.0)
    found = replan(plan, dock, DriveState(2.0, moved=by), BUDGET, lead=LEAD)
    assert found.outcome is ReplanOutcome.NEW
    assert found.trajectory.at(0.0).pose.gap_to(by @ plan.trajectory.at(2.0 + LEAD).pose) <= 1e-6
    assert found.plan.path.end.gap_to(dock) <= 1e-6


def test_way_around_a_new_obstacle():
    plan = running()
    s = 0.45 * plan.path.length
    beside = plan.path.pose_at(s) @ Pose2(0.0, -0.42, 0.0)
    world = with_obstacle(plan, beside)
    assert not certify_path(plan.path, world).certified
    found = replan(plan, world, DriveState(0.5), BUDGET, lead=LEAD)
    assert found.outcome is ReplanOutcome.NEW
    assert_continuous(plan, found)
    assert_lawful(found)


def test_wall_across_the_way_ends_in_a_stop_whose_way_is_proven():
    plan = running()
    s = float(plan.trajectory.sample_at(3.0).s[0])
    world = with_obstacle(plan, plan.path.pose_at(s + 1.0))
    found = replan(plan, world, DriveState(3.0), 0.02, lead=LEAD)
    assert found.outcome is ReplanOutcome.STOP
    assert found.proven
    assert found.plan is None
    assert found.reason
    assert found.starts_at == pytest.approx(3.0 + LEAD)
    assert_continuous(plan, found)
    assert found.motion.certified
    driven = plan.path.piece(s, float(plan.trajectory.sample_at(found.starts_at).s[0]) + found.trajectory.path.length)
    there = dataclasses.replace(world, start=driven.start, dock=dataclasses.replace(world.dock, pose=driven.end))
    assert "clearance" not in {fault.bound for fault in dense_check(driven, there).faults}


def test_obstacle_before_the_joint_stops_the_robot_at_once():
    """Just before the nose: not even the stop can be proven, and is the quickest there is."""
    plan = running()
    s = float(plan.trajectory.sample_at(3.0).s[0])
    world = with_obstacle(plan, plan.path.pose_at(s) @ Pose2(0.45 + 0.11, 0.0, 0.0))
    found = replan(plan, world, DriveState(3.0), BUDGET, lead=LEAD, drive_delay=0.01)
    assert found.outcome is ReplanOutcome.STOP
    assert not found.proven
    assert found.starts_at == pytest.approx(3.01)
    assert "not proven" in found.reason
    assert "new" in found.reason
    assert found.motion.certified
    state = plan.trajectory.at(3.01)
    least = state.twist.linear**2 / (2.0 * LIMITS.max_deceleration)
    assert least <= found.trajectory.path.length <= least + 0.15 * state.twist.linear + 1e-9


def test_a_budget_that_ends_between_any_two_readings_of_the_clock_is_answered():
    plan = running()
    s = float(plan.trajectory.sample_at(3.0).s[0])
    world = with_obstacle(plan, plan.path.pose_at(s + 1.0))
    for readings in range(1, 60):
        with budget_clock("counted"):
            found = replan(plan, world, DriveState(3.0), (readings + 0.5) * TICK, lead=LEAD)
        assert found.outcome is not ReplanOutcome.KEPT


def test_plan_is_kept_on_the_final_straight_within_the_tolerances():
    plan = running()
    late = plan.trajectory.duration - 0.4
    kept = replan(plan, moved(plan, 0.004, 0.006, 0.01), DriveState(late), BUDGET, lead=LEAD)
    assert kept.outcome is ReplanOutcome.KEPT
    assert "straight" in kept.reason
    assert kept.plan is plan
    gone = replan(plan, moved(plan, 0.0, 0.05, 0.0), DriveState(late), 0.01, lead=LEAD)
    assert gone.outcome is not ReplanOutcome.KEPT


def test_plan_within_the_tolerances_is_kept_before_its_path_is_smoothed():
    plan = running()
    s = plan.path.length - plan.problem.dock.final_straight - 0.01  # too short to be deformed
    time = float(np.interp(s, plan.trajectory.time_law.states[:, 0], plan.trajectory.time_law.times))
    kept = replan(plan, moved(plan, 0.002, 0.003, 0.005), DriveState(time), BUDGET, lead=0.0)
    assert kept.outcome is ReplanOutcome.KEPT
    assert "deformed" in kept.reason
    assert kept.tried == ()


def test_plan_beyond_new_limits_is_not_kept():
    plan = running()
    slower = dataclasses.replace(LIMITS, max_speed=0.1)
    world = dataclasses.replace(plan.problem, robot=Robot(OUTLINE, slower))
    assert replan(plan, plan.problem, DriveState(3.0), 1e-9, lead=LEAD).outcome is ReplanOutcome.KEPT
    assert replan(plan, world, DriveState(3.0), 1e-9, lead=LEAD).outcome is ReplanOutcome.STOP


def test_braking_distance_is_that_of_the_shortest_stop():
    drive = RunningDrive(running(), running().problem, DriveState(2.0))
    for lead in (0.0, 0.5, 1.0):
        joint = drive.branch_point(lead)
        stop, _ = braking(joint, LIMITS, "")
        assert joint.braking_distance(LIMITS) == pytest.approx(1.05 * stop.path.length, rel=1e-6)
    assert drive.branch_point(1e3).braking_distance(LIMITS) == 0.0


@functools.cache
def looking():
    """The same S for a robot with a camera, which sees the dock over the last 1.5 m."""
    robot = Robot(OUTLINE, LIMITS, camera=Camera(Pose2(0.4, 0.0, 0.0), math.radians(60.0)))
    dock = dataclasses.replace(dock_of(1), marker=(0.6, 0.0), visible_distance=1.5)
    start = Pose2(-2.8, 0.7, 0.1)
    return plan_dock(DockingProblem(start, dock, robot, [box_at(-1.5, 1.4), box_at(-1.0, -0.9)]), time_budget=BUDGET)


@pytest.mark.parametrize("share", [0.1, 0.5])
def test_new_plan_keeps_the_dock_in_view(share):
    plan = looking()
    found = replan(
        plan, moved(plan, 0.02, -0.03, 0.02), DriveState(share * plan.trajectory.duration), BUDGET, lead=LEAD
    )
    assert found.outcome is ReplanOutcome.NEW
    assert found.plan.problem.required_view is not None
    assert found.plan.certificate.view_margin >= -1e-6
    assert_lawful(found)


def test_plan_without_the_required_view_is_not_kept():
    plan = running()
    for field, outcome in ((2.0, ReplanOutcome.KEPT), (0.02, ReplanOutcome.STOP)):
        robot = Robot(OUTLINE, LIMITS, camera=Camera(Pose2(0.4, 0.0, 0.0), field))
        dock = dataclasses.replace(plan.problem.dock, marker=(0.6, 0.0), visible_distance=2.0)
        world = dataclasses.replace(plan.problem, robot=robot, dock=dock)
        assert replan(plan, world, DriveState(3.0), 1e-9, lead=LEAD).outcome is outcome


def test_motion_is_continuous_for_a_dock_behind_the_robot():
    plan = running()
    found = replan(plan, moved(plan, -2.5, 0.0, 0.0), DriveState(5.0), 0.05, lead=LEAD)
    assert found.outcome is not ReplanOutcome.KEPT
    assert_continuous(plan, found)


def test_after_the_end_of_the_plan_the_robot_begins_at_rest():
    plan = running()
    kept = replan(plan, plan.problem.goal, DriveState(plan.trajectory.duration + 1.0), BUDGET)
    assert kept.outcome is ReplanOutcome.KEPT
    stopped = replan(plan, moved(plan, 0.0, 0.5, 0.0), DriveState(plan.trajectory.duration + 1.0), 1e-6, lead=LEAD)
    assert stopped.outcome is ReplanOutcome.STOP
    assert stopped.trajectory.path.length <= 1e-6
    assert stopped.trajectory.at(0.0).pose.gap_to(plan.path.end) <= 1e-6


def test_target_in_another_frame_is_refused():
    plan = running()
    with pytest.raises(InvalidValue, match="frame"):
        replan(plan, dataclasses.replace(plan.problem, frame="odom"), DriveState(1.0))


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"time_budget": 0.0}, "time_budget"),
        ({"time_budget": math.inf}, "time_budget"),
        ({"drive_delay": -0.1}, "drive_delay"),
        ({"lead": -1.0}, "lead"),
    ],
)
def test_invalid_numbers_are_refused_by_name(wrong, said):
    plan = running()
    with pytest.raises(InvalidValue, match=said):
        replan(plan, plan.problem.goal, DriveState(1.0), **wrong)
    with pytest.raises(InvalidValue, match="state.rate"):
        replan(plan, plan.problem.goal, DriveState(1.0, -1.0))


@functools.cache
def with_a_cusp(*, turning=False):
    """A plan that stops on its way: for a change of gear, or at the end of a turn in place."""
    robot = Robot(OUTLINE, LIMITS, turns_in_place=turning)
    start = Pose2(1.6, 1.0, 1.2) if turning else Pose2(1.8, 1.2, -0.5)
    guesses = []
    if turning:
        turn = TurnSegment(start, 0.9)
        guesses = [Path((turn, Path.from_poses([turn.end, turn.end @ Pose2(-1.5, 0.0, 0.0)]).segments[0]))]
        dock = dataclasses.replace(dock_of(-1), pose=guesses[0].end)
    else:
        dock = dock_of(-1)
    return plan_dock(DockingProblem(start, dock, robot), guesses=guesses, time_budget=BUDGET)


@pytest.mark.parametrize("turning", [False, True])
def test_motion_is_continuous_at_joints_near_cusps_and_turns(turning):
    """Before, at and after cusps and in turns in place; there it waits for the rest, where another path may begin."""
    plan = with_a_cusp(turning=turning)
    assert plan.path.cusps
    assert plan.path.turns is turning
    goal = moved(plan, 0.015, 0.01, 0.01)
    for arrival in plan.trajectory.cusp_times.tolist():
        for before in (0.4, 0.05, 1e-9, -1e-9, -0.05):
            found = replan(plan, goal, DriveState(max(arrival - before - LEAD, 0.0)), BUDGET, lead=LEAD)
            assert found.outcome is ReplanOutcome.NEW
            assert found.starts_at >= arrival - before - 1e-9
            state = plan.trajectory.at(found.starts_at)
            assert plan.path.direction_at(state.s)[0] != 0 or abs(state.twist.angular) <= 1e-6
            assert_continuous(plan, found)
            assert_lawful(found)


def test_robot_that_turns_in_place_stops_by_turning_on_within_its_limits():
    plan = with_a_cusp(turning=True)
    assert isinstance(plan.path.segments[0], TurnSegment)
    middle = 0.5 * float(plan.trajectory.cusp_times[0])
    across = ObstacleSet.from_polygons([box_at(*plan.path.poses_at(plan.path.length - 0.3)[0, :2])], "new")
    world = dataclasses.replace(plan.problem, obstacles=across)
    found = replan(plan, world, DriveState(middle), 0.001, lead=LEAD)
    assert found.outcome is ReplanOutcome.STOP
    assert found.motion.certified
    assert found.trajectory.path.driven == 0.0
    assert_continuous(plan, found)


def test_robot_whose_clock_stands_still_begins_where_it_stands():
    plan = running()
    found = replan(plan, moved(plan, 0.02, 0.02, 0.0), DriveState(3.0, 0.0), BUDGET, lead=LEAD)
    assert found.outcome is ReplanOutcome.NEW
    assert found.starts_at == 3.0
    assert found.trajectory.at(0.0).twist.linear == 0.0


def test_cancelled_replan_keeps_the_plan_or_stops():
    plan = running()
    kept = replan(plan, moved(plan, 0.001, 0.0, 0.0), DriveState(3.0), BUDGET, lead=LEAD, cancel_checker=lambda: True)
    assert kept.outcome is ReplanOutcome.KEPT
    stopped = replan(plan, moved(plan, 0.1, 0.0, 0.0), DriveState(3.0), BUDGET, lead=LEAD, cancel_checker=lambda: True)
    assert stopped.outcome is ReplanOutcome.STOP
    assert "Cancelled" in stopped.reason


def test_replan_ends_within_its_budget():
    """By a clock of its own, which runs faster the more is asked of it: nothing here waits for the wall."""
    plan = running()
    found = replan(plan, moved(plan, 0.1, 0.1, 0.1), DriveState(3.0), 1e-9, lead=LEAD)
    assert found.outcome is ReplanOutcome.STOP
    assert found.plan is None
    assert found.reason
