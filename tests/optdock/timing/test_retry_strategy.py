"""Order of the methods, proof of the plans, and deadlines."""

from __future__ import annotations

import math

import numpy as np
import pytest

from optdock.deadline import Deadline, OutOfTime
from optdock.errors import InvalidValue
from optdock.model.limits import MotionLimits, SpeedZone
from optdock.model.path import Path
from optdock.plugins.interfaces import TimingStatus
from optdock.timing.jerk_phases import DriveBounds, Motion, MotionState
from optdock.timing.near_optimal import NearOptimal, near_optimal_plans
from optdock.timing.path_limits import limits_along
from optdock.timing.plan_checks import SegmentPlan
from optdock.timing.retry_strategy import NO_DEADLINES, Deadlines, TimingStart, best_of, segment_plans, time_path
from optdock.timing.ruckig_moves import move
from optdock.timing.windowed import Windowed, windowed_plans
from optdock.verification import certify_trajectory


@pytest.fixture
def along(make, all_limits):
    return limits_along(Path((make.spline([2.0], [0.0, 0.0]),)), all_limits, SpeedZone())[0]


def never(along, start, deadlines, braking):
    yield SegmentPlan(TimingStatus.FAIL, reason="no plan")


def windowed(along, start, deadlines, braking):
    return windowed_plans(along, start, deadlines)


def only_from_rest(*segment):
    return (windowed if segment[1] == MotionState() else never)(*segment)


def first_plan(along, start, plan):
    return best_of(segment_plans(along, start, plan, NO_DEADLINES))


def test_a_moving_start_without_a_plan_stops_and_goes(along):
    found = first_plan(along, MotionState(0.0, 0.4, 0.1), only_from_rest)
    assert (found.status, found.how) == (TimingStatus.OK, "stop and go")
    motion = Motion.of(MotionState(0.0, 0.4, 0.1), found.phases)
    assert tuple(motion.end) == pytest.approx((2.0, 0.0, 0.0), abs=1e-9)
    inner = motion.states[1, 1:-1]
    assert inner.min() == pytest.approx(0.0, abs=1e-12)


def test_no_plan_at_all_is_a_failure(along):
    assert first_plan(along, MotionState(), never).status is TimingStatus.FAIL
    found = first_plan(along, MotionState(0.0, 0.4), never)
    assert (found.status, found.reason) == (TimingStatus.FAIL, "no plan from rest after full braking")


def test_braking_ends_once_every_limit_is_kept(along):
    found = first_plan(along, MotionState(0.0, 0.7), windowed)
    assert (found.status, found.arrives) == (TimingStatus.START_INFEASIBLE, True)
    motion = Motion.of(MotionState(0.0, 0.7), found.phases)
    s, v, _a = motion.states
    assert v[s < 1.0].min() > 0.3


def test_braking_to_rest_without_a_plan(make, all_limits):
    gears = make.spline([2.0], [0.0, 0.0]), make.spline([1.0], [0.0, 0.0], sign=-1)
    result = time_path(Path(gears), all_limits, SpeedZone(), TimingStart(0.7, 0.0), never)
    assert result.status is TimingStatus.START_INFEASIBLE
    assert result.trajectory.path.segments == gears[:1]
    end = result.trajectory.time_law.states[-1]
    # V^2 / (2 D) + V D / (2 J).
    assert tuple(end) == pytest.approx((0.49 / 1.0 + 0.7 * 0.5 / 2.4, 0.0, 0.0), abs=1e-9)


def test_a_later_gear_without_a_plan_is_a_failure(make, all_limits):
    gears = make.spline([2.0], [0.0, 0.0]), make.spline([1.0], [0.0, 0.0], sign=-1)

    def first_only(*segment):
        return (windowed if segment[0].caps.direction > 0 else never)(*segment)

    result = time_path(Path(gears), all_limits, SpeedZone(), TimingStart(0.7, 0.0), first_only)
    assert (result.status, result.trajectory, result.reason) == (TimingStatus.FAIL, None, "no plan")


METHODS = (NearOptimal(), NearOptimal(smooth=True), Windowed())


@pytest.mark.parametrize("method", METHODS)
def test_a_zone_that_begins_at_a_knot_is_kept(method, make):
    # The end of the path less the zone is the knot, or the knot less one rounding: a coin for every path.
    limits, sides = MotionLimits(max_yaw_acceleration=2.0), set()
    for seed in range(16):
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


def reckless(along, start, deadlines, braking):
    """Plans that ignore the turning limits: refused wherever these bind."""
    limits = along.drive
    box = DriveBounds(limits.max_speed, limits.max_acceleration, limits.max_deceleration, limits.max_jerk)
    yield SegmentPlan(TimingStatus.OK, move(start, MotionState(along.length), box), how="reckless")


def reckless_then_careful(*segment):
    yield from reckless(*segment)
    yield from windowed(*segment)


@pytest.fixture
def gears(make):
    """A straight gear, and one that bends."""
    forward = make.spline([1.0], [0.0, 0.0])
    return Path((forward, make.spline([0.5, 0.5], [0.0, 1.5, 0.0], -1, forward.spline.end)))


def test_only_a_refused_gear_gets_the_next_plan(gears, all_limits):
    result = time_path(gears, all_limits, SpeedZone(), TimingStart(0.0, 0.0), reckless_then_careful)
    assert result.status is TimingStatus.OK
    assert result.report.gears == ("reckless", "windowed")
    assert certify_trajectory(result.trajectory, all_limits, SpeedZone()).certified
    assert result.worst_ratio <= 1.0 + 1e-6


def test_a_gear_without_another_plan_reports_the_violation(gears, all_limits):
    result = time_path(gears, all_limits, SpeedZone(), TimingStart(0.0, 0.0), reckless)
    assert (result.status, result.trajectory) == (TimingStatus.FAIL, None)
    assert "the last method, reckless, is not certified: speed " in result.reason
    assert result.limit == ""  # of a gear, or of the zone
    assert 1.0 < result.at_s < 2.0
    turning = MotionLimits(max_speed=0.6, max_reverse_speed=2.0, max_yaw_acceleration=0.2)
    result = time_path(gears, turning, SpeedZone(), TimingStart(0.0, 0.0), reckless)
    assert "is not certified: yaw acceleration " in result.reason
    assert (result.status, result.limit) == (TimingStatus.FAIL, "max_yaw_acceleration")


def test_a_moving_start_whose_plans_are_refused_stops_first(make, all_limits):
    path = Path((make.spline([1.5, 0.3, 0.3], [0.0, 0.0, 1.5, 0.0]),))

    def careful_from_rest(*segment):
        return (windowed if segment[1] == MotionState() else reckless)(*segment)

    result = time_path(path, all_limits, SpeedZone(), TimingStart(0.4, 0.0), careful_from_rest)
    assert (result.status, result.report.gears) == (TimingStatus.OK, ("stop and go",))
    assert certify_trajectory(result.trajectory, all_limits, SpeedZone(), start_speed=0.4).certified


ZONE = SpeedZone(0.12, 0.4)
PLANNERS = {"near-optimal": near_optimal_plans, "windowed": windowed}


class Ticking:
    """A clock that advances by a tick at every call."""

    def __init__(self, tick: float = 1e-3) -> None:
        self.tick, self.now = tick, 0.0

    def __call__(self) -> float:
        self.now += self.tick
        return self.now


@pytest.mark.parametrize("planner", PLANNERS.values(), ids=PLANNERS)
@pytest.mark.parametrize("ticks", [1, 3, 10, 30, 100, 300, 1000])
def test_few_checks_of_the_clock_after_the_deadline(ticks, planner, make, all_limits):
    path = make.random_path(np.random.default_rng(7), gears=2, length=2.5)
    clock = Ticking()
    deadline = Deadline(1e-3 * (ticks + 0.5), clock)
    result = time_path(path, all_limits, ZONE, TimingStart(0.0, 0.0), planner, deadline)
    assert clock.now / clock.tick - ticks <= 25
    if result.status is TimingStatus.OK:
        assert certify_trajectory(result.trajectory, all_limits, ZONE).certified
    else:
        assert (result.status, result.trajectory) == (TimingStatus.TIMED_OUT, None)
        assert "time was up" in result.reason or "no time" in result.reason


def test_methods_by_available_time(make, all_limits):
    along = limits_along(make.random_path(np.random.default_rng(7), length=2.5), all_limits, ZONE)[0]
    found = []
    for ticks in np.geomspace(2, 3000, 20):
        deadlines = Deadlines.of(Deadline(1e-3 * ticks, Ticking()), lookup=0.02)
        found.append(best_of(near_optimal_plans(along, MotionState(), deadlines, None)).how)
    order = ["none", "windowed", "reference"]
    ranks = [order.index(how) for how in found]
    assert ranks == sorted(ranks)
    assert set(ranks) == {0, 1, 2}


@pytest.mark.parametrize("method", [NearOptimal(), Windowed()])
def test_no_time_is_a_status_and_nan_is_refused(method, make, all_limits):
    path = make.random_path(np.random.default_rng(0), length=1.5)
    for none in (0.0, -1.0, 1e-9):
        result = method.parameterize(path, all_limits, ZONE, max_time=none)
        assert (result.status, result.trajectory) == (TimingStatus.TIMED_OUT, None)
        assert result.reason
    with pytest.raises(InvalidValue, match="max_time"):
        method.parameterize(path, all_limits, ZONE, max_time=math.nan)
    ample = method.parameterize(path, all_limits, ZONE, max_time=60.0).trajectory
    free = method.parameterize(path, all_limits, ZONE).trajectory
    np.testing.assert_array_equal(ample.time_law.durations, free.time_law.durations)


def test_impossible_start_is_reported_with_little_time(make, all_limits):
    path = make.random_path(np.random.default_rng(3), gears=1, length=3.0)
    for ticks in range(2, 40):
        deadline = Deadline(1e-3 * ticks, Ticking())
        result = time_path(path, all_limits, ZONE, TimingStart(0.9, 0.0), PLANNERS["near-optimal"], deadline)
        assert result.status in (TimingStatus.START_INFEASIBLE, TimingStatus.TIMED_OUT)
        if result.status is TimingStatus.START_INFEASIBLE:
            assert result.trajectory.time_law.states[-1, 1] == pytest.approx(0.0, abs=1e-9)


def test_shortened_deadlines_share_start_and_clock():
    clock = Ticking()
    whole = Deadline(0.1, clock)
    early, soon, same = whole.shortened(0.03), whole.shortened(0.03, at_most=0.02), whole.shortened()
    assert clock.now == pytest.approx(1e-3)
    assert [one.seconds for one in (early, soon, same)] == pytest.approx([0.07, 0.02, 0.1])
    clock.now = 0.05
    soon_passed, early_passed = soon.passed(), early.passed()
    assert (soon_passed, early_passed) == (True, False)
    early.look()
    with pytest.raises(OutOfTime):
        soon.look()
