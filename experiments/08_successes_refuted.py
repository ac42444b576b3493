"""Study 8: share of the paths that smoothers report as successful and that collide or cannot be driven.

Raw paths of four sources (OMPL, hybrid A*, a recorded drive, waypoints) are smoothed by Nav2's two smoothers with their
default parameters, with and without the collision check (the default of Nav2's SmoothPath node is without), and by
CasadiSmoother. Counted are results without an error, from raw paths that do not collide. Every result is judged twice:
by an independent check with shapely every 5 mm, and by the certificate. `collides`: the footprint overlaps an obstacle
by more than 1 mm. `too close`: less than the required clearance by more than 1 mm. `too sharp`: the curvature, averaged
over 0.2 m so that noise of single poses does not count, exceeds the limit of the robot by more than 5 %.

    python experiments/08_successes_refuted.py [--scale S] [--jobs N]
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from experiments.dense_check import dense_check
from experiments.raw_paths import NEEDS_OMPL, SOURCES, has_ompl
from experiments.study_cases import DockCase, PathTask, dock_cases, maps_text, problem_for
from experiments.study_run import Report, bars, run, share_text
from optdock.errors import OptdockError
from optdock.geometry.pose import transform_points, wrap_angles
from optdock.plotting.canvas import COLOURS
from optdock.plugins.interfaces import Smoother
from optdock.plugins.registry import create_plugin
from optdock.reports.report import table
from optdock.verification import certify_path

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from optdock.model.path import Path
    from optdock.model.problem import DockingProblem

NONE = "none, the raw path"
UNCHECKED = {"check_for_collisions": False}
SMOOTHERS: dict[str, tuple[str, dict[str, object]]] = {
    "SimpleSmoother": ("SimpleSmoother", UNCHECKED),
    "SimpleSmoother, checked": ("SimpleSmoother", {}),
    "SavitzkyGolaySmoother": ("SavitzkyGolaySmoother", UNCHECKED),
    "SavitzkyGolaySmoother, checked": ("SavitzkyGolaySmoother", {}),
    "CasadiSmoother": ("CasadiSmoother", {}),
}
OURS = "CasadiSmoother"
FAULTS = {"collides": "overlap", "too_close": "lack", "too_sharp": "sharpness"}  # and the column of its size
STEP, CHORD = 0.005, 0.1  # [m] between samples of the check, and between the three points of a curvature
TOLERANCE, SHARPER = 1e-3, 1.05  # [m], share of the limit
BUDGET = 2.0  # [s] of CPU time
SIZE = (10.0, 5.2)


class Row(NamedTuple):
    """Verdict on one result; the sizes are positive where the rule is broken: overlap and lack [m], ratio - 1."""

    scenario: str
    number: int
    source: str
    smoother: str
    ended: str  # `success`, or the name of the error
    raw_collides: bool
    certified: bool = False
    collides: bool = False
    too_close: bool = False
    too_sharp: bool = False
    overlap: float = 0.0
    lack: float = 0.0
    sharpness: float = 0.0
    at_s: float = 0.0

    @property
    def counts(self) -> bool:
        """Whether the result is a success from a raw path without collision."""
        return self.ended == "success" and not self.raw_collides

    @property
    def is_bad(self) -> bool:
        """Whether the result breaks one of the three rules."""
        return self.collides or self.too_close or self.too_sharp


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
        return
    collides = dense_check(raw, problem, STEP).min_clearance < -TOLERANCE
    yield judged(Row(*task, NONE, "success", collides), raw, problem)
    for name in SMOOTHERS:
        path, ended = smoothed(raw, problem, name)
        found = Row(*task, name, ended, collides)
        yield found if path is None else judged(found, path, problem)


def smoothed(raw: Path, problem: DockingProblem, name: str) -> tuple[Path | None, str]:
    """Return the result of a smoother, and how the call ended."""
    try:
        result = create_plugin(Smoother, *SMOOTHERS[name]).smooth(raw, BUDGET, problem=problem)
    except OptdockError as error:
        return None, type(error).__name__
    return result.path, "success" if result.completed else "stopped"


def judged(row: Row, path: Path, problem: DockingProblem) -> Row:
    """Return a row with the verdicts on a path."""
    dense, limit = dense_check(path, problem, STEP), problem.robot.limits.max_curvature
    sharpness = driven_curvature(path) / limit - 1.0
    return row._replace(
        certified=certify_path(path, problem).certified,
        collides=dense.min_clearance < -TOLERANCE,
        too_close=dense.worst_margin < -TOLERANCE,
        too_sharp=sharpness > SHARPER - 1.0,
        overlap=max(0.0, -dense.min_clearance),
        lack=max(0.0, -dense.worst_margin),
        sharpness=max(0.0, sharpness),
        at_s=dense.worst_s,
    )


def driven_curvature(path: Path) -> float:
    """Return the largest curvature of the positions of each gear, as the turn between two chords of 0.1 m [1/m]."""
    largest = 0.0
    for segment in path.segments:
        if segment.length < 2.0 * CHORD:
            continue
        s = np.arange(0.0, segment.length - 2.0 * CHORD + 1e-9, 0.02)
        points = [segment.poses_at(s + k * CHORD)[:, :2] for k in range(3)]
        first, second = points[1] - points[0], points[2] - points[1]
        turn = wrap_angles(np.arctan2(second[:, 1], second[:, 0]) - np.arctan2(first[:, 1], first[:, 0]))
        largest = max(largest, float(np.abs(turn).max()) / CHORD)
    return largest


def groups(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """Return the counted rows of every smoother, and of the raw paths."""
    return {name: [row for row in rows if row.smoother == name and row.counts] for name in (NONE, *SMOOTHERS)}


def report(rows: Sequence[Row]) -> Report:
    """Return the shares per smoother and per source; sound if no certified path breaks a rule."""
    found = groups(rows)
    sources = list(dict.fromkeys(row.source for row in rows))
    lines = [("smoother", "successes", "bad", "collides", "too close", "too sharp", "certified")]
    by_source = [("smoother", *(f"bad, {source}" for source in sources))]
    for name, group in found.items():
        counts = [sum(getattr(row, fault) for row in group) for fault in ("is_bad", *FAULTS, "certified")]
        lines.append((name, str(len(group)), *(share_text(count, len(group)) for count in counts)))
        of_source = [[row.is_bad for row in group if row.source == source] for source in sources]
        by_source.append((name, *(share_text(sum(bad), len(bad)) for bad in of_source)))
    worst = [
        (name, fault, max(group, key=lambda row: getattr(row, FAULTS[fault]), default=None))
        for name, group in found.items()
        for fault in FAULTS
    ]
    units = {"collides": "m overlap", "too_close": "m too close", "too_sharp": "times the limit, above it"}
    where = [("smoother", "worst", "size", "where")]
    for name, fault, row in worst:
        if row is not None and getattr(row, fault):
            size = f"{getattr(row, FAULTS[fault]):.3f} {units[fault]}"
            where.append((name, fault.replace("_", " "), size, f"{row.scenario}, start {row.number}, {row.source}"))
    lies = sum(row.certified and row.is_bad for row in rows)
    nav2 = [row for name in SMOOTHERS if name != OURS for row in found[name]]
    bad, hits = sum(row.is_bad for row in nav2), sum(row.collides for row in nav2)
    certified = sum(row.certified for row in rows)
    closing = (
        f"Of {len(nav2)} results that Nav2's smoothers report as successful, {share_text(bad, len(nav2))} break one of "
        f"the three rules and {share_text(hits, len(nav2))} collide; of {certified} certified paths, {lies} break one."
    )
    notes = maps_text() if has_ompl() else f"{maps_text()}\n{NEEDS_OMPL}."
    tables = "\n\n".join(map(table, (lines, by_source, where)))
    return Report(f"{notes}\n\n{tables}", closing, is_sound=lies == 0)


def draw(figure: Figure, rows: Sequence[Row]) -> None:
    """Draw the shares of every smoother and fault, and the deepest collision."""
    left, right = figure.subplots(1, 2, width_ratios=(1.0, 1.1))
    found = groups(rows)
    names = [fault.replace("_", " ") for fault in FAULTS]
    colours = [COLOURS[name] for name in ("limit", "goal", "reverse", "dock", "raw", "path")]
    for k, (name, group) in enumerate(found.items()):
        counts = [(sum(getattr(row, fault) for row in group), len(group)) for fault in FAULTS]
        bars(
            left,
            names,
            counts,
            offset=0.14 * (k - 2.5),
            height=0.13,
            color=colours[k],
            label=f"{name}, n = {len(group)}",
        )
    left.set_xlabel("share of reported successes, % (95 % interval)")
    figure.legend(*left.get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=8, frameon=False)
    made = [row for name in SMOOTHERS for row in found[name]]
    worst = max(made, key=lambda row: (row.overlap, row.lack), default=None)
    raw, path = (None, None) if worst is None else paths_of(worst)
    if worst is None or raw is None or path is None:
        right.set_axis_off()
        return
    size = f"overlap {1e3 * worst.overlap:.0f} mm" if worst.collides else f"{1e3 * worst.lack:.0f} mm too close"
    right.set_title(f"worst clearance, {size}: {worst.scenario}, start {worst.number}", fontsize=8.5)
    draw_scene(right, worst, raw, path)


def paths_of(row: Row) -> tuple[Path | None, Path | None]:
    """Return the raw path and the smoothed path of a row, computed again."""
    problem = problem_for(DockCase(row.scenario, row.number))
    raw = SOURCES[row.source](problem, row.number)
    return raw, None if raw is None else smoothed(raw, problem, row.smoother)[0]


def draw_scene(axes: Axes, row: Row, raw: Path, path: Path) -> None:
    """Draw the obstacles, both paths, and the footprint along the smoothed path and at its worst pose."""
    problem = problem_for(DockCase(row.scenario, row.number))
    points = np.concatenate((raw.sample(0.02).poses, path.sample(0.02).poses))[:, :2]
    lower, upper = points.min(axis=0) - 1.0, points.max(axis=0) + 1.0
    for outline in problem.all_obstacles.in_box(lower, upper).vertices:
        axes.fill(*outline.T, color=COLOURS["obstacle"], linewidth=0)
    axes.plot(*raw.sample(0.02).poses[:, :2].T, "--", color=COLOURS["raw"], label=f"raw path: {row.source}")
    axes.plot(*path.sample(0.02).poses[:, :2].T, color=COLOURS["goal"], label=row.smoother)
    stations = (*np.linspace(0.0, path.length, 12), row.at_s)
    for s, outline in zip(
        stations, transform_points(path.poses_at(stations), problem.robot.footprint.vertices), strict=True
    ):
        edge = {"edgecolor": COLOURS["hot"], "linewidth": 1.6} if s == row.at_s else {"edgecolor": COLOURS["limit"]}
        axes.fill(*outline.T, facecolor="none", **edge)
    axes.set_xlim(lower[0], upper[0])
    axes.set_ylim(lower[1], upper[1])
    axes.set_aspect("equal")
    axes.set_xlabel("x, m")
    axes.set_ylabel("y, m")
    axes.legend(fontsize=7.5, loc="best")


if __name__ == "__main__":
    sys.exit(run(__file__))
