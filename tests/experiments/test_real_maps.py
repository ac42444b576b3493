"""Scenarios on maps: raw paths violate bounds, smoothed ones are certified, and two independent checks agree."""

import importlib
import os
import subprocess
import sys

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
ROOT = DRAWN_MAPS.parents[1]


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


def test_the_experiment_runs_from_a_clone(tmp_path):
    environment = {key: value for key, value in os.environ.items() if key != "OPTDOCK_DATA"}
    environment["PYTHONPATH"] = os.pathsep.join((str(ROOT), environment.get("PYTHONPATH", "")))
    command = [sys.executable, ROOT / "experiments" / "01_docking_on_maps.py", "--only", "hall north wall"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False, env=environment)
    assert done.returncode == 0, done.stderr
    assert "1 of 1 certified, 1 docked" in done.stdout
    made = {path.name for path in (tmp_path / "results" / "01_docking_on_maps").iterdir()}
    name = "hall_north_wall_past_a_pillar"
    assert made == {"tables.txt", "comparison.csv", f"{name}.png", f"{name}_run.png"}


@pytest.mark.parametrize("given", ["option", "variable"])
def test_requested_maps_that_are_missing_are_reported_with_their_source(tmp_path, given, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.setattr(sys, "argv", ["01_docking_on_maps", *(["--maps", "nowhere"] if given == "option" else [])])
    if given == "option":
        monkeypatch.delenv("OPTDOCK_DATA", raising=False)
    else:
        monkeypatch.setenv("OPTDOCK_DATA", "nowhere")
    with pytest.raises(SystemExit) as left:
        importlib.import_module("experiments.01_docking_on_maps").main()
    assert left.value.code == 2
    message = capsys.readouterr().err
    assert "holds no depot.yaml and no warehouse.yaml; " in message
    assert "https://github.com/ros-navigation/navigation2" in message
    assert not (tmp_path / "results").exists()
