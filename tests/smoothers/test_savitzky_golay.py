import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from optdock.errors import InvalidValue, SmootherTimedOut
from optdock.model.path import Direction, Path, PolylineSegment
from optdock.plugins.interfaces import PluginContext, Smoother
from optdock.plugins.registry import create_plugin
from smoothers.nav2.pieces import poses_of
from smoothers.nav2.savitzky_golay import SavitzkyGolaySmoother, savitzky_golay_weights

COUNT = 25


def noisy(seed=0):
    rng = np.random.default_rng(seed)
    x = 0.1 * np.arange(COUNT)
    y = 0.1 * x**2 + rng.normal(scale=0.01, size=COUNT)
    return np.column_stack((x, y, np.arctan(0.2 * x)))


def there_and_back():
    out = noisy(1)
    back = noisy(2)[::-1].copy()
    back[:, 1] += out[-1, 1] - back[0, 1]
    return np.vstack((out, back[1:]))


def smoothed(poses, **parameters):
    return poses_of(SavitzkyGolaySmoother(**parameters).smooth(Path.from_poses(poses), 10.0).path)


def test_the_default_weights_are_nav2s():
    assert 21.0 * savitzky_golay_weights(7, 3) == pytest.approx([-2, 3, 6, 7, 6, 3, -2], abs=1e-12)


@settings(max_examples=25)
@given(st.integers(1, 10), st.integers(0, 5))
def test_weights_are_those_of_numpys_fit(half, degree):
    """The value in the middle of the polynomials that are fitted to a one at each place."""
    window = 2 * half + 1
    if degree < window:
        fitted = np.polynomial.Polynomial.fit
        columns = [fitted(np.arange(-half, half + 1), one, degree) for one in np.eye(window)]
        assert savitzky_golay_weights(window, degree) == pytest.approx([one(0.0) for one in columns], abs=1e-8)


def test_cubics_pass_unchanged_away_from_the_ends():
    x = 0.1 * np.arange(COUNT)
    y = 0.3 * x**3 - 0.4 * x**2 + 0.2 * x
    poses = np.column_stack((x, y, np.arctan(np.gradient(y, x))))
    after = smoothed(poses, do_refinement=False)
    assert after[3:-3, :2] == pytest.approx(poses[3:-3, :2], abs=1e-12)
    quartic = poses + np.column_stack((np.zeros(COUNT), x**4, np.zeros(COUNT)))
    assert np.abs(smoothed(quartic, do_refinement=False)[3:-3, 1] - quartic[3:-3, 1]).max() > 1e-4


def test_one_pass_is_the_weighted_sum():
    before = noisy()
    after = smoothed(before, do_refinement=False)
    window = before[5:12, 1]
    assert after[8, 1] == pytest.approx(float(np.dot([-2, 3, 6, 7, 6, 3, -2], window)) / 21.0, abs=1e-15)
    padded = np.concatenate(([before[0, 1]] * 2, before[:5, 1]))
    assert after[1, 1] == pytest.approx(float(np.dot([-2, 3, 6, 7, 6, 3, -2], padded)) / 21.0, abs=1e-15)


def test_refinement_is_the_same_pass_again():
    once = smoothed(noisy(), do_refinement=False)
    twice = smoothed(once, do_refinement=False)
    assert smoothed(noisy(), refinement_num=1)[:, :2] == pytest.approx(twice[:, :2], abs=1e-12)
    assert (smoothed(noisy()) == smoothed(noisy(), refinement_num=2)).all()


def test_noise_is_reduced():
    exact = 0.1 * (0.1 * np.arange(COUNT)) ** 2
    before, after = noisy()[:, 1] - exact, smoothed(noisy())[:, 1] - exact
    assert np.std(after[3:-3]) < 0.75 * np.std(before[3:-3])


def test_ends_and_cusp_stay_bit_for_bit():
    before = there_and_back()
    after = smoothed(before)
    kept = [0, COUNT - 1, -1]
    assert (after[kept, :2] == before[kept, :2]).all()
    assert np.abs(after[1 : COUNT - 1, :2] - before[1 : COUNT - 1, :2]).max() > 1e-3


def test_gears_survive():
    path = SavitzkyGolaySmoother().smooth(Path.from_poses(there_and_back()), 10.0).path
    assert [segment.direction for segment in path.segments] == [Direction.FORWARD, Direction.REVERSE]


def test_ten_poses_are_left_alone_and_eleven_are_not():
    assert (smoothed(noisy()[:10]) == Path.from_poses(noisy()[:10]).segments[0].poses).all()
    assert np.abs(smoothed(noisy()[:11])[1:-1, 1] - noisy()[1:10, 1]).max() > 1e-3


def test_a_path_driven_the_other_way_has_the_same_points():
    other_way = noisy()[::-1] + np.array([0.0, 0.0, math.pi])
    assert smoothed(other_way)[::-1, :2] == pytest.approx(smoothed(noisy())[:, :2], abs=1e-12)


def test_no_time_throws_only_where_there_is_work():
    with pytest.raises(SmootherTimedOut, match="allowed 0"):
        SavitzkyGolaySmoother().smooth(Path.from_poses(noisy()), 0.0)
    assert SavitzkyGolaySmoother().smooth(Path.from_poses(noisy()[:10]), 0.0).completed


def test_a_time_limit_leaves_later_pieces_unchanged_and_incomplete():
    ticks = itertools.count()
    smoother = SavitzkyGolaySmoother()
    smoother.configure(PluginContext(clock=lambda: float(next(ticks))))
    before = there_and_back()
    result = smoother.smooth(Path.from_poses(before), 1.5)  # made, asked before the first piece: 1; the second: 2
    after, whole = poses_of(result.path), smoothed(before)
    assert not result.completed
    assert result.report.extra["pieces"] == 1
    assert after[: COUNT - 1] == pytest.approx(whole[: COUNT - 1], abs=1e-15)
    assert (after[COUNT:] == poses_of(Path.from_poses(before))[COUNT:]).all()
    assert smoother.smooth(Path.from_poses(before), 2.5).completed


@pytest.mark.parametrize("yaw", [-3.0, 0.4, math.pi, 9.0])
def test_start_and_goal_keep_their_headings(yaw):
    raw = Path.from_poses(there_and_back())
    turned = np.array(raw.segments[0].poses)
    turned[0, 2] = yaw
    path = Path((PolylineSegment(turned, Direction.FORWARD), *raw.segments[1:]))
    result = SavitzkyGolaySmoother().smooth(path, 10.0).path
    assert math.cos(result.start.yaw - yaw) == pytest.approx(1.0, abs=1e-15)
    assert math.cos(result.end.yaw - path.end.yaw) == pytest.approx(1.0, abs=1e-15)
    assert [segment.direction for segment in result.segments] == [Direction.FORWARD, Direction.REVERSE]


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"window_size": 6}, "odd"),
        ({"window_size": 1}, "window_size"),
        ({"window_size": 5, "poly_order": 5}, "poly_order must be less"),
        ({"window": 7}, "did you mean window_size"),
    ],
)
def test_wrong_parameters_are_named(wrong, message):
    with pytest.raises(InvalidValue, match=message):
        SavitzkyGolaySmoother(**wrong)


@pytest.mark.parametrize("name", ["SimpleSmoother", "SavitzkyGolaySmoother"])
@pytest.mark.parametrize("bad", ["1", None, math.nan, math.inf, -1.0])
def test_a_time_limit_is_a_number_of_seconds(name, bad):
    with pytest.raises(InvalidValue, match="max_time: must be finite and >= 0 s, got"):
        create_plugin(Smoother, name).smooth(Path.from_poses(noisy()), bad)
