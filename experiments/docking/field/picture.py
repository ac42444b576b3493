"""Picture of one run in the field world: the true path, the reported poses and the reported dock."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from experiments.docking.field.methods import FIELD_METHODS
from experiments.docking.field.outcome import field_outcome
from experiments.docking.field.run import set_up
from optdock.geometry.pose import Pose2, transform_points

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.axes import Axes

    from experiments.docking.cases import Layout
    from experiments.docking.field.outcome import FieldTask
    from experiments.docking.field.world import FieldRobot
    from optdock.geometry.arrays import FloatArray

__all__ = ["draw_run"]

_OUTLINES = 0.5  # [s] between two drawn outlines of the robot
_AROUND = 1.0  # [m], margin around the path
_NEAR = 0.12  # [m] around the docked pose, in the right half


def draw_run(target: Path, task: FieldTask) -> None:
    """Repeat a task and draw it: whole run on the left, close-up of the docked pose on the right, axes in metres.

    Args:
        target: Picture file.
        task: Task to run.
    """
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    layout, robot = set_up(task)
    outcome = field_outcome(task, layout, robot, FIELD_METHODS[task.method][0](layout, robot, task.rate))
    rows = robot.record()
    figure, (whole, near) = plt.subplots(1, 2, figsize=(15.0, 7.5), layout="constrained")
    _draw_surroundings(whole, layout, rows)
    for axes, size in ((whole, 4), (near, 6)):
        _draw_paths(axes, layout, robot, rows, size)
        axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
        axes.grid(visible=True, alpha=0.3)
    low, high = rows[:, 1:3].min(axis=0), rows[:, 1:3].max(axis=0)
    whole.set(xlim=(low[0] - _AROUND, high[0] + _AROUND), ylim=(low[1] - _AROUND, high[1] + _AROUND))
    dock = robot.dock
    near.set(xlim=(dock.x - _NEAR, dock.x + _NEAR), ylim=(dock.y - _NEAR, dock.y + _NEAR))
    for axes in (whole, near):
        axes.legend(loc="upper left", fontsize="small")
    figure.suptitle(
        f"{task.world}, {task.method}, {task.rate:g} Hz, seed {task.seed}: "
        f"{outcome.ending} after {outcome.duration:.1f} s; "
        f"true error {1e3 * outcome.along:.1f} mm along, {1e3 * outcome.cross:.1f} mm across, "
        f"{math.degrees(outcome.yaw):.2f} degrees"
    )
    figure.savefig(target, dpi=90)
    plt.close(figure)


def _draw_surroundings(axes: Axes, layout: Layout, rows: FloatArray) -> None:
    """Draw obstacles, and the outline of the robot along its true path."""
    for piece in layout.problem.obstacles.vertices:
        axes.fill(*piece.T, color="0.6")
    step = max(1, round(_OUTLINES / (rows[1, 0] - rows[0, 0])))
    shown = np.vstack((rows[::step, 1:], rows[-1:, 1:]))
    for index, outline in enumerate(transform_points(shown, layout.problem.robot.footprint.vertices)):
        axes.fill(*outline.T, facecolor="C0", alpha=0.06)
        label = "" if index else f"robot, every {_OUTLINES:g} s"
        axes.fill(*outline.T, facecolor="none", edgecolor="C0", linewidth=0.5, label=label or None)


def _draw_paths(axes: Axes, layout: Layout, robot: FieldRobot, rows: FloatArray, size: int) -> None:
    """Draw stations, the true path, and reported poses; `size`: size of the dots [points]."""
    problem = layout.problem
    assert problem.dock.footprint is not None
    for pose, style, mark, name in ((robot.dock, "-", "k+", "true"), (problem.goal, "--", "C2x", "stored")):
        outline = transform_points(pose.as_array()[None], problem.dock.footprint.vertices)[0]
        axes.fill(*outline.T, facecolor="none", edgecolor="C2", linestyle=style, label=f"station, {name}")
        axes.plot(pose.x, pose.y, mark, markersize=14, zorder=5, label=f"docked pose, {name}")
    reported = np.array(robot.reported).reshape(-1, 4)
    axes.plot(reported[:, 1], reported[:, 2], "C1.", markersize=0.5 * size, label="robot, as localized")
    axes.plot(rows[:, 1], rows[:, 2], "C0", linewidth=1.5, label="robot, true path")
    places = np.array([_placed(rows, at, one.stamp, one.pose) for at, one in robot.detections]).reshape(-1, 2)
    axes.plot(places[:, 0], places[:, 1], "C3.", markersize=size, label="docked pose, as detected")


def _placed(rows: FloatArray, reported: float, stamp: float, seen: Pose2) -> tuple[float, float]:
    """Return the docked pose given by a detection, relative to the robot's true pose at its stamp."""
    row = int(np.searchsorted(rows[:, 0], min(stamp, reported)))
    placed = Pose2.from_sequence(rows[min(row, len(rows) - 1), 1:]) @ seen
    return placed.x, placed.y
