"""Deadline of a call, shared by all stages that may take a long time."""

from __future__ import annotations

import contextlib
import copy
import gc
import math
import time
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

__all__ = ["ENDLESS", "Deadline", "OutOfTime", "garbage_collection_paused", "never_late"]


class OutOfTime(Exception):
    """The deadline of a stage has passed without a result.

    This exception is internal to the package that raises it.
    """


def never_late() -> bool:
    """Return False; this is the default of `is_late` if there is no deadline."""
    return False


class _Latch:
    """A predicate that is not evaluated again once it has returned True."""

    __slots__ = ("_predicate", "was_true")

    def __init__(self, predicate: Callable[[], bool]) -> None:
        self._predicate, self.was_true = predicate, False

    def __call__(self) -> bool:
        self.was_true = self.was_true or bool(self._predicate())
        return self.was_true


class Deadline:
    """A point in time on a monotonic clock, relative to the construction of this object.

    Args:
        seconds: Wall-clock allowance [s]; infinite without a deadline.
        clock: Function that returns monotonic seconds.
        stop: Function that is polled together with the clock; if it returns True, the deadline passes immediately.

    >>> now = iter([10.0, 10.2, 10.6])
    >>> deadline = Deadline(0.5, lambda: next(now))
    >>> deadline.passed(), deadline.passed()
    (False, True)
    """

    __slots__ = ("_began", "_clock", "_stop", "seconds")

    def __init__(
        self,
        seconds: float = math.inf,
        clock: Callable[[], float] = time.monotonic,
        stop: Callable[[], bool] = never_late,
    ) -> None:
        self.seconds, self._clock, self._stop = seconds, clock, _Latch(stop)
        self._began = clock()

    @classmethod
    def of_allowance(cls, seconds: float, clock: Callable[[], float] = time.monotonic) -> Deadline:
        """Return the deadline of a Nav2 time allowance [s], where 0 means no deadline."""
        return cls(seconds if seconds > 0.0 else math.inf, clock)

    @property
    def elapsed(self) -> float:
        """Seconds since construction."""
        return self._clock() - self._began

    @property
    def left(self) -> float:
        """Remaining seconds; negative after the deadline."""
        return self.seconds - self.elapsed

    def fits(self, seconds: float) -> bool:
        """Whether work of this duration ends before the deadline."""
        return self.elapsed + seconds <= self.seconds

    def passed(self) -> bool:
        """Whether no time remains; usable as a `cancel_checker` or `is_late`."""
        return self.elapsed >= self.seconds or self._stop()

    @property
    def stopped(self) -> bool:
        """Whether `stop` has returned True."""
        return self._stop.was_true

    def look(self) -> None:
        """Check the deadline.

        Raises:
            OutOfTime: If no time remains.
        """
        if self.passed():
            raise OutOfTime

    def shortened(self, by: float = 0.0, at_most: float = math.inf) -> Deadline:
        """Return a deadline with the same start, `by` seconds earlier and at most `at_most` seconds after the start."""
        earlier = copy.copy(self)
        earlier.seconds = min(self.seconds - by, at_most)
        return earlier


ENDLESS = Deadline()


@contextlib.contextmanager
def garbage_collection_paused() -> Iterator[None]:
    """Disable automatic garbage collection within the context.

    A full collection cannot be interrupted and takes time proportional to the number of objects of the process: 35 ms
    with the libraries of this project alone, 250 ms with a million small objects of the caller. On exit the young
    generations are collected, which takes less than 1 ms after a call of 100 ms. If calls of several threads overlap,
    collection is enabled again when the first of them ends.
    """
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.collect(1)
            gc.enable()
