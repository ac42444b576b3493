"""Paths: gears, cusps, arc length, sampling, degenerate inputs."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from optdock.errors import InvalidPath
from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.pose import Pose2
from optdock.model.path import ClothoidSegment, Direction, Path, PolylineSegment


def arc_poses(radius=2.0, angle=1.0, n=21):
    t = np.linspace(0.0, angle, n)
    return np.column_stack((radius * np.sin(t), radius * (1.0 - np.cos(t)), t))


def two_gears():
    first = ClothoidSpline(Pose2(0.0, 0.0, 0.0), [0.0, 1.0], [0.5, 1.0])
    second = ClothoidSpline(first.end, [0.0, 0.7], [-1.0, 0.0], -1)
    return Path((ClothoidSegment(first), ClothoidSegment(second)))


def test_a_sampled_arc_has_its_exact_length_and_curvature():
    path = Path.from_poses(arc_poses())
    assert path.length == pytest.approx(2.0, rel=1e-12)
    assert np.allclose(path.curvature_at(np.linspace(0.0, 2.0, 50)), 0.5, rtol=1e-12)
    assert np.allclose(path.curvature_rate_at([0.3, 1.0]), 0.0, atol=1e-9)


def test_reversing_the_gear_keeps_the_sign_of_d_yaw_d_s():
    poses = arc_poses()
    backward = poses + np.array([0.0, 0.0, np.pi])
    assert Path.from_poses(poses).segments[0].direction is Direction.FORWARD
    reverse = Path.from_poses(backward)
    assert reverse.segments[0].direction is Direction.REVERSE
    assert np.allclose(reverse.curvature_at([0.5, 1.0]), 0.5)


def test_a_cusp_is_where_the_gear_changes():
    poses = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [1.5, 0, 0], [1.0, 0, 0]], dtype=float)
    path = Path.from_poses(poses)
    assert path.cusps == (2.0,)
    assert [segment.direction for segment in path.segments] == [1, -1]
    assert path.length == pytest.approx(3.0)
    assert path.direction_at([1.9, 2.0, 2.1]).tolist() == [1, -1, -1]


def test_repeated_poses_and_full_turns_of_yaw_do_not_matter():
    poses = arc_poses()
    repeated = np.repeat(poses, 3, axis=0)
    repeated[::2, 2] += 2.0 * np.pi
    assert Path.from_poses(repeated).length == pytest.approx(2.0)


def test_a_turn_in_place_belongs_to_the_gear_before_it():
    poses = np.array([[0, 0, 0], [1, 0, 0], [1, 0, np.pi], [0.5, 0, np.pi]], dtype=float)
    path = Path.from_poses(poses)
    assert len(path.segments) == 1
    assert path.length == pytest.approx(1.5)
    assert not np.isfinite(path.segments[0].step_curvature[1])


def test_sampling_keeps_every_pose_of_a_turn_in_place():
    poses = np.array([[0, 0, 0], [1, 0, 0], [1, 0, 1.0], [1, 0, 2.0], [1, 1, np.pi / 2]], dtype=float)
    assert len(Path.from_poses(poses).sample(0.1).s) >= 5


@pytest.mark.parametrize(
    "poses",
    [np.zeros((0, 3)), np.zeros((1, 3)), np.zeros((5, 3)), np.array([[0, 0, np.nan], [1, 0, 0]]), np.zeros((4, 2))],
)
def test_invalid_paths_are_rejected(poses):
    with pytest.raises(InvalidPath):
        Path.from_poses(poses)


def test_a_path_needs_a_segment():
    with pytest.raises(InvalidPath, match="no segment"):
        Path(())


def test_poses_may_be_given_as_pose_objects():
    path = Path.from_poses([Pose2(0, 0, 0), Pose2(1, 0, 0), Pose2(2, 0, 0)])
    assert path.end == Pose2(2.0, 0.0, 0.0)


def test_samples_keep_their_spacing_where_the_robot_turns_in_place():
    poses = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (1.0, 0.0, 1.2), (1.0, 0.0, 0.5), (1.4, 0.3, 0.6)]
    samples = Path.from_poses(poses).sample(0.05)
    assert np.max(np.diff(samples.s)) <= 0.05 + 1e-12
    assert np.max(np.hypot(np.diff(samples.x), np.diff(samples.y))) <= 0.05 + 1e-12
    rows = samples.poses.tolist()
    places = [rows.index(list(pose)) for pose in poses]
    assert places == [0, 20, 21, 22, len(rows) - 1]


def test_samples_hold_ends_and_both_gears_at_a_cusp():
    path = two_gears()
    samples = path.sample(0.1)
    at_cusp = np.flatnonzero(samples.s == 1.0)
    assert samples.direction[at_cusp].tolist() == [1, -1]
    assert np.allclose(samples.poses[at_cusp[0]], samples.poses[at_cusp[1]])
    assert samples.curvature[at_cusp].tolist() == [1.0, -1.0]
    assert samples.s[0] == 0.0
    assert samples.s[-1] == pytest.approx(1.7)
    assert np.max(np.diff(samples.s)) <= 0.1 + 1e-12


@settings(max_examples=20)
@given(st.floats(0.001, 3.0))
def test_sample_spacing_is_never_exceeded(spacing):
    samples = two_gears().sample(spacing)
    assert np.max(np.diff(samples.s)) <= spacing * (1.0 + 1e-9)


@settings(max_examples=20)
@given(st.floats(-1.0, 3.0))
def test_poses_are_clipped_to_the_path(s):
    path = two_gears()
    inside = path.poses_at(np.clip(s, 0.0, path.length))
    assert np.allclose(path.poses_at(s), inside)


@settings(max_examples=20)
@given(st.integers(0, 500))
def test_a_fine_polyline_converges_to_its_clothoid(seed):
    rng = np.random.default_rng(seed)
    spline = ClothoidSpline(Pose2(0, 0, 0), [0.0, 1.0, 2.0], rng.uniform(-1.5, 1.5, 3), int(rng.choice([1, -1])))
    exact = Path((ClothoidSegment(spline),))
    path = Path.from_poses(exact.sample(0.005).poses)
    assert len(path.segments) == 1
    assert path.length == pytest.approx(exact.length, abs=1e-5)
    s = np.linspace(0.05, 1.95, 30)
    assert np.allclose(path.poses_at(s), exact.poses_at(s), atol=1e-4)
    assert np.allclose(path.curvature_at(s), exact.curvature_at(s), atol=0.02)


def test_a_polyline_segment_of_one_pose_is_refused():
    with pytest.raises(InvalidPath, match="at least 2 poses"):
        PolylineSegment(np.zeros((1, 3)))
