"""Wall-clock allowance of one call."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from optdock.errors import SmootherTimedOut
from optdock.parameters import checked_seconds

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["Budget"]


@dataclass
class Budget:
    """Seconds left of an allowance that began when this was made.

    Args:
        max_time: Allowance [s].
        clock: Monotonic seconds.

    Raises:
        InvalidValue: `max_time` is not finite, or negative.
    """

    max_time: float
    clock: Callable[[], float]
    _began: float = field(init=False)

    def __post_init__(self) -> None:
        checked_seconds(self.max_time, "max_time")
        self._began = self.clock()

    @property
    def elapsed(self) -> float:
        """Seconds since the beginning."""
        return self.clock() - self._began

    @property
    def remaining(self) -> float:
        """Seconds left, negative when overrun."""
        return self.max_time - self.elapsed

    def look(self) -> None:
        """Go on only while there is time.

        Raises:
            SmootherTimedOut: There is none left.
        """
        if self.remaining <= 0.0:
            raise SmootherTimedOut(f"no certified path within {1e3 * self.max_time:.1f} ms", where={"iterations": 0})

    def fits(self, seconds: float) -> bool:
        """Whether work of this length ends in time."""
        return self.elapsed + seconds <= self.max_time
