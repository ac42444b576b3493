"""Poses, paths, twists, odometry, outlines and diagnostics."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from optdock.errors import InvalidValue
from optdock.geometry.arrays import FloatArray, frozen_array, readonly
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2, Twist2, transform_points
from optdock.ros import messages
from optdock.ros.messages import checked_frame, header, made, refuse, seconds, stamped_frame

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import ArrayLike

    from optdock.ros.messages import Message, MessageTypes

__all__ = [
    "MOST_TILTED",
    "QUATERNION_NORM",
    "StampedFootprint",
    "StampedOdometry",
    "StampedPose",
    "StampedPoses",
    "StampedTwist",
    "checked_yaws",
    "diagnostics_message",
    "footprint",
    "odometry",
    "odometry_message",
    "path_message",
    "path_poses",
    "plain_pose",
    "plain_pose_message",
    "polygon_message",
    "pose",
    "pose_message",
    "transforms_message",
    "twist",
    "twist_message",
]

# [rad] of roll and pitch together. What localization in three dimensions says of a robot on a floor, ramps included,
# is less; what is more comes from a frame whose z axis does not point up, and its yaw means nothing here.
MOST_TILTED = 0.1
QUATERNION_NORM = (
    0.01  # of a quaternion's length from 1: what ROS's own transforms accept; a zero quaternion is far outside
)

_Level = Literal["ok", "warn", "error", "stale"]
_LEVELS: Mapping[_Level, int] = {"ok": 0, "warn": 1, "error": 2, "stale": 3}


class StampedPoses(NamedTuple):
    """A path as it was sent: frame, stamp [s], poses of Shape (n, 3), read-only; n may be 0."""

    frame: str
    stamp: float
    poses: FloatArray


class StampedPose(NamedTuple):
    """A pose, its frame and its stamp [s]."""

    frame: str
    stamp: float
    pose: Pose2


class StampedTwist(NamedTuple):
    """A body velocity; frame and stamp [s] are those of its header, and empty and None where it has none."""

    frame: str
    stamp: float | None
    twist: Twist2


class StampedOdometry(NamedTuple):
    """Pose of the frame `child_frame` in `frame`, and its body velocity, at `stamp` [s]."""

    frame: str
    child_frame: str
    stamp: float
    pose: Pose2
    twist: Twist2


class StampedFootprint(NamedTuple):
    """An outline, its frame and its stamp [s]."""

    frame: str
    stamp: float
    footprint: Footprint


def path_poses(message: Message) -> StampedPoses:
    """The poses of a `nav_msgs/Path`; heights are left out.

    Raises:
        InvalidMessage: A number is not finite, a quaternion is not of length 1 or tilted by more than `MOST_TILTED`,
            there is no frame, or a pose has another one.
    """
    frame, stamp = stamped_frame(message)
    rows = []
    for one in message.poses:
        at, turn = one.pose.position, one.pose.orientation
        rows.append((at.x, at.y, at.z, turn.x, turn.y, turn.z, turn.w))
    for index, one in enumerate(message.poses):
        if one.header.frame_id not in (frame, ""):
            refuse(
                message, f"poses[{index}].header.frame_id", f"must be the path's, {frame!r}", repr(one.header.frame_id)
            )
    table = np.array(rows, dtype=np.float64).reshape(-1, 7)
    yaw = checked_yaws(message, table, "poses[{}].pose")
    return StampedPoses(frame, stamp, readonly(np.column_stack((table[:, :2], yaw))))


def pose(message: Message, *, most_tilted: float = MOST_TILTED) -> StampedPose:
    """The pose of a `geometry_msgs/PoseStamped`; its height is left out.

    Args:
        message: The pose.
        most_tilted: How much its z axis may lean [rad]; pi for any.

    Raises:
        InvalidMessage: A number is not finite, the quaternion is not of length 1 or tilted by more, there is no frame.
    """
    frame, stamp = stamped_frame(message)
    return StampedPose(frame, stamp, plain_pose(message, message.pose, "pose", most_tilted))


def odometry(message: Message) -> StampedOdometry:
    """A `nav_msgs/Odometry`; heights and what is not of the plane are left out, covariances too.

    Raises:
        InvalidMessage: A number is not finite, the quaternion is not of length 1 or tilted by more than `MOST_TILTED`,
            there is no frame.
    """
    frame, stamp = stamped_frame(message)
    at = plain_pose(message, message.pose.pose, "pose.pose")
    moves = _plain_twist(message, message.twist.twist, "twist.twist")
    return StampedOdometry(frame, str(message.child_frame_id), stamp, at, moves)


def twist(message: Message) -> StampedTwist:
    """A `geometry_msgs/Twist`, which has neither frame nor stamp, or a `geometry_msgs/TwistStamped`.

    A stamped one may have an empty frame: it is the robot's.

    Raises:
        InvalidMessage: A number is not finite, or the stamp is not a time.
    """
    if not hasattr(message, "header"):
        return StampedTwist("", None, _plain_twist(message, message, ""))
    found = _plain_twist(message, message.twist, "twist")
    if not message.header.frame_id:
        return StampedTwist("", seconds(message.header.stamp), found)
    frame, stamp = stamped_frame(message)
    return StampedTwist(frame, stamp, found)


def footprint(message: Message, at: Pose2 | None = None) -> StampedFootprint:
    """The outline of a `geometry_msgs/PolygonStamped`.

    Args:
        message: The polygon.
        at: Where the robot stands in the message's frame; the outline is taken back into the robot's frame then, as
            that of `published_footprint` must be. None: left where it is.

    Raises:
        InvalidMessage: A number is not finite, there is no frame, or the points are no simple polygon.
    """
    frame, stamp = stamped_frame(message)
    points = message.polygon.points
    corners = np.array([(point.x, point.y) for point in points], dtype=np.float64).reshape(-1, 2)
    bad = np.argwhere(~np.isfinite(corners))
    if bad.size:
        row, part = bad[0].tolist()
        refuse(message, f"polygon.points[{row}].{'xy'[part]}", "must be finite", corners[row, part])
    try:
        if at is not None:
            corners = transform_points(at.inverse().as_array()[None], corners)[0]
        return StampedFootprint(frame, stamp, Footprint(corners))
    except InvalidValue as error:
        refuse(message, "polygon", f"must be a simple polygon ({error})", f"{len(points)} points")


def plain_pose(message: Message, value: Message, field: str, most_tilted: float = MOST_TILTED) -> Pose2:
    """The `geometry_msgs/Pose` in a field of a message, checked.

    Raises:
        InvalidMessage: As `pose`.
    """
    at, turn = value.position, value.orientation
    x, y, z, w = turn.x, turn.y, turn.z, turn.w
    length = math.sqrt(x * x + y * y + z * z + w * w)
    finite = math.isfinite(at.x) and math.isfinite(at.y) and math.isfinite(at.z)
    if finite and abs(length - 1.0) <= QUATERNION_NORM and _tilt(x, y, length) <= most_tilted:
        return Pose2(float(at.x), float(at.y), math.atan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z))
    row = np.array([[at.x, at.y, at.z, x, y, z, w]], dtype=np.float64)
    checked_yaws(message, row, field, most_tilted)
    raise AssertionError  # the row is wrong, and that has been said


def checked_yaws(message: Message, table: FloatArray, field: str, most_tilted: float = MOST_TILTED) -> FloatArray:
    """The yaws of poses, Shape (n,), each the heading of the x axis seen from above.

    Args:
        message: That holds them.
        table: Positions and quaternions, Shape (n, 7): x, y, z, x, y, z, w.
        field: Their field, `{}` for the index.
        most_tilted: How much a z axis may lean [rad].

    Raises:
        InvalidMessage: A number is not finite, a quaternion not of length 1, or tilted by more.
    """
    bad = np.argwhere(~np.isfinite(table))
    if bad.size:
        row, part = bad[0].tolist()
        names = *(f"position.{axis}" for axis in "xyz"), *(f"orientation.{axis}" for axis in "xyzw")
        refuse(message, f"{field.format(row)}.{names[part]}", "must be finite", table[row, part])
    x, y, z, w = table[:, 3:].T
    length = np.hypot(np.hypot(x, y), np.hypot(z, w))  # which does not overflow
    off = np.flatnonzero(~(np.abs(length - 1.0) <= QUATERNION_NORM))
    if off.size:
        row = int(off[0])
        told = f"{length[row]:.4g} for {_listed(table[row, 3:])}"
        refuse(message, f"{field.format(row)}.orientation", f"must be of length 1 within {QUATERNION_NORM}", told)
    leans = 2.0 * np.arcsin(np.minimum(np.hypot(x, y) / length, 1.0))
    off = np.flatnonzero(leans > most_tilted)
    if off.size:
        row = int(off[0])
        told = f"{leans[row]:.4g} rad for {_listed(table[row, 3:])}"
        rule = f"must turn about the vertical alone, tilted by at most {most_tilted:.4g} rad"
        refuse(message, f"{field.format(row)}.orientation", rule, told)
    yaws: FloatArray = np.arctan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)
    return yaws


def _tilt(x: float, y: float, length: float) -> float:
    """How far the z axis leans [rad]."""
    return 2.0 * math.asin(min(math.hypot(x, y) / length, 1.0))


def _listed(values: FloatArray) -> str:
    return f"({', '.join(f'{value:.4g}' for value in values)})"


def _plain_twist(message: Message, value: Message, field: str) -> Twist2:
    """The `geometry_msgs/Twist` in a field of a message; finite, also what is not of the plane."""
    for part in ("linear", "angular"):
        vector = getattr(value, part)
        for axis in "xyz":
            speed = getattr(vector, axis)
            if not math.isfinite(speed):
                refuse(message, ".".join(filter(None, (field, part, axis))), "must be finite", speed)
    return Twist2(float(value.linear.x), float(value.angular.z), float(value.linear.y))


def path_message(types: MessageTypes, poses: ArrayLike, frame: str, stamp: float) -> Message:
    """A `nav_msgs/Path`; its poses share one header.

    Args:
        types: Gives the classes.
        poses: Shape (n, 3).
        frame: In which they stand.
        stamp: Of all of them [s].

    Raises:
        InvalidValue: Another shape, a number that is not finite, no frame, or no time.
    """
    rows = frozen_array(poses, "poses", columns=3) if np.size(poses) else np.zeros((0, 3))
    head = header(types, frame, stamp)
    one, place, turn, stamped = (
        types(f"geometry_msgs/msg/{name}") for name in ("Pose", "Point", "Quaternion", "PoseStamped")
    )
    half = 0.5 * rows[:, 2]
    columns = (rows[:, 0], rows[:, 1], np.sin(half), np.cos(half))
    made_of = [
        stamped(header=head, pose=one(position=place(x=x, y=y, z=0.0), orientation=turn(x=0.0, y=0.0, z=z, w=w)))
        for x, y, z, w in zip(*(values.tolist() for values in columns), strict=True)
    ]
    return made(types, "nav_msgs/msg/Path", header=head, poses=made_of)


def pose_message(types: MessageTypes, pose: Pose2, frame: str, stamp: float) -> Message:
    """A `geometry_msgs/PoseStamped`.

    Raises:
        InvalidValue: No frame, or no time.
    """
    return made(
        types, "geometry_msgs/msg/PoseStamped", header=header(types, frame, stamp), pose=plain_pose_message(types, pose)
    )


def twist_message(types: MessageTypes, twist: Twist2, frame: str = "", stamp: float = 0.0, *, stamped: bool) -> Message:
    """A `geometry_msgs/Twist`, or a `TwistStamped`, as `cmd_vel` is configured.

    Args:
        types: Gives the classes.
        twist: Body velocity.
        frame: The robot's; of a stamped one.
        stamp: Of a stamped one [s].
        stamped: Which of the two.

    Raises:
        InvalidValue: A stamped one has no frame, or no time.
    """
    value = _twist_value(types, twist)
    if not stamped:
        return value
    return made(types, "geometry_msgs/msg/TwistStamped", header=header(types, frame, stamp), twist=value)


def odometry_message(
    types: MessageTypes, pose: Pose2, twist: Twist2, frame: str, child_frame: str, stamp: float
) -> Message:
    """A `nav_msgs/Odometry` whose covariances are zero: not known.

    Args:
        types: Gives the classes.
        pose: Of `child_frame` in `frame`.
        twist: Body velocity.
        frame: Such as odom.
        child_frame: Such as base_link.
        stamp: When both were measured [s].

    Raises:
        InvalidValue: A frame is empty, or there is no time.
    """
    unknown = np.zeros(36)
    with_pose = made(
        types, "geometry_msgs/msg/PoseWithCovariance", pose=plain_pose_message(types, pose), covariance=unknown.copy()
    )
    with_twist = made(
        types, "geometry_msgs/msg/TwistWithCovariance", twist=_twist_value(types, twist), covariance=unknown.copy()
    )
    return made(
        types,
        "nav_msgs/msg/Odometry",
        header=header(types, frame, stamp),
        child_frame_id=checked_frame(child_frame, "child_frame"),
        pose=with_pose,
        twist=with_twist,
    )


def polygon_message(types: MessageTypes, vertices: ArrayLike, frame: str, stamp: float) -> Message:
    """A `geometry_msgs/PolygonStamped` of corners, Shape (n, 2) [m]; its numbers have seven digits.

    Raises:
        InvalidValue: Another shape, a number that is not finite, no frame, or no time.
    """
    corners = frozen_array(vertices, "vertices", columns=2).tolist()
    points = [made(types, "geometry_msgs/msg/Point32", x=x, y=y, z=0.0) for x, y in corners]
    polygon = made(types, "geometry_msgs/msg/Polygon", points=points)
    return made(types, "geometry_msgs/msg/PolygonStamped", header=header(types, frame, stamp), polygon=polygon)


def transforms_message(types: MessageTypes, transforms: Sequence[tuple[str, str, Pose2]], stamp: float) -> Message:
    """A `tf2_msgs/TFMessage`.

    Args:
        types: Gives the classes.
        transforms: Frame, child frame, and the pose of the child in the frame.
        stamp: Of all of them [s].

    Raises:
        InvalidValue: A frame is empty, or there is no time.
    """
    found = []
    for frame, child, at in transforms:
        value = plain_pose_message(types, at)
        place = made(types, "geometry_msgs/msg/Vector3", x=at.x, y=at.y, z=0.0)
        move = made(types, "geometry_msgs/msg/Transform", translation=place, rotation=value.orientation)
        found.append(
            made(
                types,
                "geometry_msgs/msg/TransformStamped",
                header=header(types, frame, stamp),
                child_frame_id=checked_frame(child, "child_frame"),
                transform=move,
            )
        )
    return made(types, "tf2_msgs/msg/TFMessage", transforms=found)


def diagnostics_message(  # noqa: PLR0913 - one parameter for each field
    types: MessageTypes,
    name: str,
    level: _Level,
    text: str,
    values: Mapping[str, object],
    stamp: float,
    *,
    hardware: str = "optdock",
) -> Message:
    """A `diagnostic_msgs/DiagnosticArray` with one status.

    Args:
        types: Gives the classes.
        name: Of what is told about, such as `docking_server: certificate`.
        level: `ok`, `warn`, `error` or `stale`.
        text: In a line.
        values: What stands behind it; numbers are written with six digits.
        stamp: When it was so [s].
        hardware: The field `hardware_id`.

    Raises:
        InvalidValue: There is no such level, or no time.
    """
    if level not in _LEVELS:
        raise InvalidValue(f"level: must be one of {', '.join(_LEVELS)}, got {level!r}")
    pairs = [
        made(types, "diagnostic_msgs/msg/KeyValue", key=str(key), value=_told(value)) for key, value in values.items()
    ]
    kind = types("diagnostic_msgs/msg/DiagnosticStatus")
    # A byte is one in rclpy, and a number in rosbags.
    number: object = _LEVELS[level] if hasattr(kind, "__dataclass_fields__") else bytes([_LEVELS[level]])
    status = made(
        types,
        "diagnostic_msgs/msg/DiagnosticStatus",
        level=number,
        name=name,
        message=text,
        hardware_id=hardware,
        values=pairs,
    )
    head = made(types, "std_msgs/msg/Header", stamp=messages.stamp(types, stamp), frame_id="")
    return made(types, "diagnostic_msgs/msg/DiagnosticArray", header=head, status=[status])


def _told(value: object) -> str:
    return f"{value:.6g}" if isinstance(value, float | np.floating) else str(value)


def plain_pose_message(types: MessageTypes, at: Pose2) -> Message:
    """A `geometry_msgs/Pose`."""
    half = 0.5 * at.yaw
    place = made(types, "geometry_msgs/msg/Point", x=at.x, y=at.y, z=0.0)
    turn = made(types, "geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=math.sin(half), w=math.cos(half))
    return made(types, "geometry_msgs/msg/Pose", position=place, orientation=turn)


def _twist_value(types: MessageTypes, moves: Twist2) -> Message:
    ahead = made(types, "geometry_msgs/msg/Vector3", x=moves.linear, y=moves.lateral, z=0.0)
    turning = made(types, "geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=moves.angular)
    return made(types, "geometry_msgs/msg/Twist", linear=ahead, angular=turning)
