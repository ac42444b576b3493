"""What a frozen value takes for a number, a word or a part: the thing itself, never something that looks like it.

A wrong word for a gear or a quoted number that passes construction would switch a rule off later, in silence.
"""

from __future__ import annotations

import math
import numbers
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from optdock.errors import InvalidValue

if TYPE_CHECKING:
    from enum import Enum

__all__ = ["MOST_SAMPLES", "exactly", "finite_number", "instance", "member", "number", "sampling_step"]

MOST_SAMPLES = 10_000_000  # at once, about 1 GB; a smaller step is a mistake of units

_Member = TypeVar("_Member", bound="Enum")
_Kind = TypeVar("_Kind")


def number(value: object, name: str) -> float:
    """A number as a float; infinity and NaN are left to the caller's rule.

    Raises:
        InvalidValue: Text, a switch, or anything else that is not a real number.
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
        raise InvalidValue(f"{name}: must be finite, got an integer beyond all floats") from error


def finite_number(value: object, name: str) -> float:
    """A finite number as a float.

    Raises:
        InvalidValue: No number, NaN or infinity.
    """
    found = number(value, name)
    if not math.isfinite(found):
        raise InvalidValue(f"{name}: must be finite, got {value}")
    return found


def sampling_step(step: object, extent: float, name: str) -> float:
    """A step between samples over `extent`, both in the same unit.

    Raises:
        InvalidValue: It is not a finite number > 0, or there would be more than `MOST_SAMPLES`.
    """
    found = finite_number(step, name)
    if not found > 0.0:
        raise InvalidValue(f"{name}: must be > 0, got {step}")
    if extent > found * MOST_SAMPLES:
        raise InvalidValue(f"{name}: {found:g} over {extent:g} would be more than {MOST_SAMPLES} samples")
    return found


def member(kind: type[_Member], value: object, name: str) -> _Member:
    """The member of an enumeration that `value` is, or whose exact value it is.

    Raises:
        InvalidValue: No such member; the message lists them.

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
    """The value itself, if it is of this class.

    Raises:
        InvalidValue: It is of another class.
    """
    if isinstance(value, kind):
        return value
    raise InvalidValue(f"{name}: must be a {kind.__name__}, got {type(value).__name__}")


def exactly(kind: type[_Kind], value: object, name: str) -> _Kind:
    """The value itself, if it is of this class and of no subclass, which could be something else in the same clothes.

    Raises:
        InvalidValue: It is of another class.
    """
    if type(value) is kind:
        return value
    raise InvalidValue(f"{name}: must be a {kind.__name__}, got {type(value).__name__}")
