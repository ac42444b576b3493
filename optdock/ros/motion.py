"""Messages of poses, paths, twists, odometry, outlines, transforms and diagnostics."""

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

# [rad] of roll and pitch together: more than on ramps and in 3-D localization on a floor. A larger tilt indicates a
# frame whose z axis does not point up and whose yaw is meaningless.
MOST_TILTED = 0.1
QUATERNION_NORM = 0.01  # deviation of a quaternion's length from 1, as accepted by the transforms of ROS

_Level = Literal["ok", "warn", "error", "stale"]
_LEVELS: Mapping[_Level, int] = {"ok": 0, "warn": 1, "error": 2, "stale": 3}


class StampedPoses(NamedTuple):
    """A path: frame, stamp [s], read-only poses of Shape (n, 3); n may be 0."""

    frame: str
    stamp: float
    poses: FloatArray


class StampedPose(NamedTuple):
    """A pose, its frame and its stamp [s]."""

    frame: str
    stamp: float
    pose: Pose2


class StampedTwist(NamedTuple):
    """A body velocity; without a header, the frame is empty and the stamp [s] is None."""

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


# From messages.


def path_poses(message: Message) -> StampedPoses:
    """Return the poses of a `nav_msgs/Path` without heights.

    Raises:
        InvalidMessage: If a number is not finite, a quaternion does not have length 1 or is tilted by more than
            `MOST_TILTED`, there is no frame, or a pose has a different frame.
    """
    frame, stamp = stamped_frame(message)
    rows = []
    for index, one in enumerate(message.poses):
        if one.header.frame_id not in (frame, ""):
            refuse(
                message, f"poses[{index}].header.frame_id", f"must be the path's, {frame!r}", repr(one.header.frame_id)
            )
        at, turn = one.pose.position, one.pose.orientation
        rows.append((at.x, at.y, at.z, turn.x, turn.y, turn.z, turn.w))
    table = np.array(rows, dtype=np.float64).reshape(-1, 7)
    yaw = _checked_yaws(message, table, "poses[{}].pose", MOST_TILTED)
    return StampedPoses(frame, stamp, readonly(np.column_stack((table[:, :2], yaw))))


def pose(message: Message) -> StampedPose:
    """Return the pose of a `geometry_msgs/PoseStamped` without its height.

    Raises:
        InvalidMessage: If a number is not finite, the quaternion does not have length 1 or is tilted by more than
            `MOST_TILTED`, or there is no frame.
    """
    return StampedPose(*stamped_frame(message), plain_pose(message, message.pose, "pose"))


def odometry(message: Message) -> StampedOdometry:
    """Return the planar pose and twist of a `nav_msgs/Odometry`, without covariances.

    Raises:
        InvalidMessage: If a number is not finite, the quaternion does not have length 1 or is tilted by more than
            `MOST_TILTED`, or there is no frame.
    """
    frame, stamp = stamped_frame(message)
    at, moves = message.pose.pose, message.twist.twist
    return StampedOdometry(
        frame,
        str(message.child_frame_id),
        stamp,
        plain_pose(message, at, "pose.pose"),
        _plain_twist(message, moves, "twist.twist"),
    )


def twist(message: Message) -> StampedTwist:
    """Return the velocity of a `geometry_msgs/Twist` or a `geometry_msgs/TwistStamped`.

    An empty frame of a `TwistStamped` means the frame of the robot.

    Raises:
        InvalidMessage: If a number is not finite, or the stamp is invalid.
    """
    if not hasattr(message, "header"):
        return StampedTwist("", None, _plain_twist(message, message, ""))
    found = _plain_twist(message, message.twist, "twist")
    if not message.header.frame_id:
        return StampedTwist("", seconds(message.header.stamp), found)
    return StampedTwist(*stamped_frame(message), found)


def footprint(message: Message, at: Pose2 | None = None) -> StampedFootprint:
    """Return the outline of a `geometry_msgs/PolygonStamped`.

    Args:
        message: The message.
        at: Pose of the robot in the message's frame: the outline is transformed into the robot's frame, as required for
            `published_footprint`. None: no transformation.

    Raises:
        InvalidMessage: If a number is not finite, there is no frame, or the points do not form a simple polygon.
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
    """Return the pose of a `geometry_msgs/Pose` in a field of a message.

    Raises:
        InvalidMessage: As `pose`.
    """
    at, turn = value.position, value.orientation
    x, y, z, w = turn.x, turn.y, turn.z, turn.w
    length = math.sqrt(x * x + y * y + z * z + w * w)
    finite = math.isfinite(at.x) and math.isfinite(at.y) and math.isfinite(at.z)
    if finite and abs(length - 1.0) <= QUATERNION_NORM:
        tilt = 2.0 * math.asin(min(math.hypot(x, y) / length, 1.0))
        if tilt <= most_tilted:
            return Pose2(float(at.x), float(at.y), math.atan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z))
    _checked_yaws(message, np.array([[at.x, at.y, at.z, x, y, z, w]], dtype=np.float64), field, most_tilted)
    raise AssertionError  # unreachable: the row is invalid


def _checked_yaws(message: Message, table: FloatArray, field: str, most_tilted: float) -> FloatArray:
    """Return the yaws of poses, Shape (n,): the headings of their x axes seen from above.

    Args:
        message: Message with the poses.
        table: Positions and quaternions, Shape (n, 7): x, y, z, x, y, z, w.
        field: Name of the field, with `{}` for the index.
        most_tilted: Largest accepted tilt of a z axis [rad].
    """
    bad = np.argwhere(~np.isfinite(table))
    if bad.size:
        row, part = bad[0].tolist()
        names = *(f"position.{axis}" for axis in "xyz"), *(f"orientation.{axis}" for axis in "xyzw")
        refuse(message, f"{field.format(row)}.{names[part]}", "must be finite", table[row, part])
    x, y, z, w = table[:, 3:].T
    length = np.hypot(np.hypot(x, y), np.hypot(z, w))  # does not overflow
    tilt = 2.0 * np.arcsin(np.minimum(np.hypot(x, y) / np.where(length > 0.0, length, 1.0), 1.0))
    for wrong, values, unit, rule in (
        (~(np.abs(length - 1.0) <= QUATERNION_NORM), length, "", f"must be of length 1 within {QUATERNION_NORM}"),
        (
            tilt > most_tilted,
            tilt,
            " rad",
            f"must rotate about the vertical axis only, tilted by at most {most_tilted:.4g} rad",
        ),
    ):
        if wrong.any():
            row = int(np.argmax(wrong))
            quaternion = ", ".join(f"{value:.4g}" for value in table[row, 3:])
            refuse(message, f"{field.format(row)}.orientation", rule, f"{values[row]:.4g}{unit} for ({quaternion})")
    yaws: FloatArray = np.arctan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)
    return yaws


def _plain_twist(message: Message, value: Message, field: str) -> Twist2:
    """Return the planar velocity of a `geometry_msgs/Twist` in a field of a message; all six numbers must be finite."""
    for part in ("linear", "angular"):
        vector = getattr(value, part)
        for axis in "xyz":
            speed = getattr(vector, axis)
            if not math.isfinite(speed):
                refuse(message, ".".join(filter(None, (field, part, axis))), "must be finite", speed)
    return Twist2(float(value.linear.x), float(value.angular.z), float(value.linear.y))


# To messages.


def path_message(types: MessageTypes, poses: ArrayLike, frame: str, stamp: float) -> Message:
    """Return a `nav_msgs/Path` of poses, Shape (n, 3), which share one header with the stamp [s].

    Raises:
        InvalidValue: If the shape is wrong, a number is not finite, or the frame or the time is invalid.
    """
    rows = frozen_array(poses, "poses", columns=3) if np.size(poses) else np.zeros((0, 3))
    head = header(types, frame, stamp)
    one, place, turn, stamped = (
        types(f"geometry_msgs/msg/{name}") for name in ("Pose", "Point", "Quaternion", "PoseStamped")
    )
    half = 0.5 * rows[:, 2]
    columns = (rows[:, 0], rows[:, 1], np.sin(half), np.cos(half))
    parts = [
        stamped(header=head, pose=one(position=place(x=x, y=y, z=0.0), orientation=turn(x=0.0, y=0.0, z=z, w=w)))
        for x, y, z, w in zip(*(values.tolist() for values in columns), strict=True)
    ]
    return made(types, "nav_msgs/msg/Path", header=head, poses=parts)


def pose_message(types: MessageTypes, pose: Pose2, frame: str, stamp: float) -> Message:
    """Return a `geometry_msgs/PoseStamped`.

    Raises:
        InvalidValue: If the frame or the time is invalid.
    """
    head = header(types, frame, stamp)
    return made(types, "geometry_msgs/msg/PoseStamped", header=head, pose=plain_pose_message(types, pose))


def twist_message(types: MessageTypes, twist: Twist2, frame: str = "", stamp: float = 0.0, *, stamped: bool) -> Message:
    """Return a `geometry_msgs/Twist`, or a `geometry_msgs/TwistStamped` with frame and stamp [s] if `stamped`.

    Raises:
        InvalidValue: If the frame or the time of a `TwistStamped` is invalid.
    """
    value = _twist_value(types, twist)
    if not stamped:
        return value
    return made(types, "geometry_msgs/msg/TwistStamped", header=header(types, frame, stamp), twist=value)


def odometry_message(
    types: MessageTypes, pose: Pose2, twist: Twist2, frame: str, child_frame: str, stamp: float
) -> Message:
    """Return a `nav_msgs/Odometry`: pose of `child_frame` in `frame` and body velocity at `stamp` [s].

    The covariances are zero, which means unknown.

    Raises:
        InvalidValue: If a frame is empty, or the time is invalid.
    """
    at, moves = plain_pose_message(types, pose), _twist_value(types, twist)
    return made(
        types,
        "nav_msgs/msg/Odometry",
        header=header(types, frame, stamp),
        child_frame_id=checked_frame(child_frame, "child_frame"),
        pose=made(types, "geometry_msgs/msg/PoseWithCovariance", pose=at, covariance=np.zeros(36)),
        twist=made(types, "geometry_msgs/msg/TwistWithCovariance", twist=moves, covariance=np.zeros(36)),
    )


def polygon_message(types: MessageTypes, vertices: ArrayLike, frame: str, stamp: float) -> Message:
    """Return a `geometry_msgs/PolygonStamped` of corners, Shape (n, 2) [m], rounded to 32 bits.

    Raises:
        InvalidValue: If the shape is wrong, a number is not finite, or the frame or the time is invalid.
    """
    corners = frozen_array(vertices, "vertices", columns=2).tolist()
    points = [made(types, "geometry_msgs/msg/Point32", x=x, y=y, z=0.0) for x, y in corners]
    polygon = made(types, "geometry_msgs/msg/Polygon", points=points)
    return made(types, "geometry_msgs/msg/PolygonStamped", header=header(types, frame, stamp), polygon=polygon)


def transforms_message(types: MessageTypes, transforms: Sequence[tuple[str, str, Pose2]], stamp: float) -> Message:
    """Return a `tf2_msgs/TFMessage` of transforms with one stamp [s]: frame, child frame, pose of the child.

    Raises:
        InvalidValue: If a frame is empty, or the time is invalid.
    """
    found = []
    for frame, child, at in transforms:
        place = made(types, "geometry_msgs/msg/Vector3", x=at.x, y=at.y, z=0.0)
        turn = plain_pose_message(types, at).orientation
        found.append(
            made(
                types,
                "geometry_msgs/msg/TransformStamped",
                header=header(types, frame, stamp),
                child_frame_id=checked_frame(child, "child_frame"),
                transform=made(types, "geometry_msgs/msg/Transform", translation=place, rotation=turn),
            )
        )
    return made(types, "tf2_msgs/msg/TFMessage", transforms=found)


def diagnostics_message(
    types: MessageTypes,
    name: str,
    level: _Level,
    text: str,
    values: Mapping[str, object],
    stamp: float,
) -> Message:
    """Return a `diagnostic_msgs/DiagnosticArray` with one status at `stamp` [s].

    The level is `ok`, `warn`, `error` or `stale`. Floats among the values are written with six digits.

    Raises:
        InvalidValue: If there is no such level, or the time is invalid.
    """
    if level not in _LEVELS:
        raise InvalidValue(f"level: must be one of {', '.join(_LEVELS)}, got {level!r}")
    pairs = []
    for key, value in values.items():
        shown = f"{value:.6g}" if isinstance(value, float | np.floating) else str(value)
        pairs.append(made(types, "diagnostic_msgs/msg/KeyValue", key=str(key), value=shown))
    kind = types("diagnostic_msgs/msg/DiagnosticStatus")
    # The field is `bytes` in rclpy, and a number in rosbags.
    number: object = _LEVELS[level] if hasattr(kind, "__dataclass_fields__") else bytes([_LEVELS[level]])
    status = made(
        types,
        "diagnostic_msgs/msg/DiagnosticStatus",
        level=number,
        name=name,
        message=text,
        hardware_id="optdock",
        values=pairs,
    )
    head = made(types, "std_msgs/msg/Header", stamp=messages.stamp(types, stamp), frame_id="")
    return made(types, "diagnostic_msgs/msg/DiagnosticArray", header=head, status=[status])


def plain_pose_message(types: MessageTypes, at: Pose2) -> Message:
    """Return a `geometry_msgs/Pose`."""
    half = 0.5 * at.yaw
    place = made(types, "geometry_msgs/msg/Point", x=at.x, y=at.y, z=0.0)
    turn = made(types, "geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=math.sin(half), w=math.cos(half))
    return made(types, "geometry_msgs/msg/Pose", position=place, orientation=turn)


def _twist_value(types: MessageTypes, moves: Twist2) -> Message:
    linear = made(types, "geometry_msgs/msg/Vector3", x=moves.linear, y=moves.lateral, z=0.0)
    angular = made(types, "geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=moves.angular)
    return made(types, "geometry_msgs/msg/Twist", linear=linear, angular=angular)
