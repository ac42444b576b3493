"""The page of `optdock ui`: one session for every open page, with a scene, a planning process and the last answer.

Every change of the scene requests a plan. The newest answer is shown until the next one arrives; it is faded while the
scene has another fingerprint.
"""

from __future__ import annotations

import asyncio
import contextlib
import functools
import time
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

from optdock import __version__
from optdock.reports.html.figures import PALETTE
from optdock.reports.html.plan_chapter import start_relief
from optdock.ui.curve_view import CurveView
from optdock.ui.drawn_plan import DrawnPlan
from optdock.ui.driven_plan import DrivenPlan
from optdock.ui.field_view import FieldView
from optdock.ui.file_view import FileView
from optdock.ui.floor_view import FloorView
from optdock.ui.mends import Mend, mend_of
from optdock.ui.moved_shapes import MovedShapes, moved_shapes
from optdock.ui.page_texts import answer_html, drive_text, status_html
from optdock.ui.page_toolbar import PageToolbar
from optdock.ui.recorded_docking import RecordedDocking
from optdock.ui.request_process import RequestProcess
from optdock.ui.scene_edits import EditedScene
from optdock.ui.scene_fields import with_field
from optdock.ui.scene_history import SceneHistory
from optdock.ui.scene_pointer import ScenePointer
from optdock.ui.scene_view import GHOSTS, SceneView, named_obstacles, view_around
from optdock.ui.surveyed_floor import SurveyedFloor

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from bokeh.document import Document

    from optdock.ui.opened_source import AskedPage

__all__ = ["PageSession", "make_page"]

_STALE = 150  # [ms] until an answer to another scene is faded
# Messages are fixed to the bottom of the window, so that they are visible everywhere and do not shift the page.
_MESSAGE = {"position": "fixed", "left": "1rem", "bottom": "1rem", "z-index": "9", "max-width": "44rem"}
_GRADES = """
:host {{ pointer-events: none; }}
p {{ margin: 0; padding: 0.6rem 1rem; font-size: 0.95rem; background: {0}; color: {1}; border: 2px solid {1}; }}
p.bad {{ color: {2}; border-color: {2}; font-weight: 600; }}
"""
_GRADE_INKS = ("paper", "ink", "hot")
_FIXED = "The map cannot be dragged. An obstacle that is added can, and a map is changed in its file."
_LONGEST_STILL = 0.1  # [s] for which the picture may stay while the hand moves


class PageSession:
    """State of one open page.

    Args:
        document: The Bokeh document of the page.
        scene: The first scene.
        folder: Folder in which files are saved.
        variant: Variant of the colours of `PALETTE`: 0 for light, 1 for dark pages.
        recorded: A docking that is played as long as its scene is shown, or a survey that is drawn below the scene.
    """

    def __init__(
        self,
        document: Document,
        scene: EditedScene,
        folder: Path,
        variant: int = 0,
        recorded: RecordedDocking | SurveyedFloor | None = None,
    ) -> None:
        from bokeh.models import Div
        from tornado.ioloop import IOLoop

        self.document = document
        self._loop: IOLoop | None = None  # of the server; None if no loop is running
        with contextlib.suppress(RuntimeError):
            asyncio.get_running_loop()  # `IOLoop.current` would create one
            self._loop = IOLoop.current()
        self.shown: DrawnPlan | None = None
        self._number, self._doing = 0, ""
        self._named: tuple[int, ...] = ()  # numbers of the obstacles that the answer names
        self._mend: Mend | None = None  # of the refusal that is shown
        self._recorded = recorded if isinstance(recorded, RecordedDocking) else None
        self._sent_at = 0.0  # [s]
        self.history = SceneHistory(scene, self._changed)
        self.view = SceneView(scene, variant)
        self.curves = CurveView([self.view.source(name) for name in GHOSTS], variant)
        self.fields = FieldView(self._set_field)
        calls = {
            "Add box": lambda: self.history.add(self.view.view, is_wall=False),
            "Add wall": lambda: self.history.add(self.view.view, is_wall=True),
            "Cancel": self._cancel, "Drive": self.drive,
        }  # fmt: skip
        self.toolbar = PageToolbar(self.history, calls, self.show_scene)
        self.files = FileView(self.history, folder, lambda: self.shown, self._load, self.say)
        self.pointer = ScenePointer(document, self.view, self.history, self.show_scene, lambda: self.say(_FIXED))
        self.words = Div(text="", sizing_mode="stretch_width")
        self.message = Div(text="", styles=_MESSAGE, stylesheets=[_GRADES.format(*map(self.view.ink, _GRADE_INKS))])
        self.floor = FloorView(self.view.axes, recorded if isinstance(recorded, SurveyedFloor) else None, variant)
        self.data = Div(visible=False, tags=[self.view.data.post])
        self.data.on_change("text", lambda _, __, ___: self._built())  # changed by ui.js
        _compose(self, variant)
        self.process = RequestProcess(self._answered)
        document.on_session_destroyed(lambda _: self.process.close())
        self._changed(in_hand=False, fault="")

    def say(self, text: str, *, is_bad: bool = False) -> None:
        """Show a message; an empty one clears it."""
        role, grade = ("alert", "bad") if is_bad else ("status", "good")
        self.message.text = f'<p role="{role}" class="{grade}">{escape(text)}</p>' if text else ""

    def _load(self, scene: EditedScene) -> None:
        self.view.look_at(view_around(scene), extends=False)
        self.history.edit(lambda _: scene)

    def drive(self) -> None:
        """Request a simulated drive along the plan."""
        self._number += 1
        scene = self.history.scene
        self.process.ask_drive(scene.scenario, self._number, scene.fingerprint)
        with self._one_message():
            self._doing = "driving"
            self._show_status()

    def _cancel(self) -> None:
        self.process.cancel()

    def show_scene(self) -> None:
        """Draw the scene and the selected part."""
        with self._one_message():
            self._draw_scene()

    def _draw_scene(self) -> None:
        history = self.history
        self.view.show(history.scene, history.selected)
        self.view.show_names(history.scene, history.selected, self._named)
        self.toolbar.show([one.name for one in history.scene.handles], history.selected)

    # Changes of the scene.

    def _set_field(self, key: str, text: str, moves: bool) -> None:  # noqa: FBT001 - a callback
        self.history.edit(functools.partial(with_field, key=key, text=text), in_hand=moves)

    def _changed(self, *, in_hand: bool, fault: str) -> None:
        """Show the scene after a change, and request a plan.

        A scene in the hand is sent with its answer, unless the last picture is older than `_LONGEST_STILL`.
        """
        is_due = not in_hand or time.monotonic() - self._sent_at > _LONGEST_STILL
        with self._one_message(sends=is_due):
            self.say(fault, is_bad=True)
            self._mend = None
            if not in_hand:
                self._named = ()  # obstacles may have other numbers
            if not fault:
                self._ask(in_hand=in_hand)
            self._draw_scene()
            if in_hand:
                self.view.show_ghost(visible=False)  # it stands on the path of an earlier scene
            else:
                self.fields.show(self.history.scene)
                self.files.show_link()

    def _ask(self, *, in_hand: bool) -> None:
        scene = self.history.scene
        self._number += 1
        only = in_hand and self.pointer.is_dragging
        self.process.ask(scene.scenario, self._number, scene.fingerprint, in_hand=in_hand, picture_only=only)
        self._doing = "moving" if in_hand else "planning"
        self._show_status()
        number = self._number
        self.document.add_timeout_callback(lambda: self._fade(number), _STALE)

    def _built(self) -> None:
        """Send the picture, and the answers that arrived while the browser built the page.

        Answers wait because they add figures to the page, and the browser builds its views asynchronously. The event
        `DocumentReady` of Bokeh comes later: it also waits until every figure has been painted.
        """
        self.view.data.connect()
        self._show_answers()

    # Answers.

    @contextlib.contextmanager
    def _one_message(self, *, sends: bool = True) -> Iterator[None]:
        """Send all changes within the context as one message; a context within another one changes nothing.

        The layers of the figure are sent once, at the end: Bokeh combines changes of a property by dropping all but the
        last one.

        Args:
            sends: Whether the layers of the figure are sent as well.
        """
        if self.document.callbacks.hold_value is not None:
            yield
            return
        self.document.hold("combine")
        try:
            yield
        finally:
            if sends:
                self.view.data.send()
                self._sent_at = time.monotonic()
            self.document.unhold()

    def _answered(self) -> None:
        """Let the event loop of the page show the answers; called in another thread.

        The callback is added by the loop itself: the end of a hold loses what another thread adds at this moment. An
        answer that arrives before the page is built is shown by `_built`.
        """
        if self._loop is not None and self.view.data.is_connected:
            self._loop.add_callback(self.document.add_next_tick_callback, self._show_answers)

    def _show_answers(self) -> None:
        answers = self.process.answers()
        if not answers:
            return
        with self._one_message():
            plans = [one for one in answers if isinstance(one, DrawnPlan)]
            drives = [one for one in answers if isinstance(one, DrivenPlan)]
            if plans:
                self._show_plan(plans[-1])
            if drives:
                self._show_drive(drives[-1])

    def _show_plan(self, drawn: DrawnPlan) -> None:
        if drawn.outcome == "cancelled" and drawn.number < self._number:
            return  # a newer request replaced it
        self.shown = drawn
        is_of_scene = drawn.fingerprint == self.history.scene.fingerprint
        if is_of_scene and not self.pointer.is_dragging:
            self._mend = mend_of(drawn, self.history.scene.problem)
        self._finish(drawn.number)
        self.view.show_answer(drawn)
        if self.pointer.is_dragging or is_of_scene:
            self._named = named_obstacles(drawn)
            self.view.show_names(self.history.scene, self.history.selected, self._named)
        if drawn.view is not None and not self.pointer.is_dragging:
            self.view.look_at(drawn.view)
            self.curves.show(drawn.motion, self._moved(drawn))
            self.view.show_ghost(visible=True)
            self.words.text = answer_html(drawn)
            self._show_recorded(drawn)

    def _moved(self, drawn: DrawnPlan) -> MovedShapes:
        """Return the shapes that the player moves along the motion of an answer; of an older scene, only the robot."""
        scene = self.history.scene
        if drawn.fingerprint != scene.fingerprint:
            return MovedShapes(drawn.outline, np.zeros((0, 2)), 0.0 * drawn.outline, np.zeros(0))
        poses = drawn.motion.poses if drawn.motion is not None and drawn.outcome == "certified" else None
        return moved_shapes(scene.problem, poses, start_relief(drawn.file))

    def _show_recorded(self, drawn: DrawnPlan) -> None:
        """Play the recorded docking instead of the plan for its scene."""
        recorded = self._recorded
        if recorded is None or drawn.fingerprint != recorded.scene.fingerprint:
            return
        self.view.show_drive(recorded.poses, recorded.detections)
        self.curves.show_player(recorded.times, recorded.poses, moved_shapes(recorded.scene.problem), recorded.states)
        self.say(f"recorded: {recorded.ending}")

    def _show_drive(self, drive: DrivenPlan) -> None:
        if drive.number < self._number:
            return  # a newer request replaced it
        scene = self.history.scene
        self._finish(drive.number)
        self.view.show_drive(drive.poses)
        if len(drive.times):
            self.curves.show_player(drive.times, drive.poses, moved_shapes(scene.problem))
        self.say(drive_text(drive), is_bad=drive.outcome != "docked")
        if drive.outcome != "cancelled" and (self.shown is None or self.shown.fingerprint != scene.fingerprint):
            self._ask(in_hand=False)  # the drive replaced the request for the plan

    def _finish(self, number: int) -> None:
        """Show in the status that a request was answered, unless a newer one waits or the hand still moves."""
        if number == self._number and self._doing != "moving":
            self._doing = ""
        self._show_status()

    def _show_status(self) -> None:
        mend = "" if self._mend is None else str(self._mend)
        self.view.show_status(status_html(self.history.scene.fingerprint, self.shown, self._doing, mend))

    def _fade(self, number: int) -> None:
        """Fade the answer if it belongs to another scene, and none to this request or a later one has arrived."""
        if self.shown is not None and self.shown.number < number:
            with self._one_message():
                self.view.fade(faded=self.shown.fingerprint != self.history.scene.fingerprint)


def make_page(document: Document, asked: AskedPage, folder: Path) -> None:
    """Fill the document of a page that was opened.

    Args:
        document: The document.
        asked: Content of the page.
        folder: Folder in which the page may write files.
    """
    opened = asked.opened
    scene, recorded = (opened, None) if isinstance(opened, EditedScene) else (opened.scene, opened)
    page = PageSession(document, scene, folder, asked.variant, recorded)
    if asked.fault:
        page.say(asked.fault, is_bad=True)


def _compose(page: PageSession, variant: int) -> None:
    """Add the roots of a page to the template of its document."""
    from jinja2 import Environment, PackageLoader

    curves, groups = page.curves, page.fields.groups
    roots: dict[str, Any] = {
        "scene": page.view.axes, "curves": curves.charts, "player": curves.slider, "play": curves.play,
        "clock": curves.clock, "floor": page.floor.box, "data": page.data, "curve_data": curves.holder,
        "message": page.message, "words": page.words, "files": page.files.box, "link": page.files.link,
        "unlinked": page.files.unlinked, **page.toolbar.roots,
        **{f"fields_{name}": group for name, group in groups.items()},
    }  # fmt: skip
    with page.document.models.freeze():  # collects the models of all roots once
        for name, root in roots.items():
            root.name = name
            page.document.add_root(root)
    loader = PackageLoader("optdock.ui", "templates")
    environment = Environment(loader=loader, autoescape=False)
    page.document.template = environment.get_template("ui.html")
    page.document.template_variables.update(
        palette={name: colours[variant] for name, colours in PALETTE.items()},
        style=loader.get_source(environment, "ui.css")[0],
        script=loader.get_source(environment, "ui.js")[0],
        version=__version__,
        groups=list(page.fields.groups),
        dark=bool(variant),
        has_map=page.history.scene.problem.costmap is not None,
    )
    page.document.title = "optdock"
