"""`optdock ui`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from optdock.cli.common import VerboseOption, reported

__all__ = ["ui"]


def ui(
    source: Annotated[
        Path | None,
        typer.Argument(
            help="Scenario, map, plan file, log of a docking, or folder of a survey; by default the built-in scenario.",
            show_default=False,
        ),
    ] = None,
    *,
    port: Annotated[int, typer.Option(min=0, max=65535, help="TCP port; 0: any free one.")] = 5006,
    address: Annotated[
        str, typer.Option(help="Address to listen on. Everyone who can reach it can use the page and its folder.")
    ] = "localhost",
    browser: Annotated[bool, typer.Option(help="Open the page in the browser.")] = True,
    verbose: VerboseOption = False,
) -> None:
    """Open a page in the browser on which start, dock and obstacles are dragged and every change is planned.

    Files are read and written only in the folder of the file, without a file in the current folder. For example:
    optdock ui examples/data/bay.yaml
    """
    with reported(verbose=verbose):
        from optdock.ui.server import page_server

        folder = Path.cwd() if source is None else source.resolve().parent
        server = page_server(None if source is None else source.resolve(), folder, port, address)
        server.start()
        url = f"http://{address}:{server.port}/"
        typer.echo(f"{url} (Ctrl-C ends it)")
        if browser:
            server.io_loop.add_callback(server.show, "/")
        try:
            server.io_loop.start()
        except KeyboardInterrupt:
            server.stop()
