"""YAML with line numbers, so that a message can name the line that a value came from."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

import yaml

from optdock.errors import InvalidFile

if TYPE_CHECKING:
    from collections.abc import Mapping

__all__ = ["Document", "Keys", "load_yaml", "printable"]

Keys: TypeAlias = "tuple[str | int, ...]"

# What PyYAML's constructors let through on the date 2026-13-45, the number 0x_, an empty !!int or a wrong !!timestamp.
_SCALAR_ERRORS = (ValueError, OverflowError, IndexError, AttributeError)
_MAX_DEPTH = 100
_MAX_REPEATS = 100_000  # aliases can make a small file expand without end


def printable(text: str) -> str:
    r"""The text on one line, with control characters written as escapes: a file's own words may hold anything.

    >>> print(printable("a\x1b[1m\nb"))
    a\x1b[1m\nb
    """
    return "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)


class _Loader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc] # the C loader is optional
    """PyYAML's safe loader that reads 1e-3 and 1.5e3 as numbers, as YAML 1.2 and Nav2's parser do."""


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"^[-+]?(?:[0-9][0-9_]*\.?[0-9_]*|\.[0-9][0-9_]*)[eE][-+]?[0-9]+$"),
    list("-+0123456789."),
)


@dataclass(frozen=True, eq=False)
class Document:
    """A YAML file: its value and where everything in it stands.

    Args:
        path: The file, as the caller named it.
        value: Mappings, lists, strings, numbers, booleans, None.
        lines: Line of every key and list entry, counted from 1.
    """

    path: Path
    value: object
    lines: Mapping[Keys, int] = field(repr=False)

    def line_of(self, keys: Keys) -> int:
        """Line of `("robot", "limits", "max_speed")`, or of the nearest enclosing entry that exists; the file is 1.

        >>> Document(Path("a.yaml"), {"a": {}}, {("a",): 3}).line_of(("a", "missing"))
        3
        """
        return next((self.lines[keys[:n]] for n in range(len(keys), 0, -1) if keys[:n] in self.lines), 1)

    def fault(self, keys: Keys, message: str) -> str:
        """One line of an error message: `file:line: dotted.key: message`.

        >>> Document(Path("a.yaml"), {"v": -1}, {("v",): 7}).fault(("v",), "must be > 0, got -1")
        'a.yaml:7: v: must be > 0, got -1'
        """
        name = ".".join(str(key) for key in keys)
        place = f"{self.path}:{self.line_of(keys)}: " if keys else f"{self.path}: "
        return place + printable(f"{name}: {message}" if keys else message)


def load_yaml(path: str | Path) -> Document:
    """Read one YAML document.

    Raises:
        InvalidFile: Unreadable, not UTF-8, not YAML, empty, more than one document, repeated keys, keys that are
            neither text nor whole numbers, or entries that contain themselves; every repeated key is listed.
    """
    path = Path(path)
    text = _text(path)
    try:
        loader = _Loader(text)
    except yaml.YAMLError as error:  # control characters
        raise InvalidFile(_yaml_fault(path, text, error)) from error
    try:
        root = loader.get_single_node()
        if root is None:
            raise InvalidFile(f"{path}: is empty")
        reader = _Reader(path, loader)
        value = reader.value_of(root, ())
        if reader.faults:
            raise InvalidFile("\n".join(reader.faults))
        return Document(path, value, reader.lines)
    except yaml.YAMLError as error:
        raise InvalidFile(_yaml_fault(path, text, error)) from error
    except RecursionError as error:
        raise InvalidFile(f"{path}: is nested too deeply") from error
    finally:
        loader.dispose()


def _text(path: Path) -> str:
    try:
        return path.read_bytes().decode("utf-8-sig")
    except OSError as error:
        raise InvalidFile(f"{path}: cannot be read: {error.strerror or error}") from error
    except ValueError as error:  # not UTF-8, or a path with a zero byte
        raise InvalidFile(f"{path}: cannot be read as UTF-8 text: {error}") from error


def _yaml_fault(path: Path, text: str, error: yaml.YAMLError) -> str:
    mark = getattr(error, "problem_mark", None)
    where = f"{path}:{mark.line + 1}" if mark is not None else str(path)
    if mark is not None and text[mark.index : mark.index + 1] == "\t":
        return f"{where}: is not valid YAML: a tab stands where only spaces may; indent with spaces"
    reason = getattr(error, "problem", None) or getattr(error, "reason", None) or str(error)
    if reason.startswith("but "):  # the other half of the sentence
        reason = f"{getattr(error, 'context', None)}, {reason}"
    return f"{where}: is not valid YAML: {reason}"


class _Reader:
    """Makes plain values of nodes: notes lines, finds repeated keys, refuses what cannot be a plain value."""

    def __init__(self, path: Path, loader: _Loader) -> None:
        self.lines: dict[Keys, int] = {}
        self.faults: list[str] = []
        self._path, self._loader = path, loader
        self._seen: set[int] = set()
        self._repeats = 0

    def value_of(self, node: yaml.Node, keys: Keys) -> object:
        is_first_visit = id(node) not in self._seen
        self._seen.add(id(node))
        self._repeats += not is_first_visit
        if len(keys) > _MAX_DEPTH or self._repeats > _MAX_REPEATS:
            raise InvalidFile(
                f"{self._place(node)}: is nested too deeply, contains itself, or repeats too many aliases"
            )
        if isinstance(node, yaml.ScalarNode):
            return self._scalar(node)
        if isinstance(node, yaml.SequenceNode) and node.tag == "tag:yaml.org,2002:seq":
            return [self._entry(entry, entry, keys, i) for i, entry in enumerate(node.value)]
        if not isinstance(node, yaml.MappingNode) or node.tag != "tag:yaml.org,2002:map":
            raise InvalidFile(f"{self._place(node)}: is not valid YAML: {node.tag} is no plain list or mapping")
        if is_first_visit:
            self._check_keys(node)
            self._loader.flatten_mapping(node)  # replaces `<<` by what it merges
        return {key: self._entry(k, v, keys, key) for k, v in node.value for key in [self._key_of(k)]}

    def _entry(self, marked: yaml.Node, node: yaml.Node, outer: Keys, key: str | int) -> object:
        keys = (*outer, key)
        self.lines[keys] = marked.start_mark.line + 1
        return self.value_of(node, keys)

    def _place(self, node: yaml.Node) -> str:
        return f"{self._path}:{node.start_mark.line + 1}"

    def _scalar(self, node: yaml.ScalarNode) -> object:
        try:
            return self._loader.construct_object(node)
        except _SCALAR_ERRORS as error:
            self.faults.append(f"{self._place(node)}: {node.value!r} cannot be read: {error}")
            return None

    def _key_of(self, node: yaml.Node) -> str | int:
        try:
            key = self._loader.construct_object(node) if isinstance(node, yaml.ScalarNode) else None
        except _SCALAR_ERRORS as error:
            raise InvalidFile(f"{self._place(node)}: key {node.value!r} cannot be read: {error}") from error
        if isinstance(key, (str, int)) and not isinstance(key, bool):
            return key
        text = repr(node.value) if isinstance(node, yaml.ScalarNode) else "a collection"
        raise InvalidFile(f"{self._place(node)}: a key must be text or a whole number, got {text}")

    def _check_keys(self, node: yaml.MappingNode) -> None:
        first: dict[str | int, int] = {}
        for key_node, _ in node.value:
            if key_node.tag == "tag:yaml.org,2002:merge":
                continue
            key = self._key_of(key_node)
            if key in first:
                self.faults.append(
                    f"{self._place(key_node)}: {printable(str(key))}: stands here again; first in line {first[key]}"
                )
            first.setdefault(key, key_node.start_mark.line + 1)
