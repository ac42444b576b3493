"""The time between two calls of a controller, measured from their stamps."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from optdock.errors import NoValidControl
from optdock.geometry.checked import finite_number

if TYPE_CHECKING:
    from optdock.plugins.lifecycle import PluginContext

__all__ = ["ControlClock"]

_FIRST = 0.005  # [s]: of the first call nothing is known; so little that its command is admissible at 200 Hz too
_LONGEST = 0.5  # [s]: after a longer silence the response to the last command is unknown
_MOST_GROWTH = 2.0  # a single late call is not a new rate
_SMOOTHING = 0.2  # share of the newest period in the usual one: five calls


class ControlClock:
    """Measures the period, whatever the rate; irregular and late calls are what they are.

    Attributes:
        now: Stamp of the last call [s]; None before the first.
        elapsed: Time between the last call and the one before [s], at most half a second.
        period: What the coming period will probably be [s].
        learnt: Whether the last call was the first that told the period.
        silent: Whether the last call came after so long that the last command says nothing any more, or was the first.
    """

    def __init__(self) -> None:
        self.now: float | None = None
        self.elapsed = 0.0
        self.period = _FIRST
        self.learnt = False
        self.silent = True
        self._gaps = 0

    def tick(self, stamp: float | None, context: PluginContext, promised: float | None = None) -> None:
        """A call.

        Args:
            stamp: When [s]; None: now, on the context's clock.
            context: Whose clock, and whose name for messages.
            promised: The period, where the caller promises one [s].

        Raises:
            NoValidControl: The clock went back; it is refused until it has caught up, or the controller is reset.
            InvalidValue: The stamp is not a finite number.
        """
        stamp = context.clock() if stamp is None else finite_number(stamp, f"{context.name}: stamp")
        before = self.now
        if before is not None and stamp < before:
            raise NoValidControl(
                f"{context.name}: the clock went back from {before} s to {stamp} s; reset the controller if it was set",
                where={"stamp": stamp, "before": before},
            )
        self.now = stamp
        if promised is not None:
            self.elapsed = self.period = promised
            self.silent = self.learnt = before is None
            return
        gap = math.inf if before is None else stamp - before
        self.silent = gap > _LONGEST
        self.elapsed = min(gap, _LONGEST) if before is not None else _FIRST
        self.learnt = False
        if gap == 0.0 or self.silent:
            return
        self._gaps += 1
        self.learnt = self._gaps == 1
        self.period = (
            gap if self.learnt else self.period + _SMOOTHING * (min(gap, _MOST_GROWTH * self.period) - self.period)
        )
