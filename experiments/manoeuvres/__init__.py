"""Manoeuvre benchmark: plans or impossibility proofs for hard docking problems; `python -m experiments.manoeuvres`."""

import os
import time

__all__ = ["count_cpu_seconds"]

_CLOCK = "MANOEUVRES_CLOCK"


def count_cpu_seconds() -> None:
    """Let time budgets count CPU seconds of this process and of processes started from it instead of wall clock.

    Results of wall-clock budgets depend on the load of the machine. Call before optdock is imported, because the clock
    is bound at import.
    """
    os.environ[_CLOCK] = "cpu"
    time.monotonic = time.process_time


if os.environ.get(_CLOCK) == "cpu":
    count_cpu_seconds()
