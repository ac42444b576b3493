"""How a contract says that it is broken; no test runner is needed for it."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["ContractBroken", "refused", "require"]


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
