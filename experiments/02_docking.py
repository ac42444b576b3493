"""Study 2: docking a robot with the errors of real robots, by the executor and by the docking law of Nav2's server.

The plant and the sensors are those of `experiments/docking/field`, which share no code with `optdock.simulation`: wheel
errors, slip, late and lost commands, a drifting and jumping localization, a camera with delays and outliers, and a
stored dock pose with an error of up to 10 cm and 5 degrees. Every docking has its own seed for the start, the errors of
the robot and all noise; both methods get the same seeds. The starts are those that Nav2's goal checker accepts, and for
the executor also wider ones. `good`: reported as docked, and at rest one second later within 10 mm along, 10 mm across
and 1.5 degrees of the true dock. `false`: reported as docked, but not good.

    python experiments/02_docking.py [--scale S] [--jobs N]
"""

from __future__ import annotations

import math
import sys
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from experiments.docking.field.outcome import FieldTask
from experiments.docking.field.run import driven_in_field
from experiments.study_run import Report, bars, median_interval, run, scaled, share_text
from optdock.plotting.canvas import COLOURS
from optdock.reports.report import table

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from matplotlib.figure import Figure

WORLDS = ("field", "field, outliers", "field, dead band")
METHODS = (("Nav2's law", "nav2"), ("executor", "nav2"), ("executor", "wider"))
RATE, FIRST_SEED = 50.0, 20_000_000  # [Hz]; other seeds than those of `python -m experiments.docking`
COLUMNS = {
    "across, mm, median": "cross",
    "yaw, degrees, median": "yaw",
    "along, mm, median": "along",
    "time, s, median": "duration",
}
SIZE = (10.0, 3.8)


class Row(NamedTuple):
    """Outcome of one docking; errors relative to the true dock [mm], [degrees], time [s]."""

    world: str
    method: str
    spread: str
    seed: int
    ending: str
    is_docked: bool
    is_good: bool
    has_collided: bool
    along: float
    cross: float
    yaw: float
    duration: float


def tasks(scale: float) -> list[FieldTask]:
    """Return every method in every world; the first world has four times as many dockings as the others."""
    return [
        FieldTask(method, world, spread, RATE, FIRST_SEED + number)
        for world in WORLDS
        for method, spread in METHODS
        for number in range(scaled(scale, 50 if world == WORLDS[0] else 12))
    ]


def work(task: FieldTask) -> Iterator[Row]:
    """Dock once."""
    task = FieldTask(*task)
    found = driven_in_field(task)
    errors = 1e3 * abs(found.along), 1e3 * abs(found.cross), math.degrees(abs(found.yaw))
    flags = found.docked, found.good, found.collided
    yield Row(task.world, task.method, task.spread, task.seed, found.ending, *flags, *errors, found.duration)


def groups(rows: Sequence[Row]) -> dict[tuple[str, str, str], list[Row]]:
    """Return the rows of every world, method and distribution of starts."""
    found: dict[tuple[str, str, str], list[Row]] = {}
    for row in rows:
        found.setdefault(row[:3], []).append(row)
    return found


def report(rows: Sequence[Row]) -> Report:
    """Return one line per group; sound if the executor neither collides nor reports a false docking."""
    lines = [("world", "method", "starts", "good", "false", "collisions", *COLUMNS)]
    for key, group in groups(rows).items():
        docked, false = [row for row in group if row.is_docked], sum(row.is_docked and not row.is_good for row in group)
        medians = [median_interval([getattr(row, column) for row in docked]) for column in COLUMNS.values()]
        texts = [f"{middle:.2g} ({low:.2g} to {high:.2g})" if docked else "-" for middle, low, high in medians]
        collided = sum(row.has_collided for row in group)
        lines.append((*key, share_text(sum(r.is_good for r in group), len(group)), str(false), str(collided), *texts))
    ours = [row for row in rows if row.method == "executor"]
    law = [row for row in rows if row.method != "executor"]
    failed = sum(row.has_collided or (row.is_docked and not row.is_good) for row in ours)
    good = [share_text(sum(row.is_good for row in group), len(group)) for group in (ours, law)]
    closing = (
        f"{good[0]} dockings of the executor and {good[1]} of Nav2's law are good; {failed} of the executor's collide "
        "or are reported although the robot is not docked."
    )
    return Report(table(lines), closing, is_sound=failed == 0)


def draw(figure: Figure, rows: Sequence[Row]) -> None:
    """Draw the good shares, and the distributions of the errors of the runs that are reported as docked."""
    left, *others = figure.subplots(1, 3, width_ratios=(1.2, 1.0, 1.0))
    found = groups(rows)
    colours = dict(zip(METHODS, (COLOURS["goal"], COLOURS["path"], COLOURS["start"]), strict=True))
    worlds = list(dict.fromkeys(row.world for row in rows))
    for k, (method, spread) in enumerate(METHODS):
        counts = [
            (sum(row.is_good for row in found.get((w, method, spread), [])), len(found.get((w, method, spread), [])))
            for w in worlds
        ]
        label, colour = f"{method}, {spread} starts", colours[method, spread]
        bars(left, worlds, counts, offset=0.27 * (k - 1), height=0.25, color=colour, label=label)
        docked = [row for row in found.get((worlds[0], method, spread), []) if row.is_docked]
        for axes, (name, column) in zip(others, list(COLUMNS.items())[:2], strict=True):
            values = np.sort([getattr(row, column) for row in docked])
            axes.step(values, 100.0 * np.arange(1, len(values) + 1) / max(1, len(values)), where="post", color=colour)
            axes.set_xlabel(f"error {name.removesuffix(', median')}")
    left.set_xlabel("good dockings, % (95 % interval)")
    for axes, most in zip(others, (10.0, 1.5), strict=True):
        axes.axvline(most, color=COLOURS["limit"], linestyle=":")
        axes.set_xscale("log")
        axes.xaxis.set_major_formatter("{x:g}")
        axes.set_ylim(0.0, 102.0)
        axes.grid(alpha=0.25)
    others[0].set_ylabel(f"share of reported dockings, % ({worlds[0]})")
    figure.legend(*left.get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=8, frameon=False)


if __name__ == "__main__":
    sys.exit(run(__file__))
