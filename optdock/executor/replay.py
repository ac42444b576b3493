"""A log driven again: equal measurements and equal results of planning must give equal commands, bit for bit."""

from __future__ import annotations

import dataclasses
from collections import deque
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.errors import InvalidValue
from optdock.executor.docking import DockingExecutor
from optdock.executor.planning import Job, Motion, PlanResult, Verdict

if TYPE_CHECKING:
    from collections.abc import Iterable

    from optdock.costmap.costmap import Costmap
    from optdock.executor.log import Cycle, DockingLog, Planned
    from optdock.geometry.arrays import FloatArray
    from optdock.geometry.pose import Twist2
    from optdock.problem import DockingProblem

__all__ = ["RecordedPlanning", "Replay", "replay"]


class Replay(NamedTuple):
    """What came of a replay.

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


class RecordedPlanning:
    """Planning out of a log: everything is delivered in the cycle in which it was."""

    def __init__(self) -> None:
        self._results: deque[Planned] = deque()
        self._verdicts: deque[Verdict] = deque()
        self._job: Job | None = None

    def deliver(self, planned: Iterable[Planned]) -> None:
        """What the coming cycle will be told."""
        self._results.clear()
        self._verdicts.clear()
        for one in planned:
            if one.verdict is not None:
                self._verdicts.append(one.verdict)
            else:
                self._results.append(one)

    def submit(self, job: Job) -> None:
        """Nothing is planned; the log knows the result."""
        self._job = job

    def poll(self, stamp: float) -> PlanResult | None:  # noqa: ARG002 - part of the interface
        """What was delivered in this cycle."""
        if not self._results:
            return None
        found = self._results.popleft()
        assert found.result is not None
        if found.trajectory is None or self._job is None:
            return found.result
        return found.result._replace(
            motion=Motion(found.trajectory, self._problem(found, self._job), None, found.start_relief)
        )

    def still_holds(self, motion: Motion, costmap: Costmap, from_time: float) -> Verdict:  # noqa: ARG002 - interface
        """What was answered in this cycle.

        Raises:
            InvalidValue: Nothing was: the replay does something else than what was recorded.
        """
        if not self._verdicts:
            raise InvalidValue("replay: asks what was not asked when the log was written")
        return self._verdicts.popleft()

    def close(self) -> None:
        """Nothing to do."""

    @staticmethod
    def _problem(found: Planned, job: Job) -> DockingProblem:
        start = found.start
        assert start is not None
        return dataclasses.replace(
            job.problem,
            start=start.pose,
            start_speed=start.speed,
            start_acceleration=start.acceleration,
            start_curvature=start.curvature,
        )


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
