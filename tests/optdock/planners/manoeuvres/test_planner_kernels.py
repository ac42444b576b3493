"""The kernels of prices, words, routes and curves: equal to their NumPy twins to the last bit."""

import dataclasses
import shutil

import numpy as np
import pytest

from experiments.families import instance
from optdock import kernels
from optdock.geometry.footprint import Footprint
from optdock.geometry.nurbs import Nurbs, shares
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import Pose2
from optdock.kernels import using_kernels
from optdock.model.dock import Dock, DockDirection
from optdock.model.limits import MotionLimits
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from optdock.planners.manoeuvres import arcs as arcs_module
from optdock.planners.manoeuvres import connections, price
from optdock.planners.manoeuvres.arcs import Arcs, ArcTree, advance, are_free, first_free, may_be_free
from optdock.planners.manoeuvres.disc_routes import Wavefront, elastic_band
from optdock.planners.manoeuvres.distance_field import DistanceField
from optdock.planners.manoeuvres.free_space import FreeSpace
from optdock.planners.manoeuvres.reeds_shepp import TURNS

pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")


def both_lanes(run):
    found = []
    for lane in ("twin", "native"):
        with using_kernels(lane):
            found.append(run())
    assert not kernels._OfProcess.replaced  # a kernel that differs in its first call is replaced by its twin
    return found


def assert_equal(twin, native):
    for a, b in zip(twin, native, strict=True):
        assert a.dtype == b.dtype
        assert a.shape == b.shape
        assert a.tobytes() == b.tobytes()


@pytest.mark.parametrize("zone", [(0.1, 0.3), (0.3, 0.02), (10.0, 0.3), (0.2, 0.0)])
@pytest.mark.parametrize("speed", [0.0, 0.3, -0.1])
def test_prices_of_both_lanes_are_equal(zone, speed):
    draw, scene = np.random.default_rng(3), instance("reverse_cusp", 0).problem
    dock = dataclasses.replace(scene.dock, approach_speed=zone[0], approach_distance=zone[1])
    problem = dataclasses.replace(scene, dock=dock, start_speed=speed)
    for rows, columns, size in ((40, 6, 0.3), (40, 3, 3.0), (40, 6, 0.01), (1, 1, 1.0), (0, 6, 1.0)):
        lengths = draw.normal(0.0, size, (rows, columns)) * draw.choice([0.0, 1e-7, 1.0, 1.0], (rows, columns))
        assert_equal(
            *both_lanes(lambda found=lengths: (price.least_prices(found, problem), price._durations(found, problem)))
        )


@pytest.mark.parametrize("kind", ["random", "far", "quarter turns", "on a grid", "the same pose", "none"])
def test_cheapest_words_of_both_lanes_are_equal(kind):
    draw, robot = np.random.default_rng(1), instance("reverse_cusp", 0).problem.robot
    starts, goals = draw.normal(0.0, 1.0, (2, 0 if kind == "none" else 90, 3))
    if kind == "far":
        goals[:, :2] *= 20.0
    if kind == "quarter turns":  # with arcs of half a turn, whose sign depends on rounding
        starts, goals = (np.round(part) * (0.8, 0.8, 0.5 * np.pi) for part in (starts, goals))
    if kind == "on a grid":
        starts, goals = np.round(starts), np.round(goals)
        goals[:, 2] = starts[:, 2]
    if kind == "the same pose":
        goals = starts.copy()
    for per_pair in (1, 3, 12, len(TURNS)):
        twin, native = both_lanes(lambda n=per_pair: connections.words_between(starts, goals, 0.8, robot, n))
        assert_equal(twin, native)
    ends = Arcs(starts[native.pair], native.lengths, native.curvatures).joints()[:, -1]
    assert np.abs(ends[:, :2] - goals[native.pair, :2]).max(initial=0.0) < 1e-9
    at_full_speed = price.driving_prices(native.lengths, robot).sum(axis=1)
    assert native.driven == pytest.approx(at_full_speed, abs=1e-12)


@pytest.mark.parametrize("speed", [0.0, 0.2, -0.2])
@pytest.mark.parametrize("direction", list(DockDirection))
def test_connections_of_both_lanes_are_equal(direction, speed):
    """Also for more pairs than are examined between two polls, and for words without motion."""
    draw, scene, polled = np.random.default_rng(4), instance("reverse_cusp", 0).problem, []
    dock = dataclasses.replace(scene.dock, direction=direction)
    space = FreeSpace(dataclasses.replace(scene, dock=dock, start_speed=speed), lambda: polled.append(1))
    trees = [ArcTree(np.zeros(3), scene.robot, gear) for gear in (1, -1)]
    for tree in trees:
        poses, signs = np.round(draw.normal(0.0, 1.5, (20, 3)), 1), draw.choice([-1.0, 0.0, 1.0], 20)
        tree._set(np.full(20, -1), np.column_stack((poses, draw.uniform(0.0, 3.0, 20), signs, np.zeros((20, 2)))))
    trees[1].nodes[:4, :3] = trees[0].nodes[:4, :3]
    ends = connections.all_pairs(*(connections.TreeNodes(tree, np.arange(20)) for tree in trees))
    polled.clear()
    twin, native = both_lanes(lambda: connections.connections(*ends, 0.6, space, 5))
    assert_equal(twin, native)
    assert len(polled) == 4
    assert np.all(np.diff(native.prices) >= 0.0)
    assert 300 < native.prices.size <= 2000


@pytest.mark.parametrize("spacing", [0.003, 0.05, 10.0])
def test_poses_by_gear_of_both_lanes_are_equal(spacing):
    draw = np.random.default_rng(6)
    for _ in range(40):
        lengths = draw.normal(0.0, 1.0, (1, 9)) * draw.choice([0.0, 1e-10, 1.0, 1.0], (1, 9))
        whole = Arcs(draw.normal(0.0, 2.0, (1, 3)), lengths, draw.choice([0.0, 1.25, -1.25], (1, 9)))
        if np.abs(lengths).max() < 1e-9:
            continue
        twin, native = both_lanes(lambda arcs=whole: arcs_module._poses_by_gear(arcs, spacing))
        assert_equal(twin, native)
        poses, counts = native
        assert np.abs(counts).sum() == len(poses)
        assert np.all(counts[1:] * counts[:-1] < 0)
        assert np.hypot(*np.diff(poses[:, :2], axis=0).T).max() <= spacing + 1e-9


def test_joints_are_the_ends_of_one_arc_after_the_other():
    draw = np.random.default_rng(2)
    lengths = draw.normal(0.0, 1.0, (200, 5)) * draw.choice([0.0, 1.0, 1.0], (200, 5))
    arcs = Arcs(draw.normal(0.0, 2.0, (200, 3)), lengths, TURNS[draw.integers(0, 44, 200)])
    poses = [arcs.start]
    for k in range(5):
        poses.append(advance(poses[-1], lengths[:, k], arcs.curvatures[:, k]))
    assert np.array_equal(arcs.joints(), np.stack(poses, axis=1))


def scattered(seed, count):
    draw, angles = np.random.default_rng(seed), np.arange(5) * 1.2
    sizes, middles = draw.uniform(0.1, 0.4, count), draw.uniform(-3.0, 3.0, (count, 2))
    outline = np.column_stack((np.cos(angles), np.sin(angles)))
    return ObstacleSet.from_polygons([at + size * outline for at, size in zip(middles, sizes, strict=True)])


@pytest.mark.parametrize("seed", range(4))
def test_waves_and_ways_of_both_lanes_are_equal(seed):
    """Also with a wave that ends in a closed room, and with one that advances further in a second call."""
    draw = np.random.default_rng(seed)
    points, walls = draw.uniform(-4.0, 4.0, (6, 2)), []
    if seed == 3:
        lower = np.array([[-0.6, -0.6], [-0.6, 0.5], [-0.6, -0.6], [0.5, -0.6]])
        sizes = np.array([[1.2, 0.1], [1.2, 0.1], [0.1, 1.2], [0.1, 1.2]])
        walls = [ObstacleSet.from_rectangles(lower, lower + sizes, "walls")]
    obstacles = sum(walls, scattered(seed, 0 if walls else 14))

    def run():
        field = DistanceField(obstacles, np.array([0.1, -0.2, 7.0]), 0.05, 1.5, lambda: None)
        wave = Wavefront(field, np.array([0.05, 0.1]), 0.12)
        first = wave.lengths(points[:1])
        early = wave._wave
        found = first, early.steps.copy(), early.front, wave.lengths(points), wave._wave.steps, wave._wave.front
        ways = [wave.way(point) for point in points]
        return (
            *found,
            np.array(wave._wave.taken),
            field._slots >= 0,
            *[np.zeros((0, 2)) if way is None else way for way in ways],
        )

    twin, native = both_lanes(run)
    assert_equal(twin, native)
    assert np.isinf(native[3]).all() == (seed == 3)
    for length, way in zip(native[3], native[8:], strict=True):
        legs = np.abs(np.diff(way, axis=0))
        assert np.all(legs.max(axis=1, initial=0.0) <= 0.05 + 1e-12)
        assert (len(way) == 0) == np.isinf(length)
        assert len(way) <= length / 0.05 + 2.0 + 1e-9  # the way back may take diagonals that the wave has not taken


def space_among(obstacles, poll=lambda: None):
    robot = Robot(Footprint.rectangle(0.3, 0.2, 0.3), MotionLimits(max_curvature=2.0))
    return FreeSpace(DockingProblem(Pose2(-1.0, 0.3, 0.4), Dock(Pose2(1.0, 0.2, 0.0)), robot, obstacles), poll)


@pytest.mark.parametrize("seed", range(3))
def test_elastic_bands_of_both_lanes_are_equal(seed):
    route = np.cumsum(np.random.default_rng(seed).normal(0.1, 0.2, (20, 2)), axis=0)
    twin, native = both_lanes(lambda: elastic_band(route, space_among(scattered(seed, 12)), 0.7))
    assert_equal([twin], [native])
    assert np.array_equal(native[[0, -1]], route[[0, -1]])


@pytest.mark.parametrize("count", [0, 3, 40, 300])
def test_the_first_free_sequence_and_the_rough_check_of_both_lanes_are_the_same(count):
    draw = np.random.default_rng(5)
    starts = np.column_stack((draw.uniform(-2.0, 2.0, (60, 2)), draw.uniform(-3.0, 3.0, 60)))
    lengths = draw.uniform(-0.5, 0.5, (60, 5)) * draw.choice([0.0, 1.0, 1.0], (60, 5))
    words, places = Arcs(starts, lengths, draw.choice([0.0, 1.25, -1.25], (60, 5))), np.arange(1, 9) / 9.0

    def run():
        space, at, chosen = space_among(scattered(1, count)), 0, []
        while at < 60:
            at += first_free(words.rows(slice(at, None)), places, 0.05, space, (0.0, 0.0))
            chosen.append(at)
            at += 1
        return np.array(chosen), may_be_free(words, places, space), are_free(words, 0.05, space, (0.0, 0.0))

    (twin, rough, free), (native, native_rough, _) = both_lanes(run)
    assert np.array_equal(twin, native)
    assert np.array_equal(rough, native_rough)
    assert rough[free].all()
    assert rough.all() == (count == 0)
    chosen = native[native < 60]
    assert free[chosen].all()
    assert chosen.size >= free.sum() - 2  # a few are blocked only at shares of their lengths


def test_the_deadline_is_polled_while_a_wave_spreads():
    class Stopped(Exception):
        pass

    def poll():
        polled.append(1)
        if len(polled) > most:
            raise Stopped

    polled, most = [], 10**6
    field = DistanceField(scattered(1, 10), np.array([0.0, 0.0, 7.0]), 0.02, 1.5, poll)
    with using_kernels("native"):
        for _ in range(2):  # the first call of a process also runs the twin; all tiles are there now
            polled.clear()
            Wavefront(field, np.zeros(2), 0.1).lengths(np.array([[3.2, 3.2]]))
        assert len(polled) >= 3
        most = 1
        polled.clear()
        with pytest.raises(Stopped):
            Wavefront(field, np.zeros(2), 0.1).lengths(np.array([[3.2, 3.2]]))


@pytest.mark.parametrize("degree", [1, 2, 3, 5])
@pytest.mark.parametrize("count", [6, 9])
def test_curves_of_both_lanes_are_equal(degree, count):
    curve = Nurbs(np.random.default_rng(degree).normal(0.0, 2.0, (count, 2)), degree)
    u = np.concatenate((np.linspace(-0.1, 1.1, 60), curve.knots))
    assert_equal(*both_lanes(lambda: (*(curve._derivative(u, order) for order in range(4)), curve.tangent_yaw_at(u))))
    assert np.array_equal(shares(count), np.linspace(0.0, 1.0, count + 1))
