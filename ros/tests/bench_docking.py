"""Dockings through the action, one after the other, in real time: how exactly, how often, and how regular cmd_vel is.

`.venv-ros/bin/python ros/tests/bench_docking.py --count 100` prints a line for every docking and the figures of all.
"""

from __future__ import annotations

import argparse
import math
import os
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from action_msgs.msg import GoalStatus
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TwistStamped
from harness import Client, Lifecycle, Processes, free_domain, ros
from nav2_msgs.action import DockRobot
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

if TYPE_CHECKING:
    from collections.abc import Mapping

DOCK = (3.0, 1.0, 0.0)
STAGING, RADIUS, TURN = 0.7, 0.25, 0.25  # [m], [m], [rad]: what Nav2's goal checker accepts around Nav2's staging pose
MOVED, TURNED = 0.1, math.radians(5.0)  # [m], [rad]: the dock from where it is stored, at most
WITHIN = 0.010, 0.010, 1.5  # [m], [m], [deg]
SERVER = {
    "dock_plugins": ["bay"],
    "bay": {
        "plugin": "opennav_docking::SimpleChargingDock",
        "use_external_detection_pose": True,
        "detection_position_sigma": 0.003,
        "detection_yaw_sigma": 0.005,
    },
    "docks": ["home"],
    "home": {"type": "bay", "frame": "map", "pose": list(DOCK)},
}


class Docking(NamedTuple):
    """One docking: where it ended [mm, mm, deg], and the times between commands [ms], as stamped and as received."""

    text: str
    docked: bool
    error: tuple[float, float, float]
    clearance: float
    duration: float
    stamped: list[float]
    received: list[float]

    @property
    def good(self) -> bool:
        """Whether it counts."""
        along, cross, yaw = self.error
        return self.docked and abs(along) <= 10.0 and abs(cross) <= 10.0 and abs(yaw) <= WITHIN[2]


class Receiver:
    """Commands, with the times at which they came."""

    def __init__(self, client: Client) -> None:
        self.commands: list[tuple[float, float]] = []
        client.create_subscription(TwistStamped, "cmd_vel", self._take, 100)

    def _take(self, message: TwistStamped) -> None:
        stamp = message.header.stamp
        self.commands.append((time.monotonic(), stamp.sec + 1e-9 * stamp.nanosec))


def world(number: int) -> dict[str, object]:
    """Where the robot begins and where the dock truly stands."""
    random = np.random.default_rng((1, number))
    radius, angle = RADIUS * math.sqrt(random.uniform()), random.uniform(-math.pi, math.pi)
    start = [
        DOCK[0] - STAGING + radius * math.cos(angle),
        DOCK[1] + radius * math.sin(angle),
        float(random.uniform(-TURN, TURN)),
    ]
    shift, bearing = MOVED * math.sqrt(random.uniform()), random.uniform(-math.pi, math.pi)
    offset = [shift * math.cos(bearing), shift * math.sin(bearing), float(random.uniform(-TURNED, TURNED))]
    return {"start": start, "dock_offset": offset, "seed": number}


def set_parameters(client: Client, node: str, values: Mapping[str, object]) -> None:
    """Set parameters of a node."""
    messages = [Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
    answer = client.call(SetParameters, f"/{node}/set_parameters", SetParameters.Request(parameters=messages))
    assert all(result.successful for result in answer.results), answer.results


def truth(reports: list[Any]) -> dict[str, float]:
    """The last report of the simulated robot."""
    named = {"True": 1.0, "False": 0.0}
    return {
        item.key: named.get(item.value) or float(item.value)
        for item in reports[-1].status[0].values
        if item.value not in named
    }


def docked(client: Client, receiver: Receiver, reports: list[Any], number: int) -> Docking:
    """One docking."""
    set_parameters(client, "simulated_robot", world(number))
    assert client.call(Trigger, "/simulated_robot/reset").success
    time.sleep(0.5)
    receiver.commands.clear()
    began = time.monotonic()
    goal = client.send(
        DockRobot, "dock_robot", DockRobot.Goal(dock_id="home", use_dock_id=True, navigate_to_staging_pose=False)
    )
    reply = goal.reply(300.0)
    duration = time.monotonic() - began
    count = len(reports)
    client.until(lambda: len(reports) >= count + 2)
    found = truth(reports)
    received, stamped = (np.diff(column) * 1e3 for column in np.array(receiver.commands[:-1]).T)
    return Docking(
        f"{reply.result.error_code} {reply.result.error_msg}",
        reply.status == GoalStatus.STATUS_SUCCEEDED,
        (1e3 * found["along"], 1e3 * found["cross"], math.degrees(found["yaw"])),
        min(found["clearance"], found["station_clearance"] + 0.001),
        duration,
        stamped.tolist(),
        received.tolist(),
    )


def say(dockings: list[Docking]) -> None:
    """The figures of all."""
    errors = np.abs([one.error for one in dockings if one.docked]).reshape(-1, 3)
    print(f"\n{sum(one.good for one in dockings)} of {len(dockings)} docked within 10 mm, 10 mm, 1.5 deg")
    for name, column in zip(("along [mm]", "cross [mm]", "yaw [deg]"), errors.T, strict=True):
        p50, p95 = np.percentile(column, (50, 95))
        print(f"{name:11} p50 {p50:.2f}  p95 {p95:.2f}  max {column.max():.2f}")
    clearances = [one.clearance for one in dockings]
    print(f"collisions  {sum(value < 0.0 for value in clearances)}, least clearance {min(clearances):.3f} m")
    print(f"duration    p50 {np.percentile([one.duration for one in dockings], 50):.1f} s")
    for name in ("stamped", "received"):
        periods = np.concatenate([getattr(one, name) for one in dockings])
        off = np.abs(periods - 20.0)
        p50, p99 = np.percentile(off, (50, 99))
        print(
            f"cmd_vel {name}: {periods.size} periods, |period - 20 ms| p50 {p50:.2f} p99 {p99:.2f} max {off.max():.2f}"
        )


def main() -> None:
    """Drive."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--realtime", action="store_true", help="the server with use_realtime_priority")
    options = parser.parse_args()
    domain, keeper = free_domain()
    os.environ.update(ROS_DOMAIN_ID=str(domain), ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST", OMP_NUM_THREADS="1")
    with keeper, ros(domain):
        processes, client = Processes(Path(tempfile.mkdtemp())), Client("bench_docking")
        try:
            processes("simulated_robot")
            server = processes("docking_server", params={**SERVER, "use_realtime_priority": options.realtime})
            Lifecycle(client, "docking_server").up()
            receiver, reports = Receiver(client), client.heard(DiagnosticArray, "/simulated_robot/report")
            dockings = []
            for number in range(options.first, options.first + options.count):
                one = docked(client, receiver, reports, number)
                dockings.append(one)
                along, cross, yaw = one.error
                print(
                    f"{number:3} {'good' if one.good else 'BAD '} {along:7.2f} {cross:6.2f} mm {yaw:6.2f} deg "
                    f"{one.clearance:6.3f} m {one.duration:5.1f} s  {one.text}",
                    flush=True,
                )
                if not one.good:
                    Path(f"/tmp/bench_docking_{number}.log").write_text(server.log())
                server.log_file.write_bytes(b"") if one.good else None
            say(dockings)
        finally:
            processes.end()
            client.end()


if __name__ == "__main__":
    main()
    sys.exit(0)
