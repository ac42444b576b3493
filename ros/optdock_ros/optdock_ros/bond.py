"""Heartbeat of a server for Nav2's lifecycle manager.

The protocol is that of `bondcpp`: both sides of a bond publish `bond/msg/Status` with one id and an instance id per
side, and end the bond with `active: false`. As in Nav2's servers, the manager's side is not monitored.
"""

from __future__ import annotations

import threading
import time
import uuid
from contextlib import suppress
from typing import TYPE_CHECKING

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.exceptions import InvalidHandle

if TYPE_CHECKING:
    from rclpy.lifecycle import LifecycleNode

__all__ = ["Bond"]

TOPIC = "bond"  # relative to the namespace of the node, as the manager's
TIMEOUT = 4.0  # [s] without a heartbeat after which the manager regards the server as dead: Nav2's default
HANGING = 30.0  # [s] in one callback that count as hanging; rclpy needs up to 10 s to receive a path of 100,000 poses


class Bond:
    """The server's side of a bond.

    The heartbeat has its own thread, so that a busy executor does not delay it. It pauses if the executor of the node
    has not run for `HANGING`, so that the bond of a node that hangs is broken.

    Args:
        node: The server; its name is the id of the bond.
        period: Period of the heartbeat [s].

    Raises:
        ImportError: If the messages of the package `bond` are not installed.
    """

    def __init__(self, node: LifecycleNode, period: float) -> None:
        from bond.msg import Status

        self._node, self._period = node, period
        self._status = Status(id=node.get_name(), heartbeat_timeout=TIMEOUT, heartbeat_period=period)
        self._publisher = node.create_publisher(Status, TOPIC, 10)
        self._ended: threading.Event | None = None
        self._executor_ran_at = 0.0
        self._group = MutuallyExclusiveCallbackGroup()

    def start(self) -> None:
        """Form a new bond; a second call has no effect."""
        if self._ended is not None:
            return
        self._status.instance_id = str(uuid.uuid4())
        self._status.active = True
        self._ended = threading.Event()
        self._note_executor()
        self._timer = self._node.create_timer(self._period, self._note_executor, callback_group=self._group)
        self._thread = threading.Thread(target=self._beat, args=(self._ended,), name="bond", daemon=True)
        self._thread.start()

    def end(self) -> None:
        """Break the bond, if there is one."""
        if self._ended is None:
            return
        self._ended.set()
        self._thread.join()
        self._node.destroy_timer(self._timer)
        self._ended = None
        self._status.active = False
        self._publish()

    def _note_executor(self) -> None:
        self._executor_ran_at = time.monotonic()

    def _beat(self, ended: threading.Event) -> None:
        with suppress(InvalidHandle):  # the node has been destroyed
            while not ended.is_set():
                if time.monotonic() - self._executor_ran_at < HANGING:
                    self._publish()
                ended.wait(self._period)

    def _publish(self) -> None:
        self._status.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(self._status)
