"""A docking of the simulated robot by the docking server, recorded and drawn: no robot and no ROS installation needed.

    make ros-demo

Robot and server are processes with the parameters of `config/simulated_docking.yaml`, in a ROS domain of their own on
this computer; `examples/dock_and_undock.py` sends the goals. The processes end with the demo, also after an error.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from demo_pictures import draw
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PolygonStamped, PoseStamped, TwistStamped
from harness import LATCHED, Client, Processes, die_with_parent, free_domain, ros
from nav_msgs.msg import Odometry
from nav_msgs.msg import Path as PathMessage
from rosbags.typesys import Stores, get_typestore
from rosgraph_msgs.msg import Clock
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import MarkerArray

from optdock.ros.bag import BagMessage, write_bag

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

PACKAGE = Path(__file__).resolve().parents[1] / "optdock_ros"
CLIENT = PACKAGE / "examples" / "dock_and_undock.py"
KEPT = {
    "/tf_static": TFMessage,
    "/dock_pose": PoseStamped,
    "/docking_trajectory": PathMessage,
    "/docking_server/markers": MarkerArray,
    "/simulated_robot/obstacles": MarkerArray,
}  # by the middleware, for late subscribers
TOPICS = {
    **KEPT,
    "/tf": TFMessage,
    "/odom": Odometry,
    "/cmd_vel": TwistStamped,
    "/detected_dock_pose": PoseStamped,
    "/diagnostics": DiagnosticArray,
    "/local_costmap/published_footprint": PolygonStamped,
    "/simulated_robot/truth": Odometry,
    "/simulated_robot/report": DiagnosticArray,
}
STARTED = 60.0  # [s] until the server is active, on a busy computer
LONGEST = 120.0  # [s] for docking and undocking, which take 20 s


class Recorder:
    """Messages of all `TOPICS`, with the time of the simulated clock."""

    def __init__(self, client: Client) -> None:
        self._now = 0.0
        self._store = get_typestore(Stores.ROS2_KILTED)
        self.messages: list[BagMessage] = []
        client.create_subscription(Clock, "/clock", self._tick, 10)
        for topic, kind in TOPICS.items():
            client.create_subscription(kind, topic, self._of(topic, kind), LATCHED if topic in KEPT else 100, raw=True)

    def _tick(self, message: Clock) -> None:
        self._now = message.clock.sec + 1e-9 * message.clock.nanosec

    def _of(self, topic: str, kind: Any) -> Callable[[bytes], None]:
        name = f"{kind.__module__.split('.')[0]}/msg/{kind.__name__}"

        def keep(data: bytes) -> None:
            self.messages.append(BagMessage(topic, self._now, self._store.deserialize_cdr(data, name)))

        return keep


def dock(parameters: Path, folder: Path, recording: Path, step: Callable[[str], None]) -> None:
    """Dock, undock, and write the recording.

    Raises:
        AssertionError: If a process ends or does not start.
        subprocess.SubprocessError: If the client fails.
    """
    processes, client = Processes(folder), Client("recorder")
    try:
        recorder = Recorder(client)
        # The simulated clock waits for a busy computer; the result does not depend on the load.
        processes("simulated_robot", parameters, ("-p", "speed:=1.0"))
        server = processes("docking_server", parameters, ("-p", "use_sim_time:=true", "-p", "autostart:=true"))
        server.wait_for("active", STARTED)
        step(f"simulated_robot and docking_server are active in ROS domain {os.environ['ROS_DOMAIN_ID']}")
        step(f"{CLIENT.name} docks and undocks: about 20 s")
        command = [sys.executable, str(CLIENT)]
        # In a session of its own, as the servers: ctrl-C interrupts only the demo, which then ends the others.
        subprocess.run(command, timeout=LONGEST, check=True, start_new_session=True, preexec_fn=die_with_parent)
        write_bag(recording, recorder.messages, KEPT)
        step(f"written: {recording}, {len(recorder.messages)} messages on {len(TOPICS)} topics")
    except (AssertionError, subprocess.SubprocessError):
        for process in processes.started:
            sys.stderr.write(f"--- log of {process.name}\n{process.log()}")
        raise
    finally:
        client.end()
        processes.end()


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the demo; return 1 if it fails, 130 after ctrl-C."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("ros-demo"), help="folder (default: %(default)s)")
    parser.add_argument("--params", type=Path, default=PACKAGE / "config" / "simulated_docking.yaml")
    options = parser.parse_args(arguments)
    options.out.mkdir(parents=True, exist_ok=True)
    recording, began = options.out / "docking.mcap", time.monotonic()

    def step(text: str) -> None:
        print(f"[{time.monotonic() - began:4.0f} s] {text}", flush=True)

    domain, keeper = free_domain()
    with keeper, tempfile.TemporaryDirectory() as folder:
        ours = {"ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "OMP_NUM_THREADS": "1"}
        os.environ.update(ours, ROS_LOG_DIR=folder)
        try:
            with ros(domain):
                dock(options.params, Path(folder), recording, step)
            for line in draw(recording, options.params, options.out):
                step(line)
        except KeyboardInterrupt:
            print("interrupted; the processes have ended", file=sys.stderr)
            return 130
        except (AssertionError, subprocess.SubprocessError) as error:
            print(f"the demo failed: {error}", file=sys.stderr)
            return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
