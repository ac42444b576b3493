"""The command line: `optdock plan | simulate | certify | compare | demo | report | replay | calibrate | bag | ...`.

Commands import the library when they run, so that `--help` is fast.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from optdock import __version__
from optdock.cli.bag import bag
from optdock.cli.calibrate import calibrate
from optdock.cli.certify import certify
from optdock.cli.common import VerboseOption, listen, reported
from optdock.cli.exit_status import EXIT_STATUSES
from optdock.cli.importing import app as importing
from optdock.cli.plan import compare, plan
from optdock.cli.replay import replay
from optdock.cli.report import report
from optdock.cli.simulate import demo, simulate
from optdock.cli.survey import survey
from optdock.cli.ui import ui

__all__ = ["app", "main"]

app = typer.Typer(
    help="Certified docking trajectories for wheeled robots: plan, smooth, prove, time, drive.",
    epilog=f"Exit status: {'; '.join(f'{status:d} {meaning}' for status, meaning in EXIT_STATUSES.items())}.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)


def main() -> None:
    """Entry point of the `optdock` program."""
    app()


def _show_version(wanted: bool) -> None:  # noqa: FBT001 - typer's callback
    if wanted:
        from optdock.kernels import kernels_in_use

        typer.echo(__version__)
        with reported(verbose=False):
            typer.echo(kernels_in_use())
        raise typer.Exit


@app.callback()
def _common(
    *,
    verbose: VerboseOption = False,
    version: Annotated[  # noqa: ARG001 - typer calls its callback
        bool,
        typer.Option(
            "--version", callback=_show_version, is_eager=True, help="Print the version and the kernels in use."
        ),
    ] = False,
) -> None:
    listen(verbose=verbose)


def plugins(
    *,
    nav2_params: Annotated[
        Path | None,
        typer.Option(
            help="List plugins and parameters of this Nav2 parameter file, and which of them optdock provides or uses."
        ),
    ] = None,
    verbose: VerboseOption = False,
) -> None:
    """List the installed plugins, one line each."""
    with reported(verbose=verbose):
        from optdock.plugins.registry import available_plugins
        from optdock.reports.report import table

        if nav2_params is None:
            typer.echo(table([(plugin.kind, plugin.name, plugin.target) for plugin in available_plugins()]))
            return
        from optdock.nav2.parameter_report import nav2_parameter_rows
        from optdock.nav2.params import load_nav2_params
        from optdock.nav2.provided_plugins import nav2_costmap_rows, nav2_plugin_rows

        params = load_nav2_params(nav2_params)
        for rows in (nav2_plugin_rows(params), nav2_costmap_rows(params), nav2_parameter_rows(params)):
            if rows:
                typer.echo(table(rows))


def schema(
    *,
    out: Annotated[Path | None, typer.Option(help="File to write instead of printing.")] = None,
    verbose: VerboseOption = False,
) -> None:
    """Print the JSON schema of scenario files for editors, with the parameters of every installed plugin."""
    with reported(verbose=verbose):
        from optdock.config import scenario_schema
        from optdock.io.atomic_file import write_text

        text = json.dumps(scenario_schema(), indent=1, allow_nan=False)
        if out is None:
            typer.echo(text)
        else:
            write_text(out, text + "\n")


for _command in (plan, simulate, certify, survey, ui, compare, report, demo, replay, calibrate, bag, plugins, schema):
    app.command()(_command)
app.add_typer(importing, name="import")
