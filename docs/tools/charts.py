"""Charts of docs/benchmark.md, drawn from its tables: `python docs/tools/charts.py`.

Each chart is written for light and for dark pages, as SVG into `docs/assets/`. A chart contains a digest of its table;
a test compares it with the digest of the table on the page.
"""

from __future__ import annotations

import hashlib
import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib as mpl
from figures import _INK, ASSETS
from matplotlib.figure import Figure

from optdock.plotting.canvas import COLOURS

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PAGE = Path(__file__).resolve().parents[1] / "benchmark.md"
_PARTS = {"before", "oblique", "beside or behind"}  # subsets of the row above them


def rows_of(command: str) -> list[dict[str, str]]:
    """Return the table below the marker of a command, as one dict per row with the column names as keys."""
    text = PAGE.read_text(encoding="utf-8").split(f"<!-- measured: {command} -->", 1)[1]
    lines = text.lstrip().split("\n\n", 1)[0].splitlines()
    head, _, *rows = ([cell.strip() for cell in line.strip("|").split("|")] for line in lines)
    return [dict(zip(head, row, strict=True)) for row in rows]


def digest_of(command: str) -> str:
    """Return a digest of the table of a command."""
    return hashlib.sha256(repr(rows_of(command)).encode()).hexdigest()[:16]


def draw_calls(axes: Axes, rows: list[dict[str, str]]) -> None:
    """Draw the CPU time of whole calls by family: median, 90th and 99th percentile."""
    rows = [row for row in rows if row["cases"] not in _PARTS]
    for y, row in enumerate(reversed(rows)):
        p50, p90, p99 = (float(row[f"CPU ms {name}"]) for name in ("p50", "p90", "p99"))
        axes.plot([p50, p99], [y, y], color=COLOURS["limit"], linewidth=1.2, zorder=1)
        axes.plot([p50, p90], [y, y], color=COLOURS["path"], linewidth=3.0, solid_capstyle="butt", zorder=2)
        axes.plot([p50], [y], "o", color=COLOURS["path"], markersize=5, zorder=3)
        axes.plot([p99], [y], "|", color=COLOURS["limit"], markersize=7, markeredgewidth=1.5, zorder=3)
        ends = [f"{row[name]} {name}" for name in ("certified", "impossible", "not found") if row[name] != "0"]
        axes.annotate(", ".join(ends), (1.01, y), xycoords=("axes fraction", "data"), va="center", fontsize=7.5)
    axes.set_yticks(range(len(rows)), [row["cases"] for row in reversed(rows)])
    axes.set_xscale("log")
    axes.xaxis.set_major_formatter("{x:g}")
    axes.set_xlabel("CPU time of a whole call [ms]: p50, p90 (thick), p99 (thin)")
    axes.grid(axis="x", alpha=0.25)


def draw_contact(axes: Axes, rows: list[dict[str, str]]) -> None:
    """Draw the lateral error at contact by method, plate, with lag and noise: median, 95th percentile and maximum."""
    rows = [row for row in rows if row["station"] == "plate" and row["world"] == "late, noisy"]
    for y, row in enumerate(reversed(rows)):
        p50, p95, most = (float(value) for value in row["across, mm"].split("/"))
        axes.plot([p50, most], [y, y], color=COLOURS["limit"], linewidth=1.2, zorder=1)
        axes.plot([p50, p95], [y, y], color=COLOURS["path"], linewidth=3.0, solid_capstyle="butt", zorder=2)
        axes.plot([p50], [y], "o", color=COLOURS["path"], markersize=5, zorder=3)
        axes.plot([most], [y], "|", color=COLOURS["limit"], markersize=7, markeredgewidth=1.5, zorder=3)
        force = row["peak force, N"].split("/")[1].strip()
        label = f"{row['docked']} docked, {force} N at p95"
        axes.annotate(label, (1.01, y), xycoords=("axes fraction", "data"), va="center", fontsize=7.5)
    axes.set_yticks(range(len(rows)), [row["method"] for row in reversed(rows)])
    axes.set_ylim(-0.6, len(rows) - 0.4)
    axes.set_xlim(0.0, None)
    axes.set_xlabel("error across at contact [mm]: p50, p95 (thick), largest (thin)")
    axes.grid(axis="x", alpha=0.25)


def shares_of(text: str) -> tuple[float, float, float]:
    """Return a share and the ends of its interval in percent, from a text such as `3/10 (10.8-60.3 %)`."""
    count, total, low, high = map(float, re.findall(r"[\d.]+", text))
    return 100.0 * count / total, low, high


def draw_dockings(axes: Axes, rows: list[dict[str, str]]) -> None:
    """Draw the share of good dockings of every world, method and distribution of starts, with its interval."""
    for y, row in enumerate(reversed(rows)):
        middle, low, high = shares_of(row["good"])
        colour = COLOURS["path" if row["method"] == "executor" else "goal"]
        axes.plot([low, high], [y, y], color=colour, linewidth=1.2)
        axes.plot([middle], [y], "o", color=colour, markersize=4)
    names = [f"{row['world']}: {row['method']}, {row['starts']} starts" for row in reversed(rows)]
    axes.set_yticks(range(len(rows)), names)
    axes.set_xlim(-1.0, 101.0)
    axes.set_xlabel("good dockings [%], 95 % interval")
    axes.grid(axis="x", alpha=0.25)


def draw_budgets(axes: Axes, rows: list[dict[str, str]]) -> None:
    """Draw the share of certified calls over the time budget, with its interval."""
    budgets = [float(row["budget, ms"]) for row in rows]
    middle, low, high = zip(*(shares_of(row["certified in this CPU time"]) for row in rows), strict=True)
    axes.fill_between(budgets, low, high, color=COLOURS["path"], alpha=0.25, linewidth=0)
    axes.plot(budgets, middle, "o-", color=COLOURS["path"], markersize=4)
    axes.set_xscale("log")
    axes.xaxis.set_major_formatter("{x:g}")
    axes.set_xlabel("time budget [ms of CPU time], with 95 % intervals")
    axes.set_ylabel("certified [%]")
    axes.set_ylim(0.0, 102.0)
    axes.grid(alpha=0.25)


def draw_successes(axes: Axes, rows: list[dict[str, str]]) -> None:
    """Draw the shares of the reported successes that break a rule, by smoother, with their intervals."""
    faults = {"too sharp": "goal", "too close": "raw", "collides": "hot"}
    for k, (fault, colour) in enumerate(faults.items()):
        for y, row in enumerate(reversed(rows)):
            middle, low, high = shares_of(row[fault])
            at = y + 0.25 * (1 - k)
            axes.plot([low, high], [at, at], color=COLOURS[colour], linewidth=1.2)
            axes.plot([middle], [at], "o", color=COLOURS[colour], markersize=4, label=fault if y == 0 else None)
    axes.set_yticks(range(len(rows)), [row["smoother"] for row in reversed(rows)])
    axes.set_xlim(-0.5, None)
    axes.set_xlabel("share of the reported successes [%], 95 % interval")
    axes.grid(axis="x", alpha=0.25)
    axes.legend(fontsize=7.5, loc="lower right", frameon=False)


CHARTS = {
    "budgets": (draw_budgets, "python experiments/04_budgets.py", 2.2),
    "dockings": (draw_dockings, "python experiments/02_docking.py", 2.4),
    "successes": (draw_successes, "python experiments/08_successes_refuted.py", 2.4),
    "calls": (draw_calls, "python -m experiments.manoeuvres", 4.2),
    "contact": (draw_contact, "python experiments/05_contact_forces.py", 1.7),
}
"""Drawing function, command of the table, and height [inch]."""


def save(name: str, scheme: str) -> Path:
    """Draw one chart for one colour scheme of the pages."""
    draw, command, height = CHARTS[name]
    ink = _INK[scheme]
    style = {f"{part}.color": ink for part in ("text", "xtick", "ytick")}
    style |= {"axes.edgecolor": ink, "axes.labelcolor": ink, "svg.hashsalt": "optdock", "font.size": 8.5}
    style |= {"axes.spines.top": False, "axes.spines.right": False, "axes.facecolor": "none"}
    with mpl.rc_context(style):
        figure = Figure(figsize=(6.8, height), layout="constrained")
        draw(figure.subplots(), rows_of(command))
        target = ASSETS / f"{name}-{scheme}.svg"
        metadata = {"Date": None, "Creator": None, "Description": f"table {digest_of(command)}"}
        figure.savefig(target, transparent=True, metadata=metadata)
    return target


def main() -> None:
    """Draw all charts."""
    for name in CHARTS:
        for scheme in _INK:
            target = save(name, scheme)
            sys.stdout.write(f"{target.name} {target.stat().st_size / 1e3:.0f} kB\n")


if __name__ == "__main__":
    main()
