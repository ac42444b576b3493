"""The table of a motion: equal to the samples of the trajectory, in both lanes."""

import pickle
import shutil

import numpy as np
import pytest

from experiments.fuzz.kinds.kernels import replaced
from optdock.controllers.motion_table import MotionRow, evaluated, motion_table
from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.pose import Pose2
from optdock.kernels import using_kernels
from optdock.model.constant_jerk import TimeLaw
from optdock.model.path import ClothoidSegment, Path, TurnSegment
from optdock.model.trajectory import Trajectory

LANES = ["twin", pytest.param("native", marks=pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler"))]


@pytest.fixture(autouse=True)
def _no_kernel_is_replaced():
    """A kernel whose first result differs is replaced by its twin, and would be equal to it."""
    yield
    assert replaced() == ""


def at_rest_at(lengths):
    """Return a time law that starts and rests at every border of segments."""
    jerks = [step for length in lengths for step in np.array([1.0, -1.0, 1.0]) * length / 2.0]
    return TimeLaw([1.0, 2.0, 1.0] * len(lengths), jerks)  # each covers jerk * 2


def curve(start, seed, sign=1, sharp=2.0):
    rng = np.random.default_rng(seed)
    knots = np.concatenate(([0.0], np.cumsum(rng.uniform(0.05, 0.4, 6))))
    return ClothoidSpline(start, knots, rng.uniform(-sharp, sharp, 7), sign)


def driven(seed, *, turn):
    first = curve(Pose2(0.3, -0.2, 1.0), seed)
    segments = [ClothoidSegment(first)]
    if turn:
        segments.append(TurnSegment(first.end, -2.5 if seed % 2 else 1.2))
    segments.append(ClothoidSegment(curve((turn and segments[-1].end) or first.end, seed + 100, sign=-1, sharp=9.0)))
    path = Path(tuple(segments))
    return Trajectory(path, at_rest_at([segment.length for segment in segments]))


def polyline(seed):
    rng = np.random.default_rng(seed)
    path = Path.from_poses(np.cumsum(rng.uniform(0.02, 0.2, (12, 3)), axis=0))
    return Trajectory(path, at_rest_at([path.length]))


MOTIONS = [
    *(driven(seed, turn=turn) for seed in range(4) for turn in (False, True)),
    polyline(1),
]


def instants(motion, seed=0):
    inside = np.random.default_rng(seed).uniform(-0.5, motion.duration + 0.5, 60)
    borders = motion.time_law.times
    return np.concatenate((inside, borders, np.nextafter(borders, -1.0), np.nextafter(borders, 99.0), borders[:2]))


@pytest.mark.parametrize("lane", LANES)
@pytest.mark.parametrize("motion", MOTIONS, ids=range(len(MOTIONS)))
def test_the_table_is_equal_to_the_samples(motion, lane):
    times = instants(motion)
    with using_kernels(lane):
        found = motion_table(motion).at(times)
        rows = motion_table(motion).rows(*times[:3].tolist())
    wanted, path = motion.sample_at(times), motion.path
    for column, name in enumerate(MotionRow._fields[:8]):
        assert found[:, column] == pytest.approx(getattr(wanted, name), abs=1e-11), name
    assert found[:, 9] == pytest.approx(path.curvature_at(wanted.s), abs=1e-11)
    assert np.array_equal(found[:, 8], path.direction_at(wanted.s))
    assert [tuple(row) for row in rows] == [tuple(row) for row in found[:3].tolist()]


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
@pytest.mark.parametrize("motion", MOTIONS[:-1], ids=range(len(MOTIONS) - 1))
def test_both_lanes_are_equal_up_to_rounding(motion):
    found = []
    for lane in ("twin", "native"):
        with using_kernels(lane):
            found.append(motion_table(motion).at(instants(motion, 7)))
            assert motion_table(motion).at(np.zeros(0)).shape == (0, 10)
    assert np.abs(found[0] - found[1]).max() < 1e-12


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
def test_sizes_are_checked():
    with using_kernels("native"):
        evaluated(np.zeros(5 + 7 + 10), (1, 1), (1.0, 1.0), np.zeros(2))
        with pytest.raises(ValueError, match="array 0 must be contiguous with 27 elements"):
            evaluated(np.zeros(5 + 7 + 10), (2, 1), (1.0, 1.0), np.zeros(2))
        with pytest.raises(ValueError, match="needs a phase and a cell"):
            evaluated(np.zeros(5 + 10), (1, 0), (1.0, 1.0), np.zeros(2))


def test_a_pickled_motion_has_the_same_table():
    motion = MOTIONS[1]
    again = pickle.loads(pickle.dumps(motion))
    assert np.array_equal(motion_table(again).at(instants(motion)), motion_table(motion).at(instants(motion)))


@pytest.mark.parametrize("motion", MOTIONS[:3], ids=range(3))
def test_a_state_at_one_time_is_that_of_many_times(motion):
    law, times = motion.time_law, instants(motion, 3)
    assert [law.state_at(t) for t in times.tolist()] == [tuple(row) for row in law.at(times)[:, :3].tolist()]
