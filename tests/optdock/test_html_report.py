"""Reports: one file that loads nothing, with the numbers of the files and their names as text."""

import dataclasses
import json
import math
import re
import sys
from html.parser import HTMLParser
from statistics import NormalDist
from types import SimpleNamespace

import numpy as np
import pytest
from typer.testing import CliRunner

import optdock as od
from optdock.cli import app
from optdock.config.writing import problem_document
from optdock.errors import InvalidFile, InvalidValue, MissingExtra, NoMotionExists, OptdockError
from optdock.executor import DockingExecutor
from optdock.executor.log import LogWriter
from optdock.geometry.pose import Pose2
from optdock.io.plan_file import PlanError, PlanFile, load_plan, save_plan
from optdock.model.path import Direction
from optdock.reports.comparison import PathFigures, comparison_csv
from optdock.reports.html import check_bokeh, read_chapters, save_report
from optdock.reports.html import page as page_module
from optdock.reports.html.certificate_words import plan_texts
from optdock.reports.html.comparison_chapter import comparison_chapter
from optdock.reports.html.figures import PALETTE, swept_area
from optdock.reports.html.html_report import _counts
from optdock.reports.html.page import Chapter, Chart, Content, Player, Readout, Table
from optdock.reports.html.plan_chapter import _gears_in_words, clearance_chart, plan_chapter
from optdock.reports.html.survey_chapter import SurveyColumns, survey_chapter
from optdock.reports.plan_file_verdict import judge_plan_file
from optdock.reports.report import failed_plan_file, run_json
from optdock.simulation import Run

HOSTILE = "<script>alert(1)</script>&amp;\"'$$x$$.json"
SQUARE = [(-0.2, -0.2), (0.2, -0.2), (0.2, 0.2), (-0.2, 0.2)]  # around the start
LINKS = {"src", "href", "srcset", "data", "poster", "action", "xlink:href", "background"}


class Page(HTMLParser):
    """Text, links and JSON of a page."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.links, self.words, self.documents, self._inside = [], [], [], {}, None
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        known = dict(attrs)
        self.links += [value for name, value in attrs if name in LINKS]
        if tag == "script":
            self._inside = known.get("id") or known.get("class") or known.get("data-for") or "script"
        elif tag == "style":
            self._inside = "style"

    def handle_endtag(self, tag):
        if tag in ("script", "style"):
            self._inside = None

    def handle_data(self, data):
        if self._inside is None:
            self.words.append(data)
        else:
            self.documents.setdefault(self._inside, []).append(data)

    @property
    def numbers(self):
        return json.loads(self.documents["report-data"][0])

    @property
    def text(self):
        return " ".join(" ".join(self.words).split())


def read(path):
    return Page(path.read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def problem():
    limits = od.MotionLimits(max_curvature=1.5, max_curvature_rate=6.0, wheelbase=0.6)
    robot = od.Robot(od.Footprint.rectangle(0.45, 0.45, 0.6), limits)
    dock = od.Dock(od.Pose2(3.0, 0.3, 0.0), final_straight=0.3)
    return od.DockingProblem(
        od.Pose2(0.0, 0.0, 0.2), dock, robot, [[(1.0, 0.9), (2.0, 0.9), (1.5, 1.4)]], clearance=0.05
    )


@pytest.fixture(scope="module")
def files(problem, tmp_path_factory):
    """A plan, a refusal with a proof, a run, a comparison, and a log."""
    folder = tmp_path_factory.mktemp("files")
    plan = od.plan_dock(problem, time_budget=1.0)
    plan.save(folder / "plan.json")
    times = np.linspace(0.0, plan.trajectory.duration, 50)
    samples = plan.trajectory.sample_at(times)
    poses = np.column_stack((samples.x, samples.y, samples.yaw))
    off = poses + np.array([0.0, 0.004, 0.0])
    twists = np.column_stack((samples.speed, samples.yaw_rate))
    run = Run(times, off, poses, twists, twists, poses, problem.goal, docked=True, min_clearance=0.25)
    (folder / "run.json").write_text(run_json(run, 0))
    wall = [[(-1.0, -1.0), (4.0, -1.0), (4.0, -0.9), (-1.0, -0.9)], [(1.5, -1.0), (1.6, -1.0), (1.6, 3.0), (1.5, 3.0)]]
    wall += [[(-1.0, 3.0), (4.0, 3.0), (4.0, 3.1), (-1.0, 3.1)], [(4.0, -1.0), (4.1, -1.0), (4.1, 3.1), (4.0, 3.1)]]
    closed = dataclasses.replace(problem, obstacles=od.ObstacleSet.from_polygons(wall))
    with pytest.raises(OptdockError) as refused:
        od.plan_dock(closed, time_budget=2.0)
    save_plan(folder / "refused.json", failed_plan_file(refused.value, "map"))
    rows = [
        PathFigures("bay", "raw", "not certified", 6.0, 9.0, 3.0, -0.1),
        PathFigures("bay", "smoothed", "certified", 6.1),
    ]
    (folder / "comparison.csv").write_text(comparison_csv(rows))
    return folder, closed


@pytest.fixture(scope="module")
def log(problem, tmp_path_factory):
    """The log of three cycles of a task that is cancelled."""
    path = tmp_path_factory.mktemp("log") / "dock.log"
    from optdock.model.measurements import Detection, Measurements

    with LogWriter(path) as writer:
        executor = DockingExecutor(problem, log=writer)
        seen = Detection(0.0, Pose2(3.0, 0.3, 0.0), 0.01, 0.01)
        for i in range(8):
            if i == 3:
                executor.cancel()
            executor.step(Measurements(0.1 * i, Pose2(0.01 * i, 0.0, 0.0), detections=(seen._replace(stamp=0.1 * i),)))
            if executor.ending is not None:
                break
    return path


@pytest.fixture(scope="module")
def pages(files, log, problem, tmp_path_factory):
    """Every kind of file in one page, and the parsed page."""
    folder, _ = files
    target = tmp_path_factory.mktemp("page") / "report.html"
    sources = [folder / "plan.json", folder / "run.json", log, folder / "comparison.csv"]
    save_report(target, "All kinds", read_chapters(sources, [problem]))
    return target, read(target)


def test_a_page_loads_nothing(pages):
    target, page = pages
    assert target.stat().st_size < 5_000_000
    assert all(link.startswith("#") for link in page.links)
    assert "link" not in page.tags
    assert "img" not in page.tags
    assert not re.search(r"@import|url\(\s*['\"]?http", "".join(page.documents["style"]))
    assert "default-src 'none'" in target.read_text(encoding="utf-8")


def test_a_link_to_the_network_is_found():
    assert Page('<img src="https://example.org/a.png">').links == ["https://example.org/a.png"]


def test_the_numbers_are_those_of_the_files(pages, files):
    folder, _ = files
    found = {one["name"]: one for one in pages[1].numbers["files"]}
    plan = json.loads((folder / "plan.json").read_text())
    for key in ("status", "completed", "frame", "certificate", "tried", "timing_ms"):
        assert found["plan.json"][key] == plan[key], key
    run = json.loads((folder / "run.json").read_text())
    for key in ("docked", "reason", "final_error", "min_clearance", "goal_checkers"):
        assert found["run.json"][key] == run[key], key
    assert found["comparison.csv"]["rows"][0]["length_m"] == "6"
    (motion, *_) = [json.loads(one) for one in pages[1].documents["motion"] if '"speed"' in one and "jerk" in one]
    columns = plan["trajectory"]
    rows = [columns["t"].index(at) for at in motion["at"]]
    assert rows[0] == 0
    assert rows[-1] == len(columns["t"]) - 1
    assert motion["poses"] == [[columns[name][row] for name in ("x", "y", "yaw")] for row in rows]


def test_the_words_of_a_plan_repeat_its_certificate(pages, files):
    certificate = json.loads((files[0] / "plan.json").read_text())["certificate"]
    text = pages[1].text
    assert f"at least {certificate['min_clearance']:.4f} m from every obstacle" in text
    assert f"exceeds the required one by at least {certificate['margin']:.4f} m" in text
    assert f"length {certificate['length']:.6f} m" in text
    assert "Steering angle" in text
    assert "verdict certified" in text
    assert "no tracking tube" in text
    assert "Perception" in text


def test_a_run_is_compared_with_the_plan_that_it_drove(pages):
    assert "Deviation from the path" in pages[1].text
    assert "largest displacement from the path 4.00 mm" in pages[1].text
    assert "across from 3." in pages[1].text or "across from 4.000" in pages[1].text


def test_a_log_shows_its_states_and_ending(pages):
    text = pages[1].text
    assert "dock.log cancelled" in text
    assert "States and events" in text
    assert "error code 0" in text


def test_files_without_a_scene_and_refusals(files, tmp_path):
    folder, closed = files
    alone = read_chapters([folder / "plan.json", folder / "run.json"])
    assert all(any(isinstance(block, Chart) for block in chapter.content().blocks) for chapter in alone)
    save_report(tmp_path / "refused.html", "Refused", read_chapters([folder / "refused.json"], [closed]))
    text = read(tmp_path / "refused.html").text
    assert "impossible, proven" in text
    assert "No motion joins start and goal" in text
    assert "enclosed area around the" in text
    assert "refuted" not in text


@pytest.mark.parametrize(
    ("gears", "words"),
    [
        ([1, 1], "forward"),
        ([-1, 1, 1, -1, -1], "3 gears: reverse, forward, reverse"),
        ([1, 0, 0, -1], "3 parts: forward, turn in place, reverse"),
    ],
)
def test_successive_segments_in_one_gear_are_stated_once(gears, words):
    segments = [SimpleNamespace(direction=Direction(gear)) for gear in gears]
    assert _gears_in_words(SimpleNamespace(segments=segments)) == words


def test_claims_are_not_called_proven_without_a_check(files, problem):
    plan = load_plan(files[0] / "plan.json")
    unchecked = plan_chapter("plan.json", plan)
    titles = [block.title for block in unchecked.content().blocks]
    assert "Proven, as the file states; not checked for this report" in titles
    assert unchecked.outcome == "certified, not checked"
    other = dataclasses.replace(problem, obstacles=od.ObstacleSet.from_polygons([[(1, -0.3), (2, -0.3), (1.5, 0.5)]]))
    refuted = plan_chapter("plan.json", plan, other)
    assert "Proven, as the file states; refuted by the check" in [block.title for block in refuted.content().blocks]
    assert (refuted.outcome, refuted.grade) == ("refuted", "bad")
    assert refuted.rank < plan_chapter("plan.json", plan, problem).rank


def test_samples_prove_the_path_but_not_the_motion(files, problem):
    sampled = dataclasses.replace(load_plan(files[0] / "plan.json"), time_law=None)
    verdict = judge_plan_file(sampled, problem)
    assert plan_chapter("p", sampled, problem).outcome == "path certified, motion not proven"
    proven = next(text for text in plan_texts(sampled, problem, verdict) if text.title == "Proven")
    assert proven.sentences[-1] == "The motion between samples is not proven."
    assert not any("keeps its limits" in sentence for sentence in proven.sentences)


def test_a_blocked_straight_is_drawn_and_explained(problem):
    pallet = od.ObstacleSet.from_polygons([[(2.2, 0.2), (2.4, 0.2), (2.4, 0.4), (2.2, 0.4)]])  # behind the docked robot
    dock = od.Dock(od.Pose2(3.0, 0.3, 0.0), direction="forward", final_straight=0.3)
    blocked = dataclasses.replace(problem, obstacles=pallet, dock=dock)
    with pytest.raises(NoMotionExists) as refused:
        od.plan_dock(blocked)
    scene, *others = plan_chapter("p", failed_plan_file(refused.value, "map"), blocked).content().blocks
    assert [entry.label for entry in scene.legend] == ["obstacle", "blocked", "start", "goal"]
    assert others[0].title == "Proof that no motion exists"
    assert "final straight" in others[0].sentences[1]


def test_names_are_shown_as_text(files, problem, tmp_path):
    """The name of a file, an obstacle and the text of an error contain markup."""
    plan = load_plan(files[0] / "plan.json")
    certificate = {**plan.certificate, "nearest": HOSTILE}
    hostile = [
        plan_chapter(HOSTILE, dataclasses.replace(plan, certificate=certificate), problem),
        plan_chapter("refused", PlanFile(status=HOSTILE, error=PlanError(1, HOSTILE, {HOSTILE: HOSTILE}))),
    ]
    save_report(tmp_path / "h.html", HOSTILE, hostile)
    page = read(tmp_path / "h.html")
    assert page.tags.count("script") == len([*page.documents.get("script", ())]) + sum(
        len(page.documents.get(name, ())) for name in ("figure", "motion", "report-data")
    )
    assert "alert(1)" not in "".join(page.documents["script"][-1:])
    assert HOSTILE in page.text
    assert HOSTILE not in (tmp_path / "h.html").read_text(encoding="utf-8")
    assert page.numbers["files"][0]["certificate"]["nearest"] == HOSTILE
    # BokehJS takes $$ for the border of a formula, for which it would load a library.
    assert page.documents["figure"]
    assert not any("alert" in figure or "$$" in figure for figure in page.documents["figure"])


def test_equal_files_give_equal_pages(files, problem, tmp_path):
    """The identifiers of Bokeh count on from figure to figure, those of the page do not."""
    path = load_plan(files[0] / "plan.json").path
    for name in ("a.html", "b.html"):
        save_report(tmp_path / name, "Same", [plan_chapter("path", PlanFile(status="unknown", path=path), problem)])
    assert read(tmp_path / "a.html").documents["figure"]
    assert (tmp_path / "a.html").read_bytes() == (tmp_path / "b.html").read_bytes()


def test_many_files_stay_below_five_megabytes(monkeypatch, tmp_path):
    """Contents beyond the limit are left out and are not computed; BokehJS and the limits have less than 5 MB."""
    assert page_module._MOST_CONTENT + page_module._MOST_NUMBERS + len(page_module._bokeh_script()) < 4_500_000
    made = []

    def content():
        made.append(1)
        player = Player("time", "s", [0.0], [[0.0, 0.0, 0.0]], [], [Readout("a", "", ["x" * 300])])
        return Content([Table("", (), [("text",)])], player)

    monkeypatch.setattr(page_module, "_MOST_CONTENT", 1000)
    chapters = [Chapter(f"plan {i}", "plans", "ok", "good", "fine", content, rank=(float(i),)) for i in range(60)]
    save_report(tmp_path / "many.html", "Many", chapters)
    found = read(tmp_path / "many.html")
    assert len(made) == 3
    assert "58 more files are in the summary only" in found.text
    assert found.links == ["#file-1", "#file-2"]
    assert "plan 59" in found.text


def test_counts_have_the_interval_of_wilson():
    chapters = [Chapter("x", "plans", "certified" if i < 8 else "refuted", "good", "", Content) for i in range(10)]
    z, n, p = NormalDist().inv_cdf(0.975), 10, 0.8
    middle, half = p + z * z / (2 * n), z * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    low, high = ((middle + sign * half) / (1 + z * z / n) for sign in (-1, 1))
    assert next(_counts(chapters)) == (
        "plans",
        "certified",
        "8 of 10",
        "80.0 %",
        f"{100 * low:.1f} to {100 * high:.1f} %",
    )


def test_the_worst_results_come_first(tmp_path):
    chapters = [Chapter(f"plan {k}", "plans", "ok", "good", "", lambda: Content([]), rank=(k, 0.0)) for k in (2.0, 0.5)]
    save_report(tmp_path / "r.html", "Ranked", chapters)
    assert re.search(r"file outcome result plan 0.5 .* plan 2.0", read(tmp_path / "r.html").text)


def test_the_drawn_requirement_is_that_of_the_certificate(files, problem):
    plan = load_plan(files[0] / "plan.json")
    certificate = plan.certificate
    poses = plan.path.poses_at(np.array([certificate["at_s"]] * 2))
    chart, (clearance, margin) = clearance_chart("s [m]", np.arange(2.0), poses, problem, problem.path_clearance)
    assert clearance.values == pytest.approx([certificate["min_clearance"]] * 2, abs=1e-3)
    required = clearance.values[0] - margin.values[0]
    assert required == pytest.approx(certificate["required_clearance"], abs=1e-9)
    assert f"required {required:.4f} m, margin {margin.values[0]:.4f} m" in chart.text


def test_the_requirement_of_a_path_includes_the_tracking_tube(files, problem):
    robot = dataclasses.replace(problem.robot, tracking=od.TrackingTube(cross=0.02))
    chapter = plan_chapter("p", load_plan(files[0] / "plan.json"), dataclasses.replace(problem, robot=robot))
    readouts = {one.label: np.array(one.values) for one in chapter.content().player.readouts}
    assert np.max(readouts["clearance"] - readouts["margin"]) == pytest.approx(0.05 + 0.02)


def test_the_swept_area_contains_the_outlines_and_has_the_area_of_a_straight_drive():
    box = od.Footprint.rectangle(0.4, 0.4, 0.6)
    poses = np.column_stack((np.linspace(0.0, 2.0, 300), np.zeros(300), np.zeros(300)))
    assert swept_area(box, poses).area == pytest.approx((2.0 + 0.8) * 0.6, rel=1e-6)


def test_colours_can_be_exchanged():
    """Every light colour names one role, and no exchange is exchanged again."""
    lights, darks = zip(*PALETTE.values(), strict=True)
    assert len(set(lights)) == len(lights)
    assert all(re.fullmatch("#[0-9A-F]{6}", colour) for colour in (*lights, *darks))


def test_reports_need_the_extra(files, monkeypatch):
    for name in [name for name in sys.modules if name.partition(".")[0] == "bokeh"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "bokeh", None)
    with pytest.raises(MissingExtra, match=r"optdock\[report\]"):
        read_chapters([files[0] / "plan.json"])[0].content()
    with pytest.raises(MissingExtra, match=r"optdock\[report\]"):
        check_bokeh()


def test_unknown_files_and_numbers_of_scenarios_are_refused(files, problem, tmp_path):
    (tmp_path / "x.json").write_text('{"format": "other/1"}')
    with pytest.raises(InvalidFile, match=r"x.json: must be .* got format 'other/1'"):
        read_chapters([tmp_path / "x.json"])
    with pytest.raises(InvalidValue, match="give one, or one for each of the 1 plans and runs, got 2"):
        read_chapters([files[0] / "plan.json"], [problem, problem])
    (tmp_path / "c.csv").write_text("scenario,path,status,length_m\na,raw,certified,wide\n")
    with pytest.raises(InvalidFile, match=r"c.csv:2: length_m: must be a number, got 'wide'"):
        read_chapters([tmp_path / "c.csv"])


@pytest.fixture
def surveyed():
    """Two headings on a grid of 3 x 2 positions, of which one is occupied and one has no certified heading."""
    rows = [(x, y, yaw) for yaw in (0.0, math.pi) for y in (0.0, 0.5) for x in (0.0, 0.5, 1.0)]
    x, y, yaw = (list(column) for column in zip(*rows, strict=True))
    seconds = [10.0 + xx + yy + turned for xx, yy, turned in rows]
    verdict = ["certified"] * 12
    verdict[0] = verdict[6] = "occupied"
    verdict[1], verdict[7] = "impossible", "not_found"
    verdict[2] = "impossible"
    for row in (0, 1, 2, 6, 7):
        seconds[row] = math.nan
    same = {"dock": ["bay"] * 12, "robot": ["amr"] * 12, "answer": ["planned"] * 12, "cusps": [0] * 12}
    return {**same, "x": x, "y": y, "yaw": yaw, "verdict": verdict, "seconds": seconds}


def test_a_survey_counts_its_cells_and_shows_the_best_heading(surveyed, problem):
    told = {"robot": "amr", "dock": "bay", "pose": [3.0, 0.3, 0.0], "share": 0.7, "p95": None, "sentence": "Certified."}
    told["reasons"] = [["StartOccupied: no", 4]]
    head = {"docks": [told]}
    chapter = survey_chapter("survey", SurveyColumns.of(surveyed, "t"), head, {"amr/bay": problem})
    assert chapter.numbers["docks"] == [told]
    assert chapter.summary == "1 dock, 12 cells; 70.0 % of the 10 free cells are certified"
    blocks = chapter.content().blocks
    tables = {block.title: block.rows for block in blocks if isinstance(block, Table)}
    assert tables["Verdicts"] == [("bay", "amr", "12", "7", "2", "1", "2", "13.64")]
    (chart,) = (block for block in blocks if isinstance(block, Chart))
    assert tables["Ranking"] == [("amr", "bay", "3.000, 0.300, 0.000", "70.0", "", "", "", "")]
    assert tables["Most frequent reasons of refusals"] == [("bay", "4", "StartOccupied: no")]
    assert [entry.label for entry in chart.legend][-1] == "docked robot"
    assert chart.layers == ["best heading", "heading 0.0 degrees", "heading 180.0 degrees"]
    images = [one.data_source.data["image"][0] for one in chart.figure.renderers[:3]]
    longest, blocked, unfound, occupied = 249, 251, 252, 253
    best = images[0].tolist()
    assert best[0][:2] == [occupied, unfound]
    assert images[1].tolist()[0] == [occupied, blocked, blocked]
    assert best[1] == images[1].tolist()[1], "the first heading is faster"
    assert best[0][2] == images[2].tolist()[0][2], "the only certified heading"
    assert max(images[2].ravel().tolist()) in (longest, occupied)


def test_a_large_survey_is_summarized_by_position(surveyed, monkeypatch):
    monkeypatch.setattr("optdock.reports.html.survey_chapter._MOST_CELLS", 5)
    (chart,) = (
        block
        for block in survey_chapter("s", SurveyColumns.of(surveyed, "t"), {}).content().blocks
        if isinstance(block, Chart)
    )
    assert [layer.partition(",")[0] for layer in chart.layers] == ["best heading", "share of certified headings"]
    share = chart.figure.renderers[1].data_source.data["image"][0]
    assert share[0, 2] == 249 // 2
    assert share[1].tolist() == [249, 249, 249]


def test_surveys_are_read_from_their_folder(surveyed, scenario, tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    import pyarrow

    parquet.write_table(pyarrow.table(surveyed), tmp_path / "survey.parquet")
    (tmp_path / "survey.json").write_text('{"format": "optdock-survey/1", "scenarios": {"amr/bay": "scenario.yaml"}}')
    (chapter,) = read_chapters([tmp_path])
    assert chapter.numbers["verdicts"] == {"certified": 7, "impossible": 2, "not found": 1, "occupied": 2}
    (tmp_path / "survey.parquet").write_bytes(b"PAR1")
    with pytest.raises(InvalidFile, match=r"survey.parquet: is not a Parquet file"):
        read_chapters([tmp_path])
    with pytest.raises(InvalidFile, match="t: has no column verdict"):
        SurveyColumns.of({key: surveyed[key] for key in ("dock", "robot", "x", "y", "yaw")}, "t")


@pytest.fixture
def scenario(problem, tmp_path):
    """The problem as a scenario file."""
    path = tmp_path / "scenario.yaml"
    path.write_text(json.dumps({"format": "optdock-scenario/1", **problem_document(problem)}))
    return path


def test_scenarios_are_given_for_each_file_or_by_name(files, problem, scenario, tmp_path, monkeypatch):
    folder, closed = files
    sources = [folder / "plan.json", folder / "refused.json"]
    wanted = ["certified", "impossible, proven"]
    assert [one.outcome for one in read_chapters(sources, [problem, closed])] == wanted
    assert [one.outcome for one in read_chapters(sources, {"refused": closed})] == ["certified, not checked", wanted[1]]
    (tmp_path / "plan.yaml").write_text(scenario.read_text())
    written = []
    monkeypatch.setattr("optdock.reports.html.save_report", lambda target, title, chapters: written.extend(chapters))
    command = ["report", str(folder / "plan.json"), "--scenario", str(tmp_path), "--out", str(tmp_path / "report.html")]
    assert CliRunner().invoke(app, command).exit_code == 0
    assert [chapter.outcome for chapter in written] == ["certified"]


def test_comparisons_of_several_smoothers_have_one_series_for_each():
    text = "scenario,path,status,length_m,smoother,cusps,max_curvature_rate_1pm2,reason\n"
    text += 'a,raw,not certified,2,,0,,\na,smoothed,certified,3,One,1,0.5,\na,smoothed,X,,Two,,,"too, bad"\n'
    chapter = comparison_chapter("c.csv", text)
    assert chapter.summary == "1 scenarios, 1 of 2 smoothed paths certified"
    table, *charts = chapter.content().blocks
    assert table.rows[2] == ("1", "a", "smoothed", "X", "", "", "", "Two", "too, bad")
    assert [chart.title for chart in charts] == ["Length", "Cusps", "Max curvature rate"]
    assert charts[0].text.startswith("raw: mean 2 of 1; smoothed by One: mean 3 of 1; smoothed by Two: none")


def test_the_command_writes_a_page_and_checks_its_output(files, scenario, tmp_path):
    plan, out = files[0] / "plan.json", tmp_path / "report.html"
    done = CliRunner().invoke(app, ["report", str(plan), "--scenario", str(scenario), "--out", str(out)])
    assert done.exit_code == 0, done.output
    assert "verdict certified" in read(out).text
    same = CliRunner().invoke(app, ["report", str(plan), "--out", str(plan)])
    assert same.exit_code == 2
    assert "would be overwritten" in same.output


def test_plans_refusals_runs_and_comparisons_write_reports(scenario, problem, tmp_path, monkeypatch):
    """The chapters that the commands write, without drawing them."""
    written = []
    monkeypatch.setattr("optdock.reports.html.save_report", lambda target, title, chapters: written.append(chapters))
    commands = [
        ["plan", scenario, "--out", tmp_path / "p.json"],
        ["simulate", scenario, "--out", tmp_path / "r.json"],
        ["compare", scenario, "--out", tmp_path / "c"],
    ]
    for command in commands:
        done = CliRunner().invoke(app, [*map(str, command), "--report", str(tmp_path / "x.html")])
        assert done.exit_code == 0, done.output
    occupied = problem_document(dataclasses.replace(problem, obstacles=od.ObstacleSet.from_polygons([SQUARE])))
    scenario.write_text(json.dumps({"format": "optdock-scenario/1", **occupied}))
    assert CliRunner().invoke(app, [*map(str, commands[0]), "--report", str(tmp_path / "x.html")]).exit_code == 3
    outcomes = [[(chapter.kind, chapter.outcome) for chapter in chapters] for chapters in written]
    both = [("runs", "docked"), ("plans", "certified")]
    compared = [("comparisons", "compared")]
    assert outcomes == [[("plans", "certified")], both, compared, [("plans", "StartOccupied")]]
