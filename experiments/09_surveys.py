"""Study 9: from where a robot can dock, on the maps of this project and on Nav2's maps if they are present.

`optdock survey` answers a grid of start poses around the dock of every scenario of `experiments.real_maps`: certified
motion, proof that no motion exists, or not found. Counted are the poses at which the robot overlaps no obstacle.

    python experiments/09_surveys.py [--scale S] [--jobs N]
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from experiments.study_cases import BAY, DockCase, dock_cases, problem_for
from experiments.study_run import Report, run
from optdock.config import Scenario, save_scenario
from optdock.plotting.canvas import COLOURS
from optdock.reports.report import table

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from matplotlib.figure import Figure

WITHIN, HEADINGS = 3.0, 8  # [m] around the dock
FINE, COARSE = 0.5, 1.0  # [m] between positions, at full scale and at small scales
PROGRAM = "from optdock.cli import main; main()"
VERDICTS = {"certified": "path", "impossible": "goal", "not_found": "limit"}
SIZE = (8.0, 5.0)


class Task(NamedTuple):
    """A scenario, and the distance between positions [m]."""

    scenario: str
    resolution: float


class Row(NamedTuple):
    """Survey of one dock: numbers of free poses by verdict, share of the floor, durations, questions, CPU time [s]."""

    scenario: str
    free: int
    certified: int
    impossible: int
    not_found: int
    floor: float
    p50: float | None
    p95: float | None
    asked: int
    cpu: float


def tasks(scale: float) -> list[Task]:
    """Return every dock of the maps; the grid becomes finer with the scale."""
    resolution = float(np.clip(FINE / np.sqrt(scale), FINE, COARSE))
    return [Task(case.scenario, resolution) for case in dock_cases(1.0, 1) if case.scenario != BAY]


def work(task: Task) -> Iterator[Row]:
    """Survey one dock by the command."""
    name, resolution = task
    with tempfile.TemporaryDirectory() as folder:
        source, out = Path(folder) / "scenario.yaml", Path(folder) / "survey"
        save_scenario(source, Scenario(problem_for(DockCase(name, 0))))
        options = {"within": WITHIN, "resolution": resolution, "headings": HEADINGS, "jobs": 1, "out": out}
        words = [word for key, value in options.items() for word in (f"--{key}", str(value))]
        command = [sys.executable, "-c", PROGRAM, "survey", str(source), *words]
        done = subprocess.run(command, check=False, capture_output=True, text=True)
        if done.returncode:
            raise RuntimeError(done.stderr.strip().splitlines()[-1])
        (found,) = json.loads((out / "survey.json").read_text(encoding="utf-8"))["docks"]
    keys = ("free", "certified", "impossible", "not_found", "floor", "p50", "p95", "asked", "cpu_seconds")
    yield Row(name, *(found[key] for key in keys))


def report(rows: Sequence[Row]) -> Report:
    """Return one line per dock, and the totals."""
    lines = [("dock", "free poses", "certified %", "impossible %", "not found %", "floor %", "p50 s", "p95 s", "CPU s")]
    for row in sorted(rows, key=lambda row: -row.certified / max(1, row.free)):
        shares = (percent(count, row.free) for count in (row.certified, row.impossible, row.not_found))
        times = ("-" if value is None else f"{value:.1f}" for value in (row.p50, row.p95))
        lines.append((row.scenario, str(row.free), *shares, f"{100.0 * row.floor:.1f}", *times, f"{row.cpu:.0f}"))
    free, (certified, impossible, lost) = sum(row.free for row in rows), totals(rows)
    asked = sum(row.asked for row in rows)
    closing = (
        f"Of {free:,} free start poses within {WITHIN:g} m of {len(rows)} docks, {percent(certified, free)} % have a "
        f"certified motion, {percent(impossible, free)} % are proven impossible and {percent(lost, free)} % have "
        f"neither; {asked:,} poses were asked, and their answers cover the others."
    )
    return Report(table(lines), closing)


def percent(count: int, total: int) -> str:
    """Return a share in percent."""
    return f"{100.0 * count / max(1, total):.1f}"


def totals(rows: Sequence[Row]) -> tuple[int, int, int]:
    """Return the numbers of certified, impossible and not found poses."""
    return sum(row.certified for row in rows), sum(row.impossible for row in rows), sum(row.not_found for row in rows)


def draw(figure: Figure, rows: Sequence[Row]) -> None:
    """Draw the shares of the verdicts of every dock."""
    axes = figure.subplots()
    ordered = sorted(rows, key=lambda row: -row.certified / max(1, row.free))
    left = np.zeros(len(ordered))
    for verdict, colour in VERDICTS.items():
        shares = np.array([100.0 * getattr(row, verdict) / max(1, row.free) for row in ordered])
        axes.barh(range(len(ordered)), shares, left=left, color=COLOURS[colour], label=verdict.replace("_", " "))
        left += shares
    axes.set_yticks(range(len(ordered)), [row.scenario for row in ordered], fontsize=7)
    axes.set_ylim(len(ordered) - 0.4, -0.6)
    axes.set_xlim(0.0, 100.0)
    axes.set_xlabel(f"share of the free start poses within {WITHIN:g} m, %")
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=8, frameon=False)


if __name__ == "__main__":
    sys.exit(run(__file__))
