"""Exceptions, named as in Nav2, each with Nav2's action error code.

Every exception raised by this library derives from `OptdockError`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

if TYPE_CHECKING:
    from collections.abc import Mapping

__all__ = [
    "BehaviorException",
    "Cancelled",
    "CertificationFailed",
    "ControllerException",
    "ControllerInvalidPath",
    "DockNotInDB",
    "DockNotValid",
    "FailedToSmoothPath",
    "FailedToTimePath",
    "GoalOccupied",
    "GoalOutsideMapBounds",
    "InvalidFile",
    "InvalidMessage",
    "InvalidPath",
    "InvalidValue",
    "LifecycleError",
    "MissingExtra",
    "NoMotionExists",
    "NoValidControl",
    "NoValidPathCouldBeFound",
    "OptdockError",
    "PlannerCancelled",
    "PlannerException",
    "PlannerTimedOut",
    "PluginError",
    "SmootherCancelled",
    "SmootherException",
    "SmootherTimedOut",
    "StartOccupied",
    "StartOutsideMapBounds",
    "TimedOut",
    "TimingCancelled",
    "TimingTimedOut",
]


class OptdockError(Exception):
    """Base class of every exception raised by optdock.

    Attributes:
        code: Nav2's action error code; 0 if Nav2 defines none.
        where: Data that locates the fault (arc length, pose, obstacle, bound, amount) as plain numbers, strings and
            lists of them.
        partial: Result of the stages that had ended before the pipeline failed, or None.
    """

    code: ClassVar[int] = 0
    partial: object | None = None

    def __init__(self, message: str, *, where: Mapping[str, object] | None = None) -> None:
        super().__init__(message)
        self.where: dict[str, object] = dict(where or {})


class InvalidValue(OptdockError, ValueError):
    """A value violates a constraint of the constructor or function that it is passed to."""


class InvalidMessage(InvalidValue):
    """A ROS message is invalid; the error names the message, field, value and rule."""


class InvalidFile(OptdockError):
    """A file cannot be read or does not match its format; the message lists every fault, one per line."""


class DockNotInDB(InvalidValue):
    """The requested dock is not in the dock database."""

    code = 901


class DockNotValid(InvalidFile):
    """A dock has an unknown type, or its frame has no known transform to the map frame."""

    code = 902


class LifecycleError(OptdockError):
    """The lifecycle state of a plugin does not allow the requested transition."""


class MissingExtra(OptdockError):
    """An optional dependency is not installed; the message names the extra that contains it."""


class PluginError(OptdockError):
    """A plugin is unknown, cannot be imported or does not implement its interface."""


class TimedOut(OptdockError):
    """The deadline passed during planning, smoothing or time parameterization."""


class Cancelled(OptdockError):
    """The cancel checker requested a stop during planning, smoothing or time parameterization."""


class CertificationFailed(OptdockError):
    """A result of a solver fails the certificate."""

    code = 503


class FailedToTimePath(OptdockError):
    """No time law satisfies the motion limits on this path from this start state."""

    code = 600


class TimingTimedOut(FailedToTimePath, TimedOut):
    """The deadline passed before a time law was found; the certified path is attached to the error."""

    code = 601


class TimingCancelled(Cancelled):
    """The cancel checker requested a stop during time parameterization or certification of the motion."""


class PlannerException(OptdockError):
    """Base class of the failures of a global planner."""

    code = 200


class StartOutsideMapBounds(PlannerException):
    """The start is outside the map."""

    code = 203


class GoalOutsideMapBounds(PlannerException):
    """The goal is outside the map."""

    code = 204


class StartOccupied(PlannerException):
    """The footprint at the start overlaps an obstacle."""

    code = 205


class GoalOccupied(PlannerException):
    """The footprint at the goal is closer to an obstacle than allowed."""

    code = 206


class PlannerTimedOut(PlannerException, TimedOut):
    """The deadline passed during planning."""

    code = 207


class NoValidPathCouldBeFound(PlannerException):
    """The planner found no path."""

    code = 208


class NoMotionExists(NoValidPathCouldBeFound):
    """It is proven that no motion connects start and goal, or that no motion ends in the dock as required.

    Attributes:
        proof: The `ImpossibilityProof` or the `BlockedStraight`.
    """

    def __init__(self, message: str, *, proof: object, where: Mapping[str, object] | None = None) -> None:
        super().__init__(message, where=where)
        self.proof = proof


class PlannerCancelled(PlannerException, Cancelled):
    """The cancel checker requested a stop during planning."""

    code = 0


class ControllerException(OptdockError):
    """Base class of the failures of a controller."""

    code = 100


class ControllerInvalidPath(ControllerException):
    """The controller received no path, or a path that it cannot follow."""

    code = 103


class NoValidControl(ControllerException):
    """No command is admissible in this control cycle."""

    code = 106


class SmootherException(OptdockError):
    """Base class of the failures of a smoother."""

    code = 500


class SmootherTimedOut(SmootherException, TimedOut):
    """The deadline passed before any path was certified."""

    code = 502


class FailedToSmoothPath(SmootherException):
    """No path near the input satisfies every bound; the message names the violated bound."""

    code = 504


class InvalidPath(SmootherException):
    """The path is empty, too short or not finite."""

    code = 505


class SmootherCancelled(SmootherException, Cancelled):
    """The cancel checker requested a stop during smoothing."""

    code = 0


class BehaviorException(OptdockError):
    """Base class of the failures of a behavior."""
