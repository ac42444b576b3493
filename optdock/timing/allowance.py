"""Wall-clock time for one call: the search for a fast motion ends early enough for a sure one and for its proof."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

from optdock.deadline import Deadline

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["ENDLESS", "Allowance", "OutOfTime", "look"]

# Times the pace, over the paths of the timing benchmark: the windowed method takes 3 and the proof 7 in the median; the
# quickest proof takes 4: with less left no motion is worth beginning.
_SURE, _PROOF = 10.0, 4.0
_REFUSAL = 0.02  # [s]: whoever asks for the impossible must hear of it soon


class OutOfTime(Exception):
    """A stage saw that its time is up; nothing of it can be used. It never leaves `optdock.timing`."""


class Allowance(NamedTuple):
    """What the stages of a call may use of its deadline.

    Args:
        whole: The deadline, counted from the beginning of the call.
        pace: How long it took to look up the curvature of all gears [s]. By it, the windowed method and the proof take
            time: by the length of the path, by its knots, and by the machine.
        patience: How long the search may go on, counted from the beginning of the call [s].
    """

    whole: Deadline
    pace: float = 0.0
    patience: float = math.inf

    def search_is_over(self) -> bool:
        """Whether methods after which another one is left must end."""
        return self.whole.left <= _SURE * self.pace or self.whole.elapsed >= self.patience

    def is_over(self) -> bool:
        """Whether the last method must end."""
        return self.whole.left <= _PROOF * self.pace

    @property
    def refused(self) -> Allowance:
        """For what is left to do after an impossible start."""
        return self._replace(patience=_REFUSAL)


ENDLESS = Allowance(Deadline())


def look(is_late: Callable[[], bool]) -> None:
    """Look at the clock.

    Raises:
        OutOfTime: It is late.
    """
    if is_late():
        raise OutOfTime
