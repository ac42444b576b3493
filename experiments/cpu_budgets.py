"""Time budgets in CPU time, so that results do not depend on the load of the machine."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

from optdock.deadline import Deadline
from optdock.plugins.lifecycle import PluginContext

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["count_cpu"]


def count_cpu() -> None:
    """Let every budget of this process that is created without a clock count CPU seconds. Idempotent."""
    for function in (Deadline.__init__, Deadline.of_allowance.__func__, PluginContext.__init__):  # type: ignore[attr-defined]
        _with_cpu_clock(function)


def _with_cpu_clock(function: Callable[..., Any]) -> None:
    """Set the default clock of a function."""
    clocks = {time.monotonic: time.process_time}
    defaults = function.__defaults__ or ()
    changed = tuple(clocks.get(value, value) for value in defaults)
    if time.process_time not in changed:
        raise TypeError(f"{function.__qualname__}: has no clock by default")
    function.__defaults__ = changed
