"""The numbered studies: each runs on one task, and their judgements find planted faults."""

from __future__ import annotations

import csv
import dataclasses
import importlib
import math
import sys
from pathlib import Path as FilePath

import numpy as np
import pytest
from scipy.stats import binom, binomtest

from experiments import raw_paths
from experiments.raw_paths import SOURCES, ompl_path
from experiments.study_cases import BAY, EXAMPLES, DockCase, dock_cases, problem_for
from experiments.study_run import median_interval, power_law, run, share_interval
from optdock.errors import MissingExtra
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import Pose2
from optdock.model.path import Path, PolylineSegment

FOLDER = FilePath(__file__).resolve().parents[2] / "experiments"
STUDIES = sorted(script.stem for script in FOLDER.glob("[0-9]*.py"))
CASE = DockCase("storage bay between pallets", 0)
QUICK = {  # tasks that use every part of a study; of the others, the first task is quick
    "01_raw_and_smoothed": ("hall east wall, aligned", 0, "hybrid A*"),
    "06_parking": ("slots", 35),
    "09_surveys": ("corridor east end past the cabinet", 1.0),
}


def study(number):
    return importlib.import_module(f"experiments.{next(stem for stem in STUDIES if stem.startswith(number))}")


@pytest.fixture(autouse=True)
def as_before(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.setenv("OPTDOCK_DATA", str(tmp_path))


@pytest.mark.parametrize("stem", STUDIES)
def test_study_runs_and_writes_its_rows_text_and_chart(stem, tmp_path, monkeypatch, capsys):
    module = importlib.import_module(f"experiments.{stem}")
    if stem == "09_surveys":
        pytest.importorskip("optdock.cli.survey", reason="needs optdock survey")
    first, *_ = module.tasks(0.02)
    task = QUICK.get(stem, first)
    monkeypatch.setattr(module, "tasks", lambda _: [task])
    if stem == "05_contact_forces":
        monkeypatch.setattr(module, "WORLDS", {module.NOISY: module.WORLDS[module.NOISY]})
        monkeypatch.setattr(module, "METHODS", {name: module.METHODS[name] for name in ("graceful law", "executor")})
    assert run(str(FOLDER / f"{stem}.py"), ["--scale", "0.02"]) == 0
    text = (tmp_path / "results" / stem / "study.md").read_text()
    assert text.startswith(module.__doc__.strip().splitlines()[0])
    assert text.strip() in capsys.readouterr().out
    with (tmp_path / "results" / stem / "rows.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) >= 1
    assert rows[0].keys() == set(module.Row._fields)
    for suffix, begin in (("png", b"\x89PNG"), ("svg", b"<?xml")):
        assert (tmp_path / "results" / stem / f"chart.{suffix}").read_bytes().startswith(begin)


def test_share_interval_is_that_of_wilson():
    for count, total in ((0, 10), (3, 17), (200, 200), (1, 1)):
        found = binomtest(count, total).proportion_ci(method="wilson")
        assert share_interval(count, total) == pytest.approx((found.low, found.high), abs=1e-6)
    assert share_interval(0, 0) == (0.0, 1.0)


@pytest.mark.parametrize("size", [6, 7, 20, 101])
def test_median_interval_holds_the_median_in_95_of_100_samples(size):
    """The interval of order statistics k and n + 1 - k holds it with probability 1 - 2 P(fewer than k below)."""
    middle, low, high = median_interval(np.arange(1.0, size + 1.0))
    assert (low + high) / 2.0 == pytest.approx(middle)
    assert 1.0 - 2.0 * binom.cdf(low - 1.0, size, 0.5) >= 0.95
    assert 1.0 - 2.0 * binom.cdf(low, size, 0.5) < 0.95


def test_power_law_recovers_a_planted_exponent():
    rng = np.random.default_rng(3)
    x = np.repeat([1.0, 10.0, 100.0, 1000.0], 10)
    fit = power_law(x, 2.5 * x**0.7 * np.exp(0.2 * rng.standard_normal(x.size)))
    assert fit.low < 0.7 < fit.high
    assert fit.high - fit.low < 0.1
    assert fit.factor == pytest.approx(2.5, rel=0.3)


@pytest.mark.parametrize("name", [name for name in SOURCES if name != "OMPL"])
def test_raw_path_leads_from_the_start_to_the_dock(name):
    problem = problem_for(CASE)
    path = SOURCES[name](problem, 0)
    assert path.start.as_array() == pytest.approx(problem.start.as_array())
    assert path.end.as_array() == pytest.approx(problem.goal.as_array())
    assert all(isinstance(segment, PolylineSegment) for segment in path.segments)


def test_waypoints_of_the_example_are_those_of_its_file():
    path = SOURCES["waypoints"](problem_for(DockCase(BAY, 0)), 0)
    written = np.loadtxt(EXAMPLES / "waypoints.csv", delimiter=",", skiprows=1)
    (segment,) = path.segments
    assert np.asarray(segment.poses) == pytest.approx(written)


def test_ompl_path_is_driven_with_the_smallest_turning_radius_among_the_obstacles():
    pytest.importorskip("ompl", reason="needs ompl")
    problem, check = problem_for(CASE), study("08")
    path = ompl_path(problem, 0)
    assert path.end.as_array() == pytest.approx(problem.goal.as_array())
    assert check.driven_curvature(path) < 1.1 * problem.robot.limits.max_curvature
    assert check.dense_check(path, problem, 0.01).min_clearance > 0.0


def test_missing_ompl_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "ompl", None)
    assert not raw_paths.has_ompl()
    with pytest.raises(MissingExtra, match=r"optdock\[ompl\]"):
        ompl_path(problem_for(CASE), 0)


def test_cases_have_own_starts_and_are_the_same_in_every_call():
    cases = dock_cases(1.0, 3)
    assert len(set(cases)) == len(cases) == 51
    first, again, other = (problem_for(DockCase(CASE.scenario, number)).start for number in (1, 1, 2))
    assert first == again != other


def test_path_through_a_wall_is_a_collision_and_a_free_one_is_none():
    check, problem = study("08"), problem_for(CASE)
    path = SOURCES["hybrid A*"](problem, 0)
    row = check.Row(*CASE, "hybrid A*", "SimpleSmoother", "success", raw_collides=False)
    assert not check.judged(row, path, problem).is_bad
    middle = path.pose_at(0.5 * path.length)
    wall = [middle @ Pose2(*corner, 0.0) for corner in ((-0.01, -0.5), (0.01, -0.5), (0.01, 0.5), (-0.01, 0.5))]
    walled = dataclasses.replace(problem, obstacles=ObstacleSet.from_polygons([[(pose.x, pose.y) for pose in wall]]))
    found = check.judged(row, path, walled)
    assert found.collides
    assert found.too_close
    assert found.overlap > 0.0
    assert not found.certified
    assert "1/1" in check.report([found]).closing
    assert not check.report([found._replace(certified=True)]).is_sound


@pytest.mark.parametrize("radius", [0.4, 1.0, 5.0])
def test_driven_curvature_is_that_of_a_circle_in_spite_of_noise(radius):
    angle = np.arange(0.0, 2.0, 0.05 / radius)
    poses = np.column_stack((radius * np.sin(angle), radius * (1.0 - np.cos(angle)), angle))
    rng = np.random.default_rng(1)
    for noise in (0.0, 1e-4):
        noisy = poses + noise * rng.standard_normal(poses.shape) * (1.0, 1.0, 0.0)
        assert study("08").driven_curvature(Path.from_poses(noisy)) == pytest.approx(1.0 / radius, rel=0.05, abs=0.1)


def test_distance_from_the_optimum_is_of_pairs_that_are_both_certified():
    module = study("01")

    def row(number, smoother, cost, status="certified"):
        return module.Row("hall", number, "hybrid A*", smoother, status, length=1.0, cost=cost)

    rows = [row(0, module.OURS, 1.02), row(0, module.OPTIMUM, 1.0), row(1, module.OURS, 9.0)]
    rows += [row(2, module.OURS, 2.0), row(2, module.OPTIMUM, 1.0, "not certified")]
    assert module.gaps(rows) == pytest.approx([2.0])


@pytest.mark.parametrize("kind", ["false", "collided"])
def test_false_docking_and_collision_of_the_executor_are_reported(kind):
    module = study("02")
    good = module.Row("field", "executor", "nav2", 1, "docked", True, True, False, 1.0, 1.0, 0.1, 5.0)
    bad = good._replace(is_good=False) if kind == "false" else good._replace(has_collided=True)
    assert module.report([good]).is_sound
    assert not module.report([good, bad]).is_sound
    assert module.report([good, bad._replace(method="Nav2's law")]).is_sound


def test_known_lag_has_smaller_errors_on_the_way_than_ignored_lag():
    module = study("03")
    ignored, known = (
        next(iter(module.work(module.Task(world, "S-curve", 1)))) for world in ("lag, ignored", "lag, known")
    )
    assert known.way_cross < 0.2 * ignored.way_cross


def test_prices_are_relative_to_the_longest_budget_and_impossible_cases_do_not_count():
    module = study("04")
    first, last = module.BUDGETS[0], module.BUDGETS[-1]
    rows = [module.Row("hall", 0, first, "certified", 12.0, 5.0), module.Row("hall", 0, last, "certified", 10.0, 50.0)]
    rows += [
        module.Row("hall", 1, first, "timed out", None, 5.0),
        module.Row("hall", 1, last, "impossible", None, 50.0),
    ]
    assert module.ratios(rows, first) == [1.2]
    assert module.certified_share(rows, first) == 1.0
    rows += [module.Row("hall", 2, first, "timed out", None, 5.0), module.Row("hall", 2, last, "certified", 9.0, 50.0)]
    assert module.certified_share(rows, first) == 0.5


def test_refuted_plan_is_reported():
    module = study("06")
    row = module.Row("slots", "parallel 1.2", "a", "certified", cusps=3, duration=10.0, first=100.0, cpu=200.0)
    assert module.report([row]).is_sound
    assert not module.report([row, row._replace(is_refuted=True)]).is_sound


def test_shares_of_surveys_add_up():
    module = study("09")
    row = module.Row("hall", 10, 7, 2, 1, 0.9, 5.0, 8.0, 4, 1.0)
    assert module.totals([row, row]) == (14, 4, 2)
    assert "Of 20 free start poses within 3 m of 2 docks, 70.0 %" in module.report([row, row]).closing


def test_sizes_of_a_scaling_scene_are_those_asked_for():
    module = study("07")
    rng = np.random.default_rng(1)
    problem = module.in_hall(10.0, 30, rng)
    assert len(problem.obstacles) == 30
    assert math.hypot(problem.start.x - problem.goal.x, problem.start.y - problem.goal.y) == pytest.approx(10.0)
    assert module.on_map(250, rng)[0].data.shape == (250, 250)
