"""`optdock survey`."""

import json
import math
import shutil
import sys

import pytest
from typer.testing import CliRunner

from optdock.cli import app

pytestmark = pytest.mark.usefixtures("coarse_pictures")
SCENARIO = """format: optdock-scenario/1
robot:
  footprint: [[0.15, 0.15], [-0.15, 0.15], [-0.15, -0.15], [0.15, -0.15]]
  limits: {max_curvature: 4.0, max_curvature_rate: 30.0}
dock: {pose: [3.0, 0.5, 0.0], final_straight: 0.2, approach_speed: 0.1, approach_distance: 0.2}
start: {pose: [0.0, 0.0, 0.2]}
"""
ROOM = ((1.0, -1.0, 1.2, 2.0), (3.4, -1.0, 3.6, 2.0), (1.0, -1.2, 3.6, -1.0), (1.0, 2.0, 3.6, 2.2))
WALL = f"obstacles: {[[[a, b], [c, b], [c, d], [a, d]] for a, b, c, d in ROOM]}\n"
SMALL = ("--region", "0.5,0.25,2.0,0.75", "--resolution", 0.25, "--headings", 2, "--time-budget", 0.1, "--jobs", 1)
DOCKS = """docks:
  "left/1": {type: simple, frame: map, pose: [3.0, 0.5, 0.0]}
  right: {type: simple, frame: map, pose: [3.0, 0.0, 0.0]}
"""


def run(*arguments):
    return CliRunner().invoke(app, ["survey", *map(str, arguments)])


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Two scenarios and a dock database."""
    made = tmp_path_factory.mktemp("scenarios")
    (made / "free.yaml").write_text(SCENARIO)
    (made / "wall.yaml").write_text(SCENARIO + WALL)
    (made / "docks.yaml").write_text(DOCKS)
    return made


@pytest.fixture(scope="module")
def finished(folder):
    """Folder of a survey of both scenarios, and its result."""
    out = folder / "both"
    return out, run(folder / "free.yaml", folder / "wall.yaml", "--out", out, *SMALL)


def test_two_robots_are_compared(finished):
    out, result = finished
    assert result.exit_code == 0, result.output
    free, wall, heads, *rows, end = result.stdout.splitlines()
    assert free.startswith("free, dock: certified from 100.0 % of 42 free start poses, in ")
    assert wall.startswith("wall, dock: certified from ")
    assert "impossible from " in wall
    assert heads.split()[:3] == ["dock", "certified", "%"]
    assert [row.split()[0] for row in rows] == ["free/dock", "wall/dock"]
    assert end == f"survey.parquet, survey.json and pictures are in {out}"
    files = {file.name for file in out.iterdir()}
    assert files == {"outcomes.jsonl", "survey.json", "survey.parquet"} | {
        f"{name}_dock.{suffix}" for name in ("free", "wall") for suffix in ("png", "yaml")
    }


@pytest.mark.parametrize(
    ("dock", "cell", "status", "told"),
    [
        ("free/dock", "1.0,0.5,0", 0, "certified"),
        ("free/dock", "1.01,0.45,0.3", 0, "certified"),
        ("wall/dock", "0.5,0.5,0", 4, "NoMotionExists"),
        ("wall/dock", "1.0,0.5,0", 3, "StartOccupied"),
    ],
)
def test_a_cell_opens_as_a_plan_file_that_certify_judges_alike(finished, tmp_path, dock, cell, status, told):
    out, _ = finished
    target = tmp_path / "cell.json"
    result = run(out, "--dock", dock, "--cell", cell, "--plan", target)
    assert result.exit_code == status, result.output
    assert json.loads(target.read_text())["status"] == told
    if status != 3:
        judged = CliRunner().invoke(app, ["certify", str(target), str(tmp_path / "cell.yaml")])
        assert judged.exit_code == status, judged.output


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--dock", "free/dock", "--cell", "5,5,0"), "--cell: 5,5,0 is outside the surveyed region"),
        (("--dock", "free/dock", "--cell", "1e300,0,1e300"), "is outside the surveyed region"),
        (("--dock", "free/dock", "--cell", "1,2"), "--cell: must be 3 numbers separated by commas, got '1,2'"),
        (("--dock", "free/dock", "--cell", "1,2,nan"), "--cell: must be 3 numbers"),
        (("--dock", "dock", "--cell", "1,0.5,0"), "dock: must be one of free/dock, wall/dock, got dock"),
        (("--dock", "none", "--cell", "1,0.5,0"), "dock: must be one of free/dock, wall/dock, got none"),
        (("--cell", "1,0.5,0", "--plan", "cell.yaml"), "cell.yaml: is given twice"),
    ],
)
def test_bad_requests_of_cells(finished, tmp_path, monkeypatch, options, message):
    out, _ = finished
    monkeypatch.chdir(tmp_path)
    result = run(out, *options)
    assert result.exit_code == 2, result.output
    assert message in " ".join(result.stderr.split())
    assert list(tmp_path.iterdir()) == []


def test_a_plan_does_not_overwrite_files_of_the_survey(finished):
    """The scenario of the plan would get the name of the scenario of the dock."""
    out, _ = finished
    before = {file.name: file.read_bytes() for file in out.iterdir()}
    for name in ("free_dock.json", "survey.json"):
        result = run(out, "--dock", "free/dock", "--cell", "1,0.5,0", "--plan", out / name)
        assert result.exit_code == 2, result.output
    assert {file.name: file.read_bytes() for file in out.iterdir()} == before


def test_docks_of_a_database(folder, tmp_path):
    region = ("--region", "0.75,0.25,1.25,0.75", *SMALL[2:])
    result = run(folder / "free.yaml", "--docks", folder / "docks.yaml", "--out", tmp_path / "out", *region)
    assert result.exit_code == 0, result.output
    rows = json.loads((tmp_path / "out" / "survey.json").read_text())["docks"]
    assert {row["dock"]: row["pose"] for row in rows} == {"left/1": [3.0, 0.5, 0.0], "right": [3.0, 0.0, 0.0]}
    opened = run(tmp_path / "out", "--dock", "left/1", "--cell", "1,0.5,0", "--plan", tmp_path / "cell.json")
    assert opened.exit_code == 0, opened.output


def test_docks_along_walls_in_a_region(folder, tmp_path):
    """The front of the docked robot is 12 mm from the wall."""
    region = ("--region", "1.2,-0.5,2.5,0.75", *SMALL[2:])
    result = run(folder / "wall.yaml", "--along-walls", 6, "--out", tmp_path, *region)
    assert result.exit_code == 0, result.output
    (row,) = json.loads((tmp_path / "survey.json").read_text())["docks"]
    assert row["pose"][:2] == pytest.approx([1.2 + 0.15 + 0.012, 0.5], abs=1e-3)
    assert abs(row["pose"][2]) == pytest.approx(math.pi)


@pytest.mark.parametrize(
    ("files", "options", "message"),
    [
        (("free.yaml",), ("--region", "1,2,3"), "--region: must be 4 numbers separated by commas, got '1,2,3'"),
        (("free.yaml",), ("--region", "1,1,0,2"), "survey.region: must be left, lower, right, upper in this order"),
        (("free.yaml",), ("--resolution", "nan"), "survey.resolution: must be > 0 m, got nan"),
        (("free.yaml",), ("--headings", "0"), "survey.headings: must be >= 1, got 0"),
        (("free.yaml",), ("--within", "0"), "survey.within: must be finite and > 0 m, got 0.0"),
        (("free.yaml",), ("--time-budget", "0"), "survey.time_budget: must be finite and > 0 s, got 0.0"),
        (("free.yaml",), ("--along-walls", "0"), "along walls: the spacing must be > 0 m, got 0.0"),
        (("free.yaml",), ("--along-walls", "1"), "survey: there is no dock"),
        (("free.yaml",), ("--along-walls", "1", "--docks", "docks.yaml"), "give either --docks or --along-walls"),
        (("free.yaml",), ("--docks", "other.yaml"), "other.yaml: a: frame: must be map, got odom"),
        (("free.yaml",), ("--docks", "none.yaml"), "none.yaml"),
        (("free.yaml", "sub/free.yaml"), (), "the scenario files must have different names"),
        (("none.yaml",), (), "none.yaml"),
        (("free.yaml", "wall.yaml"), ("--cell", "1,1,0"), "--cell needs one folder of a survey"),
        (("free.yaml",), ("--jobs", "2", "--scheduler", "tcp://127.0.0.1:9"), "not given with a scheduler"),
        (("free.yaml",), ("--out", "free.yaml"), "free.yaml"),
    ],
)
def test_bad_input_ends_with_status_2_and_no_files(folder, tmp_path, monkeypatch, files, options, message):
    monkeypatch.chdir(tmp_path)
    for name in ("free.yaml", "wall.yaml", "docks.yaml"):
        shutil.copy(folder / name, name)
    (tmp_path / "other.yaml").write_text("docks: {a: {type: simple, frame: odom, pose: [1, 0, 0]}}\n")
    (tmp_path / "sub").mkdir()
    shutil.copy("free.yaml", "sub/free.yaml")
    result = run(*files, *options)
    assert result.exit_code == 2, result.output
    assert message in " ".join(result.stderr.split())
    assert not (tmp_path / "survey").exists()


@pytest.mark.parametrize(("module", "extra"), [("pyarrow", "survey"), ("matplotlib", "plot")])
def test_a_missing_extra_ends_with_status_2_before_the_survey(folder, tmp_path, monkeypatch, module, extra):
    for name in [name for name in sys.modules if name.partition(".")[0] == module]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, module, None)
    result = run(folder / "free.yaml", "--out", tmp_path / "out", *SMALL)
    assert result.exit_code == 2, result.output
    assert f"optdock[{extra}]" in result.stderr
    assert not (tmp_path / "out").exists()
