"""Docking and undocking procedure: attempts with their plans and drives; each `yield` is one control cycle.

An exception signals the early end of a motion, an attempt or the task, and is caught by the function that can respond.
Every wait and every motion has a timeout.
"""

from __future__ import annotations

import dataclasses
import logging
from typing import TYPE_CHECKING

from optdock.errors import PlannerTimedOut, SmootherTimedOut, TimingTimedOut
from optdock.executor.control_cycles import STOP, ControlCycles, Situation
from optdock.executor.dock_contact import (
    Nudge,
    back_out,
    confirm,
    has_arrived,
    perceive,
    press,
    stands_docked,
    wait_for_detection,
)
from optdock.executor.planning import Job, Outcome, PlanRequests, PlanResult
from optdock.executor.task_states import (
    HELD,
    NOT_DOCKED,
    SHORTER_WAY,
    TOO_FAR_OFF,
    AttemptFailed,
    CancelRequested,
    EndingKind,
    Interrupted,
    NoWay,
    State,
    TaskFailed,
)
from optdock.executor.trajectory_drive import TrajectoryDrive

if TYPE_CHECKING:
    from collections.abc import Callable, Generator

    from optdock.executor.checked_inputs import CheckedDockType
    from optdock.executor.control_cycles import Cycles, Target
    from optdock.executor.executor_settings import ExecutorSettings
    from optdock.executor.perception import Perception
    from optdock.executor.planning import DrivenMotion, Planning
    from optdock.geometry.pose import Pose2
    from optdock.model.problem import DockingProblem
    from optdock.plugins.interfaces import Controller, GoalChecker

__all__ = ["Procedure", "Travel"]

logger = logging.getLogger(__name__)

# On a busy computer a plan takes a multiple of its usual time.
_OUT_OF_TIME = frozenset(kind.code for kind in (PlannerTimedOut, SmootherTimedOut, TimingTimedOut))
_LARGEST_FACTOR = 8.0
# [m] beyond the distance over which no rotation is allowed, for errors of the estimate and of the braking distance.
_UNDOCKING_MARGIN = 0.03
_PLANNING_PATIENCE = 5.0  # [s] beyond the budget: a planning thread may share its core
_MOST_BLOCKS = 5  # stops in one approach or drive after which it counts as failed


class Procedure:
    """One docking or undocking task.

    Attributes:
        cycles: Situation, state and cancellation of the task.
        num_retries: Number of approaches after the first approach.
    """

    def __init__(  # noqa: PLR0913, PLR0917 - the parts of an executor
        self,
        problem: DockingProblem,
        settings: ExecutorSettings,
        perception: Perception,
        controller: Controller,
        goal_checker: GoalChecker,
        dock_type: CheckedDockType,
        planning: Planning,
        report: Callable[[str, str], None],
    ) -> None:
        self._situation = Situation(problem, settings, perception, dock_type, report)
        self.cycles = ControlCycles(self._situation, report)
        self._travel = Travel(self.cycles, controller, goal_checker, planning)
        self._nudge = Nudge(self.cycles)
        self.num_retries = 0

    def run(self, *, undock: bool) -> Generator[Target, None, tuple[EndingKind, str]]:
        """Run the task; return the kind of ending and its reason, with the robot at rest."""
        cycles = self.cycles
        cycles.began = cycles.now
        try:
            self._situation.dock_type.reset()
            self._situation.feel()
            kind, reason = yield from self._undock() if undock else self._dock()
        except CancelRequested:
            kind, reason = EndingKind.CANCELLED, f"while {cycles.state.value}"
        except TaskFailed as failure:
            kind, reason = failure.kind, failure.reason
        except Exception as error:  # any exception of a plugin must end the task with the robot at rest
            logger.exception("the task ends")
            kind, reason = EndingKind.UNKNOWN, f"{type(error).__name__}: {error}"
        cycles.is_ending = True
        yield from cycles.stop()
        return kind, reason

    def _dock(self) -> Generator[Target, None, tuple[EndingKind, str]]:
        situation, settings, staging = self._situation, self._situation.settings, self._situation.staging
        yield from self.cycles.stop()
        yield from self.cycles.locate()
        if situation.has_signal and situation.estimate.is_near:
            return EndingKind.ALREADY_DOCKED, "by external signal"
        if (yield from stands_docked(self.cycles)):
            return EndingKind.ALREADY_DOCKED, situation.estimate.where
        if settings.navigate_to_staging_pose and staging.distance_to_nearest() > settings.prestaging_tolerance:
            yield from self._travel.drive_to(staging.poses, State.STAGING, EndingKind.FAILED_TO_STAGE)
        while True:
            try:
                yield from self._perceive_from_somewhere()
                kind = yield from self._approach()
                if situation.dock_type.waits_for_charge:
                    yield from self._wait_for_charge()
                return kind, ""
            except AttemptFailed as over:
                failure = over
            yield from self._prepare_retry(failure)

    def _prepare_retry(self, failure: AttemptFailed) -> Cycles:
        """Return to a staging pose for another attempt; after the last one, raise its failure there."""
        most = self._situation.settings.max_retries
        if most == 0:
            raise failure
        self.cycles.report("attempt failed", f"{failure.kind.value}: {failure.reason}")
        yield from self.cycles.stop()
        if self.num_retries == most:
            yield from self._leave()
            raise failure
        self.num_retries += 1
        yield from back_out(self.cycles)
        yield from self._return(is_blocked=isinstance(failure, NoWay))

    def _undock(self) -> Generator[Target, None, tuple[EndingKind, str]]:
        situation = self._situation
        yield from self.cycles.stop()
        yield from self.cycles.locate()
        if not situation.estimate.is_near and not situation.has_signal:
            return EndingKind.NOT_DOCKED, f"the robot is {situation.estimate.distance:.3f} m from the dock"
        straight = max(situation.dock_type.back_out_distance, situation.problem.dock.final_straight)
        yield from back_out(self.cycles, straight + _UNDOCKING_MARGIN)
        yield from self._travel.drive_to(situation.staging.poses, State.UNDOCKING, EndingKind.FAILED_TO_STAGE)
        return EndingKind.UNDOCKED, ""

    def _perceive_from_somewhere(self) -> Cycles:
        """Detect the dock from the present pose or a staging pose, for docking in reverse also from a reversed pose.

        A front camera cannot detect a dock that the robot enters in reverse. The dock is then detected from the
        reversed pose, and the robot drives into it by odometry.
        """
        situation, staging = self._situation, self._situation.staging
        views = [staging.poses, *([staging.turned_round] if situation.estimate.gear < 0.0 else [])]
        while True:
            views = [places for places in views if staging.may_see_dock_from(places())]
            may_see = staging.may_see_dock_from((situation.perception.robot,))
            try:
                if may_see or situation.estimate.is_found or not views:
                    return (yield from perceive(self.cycles))
            except TaskFailed as failure:
                while views and staging.has_arrived_at(views[0]()):
                    views.pop(0)
                if not views:
                    raise
                self.cycles.report("dock not seen from here", failure.reason)
            yield from self._travel.drive_to(views.pop(0), State.STAGING, EndingKind.FAILED_TO_STAGE)

    def _approach(self) -> Generator[Target, None, EndingKind]:
        """Plan from rest and drive; plan again after interruptions, and raise AttemptFailed after too many."""
        cycles, patience = self.cycles, self._situation.settings.obstacle_patience
        blocks, blocked_since = 0, cycles.now
        self._situation.dock_type.reset()
        while True:
            result = yield from self._planned_from_rest(blocked_since)
            if result.motion is None:
                continue
            try:
                return (yield from self._attempt(result.motion))
            except Interrupted as stopped:
                yield from cycles.stop_after(stopped)
                is_moved = stopped.name != HELD and (yield from self._nudge.run())
                if (stopped.name != NOT_DOCKED or is_moved) and (yield from has_arrived(cycles)):
                    return EndingKind.DOCKED_BY_DISTANCE
                if blocks == 0 or cycles.now - blocked_since > 2.0 * patience:
                    blocked_since = cycles.now
                blocks += stopped.name not in {HELD, SHORTER_WAY}
                if blocks > _MOST_BLOCKS:
                    reason = f"stopped {blocks} times on one approach, last: {stopped.name}: {stopped.reason}"
                    raise AttemptFailed(EndingKind.FAILED_TO_CONTROL, reason) from None
                if stopped.name in {TOO_FAR_OFF, NOT_DOCKED}:
                    yield from back_out(cycles)  # the robot may touch the station
                yield from wait_for_detection(cycles)

    def _planned_from_rest(self, since: float) -> Generator[Target, None, PlanResult]:
        """Plan into the dock.

        If no path is found, wait for the obstacle to move; raise NoWay if `obstacle_patience` has passed since `since`
        [s] without a path.
        """
        yield from self.cycles.locate()
        result = yield from self._travel.planned(self._situation.scene.to_dock())
        if result.motion is None:
            if self._situation.estimate.is_near:
                yield from back_out(self.cycles)  # no path begins in contact with the station
            yield from self._travel.wait_for_obstacle(result, since)
        return result

    def _attempt(self, motion: DrivenMotion) -> Generator[Target, None, EndingKind]:
        """Drive into the dock; raise Interrupted if the robot is not docked, or AttemptFailed if this is uncertain."""
        situation = self._situation
        docked = yield from self._travel.drive(motion, State.APPROACHING)
        if docked is None and situation.dock_type.is_pressed_on:
            return (yield from press(self.cycles))
        yield from self.cycles.stop()
        if docked is EndingKind.DOCKED_BY_SIGNAL and not situation.has_signal:
            # The feedback was moving the robot back when the signal was received.
            self.cycles.report("contact lost again", situation.estimate.where)
            docked = yield from press(self.cycles)
        if not situation.dock_type.is_pressed_on:
            yield from confirm(self.cycles)
            if (yield from self._nudge.run()):
                yield from confirm(self.cycles)
        return docked or EndingKind.DOCKED_BY_DISTANCE

    def _return(self, *, is_blocked: bool) -> Cycles:
        """Drive to a staging pose; after a blocked approach, only to a staging pose with a path into the dock."""
        places = self._situation.staging.poses
        if is_blocked:
            found = yield from self._travel.staging_pose_on_a_path()
            if found is None:
                self.cycles.report("no way from a staging pose", "the next attempt begins here")
                return
            yield from self._travel.drive_to(lambda: (found,), State.RETURNING, EndingKind.FAILED_TO_CONTROL)
        else:
            yield from self._travel.drive_to(places, State.RETURNING, EndingKind.FAILED_TO_CONTROL)

    def _leave(self) -> Cycles:
        """Drive a robot that is nearer to the dock than its staging poses to one of them; report why if it cannot."""
        if not self._situation.staging.is_passed:
            return
        try:
            yield from back_out(self.cycles)
            yield from self._return(is_blocked=False)
        except TaskFailed as failure:
            self.cycles.report("not returned to a staging pose", failure.reason)

    def _wait_for_charge(self) -> Cycles:
        """Wait at rest until the battery is charging; raise AttemptFailed after the timeout."""
        cycles, situation = self.cycles, self._situation
        cycles.state, since = State.WAITING_FOR_CHARGE, cycles.now
        while not situation.is_charging:
            waited = cycles.now - since
            if waited > situation.settings.wait_charge_timeout:
                reason = f"no signal for {waited:.1f} s: {situation.estimate.where}"
                raise AttemptFailed(EndingKind.FAILED_TO_CHARGE, reason)
            yield from cycles.cycle(STOP)


class Travel:
    """Functions of a task that plan from rest and drive motions."""

    def __init__(
        self, cycles: ControlCycles, controller: Controller, goal_checker: GoalChecker, planning: Planning
    ) -> None:
        self._cycles, self._situation = cycles, cycles.situation
        self._controller, self._goal_checker = controller, goal_checker
        self._requests = PlanRequests(planning, cycles.report)
        self._budget_factor = 1.0

    def planned(self, problem: DockingProblem) -> Generator[Target, None, PlanResult]:
        """Plan from rest and return the result; after plans that ran out of time with up to 8 times the budget."""
        cycles = self._cycles
        cycles.state = State.PLANNING
        since, budget = cycles.now, self._budget_factor * self._situation.settings.time_budget
        number, result = self._requests.submit(Job(0, since, problem, budget)), None
        while result is None:
            yield from cycles.cycle(STOP)
            result = self._requests.result(cycles.now)
            if result is None and cycles.now - since > budget + _PLANNING_PATIENCE:
                result = PlanResult(
                    number, Outcome.FAILED, reason="planning does not respond", code=PlannerTimedOut.code
                )
        if result.code in _OUT_OF_TIME:
            self._budget_factor = min(2.0 * self._budget_factor, _LARGEST_FACTOR)
        elif result.motion is not None:
            self._budget_factor = 1.0
        return result

    def planned_to(self, places: tuple[Pose2, ...]) -> Generator[Target, None, PlanResult]:
        """Plan to the poses in order; return the result for the first reachable pose, or for the last pose."""
        *others, last = places
        for number, place in enumerate(others, start=1):
            result = yield from self.planned(self._situation.scene.to(place))
            if result.motion is not None:
                return result
            self._cycles.report("no way to a staging pose", f"number {number} of {len(others) + 1}: {result.reason}")
        return (yield from self.planned(self._situation.scene.to(last)))

    def staging_pose_on_a_path(self) -> Generator[Target, None, Pose2 | None]:
        """Return the first reachable staging pose with a path into the dock; None if there is none."""
        scene = self._situation.scene
        for place in self._situation.staging.poses():
            if (yield from self.planned(scene.to(place))).motion is None:
                continue
            into_dock = dataclasses.replace(scene.to_dock(), start=place)
            if (yield from self.planned(into_dock)).motion is not None:
                return place
        return None

    def wait_for_obstacle(self, result: PlanResult, since: float) -> Cycles:
        """Wait at most a second for a new costmap after a failed plan.

        Raises:
            NoWay: If `obstacle_patience` has passed since `since` [s] without a path.
        """
        cycles, perception = self._cycles, self._situation.perception
        patience = self._situation.settings.obstacle_patience
        if cycles.now - since >= patience:
            raise NoWay(EndingKind.FAILED_TO_CONTROL, f"no way to the dock: {result.reason}")
        cycles.state = State.WAITING_FOR_OBSTACLE
        seen, until = perception.costmap, min(cycles.now + 1.0, since + patience)
        cycles.report("no way", result.reason)
        while cycles.now < until and perception.costmap is seen:
            yield from cycles.cycle(STOP)

    def drive(self, motion: DrivenMotion, state: State) -> Generator[Target, None, EndingKind | None]:
        """Drive a motion to its end.

        Returns:
            The kind of docking; None if the robot is not known to be docked.

        Raises:
            Interrupted: If the motion cannot continue.
            AttemptFailed: If an approach cannot succeed.
            TaskFailed: If a drive other than an approach takes too long.
        """
        cycles = self._cycles
        cycles.state = state
        drive = TrajectoryDrive(
            motion,
            state,
            situation=self._situation,
            controller=self._controller,
            goal_checker=self._goal_checker,
            requests=self._requests,
            report=cycles.report,
        )
        try:
            while not drive.is_over():
                cycles.deviation = drive.deviation
                yield from cycles.cycle(drive.command())
        finally:
            drive.end()
        return drive.docked

    def drive_to(self, places: Callable[[], tuple[Pose2, ...]], state: State, failure: EndingKind) -> Cycles:
        """Drive to the first reachable pose; plan again after interruptions.

        Args:
            places: Function that returns poses in the fixed frame, the preferred one first, for the present estimate of
                the dock.
            state: Task state of the drive.
            failure: Kind of ending if the robot does not arrive.

        Raises:
            TaskFailed: Of the kind `failure`, if the robot does not arrive.
        """
        cycles, situation = self._cycles, self._situation
        blocks, since = 0, cycles.now
        while True:
            yield from cycles.locate()
            if situation.staging.has_arrived_at(places(), is_undocking=state is State.UNDOCKING):
                return
            result = yield from self.planned_to(places())
            if result.motion is None:
                if cycles.now - since > situation.settings.obstacle_patience:
                    raise TaskFailed(failure, f"no way to the staging pose: {result.reason}")
                try:
                    yield from self.wait_for_obstacle(result, since)
                except AttemptFailed as over:
                    raise TaskFailed(failure, over.reason) from None
                continue
            try:
                yield from self.drive(result.motion, state)
                yield from cycles.stop()
                situation.staging.require_arrival(places(), is_undocking=state is State.UNDOCKING)
                return
            except Interrupted as stopped:
                yield from cycles.stop_after(stopped)
                blocks += stopped.name not in {HELD, SHORTER_WAY}
                since = cycles.now
                if blocks > _MOST_BLOCKS:
                    raise TaskFailed(failure, f"{stopped.name}: {stopped.reason}") from None
