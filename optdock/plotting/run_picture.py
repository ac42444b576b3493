"""Pictures of drives: simulated runs with tracking errors, and logged dockings."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from optdock.plotting.canvas import COLOURS, entitle, legend_below, new_figure, save_figure
from optdock.plotting.scene import OutlineStyle, draw_arrow, draw_footprints, draw_scene, draw_sweep, view_of

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.axes import Axes

    from optdock.geometry.arrays import FloatArray
    from optdock.model.problem import DockingProblem
    from optdock.plotting.scene import View
    from optdock.simulation import Run

__all__ = ["save_docking_picture", "save_run_picture"]

_FOOTPRINTS = 24  # number of outlines, at equal distances


def save_run_picture(target: str | Path, problem: DockingProblem, run: Run, *, title: str = "") -> None:
    """Draw the driven and the planned poses, and the tracking errors and speeds over time.

    Args:
        target: File to write; the suffix gives the format.
        problem: The docking problem.
        run: The simulated run.
        title: Title of the picture.

    Raises:
        MissingExtra: If Matplotlib is not installed.
        InvalidFile: If the file cannot be written.
    """
    view = view_of(problem, [run.poses])
    wide = view.right - view.left > 1.3 * (view.top - view.bottom)
    figure = new_figure(11.0, 8.5) if wide else new_figure(12.0, 7.0)
    grid = figure.add_gridspec(2, 3, height_ratios=(1.7, 1.0)) if wide else figure.add_gridspec(3, 2)
    drive = figure.add_subplot(grid[0, :] if wide else grid[:, 0])
    _draw_drive(drive, problem, run, view)
    panels = [figure.add_subplot(grid[1, i] if wide else grid[i, 1]) for i in range(3)]
    _draw_errors(panels[0], run)
    _draw_yaw_error(panels[1], run)
    _draw_commands(panels[2], run.times, run.commands)
    for panel in panels:
        panel.set_xlim(0.0, max(run.duration, 1e-9))
    legend_below(figure, drive)
    entitle(figure, title)
    save_figure(figure, target)


def save_docking_picture(
    target: str | Path, problem: DockingProblem, measured: FloatArray, estimates: FloatArray, commands: FloatArray
) -> None:
    """Draw a docking from above, and its commands over time.

    Args:
        target: File to write; the suffix gives the format.
        problem: The docking problem.
        measured: Measured poses, Shape (n, 3).
        estimates: Filtered poses, Shape (m, 3).
        commands: Time, linear and angular velocity, Shape (k, 3) [s, m/s, rad/s].

    Raises:
        MissingExtra: If Matplotlib is not installed.
        InvalidFile: If the file cannot be written.
    """
    view = view_of(problem, [poses for poses in (measured, estimates) if len(poses)])
    figure = new_figure(11.0, 8.0)
    grid = figure.add_gridspec(2, 1, height_ratios=(2.0, 1.0))
    axes = figure.add_subplot(grid[0, 0])
    draw_scene(axes, problem, view)
    axes.plot(measured[:, 0], measured[:, 1], ".", color=COLOURS["raw"], markersize=2.0, label="measured", zorder=4)
    axes.plot(estimates[:, 0], estimates[:, 1], color=COLOURS["path"], linewidth=1.6, label="estimated", zorder=5)
    draw_footprints(axes, problem.robot.footprint, estimates[-1:], OutlineStyle(edge="black", width=1.2, order=4.0))
    draw_arrow(axes, problem.goal, 0.6 * problem.robot.footprint.circumscribed_radius, COLOURS["goal"], "stored dock")
    below = figure.add_subplot(grid[1, 0])
    _draw_commands(below, commands[:, 0], commands[:, 1:])
    legend_below(figure, axes)
    save_figure(figure, target)


def _draw_drive(axes: Axes, problem: DockingProblem, run: Run, view: View) -> None:
    draw_scene(axes, problem, view)
    driven = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(run.poses[:, :2], axis=0).T))))
    rows = np.searchsorted(driven, np.linspace(0.0, driven[-1], _FOOTPRINTS))
    footprint = problem.robot.footprint
    draw_sweep(axes, footprint, run.poses[rows])
    draw_footprints(axes, footprint, run.poses[-1:], OutlineStyle(edge="black", width=1.2, order=4.0))
    axes.plot(run.references[:, 0], run.references[:, 1], "--", color=COLOURS["raw"], label="planned", zorder=5)
    axes.plot(run.poses[:, 0], run.poses[:, 1], color=COLOURS["path"], linewidth=1.8, label="driven", zorder=4.5)
    size = 0.6 * footprint.circumscribed_radius
    draw_arrow(axes, problem.start, size, COLOURS["start"], "start")
    draw_arrow(axes, problem.goal, size, COLOURS["goal"], "goal")


def _draw_errors(axes: Axes, run: Run) -> None:
    axes.plot(run.times, 1e3 * run.errors[:, 0], color=COLOURS["path"], label="along")
    axes.plot(run.times, 1e3 * run.errors[:, 1], color=COLOURS["goal"], label="cross")
    _finish(axes, "tracking error [mm]")


def _draw_yaw_error(axes: Axes, run: Run) -> None:
    axes.plot(run.times, np.degrees(run.errors[:, 2]), color=COLOURS["start"], label="yaw")
    _finish(axes, "yaw error [deg]")


def _draw_commands(axes: Axes, times: FloatArray, commands: FloatArray) -> None:
    axes.plot(times, commands[:, 0], color=COLOURS["path"], label="speed [m/s]")
    axes.plot(times, commands[:, 1], color=COLOURS["goal"], label="yaw rate [rad/s]")
    _finish(axes, "command")


def _finish(axes: Axes, label: str) -> None:
    axes.set_ylabel(label)
    axes.set_xlabel("time [s]")
    axes.axhline(0.0, color="#888888", linewidth=0.6, zorder=1)
    axes.grid(visible=True, color="#e5e5e5", linewidth=0.5)
    axes.legend(loc="best", fontsize=8)
