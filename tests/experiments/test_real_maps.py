"""Scenarios on maps: raw paths violate bounds, smoothed ones are certified, and two independent checks agree."""

import numpy as np
import pytest

from experiments.dense_check import dense_check
from experiments.draw_maps import FREE, OCCUPIED, PLACES, UNKNOWN, scanned, solid
from experiments.real_maps import DRAWN_MAPS, DRAWN_SCENARIOS, SCENARIOS, problem_of
from optdock.io.maps import load_map
from optdock.model.costs import FREE_SPACE, LETHAL, NO_INFORMATION
from optdock.planning.pipeline import plan_dock
from optdock.verification import certify_path

BUDGET = 20.0  # [s]: the test is of verdicts, not of time


def check(scenario):
    problem = problem_of(scenario)
    plan = plan_dock(problem, time_budget=BUDGET)
    assert plan.certificate.certified
    assert dense_check(plan.path, problem, step=0.01).ok


@pytest.mark.parametrize("scenario", DRAWN_SCENARIOS, ids=lambda scenario: scenario.name)
def test_scenarios_on_our_maps_are_certified(scenario):
    check(scenario)


@pytest.mark.parametrize("scenario", SCENARIOS, ids=lambda scenario: scenario.name)
def test_scenarios_on_real_maps_are_certified(scenario, real_data):
    check(scenario)


def test_raw_paths_violate_bounds(real_data):
    raw = {s.name: plan_dock(problem_of(s), time_budget=BUDGET).raw_path for s in SCENARIOS}
    broken = [s.name for s in SCENARIOS if not certify_path(raw[s.name], problem_of(s)).certified]
    assert len(broken) >= len(SCENARIOS) - 1


def test_set_of_scenarios():
    assert len(SCENARIOS) >= 20
    assert {s.map_name for s in SCENARIOS} == {"depot", "warehouse"}
    assert {s.map_name for s in DRAWN_SCENARIOS} == set(PLACES)
    assert sum(s.backward for s in SCENARIOS) >= 5
    assert max(abs(s.start[2]) for s in SCENARIOS) == 60


def test_committed_map_equals_the_drawn_map():
    """One of the maps, except for cells at which rounding of another processor's sine moves a beam over an edge."""
    place = PLACES["corridor"]
    drawn = scanned(solid(place), place.tour, np.random.default_rng(1))
    costs = load_map(DRAWN_MAPS / "corridor.yaml").costmap.data
    expected = np.select([drawn == FREE, drawn == OCCUPIED, drawn == UNKNOWN], [FREE_SPACE, LETHAL, NO_INFORMATION])
    assert np.mean(costs != expected) < 1e-3
    assert min(np.mean(costs == cost) for cost in (FREE_SPACE, LETHAL, NO_INFORMATION)) > 0.02
