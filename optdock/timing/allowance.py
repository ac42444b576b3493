"""Wall-clock time for one call: the search for a fast motion ends early enough for a sure one and for its proof."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from optdock.deadline import Deadline

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["ENDLESS", "Allowance", "OutOfTime", "look", "never_late"]


# Times the pace, over the paths of the timing benchmark: the windowed method takes 3 and the proof 7 in the median; the
# quickest proof takes 4: with less left no motion is worth beginning.
_SURE, _PROOF = 10.0, 4.0
_REFUSAL = 0.02  # [s]


class OutOfTime(Exception):
    """A stage saw that its time is up; nothing of it can be used. It never leaves `optdock.timing`."""


class Allowance(NamedTuple):
    """The deadlines of a call.

    Args:
        search: For methods after which another one is left.
        last: For the last method; what is left then is for the proof.
        refusal: The search's once the start is known to be impossible: whoever asked must hear of it soon.
    """

    search: Deadline
    last: Deadline
    refusal: Deadline

    @classmethod
    def within(cls, whole: Deadline, pace: float) -> Allowance:
        """Shares of what is left of `whole`, by how long it took to look up the curvature of all gears: `pace` [s].

        Like that, the windowed method and the proof take time by the length of the path, its knots and the machine.
        """
        left = whole.left
        search = left - _SURE * pace
        return cls(Deadline(search), Deadline(left - _PROOF * pace), Deadline(min(search, _REFUSAL)))

    @property
    def refused(self) -> Allowance:
        """For what is left to do after an impossible start."""
        return self._replace(search=self.refusal)


ENDLESS = Allowance(Deadline(), Deadline(), Deadline())


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
