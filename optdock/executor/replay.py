"""A log driven again: the same measurements and the same results of planning must give the same commands, bit for bit.

"""

from __future__ import annotations

import dataclasses
from collections import deque
from typing import TYPE_CHECKING, NamedTuple

from optdock.errors import InvalidValue
from optdock.executor.docking import DockingExecutor
from optdock.executor.planning import Job, Motion, PlanResult, Verdict
from optdock.geometry.pose import Pose2

if TYPE_CHECKING:
    from collections.abc import Iterable

    from optdock.costmap.costmap import Costmap
    from optdock.executor.log import Cycle, DockingLog, Planned
    from optdock.geometry.pose import Twist2

__all__ = ["RecordedPlanning", "Replay", "replay"]


class Replay(NamedTuple):
    """What came of a replay.

    Attributes:
        cycles: Number of them.
        differs_at: The first cycle whose command is another one; None: all are the same, bit for bit.
        command: The command of the replay there.
    """

    cycles: int
    differs_at: Cycle | None
    command: Twist2 | None


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
        return found.result._replace(motion=Motion(found.trajectory, self._problem(found, self._job)))

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
    def _problem(found: Planned, job: Job):  # type: ignore[no-untyped-def]
        x, y, yaw, speed, acceleration, curvature = found.start
        changed = {"start": Pose2(x, y, yaw), "start_speed": speed, "start_curvature": curvature}
        if hasattr(job.problem, "start_acceleration"):
            changed["start_acceleration"] = acceleration
        return dataclasses.replace(job.problem, **changed)


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
        task="undock" if task.task == "undock" else "dock",
        controller=task.controller,
        goal_checker=task.goal_checker,
        planning=planning,
    )
    for cycle in log.cycles:
        planning.deliver(cycle.planned)
        if cycle.cancelled:
            executor.cancel()
        command = executor.step(cycle.measurements).command
        same = command.linear.hex() == cycle.command.linear.hex() and command.angular.hex() == cycle.command.angular.hex()
        if not same:
            return Replay(len(log.cycles), cycle, command)
    return Replay(len(log.cycles), None, None)
