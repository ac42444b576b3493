"""Code blocks of a page, run in order, in one process, in a separate folder per page.

A text block below a block that is run, under the same heading, shows its output: every line except `...` must be among
the printed lines, with numbers within 2 % or a unit in their last place.
"""

import contextlib
import importlib
import io
import re
import shlex
import sys
from pathlib import Path
from typing import NamedTuple

from typer.testing import CliRunner

from optdock.cli import app
from optdock.errors import MissingExtra, TimedOut

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "docs" / "tools"))
measured = importlib.import_module("measured")
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]

_FENCE = re.compile(
    r"^(?:<!-- not run: (?P<reason>[^\n]+?) -->\n+)?^(?P<mark>```+)(?P<head>[^\n]*)\n(?P<body>.*?)^(?P=mark)$",
    re.MULTILINE | re.DOTALL,
)
_HEADING = re.compile(r"^#+ ", re.MULTILINE)
_TITLE = re.compile(r'title="([^"]+)"')
_TRIES = 5
_WITHIN = 0.02  # [1]: relative tolerance of printed figures
_STATUS = re.compile(r"#\s*exit status (\d)\s*$")


class Block(NamedTuple):
    """A fenced block.

    Its language, its file name or empty, its text, its line, the reason why it is not run, and whether a heading
    separates it from the previous block.
    """

    language: str
    title: str
    body: str
    line: int
    reason: str
    opens_section: bool


def blocks_of(page):
    """Return the fenced blocks of a page, in order."""
    text, end = page.read_text(encoding="utf-8"), 0
    for found in _FENCE.finditer(text):
        head = found["head"].strip()
        title = _TITLE.search(head)
        line = text.count("\n", 0, found.start("head")) + 1
        yield Block(
            head.split()[0] if head else "",
            title[1] if title else "",
            found["body"],
            line,
            found["reason"] or "",
            _HEADING.search(text, end, found.start()) is not None,
        )
        end = found.end()


def run_page(page, folder):
    """Run every block of a page that is not excluded, in one namespace.

    Returns:
        Number of blocks that were run.
    """
    (folder / "examples").symlink_to(ROOT / "examples")
    known, count, printed = {"__name__": "__page__"}, 0, None
    for block in blocks_of(page):
        where = f"{page.relative_to(ROOT)}:{block.line}"
        if block.title:
            (folder / block.title).write_text(block.body, encoding="utf-8")
        printed = None if block.opens_section else printed
        if block.language == "text" and not block.title and printed is not None:
            missing = not_printed(block.body, printed)
            assert not missing, f"{where}: the block before prints no such line: {missing}\nbut:\n{printed}"
        if block.reason or block.language not in {"python", "sh"} or block.title:
            continue
        count += 1
        try:
            printed = _RUNNERS[block.language](block, known, where)
        except BaseException as error:
            raise AssertionError(f"{where}: {type(error).__name__}: {error}") from error
    return count


def _run_python(block, known, where):
    """Run a Python block; repeat it if it did not end in time, because deadlines are real and machines may be loaded.

    A missing extra ends the block. Returns the output.
    """
    code = compile("\n" * block.line + block.body, where, "exec")
    for _ in range(_TRIES):
        with contextlib.redirect_stdout(io.StringIO()) as out, contextlib.suppress(TimedOut):
            with contextlib.suppress(MissingExtra):
                exec(code, known)
            return out.getvalue()
    raise TimedOut(f"{_TRIES} times")


def _run_shell(block, known, where):
    printed = ""
    for line in filter(str.strip, block.body.splitlines()):
        expected = _STATUS.search(line)
        program, *arguments = shlex.split(line, comments=True)
        assert program == "optdock", f"{where}: mark what is no command of ours: {line}"
        result = CliRunner().invoke(app, arguments)
        assert result.exit_code == int(expected[1] if expected else 0), f"{line}\n{result.output}"
        printed += result.output
    return printed


def not_printed(text, printed):
    """Return the first line of a block that is not among the printed lines; None if all lines are printed."""
    lines = printed.splitlines()
    wanted = (line for line in text.splitlines() if line.strip() not in {"", "..."})
    return next((one for one in wanted if not any(measured.are_alike(one, line, _WITHIN) for line in lines)), None)


_RUNNERS = {"python": _run_python, "sh": _run_shell}
