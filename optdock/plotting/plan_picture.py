"""Picture of a plan: paths, swept footprint and the closest pose."""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.errors import NoMotionExists
from optdock.geometry.obstacles import in_words
from optdock.geometry.pose import Pose2
from optdock.impossibility import BlockedStraight, NoMotionProof
from optdock.plotting.canvas import COLOURS, canvas_of, entitle, legend_below, new_figure, save_figure
from optdock.plotting.scene import (
    DRAWN_BY_THE_MAP,
    OutlineStyle,
    draw_arrow,
    draw_cone,
    draw_footprints,
    draw_scene,
    draw_shapes,
    draw_sweep,
    draw_view,
    view_of,
)
from optdock.verification import TOLERANCE, pose_clearances

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path as FilePath

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from optdock.errors import OptdockError
    from optdock.geometry.arrays import FloatArray
    from optdock.model.path import Path
    from optdock.model.problem import DockingProblem
    from optdock.verification import Certificate

__all__ = ["VIEW_REASONS", "PlanDrawing", "plan_picture_png", "refused_pose", "save_plan_picture", "show_plan_picture"]

_SPACING = 0.02  # [m] between drawn points
_RAW_WIDTH, _WIDTH = 4.5, 2.0  # widths of the two paths [pt]
VIEW_REASONS = ("view", "approach_unseen")  # reasons of refusals for which the camera's cone is drawn
_FOOTPRINTS = 24  # largest number of outlines along a path


class PlanDrawing(NamedTuple):
    """Arguments of `save_plan_picture`."""

    problem: DockingProblem
    raw_path: Path | None = None
    path: Path | None = None
    certificate: Certificate | None = None
    refusal: OptdockError | None = None
    title: str = ""


def save_plan_picture(  # noqa: PLR0913 - one parameter for each thing that is drawn
    target: str | FilePath,
    problem: DockingProblem,
    *,
    raw_path: Path | None = None,
    path: Path | None = None,
    certificate: Certificate | None = None,
    refusal: OptdockError | None = None,
    title: str = "",
) -> None:
    """Draw the map, the obstacles, the dock, the paths, the swept footprint, and the closest or refused pose.

    If the dock must be in view, its marker and the camera's cone at some poses of the path are also drawn.

    Args:
        target: File to write; the suffix gives the format.
        problem: The docking problem.
        raw_path: Path of the planner.
        path: Smoothed path; after a refusal or without a valid certificate, the best path found.
        certificate: Certificate of `path`; the pose of least clearance is marked.
        refusal: Error that ended the planning; the obstacle and the pose that it names are marked.
        title: Title of the picture.

    Raises:
        MissingExtra: If Matplotlib is not installed.
        InvalidFile: If the file cannot be written.
    """
    drawing = PlanDrawing(problem, raw_path, path, certificate, refusal, title)
    save_figure(_draw(drawing, new_figure), target)


def show_plan_picture(drawing: PlanDrawing) -> None:
    """Show the picture of a plan in a window; block until the window is closed, unless Matplotlib is interactive.

    Raises:
        MissingExtra: If Matplotlib is not installed.
    """
    new_figure(1.0, 1.0)  # raises MissingExtra without Matplotlib
    import matplotlib.pyplot as plt

    def window(width: float, height: float) -> Figure:
        figure: Figure = plt.figure(figsize=(width, height), layout="constrained")
        return figure

    _draw(drawing, window)
    plt.show()


def plan_picture_png(drawing: PlanDrawing) -> bytes:
    """Return the picture of a plan as a PNG file in memory.

    Raises:
        MissingExtra: If Matplotlib is not installed.
    """
    pixels = io.BytesIO()
    canvas_of(_draw(drawing, new_figure)).print_png(pixels)
    return pixels.getvalue()


def _draw(drawing: PlanDrawing, make_figure: Callable[[float, float], Figure]) -> Figure:
    problem, raw_path, path, certificate, refusal, title = drawing
    drawn = [each for each in (raw_path, path) if each is not None]
    last = drawn[-1] if drawn else None
    pose = None if refusal is None else refused_pose(problem, type(refusal).__name__, refusal.where, last)
    place = None if pose is None else pose.as_array()[None]
    shown = [each.sample(_SPACING).poses for each in drawn]
    view = view_of(problem, shown if place is None else [*shown, place])
    figure = make_figure(*view.figure_size())
    axes = figure.add_subplot()
    draw_scene(axes, problem, view)
    if drawn:
        _draw_sweep(axes, problem, drawn[-1])
    if problem.required_view is not None:
        draw_view(axes, problem.required_view, path)
    if raw_path is not None:
        _draw_raw(axes, raw_path, problem)
    if path is not None:
        is_proven = refusal is None or (certificate is not None and certificate.certified)
        _draw_smoothed(axes, path, "path" if is_proven else "best path found, not certified")
    ends = np.array([problem.start.as_array(), problem.goal.as_array()])
    draw_footprints(axes, problem.robot.footprint, ends, OutlineStyle(edge="black", width=1.2, order=4.0))
    size = 0.6 * problem.robot.footprint.circumscribed_radius
    draw_arrow(axes, problem.start, size, COLOURS["start"], "start")
    draw_arrow(axes, problem.goal, size, COLOURS["goal"], "goal")
    proof = refusal.proof if isinstance(refusal, NoMotionExists) else None
    if isinstance(proof, NoMotionProof):
        _draw_impossibility(axes, problem, proof)
    elif refusal is not None:
        _draw_refusal(axes, problem, refusal, place)
    elif path is not None and certificate is not None:
        _draw_closest(axes, problem, path, certificate)
    entitle(figure, title)
    legend_below(figure, axes)
    return figure


def _draw_sweep(axes: Axes, problem: DockingProblem, path: Path) -> None:
    count = int(np.clip(path.length / 0.15, 2, _FOOTPRINTS))
    poses = path.poses_at(np.linspace(0.0, path.length, count + 1))
    draw_sweep(axes, problem.robot.footprint, poses)


def _draw_raw(axes: Axes, path: Path, problem: DockingProblem) -> None:
    """Draw the raw path, with overlaps of the robot and obstacles in a different colour."""
    samples = path.sample(_SPACING)
    # The line is wide and below the smoothed path, so that both are visible where they coincide.
    axes.plot(samples.x, samples.y, color=COLOURS["raw"], linewidth=_RAW_WIDTH, label="raw path", zorder=4.5)
    clearances, _ = pose_clearances(samples.poses, problem.robot.footprint, problem.all_obstacles, within=_SPACING)
    hits = clearances < -TOLERANCE
    if hits.any():
        x, y = (np.where(hits, column, math.nan) for column in (samples.x, samples.y))
        label = "raw path, overlaps an obstacle"
        axes.plot(x, y, color=COLOURS["hot"], linewidth=_RAW_WIDTH, label=label, zorder=4.6)


def _draw_smoothed(axes: Axes, path: Path, what: str) -> None:
    samples = path.sample(_SPACING)
    for gear, colour, driven in ((1, "path", "forward"), (-1, "reverse", "reverse")):
        mine = samples.direction == gear
        if mine.any():
            x, y = (np.where(mine, column, math.nan) for column in (samples.x, samples.y))
            axes.plot(x, y, color=COLOURS[colour], linewidth=_WIDTH, label=f"{what}, {driven}", zorder=5)
    if path.cusps:
        cusps = path.poses_at(np.array(path.cusps))
        axes.plot(cusps[:, 0], cusps[:, 1], "D", color="black", markersize=5, label="cusp", zorder=6)


def _draw_closest(axes: Axes, problem: DockingProblem, path: Path, certificate: Certificate) -> None:
    """Mark the pose of least clearance of the certificate."""
    if math.isfinite(certificate.min_clearance):
        label = f"closest: {1e3 * certificate.min_clearance:.0f} mm to {in_words(certificate.nearest)}"
        _mark(axes, problem, path.poses_at(certificate.at_s), label)


def _draw_refusal(axes: Axes, problem: DockingProblem, refusal: OptdockError, place: FloatArray | None) -> None:
    """Mark the pose of a refusal, Shape (1, 3) or None, and the obstacle that the refusal names."""
    if place is not None:
        _mark(axes, problem, place, "refused here")
    if place is not None and problem.required_view is not None and refusal.where.get("reason") in VIEW_REASONS:
        draw_cone(axes, problem.required_view, place[0])
    obstacles = problem.all_obstacles
    named = [row for row in range(len(obstacles)) if obstacles.name_of(row) == refusal.where.get("obstacle")]
    if named and obstacles.name_of(named[0]) not in DRAWN_BY_THE_MAP:
        draw_shapes(axes, [obstacles.vertices[row] for row in named], OutlineStyle(edge=COLOURS["hot"], order=5.5))


def _draw_impossibility(axes: Axes, problem: DockingProblem, proof: NoMotionProof) -> None:
    """Draw the cells that the robot's centre can reach, and the outline at the bottleneck or at the blocked poses."""
    if isinstance(proof, BlockedStraight):
        for blocked in proof.poses:
            pose = np.array([[blocked.x, blocked.y, blocked.yaw]])
            _mark(axes, problem, pose, f"blocked by {in_words(blocked.obstacle)}")
        return
    style = OutlineStyle(
        face=COLOURS["start" if proof.end == "start" else "goal"],
        alpha=0.3,
        order=1.5,
        label=f"where the robot's middle can be, from the {proof.end}",
    )
    draw_shapes(axes, proof.squares(), style)
    found = proof.bottleneck
    if found is not None:
        missing = found.missing_width if found.body_fits else found.missing_without_clearance
        label = f"bottleneck: {1e3 * missing:.0f} mm too wide{', with its clearance' if found.body_fits else ''}"
        _mark(axes, problem, np.array([[found.x, found.y, found.yaw]]), label)


def refused_pose(problem: DockingProblem, refusal: str, where: Mapping[str, object], path: Path | None) -> Pose2 | None:
    """Return the pose of a refusal: given directly, at an arc length, or start or goal; None without a position.

    Args:
        problem: The docking problem.
        refusal: Name of the error.
        where: Details of the error.
        path: Path to which an arc length in the details refers.
    """
    pose = where.get("pose")
    if isinstance(pose, Sequence) and len(pose) == 3:
        return Pose2.from_sequence(pose)
    if refusal in ("StartOccupied", "StartOutsideMapBounds"):
        return problem.start
    if refusal in ("GoalOccupied", "GoalOutsideMapBounds"):
        return problem.goal
    x, y, s = (where.get(name) for name in ("x", "y", "s"))
    if isinstance(x, float) and isinstance(y, float):
        return Pose2(x, y, problem.start.yaw)
    if path is not None and isinstance(s, float):
        return path.pose_at(min(s, path.length))
    return None


def _mark(axes: Axes, problem: DockingProblem, pose: FloatArray, label: str) -> None:
    """Draw the outline at a pose, Shape (1, 3), with a cross."""
    style = OutlineStyle(edge=COLOURS["hot"], width=1.6, line="--", order=6.5, label=label)
    draw_footprints(axes, problem.robot.footprint, pose, style)
    axes.plot(pose[:, 0], pose[:, 1], "x", color=COLOURS["hot"], markersize=8, markeredgewidth=2, zorder=7)
