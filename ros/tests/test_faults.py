"""Failures of the server and of its inputs while the robot moves: the robot stops, and no process is left.

The simulated robot stops 0.25 s after its last command and decelerates at 0.5 m/s^2. The times are upper bounds for a
busy machine.
"""

from __future__ import annotations

import math
import os
import signal
import time
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from action_msgs.msg import GoalStatus
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TwistStamped
from harness import Client, Goal, Lifecycle, Process, Processes, stranger
from launch_stand_in import PACKAGE
from nav2_msgs.action import DockRobot
from nav_msgs.msg import Odometry
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

if TYPE_CHECKING:
    from collections.abc import Iterator

WORLD = PACKAGE / "config" / "simulated_docking.yaml"
MOVING = 0.08  # [m/s]: in mid-approach
STILL = 2e-3  # [m/s]: the plant's lag leaves a thousandth
DECELERATION = 0.5  # [m/s^2], the robot's limit in the world's file
SLOWEST_STOP = 1.5  # [s] from full speed, jerk limit and lag included


class World:
    """The robot, the server, and their messages."""

    def __init__(self, client: Client, processes: Processes) -> None:
        self.client, self.processes = client, processes
        self.truth: list[Odometry] = client.heard(Odometry, "/simulated_robot/truth", 50)
        self.reports: list[DiagnosticArray] = client.heard(DiagnosticArray, "/simulated_robot/report")
        self.commands: list[tuple[float, float, float]] = []
        client.create_subscription(TwistStamped, "cmd_vel", self._take, 100)
        processes("simulated_robot", params=WORLD)
        self.server = self.start()
        self.goal: Goal | None = None

    def _take(self, message: TwistStamped) -> None:
        stamp = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
        self.commands.append((stamp, message.twist.linear.x, message.twist.angular.z))

    def start(self) -> Process:
        """Start and activate a docking server."""
        self.server = self.processes("docking_server", params=WORLD)
        with stranger(int(os.environ["ROS_DOMAIN_ID"])) as client:
            Lifecycle(client, "docking_server").up()
        return self.server

    def reset(self) -> None:
        """Put the robot at its start, and switch all faults off."""
        for name in ("transforms", "odometry", "detections", "costmap"):
            self.fault(name, on=False)
        assert self.client.call(Trigger, "/simulated_robot/reset").success
        self.truth.clear()
        self.client.until(lambda: self.truth)

    def fault(self, names: str, *, on: bool) -> None:
        """Switch faults of the simulated robot, separated by commas."""
        switches = [Parameter(f"faults.{name}", value=on).to_parameter_msg() for name in names.split(",")]
        request = SetParameters.Request(parameters=switches)
        results = self.client.call(SetParameters, "/simulated_robot/set_parameters", request).results
        assert all(result.successful for result in results), results

    @property
    def speed(self) -> float:
        """True speed [m/s]."""
        twist = self.truth[-1].twist.twist
        return max(abs(twist.linear.x), 0.3 * abs(twist.angular.z))

    @property
    def driven(self) -> float:
        """Distance from the start [m]."""
        begin, end = (self.truth[k].pose.pose.position for k in (0, -1))
        return math.hypot(end.x - begin.x, end.y - begin.y)

    def send(self, client: Client | None = None) -> Goal:
        """Send a goal."""
        goal = DockRobot.Goal(dock_id="bay", navigate_to_staging_pose=False)
        self.goal = (client or self.client).send(DockRobot, "dock_robot", goal)
        return self.goal

    def leave(self) -> None:
        """Cancel the goal of a test."""
        if self.goal is not None and self.server.is_running and not self.goal.is_done:
            self.goal.cancel()
            self.goal.reply()
        self.goal = None

    def approach(self) -> Goal:
        """Send a goal and wait until the robot moves."""
        self.reset()
        goal = self.send()
        self.client.until(lambda: self.speed > MOVING or goal.is_done, what="an approach")
        assert not goal.is_done, goal.reply()
        return goal

    def stops(self, within: float) -> float:
        """Wait until the robot stands, at most `within` [s]; return the time it took [s]."""
        began = time.monotonic()
        self.client.until(lambda: self.speed < STILL, within, "a stop")
        return time.monotonic() - began

    def docks(self, client: Client) -> None:
        """Dock from the start."""
        self.reset()
        reply = self.send(client).reply(60.0)
        assert reply.status == GoalStatus.STATUS_SUCCEEDED, reply.result
        time.sleep(0.3)
        told = {item.key: item.value for item in self.reports[-1].status[0].values}
        assert abs(float(told["along"])) < 0.01
        assert abs(float(told["cross"])) < 0.01
        assert abs(float(told["yaw"])) < math.radians(1.5)

    def gentle_end(self) -> None:
        """The last command is zero, and the ramp took the time of the robot's deceleration."""
        time.sleep(0.3)
        assert self.commands[-1][1:] == (0.0, 0.0)
        moving = [(stamp, abs(speed)) for stamp, speed, _ in self.commands if speed != 0.0][-100:]
        fastest = max(speed for _, speed in moving)
        since = max(stamp for stamp, speed in moving if speed > 0.9 * fastest)
        assert moving[-1][0] - since > 0.7 * fastest / DECELERATION


@pytest.fixture(scope="module")
def world(client_node: Client, module_process: Processes) -> World:
    """The robot of all tests, with changing servers."""
    return World(client_node, module_process)


@pytest.fixture(autouse=True)
def _a_server_that_lives(world: World) -> Iterator[None]:
    with stranger(int(os.environ["ROS_DOMAIN_ID"])) as client:
        is_active = world.server.is_running and Lifecycle(client, "docking_server").state == "active"
    if not is_active:
        world.server.kill()
        world.start()
    yield
    world.leave()


def family(pid: int) -> list[int]:
    """Return the ids of the child processes."""
    return [int(word) for task in Path(f"/proc/{pid}/task").glob("*/children") for word in task.read_text().split()]


def is_gone(pid: int) -> bool:
    """Whether a process has ended; a zombie has."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] == "Z"
    except FileNotFoundError:
        return True


def test_suspended_server_does_not_accelerate_a_standing_robot(world: World) -> None:
    """The base has stopped by itself; commands from before the suspension are outdated."""
    world.approach()
    os.kill(world.server.pid, signal.SIGSTOP)
    try:
        world.stops(within=SLOWEST_STOP)
        count = len(world.commands)
    finally:  # a server that stays suspended would fail every test that follows
        os.kill(world.server.pid, signal.SIGCONT)
    world.client.until(lambda: len(world.commands) >= count + 8, what="commands again")
    assert max(abs(linear) for _, linear, _ in world.commands[count : count + 8]) < 0.5 * MOVING


def test_a_terminated_server_stops_the_robot_and_exits_normally(world: World) -> None:
    world.approach()
    assert world.server.stop(signal.SIGTERM) == 0
    assert world.stops(within=0.5) < 0.5  # it stands before the process ends
    world.gentle_end()


def test_a_shutdown_stops_the_robot_first(world: World) -> None:
    goal = world.approach()
    server = Lifecycle(world.client, "docking_server")
    assert server.shutdown()
    assert world.stops(within=0.5) < 0.5
    world.gentle_end()
    assert goal.reply().status == GoalStatus.STATUS_ABORTED
    assert server.state == "finalized"
    assert world.server.stop() == 0


@pytest.mark.parametrize(
    ("fault", "within"),
    [
        ("transforms,detections", 0.1 + 0.5 + SLOWEST_STOP),  # transform_tolerance, pose_patience
        ("odometry", 0.3 + 0.5 + SLOWEST_STOP),  # odom_duration, pose_patience
        ("costmap", 1.0 + 0.1 + SLOWEST_STOP),  # costmap_timeout, and a few cycles
    ],
)
def test_missing_inputs_stop_the_robot(world: World, fault: str, within: float) -> None:
    goal = world.approach()
    world.fault(fault, on=True)
    world.stops(within)
    world.fault(fault, on=False)
    world.client.until(lambda: world.speed > MOVING or goal.is_done, 30.0, "going on")
    assert not goal.is_done, goal.reply()


def test_detections_replace_transforms_on_the_last_metre(world: World) -> None:
    goal = world.approach()
    world.client.until(lambda: world.driven > 0.5, 20.0, "the last metre")
    world.fault("transforms", on=True)
    assert goal.reply(30.0).result.success, goal.reply()


def test_robot_stops_after_a_server_is_killed_and_a_new_server_docks(world: World) -> None:
    # The last test of the file: for 20 s the other client takes the killed server for alive, and may ask a ghost.
    world.approach()
    inner = family(world.server.pid)
    assert inner, "plans are made in another process"
    world.server.popen.kill()
    world.server.popen.wait()
    assert world.stops(within=SLOWEST_STOP) < SLOWEST_STOP
    assert world.commands[-1][1:] != (0.0, 0.0)  # nobody said so: the base stopped by itself
    world.client.until(lambda: all(is_gone(pid) for pid in inner), 5.0, "the end of the planning process")
    world.goal = None  # nobody answers for it any more
    world.start()
    with stranger(int(os.environ["ROS_DOMAIN_ID"])) as client:
        world.docks(client)
