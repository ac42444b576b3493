"""Lateness of calls of `plan_dock`, measured again by repetitions that do the same work.

A call of `plan_dock` depends on time only by its readings of the clock of time budgets. A repetition gets the readings
of the first call, so it does the same work and ends at the same place, and its CPU time is measured meanwhile. The
shortest of several repetitions counts, because it contains the least time of the host and of other processes.

Every repetition takes place in a copy of the process as it was after `warm_up`, which has planned nothing since then:
nothing that is cached with a footprint or a problem shortens it.
"""

from __future__ import annotations

import multiprocessing
import time
from typing import TYPE_CHECKING, TypeVar
from unittest import mock

from optdock.deadline import budget_clock

if TYPE_CHECKING:
    from collections.abc import Callable
    from multiprocessing.connection import Connection

__all__ = ["Repetitions", "recorded"]

_T = TypeVar("_T")
_process_time = time.process_time


class _Recorder:
    """The CPU time of the process, whose readings are kept."""

    def __init__(self) -> None:
        self.readings: list[float] = []

    def __call__(self) -> float:
        self.readings.append(_process_time())
        return self.readings[-1]


class _Player:
    """A clock that returns given readings, then the last one, and notes the CPU times at which it is read."""

    def __init__(self, readings: list[float]) -> None:
        self.readings, self.times = readings, list[float]()

    def __call__(self) -> float:
        self.times.append(_process_time())
        return self.readings[min(len(self.times), len(self.readings)) - 1]


def _read_by(clock: Callable[[], float], call: Callable[[], object]) -> None:
    with mock.patch("time.process_time", clock), budget_clock("cpu"):
        call()


def recorded(call: Callable[[], object]) -> list[float]:
    """Run a function whose time budgets count CPU seconds, and return its readings of the clock [s].

    The first one is taken before the function begins, and the last one after it has ended.
    """
    clock = _Recorder()
    clock()
    _read_by(clock, call)
    clock()
    return clock.readings


class Repetitions:
    """Copies of this process as it is now, which repeat calls of `answer(make())`.

    Args:
        answer: Function of a problem and a budget [s].
        count: Number of repetitions of a call.
    """

    def __init__(self, answer: Callable[[_T, float], object], count: int = 5) -> None:
        self._context = multiprocessing.get_context("fork")
        self._pipe, there = self._context.Pipe()
        self._answer, self._count = answer, count
        self._process = self._context.Process(target=self._serve, args=(there,))
        self._process.start()

    def lateness(self, make: Callable[[], _T], budget: float, readings: list[float]) -> float:
        """Return the lateness [s] of a recorded call with the shortest end of its repetitions.

        `make` returns the problem, a new object in every repetition. The result is the lateness of the recorded call
        itself if no repetition read the clock as often as it.
        """
        self._pipe.send((make, budget, readings))
        return float(self._pipe.recv())

    def close(self) -> None:
        """End the process of the copies."""
        self._pipe.send(None)
        self._process.join()

    def _serve(self, requests: Connection) -> None:
        while (request := requests.recv()) is not None:
            make, budget, readings = request
            begin, last = readings[0], len(readings) - 1
            in_time = max(1, *(i for i, reading in enumerate(readings[:last]) if reading < begin + budget))
            ends = [readings[last] - readings[in_time]]
            for _ in range(self._count):
                here, there = self._context.Pipe()
                copy = self._context.Process(target=self._repeat, args=(there, make, budget, readings))
                copy.start()
                times = here.recv()
                copy.join()
                if len(times) == last:
                    ends.append(times[-1] - times[in_time - 1])
            requests.send(readings[in_time] - begin - budget + min(ends))

    def _repeat(self, found: Connection, make: Callable[[], _T], budget: float, readings: list[float]) -> None:
        problem, clock = make(), _Player(readings[1:])
        _read_by(clock, lambda: self._answer(problem, budget))
        found.send([*clock.times, _process_time()])
