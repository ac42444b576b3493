"""MkDocs hook for tables on narrow screens: labels every cell with its column, so that CSS can show rows as cards."""

from __future__ import annotations

import re
from itertools import count

__all__ = ["on_page_content"]

_TABLE = re.compile(r"<table>.*?</table>", re.DOTALL)
_ROW = re.compile(r"<tr>.*?</tr>", re.DOTALL)


def on_page_content(html: str, **_: object) -> str:
    """MkDocs hook: label the cells."""
    return _TABLE.sub(lambda table: _labelled(table[0]), html)


def _labelled(table: str) -> str:
    names = [re.sub(r"<[^>]+>", "", name) for name in re.findall(r"<th[^>]*>(.*?)</th>", table, re.DOTALL)]
    return _ROW.sub(lambda row: _row(row[0], names), table)


def _row(row: str, names: list[str]) -> str:
    number = count()
    return re.sub(r"<td(?=[ >])", lambda _: f'<td data-label="{names[next(number)]}"', row)
