"""The kernels of the search: equal to the distance field and the exact distances by NumPy."""

import shutil

import numpy as np
import pytest

from optdock.geometry.footprint import Footprint
from optdock.geometry.obstacles import ObstacleSet
from optdock.kernels import using_kernels
from optdock.planners.manoeuvres import distance_field, free_space
from optdock.planners.manoeuvres.distance_field import Discs, DistanceField, disc_states

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


@pytest.mark.parametrize("seed", range(6))
def test_states_and_tiles_of_both_lanes_are_equal_to_the_last_bit(seed):
    draw = np.random.default_rng(seed)
    discs = Discs(draw.uniform(-0.5, 0.5, (9, 2)), draw.uniform(0.1, 0.3, 9), draw.uniform(-0.1, 0.3, 9))
    poses, required = poses_around(seed), draw.uniform(0.0, 0.2, 400)
    found, polls = [], []
    for lane in LANES:
        polled = []
        field = DistanceField(
            rocks(seed), np.array([0.1, -0.2, 7.0]), 0.02, 1.5, lambda polled=polled: polled.append(1)
        )
        with using_kernels(lane):
            found.append((*disc_states(field, discs, poses, required), field._values[: field._count], field._slots))
        polls.append(len(polled))
    assert all(0.01 < mask.mean() < 0.99 for mask in found[0][:3])
    assert polls[0] == polls[1] > 20
    for a, b in zip(*found, strict=True):
        assert a.dtype == b.dtype
        assert a.tobytes() == b.tobytes()


def test_a_poll_that_raises_leaves_the_missing_tiles_missing():
    class Stopped(Exception):
        pass

    def stop():
        if len(polled) == 3:
            raise Stopped
        polled.append(1)

    polled = []
    field = DistanceField(rocks(1), np.array([0.0, 0.0, 7.0]), 0.02, 1.5, stop)
    discs = Discs(np.zeros((1, 2)), np.ones(1), np.ones(1))
    with using_kernels("native"):
        disc_states(field, discs, np.zeros((1, 3)), np.zeros(1))  # the first call of a process also runs the twin
        with pytest.raises(Stopped):
            disc_states(field, discs, poses_around(1), np.zeros(400))
        assert set(np.unique(field._slots)) == {-1, 0, 1, 2}
        polled.clear()
        polled += [1] * 4
        states = disc_states(field, discs, poses_around(1), np.zeros(400))
    with using_kernels("twin"):
        again = disc_states(field, discs, poses_around(1), np.zeros(400))
    assert np.array_equal(states.blocked, again.blocked)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("corners", [4, 6, 40])
def test_clearances_of_both_lanes_are_equal(seed, corners):
    """To the last bit, but for bodies and obstacles with many corners, of which the twin skips edges."""
    angles = 2.0 * np.pi * np.arange(corners) / corners + 0.1
    footprint = Footprint(np.column_stack((0.5 * np.cos(angles), 0.4 * np.sin(angles))))
    drum = 0.3 * np.column_stack((np.cos(angles), np.sin(angles))) + [0.4, 0.3]
    obstacles = rocks(seed) + ObstacleSet.from_polygons([drum])
    found = []
    for lane in LANES:
        with using_kernels(lane):
            found.append(free_space._clearances(poses_around(seed), footprint, obstacles, 0.4))
    assert 0.05 < np.mean(found[0] < 0.0) < 0.95
    assert np.any(found[0] == 0.4)
    assert np.abs(found[0] - found[1]).max() <= (0.0 if corners < 40 else 1e-14)


def test_tiles_hold_distances_up_to_their_reach():
    obstacles, axes = rocks(1), np.column_stack((np.linspace(-2.0, 2.0, 32), np.linspace(-1.0, 3.0, 32)))
    rows = np.arange(len(obstacles))
    is_box = distance_field._are_boxes(obstacles)
    with using_kernels("native"):
        values = distance_field._tile_values(obstacles, rows[is_box], rows[~is_box], axes, 0.7)
    assert values.max() == 0.7
    assert values.min() < 0.0
