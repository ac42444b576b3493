"""What `replan` calls proven without a new plan: KEPT and STOP are about what is really driven, in the world now."""

import dataclasses
import functools

import numpy as np
import pytest

from optdock.dock import Dock
from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.limits import MotionLimits
from optdock.obstacles import ObstacleSet
from optdock.path import Direction, Path, TurnSegment
from optdock.pipeline import plan_dock
from optdock.plan import DockPlan
from optdock.plugins import timed_by
from optdock.problem import DockingProblem
from optdock.replanning import DriveState, ReplanOutcome, replan, still_holds
from optdock.robot import Drive, Robot
from optdock.segments import ClothoidSegment
from optdock.verification import certify_motion, certify_path

NO_TIME, LEAD = 1e-9, 0.02  # [s]: nothing new is found in it
LIMITS = MotionLimits(max_yaw_rate=1.0, max_yaw_acceleration=1.0)
STEERED = MotionLimits(max_curvature=1.5, wheelbase=0.4, max_steering_angle=0.6, max_steering_rate=0.5)
OUTLINE = Footprint.rectangle(0.4, 0.3, 0.5)


@functools.cache
def running():
    problem = DockingProblem(Pose2(0.0, 0.0, 0.0), Dock(Pose2(4.0, 0.5, 0.0)), Robot(OUTLINE, LIMITS))
    return plan_dock(problem, time_budget=30.0)


def plan_of(segments, robot):
    """A plan over a path of one's own."""
    path = Path(tuple(segments), "map")
    problem = DockingProblem(path.start, Dock(path.end), robot)
    trajectory = timed_by("NearOptimal", path, problem, start_wait=problem.start_wait(path))
    certificates = certify_path(path, problem), certify_motion(trajectory, problem)
    assert all(one.certified for one in certificates)
    return DockPlan(problem, path, path, trajectory, *certificates, completed=True, timing_ms={})


def drive(start, length, curvature, sign=1):
    return ClothoidSegment(ClothoidSpline(start, np.array([0.0, length]), np.array([curvature, curvature]), sign))


def box(x, y, side):
    return ObstacleSet.of([np.array([[x, y], [x + side, y], [x + side, y + side], [x, y + side]])])


@pytest.mark.parametrize("aside", [-0.08, 0.08])
def test_a_robot_off_its_plan_keeps_it_only_where_the_way_back_is_clear(aside):
    plan = running()
    time = 0.4 * plan.trajectory.duration
    off = plan.trajectory.at(time).pose @ Pose2(0.0, aside, 0.0)
    beside = plan.path.pose_at(0.75 * plan.path.length)
    near = dataclasses.replace(plan.problem, obstacles=box(beside.x, beside.y + 0.25 + 0.03, 0.1))
    assert not still_holds(plan, near, time)
    assert replan(plan, near, DriveState(time, 1.0, off), NO_TIME, lead=LEAD).outcome is ReplanOutcome.STOP
    far = dataclasses.replace(plan.problem, obstacles=box(beside.x, beside.y + 0.25 + 0.3, 0.1))
    assert replan(plan, far, DriveState(time, 1.0, off), NO_TIME, lead=LEAD).outcome is ReplanOutcome.KEPT


@pytest.mark.parametrize("slower", ["robot", "zone", "curvature", "gear"])
def test_a_plan_that_breaks_a_rule_of_the_world_now_is_not_kept(slower):
    plan = running()
    known, dock = plan.problem, plan.problem.dock
    limits = {"robot": MotionLimits(max_speed=0.2), "curvature": MotionLimits(max_curvature=1e-3)}
    docks = {
        "zone": dataclasses.replace(dock, approach_speed=0.05, approach_distance=1.0),
        "gear": dataclasses.replace(dock, direction="backward"),
    }
    world = dataclasses.replace(
        known, robot=dataclasses.replace(known.robot, limits=limits.get(slower, LIMITS)), dock=docks.get(slower, dock)
    )
    assert replan(plan, world, DriveState(2.0), NO_TIME, lead=LEAD).outcome is ReplanOutcome.STOP
    faster = dataclasses.replace(
        known, robot=dataclasses.replace(known.robot, limits=dataclasses.replace(LIMITS, max_speed=0.6))
    )
    assert replan(plan, faster, DriveState(2.0), NO_TIME, lead=LEAD).outcome is ReplanOutcome.KEPT


def test_a_robot_at_the_end_of_its_plan_stands_where_it_is_clear():
    plan = running()
    end = plan.path.end
    world = dataclasses.replace(plan.problem, obstacles=box(end.x, end.y, 0.1))
    found = replan(plan, world, DriveState(plan.trajectory.duration), NO_TIME, lead=LEAD)
    assert found.outcome is ReplanOutcome.STOP
    assert not found.proven


def test_a_stop_off_the_plan_is_proven_along_its_own_path():
    plan = plan_of([drive(Pose2(0.0, 0.0, 0.0), 3.0, 0.8)], Robot(OUTLINE, LIMITS))
    state = DriveState(3.0, 1.0, plan.trajectory.at(3.0).pose @ Pose2(0.3, -0.3, 0.0))
    elsewhere = dataclasses.replace(plan.problem, dock=Dock(Pose2(9.0, 9.0, 0.0)))
    lead = 1.5
    stop = replan(plan, elsewhere, state, NO_TIME, lead=lead)
    assert stop.proven
    # A box where only the stop's own path leads, not the one that begins where the robot is now.
    end = stop.trajectory.path.end
    front = [end @ Pose2(0.45, y, 0.0) for y in np.linspace(-0.24, 0.24, 25)]
    for place in front:
        spot = box(place.x - 0.002, place.y - 0.002, 0.004)
        asked = dataclasses.replace(elsewhere, obstacles=spot)
        found = replan(plan, asked, state, NO_TIME, lead=lead)
        if found.proven and found.starts_at == stop.starts_at:
            begun = asked.starting_at(found.trajectory.path.start)
            kinds = {one.kind for one in certify_path(found.trajectory.path, begun).violations}
            assert "clearance" not in kinds


def test_a_clock_that_stands_in_a_turn_is_not_waited_for():
    corner = Pose2(1.0, 0.0, 0.0)
    robot = Robot(OUTLINE, LIMITS, turns_in_place=True)
    turn = TurnSegment(corner, 1.2)
    plan = plan_of([drive(Pose2(0.0, 0.0, 0.0), 1.0, 0.0), turn, drive(turn.end, 1.0, 0.0)], robot)
    amid = next(t for t in np.linspace(0.0, plan.trajectory.duration, 400) if plan.trajectory.at(t).s > 1.5)
    moved = plan.problem.goal @ Pose2(0.1, 0.05, 0.1)
    found = replan(plan, moved, DriveState(float(amid), 0.0), 30.0)
    assert found.starts_at == pytest.approx(amid)
    assert found.trajectory.path.start.gap_to(plan.trajectory.at(float(amid)).pose) <= 1e-6


def test_wheels_that_are_still_turned_at_a_cusp_are_waited_for():
    cusp = ClothoidSpline(Pose2(0.0, 0.0, 0.0), np.array([0.0, 1.2]), np.array([1.0, 1.0]))
    plan = plan_of(
        [drive(cusp.start, 1.2, 1.0), drive(cusp.end, 1.0, 0.8, -1)], Robot(OUTLINE, STEERED, Drive.ACKERMANN)
    )
    (arrival,) = plan.trajectory.cusp_times.tolist()
    law = plan.trajectory.time_law
    leaves = float(law.times[np.flatnonzero(np.abs(law.states[:, 0] - 1.2) <= 1e-6)[-1]])
    assert leaves > arrival + 1.0  # from 0.38 to -0.31 rad at 0.5 rad/s
    goal = plan.problem.goal @ Pose2(-0.1, 0.01, 0.02)
    found = replan(plan, goal, DriveState(arrival - 0.05), 30.0, lead=0.02)
    assert found.outcome is ReplanOutcome.NEW
    assert found.starts_at == pytest.approx(leaves)
    assert found.trajectory.path.segments[0].direction is Direction.REVERSE
    assert found.trajectory.path.curvature_at(0.0)[0] == pytest.approx(0.8, abs=1e-6)


def test_a_plan_that_says_it_was_made_for_this_world_is_proven_in_it():
    """Nothing but the dock differs from what the plan says it was made for; its certificate says otherwise."""
    plan = running()
    ahead = plan.trajectory.at(3.0).pose @ Pose2(0.45, -0.05, 0.0)
    walled = dataclasses.replace(plan.problem, obstacles=box(ahead.x, ahead.y, 0.1))
    claimed = dataclasses.replace(plan, problem=walled)
    found = replan(claimed, walled.goal @ Pose2(0.05, 0.02, 0.0), DriveState(3.0), 1.0, lead=0.3)
    assert found.outcome is ReplanOutcome.STOP
    assert "the way until a new plan could take over is not clear" in found.reason


def test_a_robot_that_cannot_stop_without_rolling_back_is_told_so():
    """Faster than its clock just before the end: the largest jerk takes the braking back too late."""
    plan = running()
    for before in (0.2, 0.3, 0.4):
        state = DriveState(plan.trajectory.duration - before, 1.3)
        elsewhere = dataclasses.replace(plan.problem, dock=Dock(Pose2(9.0, 9.0, 0.0)))
        found = replan(plan, elsewhere, state, NO_TIME, lead=0.0)
        at = plan.trajectory.at(found.starts_at)
        begins = found.trajectory.time_law.start_speed, found.trajectory.time_law.start_acceleration
        jumps = abs(begins[0] - 1.3 * at.twist.linear), abs(begins[1] - 1.69 * at.acceleration)
        assert found.outcome is ReplanOutcome.STOP
        assert max(jumps) <= 1e-6
        speeds = found.trajectory.time_law.at(np.linspace(0.0, found.trajectory.duration, 200))[:, 1]
        assert speeds.min() >= -1e-9
        assert abs(speeds[-1]) <= 1e-9
        assert found.proven is found.motion.certified
