"""Blocks of Nav2 parameters: numbers, texts and lists of names, with defaults, rules, and line numbers of faults."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from optdock.io.numbers import is_number, unit_fault
from optdock.io.quoting import shown

if TYPE_CHECKING:
    from collections.abc import Mapping

    from optdock.io.yaml_lines import Document, Keys

__all__ = ["PARAMETERS", "ParameterBlock"]

PARAMETERS = "ros__parameters"


@dataclass(frozen=True, eq=False)
class ParameterBlock:
    """A mapping in a parameter file, such as the parameters of a node.

    Args:
        document: The file.
        keys: Position of the mapping in the file.
        values: The mapping.
        faults: Collected error messages, to which messages about wrong values are added.
    """

    document: Document
    keys: Keys
    values: Mapping[str, object]
    faults: list[str]

    @property
    def path(self) -> str:
        """Names from the outermost namespace to the node, such as `local_costmap/local_costmap`."""
        return "/".join(str(key).strip("/") for key in self.keys if key != PARAMETERS)

    def fault(self, *keys: str | int, message: str) -> None:
        """Add an error message about the value at `keys` in the block."""
        self.faults.append(self.document.fault((*self.keys, *keys), message))

    def number(self, name: str, default: float, *, positive: bool = False, unit: str = "") -> float:
        """Return a finite number, or the default if the value is absent, wrong, or implausible in its unit."""
        value = self.values.get(name, default)
        rule = "a number > 0" if positive else "a finite number"
        if not (is_number(value) and math.isfinite(value) and (value > 0.0 or not positive)):
            self.fault(name, message=f"must be {rule}, got {shown(value)}")
            return default
        implausible = unit_fault(value, unit)
        if implausible:
            self.fault(name, message=implausible)
            return default
        return float(value)

    def text(self, name: str, default: str) -> str:
        """Return a string, or the default if the value is absent or wrong."""
        value = self.values.get(name, default)
        if not isinstance(value, str):
            self.fault(name, message=f"must be text, got {shown(value)}")
            return default
        return value

    def names(self, name: str) -> tuple[str, ...]:
        """Return the valid names of a list, without duplicates."""
        value = self.values.get(name)
        if not isinstance(value, list):
            self.fault(name, message=f"must be a list of names, got {shown(value)}")
            return ()
        names = [entry for entry in value if isinstance(entry, str) and entry]
        for entry in value:
            if not (isinstance(entry, str) and entry):
                self.fault(name, message=f"must be a list of names, got {shown(entry)} in it")
        for repeated in dict.fromkeys(entry for entry in names if names.count(entry) > 1):
            self.fault(name, message=f"names {repeated} more than once")
        return tuple(dict.fromkeys(names))
