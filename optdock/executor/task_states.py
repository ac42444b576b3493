"""What an executor says of itself: states, events, endings."""

from __future__ import annotations

from enum import Enum, IntEnum
from typing import NamedTuple

from optdock.geometry.pose import Pose2, Twist2

__all__ = ["Ending", "EndingKind", "Event", "Feedback", "FeedbackState", "State", "Step"]


class FeedbackState(IntEnum):
    """The feedback states of Nav2's DockRobot action."""

    NONE = 0
    NAV_TO_STAGING_POSE = 1
    INITIAL_PERCEPTION = 2
    CONTROLLING = 3
    WAIT_FOR_CHARGE = 4
    RETRY = 5


class State(str, Enum):
    """What an executor is doing; `feedback` is Nav2's word for it."""

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
    """How a task ends; it counts as true where the task was done.

    `code` is the error code of Nav2's docking actions, 0 for what is not an error.

    Nav2's 901 and 902, a dock that is not known or not valid, come before there is a task: `DockNotInDB`,
    `DockNotValid`.
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
        """Nav2's error code."""
        return _CODES.get(self, 0)

    def __bool__(self) -> bool:
        return self.succeeded

    @property
    def succeeded(self) -> bool:
        """Whether the task was done."""
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
    """How a task ended; the robot is at rest. It counts as true where the task was done.

    Attributes:
        kind: Its name.
        reason: Why, in a sentence; empty where there is nothing to explain.
        num_retries: Approaches after the first one.
        stamp: When [s].
    """

    kind: EndingKind
    reason: str
    num_retries: int
    stamp: float

    def __bool__(self) -> bool:
        return self.kind.succeeded


class Event(NamedTuple):
    """Something that happened.

    Attributes:
        stamp: When [s].
        name: What, always in the same words.
        detail: With numbers.
    """

    stamp: float
    name: str
    detail: str = ""


class Feedback(NamedTuple):
    """What Nav2's action feedback says, and how far it is.

    Attributes:
        state: Nav2's word for what the executor does.
        num_retries: Approaches after the first one.
        distance: Of the robot from the docked pose, as estimated [m].
        docking_time: Since the task began [s].
    """

    state: FeedbackState
    num_retries: int
    distance: float
    docking_time: float


class Step(NamedTuple):
    """What one control cycle gives.

    Attributes:
        command: To be sent now; within the limits of the robot.
        state: What the executor is doing.
        feedback: The same in Nav2's words.
        ending: None while the task goes on.
        events: What happened in this cycle.
        deviation: The robot as seen from the path that it drives: across [m] and turned [rad]; None where it drives
            none.
    """

    command: Twist2
    state: State
    feedback: Feedback
    ending: Ending | None
    events: tuple[Event, ...] = ()
    deviation: Pose2 | None = None
