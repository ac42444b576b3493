"""Widgets for the fields of a scene: a slider and a text for every number, a menu for every choice."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

from optdock.io.quoting import in_digits
from optdock.ui.scene_fields import FIELDS, UNLIMITED

if TYPE_CHECKING:
    from collections.abc import Callable

    from bokeh.models import LayoutDOM, Select, Slider, TextInput

    from optdock.ui.scene_edits import EditedScene
    from optdock.ui.scene_fields import SceneField

__all__ = ["GROUPS", "FieldView"]

GROUPS = ("robot", "dock", "clearance", "planning")


class _Widgets(NamedTuple):
    field: SceneField
    box: LayoutDOM
    text: TextInput | Select
    slider: Slider | None


def _group_of(field: SceneField) -> str:
    first = field.key.partition(".")[0]
    return first if first in GROUPS else "planning"


class FieldView:
    """Widgets of all fields, in groups by the first part of their keys.

    Args:
        on_change: Called with the key and the text of a field that the user has changed, and whether the slider still
            moves.
    """

    def __init__(self, on_change: Callable[[str, str, bool], object]) -> None:
        from bokeh.layouts import column

        self._on_change = on_change
        # Texts of the values that `show` entered, as their callbacks may come after it, and are no changes by the user.
        self._entered: dict[str, str] = {}
        self._widgets = [self._made(field) for field in FIELDS.values()]
        self.groups = {
            name: column(
                [one.box for one in self._widgets if _group_of(one.field) == name],
                sizing_mode="stretch_width",
                name=f"fields_{name}",
            )
            for name in GROUPS
        }

    def show(self, scene: EditedScene) -> None:
        """Enter the values of a scene; fields that it does not have are hidden."""
        for field, box, text, slider in self._widgets:
            value, entered = field.read(scene), field.text(scene)
            self._entered[field.key] = entered
            if slider is not None and isinstance(value, int | float) and math.isfinite(value):
                slider.update(start=min(slider.start, value), end=max(slider.end, value), value=value, title=None)
            box.visible = value is not None
            text.value = entered

    def _made(self, field: SceneField) -> _Widgets:
        from bokeh.layouts import row
        from bokeh.models import Select, Slider, TextInput

        label = f"{field.label} [{field.unit}]" if field.unit else field.label
        words = f"{field.words}; '{UNLIMITED}' for no limit" if field.can_be_unlimited else field.words
        if field.slider is None:
            menu = Select(title=label, options=list(field.choices()), description=words, sizing_mode="stretch_width")
            menu.on_change("value", lambda _, __, value: self._changed(field.key, str(value)))
            return _Widgets(field, menu, menu, None)
        low, high, step = field.slider
        text = TextInput(title=label, description=words, width=110, name=field.key)
        text.on_change("value", lambda _, __, value: self._changed(field.key, str(value)))
        slider = Slider(
            start=low, end=high, step=step, value=low, show_value=False, title=None, sizing_mode="stretch_width",
            align="end",
        )  # fmt: skip
        slider.on_change("value", lambda _, __, value: self._changed(field.key, in_digits(float(value)), moves=True))
        slider.on_change("value_throttled", lambda _, __, value: self._changed(field.key, in_digits(float(value))))
        return _Widgets(field, row([text, slider], sizing_mode="stretch_width"), text, slider)

    def _changed(self, key: str, text: str, *, moves: bool = False) -> None:
        if text != self._entered.get(key):
            self._entered.pop(key, None)
            self._on_change(key, text, moves)
