"""The topics of the robot and of its docks, and the services of the dock detectors."""

from __future__ import annotations

import time
from contextlib import ExitStack, closing, contextmanager
from typing import TYPE_CHECKING, Any

from geometry_msgs.msg import PoseStamped
from nav2_msgs.action import DockRobot
from nav_msgs.msg import Odometry
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from sensor_msgs.msg import BatteryState, JointState
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from optdock_ros.dock_plugins import Received
from optdock_ros.frame_lookup import now
from optdock_ros.goal_queue import Ended, failed
from optdock_ros.surroundings import CostmapTopic, FootprintTopic

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from rclpy.node import Node
    from rclpy.task import Future

    from optdock_ros.dock_plugins import DockPlugin
    from optdock_ros.docking_parameters import DockingSettings
    from optdock_ros.frame_lookup import TransformBuffer
    from optdock_ros.goal_queue import Goal
    from optdock_ros.measuring import Measuring

__all__ = ["BATTERY", "JOINTS", "RobotTopics"]

_DETECTIONS = "detected_dock_pose"
BATTERY, JOINTS = "battery_state", "joint_states"


class RobotTopics:
    """Subscriptions, and the newest message of each topic.

    Attributes:
        costmap: Local costmap; None if obstacles are ignored.
        map: Wider costmap; None if there is none.
        footprint: Outline of the robot; None if obstacles are ignored.
    """

    def __init__(self, node: Node, settings: DockingSettings, frames: TransformBuffer) -> None:
        self._node = node
        self._parts = ExitStack()
        self._measuring: Measuring | None = None
        self._newest: dict[str, Received] = {}
        self.costmap: CostmapTopic | None = None
        self.map: CostmapTopic | None = None
        self.footprint: FootprintTopic | None = None
        try:
            if settings.controller.use_collision_detection:
                self._subscribe_surroundings(settings, frames)
            self._subscribe_sensors(settings)
        except BaseException:
            self._parts.close()
            raise

    def close(self) -> None:
        """Destroy subscriptions and clients."""
        self._parts.close()

    def newest(self, topic: str) -> Received | None:
        """Return the newest message of `BATTERY`, `JOINTS` or the topic of a switch; None before the first."""
        return self._newest.get(topic)

    def _subscribe_surroundings(self, settings: DockingSettings, frames: TransformBuffer) -> None:
        controller, parts = settings.controller, self._parts
        self.costmap = parts.enter_context(closing(CostmapTopic(self._node, controller.costmap_topic)))
        if controller.map_topic:
            self.map = parts.enter_context(closing(CostmapTopic(self._node, controller.map_topic)))
        base, tolerance = settings.own.base_frame, controller.transform_tolerance
        outline = FootprintTopic(self._node, controller.footprint_topic, frames, base, tolerance)
        self.footprint = parts.enter_context(closing(outline))

    def _subscribe_sensors(self, settings: DockingSettings) -> None:
        """Subscribe to the topics that a dock type uses."""
        plugins = settings.plugins.values()
        types = [plugin.parameters for plugin in plugins]
        self._subscribe(Odometry, settings.own.odom_topic, self._take_odometry, 10)
        if any(of_type.use_external_detection_pose and not of_type.subscribe_toggle for of_type in types):
            self._subscribe(PoseStamped, _DETECTIONS, self._take_detection, 10)
        if any(plugin.uses_battery for plugin in plugins):
            self._keep(BatteryState, BATTERY, 1)
        if any(of_type.use_stall_detection for of_type in types):
            self._keep(JointState, JOINTS, 10)
        for topic in {plugin.contact_topic for plugin in plugins} - {""}:
            self._keep(Bool, topic, 10)
        names = {of_type.detector_service_name for of_type in types} - {""}
        self._detectors: dict[str, Any] = {name: self._node.create_client(Trigger, name) for name in names}
        for client in self._detectors.values():
            self._parts.callback(self._node.destroy_client, client)

    def _subscribe(self, kind: Any, topic: str, take: Callable[[Any], None], depth: int) -> None:
        group = MutuallyExclusiveCallbackGroup()
        subscription = self._node.create_subscription(kind, topic, take, depth, callback_group=group)
        self._parts.callback(self._node.destroy_subscription, subscription)

    def _keep(self, kind: Any, topic: str, depth: int) -> None:
        """Subscribe to a topic, and keep its newest message."""

        def _take(message: Any) -> None:
            self._newest[topic] = Received(message, now(self._node))

        self._subscribe(kind, topic, _take, depth)

    def _take_odometry(self, message: Odometry) -> None:
        if self._measuring is not None:
            self._measuring.take_odometry(message)

    def _take_detection(self, message: PoseStamped) -> None:
        if self._measuring is not None:
            self._measuring.take_detection(message)

    @contextmanager
    def detecting(self, plugin: DockPlugin, measuring: Measuring, goal: Goal) -> Iterator[None]:
        """Switch the detector on, and pass messages to the measurements; raise `Ended` if that fails."""
        subscription = None
        self._measuring = measuring
        if measuring.detects:
            self._switch_on(plugin, goal)
            if plugin.parameters.subscribe_toggle:
                subscription = self._node.create_subscription(PoseStamped, _DETECTIONS, self._take_detection, 10)
        try:
            yield
        finally:
            self._measuring = None
            if subscription is not None:
                self._node.destroy_subscription(subscription)
            if measuring.detects:
                self._switch_off(plugin)

    def _switch_on(self, plugin: DockPlugin, goal: Goal) -> None:
        service = self._detectors.get(plugin.parameters.detector_service_name)
        if service is None:
            return
        what = f"{service.srv_name}: the detector is not switched on"
        timeout = plugin.parameters.detector_service_timeout
        until, no_dock = time.monotonic() + timeout, DockRobot.Result.FAILED_TO_DETECT_DOCK
        if not goal.waits_for(service.service_is_ready, until):
            raise Ended(failed(no_dock, f"{what}: there is no such service"))
        answer = service.call_async(Trigger.Request())
        if not goal.waits_for(answer.done, until):
            raise Ended(failed(no_dock, f"{what}: no answer within {timeout:g} s"))
        reply = answer.result()
        if reply is None or not reply.success:
            raise Ended(failed(no_dock, f"{what}: {reply and reply.message}"))

    def _switch_off(self, plugin: DockPlugin) -> None:
        """Switch the detector off without waiting for the answer: the server may be shutting down."""
        service = self._detectors.get(plugin.parameters.detector_service_name)
        if service is None:
            return
        what = f"{service.srv_name}: the detector is not switched off"

        def answered(answer: Future[Any]) -> None:
            reply = answer.result()
            if reply is None or not reply.success:
                self._node.get_logger().error(f"{what}: {reply and reply.message}")

        if service.service_is_ready():
            service.call_async(Trigger.Request()).add_done_callback(answered)
        else:
            self._node.get_logger().error(f"{what}: there is no such service")
