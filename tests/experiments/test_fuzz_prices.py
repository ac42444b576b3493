"""Prices of easier problems: the easier problem requires less, and a more expensive plan is reported."""

import functools
import types

import pytest

from experiments.fuzz.case import rng_of
from experiments.fuzz.doors import problem_of
from experiments.fuzz.kinds import prices
from optdock.errors import FailedToSmoothPath


@functools.cache
def drawn():
    return [prices.draw(rng_of("prices", 5, i)) for i in range(80)]


def cases(what):
    return [case for case in drawn() if case["easier"] == what]


@pytest.mark.parametrize("what", prices.EASIER)
def test_easier_problem_requires_no_more(what):
    some = cases(what)
    assert some
    for case in some:
        made = prices.easier(case)
        assert all(a <= b for a, b in zip(made["clearance"][:2], case["clearance"][:2], strict=True))
        assert len(made["obstacles"]) <= len(case["obstacles"])
        for name, limit in case["limits"].items():
            assert limit is None or made["limits"][name] >= limit
        relaxed = {"limits": 0, "clearance": 0, "obstacles": 0}
        assert {**made, **relaxed} == {**case, **relaxed}
        problem_of(made)


@pytest.mark.parametrize(
    ("found", "outcome"),
    [(10.0, "no more expensive"), (10.29, "no more expensive"), (10.31, "more expensive"), (None, "more expensive")],
)
def test_more_expensive_plan_is_reported(monkeypatch, found, outcome):
    answers = iter([10.0, found])

    def planned(problem, time_budget):
        price = next(answers)
        if price is None:
            raise FailedToSmoothPath("no")
        return types.SimpleNamespace(price=price)

    monkeypatch.setattr("experiments.fuzz.kinds.prices.plan_dock", planned)
    verdict = prices.judge(cases("clearance")[0])
    assert verdict.outcome == outcome
    assert not verdict.is_fault  # the search is not exhaustive: only counted
