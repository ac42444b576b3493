"""The page without a browser: events of the pointer and of widgets, and what the document shows after answers."""

import json
import math
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import shapely

pytest.importorskip("bokeh")

from bokeh.document import Document
from bokeh.events import Pan, PanEnd, PanStart
from bokeh.models import Div

import optdock as od
from optdock.config import demo_scenario, load_scenario
from optdock.errors import InvalidValue, NoMotionExists, StartOccupied, TimedOut
from optdock.geometry.pose import Pose2
from optdock.model.camera import Camera
from optdock.model.robot import TrackingTube
from optdock.runner import Workers
from optdock.simulation import DifferentialDrive, DockSensor, PoseSensor, Sensors, SimulatedRobot
from optdock.survey.dock_places import DockPlace
from optdock.survey.rounds import CellState
from optdock.survey.survey import SurveySettings, docks_of, run_survey
from optdock.ui import page_session as page_module
from optdock.ui.drawn_plan import drawn_plan
from optdock.ui.driven_plan import DrivenPlan
from optdock.ui.edited_obstacle import EditedObstacle
from optdock.ui.field_view import FieldView
from optdock.ui.opened_source import asked_page, open_source
from optdock.ui.page_session import PageSession, make_page
from optdock.ui.scene_edits import EditedScene
from optdock.ui.scene_files import open_scene, worked_scenes
from optdock.ui.scene_history import STEP
from optdock.ui.scene_links import from_link, to_link
from optdock.ui.scene_view import SceneView, margin_colours, view_around


class Requests:
    """A planning process that answers when the test says so."""

    def __init__(self, on_answer):
        self.asked, self.ready, self.cancelled, self.on_answer = [], [], 0, on_answer

    def ask(self, scenario, number, fingerprint, **flags):
        flags = {"in_hand": False, "picture_only": False, **flags}
        self.asked.append(SimpleNamespace(scenario=scenario, number=number, fingerprint=fingerprint, **flags))

    def ask_drive(self, scenario, number, fingerprint):
        self.ask(scenario, number, fingerprint)

    def cancel(self):
        self.cancelled += 1

    def answers(self):
        found, self.ready = self.ready, []
        return found

    def close(self):
        pass

    def answer(self, page, refusal=NoMotionExists):
        """Plan the newest request, and show the answer."""
        one = self.asked[-1]
        try:
            result = one.scenario.plan(2.0)
        except refusal as error:
            result = error
        asked, only = (one.number, one.fingerprint), one.picture_only
        self.ready.append(drawn_plan(asked, one.scenario.problem, result, picture_only=only))
        page._show_answers()


@pytest.fixture(scope="module")
def widgets():
    """Widgets of all fields, for one page after another: making them takes a third of the time of a page."""
    return FieldView(lambda *_: None)


@pytest.fixture(autouse=True)
def light_pages(monkeypatch, widgets):
    """Let every page use the same widgets, and plan in this process."""

    def shared(on_change):
        for document in {group.document for group in widgets.groups.values() if group.document}:
            document.clear()  # a model belongs to one document
        widgets._on_change = on_change
        widgets._entered.clear()
        return widgets

    monkeypatch.setattr(page_module, "FieldView", shared)
    monkeypatch.setattr(page_module, "RequestProcess", Requests)


@pytest.fixture
def worked():
    """Return a function that opens a page on a worked scene."""

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
    assert [one.picture_only for one in page.process.asked] == [False, True, True, False]
    ghost = next(one for one in page.view.axes.renderers if one.name == "ghost")
    assert not ghost.visible
    page.process.answer(page)
    assert ghost.visible
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
    assert (
        min(
            np.nanmin(np.hypot(*(np.array(one[axis], float) - at for axis, at in (("x", start.x), ("y", start.y)))))
            for one in begins
        )
        < 1e-4
    )


def test_no_way_is_shown_as_the_closed_region(worked):
    page = worked("no_way")
    page.process.answer(page)
    assert "impossible" in status(page)
    assert len(page.view.data.columns["region"]["xs"]) > 0
    assert "0.04 m too wide" in status(page)
    assert len(page.view.data.columns["swept"].get("xs", ())) == 0
    assert page.curves.slider.disabled
    page.files.load_worked("reverse_bay")
    page.process.answer(page)
    assert len(page.curves.data.columns["speed [m/s]"]["value"]) > 100
    assert all(chart.visible for chart in page.curves.charts.children)
    page.files.load_worked("no_way")
    page.process.answer(page)
    assert not any(chart.visible for chart in page.curves.charts.children)


def test_a_refusal_names_its_obstacles_in_the_figure_and_a_move_until_the_scene_changes(worked):
    page = worked("no_way")
    columns = page.view.data.columns
    page.process.answer(page)
    assert columns["names"]["text"] == ["obstacles[4]", "obstacles[5]"]
    scene = page.history.scene
    for row, xs, ys in zip((4, 5), columns["named"]["xs"], columns["named"]["ys"], strict=True):
        np.testing.assert_allclose(np.column_stack((xs, ys)), scene.polygons[row])
    assert {*columns["named"]["line"], *columns["places"]["line"]} == {page.view.ink("hot")}
    assert re.search(r"Try: move obstacles\[[45]\] 0\.05 m (up|down)\.", status(page))
    grip = scene.grip("obstacles[4]")
    drag(page, (grip.x, grip.y), (grip.x, grip.y - 0.01))
    assert columns["names"]["text"] == ["obstacles[4]"]  # as the selected part
    assert columns["named"]["xs"] == []
    assert "Try" not in status(page)


def test_the_places_of_a_certified_motion_have_no_warning_colour(worked):
    page = worked()
    page.process.answer(page)
    columns = page.view.data.columns
    assert len(columns["places"]["xs"]) > 0
    assert {*columns["places"]["line"], *columns["nearest"]["line"]} <= {page.view.ink("ink")}
    assert "2 gears: forward, reverse" in status(page)
    assert page.curves.slider.title is None


def test_names_of_an_answer_to_another_scene_are_not_shown(worked):
    """Its numbers may belong to other obstacles."""
    page = worked("no_way")
    one = page.process.asked[-1]
    drawn = drawn_plan((one.number, one.fingerprint), one.scenario.problem, StartOccupied("overlaps obstacles[5]"))
    page.history.edit(lambda scene: scene.removed(scene.grip("obstacles[0]")))
    page.process.ready.append(drawn)
    page._show_answers()
    assert page.view.data.columns["names"].get("text", []) == []


@pytest.mark.parametrize("stem", [path.stem for path in worked_scenes()])
def test_the_first_view_contains_the_scene(stem):
    (path,) = (path for path in worked_scenes() if path.stem == stem)
    scene = open_scene(path.name, path.parent)
    view = SceneView(scene, 0).view
    points = np.vstack((*scene.polygons, [[one.x, one.y] for one in scene.handles]))
    assert np.all((points > [view.left, view.bottom]) & (points < [view.right, view.top]))
    far = scene.added_box(view.right + 100.0, 0.0)
    assert view_around(far) == view


def test_keys_of_a_time_out_are_fields_of_the_page(worked):
    page = worked()
    page._set_field("time_budget", "0.1", False)
    one, error = page.process.asked[-1], TimedOut("the search ran out of time; raise time_budget, which is 0.1 s")
    page.process.ready.append(drawn_plan((one.number, one.fingerprint), one.scenario.problem, error))
    page._show_answers()
    for text in (status(page), page.words.text):
        assert "raise the time budget (under Planning), which is 0.1 s" in text


def test_figures_of_curves_stay_in_the_document(worked):
    """A browser does not release the models of figures that were removed."""
    page = worked("forklift")
    shown = []
    for stem in ("forklift", "reverse_bay", "forklift", "reverse_bay"):
        page.files.load_worked(stem)
        page.process.answer(page)
        charts = page.curves.charts.children
        shown.append([(chart.id, chart.title.text) for chart in charts if chart.visible])
    assert shown[0] != shown[1]
    assert shown[:2] == shown[2:]
    assert {one for some in shown for one in some} == {(chart.id, chart.title.text) for chart in charts}


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
    page.files.name.value = "bay"
    page.files.save()
    assert {one.name for one in tmp_path.iterdir()} == {"bay.yaml", "bay.json", "bay.html"}
    assert open_scene("bay.json", tmp_path).fingerprint == page.history.scene.fingerprint
    page.files.save()
    assert "exists" in page.message.text
    page.files.name.value = "../outside"
    page.files.save()
    assert 'role="alert"' in page.message.text
    assert not (tmp_path.parent / "outside.yaml").exists()


def test_a_page_opens_the_scene_of_its_address(monkeypatch, tmp_path):
    opened = []
    monkeypatch.setattr(page_module, "PageSession", lambda *given: opened.append(PageSession(*given)) or opened[-1])
    (path, *_) = worked_scenes()
    scene = open_scene(path.name, path.parent)
    query = {"scene": [to_link(scene, tmp_path).encode()], "theme": [b"dark"]}
    make_page(Document(), asked_page(None, tmp_path, query), tmp_path)
    assert opened[-1].history.scene.fingerprint == scene.fingerprint
    hostile = [("scene", text) for text in (b"\xff\xfe", b"9." + b"A" * 100_000)]
    hostile += [("file", text) for text in (b"../../etc/passwd", b"x" * 10_000, b"\x00")]
    pages = [asked_page(None, tmp_path, {name: [text]}) for name, text in hostile]
    assert all(page.fault and isinstance(page.opened, EditedScene) for page in pages)
    make_page(Document(), pages[-1], tmp_path)
    assert 'role="alert"' in opened[-1].message.text
    assert opened[-1].history.scene is pages[-1].opened


def test_a_slider_is_one_step_of_undo_and_is_planned_at_its_end(worked):
    page = worked()
    before = page.history.scene
    for text in ("0.3", "0.35", "0.4"):
        page._set_field("robot.limits.max_speed", text, True)
    page._set_field("robot.limits.max_speed", "0.4", False)
    assert [one.in_hand for one in page.process.asked] == [False, True, True, True, False]
    assert not any(one.picture_only for one in page.process.asked)
    assert page.files.link.text == to_link(page.history.scene, Path())
    page.history.undo()
    assert page.history.scene is before


def test_a_drag_of_the_map_is_explained(tmp_path):
    page = PageSession(Document(), open_scene(None, tmp_path), tmp_path)
    scene, costmap = page.history.scene, page.history.scene.problem.costmap
    rows, columns = np.nonzero(costmap.data == 254)
    places = costmap.centre_of(np.column_stack((columns, rows)))
    occupied = next(tuple(place) for place in places.tolist() if scene.grip_at(*place, 0.1) is None)
    drag(page, occupied, (occupied[0] + 0.3, occupied[1]))
    assert "The map cannot be dragged" in page.message.text
    assert page.history.scene is scene


def test_a_scene_with_a_map_returns_by_its_link(tmp_path):
    page = PageSession(Document(), open_scene(None, tmp_path), tmp_path)
    page.history.nudge(0.1, 0.0)
    assert page.files.unlinked.text == ""
    assert from_link(page.files.link.text, tmp_path).fingerprint == page.history.scene.fingerprint
    page.files._explain_link()
    assert "contains the scene, without its map" in page.message.text


def test_a_scene_without_a_link_is_named_before_it_is_lost(worked):
    page = worked()
    places = np.random.default_rng(1).normal(size=(900, 2)).round(6)
    triangles = [np.add(place, [[0, 0], [0.1, 0], [0, 0.1]]) for place in places]
    obstacles = tuple(map(EditedObstacle.of, triangles, range(900)))
    page.history.edit(lambda scene: scene._with_obstacles(obstacles))
    assert page.files.link.text == ""
    assert "the scene is too large" in page.files.unlinked.text
    assert "loses changes that are not saved" in page.files.unlinked.text
    page.files._explain_link()
    assert 'role="alert"' in page.message.text
    page.history.undo()
    assert page.files.link.text.startswith("1.")
    assert page.files.unlinked.text == ""


@pytest.mark.parametrize("key", ["z", "ArrowUp", "Delete"])
def test_a_key_ends_a_drag_and_undo_returns_to_its_beginning(worked, key):
    page = worked()
    page.history.nudge(-0.1, 0.0)
    base, axes = page.history.scene, page.view.axes
    row = len(base.polygons) - 1
    at = base.grip(f"obstacles[{row}]")
    axes._trigger_event(PanStart(axes, x=at.x, y=at.y, sx=0, sy=0))
    axes._trigger_event(Pan(axes, x=at.x + 0.1, y=at.y, sx=0, sy=0))
    page.pointer._follow()
    assert page.pointer.is_dragging
    page.toolbar._pressed(key)
    ended = page.history.scene
    assert not page.pointer.is_dragging
    axes._trigger_event(Pan(axes, x=at.x + 0.2, y=at.y, sx=0, sy=0))
    page.pointer._follow()
    axes._trigger_event(PanEnd(axes, x=at.x + 0.2, y=at.y, sx=0, sy=0))
    assert page.history.scene is ended
    assert not page.process.asked[-1].in_hand
    if key != "z":
        page.history.undo()
    assert page.history.scene is base
    page.history.undo()
    assert page.history.scene.problem.start.x == pytest.approx(base.problem.start.x + 0.1)


def test_a_drag_that_begins_before_the_end_of_another_keeps_both(worked):
    page = worked()
    first, axes = page.history.scene, page.view.axes
    start = first.problem.start
    axes._trigger_event(PanStart(axes, x=start.x, y=start.y, sx=0, sy=0))
    axes._trigger_event(Pan(axes, x=start.x + 0.1, y=start.y, sx=0, sy=0))
    page.pointer._follow()
    middle = page.history.scene
    drag(page, (start.x + 0.1, start.y), (start.x + 0.2, start.y))
    page.history.undo()
    assert page.history.scene is middle
    page.history.undo()
    assert page.history.scene is first


def test_a_release_without_a_change_still_requests_the_plan(worked):
    page = worked()
    start = page.history.scene.problem.start
    drag(page, (start.x, start.y), (start.x, start.y))
    assert [one.in_hand for one in page.process.asked] == [False, False]


def test_delete_twice_removes_one_obstacle(worked):
    page = worked()
    count = len(page.history.scene.polygons)
    assert count > 1
    page.history.select("obstacles[0]")
    for _ in range(2):
        page.toolbar._pressed("Delete")
    assert len(page.history.scene.polygons) == count - 1
    assert page.history.selected == "start"


def driven(page, outcome="docked", *, number=None, count=0):
    """Return the answer to a request for a drive of the present scene."""
    number, poses = page._number if number is None else number, np.zeros((count, 3))
    return DrivenPlan(number, page.history.scene.fingerprint, outcome, "", (), np.arange(1.0 * count), poses, poses)


def test_a_plan_that_a_drive_replaced_is_requested_again(worked):
    page = worked()
    page.process.answer(page)
    page.history.nudge(0.05, 0.0)
    page.drive()
    page.process.ready.append(driven(page))
    page._show_answers()
    assert page.process.asked[-1].fingerprint == page.history.scene.fingerprint
    assert len(page.process.asked) == 4
    page.process.answer(page)
    assert marks(page)[0] == marks(page)[1]


def test_a_plan_and_a_drive_that_arrive_together_are_both_shown(worked):
    page = worked()
    one = page.process.asked[-1]
    page.drive()
    plan = drawn_plan((one.number, one.fingerprint), one.scenario.problem, one.scenario.plan(5.0))
    page.process.ready += [plan, driven(page)]
    page._show_answers()
    assert page.shown is plan
    assert "docked" in page.message.text
    assert len(page.process.asked) == 2
    page.history.nudge(0.05, 0.0)
    page.process.ready.append(driven(page, "cancelled", number=2))
    page._show_answers()
    assert page.message.text == ""
    assert 'data-doing="planning"' in status(page)


def test_a_picture_is_faded_during_a_long_drag(worked):
    page = worked()
    page.process.answer(page)
    for _ in range(3):
        page.history.nudge(0.01, 0.0)
    page._fade(2)
    assert page.view._veil.visible


def test_the_browser_receives_every_change_of_the_picture(worked):
    page = worked()
    post, received = page.view.data.post, {}

    def receive(event):
        if getattr(event, "model", None) is post:
            received.update(json.loads(post.data["json"][0]))

    page.document.on_change(receive)
    page.view.data.connect()
    page.process.answer(page)
    start = page.history.scene.problem.start
    for change in (
        lambda: drag(page, (start.x, start.y), (start.x - 3.0, start.y)),  # beyond the view
        lambda: page.process.answer(page),
        lambda: page.toolbar._selected("dock"),
        lambda: page.files.load_worked("no_way"),
        lambda: page.process.answer(page),
        page.drive,
    ):
        change()
        assert received == {name: columns for name, columns in page.view.data.columns.items() if columns}


def test_numbers_of_a_refusal_are_short(worked):
    page = worked()
    start, row = page.history.scene.problem.start, page.history.scene.grip("obstacles[0]")
    page.history.nudge(row.x - start.x + 0.1, row.y - start.y + 0.07)
    page.process.answer(page, StartOccupied)
    assert "clearance: -0.58<" in page.words.text
    assert re.search(r"[0-9]\.[0-9]{7}", page.words.text) is None


def test_texts_of_an_answer_are_not_markup(worked):
    page = worked()
    one = page.process.asked[-1]
    hostile = "<img src=x onerror=alert(1)>"
    page.process.ready.append(drawn_plan((one.number, hostile), one.scenario.problem, InvalidValue(hostile)))
    page._show_answers()
    assert "refused" in status(page)
    assert "<img" not in status(page) + page.words.text


def test_a_map_is_hidden_while_the_scene_has_none():
    source = demo_scenario()
    page = PageSession(Document(), open_scene(source, source.parent), source.parent)
    (cells,) = [one for one in page.view.axes.renderers if type(one.glyph).__name__ == "Image"]
    assert cells.visible
    page.files.load_worked("no_way")
    assert not cells.visible
    page.history.undo()
    assert cells.visible


def test_a_page_opens_after_the_first_file_was_removed(tmp_path):
    document = Document()
    make_page(document, asked_page(tmp_path / "gone.yaml", tmp_path, {}), tmp_path)
    assert any("gone.yaml" in root.text for root in document.roots if isinstance(root, Div))


def test_nothing_is_saved_if_one_of_the_files_cannot_be(worked, tmp_path):
    folder = tmp_path / "inside"
    folder.mkdir()
    page = worked(folder=folder)
    page.process.answer(page)
    for suffix in (".yaml", ".json", ".html"):
        fail_to_save(page, folder, suffix)


def fail_to_save(page, folder, suffix):
    """Save where one of the names is a link, a file of somebody else, and a folder."""
    outside = folder.parent / "outside"
    (folder / f"bay{suffix}").symlink_to(outside)
    page.files.name.value = "bay"
    page.files.replaces.active = True
    page.files.save()
    assert 'role="alert"' in page.message.text
    assert [one.name for one in folder.iterdir()] == [f"bay{suffix}"]
    assert not outside.exists()
    (folder / f"bay{suffix}").unlink()
    (folder / f"bay{suffix}").write_text("mine")
    page.files.replaces.active = False
    page.files.save()
    assert [one.read_text() for one in folder.iterdir()] == ["mine"]
    (folder / f"bay{suffix}").unlink()
    (folder / f"bay{suffix}").mkdir()
    page.files.replaces.active = True
    page.files.save()
    assert 'role="alert"' in page.message.text
    (folder / f"bay{suffix}").rmdir()


def test_camera_and_tube_move_with_the_robot(worked):
    page = worked()
    page.process.answer(page)
    robot, cone, tube = page.curves._shapes
    assert [len(one.data["x"]) for one in (robot, cone, tube)] == [4, 0, 0]
    problem = page.history.scene.problem
    camera = Camera(Pose2(-0.4, 0.0, math.pi), 1.0, 0.2, 3.0)
    seeing = replace(problem.robot, camera=camera, tracking=TrackingTube(0.01, 0.01))
    page.history.edit(lambda scene: scene.with_problem(replace(problem, robot=seeing)))
    page.process.answer(page)
    x, y = np.array(cone.data["x"]), np.array(cone.data["y"])
    points = np.column_stack((-0.4 - x, -y))  # in the frame of the camera, which looks backwards
    assert np.abs(camera.margins(points).near).min() < 1e-9
    assert min(map(min, zip(*camera.margins(points)[:3], strict=True))) > -1e-9
    # The tube contains every point that the robot reaches by a displacement up to its width.
    widths, row = np.array(page.curves._motion.data["width"]), 100
    assert widths.max() == pytest.approx(seeing.tracking.width(seeing.footprint))
    assert widths[-1] < 1e-6
    grown = [np.array(tube.data[name]) + widths[row] * np.array(tube.data[f"d{name}"]) for name in "xy"]
    reached = shapely.Polygon(seeing.footprint.vertices).buffer(widths[row], quad_segs=32)
    assert shapely.Polygon(np.column_stack(grown)).buffer(1e-9).contains(reached)
    assert shapely.Polygon(np.column_stack(grown)).hausdorff_distance(reached) < 0.5 * widths[row]
    page.process.ready.append(driven(page, count=3))
    page._show_answers()
    assert [len(one.data["x"]) > 0 for one in (robot, cone, tube)] == [True, True, False]  # it lies around the path
    page.history.nudge(0.1, 0.0)
    page.files.load_worked("no_way")
    page.process.answer(page)
    assert [len(one.data["x"]) for one in (robot, cone, tube)] == [4, 0, 0]


def test_colours_of_margins_go_from_red_to_blue():
    low, *_, high, higher = margin_colours(np.array([0.0, 0.1, 0.3, 2.0]))
    assert (low, high, higher) == ("#C8102E", "#2F89BD", "#2F89BD")
    assert margin_colours(np.array([-0.1])) == ["#C8102E"]


def test_a_log_is_played_until_the_scene_changes(tmp_path):
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


def test_a_survey_is_drawn_below_a_scene_that_starts_on_its_floor(tmp_path):
    given = replace(load_scenario(worked_scenes()[-1]), time_budget=0.3)
    (dock,) = docks_of("bay", given, [DockPlace("dock", given.problem.goal)])
    settings = SurveySettings(within=1.5, resolution=0.5, headings=2, time_budget=0.3)
    with Workers(1, clock="counted", prepare=None) as workers:
        (found,) = run_survey([dock], settings, tmp_path / "floor", workers)
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
