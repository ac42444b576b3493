"""Manoeuvres: from anywhere into the dock, or the proof that there is no way. `python -m experiments.manoeuvres`."""

import os
import time

__all__ = ["count_cpu_seconds"]

_CLOCK = "MANOEUVRES_CLOCK"


def count_cpu_seconds() -> None:
    """Let time budgets count CPU seconds of the process instead of wall clock, here and in processes started from here.

    On a machine that others use too, shares by wall clock say how busy it was. Call it before optdock is imported,
    which binds the clock.
    """
    os.environ[_CLOCK] = "cpu"
    time.monotonic = time.process_time


if os.environ.get(_CLOCK) == "cpu":
    count_cpu_seconds()
