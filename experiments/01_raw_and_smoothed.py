"""Study 1: raw paths of four sources, smoothed by every smoother, and judged by the same certificate.

The raw paths are by OMPL (RRT-Connect on Reeds-Shepp curves), hybrid A*, a recorded drive (simulated, with noise) and
waypoints on lines. Every smoother smooths the same paths with its default parameters. `refused`: the smoother raises an
error. The rules are those of the certificate: clearance, curvature, curvature rate, motion along the heading (`slip`),
and the straight end before the dock. `optimum` is ipopt on the whole nonlinear program of CasadiSmoother, without its
linearizations, from the same start; its cost is a local optimum. It is solved for the paths of hybrid A* from the first
start of every dock, in at most 10 s.

    python experiments/01_raw_and_smoothed.py [--scale S] [--jobs N]
"""

from __future__ import annotations

import sys
import time
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from experiments.benchmarks.ipopt_reference import smooth_by_ipopt
from experiments.raw_paths import NEEDS_OMPL, SOURCES, has_ompl
from experiments.study_cases import DockCase, PathTask, dock_cases, maps_text, problem_for
from experiments.study_run import Report, bars, median_interval, run, share_text
from optdock.config import Scenario
from optdock.errors import OptdockError
from optdock.plotting.canvas import COLOURS, legend_below
from optdock.plugins.interfaces import Smoother
from optdock.plugins.registry import create_plugin
from optdock.reports.comparison import figures_of
from optdock.reports.report import table
from optdock.verification import certify_path

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from matplotlib.figure import Figure

    from optdock.model.path import Path
    from optdock.model.problem import DockingProblem
    from optdock.plugins.interfaces import SmoothingResult

RAW, OPTIMUM, OURS = "none, the raw path", "optimum", "CasadiSmoother"
SMOOTHERS = ("SimpleSmoother", "SavitzkyGolaySmoother", OURS)
OPTIMIZED = "hybrid A*"  # source whose paths ipopt smooths
RULES = ("clearance", "curvature", "curvature_rate", "slip", "final_straight")
HEAD = (
    "smoother", "certified", "refused",
    "breaks clearance", "breaks curvature", "breaks curvature rate", "breaks slip", "breaks final straight",
)  # fmt: skip
BUDGET, LONG = 2.0, 10.0  # [s] of CPU time, for smoothers and for ipopt
SIZE = (9.5, 6.4)


class Row(NamedTuple):
    """Figures of one path; those that do not exist are None."""

    scenario: str
    number: int
    source: str
    smoother: str
    status: str  # `certified`, `not certified` or the name of the error
    broken: str = ""  # rules, separated by spaces
    length: float | None = None  # [m]
    cusps: int | None = None
    max_curvature: float | None = None  # [1/m]
    margin: float | None = None  # [m]
    duration: float | None = None  # [s]
    cpu: float | None = None  # [ms]
    cost: float | None = None


def tasks(scale: float) -> list[PathTask]:
    """Return every case with every source."""
    sources = [name for name in SOURCES if name != "OMPL" or has_ompl()]
    return [PathTask(*case, source) for case in dock_cases(scale, 2) for source in sources]


def work(task: PathTask) -> Iterator[Row]:
    """Smooth the raw path of a task by every smoother."""
    task = PathTask(*task)
    problem = problem_for(DockCase(task.scenario, task.number))
    raw = SOURCES[task.source](problem, task.number)
    if raw is None:
        yield Row(*task, RAW, "no path")
        return
    yield measured(Row(*task, RAW, ""), raw, problem)
    for name in SMOOTHERS:
        plugin = create_plugin(Smoother, name)
        yield of_call(Row(*task, name, ""), problem, lambda plugin=plugin: plugin.smooth(raw, BUDGET, problem=problem))
    if task.source == OPTIMIZED and task.number == 0:
        yield of_call(Row(*task, OPTIMUM, ""), problem, lambda: smooth_by_ipopt(raw, LONG, problem))


def of_call(row: Row, problem: DockingProblem, call: Callable[[], SmoothingResult]) -> Row:
    """Return a row with the figures of the path that a call returns, its CPU time and its cost."""
    began = time.process_time()
    try:
        result = call()
    except OptdockError as error:
        return row._replace(status=type(error).__name__, cpu=1e3 * (time.process_time() - began))
    cpu = 1e3 * (time.process_time() - began)
    return measured(row, result.path, problem)._replace(cpu=cpu, cost=result.report.cost)


def measured(row: Row, path: Path, problem: DockingProblem) -> Row:
    """Return a row with the figures of a path."""
    figures = figures_of(Scenario(problem), "smoothed", path)
    kinds = {one.kind for one in certify_path(path, problem).violations}
    return row._replace(
        status=figures.status,
        broken=" ".join(sorted(kinds)),
        length=figures.length,
        cusps=figures.cusps,
        max_curvature=figures.max_curvature,
        margin=figures.margin,
        duration=figures.duration,
    )


def gaps(rows: Sequence[Row]) -> list[float]:
    """Return how much more than the optimum the paths of CasadiSmoother cost, where both are certified [%]."""
    best = {row[:3]: row for row in rows if row.smoother == OPTIMUM and row.status == "certified"}
    ours = [row for row in rows if row.smoother == OURS and row.status == "certified" and row[:3] in best]
    return [100.0 * (row.cost / cost - 1.0) for row in ours if row.cost is not None and (cost := best[row[:3]].cost)]


def chosen(rows: Sequence[Row], smoother: str, source: str = "") -> list[Row]:
    """Return the rows of a smoother, for which there is a raw path, of one source or of all."""
    return [
        row
        for row in rows
        if row.smoother == smoother and row.status != "no path" and row.source in (source or row.source,)
    ]


def report(rows: Sequence[Row]) -> Report:
    """Return the tables per smoother."""
    sources = list(dict.fromkeys(row.source for row in rows))
    lines = [HEAD]
    by_source = [("smoother", *(f"certified, {source}" for source in sources))]
    for name in (RAW, *SMOOTHERS, OPTIMUM):
        group = chosen(rows, name)
        paths = [row for row in group if row.length is not None]
        broken = [sum(rule in row.broken.split() for row in paths) for rule in RULES]
        shares = (share_text(count, len(paths)) for count in broken)
        lines.append((name, certified_text(group), str(len(group) - len(paths)), *shares))
        by_source.append((name, *(certified_text(chosen(rows, name, source)) for source in sources)))
    costs = [("smoother", "CPU ms, median", "length / raw, median", "duration s, median")]
    raw = {row[:3]: row for row in rows if row.smoother == RAW}
    for name in (*SMOOTHERS, OPTIMUM):
        paths = [row for row in chosen(rows, name) if row.length is not None]
        ratios = [row.length / length for row in paths if row.length and (length := raw[row[:3]].length)]
        columns = ([row.cpu for row in paths], ratios, [row.duration for row in paths])
        costs.append((name, *(interval([v for v in values if v is not None]) for values in columns)))
    without = sum(row.status == "no path" for row in rows)
    gap = gaps(rows)
    ours, nav2 = chosen(rows, OURS), [row for name in SMOOTHERS[:2] for row in chosen(rows, name)]
    closing = (
        f"CasadiSmoother makes certified paths of {certified_text(ours)} raw paths and Nav2's "
        f"smoothers of {certified_text(nav2)}; its paths cost {interval(gap)} % more than "
        f"ipopt's optimum ({max(gap, default=0.0):.2g} % at most)."
    )
    notes = f"{maps_text()} {without} raw paths were not found." + ("" if has_ompl() else f"\n{NEEDS_OMPL}.")
    tables = "\n\n".join(map(table, (lines, by_source, costs)))
    return Report(f"{notes}\n\n{tables}", closing)


def certified_text(rows: Sequence[Row]) -> str:
    """Return the share of certified paths."""
    return share_text(sum(row.status == "certified" for row in rows), len(rows))


def interval(values: Sequence[float]) -> str:
    """Return a median with its interval."""
    middle, low, high = median_interval(values)
    return f"{middle:.3g} ({low:.3g} to {high:.3g})"


def draw(figure: Figure, rows: Sequence[Row]) -> None:
    """Draw certified shares per source, broken rules per smoother, and the distance from the optimum."""
    grid = figure.add_gridspec(2, 2)
    left, right, below = figure.add_subplot(grid[:, 0]), figure.add_subplot(grid[0, 1]), figure.add_subplot(grid[1, 1])
    colours = dict(
        zip((RAW, *SMOOTHERS), (COLOURS["limit"], COLOURS["goal"], COLOURS["raw"], COLOURS["path"]), strict=True)
    )
    sources = list(dict.fromkeys(row.source for row in rows))
    for k, (name, colour) in enumerate(colours.items()):
        groups = [chosen(rows, name, source) for source in sources]
        counts = [(sum(row.status == "certified" for row in group), len(group)) for group in groups]
        bars(left, sources, counts, offset=0.2 * (k - 1.5), height=0.19, color=colour, label=name)
        paths = [row for row in chosen(rows, name) if row.length is not None]
        broken = [(sum(rule in row.broken.split() for row in paths), len(paths)) for rule in RULES]
        bars(
            right, [rule.replace("_", " ") for rule in RULES], broken, offset=0.2 * (k - 1.5), height=0.19, color=colour
        )
    left.set_xlabel("paths that are certified, %")
    legend_below(figure, left)
    right.set_xlabel("returned paths that break the rule, %")
    gap = np.sort(gaps(rows))
    below.step(gap, 100.0 * np.arange(1, len(gap) + 1) / max(1, len(gap)), where="post", color=COLOURS["path"])
    below.set_xlabel(f"cost above ipopt's optimum, % (n = {len(gap)})")
    below.set_ylabel("share of paths, %")
    if gap.size and np.ptp(gap) > 1.0:
        below.set_xscale("symlog", linthresh=0.1)
    below.grid(alpha=0.25)


if __name__ == "__main__":
    sys.exit(run(__file__))
