"""What is left of an error at the dock, and what can be planned away: closed forms and symmetries."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from optdock.executor.dock_estimate import (
    DECAY,
    SHORTEST_DECAY,
    can_be_planned_away,
    left_at_dock,
    reachable_offset,
    staging_distance,
)
from optdock.geometry.pose import Pose2, Twist2
from optdock.model.limits import MotionLimits

from .conftest import LIMITS, problem_with

offsets, turns, ways = st.floats(-0.1, 0.1), st.floats(-0.2, 0.2), st.floats(0.0, 2.0)


@settings(max_examples=25)
@given(
    offset=offsets,
    turn=turns,
    way=ways,
    gear=st.sampled_from([1.0, -1.0]),
    decay=st.sampled_from([DECAY, SHORTEST_DECAY]),
)
def test_errors_decay_by_the_tracking_law(offset, turn, way, gear, decay):
    """Against its own steps: d offset / ds = turn, and the heading is pulled back by both; in both gears alike."""
    y, w, step = offset, gear * turn, way / 1000
    for _ in range(1000):
        y, w = y + step * w, w - step * (2.0 * w / decay + y / decay**2)
    found = left_at_dock(offset, turn, way, gear, decay)
    assert found == pytest.approx((y, gear * w), abs=5e-3)
    mirrored = left_at_dock(-offset, -turn, way, gear, decay)
    assert mirrored == pytest.approx((-found[0], -found[1]))


def test_reachable_offset_is_driven():
    """Curvature up and down and up again at the largest rate ends so far aside, in the old direction."""
    pose, way, count = Pose2(0.0, 0.0, 0.0), 0.4, 4000
    for k in range(count):
        s = (k + 0.5) * way / count
        quarter = way / 4
        curvature = LIMITS.max_curvature_rate * (s if s < quarter else 2 * quarter - s if s < 3 * quarter else s - way)
        pose = pose.moved(Twist2(1.0, curvature), way / count)
    assert pose.yaw == pytest.approx(0.0, abs=1e-9)
    assert pose.y == pytest.approx(reachable_offset(way, LIMITS), rel=0.01)
    assert reachable_offset(0.0, MotionLimits()) == 0.0
    assert reachable_offset(0.5, MotionLimits()) == math.inf
    assert reachable_offset(2.0, LIMITS) == pytest.approx(0.25 * LIMITS.max_curvature * 4.0)


def test_arc_back_to_the_path_needs_no_correction():
    """A robot on the arc that ends on the path needs less than one that is as far off and straight."""
    assert can_be_planned_away(-0.01, 0.1, 0.2, 1.0, LIMITS) == (0.25 * LIMITS.max_curvature_rate * 0.02 >= 0.1)
    assert can_be_planned_away(-0.004, 0.04, 0.2, 1.0, LIMITS)
    assert not can_be_planned_away(0.004, 0.04, 0.2, 1.0, LIMITS)
    assert can_be_planned_away(0.004, 0.04, 0.2, -1.0, LIMITS)
    assert not can_be_planned_away(0.0, 0.0, 0.0, 1.0, LIMITS)


def test_staging_distance_allows_to_correct_a_wrongly_stored_dock():
    problem = problem_with()
    room = staging_distance(problem) - problem.dock.final_straight
    assert reachable_offset(room, LIMITS) >= 0.15
    assert staging_distance(problem) >= 0.7
