"""How a contract is judged: what must hold, what must be refused, and whether a call can be cancelled.

No test runner is needed for it.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["ContractBroken", "refused", "require", "require_cancellable"]

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

    >>> str(refused(lambda: int("x"), ValueError, "text is not a number"))[:15]
    'invalid literal'
    """
    try:
        returned = call()
    except error as found:
        return found
    except Exception as found:
        raise ContractBroken(f"{sentence}: wanted {error.__name__}, got {type(found).__name__}: {found}") from found
    raise ContractBroken(f"{sentence}: wanted {error.__name__}, got the result {returned!r}")


class _PollCounter:
    """A cancel checker that says True from its poll `cancel_at` on; 0: never."""

    def __init__(self, cancel_at: int = 0) -> None:
        self.polls, self._cancel_at = 0, cancel_at

    def __call__(self) -> bool:
        self.polls += 1
        return 0 < self._cancel_at <= self.polls


def require_cancellable(run: Callable[[Callable[[], bool]], object], error: type[Exception]) -> None:
    """`run(cancel_checker)` polls its checker, and ends with `error` at the first, second or hundredth poll.

    Raises:
        ContractBroken: It never polls, goes on after a True, or ends in another way.
    """
    patient = _PollCounter()
    run(patient)
    require(patient.polls >= 1, "the cancel checker is polled at least once")
    for poll in _CANCEL_AT:
        if poll > patient.polls:
            break
        counter = _PollCounter(poll)
        refused(partial(run, counter), error, f"a True at poll {poll} ends the work")
        require(counter.polls == poll, f"after a True at poll {poll} nothing more is asked, got {counter.polls} polls")
