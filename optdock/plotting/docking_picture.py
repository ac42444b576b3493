"""Picture of a logged docking: measured and estimated poses, and commands."""

from __future__ import annotations

from typing import TYPE_CHECKING

from optdock.plotting.canvas import COLOURS, legend_below, new_figure, save_figure
from optdock.plotting.scene import OutlineStyle, draw_arrow, draw_footprints, draw_scene, view_of

if TYPE_CHECKING:
    from pathlib import Path

    from optdock.geometry.arrays import FloatArray
    from optdock.model.problem import DockingProblem

__all__ = ["save_docking_picture"]


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
        MissingExtra: Matplotlib is not installed.
        InvalidFile: The file cannot be written.
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
    below.plot(commands[:, 0], commands[:, 1], color=COLOURS["path"], label="speed [m/s]")
    below.plot(commands[:, 0], commands[:, 2], color=COLOURS["goal"], label="yaw rate [rad/s]")
    below.set_xlabel("time [s]")
    below.set_ylabel("command")
    below.grid(visible=True, color="#e5e5e5", linewidth=0.5)
    below.legend(loc="best", fontsize=8)
    legend_below(figure, axes)
    save_figure(figure, target)
