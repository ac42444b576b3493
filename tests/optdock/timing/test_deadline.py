"""Every stage looks at the clock: what is returned late is little, and what is returned is still proven."""

from __future__ import annotations

import math

import numpy as np
import pytest

from optdock.deadline import Deadline
from optdock.errors import InvalidValue
from optdock.interfaces import TimingStatus
from optdock.limits import SpeedZone
from optdock.timing.allowance import Allowance
from optdock.timing.attempt import Settings
from optdock.timing.gears import courses_of, time_path
from optdock.timing.motion import State
from optdock.timing.near_optimal import NearOptimal
from optdock.timing.repair import plan_gear
from optdock.timing.start import best_of
from optdock.timing.windowed import Windowed, plan_windows
from optdock.verification import certify_trajectory

ZONE = SpeedZone(0.12, 0.4)
PLANNERS = {
    "near-optimal": lambda course, start, allowance: plan_gear(course, start, Settings(), allowance),
    "windowed": plan_windows,
}


class Ticking:
    """A clock that moves on by a tick whenever it is looked at."""

    def __init__(self, tick: float = 1e-3) -> None:
        self.tick, self.now = tick, 0.0

    def __call__(self) -> float:
        self.now += self.tick
        return self.now


@pytest.mark.parametrize("planner", PLANNERS.values(), ids=PLANNERS)
@pytest.mark.parametrize("ticks", [1, 3, 10, 30, 100, 300, 1000])
def test_no_more_than_a_few_looks_after_the_deadline(ticks, planner, make, all_limits):
    path = make.random_path(np.random.default_rng(7), gears=2, length=2.5)
    clock = Ticking()
    deadline = Deadline(1e-3 * (ticks + 0.5), clock)
    result = time_path(path, all_limits, ZONE, (0.0, 0.0), planner, deadline)
    assert clock.now / clock.tick - ticks <= 25
    if result.status is TimingStatus.OK:
        assert certify_trajectory(result.trajectory, all_limits, ZONE).certified
    else:
        assert (result.status, result.trajectory) == (TimingStatus.TIMED_OUT, None)
        assert "time was up" in result.reason or "no time" in result.reason


def test_more_time_gives_nothing_then_windows_then_the_reference(make, all_limits):
    course = courses_of(make.random_path(np.random.default_rng(7), length=2.5), all_limits, ZONE)[0]
    found = []
    for ticks in np.geomspace(2, 3000, 40):
        allowance = Allowance(Deadline(1e-3 * ticks, Ticking()), pace=0.02)
        found.append(best_of(plan_gear(course, State(), Settings(), allowance)).how)
    order = ["none", "windowed", "reference"]
    ranks = [order.index(how) for how in found]
    assert ranks == sorted(ranks)
    assert set(ranks) == {0, 1, 2}


@pytest.mark.parametrize("method", [NearOptimal(), Windowed()])
def test_no_time_is_a_status_and_no_number_is_refused(method, make, all_limits):
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


def test_an_impossible_start_is_answered_even_without_time_for_the_rest(make, all_limits):
    path = make.random_path(np.random.default_rng(3), gears=1, length=3.0)
    for ticks in range(2, 40):
        deadline = Deadline(1e-3 * ticks, Ticking())
        result = time_path(path, all_limits, ZONE, (0.9, 0.0), PLANNERS["near-optimal"], deadline)
        assert result.status in (TimingStatus.START_INFEASIBLE, TimingStatus.TIMED_OUT)
        if result.status is TimingStatus.START_INFEASIBLE:
            assert result.trajectory.time_law.states[-1, 1] == pytest.approx(0.0, abs=1e-9)
