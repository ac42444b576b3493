"""Consistency of a verdict's truth value with its content; applied to every verdict in all kinds of cases."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["UntruthfulError", "says_yes"]


class UntruthfulError(Exception):
    """The truth value of a verdict contradicts its content."""


# Evidence and flags of a verdict; attributes that it does not have are skipped.
_EVIDENCE: dict[str, Callable[[object], bool]] = {
    "violations": lambda broken: len(broken) == 0,  # type: ignore[arg-type]
    "unproven": lambda left: isinstance(left, dict) or len(left) == 0,  # type: ignore[arg-type]
    "certified": bool,
    "holds": bool,
    "proven": lambda content: content is not False,  # elsewhere a bound in metres
    "refuted": lambda content: not content,
    "outcome": lambda outcome: outcome.value != "failed",  # type: ignore[attr-defined]
    "status": lambda status: int(status) == 0,  # type: ignore[call-overload]
}


def says_yes(verdict: object) -> bool:
    """Return the truth value of a verdict.

    Raises:
        UntruthfulError: If it contradicts the evidence or a flag.
    """
    content = {name: means(getattr(verdict, name)) for name, means in _EVIDENCE.items() if hasattr(verdict, name)}
    if not content or bool(verdict) != all(content.values()):
        raise UntruthfulError(f"{type(verdict).__name__}: counts as {bool(verdict)}; content: {content}")
    return bool(verdict)
