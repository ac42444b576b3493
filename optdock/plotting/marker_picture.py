"""Markers of a plan, drawn from above without RViz."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from optdock.geometry.pose import Pose2, transform_points

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from optdock.geometry.arrays import FloatArray

__all__ = ["draw_marker_array"]

_ARROW = 0  # in the message definition
_SAME = Pose2(0.0, 0.0, 0.0)


def draw_marker_array(
    axes: Axes,
    markers: Any,  # noqa: ANN401 - a message
    frame: Pose2 = _SAME,
    points_per_metre: float = 80.0,
) -> None:
    """Draw the lines, arrows and texts of a `visualization_msgs/MarkerArray` of `plan_markers`.

    Args:
        axes: Axes in metres; the namespaces of the markers are the labels of the legend.
        markers: The message, of ROS or of a recording.
        frame: Pose of the frame of the markers in that of the axes.
        points_per_metre: Scale of the widths of lines [pt/m].
    """
    from matplotlib.collections import LineCollection

    for marker in markers.markers:
        ends = _placed(frame, marker.points).reshape(-1, 2, 2)
        inks = [(ink.r, ink.g, ink.b, ink.a) for ink in (*marker.colors[::2],) or (marker.color,)]
        if len(ends):
            label = "" if marker.ns in axes.get_legend_handles_labels()[1] else marker.ns
            width = points_per_metre * marker.scale.x
            axes.add_collection(LineCollection(list(ends), colors=inks, linewidths=width, zorder=3, label=label))
        elif marker.type == _ARROW and marker.scale.x > 0.0:
            turn, ahead = marker.pose.orientation, np.array([[0.0, 0.0], [marker.scale.x, 0.0]])
            yaw = 2.0 * math.atan2(turn.z, turn.w)
            pose = frame @ Pose2(marker.pose.position.x, marker.pose.position.y, yaw)
            tail, tip = transform_points(pose.as_array()[None], ahead)[0]
            axes.annotate("", tip, tail, arrowprops={"arrowstyle": "-|>", "color": inks[0], "linewidth": 2.0}, zorder=6)
        if marker.text:
            (end,), line = _placed(frame, [marker.pose.position]), {"arrowstyle": "-", "color": "#888888"}
            beside: dict[str, Any] = {"textcoords": "offset points", "ha": "right", "arrowprops": line}
            axes.annotate(marker.text, end, (-6.0, -46.0), color=inks[0], **beside)


def _placed(frame: Pose2, points: Any) -> FloatArray:  # noqa: ANN401 - of messages
    """Return points in the frame of the axes, Shape (n, 2)."""
    flat = np.array([(point.x, point.y) for point in points]).reshape(-1, 2)
    placed: FloatArray = transform_points(frame.as_array()[None], flat)[0]
    return placed
