"""The application: its commands and what they have in common."""

from __future__ import annotations

import logging
from typing import Annotated

import typer

from optdock import __version__
from optdock.cli.certify import certify
from optdock.cli.compare import compare
from optdock.cli.demo import demo
from optdock.cli.plan import plan
from optdock.cli.plugins import plugins
from optdock.cli.simulate import simulate

__all__ = ["app", "main"]

app = typer.Typer(
    help="Certified docking trajectories for wheeled robots: plan, smooth, prove, time, drive.",
    epilog="Exit status: 0 certified; 2 usage or bad input; 3 no certified plan.",
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)
for _command in (plan, simulate, certify, compare, demo, plugins):
    app.command()(_command)


def _show_version(wanted: bool) -> None:  # noqa: FBT001 - typer's callback
    if wanted:
        typer.echo(__version__)
        raise typer.Exit


@app.callback()
def _common(
    *,
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Say on stderr what each stage does.")] = False,
    version: Annotated[  # noqa: ARG001 - typer calls its callback
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    logging.basicConfig(level=logging.INFO if verbose else logging.WARNING, format="%(name)s: %(message)s")


def main() -> None:
    """Entry point of the `optdock` program."""
    app()
