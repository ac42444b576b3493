"""Chapter of a comparison of raw and smoothed paths."""

from __future__ import annotations

import csv
import functools
import io
import math
from typing import TYPE_CHECKING, NamedTuple

from optdock.errors import InvalidFile
from optdock.io.quoting import shown
from optdock.reports.html.figures import LegendEntry, bar_figure
from optdock.reports.html.page import Chapter, Chart, Content, Table

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

__all__ = ["comparison_chapter", "is_comparison"]

_KEYS = ("scenario", "path", "status")
_TEXTS = (*_KEYS, "smoother", "reason")  # columns without numbers
_UNITS = {"m": "m", "1pm": "1/m", "1pm2": "1/m^2", "deg": "deg", "s": "s", "ms": "ms"}  # suffixes of columns
_SERIES = ("raw", "path", "start", "reverse", "goal", "dock", "robot")  # colours
_MOST_BARS = 40  # groups of a chart


class _Row(NamedTuple):
    """One path: its texts and its numbers by column, nan if missing."""

    texts: Mapping[str, str]
    numbers: Mapping[str, float]

    @property
    def kind(self) -> str:
        smoother = self.texts.get("smoother")
        return f"{self.texts['path']} by {smoother}" if smoother else self.texts["path"]


def is_comparison(text: str) -> bool:
    """Whether the first line of a text is the head of a comparison.csv of `optdock compare`."""
    return text.partition("\n")[0].startswith(",".join(_KEYS))


def comparison_chapter(name: str, text: str) -> Chapter:
    """Return the chapter of a comparison of paths; further columns of numbers are shown as well.

    Args:
        name: Name of the file.
        text: Text of the CSV file.

    Raises:
        InvalidFile: If a row has another number of cells than the head, or a cell is not a number.
    """
    head, *lines = csv.reader(io.StringIO(text))
    rows = [_row(f"{name}:{number}", head, line) for number, line in enumerate(lines, start=2)]
    smoothed = [row.texts["status"] for row in rows if row.texts["path"] != "raw"]
    certified = smoothed.count("certified")
    scenarios = [*dict.fromkeys(row.texts["scenario"] for row in rows)]
    summary = f"{len(scenarios)} scenarios, {certified} of {len(smoothed)} smoothed paths certified"
    grade, severity = ("good", 2.0) if certified == len(smoothed) else ("neutral", 1.5)
    numbers = {"rows": [dict(zip(head, line, strict=True)) for line in lines]}
    content = functools.partial(_content, head, rows, scenarios)
    return Chapter(name, "comparisons", "compared", grade, summary, content, numbers, (severity, 0.0))


def _row(place: str, head: Sequence[str], line: Sequence[str]) -> _Row:
    if len(line) != len(head):
        raise InvalidFile(f"{place}: must have {len(head)} cells, got {len(line)}")
    cells = dict(zip(head, line, strict=True))
    numbers = {column: _number(place, column, cells[column]) for column in head if column not in _TEXTS}
    return _Row({one: cells[one] for one in head if one in _TEXTS}, numbers)


def _number(place: str, column: str, cell: str) -> float:
    try:
        return float(cell or math.nan)
    except ValueError:
        raise InvalidFile(f"{place}: {column}: must be a number, got {shown(cell)}") from None


def _content(head: Sequence[str], rows: Sequence[_Row], scenarios: Sequence[str]) -> Content:
    columns = [one for one in head if one not in _TEXTS]
    texts = [one for one in head if one in _TEXTS]
    titles = ("#", *texts[: len(_KEYS)], *(" ".join(_title(one)) for one in columns), *texts[len(_KEYS) :])
    cells = []
    for row in rows:
        numbers = ("" if math.isnan(row.numbers[one]) else f"{row.numbers[one]:.4g}" for one in columns)
        known = [row.texts[one] for one in texts]
        number = str(scenarios.index(known[0]) + 1)
        cells.append((number, *known[: len(_KEYS)], *numbers, *known[len(_KEYS) :]))
    return Content([Table("Paths", titles, cells), *_charts(columns, rows, scenarios)])


def _title(column: str) -> tuple[str, str]:
    """Return name and unit of a column."""
    name, _, suffix = column.rpartition("_")
    unit = _UNITS.get(suffix)
    return (column.replace("_", " "), "") if unit is None else (name.replace("_", " "), f"[{unit}]")


def _charts(columns: Sequence[str], rows: Sequence[_Row], scenarios: Sequence[str]) -> Iterator[Chart]:
    groups = scenarios[:_MOST_BARS]
    numbers = {(row.texts["scenario"], row.kind): row.numbers for row in rows}
    colours = dict(zip(_SERIES, dict.fromkeys(row.kind for row in rows), strict=False))
    legend = [LegendEntry(kind, colour, "area") for colour, kind in colours.items()]
    for column in columns:
        bars = {
            colour: [numbers.get((one, kind), {}).get(column, math.nan) for one in groups]
            for colour, kind in colours.items()
        }
        name, unit = _title(column)
        figure = bar_figure([str(i) for i in range(1, len(groups) + 1)], bars, unit or "[1]")
        means = []
        for colour, kind in colours.items():
            known = [value for value in bars[colour] if math.isfinite(value)]
            means.append(f"{kind}: mean {sum(known) / len(known):.4g} of {len(known)}" if known else f"{kind}: none")
        yield Chart(name.capitalize(), f"{'; '.join(means)}; numbers of scenarios as in the table.", figure, legend)
