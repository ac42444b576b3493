"""Chapter of a comparison of raw and smoothed paths."""

from __future__ import annotations

import csv
import io
import math
from typing import TYPE_CHECKING

from optdock.errors import InvalidFile
from optdock.io.quoting import shown
from optdock.reports.html.figures import LegendEntry, bar_figure
from optdock.reports.html.page import Chapter, Chart, Content, Table

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

__all__ = ["comparison_chapter", "is_comparison"]

_KEYS = ("scenario", "path", "status")
_UNITS = {"m": "m", "1pm": "1/m", "deg": "deg", "s": "s", "ms": "ms"}  # suffixes of columns
_SERIES = ("raw", "path", "start", "reverse", "goal")  # colours
_MOST_BARS = 40  # groups of a chart


def is_comparison(text: str) -> bool:
    """Whether the first line of a text is the head of a comparison.csv of `optdock compare`."""
    return text.partition("\n")[0].startswith(",".join(_KEYS))


def comparison_chapter(name: str, text: str) -> Chapter:
    """Return the chapter of a comparison of paths; further numeric columns and kinds of paths are shown as well.

    Args:
        name: Name of the file.
        text: Text of the CSV file.

    Raises:
        InvalidFile: If a row has another number of cells than the head, or a cell is not a number.
    """
    head, *rows = csv.reader(io.StringIO(text))
    for number, row in enumerate(rows, start=2):
        if len(row) != len(head):
            raise InvalidFile(f"{name}:{number}: must have {len(head)} cells, got {len(row)}")
    values = [[_number(name, i, head, row, k) for k in range(len(_KEYS), len(head))] for i, row in enumerate(rows, 2)]
    scenarios = [*dict.fromkeys(row[0] for row in rows)]
    kinds = [*dict.fromkeys(row[1] for row in rows)]
    certified = sum(row[2] == "certified" for row in rows if row[1] != "raw")
    count = sum(row[1] != "raw" for row in rows)
    numbered = [
        (str(scenarios.index(row[0]) + 1), *row[:3], *("" if math.isnan(v) else f"{v:.4g}" for v in of))
        for row, of in zip(rows, values, strict=True)
    ]
    numbers = {"rows": [dict(zip(head, row, strict=True)) for row in rows]}
    summary = f"{len(scenarios)} scenarios, {certified} of {count} smoothed paths certified"
    grade, severity = ("good", 2.0) if certified == count else ("neutral", 1.5)

    def content() -> Content:
        table = Table("Paths", ("#", *_KEYS, *(" ".join(_title(column)) for column in head[3:])), numbered)
        found = {(row[0], row[1]): of for row, of in zip(rows, values, strict=True)}
        return Content([table, *_charts(head, found, scenarios, kinds)])

    return Chapter(name, "comparisons", "compared", grade, summary, content, numbers, (severity, 0.0))


def _number(name: str, line: int, head: Sequence[str], row: Sequence[str], column: int) -> float:
    try:
        return float(row[column]) if row[column] else math.nan
    except ValueError:
        raise InvalidFile(f"{name}:{line}: {head[column]}: must be a number, got {shown(row[column])}") from None


def _title(column: str) -> tuple[str, str]:
    """Return name and unit of a column."""
    name, _, suffix = column.rpartition("_")
    unit = _UNITS.get(suffix)
    return (column.replace("_", " "), "") if unit is None else (name.replace("_", " "), f"[{unit}]")


def _charts(
    head: Sequence[str],
    values: Mapping[tuple[str, str], Sequence[float]],
    scenarios: Sequence[str],
    kinds: Sequence[str],
) -> Iterator[Chart]:
    groups = scenarios[:_MOST_BARS]
    missing = [math.nan] * (len(head) - len(_KEYS))
    colours = dict(zip(_SERIES, kinds, strict=False))
    for k, column in enumerate(head[len(_KEYS) :]):
        bars = {colour: [values.get((one, kind), missing)[k] for one in groups] for colour, kind in colours.items()}
        name, unit = _title(column)
        figure = bar_figure([str(i) for i in range(1, len(groups) + 1)], bars, f"{name} {unit}".strip())
        means = []
        for colour, kind in colours.items():
            known = [value for value in bars[colour] if math.isfinite(value)]
            means.append(f"{kind}: mean {sum(known) / len(known):.4g} of {len(known)}" if known else f"{kind}: none")
        legend = [LegendEntry(kind, colour, "area") for colour, kind in colours.items()]
        yield Chart(name.capitalize(), f"{'; '.join(means)}; numbers of scenarios as in the table.", figure, legend)
