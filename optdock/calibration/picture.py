"""Picture of a calibration: residuals and fits, and the dock in the map according to each recording."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from optdock.calibration.localization import docks_in_map
from optdock.plotting.canvas import COLOURS, new_figure, save_figure

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.axes import Axes

    from optdock.calibration.calibrate import Calibration
    from optdock.calibration.motion_smoother import RecordedMotion

__all__ = ["save_calibration_picture"]

_SHOWN = 15.0  # [s] of the response of the drive: longer curves are too dense
_PAUSE = 1.5  # [s]: errors farther apart are not joined by a line


def save_calibration_picture(target: str | Path, calibration: Calibration) -> None:
    """Draw the response of the drive, residuals of detections, errors of the localization, and the dock in the map.

    Args:
        target: File; the suffix selects the format.
        calibration: Result of a calibration.

    Raises:
        MissingExtra: If Matplotlib is not installed.
        InvalidFile: If the file cannot be written.
    """
    figure = new_figure(12.0, 8.5)
    grid = figure.add_gridspec(2, 6)
    _draw_response(figure.add_subplot(grid[0, :4]), calibration)
    _draw_docks(figure.add_subplot(grid[0, 4:]), calibration)
    for column, index in ((slice(0, 2), 0), (slice(2, 4), 2)):
        _draw_detections(figure.add_subplot(grid[1, column]), calibration.motion, index)
    _draw_localization(figure.add_subplot(grid[1, 4:]), calibration)
    save_figure(figure, target)


def _draw_response(axes: Axes, calibration: Calibration) -> None:
    answers = calibration.response.answers
    _label(axes, "drive: odometry and fit", "time [s]", "speed [m/s], yaw rate [rad/s]")
    if not answers:
        return
    times, columns = answers[0]
    shown = times - times[0] <= _SHOWN
    t = times[shown] - times[0]
    names = (("speed", "path"), ("yaw rate", "goal"))
    for k, (name, colour) in enumerate(names):
        axes.plot(t, columns[shown, 2 * k], ".", color=COLOURS[colour], markersize=2.5, label=f"{name}, odometry")
        axes.plot(t, columns[shown, 2 * k + 1], color=COLOURS[colour], linewidth=1.0, label=f"{name}, fitted")
    axes.legend(fontsize=7, loc="best")


def _draw_detections(axes: Axes, motion: RecordedMotion | None, index: int) -> None:
    """Draw residuals of x and y (index 0) or yaw (index 2) over the range, and the estimated standard deviations."""
    name, unit, scale = ("position", "mm", 1e3) if index == 0 else ("yaw", "degrees", 180.0 / np.pi)
    _label(axes, f"detections: residuals of {name}, and 1 and 2 sigma", "range [m]", f"residual [{unit}]")
    if motion is None:
        return
    for one in motion.of:
        for residuals in scale * one.seen.residuals.T[[0, 1] if index == 0 else [2]]:
            axes.plot(one.seen.ranges, residuals, ".", color=COLOURS["path"], markersize=2.5)
    farthest = max(float(np.max(one.seen.ranges)) for one in motion.of)
    ranges = np.linspace(0.0, farthest, 50)
    sigma = scale * motion.noise.sigmas(ranges, np.zeros((50, 3)))[:, index]
    for times in (-2.0, -1.0, 1.0, 2.0):
        axes.plot(ranges, times * sigma, color=COLOURS["goal"], linewidth=1.0)
    axes.set_ylim(-8.0 * float(np.mean(sigma)), 8.0 * float(np.mean(sigma)))


def _draw_localization(axes: Axes, calibration: Calibration) -> None:
    _label(axes, "localization: error of x and y", "time [s]", "error [mm]")
    if calibration.localization is None:
        return
    for column, (colour, name) in enumerate((("path", "x"), ("goal", "y")), start=1):
        axes.plot([], [], ".-", color=COLOURS[colour], label=name)
        for rows in calibration.localization.series:
            for part in np.split(rows, np.flatnonzero(np.diff(rows[:, 0]) > _PAUSE) + 1):
                times, errors = part[:, 0] - rows[0, 0], 1e3 * part[:, column]
                axes.plot(times, errors, ".-", color=COLOURS[colour], linewidth=0.8, markersize=2.0)
    axes.legend(fontsize=7, loc="best")


def _draw_docks(axes: Axes, calibration: Calibration) -> None:
    _label(axes, "the dock in the map", "x [m]", "y [m]")
    axes.set_aspect("equal", adjustable="datalim")
    if calibration.motion is not None:
        for k, one in enumerate(calibration.motion.of):
            rows = docks_in_map(one, calibration.motion.delay).dock
            axes.plot(rows[:, 0], rows[:, 1], ".", color=COLOURS["limit"], markersize=2.0, label="" if k else "single")
            if len(rows):
                middle = np.mean(rows[:, :2], axis=0)
                axes.plot(*middle, "o", color=COLOURS["path"], markersize=4.0, label="" if k else "of a recording")
    stored = next((one.stored for one in calibration.recordings if one.stored is not None), None)
    if stored is not None:
        axes.plot(stored.x, stored.y, "s", color=COLOURS["start"], markersize=6.0, label="as stored")
    found = [one for one in calibration.quantities if one.name.startswith("stored dock") and one]
    if len(found) == 3:
        x, y, _ = found
        axes.errorbar(
            x.value, y.value, y.half_width, x.half_width, "D", color=COLOURS["goal"], markersize=5.0, label="found"
        )
    if axes.get_legend_handles_labels()[0]:
        axes.legend(fontsize=7, loc="best")


def _label(axes: Axes, title: str, x: str, y: str) -> None:
    axes.set_title(title, fontsize=10)
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.grid(visible=True, color="#e5e5e5", linewidth=0.5)
    axes.tick_params(labelsize=8)
