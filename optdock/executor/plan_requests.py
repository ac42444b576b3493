"""Plans asked for beside the control loop, one at a time, and their results reported."""

from __future__ import annotations

from typing import TYPE_CHECKING

from optdock.executor.interruptions import TaskFailed
from optdock.executor.log import RecordedPlanning
from optdock.executor.planning import Job, Outcome
from optdock.executor.task_states import EndingKind

if TYPE_CHECKING:
    from collections.abc import Callable

    from optdock.executor.planning import DrivenMotion, Planning, PlanResult, Verdict
    from optdock.model.costmap import Costmap

__all__ = ["PlanRequests"]


class PlanRequests:
    """Numbers jobs, and tells the result of the last one from those of older ones.

    Args:
        planning: Works on them.
        report: Takes the name of an event and its detail.
    """

    def __init__(self, planning: Planning, report: Callable[[str, str], None]) -> None:
        self._planning, self._report = planning, report
        self._number = 0
        self.pending = False

    def submit(self, job: Job) -> int:
        """Hand in a job, whose number is set; the result of the one before is not waited for any more.

        Returns:
            Its number.
        """
        self._number += 1
        self.pending = True
        self._planning.submit(job._replace(number=self._number))
        return self._number

    def forget(self) -> None:
        """Wait for no result any more."""
        self.pending = False

    def result(self, now: float) -> PlanResult | None:
        """The result of the last job, once; None while there is none.

        Args:
            now: [s].

        Raises:
            TaskFailed: It is a motion that leads on, and no proven one; a log is believed, for it drives no robot.
        """
        result = self._planning.poll(now)
        if result is None or not self.pending or result.number != self._number:
            return None
        self.pending = False
        unproven = result.motion is not None and result.motion.plan is None
        if result.outcome is Outcome.NEW and unproven and not isinstance(self._planning, RecordedPlanning):
            raise TaskFailed(EndingKind.UNKNOWN, "planning returned a motion that is not proven")
        detail = result.reason
        if result.motion is not None:
            trajectory = result.motion.trajectory
            detail = f"{trajectory.path.driven:.3f} m in {trajectory.duration:.2f} s"
        self._report(f"plan {result.outcome.value}", detail)
        return result

    def still_holds(self, motion: DrivenMotion, costmap: Costmap, time: float) -> Verdict:
        """Whether the rest of a motion is free among what a newer costmap shows, see `Planning.still_holds`."""
        return self._planning.still_holds(motion, costmap, time)
