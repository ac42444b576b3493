"""`optdock compare`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from optdock.cli.exits import NOT_CERTIFIED, reported
from optdock.cli.progress import working

if TYPE_CHECKING:
    from optdock.comparison import PathFigures
    from optdock.config import Scenario

__all__ = ["compare"]


def compare(
    scenarios: Annotated[list[Path], typer.Argument(help="Scenario files (YAML).", show_default=False)],
    out: Annotated[Path, typer.Option(help="Folder for comparison.csv and a picture of each scenario.")] = Path(
        "comparison"
    ),
) -> None:
    """Compare the raw path with the smoothed one: a table here, a CSV and pictures in a folder."""
    with reported():
        from optdock.comparison import comparison_csv, comparison_table
        from optdock.config import load_scenario
        from optdock.io.atomic_file import write_text

        loaded = [load_scenario(scenario) for scenario in scenarios]
        figures: list[PathFigures] = []
        with working("comparing", len(loaded)) as advance:
            for number, scenario in enumerate(loaded, start=1):
                figures.extend(_compared(scenario, out / f"{number:02d}_{scenario.source.stem}.png"))
                advance(scenario.source.stem)
        write_text(out / "comparison.csv", comparison_csv(figures))
        typer.echo(comparison_table(figures))
    if any(row.path == "smoothed" and row.status != "certified" for row in figures):
        raise typer.Exit(NOT_CERTIFIED)


def _compared(scenario: Scenario, picture: Path) -> list[PathFigures]:
    """Both rows of one scenario, and its picture; a failure becomes a row and a line on stderr."""
    from optdock.cli.exits import BAD_INPUT, status_of
    from optdock.cli.pictures import draw_plan
    from optdock.cli.solving import solved
    from optdock.comparison import PathFigures, figures_of
    from optdock.errors import OptdockError
    from optdock.plan import PartialPlan

    name, problem = scenario.source.stem, scenario.problem
    try:
        plan = solved(scenario)
    except OptdockError as error:
        if status_of(error) == BAD_INPUT:
            raise
        typer.echo(f"{name}: {type(error).__name__}: {' '.join(str(error).split())}", err=True)
        left = PartialPlan.left_by(error)
        draw_plan(picture, problem, left, f"{name}: {type(error).__name__}")
        failed = PathFigures(name, "smoothed", type(error).__name__)
        return [failed] if left.raw_path is None else [figures_of(scenario, "raw", left.raw_path), failed]
    draw_plan(picture, problem, plan, name)
    smoothed = figures_of(scenario, "smoothed", plan.path, plan.trajectory.duration)
    return [figures_of(scenario, "raw", plan.raw_path), smoothed]
