"""`replan`: a new plan for a moving robot, which takes over from the running plan without a jump.

A new plan begins at the *joint*: the state on the running trajectory that the robot will have when planning is finished
and the drive responds. The joint is the start of an ordinary docking problem, whose rules for a moving start guarantee
continuity. The following methods are tried in order until a plan is certified:

1. The rest of the running path, deformed onto the new goal (`deformation`), in about a millisecond.
2. The old plan, if its remaining path is certified in the new world and ends at the new dock within the dock's
   tolerances.
3. In the last gear, close to the dock: the robot backs up and approaches again (`backing_up`).
   Before the last gear: the smoother from the joint, with the rest of the running path as warm start, unless the
   deformation failed at an obstacle.
4. `plan_dock` from the joint. After its first certified plan it continues only while another plan may be much cheaper.

Methods 3 and 4 are omitted if it is proven that the robot cannot stop before it comes too close to an obstacle
(`inevitable_collision`). If nothing is certified in time, the robot brakes along its path. The motion up to the joint
can no longer be changed, so it is certified first. If this proof fails, the robot brakes immediately.
"""

from __future__ import annotations

import dataclasses
import functools
import logging
import math
from dataclasses import dataclass, field
from enum import Enum
from typing import TYPE_CHECKING

import numpy as np

from optdock.deadline import Deadline, garbage_collection_paused
from optdock.errors import (
    Cancelled,
    FailedToSmoothPath,
    FailedToTimePath,
    InvalidValue,
    LifecycleError,
    OptdockError,
    PluginError,
    SmootherTimedOut,
)
from optdock.geometry.checked import exactly, finite_number, instance, number
from optdock.geometry.pose import Pose2
from optdock.model.constant_jerk import TimeLaw
from optdock.model.limits import SpeedZone
from optdock.model.path import Path
from optdock.model.problem import DockingProblem
from optdock.model.trajectory import Trajectory
from optdock.planning.backing_up import backed_up
from optdock.planning.changed_world import StillHolds, still_holds
from optdock.planning.deformation import Push, pushes_off
from optdock.planning.inevitable_collision import inevitable_collision
from optdock.planning.pipeline import DEFAULT_PLANNERS, DEFAULT_SMOOTHER, DEFAULT_TIMING, Plugins, plan_dock
from optdock.planning.plan import Attempt, DockPlan, PartialPlan
from optdock.planning.refinement import Cancellation, Refinement, ran_out_of_time, sampled_bounds
from optdock.planning.running_drive import NO_WAY, BranchPoint, DriveState, RunningDrive, braking
from optdock.plugins.interfaces import never_cancelled
from optdock.samples.tube import Tube
from optdock.verification import (
    ProvenWay,
    WayVerdict,
    certify_motion,
    certify_trajectory,
    end_clearances,
    prove_way,
    proven_way,
)
from optdock.verification.conservative_advancement import Begun
from optdock.verification.path_rules import path_violations
from optdock.verification.visibility import prove_view

if TYPE_CHECKING:
    from collections.abc import Callable

    from optdock.planning.pipeline import PlannerLike, SmootherLike, TimingLike
    from optdock.verification import TrajectoryCertificate

__all__ = [
    "DEFAULT_REPLANNING_BUDGET",
    "DriveState",
    "ReplanOutcome",
    "Replanned",
    "StillHolds",
    "replan",
    "still_holds",
]

logger = logging.getLogger(__name__)

DEFAULT_REPLANNING_BUDGET = 0.02  # [s]: one period of a controller at 50 Hz
_FALLBACK_SHARE, _FALLBACK_MOST = 0.35, 0.007  # of the budget, [s]: reserved for the proofs of the old plan or a stop
_ON_THE_STRAIGHT = "the robot is on the final straight, which is not deformed"
_AT_THE_END = "the robot is at the end of the plan"
_NOT_DEFORMED = "the path cannot be deformed within the curvature limits"
# After the first certified plan from the joint, only plans that may be cheaper by this share are searched for. In 192
# changed worlds the durations were the same as with 0.03, and calls with a whole search took about half the CPU time.
_LEAST_GAIN = 0.2
_PUSHES = 4  # most pushes off obstacles, two milliseconds each
# Attributes of a dock that constrain a path, in addition to its pose and its station.
_DOCK_RULES = ("approach", "direction", "final_straight", "marker", "visible_distance", "blind_distance")
_NEARBY = 0.5  # [m]: distance from its reference along the path in which a robot off its path is projected


class ReplanOutcome(str, Enum):
    """Decision of `replan` for a moving robot."""

    NEW = "new"  # drive the new plan after the joint
    KEPT = "kept"  # continue with the old plan
    STOP = "stop"  # brake along the old path


@dataclass(frozen=True, eq=False, repr=False)
class Replanned:
    """Result of `replan`; its truth value is `proven`.

    Args:
        outcome: The decision.
        trajectory: Trajectory that starts, at its time 0, when the clock of the running trajectory reaches `starts_at`.
        starts_at: Time [s] on the clock of the running trajectory at which `trajectory` takes over; 0 for KEPT.
        plan: The plan of that trajectory; None for STOP.
        reason: Reason for the absence of a new plan; empty for NEW.
        way: Proof of clearance in the new world, from the current pose of the robot to the takeover (NEW) or to the end
            of the motion (KEPT, STOP); None if clearance could not be proven. For KEPT the station is assumed to be at
            the end of the plan, which is within the dock's tolerances.
        motion: The certificate of the motion of a stop; None for NEW and KEPT, whose plan contains this certificate.
        tried: Every attempt and its result.
        timing_ms: Wall-clock milliseconds per stage.

    Raises:
        InvalidValue: If an argument has the wrong class, the trajectory does not belong to the plan, or a stop has a
            plan.
    """

    outcome: ReplanOutcome
    trajectory: Trajectory
    starts_at: float
    plan: DockPlan | None
    reason: str = ""
    way: ProvenWay | None = None
    motion: TrajectoryCertificate | None = None
    tried: tuple[Attempt, ...] = ()
    timing_ms: dict[str, float] = field(default_factory=dict)

    def __bool__(self) -> bool:
        return self.proven

    def __post_init__(self) -> None:
        exactly(ReplanOutcome, self.outcome, "replanned.outcome")
        exactly(Trajectory, self.trajectory, "replanned.trajectory")
        if self.way is not None:
            exactly(ProvenWay, self.way, "replanned.way")
        if (self.plan is None) != (self.outcome is ReplanOutcome.STOP):
            raise InvalidValue("replanned.plan: must be None for a stop, and a plan otherwise")
        if self.plan is not None and self.trajectory is not exactly(DockPlan, self.plan, "replanned.plan").trajectory:
            raise InvalidValue("replanned.trajectory: must be that of its plan")

    @property
    def proven(self) -> bool:
        """Whether clearance and limits are proven from the current pose until the motion ends.

        The result is False only for a stop, which is then the fastest possible stop. Any caller can construct a
        certificate, so a stop is certified again here.
        """
        if self.way is None or self.plan is not None:
            return self.way is not None
        if self.motion is None or not self.motion.certified:
            return False
        limits = self.way.problem.robot.limits
        return certify_trajectory(self.trajectory, limits, SpeedZone()).certified

    def __repr__(self) -> str:
        why = f": {self.reason}" if self.reason else ""
        unproven = "" if self.proven else ", not proven"
        return f"<Replanned {self.outcome.value}{unproven}, from {self.starts_at:.3f} s{why}>"


def replan(  # noqa: PLR0913 - every choice is a keyword
    plan: DockPlan,
    target: DockingProblem | Pose2,
    state: DriveState,
    time_budget: float = DEFAULT_REPLANNING_BUDGET,
    *,
    drive_delay: float = 0.0,
    lead: float | None = None,
    planner: PlannerLike | tuple[PlannerLike, ...] = DEFAULT_PLANNERS,
    smoother: SmootherLike = DEFAULT_SMOOTHER,
    timing: TimingLike = DEFAULT_TIMING,
    cancel_checker: Callable[[], bool] = never_cancelled,
) -> Replanned:
    """Decide how a robot that executes `plan` continues after its dock or the world has changed.

    Args:
        plan: The running plan.
        target: New pose of the docked robot, with which the station moves; or a whole problem, whose start is not used.
        state: Progress of the robot.
        time_budget: Wall-clock seconds for the whole call.
        drive_delay: Response time of the drive [s].
        lead: Time from `state` to the joint [s]. None means `time_budget + drive_delay`, the latest time at which the
            result is available. Smaller values are for simulations, whose clock stops during the call.
        planner: As in `plan_dock`.
        smoother: As in `plan_dock`.
        timing: As in `plan_dock`.
        cancel_checker: Polled as in `plan_dock`. Cancelling does not raise an error; the outcome is KEPT or STOP, as
            after a time-out.

    Raises:
        InvalidValue: If a value has the wrong class or is not finite, or the target is not in the frame of the plan.
        PluginError: As `plan_dock`.
        LifecycleError: As `plan_dock`.
    """
    exactly(DockPlan, plan, "plan")
    time_budget, drive_delay = number(time_budget, "time_budget"), finite_number(drive_delay, "drive_delay")
    if not (math.isfinite(time_budget) and time_budget > 0.0):
        raise InvalidValue(f"time_budget: must be finite and > 0 s, got {time_budget}")
    if not drive_delay >= 0.0:
        raise InvalidValue(f"drive_delay: must be >= 0 s, got {drive_delay}")
    lead = time_budget + drive_delay if lead is None else finite_number(lead, "lead")
    if not lead >= 0.0:
        raise InvalidValue(f"lead: must be >= 0 s, got {lead}")
    state = _checked(state)
    world = _world(plan, target)
    plugins = Plugins.ready(planner, smoother, timing)
    deadline, drive = Deadline(time_budget), RunningDrive(plan, world, state)
    run = _Replanning(drive, time_budget, lead, Cancellation(cancel_checker), deadline, plugins)
    with garbage_collection_paused():
        found = run.answer(min(drive_delay, lead))
    logger.info("%r after %.1f ms", found, 1e3 * run.deadline.elapsed)
    return found


def _checked(state: DriveState) -> DriveState:
    instance(DriveState, state, "state")
    time, rate = finite_number(state.time, "state.time"), finite_number(state.rate, "state.rate")
    if not rate >= 0.0:
        raise InvalidValue(f"state.rate: must be >= 0, got {rate}")
    for name, pose in (("pose", state.pose), ("moved", state.moved)):
        if pose is not None:
            exactly(Pose2, pose, f"state.{name}")
    instance(bool, state.is_filtered, "state.is_filtered")
    return DriveState(time, rate, state.pose, state.moved, state.is_filtered)


def _world(plan: DockPlan, target: DockingProblem | Pose2) -> DockingProblem:
    """Return the new problem; its start is not used."""
    if isinstance(target, Pose2):
        return dataclasses.replace(plan.problem, dock=dataclasses.replace(plan.problem.dock, pose=target))
    instance(DockingProblem, target, "target")
    if target.frame != plan.frame:
        raise InvalidValue(f"target: is in frame {target.frame!r}, the plan in {plan.frame!r}; transform it first")
    return target


@dataclass(eq=False)
class _Replanning:
    """State and steps of one call of `replan`."""

    drive: RunningDrive
    budget: float
    lead: float
    cancelled: Cancellation
    deadline: Deadline
    plugins: Plugins
    timing_ms: dict[str, float] = field(default_factory=dict)
    tried: list[Attempt] = field(default_factory=list)
    failure: OptdockError | None = None
    is_blocked: bool = False  # whether a deformed path could not be pushed off an obstacle

    def answer(self, delay: float) -> Replanned:
        """Return the decision: new, kept or stop."""
        joint = self.drive.branch_point(self.lead, at_a_rest=True)
        is_moved = self.drive.is_on_the_path or self.drive.ahead is not self.drive.path
        if not is_moved and not self.drive.is_in_tube(joint.pose):
            self.drive.move_ahead()
            joint = self.drive.branch_point(self.lead, at_a_rest=True)
        try:
            return self._decided(joint, delay)
        except (PluginError, LifecycleError, InvalidValue):
            raise
        except Cancelled as error:
            why = f"{type(error).__name__}: {error}"
            return self._kept(why) or self._stop(delay, why)
        except OptdockError as error:
            return self._stop(delay, f"{type(error).__name__}: {error}")

    def _decided(self, joint: BranchPoint, delay: float) -> Replanned:
        """Prove the way to the joint and plan from there; on the final straight the old plan is tried before."""
        why, kept = _AT_THE_END if joint.is_at_the_end else _ON_THE_STRAIGHT, None
        is_deformed = joint.has_more_than(self.drive.world.dock.final_straight)
        if not is_deformed:
            kept = self._kept(why)
        if kept is not None:
            return kept
        until = self.drive.way_until(joint)
        if until is not None and until.way is None:
            blocked = f"the path until the takeover of a new plan is not clear: {until.reason}"
            return (self._kept(blocked) if is_deformed else None) or self._stop(delay, blocked)
        return self._replanned(joint, None if until is None else until.way, is_deformed=is_deformed)

    def _replanned(self, joint: BranchPoint, until: ProvenWay | None, *, is_deformed: bool) -> Replanned:
        """Try the deformed path, then the old plan, then another approach, then a new plan in other gears, or raise."""
        reserve = min(_FALLBACK_SHARE * self.budget, _FALLBACK_MOST)
        deadline, problem = self.deadline.shortened(by=reserve), self.drive.problem_at(joint)
        if joint.rest is not None:
            limits = self.cancelled, self.budget, deadline, self.timing_ms
            work = Refinement(problem, self.plugins.smoother, self.plugins.timing, joint.rest, *limits)
            guess, plan = self._deformed(joint, joint.rest, work) if is_deformed else (joint.rest, None)
            if plan is not None:
                return self._new(joint, until, plan)
            kept = self._kept(str(self.failure or _NOT_DEFORMED)) if is_deformed else None
            if kept is not None:
                return kept
            plan = self._otherwise(joint, guess, work)
            if plan is not None:
                return self._new(joint, until, plan)
        left = deadline.left
        if left <= 0.0:
            late = ran_out_of_time("planning from the joint", self.budget)
            raise self.failure or SmootherTimedOut(late)
        plan = plan_dock(
            problem,
            time_budget=left,
            cancel_checker=self.cancelled,
            least_gain=_LEAST_GAIN,
            **self.plugins._asdict(),
        )
        if joint.rests and problem.start_curvature and int(plan.path.segments[0].direction) != joint.gear:
            raise FailedToSmoothPath(
                "the new path begins in the other gear, for which the steered wheels are not turned"
            )
        return self._new(joint, until, plan)

    def _new(self, joint: BranchPoint, until: ProvenWay | None, plan: DockPlan) -> Replanned:
        tried, timing = (*self.tried, *plan.tried), self._timing()
        plan = dataclasses.replace(plan, tried=tried, timing_ms=timing)
        way = until or proven_way(plan.motion, self.drive.state.pose)
        return Replanned(ReplanOutcome.NEW, plan.trajectory, joint.time, plan, way=way, tried=tried, timing_ms=timing)

    def _deformed(
        self, joint: BranchPoint, path: Path, work: Refinement, *, shortens: bool = False
    ) -> tuple[Path, DockPlan | None]:
        """Return a path from the joint, deformed, with its plan if it is certified."""
        problem, stage = work.problem, "backed up" if shortens else "deformed"
        steers, least = problem.start_curvature is not None, joint.braking_distance(problem.robot.limits)
        known, pushes = self.drive.plan.problem, list[Push]()
        if not shortens and (known.obstacles is not problem.obstacles or known.costmap is not problem.costmap):
            pushes = pushes_off(path, problem)
        guess, certificate = work.deformed(
            path, _PUSHES, steers=steers, speed=abs(joint.speed), least=least, pushes=pushes, shortens=shortens
        )
        if certificate is None or not certificate.certified:
            self.is_blocked = certificate is not None or bool(pushes)
            return guess, None
        return guess, self._attempt(stage, guess, functools.partial(work.proven, guess, guess))

    def _otherwise(self, joint: BranchPoint, guess: Path, work: Refinement) -> DockPlan | None:
        """Return a plan that backs up before the dock, or that of the smoothed guess, or None.

        The smoother is called only for several gears. In one gear, it refused all of 34 guesses whose deformation had
        failed. In several gears, it refused all of 17 that could not be pushed off an obstacle, and one of 11 others.

        Raises:
            FailedToSmoothPath: If every motion from the joint is proven to come too close to an obstacle.
        """
        inevitable = inevitable_collision(work.problem)
        if inevitable:
            raise FailedToSmoothPath(inevitable)
        if isinstance(self.failure, FailedToTimePath):  # a smoothed path could not be timed either
            return None
        if len(guess.segments) > 1:
            if self.is_blocked:
                return None
            return self._attempt("smoothed", guess, lambda so_far: work.refined(guess, so_far, math.inf, is_given=True))
        again = backed_up(joint, work.problem, joint.braking_distance(work.problem.robot.limits))
        return None if again is None else self._deformed(joint, again, work, shortens=True)[1]

    def _timing(self) -> dict[str, float]:
        return {**self.timing_ms, "total": 1e3 * self.deadline.elapsed}

    def _attempt(self, stage: str, guess: Path, make: Callable[[PartialPlan], DockPlan]) -> DockPlan | None:
        began = self.deadline.elapsed
        try:
            plan = make(PartialPlan())
        except (PluginError, LifecycleError):
            raise
        except OptdockError as error:
            self.failure = error
            reason = f"{type(error).__name__}: {error}"
            self.tried.append(Attempt(stage, guess, self.deadline.elapsed - began, reason=reason))
            if isinstance(error, Cancelled):
                raise
            return None
        self.tried.append(Attempt(stage, guess, self.deadline.elapsed - began, plan.price))
        return plan

    def _kept(self, why: str) -> Replanned | None:
        """Return the old plan if it is still valid with the station at its end, within the dock's tolerances.

        Its rest must also satisfy the smoother's own bounds at samples.
        """
        path, world = self.drive.path, self.drive.world
        if not world.dock.tolerances.accept(path.end, world.goal) or not self._keeps_limits():
            return None
        world = dataclasses.replace(world, start=path.start, dock=dataclasses.replace(world.dock, pose=path.end))
        if self.drive.is_on_the_path:
            rest = path.piece(min(self.drive.now.s, max(0.0, path.length - NO_WAY)))
            found = prove_way(rest, world)
        else:
            rest = path.piece(min(max(0.0, self.drive.now.s - _NEARBY), max(0.0, path.length - NO_WAY)))
            found = self._goes_back(path, world)
        if found.way is None or not self._keeps_own_bounds(rest, path.length - rest.length):
            return None
        tried, timing = tuple(self.tried), self._timing()
        running, plan = self.drive.plan.trajectory, self.drive.plan
        return Replanned(ReplanOutcome.KEPT, running, 0.0, plan, why, way=found.way, tried=tried, timing_ms=timing)

    def _keeps_own_bounds(self, rest: Path, begin: float) -> bool:
        """Whether the rest of the running path, from `begin` [m], satisfies the smoother's own bounds at samples."""
        before = self.drive.path.piece(0.0, begin).driven if begin > NO_WAY else 0.0
        found = sampled_bounds(self.plugins.smoother, rest, self.drive.world, self.cancelled, before)
        return all(bound.holds for bound in found)

    def _goes_back(self, path: Path, world: DockingProblem) -> WayVerdict:
        """Prove the clearance of the rest of the path, by the plan's clearance rule, for a robot off the path."""
        pose, relief = self.drive.state.pose, self.drive.plan.certificate.start_relief
        assert pose is not None
        now = min(self.drive.now.s, max(0.0, path.length - NO_WAY))
        # Legs of a cusp overlap: the time on the trajectory determines the leg.
        gear = int(np.searchsorted(path.segment_starts, now, side="right")) - 1
        first, last = path.segment_starts[gear : gear + 2].tolist()
        first, last = max(first, now - _NEARBY), min(last, now + _NEARBY)
        leg = Tube(path.piece(first, last), world, relief)
        nearest = first + float(leg.deviations(pose.as_array()[None]).s[0])
        begin = min(now, nearest)
        begun = Begun(path.start, end_clearances(self.drive.plan.problem).start)
        return prove_way(path.piece(begin), world, pose, at=nearest - begin, begun=begun, start_relief=relief)

    def _keeps_limits(self) -> bool:
        """Whether the running plan, driven at its present rate, satisfies the new problem's rules except clearance."""
        before, world, path, rate = self.drive.plan.problem, self.drive.world, self.drive.path, self.drive.state.rate
        if rate > 1.0:
            law = self.drive.plan.trajectory.time_law
            starts = law.start_s, rate * law.start_speed, rate * rate * law.start_acceleration
            faster = Trajectory(path, TimeLaw(law.durations / rate, law.jerks * rate**3, *starts))
            if not certify_trajectory(faster, world.robot.limits, world.dock.approach).certified:
                return False
        robots, docks = (before.robot, world.robot), (before.dock, world.dock)
        same = robots[0] is robots[1] or robots[0].fingerprint.limits == robots[1].fingerprint.limits
        rules = [[getattr(dock, name) for name in _DOCK_RULES] for dock in docks]
        if same and rules[0] == rules[1]:
            return True
        begun = world.starting_at(path.start, before.start_speed, before.start_curvature, before.start_acceleration)
        asked = dataclasses.replace(begun, dock=dataclasses.replace(world.dock, pose=path.end))
        holds = not path_violations(path, asked) and bool(prove_view(path, asked))
        return holds and certify_motion(self.drive.plan.trajectory, asked).certified

    def _stop(self, delay: float, why: str) -> Replanned:
        """Brake along the running path, from the joint if the way to the joint is proven, otherwise immediately."""
        found: list[Replanned] = []
        for lead in (self.lead, delay):
            joint = self.drive.branch_point(lead)
            trajectory, motion = braking(joint, self.drive.world.robot.limits, self.drive.plan.frame)
            now = self.drive.now
            before, driven = joint.s - now.s, trajectory.path.length
            way = trajectory.path
            if not now.is_at_the_end:
                way = now.path.piece(now.s, now.s + max(before + driven, NO_WAY))
            clear = prove_way(way, self.drive.world, self.drive.state.pose)
            reason = why if clear else f"{why}; the stop is not proven: {clear.reason}"
            if not motion.certified:
                reason += f"; the stop breaks a limit: {motion.reason}"
            stop = Replanned(
                ReplanOutcome.STOP,
                trajectory,
                joint.time,
                None,
                reason,
                clear.way,
                motion,
                tried=tuple(self.tried),
                timing_ms=self._timing(),
            )
            if stop.proven:
                return stop
            found.append(stop)
        return found[-1]
