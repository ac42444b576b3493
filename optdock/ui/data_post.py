"""Columns of several Bokeh data sources as one message to the browser.

Bokeh sends every changed property, and every array in it, as messages of their own; a picture of 20 layers with 100
outlines would be several hundred. Here all columns are one JSON text in one property, which a callback in the browser
distributes, so that a picture is never shown in part. Bokeh encodes lists element by element in Python, which takes
four times as long.
"""

from __future__ import annotations

import json
import math
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Mapping

    from bokeh.models import ColumnDataSource

__all__ = ["DataPost"]

_DIGITS = 5  # of columns: 0.01 mm
_DISTRIBUTE = """
const changed = JSON.parse(post.data.json[0], (_, value) => value ?? NaN);
for (const [name, columns] of Object.entries(changed)) sources[name].data = columns;
"""


class DataPost:
    """Data sources that are changed together.

    Attributes: `columns`, the columns of every source, in which None is a number that is not finite; `is_connected`,
    whether changes are sent as messages, see `connect`.

    Args:
        sources: The sources by their names.
    """

    def __init__(self, sources: Mapping[str, ColumnDataSource]) -> None:
        from bokeh.models import ColumnDataSource, CustomJS

        self._sources, self.is_connected = dict(sources), False
        self.columns: dict[str, dict[str, Any]] = {name: {} for name in sources}
        self._waiting: dict[str, dict[str, Any]] = {}
        for source in sources.values():
            source.syncable = False  # changes in the browser are not sent back
        self.post = ColumnDataSource()
        self.post.js_on_change("data", CustomJS(args={"post": self.post, "sources": self._sources}, code=_DISTRIBUTE))

    def connect(self) -> None:
        """Send changes as messages from now on, and everything at once, as changes before may not have arrived."""
        self.is_connected = True
        self._waiting = {name: columns for name, columns in self.columns.items() if columns}
        self.send()

    def put(self, name: str, columns: Mapping[str, Any]) -> None:
        """Change the columns of a source, arrays or nested lists of arrays, with the next `send`."""
        plain = {key: _plain(column) for key, column in columns.items()}
        if plain == self.columns[name]:
            return
        self.columns[name] = plain
        if self.is_connected:
            self._waiting[name] = plain
        else:
            self._sources[name].data = {key: _with_gaps(column) for key, column in plain.items()}

    def send(self) -> None:
        """Send all changes as one message."""
        if self._waiting:
            self.post.data, self._waiting = {"json": [json.dumps(self._waiting)]}, {}


def _plain(column: Any) -> Any:  # noqa: ANN401 - nested lists
    if isinstance(column, np.ndarray):
        if column.dtype.kind != "f":
            return column.tolist()
        shown, finite = np.round(column, _DIGITS), np.isfinite(column)
        if not finite.all():
            shown = shown.astype(object)
            shown[~finite] = None
        return shown.tolist()
    return [_plain(one) for one in column] if isinstance(column, list | tuple) else column


def _with_gaps(column: Any) -> Any:  # noqa: ANN401 - as above
    if isinstance(column, list):
        return [_with_gaps(one) for one in column]
    return math.nan if column is None else column
