"""Figures of the documentation that a command prints, compared with what it prints now.

A table below a line `<!-- measured: COMMAND -->` holds columns of the first table that the command prints with all of
them; of the rows those that begin as its own do, or all where several begin alike. `python docs/tools/measured.py`
(`make figures`) runs the commands and fails where a figure is another one by now; `--write` puts the new ones in. Words
after it choose among commands: those that contain one of them.

A line `<!-- measured by hand: REASON -->` stands above a table that no command prints as it is.

A number in a sentence that the code knows stands before a comment with the expression: 54<!-- len(optdock.__all__) -->.
The tests compare those, and what snippets print with the blocks below them.
"""

from __future__ import annotations

import argparse
import math
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

__all__ = [
    "ROOT",
    "Counted",
    "Measured",
    "are_alike",
    "compared",
    "counted_in",
    "measured_in",
    "printed_tables",
    "tables_of",
    "updated",
]

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", ROOT / "DESIGN.md", *sorted((ROOT / "docs").rglob("*.md"))]

# Plans of a call depend a little on what its budget allows, and so do figures of runs with deadlines.
_WITHIN = 0.1  # [1]: of a figure
_OF_TIME = 0.5  # [1]: of a figure of computing time, which differs from machine to machine by a factor of two
_TIME = re.compile(r"\b(ms|CPU)\b", re.IGNORECASE)

_MARKER = re.compile(
    r"^<!-- measured(?: by hand: (?P<reason>[^\n]+?)|: (?P<command>[^\n]+?)) -->\n+(?P<table>(?:^\|[^\n]*\n)+)",
    re.MULTILINE,
)
_TABLE = re.compile(r"(?:^\|[^\n]*\n)+", re.MULTILINE)
_COUNTED = re.compile(r"(?P<number>[\d,]+|\w+)\**<!-- (?P<expression>[^\n>]*?\([^\n>]*?) -->")
_NUMBER = re.compile(r"(?<![\w.])[-+]?\d[\d,]*(?:\.\d+)?(?:e[-+]?\d+)?")
_GAP = re.compile(r"\s{2,}")
_WORDS = ("zero", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "eleven", "twelve")


class Measured(NamedTuple):
    """A table of a page: its command, or the reason why there is none, and its rows of cells, the head first."""

    page: Path
    command: str
    reason: str
    rows: list[list[str]]
    text: str


class Counted(NamedTuple):
    """A number of a sentence, and the expression that says what it is."""

    number: int
    expression: str


def measured_in(page: Path) -> list[Measured]:
    """The marked tables of a page."""
    text = page.read_text(encoding="utf-8")
    return [
        Measured(page, found["command"] or "", found["reason"] or "", _cells(found["table"]), found["table"])
        for found in _MARKER.finditer(text)
    ]


def tables_of(page: Path) -> list[list[list[str]]]:
    """Every table of a page, marked or not, as rows of cells."""
    return [_cells(found[0]) for found in _TABLE.finditer(page.read_text(encoding="utf-8"))]


def _cells(table: str) -> list[list[str]]:
    rows = [[cell.strip() for cell in line.strip()[1:-1].split(" | ")] for line in table.splitlines()]
    rows = [[cell.strip(" |") for cell in row] for row in rows]
    return [row for row in rows if not all(set(cell) <= set("-: |") and cell for cell in row)]


def counted_in(page: Path) -> list[Counted]:
    """The numbers of a page that the code knows."""
    return [
        Counted(_as_int(found["number"]), found["expression"])
        for found in _COUNTED.finditer(page.read_text(encoding="utf-8"))
    ]


def _as_int(number: str) -> int:
    word = number.lower()
    return _WORDS.index(word) if word in _WORDS else int(number.replace(",", ""))


def printed_tables(text: str) -> list[list[list[str]]]:
    """The tables that a command has printed: lines of as many columns as the line above, two spaces between them."""
    tables: list[list[list[str]]] = [[]]
    for line in text.splitlines():
        cells = _GAP.split(line.strip())
        if set(line.strip()) <= {"-"}:
            continue  # a rule below a head
        if len(cells) < 2 or (tables[-1] and len(cells) != len(tables[-1][0])):
            tables.append([])
        if len(cells) >= 2:
            tables[-1].append(cells)
    return [rows for rows in tables if len(rows) > 1]


def updated(table: Measured, printed: str) -> list[list[str]]:
    """The rows of a table as its command prints them now, the head first.

    Raises:
        LookupError: It prints no table with these columns.
    """
    head = table.rows[0]
    rows = next((rows for rows in printed_tables(printed) if set(head) <= set(rows[0])), None)
    if rows is None:
        raise LookupError(f"{table.command}: prints no table with the columns {', '.join(head)}")
    columns = [rows[0].index(name) for name in head]
    found = [[row[k] for k in columns] for row in rows[1:]]
    names, kept = [row[0] for row in found], {row[0] for row in table.rows[1:]}
    chosen = len(set(names)) == len(names) and kept <= set(names)
    return [head, *(row for row in found if not chosen or row[0] in kept)]


def compared(table: Measured, printed: str) -> list[str]:
    """What of a table is not what its command prints now; empty: nothing."""
    try:
        now = updated(table, printed)
    except LookupError as error:
        return [str(error)]
    if len(now) != len(table.rows):
        return [f"{len(table.rows) - 1} rows, printed are {len(now) - 1}"]
    return [
        f"row {i}, {name}: {said!r}, printed is {found!r}"
        for i, (row, other) in enumerate(zip(table.rows[1:], now[1:], strict=True), start=1)
        for name, said, found in zip(table.rows[0], row, other, strict=True)
        if not are_alike(said, found, _OF_TIME if _TIME.search(name) else _WITHIN)
    ]


def are_alike(said: str, found: str, within: float) -> bool:
    """Whether two texts are the same but for their numbers, and these within a share of the larger one.

    A unit in the last place that is said is always allowed.
    """
    if _NUMBER.sub("#", said).split() != _NUMBER.sub("#", found).split():
        return False
    return all(
        math.isclose(_value(a), _value(b), rel_tol=within, abs_tol=1.01 * _unit(a))
        for a, b in zip(_NUMBER.findall(said), _NUMBER.findall(found), strict=True)
    )


def _value(number: str) -> float:
    return float(number.replace(",", ""))


def _unit(number: str) -> float:
    """Of the last place; none of a count."""
    mantissa, _, exponent = number.partition("e")
    digits = len(mantissa.partition(".")[2])
    return 10.0 ** (int(exponent or 0) - digits) if digits else 0.0


def run(command: str) -> str:
    """What a command prints, here and now.

    Raises:
        subprocess.CalledProcessError: It fails.
    """
    words = shlex.split(command)
    if words[0] == "python":
        words[0] = sys.executable
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.run(words, cwd=ROOT, env=environment, check=True, stdout=subprocess.PIPE, text=True).stdout


def main() -> int:
    """Run, compare, say what differs; the exit status is 1 where something does."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("words", nargs="*", help="parts of commands; default: all")
    parser.add_argument("--write", action="store_true", help="put the new figures in")
    parser.add_argument("--list", action="store_true", help="name the commands and run nothing")
    options = parser.parse_args()
    tables = [table for page in PAGES for table in measured_in(page) if table.command]
    tables = [table for table in tables if not options.words or any(word in table.command for word in options.words)]
    commands, status = list(dict.fromkeys(table.command for table in tables)), 0
    for command in commands:
        print(command, flush=True)
        if options.list:
            continue
        printed = run(command)
        for table in (table for table in tables if table.command == command):
            wrong = compared(table, printed)
            if options.write:
                _write(table, updated(table, printed))
            else:
                status = 1 if wrong else status
            print(*(f"  {table.page.relative_to(ROOT)}: {line}" for line in wrong), sep="\n", flush=True)
    return status


def _write(table: Measured, rows: list[list[str]]) -> None:
    lines = ["| " + " | ".join(row) + " |" for row in rows]
    lines.insert(1, "|" + "---|" * len(rows[0]))
    text = table.page.read_text(encoding="utf-8")
    table.page.write_text(text.replace(table.text, "\n".join(lines) + "\n"), encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
