"""The queue of goals: preemption, cancelling, plugins that do not return, and how long results are kept."""

from __future__ import annotations

import threading
import time
from typing import TYPE_CHECKING, Any

import pytest
from action_msgs.msg import GoalStatus
from harness import spinning
from nav2_msgs.action import DockRobot, SmoothPath
from optdock_ros.goal_queue import Goal, GoalAction, GoalOutcome, GoalQueue, done
from optdock_ros.server import Server
from rclpy.action import ActionClient
from rclpy.qos import QoSProfile

if TYPE_CHECKING:
    from collections.abc import Iterator

    from harness import Client


class Queue:
    """A queue of two actions; the work on a goal of `dock` ends when the goal is ended, that on `path` at once."""

    def __init__(self, client: Client, node: Server[Any]) -> None:
        self.client = client
        self.log: list[str] = []
        self.release = threading.Event()
        self.is_stuck = False
        actions = {
            DockRobot: GoalAction("dock", self._dock, 999),
            SmoothPath: GoalAction("path", self._path, 0),
        }
        self.queue = GoalQueue(node, actions, result_timeout=1.0)
        self.queue.accept_goals()

    def _dock(self, goal: Goal) -> GoalOutcome:
        self.log.append(f"{threading.current_thread().name} {goal.request.dock_id}")
        if self.is_stuck:
            assert self.release.wait(20.0)
            return done("too late")
        while True:
            goal.check_end()
            time.sleep(0.001)

    def _path(self, goal: Goal) -> GoalOutcome:
        if goal.request.smoother_id:
            raise SystemExit(goal.request.smoother_id)
        return done(result=SmoothPath.Result(was_completed=True))

    def dock(self, name: str = "") -> Any:
        """Send a goal."""
        return self.client.send(DockRobot, "dock", DockRobot.Goal(dock_id=name))

    def path(self, smoother: str = "") -> Any:
        """Send a goal."""
        return self.client.send(SmoothPath, "path", SmoothPath.Goal(smoother_id=smoother))


@pytest.fixture
def queue(client_node: Client) -> Iterator[Queue]:
    node: Server[Any] = Server("queued")
    made = Queue(client_node, node)
    with spinning(node):
        yield made
        made.release.set()
        made.queue.close("the end")
        made.queue.join(5.0)
        made.queue.destroy()


def answer(goal: Any) -> tuple[int, int, str]:
    status, result, _ = goal.reply()
    return status, result.error_code, result.error_msg


def test_all_of_60_goals_at_once_are_answered(queue: Queue) -> None:
    depth = QoSProfile(depth=60)  # of the client's queue for the answers
    action: ActionClient[Any, Any, Any] = ActionClient(queue.client, SmoothPath, "path", goal_service_qos_profile=depth)
    assert action.wait_for_server(20.0)
    answers = [action.send_goal_async(SmoothPath.Goal()) for _ in range(60)]
    queue.client.until(lambda: all(answer.done() for answer in answers), what="all answers")


def test_goals_preempt_wait_are_replaced_and_cancelled(queue: Queue) -> None:
    first = queue.dock("first")
    waiting, replacing = queue.path(), queue.path()
    assert answer(waiting) == (GoalStatus.STATUS_ABORTED, 0, "replaced by a newer goal before it began")
    replacing.cancel()
    assert answer(replacing) == (GoalStatus.STATUS_CANCELED, 0, "cancelled before it began")
    second = queue.dock("second")
    assert answer(first) == (GoalStatus.STATUS_ABORTED, 999, "preempted by a newer goal")
    third = queue.path()
    second.cancel()
    assert answer(second) == (GoalStatus.STATUS_CANCELED, 0, "cancelled")
    assert third.reply().result.was_completed
    assert queue.log == ["goals first", "goals second"]
    assert queue.queue.call(threading.current_thread).name == "goals"


def test_closing_ends_all_goals_and_accepts_no_more(queue: Queue) -> None:
    first, waiting = queue.dock(), queue.path()
    queue.queue.close("enough")
    assert queue.queue.join(5.0)
    assert answer(first) == (GoalStatus.STATUS_ABORTED, 999, "enough")
    assert answer(waiting) == (GoalStatus.STATUS_ABORTED, 0, "enough")
    assert not queue.dock().is_accepted


def test_work_that_does_not_return_is_given_up(queue: Queue) -> None:
    queue.is_stuck = True
    stuck = queue.dock()
    queue.client.until(lambda: queue.log)
    queue.queue.close("enough")
    assert not queue.queue.join(0.05)
    assert answer(stuck) == (GoalStatus.STATUS_ABORTED, 999, "enough")
    queue.queue.accept_goals()
    assert queue.path().reply().status == GoalStatus.STATUS_SUCCEEDED
    queue.release.set()
    time.sleep(0.1)
    assert not queue.queue.is_busy
    assert queue.path().reply().status == GoalStatus.STATUS_SUCCEEDED


def test_exception_of_the_work_is_the_result(queue: Queue) -> None:
    assert answer(queue.path("boom")) == (GoalStatus.STATUS_ABORTED, SmoothPath.Result.UNKNOWN, "SystemExit: boom")
    assert queue.path().reply().status == GoalStatus.STATUS_SUCCEEDED
    with pytest.raises(ZeroDivisionError):
        queue.queue.call(lambda: 1 / 0)


def test_results_are_kept_for_a_while_and_then_removed(queue: Queue) -> None:
    for _ in range(5):
        queue.path().reply()
    server = queue.queue._servers[SmoothPath]
    assert server._goal_handles
    queue.client.until(lambda: not server._goal_handles, timeout=10.0, what="that all are gone")
    assert not server._result_futures
