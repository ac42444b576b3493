"""How a contract is judged: what must hold, what must be refused, and whether a call can be cancelled.

No test runner is needed for it.
"""

from __future__ import annotations

import time
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["ContractBroken", "PollCounter", "PollGaps", "poll_gaps", "refused", "require", "require_cancellable"]

_CANCEL_AT = (1, 2, 100)  # polls; those that a plugin never reaches are left out


class ContractBroken(AssertionError):
    """A plugin does not keep its interface; the message says which sentence and with what values."""


def require(holds: object, sentence: str) -> None:
    """Go on only if `holds` is true; unlike `assert` also under `python -O`.

    Raises:
        ContractBroken: It is false.

    >>> require(1.0 <= 2.0, "one is at most two")
    """
    if not holds:
        raise ContractBroken(sentence)


def refused(call: Callable[[], object], error: type[Exception], sentence: str) -> Exception:
    """The exception with which `call` refuses; it must be an `error`.

    Args:
        call: What must not succeed.
        error: The class that it must raise, or a parent of it.
        sentence: The rule, for the message.

    Raises:
        ContractBroken: It returned, or raised something else.

    >>> str(refused(lambda: int("x"), ValueError, "text is no number"))[:15]
    'invalid literal'
    """
    try:
        returned = call()
    except error as found:
        return found
    except Exception as found:
        raise ContractBroken(f"{sentence}: wanted {error.__name__}, got {type(found).__name__}: {found}") from found
    raise ContractBroken(f"{sentence}: wanted {error.__name__}, got the result {returned!r}")


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
