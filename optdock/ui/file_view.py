"""Widgets for files and links of a scene: worked scenes, the name for saving, and the link in the address."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING, Protocol

from optdock.errors import InvalidValue, OptdockError
from optdock.ui.page_toolbar import labelled_button
from optdock.ui.scene_files import answer_files, open_scene, saved, worked_scenes
from optdock.ui.scene_links import to_link

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from optdock.ui.drawn_plan import DrawnPlan
    from optdock.ui.scene_edits import EditedScene
    from optdock.ui.scene_history import SceneHistory

__all__ = ["FileView"]

# The address of the page contains its scene, so that it survives a reload and can be sent.
_LINKED = """
const url = new URL(window.location);
if (link.text) url.searchParams.set("scene", link.text); else url.searchParams.delete("scene");
if (link.text) url.searchParams.delete("file");
window.history.replaceState(null, "", url);
"""
_COPY = """
navigator.clipboard?.writeText(window.location.href);
"""


class PageMessage(Protocol):
    """Function that shows a message on the page."""

    def __call__(self, text: str, *, is_bad: bool = False) -> object:
        """Show a message, as an error if `is_bad`."""


class FileView:
    """Widgets with which scenes are opened, saved and linked.

    Attributes: `link`, whose text becomes the link in the address of the page; `unlinked`, the reason why the scene has
    no link; `box`, the widgets.

    Args:
        history: The scene.
        folder: Folder in which files are saved.
        answer: Function that returns the answer that is shown, or None.
        on_scene: Called with a worked scene that was chosen.
        say: Function that shows a message.
    """

    def __init__(
        self,
        history: SceneHistory,
        folder: Path,
        answer: Callable[[], DrawnPlan | None],
        on_scene: Callable[[EditedScene], object],
        say: PageMessage,
    ) -> None:
        from bokeh.layouts import column, row
        from bokeh.models import Checkbox, CustomJS, Div, Select, TextInput

        self._history, self._folder, self._answer = history, folder, answer
        self._on_scene, self._say = on_scene, say
        self.link, self.unlinked = Div(text="", visible=False), Div(text="", sizing_mode="stretch_width")
        self.link.js_on_change("text", CustomJS(args={"link": self.link}, code=_LINKED))
        self._scenes = Select(title="scene", options=["", *(path.stem for path in worked_scenes())], width=180)
        self._scenes.on_change("value", lambda _, __, value: self.load_worked(str(value)))
        self.name = TextInput(title="name", value="scene", width=180)
        self.replaces = Checkbox(label="replace existing files", active=False)
        buttons = [labelled_button("Save", self.save), labelled_button("Copy link", self._explain_link)]
        buttons[1].js_on_event("button_click", CustomJS(args={"link": self.link}, code=_LINKED + _COPY))
        self.box = column([self._scenes, self.name, self.replaces, row(buttons, styles={"flex-wrap": "wrap"})])

    def load_worked(self, stem: str) -> None:
        """Open a worked scene, see `worked_scenes`."""
        for path in worked_scenes():
            if path.stem == stem:
                self._on_scene(open_scene(path.name, path.parent))

    def save(self) -> None:
        """Write scenario, plan file and report of the scene into the folder."""
        name, drawn, scene = str(self.name.value), self._answer(), self._history.scene
        is_answered = drawn is not None and drawn.fingerprint == scene.fingerprint and drawn.outcome != "cancelled"
        try:
            beside = answer_files(drawn, scene, name) if drawn is not None and is_answered else {}
            files = saved(scene, name, self._folder, overwrite=bool(self.replaces.active), beside=beside)
            self._say(f"saved: {', '.join(file.name for file in files)}")
        except OptdockError as error:
            self._say(str(error), is_bad=True)

    def show_link(self) -> None:
        """Let the address of the page contain the scene, or show the reason why it cannot."""
        link, reason = "", ""
        try:
            link = to_link(self._history.scene, self._folder)
        except InvalidValue as error:
            reason = f"{error}; save the scenario: a reload or a lost connection loses changes that are not saved"
        self.link.text = link
        self.unlinked.text = f'<p role="note" class="unlinked">{escape(reason)}</p>' if reason else ""

    def _explain_link(self) -> None:
        with_map = self._history.scene.problem.costmap is not None
        words = ", without its map; it opens in the same folder" if with_map else ""
        if self.link.text:
            self._say(f"The address of this page contains the scene{words}.")
        else:
            self._say("This scene has no link; save it instead.", is_bad=True)
