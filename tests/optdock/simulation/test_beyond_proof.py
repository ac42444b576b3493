"""Descriptions of driven poses outside of the certified tube or clearance."""

import functools

import numpy as np
import pytest

from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.model.clearance_rule import ClearanceRule
from optdock.model.dock import Dock
from optdock.model.limits import MotionLimits
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot, TrackingTube
from optdock.planning.pipeline import plan_dock
from optdock.simulation import beyond_proof

PLATE = Footprint([(0.4, -0.3), (0.6, -0.3), (0.6, 0.3), (0.4, 0.3)])
WALL = [[0.5, 0.45], [2.5, 0.45], [2.5, 0.65], [0.5, 0.65]]  # 0.2 m beside the straight way in


@functools.cache
def plan(cross=0.0):
    robot = Robot(Footprint.rectangle(0.4, 0.3, 0.5), MotionLimits(), tracking=TrackingTube(cross, 0.0))
    dock = Dock(Pose2(3.0, 0.0, 0.0), footprint=PLATE)
    rule = ClearanceRule(0.15, 0.0, 0.3)
    return plan_dock(DockingProblem(Pose2(0.0, 0.0, 0.0), dock, robot, [WALL], rule), time_budget=30.0)


def left(asked, *offsets):
    """Description of poses with offsets (along, across, yaw) from the path at s [m]."""
    poses = [asked.path.pose_at(s) @ Pose2(*off) for s, off in ((1.0, (0.0, 0.0, 0.0)), *offsets)]
    return beyond_proof(asked.path, asked.problem, asked.certificate, np.array([pose.as_array() for pose in poses]))


def test_poses_on_the_path_are_within():
    assert left(plan()) == ""
    assert left(plan(0.02), (0.5, (0.0, 0.015, 0.0))) == ""


def test_without_a_tube_the_clearance_decides():
    spare = plan().certificate.min_clearance
    assert spare == pytest.approx(0.0, abs=1e-6)  # at the plate
    assert left(plan(), (1.5, (0.0, -0.3, 0.0))) == ""  # far off the path, and of every obstacle
    assert "0.1400 m from obstacles[0], 1.501 m from the dock, required 0.1500 m" in left(
        plan(), (1.5, (0.0, 0.06, 0.0))
    )


def test_with_a_tube_its_width_decides():
    assert "30.0 mm off the path 2.500 m from the dock, the tube is 20.0 mm wide" in left(
        plan(0.02), (0.5, (0.0, -0.03, 0.0))
    )


def test_at_the_dock_a_bumper_yields_by_two_millimetres():
    asked = plan(0.02)
    end = asked.path.length
    assert left(asked, (end, (0.0019, 0.0, 0.0))) == ""
    assert "from dock" in left(asked, (end, (0.0025, 0.0, 0.0)))
    assert left(asked, (end, (-0.005, 0.005, 0.0))) == ""  # where the tube has no width
