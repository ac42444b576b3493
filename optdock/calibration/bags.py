"""Recordings of ROS 2 as drives: odometry, commands, detections of the dock, transforms from map to odom."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from optdock.calibration.recording import Recording
from optdock.errors import InvalidFile, InvalidMessage
from optdock.ros.bag import open_bag
from optdock.ros.motion import odometry, pose, twist

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from optdock.geometry.arrays import FloatArray
    from optdock.ros.bag import BagRecording as Bag
    from optdock.ros.messages import Message

__all__ = ["recording_of_bag"]

_ODOMETRY = ("/odom", "/odometry/filtered")  # Nav2's names
_COMMANDS = ("/cmd_vel", "/cmd_vel_smoothed", "/cmd_vel_nav")
_DETECTED = ("/detected_dock_pose",)
_Value = TypeVar("_Value")

_KINDS = ("geometry_msgs/msg/TwistStamped", "geometry_msgs/msg/Twist")


def recording_of_bag(source: Path) -> Recording:
    """The drive in a recording; detections must be in the robot's frame, as `optdock bag` writes them.

    Raises:
        InvalidFile: It cannot be read or is damaged, or has no odometry or no commands.
        MissingExtra: The extra `bag` is not installed.
    """
    with open_bag(source) as bag:
        odom = _topic(bag, source, _ODOMETRY, ("nav_msgs/msg/Odometry",), "odometry")
        cmd = _topic(bag, source, _COMMANDS, _KINDS, "commands")
        told = [one for _, one in _values(bag, source, odom, odometry)]
        if len(told) < 2:  # from one pose to the next is how far the robot went
            raise InvalidFile(f"{source}: {odom}: needs two messages at least, has {len(told)}")
        begin, base = told[0].stamp, told[0].child_frame
        commands = [(time, one.twist) for time, one in _values(bag, source, cmd, twist)]
        seen = []
        topic = bag.find(_DETECTED, ("geometry_msgs/msg/PoseStamped",))
        for _, found in _values(bag, source, topic, pose):
            if found.frame != base:
                raise InvalidFile(f"{source}: {topic}: must be in frame {base}, is in {found.frame}")
            seen.append((found.stamp - begin, *found.pose.as_array(), 0.0, 0.0))
    rows = _rising(np.array([(one.stamp - begin, *one.pose.as_array()) for one in told]).reshape(-1, 4))
    twists = np.array([(one.twist.linear, one.twist.angular) for one in told]).reshape(-1, 2)
    asked = np.array([(time - begin, one.linear, one.angular) for time, one in commands]).reshape(-1, 3)
    asked = asked[_are_rising(asked[:, 0])]
    near = np.clip(np.searchsorted(rows[:, 0], asked[:, 0]), 0, max(len(rows) - 1, 0))
    told_twists = twists[_are_rising(np.array([one.stamp for one in told]))]
    return Recording(
        str(source), asked[:, 0], asked[:, 1:], told_twists[near], rows, told_twists, np.zeros(0), np.zeros((0, 4)),
        np.array(sorted(seen)).reshape(-1, 6), None, None, None,
    )  # fmt: skip


def _topic(bag: Bag, source: Path, names: tuple[str, ...], kinds: tuple[str, ...], what: str) -> str:
    found = bag.find(names, kinds)
    if not found:
        raise InvalidFile(f"{source}: has no {what}: none of {', '.join(names)}")
    return found


def _values(bag: Bag, source: Path, topic: str, convert: Callable[[Message], _Value]) -> Iterator[tuple[float, _Value]]:
    """Times of reception [s] and what the messages of a topic say.

    Raises:
        InvalidFile: A message is damaged or says nothing that is possible, such as a number that is not finite.
    """
    for time, message in bag.messages(topic, 0.0, math.inf):
        try:
            value = convert(message)
        except InvalidMessage as error:
            raise InvalidFile(f"{source}: {topic}: {error}") from error
        yield time, value


def _rising(rows: FloatArray) -> FloatArray:
    found: FloatArray = rows[_are_rising(rows[:, 0])]
    return found


def _are_rising(stamps: FloatArray) -> FloatArray:
    return (
        np.concatenate(([True], stamps[1:] > np.maximum.accumulate(stamps)[:-1])) if len(stamps) else np.zeros(0, bool)
    )
