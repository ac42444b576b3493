"""The exception tree: Nav2's nouns, each with Nav2's action error code.

Every exception that leaves this library derives from `OptdockError`, carries a `code` and may carry `where`: the
data that locates the fault (arc length, pose, obstacle, bound, amount), ready for a plan file.
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
    """Base of every exception raised by optdock.

    Attributes:
        code: Nav2's action error code, 0 where Nav2 has none.
        where: What locates the fault; plain numbers, strings and lists of them.
        partial: What a pipeline had finished when it failed, or None.
    """

    code: ClassVar[int] = 0
    partial: object | None = None

    def __init__(self, message: str, *, where: Mapping[str, object] | None = None) -> None:
        super().__init__(message)
        self.where: dict[str, object] = dict(where or {})


class InvalidValue(OptdockError, ValueError):
    """A value breaks a rule that its constructor states."""


class InvalidMessage(InvalidValue):
    """A ROS message breaks a rule; the error names message, field, value and rule."""


class InvalidFile(OptdockError):
    """A file cannot be read or breaks its format; the message lists every fault, one per line."""


class DockNotInDB(InvalidValue):
    """The dock asked for is not in the dock database."""

    code = 901


class DockNotValid(InvalidFile):
    """A dock is of a type that nothing knows, or in a frame that nothing relates to the map's."""

    code = 902


class LifecycleError(OptdockError):
    """A plugin was asked for a transition its lifecycle state does not allow."""


class MissingExtra(OptdockError):
    """An optional dependency is not installed; the message names the extra that brings it."""


class PluginError(OptdockError):
    """A plugin is unknown, cannot be imported or does not keep its interface."""


class TimedOut(OptdockError):
    """The deadline came first, in whatever stage: the planner, the smoother or the time parameterizer."""


class Cancelled(OptdockError):
    """The cancel checker asked to stop, in whatever stage."""


class CertificationFailed(OptdockError):
    """The independent certificate refuses a result that a solver proposed."""

    code = 503


class FailedToTimePath(OptdockError):
    """No time law keeps the motion limits on this path from this start state."""

    code = 600


class TimingTimedOut(FailedToTimePath, TimedOut):
    """The deadline came before the time law; the path is certified and hangs on the error."""

    code = 601


class TimingCancelled(Cancelled):
    """The cancel checker asked to stop while a smoothed path was timed, or the motion proven."""


class PlannerException(OptdockError):
    """Any failure of a global planner."""

    code = 200


class StartOutsideMapBounds(PlannerException):
    """The start lies off the map."""

    code = 203


class GoalOutsideMapBounds(PlannerException):
    """The goal lies off the map."""

    code = 204


class StartOccupied(PlannerException):
    """The footprint at the start overlaps an obstacle."""

    code = 205


class GoalOccupied(PlannerException):
    """The footprint at the goal is closer to an obstacle than allowed."""

    code = 206


class PlannerTimedOut(PlannerException, TimedOut):
    """The planner ran out of time."""

    code = 207


class NoValidPathCouldBeFound(PlannerException):
    """There is no path of the kind this planner makes."""

    code = 208


class NoMotionExists(NoValidPathCouldBeFound):
    """No motion of any kind joins start and goal, or none can end in the dock as it asks, and that is proven.

    Attributes:
        proof: The `ImpossibilityProof`, or the `BlockedStraight`.
    """

    def __init__(self, message: str, *, proof: object, where: Mapping[str, object] | None = None) -> None:
        super().__init__(message, where=where)
        self.proof = proof


class PlannerCancelled(PlannerException, Cancelled):
    """The cancel checker asked the planner to stop."""

    code = 0


class ControllerException(OptdockError):
    """Any failure of a controller."""

    code = 100


class ControllerInvalidPath(ControllerException):
    """The controller was given no path, or one it cannot follow."""

    code = 103


class NoValidControl(ControllerException):
    """No command is admissible in this cycle."""

    code = 106


class SmootherException(OptdockError):
    """Any failure of a smoother."""

    code = 500


class SmootherTimedOut(SmootherException, TimedOut):
    """The deadline came before any certified path."""

    code = 502


class FailedToSmoothPath(SmootherException):
    """No path near the input keeps every bound; the message names the bound in the way."""

    code = 504


class InvalidPath(SmootherException):
    """The path is empty, too short or not finite."""

    code = 505


class SmootherCancelled(SmootherException, Cancelled):
    """The cancel checker asked the smoother to stop."""

    code = 0


class BehaviorException(OptdockError):
    """Any failure of a behavior."""
