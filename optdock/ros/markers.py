"""A plan as markers: its path coloured by gear, the outlines that it sweeps, the goal, the closest point."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np
import shapely

from optdock.errors import InvalidValue
from optdock.geometry.arrays import FloatArray, readonly
from optdock.geometry.checked import sampling_step
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

__all__ = ["SWEPT_EVERY", "delete_markers", "path_markers", "plan_markers"]

SWEPT_EVERY = 0.1  # [m] between outlines: they overlap for any robot that docks, and 10 m are 100 of them
_SPACING = 0.02  # [m] between drawn points, as in pictures
_WIDTH, _THIN = 0.02, 0.005  # [m] of lines: seen from above a whole room, and not hiding one another
_TEXT = 0.1  # [m], height of letters
# Kinds and actions by their numbers, as the message's definition has them.
_ARROW, _LINE_LIST, _TEXT_FACING = 0, 5, 9
_ADD, _DELETE, _DELETE_ALL = 0, 2, 3

_ARROW_LENGTH = 0.3  # [m], where no outline says how large the robot is
_ORIGIN = Pose2(0.0, 0.0, 0.0)
_NO_BYTES = readonly(np.zeros(0, dtype=np.uint8))
_Colour: TypeAlias = tuple[float, float, float, float]

# Red, green, blue, alpha. Forward and reverse as in pictures.
_FORWARD, _REVERSE, _TURN = (0.12, 0.47, 0.71, 1.0), (0.84, 0.37, 0.0, 1.0), (0.58, 0.4, 0.74, 1.0)
_SWEPT, _GOAL, _HOT = (0.5, 0.5, 0.5, 0.5), (0.17, 0.63, 0.17, 0.9), (0.84, 0.15, 0.16, 1.0)


def plan_markers(
    types: MessageTypes, plan: DockPlan, frame: str, stamp: float, *, swept_every: float = SWEPT_EVERY
) -> Message:
    """A plan as a `visualization_msgs/MarkerArray`, as `path_markers`.

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
        swept_every=swept_every,
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
    swept_every: float = SWEPT_EVERY,
) -> Message:
    """A path as a `visualization_msgs/MarkerArray`.

    It always holds the same markers, by namespace and id, so that it takes the place of the one before it; what there
    is nothing to say of is deleted.

    Args:
        types: Gives the classes.
        path: Blue where driven forward, orange in reverse.
        frame: In which it stands.
        stamp: Of the markers [s].
        footprint: The robot's outline, for what it sweeps, and at the goal.
        obstacles: Among which the closest point is looked for.
        certificate: Says where the path is closest to them.
        swept_every: Distance of outlines along the path [m].

    Raises:
        InvalidValue: The path stands in another frame, the frame is empty, there is no time, or the distance of
            outlines is not > 0.
    """
    if not may_be_one_frame(path.frame, frame):
        raise InvalidValue(f"frame: the path stands in {path.frame!r}, not in {frame!r}; transform it first")
    step = sampling_step(swept_every, path.length, "swept_every")
    size = _ARROW_LENGTH if footprint is None else footprint.circumscribed_radius
    draw = _Pen(types, header(types, frame, stamp))
    draw.lines("path", 0, *_gears(path), _WIDTH)
    draw.lines("swept footprint", 0, _outlines(footprint, path.poses_at(_stations(path, step))), [_SWEPT], _THIN)
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
    """A `visualization_msgs/MarkerArray` that takes away all markers of its topic.

    Raises:
        InvalidValue: The frame is empty, or there is no time.
    """
    draw = _Pen(types, header(types, frame, stamp))
    draw.mark("", 0, action=_DELETE_ALL)
    return made(types, "visualization_msgs/msg/MarkerArray", markers=draw.markers)


class _Closest(NamedTuple):
    """Where a path is closest to an obstacle: edges of the outline, the line between the two, in words."""

    outline: FloatArray
    line: FloatArray
    text: str


_NOTHING = readonly(np.zeros((0, 2)))


def _closest(
    path: Path, footprint: Footprint | None, obstacles: ObstacleSet | None, certificate: Certificate | None
) -> _Closest:
    """What a certificate says of it; nothing where it says nothing, or robot and obstacles are unknown."""
    if footprint is None or obstacles is None or certificate is None or not math.isfinite(certificate.min_clearance):
        return _Closest(_NOTHING, _NOTHING, "")
    pose = path.poses_at(certificate.at_s)
    _, rows = pose_clearances(pose, footprint, obstacles)
    body, obstacle = transform_points(pose, footprint.vertices)[0], obstacles.vertices[rows[0]]
    line = shapely.get_coordinates(shapely.shortest_line(shapely.Polygon(body), shapely.Polygon(obstacle)))
    text = f"{1e3 * certificate.min_clearance:.0f} mm to {in_words(certificate.nearest)}"
    return _Closest(_outlines(footprint, pose), line, text)


def _gears(path: Path) -> tuple[FloatArray, list[_Colour]]:
    """Pieces of line by their ends, Shape (2 n, 2), and a colour for every end."""
    samples = path.sample(_SPACING)
    points = np.column_stack((samples.x, samples.y))
    ends = np.stack((points[:-1], points[1:]), axis=1).reshape(-1, 2)
    colours = {1: _FORWARD, -1: _REVERSE, 0: _TURN}
    # Two samples stand at a cusp, one of each gear, so that a piece of line has the gear of its beginning.
    return ends, [colours[gear] for gear in np.repeat(samples.direction[:-1], 2).tolist()]


def _stations(path: Path, step: float) -> FloatArray:
    """Arc lengths at most `step` apart, ends and cusps among them."""
    count = max(1, math.ceil(path.length / step))
    stations: FloatArray = np.unique(np.concatenate((np.linspace(0.0, path.length, count + 1), path.cusps)))
    return stations


def _outlines(footprint: Footprint | None, poses: FloatArray) -> FloatArray:
    """The edges of an outline at every pose by their ends, Shape (2 n, 2); none of no outline."""
    if footprint is None:
        return _NOTHING
    corners = transform_points(poses, footprint.vertices)
    return np.stack((corners, np.roll(corners, -1, axis=1)), axis=2).reshape(-1, 2)


class _Pen:
    """Makes markers of one header."""

    def __init__(self, types: MessageTypes, head: Message) -> None:
        self._types, self._head = types, head
        self._inks: dict[_Colour, Message] = {}
        self.markers: list[Message] = []

    def lines(self, name: str, number: int, ends: FloatArray, colours: Sequence[_Colour], width: float) -> None:
        """Pieces of line by their ends, Shape (2 n, 2), in one colour or with one for every end; deleted where none."""
        if not len(ends):
            self.mark(name, number, action=_DELETE)
            return
        place = self._types("geometry_msgs/msg/Point")
        points = [place(x=x, y=y, z=0.0) for x, y in ends.tolist()]
        each = [self._ink(colour) for colour in colours] if len(colours) > 1 else []
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
        """One more marker, every field of it: classes of rosbags have no defaults."""
        types, none = self._types, "sensor_msgs/msg/CompressedImage"
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
                color=self._ink(colour),
                lifetime=made(types, "builtin_interfaces/msg/Duration", sec=0, nanosec=0),
                frame_locked=False,
                points=list(points),
                colors=list(colours),
                texture_resource="",
                texture=made(types, none, header=self._head, format="", data=column(types, none, _NO_BYTES)),
                uv_coordinates=[],
                text=text,
                mesh_resource="",
                mesh_file=made(
                    types, "visualization_msgs/msg/MeshFile", filename="", data=column(types, none, _NO_BYTES)
                ),
                mesh_use_embedded_materials=False,
            )
        )

    def _ink(self, colour: _Colour) -> Message:
        if colour not in self._inks:
            channels = dict(zip("rgba", colour, strict=True))
            self._inks[colour] = made(self._types, "std_msgs/msg/ColorRGBA", **channels)
        return self._inks[colour]
