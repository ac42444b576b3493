"""The kernels of the search: equal to the distance field and the exact distances by NumPy."""

import functools
import shutil

import numpy as np
import pytest

from optdock import kernels
from optdock.geometry.footprint import Footprint
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import Pose2
from optdock.kernels import using_kernels
from optdock.model.clearance_rule import ClearanceRule
from optdock.model.dock import Dock
from optdock.model.limits import MotionLimits
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from optdock.planners.manoeuvres import arcs, distance_field
from optdock.planners.manoeuvres.arcs import Arcs, ArcTree, are_free, moves_of
from optdock.planners.manoeuvres.distance_field import DistanceField
from optdock.planners.manoeuvres.free_space import Effort, FreeSpace

pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")

LANES = ("twin", "native")


def rocks(seed):
    draw = np.random.default_rng(seed)
    polygons = []
    for middle in draw.uniform(-3.0, 3.0, (12, 2)):
        angles = np.sort(draw.uniform(0.0, 2.0 * np.pi, int(draw.integers(3, 8))))
        polygons.append(middle + draw.uniform(0.1, 0.6) * np.column_stack((np.cos(angles), np.sin(angles))))
    low = draw.uniform(-3.0, 3.0, (10, 2))
    return ObstacleSet.from_polygons(polygons) + ObstacleSet.from_rectangles(low, low + 0.3, "boxes")


def poses_around(seed, count=400):
    draw = np.random.default_rng(seed)
    return np.column_stack((draw.uniform(-4.0, 4.0, (count, 2)), draw.uniform(-np.pi, np.pi, count)))


ANGLES = 2.0 * np.pi * np.arange(40) / 40 + 0.1
BODIES = {
    "convex": Footprint.rectangle(0.45, 0.25, 0.6),
    "two pieces": Footprint([[0.5, 0.3], [-0.2, 0.3], [-0.2, 0.1], [0.3, 0.1], [0.3, -0.3], [0.5, -0.3]]),
    "drum": Footprint(np.column_stack((0.5 * np.cos(ANGLES), 0.4 * np.sin(ANGLES)))),
    "triangle": Footprint([[0.6, 0.0], [-0.1, 0.1], [-0.1, -0.1]]),
}
MOVES = moves_of((1.0, -1.0), (0.0, 1.25, -1.25))
EFFORTS = [Effort(0.8, 0.0, 12, 100), Effort(0.8, 0.03, 24, 100), Effort(0.8, 0.0, 24, 100, 0.5)]


def space_among(obstacles, body, rule=None, poll=lambda: None):
    """The free space from a start near the obstacles to a dock among them."""
    robot = Robot(BODIES[body], MotionLimits())
    rule = rule or ClearanceRule(0.08, 0.0, 0.4, 0.1, at_start=0.03)
    return FreeSpace(DockingProblem(Pose2(-1.0, 0.3, 0.4), Dock(Pose2(1.0, 0.2, 0.0)), robot, obstacles, rule), poll)


def both_lanes(run):
    found = []
    for lane in LANES:
        with using_kernels(lane):
            found.append(run())
    return found


@pytest.mark.parametrize("seed", range(6))
def test_tiles_of_both_lanes_are_equal_to_the_last_bit(seed):
    found, free = [], []
    for lane in LANES:
        space = space_among(rocks(seed), "convex")
        with using_kernels(lane):
            free.append(space.is_free(poses_around(seed)))
        slots = space.field._slots
        found.append((slots >= 0, space.field._values[slots[slots >= 0]]))
    assert len(rocks(seed)) > 16  # with few obstacles the kernel needs no fine discs, and fewer tiles
    assert 0.01 < free[0].mean() < 0.99
    assert np.count_nonzero(found[0][0]) > 20
    for a, b in zip(*found, strict=True):
        assert a.dtype == b.dtype
        assert a.tobytes() == b.tobytes()


@pytest.mark.parametrize("count", [1, 256, 257, 600])
def test_tiles_among_many_obstacles_are_equal_in_both_lanes(count):
    draw = np.random.default_rng(count)
    low, turned = draw.uniform(-1.0, 1.0, (2, count, 2))
    shape = 0.05 * np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.5]])
    boxes = ObstacleSet.from_rectangles(low[::2], low[::2] + 0.02, "boxes")
    # Overlapping walls: points inside both have the distance to the boundary that is farther away.
    boxes += ObstacleSet.from_rectangles(
        np.array([[-1.4, 0.2], [-1.4, -0.7]]), np.array([[-0.3, 1.6], [0.1, 1.5]]), "walls"
    )
    some = boxes + ObstacleSet.from_polygons([shape + at for at in turned[1::2]]) if count > 1 else boxes
    field = DistanceField(some, np.array([0.1, 0.2, 3.0]), 0.03, 0.9, lambda: None)
    twin, native = both_lanes(lambda: distance_field._tile_values(field, np.arange(field.tiles**2)))
    assert twin.tobytes() == native.tobytes()
    assert twin.min() < field.reach


def test_a_poll_that_raises_leaves_the_missing_tiles_missing():
    class Stopped(Exception):
        pass

    def stop():
        if len(polled) == 6:
            raise Stopped
        polled.append(1)

    polled = []
    space = space_among(rocks(1), "convex", poll=stop)
    with using_kernels("native"):
        space.is_free(np.zeros((1, 3)))  # the first call of a process also runs the twin
        with pytest.raises(Stopped):
            space.is_free(poses_around(1))
        slots = np.unique(space.field._slots)
        assert slots[0] == -1
        assert np.array_equal(slots[1:], np.arange(slots.size - 1))
        polled.clear()
        polled += [1] * 7
        free = space.is_free(poses_around(1))
    with using_kernels("twin"):
        assert np.array_equal(free, space.is_free(poses_around(1)))


def words_from(seed, count=30):
    draw = np.random.default_rng(seed)
    lengths = draw.uniform(-0.2, 0.2, (count, 5)) * draw.choice([0.0, 1e-12, 1.0, 1.0], (count, 5))
    return Arcs(poses_around(seed, count), lengths, draw.choice([0.0, 1.25, -1.25], (count, 5)))


@functools.cache
def space_of(lane, body):
    """A space for the tests of one lane: the first of them computes its tiles."""
    return space_among(rocks(1), body)


@pytest.mark.parametrize("effort", EFFORTS, ids=["strict", "margin", "relief"])
@pytest.mark.parametrize("body", BODIES)
def test_free_poses_arcs_and_sequences_of_both_lanes_are_equal(body, effort):
    limits, words, stations = (effort.margin, effort.start_relief), words_from(1), np.array([0.1, 0.25, 0.4])
    found = []
    for lane in LANES:
        space = space_of(lane, body)
        tree = ArcTree(np.zeros(3), space.problem.robot, -1)
        signs = np.tile([1.0, 0.0, -1.0], 16)
        nodes = np.column_stack((poses_around(9, 48), np.linspace(0.0, 2.0, 48), signs, np.zeros((48, 2))))
        tree._set(np.full(48, -1), nodes)
        with using_kernels(lane):
            every = space.is_free(poses_around(1), *limits)
            arc, ends = arcs._extensions(tree, np.arange(47, -1, -1), MOVES, stations, space, effort)
            found.append((every, arc, ends, are_free(words, 0.05, space, limits)))
    assert not kernels._OfProcess.replaced  # a kernel that differs in its first call is replaced by its twin
    for twin, native in zip(*found, strict=True):
        assert twin.dtype == native.dtype
        assert np.array_equal(twin, native)
    assert 0.02 < found[0][0].mean() < 0.98
    lengths = np.abs(found[0][2][:, 5])
    assert 0 < np.count_nonzero(lengths == 0.4) < 48 * len(MOVES)
    assert np.any(~np.isin(lengths, stations))
    assert 0 < found[0][3].sum() < 30


@pytest.mark.parametrize("body", BODIES)
def test_among_few_obstacles_the_kernel_needs_no_fine_discs(body):
    few = ObstacleSet.from_rectangles(
        np.array([[-0.9, 1.1], [0.3, -1.2]]), np.array([[0.9, 1.4], [1.8, -0.8]]), "boxes"
    )
    twin, native = both_lanes(lambda: space_among(few, body).is_free(poses_around(3), 0.03))
    assert np.array_equal(twin, native)
    assert 0.05 < twin.mean() < 0.95


def test_without_obstacles_everything_is_free():
    space = space_among(ObstacleSet.empty(), "convex")
    tree = ArcTree(np.zeros(3), space.problem.robot, 1)
    space.obstacles = ObstacleSet.empty()  # also without the station
    lengths, wholes = (
        both_lanes(run)
        for run in (
            lambda: arcs._extensions(tree, np.zeros(1, dtype=np.int64), MOVES, np.ones(1), space, EFFORTS[0])[1][:, 5],
            lambda: are_free(words_from(0), 0.02, space, (0.0, 0.0)),
        )
    )
    assert all(np.array_equal(found, MOVES[:, 0]) for found in lengths)
    assert all(found.all() for found in wholes)


def test_the_deadline_is_polled_during_long_checks():
    class Stopped(Exception):
        pass

    def poll():
        polled.append(1)
        if len(polled) > most:
            raise Stopped

    polled, most = [], 10**6
    space = space_among(rocks(2), "convex", poll=poll)
    with using_kernels("native"):
        space.is_free(poses_around(2, 5000))  # the first call of a process also runs the twin; all tiles are there now
        polled.clear()
        space.is_free(poses_around(2, 5000))
        assert len(polled) == 10
        polled.clear()
        most = 4
        with pytest.raises(Stopped):
            space.is_free(poses_around(2, 5000))


def test_tiles_hold_distances_up_to_their_reach():
    field = DistanceField(rocks(1), np.array([0.0, 0.0, 7.0]), 0.05, 0.7, lambda: None)
    with using_kernels("native"):
        values = distance_field._tile_values(field, np.arange(field.tiles**2))
    assert values.max() == 0.7
    assert values.min() < 0.0
