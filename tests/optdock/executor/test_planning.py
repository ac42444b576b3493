"""Planning of the executor: the plan that is kept is the one that was checked, for the pose of the robot."""

import dataclasses

import numpy as np
import pytest

from optdock.errors import InvalidValue
from optdock.executor.planning import DrivenMotion, Job, Outcome, planned
from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.model.clearance_rule import ClearanceRule
from optdock.model.dock import Dock, DockTolerances
from optdock.model.limits import MotionLimits
from optdock.model.path import ClothoidSegment, Path
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from optdock.model.trajectory import Trajectory
from optdock.planning.plan import DockPlan
from optdock.plugins.registry import timed_by
from optdock.verification import prove_motion

ROBOT = Robot(Footprint.rectangle(0.4, 0.4, 0.5), MotionLimits(max_curvature=1.5, max_curvature_rate=6.0))
PROBLEM = DockingProblem(
    Pose2(0.5, 0.0, 0.0),
    Dock(Pose2(4.0, 0.0, 0.0), final_straight=0.3, tolerances=DockTolerances(0.05, 0.05, 0.05)),
    ROBOT,
    clearance=ClearanceRule(0.05, 0.0, 0.3),
)


def plan_of(problem=PROBLEM):
    path = Path((ClothoidSegment(ClothoidSpline(problem.start, np.array([0.0, 3.5]), np.zeros(2))),), "map")
    return DockPlan(prove_motion(timed_by("NearOptimal", path, problem), problem), path)


def among(*boxes):
    return dataclasses.replace(
        PROBLEM, obstacles=[[[x, y], [x + 0.3, y], [x + 0.3, y + 0.3], [x, y + 0.3]] for x, y in boxes]
    )


def decided(world, aside, moved=None, budget=1e-9):
    plan = plan_of()
    law = plan.trajectory.time_law
    t = np.linspace(0.0, law.duration, 4000)
    time = float(np.interp(1.3, law.at(t)[:, 0], t))
    running = DrivenMotion.of(plan)
    job = Job(1, 0.0, world, budget, running, time, 1.0, Pose2(1.8, aside, 0.0), 0.0, moved)
    return planned(job)


@pytest.mark.parametrize(
    ("gap", "aside", "kept"),
    [
        (0.2, 0.0, True),
        (0.01, 0.045, False),  # beside the robot's path there is room, beside the plan's there is none
        (0.06, 0.0, True),
        (0.06, 0.009, True),
        (0.06, 0.011, False),  # between the robot and its plan
        (0.06, -0.011, False),
    ],
)
def test_kept_plan_is_checked_at_the_pose_of_the_robot(gap, aside, kept):
    found = decided(among((2.6, -0.25 - gap - 0.3)), aside)
    assert (found.outcome is Outcome.KEPT) is kept


def test_moved_plan_is_checked_at_its_displacement():
    moved = Pose2(0.0, -0.03, 0.0)
    world = dataclasses.replace(
        among((2.6, -0.25 - 0.07 - 0.3)), dock=dataclasses.replace(PROBLEM.dock, pose=moved @ PROBLEM.goal)
    )
    assert decided(world, -0.03, moved).outcome is not Outcome.KEPT
    assert decided(world, 0.0).outcome is Outcome.KEPT
    above = dataclasses.replace(among((2.6, 0.25 + 0.06)), dock=world.dock)
    assert decided(above, -0.03, moved).outcome is Outcome.KEPT
    assert decided(above, -0.03).outcome is not Outcome.KEPT


def test_a_new_motion_begins_at_the_robot_and_ends_at_the_dock():
    world = dataclasses.replace(PROBLEM, dock=dataclasses.replace(PROBLEM.dock, pose=Pose2(4.0, 0.02, 0.0)))
    found = decided(world, 0.045, budget=30.0)
    assert found.outcome is Outcome.NEW
    assert found.motion.plan.path.start.gap_to(Pose2(1.8, 0.045, 0.0)) <= 1e-6
    assert found.motion.plan.path.end.gap_to(world.goal) <= 1e-6


def test_motion_must_be_that_of_its_plan():
    plan = plan_of()
    assert DrivenMotion.of(plan).trajectory is plan.trajectory
    other = Trajectory(plan.path.moved(Pose2(0.0, 0.3, 0.0)), plan.trajectory.time_law)
    for parts in ((other, plan.problem, plan), (plan.trajectory, among((2.6, -0.2)), plan), (other, PROBLEM, object())):
        with pytest.raises(InvalidValue):
            DrivenMotion(*parts)


def test_motion_without_a_plan_cannot_be_replanned():
    plan = plan_of()
    job = Job(1, 0.0, PROBLEM, 0.1, DrivenMotion(plan.trajectory, PROBLEM), 1.0, 1.0, None, 0.0)
    found = planned(job)
    assert found.outcome is Outcome.FAILED
    assert "not a plan" in found.reason
