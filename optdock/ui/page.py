"""The page of `optdock ui`: one session for every open page, with a scene, a planning process and the last answer.

Every change of the scene requests a plan. The newest answer is shown until the next one arrives; it is faded while the
scene has another fingerprint.
"""

from __future__ import annotations

import contextlib
import functools
import time
from html import escape
from typing import TYPE_CHECKING, Any

from optdock import __version__
from optdock.errors import InvalidValue, OptdockError
from optdock.io.quoting import shown
from optdock.plotting.scene import view_of
from optdock.reports.html.figures import PALETTE
from optdock.ui.curve_view import CurveView
from optdock.ui.drawn_plan import DrawnPlan
from optdock.ui.field_view import FieldView
from optdock.ui.page_texts import answer_html, drive_text, status_html
from optdock.ui.page_toolbar import PageToolbar
from optdock.ui.request_process import RequestProcess
from optdock.ui.scene_fields import with_field
from optdock.ui.scene_files import open_scene, worked_scenes
from optdock.ui.scene_history import SceneHistory
from optdock.ui.scene_links import from_link, to_link
from optdock.ui.scene_pointer import ScenePointer
from optdock.ui.scene_view import GHOST, SceneView

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    from bokeh.document import Document

    from optdock.ui.driven_plan import DrivenPlan
    from optdock.ui.scene_edits import EditedScene

__all__ = ["PageSession", "make_page"]

_STALE = 150  # [ms] until an answer to another scene is faded
_LONGEST_STILL = 0.1  # [s] for which the picture may stay while the hand moves
_LONGEST_NAME = 200  # characters of a file in the address of a page


class PageSession:
    """State of one open page.

    Args:
        document: The Bokeh document of the page.
        scene: The first scene.
        folder: Folder in which files are saved.
        variant: Variant of the colours of `PALETTE`: 0 for light, 1 for dark pages.
    """

    def __init__(self, document: Document, scene: EditedScene, folder: Path, variant: int = 0) -> None:
        from bokeh.events import DocumentReady
        from bokeh.models import Div

        self.document, self.folder = document, folder
        self.shown: DrawnPlan | None = None
        self._number = 0
        self._before_slider: EditedScene | None = None  # while a slider moves
        self._sent_at = 0.0  # [s]
        self.history = SceneHistory(scene, self._changed)
        self.view = SceneView(scene, variant)
        self.curves = CurveView(self.view.source(GHOST), variant)
        self.fields = FieldView(self._set_field)
        self.toolbar = PageToolbar(self)
        self.pointer = ScenePointer(document, self.view, self.history, self.show_scene)
        self.message, self.words = (Div(text="", sizing_mode="stretch_width") for _ in range(2))
        self.data = Div(visible=False, tags=[self.view.data.post])
        document.on_event(DocumentReady, lambda _: self.view.data.begin())
        self._compose(variant)
        self.process = RequestProcess(self._answered)
        document.on_session_destroyed(lambda _: self.process.close())
        self._changed(in_hand=False, fault="")

    def say(self, text: str, *, is_bad: bool = False) -> None:
        """Show a message; an empty one clears it."""
        role, grade = ("alert", "bad") if is_bad else ("status", "good")
        self.message.text = f'<p role="{role}" class="{grade}">{escape(text)}</p>' if text else ""

    def load_worked(self, stem: str) -> None:
        """Show a worked scene, see `worked_scenes`."""
        for path in worked_scenes():
            if path.stem == stem:
                self._load(open_scene(path.name, path.parent))

    def _load(self, scene: EditedScene) -> None:
        self.view.look_at(view_of(scene.problem, []), extends=False)
        self.history.edit(lambda _: scene)

    def drive(self) -> None:
        """Request a simulated drive along the plan."""
        self._number += 1
        scene = self.history.scene
        self.process.ask_drive(scene.scenario, self._number, scene.fingerprint)
        with self._one_message():
            self._show_status("driving")

    def show_scene(self) -> None:
        """Draw the scene and the selected part."""
        with self._one_message():
            self._draw_scene()

    def _draw_scene(self) -> None:
        history = self.history
        self.view.show(history.scene, history.selected)
        self.toolbar.show([one.name for one in history.scene.handles()], history.selected)

    # Changes of the scene.

    def _set_field(self, key: str, text: str, moves: bool) -> None:  # noqa: FBT001 - a callback
        change = functools.partial(with_field, key=key, text=text)
        base = self._before_slider
        if moves:
            self._before_slider = base or self.history.scene
            self.history.edit(change, in_hand=True)
        elif base is not None:
            self._before_slider = None
            self.history.drop(base, change)
        else:
            self.history.edit(change)

    def _changed(self, *, in_hand: bool, fault: str) -> None:
        """Show the scene after a change, and request a plan.

        A scene in the hand is sent with its answer, unless the last picture is older than `_LONGEST_STILL`.
        """
        is_due = not in_hand or time.monotonic() - self._sent_at > _LONGEST_STILL
        with self._one_message(sends=is_due):
            self.say(fault, is_bad=True)
            if not fault:
                self._ask(in_hand=in_hand)
            self._draw_scene()
            if not in_hand:
                self.fields.show(self.history.scene)
                self.toolbar.link.text = _link_to(self.history.scene)

    def _ask(self, *, in_hand: bool) -> None:
        scene = self.history.scene
        self._number += 1
        self.process.ask(scene.scenario, self._number, scene.fingerprint, in_hand=in_hand)
        self._show_status("planning")
        number = self._number
        self.document.add_timeout_callback(lambda: self._fade(number), _STALE)

    # Answers.

    @contextlib.contextmanager
    def _one_message(self, *, sends: bool = True) -> Iterator[None]:
        """Send all changes within the context as one message.

        The layers of the figure are sent once, at the end: Bokeh combines changes of a property by dropping all but the
        last one.

        Args:
            sends: Whether the layers of the figure are sent as well.
        """
        self.document.hold("combine")
        try:
            yield
            if sends:
                self.view.data.send()
                self._sent_at = time.monotonic()
        finally:
            self.document.unhold()

    def _answered(self) -> None:
        """Let the event loop of the page show the answers; called in another thread."""
        self.document.add_next_tick_callback(self._show_answers)

    def _show_answers(self) -> None:
        answers = self.process.answers()
        if not answers:
            return
        with self._one_message():
            if isinstance(answers[-1], DrawnPlan):
                self._show_plan(answers[-1])
            else:
                self._show_drive(answers[-1])

    def _show_plan(self, drawn: DrawnPlan) -> None:
        if drawn.outcome == "cancelled" and drawn.number < self._number:
            return  # a newer request replaced it
        self.shown = drawn
        self._show_status("planning" if drawn.number < self._number else "")
        self.view.show_answer(drawn)
        if not self.pointer.is_dragging:
            self.view.look_at(drawn.view)
            self.curves.show(drawn.motion, drawn.outline)
            self.words.text = answer_html(drawn)

    def _show_drive(self, drive: DrivenPlan) -> None:
        self._show_status("")
        if drive.fingerprint != self.history.scene.fingerprint:
            return
        self.view.show_drive(drive)
        if self.shown is not None and len(drive.times):
            self.curves.show_player(drive.times, drive.poses, self.shown.outline)
        self.say(drive_text(drive), is_bad=drive.outcome != "docked")

    def _show_status(self, doing: str) -> None:
        self.view.show_status(status_html(self.history.scene.fingerprint, self.shown, doing))

    def _fade(self, number: int) -> None:
        """Fade the answer if it still belongs to another scene than that of a request."""
        if number == self._number and self.shown is not None:
            with self._one_message():
                self.view.fade(faded=self.shown.fingerprint != self.history.scene.fingerprint)

    def _compose(self, variant: int) -> None:
        """Add the roots of the document to its template."""
        from jinja2 import Environment, PackageLoader

        curves, groups = self.curves, self.fields.groups
        roots: dict[str, Any] = {
            "scene": self.view.axes, "curves": curves.charts, "player": curves.slider, "play": curves.play,
            "data": self.data, "curve_data": curves.holder, "message": self.message,
            "words": self.words, **self.toolbar.roots, **{f"fields_{name}": group for name, group in groups.items()},
        }  # fmt: skip
        for name, root in roots.items():
            root.name = name
            self.document.add_root(root)
        loader = PackageLoader("optdock.ui", "templates")
        environment = Environment(loader=loader, autoescape=False)
        self.document.template = environment.get_template("ui.html")
        self.document.template_variables.update(
            palette={name: colours[variant] for name, colours in PALETTE.items()},
            style=loader.get_source(environment, "ui.css")[0],
            script=loader.get_source(environment, "ui.js")[0],
            version=__version__,
            groups=list(self.fields.groups),
            dark=bool(variant),
        )
        self.document.title = "optdock"


def _link_to(scene: EditedScene) -> str:
    try:
        return to_link(scene)
    except InvalidValue:  # a map, or a scene that is too large
        return ""


def make_page(document: Document, source: Path | None, folder: Path, arguments: Mapping[str, list[bytes]]) -> None:
    """Fill the document of a page that was opened.

    Args:
        document: The document.
        source: File with which the program was started, or None.
        folder: Folder in which the page may read and write files.
        arguments: Arguments of the query: `scene`, a link; `file`, a file in the folder; `theme`, `dark` or nothing.
            An argument that is wrong becomes a message on the page with the first scene.
    """
    given = {name: arguments.get(name, [b""])[0].decode("utf-8", "replace") for name in ("scene", "file", "theme")}
    fault = ""
    try:
        scene = _first_scene(source, folder, given)
    except OptdockError as error:
        scene, fault = open_scene(source, folder), str(error)
    page = PageSession(document, scene, folder, int(given["theme"] == "dark"))
    if fault:
        page.say(fault, is_bad=True)


def _first_scene(source: Path | None, folder: Path, given: Mapping[str, str]) -> EditedScene:
    if given["scene"]:
        return from_link(given["scene"])
    if len(given["file"]) > _LONGEST_NAME:
        raise InvalidValue(f"file: must have at most {_LONGEST_NAME} characters, got {shown(given['file'])}")
    return open_scene(given["file"] or source, folder)
