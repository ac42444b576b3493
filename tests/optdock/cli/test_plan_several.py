"""`optdock plan` with several scenarios."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from optdock.cli import app

SCENARIO = """format: optdock-scenario/1
robot:
  footprint: [[0.3, 0.25], [-0.3, 0.25], [-0.3, -0.25], [0.3, -0.25]]
dock: {pose: [3.0, 0.5, 0.0]}
start: {pose: [0.0, 0.0, 0.2]}
"""
WALL = "obstacles: [[[1.0, -9.0], [1.2, -9.0], [1.2, 9.0], [1.0, 9.0]]]\n"


@pytest.fixture
def scenarios(tmp_path):
    """A free floor, a floor with an obstacle at the start, and a second file with the name of the first one."""
    texts = {
        "free.yaml": SCENARIO,
        "occupied.yaml": SCENARIO + WALL.replace("1.0,", "0.1,"),
        "free.yml": SCENARIO,
    }
    for name, text in texts.items():
        (tmp_path / name).write_text(text)
    return [str(tmp_path / name) for name in texts]


def planned(*arguments):
    return CliRunner().invoke(app, ["plan", *map(str, arguments)])


@pytest.mark.parametrize("jobs", [1, 2])
def test_every_scenario_has_a_plan_file_and_a_row(scenarios, tmp_path, jobs):
    """The exit status is the highest one; the reason of a failure is on stderr."""
    out = tmp_path / "plans"
    result = planned(*scenarios[:2], "--out", out, "--jobs", jobs)
    assert result.exit_code == 3, result.output
    heads, free, occupied, end = result.stdout.splitlines()
    assert heads.split()[:2] == ["scenario", "status"]
    assert free.split()[:2] == ["free", "certified"]
    assert occupied.split() == ["occupied", "StartOccupied"]
    assert end == f"plan files are in {out}"
    assert "occupied: StartOccupied: " in result.stderr
    files = {file.stem: json.loads(file.read_text()) for file in out.iterdir()}
    assert {name: file["status"] for name, file in files.items()} == {"free": "certified", "occupied": "StartOccupied"}
    judged = CliRunner().invoke(app, ["certify", str(out / "free.json"), scenarios[0]])
    assert judged.exit_code == 0, judged.output


def test_options_decide_about_each_plan(scenarios, tmp_path):
    coarse = tmp_path / "coarse"
    Path(scenarios[1]).write_text(SCENARIO)
    assert planned(*scenarios[:2], "--out", coarse, "--jobs", 1, "--spacing", 0.5).exit_code == 0
    assert all(len(json.loads(file.read_text())["path"]["s"]) < 12 for file in coarse.iterdir())
    result = planned(*scenarios[:2], "--out", coarse, "--jobs", 1, "--time-budget", 1e-6)
    assert result.exit_code == 5
    assert {json.loads(file.read_text())["status"] for file in coarse.iterdir()} <= {"PlannerTimedOut", "TimedOut"}


@pytest.mark.parametrize(
    ("given", "options", "message"),
    [
        ((0, 1), (), "--out: several scenarios need a folder"),
        ((0, 2), ("--out", "plans"), r"free.json: is given twice"),
        ((0, 1), ("--out", "plans", "--plot", "a.png"), "need a single scenario"),
        ((0, 1), ("--out", "plans", "--map", "a.yaml"), "need a single scenario"),
        ((0, 1), ("--out", "plans", "--jobs", "2", "--scheduler", "tcp://127.0.0.1:9"), "not given with a scheduler"),
    ],
)
def test_contradictions_end_with_status_2_before_planning(scenarios, tmp_path, monkeypatch, given, options, message):
    monkeypatch.chdir(tmp_path)
    result = planned(*(scenarios[k] for k in given), *options)
    assert result.exit_code == 2, result.output
    assert message in " ".join(result.stderr.split())
    assert not Path("plans").exists()


def test_a_broken_scenario_ends_the_command_before_planning(scenarios, tmp_path):
    Path(scenarios[1]).write_text("format: optdock-scenario/1\n")
    result = planned(*scenarios[:2], "--out", tmp_path / "plans")
    assert result.exit_code == 2
    assert "occupied.yaml" in result.stderr
    assert not (tmp_path / "plans").exists()
