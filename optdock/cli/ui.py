"""`optdock ui`."""

from __future__ import annotations

import signal
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from optdock.cli.common import VerboseOption, reported

if TYPE_CHECKING:
    from tornado.ioloop import IOLoop

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
        if address not in ("localhost", "127.0.0.1"):
            typer.echo(
                f"warning: everyone who can reach {address} can use the page and the files of {folder}", err=True
            )
        typer.echo(f"{url} (Ctrl-C ends it)")
        if browser:
            server.io_loop.add_callback(server.show, "/")
        _stop_on_signals(server.io_loop)
        server.io_loop.start()
        server.stop()


def _stop_on_signals(loop: IOLoop) -> None:
    """Stop a loop at the first signal; KeyboardInterrupt would be lost in a callback of the garbage collector."""

    def stop(number: int, _: object) -> None:
        signal.signal(number, signal.SIG_DFL)  # a second signal ends a loop that hangs
        loop.add_callback(loop.stop)

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, stop)
