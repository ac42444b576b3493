"""What is called OK is proven; where the proof refuses a plan, the next method takes its place."""

from __future__ import annotations

import numpy as np
import pytest

from optdock.interfaces import TimingStatus
from optdock.limits import MotionLimits, SpeedZone
from optdock.path import Path
from optdock.timing.gears import time_path
from optdock.timing.motion import State
from optdock.timing.moves import Box, move
from optdock.timing.near_optimal import NearOptimal
from optdock.timing.start import GearPlan
from optdock.timing.windowed import Windowed, plan_windows
from optdock.verification import certify_trajectory

METHODS = (NearOptimal(), NearOptimal(smooth=True), Windowed())


@pytest.mark.parametrize("method", METHODS)
def test_a_zone_that_begins_at_a_knot_is_kept(method, make):
    # The end of the path less the zone is the knot, or the knot less one rounding: a coin for every path.
    limits, sides = MotionLimits(max_yaw_acceleration=2.0), set()
    for seed in range(24):
        rng = np.random.default_rng(seed)
        lengths = np.append(rng.uniform(0.2, 0.5, 4), rng.uniform(0.25, 0.45))
        path = Path((make.spline(lengths, [*rng.uniform(-1.2, 1.2, 4), 0.0, 0.0]),))
        knot = float(path.segments[0].knots[-2])
        zone = SpeedZone(0.1, float(lengths[-1]))
        sides.add(np.sign(path.length - zone.distance - knot))
        result = method.parameterize(path, limits, zone)
        assert result.status is TimingStatus.OK
        proof = certify_trajectory(result.trajectory, limits, zone, start_speed=0.0, start_acceleration=0.0)
        assert proof.certified, proof.reason
        assert "stretched" not in result.report.gears[0]
        free = SpeedZone(0.1, zone.distance + 1e-9)
        assert result.trajectory.duration == pytest.approx(
            method.parameterize(path, limits, free).trajectory.duration, rel=1e-3
        )
    assert {-1.0, 0.0, 1.0} <= sides


def reckless(course, start, allowance):
    """Plans that ignore the turning limits: refused wherever these bind."""
    limits = course.limits
    box = Box(limits.max_speed, limits.max_acceleration, limits.max_deceleration, limits.max_jerk)
    yield GearPlan(TimingStatus.OK, move(start, State(course.length), box), how="reckless")


def reckless_then_careful(course, start, allowance):
    yield from reckless(course, start, allowance)
    yield from plan_windows(course, start, allowance)


@pytest.fixture
def gears(make):
    """A straight gear, and one that bends."""
    forward = make.spline([1.0], [0.0, 0.0])
    return Path((forward, make.spline([0.5, 0.5], [0.0, 1.5, 0.0], -1, forward.spline.end)))


def test_a_refused_gear_gets_the_next_plan_and_the_others_keep_theirs(gears, all_limits):
    result = time_path(gears, all_limits, SpeedZone(), (0.0, 0.0), reckless_then_careful)
    assert result.status is TimingStatus.OK
    assert result.report.gears == ("reckless", "windowed")
    assert certify_trajectory(result.trajectory, all_limits, SpeedZone()).certified
    assert result.worst_ratio <= 1.0 + 1e-6


def test_a_gear_whose_last_plan_is_refused_fails_with_what_is_broken_and_where(gears, all_limits):
    result = time_path(gears, all_limits, SpeedZone(), (0.0, 0.0), reckless)
    assert (result.status, result.trajectory) == (TimingStatus.FAIL, None)
    assert "the last method, reckless, is not certified: " in result.reason
    assert 1.0 < result.at_s < 2.0


def test_a_moving_start_whose_plans_are_refused_stops_first(make, all_limits):
    path = Path((make.spline([1.5, 0.3, 0.3], [0.0, 0.0, 1.5, 0.0]),))

    def careful_from_rest(course, start, allowance):
        return (plan_windows if start == State() else reckless)(course, start, allowance)

    result = time_path(path, all_limits, SpeedZone(), (0.4, 0.0), careful_from_rest)
    assert (result.status, result.report.gears) == (TimingStatus.OK, ("stop and go",))
    assert certify_trajectory(result.trajectory, all_limits, SpeedZone(), start_speed=0.4).certified
