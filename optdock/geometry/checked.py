"""Strict checks of constructor arguments: numbers, enumeration members and classes.

Without strict checks, a number in quotes or a misspelled gear could silently disable a rule.
"""

from __future__ import annotations

import math
import numbers
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from optdock.errors import InvalidValue

if TYPE_CHECKING:
    from enum import Enum

__all__ = [
    "MOST_SAMPLES",
    "exactly",
    "finite_number",
    "instance",
    "member",
    "non_negative",
    "number",
    "positive",
    "sampling_step",
]

MOST_SAMPLES = 10_000_000  # about 1 GB; a smaller step is most likely a wrong unit

_Member = TypeVar("_Member", bound="Enum")
_Kind = TypeVar("_Kind")


def number(value: object, name: str) -> float:
    """Return a number as a float; NaN and infinity are accepted.

    Raises:
        InvalidValue: If the value is text, a bool or anything else that is not a real number.
    """
    if type(value) is float:
        return value
    if isinstance(value, np.ndarray) and value.shape == ():
        value = value[()]
    if isinstance(value, bool | np.bool_) or not isinstance(value, numbers.Real):
        raise InvalidValue(f"{name}: must be a number, got {value!r}")
    try:
        return float(value)
    except OverflowError as error:
        raise InvalidValue(f"{name}: must be finite, got an integer too large for a float") from error


def finite_number(value: object, name: str) -> float:
    """Return a finite number as a float.

    Raises:
        InvalidValue: If the value is NaN, is infinite, or is not a number.
    """
    found = number(value, name)
    if not math.isfinite(found):
        raise InvalidValue(f"{name}: must be finite, got {value}")
    return found


def non_negative(value: object, name: str, unit: str = "") -> float:
    """Return a finite number >= 0 as a float.

    Raises:
        InvalidValue: If the value is not a finite number >= 0.
    """
    found = number(value, name)
    if not (math.isfinite(found) and found >= 0.0):
        raise InvalidValue(f"{name}: must be finite and >= 0{unit and ' '}{unit}, got {found}")
    return found


def positive(value: object, name: str, unit: str = "") -> float:
    """Return a finite number > 0 as a float.

    Raises:
        InvalidValue: If the value is not a finite number > 0.
    """
    found = number(value, name)
    if not (math.isfinite(found) and found > 0.0):
        raise InvalidValue(f"{name}: must be finite and > 0{unit and ' '}{unit}, got {found}")
    return found


def sampling_step(step: object, extent: float, name: str) -> float:
    """Return a checked step between samples over `extent`, which has the same unit.

    Raises:
        InvalidValue: If the step is not finite and > 0, or gives more than `MOST_SAMPLES` samples.
    """
    found = positive(step, name)
    if extent > found * MOST_SAMPLES:
        raise InvalidValue(f"{name}: {found:g} over {extent:g} would be more than {MOST_SAMPLES} samples")
    return found


def member(kind: type[_Member], value: object, name: str) -> _Member:
    """Return the member of the enumeration `kind` that is `value` or whose value equals `value`.

    Raises:
        InvalidValue: If there is no such member; the message lists the members.

    >>> from optdock.model.dock import DockDirection
    >>> member(DockDirection, "forward", "dock.direction").name
    'FORWARD'
    """
    try:
        if not isinstance(value, bool | np.bool_):
            return kind(value)
    except (TypeError, ValueError):
        pass
    known = ", ".join(str(one.value) for one in kind)
    raise InvalidValue(f"{name}: must be one of {known}, got {value!r}")


def instance(kind: type[_Kind], value: object, name: str) -> _Kind:
    """Return the value if it is an instance of `kind`.

    Raises:
        InvalidValue: If the value is not an instance of `kind`.
    """
    if isinstance(value, kind):
        return value
    raise InvalidValue(f"{name}: must be a {kind.__name__}, got {type(value).__name__}")


def exactly(kind: type[_Kind], value: object, name: str) -> _Kind:
    """Return the value if its class is exactly `kind`; a subclass could override methods on which proofs rely.

    Raises:
        InvalidValue: If the class of the value is not exactly `kind`.
    """
    if type(value) is kind:
        return value
    raise InvalidValue(f"{name}: must be a {kind.__name__}, got {type(value).__name__}")
