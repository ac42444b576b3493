"""The page without a browser: events of the pointer and of widgets, and what the document shows after answers."""

import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("bokeh")

from bokeh.document import Document
from bokeh.events import Pan, PanEnd, PanStart

import optdock as od
from optdock.config import load_scenario
from optdock.errors import InvalidValue, NoMotionExists
from optdock.runner import Workers
from optdock.simulation import DifferentialDrive, DockSensor, PoseSensor, Sensors, SimulatedRobot
from optdock.survey.dock_places import DockPlace
from optdock.survey.rounds import CellState
from optdock.survey.survey import SurveySettings, docks_of, run_survey
from optdock.ui import page as page_module
from optdock.ui.drawn_plan import drawn_plan
from optdock.ui.page import PageSession, make_page, open_source
from optdock.ui.scene_edits import EditedScene
from optdock.ui.scene_files import open_scene, worked_scenes
from optdock.ui.scene_history import STEP
from optdock.ui.scene_links import to_link
from optdock.ui.scene_view import margin_colours


class Requests:
    """A planning process that answers when the test says so."""

    def __init__(self, on_answer):
        self.asked, self.ready, self.cancelled, self.on_answer = [], [], 0, on_answer

    def ask(self, scenario, number, fingerprint, *, in_hand=False):
        self.asked.append(SimpleNamespace(scenario=scenario, number=number, fingerprint=fingerprint, in_hand=in_hand))

    def ask_drive(self, scenario, number, fingerprint):
        self.ask(scenario, number, fingerprint)

    def cancel(self):
        self.cancelled += 1

    def answers(self):
        found, self.ready = self.ready, []
        return found

    def close(self):
        pass

    def answer(self, page, row=-1):
        """Plan a request, and show the answer."""
        one = self.asked[row]
        try:
            result = one.scenario.plan(2.0)
        except NoMotionExists as error:
            result = error
        self.ready.append(drawn_plan((one.number, one.fingerprint), one.scenario.problem, result))
        page._show_answers()


@pytest.fixture
def worked(monkeypatch):
    """Return a function that opens a page on a worked scene."""
    monkeypatch.setattr(page_module, "RequestProcess", Requests)

    def opened(stem="reverse_bay", folder=Path()):
        (path,) = (path for path in worked_scenes() if path.stem == stem)
        return PageSession(Document(), open_scene(path.name, path.parent), folder)

    return opened


def drag(page, start, *places):
    """Grab at a point, move through places, and release at the last one."""
    axes = page.view.axes
    axes._trigger_event(PanStart(axes, x=start[0], y=start[1], sx=0, sy=0))
    for x, y in places:
        axes._trigger_event(Pan(axes, x=x, y=y, sx=0, sy=0))
        page.pointer._follow()
    axes._trigger_event(PanEnd(axes, x=places[-1][0], y=places[-1][1], sx=0, sy=0))


def status(page):
    return page.view.data.columns["status"]["html"][0]


def marks(page):
    """Return the fingerprints of the scene and of the answer that the page shows."""
    text = status(page)
    return [text.partition(f'data-{name}="')[2].partition('"')[0] for name in ("scene", "shown")]


def test_a_drag_moves_the_robot_and_asks_in_the_hand_until_the_release(worked):
    page = worked()
    start = page.history.scene.problem.start
    drag(page, (start.x, start.y), (start.x + 0.1, start.y), (start.x + 0.2, start.y + 0.1))
    assert page.history.scene.problem.start.x == pytest.approx(start.x + 0.2)
    assert page.history.scene.problem.start.y == pytest.approx(start.y + 0.1)
    assert [one.in_hand for one in page.process.asked] == [False, True, True, False]
    assert page.process.asked[-1].fingerprint == page.history.scene.fingerprint
    page.history.undo()
    assert page.history.scene.problem.start == start
    page.history.redo()
    assert page.history.scene.problem.start.x == pytest.approx(start.x + 0.2)


def test_a_pointer_beside_all_parts_changes_nothing(worked):
    page = worked()
    before = page.history.scene
    drag(page, (1e3, 1e3), (1e3 + 1, 1e3))
    assert page.history.scene is before
    assert len(page.process.asked) == 1


def test_only_the_newest_of_several_places_of_the_pointer_is_applied(worked):
    page = worked()
    start, axes = page.history.scene.problem.start, page.view.axes
    axes._trigger_event(PanStart(axes, x=start.x, y=start.y, sx=0, sy=0))
    for step in range(5):
        axes._trigger_event(Pan(axes, x=start.x + 0.01 * step, y=start.y, sx=0, sy=0))
    page.pointer._follow()
    page.pointer._follow()
    assert len(page.process.asked) == 2
    assert page.history.scene.problem.start.x == pytest.approx(start.x + 0.04)


def test_the_picture_belongs_to_its_fingerprint(worked):
    page = worked()
    page.process.answer(page)
    scene, shown = marks(page)
    assert scene == shown == page.history.scene.fingerprint
    page.history.nudge(0.1, 0.0)
    assert marks(page) == [page.history.scene.fingerprint, shown]
    assert "stale" in status(page)
    page._fade(page._number)
    assert page.view._veil.visible
    page.process.answer(page)
    assert marks(page)[0] == marks(page)[1]
    assert not page.view._veil.visible
    start = page.history.scene.problem.start
    begins = [page.view.data.columns[gear] for gear in ("forward", "reverse")]
    assert min(np.nanmin(np.hypot(np.array(one["x"]) - start.x, np.array(one["y"]) - start.y)) for one in begins) < 1e-4


def test_no_way_is_shown_as_the_closed_region(worked):
    page = worked("no_way")
    page.process.answer(page)
    assert "impossible" in status(page)
    assert len(page.view.data.columns["region"]["xs"]) > 0
    assert "0.04 m too wide" in status(page)
    assert len(page.view.data.columns["swept"].get("xs", ())) == 0
    assert page.curves.slider.disabled
    page.load_worked("reverse_bay")
    page.process.answer(page)
    assert len(page.curves.data.columns["0"]["value"]) > 100
    page.load_worked("no_way")
    page.process.answer(page)
    assert page.curves.data.columns["0"]["value"] == []


def test_a_wrong_field_is_a_message_and_the_scene_stays(worked):
    page = worked()
    before = page.history.scene
    page._set_field("robot.limits.max_speed", "<b>fast</b>", False)
    assert page.history.scene is before
    assert 'role="alert"' in page.message.text
    assert "<b>fast" not in page.message.text
    page._set_field("robot.limits.max_speed", "0.4", False)
    assert page.history.scene.problem.robot.limits.max_speed == 0.4
    assert page.message.text == ""
    assert next(one for one in page.fields._widgets if one.field.key == "robot.limits.max_speed").text.value == "0.4"


def test_keys_and_buttons_move_turn_add_and_remove(worked):
    page = worked()
    start = page.history.scene.problem.start
    for key in ("ArrowRight", "q"):
        page.toolbar._pressed(key)
    moved = page.history.scene.problem.start
    assert moved.x == pytest.approx(start.x + STEP)
    assert math.degrees(moved.yaw - start.yaw) == pytest.approx(5.0)
    count = len(page.history.scene.polygons)
    page.history.add(page.view.view, is_wall=True)
    assert page.history.selected == f"obstacles[{count}]"
    assert len(page.history.scene.polygons) == count + 1
    page.toolbar._pressed("Delete")
    assert len(page.history.scene.polygons) == count
    page.toolbar._pressed("Escape")
    assert page.process.cancelled == 1
    page.toolbar._pressed("F1")


def test_scenario_plan_and_report_are_saved_once(worked, tmp_path):
    page = worked(folder=tmp_path)
    page.process.answer(page)
    page.toolbar._name.value = "bay"
    page.toolbar.save()
    assert {one.name for one in tmp_path.iterdir()} == {"bay.yaml", "bay.json", "bay.html"}
    assert open_scene("bay.json", tmp_path).fingerprint == page.history.scene.fingerprint
    page.toolbar.save()
    assert "exists" in page.message.text
    page.toolbar._name.value = "../outside"
    page.toolbar.save()
    assert 'role="alert"' in page.message.text
    assert not (tmp_path.parent / "outside.yaml").exists()


def test_a_page_opens_the_scene_of_its_address(monkeypatch, tmp_path):
    opened = []
    monkeypatch.setattr(page_module, "RequestProcess", Requests)
    monkeypatch.setattr(page_module, "PageSession", lambda *given: opened.append(PageSession(*given)) or opened[-1])
    (path, *_) = worked_scenes()
    scene = open_scene(path.name, path.parent)
    make_page(Document(), None, tmp_path, {"scene": [to_link(scene).encode()], "theme": [b"dark"]})
    assert opened[-1].history.scene.fingerprint == scene.fingerprint
    for hostile in (b"\xff\xfe", b"9." + b"A" * 100_000):
        make_page(Document(), None, tmp_path, {"scene": [hostile]})
        assert 'role="alert"' in opened[-1].message.text
    for hostile in (b"../../etc/passwd", b"x" * 10_000, b"\x00"):
        make_page(Document(), None, tmp_path, {"file": [hostile]})
        assert 'role="alert"' in opened[-1].message.text
        assert isinstance(opened[-1].history.scene, EditedScene)


def test_colours_of_margins_go_from_red_to_blue():
    low, *_, high, higher = margin_colours(np.array([0.0, 0.1, 0.3, 2.0]))
    assert (low, high, higher) == ("#C8102E", "#2F89BD", "#2F89BD")
    assert margin_colours(np.array([-0.1])) == ["#C8102E"]


def test_a_log_is_played_until_the_scene_changes(monkeypatch, tmp_path):
    robot = od.Robot(od.Footprint.rectangle(0.3, 0.3, 0.5), od.MotionLimits(max_curvature=2.0, max_curvature_rate=8.0))
    dock = od.Dock(od.Pose2(2.0, 0.0, 0.0), final_straight=0.1, approach_speed=0.15, approach_distance=0.2)
    problem = od.DockingProblem(od.Pose2(0.9, 0.2, -0.1), dock, robot)
    sensors = Sensors(PoseSensor(0.005, 0.009), dock=DockSensor(latency=0.06))
    world = SimulatedRobot(DifferentialDrive(robot), start=problem.start, dock_pose=dock.pose, sensors=sensors)
    with od.LogWriter(tmp_path / "docking.jsonl") as log:
        executor = od.DockingExecutor(problem, log=log)
        step = executor.step(world.measurements)
        while step.ending is None:
            step = executor.step(world.advance(step.command, 0.1))
    monkeypatch.setattr(page_module, "RequestProcess", Requests)
    recorded = open_source("docking.jsonl", tmp_path)
    assert recorded.ending.startswith("dock in ")
    assert len(recorded.times) == len(recorded.poses) == len(recorded.states)
    page = PageSession(Document(), recorded.scene, tmp_path, 0, recorded)
    page.process.answer(page)
    assert np.allclose(page.curves._motion.data["x"], recorded.poses[:, 0])
    assert page.curves._motion.data["words"] == recorded.states
    assert len(page.view.data.columns["drive"]["x"]) == len(recorded.poses)
    assert "recorded: dock in" in page.message.text
    page.history.nudge(0.1, 0.0)
    page.process.answer(page)
    assert set(page.curves._motion.data["words"]) == {""}
    assert page.view.data.columns["drive"]["x"] == []
    with pytest.raises(InvalidValue, match="is not in the folder"):
        open_source("../docking.jsonl", tmp_path / "inner")


def test_a_survey_is_drawn_below_a_scene_that_starts_on_its_floor(monkeypatch, tmp_path):
    given = replace(load_scenario(worked_scenes()[-1]), time_budget=0.3)
    (dock,) = docks_of("bay", given, [DockPlace("dock", given.problem.goal)])
    settings = SurveySettings(within=1.5, resolution=0.5, headings=2, time_budget=0.3)
    with Workers(1, clock="counted", prepare=None) as workers:
        (found,) = run_survey([dock], settings, tmp_path / "floor", workers)
    monkeypatch.setattr(page_module, "RequestProcess", Requests)
    floor = open_source("floor", tmp_path)
    assert str(found.summary) == floor.summary
    assert len(floor.layers) == len(floor.headings) == 2
    certified = found.answers.verdict.reshape(found.task.grid.shape) == CellState.CERTIFIED
    assert np.array_equal(np.array(floor.layers) < 250, certified)
    page = PageSession(Document(), floor.scene, tmp_path, 0, floor)
    page.process.answer(page)
    assert "certified" in status(page)
    assert [one.visible for one in page.view.axes.renderers if (one.name or "").startswith("layer-")] == [True, False]
    with pytest.raises(InvalidValue, match="is not in the folder"):
        open_source("../floor-2", tmp_path / "floor")
