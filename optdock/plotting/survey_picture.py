"""Picture of a survey: durations, refusals, and the share of certified headings at every position."""

from __future__ import annotations

import math
import textwrap
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.plotting.canvas import COLOURS, entitle, new_figure, save_figure
from optdock.plotting.scene import OutlineStyle, View, draw_arrow, draw_footprints, draw_scene

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from optdock.geometry.arrays import BoolArray, FloatArray
    from optdock.model.problem import DockingProblem

__all__ = ["SurveyLayers", "save_survey_picture"]

_ABOVE_MAP = 0.9
_MARGIN = 0.5  # [m] around the surveyed region


class SurveyLayers(NamedTuple):
    """Answers by heading and position, Shape (headings, rows, columns) each.

    `x`, `y`: positions, Shape (columns,) and (rows,) [m]. `headings`: Shape (headings,) [rad]. `seconds`: duration of
    certified motions, nan for others [s]. `impossible`, `not_found`: verdicts. `free`: whether the robot overlaps no
    obstacle.
    """

    x: FloatArray
    y: FloatArray
    headings: FloatArray
    seconds: FloatArray
    impossible: BoolArray
    not_found: BoolArray
    free: BoolArray


def save_survey_picture(target: str | Path, problem: DockingProblem, layers: SurveyLayers, *, title: str = "") -> None:
    """Draw the least duration and the share of certified headings at every position, and a rose of the headings.

    Args:
        target: File name; the suffix selects the format.
        problem: Problem with map, obstacles and dock.
        layers: The answers.
        title: Title above the picture.

    Raises:
        MissingExtra: If Matplotlib is not installed.
        InvalidFile: If the file cannot be written.
        InvalidValue: If the suffix names no picture format.
    """
    step = 0.5 * float(layers.x[1] - layers.x[0]) if layers.x.size > 1 else 0.05
    left, right = float(layers.x[0]) - step, float(layers.x[-1]) + step
    lower, upper = float(layers.y[0]) - step, float(layers.y[-1]) + step
    view = View(left - _MARGIN, right + _MARGIN, lower - _MARGIN, upper + _MARGIN)
    extent = (left, right, lower, upper)
    ratio = (view.top - view.bottom) / (view.right - view.left)
    figure = new_figure(15.0, min(max(5.2 * ratio + 1.6, 4.2), 9.0))
    grid = figure.add_gridspec(1, 3, width_ratios=(1.0, 1.0, 0.55))
    certified = np.isfinite(layers.seconds)
    any_free = layers.free.any(axis=0)
    least = np.where(certified, layers.seconds, np.inf).min(axis=0)
    least = np.where(np.isfinite(least), least, np.nan)
    share = np.where(any_free, certified.sum(axis=0) / np.maximum(layers.free.sum(axis=0), 1), np.nan)
    for column, (values, label, most, colours) in enumerate(
        (
            (least, "least duration over the headings [s]", None, "viridis_r"),
            (100.0 * share, "certified headings [% of the free ones]", 100.0, "cividis"),
        )
    ):
        axes = figure.add_subplot(grid[0, column])
        draw_scene(axes, problem, view)
        drawn = axes.imshow(
            np.ma.masked_invalid(values),
            origin="lower",
            extent=extent,
            cmap=colours,
            vmin=None if most is None else 0.0,
            vmax=most,
            interpolation="nearest",
            alpha=0.85,
            zorder=_ABOVE_MAP,
        )
        figure.colorbar(drawn, ax=axes, label=label, shrink=0.75, location="bottom")
        _mark_refusals(axes, layers)
        goal = problem.goal.as_array()[None]
        draw_footprints(axes, problem.robot.footprint, goal, OutlineStyle(edge="black", width=1.2, order=4.0))
        draw_arrow(axes, problem.goal, 0.6 * problem.robot.footprint.circumscribed_radius, COLOURS["goal"], "dock")
    _draw_rose(figure, grid[0, 2], layers, certified)
    entitle(figure, title)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    named = dict(zip(labels, handles, strict=True))
    figure.legend(named.values(), named.keys(), loc="outside lower center", ncols=6, fontsize=8, frameon=False)
    save_figure(figure, target)


def _mark_refusals(axes: Axes, layers: SurveyLayers) -> None:
    """Hatch positions that are impossible for every free heading, and mark positions with a heading not found."""
    x, y = np.meshgrid(layers.x, layers.y)
    closed = layers.impossible.any(axis=0) & ~np.isfinite(layers.seconds).any(axis=0) & ~layers.not_found.any(axis=0)
    if closed.any():
        levels = np.where(closed, 1.0, 0.0)
        if min(levels.shape) > 1:
            axes.contourf(layers.x, layers.y, levels, levels=[0.5, 1.5], colors="none", hatches=["xxx"], zorder=2.0)
        axes.scatter(x[closed], y[closed], s=2.0, color=COLOURS["hot"], zorder=2.1)
        label = "impossible: proven"
        axes.fill([], [], facecolor="none", edgecolor=COLOURS["hot"], hatch="xxx", label=label)
    some = layers.not_found.any(axis=0)
    if some.any():
        label = "not found for a heading"
        axes.scatter(
            x[some], y[some], s=5.0, marker="x", linewidths=0.6, color=COLOURS["reverse"], label=label, zorder=2.2
        )


def _draw_rose(figure: Figure, place: object, layers: SurveyLayers, certified: BoolArray) -> None:
    """Draw the share of certified cells and the median duration of each heading."""
    axes = figure.add_subplot(place, projection="polar")  # type: ignore[call-overload]
    free = layers.free.sum(axis=(1, 2))
    share = 100.0 * certified.sum(axis=(1, 2)) / np.maximum(free, 1)
    width = 2.0 * math.pi / layers.headings.size
    medians = [
        float(np.median(seconds[np.isfinite(seconds)])) if np.isfinite(seconds).any() else math.nan
        for seconds in layers.seconds
    ]
    from matplotlib import colormaps
    from matplotlib.colors import Normalize

    known = [one for one in medians if math.isfinite(one)] or [0.0]
    scale = Normalize(min(known), max(known))
    colours = [colormaps["viridis_r"](scale(one)) if math.isfinite(one) else "none" for one in medians]
    axes.bar(layers.headings, share, width=0.9 * width, color=colours, edgecolor="black", linewidth=0.4)
    axes.set_ylim(0.0, 100.0)
    axes.set_yticks([50.0, 100.0], ["50 %", "100 %"], fontsize=7)
    axes.set_xticks(np.linspace(0.0, 2.0 * math.pi, 8, endpoint=False))
    axes.tick_params(labelsize=7)
    note = (
        f"by start heading: length = certified share, colour = median duration, {min(known):.1f} to {max(known):.1f} s"
    )
    axes.set_title(textwrap.fill(note, 34), fontsize=8)
