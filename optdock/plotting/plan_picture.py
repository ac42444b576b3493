"""The picture of a plan: where the robot drives and where it is tight."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from optdock.geometry.pose import Pose2
from optdock.plotting.canvas import COLOURS, entitle, legend_below, new_figure, save_figure
from optdock.plotting.scene import OutlineStyle, draw_arrow, draw_footprints, draw_scene, view_of
from optdock.verification import pose_clearance

if TYPE_CHECKING:
    from pathlib import Path as FilePath

    from matplotlib.axes import Axes

    from optdock.path import Path
    from optdock.problem import DockingProblem
    from optdock.verification import Certificate

__all__ = ["save_plan_picture"]

_SPACING = 0.02  # [m] between drawn points
_FOOTPRINTS = 24  # drawn along a path at most


def save_plan_picture(
    target: str | FilePath,
    problem: DockingProblem,
    *,
    raw_path: Path | None = None,
    path: Path | None = None,
    certificate: Certificate | None = None,
    title: str = "",
) -> None:
    """Draw map, obstacles, dock, paths, the swept footprint, and the tightest place.

    Args:
        target: Where; the suffix chooses the format.
        problem: What was planned.
        raw_path: The planner's path.
        path: The smoothed path.
        certificate: The verdict on it; with one, the closest pose before the dock is marked.
        title: Above the picture.

    Raises:
        MissingExtra: Matplotlib is not installed.
        InvalidFile: The file cannot be written.
    """
    drawn = [each for each in (raw_path, path) if each is not None]
    view = view_of(problem, [each.sample(_SPACING).poses for each in drawn])
    figure = new_figure(*view.figure_size())
    axes = figure.add_subplot()
    draw_scene(axes, problem, view)
    if drawn:
        _draw_sweep(axes, problem, drawn[-1])
    if raw_path is not None:
        _draw_raw(axes, raw_path)
    if path is not None:
        _draw_smoothed(axes, path)
    ends = np.array([problem.start.as_array(), problem.goal.as_array()])
    draw_footprints(axes, problem.robot.footprint, ends, OutlineStyle(edge="black", width=1.2, order=4.0))
    size = 0.6 * problem.robot.footprint.circumscribed_radius
    draw_arrow(axes, problem.start, size, COLOURS["start"], "start")
    draw_arrow(axes, problem.goal, size, COLOURS["goal"], "goal")
    if path is not None and certificate is not None:
        _draw_tightest(axes, problem, path, certificate)
    entitle(figure, title)
    legend_below(figure, axes)
    save_figure(figure, target)


def _draw_sweep(axes: Axes, problem: DockingProblem, path: Path) -> None:
    count = int(np.clip(path.length / 0.15, 2, _FOOTPRINTS))
    poses = path.poses_at(np.linspace(0.0, path.length, count + 1))
    footprint = problem.robot.footprint
    blue = COLOURS["robot"]
    draw_footprints(axes, footprint, poses, OutlineStyle(face=blue, alpha=0.12))
    draw_footprints(axes, footprint, poses, OutlineStyle(edge=blue, width=0.6, order=2.1))


def _draw_raw(axes: Axes, path: Path) -> None:
    samples = path.sample(_SPACING)
    axes.plot(samples.x, samples.y, "--", color=COLOURS["raw"], linewidth=1.6, label="raw path", zorder=5)


def _draw_smoothed(axes: Axes, path: Path) -> None:
    samples = path.sample(_SPACING)
    for gear, colour, label in ((1, "path", "path, forward"), (-1, "reverse", "path, reverse")):
        mine = samples.direction == gear
        if mine.any():
            x, y = (np.where(mine, column, math.nan) for column in (samples.x, samples.y))
            axes.plot(x, y, color=COLOURS[colour], linewidth=2.2, label=label, zorder=5)
    if path.cusps:
        cusps = path.poses_at(np.array(path.cusps))
        axes.plot(cusps[:, 0], cusps[:, 1], "D", color="black", markersize=5, label="cusp", zorder=6)


def _draw_tightest(axes: Axes, problem: DockingProblem, path: Path, certificate: Certificate) -> None:
    if not math.isfinite(certificate.min_clearance):
        return
    s, clearance = _tightest_on_the_way(problem, path)
    where = "on the way" if s < path.length else "at the dock"
    pose = path.poses_at(s)
    style = OutlineStyle(
        edge=COLOURS["hot"], width=1.6, line="--", order=5.5, label=f"closest {where}: {1e3 * clearance:.0f} mm"
    )
    draw_footprints(axes, problem.robot.footprint, pose, style)
    axes.plot(pose[:, 0], pose[:, 1], "x", color=COLOURS["hot"], markersize=8, markeredgewidth=2, zorder=7)


def _tightest_on_the_way(problem: DockingProblem, path: Path) -> tuple[float, float]:
    """Arc length and clearance [m] of the closest of the drawn poses before the dock, where contact is the aim."""
    s = np.linspace(0.0, path.length, int(np.ceil(path.length / (2.0 * _SPACING))) + 1)
    poses = path.poses_at(s)
    away = np.hypot(poses[:, 0] - problem.goal.x, poses[:, 1] - problem.goal.y) >= problem.clearance.taper
    rows = np.flatnonzero(away) if away.any() else np.array([s.size - 1])
    outline, obstacles = problem.robot.footprint, problem.all_obstacles
    clearances = [pose_clearance(Pose2.from_sequence(poses[row]), outline, obstacles)[0] for row in rows]
    best = int(np.argmin(clearances))
    return float(s[rows[best]]), clearances[best]
