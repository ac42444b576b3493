"""Time laws and trajectories against their definitions."""

import math
import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from optdock.errors import InvalidValue
from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.pose import Pose2
from optdock.model.constant_jerk import TimeLaw, border_states, constant_jerk
from optdock.model.path import ClothoidSegment, Path
from optdock.model.trajectory import Trajectory

phases = st.lists(st.tuples(st.floats(0.01, 2.0), st.floats(-2.0, 2.0)), min_size=1, max_size=8)


@settings(max_examples=20)
@given(phases, st.floats(0.0, 1.0), st.floats(-1.0, 1.0))
def test_speed_and_acceleration_are_the_derivatives_of_distance(pieces, speed, acceleration):
    durations, jerks = map(list, zip(*pieces, strict=True))
    law = TimeLaw(durations, jerks, 0.5, speed, acceleration)
    t, eps = np.linspace(0.0, law.duration, 41)[1:-1], 1e-5
    t = t[np.min(np.abs(t[:, None] - law.times), axis=1) > 2 * eps]
    if t.size == 0:
        return
    before, after = law.at(t - eps), law.at(t + eps)
    slope = (after - before) / (2.0 * eps)
    middle = law.at(t)
    scale = 1.0 + np.abs(middle).max()
    assert np.allclose(slope[:, 0], middle[:, 1], atol=1e-6 * scale)
    assert np.allclose(slope[:, 1], middle[:, 2], atol=1e-6 * scale)
    assert np.allclose(slope[:, 2], middle[:, 3], atol=1e-5 * scale)


@settings(max_examples=20)
@given(phases, st.tuples(*(st.floats(-1.0, 1.0) for _ in range(3))))
def test_border_states_are_the_motion_under_constant_jerk_phase_by_phase(pieces, start):
    durations, jerks = np.array(pieces).T
    states = border_states(durations, jerks, start)
    state = start
    for k, (duration, jerk) in enumerate(pieces):
        state = constant_jerk(duration, *state, jerk)
        np.testing.assert_allclose(states[:, k + 1], state, rtol=0.0, atol=1e-12)
    together = constant_jerk(durations, *states[:, :-1], jerks)
    np.testing.assert_allclose(together, states[:, 1:], rtol=0.0, atol=1e-12)


def test_a_known_move():
    law = TimeLaw([1.0, 2.0, 1.0], [1.0, 0.0, -1.0])
    assert law.duration == 4.0
    assert law.states[-1].tolist() == pytest.approx([1 / 6 + (0.5 * 2 + 0.5 * 4) + (2.5 + 0.5 - 1 / 6), 3.0, 0.0])


def test_times_are_clipped():
    law = TimeLaw([1.0], [0.0], 0.0, 1.0)
    assert law.at([-1.0, 2.0])[:, 0].tolist() == [0.0, 1.0]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([], []), ">= 1 phase"),
        (([1.0], [1.0, 2.0]), "a jerk each"),
        (([0.0], [1.0]), "must be > 0 s"),
        (([np.nan], [1.0]), "must be finite"),
        (([1.0], [1.0], np.inf), "time law.start_s: must be finite"),
        (([1e200], [1e200]), "overflows"),
        (([1e150, 1.0], [1e10, -1.0]), "overflows"),
    ],
)
def test_invalid_time_laws_are_rejected(arguments, message):
    with pytest.raises(InvalidValue, match=message):
        TimeLaw(*arguments)


def motion():
    first = ClothoidSpline(Pose2(0.0, 0.0, 0.0), [0.0, 1.0], [0.5, 1.0])
    second = ClothoidSpline(first.end, [0.0, 0.5], [-1.0, 0.0], -1)
    # Two rest-to-rest moves of constant jerk: distance j T^3 / 32 for four phases of T / 4.
    t1, t2 = 2.0, 2.0
    j1, j2 = 32.0 * 1.0 / t1**3, 32.0 * 0.5 / t2**3
    law = TimeLaw([0.5] * 8, [j1, -j1, -j1, j1, j2, -j2, -j2, j2])
    return Trajectory(Path((ClothoidSegment(first), ClothoidSegment(second))), law)


def test_reverse_is_negative_speed_and_the_cusp_is_sampled():
    trajectory = motion()
    samples = trajectory.sample(0.3)
    assert trajectory.cusp_times.tolist() == [2.0]
    assert 2.0 in samples.t
    assert samples.t[[0, -1]].tolist() == [0.0, 4.0]
    assert np.all(samples.speed[samples.t < 2.0] >= 0.0)
    assert np.all(samples.speed[samples.t > 2.0] <= 1e-12)


def test_yaw_rate_and_yaw_acceleration_are_the_derivatives_of_yaw():
    trajectory, eps = motion(), 1e-4
    t = np.array([0.3, 0.8, 1.3, 2.3, 2.9, 3.6])
    yaw = np.array([trajectory.sample_at(t + k * eps).yaw for k in (-1, 0, 1)])
    middle = trajectory.sample_at(t)
    assert np.allclose((yaw[2] - yaw[0]) / (2 * eps), middle.yaw_rate, atol=1e-6)
    assert np.allclose((yaw[2] - 2 * yaw[1] + yaw[0]) / eps**2, middle.yaw_acceleration, atol=1e-5)


def test_the_twist_moves_the_pose():
    trajectory, eps = motion(), 1e-5
    for t in (0.7, 2.8):
        state, later = trajectory.at(t), trajectory.at(t + eps)
        velocity = np.array([later.pose.x - state.pose.x, later.pose.y - state.pose.y]) / eps
        heading = np.array([np.cos(state.pose.yaw), np.sin(state.pose.yaw)])
        assert np.allclose(velocity, state.twist.linear * heading, atol=1e-4)


def test_trajectories_survive_pickling():
    trajectory = motion()
    copy = pickle.loads(pickle.dumps(trajectory))
    assert copy.at(1.2) == trajectory.at(1.2)


@pytest.mark.parametrize("period", [0.02, 0.1, 0.3, 1.0, 7.0])
def test_samples_come_every_period_and_end_at_the_end(period):
    path = Path((ClothoidSegment(ClothoidSpline(Pose2(1.0, 2.0, 0.3), [0.0, 1.0], [0.0, 0.5])),))
    trajectory = Trajectory(path, TimeLaw([1.0, 1.0, 1.0, 1.0], [0.5, -0.5, -0.5, 0.5], 0.0))
    t, poses, twists = trajectory.sampled(period)
    assert (poses.shape, twists.shape) == ((t.size, 3), (t.size, 2))
    assert t[0] == 0.0
    assert t[-1] == trajectory.duration
    assert np.allclose(np.diff(t)[:-1], period, atol=1e-12)
    assert 0.0 < t[-1] - t[-2] <= period * (1.0 + 1e-9)
    for row, when in enumerate(t):
        state = trajectory.at(when)
        np.testing.assert_allclose(poses[row], state.pose.as_array(), atol=1e-12)
        np.testing.assert_allclose(twists[row], [state.twist.linear, state.twist.angular], atol=1e-12)


@pytest.mark.parametrize("period", [0.0, -0.1, np.nan, np.inf, "0.02", True])
def test_a_sampling_period_is_a_positive_number(period):
    trajectory = Trajectory(Path.from_poses([[0, 0, 0], [1, 0, 0]]), TimeLaw([1.0, 1.0], [1.0, -1.0]))
    with pytest.raises(InvalidValue, match="period"):
        trajectory.sampled(period)


@pytest.mark.parametrize("bad", [0.0, -1.0, math.nan, math.inf, "1", None, True, 1e-12])
def test_invalid_sampling_steps_are_rejected(bad):
    path = Path.from_poses([Pose2(0.0, 0.0, 0.0), Pose2(1.0, 0.0, 0.0)])
    trajectory = Trajectory(path, TimeLaw([2.0, 2.0], [0.0, 0.0], start_speed=0.25))
    for sample, name in ((path.sample, "spacing"), (trajectory.sample, "period"), (trajectory.sampled, "period")):
        with pytest.raises(InvalidValue, match=f"^{name}: "):
            sample(bad)
