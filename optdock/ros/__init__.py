"""Conversion between ROS 2 messages and values of this library, without ROS.

This package does not import any ROS package. A message to be read may be any object with the fields of the message,
such as a message of `rclpy` or `rosbags`. To write messages, the caller passes `MessageTypes`, a function that maps
names such as `"nav_msgs/msg/Path"` to classes. Times, frames, numbers, quaternions and sizes are checked; an
`InvalidMessage` error contains message, field, index, value and rule.
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
