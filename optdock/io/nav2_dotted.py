"""Dotted parameter names: `FollowPath.plugin: x` says the same as `FollowPath: {plugin: x}`, as in ROS."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from optdock.io.yaml_lines import Document, Keys

__all__ = ["with_nested_names"]


def with_nested_names(document: Document, below: str) -> Document:
    """The document with every dotted name under a key `below` taken apart; line numbers follow.

    A name that stands there both ways keeps its first value, and a repetition is not looked for.
    """
    lines = dict(document.lines)
    value = _nested(document.value, (), (), lines, below)
    return dataclasses.replace(document, value=value, lines=lines)


def _nested(value: object, old: Keys, new: Keys, lines: dict[Keys, int], below: str) -> object:
    """`value`, found at `old` and put at `new`; names are taken apart once `below` has been passed."""
    if not isinstance(value, Mapping):
        return value
    result: dict[object, object] = {}
    for key, inner in value.items():
        parts = _parts(key) if below in new else (key,)
        place = new + parts
        for n in range(len(new) + 1, len(place) + 1):
            lines.setdefault(place[:n], lines.get((*old, key), 1))
        _put(result, parts, _nested(inner, (*old, key), place, lines, below))
    return result


def _parts(key: str | int) -> Keys:
    parts = str(key).split(".")
    return tuple(parts) if len(parts) > 1 and all(parts) else (key,)


def _put(result: dict[object, object], parts: Keys, value: object) -> None:
    for part in parts[:-1]:
        inner = result.setdefault(part, {})
        if not isinstance(inner, dict):
            return
        result = inner
    present = result.get(parts[-1])
    if isinstance(present, dict) and isinstance(value, dict):
        for key, inner in value.items():
            _put(present, (key,), inner)
    else:
        result.setdefault(parts[-1], value)
