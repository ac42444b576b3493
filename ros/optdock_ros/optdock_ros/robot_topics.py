"""What a robot does, feels and sees, by the topics of Nav2 and of its docks' types, and their detectors' services."""

from __future__ import annotations

import time
from contextlib import ExitStack, closing, contextmanager
from functools import partial
from typing import TYPE_CHECKING, Any

from geometry_msgs.msg import PoseStamped
from nav2_msgs.action import DockRobot
from nav_msgs.msg import Odometry
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from sensor_msgs.msg import BatteryState, JointState
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from optdock_ros.dock_plugins import Told
from optdock_ros.docking_goals import Ended, failed
from optdock_ros.server import Server
from optdock_ros.surroundings import CostmapTopic, FootprintTopic, now

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from rclpy.task import Future

    from optdock_ros.dock_plugins import DockPlugin
    from optdock_ros.docking_parameters import DockingSettings
    from optdock_ros.frame_lookup import TransformBuffer
    from optdock_ros.measuring import Measuring

__all__ = ["RobotTopics"]

_LOOK = 0.05  # [s] between two looks at costmaps, cancellations and what there is to report
_DETECTIONS = "detected_dock_pose"


class RobotTopics:
    """Subscriptions, and the newest message of each.

    Args:
        node: Whose they are.
        settings: Which are needed, and their names.
        frames: For the footprint.

    Attributes:
        costmap: The local costmap; None: the robot is to see no obstacles.
        map: A wider costmap; None: there is none.
        footprint: The outline of the robot; None as `costmap`.
        battery: The newest message; None before the first.
        joints: Likewise.
        switches: Likewise, by topic.
    """

    def __init__(self, node: Server[DockingSettings], settings: DockingSettings, frames: TransformBuffer) -> None:
        self._node, self._settings, self._frames = node, settings, frames
        self._parts = ExitStack()
        self._measuring: Measuring | None = None
        self.battery: Told | None = None
        self.joints: Told | None = None
        self.switches: dict[str, Told] = {}
        try:
            self._see()
            self._listen()
        except BaseException:
            self._parts.close()
            raise

    def close(self) -> None:
        """Give everything back."""
        self._parts.close()

    def _see(self) -> None:
        """Subscribe to what the robot must not touch, and to what it is."""
        own, controller, parts = self._settings.own, self._settings.controller, self._parts
        self.costmap: CostmapTopic | None = None
        self.map: CostmapTopic | None = None
        self.footprint: FootprintTopic | None = None
        if not controller.use_collision_detection:
            return
        self.costmap = parts.enter_context(closing(CostmapTopic(self._node, controller.costmap_topic)))
        if controller.map_topic:
            self.map = parts.enter_context(closing(CostmapTopic(self._node, controller.map_topic)))
        outline = FootprintTopic(
            self._node, controller.footprint_topic, self._frames, own.base_frame, controller.transform_tolerance
        )
        self.footprint = parts.enter_context(closing(outline))

    def _listen(self) -> None:
        """Subscribe to what the robot does and feels, as far as a type of dock asks for it."""
        types = [plugin.parameters for plugin in self._settings.plugins.values()]
        self._subscribe(Odometry, self._settings.own.odom_topic, self._take_odometry, 10)
        if any(of_type.use_external_detection_pose and not of_type.subscribe_toggle for of_type in types):
            self._subscribe(PoseStamped, _DETECTIONS, self._take_detection, 10)
        if any(plugin.uses_battery for plugin in self._settings.plugins.values()):
            self._subscribe(BatteryState, "battery_state", self._take_battery, 1)
        if any(of_type.use_stall_detection for of_type in types):
            self._subscribe(JointState, "joint_states", self._take_joints, 10)
        for topic in {plugin.contact_topic for plugin in self._settings.plugins.values()} - {""}:
            self._subscribe(Bool, topic, partial(self._take_switch, topic), 10)
        names = {of_type.detector_service_name for of_type in types} - {""}
        self._detectors: dict[str, Any] = {name: self._node.create_client(Trigger, name) for name in names}
        for client in self._detectors.values():
            self._parts.callback(self._node.destroy_client, client)

    def _subscribe(self, kind: Any, topic: str, take: Callable[[Any], None], depth: int) -> None:
        group = MutuallyExclusiveCallbackGroup()
        subscription = self._node.create_subscription(kind, topic, take, depth, callback_group=group)
        self._parts.callback(self._node.destroy_subscription, subscription)

    def _take_odometry(self, message: Odometry) -> None:
        if self._measuring is not None:
            self._measuring.take_odometry(message)

    def _take_detection(self, message: PoseStamped) -> None:
        if self._measuring is not None:
            self._measuring.take_detection(message)

    def _take_battery(self, message: BatteryState) -> None:
        self.battery = Told(message, now(self._node))

    def _take_joints(self, message: JointState) -> None:
        self.joints = Told(message, now(self._node))

    def _take_switch(self, topic: str, message: Bool) -> None:
        self.switches[topic] = Told(message, now(self._node))

    def _switch_on(self, plugin: DockPlugin, check_end: Callable[[], None]) -> None:
        """Have the detector switched on, where the type of dock names its service.

        Raises:
            Ended: It is not, or the goal is to end.
        """
        service = self._detectors.get(plugin.parameters.detector_service_name)
        if service is None:
            return
        timeout, answer = plugin.parameters.detector_service_timeout, None
        until = time.monotonic() + timeout
        while answer is None or not answer.done():
            check_end()
            if time.monotonic() > until:
                why = "there is no such service" if answer is None else f"no answer within {timeout:g} s"
                fault = f"{service.srv_name}: the detector is not switched on: {why}"
                raise Ended(failed(DockRobot.Result.FAILED_TO_DETECT_DOCK, fault))
            if answer is None and service.service_is_ready():
                answer = service.call_async(Trigger.Request())
            time.sleep(_LOOK)
        told = answer.result()
        if told is None or not told.success:
            fault = f"{service.srv_name}: the detector is not switched on: {told and told.message}"
            raise Ended(failed(DockRobot.Result.FAILED_TO_DETECT_DOCK, fault))

    def _switch_off(self, plugin: DockPlugin) -> None:
        """As above, without waiting for the answer: the server may be shutting down."""
        service = self._detectors.get(plugin.parameters.detector_service_name)
        if service is None:
            return
        what = f"{service.srv_name}: the detector is not switched off"

        def answered(answer: Future[Any]) -> None:
            told = answer.result()
            if told is None or not told.success:
                self._node.get_logger().error(f"{what}: {told and told.message}")

        if service.service_is_ready():
            service.call_async(Trigger.Request()).add_done_callback(answered)
        else:
            self._node.get_logger().error(f"{what}: there is no such service")

    @contextmanager
    def detecting(self, plugin: DockPlugin, measuring: Measuring, check_end: Callable[[], None]) -> Iterator[None]:
        """Have the detector at work, and hand its messages over.

        Args:
            plugin: The type of the dock.
            measuring: Takes the messages.
            check_end: Raises where the goal is to end.

        Raises:
            Ended: It does not begin, or the goal is to end.
        """
        of_type, subscription = plugin.parameters, None
        self._measuring = measuring
        if measuring.detects:
            self._switch_on(plugin, check_end)
            if of_type.subscribe_toggle:
                subscription = self._node.create_subscription(PoseStamped, _DETECTIONS, self._take_detection, 10)
        try:
            yield
        finally:
            self._measuring = None
            if subscription is not None:
                self._node.destroy_subscription(subscription)
            if measuring.detects:
                self._switch_off(plugin)
