"""Error messages for files, in the form `file:line: key: rule, got value`."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, NamedTuple

from optdock.errors import InvalidValue
from optdock.io.quoting import listed, shown
from optdock.plugins.parameters import closest

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from pydantic import ValidationError

    from optdock.io.yaml_lines import Document, Keys

__all__ = ["Fault", "faults_of", "report"]

# Rules by pydantic's error types; each is followed by ", got VALUE".
_RULES = {
    "float_type": "must be a number",
    "float_parsing": "must be a number",
    "finite_number": "must be finite",
    "int_type": "must be a whole number",
    "int_parsing": "must be a whole number",
    "int_from_float": "must be a whole number",
    "bool_type": "must be true or false",
    "bool_parsing": "must be true or false",
    "string_type": "must be text",
    "invalid_key": "a key must be text",
    "list_type": "must be a list",
    "dict_type": "must be a mapping",
    "model_type": "must be a mapping",
    "model_attributes_type": "must be a mapping",
}
_BOUNDS = {"greater_than": (">", "gt"), "greater_than_equal": (">=", "ge")}
_BOUNDS |= {"less_than": ("<", "lt"), "less_than_equal": ("<=", "le")}
_OWNER = re.compile(r"^([a-z_]+(?:\.[a-z_]+|\[\d+\])*): ")
_MOST = 1000  # faults that are converted before they are sorted by line


class Fault(NamedTuple):
    """One violation of a rule, with the key and the message."""

    key: Keys
    message: str


def faults_of(
    error: ValidationError,
    known: Callable[[Keys], Iterable[str]],
    base: Keys = (),
    synonym: Callable[[Keys, object], str] = lambda _key, _value: "",
) -> list[Fault]:
    """Return the faults of a pydantic validation.

    Args:
        error: The error of pydantic.
        known: Function that returns the keys of the mapping at a key, for suggestions.
        base: Key of the validated part in the file.
        synonym: Function that returns the suggestion for an unknown key and its value, or "".
    """
    return [_fault(item, known, base, synonym) for item in error.errors(include_url=False)[:_MOST]]


def _fault(
    item: Mapping[str, object],
    known: Callable[[Keys], Iterable[str]],
    base: Keys,
    synonym: Callable[[Keys, object], str],
) -> Fault:
    location = item["loc"]
    key = location if isinstance(location, tuple) else ()
    kind, context = str(item["type"]), item.get("ctx")
    details = context if isinstance(context, dict) else {}
    if kind == "missing":
        return Fault(base + key, "is required")
    if kind == "extra_forbidden":
        hint = synonym(key, item["input"]) or closest(str(key[-1]), known(key[:-1]))
        return Fault(base + key, f"unknown key{hint}")
    if kind == "value_error":
        # Messages of InvalidValue contain the value; messages of a bare ValueError do not.
        got = "" if isinstance(details.get("error"), InvalidValue) else f", got {shown(item['input'])}"
        return _value_fault(base + key, f"{details.get('error')}{got}")
    return Fault(base + key, f"{_rule(kind, details, str(item['msg']))}, got {shown(item['input'])}")


def _value_fault(key: Keys, message: str) -> Fault:
    """Replace the value's name in the message of a constructor by the value's key in the file."""
    found = _OWNER.match(message)
    if found is None:
        return Fault(key, message)
    owner, dot, part = found[1].partition(".")
    return Fault((*key, part) if dot and key[-1:] == (owner,) else key, message[found.end() :])


def _rule(kind: str, details: Mapping[str, object], message: str) -> str:
    if kind in ("literal_error", "enum"):
        return f"must be {str(details['expected']).replace(chr(39), '')}"
    if kind in _BOUNDS:
        sign, name = _BOUNDS[kind]
        return f"must be {sign} {details[name]}"
    return _RULES.get(kind, message)


def report(faults: Iterable[Fault], document: Document) -> str:
    """Return one line for every fault, in the order of the file."""
    ordered = sorted(faults, key=lambda fault: document.line_of(fault.key))
    return listed(str(document.path), [document.fault(*fault) for fault in ordered])
