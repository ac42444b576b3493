"""ROS 2 messages from and to values of this library, without ROS.

Nothing here imports a ROS package. Reading takes any object with a message's fields: those of `rclpy`, of `rosbags`, or
a stand-in. Writing takes the classes from the caller as `MessageTypes`, a function from names such as
`"nav_msgs/msg/Path"` to classes. Every value that is read is checked: times, frames, numbers, quaternions, sizes; what
is wrong is an `InvalidMessage` that names message, field, index, value and rule.
"""

from __future__ import annotations

from optdock.errors import InvalidMessage
from optdock.ros.grids import StampedCostmap, costmap, costmap_message, occupancy_message, patched
from optdock.ros.markers import delete_markers, path_markers, plan_markers
from optdock.ros.messages import Message, MessageTypes, imported, seconds, stamp
from optdock.ros.motion import (
    MOST_TILTED,
    StampedFootprint,
    StampedOdometry,
    StampedPose,
    StampedPoses,
    StampedTwist,
    diagnostics_message,
    footprint,
    odometry,
    odometry_message,
    path_message,
    path_poses,
    polygon_message,
    pose,
    pose_message,
    transforms_message,
    twist,
    twist_message,
)
from optdock.ros.transforms import Transform, TransformError, TransformTree

__all__ = [
    "MOST_TILTED",
    "InvalidMessage",
    "Message",
    "MessageTypes",
    "StampedCostmap",
    "StampedFootprint",
    "StampedOdometry",
    "StampedPose",
    "StampedPoses",
    "StampedTwist",
    "Transform",
    "TransformError",
    "TransformTree",
    "costmap",
    "costmap_message",
    "delete_markers",
    "diagnostics_message",
    "footprint",
    "imported",
    "occupancy_message",
    "odometry",
    "odometry_message",
    "patched",
    "path_markers",
    "path_message",
    "path_poses",
    "plan_markers",
    "polygon_message",
    "pose",
    "pose_message",
    "seconds",
    "stamp",
    "transforms_message",
    "twist",
    "twist_message",
]
