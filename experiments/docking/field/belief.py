"""Error of the executor's dock estimate: at the end, and its recovery time after the dock was pushed."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from experiments.docking.outcome import ACCEPTED

if TYPE_CHECKING:
    from experiments.docking.field.world import FieldRobot
    from optdock.executor import DockingExecutor
    from optdock.geometry.pose import Pose2

__all__ = ["Belief"]


class Belief:
    """Error of the executor's estimate of the robot pose in the dock frame.

    Attributes:
        off: Last distance between estimate and truth [m]; NaN before the robot is located.
        turned_off: Last angle between estimate and truth [rad].
        recovered_after: Number of detections of the pushed dock until the estimate was within 10 mm, 10 mm and 1.5
            degrees of the truth; infinite if it never was, NaN if nothing was pushed.
    """

    def __init__(self) -> None:
        self.off = self.turned_off = math.nan
        self.recovered_after = math.nan
        self._is_waiting = True

    def compare(self, executor: DockingExecutor, robot: FieldRobot) -> None:
        """Update the errors after a control cycle."""
        if executor.robot is None:
            return
        seen = executor.robot.in_frame_of(executor.dock)
        gap = robot.error.in_frame_of(seen)
        self.off, self.turned_off = math.hypot(gap.x, gap.y), abs(gap.yaw)
        if len(robot.docks) > 1 and self._is_waiting:
            self._wait(gap, robot)

    def _wait(self, gap: Pose2, robot: FieldRobot) -> None:
        """Count detections of a pushed dock until the estimate has recovered."""
        values = abs(gap.x), abs(gap.y), abs(gap.yaw)
        if all(value <= most for value, most in zip(values, ACCEPTED, strict=True)):
            since = robot.docks[-1][0]
            self.recovered_after = float(sum(one.stamp >= since for _, one in robot.detections))
            self._is_waiting = False
        else:
            self.recovered_after = math.inf
