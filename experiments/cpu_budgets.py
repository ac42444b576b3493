"""Time budgets in CPU time, so that results do not depend on the load of the machine."""

from __future__ import annotations

import functools
import time
from typing import TYPE_CHECKING

from optdock.deadline import Deadline
from optdock.plugins.lifecycle import PluginContext

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["count_cpu"]

_CLOCKS: set[Callable[[], float]] = {time.monotonic, time.process_time}  # defaults that may be replaced


def count_cpu(rate: float = 1.0) -> None:
    """Let every budget of this process that is created without a clock count CPU seconds. Idempotent.

    Args:
        rate: Speed of the clock. With 0.25 every time limit, also those that are fixed in the code, allows four times
            its CPU time.
    """
    clock = _clock(rate)
    _CLOCKS.add(clock)
    for function in (Deadline.__init__, Deadline.of_allowance.__func__, PluginContext.__init__):  # type: ignore[attr-defined]
        defaults = function.__defaults__ or ()
        changed = tuple(clock if value in _CLOCKS else value for value in defaults)
        if clock not in changed:
            raise TypeError(f"{function.__qualname__}: has no clock by default")
        function.__defaults__ = changed


@functools.cache
def _clock(rate: float) -> Callable[[], float]:
    return time.process_time if rate == 1.0 else lambda: rate * time.process_time()
