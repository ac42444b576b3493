"""Proofs made once: what is judged and what it is judged against are frozen, so the same two have the same verdict.

The proofs are held here, so that nobody can hand in a verdict of their own, and for as long as what was judged lives.
"""

from __future__ import annotations

import weakref
from dataclasses import dataclass
from typing import TYPE_CHECKING, Generic, Protocol, TypeVar

from optdock.deadline import never_late

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable

__all__ = ["KeptProofs"]


class _Verdict(Protocol):
    @property
    def certified(self) -> bool: ...


Subject = TypeVar("Subject")
Verdict = TypeVar("Verdict", bound=_Verdict)


@dataclass(frozen=True)
class _Kept(Generic[Subject, Verdict]):
    subject: weakref.ref[Subject]
    against: Hashable
    verdict: Verdict
    is_whole: bool


class KeptProofs(Generic[Subject, Verdict]):
    """The last verdict on every subject, with what it was judged against and whether it was made to its end.

    A subject is itself, whatever it calls its equal.
    """

    def __init__(self) -> None:
        self._kept: dict[int, _Kept[Subject, Verdict]] = {}  # by identity, for as long as the subject lives

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
            is_late: The caller's deadline; `never_late` without one.
            prove: Makes the proof, asking the callable that it is given whether it is late.
        """
        key = id(subject)
        known = self._kept.get(key)
        is_same = known is not None and known.subject() is subject and known.against == against
        if known is not None and is_same and (known.is_whole or is_late is not never_late):
            return known.verdict
        was_late = False

        def asked() -> bool:
            nonlocal was_late
            was_late = was_late or is_late()
            return was_late

        found = prove(asked)
        if found.certified or not was_late:
            alive = weakref.ref(subject, lambda _: self._kept.pop(key, None))
            self._kept[key] = _Kept(alive, against, found, not was_late)
        return found
