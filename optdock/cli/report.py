"""`optdock report`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from optdock.cli.common import VerboseOption, check_report, reported, spare

__all__ = ["report"]


def report(
    sources: Annotated[
        list[Path],
        typer.Argument(
            metavar="FILES...",
            help="Plan files, runs, logs of dockings, comparison.csv, or folders of surveys.",
            show_default=False,
        ),
    ],
    *,
    out: Annotated[Path, typer.Option(help="HTML file to write.")] = Path("report.html"),
    scenario: Annotated[
        list[Path] | None,
        typer.Option(
            help="Scenario with the scene of the plans and runs: one for all, one for each in their order, or a folder "
            "with x.yaml for each x.json.",
            show_default=False,
        ),
    ] = None,
    title: Annotated[str, typer.Option(help="Title of the page.")] = "Docking report",
    verbose: VerboseOption = False,
) -> None:
    """Write one HTML page about plans, runs, logs, comparisons and surveys; it needs no network.

    Plans are checked as by `optdock certify` if their scenario is given. For example, after `optdock demo`: optdock
    report demo/plan.json demo/run.json --scenario demo/scenario.yaml
    """
    with reported(verbose=verbose):
        from optdock.config import load_scenario
        from optdock.reports.html import read_chapters, save_report

        check_report(out)
        for source in (*sources, *(scenario or ())):
            spare(source, out)
        given = scenario or []
        if len(given) == 1 and given[0].is_dir():
            named = {source.stem: given[0] / f"{source.stem}.yaml" for source in sources}
            by_name = {stem: load_scenario(path).problem for stem, path in named.items() if path.exists()}
            chapters = read_chapters(sources, by_name)
        else:
            chapters = read_chapters(sources, [load_scenario(source).problem for source in given])
        save_report(out, title, chapters)
        typer.echo(f"{out}: {len(chapters)} files")
