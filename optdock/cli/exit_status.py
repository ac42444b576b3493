"""Exit statuses of all commands."""

from __future__ import annotations

from enum import IntEnum
from typing import TYPE_CHECKING

from optdock.errors import InvalidFile, InvalidValue, MissingExtra, NoMotionExists, OptdockError, PluginError, TimedOut

if TYPE_CHECKING:
    from collections.abc import Mapping

__all__ = ["EXIT_STATUSES", "ExitStatus", "status_of"]


class ExitStatus(IntEnum):
    """Exit status of a command; `EXIT_STATUSES` contains the meanings."""

    CERTIFIED = 0
    UNEXPECTED = 1
    BAD_INPUT = 2
    NOT_CERTIFIED = 3
    IMPOSSIBLE = 4
    TIMED_OUT = 5


EXIT_STATUSES: Mapping[ExitStatus, str] = {
    ExitStatus.CERTIFIED: (
        "certified, and nothing in the input is refuted; simulated drives docked without a collision; other commands: "
        "done"
    ),
    ExitStatus.UNEXPECTED: "an error in optdock itself, with a traceback: please report it",
    ExitStatus.BAD_INPUT: (
        "bad input: usage, an option, the name of a plugin, or a file that cannot be read or contradicts itself"
    ),
    ExitStatus.NOT_CERTIFIED: (
        "refuted or unproven: no certified plan was found, a rule is broken, a value in a file is false, a motion "
        "is known by samples only, a run did not dock, a replay differs"
    ),
    ExitStatus.IMPOSSIBLE: "impossible: it is proven that no motion exists for this problem",
    ExitStatus.TIMED_OUT: "timed out before a certified plan was found: try again with a larger time budget",
}

# The first matching class decides.
_STATUSES: tuple[tuple[type[OptdockError], ExitStatus], ...] = (
    (InvalidFile, ExitStatus.BAD_INPUT),
    (InvalidValue, ExitStatus.BAD_INPUT),
    (PluginError, ExitStatus.BAD_INPUT),
    (MissingExtra, ExitStatus.BAD_INPUT),
    (NoMotionExists, ExitStatus.IMPOSSIBLE),
    (TimedOut, ExitStatus.TIMED_OUT),
    (OptdockError, ExitStatus.NOT_CERTIFIED),
)


def status_of(error: OptdockError | type[OptdockError]) -> ExitStatus:
    """Return the exit status of a command that ends with an error.

    >>> status_of(NoMotionExists), status_of(InvalidFile("a.yaml: is empty"))
    (<ExitStatus.IMPOSSIBLE: 4>, <ExitStatus.BAD_INPUT: 2>)
    """
    kind = error if isinstance(error, type) else type(error)
    return next(status for known, status in _STATUSES if issubclass(kind, known))
