"""Memo: what was proven of a frozen value, kept for as long as that value lives.

What is judged and what it is judged against are frozen, so the same two have the same verdict. The verdicts are held
here, so that a caller cannot pass one of its own.
"""

from __future__ import annotations

import weakref
from typing import Generic, TypeVar

__all__ = ["Memo"]

Subject = TypeVar("Subject")
Value = TypeVar("Value")


class Memo(Generic[Subject, Value]):
    """The last value kept for every subject; a subject is itself, whatever it calls its equal."""

    def __init__(self) -> None:
        self._kept: dict[int, tuple[weakref.ref[Subject], Value]] = {}

    def recall(self, subject: Subject) -> Value | None:
        """What was kept for `subject`, or None."""
        known = self._kept.get(id(subject))
        return known[1] if known is not None and known[0]() is subject else None

    def keep(self, subject: Subject, value: Value) -> None:
        """Keep `value`, which must not hold `subject`, until `subject` is gone."""
        key = id(subject)
        self._kept[key] = weakref.ref(subject, lambda _: self._kept.pop(key, None)), value
