from __future__ import annotations

import pytest

from optdock.interfaces import TimingStatus
from optdock.limits import SpeedZone
from optdock.path import Path
from optdock.timing.allowance import ENDLESS
from optdock.timing.gears import courses_of, time_path
from optdock.timing.motion import Motion, State
from optdock.timing.start import GearPlan, best_of, plans_from
from optdock.timing.windowed import plan_windows


@pytest.fixture
def course(make, all_limits):
    return courses_of(Path((make.spline([2.0], [0.0, 0.0]),)), all_limits, SpeedZone())[0]


def never(course, start, allowance):
    yield GearPlan(TimingStatus.FAIL, reason="no plan")


def only_from_rest(course, start, allowance):
    return plan_windows(course, start, allowance) if start == State() else never(course, start, allowance)


def first_plan(course, start, plan):
    return best_of(plans_from(course, start, plan, ENDLESS))


def test_a_moving_start_without_a_plan_stops_and_goes(course):
    found = first_plan(course, State(0.0, 0.4, 0.1), only_from_rest)
    assert (found.status, found.how) == (TimingStatus.OK, "stop and go")
    motion = Motion.of(State(0.0, 0.4, 0.1), found.phases)
    assert tuple(motion.end) == pytest.approx((2.0, 0.0, 0.0), abs=1e-9)
    inner = motion.states[1, 1:-1]
    assert inner.min() == pytest.approx(0.0, abs=1e-12)


def test_no_plan_at_all_is_a_failure(course):
    assert first_plan(course, State(), never).status is TimingStatus.FAIL
    found = first_plan(course, State(0.0, 0.4), never)
    assert (found.status, found.reason) == (TimingStatus.FAIL, "no plan from rest after full braking")


def test_braking_is_cut_short_once_every_limit_holds(course):
    found = first_plan(course, State(0.0, 0.7), plan_windows)
    assert (found.status, found.arrives) == (TimingStatus.START_INFEASIBLE, True)
    motion = Motion.of(State(0.0, 0.7), found.phases)
    s, v, _a = motion.states
    assert v[s < 1.0].min() > 0.3


def test_braking_to_rest_is_all_there_is_where_nothing_can_be_planned(make, all_limits):
    gears = make.spline([2.0], [0.0, 0.0]), make.spline([1.0], [0.0, 0.0], sign=-1)
    result = time_path(Path(gears), all_limits, SpeedZone(), (0.7, 0.0), never)
    assert result.status is TimingStatus.START_INFEASIBLE
    assert result.trajectory.path.segments == gears[:1]
    end = result.trajectory.time_law.states[-1]
    # V^2 / (2 D) + V D / (2 J).
    assert tuple(end) == pytest.approx((0.49 / 1.0 + 0.7 * 0.5 / 2.4, 0.0, 0.0), abs=1e-9)


def test_a_later_gear_without_a_plan_fails_the_whole(make, all_limits):
    gears = make.spline([2.0], [0.0, 0.0]), make.spline([1.0], [0.0, 0.0], sign=-1)

    def first_only(course, start, allowance):
        return (plan_windows if course.drive.direction > 0 else never)(course, start, allowance)

    result = time_path(Path(gears), all_limits, SpeedZone(), (0.7, 0.0), first_only)
    assert (result.status, result.trajectory, result.reason) == (TimingStatus.FAIL, None, "no plan")
