"""Wall-clock time for one call: the search for a fast motion ends early enough for a sure one and for its proof."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from optdock.deadline import Deadline

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["ENDLESS", "Allowance", "OutOfTime", "look", "never_late"]


class OutOfTime(Exception):
    """A stage saw that its time is up; nothing of it can be used. It never leaves `optdock.timing`."""


class Allowance(NamedTuple):
    """The two deadlines of a call.

    Args:
        search: For methods after which another one is left.
        last: For the last method and for the proof.
    """

    search: Deadline
    last: Deadline

    @classmethod
    def within(cls, whole: Deadline, reserve: float) -> Allowance:
        """All of `whole` but `reserve` [s] for the search."""
        return cls(Deadline(whole.left - reserve), whole)


ENDLESS = Allowance(Deadline(), Deadline())


def never_late() -> bool:
    """There is no deadline."""
    return False


def look(is_late: Callable[[], bool]) -> None:
    """Look at the clock.

    Raises:
        OutOfTime: It is late.
    """
    if is_late():
        raise OutOfTime
