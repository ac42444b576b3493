"""Nav2's simple docks: parameters, detections, contact and charge, docks by name."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import pytest
from geometry_msgs.msg import PoseStamped, Quaternion
from optdock_ros.dock_plugins import DockPlugin, Received, SimpleChargingDock, plugin_class
from optdock_ros.docking_parameters import Docks, docks_of_parameters
from sensor_msgs.msg import BatteryState, JointState
from std_msgs.msg import Bool

from optdock.errors import DockNotInDB, DockNotValid, InvalidFile, InvalidMessage, InvalidValue
from optdock.executor import SimpleDock
from optdock.geometry.pose import Pose2
from optdock.model.dock import DockDirection
from optdock.ros.transforms import Transform

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

CAMERA = Transform("base_link", "camera", 5.0, (0.2, 0.0, 0.4), (-0.5, 0.5, -0.5, 0.5))  # z ahead, x right, y down
QUARTER = math.sin(0.25 * math.pi)
EXACT = {"external_detection_rotation_roll": -0.5 * math.pi, "external_detection_rotation_pitch": 0.5 * math.pi}


def seen(x: float, y: float, z: float, turn: tuple[float, float, float, float]) -> PoseStamped:
    """Return a detection in the camera's frame."""
    message = PoseStamped()
    message.header.stamp.sec, message.header.frame_id = 5, "camera"
    message.pose.position.x, message.pose.position.y, message.pose.position.z = x, y, z
    message.pose.orientation = Quaternion(x=turn[0], y=turn[1], z=turn[2], w=turn[3])
    return message


# A marker that faces the camera, its z out of it and its y up: half a turn about the camera's x.
FACING = (1.0, 0.0, 0.0, 0.0)


def test_a_marker_ahead_is_a_docked_pose_ahead() -> None:
    dock = DockPlugin("dock", EXACT)
    found = dock.detection(seen(0.1, -0.1, 1.3, FACING), CAMERA)
    # 0.2 m before the camera's 1.3 m, and Nav2's 0.2 m before the marker; right of the axis is negative y.
    assert found.pose.as_array() == pytest.approx([1.3, -0.1, 0.0], abs=1e-9)
    assert found.stamp == 5.0
    assert (found.position_sigma, found.yaw_sigma) == (0.005, 0.01)


def test_nav2_default_rotations_are_rounded_quarter_turns() -> None:
    found = DockPlugin("dock", {}).detection(seen(0.0, 0.0, 1.3, FACING), CAMERA)
    assert found.pose.as_array() == pytest.approx([1.3, 0.0, 0.0], abs=2e-3)


def test_backward_docking_turns_the_docked_pose() -> None:
    dock = DockPlugin("dock", {**EXACT, "dock_direction": "backward", "staging_yaw_offset": math.pi})
    found = dock.detection(seen(0.0, 0.0, 1.3, FACING), CAMERA)
    assert found.pose.as_array()[:2] == pytest.approx([1.3, 0.0], abs=1e-9)
    assert abs(found.pose.yaw) == pytest.approx(math.pi)
    assert dock.direction is DockDirection.BACKWARD
    stored = Pose2(3.0, 1.0, 0.5)
    assert dock.stored_pose(dock.docked_pose(stored)).distance_to(stored) < 1e-12
    # Staged before the dock on its axis, with the back to it: where the executor of the docked pose backs in from.
    staging = dock.staging_pose(stored).in_frame_of(dock.docked_pose(stored))
    assert staging.as_array() == pytest.approx([0.7, 0.0, 0.0], abs=1e-9)


@pytest.mark.parametrize(
    ("message", "words"),
    [
        (seen(math.nan, 0.0, 1.0, FACING), "must be finite"),
        (seen(0.0, 0.0, 1.0, (0.0, 0.0, 0.0, 0.0)), "must have the length 1"),
        (seen(0.0, 0.0, 1.0, (QUARTER, 0.0, 0.0, QUARTER)), "steep; look at dock.external_detection_rotation_"),
    ],
)
def test_invalid_detections_are_rejected(message: PoseStamped, words: str) -> None:
    with pytest.raises(InvalidMessage, match=words):
        DockPlugin("dock", EXACT).detection(message, CAMERA)


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ({"staging_x_ofset": -1.0}, "did you mean staging_x_offset"),
        ({"dock_direction": "forwards"}, "dock_direction"),
        ({"rotate_to_dock": True}, "needs dock_direction: backward"),
        ({"use_stall_detection": True}, "needs stall_joint_names"),
        ({"docking_threshold": 0.0}, "docking_threshold"),
        ({"use_battery_status": True}, "use_battery_status"),  # of the charging dock only
    ],
)
def test_wrong_parameters_are_refused_by_name(parameters: Mapping[str, object], words: str) -> None:
    with pytest.raises(InvalidValue, match=words):
        DockPlugin("dock", parameters)


def test_unknown_classes_are_rejected_by_name() -> None:
    assert plugin_class("dock", "opennav_docking/SimpleChargingDock") is SimpleChargingDock
    with pytest.raises(DockNotValid, match="no dock of the class mine::Dock"):
        plugin_class("dock", "mine::Dock")
    with pytest.raises(InvalidValue, match=r"dock\.plugin: is required"):
        plugin_class("dock", None)


def told(message: Any, at: float = 10.0) -> Received:
    """Return a message that arrived at 10 s."""
    return Received(message, at)


def test_recent_current_above_the_threshold_is_charging() -> None:
    dock = SimpleChargingDock("dock", {})
    assert dock.waits_for_charge
    assert dock.is_charging(None, 10.0) is False
    assert dock.is_charging(told(BatteryState(current=0.6)), 10.5) is True
    assert dock.is_charging(told(BatteryState(current=0.4)), 10.5) is False
    assert dock.is_charging(told(BatteryState(current=math.nan)), 10.5) is False
    assert dock.is_charging(told(BatteryState(current=0.6)), 30.0) is False
    assert SimpleChargingDock("dock", {"use_battery_status": False}).is_charging(None, 10.0) is False
    assert DockPlugin("dock", {}).is_charging(told(BatteryState(current=9.0)), 10.0) is False


@pytest.mark.parametrize("use_battery_status", [True, False])
@pytest.mark.parametrize("stalls", [True, False])
def test_nav2s_parameters_are_those_of_a_simple_dock(use_battery_status: bool, stalls: bool) -> None:  # noqa: FBT001
    felt = {"use_stall_detection": True, "stall_joint_names": ["left"]} if stalls else {}
    dock = SimpleChargingDock("dock", {"use_battery_status": use_battery_status, "charging_threshold": 0.7, **felt})
    made = dock.dock_type({"back_out_distance": 0.3})
    assert isinstance(made, SimpleDock)
    assert made is not dock.dock_type({}), "a new one for every task"
    assert made.parameters.contact == ("touch" if stalls else "distance")
    assert made.parameters.charging_current == (0.7 if use_battery_status else None)
    assert made.waits_for_charge is dock.waits_for_charge is dock.uses_battery is use_battery_status
    assert made.back_out_distance == 0.3
    chosen = DockPlugin("dock", {**felt, "contact": "distance"}).dock_type({})
    assert not chosen.is_pressed_on


def test_a_dock_type_is_named_by_its_entry_point_and_takes_its_own_parameters() -> None:
    kind = plugin_class("bay", "SimpleDock")
    assert {"use_external_detection_pose", "docking_threshold", "charging_current"} <= kind.known_names()
    own = {"contact": "touch", "wait_for_charge": True, "charging_current": 2.0}
    poses = [[-0.9, 0.1, 0.2], [-0.8, 0.0, 0.0]]
    dock = kind("bay", {**own, "staging_poses": poses, "use_battery_status": True, "docking_threshold": 0.03})
    assert (dock.is_charger, dock.uses_battery, dock.waits_for_charge) == (True, True, True)
    assert dock.parameters.docking_threshold == 0.03
    made = dock.dock_type({"stall_time": 9.0})
    assert isinstance(made, SimpleDock)
    assert made.parameters == SimpleDock(**own, staging_poses=poses).parameters
    assert dock.is_charging(told(BatteryState(current=2.5)), 10.5) is True
    assert dock.is_charging(told(BatteryState(current=1.5)), 10.5) is False
    assert dock.staging_pose(Pose2(1.0, 0.0, 0.0)).gap_to(Pose2(0.1, 0.1, 0.2)) < 1e-9


def test_switch_messages_expire() -> None:
    dock = plugin_class("bay", "SimpleDock")("bay", {"contact_topic": "photocell", "contact_timeout": 0.3})
    assert dock.contact_topic == "photocell"
    assert dock.is_switched(None, 10.0) is None
    assert dock.is_switched(told(Bool(data=True)), 10.2) is True
    assert dock.is_switched(told(Bool(data=False)), 10.2) is False
    assert dock.is_switched(told(Bool(data=True)), 10.4) is None
    other = DockPlugin("dock", {})
    assert (other.contact_topic, other.is_switched(told(Bool(data=True)), 10.0)) == ("", None)


def test_a_dock_type_is_staged_before_the_dock_in_either_gear() -> None:
    """Nav2's pose of a dock points into it in either gear."""
    kind, dock = plugin_class("bay", "SimpleDock"), Pose2(2.0, 1.0, 0.5)
    for direction, turned in (("forward", 0.0), ("backward", math.pi)):
        found = kind("bay", {"dock_direction": direction, "staging_x_offset": -0.9}).staging_pose(dock)
        assert found.gap_to(dock @ Pose2(-0.9, 0.0, turned)) < 1e-9
    seen_first = kind("bay", {"dock_direction": "backward", "rotate_to_dock": True}).staging_pose(dock)
    assert seen_first.gap_to(dock @ Pose2(-0.7, 0.0, 0.0)) < 1e-9


@pytest.mark.parametrize(
    ("name", "parameters", "words"),
    [
        ("SimpleDock", {"contact": "feel"}, r"bay\.contact"),
        ("SimpleDock", {"staging_poses": [[1.0]]}, r"bay\.staging_poses"),
        ("SimpleDock", {"docking_threshold": -1.0}, r"bay\.docking_threshold"),
        ("SimpleDok", {}, "unknown plugin 'SimpleDok'; did you mean SimpleDock"),
    ],
)
def test_invalid_dock_type_is_rejected_by_name(name: str, parameters: Mapping[str, object], words: str) -> None:
    with pytest.raises((InvalidValue, DockNotValid), match=words):
        plugin_class("bay", name)("bay", parameters)


def test_joints_that_push_without_turning_are_a_stall() -> None:
    dock = DockPlugin("dock", {"use_stall_detection": True, "stall_joint_names": ["left", "right"]})

    def joints(velocity: float, effort: float) -> Received:
        return told(
            JointState(name=["arm", "left", "right"], velocity=[9.0, -velocity, velocity], effort=[0.0, effort, effort])
        )

    assert dock.is_stalled(joints(0.5, 2.0), 10.1)
    assert not dock.is_stalled(joints(2.0, 2.0), 10.1)
    assert not dock.is_stalled(joints(0.5, 0.5), 10.1)
    assert not dock.is_stalled(joints(math.nan, 2.0), 10.1)
    assert not dock.is_stalled(joints(0.5, 2.0), 11.0), "too old"
    assert not dock.is_stalled(None, 10.0)
    with pytest.raises(InvalidMessage, match="needs velocity and effort"):
        dock.is_stalled(told(JointState(name=["left"])), 10.0)


def docks(**entries: Mapping[str, object]) -> Docks:
    """Return docks of the type `bay`."""
    plugins: dict[str, DockPlugin] = {"bay": DockPlugin("bay", {})}
    return Docks(plugins, docks_of_parameters({"docks": list(entries), **entries}))


def test_docks_are_found_by_name_and_faults_have_nav2s_codes(tmp_path: Path) -> None:
    known = docks(
        home={"type": "bay", "pose": [1.0, 2.0, 0.5], "frame": "odom"}, lost={"type": "quay", "pose": [0, 0, 0]}
    )
    entry, plugin = known.find("home")
    assert (entry.pose, entry.frame, plugin.name) == (Pose2(1.0, 2.0, 0.5), "odom", "bay")
    with pytest.raises(DockNotInDB, match="'hoem'; did you mean home") as missing:
        known.find("hoem")
    assert missing.value.code == 901
    with pytest.raises(DockNotValid, match="no dock type 'quay'") as invalid:
        known.find("lost")
    assert invalid.value.code == 902
    assert known.plugin("", "").name == "bay", "the only one, as Nav2"
    file = tmp_path / "docks.yaml"
    file.write_text("docks: {other: {type: bay, pose: [0.0, 0.0, 0.0]}}")
    known.reload(str(file))
    assert list(known.entries) == ["other"]
    with pytest.raises(InvalidFile):
        known.reload(str(tmp_path / "nothing.yaml"))
    assert list(known.entries) == ["other"], "they stay as they are"


def test_faults_of_docks_in_parameters_name_the_parameter() -> None:
    with pytest.raises(InvalidValue, match=r"(?s)^home.pose: must be \[x, y, yaw\].*away: must be a mapping"):
        docks_of_parameters({"docks": ["home", "away"], "home": {"type": "bay", "pose": [1.0, 2.0]}})
    assert docks_of_parameters({}) == {}
