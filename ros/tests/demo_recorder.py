"""The topics that the demo records, and their messages."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PolygonStamped, PoseStamped, TwistStamped
from harness import LATCHED
from nav_msgs.msg import Odometry
from nav_msgs.msg import Path as PathMessage
from rosbags.typesys import Stores, get_typestore
from rosgraph_msgs.msg import Clock
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import MarkerArray

from optdock.ros.bag import BagMessage

if TYPE_CHECKING:
    from collections.abc import Callable

    from harness import Client

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
