"""`optdock certify`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from optdock.cli.exits import NOT_CERTIFIED, reported
from optdock.cli.options import ScenarioArgument

if TYPE_CHECKING:
    from optdock.io.plan_file import PlanFile
    from optdock.problem import DockingProblem

__all__ = ["certify"]


def certify(
    plan: Annotated[Path, typer.Argument(help="Plan file (JSON), by whomever.", show_default=False)],
    scenario: ScenarioArgument,
) -> None:
    """Judge a plan file, also one that optdock did not make: prove it, or name every rule it breaks."""
    with reported():
        from optdock.config import load_scenario
        from optdock.io.plan_file import load_plan

        problem = load_scenario(scenario).problem
        faults = _judged(load_plan(plan), problem)
    if faults:
        typer.echo(f"not certified: {faults[0]}", err=True)
        raise typer.Exit(NOT_CERTIFIED)


def _judged(plan: PlanFile, problem: DockingProblem) -> list[str]:
    """Every broken rule, printed with what was proven and what the file does not say."""
    from optdock.cli.motion_samples import motion_faults
    from optdock.report import certificate_rows, table
    from optdock.verification import certify_path

    if plan.path is None:
        return [f"the file holds no path, its status is {plan.status}"]
    if plan.frame != problem.frame:
        return [f"the plan stands in frame {plan.frame!r}, the scenario in {problem.frame!r}; transform one of them"]
    certificate = certify_path(plan.path, problem)
    faults = [violation.message for violation in certificate.violations]
    motion = "none in the file, the path alone is judged"
    if plan.trajectory is not None:
        broken = motion_faults(plan.trajectory, plan.path, problem)
        motion = f"{plan.trajectory.t.size} samples, {'refuted' if broken else 'none breaks a limit'}"
        faults += broken
    verdict = "not certified" if faults else "certified"
    rows = [("verdict", verdict), *certificate_rows(certificate), ("motion", motion)]
    typer.echo(table([*rows, *(("violation", fault) for fault in faults)]))
    return faults
