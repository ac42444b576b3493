"""`docking_server` and a simulated robot as processes: dockings, error codes, and stops."""

from __future__ import annotations

import math
import os
import signal
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from action_msgs.msg import GoalStatus
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, TwistStamped
from harness import LATCHED, Client, Lifecycle, Process, Processes
from nav2_msgs.action import DockRobot, NavigateToPose, UndockRobot
from nav2_msgs.srv import ReloadDockDatabase
from nav_msgs.msg import Odometry
from nav_msgs.msg import Path as PathMessage
from rcl_interfaces.srv import SetParameters
from rclpy.action import ActionServer
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger
from visualization_msgs.msg import MarkerArray

SUCCEEDED, CANCELED, ABORTED = GoalStatus.STATUS_SUCCEEDED, GoalStatus.STATUS_CANCELED, GoalStatus.STATUS_ABORTED
BAY = {
    "plugin": "opennav_docking::SimpleChargingDock",
    "use_external_detection_pose": True,
    "detection_position_sigma": 0.003,
    "detection_yaw_sigma": 0.005,
}
SERVER: dict[str, object] = {
    "dock_plugins": ["bay", "quay", "blind", "felt", "watched", "own"],
    "bay": BAY,
    "watched": {**BAY, "detector_service_name": "detector", "detector_service_timeout": 3.0},
    "quay": {"plugin": "opennav_docking::SimpleNonChargingDock"},
    "blind": {
        "plugin": "opennav_docking::SimpleNonChargingDock",
        "use_external_detection_pose": True,
        "subscribe_toggle": True,
        "dock_direction": "backward",
        "rotate_to_dock": True,
    },
    "felt": {
        "plugin": "opennav_docking::SimpleNonChargingDock",
        "use_external_detection_pose": True,
        "use_stall_detection": True,
        "stall_joint_names": ["left_wheel_joint", "right_wheel_joint"],
    },
    "own": {
        "plugin": "SimpleDock",
        "use_external_detection_pose": True,
        "use_battery_status": True,
        "contact": "touch",
        "charging_current": 0.5,
        "wait_for_charge": True,
    },
    "docks": ["home", "moon", "odd"],
    "home": {"type": "bay", "frame": "map", "pose": [3.0, 1.0, 0.0]},
    "moon": {"type": "bay", "frame": "moon", "pose": [0.0, 0.0, 0.0]},
    "odd": {"type": "unheard_of", "frame": "map", "pose": [0.0, 0.0, 0.0]},
    "max_retries": 0,
    "initial_perception_timeout": 1.0,
    "wait_charge_timeout": 1.5,
    "executor": {"localization_timeout": 1.5, "costmap_timeout": 1.0, "obstacle_patience": 1.0},
    "controller": {"costmap_timeout": 0.8},
}
NEAR = [2.45, 1.02, 0.05]  # the robot, before the dock at [3, 1, 0]
MOST_CHANGE = 0.1  # [m/s] beyond 0.5 m/s^2 times the time between commands: what a busy machine sends late


class Bay:
    """The simulated robot, the server, and their messages."""

    def __init__(self, client: Client, processes: Processes, server: dict[str, object] = SERVER) -> None:
        self.client, self.processes = client, processes
        self.robot = processes("simulated_robot")
        self.server = processes("docking_server", params=server)
        self.life = Lifecycle(client, "docking_server")
        self.life.up()
        self.commands: list[TwistStamped] = client.heard(TwistStamped, "cmd_vel", 100)
        self.reports: list[DiagnosticArray] = client.heard(DiagnosticArray, "/simulated_robot/report")
        self.odometry: list[Odometry] = client.heard(Odometry, "odom")

    def set(self, **values: object) -> None:
        """Set parameters of the simulated robot; __ stands for a dot."""
        assert all(r.successful for r in set_parameters(self.client, "simulated_robot", **values))

    def reset(self, **values: object) -> None:
        """Restart the world with all sensors working."""
        faults = {f"faults__{name}": False for name in ("transforms", "odometry", "detections", "costmap")}
        self.set(**{"start": NEAR, "dock_offset": [0.01, -0.01, 0.01], **faults, **values})
        assert self.client.call(Trigger, "/simulated_robot/reset").success
        time.sleep(0.3)
        self.commands.clear()

    def dock(self, **values: object) -> Any:
        """Send a goal."""
        wanted = {"dock_id": "home", "use_dock_id": True, "navigate_to_staging_pose": False, **values}
        return self.client.send(DockRobot, "dock_robot", DockRobot.Goal(**wanted))

    def undock(self, **values: object) -> Any:
        """Send a goal."""
        return self.client.send(UndockRobot, "undock_robot", UndockRobot.Goal(**values))

    def driving(self) -> None:
        """Wait until the robot moves after a command."""
        self.client.until(lambda: self.commands and abs(self.commands[-1].twist.linear.x) > 0.08, what="a motion")

    def truth(self) -> dict[str, float]:
        """Return the next report of the simulated robot."""
        count = len(self.reports)
        self.client.until(lambda: len(self.reports) >= count + 2, what="a report")
        words = {"True": 1.0, "False": 0.0}
        return {
            v.key: words[v.value] if v.value in words else float(v.value) for v in self.reports[-1].status[0].values
        }

    def assert_stopped(self, *, in_limits: bool = True) -> None:
        """The robot stands, the last command is zero, and the commands kept the limits."""
        self.client.until(lambda: abs(self.odometry[-1].twist.twist.linear.x) < 0.01, 3.0, "rest")
        time.sleep(0.1)
        last = self.commands[-1].twist
        assert (last.linear.x, last.angular.z) == (0.0, 0.0)
        if in_limits:
            speeds = [command.twist.linear.x for command in self.commands]
            stamps = [c.header.stamp.sec + 1e-9 * c.header.stamp.nanosec for c in self.commands]
            assert np.all(np.abs(np.diff(speeds)) < MOST_CHANGE + 0.5 * np.diff(stamps))


def set_parameters(client: Client, node: str, **values: object) -> list[Any]:
    """Set parameters of a node; __ stands for a dot."""
    messages = [Parameter(k.replace("__", "."), value=v).to_parameter_msg() for k, v in values.items()]
    return list(
        client.call(SetParameters, f"/{node}/set_parameters", SetParameters.Request(parameters=messages)).results
    )


@pytest.fixture(scope="module")
def bay(module_process: Processes, client_node: Client) -> Bay:
    """The robot and the server of all tests."""
    return Bay(client_node, module_process)


def test_goal_right_after_activation_waits_for_the_robot(process: Processes, client_node: Client) -> None:
    """As on a busy computer, on which the server has not discovered the publishers yet."""
    apart = ("-r", "__ns:=/early", "-r", "/tf:=tf", "-r", "/tf_static:=tf_static")
    process("docking_server", params=SERVER, args=apart)
    Lifecycle(client_node, "early/docking_server").up()
    request = DockRobot.Goal(dock_id="home", navigate_to_staging_pose=False)
    goal = client_node.send(DockRobot, "early/dock_robot", request)
    time.sleep(3.0)  # longer than the wait for messages of known publishers
    assert not goal.is_done, goal.reply().result
    process("simulated_robot", params={"start": NEAR}, args=apart)
    reply = goal.reply(40.0)
    assert (reply.status, reply.result.error_code) == (SUCCEEDED, 0), reply.result


def test_a_docking_and_an_undocking(bay: Bay) -> None:
    client = bay.client
    heard = {
        "docking_trajectory": client.heard(PathMessage, "docking_trajectory", LATCHED),
        "markers": client.heard(MarkerArray, "/docking_server/markers", LATCHED),
        "dock_pose": client.heard(PoseStamped, "dock_pose", LATCHED),
        "filtered_dock_pose": client.heard(PoseStamped, "filtered_dock_pose", LATCHED),
    }
    diagnostics = client.heard(DiagnosticArray, "/diagnostics", 50)
    bay.reset()
    goal = bay.dock()
    bay.driving()
    # Nonsense on a topic is not believed, and stops nothing.
    nonsense = client.create_publisher(PoseStamped, "detected_dock_pose", 1)
    broken = PoseStamped()
    broken.header.frame_id, broken.pose.position.x = "base_link", math.nan
    broken.header.stamp = bay.commands[-1].header.stamp
    nonsense.publish(broken)
    assert not client.call(ReloadDockDatabase, "/docking_server/reload_database").success, "not while docking"
    reply = goal.reply(30.0)
    assert (reply.status, reply.result.success, reply.result.error_code) == (SUCCEEDED, True, 0), reply.result
    states = [feedback.state for feedback in reply.feedback]
    assert {2, 3} <= set(states) <= {2, 3, 4}
    assert 1 < len(states) / reply.feedback[-1].docking_time.sec < 25, "10 per second, and every change"
    found = bay.truth()
    assert abs(found["along"]) < 0.010, found
    assert abs(found["cross"]) < 0.010, found
    assert abs(found["yaw"]) < math.radians(1.5), found
    assert found["charging"] == 1.0
    assert found["clearance"] > 0.05
    assert found["station_clearance"] > -0.001
    bay.assert_stopped()
    assert all(heard.values()), heard.keys()
    (path,) = heard["docking_trajectory"][-1:]
    assert (path.header.frame_id, len(path.poses) > 5) == ("odom", True)
    said = {status.name: status for message in diagnostics for status in message.status}
    assert said["docking_server: certificate"].level == b"\x00"
    assert "busy p99 [ms]" in {item.key for item in said["docking_server: deadlines"].values}
    assert said["docking_server: state"].message == "idle"


def test_docked_robot_stays_and_undocks(bay: Bay) -> None:
    bay.reset()
    assert bay.dock().reply(40.0).result.success
    again = bay.dock().reply()
    assert (again.status, again.result.success) == (SUCCEEDED, True)
    assert "already" in again.result.error_msg

    reply = bay.undock(max_undocking_time=0.05).reply()
    assert (reply.status, reply.result.error_code) == (ABORTED, 907), reply.result
    reply = bay.undock(max_undocking_time=30.0).reply(30.0)
    assert (reply.status, reply.result.error_code) == (SUCCEEDED, 0), reply.result
    assert bay.truth()["along"] < -0.65
    bay.assert_stopped()
    reply = bay.undock().reply()
    assert (reply.status, reply.result.success) == (ABORTED, False)
    assert reply.result.error_code == 902, "two types, and nobody has docked"
    reply = bay.undock(dock_type="bay").reply()
    assert (reply.status, reply.result.success, reply.result.error_code) == (ABORTED, False, 902)
    assert "no dock of the type 'bay', there is nothing to undock from" in reply.result.error_msg


@pytest.mark.parametrize(("kind", "yaw"), [("blind", math.pi), ("felt", 0.0), ("own", 0.0)])
def test_backward_touch_and_third_party_docks(bay: Bay, kind: str, yaw: float) -> None:
    bay.reset()
    goal = bay.dock(use_dock_id=False, dock_type=kind, dock_pose=pose("map"))
    reply = goal.reply(40.0)
    assert (reply.status, reply.result.success) == (SUCCEEDED, True), reply.result
    if kind == "felt":
        assert "signal" in reply.result.error_msg, "the joints'"
    if kind == "own":
        assert bay.truth()["charging"] == 1.0
    found = bay.truth()
    # Unseen, the way in is the odometry's.
    within = 0.03 if kind == "blind" else 0.01
    assert max(abs(found["along"]), abs(found["cross"])) < within, found
    assert abs(math.remainder(found["yaw"] - yaw, 2.0 * math.pi)) < math.radians(3.0 if kind == "blind" else 1.5), found
    bay.assert_stopped()


def pose(frame: str, x: float = 3.0, y: float = 1.0, w: float = 1.0) -> PoseStamped:
    """Return the pose of a dock."""
    message = PoseStamped()
    message.header.frame_id, message.pose.position.x, message.pose.position.y = frame, x, y
    message.pose.orientation.w = w
    return message


@pytest.mark.parametrize(
    ("goal", "code", "words"),
    [
        ({"dock_id": "hom"}, 901, "did you mean home"),
        ({"dock_id": "odd"}, 902, "no dock type 'unheard_of'"),
        ({"dock_id": "moon"}, 902, "moon"),
        ({"dock_id": "home", "max_staging_time": math.nan}, 999, "max_staging_time"),
        ({"use_dock_id": False, "dock_type": "bay", "dock_pose": pose("")}, 902, "frame"),
        ({"use_dock_id": False, "dock_type": "bay", "dock_pose": pose("map", x=math.nan)}, 902, "finite"),
        ({"use_dock_id": False, "dock_type": "bay", "dock_pose": pose("map", w=0.0)}, 902, "orientation"),
        ({"use_dock_id": False, "dock_type": "", "dock_pose": pose("map")}, 902, "no dock type ''"),
    ],
)
def test_goals_with_invalid_docks(bay: Bay, goal: dict[str, Any], code: int, words: str) -> None:
    bay.commands.clear()
    reply = bay.dock(**goal).reply()
    assert (reply.status, reply.result.success, reply.result.error_code) == (ABORTED, False, code)
    assert words in reply.result.error_msg
    assert bay.commands == []


def test_no_detection(bay: Bay) -> None:
    bay.reset(faults__detections=True)
    reply = bay.dock().reply(30.0)
    assert (reply.status, reply.result.error_code) == (ABORTED, 904), reply.result


def test_no_charge_and_another_attempt(bay: Bay) -> None:
    """The feedback never claims that the second attempt waits for the charge before it has begun."""
    assert set_parameters(bay.client, "docking_server", max_retries=1)[0].successful
    bay.reset(battery__charging_current=0.0)
    reply = bay.dock().reply(60.0)
    assert set_parameters(bay.client, "docking_server", max_retries=0)[0].successful
    bay.set(battery__charging_current=2.0)
    assert (reply.status, reply.result.error_code, reply.result.num_retries) == (ABORTED, 906, 1), reply.result
    states = [message.state for message in reply.feedback if message.num_retries == 1]
    assert states[0] == DockRobot.Feedback.RETRY, states
    bay.assert_stopped()


@pytest.mark.parametrize("kind", ["bay", "blind"])
def test_detected_dock_far_from_its_stored_pose_is_904(bay: Bay, kind: str) -> None:
    bay.reset()
    reply = bay.dock(use_dock_id=False, dock_type=kind, dock_pose=pose("map", y=1.4)).reply(30.0)
    assert (reply.status, reply.result.error_code) == (ABORTED, 904), reply.result
    assert "m from the stored dock, max_detection_offset is 0.250 m" in reply.result.error_msg


def test_no_costmap_at_the_start_is_905(bay: Bay) -> None:
    bay.reset(faults__costmap=True)
    time.sleep(0.8)
    reply = bay.dock().reply()
    assert (reply.status, reply.result.error_code) == (ABORTED, 905), reply.result
    assert "local_costmap/costmap_raw" in reply.result.error_msg
    assert bay.commands == [] or not bay.commands[-1].twist.linear.x


@pytest.mark.parametrize(
    ("faults", "code", "words"),
    [
        (("transforms", "detections"), 999, "transform"),
        (("costmap",), 905, "costmap"),
    ],
)
def test_lost_measurements_stop_the_robot(bay: Bay, faults: tuple[str, ...], code: int, words: str) -> None:
    """Transforms fail together with detections, which replace them on the last metre."""
    bay.reset(start=[2.2, 1.0, 0.0])
    goal = bay.dock()
    bay.driving()
    bay.set(**{f"faults__{fault}": True for fault in faults})
    reply = goal.reply(20.0)
    assert (reply.status, reply.result.error_code) == (ABORTED, code), reply.result
    assert words in reply.result.error_msg
    bay.set(**{f"faults__{fault}": False for fault in faults})
    time.sleep(0.1)
    bay.assert_stopped()
    assert bay.truth()["along"] < -0.1, "before the dock"


def test_cancelling_stops_within_the_limits(bay: Bay) -> None:
    bay.reset()
    goal = bay.dock()
    bay.driving()
    assert len(goal.cancel().goals_canceling) == 1
    reply = goal.reply()
    assert (reply.status, reply.result.success) == (CANCELED, False)
    assert "cancelled" in reply.result.error_msg
    bay.assert_stopped()


def test_new_goal_preempts_and_other_action_waits(bay: Bay) -> None:
    bay.reset()
    first = bay.dock()
    bay.driving()
    undock, second = bay.undock(dock_type="bay"), bay.dock()
    reply = first.reply()
    assert (reply.status, reply.result.error_code) == (ABORTED, 999)
    assert "preempted" in reply.result.error_msg
    replaced = bay.undock(dock_type="bay")
    assert undock.reply().result.error_msg.startswith("replaced by a newer goal")
    replaced.cancel()
    assert replaced.reply().status == CANCELED, "while it waits"
    bay.commands.clear()
    bay.driving()
    second.cancel()
    assert second.reply().status == CANCELED
    bay.assert_stopped()


def test_deactivation_stops_the_robot_with_a_reason(bay: Bay) -> None:
    """The detector is switched off, too, without waiting for its answer."""
    bay.reset()
    asked: list[int] = []

    def switch(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        asked.append(1)
        response.success = True
        return response

    service = bay.client.create_service(Trigger, "detector", switch)
    goal = bay.dock(use_dock_id=False, dock_type="watched", dock_pose=pose("map"))
    bay.driving()
    assert len(asked) == 1
    assert bay.life.deactivate()
    bay.client.until(lambda: len(asked) == 2, what="off")
    bay.client.destroy_service(service)
    assert "the thread of a goal still runs" not in bay.server.log()
    reply = goal.reply()
    assert (reply.status, reply.result.error_code) == (ABORTED, 999)
    assert "deactivated" in reply.result.error_msg
    bay.assert_stopped()
    assert not bay.dock().is_accepted
    assert bay.life.cleanup()
    bay.life.up()
    assert bay.dock(dock_id="hom").reply().result.error_code == 901


def test_staging_by_navigate_to_pose(bay: Bay) -> None:
    bay.reset(start=[1.6, 1.2, 0.0])
    asked: list[NavigateToPose.Goal] = []
    fails = [True, True, True, False]  # two attempts of the first goal, one of the second

    def navigate(handle: Any) -> NavigateToPose.Result:
        asked.append(handle.request)
        (handle.abort if fails[len(asked) - 1] else handle.succeed)()
        return NavigateToPose.Result()

    navigator = ActionServer(bay.client, NavigateToPose, "navigate_to_pose", navigate)
    try:
        reply = bay.dock(navigate_to_staging_pose=True).reply()
        assert (reply.status, reply.result.error_code) == (ABORTED, 903), reply.result
        assert "navigate_to_pose" in reply.result.error_msg
        assert 1 in {feedback.state for feedback in reply.feedback}
        assert bay.commands == [], "cmd_vel is the navigator's"
        goal = bay.dock(navigate_to_staging_pose=True)
        bay.client.until(lambda: bay.commands, 10.0, "the executor's part")
        goal.cancel()
        assert goal.reply().status == CANCELED
    finally:
        navigator.destroy()
    assert len(asked) == 4
    wanted = asked[0].pose
    assert wanted.header.frame_id == "map"
    assert (wanted.pose.position.x, wanted.pose.position.y) == pytest.approx((2.3, 1.0))
    bay.assert_stopped()


def test_parameters_are_validated_while_active(bay: Bay) -> None:
    for name, value, words in (
        ("max_retries", -1, "max_retries"),
        ("executor.time_budgett", 1.0, "did you mean time_budget"),
        ("executor.max_retries", 1, "is max_retries of this server"),
        ("robot.limits.max_speed", -0.1, "max_speed"),
        ("bay.docking_treshold", 0.1, "did you mean docking_threshold"),
        ("base_frame", "base_footprint", "cannot be changed while configured"),
    ):
        (result,) = set_parameters(bay.client, "docking_server", **{name.replace(".", "__"): value})
        assert not result.successful, name
        assert words in result.reason, result.reason
    assert set_parameters(bay.client, "docking_server", max_retries=1)[0].successful
    assert set_parameters(bay.client, "docking_server", max_retries=0)[0].successful


def children(process: Process) -> list[int]:
    """Return the ids of the child processes."""
    found = Path(f"/proc/{process.pid}/task").glob("*/children")
    return [int(pid) for file in found for pid in file.read_text().split()]


def test_a_planning_process_that_is_killed_is_replaced(bay: Bay) -> None:
    assert set_parameters(bay.client, "docking_server", max_retries=2)[0].successful
    bay.reset()
    goal = bay.dock()
    bay.driving()
    (planner,) = [pid for pid in children(bay.server) if b"spawn_main" in Path(f"/proc/{pid}/cmdline").read_bytes()]
    os.kill(planner, signal.SIGKILL)
    reply = goal.reply(60.0)
    assert set_parameters(bay.client, "docking_server", max_retries=0)[0].successful
    assert reply.status == SUCCEEDED, reply.result
    bay.assert_stopped()
