"""The way to the staging pose, by the server of navigate_to_pose: Nav2's navigator, as for its own docking server."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

from action_msgs.msg import GoalStatus
from nav2_msgs.action import NavigateToPose
from rclpy.action import ActionClient
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup

if TYPE_CHECKING:
    from collections.abc import Callable

    from geometry_msgs.msg import PoseStamped
    from rclpy.node import Node
    from rclpy.task import Future

__all__ = ["Navigator"]

_ATTEMPTS = 2  # as Nav2's docking server
_ANSWER = 2.0  # [s] for the action to be there and to accept, each, as there


class Navigator:
    """A client of navigate_to_pose.

    Args:
        node: Whose client it is; its executor must go on while a thread waits here.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._client: ActionClient[Any, Any, Any] = ActionClient(
            node, NavigateToPose, "navigate_to_pose", callback_group=MutuallyExclusiveCallbackGroup()
        )

    def close(self) -> None:
        """End the client."""
        self._client.destroy()

    def go(self, pose: PoseStamped, tree: str, limit: float, is_over: Callable[[], bool]) -> str:
        """Have the robot navigated there; a goal that is given up is cancelled.

        Args:
            pose: Where to.
            tree: Behaviour tree; empty: the navigator's own.
            limit: For all attempts [s].
            is_over: Called again and again, waits a moment, and says whether the goal is to end.

        Returns:
            Why the robot is not there; empty: it is.
        """
        until, fault = time.monotonic() + limit, ""
        for _ in range(_ATTEMPTS):
            fault = self._attempt(NavigateToPose.Goal(pose=pose, behavior_tree=tree), until, is_over)
            if not fault or is_over() or time.monotonic() > until:
                return fault
            self._node.get_logger().warning(f"navigate_to_pose: {fault}")
        return fault

    def _attempt(self, wanted: NavigateToPose.Goal, until: float, is_over: Callable[[], bool]) -> str:
        answer = min(until, time.monotonic() + _ANSWER)
        while not self._client.server_is_ready():
            if is_over() or time.monotonic() > answer:
                return "there is no such server"
        sent = self._client.send_goal_async(wanted)
        if not _came(sent, min(until, time.monotonic() + _ANSWER), is_over):
            sent.add_done_callback(_cancel_when_accepted)
            return "it does not answer"
        handle = sent.result()
        if handle is None or not handle.accepted:
            return "it does not accept the goal"
        ended = handle.get_result_async()
        if not _came(ended, until, is_over):
            handle.cancel_goal_async()
            return "the robot is not there in time"
        found = ended.result()
        assert found is not None
        code = getattr(found.result, "error_code", 0)
        if found.status == GoalStatus.STATUS_SUCCEEDED and code == 0:
            return ""
        return f"it ended with status {found.status}, code {code} {getattr(found.result, 'error_msg', '')}".rstrip()


def _came(future: Future[Any], until: float, is_over: Callable[[], bool]) -> bool:
    """Whether a result came in time, and before all was over."""
    while not future.done():
        if is_over() or time.monotonic() > until:
            return False
    return True


def _cancel_when_accepted(future: Future[Any]) -> None:
    """Cancel a goal that was accepted too late."""
    handle = future.result()
    if handle is not None and handle.accepted:
        handle.cancel_goal_async()
