"""The heartbeat by which Nav2's lifecycle manager knows that a server lives.

The protocol is that of `bondcpp`: both sides of a bond publish `bond/msg/Status` under one id, each with an instance id
of its own, and say with `active: false` that they end it. Nothing is asked of the other side here: a manager that is
gone leaves a server as it is, as Nav2's own.
"""

from __future__ import annotations

import uuid
from typing import TYPE_CHECKING

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup

if TYPE_CHECKING:
    from rclpy.lifecycle import LifecycleNode
    from rclpy.timer import Timer

__all__ = ["Bond"]

TOPIC = "bond"  # in the namespace of the node, where the manager's is too
PERIOD = 0.1  # [s]: Nav2's bond_heartbeat_period
TIMEOUT = 4.0  # [s] without a heartbeat until the manager takes a server for dead: Nav2's


class Bond:
    """The server's side of a bond; it beats in the executor of the node, so a node that hangs loses it.

    Args:
        node: The server; its name is the id of the bond.
        period: Between two heartbeats [s].

    Raises:
        ImportError: The messages of the package `bond` are not installed.
    """

    def __init__(self, node: LifecycleNode, period: float = PERIOD) -> None:
        from bond.msg import Status

        self._node, self._period = node, period
        self._status = Status(id=node.get_name(), heartbeat_timeout=TIMEOUT, heartbeat_period=period)
        self._publisher = node.create_publisher(Status, TOPIC, 10)
        self._timer: Timer | None = None
        self._group = MutuallyExclusiveCallbackGroup()  # no other callback delays the heartbeat

    def start(self) -> None:
        """Form a new bond; a second call does nothing."""
        if self._timer is not None:
            return
        self._status.instance_id = str(uuid.uuid4())
        self._status.active = True
        self._timer = self._node.create_timer(self._period, self._beat, callback_group=self._group)
        self._beat()

    def end(self) -> None:
        """Break the bond; where there is none nothing happens."""
        if self._timer is None:
            return
        self._node.destroy_timer(self._timer)
        self._timer = None
        self._status.active = False
        self._beat()

    def _beat(self) -> None:
        self._status.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(self._status)
