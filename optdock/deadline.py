"""The one deadline of a call, handed down to every stage that may take long."""

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
    """A stage saw that its time is up; nothing of it can be used. It never leaves the package that raised it."""


def never_late() -> bool:
    """The `is_late` of a caller without a deadline."""
    return False


class _Latch:
    """A question that is not asked again once it was answered with yes."""

    __slots__ = ("_question", "said_yes")

    def __init__(self, question: Callable[[], bool]) -> None:
        self._question, self.said_yes = question, False

    def __call__(self) -> bool:
        self.said_yes = self.said_yes or bool(self._question())
        return self.said_yes


class Deadline:
    """A moment on a monotonic clock, counted from when this was made.

    Args:
        seconds: Wall-clock allowance [s]; infinite means no deadline.
        clock: Monotonic seconds.
        stop: Polled with the clock; True: the deadline has passed, whatever the clock says.

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
        """As Nav2 gives time allowances [s]: 0 means no deadline."""
        return cls(seconds if seconds > 0.0 else math.inf, clock)

    @property
    def elapsed(self) -> float:
        """Seconds since the beginning."""
        return self._clock() - self._began

    @property
    def left(self) -> float:
        """Seconds left, negative when overdrawn."""
        return self.seconds - self.elapsed

    def fits(self, seconds: float) -> bool:
        """Whether work of this length ends in time."""
        return self.elapsed + seconds <= self.seconds

    def passed(self) -> bool:
        """Whether no time is left; a method, so that it serves as a `cancel_checker` or `is_late`."""
        return self.elapsed >= self.seconds or self._stop()

    @property
    def stopped(self) -> bool:
        """Whether `stop` has returned True."""
        return self._stop.said_yes

    def look(self) -> None:
        """Go on only while there is time.

        Raises:
            OutOfTime: There is none left.
        """
        if self.passed():
            raise OutOfTime

    def shortened(self, by: float = 0.0, at_most: float = math.inf) -> Deadline:
        """The same beginning and clock, but it passes `by` seconds earlier, and never later than after `at_most`."""
        earlier = copy.copy(self)
        earlier.seconds = min(self.seconds - by, at_most)
        return earlier


ENDLESS = Deadline()


@contextlib.contextmanager
def garbage_collection_paused() -> Iterator[None]:
    """Within it Python starts no automatic collection of cyclic garbage.

    A full collection cannot be interrupted and takes as long as the process has objects: 35 ms with the libraries of
    this project alone, 250 ms beside a million small objects of the caller's. What was made within is collected at the
    end, below a millisecond for a call of 100 ms: else the first object after it would start a collection that is due,
    a full one now and then. Where calls of several threads overlap, collection is back at the latest when the first of
    them ends.
    """
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.collect(1)
            gc.enable()
