"""Buttons and menus of the page: parts, edits, requests, files and links."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from optdock.ui.scene_files import worked_scenes
from optdock.ui.scene_history import STEP, TURN

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from bokeh.models import Button

    from optdock.ui.scene_history import SceneHistory

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

    Attribute `link`: its text becomes the link in the address of the page.

    Args:
        history: The scene.
        calls: Functions of the buttons `Add box`, `Add wall`, `Cancel`, `Drive`, `Save` and `Copy link`.
        on_select: Called after a part was selected.
        on_scene: Called with the name of a worked scene that was chosen.
    """

    def __init__(
        self,
        history: SceneHistory,
        calls: Mapping[str, Callable[[], object]],
        on_select: Callable[[], object],
        on_scene: Callable[[str], object],
    ) -> None:
        from bokeh.layouts import column, row
        from bokeh.models import Checkbox, CustomJS, Div, Select, TextInput

        self._history, self._cancel, self._on_select = history, calls["Cancel"], on_select
        self.link = Div(text="", visible=False)
        self.link.js_on_change("text", CustomJS(args={"link": self.link}, code=_LINKED))
        # The script of the page writes the name of a pressed key and a counter.
        self._keys = TextInput(value="", visible=False)
        self._keys.on_change("value", lambda _, __, value: self._pressed(str(value).partition(" ")[0]))
        self._part = Select(title="part", options=["start"], value="start", width=180)
        self._part.on_change("value", lambda _, __, value: self._selected(str(value)))
        self._scenes = Select(title="scene", options=["", *(path.stem for path in worked_scenes())], width=180)
        self._scenes.on_change("value", lambda _, __, value: on_scene(str(value)))
        self._name = TextInput(title="name", value="scene", width=180)
        self._replace = Checkbox(label="replace existing files", active=False)
        files = [_button(label, calls[label]) for label in ("Save", "Copy link")]
        files[1].js_on_event("button_click", CustomJS(args={"link": self.link}, code=_LINKED + _COPY))
        nudge, turn = history.nudge, history.turn
        moves: dict[str, Callable[[], object]] = {
            "←": lambda: nudge(-STEP, 0.0), "→": lambda: nudge(STEP, 0.0), "↑": lambda: nudge(0.0, STEP),
            "↓": lambda: nudge(0.0, -STEP), "⟲": lambda: turn(TURN), "⟳": lambda: turn(-TURN),
        }  # fmt: skip
        edits = {
            "Undo": history.undo, "Redo": history.redo, "Add box": calls["Add box"], "Add wall": calls["Add wall"],
            "Remove": history.remove, "Cancel": calls["Cancel"], "Drive": calls["Drive"],
        }  # fmt: skip
        style = {"flex-wrap": "wrap"}
        self.roots: dict[str, Any] = {
            "edits": row([_button(label, call) for label, call in edits.items()], styles=style),
            "parts": row(
                [self._part, *(_button(label, call, 44) for label, call in moves.items())],
                styles={**style, "align-items": "end"},
            ),
            "files": column([self._scenes, self._name, self._replace, row(files, styles=style)]),
            "link": self.link,
            "keys": self._keys,
        }

    @property
    def file_name(self) -> str:
        """Name under which the scene is saved."""
        return str(self._name.value)

    @property
    def is_replacing(self) -> bool:
        """Whether existing files are replaced."""
        return bool(self._replace.active)

    def show(self, names: list[str], selected: str) -> None:
        """Show the parts of a scene and the selected one."""
        bodies = [name for name in names if ".corners" not in name and not name.endswith(".heading")]
        if selected not in bodies:
            bodies.append(selected)
        if bodies != self._part.options:  # Bokeh checks every new option
            self._part.options = bodies
        self._part.value = selected

    def _pressed(self, key: str) -> None:
        if key == "Escape":
            self._cancel()
        else:
            self._history.press(key)

    def _selected(self, name: str) -> None:
        if name != self._history.selected:
            self._history.select(name)
            self._on_select()


def _button(label: str, call: Callable[[], object], width: int = 92) -> Button:
    from bokeh.models import Button

    button = Button(label=label, width=width)
    button.on_event("button_click", lambda _: call())
    return button
