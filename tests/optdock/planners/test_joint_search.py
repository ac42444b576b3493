import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from optdock.planners.two_segment import JointKind, find_joint, interior_angles

# C at the origin, F at 6 m, a sample every 5 cm; the dock lies toward negative x.
LINE = np.column_stack((np.linspace(0.0, 6.0, 121), np.zeros(121)))
SPACING = 0.05
THRESHOLD = 2.0 * math.pi / 3.0


def joint_from(x, y, threshold=THRESHOLD, line=LINE):
    return find_joint(np.array([x, y]), line, threshold)


def test_room_for_the_run_in_turns_toward_the_dock():
    joint = joint_from(4.0, 1.0)
    assert joint.dir is JointKind.TOWARD
    # The first sample from the foot that sees A and C at 120 degrees: tan(30 deg) = 0.577 m before the foot.
    assert joint.middle == 68
    np.testing.assert_allclose(joint.control_points[1], [3.4, 0.0])
    leg = math.hypot(0.6, 1.0)
    before, after = (np.hypot(*np.diff(joint.control_points, axis=0).T)).tolist()
    assert before == pytest.approx(leg)
    assert leg <= after < leg + SPACING


def test_no_room_before_c_turns_away_and_ends_at_f():
    joint = joint_from(0.5, 1.0)
    assert joint.dir is JointKind.AWAY
    # With the source's 0.05 rad of slack: tan(30 deg - 0.05) = 0.512 m beyond the foot, the next sample.
    np.testing.assert_allclose(joint.control_points, [[0.5, 1.0], [1.05, 0.0], [6.0, 0.0]])


def test_no_room_on_either_side_drives_straight_to_the_axis():
    joint = joint_from(3.01, 5.0)
    assert joint.dir is JointKind.CORNER
    assert joint.middle == -1
    np.testing.assert_allclose(joint.control_points, [[3.01, 5.0], [3.005, 2.5], [3.0, 0.0]])


@pytest.mark.parametrize(("y", "kind"), [(1.7, JointKind.TOWARD), (1.8, JointKind.AWAY), (2.0, JointKind.CORNER)])
def test_run_in_rule_decides_at_an_angle_above_sixty_degrees(y, kind):
    # Toward needs sqrt(3) d before the foot at 3 m; away needs 1.635 d beyond it.
    line = LINE[:121] if kind is not JointKind.CORNER else LINE[:120]
    assert joint_from(3.0, y, line=line).dir is kind


@pytest.mark.parametrize("x", [0.001, 0.024, 0.026, 0.05, 0.07, 0.1, 1.0, 4.987])
def test_start_on_the_axis_runs_straight_toward_c(x):
    joint = joint_from(x, 0.0, threshold=0.5 * math.pi)
    assert joint.dir is JointKind.TOWARD
    along = joint.control_points[:, 0]
    assert np.all(np.diff(along) < 0.0)
    assert along[-1] >= 0.0


@settings(max_examples=25)
@given(st.floats(0.0, 5.0), st.floats(1e-3, 5.0), st.floats(math.pi / 2, 2.2))
def test_joints_satisfy_the_rules_of_their_kind(x, y, threshold):
    joint = joint_from(x, y, threshold)
    start, middle, end = joint.control_points
    legs = np.hypot(*np.diff(joint.control_points, axis=0).T)
    if joint.dir is JointKind.CORNER:
        assert abs(end[0] - x) <= 0.5 * SPACING + 1e-9
        return
    slack = 0.0 if joint.dir is JointKind.TOWARD else 0.05
    assert interior_angles(middle[None], start, end)[0] >= threshold - slack - 1e-6
    assert legs[1] >= legs[0] - 1e-9
    if joint.dir is JointKind.TOWARD:
        assert end[0] < middle[0] <= x + SPACING
        assert legs[1] < legs[0] + SPACING + 1e-9
    else:
        assert end[0] == 6.0
        assert middle[0] >= x - SPACING


@settings(max_examples=25)
@given(st.floats(0.0, 5.0), st.floats(1e-3, 5.0))
def test_starts_left_and_right_of_the_axis_join_at_the_same_place(x, y):
    left, right = joint_from(x, y), joint_from(x, -y)
    assert (left.dir, left.middle) == (right.dir, right.middle)
    np.testing.assert_array_equal(left.control_points * [1.0, -1.0], right.control_points)


@settings(max_examples=25)
@given(st.floats(-3.0, 3.0), st.floats(0.01, 5.0), st.floats(0.01, 5.0), st.floats(0.0, math.pi))
def test_interior_angle_is_the_angle_between_the_rays(base, a, b, angle):
    at = np.array([[1.0, 2.0]])
    first = at[0] + a * np.array([math.cos(base), math.sin(base)])
    for turn in (angle, -angle):
        second = at[0] + b * np.array([math.cos(base + turn), math.sin(base + turn)])
        assert interior_angles(at, first, second)[0] == pytest.approx(angle, abs=1e-6)


def test_ray_without_length_has_no_angle():
    at = np.array([[1.0, 2.0]])
    assert interior_angles(at, at[0], np.array([0.0, 0.0]))[0] == 0.0
