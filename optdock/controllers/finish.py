"""The end of a drive: what is left is corrected against the drive's dead band, or named when it cannot be.

A wheeled robot that stands corrects what lies along its heading, and its heading if it can turn in place; what lies
across stays. A drive that does not move at a small command is told a larger and larger one until it does.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

from optdock.geometry.pose import Twist2
from optdock.model.dock import DockTolerances

if TYPE_CHECKING:
    from optdock.geometry.pose import Pose2
    from optdock.plugins.interfaces import GoalChecker
    from optdock.plugins.lifecycle import PluginContext

__all__ = ["Accepted", "DeadBandPush", "Patience", "accepted_errors"]

_STANDS = Twist2(0.003, 0.01)  # [m/s], [rad/s]: slower than this a drive has not moved yet
_PUSH_RATE = Twist2(0.05, 0.2)  # [m/s^2], [rad/s^2]: through a dead band of 0.05 m/s in a second
_MOST_PUSH = Twist2(0.1, 0.3)  # [m/s], [rad/s]: no drive's dead band is wider
_BETTER = 0.95  # of the least shortfall so far, to count as progress: noise alone makes no new least for long


class Accepted(NamedTuple):
    """Errors that are accepted: along and across the goal's heading [m], of heading [rad]."""

    along: float
    cross: float
    yaw: float

    def shortfall(self, error: Pose2) -> float:
        """The largest of the errors in units of what is accepted; at most 1 where all are."""
        return max(abs(error.x) / self.along, abs(error.y) / self.cross, abs(error.yaw) / self.yaw)


def accepted_errors(goal_checker: GoalChecker | None, context: PluginContext) -> Accepted:
    """What the goal checker accepts; what it does not measure, and without one, what the dock of the problem does."""
    asked = goal_checker.tolerances if goal_checker else None
    dock = context.problem.dock.tolerances if context.problem else DockTolerances()
    given = (asked.x, asked.y, asked.yaw) if asked else (None, None, None)
    usual = (dock.along, dock.cross, dock.yaw)
    return Accepted(*(u if g is None or g <= 0.0 else g for g, u in zip(given, usual, strict=True)))


class Patience:
    """Notices that something that should become less does not any more."""

    def __init__(self) -> None:
        self._least, self._idle = math.inf, 0.0

    def lost(self, shortfall: float, period: float, patience: float) -> bool:
        """Whether the shortfall, which is fine at 1, has not become less for `patience` [s]; then it begins anew."""
        if shortfall <= 1.0 or self._idle > patience:
            self._least, self._idle = math.inf, 0.0
        elif shortfall < _BETTER * self._least:
            self._least, self._idle = shortfall, 0.0
        else:
            self._idle += period
        return self._idle > patience


class DeadBandPush:
    """What is added to a command that the drive does not answer, growing until it does."""

    def __init__(self) -> None:
        self._push = [0.0, 0.0]

    def onto(self, wanted: Twist2, error: Pose2, near: Pose2, velocity: Twist2, period: float) -> Twist2:
        """`wanted` with the push of this period.

        Args:
            wanted: Towards the goal.
            error: The goal seen from the robot.
            near: Errors that need no push; y plays no part.
            velocity: Measured.
            period: Since the last call [s].
        """
        return Twist2(
            wanted.linear + self._grown(0, error.x, near.x, velocity.linear, period),
            wanted.angular + self._grown(1, error.yaw, near.yaw, velocity.angular, period),
        )

    def _grown(self, axis: int, error: float, near: float, speed: float, period: float) -> float:
        still, rate, most = ((pair.linear, pair.angular)[axis] for pair in (_STANDS, _PUSH_RATE, _MOST_PUSH))
        push = self._push[axis]
        if abs(error) <= near or push * error < 0.0:
            push = 0.0
        elif abs(speed) < still:
            push = math.copysign(min(abs(push) + rate * period, most), error)
        self._push[axis] = push
        return push
