"""States, events and endings of a docking task, and the exceptions that end a motion, an attempt or the task."""

from __future__ import annotations

from enum import Enum, IntEnum
from typing import NamedTuple

from optdock.geometry.pose import Pose2, Twist2

__all__ = [
    "HELD",
    "NOT_DOCKED",
    "SHORTER_WAY",
    "TOO_FAR_OFF",
    "AttemptFailed",
    "CancelRequested",
    "Ending",
    "EndingKind",
    "Event",
    "Feedback",
    "FeedbackState",
    "Interrupted",
    "NoWay",
    "State",
    "Step",
    "TaskFailed",
]

# Names of the interruptions that the procedure distinguishes.
HELD, TOO_FAR_OFF, NOT_DOCKED, SHORTER_WAY = "held", "too far off to correct", "not docked", "shorter way"


class FeedbackState(IntEnum):
    """The feedback states of Nav2's DockRobot action."""

    NONE = 0
    NAV_TO_STAGING_POSE = 1
    INITIAL_PERCEPTION = 2
    CONTROLLING = 3
    WAIT_FOR_CHARGE = 4
    RETRY = 5


class State(str, Enum):
    """State of an executor; `Feedback.state` is the corresponding state of Nav2."""

    READY = "ready"
    STAGING = "staging"
    PERCEIVING = "perceiving the dock"
    PLANNING = "planning"
    APPROACHING = "approaching"
    PRESSING = "pressing on towards contact"
    WAITING_FOR_CHARGE = "waiting for charge"
    WAITING_FOR_DETECTION = "waiting for a detection"
    WAITING_FOR_OBSTACLE = "waiting for an obstacle to go"
    WAITING_FOR_POSE = "waiting for a pose"
    WAITING_FOR_COSTMAP = "waiting for a newer costmap"
    BACKING_OUT = "backing out"
    RETURNING = "returning to the staging pose"
    UNDOCKING = "undocking"
    STOPPING = "stopping"
    HELD = "held"
    ENDED = "ended"


class EndingKind(str, Enum):
    """Kind of ending of a task; true if the task succeeded.

    Errors with Nav2's codes 901 and 902 (dock unknown or invalid), `DockNotInDB` and `DockNotValid`, are raised before
    a task exists.
    """

    DOCKED_BY_DISTANCE = "docked by distance"
    DOCKED_BY_STALL = "docked by stall"
    DOCKED_BY_SIGNAL = "docked by external signal"
    ALREADY_DOCKED = "already docked"
    UNDOCKED = "undocked"
    NOT_DOCKED = "not docked, nothing to undock from"
    CANCELLED = "cancelled"
    FAILED_TO_STAGE = "failed to stage"
    FAILED_TO_DETECT_DOCK = "failed to detect the dock"
    FAILED_TO_CONTROL = "failed to control"
    FAILED_TO_CHARGE = "failed to charge"
    TIMEOUT = "timeout"
    UNKNOWN = "unknown"

    @property
    def code(self) -> int:
        """Error code of Nav2's docking actions; 0 without an error."""
        return _CODES.get(self, 0)

    def __bool__(self) -> bool:
        return self.succeeded

    @property
    def succeeded(self) -> bool:
        """Whether the task succeeded."""
        return self.code == 0 and self is not EndingKind.CANCELLED


_CODES = {
    EndingKind.FAILED_TO_STAGE: 903,
    EndingKind.FAILED_TO_DETECT_DOCK: 904,
    EndingKind.FAILED_TO_CONTROL: 905,
    EndingKind.FAILED_TO_CHARGE: 906,
    EndingKind.TIMEOUT: 907,
    EndingKind.UNKNOWN: 999,
}


class Ending(NamedTuple):
    """Ending of a task, with the robot at rest; true if the task succeeded.

    Attributes:
        kind: Kind of the ending.
        reason: Explanation; empty if no explanation is needed.
        num_retries: Number of approaches after the first one.
        stamp: Time [s].
    """

    kind: EndingKind
    reason: str
    num_retries: int
    stamp: float

    def __bool__(self) -> bool:
        return self.kind.succeeded


class Event(NamedTuple):
    """An event of a task.

    Attributes:
        stamp: Time [s].
        name: Fixed name of the kind of event.
        detail: Description with numbers.
    """

    stamp: float
    name: str
    detail: str = ""


class Feedback(NamedTuple):
    """Feedback of Nav2's action, and the distance to the dock.

    Attributes:
        state: Feedback state of Nav2.
        num_retries: Number of approaches after the first one.
        distance: Estimated distance of the robot from the docked pose [m].
        docking_time: Time since the task began [s].
    """

    state: FeedbackState
    num_retries: int
    distance: float
    docking_time: float


class Step(NamedTuple):
    """Result of one control cycle.

    Attributes:
        command: Velocity command to send, within the limits of the robot.
        state: State of the executor.
        feedback: The state as feedback of Nav2's action.
        ending: Ending of the task; None while the task runs.
        events: Events of this cycle.
        deviation: Pose of the robot relative to the nearest pose of the path; None while no path is driven.
    """

    command: Twist2
    state: State
    feedback: Feedback
    ending: Ending | None
    events: tuple[Event, ...] = ()
    deviation: Pose2 | None = None


class CancelRequested(Exception):
    """The caller has cancelled the task."""


class TaskFailed(Exception):
    """The task has failed."""

    def __init__(self, kind: EndingKind, reason: str) -> None:
        super().__init__(reason)
        self.kind, self.reason = kind, reason


class AttemptFailed(TaskFailed):
    """The current approach has failed; another approach may succeed."""


class NoWay(AttemptFailed):
    """No path into the dock was found within the time for which the executor waits for obstacles to move."""


class Interrupted(Exception):
    """The current motion cannot continue; a different motion from the same pose may succeed."""

    def __init__(self, name: str, reason: str) -> None:
        super().__init__(reason)
        self.name, self.reason = name, reason
