"""The time a behavior may take, on the context's clock."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["Deadline"]


class Deadline:
    """Starts when built.

    Args:
        clock: Monotonic seconds.
        allowance: Seconds allowed; 0 means no limit, as in Nav2.
    """

    def __init__(self, clock: Callable[[], float], allowance: float) -> None:
        self._clock, self._began, self._allowance = clock, clock(), allowance

    @property
    def elapsed(self) -> float:
        """Seconds since the start."""
        return self._clock() - self._began

    @property
    def passed(self) -> bool:
        """Whether the allowance is used up."""
        return 0.0 < self._allowance < self.elapsed
