"""Buttons and menus of the page: parts, edits, requests, files and links."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from optdock.errors import OptdockError
from optdock.ui.scene_files import saved, worked_scenes
from optdock.ui.scene_history import STEP, TURN

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from bokeh.models import Button

    from optdock.ui.page_session import PageSession

__all__ = ["PageToolbar"]

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


class PageToolbar:
    """Buttons and menus of a page.

    Args:
        page: The page.
    """

    def __init__(self, page: PageSession) -> None:
        from bokeh.layouts import column, row
        from bokeh.models import Checkbox, CustomJS, Div, Select, TextInput

        self._page = page
        self.link = Div(text="", visible=False)
        self.link.js_on_change("text", CustomJS(args={"link": self.link}, code=_LINKED))
        # The script of the page writes the name of a pressed key and a counter.
        self._keys = TextInput(value="", visible=False)
        self._keys.on_change("value", lambda _, __, value: self._pressed(str(value).partition(" ")[0]))
        self._part = Select(title="part", options=["start"], value="start", width=180)
        self._part.on_change("value", lambda _, __, value: self._selected(str(value)))
        self._scenes = Select(title="scene", options=["", *(path.stem for path in worked_scenes())], width=180)
        self._scenes.on_change("value", lambda _, __, value: self._open(str(value)))
        self._name = TextInput(title="name", value="scene", width=180)
        self._replace = Checkbox(label="replace existing files", active=False)
        copied = self._button("Copy link", self._explain_link)
        copied.js_on_event("button_click", CustomJS(code=_COPY))
        nudge, turn, step = page.history.nudge, page.history.turn, STEP
        moves: dict[str, Callable[[], Any]] = {
            "←": lambda: nudge(-step, 0.0), "→": lambda: nudge(step, 0.0), "↑": lambda: nudge(0.0, step),
            "↓": lambda: nudge(0.0, -step), "⟲": lambda: turn(TURN), "⟳": lambda: turn(-TURN),
        }  # fmt: skip
        edits: dict[str, Callable[[], Any]] = {
            "Undo": page.history.undo, "Redo": page.history.redo,
            "Add box": lambda: page.history.add(page.view.view, is_wall=False),
            "Add wall": lambda: page.history.add(page.view.view, is_wall=True),
            "Remove": page.history.remove, "Cancel": self._cancel, "Drive": page.drive,
        }  # fmt: skip
        style = {"flex-wrap": "wrap"}
        self.roots: dict[str, Any] = {
            "edits": row([self._button(label, call) for label, call in edits.items()], styles=style),
            "parts": row(
                [self._part, *(self._button(label, call, 44) for label, call in moves.items())],
                styles={**style, "align-items": "end"},
            ),
            "files": column(
                [self._scenes, self._name, self._replace, row([self._button("Save", self.save), copied], styles=style)]
            ),
            "link": self.link,
            "keys": self._keys,
        }

    def show(self, names: list[str], selected: str) -> None:
        """Show the parts of a scene and the selected one."""
        bodies = [name for name in names if ".corners" not in name and not name.endswith(".heading")]
        if selected not in bodies:
            bodies.append(selected)
        self._part.update(options=bodies, value=selected)

    def save(self) -> None:
        """Write scenario, plan file and report of the scene into the folder of the page."""
        page, name = self._page, str(self._name.value)
        try:
            page.say(f"saved: {', '.join(_written(page, name, overwrite=bool(self._replace.active)))}")
        except OptdockError as error:
            page.say(str(error), is_bad=True)

    def _explain_link(self) -> None:
        if self.link.text:
            self._page.say("The address of this page contains the scene.")
        else:
            self._page.say("This scene has a map or is too large for a link; save it instead.", is_bad=True)

    def _button(self, label: str, call: Callable[[], Any], width: int = 92) -> Button:
        from bokeh.models import Button

        button = Button(label=label, width=width)
        button.on_event("button_click", lambda _: call())
        return button

    def _cancel(self) -> None:
        self._page.process.cancel()

    def _pressed(self, key: str) -> None:
        if key == "Escape":
            self._cancel()
        else:
            self._page.history.press(key)

    def _selected(self, name: str) -> None:
        if name != self._page.history.selected:
            self._page.history.select(name)
            self._page.show_scene()

    def _open(self, stem: str) -> None:
        if stem:
            self._page.load_worked(stem)


def _written(page: PageSession, name: str, *, overwrite: bool) -> list[str]:
    """Write the files, and return their names."""
    from optdock.reports.html import plan_chapter, save_report

    drawn, scene = page.shown, page.history.scene
    beside: dict[str, Callable[[Path], object]] = {}
    if drawn is not None and drawn.fingerprint == scene.fingerprint and drawn.outcome != "cancelled":
        text, file, stem = drawn.plan_text, drawn.plan_file, name.removesuffix(".yaml").removesuffix(".yml")
        beside[".json"] = lambda path: path.write_text(text, encoding="utf-8")
        beside[".html"] = lambda path: save_report(path, stem, [plan_chapter(f"{stem}.json", file, scene.problem)])
    return [one.name for one in saved(scene, name, page.folder, overwrite=overwrite, beside=beside)]
