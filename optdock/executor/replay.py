"""Replay of a log: identical measurements and planning results must give bit-for-bit identical commands."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.executor.docking import DockingExecutor
from optdock.executor.planning import RecordedPlanning

if TYPE_CHECKING:
    from optdock.executor.log import Cycle, DockingLog
    from optdock.geometry.arrays import FloatArray
    from optdock.geometry.pose import Twist2

__all__ = ["Replay", "replay"]


class Replay(NamedTuple):
    """Result of a replay; true if every command is the same.

    Attributes:
        cycles: Number of cycles of the log.
        differs_at: First cycle with a different command; None if all commands are equal bit for bit.
        command: Command of the replay in that cycle.
        off_path: Largest lateral and heading deviation from the path [m, rad].
        estimates: Estimated poses of the robot, Shape (n, 3).
    """

    cycles: int
    differs_at: Cycle | None
    command: Twist2 | None
    off_path: tuple[float, float]
    estimates: FloatArray

    def __bool__(self) -> bool:
        return self.differs_at is None


def replay(log: DockingLog) -> Replay:
    """Replay a log up to the first different command.

    Raises:
        PluginError: If a plugin of the log is not installed.
        InvalidValue: If the logged parameters of a plugin are not valid for the installed plugin.
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
    differs_at: Cycle | None = None
    command: Twist2 | None = None
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
            differs_at, command = cycle, step.command
            break
    return Replay(len(log.cycles), differs_at, command, (across, turned), np.array(estimates).reshape(-1, 3))


def _is_same(first: Twist2, second: Twist2) -> bool:
    """Whether two commands are equal to the last bit; 0.0 and -0.0 are different."""
    return (first.linear.hex(), first.angular.hex()) == (second.linear.hex(), second.angular.hex())
