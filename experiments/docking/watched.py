"""Instrumentation of a run: CPU time of every control cycle, and the followed plans."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from experiments.docking.outcome import FollowedPlan
from optdock.deadline import now
from optdock.executor.planning import InlinePlanning

if TYPE_CHECKING:
    from collections.abc import Callable

    from optdock.executor.planning import Job, PlanResult
    from optdock.geometry.pose import Twist2

__all__ = ["Cycles", "WatchedPlanning"]


class Cycles:
    """CPU seconds of every control cycle."""

    def __init__(self) -> None:
        self.spent: list[float] = []

    def timed(self, work: Callable[[], Twist2]) -> Twist2:
        """Return the command computed by `work`, and record its CPU time."""
        began = now()
        try:
            return work()
        finally:
            self.spent.append(now() - began)

    @property
    def busy(self) -> float:
        """99th percentile [s]."""
        return float(np.percentile(self.spent, 99)) if self.spent else 0.0


class WatchedPlanning(InlinePlanning):
    """Planning that records the followed certified plans and their start times."""

    def __init__(self) -> None:
        super().__init__()
        self.followed: list[FollowedPlan] = []
        self.replans = 0
        self.spent: list[float] = []
        self._job: Job | None = None

    def submit(self, job: Job) -> None:
        """Submit a request; its CPU time is not part of the control cycle."""
        self._job, began = job, now()
        super().submit(job)
        self.spent.append(now() - began)

    def poll(self, stamp: float) -> PlanResult | None:
        """See `Planning.poll`."""
        result = super().poll(stamp)
        if result is not None and result.motion is not None and self._job is not None:
            in_motion = self._job.running is not None
            self.replans += in_motion
            since = self._job.stamp + self._job.lead if in_motion else stamp
            self.followed.append(FollowedPlan(since, result.motion.plan))
        return result
