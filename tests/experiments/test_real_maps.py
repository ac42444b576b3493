"""The scenarios on real maps: raw paths break the rules, smoothed ones are certified, and two judges agree."""

import pytest

from experiments.real_maps import SCENARIOS, problem_of
from optdock.pipeline import plan_dock
from optdock.testing.dense_check import dense_check
from optdock.verification import certify_path

BUDGET = 20.0  # [s]: about verdicts, not about time


@pytest.mark.parametrize("scenario", SCENARIOS, ids=lambda scenario: scenario.name)
def test_every_scenario_is_certified_and_the_dense_check_agrees(scenario, real_data):
    problem = problem_of(scenario)
    plan = plan_dock(problem, time_budget=BUDGET)
    assert plan.certificate.certified
    assert dense_check(plan.path, problem, step=0.01).ok


def test_nearly_every_raw_path_breaks_a_rule(real_data):
    raw = {s.name: plan_dock(problem_of(s), time_budget=BUDGET).raw_path for s in SCENARIOS}
    broken = [s.name for s in SCENARIOS if not certify_path(raw[s.name], problem_of(s)).certified]
    assert len(broken) >= len(SCENARIOS) - 1


def test_the_set_is_what_it_promises():
    assert len(SCENARIOS) >= 20
    assert {s.map_name for s in SCENARIOS} == {"depot", "warehouse"}
    assert sum(s.backward for s in SCENARIOS) >= 5
    assert max(abs(s.start[2]) for s in SCENARIOS) == 60
