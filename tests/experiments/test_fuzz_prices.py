"""The fuzzer's rule of prices: what is made easier asks for less, and a plan that costs more all the same is told."""

import types

import pytest

from experiments.fuzz.case import rng_of
from experiments.fuzz.doors import problem_of
from experiments.fuzz.kinds import prices
from optdock.errors import FailedToSmoothPath


def cases(what, count=20):
    drawn = (prices.draw(rng_of("prices", 5, i)) for i in range(200))
    return [case for case in drawn if case["easier"] == what][:count]


@pytest.mark.parametrize("what", prices.EASIER)
def test_the_easier_problem_asks_for_no_more(what):
    some = cases(what)
    assert some
    for case in some:
        made = prices.easier(case)
        assert all(a <= b for a, b in zip(made["clearance"][:2], case["clearance"][:2], strict=True))
        assert len(made["obstacles"]) <= len(case["obstacles"])
        for name, limit in case["limits"].items():
            assert limit is None or made["limits"][name] >= limit
        assert {**made, "limits": 0, "clearance": 0, "obstacles": 0} == {
            **case,
            "limits": 0,
            "clearance": 0,
            "obstacles": 0,
        }
        problem_of(made)


@pytest.mark.parametrize(
    ("found", "outcome"), [(10.0, "no dearer"), (10.29, "no dearer"), (10.31, "dearer"), (None, "dearer")]
)
def test_a_dearer_plan_is_told(monkeypatch, found, outcome):
    answers = iter([10.0, found])

    def planned(problem, time_budget):
        price = next(answers)
        if price is None:
            raise FailedToSmoothPath("no")
        return types.SimpleNamespace(price=price)

    monkeypatch.setattr("experiments.fuzz.kinds.prices.plan_dock", planned)
    verdict = prices.judge(cases("clearance")[0])
    assert verdict.outcome == outcome
    assert not verdict.is_fault  # a search may miss a way: it is counted
