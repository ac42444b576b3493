"""Frame of the numbered studies: tasks by scale, the runner, results and a chart as files.

A study is a module with a docstring (its legend), a named tuple `Row`, and four functions: `tasks(scale)`,
`work(task)`, which yields rows, `report(rows)`, and `draw(figure, rows)`. Tasks and rows consist of plain values.
Time budgets use the counted clock, with which the rows do not depend on the machine, or the CPU clock in studies with
`CLOCK = "cpu"`, which are about CPU time. Neither depends on the load of the machine.
"""

from __future__ import annotations

import argparse
import csv
import importlib
import math
import os
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from optdock.cli.common import working
from optdock.io.atomic_file import replacing, write_text
from optdock.plotting.canvas import new_figure, save_figure
from optdock.runner import Case, Workers, run_cases

if TYPE_CHECKING:
    from collections.abc import Sequence
    from types import ModuleType

    from matplotlib.axes import Axes

__all__ = [
    "Exponent",
    "Report",
    "bars",
    "median_interval",
    "power_law",
    "run",
    "scaled",
    "share_interval",
    "share_text",
    "worked",
]

INTERVALS = "Intervals in parentheses are of 95 % and treat the rows as independent."
_SIGMAS = 1.959964  # of a normal distribution, two-sided 95 %
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


class Report(NamedTuple):
    """Tables of a study, the sentence that follows from them, and whether the rows contradict a law of the library."""

    tables: str
    closing: str
    is_sound: bool = True


def run(script: str, arguments: Sequence[str] | None = None) -> int:
    """Run the study of a script; return 0 if its rows contradict no law of the library.

    The results are written to results/STEM/: rows.csv, study.md, chart.png and chart.svg.
    """
    stem, folder = Path(script).stem, Path(script).resolve().parent
    # Python puts the folder of a script first, where `experiments/mujoco` would hide the package mujoco.
    sys.path[:] = [place for place in sys.path if Path(place).resolve() != folder]
    for name in _THREADS:
        os.environ.setdefault(name, "1")
    study = importlib.import_module(f"experiments.{stem}")
    parser = argparse.ArgumentParser(
        prog=f"{stem}.py", description=study.__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scale", type=float, default=1.0, help="share of the usual number of cases (default: 1)")
    parser.add_argument("--jobs", type=int, default=1, help="number of processes (default: %(default)s)")
    parser.add_argument("--scheduler", help="address of a dask scheduler, instead of processes of this machine")
    parser.add_argument("--out", type=Path, default=Path("results") / stem, help="folder (default: %(default)s)")
    options = parser.parse_args(arguments)
    began = time.monotonic()
    workers = Workers(
        None if options.scheduler else options.jobs, options.scheduler, getattr(study, "CLOCK", "counted")
    )
    rows = _rows_of(study, list(study.tasks(options.scale)), workers)
    report = study.report(rows)
    text = f"{study.__doc__.strip()}\n\n{INTERVALS}\n\n{report.tables}\n\n{report.closing}\n"
    options.out.mkdir(parents=True, exist_ok=True)
    _write_rows(options.out / "rows.csv", rows)
    write_text(options.out / "study.md", text)
    figure = new_figure(*getattr(study, "SIZE", (8.0, 4.5)))
    study.draw(figure, rows)
    for suffix in ("png", "svg"):
        save_figure(figure, options.out / f"chart.{suffix}")
    print(text)
    print(f"{len(rows)} rows in {time.monotonic() - began:.0f} s; rows, text and chart are in {options.out}")
    return 0 if report.is_sound else 1


def _rows_of(study: ModuleType, tasks: list[Any], workers: Workers) -> list[Any]:
    """Return the rows of all tasks, in the order of the tasks.

    Raises:
        RuntimeError: If a task fails.
    """
    rows: list[Any] = []
    cases = [Case(f"{number}", (study.__name__, tuple(task))) for number, task in enumerate(tasks)]
    with working(study.__name__, len(cases)) as advance, workers:
        for outcome in run_cases(worked, cases, workers=workers, progress=advance):
            if outcome.error:
                raise RuntimeError(f"{study.__name__}, {tasks[int(outcome.key)]}: {outcome.error}")
            rows += [study.Row(*row) for row in outcome.value]
    return rows


def worked(name: str, task: tuple[Any, ...]) -> list[Any]:
    """Return the rows of one task of a study, in a worker."""
    return list(importlib.import_module(name).work(task))


def _write_rows(target: Path, rows: Sequence[Any]) -> None:
    with replacing(target) as temporary, Path(temporary).open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        if rows:
            writer.writerow(type(rows[0])._fields)
        writer.writerows(rows)


def scaled(scale: float, usual: int, least: int = 1) -> int:
    """Return a number of cases at a scale."""
    return max(least, round(scale * usual))


def share_interval(count: int, total: int) -> tuple[float, float]:
    """Return Wilson's score interval of a share; (0, 1) without cases.

    >>> [round(end, 3) for end in share_interval(0, 10)]
    [0.0, 0.278]
    """
    if total == 0:
        return 0.0, 1.0
    share, z = count / total, _SIGMAS**2 / total
    middle, half = share + 0.5 * z, _SIGMAS * math.sqrt(share * (1.0 - share) / total + 0.25 * z / total)
    return max(0.0, (middle - half) / (1.0 + z)), min(1.0, (middle + half) / (1.0 + z))


def share_text(count: int, total: int) -> str:
    """Return a count with the percentages of its interval, such as `3/10 (10.8-60.3 %)`."""
    low, high = share_interval(count, total)
    return f"{count}/{total} ({100.0 * low:.1f}-{100.0 * high:.1f} %)" if total else "-"


def median_interval(values: Sequence[float]) -> tuple[float, float, float]:
    """Return a median and its distribution-free interval, between two order statistics; NaN without values.

    Fewer than six values have no such interval; their range is returned.
    """
    from scipy.stats import binom

    ordered = np.sort(np.asarray(values, dtype=np.float64))
    if not ordered.size:
        return math.nan, math.nan, math.nan
    below = int(binom.ppf(0.025, ordered.size, 0.5))
    return (
        float(np.median(ordered)),
        float(ordered[max(0, below - 1)]),
        float(ordered[min(ordered.size, ordered.size - below + 1) - 1]),
    )


class Exponent(NamedTuple):
    """Exponent of a power law with its interval, and the factor."""

    value: float
    low: float
    high: float
    factor: float

    def __str__(self) -> str:
        return f"{self.value:.2f} ({self.low:.2f} to {self.high:.2f})"


def power_law(x: Sequence[float], y: Sequence[float]) -> Exponent:
    """Fit y = factor * x^exponent by least squares of the logarithms, with Student's interval of the exponent.

    >>> power_law([1.0, 2.0, 4.0, 8.0], [3.0, 12.0, 48.0, 192.0]).value
    2.0
    """
    from scipy.stats import linregress, t

    fit = linregress(np.log(x), np.log(y))
    half = float(t.ppf(0.975, max(1, len(x) - 2))) * fit.stderr
    return Exponent(round(float(fit.slope), 9), fit.slope - half, fit.slope + half, math.exp(fit.intercept))


def bars(axes: Axes, names: Sequence[str], counts: Sequence[tuple[int, int]], **style: float | str) -> None:
    """Draw shares in percent as horizontal bars with their intervals, the first on top.

    Args:
        axes: Axes.
        names: Labels.
        counts: Count and total of every bar.
        **style: Keyword arguments of `Axes.barh`; `offset` moves the bars, for several bars per label.
    """
    at = np.arange(len(names), dtype=np.float64) + style.pop("offset", 0.0)
    shares = np.array([count / total if total else math.nan for count, total in counts])
    ends = np.array([share_interval(*pair) for pair in counts])
    errors = 100.0 * np.abs(ends - shares[:, None]).T
    axes.barh(at, 100.0 * shares, xerr=errors, error_kw={"elinewidth": 1.0, "capsize": 2.0}, **style)
    axes.set_yticks(range(len(names)), names)
    axes.set_ylim(len(names) - 0.4, -0.6)
    axes.set_xlim(0.0, 104.0)
