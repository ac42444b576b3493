"""The executor in the field world with default settings, and the registry of compared methods."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Literal

import numpy as np

from experiments.docking.field.nav2 import by_nav2
from experiments.docking.field.outcome import SteeringResult
from experiments.docking.outcome import ACCEPTED
from experiments.docking.watched import Cycles, WatchedPlanning
from optdock.deadline import now
from optdock.executor import DockingExecutor, ExecutorSettings
from optdock.geometry.pose import Twist2

if TYPE_CHECKING:
    from experiments.docking.cases import Layout
    from experiments.docking.field.world import FieldRobot
    from experiments.docking.outcome import FollowedPlan
    from optdock.executor.log import LogWriter
    from optdock.geometry.pose import Pose2
    from optdock.plugins.registry import PluginChoice

__all__ = ["FIELD_METHODS", "Belief", "by_executor"]

TIMEOUT = 180.0  # [s]: time limit of a task; a task that exceeds it counts as not ended
SETTLING = 1.0  # [s] after the end, until pending commands have arrived and the wheels stand
SAME_GOAL = 0.3  # [m]: a plan whose end is within this distance of the stored dock is a plan into the dock


class Belief:
    """Error of the executor's estimate of the robot pose in the dock frame.

    Attributes:
        off: Last distance between estimate and truth [m]; NaN before the robot is located.
        turned_off: Last angle between estimate and truth [rad].
        recovered_after: Number of detections of the pushed dock until the estimate was within 10 mm, 10 mm and 1.5
            degrees of the truth; infinite if it never was, NaN if nothing was pushed.
    """

    def __init__(self) -> None:
        self.off = self.turned_off = math.nan
        self.recovered_after = math.nan
        self._is_waiting = True

    def compare(self, executor: DockingExecutor, robot: FieldRobot) -> None:
        """Update the errors after a control cycle."""
        if executor.robot is None:
            return
        seen = executor.robot.in_frame_of(executor.dock)
        gap = robot.error.in_frame_of(seen)
        self.off, self.turned_off = math.hypot(gap.x, gap.y), abs(gap.yaw)
        if len(robot.docks) > 1 and self._is_waiting:
            self._wait(gap, robot)

    def _wait(self, gap: Pose2, robot: FieldRobot) -> None:
        """Count detections of a pushed dock until the estimate has recovered."""
        values = abs(gap.x), abs(gap.y), abs(gap.yaw)
        if all(value <= most for value, most in zip(values, ACCEPTED, strict=True)):
            since = robot.docks[-1][0]
            self.recovered_after = float(sum(one.stamp >= since for _, one in robot.detections))
            self._is_waiting = False
        else:
            self.recovered_after = math.inf


def by_executor(  # noqa: PLR0913 - what may be chosen
    layout: Layout,
    robot: FieldRobot,
    rate: float,
    *,
    task: Literal["dock", "undock"] = "dock",
    controller: str | PluginChoice | None = None,
    settings: ExecutorSettings | None = None,
    log: LogWriter | None = None,
) -> SteeringResult:
    """Dock or undock by the executor.

    Args:
        layout: Problem and true dock pose.
        robot: Robot at its start.
        rate: Control cycles per second [Hz].
        task: Docking or undocking.
        controller: Name, or name with parameters; None: the default.
        settings: None: the defaults plus the calibrated settings of the world.
        log: Recorder of the docking.
    """
    if settings is None and robot.world.executor_settings:
        settings = ExecutorSettings(**robot.world.executor_settings)
    planning, cycles, belief = WatchedPlanning(), Cycles(), Belief()
    chosen = {} if controller is None else {"controller": controller}
    executor = DockingExecutor(
        layout.problem,
        settings,
        task=task,
        planning=planning,
        log=log,
        **chosen,  # type: ignore[arg-type]
    )
    stamps: list[float] = []
    commands: list[tuple[float, float]] = []
    raised: Exception | None = None
    while robot.time < TIMEOUT:
        planned_before, began = sum(planning.spent), now()
        try:
            step = executor.step(robot.measurements)
        except Exception as error:  # any exception is a result: the run has failed
            raised = error
            break
        cycles.spent.append(now() - began - sum(planning.spent) + planned_before)
        belief.compare(executor, robot)
        stamps.append(robot.time)
        commands.append((step.command.linear, step.command.angular))
        if step.ending is not None and step.command == Twist2():
            break
        robot.advance(step.command, rate)
    ended, settled = robot.time, robot.time + SETTLING
    while robot.time < settled:
        robot.advance(Twist2(), rate)
    ending = executor.ending
    name, reason = ("never ended", "") if ending is None else (ending.kind.value, ending.reason)
    if raised is not None:
        name, reason = f"raised {type(raised).__name__}", str(raised)
    return SteeringResult(
        name,
        reason,
        raised is None and ending is not None and ending.kind.succeeded,
        ended,
        _planned(layout, planning.followed),
        0 if ending is None else ending.num_retries,
        cycles.busy,
        belief.off,
        belief.turned_off,
        belief.recovered_after,
        np.array(commands),
        np.array(stamps),
    )


def _planned(layout: Layout, followed: list[FollowedPlan]) -> float:
    """Return the planning time of the first plan into the dock, plus that of a preceding plan to the staging pose."""
    total, staged = 0.0, False
    for _, plan in followed:
        if plan is None:
            continue
        if plan.problem.goal.distance_to(layout.problem.goal) < SAME_GOAL:
            return total + plan.trajectory.duration
        if not staged:
            total, staged = plan.trajectory.duration, True
    return math.nan


FIELD_METHODS: dict[str, tuple[Callable[[Layout, FieldRobot, float], SteeringResult], str]] = {
    "executor": (by_executor, "wider"),
    "executor with the MPC": (partial(by_executor, controller="MpcController"), "wider"),
    "Nav2's law": (by_nav2, "nav2"),
}
"""Methods with their default distribution of starts: Nav2's law has no planner to the staging pose."""
