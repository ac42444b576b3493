"""Planning for the commands: load everything first, then let the clock run."""

from __future__ import annotations

from typing import TYPE_CHECKING

from optdock.cli.exits import NOT_CERTIFIED, status_of
from optdock.errors import OptdockError
from optdock.io.plan_file import save_plan
from optdock.pipeline import plan_dock
from optdock.report import failed_plan_file

if TYPE_CHECKING:
    from pathlib import Path

    from optdock.config import Scenario
    from optdock.pipeline import DockPlan, PluginChoices

__all__ = ["solved", "solved_or_saved", "warm_up"]


def warm_up(plugins: PluginChoices) -> None:
    """Plan a small problem, so that no library is loaded and nothing is built while the budget runs."""
    from optdock.dock import Dock
    from optdock.geometry.footprint import Footprint
    from optdock.geometry.pose import Pose2
    from optdock.limits import MotionLimits
    from optdock.problem import DockingProblem
    from optdock.robot import Robot

    robot = Robot(Footprint.rectangle(0.3, 0.3, 0.5), MotionLimits(max_curvature=2.0, max_curvature_rate=8.0))
    outline = Footprint.rectangle(0.6, -0.4, 0.5)
    small = DockingProblem(Pose2(-2.0, 0.1, 0.1), Dock(Pose2(0.0, 0.0, 0.0), outline), robot)
    try:
        plan_dock(small, time_budget=10.0, plugins=plugins)
    except OptdockError:
        return  # what is wrong with the plugins shows when they meet the real problem


def solved(scenario: Scenario, time_budget: float | None = None) -> DockPlan:
    """The certified plan of a scenario.

    Raises:
        OptdockError: There is none; see `plan_dock`.
    """
    warm_up(scenario.plugins)
    budget = scenario.time_budget if time_budget is None else time_budget
    return plan_dock(scenario.problem, time_budget=budget, plugins=scenario.plugins)


def solved_or_saved(scenario: Scenario, out: Path, time_budget: float | None, spacing: float) -> DockPlan:
    """The certified plan; a failure is written to `out` before it is raised.

    Raises:
        OptdockError: There is no certified plan.
    """
    try:
        return solved(scenario, time_budget)
    except OptdockError as error:
        if status_of(error) == NOT_CERTIFIED:
            save_plan(out, failed_plan_file(error, scenario.problem.frame), spacing=spacing)
        raise
