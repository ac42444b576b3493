"""Surveys in a folder: workers, resuming, the table, the summary, names of files."""

import dataclasses
import json
import math
import sys

import numpy as np
import pytest

from optdock.config import load_scenario
from optdock.errors import InvalidFile, InvalidValue, MissingExtra
from optdock.geometry.pose import Pose2
from optdock.runner import Workers
from optdock.survey.dock_places import DockPlace
from optdock.survey.grid import Box
from optdock.survey.rounds import CellState
from optdock.survey.summary import _percent
from optdock.survey.survey import SurveySettings, docks_of, file_stems, open_survey, run_survey
from optdock.survey.table import columns_of
from tests.optdock.runner.test_runner import Cluster
from tests.optdock.survey.scenes import BACK_STATION, box, scenario

# Cells of 0.5 m: the survey of the room has answers of every method.
SETTINGS = SurveySettings(within=2.1, resolution=0.5, headings=2, time_budget=0.1)
GIVEN = scenario(box(1.9, 0, 2.1, 3))


def docks(given=GIVEN, names=("dock",)):
    return list(docks_of("robot", given, [DockPlace(name, given.problem.goal) for name in names]))


def one_process():
    return Workers(1, clock="counted", prepare=None)


def surveyed(folder, workers=None, given=GIVEN, settings=SETTINGS, names=("dock",)):
    with workers or one_process() as running:
        return run_survey(docks(given, names), settings, folder, running)


def same(left, right):
    """Whether two answers agree in everything but CPU time."""
    return all(
        np.array_equal(getattr(left, name), getattr(right, name), equal_nan=name in {"seconds", "start", "place"})
        for name in ("verdict", "method", "seconds", "stops", "source", "place", "start")
    ) and (left.asked, left.proofs) == (right.asked, right.proofs)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Folder and answers of a survey of two docks at the same place."""
    folder = tmp_path_factory.mktemp("whole")
    return folder, surveyed(folder)[0]


def table_of(folder):
    parquet = pytest.importorskip("pyarrow.parquet")
    return parquet.read_table(folder / "survey.parquet").to_pydict()


def test_rows_do_not_depend_on_the_workers(whole, tmp_path):
    folder, found = whole
    pytest.importorskip("distributed")
    cluster = Cluster(tmp_path)
    try:
        cluster.add_workers(1)
        for name, workers in (("two", Workers(2, clock="counted", prepare=None)), ("tcp", cluster.workers())):
            (other,) = surveyed(tmp_path / name, workers)
            assert same(other.answers, found.answers), name
            assert repr(table_of(tmp_path / name)) == repr(table_of(folder))
    finally:
        for process in cluster.processes:
            process.kill()
            process.wait()


@pytest.mark.parametrize("share", [0.0, 0.3, 0.8])
def test_a_killed_survey_continues_with_the_same_rows(whole, tmp_path, share):
    """The last line of the killed run is not complete."""
    folder, found = whole
    lines = (folder / "outcomes.jsonl").read_bytes().splitlines(keepends=True)
    kept = 1 + int(share * (len(lines) - 1))
    (tmp_path / "outcomes.jsonl").write_bytes(b"".join(lines[:kept]) + lines[kept][:20])
    (other,) = surveyed(tmp_path)
    assert same(other.answers, found.answers)
    assert repr(table_of(tmp_path)) == repr(table_of(folder))


def test_another_task_does_not_continue_a_survey(whole):
    folder, _ = whole
    before = sorted(folder.iterdir())
    with pytest.raises(InvalidFile, match="another task"):
        surveyed(folder, settings=dataclasses.replace(SETTINGS, time_budget=0.2))
    assert sorted(folder.iterdir()) == before


def test_a_survey_is_opened_with_the_same_answers(whole, tmp_path):
    folder, found = whole
    for name in (None, "dock", "robot/dock"):
        assert same(open_survey(folder, name).answers, found.answers)
    with pytest.raises(InvalidValue, match="dock: must be one of robot/dock, got other"):
        open_survey(folder, "other")
    with pytest.raises(InvalidFile, match=r"survey\.json"):
        open_survey(tmp_path)
    for text in ("[]", '{"format": "optdock-survey/9"}', '{"format": "optdock-survey/1", "docks": [{}]}'):
        (tmp_path / "survey.json").write_text(text)
        with pytest.raises(InvalidFile, match=r"survey\.json: (format: must be|is damaged)"):
            open_survey(tmp_path)


def test_a_survey_with_a_missing_outcome_is_not_finished(whole, tmp_path):
    folder, _ = whole
    for file in folder.iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    lines = (folder / "outcomes.jsonl").read_bytes().splitlines(keepends=True)
    (tmp_path / "outcomes.jsonl").write_bytes(b"".join(lines[:-1]))
    with pytest.raises(InvalidFile, match="the survey is not finished"):
        open_survey(tmp_path)


def test_the_columns_are_the_answers(whole):
    folder, found = whole
    answers, table = found.answers, table_of(folder)
    assert {"measured", "proven", "planned", "inherited", "deformed"} <= set(answers.method)
    rows = np.flatnonzero(answers.verdict > CellState.UNKNOWN)
    assert set(table["robot"]) == {"robot"}
    assert set(table["dock"]) == {"dock"}
    assert np.array_equal(np.column_stack([table[name] for name in ("x", "y", "yaw")]), answers.grid.poses(rows))
    assert [CellState[name.upper()] for name in table["verdict"]] == answers.verdict[rows].tolist()
    assert table["answer"] == answers.method[rows].tolist()
    assert np.array_equal(table["seconds"], answers.seconds[rows], equal_nan=True)
    for row, (verdict, seconds, cusps) in enumerate(
        zip(table["verdict"], table["seconds"], table["cusps"], strict=True)
    ):
        assert math.isfinite(seconds) == (verdict == "certified")
        assert (cusps >= 0) == (verdict == "certified")
        assert (table["reason"][row] != "") == (verdict == "impossible")
        source = table["source"][row]
        assert (source < 0) == (verdict == "occupied")
        if verdict != "occupied":
            assert rows[source] == answers.source[rows[row]]
        start = [table[name][row] for name in ("start_x", "start_y", "start_yaw")]
        assert np.array_equal(start, answers.start[rows[row]])


def test_the_numbers_of_the_summary_are_those_of_the_table(whole):
    folder, found = whole
    document, table = json.loads((folder / "survey.json").read_text()), table_of(folder)
    (row,) = document["docks"]
    verdicts = np.array(table["verdict"])
    for name in ("certified", "impossible", "not_found"):
        assert row[name] == (verdicts == name).sum()
    free = verdicts != "occupied"
    assert row["free"] == free.sum()
    assert row["share"] == row["certified"] / row["free"]
    seconds = np.array(table["seconds"])[verdicts == "certified"]
    assert (row["p50"], row["p95"]) == tuple(np.quantile(seconds, (0.5, 0.95)))
    places = set(zip(np.array(table["x"])[free], np.array(table["y"])[free], strict=True))
    is_certified = verdicts == "certified"
    reached = set(zip(np.array(table["x"])[is_certified], np.array(table["y"])[is_certified], strict=True))
    assert row["floor"] == len(reached) / len(places)
    assert sum(row["answers"].values()) == row["free"]
    assert row["asked"] == len(found.answers.asked)
    assert row["sentence"] == str(found.summary)
    assert f"certified from {100 * row['share']:.1f} % of {row['free']} free start poses" in row["sentence"]
    assert f"impossible from {100 * row['impossible'] / row['free']:.1f} %: " in row["sentence"]


@pytest.mark.parametrize(
    ("share", "text"),
    [
        (1.0, "100.0 %"), (0.99951, "more than 99.9 %"), (1.0 - 1e-9, "more than 99.9 %"), (0.9994, "99.9 %"),
        (0.0, "0.0 %"), (1e-9, "less than 0.1 %"), (0.0006, "0.1 %"),
    ],
)  # fmt: skip
def test_only_all_cells_are_100_percent(share, text):
    assert _percent(share) == text


def test_the_sentence_without_motions(whole):
    _, found = whole
    changed = dataclasses.replace(found.summary, certified=0, impossible=0, not_found=60, free=60, reasons=())
    assert str(changed) == (
        "robot, dock: certified from 0.0 % of 60 free start poses; not found from 100.0 %, without a proof"
    )
    mixed = dataclasses.replace(changed, impossible=20, not_found=40, reasons=(("slow", 40), ("a gap", 20)))
    assert str(dataclasses.replace(mixed, obstruction="a gap")).endswith(
        "not found from 66.7 %, without a proof; impossible from 33.3 %: a gap"
    )
    assert str(dataclasses.replace(changed, free=0)) == "robot, dock: no free start pose in the region"


STRANGE = ("a/b", "a b", "a_b", "../x", "..", "", "A b", 'quote"', "ä", "x" * 300, "x" * 299 + "y", "a\nb", "-2")


def test_names_of_files_stay_in_the_folder_and_differ():
    places = [DockPlace(name, GIVEN.problem.goal) for name in STRANGE]
    found = file_stems([*docks_of("r", GIVEN, places), *docks_of("r_a", GIVEN, [DockPlace("b", GIVEN.problem.goal)])])
    assert len(found) == len(STRANGE) + 1
    stems = list(found.values())
    assert len({stem.casefold() for stem in stems}) == len(stems)
    assert all(not set(stem) & set('/\\"\n: ') and not stem.startswith(".") and len(stem) < 80 for stem in stems)


def test_docks_with_strange_names_are_written_and_opened(tmp_path):
    """The best dock is the first; every scenario begins in its dock."""
    out, settings = tmp_path / "out", dataclasses.replace(SETTINGS, region=Box(2.5, 1.25, 2.75, 1.5), resolution=0.25)
    found = surveyed(out, given=scenario(), settings=settings, names=("../x", "a/b", "a b"))
    assert [file.name for file in tmp_path.iterdir()] == ["out"]
    assert len(list(out.glob("*.yaml"))) == 3
    for one in found:
        again = open_survey(out, one.surveyed.dock)
        assert again.surveyed.dock == one.surveyed.dock
        assert same(again.answers, one.answers)
    files = json.loads((out / "survey.json").read_text())["scenarios"]
    for file in files.values():
        problem = load_scenario(out / file).problem
        assert problem.start == problem.goal


def test_docks_are_sorted_by_the_certified_share(tmp_path):
    """A dock in a closed part of the room is reached from nowhere."""
    given = scenario(box(3.0, 0.6, 3.1, 2.4), box(3.0, 0.6, 4, 0.7), box(3.0, 2.3, 4, 2.4))
    places = [DockPlace("closed", given.problem.goal), DockPlace("open", Pose2(1.5, 2.6, math.pi / 2))]
    settings = dataclasses.replace(SETTINGS, region=Box(1.0, 1.0, 1.5, 1.5), resolution=0.25)
    with one_process() as workers:
        found = run_survey(list(docks_of("robot", given, places)), settings, tmp_path, workers)
    assert [(one.surveyed.dock, one.summary.certified > 0) for one in found] == [("open", True), ("closed", False)]
    assert "impossible from 100.0 %" in str(found[1].summary)
    assert [row["dock"] for row in json.loads((tmp_path / "survey.json").read_text())["docks"]] == ["open", "closed"]


def test_one_robot_or_dock_twice_is_refused(tmp_path):
    with pytest.raises(InvalidValue, match="docks must have different names"):
        surveyed(tmp_path / "twice", names=("a", "a"))
    with pytest.raises(InvalidValue, match="there is no dock"):
        surveyed(tmp_path / "none", names=())


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"within": math.nan}, "survey.within: must be finite and > 0 m"),
        ({"within": -1.0}, "survey.within: must be finite and > 0 m"),
        ({"time_budget": 0.0}, "survey.time_budget: must be finite and > 0 s"),
        ({"time_budget": math.nan}, "survey.time_budget: must be finite and > 0 s"),
        ({"headings": 0}, "survey.headings"),
        ({"resolution": math.nan}, "survey.resolution"),
    ],
)
def test_wrong_settings_are_refused_before_any_file_is_written(tmp_path, changes, message):
    with pytest.raises(InvalidValue, match=message):
        surveyed(tmp_path / "out", settings=dataclasses.replace(SETTINGS, **changes))
    assert not (tmp_path / "out").exists()


def test_without_pyarrow_nothing_is_computed(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    monkeypatch.setitem(sys.modules, "pyarrow.parquet", None)
    with pytest.raises(MissingExtra, match=r"pip install 'optdock\[survey\]'"):
        surveyed(tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_backward_dock_is_surveyed(tmp_path):
    given = scenario(goal=Pose2(3.6, 1.5, math.pi), station=BACK_STATION, direction="backward")
    settings = dataclasses.replace(SETTINGS, region=Box(2.0, 1.25, 2.5, 1.75), resolution=0.25)
    (found,) = surveyed(tmp_path, given=given, settings=settings)
    assert found.summary.share == 1.0
    assert "certified from 100.0 % of" in str(found.summary)
    assert set(columns_of(found.answers)["verdict"]) == {"certified"}
