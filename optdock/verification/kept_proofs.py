"""Proofs made once: what is judged and what it is judged against are frozen, so the same two have the same verdict.

The proofs are held here, so that nobody can hand in a verdict of their own, and for as long as what was judged lives.
"""

from __future__ import annotations

import weakref
from typing import TYPE_CHECKING, Generic, Protocol, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable

__all__ = ["KeptProofs", "never"]


class _Verdict(Protocol):
    @property
    def certified(self) -> bool: ...


Subject = TypeVar("Subject")
Verdict = TypeVar("Verdict", bound=_Verdict)


def never() -> bool:
    """There is no deadline."""
    return False


class KeptProofs(Generic[Subject, Verdict]):
    """The last verdict on every subject, with what it was judged against and whether it was made to its end."""

    def __init__(self) -> None:
        self._kept: weakref.WeakKeyDictionary[Subject, tuple[Hashable, Verdict, bool]] = weakref.WeakKeyDictionary()

    def verdict(
        self,
        subject: Subject,
        against: Hashable,
        is_late: Callable[[], bool],
        prove: Callable[[Callable[[], bool]], Verdict],
    ) -> Verdict:
        """The kept verdict, or a new one.

        A proof that was cut short may be certified all the same, only not sharp: then it serves callers that have a
        deadline themselves. One that was cut short and is not certified is forgotten.

        Args:
            subject: What is judged.
            against: What it is judged against; equal where the verdict must be the same.
            is_late: The caller's deadline; `never` without one.
            prove: Makes the proof, asking the callable that it is given whether it is late.
        """
        known = self._kept.get(subject)
        if known is not None and known[0] == against and (known[2] or is_late is not never):
            return known[1]
        was_late = False

        def asked() -> bool:
            nonlocal was_late
            was_late = was_late or is_late()
            return was_late

        found = prove(asked)
        if found.certified or not was_late:
            self._kept[subject] = (against, found, not was_late)
        return found
