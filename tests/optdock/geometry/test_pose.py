"""SE(2) laws."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from optdock.errors import InvalidValue
from optdock.geometry.pose import Pose2, Twist2, normalize_angle, transform_points

coordinate = st.floats(-1e3, 1e3)
poses = st.builds(Pose2, coordinate, coordinate, st.floats(-10.0, 10.0))


def close(a, b):
    return np.allclose([a.x, a.y], [b.x, b.y], atol=1e-9) and abs(normalize_angle(a.yaw - b.yaw)) < 1e-9


@settings(max_examples=25)
@given(poses, poses, poses)
def test_composition_is_associative(a, b, c):
    assert close((a @ b) @ c, a @ (b @ c))


@settings(max_examples=25)
@given(poses)
def test_the_inverse_undoes_from_both_sides(a):
    identity = Pose2(0.0, 0.0, 0.0)
    assert close(a @ a.inverse(), identity)
    assert close(a.inverse() @ a, identity)


@settings(max_examples=25)
@given(poses, poses)
def test_in_frame_of_undoes_composition(a, b):
    assert close((a @ b).in_frame_of(a), Pose2(b.x, b.y, normalize_angle(b.yaw)))


@settings(max_examples=25)
@given(st.floats(-1e4, 1e4))
def test_a_normalized_angle_is_the_same_direction_in_the_half_open_interval(angle):
    wrapped = normalize_angle(angle)
    assert -math.pi < wrapped <= math.pi
    assert math.cos(wrapped - angle) == pytest.approx(1.0)


@settings(max_examples=25)
@given(poses, coordinate, coordinate)
def test_transforming_a_point_agrees_with_composition(a, x, y):
    moved = transform_points(a.as_array()[None], np.array([[x, y]]))[0, 0]
    composed = a @ Pose2(x, y, 0.0)
    assert np.allclose(moved, [composed.x, composed.y], atol=1e-9)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_nonfinite_values_are_rejected_by_name(bad):
    with pytest.raises(InvalidValue, match="pose.yaw: must be finite"):
        Pose2(0.0, 0.0, bad)
    with pytest.raises(InvalidValue, match="twist.angular: must be finite"):
        Twist2(0.0, bad)


@pytest.mark.parametrize("values", [[1.0, 2.0], [1.0, 2.0, 3.0, 4.0], []])
def test_a_pose_is_made_of_three_numbers(values):
    with pytest.raises(InvalidValue, match=r"must be \[x, y, yaw\]"):
        Pose2.from_sequence(values)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ((1e9, 0.0, 0.0), "pose.x: must be within"),
        ((0.0, -1.1e8, 0.0), "pose.y: must be within"),
        ((0.0, 0.0, 1e14), "pose.yaw: must be within"),
        ((0.0, 0.0, "1"), "pose.yaw: must be a number"),
        ((True, 0.0, 0.0), "pose.x: must be a number"),
        ((0.0, np.nan, 0.0), "pose.y: must be finite"),
        ((10**400, 0.0, 0.0), "pose.x: must be finite"),
    ],
)
def test_poses_out_of_range_are_rejected(values, message):
    with pytest.raises(InvalidValue, match=message):
        Pose2(*values)


def test_any_number_makes_a_pose():
    assert Pose2(np.float32(0.5), np.int64(2), np.array(3)) == Pose2(0.5, 2.0, 3.0)
