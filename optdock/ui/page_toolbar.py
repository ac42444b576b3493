"""Buttons and menus of the page: parts, edits and requests."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from optdock.ui.scene_history import STEP, TURN

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from bokeh.models import Button

    from optdock.ui.scene_history import SceneHistory

__all__ = ["PageToolbar", "labelled_button"]


class PageToolbar:
    """Buttons and menus of a page.

    Args:
        history: The scene.
        calls: Functions of the buttons `Add box`, `Add wall`, `Cancel` and `Drive`.
        on_select: Called after a part was selected.
    """

    def __init__(
        self,
        history: SceneHistory,
        calls: Mapping[str, Callable[[], object]],
        on_select: Callable[[], object],
    ) -> None:
        from bokeh.layouts import row
        from bokeh.models import Select, TextInput

        self._history, self._cancel, self._on_select = history, calls["Cancel"], on_select
        # The script of the page writes the name of a pressed key and a counter.
        self._keys = TextInput(value="", visible=False)
        self._keys.on_change("value", lambda _, __, value: self._pressed(str(value).partition(" ")[0]))
        self._part = Select(title="part", options=["start"], value="start", width=180)
        self._part.on_change("value", lambda _, __, value: self._selected(str(value)))
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
            "edits": row([labelled_button(label, call) for label, call in edits.items()], styles=style),
            "parts": row(
                [self._part, *(labelled_button(label, call, 44) for label, call in moves.items())],
                styles={**style, "align-items": "end"},
            ),
            "keys": self._keys,
        }

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


def labelled_button(label: str, call: Callable[[], object], width: int = 92) -> Button:
    """Return a button that calls a function; `width` in pixels."""
    from bokeh.models import Button

    button = Button(label=label, width=width)
    button.on_event("button_click", lambda _: call())
    return button
