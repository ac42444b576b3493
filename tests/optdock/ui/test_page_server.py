"""The server of the page and its command: sessions, their limit, origins, addresses, faults and the end."""

import asyncio
import contextlib
import os
import signal
import socket
import subprocess
import sys
import threading

import pytest

pytest.importorskip("bokeh")

from bokeh.document import Document
from bokeh.models import Div
from tornado.httpclient import AsyncHTTPClient, HTTPClientError, HTTPRequest
from tornado.websocket import websocket_connect
from typer.testing import CliRunner

from optdock.cli import app
from optdock.errors import InvalidValue
from optdock.ui import page_session as page_module
from optdock.ui import server as server_module
from optdock.ui.opened_source import asked_page
from optdock.ui.server import page_server


class NoRequests:
    """A planning process that never answers by itself."""

    made = None  # the last one

    def __init__(self, on_answer):
        self.closed, self.on_answer, self.fetched = False, on_answer, asyncio.Event()
        NoRequests.made = self

    def ask(self, *asked, **more):
        pass

    def answers(self):
        self.fetched.set()
        return []

    def close(self):
        self.closed = True


@pytest.fixture
def served(monkeypatch, tmp_path):
    """Return a function that starts a server and runs a coroutine function with it."""
    monkeypatch.setattr(page_module, "RequestProcess", NoRequests)

    def run(visit):
        async def visited():
            server = page_server(None, tmp_path, address="127.0.0.1")
            server.start()
            try:
                await visit(server)
            finally:
                server.stop()

        asyncio.run(visited())

    return run


def sessions(server):
    return server.get_sessions("/")


async def fetched(server, query=""):
    reply = await AsyncHTTPClient().fetch(f"http://127.0.0.1:{server.port}/{query}")
    return reply.body.decode()


def text_of(session):
    return " ".join(root.text for root in session.document.roots if isinstance(root, Div))


async def built(server):
    """Report what the browser reports when it has built the page."""
    (session,) = sessions(server)
    data = session.document.get_model_by_name("data")
    await session.with_document_locked(lambda: data.update(text="built"))


def test_an_answer_changes_the_document_in_the_thread_of_its_loop(served, monkeypatch):
    """`Document.unhold` loses a callback that another thread adds between two of its statements."""
    threads, add = set(), Document.add_next_tick_callback

    def added(document, callback):
        threads.add(threading.current_thread())
        return add(document, callback)

    async def visit(server):
        await fetched(server)
        await built(server)
        NoRequests.made.fetched.clear()
        monkeypatch.setattr(Document, "add_next_tick_callback", added)
        await asyncio.to_thread(NoRequests.made.on_answer)
        await NoRequests.made.fetched.wait()
        assert threads == {threading.current_thread()}

    served(visit)


def test_an_answer_waits_until_the_browser_has_built_the_page(served):
    async def visit(server):
        await fetched(server)
        await asyncio.to_thread(NoRequests.made.on_answer)
        for _ in range(5):
            await asyncio.sleep(0.01)
        assert not NoRequests.made.fetched.is_set()
        await built(server)
        assert NoRequests.made.fetched.is_set()

    served(visit)


def test_every_page_has_a_session_and_hostile_queries_are_messages(served, monkeypatch):
    async def visit(server):
        assert "not a safety function" in await fetched(server)
        assert len(sessions(server)) == 1
        assert "<script>x" not in await fetched(server, "?theme=%3Cscript%3Ex")
        # What the page does with a fault is tested in `test_page.py`.
        monkeypatch.setattr(server_module, "make_page", lambda page, asked, _: page.add_root(Div(text=asked.fault)))
        for query in ("?scene=%ff%fe%00", "?scene=1.A&scene=2.B&theme=x&theme=dark", "?file=" + "%2e%2e/" * 2000):
            await fetched(server, query)
            assert text_of(sessions(server)[-1])

    served(visit)


def test_the_ninth_page_is_refused_until_one_is_closed(served, monkeypatch):
    monkeypatch.setattr(server_module, "make_page", lambda *_: None)

    async def visit(server):
        for _ in range(9):
            await fetched(server)
        assert ["8 pages" in text_of(one) for one in sessions(server)].count(True) == 1
        context = server._tornado.applications["/"]
        closed = next(one for one in sessions(server) if "8 pages" not in text_of(one))
        await context._discard_session(closed, lambda _: True)
        await fetched(server)
        assert ["8 pages" in text_of(one) for one in sessions(server)].count(True) == 1

    served(visit)


def test_a_page_that_cannot_be_made_takes_no_place(served, monkeypatch):
    async def visit(server):
        monkeypatch.setattr(server_module, "make_page", lambda *_: 1 / 0)
        for _ in range(9):
            await _ignoring_errors(server)
        monkeypatch.setattr(server_module, "make_page", lambda *_: None)
        await fetched(server)
        assert "8 pages" not in text_of(sessions(server)[-1])

    served(visit)


async def _ignoring_errors(server):
    with contextlib.suppress(HTTPClientError):
        await fetched(server)


def test_a_page_that_is_slow_to_open_delays_no_other(served, monkeypatch):
    begun, released, ended = threading.Event(), threading.Event(), []

    def asked(source, folder, arguments):
        if "file" in arguments:
            begun.set()
            ended.append(released.wait(20.0))
        return asked_page(source, folder, {})

    async def visit(server):
        slow = asyncio.create_task(fetched(server, "?file=large.yaml"))
        while not begun.is_set():
            await asyncio.sleep(0.001)
        assert "not a safety function" in await fetched(server)
        released.set()
        assert "not a safety function" in await slow
        assert ended == [True]

    monkeypatch.setattr(server_module, "asked_page", asked)
    served(visit)


@pytest.mark.parametrize(
    ("origin", "is_open"), [("http://127.0.0.1", True), ("http://localhost", True), ("http://evil.example", False)]
)
def test_only_pages_of_this_server_open_a_session(served, monkeypatch, origin, is_open):
    monkeypatch.setattr(server_module, "make_page", lambda *_: None)

    async def visit(server):
        page = await fetched(server)
        token = page.partition('"token":"')[2].partition('"')[0]
        request = HTTPRequest(f"ws://127.0.0.1:{server.port}/ws", headers={"Origin": f"{origin}:{server.port}"})
        if is_open:
            line = await websocket_connect(request, subprotocols=["bokeh", token])
            assert "ACK" in await line.read_message()
            line.close()
        else:
            with pytest.raises(HTTPClientError, match="403"):
                await websocket_connect(request, subprotocols=["bokeh", token])

    served(visit)


@pytest.mark.parametrize("address", ["", "*", "0.0.0.0", "0", "::", "::1", "no such host", "x" * 300])
def test_addresses_through_which_no_page_opens_are_refused(tmp_path, address):
    with pytest.raises(InvalidValue, match="address: must be one host name"):
        page_server(None, tmp_path, address=address)


def test_the_command_refuses_a_port_in_use_a_missing_file_and_an_address_elsewhere(tmp_path):
    with socket.create_server(("127.0.0.1", 0)) as used:
        port = str(used.getsockname()[1])
        for arguments, words in (
            (["--port", port, "--address", "127.0.0.1"], f"port: cannot listen on 127.0.0.1:{port}"),
            ([str(tmp_path / "none.yaml")], "none.yaml"),
            (["--port", "0", "--address", "192.0.2.1"], "port: cannot listen on 192.0.2.1"),
        ):
            done = CliRunner().invoke(app, ["ui", "--no-browser", *arguments])
            assert done.exit_code == 2
            assert words in done.output


def test_without_bokeh_the_command_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "bokeh.server.server", None)
    done = CliRunner().invoke(app, ["ui", "--no-browser"])
    assert done.exit_code == 2
    assert "pip install 'optdock[ui]'" in done.output


@pytest.mark.skipif(os.name != "posix", reason="needs signals and process groups")
def test_ctrl_c_ends_the_program_and_its_processes(tmp_path):
    program = "from optdock.cli import main; main()"
    command = [sys.executable, "-c", program, "ui", "--no-browser", "--port", "0"]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen(command, text=True, cwd=tmp_path, start_new_session=True, **pipes) as ui:
        url = ui.stdout.readline().split()[0]
        asyncio.run(_opened(url))
        os.killpg(ui.pid, signal.SIGINT)
        assert ui.communicate(timeout=60) == ("", "")  # all processes have closed the pipes
        assert ui.returncode == 0


async def _opened(url):
    await AsyncHTTPClient().fetch(url)
