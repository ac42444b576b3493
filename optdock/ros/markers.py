"""Markers of a plan: path coloured by gear, swept outlines, goal, and closest point."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np
import shapely

from optdock.errors import InvalidValue
from optdock.geometry.arrays import FloatArray, readonly
from optdock.geometry.obstacles import in_words
from optdock.geometry.pose import Pose2, transform_points
from optdock.model.path import may_be_one_frame
from optdock.ros.messages import column, header, made
from optdock.ros.motion import plain_pose_message
from optdock.verification.proximity import pose_clearances

if TYPE_CHECKING:
    from collections.abc import Sequence

    from optdock.geometry.footprint import Footprint
    from optdock.geometry.obstacles import ObstacleSet
    from optdock.model.path import Path
    from optdock.planning.plan import DockPlan
    from optdock.ros.messages import Message, MessageTypes
    from optdock.verification import Certificate

__all__ = ["delete_markers", "path_markers", "plan_markers"]

_SWEPT_EVERY = 0.1  # [m] between outlines: outlines overlap for usual robots, and 10 m have 100 of them
_SPACING = 0.02  # [m] between drawn points, as in pictures
_WIDTH, _THIN = 0.02, 0.005  # [m] of lines: visible in a view of a whole room
_TEXT = 0.1  # [m], height of letters
_ARROW_LENGTH = 0.3  # [m] without an outline
# Values of the fields `type` and `action` in the message definition.
_ARROW, _LINE_LIST, _TEXT_FACING = 0, 5, 9
_ADD, _DELETE, _DELETE_ALL = 0, 2, 3

_ORIGIN = Pose2(0.0, 0.0, 0.0)
_NO_BYTES = readonly(np.zeros(0, dtype=np.uint8))
_NO_LINES = readonly(np.zeros((0, 2)))
_Colour: TypeAlias = tuple[float, float, float, float]

# Red, green, blue, alpha. Forward and reverse as in pictures.
_FORWARD, _REVERSE, _TURN = (0.12, 0.47, 0.71, 1.0), (0.84, 0.37, 0.0, 1.0), (0.58, 0.4, 0.74, 1.0)
_SWEPT, _GOAL, _HOT = (0.5, 0.5, 0.5, 0.5), (0.17, 0.63, 0.17, 0.9), (0.84, 0.15, 0.16, 1.0)


def plan_markers(types: MessageTypes, plan: DockPlan, frame: str, stamp: float) -> Message:
    """Return a plan as a `visualization_msgs/MarkerArray`; see `path_markers`.

    Raises:
        InvalidValue: As `path_markers`.
    """
    return path_markers(
        types,
        plan.path,
        frame,
        stamp,
        footprint=plan.problem.robot.footprint,
        obstacles=plan.problem.all_obstacles,
        certificate=plan.certificate,
    )


def path_markers(  # noqa: PLR0913 - one parameter for each thing that is drawn
    types: MessageTypes,
    path: Path,
    frame: str,
    stamp: float,
    *,
    footprint: Footprint | None = None,
    obstacles: ObstacleSet | None = None,
    certificate: Certificate | None = None,
) -> Message:
    """Return a path as a `visualization_msgs/MarkerArray`.

    The namespaces and ids of the markers are always the same, so each array replaces the previous array. Markers
    without content are deleted.

    Args:
        types: Message classes.
        path: The path; blue if driven forward, orange in reverse.
        frame: Frame of the path.
        stamp: Stamp of the markers [s].
        footprint: Outline of the robot, for the swept outlines and the goal.
        obstacles: Obstacles for the closest point.
        certificate: Certificate with the arc length of the closest point.

    Raises:
        InvalidValue: If the path is in a different frame, the frame is empty, or the time is invalid.
    """
    if not may_be_one_frame(path.frame, frame):
        raise InvalidValue(f"frame: the path is in {path.frame!r}, not in {frame!r}; transform it first")
    count = max(1, math.ceil(path.length / _SWEPT_EVERY))
    stations = np.unique(np.concatenate((np.linspace(0.0, path.length, count + 1), path.cusps)))
    size = _ARROW_LENGTH if footprint is None else footprint.circumscribed_radius
    draw = _MarkerList(types, header(types, frame, stamp))
    draw.lines("path", 0, *_coloured_path(path), _WIDTH)
    draw.lines("swept footprint", 0, _outlines(footprint, path.poses_at(stations)), [_SWEPT], _THIN)
    draw.mark("goal", 0, kind=_ARROW, at=path.end, size=(size, 2.0 * _WIDTH, 2.0 * _WIDTH), colour=_GOAL)
    draw.lines("goal", 1, _outlines(footprint, path.end.as_array()[None]), [_GOAL], _WIDTH)
    found = _closest(path, footprint, obstacles, certificate)
    draw.lines("closest", 0, found.outline, [_HOT], _WIDTH)
    draw.lines("closest", 1, found.line, [_HOT], 2.0 * _WIDTH)
    if found.text:
        at = Pose2(float(found.line[0, 0]), float(found.line[0, 1]), 0.0)
        draw.mark("closest", 2, kind=_TEXT_FACING, at=at, size=(0.0, 0.0, _TEXT), colour=_HOT, text=found.text)
    else:
        draw.mark("closest", 2, action=_DELETE)
    return made(types, "visualization_msgs/msg/MarkerArray", markers=draw.markers)


def delete_markers(types: MessageTypes, frame: str, stamp: float) -> Message:
    """Return a `visualization_msgs/MarkerArray` that deletes all markers of its topic.

    Raises:
        InvalidValue: If the frame is empty, or the time is invalid.
    """
    draw = _MarkerList(types, header(types, frame, stamp))
    draw.mark("", 0, action=_DELETE_ALL)
    return made(types, "visualization_msgs/msg/MarkerArray", markers=draw.markers)


class _Closest(NamedTuple):
    """Closest point of a path to an obstacle: edges of the outline, line between outline and obstacle, text."""

    outline: FloatArray = _NO_LINES
    line: FloatArray = _NO_LINES
    text: str = ""


def _closest(
    path: Path, footprint: Footprint | None, obstacles: ObstacleSet | None, certificate: Certificate | None
) -> _Closest:
    if footprint is None or obstacles is None or certificate is None or not math.isfinite(certificate.min_clearance):
        return _Closest()
    pose = path.poses_at(certificate.at_s)
    _, rows = pose_clearances(pose, footprint, obstacles)
    body, obstacle = transform_points(pose, footprint.vertices)[0], obstacles.vertices[rows[0]]
    line = shapely.get_coordinates(shapely.shortest_line(shapely.Polygon(body), shapely.Polygon(obstacle)))
    text = f"{1e3 * certificate.min_clearance:.0f} mm to {in_words(certificate.nearest)}"
    return _Closest(_outlines(footprint, pose), line, text)


def _coloured_path(path: Path) -> tuple[FloatArray, list[_Colour]]:
    """Return the ends of line segments, Shape (2 n, 2), and a colour for every end."""
    samples = path.sample(_SPACING)
    points = np.column_stack((samples.x, samples.y))
    ends = np.stack((points[:-1], points[1:]), axis=1).reshape(-1, 2)
    colours = {1: _FORWARD, -1: _REVERSE, 0: _TURN}
    # A cusp has two samples, one of each gear, so that a segment has the gear of its first sample.
    return ends, [colours[gear] for gear in np.repeat(samples.direction[:-1], 2).tolist()]


def _outlines(footprint: Footprint | None, poses: FloatArray) -> FloatArray:
    """Return the ends of the edges of an outline at every pose, Shape (2 n, 2); empty without an outline."""
    if footprint is None:
        return _NO_LINES
    corners = transform_points(poses, footprint.vertices)
    return np.stack((corners, np.roll(corners, -1, axis=1)), axis=2).reshape(-1, 2)


class _MarkerList:
    """List of markers with a common header."""

    def __init__(self, types: MessageTypes, head: Message) -> None:
        self._types, self._head = types, head
        self._colours: dict[_Colour, Message] = {}
        self.markers: list[Message] = []

    def lines(self, name: str, number: int, ends: FloatArray, colours: Sequence[_Colour], width: float) -> None:
        """Add line segments with ends of Shape (2 n, 2), in one colour or one per end; if empty, delete the marker."""
        if not len(ends):
            self.mark(name, number, action=_DELETE)
            return
        place = self._types("geometry_msgs/msg/Point")
        points = [place(x=x, y=y, z=0.0) for x, y in ends.tolist()]
        each = [self._colour(colour) for colour in colours] if len(colours) > 1 else []
        size = (width, 0.0, 0.0)
        self.mark(name, number, kind=_LINE_LIST, size=size, colour=colours[0], points=points, colours=each)

    def mark(  # noqa: PLR0913 - one parameter for each field
        self,
        name: str,
        number: int,
        *,
        kind: int = _ARROW,
        action: int = _ADD,
        at: Pose2 = _ORIGIN,
        size: tuple[float, float, float] = (0.0, 0.0, 0.0),
        colour: _Colour = _HOT,
        points: Sequence[Message] = (),
        colours: Sequence[Message] = (),
        text: str = "",
    ) -> None:
        """Add one marker with all fields, because classes of rosbags have no defaults."""
        types, image, mesh = self._types, "sensor_msgs/msg/CompressedImage", "visualization_msgs/msg/MeshFile"
        self.markers.append(
            made(
                types,
                "visualization_msgs/msg/Marker",
                header=self._head,
                ns=name,
                id=number,
                type=kind,
                action=action,
                pose=plain_pose_message(types, at),
                scale=made(types, "geometry_msgs/msg/Vector3", **dict(zip("xyz", size, strict=True))),
                color=self._colour(colour),
                lifetime=made(types, "builtin_interfaces/msg/Duration", sec=0, nanosec=0),
                frame_locked=False,
                points=list(points),
                colors=list(colours),
                texture_resource="",
                texture=made(types, image, header=self._head, format="", data=column(types, image, _NO_BYTES)),
                uv_coordinates=[],
                text=text,
                mesh_resource="",
                mesh_file=made(types, mesh, filename="", data=column(types, image, _NO_BYTES)),
                mesh_use_embedded_materials=False,
            )
        )

    def _colour(self, colour: _Colour) -> Message:
        if colour not in self._colours:
            channels = dict(zip("rgba", colour, strict=True))
            self._colours[colour] = made(self._types, "std_msgs/msg/ColorRGBA", **channels)
        return self._colours[colour]
