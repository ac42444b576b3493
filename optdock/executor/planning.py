"""Planning jobs, run inline (simulations), in a thread or process (servers), or from a log (replay)."""

from __future__ import annotations

import dataclasses
import math
from collections import deque
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, NamedTuple, Protocol

from optdock.errors import InvalidValue, OptdockError
from optdock.executor.task_states import EndingKind, TaskFailed
from optdock.geometry.checked import exactly, finite_number
from optdock.planning.pipeline import plan_dock
from optdock.planning.plan import DockPlan
from optdock.planning.replanning import DriveState, ReplanOutcome, replan, still_holds

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from optdock.geometry.pose import Pose2
    from optdock.model.costmap import Costmap
    from optdock.model.problem import DockingProblem
    from optdock.model.trajectory import Trajectory

__all__ = [
    "DrivenMotion",
    "InlinePlanning",
    "Job",
    "MotionStart",
    "Outcome",
    "PlanRequests",
    "PlanResult",
    "Planned",
    "Planning",
    "RecordedPlanning",
    "ThreadPlanning",
    "Verdict",
    "planned",
]

_INSTANT = 1e-9  # [s]: rounding of stamps that are sums of periods


class Outcome(str, Enum):
    """Outcome of a planning job."""

    NEW = "new"  # another motion
    KEPT = "kept"  # the running motion continues
    STOP = "stop"  # a motion that brakes
    FAILED = "failed"


@dataclass(frozen=True, eq=False)
class DrivenMotion:
    """A motion to drive, and the problem for which it was certified.

    Args:
        trajectory: Time-parameterized path.
        problem: Start, goal and obstacles.
        plan: Plan that contains this motion; None for a motion from a log and for a braking motion.
        start_relief: Start relief in the certificate, see `Tube` [m].

    Raises:
        InvalidValue: If `plan` is not a `DockPlan`, or contains a different motion.
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
            raise InvalidValue("motion: trajectory and problem must come from its plan")

    @classmethod
    def of(cls, plan: DockPlan) -> DrivenMotion:
        """Return the motion of a plan."""
        exactly(DockPlan, plan, "plan")
        return cls(plan.trajectory, plan.problem, plan, plan.certificate.start_relief)


class Job(NamedTuple):
    """A planning job.

    Attributes:
        number: Number of the job, increasing.
        stamp: Time of submission [s].
        problem: Problem to plan.
        budget: Wall-clock time [s].
        running: Motion being driven; None at rest.
        time: Time of the reference on the clock of the running motion [s].
        rate: Rate of that clock [1].
        pose: Measured pose of the robot.
        lead: Time between `time` and the takeover by the new motion [s].
        moved: Displacement of the running motion as a whole, if the estimated dock has moved since the motion was
            planned; None: no displacement.
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
    """Result of a job; true unless the job failed.

    Attributes:
        number: Number of the job.
        outcome: Outcome.
        motion: New motion; None if there is none.
        starts_at: Time of the takeover on the clock of the running motion [s].
        reason: Reason why there is no new motion, with the name of the error.
        code: Nav2's code of the error; 0 without an error.
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
    """Result of checking the clearance of the rest of a motion; true if the clearance is sufficient.

    Attributes:
        holds: Whether the rest of the motion has the required clearance.
        reason: The obstacle and its position.
        at_time: Time at which the motion would reach the obstacle, on the clock of the motion [s].
    """

    holds: bool
    reason: str = ""
    at_time: float = math.inf

    def __bool__(self) -> bool:
        return self.holds


class Planning(Protocol):
    """Interface that runs the planning jobs of an executor, one at a time."""

    def submit(self, job: Job) -> None:
        """Start a job; the result of the previous job is dropped."""

    def poll(self, stamp: float) -> PlanResult | None:
        """Return the result of the last job once, when it is available; None otherwise."""

    def still_holds(self, motion: DrivenMotion, costmap: Costmap, from_time: float) -> Verdict:
        """Return whether a motion after a time [s] has the required clearance from the obstacles of a costmap."""
        if motion.plan is None:
            return Verdict(holds=True)
        found = still_holds(motion.plan, costmap, from_time)
        return Verdict(found.holds, found.reason, math.inf if found.at_time is None else found.at_time)

    def close(self) -> None:
        """Release all resources; the default implementation has no resources."""
        return  # optional for subclasses, therefore not abstract


def planned(job: Job) -> PlanResult:
    """Run a job; errors are returned in the result."""
    try:
        return _replanned(job) if job.running is not None else _from_rest(job)
    except OptdockError as error:
        return PlanResult(job.number, Outcome.FAILED, reason=f"{type(error).__name__}: {error}", code=error.code)


def _from_rest(job: Job) -> PlanResult:
    plan = plan_dock(job.problem, time_budget=job.budget)
    return PlanResult(job.number, Outcome.NEW, DrivenMotion.of(plan))


def _replanned(job: Job) -> PlanResult:
    """Plan a motion that starts from the measured pose, which leaves no offset for the feedback to correct."""
    assert job.running is not None
    plan = job.running.plan
    if plan is None:
        return PlanResult(job.number, Outcome.FAILED, reason="the running motion is not a plan")
    state = DriveState(job.time, job.rate, job.pose, job.moved, is_filtered=True)
    found = replan(plan, job.problem, state, job.budget, lead=job.lead)
    if found.outcome is ReplanOutcome.KEPT:
        return PlanResult(job.number, Outcome.KEPT, reason=found.reason)
    motion = DrivenMotion(found.trajectory, job.problem) if found.plan is None else DrivenMotion.of(found.plan)
    outcome = Outcome.NEW if found.outcome is ReplanOutcome.NEW else Outcome.STOP
    return PlanResult(job.number, outcome, motion, found.starts_at, found.reason)


class InlinePlanning(Planning):
    """Planning within `submit`, with a simulated latency of the result.

    Args:
        latency: Time until a result is available, on the clock of the stamps [s].
        patience: Factor on the wall-clock budgets, which makes results independent of the load of the machine [1].

    Raises:
        InvalidValue: If the latency is negative, the patience is not positive, or either value is not finite.
    """

    def __init__(self, latency: float = 0.02, patience: float = 5.0) -> None:
        if not finite_number(latency, "planning.latency") >= 0.0:
            raise InvalidValue(f"planning.latency: must be >= 0 s, got {latency}")
        if not finite_number(patience, "planning.patience") > 0.0:
            raise InvalidValue(f"planning.patience: must be > 0, got {patience}")
        self._latency, self._patience = latency, patience
        self._ready: tuple[float, PlanResult] | None = None

    def submit(self, job: Job) -> None:
        """Run the job."""
        self._ready = job.stamp + self._latency, planned(job._replace(budget=self._patience * job.budget))

    def poll(self, stamp: float) -> PlanResult | None:
        """Return the result once the latency has passed."""
        if self._ready is None or stamp < self._ready[0] - _INSTANT:
            return None
        result, self._ready = self._ready[1], None
        return result


class ThreadPlanning(Planning):
    """Planning in a background thread.

    A running job is not interrupted; its duration is limited by its budget, and the next job begins when it has ended.

    Args:
        plan: Function that runs a job; `PlanningProcess.planned` runs it in a separate process.
    """

    def __init__(self, plan: Callable[[Job], PlanResult] = planned) -> None:
        self._plan = plan
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="optdock-planning")
        self._result: Future[PlanResult] | None = None

    def submit(self, job: Job) -> None:
        """Queue the job and drop any waiting job."""
        if self._result is not None:
            self._result.cancel()
        self._result = self._thread.submit(self._plan, job)

    def poll(self, stamp: float) -> PlanResult | None:  # noqa: ARG002 - part of the interface
        """Return the result once it is available."""
        if self._result is None or not self._result.done():
            return None
        future, self._result = self._result, None
        return future.result()

    def close(self) -> None:
        """Drop waiting jobs; the thread ends after the running job, without blocking the caller."""
        self._thread.shutdown(wait=False, cancel_futures=True)


class MotionStart(NamedTuple):
    """Start of a planned motion, as the fields of a `DockingProblem`."""

    start: Pose2
    start_speed: float
    start_acceleration: float
    start_curvature: float | None


class Planned(NamedTuple):
    """A recorded result of planning.

    Attributes:
        result: Result of a job, without its motion; None for a recorded verdict.
        trajectory: Trajectory of the motion; None without a motion.
        start: Start of the motion's problem.
        start_relief: Start relief of the motion.
        verdict: Recorded result of `still_holds`; None for a job.
    """

    result: PlanResult | None = None
    trajectory: Trajectory | None = None
    start: MotionStart | None = None
    start_relief: float = 0.0
    verdict: Verdict | None = None


class RecordedPlanning(Planning):
    """Planning from a log: each result is delivered, without a certificate, in the cycle of its recording."""

    def __init__(self) -> None:
        self._results: deque[Planned] = deque()
        self._verdicts: deque[Verdict] = deque()
        self._job: Job | None = None

    def deliver(self, recorded: Iterable[Planned]) -> None:
        """Set the results of the next cycle."""
        self._results.clear()
        self._verdicts.clear()
        for one in recorded:
            if one.verdict is not None:
                self._verdicts.append(one.verdict)
            else:
                self._results.append(one)

    def submit(self, job: Job) -> None:
        """Store the job, whose problem completes the recorded motion."""
        self._job = job

    def poll(self, stamp: float) -> PlanResult | None:  # noqa: ARG002 - part of the interface
        """Return the result recorded in this cycle."""
        if not self._results:
            return None
        found = self._results.popleft()
        assert found.result is not None
        if found.trajectory is None or self._job is None:
            return found.result
        assert found.start is not None
        problem = dataclasses.replace(self._job.problem, **found.start._asdict())
        return found.result._replace(motion=DrivenMotion(found.trajectory, problem, None, found.start_relief))

    def still_holds(self, motion: DrivenMotion, costmap: Costmap, from_time: float) -> Verdict:  # noqa: ARG002 - interface
        """Return the verdict recorded in this cycle.

        Raises:
            InvalidValue: If no verdict was recorded in this cycle, because the replay differs from the recorded task.
        """
        if not self._verdicts:
            raise InvalidValue("replay: the log contains no verdict for this cycle")
        return self._verdicts.popleft()


class PlanRequests:
    """Numbered jobs of a task; results of outdated jobs are dropped.

    Attributes:
        pending: Whether a result is expected.
    """

    def __init__(self, planning: Planning, report: Callable[[str, str], None]) -> None:
        self._planning, self._report = planning, report
        self._number = 0
        self.pending = False

    def submit(self, job: Job) -> int:
        """Submit a job and return its number; the result of the previous job is dropped."""
        self._number += 1
        self.pending = True
        self._planning.submit(job._replace(number=self._number))
        return self._number

    def forget(self) -> None:
        """Drop the result of the pending job."""
        self.pending = False

    def result(self, now: float) -> PlanResult | None:
        """Return the result of the last job once, when it is available at the time `now` [s]; None otherwise.

        Raises:
            TaskFailed: If a new motion is not certified; recorded motions are exempt, because no robot executes them.
        """
        result = self._planning.poll(now)
        if result is None or not self.pending or result.number != self._number:
            return None
        self.pending = False
        unproven = result.motion is not None and result.motion.plan is None
        if result.outcome is Outcome.NEW and unproven and not isinstance(self._planning, RecordedPlanning):
            raise TaskFailed(EndingKind.UNKNOWN, "planning returned a motion that is not certified")
        detail = result.reason
        if result.motion is not None:
            trajectory = result.motion.trajectory
            detail = f"{trajectory.path.driven:.3f} m in {trajectory.duration:.2f} s"
        self._report(f"plan {result.outcome.value}", detail)
        return result

    def still_holds(self, motion: DrivenMotion, costmap: Costmap, time: float) -> Verdict:
        """Return the verdict on a motion; see `Planning.still_holds`."""
        return self._planning.still_holds(motion, costmap, time)
