"""Drawing of the camera's view: the marker, and the camera's cone at some poses."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from optdock.geometry.pose import transform_points
from optdock.plotting.canvas import COLOURS
from optdock.plotting.scene import OutlineStyle, draw_shapes

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from optdock.geometry.arrays import FloatArray
    from optdock.model.camera import Camera, RequiredView
    from optdock.model.path import Path

__all__ = ["draw_cone", "draw_view"]

_CONES = 4  # along the path; more would hide each other
_BEYOND = 1.08  # length of a drawn cone over the distance of the marker, or over the minimum range
_ARC = 0.05  # [rad] between the points of an arc, at most


def draw_view(axes: Axes, view: RequiredView, path: Path | None) -> None:
    """Draw the marker, and cones along the part of the path where the marker must be in view."""
    axes.plot(
        *view.marker, "*", color=COLOURS["goal"], markeredgecolor="black", markersize=13, label="marker", zorder=6.5
    )
    stretch = None if path is None else view.stretch(path)
    if path is None or stretch is None:
        return
    poses = path.poses_at(np.linspace(*stretch, _CONES))
    cones = [_cone(view, pose) for pose in poses]
    label = f"camera, must see the marker from s = {stretch[0]:.2f} m to {stretch[1]:.2f} m"
    draw_shapes(axes, cones, OutlineStyle(face=COLOURS["goal"], alpha=0.10, order=1.2))
    draw_shapes(axes, cones, OutlineStyle(edge=COLOURS["goal"], width=0.9, alpha=0.8, order=1.3, label=label))


def draw_cone(axes: Axes, view: RequiredView, pose: FloatArray) -> None:
    """Draw the cone at a pose of the robot, Shape (3,), where the marker is out of view."""
    style = OutlineStyle(edge=COLOURS["hot"], width=1.4, line="--", order=6.4, label="camera there")
    draw_shapes(axes, [_cone(view, pose)], style)


def _cone(view: RequiredView, pose: FloatArray) -> FloatArray:
    """Outline of the camera's cone at a pose of the robot, Shape (n, 2) [m]."""
    camera = view.camera
    distance = float(view.margins(pose[None]).distance[0])
    reach = min(camera.max_range, max(_BEYOND * distance, _BEYOND * camera.min_range))
    seen = transform_points(camera.mount.as_array()[None], _sector(camera, reach))[0]
    outline: FloatArray = transform_points(pose[None], seen)[0]
    return outline


def _sector(camera: Camera, reach: float) -> FloatArray:
    """Outline of the cone in the camera's frame, from the minimum range to `reach` [m]. Shape (n, 2) [m]."""
    half = 0.5 * camera.field_of_view
    angles = np.linspace(-half, half, max(2, math.ceil(2.0 * half / _ARC)))
    arc = np.column_stack((np.cos(angles), np.sin(angles)))
    inner = (
        camera.min_range * arc[::-1] if camera.min_range > 0.0 else np.zeros((0 if camera.sees_all_around else 1, 2))
    )
    return np.vstack((reach * arc, inner))
