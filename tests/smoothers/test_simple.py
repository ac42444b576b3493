import itertools
import logging
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from optdock.errors import InvalidValue, SmootherTimedOut
from optdock.geometry.pose import Pose2
from optdock.model.costmap import FREE_SPACE, INSCRIBED, LETHAL, NO_INFORMATION, Costmap
from optdock.model.path import Direction, Path, PolylineSegment
from optdock.plugins.interfaces import PluginContext
from smoothers.nav2.pieces import poses_of
from smoothers.nav2.simple import SimpleSmoother, _Sweep

IRREGULAR = np.array([0.0, 0.1, 0.2, 0.35, 0.4, 0.56, 0.9, 0.95, 1.3, 2.0, 2.5])


def line(y, x=0.5):
    return np.column_stack((np.full(len(y), x), y, np.full(len(y), math.pi / 2.0)))


def corner():
    """A right angle; turned, rounding could make a cusp of it, because its dot product is 0."""
    up = [(0.5, 0.1 * i, math.pi / 2.0) for i in range(5)]
    right = [(0.5 + 0.1 * i, 0.5, 0.0) for i in range(6)]
    return np.array(up + right)


def bow():
    s = np.linspace(0.0, 1.0, 15)
    return np.column_stack((s, 0.3 * np.abs(s - 0.4), np.where(s < 0.4, -0.29, 0.29)))


def there_and_back():
    """Forward along x, then in reverse to the left: a cusp at index 12."""
    s = 0.1 * np.arange(13)
    out = np.column_stack((s, 0.02 * np.sin(9.0 * s), np.zeros(13)))
    back = np.column_stack((1.2 - s[1:], out[-1, 1] + 0.2 * s[1:] ** 2, -0.2 * s[1:]))
    return np.vstack((out, back))


def smoothed(poses, **parameters):
    return poses_of(SimpleSmoother(**parameters).smooth(Path.from_poses(poses), 10.0).path)


def test_nav2_irregular_line_becomes_even():
    # Nav2's own test: the largest gap of 0.70 m must fall below 0.50 m.
    assert np.diff(IRREGULAR).max() == pytest.approx(0.70)
    gaps = np.diff(smoothed(line(IRREGULAR))[:, 1])
    assert gaps.max() < 0.50
    assert gaps.min() > 0.0


def test_nav2_regular_line_stays():
    before = line(0.1 * np.arange(11))
    assert np.abs(smoothed(before) - before).max() < 1e-3


def test_nav2_corner_moves_inwards():
    # Nav2's own test: pose 5 goes to (0.607, 0.387) within 0.01.
    assert smoothed(corner())[5, :2] == pytest.approx((0.607, 0.387), abs=0.01)


def test_nav2_no_time_throws():
    with pytest.raises(SmootherTimedOut, match="allowed 0"):
        SimpleSmoother().smooth(Path.from_poses(corner()), 0.0)


def looped_sweep(original, points, w_data, w_smooth):
    """The sweep point by point, as Nav2 documents it."""
    moved = points.copy()
    for i in range(1, len(points) - 1):
        pull = w_data * (original[i] - moved[i])
        moved[i] = moved[i] + pull + w_smooth * (moved[i + 1] + moved[i - 1] - 2.0 * moved[i])
    return moved


@settings(max_examples=25)
@given(
    st.lists(st.tuples(st.floats(-9.0, 9.0), st.floats(-9.0, 9.0)), min_size=3, max_size=30),
    st.floats(0.0, 1.0),
    st.floats(0.0, 0.6),
    st.integers(0, 2**31),
)
def test_a_sweep_at_once_is_the_sweep_point_by_point(points, w_data, w_smooth, seed):
    original = np.array(points)
    current = original + np.random.default_rng(seed).normal(size=original.shape)
    at_once = _Sweep(original, w_data, w_smooth)(current)
    assert at_once == pytest.approx(looped_sweep(original, current, w_data, w_smooth), abs=1e-12)


def test_the_end_of_all_sweeps_balances_both_pulls():
    before = corner()
    after = smoothed(before, do_refinement=False, w_data=0.25, w_smooth=0.2)[:, :2]
    bend = after[2:] + after[:-2] - 2.0 * after[1:-1]
    balance = 0.25 * (before[1:-1, :2] - after[1:-1]) + 0.2 * bend
    assert np.abs(balance).max() < 1e-9


def test_ends_and_cusp_stay_bit_for_bit():
    before = there_and_back()
    after = smoothed(before)
    assert (after[[0, 12, -1], :2] == before[[0, 12, -1], :2]).all()
    assert after[-1, 2] == pytest.approx(before[-1, 2])
    assert np.abs(after[1:12, :2] - before[1:12, :2]).max() > 1e-4


def test_gears_survive_and_yaws_follow_the_travel():
    path = SimpleSmoother().smooth(Path.from_poses(there_and_back()), 10.0).path
    assert [segment.direction for segment in path.segments] == [Direction.FORWARD, Direction.REVERSE]
    poses = path.segments[1].poses
    travel = np.arctan2(np.diff(poses[:, 1]), np.diff(poses[:, 0]))
    assert np.cos(poses[:-1, 2] - travel)[1:] == pytest.approx(-1.0, abs=1e-12)


def test_without_inversions_the_cusp_is_rounded_off():
    before = there_and_back()
    after = smoothed(before, enforce_path_inversion=False)
    assert after[:, 0].max() < before[12, 0] - 0.05


def test_a_turn_in_place_stays_where_it_is():
    first = np.column_stack((0.1 * np.arange(8), np.zeros(8), np.zeros(8)))
    second = np.column_stack((np.full(8, 0.7), 0.1 * np.arange(8), np.full(8, math.pi / 2.0)))
    after = smoothed(np.vstack((first, second)))
    assert after[7, :2] == pytest.approx((0.7, 0.0), abs=1e-15)
    assert after[:8, 1] == pytest.approx(np.zeros(8), abs=1e-12)
    assert after[7:, 0] == pytest.approx(np.full(9, 0.7), abs=1e-12)
    one_piece = smoothed(np.vstack((first, second)), enforce_path_inversion=False)
    assert one_piece[7, 1] > 0.01


def test_four_poses_are_left_alone_and_five_are_not():
    bent = np.column_stack((0.1 * np.arange(5), [0.0, 0.05, 0.0, 0.05, 0.0], [0.4, 0.4, -0.4, 0.4, -0.4]))
    assert (smoothed(bent[:4]) == bent[:4]).all()
    assert np.abs(smoothed(bent)[1:-1, :2] - bent[1:-1, :2]).max() > 0.01


def test_refinement_goes_on_where_the_first_pass_stopped():
    turns = [np.abs(np.diff(np.unwrap(smoothed(corner(), refinement_num=n)[1:-1, 2]))).max() for n in (0, 2, 5)]
    assert turns[0] > turns[1] > turns[2]
    plain = smoothed(corner(), do_refinement=False)
    assert (plain == smoothed(corner(), refinement_num=0)).all()
    again = smoothed(plain, do_refinement=False)[:, :2]
    assert again == pytest.approx(smoothed(corner(), refinement_num=1)[:, :2], abs=1e-9)


@settings(max_examples=20)
@given(st.floats(-5.0, 5.0), st.floats(-5.0, 5.0), st.floats(-3.0, 3.0), st.sampled_from([bow, there_and_back]))
def test_a_moved_path_is_smoothed_to_the_moved_result(x, y, yaw, shape):
    frame = Pose2(x, y, yaw)
    moved = np.array([(frame @ Pose2(*pose)).as_array() for pose in shape()])
    expected = np.array([(frame @ Pose2(*pose)).as_array() for pose in smoothed(shape())])
    after = smoothed(moved)
    assert after[:, :2] == pytest.approx(expected[:, :2], abs=1e-8)
    assert np.cos(after[:, 2] - expected[:, 2]) == pytest.approx(1.0, abs=1e-8)


def grid(cost, centre):
    data = np.full((60, 60), FREE_SPACE, dtype=np.uint8)
    empty = Costmap(data, 0.05, (-1.0, -1.0))
    i, j = empty.cell_of([centre])[0]
    data[j, i] = cost
    return empty.with_data(data)


def stopped_by(costmap, **parameters):
    smoother = SimpleSmoother(**parameters)
    smoother.configure(PluginContext(name="simple", costmap=costmap))
    return smoother.smooth(Path.from_poses(corner()), 10.0)


@pytest.mark.parametrize("cost", [INSCRIBED, LETHAL])
def test_a_sweep_into_an_obstacle_is_undone_and_ends_the_work(cost):
    after_eight = SimpleSmoother(max_its=9, do_refinement=False).smooth(Path.from_poses(corner()), 10.0)
    after_nine = poses_of(SimpleSmoother(max_its=10, do_refinement=False).smooth(Path.from_poses(corner()), 10.0).path)
    in_the_way = Costmap(np.full((1, 1), cost, dtype=np.uint8), 1e-9, tuple(after_nine[5, :2] - 5e-10))
    result = stopped_by(in_the_way)
    assert result.completed  # False would mean the time limit
    assert result.report.extra["ended_by"] == ("obstacle",)
    assert poses_of(result.path) == pytest.approx(poses_of(after_eight.path), abs=1e-15)


@pytest.mark.parametrize("cost", [FREE_SPACE, 252, NO_INFORMATION])
def test_inflated_and_unknown_cells_do_not_stop_it(cost):
    result = stopped_by(grid(cost, (0.58, 0.42)))
    assert result.completed
    assert poses_of(result.path) == pytest.approx(smoothed(corner()), abs=1e-12)


def test_off_the_map_nothing_stops_it():
    far = Costmap(np.full((3, 3), LETHAL, dtype=np.uint8), 0.05, (50.0, 50.0))
    assert stopped_by(far).completed


def test_too_few_sweeps_are_reported_and_warned_about(caplog):
    with caplog.at_level(logging.WARNING):
        result = SimpleSmoother(max_its=5).smooth(Path.from_poses(corner()), 10.0)
    assert result.completed
    assert (result.report.iterations, result.report.extra["ended_by"]) == (4, ("max_its",))
    assert "still moving after 5 sweeps" in caplog.text


def limited_to(sweeps, poses, costmap=None):
    """A result whose time is over after so many sweeps, on a clock that counts how often it is asked."""
    ticks = itertools.count()
    smoother = SimpleSmoother()
    smoother.configure(PluginContext(costmap=costmap, clock=lambda: float(next(ticks))))
    return smoother.smooth(Path.from_poses(poses), sweeps + 0.5)


@pytest.mark.parametrize("sweeps", [1, 4, 8])
def test_a_time_limit_returns_the_last_whole_sweep_as_incomplete(sweeps):
    result = limited_to(sweeps, corner())
    whole = SimpleSmoother(max_its=sweeps + 1, do_refinement=False).smooth(Path.from_poses(corner()), 10.0)
    assert not result.completed
    assert result.report.extra["ended_by"] == ("time",)
    assert poses_of(result.path) == pytest.approx(poses_of(whole.path), abs=1e-15)


def test_a_time_limit_leaves_later_pieces_as_they_were():
    result, before = limited_to(1, there_and_back()), there_and_back()
    after = poses_of(result.path)
    assert not result.completed
    assert np.abs(after[1:12, :2] - before[1:12, :2]).max() > 1e-4
    assert (after[12:, :2] == before[12:, :2]).all()
    assert [segment.direction for segment in result.path.segments] == [Direction.FORWARD, Direction.REVERSE]


def test_a_result_at_the_time_limit_is_free_of_collisions():
    blocked = grid(LETHAL, (0.58, 0.42))
    for sweeps in (1, 2, 3):
        points = poses_of(limited_to(sweeps, corner(), blocked).path)[:, :2]
        assert (blocked.cost_at(points) == FREE_SPACE).all()


@pytest.mark.parametrize("yaw", [-3.0, 0.4, math.pi, 9.0])
@pytest.mark.parametrize("shape", [bow, there_and_back])
def test_start_and_goal_keep_their_headings(yaw, shape):
    """The seed: preserve start and end poses; Nav2's smoother turns the start along the first step."""
    poses = shape()
    raw = Path.from_poses(poses)
    gears = [segment.direction for segment in raw.segments]
    turned = np.array(raw.segments[0].poses)
    turned[0, 2] = yaw
    path = Path((PolylineSegment(turned, gears[0]), *raw.segments[1:]))
    result = SimpleSmoother().smooth(path, 10.0).path
    assert result.start.distance_to(path.start) == 0.0
    assert math.cos(result.start.yaw - yaw) == pytest.approx(1.0, abs=1e-15)
    assert math.cos(result.end.yaw - poses[-1, 2]) == pytest.approx(1.0, abs=1e-15)
    assert [segment.direction for segment in result.segments] == gears


@pytest.mark.parametrize("wrong", [{"tolerance": 0.0}, {"max_its": 0}, {"w_data": -0.1}, {"w_smoth": 0.3}])
def test_wrong_parameters_are_named(wrong):
    with pytest.raises(InvalidValue, match=next(iter(wrong))):
        SimpleSmoother(**wrong)


@pytest.mark.parametrize("weights", [{"w_data": 0.0, "w_smooth": 0.995}, {"w_data": 1.9, "w_smooth": 0.045}])
def test_weights_that_converge_slowly_are_accepted_and_weights_that_never_do_are_refused(weights):
    smoother = SimpleSmoother(max_its=100_000, tolerance=1e-6, **weights)
    assert smoother.smooth(Path.from_poses(corner()), 30.0).completed
    too_much = {name: value * 2.001 / 1.99 for name, value in weights.items()}
    with pytest.raises(InvalidValue, match=r"w_data \+ 2 w_smooth: must be < 2"):
        SimpleSmoother(**too_much)


def test_a_curve_is_taken_as_samples():
    from experiments.families import instance

    witness = instance("reverse_cusp", 0).witness
    result = SimpleSmoother().smooth(witness, 10.0)
    assert [s.direction for s in result.path.segments] == [s.direction for s in witness.segments]
    assert result.path.length == pytest.approx(witness.length, rel=0.02)
