"""Wall-clock allowance of one call."""

from __future__ import annotations

from typing import TYPE_CHECKING

from optdock.deadline import Deadline
from optdock.errors import SmootherTimedOut
from optdock.parameters import checked_seconds

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["Budget"]


class Budget(Deadline):
    """Seconds left of an allowance that began when this was made.

    Args:
        max_time: Allowance [s].
        clock: Monotonic seconds.

    Raises:
        InvalidValue: `max_time` is not finite, or negative.
    """

    def __init__(self, max_time: float, clock: Callable[[], float]) -> None:
        super().__init__(checked_seconds(max_time, "max_time"), clock)

    def fits(self, seconds: float) -> bool:
        """Whether work of this length ends in time."""
        return self.elapsed + seconds <= self.seconds

    def look(self) -> None:
        """Go on only while there is time.

        Raises:
            SmootherTimedOut: There is none left.
        """
        if self.passed():
            raise SmootherTimedOut(f"no certified path within {1e3 * self.seconds:.1f} ms", where={"iterations": 0})
