"""Comparison of figures in the documentation with the present output of the commands that print them.

A table below a line `<!-- measured: COMMAND -->` contains columns of the first table printed by the command that has
all of these columns. Rows are matched by their first cells; all rows are compared if several begin alike. `python
docs/tools/measured.py` (`make figures`) runs the commands and fails if a figure has changed; `--write` updates the
pages. Additional arguments select the commands that contain one of them. `--results results` compares the studies that
`make experiments` has run, without running anything.

A line `<!-- measured by hand: REASON -->` marks a table that is not printed by a command.

A computed number in a sentence is followed by a comment with its expression: 54<!-- len(optdock.__all__) -->. The tests
compare these numbers, and the output of snippets with the blocks below them.
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

# Plans depend slightly on the available time budget, and so do figures of runs with deadlines.
_WITHIN = 0.1  # [1]: relative tolerance of a figure
_OF_TIME = 0.5  # [1]: relative tolerance of computing times, which differ between machines by a factor of two
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
    """A table of a page: its command, or the reason of a missing command, and its rows of cells, the head first."""

    page: Path
    command: str
    reason: str
    rows: list[list[str]]
    text: str


class Counted(NamedTuple):
    """A number in a sentence, and the expression of its value."""

    number: int
    expression: str


def measured_in(page: Path) -> list[Measured]:
    """Return the marked tables of a page."""
    text = page.read_text(encoding="utf-8")
    return [
        Measured(page, found["command"] or "", found["reason"] or "", _cells(found["table"]), found["table"])
        for found in _MARKER.finditer(text)
    ]


def tables_of(page: Path) -> list[list[list[str]]]:
    """Return every table of a page, marked or not, as rows of cells."""
    return [_cells(found[0]) for found in _TABLE.finditer(page.read_text(encoding="utf-8"))]


def _cells(table: str) -> list[list[str]]:
    rows = [[cell.strip() for cell in line.strip()[1:-1].split(" | ")] for line in table.splitlines()]
    rows = [[cell.strip(" |") for cell in row] for row in rows]
    return [row for row in rows if not all(set(cell) <= set("-: |") and cell for cell in row)]


def counted_in(page: Path) -> list[Counted]:
    """Return the numbers of a page that have an expression."""
    return [
        Counted(_as_int(found["number"]), found["expression"])
        for found in _COUNTED.finditer(page.read_text(encoding="utf-8"))
    ]


def _as_int(number: str) -> int:
    word = number.lower()
    return _WORDS.index(word) if word in _WORDS else int(number.replace(",", ""))


def printed_tables(text: str) -> list[list[list[str]]]:
    """Yield the tables printed by a command: lines with the same number of columns, separated by two spaces."""
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
    """Return the rows of a table as printed by its command now, the head first.

    Raises:
        LookupError: If it prints no table with these columns.
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
    """Return the differences between a table and the present output of its command."""
    try:
        now = updated(table, printed)
    except LookupError as error:
        return [str(error)]
    if len(now) != len(table.rows):
        return [f"{len(table.rows) - 1} rows, printed are {len(now) - 1}"]
    return [
        f"row {i}, {name}: {documented!r}, printed: {found!r}"
        for i, (row, other) in enumerate(zip(table.rows[1:], now[1:], strict=True), start=1)
        for name, documented, found in zip(table.rows[0], row, other, strict=True)
        if not are_alike(documented, found, _OF_TIME if _TIME.search(name) else _WITHIN)
    ]


def are_alike(documented: str, found: str, within: float) -> bool:
    """Return whether two texts are equal except for their numbers, and these agree within a relative tolerance.

    A difference of one unit in the last printed place is always accepted.
    """
    if _NUMBER.sub("#", documented).split() != _NUMBER.sub("#", found).split():
        return False
    return all(
        math.isclose(_value(a), _value(b), rel_tol=within, abs_tol=1.01 * _unit(a))
        for a, b in zip(_NUMBER.findall(documented), _NUMBER.findall(found), strict=True)
    )


def _value(number: str) -> float:
    return float(number.replace(",", ""))


def _unit(number: str) -> float:
    """Return one unit in the last place; 0 for a count."""
    mantissa, _, exponent = number.partition("e")
    digits = len(mantissa.partition(".")[2])
    return 10.0 ** (int(exponent or 0) - digits) if digits else 0.0


def run(command: str) -> str:
    """Return the output of a command.

    Raises:
        subprocess.CalledProcessError: If it fails.
    """
    words = shlex.split(command)
    if words[0] == "python":
        words[0] = sys.executable
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.run(words, cwd=ROOT, env=environment, check=True, stdout=subprocess.PIPE, text=True).stdout


def study_of(command: str, results: Path) -> str | None:
    """Return the text in a folder of results that a study has printed; None if it has not run with these arguments."""
    found = re.fullmatch(r"python experiments/(\w+)\.py", command)
    text = results / found[1] / "study.md" if found else None
    return text.read_text(encoding="utf-8") if text is not None and text.is_file() else None


def main() -> int:
    """Run the commands and print the differences; the exit status is 1 if there are any."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("words", nargs="*", help="select the commands that contain one of these texts; default: all")
    parser.add_argument("--write", action="store_true", help="write the new figures into the pages")
    parser.add_argument("--results", type=Path, help="compare the texts of studies in this folder, and run no command")
    parser.add_argument("--list", action="store_true", help="list the commands without running them")
    options = parser.parse_args()
    tables = [table for page in PAGES for table in measured_in(page) if table.command]
    tables = [table for table in tables if not options.words or any(word in table.command for word in options.words)]
    commands, status = list(dict.fromkeys(table.command for table in tables)), 0
    for command in commands:
        print(command, flush=True)
        if options.list:
            continue
        printed = run(command) if options.results is None else study_of(command, options.results)
        if printed is None:
            print("  is not among the results")
            status = 1
            continue
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
