"""Where frames stand to each other now: what /tf and /tf_static say."""

from __future__ import annotations

import dataclasses
import math
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

__all__ = ["TransformBuffer"]

_HISTORY = 10.0  # [s]: as tf2's buffer
_DEPTH = 100  # messages: as tf2's listener; a burst of a hundred publishers gets through


class TransformBuffer(ros.TransformTree):
    """Transforms between frames, as /tf and /tf_static tell them, kept for 10 s.

    A clock that jumps back forgets the moving frames.

    Args:
        node: Whose subscriptions they are; a node of `use_sim_time` has the simulation's clock.
    """

    def __init__(self, node: Node) -> None:
        super().__init__(_HISTORY)
        self._node = node
        group = MutuallyExclusiveCallbackGroup()
        # Best effort takes from publishers of either kind; what is lost is told again a moment later.
        moving = QoSProfile(depth=_DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT)
        fixed = QoSProfile(depth=_DEPTH, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._subscriptions = [
            node.create_subscription(TFMessage, "/tf", self._take_moving, moving, callback_group=group),
            node.create_subscription(TFMessage, "/tf_static", self._take_fixed, fixed, callback_group=group),
        ]
        backwards = JumpThreshold(min_forward=None, min_backward=Duration(nanoseconds=-1), on_clock_change=True)
        self._jumps = node.get_clock().create_jump_callback(backwards, post_callback=lambda _: self.forget())

    def close(self) -> None:
        """End the subscriptions; what is known stays."""
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)
        self._subscriptions = []
        self._jumps.unregister()

    def lookup(self, target: str, source: str, stamp: float | None = None, tolerance: float = 0.0) -> ros.Transform:
        """As `TransformTree.lookup`; frames that never move stand so now, where no time is asked for."""
        found = super().lookup(target, source, stamp, tolerance)
        return found if math.isfinite(found.stamp) else dataclasses.replace(found, stamp=self._now())

    def insert(self, message: TransformStamped, *, is_static: bool = False) -> bool:
        """As `TransformTree.insert`; what is refused is logged, once per pair of frames."""
        pair = message.header.frame_id.lstrip("/"), message.child_frame_id.lstrip("/")
        is_new, ahead = pair not in self.refused, self._ahead(message)
        if is_static or ahead <= _HISTORY:
            is_stored = super().insert(message, is_static=is_static)
        else:
            # As the newest it would stand for ever, and everything before it would be forgotten.
            is_stored = self.refuse(*pair, f"is dated {ahead:.1f} s into the future")
        if is_new and not is_stored:
            self._node.get_logger().error(f"{pair[0]} <- {pair[1]}: {self.refused[pair]}; not used")
        return is_stored

    def stamp_text(self, newest: float) -> str:
        """How old the newest transform of a frame is, in words."""
        return f"{self._now() - newest:.2f} s old"

    def _ahead(self, message: TransformStamped) -> float:
        """How far ahead of the node's clock a message is dated [s]; where there is no time yet, it is not."""
        now, stamp = self._now(), message.header.stamp
        return float(stamp.sec + 1e-9 * stamp.nanosec) - now if now > 0.0 else 0.0

    def _now(self) -> float:
        return float(self._node.get_clock().now().nanoseconds) * 1e-9

    def _take_moving(self, message: TFMessage) -> None:
        for transform in message.transforms:
            self.insert(transform)

    def _take_fixed(self, message: TFMessage) -> None:
        for transform in message.transforms:
            self.insert(transform, is_static=True)
