"""Plans from rest, and the motions that they give: driven, interrupted, planned again."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

from optdock.executor.control_cycles import STOP
from optdock.executor.interruptions import HELD, SHORTER_WAY, AttemptFailed, Interrupted, NoWay, TaskFailed
from optdock.executor.plan_requests import PlanRequests
from optdock.executor.planning import Job, Outcome, PlanResult
from optdock.executor.task_states import EndingKind, State
from optdock.executor.trajectory_drive import TrajectoryDrive

if TYPE_CHECKING:
    from collections.abc import Callable, Generator

    from optdock.executor.control_cycles import ControlCycles, Cycles, Wish
    from optdock.executor.planning import DrivenMotion, Planning
    from optdock.geometry.pose import Pose2
    from optdock.model.problem import DockingProblem
    from optdock.plugins.interfaces import Controller, GoalChecker

__all__ = ["MOST_BLOCKS", "Travel"]

_PLANNING_PATIENCE = 5.0  # [s] beyond its budget: a thread that shares its core is late, not dead
MOST_BLOCKS = 5  # stops on one approach, until it counts as failed


class Travel:
    """Plans and drives.

    Args:
        cycles: Of the task.
        controller: Drives the motions.
        goal_checker: Says when the robot is docked.
        planning: Makes the motions.
    """

    def __init__(
        self, cycles: ControlCycles, controller: Controller, goal_checker: GoalChecker, planning: Planning
    ) -> None:
        self._cycles, self._controller, self._goal_checker = cycles, controller, goal_checker
        self._requests = PlanRequests(planning, cycles.report)

    def planned(self, problem: DockingProblem) -> Generator[Wish, None, PlanResult]:
        """The result of a plan from rest."""
        self._cycles.state = State.PLANNING
        since, budget = self._cycles.now, self._cycles.situation.settings.time_budget
        number = self._requests.submit(Job(0, since, problem, budget))
        while True:
            yield from self._cycles.cycle(STOP)
            result = self._requests.result(self._cycles.now)
            if result is not None:
                return result
            if self._cycles.now - since > budget + _PLANNING_PATIENCE:
                return PlanResult(number, Outcome.FAILED, reason="planning does not answer")

    def planned_to(self, places: tuple[Pose2, ...]) -> Generator[Wish, None, PlanResult]:
        """The result of a plan to the first pose to which there is one; else that of the last."""
        *others, last = places
        for number, place in enumerate(others, start=1):
            result = yield from self.planned(self._cycles.situation.scene.to(place))
            if result.motion is not None:
                return result
            self._cycles.report("no way to a staging pose", f"number {number} of {len(others) + 1}: {result.reason}")
        return (yield from self.planned(self._cycles.situation.scene.to(last)))

    def staging_pose_on_a_way(self) -> Generator[Wish, None, Pose2 | None]:
        """The first staging pose to which there is a plan, and from there one into the dock; None if there is none."""
        situation = self._cycles.situation
        for place in situation.staging.poses():
            if (yield from self.planned(situation.scene.to(place))).motion is None:
                continue
            into_dock = dataclasses.replace(situation.scene.to_dock(), start=place)
            if (yield from self.planned(into_dock)).motion is not None:
                return place
        return None

    def wait_for_obstacle(self, result: PlanResult, since: float) -> Cycles:
        """No way from here: wait for another picture of the surroundings, or some time, and try again.

        Raises:
            NoWay: There has been none for too long.
        """
        patience, perception = self._cycles.situation.settings.obstacle_patience, self._cycles.situation.perception
        if self._cycles.now - since >= patience:
            raise NoWay(EndingKind.FAILED_TO_CONTROL, f"no way to the dock: {result.reason}")
        self._cycles.state = State.WAITING_FOR_OBSTACLE
        seen, until = perception.costmap, min(self._cycles.now + 1.0, since + patience)
        self._cycles.report("no way", result.reason)
        while self._cycles.now < until and perception.costmap is seen:
            yield from self._cycles.cycle(STOP)

    def drive(self, motion: DrivenMotion, state: State) -> Generator[Wish, None, EndingKind | None]:
        """Drive a motion to its end, replanned on the way where that is worth it.

        Returns:
            How the robot got into its dock; None where it is not known to stand there.

        Raises:
            Interrupted: It cannot go on.
            AttemptFailed: An approach that cannot succeed any more.
            TaskFailed: Another drive that takes too long.
        """
        self._cycles.state = state
        drive = TrajectoryDrive(
            motion,
            state,
            situation=self._cycles.situation,
            controller=self._controller,
            goal_checker=self._goal_checker,
            requests=self._requests,
            report=self._cycles.report,
        )
        try:
            while not drive.is_over():
                self._cycles.deviation = drive.deviation
                yield from self._cycles.cycle(drive.command())
        finally:
            drive.end()
        return drive.docked

    def drive_to(self, places: Callable[[], tuple[Pose2, ...]], state: State, failure: EndingKind) -> Cycles:
        """Along a certified path to one of some poses; what stops the robot is planned around, or ends the task.

        Args:
            places: In the fixed frame, the preferred one first, as the dock is known now.
            state: What for.
            failure: What it is if the robot does not get there.

        Raises:
            TaskFailed: The robot does not get there; of the kind `failure`.
        """
        situation = self._cycles.situation
        blocks, since = 0, self._cycles.now
        while True:
            yield from self._cycles.locate()
            if situation.staging.has_arrived_at(places()):
                return
            result = yield from self.planned_to(places())
            if result.motion is None:
                if self._cycles.now - since > self._cycles.situation.settings.obstacle_patience:
                    raise TaskFailed(failure, f"no way to the staging pose: {result.reason}")
                try:
                    yield from self.wait_for_obstacle(result, since)
                except AttemptFailed as over:
                    raise TaskFailed(failure, over.reason) from None
                continue
            try:
                yield from self.drive(result.motion, state)
                yield from self._cycles.stop()
                return
            except Interrupted as stopped:
                self._cycles.say_why(stopped)
                yield from self._cycles.stop()
                blocks += stopped.name not in {HELD, SHORTER_WAY}
                since = self._cycles.now
                if blocks > MOST_BLOCKS:
                    raise TaskFailed(failure, f"{stopped.name}: {stopped.reason}") from None
