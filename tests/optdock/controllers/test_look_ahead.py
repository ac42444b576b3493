"""Collision check of a motion, compared with dense poses among all obstacles."""

import math
import shutil

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from experiments.fuzz.kinds.kernels import replaced
from optdock.controllers.look_ahead import LookAhead, near_distances, radius_of, stopping_way
from optdock.geometry.footprint import Footprint
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import Pose2, Twist2
from optdock.kernels import using_kernels
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


@pytest.fixture(autouse=True)
def _no_kernel_is_replaced():
    """A kernel whose first result differs is replaced by its twin, and would be equal to it."""
    yield
    assert replaced() == ""


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


SHAPES = {
    "rectangle": Footprint.rectangle(0.4, 0.3, 0.5),
    "disc": Footprint.from_radius(0.3),
    "dented": Footprint(np.array([[0.5, 0.3], [0.1, 0.0], [0.5, -0.3], [-0.4, -0.3], [-0.4, 0.3]])),
}


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("seed", range(8))
def test_both_lanes_measure_equal_distances(name, seed):
    """Among polygons of three to six corners, also touching and overlapping ones, and without an obstacle."""
    random = np.random.default_rng(seed)
    outlines = [
        random.uniform(-1.5, 1.5, 2) + random.uniform(0.05, 0.4) * np.column_stack((np.cos(at), np.sin(at)))
        for at in (np.sort(random.uniform(0.0, 6.28, count)) for count in random.integers(3, 7, 6))
    ]
    obstacles = ObstacleSet.from_polygons([*outlines, box(0.5, 0.0, 0.1)])
    poses = np.concatenate((random.uniform(-1.0, 1.0, (5, 3)), np.zeros((1, 3)), [[20.0, 0.0, 0.0]]))
    found = []
    for lane in ("twin", "native"):
        with using_kernels(lane):
            found.append(near_distances(SHAPES[name], poses, obstacles))
            assert near_distances(SHAPES[name], poses, ObstacleSet.empty()).shape == (7, 0)
    assert np.array_equal(np.isinf(found[0]), np.isinf(found[1]))
    near = np.isfinite(found[0])
    assert np.abs(found[0][near] - found[1][near]).max() < 1e-12
    assert not near[-1].any()
    nearest = np.min(found[0], axis=1, initial=np.inf)
    exact = pose_clearances(poses, SHAPES[name], obstacles, checks_unions=False)[0]
    assert np.minimum(nearest, 0.5) == pytest.approx(np.minimum(exact, 0.5), abs=1e-12)


@settings(max_examples=30)
@given(places, st.lists(twists, min_size=4, max_size=8))
def test_a_clear_motion_meets_no_obstacle(corners, motions):
    """The remembered clearance of an earlier pose: with it no motion is called clear that a new search refuses."""
    world, look, pose = context([box(x, y) for x, y in corners]), LookAhead(), ORIGIN
    assert not look.is_clear(world, ROBOT.footprint, pose, 0.0)  # nothing is known yet
    for twist in motions:
        reach = 0.2 * (abs(twist.linear) + radius_of(ROBOT.footprint) * abs(twist.angular))
        way = stopping_way(pose, ROBOT.footprint, ((twist, 0.2),))
        if look.is_clear(world, ROBOT.footprint, pose, reach):
            assert pose_clearances(way, ROBOT.footprint, world.problem.all_obstacles)[0].min() > 0.0
        else:
            look.obstruction(world, way, NOWHERE, TOLERANCE)
        pose = pose.moved(twist, 0.2)


def test_a_motion_is_not_clear_after_a_change_of_the_costmap():
    grid = Costmap.writable((80, 80), 0.05, (-2.0, -2.0))
    world, look = PluginContext(local_costmap=grid, footprint=ROBOT.footprint), LookAhead()
    assert look.obstruction(world, np.zeros((1, 3)), NOWHERE, TOLERANCE) is None
    assert look.is_clear(world, ROBOT.footprint, ORIGIN, 0.4)
    assert not look.is_clear(world, ROBOT.footprint, ORIGIN, 0.6)  # as far as obstacles were searched
    assert not look.is_clear(PluginContext(local_costmap=grid, footprint=ROBOT.footprint), ROBOT.footprint, ORIGIN, 0.1)
    grid.data[38:42, 46] = 254
    assert not look.is_clear(world, ROBOT.footprint, ORIGIN, 0.4)
