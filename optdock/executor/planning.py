"""Planning beside the control loop: a job is handed in, and its result is there some cycles later.

Three ways to do it: at once, delivered after a time that the caller chooses (simulations, the same in every run); in a
thread, or from there in another process (`PlanningProcess`; servers); out of a log (replay).
"""

from __future__ import annotations

import math
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, NamedTuple, Protocol

from optdock.errors import InvalidValue, OptdockError
from optdock.geometry.checked import exactly, finite_number
from optdock.planning.pipeline import plan_dock
from optdock.planning.plan import DockPlan
from optdock.planning.replanning import DriveState, ReplanOutcome, replan, still_holds

if TYPE_CHECKING:
    from collections.abc import Callable

    from optdock.geometry.pose import Pose2
    from optdock.model.costmap import Costmap
    from optdock.model.problem import DockingProblem
    from optdock.model.trajectory import Trajectory

__all__ = [
    "DrivenMotion",
    "InlinePlanning",
    "Job",
    "Outcome",
    "PlanResult",
    "Planning",
    "ThreadPlanning",
    "Verdict",
]


class Outcome(str, Enum):
    """What became of a job."""

    NEW = "new"  # there is another motion
    KEPT = "kept"  # the running one goes on
    STOP = "stop"  # there is a motion that brakes
    FAILED = "failed"


@dataclass(frozen=True, eq=False)
class DrivenMotion:
    """What is being driven, and what it was proven for.

    Args:
        trajectory: When to be where.
        problem: From where to where, among what.
        plan: The plan whose motion that is; None where it comes out of a log, or brakes only.
        start_relief: Of its certificate, see `Tube` [m].

    Raises:
        InvalidValue: `plan` is no `DockPlan`, or its motion is another one.
    """

    trajectory: Trajectory
    problem: DockingProblem
    plan: DockPlan | None = None
    start_relief: float = 0.0

    def __post_init__(self) -> None:
        if self.plan is None:
            return
        exactly(DockPlan, self.plan, "motion.plan")
        proven = self.plan.motion
        if self.trajectory is not proven.trajectory or self.problem is not proven.problem:
            raise InvalidValue("motion: trajectory and problem must be those that its plan was proven for")

    @classmethod
    def of(cls, plan: DockPlan) -> DrivenMotion:
        """That of a plan."""
        exactly(DockPlan, plan, "plan")
        return cls(plan.trajectory, plan.problem, plan, plan.certificate.start_relief)


class Job(NamedTuple):
    """What is to be planned.

    Attributes:
        number: Rises by one from job to job.
        stamp: When it was handed in [s].
        problem: From where, to where, among what.
        budget: Wall-clock seconds.
        running: What is being driven meanwhile; None where the robot stands.
        time: Of the reference on the running motion's own clock [s].
        rate: How fast that runs [1].
        pose: Of the robot, measured.
        lead: How far ahead of that time the new motion takes over [s].
        moved: What the running motion has been moved by as a whole, because the robot steers by a dock that it sees
            elsewhere now; None: nothing.
    """

    number: int
    stamp: float
    problem: DockingProblem
    budget: float
    running: DrivenMotion | None = None
    time: float = 0.0
    rate: float = 1.0
    pose: Pose2 | None = None
    lead: float = 0.05
    moved: Pose2 | None = None


class PlanResult(NamedTuple):
    """What became of a job; it counts as true unless it failed.

    Attributes:
        number: Of the job.
        outcome: In a word.
        motion: The new one; None where there is none.
        starts_at: When it takes over, on the running motion's own clock [s].
        reason: Why there is none, with the name of the error.
        code: Nav2's error code of that.
    """

    number: int
    outcome: Outcome
    motion: DrivenMotion | None = None
    starts_at: float = 0.0
    reason: str = ""
    code: int = 0

    def __bool__(self) -> bool:
        return self.outcome is not Outcome.FAILED


class Verdict(NamedTuple):
    """Whether the rest of a motion still keeps its clearance; it counts as true where it does.

    Attributes:
        holds: In a word.
        reason: What stands in the way, and where.
        at_time: When the motion would be there, on its own clock [s].
    """

    holds: bool
    reason: str = ""
    at_time: float = math.inf

    def __bool__(self) -> bool:
        return self.holds


class Planning(Protocol):
    """Does the jobs of an executor, one at a time."""

    def submit(self, job: Job) -> None:
        """Begin a job; the result of the job before is dropped."""

    def poll(self, stamp: float) -> PlanResult | None:
        """The result of the last job once it is there; then None until the next one's."""

    def still_holds(self, motion: DrivenMotion, costmap: Costmap, from_time: float) -> Verdict:
        """Whether a motion keeps its clearance among the cells of a costmap too, from a time on [s]."""

    def close(self) -> None:
        """Nothing more will be asked."""


def planned(job: Job) -> PlanResult:
    """Do a job; a failure is reported in its result."""
    try:
        return _replanned(job) if job.running is not None else _from_rest(job)
    except OptdockError as error:
        return PlanResult(job.number, Outcome.FAILED, reason=f"{type(error).__name__}: {error}", code=error.code)


def _from_rest(job: Job) -> PlanResult:
    plan = plan_dock(job.problem, time_budget=job.budget)
    return PlanResult(job.number, Outcome.NEW, DrivenMotion.of(plan))


def _replanned(job: Job) -> PlanResult:
    """A motion that takes over from the running one, from where the robot truly is.

    So the new path begins where the robot will be, to the millimetre, and the feedback has nothing left to correct.
    """
    assert job.running is not None
    plan = job.running.plan
    if plan is None:
        return PlanResult(job.number, Outcome.FAILED, reason="what is driven is not a plan, so nothing follows it")
    state = DriveState(job.time, job.rate, job.pose, job.moved, is_filtered=True)
    found = replan(plan, job.problem, state, job.budget, lead=job.lead)
    if found.outcome is ReplanOutcome.KEPT:
        return PlanResult(job.number, Outcome.KEPT, reason=found.reason)
    motion = DrivenMotion(found.trajectory, job.problem) if found.plan is None else DrivenMotion.of(found.plan)
    outcome = Outcome.NEW if found.outcome is ReplanOutcome.NEW else Outcome.STOP
    return PlanResult(job.number, outcome, motion, found.starts_at, found.reason)


def holds(motion: DrivenMotion, costmap: Costmap, from_time: float) -> Verdict:
    """As `Planning.still_holds`."""
    if motion.plan is None:
        return Verdict(holds=True)
    found = still_holds(motion.plan, costmap, from_time)
    return Verdict(found.holds, found.reason, math.inf if found.at_time is None else found.at_time)


class InlinePlanning:
    """Does a job when it is handed in, and shows the result later: what planning takes is simulated, not measured.

    Args:
        latency: After how long a result is there, by the stamps [s].
        patience: Budgets are so many times as long by the wall clock, so that results do not depend on what else the
            machine does [1].

    Raises:
        InvalidValue: The latency is negative, the patience not > 0, or one of them is not finite.
    """

    def __init__(self, latency: float = 0.02, patience: float = 5.0) -> None:
        if not finite_number(latency, "planning.latency") >= 0.0:
            raise InvalidValue(f"planning.latency: must be >= 0 s, got {latency}")
        if not finite_number(patience, "planning.patience") > 0.0:
            raise InvalidValue(f"planning.patience: must be > 0, got {patience}")
        self._latency, self._patience = latency, patience
        self._ready: tuple[float, PlanResult] | None = None

    def submit(self, job: Job) -> None:
        """Do it now."""
        self._ready = job.stamp + self._latency, planned(job._replace(budget=self._patience * job.budget))

    def poll(self, stamp: float) -> PlanResult | None:
        """The result, once the latency has passed."""
        if self._ready is None or stamp < self._ready[0] - _INSTANT:
            return None
        result, self._ready = self._ready[1], None
        return result

    def still_holds(self, motion: DrivenMotion, costmap: Costmap, from_time: float) -> Verdict:
        """At once."""
        return holds(motion, costmap, from_time)

    def close(self) -> None:
        """Nothing to do."""


_INSTANT = 1e-9  # [s]: rounding of stamps that are sums of periods


class ThreadPlanning:
    """Does jobs in a thread of its own; close it at the end.

    A job is not interrupted: its budget bounds it, and the next one begins after it.

    Args:
        plan: What does a job; `PlanningProcess.planned` does it in another process.
    """

    def __init__(self, plan: Callable[[Job], PlanResult] = planned) -> None:
        self._plan = plan
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="optdock-planning")
        self._result: Future[PlanResult] | None = None

    def submit(self, job: Job) -> None:
        """Put it into the queue; what waits there is dropped."""
        if self._result is not None:
            self._result.cancel()
        self._result = self._thread.submit(self._plan, job)

    def poll(self, stamp: float) -> PlanResult | None:  # noqa: ARG002 - part of the interface
        """The result, once it is there."""
        if self._result is None or not self._result.done():
            return None
        future, self._result = self._result, None
        return future.result()

    def still_holds(self, motion: DrivenMotion, costmap: Costmap, from_time: float) -> Verdict:
        """At once, in the caller's thread: it takes less than a millisecond or two."""
        return holds(motion, costmap, from_time)

    def close(self) -> None:
        """Drop what waits; the thread ends with the job at work, for which no control loop must wait."""
        self._thread.shutdown(wait=False, cancel_futures=True)
