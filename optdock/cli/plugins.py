"""`optdock plugins`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from optdock.cli.exits import reported

__all__ = ["plugins"]


def plugins(
    nav2_params: Annotated[
        Path | None,
        typer.Option(help="List what this Nav2 parameter file asks for, and what of it is provided here."),
    ] = None,
) -> None:
    """List the installed plugins, one line each."""
    with reported():
        from optdock.plugins import available_plugins
        from optdock.report import table

        if nav2_params is None:
            typer.echo(table([(plugin.kind, plugin.name, plugin.target) for plugin in available_plugins()]))
            return
        from optdock.nav2.params import load_nav2_params
        from optdock.nav2.provided_plugins import nav2_costmap_rows, nav2_plugin_rows

        params = load_nav2_params(nav2_params)
        for rows in (nav2_plugin_rows(params), nav2_costmap_rows(params)):
            if rows:
                typer.echo(table(rows))
