"""Study 7: CPU time of `plan_dock` over the distance, the number of obstacles and the size of the map.

Three sweeps in halls with pillars at the crossings of a grid of 4 m, displaced at random: the distance from start to
dock (1 to 100 m, 300 pillars), the number of polygons (1 to 2,000, 15 m), and the cells of a map of 5 cm per cell (250
x 250 to 8,000 x 8,000, 8 m, one pillar per 16 m^2). With a map, the first call includes the constructor of the problem,
which converts the cells to obstacles; later calls on the same map do not. The exponent of a power law is fitted to the
upper half of each sweep.

    python experiments/07_scaling.py [--scale S] [--jobs N]
"""

from __future__ import annotations

import math
import sys
import time
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from experiments.manoeuvres.cases import RULE, dock_at, rectangle
from experiments.real_maps import ROBOT
from experiments.study_run import Exponent, Report, median_interval, power_law, run, scaled, share_text
from optdock.errors import OptdockError
from optdock.geometry.pose import Pose2
from optdock.model.costmap import Costmap
from optdock.model.problem import DockingProblem
from optdock.planning.pipeline import plan_dock
from optdock.plotting.canvas import COLOURS
from optdock.reports.report import table

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from matplotlib.figure import Figure

    from optdock.geometry.arrays import FloatArray

SWEEPS = {
    "distance": ("distance, m", (1, 2, 5, 10, 20, 50, 100)),
    "obstacles": ("obstacles", (1, 10, 30, 100, 300, 1000, 2000)),
    "cells": ("cells of the map along an edge", (250, 500, 1000, 2000, 4000, 8000)),
    "first call": ("cells of the map along an edge", (250, 500, 1000, 2000, 4000, 8000)),
}
PITCH, CELL = 4.0, 0.05  # [m] between pillars, of a cell
FREE = 2.5  # [m] around start and dock
BUDGET = 60.0  # [s]: no limit in practice
CLOCK = "cpu"
SIZE = (10.0, 3.6)


class Task(NamedTuple):
    """A point of a sweep, and the number of the scene."""

    sweep: str
    size: int
    number: int


class Row(NamedTuple):
    """CPU time of one call [ms], and whether it returned a plan."""

    sweep: str
    size: int
    number: int
    is_certified: bool
    cpu: float


def tasks(scale: float) -> list[Task]:
    """Return the points of the sweeps; both sweeps over the cells are measured by one task."""
    draws = scaled(scale, 12, 2)
    found = [Task("distance", size, n) for size in SWEEPS["distance"][1] for n in range(draws)]
    found += [Task("obstacles", size, n) for size in SWEEPS["obstacles"][1] for n in range(draws)]
    least = 1 if scale >= 0.5 else 2  # the largest maps take longest
    return found + [
        Task("cells", size, n)
        for size in SWEEPS["cells"][1][: None if least == 1 else 4]
        for n in range(scaled(scale, 4, 2))
    ]


def work(task: Task) -> Iterator[Row]:
    """Measure one point."""
    task = Task(*task)
    rng = np.random.default_rng((task.number, len(task.sweep)))  # the same scene at every size
    if task.sweep == "cells":
        scene, start, goal = on_map(task.size, rng)
        began = time.process_time()
        problem = DockingProblem(start, dock_at(goal), ROBOT, clearance=RULE, costmap=scene)
        yield measured(task._replace(sweep="first call"), problem, began)
        yield measured(task, problem.starting_at(start @ Pose2(0.01, 0.0, 0.0)))
    elif task.sweep == "distance":
        yield measured(task, in_hall(float(task.size), 300, rng))
    else:
        yield measured(task, in_hall(15.0, task.size, rng))


def measured(task: Task, problem: DockingProblem, began: float | None = None) -> Row:
    """Return the CPU time of a call, since `began` [s] if it is given."""
    began = time.process_time() if began is None else began
    try:
        plan_dock(problem, time_budget=BUDGET)
        is_certified = True
    except OptdockError:
        is_certified = False
    return Row(*task, is_certified, 1e3 * (time.process_time() - began))


def ends(distance: float, rng: np.random.Generator) -> tuple[Pose2, Pose2]:
    """Return a start and a dock, `distance` [m] apart, with the origin in the middle between them."""
    bearing = rng.uniform(-math.pi, math.pi)
    x, y = 0.5 * distance * math.cos(bearing), 0.5 * distance * math.sin(bearing)
    return Pose2(-x, -y, bearing + rng.uniform(-1.0, 1.0)), Pose2(x, y, bearing + rng.uniform(-1.0, 1.0))


def pillars(count: int, kept_free: Sequence[Pose2], rng: np.random.Generator) -> list[FloatArray]:
    """Return the `count` pillars that are nearest to the origin, except near poses. Shape (4, 2) [m] each."""
    side = math.ceil(math.sqrt(count)) + 6
    grid = PITCH * (np.stack(np.meshgrid(*2 * [np.arange(side) - 0.5 * (side - 1)]), axis=-1).reshape(-1, 2))
    middles = grid + rng.uniform(-0.6, 0.6, grid.shape)
    away = np.min([np.hypot(*(middles - (pose.x, pose.y)).T) for pose in kept_free], axis=0)
    middles = middles[away > FREE]
    nearest = middles[np.argsort(np.hypot(*middles.T))[:count]]
    sizes, turns = rng.uniform(0.3, 0.8, (len(nearest), 2)), rng.uniform(0.0, math.pi, len(nearest))
    return [rectangle(*at, *size, turn) for at, size, turn in zip(nearest, sizes, turns, strict=True)]


def in_hall(distance: float, count: int, rng: np.random.Generator) -> DockingProblem:
    """Return a problem among polygons."""
    start, goal = ends(distance, rng)
    around = (start, goal, goal @ Pose2(-1.5, 0.0, 0.0))
    return DockingProblem(start, dock_at(goal), ROBOT, pillars(count, around, rng), RULE)


def on_map(edge: int, rng: np.random.Generator) -> tuple[Costmap, Pose2, Pose2]:
    """Return a map of `edge` x `edge` cells with axis-parallel pillars, a start and a dock."""
    start, goal = ends(8.0, rng)
    half, around = 0.5 * edge * CELL, (start, goal, goal @ Pose2(-1.5, 0.0, 0.0))
    cells = np.zeros((edge, edge), dtype=np.uint8)
    for corners in pillars(max(4, int((2.0 * half / PITCH) ** 2)), around, rng):
        low, high = np.floor((np.array([corners.min(axis=0), corners.max(axis=0)]) + half) / CELL).astype(int)
        cells[max(low[1], 0) : max(high[1], 0), max(low[0], 0) : max(high[0], 0)] = 254
    return Costmap(cells, CELL, (-half, -half)), start, goal


def fitted(rows: Sequence[Row], sweep: str) -> Exponent | None:
    """Return the exponent of the upper half of a sweep, from the calls with a plan."""
    sizes = sorted({row.size for row in rows if row.sweep == sweep})
    upper = [row for row in rows if row.sweep == sweep and row.size in sizes[len(sizes) // 2 :] and row.is_certified]
    if len({row.size for row in upper}) < 2 or len(upper) < 3:
        return None
    return power_law([row.size for row in upper], [row.cpu for row in upper])


def report(rows: Sequence[Row]) -> Report:
    """Return the medians of the points and the exponents."""
    lines, fits = [("sweep", "size", "certified", "CPU ms, median")], [("sweep", "exponent, upper half")]
    for sweep, (label, sizes) in SWEEPS.items():
        for size in sizes:
            group = [row for row in rows if (row.sweep, row.size) == (sweep, size)]
            if group:
                middle, low, high = median_interval([row.cpu for row in group if row.is_certified])
                share = share_text(sum(row.is_certified for row in group), len(group))
                lines.append((f"{sweep} ({label})", f"{size:,}", share, f"{middle:.3g} ({low:.3g} to {high:.3g})"))
        fits.append((sweep, str(fitted(rows, sweep) or "-")))
    largest = {sweep: max((row.size for row in rows if row.sweep == sweep), default=0) for sweep in SWEEPS}
    times = {
        s: median_interval([r.cpu for r in rows if (r.sweep, r.size) == (s, largest[s]) and r.is_certified])[0]
        for s in SWEEPS
    }
    exponents = {sweep: fitted(rows, sweep) for sweep in SWEEPS}
    closing = (
        f"A call takes {times['distance']:.0f} ms of CPU time over {largest['distance']} m (exponent "
        f"{exponents['distance']}), {times['obstacles']:.0f} ms among {largest['obstacles']:,} obstacles (exponent "
        f"{exponents['obstacles']}), and on a map of {largest['cells']:,} x {largest['cells']:,} cells "
        f"{times['first call']:.0f} ms the first time and {times['cells']:.0f} ms later (exponents of the edge "
        f"{exponents['first call']} and {exponents['cells']})."
    )
    return Report(f"{table(lines)}\n\n{table(fits)}", closing)


def draw(figure: Figure, rows: Sequence[Row]) -> None:
    """Draw the CPU times of the sweeps and the fitted power laws."""
    panels = dict(zip(("distance", "obstacles", "cells"), figure.subplots(1, 3, sharey=True), strict=True))
    for sweep, (label, _) in SWEEPS.items():
        axes, colour = (
            panels[sweep if sweep in panels else "cells"],
            COLOURS["goal" if sweep == "first call" else "path"],
        )
        group = [row for row in rows if row.sweep == sweep and row.is_certified]
        axes.plot([row.size for row in group], [row.cpu for row in group], ".", color=colour, alpha=0.5)
        fit = fitted(rows, sweep)
        if fit is not None:
            sizes = sorted({row.size for row in group})
            ends_of_fit = np.array([sizes[len(sizes) // 2], sizes[-1]], dtype=float)
            name = {"cells": "later calls", "first call": "first call"}.get(sweep, "")
            text = f"{name}{': ' if name else ''}exponent {fit.value:.2f}\n({fit.low:.2f} to {fit.high:.2f})"
            axes.plot(ends_of_fit, fit.factor * ends_of_fit**fit.value, color=colour, label=text)
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_xticks((1, 10, 100) if sweep == "distance" else SWEEPS[sweep][1][::2], minor=False)
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_formatter("{x:g}")
            axis.set_minor_formatter("")
        axes.set_xlabel(label)
        axes.grid(alpha=0.25)
    for axes in panels.values():
        if axes.get_legend_handles_labels()[0]:
            axes.legend(fontsize=7.5, loc="upper left")
    panels["distance"].set_ylabel("CPU time of a call, ms")


if __name__ == "__main__":
    sys.exit(run(__file__))
