"""The longest pause of the servers' heartbeat under load, measured by a process that only receives it.

    .venv-ros/bin/python ros/tests/bench_heartbeat.py [--seconds 10]

Loads: a named pipe as dock database, costmaps of 4000 x 4000 cells at 5 Hz during a docking, a path of 100,000 poses,
and 60 goals at once. Bar: no pause above 1 s. Nav2's lifecycle manager regards a server as dead after 4 s.
"""

from __future__ import annotations

import argparse
import os
import signal
import struct
import subprocess
import sys
import tempfile
import time
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from bond.msg import Status
from hall import COSTMAP, Surroundings, message
from harness import LATCHED, Client, Lifecycle, Processes, free_domain, ros
from launch_stand_in import PACKAGE
from nav2_msgs.action import DockRobot, SmoothPath
from nav2_msgs.msg import Costmap
from nav2_msgs.srv import ReloadDockDatabase
from rclpy.action import ActionClient
from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message

from optdock.model.costmap import Costmap as Grid
from optdock.ros import costmap_message, imported

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

BAR = 1.0  # [s]
POSES, CELLS, RATE, GOALS = 100_000, 4000, 5.0, 60
WORLD = PACKAGE / "config" / "simulated_docking.yaml"
DOCK = DockRobot.Goal(dock_id="bay", navigate_to_staging_pose=False)
STAMP = struct.Struct("<iI")  # of a serialized message with a header, after 4 bytes of encapsulation


def listen() -> None:
    """Print server and time [s] of every heartbeat, until the standard input is closed."""
    domain = int(os.environ["ROS_DOMAIN_ID"])
    with ros(domain):
        client = Client("listener")
        client.create_subscription(
            Status, "bond", lambda status: print(status.id, time.monotonic(), status.active, flush=True), 100
        )
        sys.stdin.read()
        client.end()


@contextmanager
def listening(folder: Path) -> Iterator[Callable[[str, float], float]]:
    """Return a function that returns the longest pause of a server's heartbeat since a time [s]."""
    file = folder / "heartbeats"
    with file.open("w") as out:
        child = subprocess.Popen([sys.executable, __file__, "--listen"], stdin=subprocess.PIPE, stdout=out)

        def _longest(server: str, since: float) -> float:
            lines = [line.split() for line in file.read_text().splitlines() if line.count(" ") == 2]
            heard = [float(stamp) for name, stamp, _ in lines if name == server]
            return max(np.diff([since, *(stamp for stamp in heard if stamp > since), time.monotonic()]))

        try:
            yield _longest
        finally:
            child.communicate()


class Bench:
    """Both servers and a simulated robot, and a function for every load, which returns what has been processed."""

    def __init__(self, client: Client, processes: Processes, folder: Path, seconds: float) -> None:
        self.client, self.folder, self.seconds = client, folder, seconds
        self.world = Surroundings(client)
        processes("simulated_robot", params=WORLD, args=("-r", "local_costmap/costmap_raw:=small"))
        self.servers = {
            "smoother_server": processes("smoother_server"),
            "docking_server": processes("docking_server", params=WORLD),
        }
        for name in self.servers:
            Lifecycle(client, name).up()
        self.world.footprint()
        self.publishers = [
            client.create_publisher(Costmap, topic, LATCHED) for topic in (COSTMAP, "local_costmap/costmap_raw")
        ]
        data = np.zeros((CELLS, CELLS), np.uint8)
        grid = costmap_message(imported, Grid(data, 0.05, (-0.025 * CELLS, -0.025 * CELLS)), "odom", 0.0)
        self.costmap = serialize_message(grid)

    def rest(self) -> str:
        """Nothing."""
        time.sleep(self.seconds)
        return ""

    def pipe(self) -> str:
        """Name a pipe as dock database."""
        pipe = self.folder / "pipe"
        os.mkfifo(pipe)
        request = ReloadDockDatabase.Request(filepath=str(pipe))
        assert not self.client.call(ReloadDockDatabase, "/docking_server/reload_database", request).success
        return "refused"

    def poses(self) -> str:
        """Send a long path."""
        path = message(np.column_stack((np.linspace(-5.0, 5.0, POSES), np.zeros(POSES), np.zeros(POSES))))
        goal = SmoothPath.Goal(path=path)
        goal.max_smoothing_duration.sec = 2
        result = self.client.send(SmoothPath, "smooth_path", goal, 60.0).reply(60.0).result
        return f"answered with code {result.error_code}"

    def costmaps(self) -> str:
        """Publish large costmaps to both servers during a docking."""
        self._publish()
        goal = self.client.send(DockRobot, "dock_robot", DOCK)
        until, count = time.monotonic() + self.seconds, 0
        while time.monotonic() < until or not goal.is_done:
            began = time.monotonic()
            self._publish()
            count += 1
            time.sleep(max(0.0, began + 1.0 / RATE - time.monotonic()))
        result = goal.reply().result
        return f"{count} published, docking: {result.success}, {result.error_msg}"

    def _publish(self) -> None:
        now = self.client.get_clock().now().nanoseconds
        serialized = self.costmap[:4] + STAMP.pack(*divmod(now, 10**9)) + self.costmap[4 + STAMP.size :]
        for publisher in self.publishers:
            publisher.publish(serialized)

    def goals(self) -> str:
        """Send goals to both servers at once, with a queue for all of them."""
        depth = QoSProfile(depth=2 * GOALS)
        path = message(np.column_stack((np.linspace(-5.0, 5.0, 200), np.zeros(200), np.zeros(200))))
        wanted = ((SmoothPath, "smooth_path", SmoothPath.Goal(path=path)), (DockRobot, "dock_robot", DOCK))
        answers = []
        for kind, name, goal in wanted:
            action = ActionClient(self.client, kind, name, goal_service_qos_profile=depth)
            assert action.wait_for_server(10.0)
            answers += [action.send_goal_async(goal) for _ in range(GOALS)]
        time.sleep(self.seconds)
        return f"{sum(answer.done() for answer in answers)} of {len(answers)} accepted"


def main() -> int:
    """Run all loads and print a table; return 1 if a pause is above the bar."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=10.0, help="duration of rest and costmaps")
    parser.add_argument("--listen", action="store_true", help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.listen:
        listen()
        return 0
    domain, keeper = free_domain()
    os.environ |= {"ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "OMP_NUM_THREADS": "1"}
    with tempfile.TemporaryDirectory() as name, keeper, ros(domain), listening(Path(name)) as longest:
        processes, client = Processes(Path(name)), Client("bench")
        try:
            bench = Bench(client, processes, Path(name), asked.seconds)
            return measure(bench, longest)
        finally:
            client.end()
            processes.end()


def measure(bench: Bench, longest: Callable[[str, float], float]) -> int:
    """Print the longest pauses; return 1 if one is above the bar."""
    worst = 0.0
    time.sleep(1.0)
    print(f"longest pause of the heartbeat, every 0.1 s, bar {BAR:g} s; load {os.getloadavg()[0]:.1f}", flush=True)
    for load in (bench.rest, bench.pipe, bench.costmaps, bench.poses, bench.goals):
        began = time.monotonic()
        told = load()
        time.sleep(1.0)
        found = {name: longest(name, began) for name in bench.servers}
        worst = max(worst, *found.values())
        pauses = ", ".join(f"{name} {seconds:.2f} s" for name, seconds in found.items())
        print(f"  {load.__name__:10s} {pauses}; {time.monotonic() - began:.1f} s {told}", flush=True)
    for name, server in bench.servers.items():
        began = time.monotonic()
        server.stop(signal.SIGINT, 60.0)
        print(f"  SIGINT     {name} ends after {time.monotonic() - began:.1f} s")
    return int(worst > BAR)


if __name__ == "__main__":
    sys.exit(main())
