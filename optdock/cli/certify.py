"""`optdock certify`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from optdock.cli.common import ScenarioArgument, VerboseOption, reported
from optdock.cli.exit_status import ExitStatus

if TYPE_CHECKING:
    from optdock.model.problem import DockingProblem
    from optdock.reports.plan_file_verdict import PlanFileVerdict

__all__ = ["certify"]


def certify(
    plan: Annotated[Path, typer.Argument(help="Plan file (JSON), from any source.", show_default=False)],
    scenario: ScenarioArgument,
    *,
    verbose: VerboseOption = False,
) -> None:
    """Check a plan file from any source: prove it, or list every broken rule.

    The path is proven or refuted. The motion is proven if the file has its phases; samples alone can be refuted but not
    proven. Other values are compared with the values computed here, or listed as not checked. Exit status 0: the path
    and, if the file has one, the motion are certified, and no value is false; 4: the file is a refusal with a valid
    proof that no motion exists; 2: the file contradicts itself; otherwise 3.
    """
    with reported(verbose=verbose):
        from optdock.config import load_scenario
        from optdock.reports.report import table

        verdict = _verdict(plan, load_scenario(scenario).problem)
        typer.echo(table(verdict.rows))
        for claim in verdict.false_claims:
            typer.echo(f"false claim: {claim}", err=True)
    if verdict.outcome == "impossible":
        raise typer.Exit(ExitStatus.IMPOSSIBLE)
    if not verdict:
        typer.echo(f"not certified: {verdict.reason}", err=True)
        raise typer.Exit(ExitStatus.NOT_CERTIFIED)


def _verdict(source: Path, problem: DockingProblem) -> PlanFileVerdict:
    """Return the verdict on a file.

    Raises:
        InvalidFile: If the file cannot be read, violates its format, or contradicts itself.
    """
    from optdock.errors import InvalidFile
    from optdock.io.plan_file import load_plan
    from optdock.reports.plan_file_verdict import judge_plan_file

    plan = load_plan(source)
    try:
        return judge_plan_file(plan, problem)
    except InvalidFile as error:
        raise InvalidFile(f"{source}: {error}") from error
