"""What `replan` calls proven without a new plan: KEPT and STOP are about what is really driven, in the world now."""

import dataclasses
import functools
import math

import numpy as np
import pytest

from optdock.errors import InvalidValue
from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.footprint import Footprint
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import Pose2
from optdock.model.clearance_rule import ClearanceRule
from optdock.model.constant_jerk import TimeLaw
from optdock.model.dock import Dock, DockTolerances
from optdock.model.limits import MotionLimits
from optdock.model.path import Direction, Path, TurnSegment
from optdock.model.problem import DockingProblem
from optdock.model.robot import Drive, Robot, TrackingTube
from optdock.model.segments import ClothoidSegment
from optdock.model.trajectory import Trajectory
from optdock.planning.pipeline import plan_dock
from optdock.planning.plan import DockPlan
from optdock.planning.replanning import DriveState, ReplanOutcome, replan, still_holds
from optdock.plugins.registry import timed_by
from optdock.verification import ProvenWay, TrajectoryCertificate, certify_path, prove_motion

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
    return DockPlan(prove_motion(trajectory, problem), path)


def drive(start, length, curvature, sign=1):
    return ClothoidSegment(ClothoidSpline(start, np.array([0.0, length]), np.array([curvature, curvature]), sign))


def box(x, y, side):
    return ObstacleSet.of([np.array([[x, y], [x + side, y], [x + side, y + side], [x, y + side]])])


@pytest.mark.parametrize("aside", [-0.08, 0.08])
def test_robot_off_its_plan_keeps_it_only_where_the_way_back_is_clear(aside):
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
def test_plan_that_breaks_a_rule_of_the_world_now_is_not_kept(slower):
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


def test_robot_at_the_end_of_its_plan_stands_where_it_is_clear():
    plan = running()
    end = plan.path.end
    world = dataclasses.replace(plan.problem, obstacles=box(end.x, end.y, 0.1))
    found = replan(plan, world, DriveState(plan.trajectory.duration), NO_TIME, lead=LEAD)
    assert found.outcome is ReplanOutcome.STOP
    assert not found.proven


def test_stop_off_the_plan_is_proven_along_its_own_path():
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


def test_standing_clock_in_a_turn_is_not_waited_for():
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


def test_stop_that_would_roll_back_is_not_proven():
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


# The robot where it is measured.


def straight_plan(walls, clearance, tracking=None, **dock):
    """Two metres straight on, beside walls."""
    robot = Robot(OUTLINE, LIMITS, tracking=tracking or TrackingTube())
    dock = Dock(Pose2(2.0, 0.0, 0.0), **dock)
    problem = DockingProblem(Pose2(0.0, 0.0, 0.0), dock, robot, obstacles=walls, clearance=clearance)
    path = Path((drive(Pose2(0.0, 0.0, 0.0), 2.0, 0.0),), "map")
    return DockPlan(prove_motion(timed_by("NearOptimal", path, problem), problem), path)


def asked(plan, x, pose, target=None, budget=NO_TIME, **state):
    """What a robot is told that is at `x` of a straight plan by its clock, and at `pose` as measured."""
    law = plan.trajectory.time_law
    time = float(np.interp(x, law.at(t := np.linspace(0.0, law.duration, 4000))[:, 0], t))
    return replan(plan, target or plan.problem, DriveState(time, 1.0, pose, **state), budget, lead=LEAD)


BESIDE = [[[-1.0, 0.3], [3.0, 0.3], [3.0, 0.4], [-1.0, 0.4]]]  # 5 cm beside the robot


@pytest.mark.parametrize("target", ["same world", "moved dock", "new obstacle"])
@pytest.mark.parametrize(("aside", "clear"), [(0.0, True), (0.02, True), (0.039, True), (0.041, False), (0.06, False)])
def test_plan_is_kept_for_the_robot_where_it_is_not_where_it_should_be(aside, clear, target):
    """The path keeps 5 cm where 1 cm is required, so a robot may be up to 4 cm nearer to the wall."""
    plan = straight_plan(BESIDE, ClearanceRule(0.01, 0.01, 0.0))
    worlds = {
        "same world": plan.problem,
        "moved dock": plan.problem.goal @ Pose2(0.003, 0.0, 0.0),
        "new obstacle": dataclasses.replace(plan.problem, obstacles=[*BESIDE, [[1.0, -2.0], [1.1, -2.0], [1.0, -1.9]]]),
    }
    for side in (1.0, -1.0):
        measured = Pose2(1.0, side * aside, 0.0)
        found = asked(plan, 1.0, measured, worlds[target])
        if clear:
            assert found.outcome is ReplanOutcome.KEPT
            assert found.proven
            assert found.way.pose.gap_to(measured) <= 1e-6
        elif side > 0.0:
            assert found.outcome is ReplanOutcome.STOP
            assert found.proven is (aside < 0.05)  # a robot that is too near, but not inside, may stop


def test_tube_counts_as_wide_as_it_is_where_the_robot_is():
    """Two walls, 10 mm beside the docked robot, where the tube of 5 cm narrows to nothing."""
    walls = [[[2.32, y], [2.8, y], [2.8, y + 0.2], [2.32, y + 0.2]] for y in (0.26, -0.46)]
    plan = straight_plan(walls, ClearanceRule(0.05, 0.0, 1.0), TrackingTube(0.05), final_straight=0.5)
    x = 1.95  # the tube is 2.5 mm wide there, its clearance 2.5 mm on top
    for aside, kept in ((0.002, True), (0.006, True), (0.0105, False), (0.03, False)):
        found = asked(plan, x, Pose2(x, aside, 0.0))
        assert (found.outcome is ReplanOutcome.KEPT) is kept
        assert found.proven is (aside < 0.01)
    wide = straight_plan([], ClearanceRule(0.05, 0.0, 1.0), TrackingTube(0.05), final_straight=0.5)
    assert asked(wide, x, Pose2(x, 0.03, 0.0)).outcome is ReplanOutcome.KEPT  # nothing is there to be touched


def test_station_is_touched_by_a_robot_that_counts_as_docked():
    """A millimetre aside before its station: only other things must be a millimetre farther off."""
    station = Footprint([[0.4, 0.25], [0.4, -0.25], [0.8, -0.25], [0.8, 0.25]])
    plan = straight_plan([], ClearanceRule(0.0, 0.0, 0.0), footprint=station)
    assert asked(plan, 1.9, Pose2(1.9, 0.01, 0.01)).outcome is ReplanOutcome.KEPT
    assert asked(plan, 1.9, Pose2(1.9, 0.03, 0.0)).outcome is not ReplanOutcome.KEPT  # farther off than docked robots
    front = [[[2.4, -0.25], [2.8, -0.25], [2.8, 0.25], [2.4, 0.25]]]
    wall = straight_plan(front, ClearanceRule(0.0, 0.0, 0.0))
    assert asked(wall, 1.9, Pose2(1.9, 0.01, 0.01)).outcome is not ReplanOutcome.KEPT


def test_what_is_driven_relative_to_the_dock_is_judged_where_that_leads():
    ahead = [[[1.6, 0.3], [3.0, 0.3], [3.0, 0.4], [1.6, 0.4]]]  # not beside the robot yet, which has no relief
    plan = straight_plan(ahead, ClearanceRule(0.03, 0.03, 0.0), tolerances=DockTolerances(0.1, 0.1, 0.1))
    for aside, kept in ((0.019, True), (0.021, False)):
        by = Pose2(0.0, aside, 0.0)
        found = asked(plan, 1.0, None, by @ plan.problem.goal, moved=by)
        assert (found.outcome is ReplanOutcome.KEPT) is kept
        assert asked(plan, 1.0, None, by @ plan.problem.goal).outcome is ReplanOutcome.KEPT  # not moved: clear


def test_proven_cannot_be_set():
    plan = running()
    found = asked(plan, 1.0, None, dataclasses.replace(plan.problem, obstacles=box(1.4, -0.05, 0.2)))
    assert not found.proven
    for claim in ({"proven": True}, {"way": True}):
        with pytest.raises((TypeError, InvalidValue)):
            dataclasses.replace(found, **claim)
    with pytest.raises(InvalidValue, match="cannot be constructed"):
        ProvenWay()


def test_result_must_have_the_trajectory_of_its_plan():
    plan = running()
    law = plan.trajectory.time_law
    fast = Trajectory(plan.path, TimeLaw(law.durations / 10.0, law.jerks * 1000.0))
    kept = asked(plan, 1.0, None)
    assert kept.proven
    for claim in ({"trajectory": fast}, {"plan": None}, {"outcome": ReplanOutcome.STOP}, {"outcome": "new"}):
        with pytest.raises(InvalidValue):
            dataclasses.replace(kept, **claim)
    braked = asked(plan, 1.0, None, dataclasses.replace(plan.problem, obstacles=box(3.2, 0.2, 0.4)))
    assert braked.outcome is ReplanOutcome.STOP
    assert braked.proven
    assert not dataclasses.replace(braked, trajectory=fast).proven
    by_hand = TrajectoryCertificate((), {}, fast.duration, fast.path.digest)
    assert not dataclasses.replace(braked, trajectory=fast, motion=by_hand).proven


def test_new_plan_begins_on_the_path_within_the_tube_and_at_the_robot_outside():
    plan = straight_plan([], ClearanceRule(0.02, 0.02, 0.0), TrackingTube(0.03))
    target = plan.problem.goal @ Pose2(0.0, 0.01, 0.0)
    for aside, is_filtered, on_path in ((0.029, False, True), (0.031, False, False), (0.029, True, False)):
        measured = Pose2(0.8, aside, 0.0)
        found = asked(plan, 0.8, measured, target, budget=30.0, is_filtered=is_filtered)
        assert found.outcome is ReplanOutcome.NEW
        assert found.proven
        assert found.way.pose.gap_to(measured) <= 1e-6
        assert found.trajectory.path.start.y == pytest.approx(0.0 if on_path else aside, abs=1e-6)


def test_tube_covers_no_robot_where_something_new_stands_in_it():
    """2 cm beside the path, where the robot is 3 cm to that side: the tube about the reference is narrower now."""
    plan = straight_plan([], ClearanceRule(0.02, 0.02, 0.0), TrackingTube(0.05))
    post = [[0.7, 0.27], [0.8, 0.27], [0.8, 0.3], [0.7, 0.3]]
    world = dataclasses.replace(plan.problem, obstacles=[post])
    assert not asked(plan, 0.8, Pose2(0.8, 0.03, 0.0), world, budget=5.0).proven
    away = asked(plan, 0.8, Pose2(0.8, -0.03, 0.0), world, budget=5.0)
    assert away.outcome is ReplanOutcome.NEW
    assert away.proven
    assert away.trajectory.path.start.y == pytest.approx(-0.03, abs=1e-6)


def test_tube_that_narrows_before_the_joint_covers_no_robot_there():
    plan = straight_plan([], ClearanceRule(0.02, 0.02, 0.0), TrackingTube(0.05))
    time = 0.5 * plan.trajectory.duration
    joint = plan.trajectory.at(time + 0.6).pose
    post = [[joint.x + 0.1, 0.27], [joint.x + 0.2, 0.27], [joint.x + 0.2, 0.3], [joint.x + 0.1, 0.3]]
    world = dataclasses.replace(plan.problem, obstacles=[post])
    now = plan.trajectory.at(time).pose
    state = DriveState(time, 1.0, Pose2(now.x, -0.03, 0.0))
    found = replan(plan, world, state, 5.0, lead=0.6)
    assert found.outcome is ReplanOutcome.NEW
    assert found.proven
    assert found.trajectory.path.start.y == pytest.approx(-0.03, abs=1e-6)


def test_tube_that_tapers_before_the_joint_covers_no_robot_there():
    """4 cm off; the tube of 5 cm narrows over the last half metre, and the joint is in it."""
    plan = straight_plan([], ClearanceRule(0.02, 0.0, 0.5), TrackingTube(0.05))
    time = 0.55 * plan.trajectory.duration
    for lead, aside in ((0.3, 0.0), (1.0, -0.04)):
        now = plan.trajectory.at(time).pose
        target = plan.problem.goal @ Pose2(0.0, -0.03, 0.0)
        world = dataclasses.replace(plan.problem, dock=dataclasses.replace(plan.problem.dock, pose=target))
        found = replan(plan, world, DriveState(time, 1.0, Pose2(now.x, -0.04, 0.0)), 0.2, lead=lead)
        assert found.proven
        assert found.trajectory.path.start.y == pytest.approx(aside, abs=1e-6)


def test_clock_that_runs_fast_keeps_no_plan_that_breaks_a_limit_then():
    slow = dataclasses.replace(LIMITS, max_speed=0.2, max_acceleration=0.1, max_deceleration=0.1, max_jerk=0.2)
    problem = dataclasses.replace(running().problem, robot=Robot(OUTLINE, slow))
    plan = plan_dock(problem, time_budget=30.0)
    able = dataclasses.replace(problem, robot=Robot(OUTLINE, LIMITS))
    for world, rate, kept in ((problem, 1.0, True), (problem, 0.7, True), (problem, 1.2, False), (able, 1.2, True)):
        found = replan(plan, world, DriveState(0.5 * plan.trajectory.duration, rate), NO_TIME, lead=0.0)
        assert (found.outcome is ReplanOutcome.KEPT) is kept


def test_robot_is_on_the_leg_of_a_cusp_that_its_clock_shows():
    """On the way back already, by its pose; the clock shows the way there, from which it is decimetres off."""
    there = drive(Pose2(0.0, 0.0, 0.0), 1.0, 0.0)
    path = Path((there, drive(Pose2(1.0, 0.0, 0.0), 1.0, 0.5, -1)), "map")
    back = path.pose_at(1.6)
    off = path.pose_at(0.4).distance_to(back)
    side = -math.copysign(0.25 + 1.2 * off, back.y)
    wall = [[-1.0, side], [2.0, side], [2.0, 2.0 * side], [-1.0, 2.0 * side]]
    plan = plan_of(path.segments, Robot(OUTLINE, LIMITS))
    for obstacles, kept in (([], True), ([wall], False)):
        world = dataclasses.replace(plan.problem, obstacles=obstacles)
        assert asked(plan, 0.4, path.pose_at(0.4), world).outcome is ReplanOutcome.KEPT, "on its path"
        found = asked(plan, 0.4, back, world)
        assert (found.outcome is ReplanOutcome.KEPT) is kept
