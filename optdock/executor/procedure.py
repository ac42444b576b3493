"""How a robot docks and undocks, from top to bottom: each `yield` is one control cycle.

What ends an attempt or the whole task early is raised and caught where it can be answered (`interruptions`). Every wait
has a name and a limit, and so has every motion.
"""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING

from optdock.executor.contact_motions import back_out, press
from optdock.executor.control_cycles import STOP, ControlCycles
from optdock.executor.dock_checks import confirm, has_arrived, perceive, stands_docked, wait_for_detection
from optdock.executor.interruptions import (
    HELD,
    NOT_DOCKED,
    SHORTER_WAY,
    TOO_FAR_OFF,
    AttemptFailed,
    CancelRequested,
    Interrupted,
    NoWay,
    TaskFailed,
)
from optdock.executor.nudge import Nudge
from optdock.executor.situation import Situation
from optdock.executor.task_states import EndingKind, State
from optdock.executor.travel import MOST_BLOCKS, Travel

if TYPE_CHECKING:
    from collections.abc import Callable, Generator

    from optdock.executor.checked_dock_type import CheckedDockType
    from optdock.executor.control_cycles import Cycles, Wish
    from optdock.executor.executor_settings import ExecutorSettings
    from optdock.executor.perception import Perception
    from optdock.executor.planning import DrivenMotion, Planning, PlanResult
    from optdock.model.problem import DockingProblem
    from optdock.plugins.interfaces import Controller, GoalChecker

__all__ = ["Procedure"]

logger = logging.getLogger(__name__)

_SURELY_OUT = 0.03  # [m] more than the way in which nothing may turn: by what the estimate and the braking may be wrong


class Procedure:
    """One task.

    Args:
        problem: Robot, dock as stored, obstacles, clearance; its start plays no part.
        settings: How.
        perception: Brought up to date before every cycle.
        controller: Drives the motions.
        goal_checker: Says when the robot is docked.
        dock_type: Says where approaches begin, and what contact and charge are.
        planning: Makes them.
        report: Takes the name of an event and its detail.

    Attributes:
        cycles: Of the task: situation, state, cancellation.
        num_retries: Approaches after the first one.
    """

    def __init__(  # noqa: PLR0913, PLR0917 - the parts that an executor joins
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
        self.cycles = ControlCycles(Situation(problem, settings, perception, dock_type, report), report)
        self._travel = Travel(self.cycles, controller, goal_checker, planning)
        self._nudge = Nudge(self.cycles)
        self.num_retries = 0

    def run(self, *, undock: bool) -> Generator[Wish, None, tuple[EndingKind, str]]:
        """The task; its value is how it ended, the robot being at rest."""
        self.cycles.began = self.cycles.now
        try:
            self.cycles.situation.dock_type.reset()
            self.cycles.situation.feel()
            kind, reason = yield from self._undock() if undock else self._dock()
        except CancelRequested:
            kind, reason = EndingKind.CANCELLED, f"while {self.cycles.state.value}"
        except TaskFailed as failure:
            kind, reason = failure.kind, failure.reason
        except Exception as error:  # whatever a plugin raises, the robot must come to rest under a name
            logger.exception("the task ends")
            kind, reason = EndingKind.UNKNOWN, f"{type(error).__name__}: {error}"
        self.cycles.is_ending = True
        yield from self.cycles.stop()
        return kind, reason

    def _dock(self) -> Generator[Wish, None, tuple[EndingKind, str]]:
        situation, settings = self.cycles.situation, self.cycles.situation.settings
        yield from self.cycles.stop()
        yield from self.cycles.locate()
        if situation.has_signal and situation.estimate.is_near:
            return EndingKind.ALREADY_DOCKED, "the external signal says so"
        if (yield from stands_docked(self.cycles)):
            return EndingKind.ALREADY_DOCKED, situation.estimate.where
        if (
            settings.navigate_to_staging_pose
            and situation.staging.distance_to_nearest() > settings.prestaging_tolerance
        ):
            yield from self._travel.drive_to(situation.staging.poses, State.STAGING, EndingKind.FAILED_TO_STAGE)
        while True:
            try:
                yield from self._perceive_from_somewhere()
                kind = yield from self._approach()
                if self.cycles.situation.dock_type.waits_for_charge:
                    yield from self._wait_for_charge()
                return kind, ""
            except AttemptFailed as failure:
                if self.num_retries >= settings.max_retries:
                    raise
                self.cycles.report("attempt failed", f"{failure.kind.value}: {failure.reason}")
                yield from self.cycles.stop()
                self.num_retries += 1
                is_blocked = isinstance(failure, NoWay)
            yield from back_out(self.cycles)
            yield from self._return(is_blocked=is_blocked)

    def _undock(self) -> Generator[Wish, None, tuple[EndingKind, str]]:
        situation = self.cycles.situation
        yield from self.cycles.stop()
        yield from self.cycles.locate()
        if not situation.estimate.is_near and not situation.has_signal:
            return EndingKind.NOT_DOCKED, f"the robot is {situation.estimate.distance:.3f} m from the dock"
        straight = max(self.cycles.situation.dock_type.back_out_distance, situation.problem.dock.final_straight)
        yield from back_out(self.cycles, straight + _SURELY_OUT)
        yield from self._travel.drive_to(situation.staging.poses, State.UNDOCKING, EndingKind.FAILED_TO_STAGE)
        return EndingKind.UNDOCKED, ""

    def _perceive_from_somewhere(self) -> Cycles:
        """Look at the dock from here; where it is not seen, from a staging pose.

        A dock that is entered in reverse is behind a camera in front. So it is looked at from a staging pose turned
        round as well; from there the way in is the odometry's, as far as that is good enough.

        Raises:
            TaskFailed: It is not seen from anywhere, or the robot does not get there.
        """
        situation = self.cycles.situation
        views = [situation.staging.poses, *([situation.staging.turned_round] if situation.estimate.gear < 0.0 else [])]
        while True:
            views = [places for places in views if situation.staging.may_see_dock_from(places())]
            is_worth_it = situation.staging.may_see_dock_from((situation.perception.robot,))
            try:
                if is_worth_it or situation.estimate.is_found or not views:
                    return (yield from perceive(self.cycles))
            except TaskFailed as failure:
                while views and situation.staging.has_arrived_at(views[0]()):
                    views.pop(0)
                if not views:
                    raise
                self.cycles.report("dock not seen from here", failure.reason)
            yield from self._travel.drive_to(views.pop(0), State.STAGING, EndingKind.FAILED_TO_STAGE)

    def _approach(self) -> Generator[Wish, None, EndingKind]:
        """Plan from rest and drive; from wherever something stops the robot, plan again.

        Raises:
            AttemptFailed: It is stopped too often.
        """
        blocks, blocked_since = 0, self.cycles.now
        self.cycles.situation.dock_type.reset()
        while True:
            result = yield from self._planned_from_rest(blocked_since)
            if result.motion is None:
                continue
            try:
                return (yield from self._attempt(result.motion))
            except Interrupted as stopped:
                self.cycles.say_why(stopped)
                yield from self.cycles.stop()
                is_off = stopped.name in {TOO_FAR_OFF, NOT_DOCKED}
                is_moved = stopped.name != HELD and (yield from self._nudge.run())
                if (stopped.name != NOT_DOCKED or is_moved) and (yield from has_arrived(self.cycles)):
                    return EndingKind.DOCKED_BY_DISTANCE
                if (
                    blocks == 0
                    or self.cycles.now - blocked_since > 2.0 * self.cycles.situation.settings.obstacle_patience
                ):
                    blocked_since = self.cycles.now
                blocks += stopped.name not in {HELD, SHORTER_WAY}
                if blocks > MOST_BLOCKS:
                    reason = f"stopped {blocks} times on one approach, last: {stopped.name}: {stopped.reason}"
                    raise AttemptFailed(EndingKind.FAILED_TO_CONTROL, reason) from None
                if is_off:
                    yield from back_out(self.cycles)  # where the robot may touch the station
                yield from wait_for_detection(self.cycles)

    def _planned_from_rest(self, since: float) -> Generator[Wish, None, PlanResult]:
        """A plan into the dock; where there is none, after a wait for the obstacle in the way.

        Args:
            since: When there was a way last [s].

        Raises:
            NoWay: There has been none for too long.
        """
        yield from self.cycles.locate()
        result = yield from self._travel.planned(self.cycles.situation.scene.to_dock())
        if result.motion is None:
            if self.cycles.situation.estimate.is_near:
                yield from back_out(self.cycles)  # in contact with the station nothing can be planned
            yield from self._travel.wait_for_obstacle(result, since)
        return result

    def _attempt(self, motion: DrivenMotion) -> Generator[Wish, None, EndingKind]:
        """Drive a motion into the dock, and see that the robot stands in it.

        Raises:
            Interrupted: It does not.
            AttemptFailed: It is unknown.
        """
        docked = yield from self._travel.drive(motion, State.APPROACHING)
        if docked is None and self.cycles.situation.dock_type.is_pressed_on:
            return (yield from press(self.cycles))
        yield from self.cycles.stop()
        if docked is EndingKind.DOCKED_BY_SIGNAL and not self.cycles.situation.has_signal:
            self.cycles.report(
                "contact lost again", self.cycles.situation.estimate.where
            )  # the feedback was taking the robot back
            docked = yield from press(self.cycles)
        if not self.cycles.situation.dock_type.is_pressed_on:
            yield from confirm(self.cycles)
            if (yield from self._nudge.run()):
                yield from confirm(self.cycles)
        return docked or EndingKind.DOCKED_BY_DISTANCE

    def _return(self, *, is_blocked: bool) -> Cycles:
        """To a staging pose; where no way led into the dock, only if one leads to a staging pose and from there in.

        Raises:
            TaskFailed: The robot does not get there.
        """
        if not is_blocked:
            yield from self._travel.drive_to(
                self.cycles.situation.staging.poses, State.RETURNING, EndingKind.FAILED_TO_CONTROL
            )
            return
        found = yield from self._travel.staging_pose_on_a_way()
        if found is None:
            self.cycles.report("no way from a staging pose", "the next attempt begins here")
        else:
            yield from self._travel.drive_to(lambda: (found,), State.RETURNING, EndingKind.FAILED_TO_CONTROL)

    def _wait_for_charge(self) -> Cycles:
        """At rest until the battery is charged.

        Raises:
            AttemptFailed: It does not.
        """
        self.cycles.state, since = State.WAITING_FOR_CHARGE, self.cycles.now
        while not self.cycles.situation.is_charging:
            if self.cycles.now - since > self.cycles.situation.settings.wait_charge_timeout:
                raise AttemptFailed(
                    EndingKind.FAILED_TO_CHARGE,
                    f"no signal for {self.cycles.now - since:.1f} s: {self.cycles.situation.estimate.where}",
                )
            yield from self.cycles.cycle(STOP)
