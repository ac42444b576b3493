"""Whether a verdict of the library is its truth value; asked about every verdict that a kind of cases meets."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["UntruthfulError", "says_yes"]


class UntruthfulError(Exception):
    """A verdict counts as true though it says no, or the other way round."""


# What a verdict says, by its evidence and by its words; a word that it does not have is not asked for.
_EVIDENCE: dict[str, Callable[[object], bool]] = {
    "violations": lambda broken: len(broken) == 0,  # type: ignore[arg-type]
    "unproven": lambda left: isinstance(left, dict) or len(left) == 0,  # type: ignore[arg-type]
    "certified": bool,
    "holds": bool,
    "proven": lambda said: said is not False,  # a bound in metres elsewhere
    "refuted": lambda said: not said,
    "outcome": lambda outcome: outcome.value != "failed",  # type: ignore[attr-defined]
    "status": lambda status: int(status) == 0,  # type: ignore[call-overload]
}


def says_yes(verdict: object) -> bool:
    """The truth value of a verdict.

    Raises:
        UntruthfulError: That is not what its evidence or one of its words says.
    """
    said = {name: means(getattr(verdict, name)) for name, means in _EVIDENCE.items() if hasattr(verdict, name)}
    if not said or bool(verdict) != all(said.values()):
        raise UntruthfulError(f"{type(verdict).__name__}: counts as {bool(verdict)}, says {said}")
    return bool(verdict)
