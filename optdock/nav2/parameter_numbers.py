"""Numbers of Nav2 parameter blocks: defaults, types and ranges, with the line in every fault."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from optdock.io.numbers import is_number, unit_fault
from optdock.io.quoting import shown

if TYPE_CHECKING:
    from collections.abc import Mapping

    from optdock.io.yaml_lines import Document, Keys

__all__ = ["NumberReader"]


class NumberReader:
    """Reads numbers from the mapping at `keys` of a document and notes what is wrong.

    Args:
        document: The file.
        keys: Where the mapping stands.
        values: The mapping.
        faults: Where faults are noted.
    """

    def __init__(self, document: Document, keys: Keys, values: Mapping[str, object], faults: list[str]) -> None:
        self._document, self._keys, self._values, self._faults = document, keys, values, faults

    def number(self, name: str, default: float, *, positive: bool = False, unit: str = "") -> float:
        """The finite number called `name`, or its default where it is absent, wrong, or implausible in its `unit`."""
        value = self._values.get(name, default)
        rule = "a number > 0" if positive else "a finite number"
        if not (is_number(value) and math.isfinite(value) and (value > 0.0 or not positive)):
            self.fault(name, f"must be {rule}, got {shown(value)}")
            return default
        implausible = unit_fault(value, unit)
        if implausible:
            self.fault(name, implausible)
            return default
        return float(value)

    def text(self, name: str, default: str) -> str:
        """The text called `name`, or its default where it is absent or wrong."""
        value = self._values.get(name, default)
        if not isinstance(value, str):
            self.fault(name, f"must be text, got {shown(value)}")
            return default
        return value

    def fault(self, name: str, message: str) -> None:
        """Note that the value called `name` is wrong."""
        self._faults.append(self._document.fault((*self._keys, name), message))
