"""Planning for the commands."""

from __future__ import annotations

from typing import TYPE_CHECKING

from optdock.cli.exits import NOT_CERTIFIED, status_of
from optdock.errors import OptdockError
from optdock.io.plan_file import save_plan
from optdock.report import failed_plan_file

if TYPE_CHECKING:
    from pathlib import Path

    from optdock.config import Scenario
    from optdock.plan import DockPlan

__all__ = ["solved", "solved_or_saved"]


def solved(scenario: Scenario, time_budget: float | None = None) -> DockPlan:
    """The certified plan of a scenario.

    Raises:
        OptdockError: There is none; see `plan_dock`.
    """
    return scenario.plan(time_budget)


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
