"""The server of `optdock ui`."""

from __future__ import annotations

import asyncio
import socket
from typing import TYPE_CHECKING

from optdock.errors import InvalidValue, MissingExtra
from optdock.io.quoting import shown
from optdock.ui.opened_source import asked_page, open_source
from optdock.ui.page_session import make_page

if TYPE_CHECKING:
    from pathlib import Path

    from bokeh.application.application import SessionContext
    from bokeh.document import Document
    from bokeh.server.server import Server

    from optdock.ui.opened_source import AskedPage

__all__ = ["page_server"]

_MOST_PAGES = 8  # open at the same time, each with a process of its own


def page_server(source: Path | None, folder: Path, port: int = 0, address: str = "localhost") -> Server:
    """Return a server of the page, which is listening but not running yet.

    Args:
        source: File that the page opens first, see `open_source`; None: the built-in scenario.
        folder: Folder in which the page may read and write files.
        port: TCP port; 0: any free one.
        address: Address to listen on. Other addresses than local ones make the page, and the files of the folder,
            available to everyone who can reach this machine.

    Raises:
        InvalidFile: If the file cannot be read.
        InvalidValue: If the port is in use, or the address is not one IPv4 address or host name of this machine.
        MissingExtra: If Bokeh is not installed.
    """
    try:
        from bokeh.application import Application
        from bokeh.application.handlers.function import FunctionHandler
        from bokeh.server.server import Server
    except ImportError as error:
        raise MissingExtra("the page needs Bokeh: pip install 'optdock[ui]'") from error
    _check_address(address)
    open_source(source, folder)  # so that errors are reported here and not in the browser
    asked: dict[str, AskedPage] = {}
    pages: list[Document] = []

    async def prepare(context: SessionContext) -> None:
        """Open the content of a page in a thread, so that a large map does not delay the other pages."""
        if len(pages) < _MOST_PAGES:
            arguments = dict(getattr(context.request, "arguments", {}))
            asked[context.id] = await asyncio.to_thread(asked_page, source, folder, arguments)

    def opened(document: Document) -> None:
        context = document.session_context
        content = asked.pop(context.id, None) if context is not None else None
        if len(pages) >= _MOST_PAGES:
            _refuse(document, f"{_MOST_PAGES} pages are open already; close one of them and reload this page.")
            return
        if content is None:
            _refuse(document, "The page cannot be opened; the output of the program contains the reason.")
            return
        make_page(document, content, folder)
        pages.append(document)
        document.on_session_destroyed(lambda _: pages.remove(document))

    handler = FunctionHandler(opened)
    handler.on_session_created = prepare
    try:
        port = _free_port(address, port)
        server = Server(
            {"/": Application(handler)},
            port=port,
            address=address,
            # Only pages that were opened through this address may open a session.
            allow_websocket_origin=[f"{host.lower()}:{port}" for host in ("localhost", "127.0.0.1", address)],
            unused_session_lifetime_milliseconds=5_000,
            check_unused_sessions_milliseconds=2_000,
        )
    except OSError as error:
        raise InvalidValue(f"port: cannot listen on {address}:{port}: {error.strerror or error}") from None
    return server


def _check_address(address: str) -> None:
    """Raise InvalidValue for addresses through which no page could be opened."""
    try:
        found = socket.gethostbyname(address) if address and ":" not in address else ""
    except (OSError, UnicodeError):  # the name is unknown
        found = ""
    if found in ("", "0.0.0.0"):
        raise InvalidValue(
            "address: must be one host name or IPv4 address of this machine, such as 192.168.1.7, "
            f"got {shown(address)}; a page works only through the address that is given here"
        )


def _free_port(address: str, port: int) -> int:
    """Return the port, or any free one for 0; raise OSError if it is in use."""
    with socket.create_server((address, port)) as listening:
        return int(listening.getsockname()[1])


def _refuse(document: Document, words: str) -> None:
    from bokeh.models import Div

    document.add_root(Div(text=words))
