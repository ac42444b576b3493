"""Proven motions and ways: only proofs create them, with the content that was proven."""

import copy
import dataclasses
import math
import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from optdock.errors import CertificationFailed, InvalidValue
from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.footprint import Footprint
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import Pose2
from optdock.model.clearance_rule import ClearanceRule
from optdock.model.constant_jerk import TimeLaw
from optdock.model.dock import Dock
from optdock.model.limits import MotionLimits
from optdock.model.path import ClothoidSegment, Path
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot, TrackingTube
from optdock.model.trajectory import Trajectory
from optdock.planning.plan import DockPlan
from optdock.planning.replanning import DriveState, replan, still_holds
from optdock.verification import (
    ProvenMotion,
    ProvenWay,
    certify_motion,
    certify_path,
    pose_clearance,
    prove_motion,
    prove_way,
    proven_for,
    proven_way,
    unchanged_way,
)
from optdock.verification.conservative_advancement import Begun
from optdock.verification.proven_motion import _not_clear_by

OUTLINE = Footprint.rectangle(0.4, 0.4, 0.5)
ROBOT = Robot(OUTLINE, MotionLimits(max_curvature=1.5, max_curvature_rate=6.0))
LENGTH = 2.0


def straight(y=0.0):
    return Path((ClothoidSegment(ClothoidSpline(Pose2(0.0, y, 0.0), np.array([0.0, LENGTH]), np.zeros(2))),), "map")


def law(duration=12.0):
    """Return a time law from rest to rest over `LENGTH` = 2 j T^3 in four phases of duration T."""
    quarter = duration / 4.0
    return TimeLaw(np.full(4, quarter), 0.5 * LENGTH / quarter**3 * np.array([1.0, -1.0, -1.0, 1.0]))


def problem(obstacles=(), clearance=0.02, robot=ROBOT, y=0.0):
    return DockingProblem(
        Pose2(0.0, y, 0.0), Dock(Pose2(LENGTH, y, 0.0)), robot, obstacles=list(obstacles), clearance=clearance
    )


def wall(gap):
    """Return a wall along the path at this distance from the robot."""
    return [[-1.0, 0.25 + gap], [3.0, 0.25 + gap], [3.0, 1.0 + gap], [-1.0, 1.0 + gap]]


def proven(**options):
    return prove_motion(Trajectory(straight(), law()), problem(**options))


# Made by proofs alone.


def test_a_proven_motion_ties_what_was_proven():
    task, trajectory = problem([wall(0.1)]), Trajectory(straight(), law())
    motion = prove_motion(trajectory, task)
    assert motion.trajectory is trajectory
    assert motion.problem is task
    assert motion.pose == task.start
    assert motion.certificate is certify_path(trajectory.path, task)
    assert motion.trajectory_certificate is certify_motion(trajectory, task)
    assert proven_for(trajectory) == task.fingerprint
    assert proven_for(Trajectory(trajectory.path, trajectory.time_law)) is None


@pytest.mark.parametrize("kind", [ProvenMotion, ProvenWay])
def test_only_proofs_create_proven_motions(kind):
    with pytest.raises(InvalidValue, match="cannot be constructed"):
        kind()
    forged = object.__new__(kind)
    for name in ("path", "trajectory", "problem", "pose", "certificate"):
        if hasattr(kind, name):
            with pytest.raises(InvalidValue, match="no proof was made"):
                getattr(forged, name)
    honest = proven() if kind is ProvenMotion else prove_way(straight(), problem()).way
    for name in ("trajectory", "path", "problem", "certificate", "anything"):
        with pytest.raises(AttributeError):
            setattr(honest, name, None)
        with pytest.raises(AttributeError):
            object.__setattr__(honest, name, None)


def test_a_plan_accepts_only_a_proven_motion():
    plan = DockPlan(proven(), straight())
    looks_like = type("Motion", (), dict.fromkeys(("trajectory", "problem", "certificate", "trajectory_certificate")))
    for other in (object.__new__(ProvenMotion), plan, None, looks_like()):
        with pytest.raises(InvalidValue):
            DockPlan(other, straight())
    for name in ("trajectory", "path", "problem", "certificate", "trajectory_certificate"):
        with pytest.raises(TypeError):
            dataclasses.replace(plan, **{name: getattr(plan, name)})
        with pytest.raises(AttributeError):
            object.__setattr__(plan, name, None)


def test_subclasses_of_plans_are_rejected():
    plan = DockPlan(proven(), straight())

    class Elsewhere(DockPlan):
        @property
        def trajectory(self):
            return Trajectory(straight(1.0), law())

    other = Elsewhere(plan.motion, plan.raw_path)
    with pytest.raises(InvalidValue, match="plan: must be a DockPlan"):
        still_holds(other, plan.problem)
    with pytest.raises(InvalidValue, match="plan: must be a DockPlan"):
        replan(other, plan.problem, DriveState(1.0))


@pytest.mark.parametrize(
    ("trajectory", "reason"),
    [
        (Trajectory(straight(), law(2.0)), "the motion is not certified: speed 2 m/s"),
        (Trajectory(straight(0.1), law()), "the path is not certified: the path misses the start pose"),
        (Trajectory(straight(), TimeLaw([1.0], [0.0], start_speed=0.3)), "the motion is not certified"),
    ],
)
def test_violations_are_not_proven(trajectory, reason):
    with pytest.raises(CertificationFailed, match=reason) as caught:
        prove_motion(trajectory, problem())
    assert caught.value.where["amount"] > 0.0
    assert proven_for(trajectory) is None


def test_a_collision_is_not_proven():
    with pytest.raises(CertificationFailed, match="overlaps obstacles"):
        proven(obstacles=[[[1.0, -0.1], [1.1, -0.1], [1.1, 0.1], [1.0, 0.1]]])


def test_pickles_and_copies_have_the_same_content():
    motion = proven(obstacles=[wall(0.1)])
    for other in (pickle.loads(pickle.dumps(motion)), copy.copy(motion), copy.deepcopy(motion)):
        assert type(other) is ProvenMotion
        assert other.certificate == motion.certificate
        assert other.trajectory.path.digest == motion.trajectory.path.digest
        assert other.problem.fingerprint == motion.problem.fingerprint
        assert proven_for(other.trajectory) == motion.problem.fingerprint
    way = prove_way(straight(), motion.problem).way
    assert pickle.loads(pickle.dumps(way)).path.digest == way.path.digest


# Ways from where the robot is.


@settings(max_examples=25)
@given(st.floats(-0.15, 0.15), st.floats(-0.2, 0.2), st.floats(0.0, 0.2), st.floats(0.0, 0.03))
def test_a_robot_next_to_its_path_keeps_the_clearance_on_its_return(across, turned, gap, required):
    """Sampled displaced poses keep the requirement, and the verdict is that of the closed form for a straight wall."""
    task = problem([wall(gap)], ClearanceRule(required, required, 0.0))
    pose = Pose2(0.3, across, turned)
    way = straight().piece(0.3)
    found = prove_way(way, task, pose)
    off = abs(across) + 2.0 * OUTLINE.circumscribed_radius * math.sin(0.5 * abs(turned))
    if abs(gap - required - off) > 2e-6:
        assert bool(found) is (gap - required > off)
    if found:
        assert found.way.pose is pose
        shares = np.random.default_rng(0).uniform(-1.0, 1.0, (40, 2))
        for share, place in shares:
            there = Pose2(1.3 + place, share * across, share * turned)
            assert pose_clearance(there, OUTLINE, task.all_obstacles)[0] >= required - 1e-6


@pytest.mark.parametrize("aside", [0.0, 0.03, 0.0499, 0.0501, 0.0701])
def test_a_tube_covers_displacements_up_to_its_width(aside):
    robot = dataclasses.replace(ROBOT, tracking=TrackingTube(0.05))
    task = problem([wall(0.07)], ClearanceRule(0.02, 0.02, 0.0), robot)
    assert bool(prove_way(straight(), task, Pose2(0.0, aside, 0.0))) is (aside <= 0.05)
    free = problem([wall(0.5)], ClearanceRule(0.02, 0.02, 0.0), robot)
    assert prove_way(straight(), free, Pose2(0.0, aside, 0.0))  # beyond the tube there is room enough


def test_a_robot_that_is_too_close_may_leave_and_may_not_come_nearer():
    task = problem([wall(0.01)])
    assert not prove_way(straight(), dataclasses.replace(task, robot=ROBOT, clearance=0.05))
    leaving = Path((ClothoidSegment(ClothoidSpline(Pose2(0.0, 0.0, -0.3), np.array([0.0, 1.0]), np.zeros(2))),), "map")
    assert prove_way(leaving, problem([[[-1.0, 0.4], [3.0, 0.4], [3.0, 1.0], [-1.0, 1.0]]], 0.1))


def test_a_way_is_unchanged_if_only_a_distant_dock_differs():
    motion = proven(obstacles=[wall(0.1)])
    task = motion.problem
    elsewhere = dataclasses.replace(task, dock=Dock(Pose2(LENGTH, -0.1, 0.0)))
    found = unchanged_way(motion, 0.2, 0.4, elsewhere)
    assert found.path.start.gap_to(Pose2(0.2, 0.0, 0.0)) <= 1e-9
    assert prove_way(found.path, elsewhere)
    assert unchanged_way(motion, 0.2, 1.9, elsewhere) is None  # the dock is near
    for change in (
        {"obstacles": [wall(0.1)]},
        {"clearance": 0.03},
        {"robot": Robot(OUTLINE, MotionLimits(max_curvature=1.0))},
        {"frame": "odom"},
    ):
        assert unchanged_way(motion, 0.2, 0.4, dataclasses.replace(task, **change)) is None


# Values that only look like ours.


def test_proofs_reject_subclasses_of_values():
    class Nowhere(DockingProblem):
        """A subclass could hide obstacles from the fingerprint."""

    class Slim(Footprint):
        pass

    class Near(Pose2):
        __slots__ = ()

    task = problem()
    parts = {name: getattr(task, name) for name in ("start", "dock", "robot", "obstacles", "clearance")}
    with pytest.raises(InvalidValue, match="problem: must be a DockingProblem"):
        prove_motion(Trajectory(straight(), law()), Nowhere(**parts))
    with pytest.raises(InvalidValue, match="problem: must be a DockingProblem"):
        prove_way(straight(), Nowhere(**parts))
    with pytest.raises(InvalidValue, match="robot.footprint: must be a Footprint"):
        Robot(Slim(OUTLINE.vertices), ROBOT.limits)
    with pytest.raises(InvalidValue, match="problem.start: must be a Pose2"):
        DockingProblem(Near(0.0, 0.0, 0.0), task.dock, ROBOT)
    with pytest.raises(InvalidValue, match="dock.pose: must be a Pose2"):
        Dock(Near(0.0, 0.0, 0.0))
    for name, kind in (("dock", Dock), ("robot", Robot), ("obstacles", ObstacleSet), ("clearance", ClearanceRule)):
        lookalike = object.__new__(type("Lookalike", (kind,), {}))
        vars(lookalike).update(vars(parts[name]))
        with pytest.raises(InvalidValue, match=f"problem.{name}: must be a"):
            DockingProblem(**(parts | {name: lookalike}))


# What a robot beside its way is spared, and what not.


def test_an_exempt_station_still_blocks_the_path():
    """The dock is 5 cm before the end of the path, so the station blocks the path."""
    station = Footprint([[0.4, 0.25], [0.4, -0.25], [0.8, -0.25], [0.8, 0.25]])
    rule = ClearanceRule(0.0, 0.0, 0.0)
    for at, clear in ((LENGTH, True), (LENGTH - 0.05, False)):
        dock = Dock(Pose2(at, 0.0, 0.0), footprint=station)
        task = DockingProblem(Pose2(0.0, 0.0, 0.0), dock, ROBOT, clearance=rule)
        assert bool(prove_way(straight(), task, Pose2(0.0, 0.01, 0.01))) is clear


def test_a_displaced_robot_near_a_tight_start_needs_more_clearance():
    task, start = problem([wall(0.01)], 0.05), Pose2(0.0, 0.0, 0.0)
    rest = {"begun": Begun(start, 0.01), "start_relief": 5.0}
    assert prove_way(straight(), task, start, **rest)
    assert prove_way(straight(), task, Pose2(0.0, 0.0049, 0.0), **rest)  # half of a centimetre is enough
    assert not prove_way(straight(), task, Pose2(0.0, 0.0051, 0.0), **rest)


@pytest.mark.parametrize(("gap", "holds"), [(0.0069, False), (0.0071, True)])
def test_near_a_tight_start_the_requirement_grows_by_the_displacement(gap, holds):
    """The start has 4 mm, half of which is required; with 5 mm of displacement the path must keep 7 mm."""
    begun = Begun(Pose2(0.0, 0.0, 0.0), 0.004)
    blocked = _not_clear_by(0.005, straight(), problem([wall(gap)], 0.05), begun, 5.0, spares_station=False)
    assert (blocked == "") is holds


@pytest.mark.parametrize(("begin", "dock"), [(0.2, Pose2(0.6, 0.0, 0.0)), (1.5, Pose2(9.0, 9.0, 0.0))])
def test_an_unchanged_way_is_far_from_both_docks(begin, dock):
    motion = proven()
    moved = dataclasses.replace(motion.problem, dock=Dock(dock))
    assert unchanged_way(motion, begin, begin + 0.1, moved) is None
    assert unchanged_way(motion, 0.2, 0.3, dataclasses.replace(motion.problem, dock=Dock(Pose2(9.0, 9.0, 0.0))))


def test_a_proven_way_covers_robots_in_the_tube_at_the_start():
    robot = dataclasses.replace(ROBOT, tracking=TrackingTube(0.05))
    for gap, width in ((0.5, 0.05), (0.03, 0.01), (0.01, 0.0)):
        path = Path((ClothoidSegment(ClothoidSpline(Pose2(0.0, 0.0, -0.8), np.array([0.0, 1.0]), np.zeros(2))),), "map")
        reach = float(np.max(OUTLINE.vertices @ [math.sin(-0.8), math.cos(-0.8)]))
        block = [[-1.0, reach + gap], [1.0, reach + gap], [1.0, 2.0], [-1.0, 2.0]]
        task = DockingProblem(path.start, Dock(path.end), robot, obstacles=[block], clearance=0.02)
        timed = TimeLaw(np.full(4, 3.0), 0.5 / 27.0 * np.array([1.0, -1.0, -1.0, 1.0]))
        motion = prove_motion(Trajectory(path, timed), task)
        for off, covered in ((0.9 * width, True), (1.1 * width + 1e-3, False)):
            pose = Pose2(0.0, off, -0.8)
            found = proven_way(motion, pose)
            assert (found is not None) is covered
            assert not covered or found.pose is pose
