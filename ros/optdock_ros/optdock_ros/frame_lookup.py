"""The time of a node, and the transforms between frames that it receives from /tf and /tf_static."""

from __future__ import annotations

import dataclasses
import math
from functools import partial
from typing import TYPE_CHECKING

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.clock import JumpThreshold
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from tf2_msgs.msg import TFMessage

from optdock import ros

if TYPE_CHECKING:
    from geometry_msgs.msg import TransformStamped
    from rclpy.node import Node

__all__ = ["TransformBuffer", "now"]

_HISTORY = 10.0  # [s]: as tf2's buffer
_DEPTH = 100  # messages: as tf2's listener


def now(node: Node) -> float:
    """Return the time of a node's clock [s], which is that of the simulation with `use_sim_time`."""
    return float(node.get_clock().now().nanoseconds) * 1e-9


class TransformBuffer(ros.TransformTree):
    """The transforms of /tf and /tf_static, kept for 10 s; a clock that jumps back removes those of moving frames."""

    def __init__(self, node: Node) -> None:
        super().__init__(_HISTORY)
        self._node = node
        subscribe = partial(node.create_subscription, TFMessage, callback_group=MutuallyExclusiveCallbackGroup())
        # Best effort is compatible with publishers of either kind.
        moving = QoSProfile(depth=_DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT)
        fixed = QoSProfile(depth=_DEPTH, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._subscriptions = [
            subscribe("/tf", partial(self._take, is_static=False), qos_profile=moving),
            subscribe("/tf_static", partial(self._take, is_static=True), qos_profile=fixed),
        ]
        backwards = JumpThreshold(min_forward=None, min_backward=Duration(nanoseconds=-1), on_clock_change=True)
        self._jumps = node.get_clock().create_jump_callback(backwards, post_callback=lambda _: self.forget())

    def close(self) -> None:
        """Destroy the subscriptions; the transforms are kept."""
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)
        self._subscriptions = []
        self._jumps.unregister()

    def lookup(self, target: str, source: str, stamp: float | None = None, tolerance: float = 0.0) -> ros.Transform:
        """Look up as `TransformTree.lookup`; without a given time, a static transform has the current time."""
        found = super().lookup(target, source, stamp, tolerance)
        return found if math.isfinite(found.stamp) else dataclasses.replace(found, stamp=now(self._node))

    def insert(self, message: TransformStamped, *, is_static: bool = False) -> bool:
        """Insert as `TransformTree.insert`, and log a rejected transform once per pair of frames."""
        pair = message.header.frame_id.lstrip("/"), message.child_frame_id.lstrip("/")
        is_new, time = pair not in self.refused, now(self._node)
        ahead = float(message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec) - time
        # As the newest transform it would remain valid and remove all others; before the first /clock there is no time.
        if not is_static and time > 0.0 and ahead > _HISTORY:
            is_stored = self.refuse(*pair, f"is dated {ahead:.1f} s into the future")
        else:
            is_stored = super().insert(message, is_static=is_static)
        if is_new and not is_stored:
            self._node.get_logger().error(f"{pair[0]} <- {pair[1]}: {self.refused[pair]}; not used")
        return is_stored

    def stamp_text(self, newest: float) -> str:
        """Return the age of the newest transform of a frame in words."""
        return f"{now(self._node) - newest:.2f} s old"

    def _take(self, message: TFMessage, *, is_static: bool) -> None:
        for transform in message.transforms:
            self.insert(transform, is_static=is_static)
