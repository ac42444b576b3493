"""Deadline of a call, shared by all stages that may take a long time, and the clock of all time budgets.

The clock of a process is exchangeable:

- `wall`, the default, measures real time;
- `cpu` measures the CPU time of the process, so that other load on the machine uses up no budget;
- `counted` measures no time: it advances by `TICK` at each reading. A plan then depends only on its problem and its
  budget, not on the machine, its load, the number of worker processes or the calls before.

On a two-core server, with kernels in C, counted seconds per CPU second of 58 calls of `plan_dock` with a budget of 1 s
are 0.9 in the median, 0.5 to 1.4 for nine of ten calls, and 0.2 to 1.7 in the extremes.
"""

from __future__ import annotations

import contextlib
import gc
import math
import time
from typing import TYPE_CHECKING, Literal, TypeAlias, get_args

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

__all__ = [
    "ENDLESS",
    "TICK",
    "ClockName",
    "Deadline",
    "OutOfTime",
    "Stopwatch",
    "budget_clock",
    "clock_name",
    "garbage_collection_paused",
    "never_late",
    "now",
    "set_clock",
    "uncounted",
]

ClockName: TypeAlias = Literal["wall", "cpu", "counted"]

TICK = 5.0 * 2.0**-15  # [s], 0.15 ms; few bits, so that differences of times are exact and equal in every call


class _Counter:
    """A function that returns 0 and then `tick` seconds more at each call, except while it stands still."""

    __slots__ = ("readings", "stands", "tick")

    def __init__(self, tick: float) -> None:
        self.readings, self.stands, self.tick = -1, False, tick

    def __call__(self) -> float:
        if not self.stands:
            self.readings += 1
        return max(self.readings, 0) * self.tick


class _Clock:
    """The clock of time budgets of this process."""

    __slots__ = ("name", "read")

    def __init__(self, name: ClockName, rate: float = 1.0) -> None:
        self.name, self.read = name, time.monotonic
        if name == "cpu":
            self.read = time.process_time
        elif name == "counted":
            self.read = _Counter(rate * TICK)
        if name != "counted" and rate != 1.0:
            exact = self.read
            self.read = lambda: rate * exact()


class _OfProcess:
    clock = _Clock("wall")


def now() -> float:
    """Return the time [s] on the clock of time budgets, from an arbitrary origin."""
    return _OfProcess.clock.read()


def clock_name() -> ClockName:
    """Return the name of the clock of time budgets."""
    return _OfProcess.clock.name


def set_clock(name: ClockName, rate: float = 1.0) -> None:
    """Set the clock of time budgets of this process; a counted clock starts at 0.

    In all threads, it is the clock of every `Deadline` that is created afterwards, and of every `PluginContext`, unless
    they are given another clock.

    Args:
        name: `wall`, `cpu` or `counted`.
        rate: Speed of the clock, > 0. With 0.25 every time limit, also a limit that is fixed in the code, allows four
            times its duration.

    Raises:
        ValueError: If the clock is unknown, or the rate is not finite and > 0.
    """
    if name not in get_args(ClockName) or not (math.isfinite(rate) and rate > 0.0):
        raise ValueError(f"clock: must be one of {', '.join(get_args(ClockName))} with a rate > 0, got {name}, {rate}")
    _OfProcess.clock = _Clock(name, rate)


@contextlib.contextmanager
def budget_clock(name: ClockName, rate: float = 1.0) -> Iterator[None]:
    """Use a clock for the time budgets of this process within the context, and then the previous clock again.

    The arguments and errors are those of `set_clock`.
    """
    before = _OfProcess.clock
    set_clock(name, rate)
    try:
        yield
    finally:
        _OfProcess.clock = before


@contextlib.contextmanager
def uncounted() -> Iterator[None]:
    """Let a counted clock stand still within the context, for work of the first call in a process."""
    read = _OfProcess.clock.read
    if not isinstance(read, _Counter):
        yield
        return
    before, read.stands = read.stands, True
    try:
        yield
    finally:
        read.stands = before


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
        clock: Function that returns monotonic seconds; by default the present clock of time budgets.
        stop: Function that is polled together with the clock; if it returns True, the deadline passes immediately.

    >>> now = iter([10.0, 10.2, 10.6])
    >>> deadline = Deadline(0.5, lambda: next(now))
    >>> deadline.passed(), deadline.passed()
    (False, True)
    """

    __slots__ = ("_began", "_stop", "clock", "seconds")

    def __init__(
        self,
        seconds: float = math.inf,
        clock: Callable[[], float] = now,
        stop: Callable[[], bool] = never_late,
    ) -> None:
        self.seconds = seconds
        self._stop = None if stop is never_late else _Latch(stop)
        self.clock = _OfProcess.clock.read if clock is now else clock
        self._began = self.clock()

    @classmethod
    def of_allowance(cls, seconds: float, clock: Callable[[], float] = now) -> Deadline:
        """Return the deadline of a Nav2 time allowance [s], where 0 means no deadline."""
        return cls(seconds if seconds > 0.0 else math.inf, clock)

    @property
    def elapsed(self) -> float:
        """Seconds since construction."""
        return self.clock() - self._began

    @property
    def left(self) -> float:
        """Remaining seconds; negative after the deadline."""
        return self.seconds - (self.clock() - self._began)

    def fits(self, seconds: float) -> bool:
        """Whether work of this duration ends before the deadline."""
        return self.clock() - self._began + seconds <= self.seconds

    def passed(self) -> bool:
        """Whether no time remains; usable as a `cancel_checker` or `is_late`."""
        return self.clock() - self._began >= self.seconds or (self._stop is not None and self._stop())

    @property
    def stopped(self) -> bool:
        """Whether `stop` has returned True."""
        return self._stop is not None and self._stop.was_true

    def look(self) -> None:
        """Check the deadline.

        Raises:
            OutOfTime: If no time remains.
        """
        if self.passed():
            raise OutOfTime

    def shortened(self, by: float = 0.0, at_most: float = math.inf) -> Deadline:
        """Return a deadline with the same start, `by` seconds earlier and at most `at_most` seconds after the start."""
        earlier = object.__new__(type(self))
        earlier.seconds, earlier._began = min(self.seconds - by, at_most), self._began
        earlier.clock, earlier._stop = self.clock, self._stop
        return earlier


ENDLESS = Deadline()


class Stopwatch:
    """Time since construction on the clock of a deadline, divided into work and suspension.

    On a wall clock, the smaller of real time and CPU time of the thread is work: the former includes the time of other
    processes, and the latter may be coarse. On every other clock all time is work.
    """

    __slots__ = ("_began", "_clock", "_worked")

    def __init__(self, deadline: Deadline) -> None:
        self._clock = clock = deadline.clock
        self._began, self._worked = clock(), time.thread_time() if clock is time.monotonic else 0.0

    def read(self) -> tuple[float, float]:
        """Return the elapsed time and the part of it that was work [s]."""
        took = self._clock() - self._began
        return took, min(took, time.thread_time() - self._worked) if self._clock is time.monotonic else took


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
