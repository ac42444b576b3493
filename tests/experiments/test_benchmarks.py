import json
import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.pose import Pose2
from optdock.model.path import ClothoidSegment
from optdock.model.path import Path as DrivenPath
from optdock.verification.visibility import prove_view

ROOT = Path(__file__).resolve().parents[2]


class Done(NamedTuple):
    returncode: int
    stdout: str
    stderr: str


@pytest.fixture
def run(capsys, monkeypatch):
    """Run the benchmarks in this process."""
    monkeypatch.syspath_prepend(str(ROOT))
    from experiments.benchmarks import __main__ as benchmarks

    for name in benchmarks.THREAD_VARIABLES:
        monkeypatch.setenv(name, "1")

    def running(*arguments):
        try:
            status = benchmarks.run(list(arguments))
        except SystemExit as stop:
            status = stop.code
        return Done(status, *capsys.readouterr())

    return running


def test_smoothing_benchmark_counts(run, tmp_path):
    out = tmp_path / "smoothing.json"
    small = ("--seeds", "1", "--repeats", "1", "--calls", "2", "--budgets", "50,100")
    done = run("smoothing", *small, "--families", "open_s,start_collision", "--out", str(out))
    assert done.returncode == 0, done.stderr
    tables = {table["title"]: table["rows"] for table in json.loads(out.read_text())["tables"]}
    (verdict,) = tables["Smoothing, infeasible families: verdicts"]
    assert (verdict["right"], verdict["of"]) == (1, 1)
    (solved,) = tables["Smoothing, feasible families"]
    assert (solved["certified"], solved["of"], solved["false"]) == (1, 1, 0)
    (again,) = tables["Warm re-smooth"]
    assert again["warm certified"] == 1
    assert [row["calls"] for row in tables["Hard time budgets"]] == [1, 1]
    compared = {row["smoother"]: row for row in tables["Smoothers compared on the same raw paths"]}
    assert compared["raw"]["over curvature"] == 1
    assert compared["raw"]["certified"] == 0
    assert compared["CasadiSmoother"]["certified"] == 1
    assert "Hard time budgets" in done.stdout


def test_the_benchmark_of_terms_times_every_set(run):
    done = run("terms", "--families", "open_s", "--seeds", "1", "--repeats", "1")
    assert done.returncode == 0, done.stderr
    assert [line.split("  ")[0] for line in done.stdout.splitlines() if line.startswith(("none", "hard", "soft"))] == [
        "none",
        "hard: plane",
        "hard: curvature",
        "hard: disc",
        "soft: floor",
        "soft: wave",
    ]


def test_certificate_and_first_call_benchmarks(run):
    done = run("certificate", "--seeds", "1")
    assert done.returncode == 0, done.stderr
    assert "reverse_alcove" in done.stdout
    assert len([line for line in done.stdout.splitlines() if line.startswith("clutter ")]) == 1
    done = run("first_call", "--processes", "1", "--families", "open_s")
    assert done.returncode == 0, done.stderr
    first, _, later = (float(word) for word in done.stdout.splitlines()[-1].split()[-3:])
    assert min(first, later) > 0.0


def test_view_benchmark(run):
    done = run("views", "--count", "2")
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1].split()[:2] == ["all", "2"]


def test_visibility_by_bearings_agrees_with_the_certificate():
    from experiments.benchmarks.views import seeing, sees, starts

    _, problem = next(starts(1, 11))
    wanted, goal = seeing(problem, 60.0, 1.5), problem.goal
    for turn, expected in ((0.0, True), (0.2, True), (0.7, False)):
        line = ClothoidSpline(goal @ Pose2(-1.5, 0.0, turn), np.array([0.0, 0.5]), np.zeros(2))
        path = DrivenPath((ClothoidSegment(line),))
        assert sees(path, problem, 60.0, 1.5) is expected
        assert bool(prove_view(path, wanted)) is expected


def test_deadline_benchmark_with_a_busy_process(run):
    done = run("deadlines", "--calls", "3", "--seeds", "1", "--busy", "1")
    assert done.returncode == 0, done.stderr
    rows = [line.split() for line in done.stdout.splitlines()[-4:]]
    assert [row[:2] for row in rows] == [["10", "3"], ["20", "3"], ["50", "3"], ["100", "3"]]
    assert all(sum(map(int, row[2:5])) == 3 for row in rows)  # certified, timed out, refused
    assert "1 busy processes" in done.stdout


def test_late_calls_are_measured_again(run):
    done = run("deadlines", "--among-walls", "--cpu-clock", "--calls", "2", "--budgets", "0.001")
    assert done.returncode == 0, done.stderr
    row = done.stdout.splitlines()[-1].split()
    assert row[:3] == ["1", "2", "0"]
    assert int(row[11]) <= int(row[10]) <= 2  # late again, late


@pytest.mark.parametrize("wrong", [("nosuch",), ("smoothing", "timing", "--seeds", "1")])
def test_unknown_names_are_refused_with_the_known_ones(run, wrong):
    done = run(*wrong)
    assert done.returncode == 2
    assert "smoothing" in done.stderr


def test_unknown_families_are_refused_with_the_known_ones(run):
    done = run("smoothing", "--families", "alcove,nosuch")
    assert done.returncode == 2
    assert "unknown nosuch; known: open_s" in done.stderr


def test_percentiles_and_tables(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT))
    from experiments.benchmarks.tables import Table, percentile

    values = [3.0, 1.0, math.nan, 2.0, 4.0]
    assert [percentile(values, share) for share in (0, 50, 51, 100)] == [1.0, 2.0, 3.0, 4.0]
    assert math.isnan(percentile([math.nan], 50))
    lines = str(Table("A title", ("name", "n"), (("first", 1.23456), ("second", math.nan)), "note")).splitlines()
    assert lines[1:3] == ["## A title", "note"]
    assert [line.split()[-1] for line in lines[-2:]] == ["1.23", "-"]


def test_survey_benchmark(run, tmp_path, capsys):
    """A sample of a small survey; a verdict that is made up is refuted."""
    from experiments.benchmarks import survey as benchmark
    from optdock.runner import Workers
    from optdock.survey.grid import Box
    from optdock.survey.rounds import CellState
    from optdock.survey.survey import SurveySettings, docks_of, run_survey
    from tests.optdock.survey.scenes import box, scenario

    given = scenario(box(1.9, 0, 2.1, 3))
    settings = SurveySettings(region=Box(1.5, 1.25, 2.5, 1.75), resolution=0.25, headings=2, time_budget=0.1)
    with Workers(1, clock="counted", prepare=None) as workers:
        (found,) = run_survey(list(docks_of("r", given, [("d", given.problem.goal)])), settings, tmp_path, workers)
    done = run("survey", "--folder", str(tmp_path), "--sample", "8", "--jobs", "1")
    assert done.returncode == 0, done.stdout
    assert "refuted: 0 impossible cells with a plan, 0 answers whose plan file differs,\nof 8 (" in done.stdout
    cell = int(np.flatnonzero(found.answers.verdict == CellState.IMPOSSIBLE)[0])
    results = {"alone": [{"verdict": "CERTIFIED", "seconds": 9.0}], "opened": [benchmark.opened(found, cell)]}
    assert benchmark.report(found, [cell], results, {"alone": 1.0}, 1) == 1
    assert "refuted: 1 impossible cells with a plan" in capsys.readouterr().out
