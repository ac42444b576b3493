"""Tables of numbers on standard output, and a reference workload for comparing runs on different machines."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["Table", "Timer", "fixed_work", "percentile", "yardstick"]


@dataclass(frozen=True)
class Table:
    """A titled table; `note` describes the measurement."""

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[object, ...], ...]
    note: str = ""

    def __str__(self) -> str:
        cells = [[_text(value) for value in row] for row in self.rows]
        widths = [max(map(len, column)) for column in zip(self.header, *cells, strict=True)]
        lines = [
            "  ".join(_aligned(i, text, width) for i, (text, width) in enumerate(zip(row, widths, strict=True)))
            for row in (self.header, *cells)
        ]
        rule = "-" * len(lines[0])
        return "\n".join((f"\n## {self.title}", *((self.note,) if self.note else ()), lines[0], rule, *lines[1:]))

    def as_dict(self) -> dict[str, object]:
        """Return plain values for a JSON file."""
        rows = [dict(zip(self.header, map(_plain, row), strict=True)) for row in self.rows]
        return {"title": self.title, "note": self.note, "rows": rows}


def _aligned(column: int, text: str, width: int) -> str:
    return text.ljust(width) if column == 0 else text.rjust(width)


def _text(value: object) -> str:
    if not isinstance(value, float):
        return str(value) or "-"
    if not math.isfinite(value):
        return "-"
    return f"{value:.0f}" if abs(value) >= 1000.0 else f"{value:.3g}"


def _plain(value: object) -> object:
    return None if isinstance(value, float) and not math.isfinite(value) else value


def percentile(values: Sequence[float], share: float) -> float:
    """Return the smallest value not exceeded by at least `share` percent of the finite values; NaN without values."""
    finite = [value for value in values if math.isfinite(value)]
    return float(np.percentile(finite, share, method="inverted_cdf")) if finite else math.nan


class Timer:
    """Wall and CPU seconds since construction."""

    def __init__(self) -> None:
        self._wall, self._cpu = time.perf_counter(), time.process_time()

    @property
    def wall(self) -> float:
        """Wall-clock seconds."""
        return time.perf_counter() - self._wall

    @property
    def cpu(self) -> float:
        """CPU seconds of this process."""
        return time.process_time() - self._cpu


def yardstick() -> float:
    """Return the CPU seconds of `fixed_work`; the median of 15 runs."""
    seconds = []
    for _ in range(15):
        timer = Timer()
        fixed_work()
        seconds.append(timer.cpu)
    return float(np.median(seconds))


def fixed_work() -> None:
    """Run a constant workload of a few milliseconds: small arrays and a small factorization."""
    points = np.linspace(0.0, 1.0, 160)
    matrix = np.eye(40) + 0.01 * np.cos(np.outer(np.arange(40), np.arange(40)))
    for _ in range(100):
        points = np.cumsum(np.cos(points)) / 160.0
        matrix = 0.5 * (matrix + np.linalg.inv(matrix))
