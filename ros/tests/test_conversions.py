"""Round trips of `optdock.ros` with the message classes of rclpy."""

import math
import os
import subprocess
import sys
from array import array
from pathlib import Path

import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message

import optdock as od
from optdock import ros

TYPES = ros.imported
PLACE = od.Pose2(1.0, -2.0, 3.0)


def sent(message: ros.Message) -> ros.Message:
    """Return the message after serialization."""
    return deserialize_message(serialize_message(message), type(message))


def test_motion_messages_round_trip() -> None:
    poses = np.column_stack((np.linspace(0.0, 5.0, 50), np.linspace(1.0, -1.0, 50), np.linspace(-3.0, 3.0, 50)))
    path = ros.path_poses(sent(ros.path_message(TYPES, poses, "map", 12.5)))
    assert (path.frame, path.stamp) == ("map", 12.5)
    assert np.allclose(path.poses, poses, rtol=0.0, atol=1e-12)
    pose = ros.pose(sent(ros.pose_message(TYPES, PLACE, "odom", 2.0)))
    assert (pose.frame, pose.pose.x, pose.pose.y) == ("odom", 1.0, -2.0)
    assert pose.pose.yaw == pytest.approx(3.0)
    moving = od.Twist2(0.5, -0.25, 0.125)
    both = ros.odometry(sent(ros.odometry_message(TYPES, PLACE, moving, "odom", "base_link", 2.0)))
    assert (both.frame, both.child_frame, both.twist) == ("odom", "base_link", moving)
    assert ros.twist(sent(ros.twist_message(TYPES, moving, stamped=False))) == ("", None, moving)
    assert ros.twist(sent(ros.twist_message(TYPES, moving, "base_link", 2.0, stamped=True))) == (
        "base_link",
        2.0,
        moving,
    )
    transforms = sent(ros.transforms_message(TYPES, [("odom", "base_link", PLACE)], 2.0))
    assert transforms.transforms[0].transform.rotation.z == pytest.approx(math.sin(1.5))


def test_costmap_messages_round_trip() -> None:
    costs = np.arange(256, dtype=np.uint8).reshape(8, 32)
    grid = od.Costmap(costs, 0.05, (-1.5, 2.25))
    found = ros.costmap(sent(ros.costmap_message(TYPES, grid, "odom", 3.0)))
    assert (found.frame, found.stamp, found.costmap.resolution, found.costmap.origin) == (
        "odom",
        3.0,
        0.05,
        grid.origin,
    )
    assert np.array_equal(found.costmap.data, costs)
    occupancy = ros.costmap(sent(ros.occupancy_message(TYPES, grid, "odom", 3.0))).costmap
    assert np.array_equal(occupancy.data >= 253, costs >= 253)
    update = TYPES("nav2_msgs/msg/CostmapUpdate")(x=2, y=1, size_x=2, size_y=1, data=array("B", [254, 255]))
    update.header.frame_id = "odom"
    changed = ros.patched(found, sent(update)).costmap.data
    assert changed[1, 2:4].tolist() == [254, 255]
    outline = od.Footprint.rectangle(0.5, 0.25, 0.5)
    corners = [(PLACE @ od.Pose2(x, y, 0.0)).as_array()[:2] for x, y in outline.vertices.tolist()]
    taken_back = ros.footprint(sent(ros.polygon_message(TYPES, corners, "odom", 3.0)), PLACE)
    assert np.allclose(taken_back.footprint.vertices, outline.vertices, atol=1e-6)


def test_marker_and_diagnostics_messages_round_trip() -> None:
    path = od.Path.from_poses([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.5, 0.0, 0.0)])
    markers = sent(ros.path_markers(TYPES, path, "map", 1.0, footprint=od.Footprint.rectangle(0.3, 0.3, 0.4)))
    marker = type(markers.markers[0])
    assert [one.action for one in markers.markers] == [marker.ADD] * 4 + [marker.DELETE] * 3
    assert markers.markers[0].type == marker.LINE_LIST
    assert len(markers.markers[0].points) == len(markers.markers[0].colors)
    assert sent(ros.delete_markers(TYPES, "map", 1.0)).markers[0].action == marker.DELETEALL
    (status,) = sent(ros.diagnostics_message(TYPES, "docking", "error", "late", {"by [s]": 0.5}, 1.0)).status
    assert (status.level, status.message, status.values[0].value) == (type(status).ERROR, "late", "0.5")


def test_every_field_has_the_type_of_its_class() -> None:
    """The classes check the types of fields only with this environment variable."""
    tests = ("motion_messages", "costmap_messages", "marker_and_diagnostics_messages")
    script = "import test_conversions as t; " + "; ".join(f"t.test_{name}_round_trip()" for name in tests)
    checked = {**os.environ, "ROS_PYTHON_CHECK_FIELDS": "1"}
    subprocess.run([sys.executable, "-c", script], cwd=Path(__file__).parent, env=checked, check=True)


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_invalid_messages_are_rejected(value: float) -> None:
    message = ros.path_message(TYPES, np.zeros((3, 3)), "map", 1.0)
    message.poses[1].pose.position.x = value
    with pytest.raises(ros.InvalidMessage, match=r"nav_msgs/msg/Path: poses\[1\]\.pose\.position\.x: must be finite"):
        ros.path_poses(sent(message))
    untouched = TYPES("geometry_msgs/msg/PoseStamped")()
    with pytest.raises(ros.InvalidMessage, match=r"PoseStamped: header\.frame_id: must be the name of a coordinate"):
        ros.pose(untouched)
