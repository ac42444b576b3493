"""Collision check of a motion, compared with dense poses among all obstacles."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from optdock.controllers.look_ahead import LookAhead, stopping_way
from optdock.geometry.footprint import Footprint
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import Pose2, Twist2
from optdock.model.costmap import Costmap
from optdock.model.dock import Dock
from optdock.model.limits import MotionLimits
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from optdock.plugins.interfaces import PluginContext
from optdock.verification import pose_clearances

ORIGIN = Pose2(0.0, 0.0, 0.0)
ROBOT = Robot(Footprint.rectangle(0.4, 0.3, 0.5), MotionLimits())
TOLERANCE = 0.01


NOWHERE = np.zeros((0, 3))


def obstruction(world, way, contacts=NOWHERE):
    return LookAhead().obstruction(world, way, contacts, TOLERANCE)


def box(x, y, half=0.05):
    return np.array([[x - half, y - half], [x + half, y - half], [x + half, y + half], [x - half, y + half]])


def context(polygons):
    far = Dock(Pose2(50.0, 0.0, 0.0))
    return PluginContext(problem=DockingProblem(ORIGIN, far, ROBOT, ObstacleSet.from_polygons(polygons)))


twists = st.builds(Twist2, st.floats(-0.5, 0.5), st.floats(-1.5, 1.5))
places = st.lists(st.tuples(st.floats(-0.8, 0.8), st.floats(-0.8, 0.8)), min_size=1, max_size=4)


@settings(max_examples=20)
@given(twists, st.floats(0.0, 1.5), places)
def test_it_finds_what_dense_poses_find(twist, duration, places):
    polygons = [box(x, y) for x, y in places]
    world = context(polygons)
    way = stopping_way(ORIGIN, ROBOT.footprint, ((twist, duration),))
    found = obstruction(world, way)
    poses = np.array([ORIGIN.moved(twist, t).as_array() for t in np.linspace(0.0, duration, 200)])
    depth = 0.0
    for polygon in polygons:
        distance, _ = pose_clearances(poses, ROBOT.footprint, ObstacleSet.from_polygons([polygon]))
        if distance.min() < min(0.0, distance[0] - 1e-6):
            depth = max(depth, -float(distance.min()))
    if found is None:
        assert depth < 0.016
    else:
        assert found.depth <= depth + 1e-4


def test_turns_in_place_are_checked_with_their_braking():
    beside = context([box(-0.25, 0.28, 0.02)])  # the rear left corner swings through it
    twist = Twist2(0.0, 1.0)
    soon = stopping_way(ORIGIN, ROBOT.footprint, ((twist, 0.02),))
    braking = stopping_way(ORIGIN, ROBOT.footprint, ((twist, 0.02 + 0.25),))
    for turn in (1.0, -1.0):
        mirrored = context([box(-0.25 if turn < 0.0 else 0.2, 0.28, 0.02)])
        way = stopping_way(ORIGIN, ROBOT.footprint, ((Twist2(0.0, turn), 0.5),))
        assert obstruction(mirrored, way) is not None
    assert obstruction(beside, soon) is None
    assert len(braking) > len(soon)


def test_robot_inside_an_obstacle():
    inside, ahead = box(0.0, 0.0, 0.1), box(0.32, 0.0, 0.04)
    world = context([inside, ahead])
    out = stopping_way(ORIGIN, ROBOT.footprint, ((Twist2(-0.3), 1.0),))
    onto = stopping_way(ORIGIN, ROBOT.footprint, ((Twist2(0.3), 0.5),))
    assert obstruction(context([inside]), onto) is None
    found = obstruction(world, onto)
    assert found.obstacle == "obstacles[1]"
    assert obstruction(context([box(0.3, 0.0, 0.12)]), out) is None


@pytest.mark.parametrize("thickness", [0.001, 0.004, 0.02])
@pytest.mark.parametrize("gear", [1.0, -1.0])
def test_thin_obstacles_are_found_in_both_gears(thickness, gear):
    front = 0.26 * gear if gear > 0.0 else -0.26
    wall = np.array([[front, -1.0], [front + thickness, -1.0], [front + thickness, 1.0], [front, 1.0]])
    post = box(front, 0.1, thickness / 2.0)
    for thing in (wall, post):
        way = stopping_way(ORIGIN, ROBOT.footprint, ((Twist2(0.3 * gear), 0.5),))
        found = obstruction(context([thing]), way)
        assert found is not None


def test_costmap_changes_count_in_the_next_call():
    grid = Costmap.writable((80, 80), 0.05, (-2.0, -2.0))
    world, look = PluginContext(local_costmap=grid, footprint=ROBOT.footprint), LookAhead()
    way = stopping_way(ORIGIN, ROBOT.footprint, ((Twist2(0.3), 0.5),))
    assert look.obstruction(world, way, NOWHERE, TOLERANCE) is None
    grid.data[38:42, 46] = 254
    assert look.obstruction(world, way, NOWHERE, TOLERANCE).obstacle == "map"
    grid.data[:] = 0
    assert look.obstruction(world, way, NOWHERE, TOLERANCE) is None


def test_only_intended_contacts_have_a_tolerance():
    wall = np.array([[0.45, -1.0], [0.6, -1.0], [0.6, 1.0], [0.45, 1.0]])
    end = np.array([[0.05, 0.0, 0.0]])  # the nose touches the wall there
    for wrong, beyond in ((0.008, 0.0), (0.012, 0.0), (0.008, 0.1)):
        way = stopping_way(ORIGIN, ROBOT.footprint, ((Twist2(0.05 + wrong), 1.0),))
        assert (obstruction(context([wall]), way, end) is None) == (wrong < TOLERANCE)
        assert obstruction(context([wall]), way) is not None
        deep = end + np.array([beyond, 0.0, 0.0])  # an end inside of something is no contact
        assert (obstruction(context([wall]), way, deep) is None) == (wrong < TOLERANCE and beyond == 0.0)
    station = Dock(Pose2(0.05, 0.0, 0.0), Footprint(np.array([[0.4, -0.2], [0.6, -0.2], [0.6, 0.2], [0.4, 0.2]])))
    docking = PluginContext(problem=DockingProblem(Pose2(-1.0, 0.0, 0.0), station, ROBOT))
    way = stopping_way(ORIGIN, ROBOT.footprint, ((Twist2(0.058), 1.0),))
    assert obstruction(docking, way) is None


def test_distant_obstacles_are_found_on_approach():
    look, world = LookAhead(), context([box(3.0, 0.0)])
    stopped = None
    for k in range(100):
        pose = Pose2(0.03 * k, 0.0, 0.0)
        way = stopping_way(pose, ROBOT.footprint, ((Twist2(0.3), 0.4),))
        if look.obstruction(world, way, NOWHERE, TOLERANCE) is not None:
            stopped = pose.x
            break
    reach = ROBOT.footprint.vertices[:, 0].max() + 0.12
    assert stopped == pytest.approx(3.0 - 0.05 - reach, abs=0.031)
    assert math.isfinite(stopped)


def test_contact_is_intended_only_near_its_pose():
    wall = np.array([[0.45, -1.0], [0.6, -1.0], [0.6, 1.0], [0.45, 1.0]])
    end = np.array([[0.05, 0.0, 0.0]])
    pressed = stopping_way(Pose2(0.0, 0.3, 0.0), ROBOT.footprint, ((Twist2(0.055), 1.0),))
    assert obstruction(context([wall]), pressed, end) is not None
    assert obstruction(context([wall]), pressed - np.array([0.0, 0.3, 0.0]), end) is None
