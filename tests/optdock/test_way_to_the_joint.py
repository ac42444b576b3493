"""The way that a robot drives until a new plan takes over is judged by the world now, where that has changed."""

import dataclasses

import numpy as np
import pytest

from optdock.geometry.footprint import Footprint
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import Pose2
from optdock.model.clearance_rule import ClearanceRule
from optdock.model.dock import Dock
from optdock.model.limits import MotionLimits
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from optdock.planning.pipeline import plan_dock
from optdock.planning.replanning import DriveState, ReplanOutcome, replan

ROBOT = Robot(Footprint.rectangle(0.4, 0.3, 0.5), MotionLimits(max_yaw_rate=1.0, max_yaw_acceleration=1.0))
NOT_CLEAR = "the path until the takeover of a new plan is not clear"


def straight_past(gap, rule):
    """A plan along x, past a post so far from the robot's left side between 2.8 and 2.85 m."""
    y = 0.25 + gap
    post = ObstacleSet.from_polygons([[[2.8, y], [2.85, y], [2.85, y + 0.05], [2.8, y + 0.05]]])
    plan = plan_dock(
        DockingProblem(Pose2(0.0, 0.0, 0.0), Dock(Pose2(4.0, 0.0, 0.0)), ROBOT, post, rule), time_budget=30.0
    )
    assert plan.path.length == pytest.approx(4.0, abs=1e-3)
    return plan


def replanned_past(plan, target):
    """Asked before the post, with the joint behind it."""
    begin, end = (next(t for t in np.arange(0.0, 60.0, 0.02) if plan.trajectory.at(t).s > s) for s in (2.3, 3.1))
    return replan(plan, target, DriveState(begin), 30.0, lead=end - begin)


@pytest.mark.parametrize(("required", "is_clear"), [(0.05, True), (0.15, False)])
def test_way_keeps_the_clearance_that_is_asked_for_now(required, is_clear):
    """A post stands 0.1 m beside the plan: whoever asks for more is given none that takes over behind it."""
    plan = straight_past(0.1, ClearanceRule(0.05))
    moved = dataclasses.replace(plan.problem.dock, pose=plan.problem.goal @ Pose2(0.05, 0.02, 0.0))
    found = replanned_past(plan, dataclasses.replace(plan.problem, dock=moved, clearance=ClearanceRule(required)))
    assert (NOT_CLEAR in found.reason) is not is_clear
    assert (found.outcome is ReplanOutcome.NEW) is is_clear


@pytest.mark.parametrize(("farther", "is_clear"), [(0.0, True), (0.8, False)])
def test_within_the_taper_a_dock_that_is_elsewhere_asks_for_another_clearance(farther, is_clear):
    """1.2 m before the old dock 0.12 m are asked for, and there are 0.14; as far before the new one it is 0.2 m."""
    plan = straight_past(0.14, ClearanceRule(0.2, 0.0, 2.0))
    found = replanned_past(plan, plan.problem.goal @ Pose2(farther, 0.02, 0.0))
    assert (NOT_CLEAR in found.reason) is not is_clear
