"""A log driven again: equal measurements and equal results of planning must give equal commands, bit for bit."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.executor.docking import DockingExecutor
from optdock.executor.log import RecordedPlanning

if TYPE_CHECKING:
    from optdock.executor.log import Cycle, DockingLog
    from optdock.geometry.arrays import FloatArray
    from optdock.geometry.pose import Twist2

__all__ = ["Replay", "replay"]


class Replay(NamedTuple):
    """What came of a replay; it counts as true where every command is the same.

    Attributes:
        cycles: Number of them.
        differs_at: The first cycle whose command is another one; None: all are the same, bit for bit.
        command: The command of the replay there.
        off_path: Largest distance across and largest turn off the path that was driven [m, rad].
        estimates: The robot as it was believed to be, Shape (n, 3).
    """

    cycles: int
    differs_at: Cycle | None
    command: Twist2 | None
    off_path: tuple[float, float]
    estimates: FloatArray

    def __bool__(self) -> bool:
        return self.differs_at is None


def replay(log: DockingLog) -> Replay:
    """Drive a log again, up to the first command that is another one.

    Raises:
        PluginError: A plugin of the log is not installed.
        InvalidValue: Its parameters are not those of the installed one.
    """
    planning, task = RecordedPlanning(), log.task
    executor = DockingExecutor(
        task.problem,
        task.settings,
        task=task.task,
        controller=task.controller,
        goal_checker=task.goal_checker,
        dock_type=task.dock_type,
        last_command=task.last_command,
        planning=planning,
    )
    across = turned = 0.0
    estimates: list[tuple[float, float, float]] = []
    for cycle in log.cycles:
        planning.deliver(cycle.planned)
        if cycle.cancelled:
            executor.cancel()
        step = executor.step(cycle.measurements)
        if step.deviation is not None:
            across, turned = max(across, abs(step.deviation.y)), max(turned, abs(step.deviation.yaw))
        if executor.robot is not None:
            estimates.append((executor.robot.x, executor.robot.y, executor.robot.yaw))
        if not _is_same(step.command, cycle.command):
            break
    else:
        return Replay(len(log.cycles), None, None, (across, turned), np.array(estimates).reshape(-1, 3))
    return Replay(len(log.cycles), cycle, step.command, (across, turned), np.array(estimates).reshape(-1, 3))


def _is_same(first: Twist2, second: Twist2) -> bool:
    """To the last bit: 0.0 and -0.0 are not the same."""
    return (first.linear.hex(), first.angular.hex()) == (second.linear.hex(), second.angular.hex())
