"""Study 4: share of dockings with a certified plan, and price of the plans, over the time budget of the call.

`plan_dock` is called anew for every budget, in a process that has planned before. The price is the duration of the plan
with the additional costs of cusps and of driving in reverse; it is compared with the price at the longest budget.
Budgets count CPU time.

    python experiments/04_budgets.py [--scale S] [--jobs N]
"""

from __future__ import annotations

import sys
import time
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from experiments.study_cases import DockCase, dock_cases, maps_text, problem_for
from experiments.study_run import Report, median_interval, run, share_interval, share_text
from optdock.errors import NoMotionExists, OptdockError, TimedOut
from optdock.planning.pipeline import plan_dock
from optdock.plotting.canvas import COLOURS
from optdock.reports.report import table

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from matplotlib.figure import Figure

BUDGETS = (0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 3.0)  # [s]
CLOCK = "cpu"
SIZE = (9.0, 3.8)


class Row(NamedTuple):
    """Result of one call: `certified`, `timed out`, `impossible` or the name of the error; price [s], CPU time [ms]."""

    scenario: str
    number: int
    budget: float
    status: str
    price: float | None
    cpu: float


def tasks(scale: float) -> list[DockCase]:
    """Return the cases."""
    return dock_cases(scale, 4)


def work(task: DockCase) -> Iterator[Row]:
    """Plan with every budget."""
    for budget in BUDGETS:
        problem, began, price = problem_for(DockCase(*task)), time.process_time(), None
        try:
            plan = plan_dock(problem, time_budget=budget)
            status, price = "certified", plan.price
        except OptdockError as error:
            status = "timed out" if isinstance(error, TimedOut) else type(error).__name__
            status = "impossible" if isinstance(error, NoMotionExists) else status
        yield Row(*task, budget, status, price, 1e3 * (time.process_time() - began))


def ratios(rows: Sequence[Row], budget: float) -> list[float]:
    """Return the prices at a budget, divided by the prices at the longest budget."""
    last = {row[:2]: row.price for row in rows if row.budget == BUDGETS[-1]}
    group = [row for row in rows if row.budget == budget and row.price is not None]
    return [row.price / final for row in group if row.price is not None and (final := last.get(row[:2])) is not None]


def possible(rows: Sequence[Row], budget: float) -> list[Row]:
    """Return the rows of a budget without the cases that are proven to be impossible."""
    without = {row[:2] for row in rows if row.status == "impossible"}
    return [row for row in rows if row.budget == budget and row[:2] not in without]


def report(rows: Sequence[Row]) -> Report:
    """Return one line per budget."""
    lines = [("budget, ms", "certified in this CPU time", "timed out", "price / final, median", "price / final, p95")]
    for budget in BUDGETS:
        group, prices = possible(rows, budget), ratios(rows, budget)
        certified = sum(row.status == "certified" for row in group)
        middle, low, high = median_interval(prices)
        spread = "-", "-"
        if prices:
            spread = f"{middle:.3f} ({low:.3f} to {high:.3f})", f"{np.percentile(prices, 95):.2f}"
        timed_out = sum(row.status == "timed out" for row in group)
        lines.append((f"{1e3 * budget:g}", share_text(certified, len(group)), str(timed_out), *spread))
    last = possible(rows, BUDGETS[-1])
    enough = next(
        (b for b in BUDGETS if certified_share(rows, b) >= 0.95 * certified_share(rows, BUDGETS[-1])), BUDGETS[-1]
    )
    closing = (
        f"{1e3 * enough:g} ms of CPU time give at least 95 % of the plans that {BUDGETS[-1]:g} s give "
        f"({share_text(sum(row.status == 'certified' for row in last), len(last))}), at "
        f"{median_interval(ratios(rows, enough))[0]:.2f} times their price in the median."
    )
    impossible = len({row[:2] for row in rows if row.status == "impossible"})
    notes = f"{maps_text()} Without {impossible} cases that are proven to be impossible."
    return Report(f"{notes}\n\n{table(lines)}", closing)


def certified_share(rows: Sequence[Row], budget: float) -> float:
    """Return the share of the possible cases that are certified."""
    group = possible(rows, budget)
    return sum(row.status == "certified" for row in group) / max(1, len(group))


def draw(figure: Figure, rows: Sequence[Row]) -> None:
    """Draw both curves over the budget."""
    left, right = figure.subplots(1, 2)
    budgets = [1e3 * budget for budget in BUDGETS]
    counts = [(sum(row.status == "certified" for row in possible(rows, b)), len(possible(rows, b))) for b in BUDGETS]
    shares = [share_interval(*pair) for pair in counts]
    left.plot(budgets, [100.0 * certified_share(rows, b) for b in BUDGETS], "o-", color=COLOURS["path"])
    left.fill_between(
        budgets, *(100.0 * end for end in map(np.array, zip(*shares, strict=True))), alpha=0.25, color=COLOURS["path"]
    )
    left.set_ylabel(f"dockings with a certified plan, % (n = {counts[-1][1]})")
    left.set_ylim(0.0, 102.0)
    prices = [ratios(rows, budget) for budget in BUDGETS]
    middles = np.array([median_interval(values) for values in prices])
    right.plot(budgets, middles[:, 0], "o-", color=COLOURS["path"], label="median")
    right.fill_between(budgets, middles[:, 1], middles[:, 2], alpha=0.25, color=COLOURS["path"])
    p95 = [np.percentile(values, 95) if values else np.nan for values in prices]
    right.plot(budgets, p95, "s--", color=COLOURS["goal"], label="95th percentile")
    right.set_ylabel(f"price / price at {BUDGETS[-1]:g} s")
    right.legend(fontsize=8)
    for axes in (left, right):
        axes.set_xscale("log")
        axes.xaxis.set_major_formatter("{x:g}")
        axes.set_xlabel("time budget, ms of CPU time")
        axes.grid(alpha=0.25)


if __name__ == "__main__":
    sys.exit(run(__file__))
