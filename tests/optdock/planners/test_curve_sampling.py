import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from optdock.errors import NoValidPathCouldBeFound, PlannerCancelled
from optdock.geometry.nurbs import Nurbs
from optdock.model.costmap import Costmap
from optdock.model.path import Direction
from optdock.planners.two_segment import MAX_SAMPLES, CurveSampler
from optdock.plugins.interfaces import never_cancelled

ARC = np.array([[0.0, 0.0], [2.0, 0.0], [3.0, 1.5]])


def sampler(*, resolution=0.05, step=0.02, costmap=None, threshold=200, degree=2, cancel=never_cancelled):
    return CurveSampler(degree, step, resolution, costmap, threshold, cancel)


def spacing(poses):
    return np.hypot(*np.diff(poses[:, :2], axis=0).T)


coordinates = st.floats(-5.0, 5.0, allow_subnormal=False)


@settings(max_examples=25)
@given(st.lists(st.tuples(coordinates, coordinates), min_size=3, max_size=3, unique=True), st.floats(0.01, 2.0))
def test_neighbours_are_never_farther_apart_than_the_resolution(points, resolution):
    poses = sampler(resolution=resolution).poses(np.array(points), Direction.FORWARD, "a curve")
    assert spacing(poses).max() <= resolution


def test_straight_curve_is_sampled_at_resolution_over_length():
    poses = sampler().poses(np.array([[0.0, 0.0], [1.9995, 0.0], [3.999, 0.0]]), Direction.FORWARD, "a curve")
    np.testing.assert_allclose(poses, np.column_stack((np.linspace(0.0, 3.999, 81), np.zeros((81, 2)))), atol=1e-12)


def test_step_of_u_is_never_coarser_than_asked():
    assert len(sampler(resolution=100.0).poses(ARC, Direction.FORWARD, "a curve")) == 51
    assert len(sampler(resolution=100.0, step=0.25).poses(ARC, Direction.FORWARD, "a curve")) == 5


def test_yaw_is_the_tangent_and_the_last_repeats_the_one_before():
    poses = sampler().poses(ARC, Direction.FORWARD, "a curve")
    u = np.linspace(0.0, 1.0, len(poses))
    np.testing.assert_allclose(poses[:-1, 2], Nurbs(ARC).tangent_yaw_at(u)[:-1], atol=1e-12)
    assert poses[-1, 2] == poses[-2, 2]
    assert poses[0, 2] == 0.0


def test_reverse_turns_every_pose_around():
    forward = sampler().poses(ARC, Direction.FORWARD, "a curve")
    reverse = sampler().poses(ARC, Direction.REVERSE, "a curve")
    np.testing.assert_allclose(reverse - forward, np.tile([0.0, 0.0, math.pi], (len(forward), 1)))


def test_degree_one_follows_the_control_polygon():
    poses = sampler(degree=1).poses(ARC, Direction.FORWARD, "a curve")
    assert spacing(poses).sum() == pytest.approx(2.0 + math.hypot(1.0, 1.5), abs=0.02)  # one step cuts the corner
    assert spacing(poses).max() <= 0.05


def test_curve_without_extent_is_empty():
    with pytest.raises(NoValidPathCouldBeFound, match="segment 9 is empty: only 0 of 51 samples are finite"):
        sampler().poses(np.ones((3, 2)), Direction.FORWARD, "segment 9")


def test_too_long_curve_is_refused_before_it_is_sampled():
    far = np.array([[0.0, 0.0], [5e8, 0.0], [1e9, 0.0]])
    with pytest.raises(NoValidPathCouldBeFound, match=f"2e\\+10 samples, at most {MAX_SAMPLES}"):
        sampler().poses(far, Direction.FORWARD, "segment 1")
    fine = sampler(resolution=1e4).poses(far, Direction.FORWARD, "segment 1")
    assert spacing(fine).max() <= 1e4


def wall(cost):
    """A free map of 4 m x 2 m with one column of cells of this cost at x = 1.0 .. 1.1 m, y from -1 m."""
    data = np.zeros((20, 40), dtype=np.uint8)
    data[:, 10] = cost
    return Costmap(data, 0.1, (0.0, -1.0))


@pytest.mark.parametrize(("cost", "threshold", "blocked"), [(199, 200, False), (200, 200, True), (1, 1, True)])
def test_cell_at_the_threshold_blocks(cost, threshold, blocked):
    points = np.array([[0.5, 0.0], [1.0, 0.0], [1.5, 0.0]])
    checked = sampler(costmap=wall(cost), threshold=threshold)
    if not blocked:
        assert len(checked.poses(points, Direction.FORWARD, "segment 1")) == 51
        return
    with pytest.raises(
        NoValidPathCouldBeFound, match=f"segment 1 is blocked .* cost {cost} there, must be <"
    ) as caught:
        checked.poses(points, Direction.FORWARD, "segment 1")
    assert caught.value.where["x"] == pytest.approx(1.0)
    assert caught.value.where["cost"] == cost


def test_off_the_map_blocks_like_the_unknown():
    points = np.array([[3.5, 0.0], [4.0, 0.0], [4.5, 0.0]])
    with pytest.raises(NoValidPathCouldBeFound, match="cost 255 there"):
        sampler(costmap=wall(0)).poses(points, Direction.FORWARD, "segment 2")


def test_long_curves_poll_the_cancel_checker():
    calls = []

    def cancel_at_third():
        calls.append(None)
        return len(calls) == 3

    points = np.array([[0.0, 0.0], [500.0, 0.0], [1000.0, 0.0]])
    with pytest.raises(PlannerCancelled, match="while sampling segment 1"):
        sampler(cancel=cancel_at_third).poses(points, Direction.FORWARD, "segment 1")
    assert len(calls) == 3
