"""Checks of the tracking controller: validity of its inputs, and progress towards the accepted errors."""

from __future__ import annotations

import math
from numbers import Real
from typing import TYPE_CHECKING, NamedTuple

from optdock.errors import ControllerInvalidPath, InvalidValue, NoValidControl
from optdock.model.dock import DockTolerances
from optdock.model.path import Path, may_be_one_frame
from optdock.model.trajectory import Trajectory
from optdock.verification import proven_for

if TYPE_CHECKING:
    from optdock.geometry.pose import Pose2
    from optdock.plugins.interfaces import GoalChecker
    from optdock.plugins.lifecycle import PluginContext

__all__ = ["AcceptedErrors", "ProgressCheck", "accepted_errors", "checked_speed_limit", "checked_task"]

_BETTER = 0.95  # of the least shortfall so far, to count as progress: above the scatter of noise


def checked_speed_limit(limit: object, percentage: object) -> float:
    """Check a speed limit in percent or m/s, and return it.

    Raises:
        InvalidValue: If `limit` is not a finite number >= 0, or `percentage` is not a bool.
    """
    if not isinstance(percentage, bool):
        raise InvalidValue(f"TrackingController: percentage must be True (percent) or False (m/s), got {percentage!r}")
    if isinstance(limit, bool) or not isinstance(limit, Real) or not (math.isfinite(limit) and float(limit) >= 0.0):
        raise InvalidValue(f"TrackingController: the speed limit must be finite and >= 0, got {limit!r}")
    return float(limit)


def checked_task(task: Path | Trajectory, context: PluginContext) -> Path | Trajectory:
    """Check `task`, the path or trajectory to follow, and return it.

    The frame must be equal to the frame of the configured problem if both are known. A certified trajectory must have
    been certified for the configured problem; only its start may differ, because a plan made in motion begins at the
    pose of the robot. Obstacles found after planning belong in `local_costmap`, which is read in every cycle.

    Raises:
        ControllerInvalidPath: If `task` is neither a path nor a trajectory, is in a different frame, or was certified
            for a different problem.
    """
    if not isinstance(task, Path | Trajectory):
        raise ControllerInvalidPath(f"TrackingController: can follow a Path or a Trajectory, got {type(task).__name__}")
    if context.problem is not None and not may_be_one_frame(task.frame, context.problem.frame):
        raise ControllerInvalidPath(
            f"TrackingController: the path is in frame {task.frame!r}, the configured problem in "
            f"{context.problem.frame!r}; transform one of them",
            where={"path": task.frame, "problem": context.problem.frame},
        )
    proven = proven_for(task) if isinstance(task, Trajectory) else None
    if proven is not None and context.problem is not None:
        differences = proven.differences(context.problem.fingerprint)
        others = [name for name in differences if name not in ("start", "frame")]  # frames: above
        if others:
            raise ControllerInvalidPath(
                f"TrackingController: the trajectory was certified for another problem than the configured one: "
                f"{', '.join(others)} differ; configure the controller anew, or plan again",
                where={"differences": others},
            )
    return task


class AcceptedErrors(NamedTuple):
    """Accepted errors along and across the goal's heading [m], and of the heading [rad]."""

    along: float
    cross: float
    yaw: float

    def shortfall(self, error: Pose2) -> float:
        """Return the largest ratio of an error to the accepted error; at most 1 if all errors are accepted."""
        return max(abs(error.x) / self.along, abs(error.y) / self.cross, abs(error.yaw) / self.yaw)


def accepted_errors(goal_checker: GoalChecker | None, context: PluginContext) -> AcceptedErrors:
    """Return the tolerances of the goal checker; missing tolerances are taken from the problem's dock."""
    asked = goal_checker.tolerances if goal_checker else None
    dock = context.problem.dock.tolerances if context.problem else DockTolerances()
    if asked is None:
        return AcceptedErrors(dock.along, dock.cross, dock.yaw)
    x, y, yaw = asked.x, asked.y, asked.yaw
    return AcceptedErrors(
        dock.along if x is None or x <= 0.0 else x,
        dock.cross if y is None or y <= 0.0 else y,
        dock.yaw if yaw is None or yaw <= 0.0 else yaw,
    )


class _StallTimer:
    """Timer that measures the time for which a quantity that should decrease has made no progress."""

    def __init__(self) -> None:
        self._least, self._idle = math.inf, 0.0

    def expired(self, shortfall: float, period: float, patience: float) -> bool:
        """Whether a shortfall above 1 has not decreased for `patience` [s]; the timer then restarts."""
        if shortfall <= 1.0 or self._idle > patience:
            self._least, self._idle = math.inf, 0.0
        elif shortfall < _BETTER * self._least:
            self._least, self._idle = shortfall, 0.0
        else:
            self._idle += period
        return self._idle > patience


class ProgressCheck:
    """Detector of a robot that does not follow its reference, or does not approach the goal at the end."""

    def __init__(self) -> None:
        self._following, self._arriving = _StallTimer(), _StallTimer()

    def check(
        self, error: Pose2, period: float, patience: float, *, is_held: bool, left: AcceptedErrors | None
    ) -> None:
        """Check the progress in this period.

        Args:
            error: The reference pose in the robot's frame.
            period: Time since the last call [s].
            patience: Time without progress after which the task ends [s].
            is_held: Whether the reference waits for the robot.
            left: Accepted errors, once the reference is at its end; None before the end.

        Raises:
            NoValidControl: If the reference has been held for longer than `patience`, or the error at the end of the
                trajectory has not decreased for that time.
        """
        where = {"along": error.x, "cross": error.y, "yaw": error.yaw}
        if self._following.expired(2.0 if is_held else 0.0, period, patience):
            raise NoValidControl(
                f"TrackingController: the robot does not follow: for {patience:g} s the reference has waited "
                f"{abs(error.x):.3f} m ahead; the robot is blocked, or its drive does not respond",
                where=where,
            )
        if self._arriving.expired(left.shortfall(error) if left else 0.0, period, patience) and left:
            raise NoValidControl(
                f"TrackingController: the goal tolerances are not reached: {error.x:.3f} m along, {error.y:.3f} m "
                f"across and {error.yaw:.3f} rad remain, tolerances {left.along:g} m, {left.cross:g} m and "
                f"{left.yaw:g} rad, no improvement for {patience:g} s; plan again from here",
                where=where,
            )
