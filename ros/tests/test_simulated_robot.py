"""The simulated robot behaves like a real base, localization, detector and costmap."""

from __future__ import annotations

import math
import signal
import time
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, Twist, TwistStamped
from harness import LATCHED, Client, Processes
from nav2_msgs.msg import Costmap, CostmapUpdate
from nav_msgs.msg import Odometry
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import BatteryState, JointState
from std_srvs.srv import Trigger
from tf2_msgs.msg import TFMessage

if TYPE_CHECKING:
    from collections.abc import Mapping

EXACT = {
    "odometry.linear_sigma": 0.0,
    "odometry.angular_sigma": 0.0,
    "localization.position_sigma": 0.0,
    "localization.yaw_sigma": 0.0,
    "detection.position_sigma": 0.0,
    "detection.yaw_sigma": 0.0,
}
NAV2_ROTATION = (1.57, 1.57, 0.0)  # magnitudes of external_detection_rotation_{roll (negative), pitch, yaw}


def set_parameters(client: Client, values: Mapping[str, object]) -> list[Any]:
    """Set parameters of the robot."""
    messages: list[ParameterMessage] = [
        Parameter(name, value=value).to_parameter_msg() for name, value in values.items()
    ]
    request = SetParameters.Request(parameters=messages)
    return list(client.call(SetParameters, "/simulated_robot/set_parameters", request).results)


def reset(client: Client, **values: object) -> None:
    """Restart the world."""
    results = set_parameters(client, {name.replace("__", "."): value for name, value in values.items()})
    assert all(result.successful for result in results), results
    answer = client.call(Trigger, "/simulated_robot/reset")
    assert answer.success, answer.message


def report(client: Client) -> dict[str, float]:
    """Return the next report."""
    heard = client.heard(DiagnosticArray, "/simulated_robot/report")
    client.until(lambda: len(heard) >= 2, what="a report")
    return {
        item.key: float({"True": 1.0, "False": 0.0}.get(item.value, item.value)) for item in heard[-1].status[0].values
    }


def drive(client: Client, linear: float, angular: float, seconds: float) -> None:
    """Send commands at 50 Hz."""
    publisher = client.create_publisher(TwistStamped, "cmd_vel", 1)
    client.until(publisher.get_subscription_count)
    message = TwistStamped()
    message.twist.linear.x, message.twist.angular.z = linear, angular
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        publisher.publish(message)
        time.sleep(0.02)


@pytest.fixture(scope="module")
def robot(module_process: Processes, client_node: Client) -> Client:
    """A robot with exact sensors."""
    module_process("simulated_robot", params=EXACT)
    heard = client_node.heard(Odometry, "odom")
    client_node.until(lambda: heard)
    return client_node


def test_the_watchdog_stops_it_when_commands_end(robot: Client) -> None:
    reset(robot, start=[1.0, 1.0, 0.0])
    heard = robot.heard(Odometry, "odom")
    drive(robot, 0.2, 0.0, 0.6)
    assert max(message.twist.twist.linear.x for message in heard) > 0.1
    robot.until(lambda: abs(heard[-1].twist.twist.linear.x) < 1e-3, 5.0, "a stop")
    assert report(robot)["watchdog_stops"] == 1.0


def test_transforms_and_detections_locate_the_dock(robot: Client) -> None:
    """The chain of transforms as in a server, with the default rotation of Nav2's simple docks."""
    static = robot.heard(TFMessage, "/tf_static", LATCHED)
    reset(robot, start=[1.8, 1.2, -0.2], dock_offset=[0.03, 0.02, 0.05])
    kept = robot.heard(TFMessage, "/tf", 100)
    seen = robot.heard(PoseStamped, "detected_dock_pose")
    robot.until(lambda: static and len(seen) >= 3 and len(kept) >= 8)
    frames = {found.child_frame_id: found for message in [*static, *kept] for found in message.transforms}
    assert set(frames) == {"odom", "base_link", "camera_optical_frame"}
    matrix = np.eye(4)
    for name in ("odom", "base_link", "camera_optical_frame"):
        found = frames[name].transform
        matrix = matrix @ homogeneous(found.translation, found.rotation)
    marker = matrix @ homogeneous(seen[-1].pose.position, seen[-1].pose.orientation)
    roll, pitch, _ = NAV2_ROTATION
    turned = marker[:3, :3] @ about(1, pitch) @ about(0, -roll)
    yaw = math.atan2(turned[1, 0], turned[0, 0])
    where = marker[:2, 3] + [-0.2 * math.cos(yaw), -0.2 * math.sin(yaw)]
    true = [3.0 + 0.03, 1.0 + 0.02, 0.05]
    assert np.allclose([*where, yaw], true, atol=2e-3)  # 1.57 is not a quarter turn
    assert marker[2, 3] == pytest.approx(0.3)


def homogeneous(position: Any, rotation: Any) -> np.ndarray[Any, Any]:
    """Return a 4 x 4 matrix of a transform's parts."""
    x, y, z, w = rotation.x, rotation.y, rotation.z, rotation.w
    found = np.eye(4)
    found[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    found[:3, 3] = position.x, position.y, position.z
    return found


def about(axis: int, angle: float) -> np.ndarray[Any, Any]:
    """Return a rotation about a coordinate axis."""
    c, s = math.cos(angle), math.sin(angle)
    i, j = [(1, 2), (2, 0), (0, 1)][axis]
    found = np.eye(3)
    found[i, i], found[i, j], found[j, i], found[j, j] = c, -s, s, c
    return found


def test_costmap_contains_the_dock_and_is_updated(robot: Client) -> None:
    whole = robot.heard(Costmap, "local_costmap/costmap_raw", LATCHED)
    updates = robot.heard(CostmapUpdate, "local_costmap/costmap_raw_updates")
    transforms = robot.heard(TFMessage, "/tf", 100)
    robot.until(lambda: whole)  # the latched one
    before = len(whole)
    reset(robot, start=[2.2, 1.0, 0.0], dock_offset=[0.0, 0.0, 0.0])
    robot.until(lambda: len(whole) > before)
    updates.clear()
    robot.until(lambda: len(updates) >= 2)
    grid = whole[-1]
    assert grid.header.frame_id == "odom"
    assert len(grid.data) == grid.metadata.size_x * grid.metadata.size_y == 3600
    assert grid.metadata.resolution == pytest.approx(0.05)
    robot.until(lambda: {t.child_frame_id for m in transforms[-8:] for t in m.transforms} >= {"odom"})
    odom = [t.transform for m in transforms for t in m.transforms if t.child_frame_id == "odom"][-1]
    matrix = homogeneous(odom.translation, odom.rotation)
    rows, columns = np.nonzero(np.array(grid.data).reshape(60, 60) == 254)
    cells = np.column_stack((columns, rows)) * 0.05 + [grid.metadata.origin.position.x, grid.metadata.origin.position.y]
    places = (cells + 0.025) @ matrix[:2, :2].T + matrix[:2, 3]
    station = places[(abs(places[:, 1] - 1.0) < 0.2) & (places[:, 0] > 2.9)]
    assert abs(station[:, 0].min() - 3.3) < 0.06  # the front of the station, as cells go


def test_contact_at_the_stop_charges_and_stalls(robot: Client) -> None:
    reset(robot, start=[2.95, 1.0, 0.0], battery__delay=0.2)
    battery, joints = robot.heard(BatteryState, "battery_state"), robot.heard(JointState, "joint_states")
    robot.until(lambda: battery)
    assert battery[-1].current == -1.0
    drive(robot, 0.1, 0.0, 1.5)
    robot.until(lambda: battery[-1].current == 2.0, 3.0, "charging")
    assert max(message.effort[0] for message in joints) == 5.0
    stalled = next(message for message in joints if message.effort[0] == 5.0)
    assert list(stalled.velocity) == [0.0, 0.0]
    said = report(robot)
    assert abs(said["along"]) < 0.005
    assert said["contact"] == 1.0


def test_collision_is_reported(robot: Client) -> None:
    reset(robot, start=[0.9, 0.25, math.pi])
    drive(robot, 0.2, 0.0, 1.0)
    assert report(robot)["clearance"] < 0.0


def test_faults_stop_only_their_topics(robot: Client) -> None:
    reset(robot, start=[1.8, 1.15, -0.2])
    topics = {
        "transforms": robot.heard(TFMessage, "/tf", 100),
        "odometry": robot.heard(Odometry, "odom"),
        "detections": robot.heard(PoseStamped, "detected_dock_pose"),
        "costmap": robot.heard(CostmapUpdate, "local_costmap/costmap_raw_updates"),
    }
    for name in topics:
        robot.until(lambda: all(topics.values()), what="everything")
        assert set_parameters(robot, {f"faults.{name}": True})[0].successful
        time.sleep(0.3)  # what was under way has arrived, and every other topic has gone on
        for heard in topics.values():
            heard.clear()
        time.sleep(0.5)
        assert [topic for topic, heard in topics.items() if not heard] == [name]
        assert set_parameters(robot, {f"faults.{name}": False})[0].successful


def test_wrong_parameters_are_refused_by_name(robot: Client) -> None:
    for values, words in (
        ({"detection.latency": -1.0}, "latency"),
        ({"rate": "fast"}, "rate: "),
        ({"scenario": "/nowhere.yaml"}, "/nowhere.yaml"),
        ({"start": [1.0]}, "start: must be three numbers"),
    ):
        (result,) = set_parameters(robot, values)
        assert not result.successful
        assert words in result.reason


def test_stamps_are_current_after_a_suspension(process: Processes, client_node: Client) -> None:
    """After a suspension the stamps are not in the past."""
    started = process("simulated_robot", args=("-r", "__ns:=/stalled", "-r", "/tf:=tf"))
    ages: list[float] = []

    def take(message: Odometry) -> None:
        ages.append(time.time() - message.header.stamp.sec - 1e-9 * message.header.stamp.nanosec)

    client_node.create_subscription(Odometry, "/stalled/odom", take, 10)
    client_node.until(lambda: len(ages) > 5)
    started.popen.send_signal(signal.SIGSTOP)
    time.sleep(1.0)
    started.popen.send_signal(signal.SIGCONT)
    time.sleep(0.5)
    ages.clear()
    client_node.until(lambda: len(ages) > 20)
    assert min(ages) < 0.1


@pytest.mark.parametrize(("params", "words"), [({"ratee": 1.0}, "ratee: no such parameter; did you mean rate?")])
def test_unknown_parameter_is_rejected_at_the_start(
    process: Processes, params: Mapping[str, object], words: str
) -> None:
    started = process("simulated_robot", params=params)
    assert started.popen.wait(20.0) == 1
    assert words in started.log()


def test_simulated_clock_is_faster_and_twist_is_accepted(process: Processes, client_node: Client) -> None:
    started = process(
        "simulated_robot", params={"speed": 4.0, "enable_stamped_cmd_vel": False}, args=("-r", "__ns:=/fast")
    )
    heard = client_node.heard(Clock, "/clock")
    client_node.until(lambda: heard)
    odom = client_node.heard(Odometry, "/fast/odom")
    publisher = client_node.create_publisher(Twist, "/fast/cmd_vel", 1)
    client_node.until(publisher.get_subscription_count)
    begin, first = time.monotonic(), heard[-1].clock
    command = Twist()
    command.linear.x = 0.1
    while time.monotonic() < begin + 1.0:
        publisher.publish(command)
        time.sleep(0.01)
    went = heard[-1].clock.sec - first.sec + 1e-9 * (heard[-1].clock.nanosec - first.nanosec)
    assert 1.2 < went < 4.5  # slower where the machine is busy, never faster
    assert odom[-1].pose.pose.position.x > 0.05
    assert started.stop(signal.SIGINT) == 0
