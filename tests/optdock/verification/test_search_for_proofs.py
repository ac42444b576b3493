"""Numerical parts of the search for a proof: kernels and twins against each other and against SciPy."""

import contextlib
import itertools
import os
import shutil
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import ndimage, sparse
from scipy.sparse import csgraph

from experiments.fuzz.case import rng_of
from optdock import kernels
from optdock.geometry.obstacles import ObstacleSet
from optdock.impossibility import connectivity_graph, footprint_discs, obstacle_lattice, proof
from optdock.kernels import using_kernels

LANES = ["twin"] + ["audit"] * (shutil.which(os.environ.get("CC", "cc").split()[0]) is not None)


@pytest.fixture(params=LANES)
def lane(request):
    with using_kernels(request.param):
        yield request.param


def drawn_sites(rng):
    """Draw spans of nodes inside obstacles and samples of outlines, sometimes none, sometimes exactly at nodes."""
    count, step = int(rng.integers(1, 50)), float(rng.uniform(0.01, 0.2))
    spans, samples = int(rng.integers(0, 5)), int(rng.integers(0, 30))
    ends = np.sort(rng.integers(0, count + 1, (spans, 2)), axis=1)
    covered = np.column_stack((rng.integers(0, count, spans), ends)).reshape(-1, 3)
    points = rng.uniform(0.0, step * (count - 1), (samples, 2))
    if rng.random() < 0.5:
        points = np.rint(points / step) * step
    return covered, points, step, count


def no_look():
    """Let the search go on."""


def nodes_at(covered, points, step, count):
    found = np.zeros((count, count), dtype=bool)
    for row, first, stop in covered.tolist():
        found[row, first:stop] = True
    columns, rows = np.rint(points / step).astype(int).T
    found[rows, columns] = True
    return found


@pytest.mark.parametrize("number", range(40))
def test_distances_on_the_lattice_are_those_of_a_distance_transform(number):
    covered, points, step, count = drawn_sites(rng_of("lattice", 1, number))
    points = np.rint(points / step) * step
    found = obstacle_lattice.to_obstacles(covered, points, step, count, no_look)
    sites = nodes_at(covered, points, step, count)
    expected = step * ndimage.distance_transform_edt(~sites) if sites.any() else np.full(sites.shape, np.inf)
    np.testing.assert_allclose(found, expected, atol=1e-12)


@pytest.mark.parametrize("number", range(20))
def test_distances_are_never_below_the_distance_of_the_nearest_sample(number):
    _, points, step, count = drawn_sites(rng_of("lattice", 2, number))
    found = obstacle_lattice.to_obstacles(np.zeros((0, 3), dtype=np.int64), points, step, count, no_look)
    nodes = step * np.stack(np.meshgrid(np.arange(count), np.arange(count)), axis=-1)
    apart = np.hypot(*np.moveaxis(nodes[..., None, :] - points, -1, 0))
    nearest = apart.min(axis=-1, initial=np.inf)
    assert np.all(found >= nearest - 1e-12)
    assert np.all(
        (found <= nearest + np.sqrt(2.0) * step) | np.isinf(found)
    )  # a sample is half a diagonal off its node


@pytest.mark.parametrize("number", range(40))
def test_components_are_those_of_scipy(lane, number):
    rng = rng_of("components", 1, number)
    kinds = rng.choice(3, size=rng.integers(1, 9, 3), p=[0.3, 0.4, 0.3]).astype(np.int64)
    labels, counts = connectivity_graph.connected_cells(kinds)
    before = 0
    for kind, count in zip((1, 2), counts.tolist(), strict=True):
        expected, number_of_them = ndimage.label(kinds == kind)
        assert count == number_of_them
        np.testing.assert_array_equal(labels[kinds == kind], expected[kinds == kind] - 1 + before)
        before += count
    assert np.all(labels[kinds == 0] == -1)


def drawn_graph(rng):
    nodes = int(rng.integers(3, 40))
    joints = np.unique(np.sort(rng.integers(0, nodes, (int(rng.integers(1, 3 * nodes)), 2)), axis=1), axis=0)
    joints = joints[joints[:, 0] != joints[:, 1]]
    costs = rng.choice([1e-6, 0.25, 0.5, 1.0], nodes) if rng.random() < 0.5 else rng.uniform(0.01, 1.0, nodes)
    return joints, costs


def route_of(before):
    return connectivity_graph._route(before)


START, GOAL = connectivity_graph.START, connectivity_graph.GOAL


@pytest.mark.parametrize("number", range(40))
def test_the_cheapest_route_costs_as_much_as_that_of_scipy(lane, number):
    joints, costs = drawn_graph(rng_of("routes", 1, number))
    route = route_of(connectivity_graph.predecessors(joints, costs, START, GOAL, is_minimax=False))
    first, second = np.concatenate((joints, joints[:, ::-1])).T
    matrix = sparse.csr_matrix((costs[second], (first, second)), shape=(costs.size, costs.size))
    least = csgraph.dijkstra(matrix, indices=START)[GOAL]
    assert bool(route) == bool(np.isfinite(least))
    if route:
        assert sum(costs[node] for node in route[:-1]) == pytest.approx(least, abs=1e-12)
        assert {tuple(sorted(pair)) for pair in itertools.pairwise(route)} <= set(map(tuple, joints.tolist()))


@pytest.mark.parametrize("number", range(40))
def test_no_cheaper_nodes_than_those_of_the_minimax_route_connect_the_ends(lane, number):
    joints, costs = drawn_graph(rng_of("routes", 2, number))
    costs[[START, GOAL]] = 0.0
    route = route_of(connectivity_graph.predecessors(joints, costs, START, GOAL, is_minimax=True))
    highest = max((costs[node] for node in route), default=np.inf)

    def are_connected(is_kept):
        first, second = joints[is_kept[joints].all(axis=1)].T
        matrix = sparse.coo_matrix((np.ones(first.size), (first, second)), shape=(costs.size, costs.size))
        component = csgraph.connected_components(matrix, directed=False)[1]
        return component[START] == component[GOAL]

    assert not are_connected(costs < highest)
    assert are_connected(costs <= highest) == bool(route)


def polygon(rng):
    """Draw a star-shaped polygon."""
    angles = np.sort(rng.uniform(-np.pi, np.pi, int(rng.integers(3, 12))))
    radii = rng.uniform(0.2, 1.0, angles.size)
    return np.stack((radii * np.cos(angles), radii * np.sin(angles)), axis=1)


def drawn_lattice(rng):
    """Draw polygons, squares along the axes with corners at nodes among them, and a lattice that cuts some of them."""
    count, step, corner = int(rng.integers(2, 50)), float(rng.choice([0.05, 0.1, 0.17])), rng.uniform(-1.0, 0.0, 2)
    corner = np.rint(corner / step) * step if rng.random() < 0.5 else corner
    angles = (np.sort(rng.uniform(-np.pi, np.pi, int(rng.integers(3, 12)))) for _ in range(int(rng.integers(0, 6))))
    drawn = [np.stack((np.cos(one), np.sin(one)), axis=1) + rng.uniform(-2.0, 4.0, 2) for one in angles]
    for _ in range(int(rng.integers(0, 4))):
        low = np.rint(rng.uniform(-1.0, 3.0, 2) / step) * step
        drawn.append(low + step * int(rng.integers(1, 20)) * np.array([[0, 0], [1, 0], [1, 1], [0, 1]]))
    world = ObstacleSet.from_polygons(drawn)
    return obstacle_lattice.ObstacleLattice(SimpleNamespace(all_obstacles=world), corner, no_look), corner, step, count


@pytest.mark.parametrize("number", range(40))
def test_lattice_is_as_far_from_obstacles_as_shapely_says(lane, number):
    import shapely

    lattice, corner, step, count = drawn_lattice(rng_of("lattice", 3, number))
    found = lattice.distances(corner, step, count)
    nodes = shapely.points(*(corner + step * np.stack(np.meshgrid(*2 * [np.arange(count)]), axis=-1)).reshape(-1, 2).T)
    here = shapely.box(*corner, *(corner + step * (count - 1)))
    world = shapely.union_all([shapely.Polygon(one) for one in lattice.vertices])
    seen = shapely.intersection(world, here)
    assert np.all(found[shapely.contains_properly(world.buffer(-1e-9), nodes).reshape(count, count)] == 0.0)
    exact = shapely.distance(seen, nodes).reshape(count, count) if not seen.is_empty else np.full_like(found, np.inf)
    assert np.all(found >= exact - 1e-9)
    assert np.all((found <= exact + np.sqrt(2.0) * step + 1e-9) | np.isinf(exact))


NATIVE_AND_TWIN = pytest.mark.skipif("audit" not in LANES, reason="no C compiler")


@NATIVE_AND_TWIN
@pytest.mark.parametrize("number", range(40))
def test_both_lanes_are_equal_to_the_last_bit(number):
    """A kernel that differs in its first call is replaced by its twin, which would then be compared with itself."""
    rng = rng_of("proof lanes", 1, number)
    lattice, corner, step, count = drawn_lattice(rng)
    kinds = rng.integers(0, 3, rng.integers(1, 12, 3))
    (joints, costs), discs, headings = drawn_graph(rng), int(rng.integers(1, 6)), int(rng.integers(1, 5))
    distance, at = rng.uniform(0.0, 2.0, 400), rng.integers(100, 300, 9)
    shift = rng.integers(-100, 100, (headings, discs))
    outline, points = polygon(rng), rng.uniform(-1.0, 1.0, (200, 2))
    points[:5] = outline[0]
    results = []
    for one in ("twin", "native"):
        with using_kernels(one):
            results.append(
                (
                    obstacle_lattice._distances(lattice, corner, step, count),
                    *obstacle_lattice.least_and_most(distance, at, shift, 0.1 * np.arange(discs), 0.2 * np.ones(discs)),
                    *connectivity_graph.connected_cells(kinds),
                    connectivity_graph.predecessors(joints, costs, START, GOAL, is_minimax=False),
                    connectivity_graph.predecessors(joints, -costs, START, GOAL, is_minimax=True),
                    footprint_discs._depth(points, outline),
                )
            )
    assert not any("impossibility" in name for name in kernels._OfProcess.replaced), "only twins were compared"
    for twin, native in zip(*results, strict=True):
        np.testing.assert_array_equal(twin, native)


@NATIVE_AND_TWIN
def test_nodes_outside_the_arrays_are_an_error_in_c():
    one = np.zeros((1, 1), dtype=np.int64)
    with using_kernels("native"):
        with pytest.raises(IndexError, match="lattice"):
            obstacle_lattice._least_and_most_native(np.zeros(4), one.ravel(), one - 1, np.zeros(1), np.zeros(1))
        with pytest.raises(IndexError, match="node"):
            connectivity_graph._predecessors_native(np.array([[0, 5]]), np.zeros(5), START, GOAL, is_minimax=False)


def test_depths_are_those_of_shapely(lane):
    import shapely

    rng = np.random.default_rng(3)
    outline, points = polygon(rng), rng.uniform(-1.0, 1.0, (300, 2))
    shape, places = shapely.Polygon(outline), shapely.points(points)
    found, apart = footprint_discs._depth(points, outline), shapely.distance(shape.exterior, places)
    np.testing.assert_allclose(found, np.where(shapely.contains(shape, places), apart - 1e-9, -apart), atol=1e-12)


def drawn_tiles(grid, rng):
    """Four tiles of level 0, of which one was not examined and one is split."""
    places = [(0, 0, 1), (0, 1, 0), (0, 1, 1), *connectivity_graph.Tile(0, 0, 0).split()]
    tiles = [connectivity_graph.Tile(0, 0, 1)]
    for level, column, row in places[1:]:
        margin = rng.normal(0.0, grid.cell, (grid.count(level), proof.CELLS, proof.CELLS)).astype(np.float32)
        tiles.append(connectivity_graph.Tile(level, column, row, margin < -0.5 * grid.cell, margin))
    return tiles


@pytest.mark.parametrize("steps", [1, 2, 5, 100])
def test_a_graph_is_the_same_after_interruptions_between_its_steps(steps, monkeypatch):
    monkeypatch.setattr(connectivity_graph, "_AT_ONCE", 1)
    grid = connectivity_graph.CellGrid(np.zeros(2), 0.1, 2, 1)
    ends = [np.array([0.3, 0.2, 0.1]), np.array([2.0, 1.9, 0.4])]
    tiles, left = drawn_tiles(grid, rng_of("graph", 1, steps)), 0

    def look():
        nonlocal left
        left -= 1
        if left < 0:
            raise InterruptedError

    whole, parts = (
        connectivity_graph.ConnectivityGraph(grid, ends, connectivity_graph.by_certainty(grid)) for _ in range(2)
    )
    whole.add(tiles)
    waiting, calls = tiles, 0
    while waiting or left < 0:
        left, calls = steps, calls + 1
        with contextlib.suppress(InterruptedError):
            parts.add(waiting, look)
        waiting = []
    assert calls == -(-2 * len(tiles) // steps)
    assert whole.cost == parts.cost
    assert list(whole.joints) == list(parts.joints)
    assert all(np.array_equal(joint, parts.joints[pair]) for pair, joint in whole.joints.items())
    assert whole.route() == parts.route()
