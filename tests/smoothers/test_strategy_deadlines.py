"""`CasadiSmoother` against the clock: budgets, certificates that take too long, no time at all."""

import itertools
import math

import pytest

from experiments.families import instance
from optdock.errors import SmootherTimedOut
from optdock.plugins.interfaces import PluginContext
from optdock.verification import certify_path
from smoothers.casadi_smoother import CasadiSmoother
from smoothers.scp.loop import search
from smoothers.scp.qp_step import pool_of_this_thread


@pytest.fixture(autouse=True)
def usual_pace(monkeypatch):
    """The clocks here run by themselves, whatever an earlier warm-up has measured of the machine."""
    monkeypatch.setattr(pool_of_this_thread(), "pace", 1.0)


def ticking(seconds):
    """A clock that advances by the same time at every look."""
    looks = itertools.count()
    return lambda: seconds * next(looks)


def with_clock(clock, **parameters):
    plugin = CasadiSmoother(**parameters)
    plugin.configure(PluginContext(name="smoother", clock=clock))
    return plugin


def test_the_cost_never_grows_with_the_budget():
    case = instance("parallel", 0)
    costs = []
    for budget in (0.003, 0.005, 0.007, 0.009, 0.012, 0.05):
        try:
            # A certificate looks at the clock after every round: it takes no longer than expected of it.
            result = with_clock(ticking(0.0005)).smooth(case.raw_path, budget, problem=case.problem)
        except SmootherTimedOut:
            costs.append(math.inf)
            continue
        assert certify_path(result.path, case.problem).certified
        costs.append(result.report.cost)
    assert costs == sorted(costs, reverse=True)
    assert costs[-1] < costs[0]
    assert result.completed


class HandClock:
    """A clock that stands still until it is moved."""

    now = 0.0

    def __call__(self):
        return self.now


@pytest.mark.parametrize(("delay", "certified"), [(0.0, True), (1.0, False)])
def test_a_late_certificate_is_abandoned_without_a_verdict(monkeypatch, delay, certified):
    clock, case = HandClock(), instance("corridor", 1)

    def slowly(path, problem, *, is_late):
        clock.now += delay
        return certify_path(path, problem, is_late=is_late)

    searches = []
    monkeypatch.setattr("smoothers.scp.search.certify_path", slowly)
    monkeypatch.setattr("smoothers.scp.search.search", lambda *a: searches.append(a) or search(*a))
    if certified:
        assert with_clock(clock).smooth(case.raw_path, 0.5, problem=case.problem).completed
    else:
        with pytest.raises(SmootherTimedOut):
            with_clock(clock).smooth(case.raw_path, 0.5, problem=case.problem)
    assert len(searches) == 1


def test_a_short_budget_returns_an_unfinished_certified_path():
    case = instance("parallel", 0)
    result = with_clock(ticking(0.001)).smooth(case.raw_path, 0.012, problem=case.problem)
    assert not result.completed
    assert certify_path(result.path, case.problem).certified


def test_no_time_at_all_is_a_timeout():
    case = instance("parallel", 0)
    with pytest.raises(SmootherTimedOut):
        with_clock(ticking(0.001)).smooth(case.raw_path, 0.002, problem=case.problem)


def test_a_time_out_leaves_where_it_was_and_a_later_call_goes_on_from_there():
    """Two calls that are too short each, one after the other, do what a long one does."""
    case, half = instance("corridor", 1), None
    budgets = [0.002 * 1.15**k for k in range(24)]
    for budget in budgets:
        try:
            with_clock(ticking(0.0005)).smooth(case.raw_path, budget, problem=case.problem)
            break
        except SmootherTimedOut as error:
            half = error.partial
    assert half is not None
    assert budget > budgets[0]
    result = with_clock(ticking(0.0005)).smooth(case.raw_path, 0.9 * budget, problem=case.problem, warm_start=half.path)
    assert certify_path(result.path, case.problem).certified
