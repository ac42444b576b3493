"""YAML with line numbers for messages.

Aliases and merge keys can expand a few bytes of YAML to a very large document, so the values are counted before any
value is constructed, first as written and then as expanded.
"""

from __future__ import annotations

import itertools
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

import yaml

from optdock.errors import InvalidFile
from optdock.io.guarded_file import MostBytes, read_text
from optdock.io.quoting import listed, printable, shortened, shown

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

__all__ = ["Document", "Keys", "load_yaml", "parse_yaml"]

Keys: TypeAlias = "tuple[str | int, ...]"

# Raised by PyYAML's constructors for the date 2026-13-45, the number 0x_, an empty !!int or a wrong !!timestamp.
_SCALAR_ERRORS = (ValueError, OverflowError, IndexError, AttributeError)
_MAX_DEPTH = 100
# Scalars and collections, aliases expanded; the largest parameter files have two thousand.
_MAX_VALUES = 50_000
_MAX_NUMBER = 1000  # characters of a value that is not text; integers in base 60 take quadratic time
_LONGEST_LINE = 400  # characters of a message about one value


class _Loader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc] # the C loader is optional
    """PyYAML's safe loader, extended to read 1e-3 and 1.5e3 as numbers, like YAML 1.2 and Nav2's parser."""


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"^[-+]?(?:[0-9][0-9_]*\.?[0-9_]*|\.[0-9][0-9_]*)[eE][-+]?[0-9]+$"),
    list("-+0123456789."),
)


@dataclass(frozen=True, eq=False)
class Document:
    """A YAML file: its value, and the lines of its keys.

    Args:
        path: Path of the file as given by the caller.
        value: Mappings, lists, strings, numbers, booleans, None.
        lines: Line of every key and list entry, counted from 1.
    """

    path: Path
    value: object
    lines: Mapping[Keys, int] = field(repr=False)

    def line_of(self, keys: Keys) -> int:
        """Return the line of a key such as `("robot", "limits", "max_speed")`, or of its nearest enclosing key, or 1.

        >>> Document(Path("a.yaml"), {"a": {}}, {("a",): 3}).line_of(("a", "missing"))
        3
        """
        return next((self.lines[keys[:n]] for n in range(len(keys), 0, -1) if keys[:n] in self.lines), 1)

    def fault(self, keys: Keys, message: str) -> str:
        """Return one line of an error message: `file:line: dotted.key: message`.

        >>> Document(Path("a.yaml"), {"v": -1}, {("v",): 7}).fault(("v",), "must be > 0, got -1")
        'a.yaml:7: v: must be > 0, got -1'
        """
        name = ".".join(str(key) for key in keys)
        place = f"{self.path}:{self.line_of(keys)}: " if keys else f"{self.path}: "
        text = printable(f"{name}: {message}" if keys else message)
        return place + (text if len(text) <= _LONGEST_LINE else f"{text[:_LONGEST_LINE]}...")


def load_yaml(path: str | Path) -> Document:
    """Read one YAML document.

    Raises:
        InvalidFile: If the file is unreadable, not regular, not UTF-8, not YAML, empty, has more than one document,
            repeated keys, keys that are neither text nor integers, entries that contain themselves, or more than 50,000
            values with aliases expanded; every repeated key is listed.
    """
    path = Path(path)
    return parse_yaml(read_text(path, MostBytes.YAML), path)


def parse_yaml(text: str, path: Path) -> Document:
    """Return one YAML document from its text; no file is read.

    Args:
        text: The text.
        path: Name of the document in messages.

    Raises:
        InvalidFile: As for `load_yaml`.
    """
    try:
        _check_events(path, text)
        loader = _Loader(text)
    except yaml.YAMLError as error:
        raise InvalidFile(_yaml_fault(path, text, error)) from error
    try:
        root = loader.get_single_node()
        if root is None:
            raise InvalidFile(f"{path}: is empty")
        reader = _Reader(path, loader)
        if _expanded(root, path) > _MAX_VALUES:
            raise InvalidFile(f"{path}: holds more than {_MAX_VALUES} values, as it repeats too many aliases")
        value = reader.value_of(root, ())
        if reader.faults:
            raise InvalidFile(listed(str(path), reader.faults))
        return Document(path, value, reader.lines)
    except yaml.YAMLError as error:
        raise InvalidFile(_yaml_fault(path, text, error)) from error
    except RecursionError as error:
        raise InvalidFile(f"{path}: is nested too deeply") from error
    finally:
        loader.dispose()


def _yaml_fault(path: Path, text: str, error: yaml.YAMLError) -> str:
    mark = getattr(error, "problem_mark", None)
    where = f"{path}:{mark.line + 1}" if mark is not None else str(path)
    if mark is not None and text[mark.index : mark.index + 1] == "\t":
        return f"{where}: is not valid YAML: a tab where only spaces are allowed; indent with spaces"
    reason = getattr(error, "problem", None) or getattr(error, "reason", None) or str(error)
    if "nesting depth" in reason:  # limit of libyaml since PyYAML 6.0.4
        return f"{where}: is nested too deeply"
    if reason.startswith("but "):  # second half of a sentence
        reason = f"{getattr(error, 'context', None)}, {reason}"
    return f"{where}: is not valid YAML: {shortened(reason)}"


def _check_events(path: Path, text: str) -> None:
    """Check depth and number of values before nodes are constructed.

    Raises:
        InvalidFile: If a limit is exceeded.
        YAMLError: If the text up to the limit is not YAML.
    """
    depth = values = 0
    for event in yaml.parse(text, Loader=_Loader):
        is_begin = isinstance(event, yaml.CollectionStartEvent)
        values += is_begin or isinstance(event, yaml.ScalarEvent | yaml.AliasEvent)
        depth += is_begin - isinstance(event, yaml.CollectionEndEvent)
        if depth > _MAX_DEPTH:
            line = 1 if event.start_mark is None else event.start_mark.line + 1
            raise InvalidFile(f"{path}:{line}: is nested too deeply")
        if values > _MAX_VALUES:
            raise InvalidFile(f"{path}: holds more than {_MAX_VALUES} values")


def _expanded(root: yaml.Node, path: Path) -> int:
    """Return the number of values with every alias and merge key expanded; every node is visited once.

    Raises:
        InvalidFile: If the document is nested too deeply or contains itself.
    """
    sizes: dict[int, int] = {}
    around: set[int] = set()

    def _size(node: yaml.Node) -> int:
        known = sizes.get(id(node))
        if known is not None:
            return known
        if id(node) in around or len(around) > _MAX_DEPTH:
            raise InvalidFile(f"{path}:{node.start_mark.line + 1}: is nested too deeply, or contains itself")
        around.add(id(node))
        parts: Iterable[yaml.Node] = ()
        if isinstance(node, yaml.SequenceNode):
            parts = node.value
        elif isinstance(node, yaml.MappingNode):
            parts = itertools.chain.from_iterable(node.value)
        sizes[id(node)] = 1 + sum(map(_size, parts))
        around.remove(id(node))
        return sizes[id(node)]

    return _size(root)


class _Reader:
    """Conversion of nodes to plain values; records lines and repeated keys."""

    def __init__(self, path: Path, loader: _Loader) -> None:
        self.lines: dict[Keys, int] = {}
        self.faults: list[str] = []
        self._path, self._loader = path, loader
        self._seen: set[int] = set()

    def value_of(self, node: yaml.Node, keys: Keys) -> object:
        is_first_visit = id(node) not in self._seen
        self._seen.add(id(node))
        if isinstance(node, yaml.ScalarNode):
            return self._scalar(node)
        if isinstance(node, yaml.SequenceNode) and node.tag == "tag:yaml.org,2002:seq":
            return [self._entry(entry, entry, keys, i) for i, entry in enumerate(node.value)]
        if not isinstance(node, yaml.MappingNode) or node.tag != "tag:yaml.org,2002:map":
            raise InvalidFile(
                f"{self._place(node)}: is not valid YAML: {shortened(node.tag)} is not a plain list or mapping"
            )
        if is_first_visit:
            self._check_keys(node)
            self._loader.flatten_mapping(node)  # expands `<<`
        return {key: self._entry(k, v, keys, key) for k, v in node.value for key in [self._key_of(k)]}

    def _entry(self, marked: yaml.Node, node: yaml.Node, outer: Keys, key: str | int) -> object:
        keys = (*outer, key)
        self.lines[keys] = marked.start_mark.line + 1
        return self.value_of(node, keys)

    def _place(self, node: yaml.Node) -> str:
        return f"{self._path}:{node.start_mark.line + 1}"

    def _scalar(self, node: yaml.ScalarNode) -> object:
        try:
            return self._made(node)
        except _SCALAR_ERRORS as error:
            self.faults.append(f"{self._place(node)}: {shown(node.value)} cannot be read: {shortened(str(error))}")
            return None

    def _made(self, node: yaml.ScalarNode) -> object:
        if node.tag != "tag:yaml.org,2002:str" and len(node.value) > _MAX_NUMBER:
            raise ValueError(f"it has more than {_MAX_NUMBER} characters; write text in quotes")
        value: object = self._loader.construct_object(node)
        return value

    def _key_of(self, node: yaml.Node) -> str | int:
        try:
            key = self._made(node) if isinstance(node, yaml.ScalarNode) else None
        except _SCALAR_ERRORS as error:
            reason = shortened(str(error))
            raise InvalidFile(f"{self._place(node)}: key {shown(node.value)} cannot be read: {reason}") from error
        if isinstance(key, (str, int)) and not isinstance(key, bool):
            return key
        text = shown(node.value) if isinstance(node, yaml.ScalarNode) else "a collection"
        raise InvalidFile(f"{self._place(node)}: a key must be text or a whole number, got {text}")

    def _check_keys(self, node: yaml.MappingNode) -> None:
        first: dict[str | int, int] = {}
        for key_node, _ in node.value:
            if key_node.tag == "tag:yaml.org,2002:merge":
                continue
            key = self._key_of(key_node)
            if key in first:
                self.faults.append(
                    f"{self._place(key_node)}: {shortened(str(key))}: is repeated; first in line {first[key]}"
                )
            first.setdefault(key, key_node.start_mark.line + 1)
