"""Cancellation: whether a plugin asks its cancel checker, how often, and whether it obeys."""

from __future__ import annotations

import time
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

from optdock.testing.contracts_rules import refused, require

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["PollCounter", "PollGaps", "poll_gaps", "require_cancellable"]

_CANCEL_AT = (1, 2, 100)  # polls; those that a plugin never reaches are left out


class PollCounter:
    """A cancel checker that counts how often it is asked.

    Args:
        cancel_at: The poll from which on it says True; 0: never.
        clock: Monotonic seconds.

    Attributes:
        polls: How often it was asked.
        longest: Longest time between two polls, the start included [s].
    """

    def __init__(self, cancel_at: int = 0, clock: Callable[[], float] = time.perf_counter) -> None:
        self.polls, self.longest = 0, 0.0
        self._cancel_at, self._clock, self._last = cancel_at, clock, clock()

    def __call__(self) -> bool:
        """Whether to stop."""
        self.polls += 1
        self.lap()
        return 0 < self._cancel_at <= self.polls

    def lap(self) -> None:
        """End a gap and begin the next."""
        now = self._clock()
        self.longest, self._last = max(self.longest, now - self._last), now


class PollGaps(NamedTuple):
    """Polls during one call, the longest time without one [s], and the call's duration [s]."""

    polls: int
    longest: float
    total: float


def poll_gaps(run: Callable[[Callable[[], bool]], object], clock: Callable[[], float] = time.perf_counter) -> PollGaps:
    """How often `run(cancel_checker)` polls; a measurement for benchmarks.

    Args:
        run: The work.
        clock: Monotonic seconds; `time.process_time` leaves out what other processes of a busy machine take.

    >>> gaps = poll_gaps(lambda cancelled: [cancelled() for _ in range(3)])
    >>> gaps.polls, gaps.longest <= gaps.total
    (3, True)
    """
    began = clock()
    counter = PollCounter(clock=clock)
    run(counter)
    counter.lap()
    return PollGaps(counter.polls, counter.longest, clock() - began)


def require_cancellable(run: Callable[[Callable[[], bool]], object], error: type[Exception]) -> None:
    """`run(cancel_checker)` polls its checker, and ends with `error` at the first, second or hundredth poll.

    Raises:
        ContractBroken: It never polls, goes on after a True, or ends in another way.
    """
    patient = PollCounter()
    run(patient)
    require(patient.polls >= 1, "the cancel checker is polled at least once")
    for poll in _CANCEL_AT:
        if poll > patient.polls:
            break
        counter = PollCounter(poll)
        refused(partial(run, counter), error, f"a True at poll {poll} ends the work")
        require(counter.polls == poll, f"after a True at poll {poll} nothing more is asked, got {counter.polls} polls")
