"""What ends a motion, an attempt or a task early."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from optdock.executor.task_states import EndingKind

__all__ = [
    "HELD",
    "NOT_DOCKED",
    "SHORTER_WAY",
    "TOO_FAR_OFF",
    "AttemptFailed",
    "CancelRequested",
    "Interrupted",
    "NoWay",
    "TaskFailed",
]

# Names of interruptions that are answered in ways of their own.
HELD, TOO_FAR_OFF, NOT_DOCKED, SHORTER_WAY = "held", "too far off to correct", "not docked", "shorter way"


class CancelRequested(Exception):
    """The caller has cancelled the task."""


class TaskFailed(Exception):
    """The task has failed."""

    def __init__(self, kind: EndingKind, reason: str) -> None:
        super().__init__(reason)
        self.kind, self.reason = kind, reason


class AttemptFailed(TaskFailed):
    """This approach has failed; another one may succeed."""


class NoWay(AttemptFailed):
    """There has been no way into the dock from where the robot stands, for longer than an obstacle is waited for."""


class Interrupted(Exception):
    """The motion cannot go on; another one from here may."""

    def __init__(self, name: str, reason: str) -> None:
        super().__init__(reason)
        self.name, self.reason = name, reason
