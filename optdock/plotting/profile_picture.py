"""Picture of the quantities of a motion over time, with their limits."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.model.limits import LIMITS, finite_limits
from optdock.model.path import place_before_end
from optdock.plotting.canvas import COLOURS, entitle, legend_below, new_figure, save_figure

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator
    from pathlib import Path

    from matplotlib.axes import Axes

    from optdock.geometry.arrays import BoolArray, FloatArray
    from optdock.model.limits import MotionLimits, SpeedZone
    from optdock.model.trajectory import Trajectory

__all__ = ["MotionPanel", "motion_panels", "save_profile_picture"]

_POINTS = 1500


class MotionPanel(NamedTuple):
    """One limited quantity of a motion.

    Attributes:
        label: Name of the quantity with its unit.
        values: Values at n times, Shape (n,); nan where the quantity is not defined.
        lower: Lower bounds, Shape (n,); -inf where the quantity is unlimited.
        upper: Upper bounds, Shape (n,); inf where the quantity is unlimited.
    """

    label: str
    values: FloatArray
    lower: FloatArray
    upper: FloatArray

    @property
    def axis_range(self) -> tuple[float, float]:
        """Range of the axis: the values, and the bounds unless the curve would appear flat next to them."""
        reach = 1.15 * max(float(np.nanmax(np.abs(self.values))), 1e-6)
        for bound in (self.lower, self.upper):
            reach = max(reach, _range_of(bound, reach))
        goes_below = bool(np.nanmin(self.values) < -1e-9 or np.min(self.lower) < 0.0)
        goes_above = bool(np.nanmax(self.values) > 1e-9 or np.max(self.upper) > 0.0)
        return -reach if goes_below else -0.05 * reach, reach if goes_above else 0.05 * reach


def save_profile_picture(
    target: str | Path, trajectory: Trajectory, limits: MotionLimits, zone: SpeedZone, *, title: str = ""
) -> None:
    """Draw speed, acceleration, jerk, curvature, yaw rate and yaw acceleration over time, each with its limits.

    Other quantities that depend on curvature are drawn if they are limited, except in turns in place. The speed limit
    is the smallest of the limits of the drive and the speed zone, and of the speeds at which the yaw rate, the lateral
    acceleration, the wheel speed and the steering rate reach their limits at the curvature of the path.

    Args:
        target: File to write; the suffix gives the format.
        trajectory: The motion.
        limits: Motion limits.
        zone: Speed zone at the end of the path.
        title: Title of the picture.

    Raises:
        MissingExtra: If Matplotlib is not installed.
        InvalidFile: If the file cannot be written.
    """
    times = np.linspace(0.0, trajectory.duration, _POINTS, dtype=np.float64)
    panels = motion_panels(trajectory, limits, zone, times)
    rows = -(-len(panels) // 2)
    figure = new_figure(10.0, 2.5 * rows)
    grid = figure.subplots(rows, 2, sharex=True)
    for axes, panel in zip(grid.T.ravel(), panels, strict=False):
        _draw_panel(axes, times, panel, trajectory.cusp_times)
    if len(panels) < grid.size:
        grid[-1, -1].axis("off")
    for axes in grid[-1]:
        axes.set_xlabel("time [s]")
        axes.set_xlim(0.0, trajectory.duration)
    legend_below(figure, grid[0, 0])
    entitle(figure, title)
    save_figure(figure, target)


def motion_panels(
    trajectory: Trajectory, limits: MotionLimits, zone: SpeedZone, times: FloatArray
) -> list[MotionPanel]:
    """Return the quantities of a motion with their limits; see `save_profile_picture`.

    Args:
        trajectory: The motion.
        limits: Motion limits.
        zone: Speed zone at the end of the path.
        times: Times in the duration of the motion, Shape (n,) [s].
    """
    samples = trajectory.sample_at(times)
    curvature, gear = trajectory.path.curvature_at(samples.s), trajectory.path.direction_at(samples.s)
    forward, turning = gear > 0, gear == 0
    up, down = limits.max_acceleration, limits.max_deceleration
    speed = _speed_bound(limits, np.abs(curvature), forward)
    if np.isfinite(limits.max_steering_rate):
        per_metre = limits.steering_per_metre(curvature, trajectory.path.curvature_rate_at(samples.s))
        speed = np.minimum(speed, limits.max_steering_rate / np.maximum(per_metre, 1e-12))
    speed = np.where(samples.s > place_before_end(trajectory.path, zone.distance), np.minimum(speed, zone.speed), speed)
    speed, curvature = np.where(turning, 0.0, speed), np.where(turning, 0.0, curvature)
    accelerations = np.where(forward, -down, -up), np.where(forward, up, down)
    symmetric = {
        "max_jerk": samples.jerk,
        "max_curvature": curvature,
        "max_yaw_rate": samples.yaw_rate,
        "max_yaw_acceleration": samples.yaw_acceleration,
    }
    rate = np.where(turning, 0.0, trajectory.path.curvature_rate_at(samples.s))
    along = _TurnProfile(gear * samples.speed, gear * samples.acceleration, curvature, rate)
    return [
        MotionPanel(_label("max_speed"), samples.speed, np.where(forward, 0.0, -speed), np.where(forward, speed, 0.0)),
        MotionPanel(_label("max_acceleration"), samples.acceleration, *accelerations),
        *(_symmetric(name, values, getattr(limits, name)) for name, values in symmetric.items()),
        *_more_panels(limits, symmetric, along, turning),
    ]


class _TurnProfile(NamedTuple):
    """Speed, acceleration, curvature and its rate; implements `TurningMotion`."""

    v: FloatArray
    a: FloatArray
    k: FloatArray
    r: FloatArray


def _more_panels(
    limits: MotionLimits, drawn: Collection[str], motion: _TurnProfile, turning: BoolArray
) -> Iterator[MotionPanel]:
    """Generate the panels of the other finite limits that depend on curvature."""
    for name, bound in finite_limits(limits).items():
        if name not in drawn and name in LIMITS and (size := LIMITS[name].size):
            values = np.where(turning, np.nan, size(motion, limits))
            yield MotionPanel(_label(name), values, np.zeros(values.size), np.full(values.size, bound))


def _symmetric(name: str, values: FloatArray, bound: float) -> MotionPanel:
    return MotionPanel(_label(name), values, np.full(values.size, -bound), np.full(values.size, bound))


def _label(name: str) -> str:
    """Return the label of the limited quantity, with its unit."""
    return LIMITS[name].label.replace("^2", "²").replace("^3", "³")


def _speed_bound(limits: MotionLimits, curvature: FloatArray, forward: BoolArray) -> FloatArray:
    """Return the largest speed at every |curvature|, Shape (n,) [m/s]."""
    bent = np.maximum(curvature, 1e-12)
    bound = np.where(forward, limits.max_speed, limits.max_reverse_speed)
    bound = np.minimum(bound, limits.max_yaw_rate / bent)
    bound = np.minimum(bound, np.sqrt(limits.max_lateral_acceleration / bent))
    lowest: FloatArray = np.minimum(bound, limits.max_wheel_speed / (1.0 + 0.5 * limits.track_width * curvature))
    return lowest


def _draw_panel(axes: Axes, times: FloatArray, panel: MotionPanel, cusps: FloatArray) -> None:
    axes.plot(times, panel.values, color=COLOURS["path"], linewidth=1.5, label="trajectory", zorder=3)
    for bound in (panel.lower, panel.upper):
        shown = np.where(np.isfinite(bound), bound, math.nan)
        axes.plot(
            times, shown, "--", color=COLOURS["goal"], linewidth=1.1, label="limit" if bound is panel.upper else None
        )
    for i, time in enumerate(cusps):
        axes.axvline(time, color="black", linewidth=0.8, linestyle=":", label="cusp" if i == 0 else None)
    axes.set_ylim(*panel.axis_range)
    axes.set_ylabel(panel.label)
    axes.axhline(0.0, color="#888888", linewidth=0.6, zorder=1)
    axes.grid(visible=True, color="#e5e5e5", linewidth=0.5)


def _range_of(bound: FloatArray, reach: float) -> float:
    """Return the axis range that shows a bound, or 0 if the bound is so large that the curve would appear flat."""
    finite = np.abs(bound[np.isfinite(bound)])
    largest = 1.1 * float(finite.max()) if finite.size else 0.0
    return largest if largest < 12.0 * reach else 0.0
