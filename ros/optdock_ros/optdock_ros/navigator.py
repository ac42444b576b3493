"""Navigation to the staging pose by the action `navigate_to_pose`, as in Nav2's docking server."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

from action_msgs.msg import GoalStatus
from nav2_msgs.action import NavigateToPose
from rclpy.action import ActionClient
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.task import Future

if TYPE_CHECKING:
    from collections.abc import Callable

    from geometry_msgs.msg import PoseStamped
    from rclpy.node import Node

__all__ = ["Navigator", "answer_of"]

_ATTEMPTS = 2  # as Nav2's docking server
_ANSWER = 2.0  # [s] for the server to appear, and for it to accept a goal, as in Nav2's docking server


class Navigator:
    """A client of `navigate_to_pose`; the executor of its node must run in another thread than `go`."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._client: ActionClient[Any, Any, Any] = ActionClient(
            node, NavigateToPose, "navigate_to_pose", callback_group=MutuallyExclusiveCallbackGroup()
        )

    def close(self) -> None:
        """Destroy the client."""
        self._client.destroy()

    def go(self, pose: PoseStamped, tree: str, limit: float, is_over: Callable[[], bool]) -> str:
        """Navigate the robot to a pose, and return the reason of a failure; empty after success.

        Args:
            pose: Pose to navigate to.
            tree: Behaviour tree; empty for the navigator's default.
            limit: Time limit of all attempts [s].
            is_over: Function that waits for a moment and returns whether to abort; called repeatedly.
        """
        until, fault = time.monotonic() + limit, ""
        for _ in range(_ATTEMPTS):
            fault = self._attempt(NavigateToPose.Goal(pose=pose, behavior_tree=tree), until, is_over)
            if not fault or is_over() or time.monotonic() > until:
                return fault
            self._node.get_logger().warning(f"navigate_to_pose: {fault}")
        return fault

    def _attempt(self, wanted: NavigateToPose.Goal, until: float, is_over: Callable[[], bool]) -> str:
        if not _waited(self._client.server_is_ready, min(until, time.monotonic() + _ANSWER), is_over):
            return "there is no such server"
        sent = answer_of(self._node, lambda: self._client.send_goal_async(wanted))
        if not _waited(sent.done, min(until, time.monotonic() + _ANSWER), is_over):
            sent.add_done_callback(_cancel_when_accepted)
            return "it does not respond"
        handle = sent.result()
        if handle is None or not handle.accepted:
            return "the goal was rejected"
        ended = answer_of(self._node, handle.get_result_async)
        if not _waited(ended.done, until, is_over):
            handle.cancel_goal_async()
            return "the staging pose was not reached in time"
        found = ended.result()
        assert found is not None
        code = getattr(found.result, "error_code", 0)
        if found.status == GoalStatus.STATUS_SUCCEEDED and code == 0:
            return ""
        return f"it ended with status {found.status}, code {code} {getattr(found.result, 'error_msg', '')}".rstrip()


def answer_of(node: Node, ask: Callable[[], Future[Any]]) -> Future[Any]:
    """Return the answer of an action client to a call that the executor's thread makes.

    Before Kilted, rclpy loses an answer that the executor receives before a call in another thread has returned.
    """
    answer: Future[Any] = Future()
    executor = node.executor
    assert executor is not None, "the node is in no executor"
    executor.create_task(lambda: ask().add_done_callback(lambda found: answer.set_result(found.result())))
    return answer


def _waited(condition: Callable[[], bool], until: float, is_over: Callable[[], bool]) -> bool:
    """Wait for a condition, and return whether it has become true in time."""
    while not condition():
        if is_over() or time.monotonic() > until:
            return False
    return True


def _cancel_when_accepted(future: Future[Any]) -> None:
    handle = future.result()
    if handle is not None and handle.accepted:
        handle.cancel_goal_async()
