"""One goal at a time, of several actions: which is worked on, which waits, and how each is answered.

As in Nav2's docking server, a goal of the same action preempts the one at work, a goal of another action waits for it,
and of those that wait only the newest of its action is kept. There a goal that preempts an approach is aborted together
with it; here it is carried out once the robot stands.
"""

from __future__ import annotations

import threading
import time
from contextlib import suppress
from typing import TYPE_CHECKING, Any, NamedTuple

from action_msgs.msg import GoalStatus
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import GoalEvent, RCLError
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.duration import Duration

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from rclpy.action.server import ServerGoalHandle
    from rclpy.node import Node

    from optdock_ros.control_loop import TaskRun

__all__ = ["UNKNOWN", "Ended", "Goal", "GoalOutcome", "GoalQueue", "done", "failed"]

UNKNOWN = 999
"""Nav2's error code for what has no other."""


class GoalOutcome(NamedTuple):
    """How a goal ended.

    Attributes:
        success: Whether it was done.
        code: Nav2's error code.
        text: In words.
        retries: Approaches after the first one.
    """

    success: bool
    code: int = 0
    text: str = ""
    retries: int = 0

    def __bool__(self) -> bool:
        return self.success


def done(text: str) -> GoalOutcome:
    """The goal was reached."""
    return GoalOutcome(success=True, text=text)


def failed(code: int, text: str, retries: int = 0) -> GoalOutcome:
    """The goal was not reached; code 0 where nothing went wrong."""
    return GoalOutcome(success=False, code=code, text=text, retries=retries)


class Ended(Exception):
    """The goal has ended before its task, or instead of one."""

    def __init__(self, outcome: GoalOutcome) -> None:
        super().__init__(outcome.text)
        self.outcome = outcome


class Goal:
    """A goal, and how it is told to end.

    Args:
        kind: The class of its action.
        handle: rclpy's.

    Attributes:
        request: What is wanted.
        began: When the work on it began [s], on the monotonic clock.
        run: The task that carries it out; None while there is none.
        ending: Why it is to end before it is done; empty: it is not.
        changed: Set when there is something new to look at.
    """

    def __init__(self, kind: Any, handle: ServerGoalHandle[Any, Any, Any]) -> None:
        self.kind, self.handle = kind, handle
        self.request = handle.request
        self.began = time.monotonic()
        self.run: TaskRun | None = None
        self.ending = ""
        self.changed = threading.Event()

    def end(self, reason: str) -> None:
        """It is to end; a robot that moves stops first. From any thread."""
        self.ending = self.ending or reason
        run = self.run
        if run is not None:
            run.stop(reason)
        self.changed.set()

    def start(self, run: TaskRun) -> None:
        """It is carried out by a task from now on."""
        self.run = run
        if self.ending:  # it was told so a moment before
            run.stop(self.ending)

    def tell(self, **values: object) -> None:
        """Publish feedback; what the action has no field for is left out."""
        message = self.kind.Feedback()
        for name, value in values.items():
            if hasattr(message, name):
                setattr(message, name, value)
        with suppress(RCLError):  # the goal may have ended
            self.handle.publish_feedback(message)

    def tell_progress(self, state: int, retries: int = 0) -> None:
        """Publish feedback of a docking: Nav2's number of the state, and approaches after the first one."""
        passed = Duration(nanoseconds=int(1e9 * (time.monotonic() - self.began))).to_msg()
        self.tell(state=state, docking_time=passed, num_retries=retries)

    def stopped(self, where: str = "", retries: int = 0) -> GoalOutcome:
        """How a goal ends that is to end before it is done."""
        code = 0 if self.ending == "cancelled" else UNKNOWN
        return failed(code, f"{self.ending}{where and ' '}{where}", retries)


class GoalQueue:
    """Action servers whose goals are worked on one after the other, in a thread of its own.

    Args:
        node: Whose action servers they are.
        actions: Name and work of every action, by its class; the work is called in the queue's thread.
    """

    def __init__(self, node: Node, actions: Mapping[Any, tuple[str, Callable[[Goal], GoalOutcome]]]) -> None:
        self._node, self._actions = node, actions
        self._lock = threading.RLock()
        self._is_open = False
        self._current: Goal | None = None
        self._waiting: dict[Any, Goal] = {}
        self._thread: threading.Thread | None = None
        self._servers = {kind: self._server(kind, name) for kind, (name, _) in actions.items()}

    def _server(self, kind: Any, name: str) -> ActionServer[Any, Any, Any]:
        return ActionServer(
            self._node,
            kind,
            name,
            execute_callback=lambda _: kind.Result(),  # never called: results are handed over when they are there
            goal_callback=lambda _: GoalResponse.ACCEPT if self._is_open else GoalResponse.REJECT,
            handle_accepted_callback=lambda handle: self._accept(kind, handle),
            cancel_callback=self._cancel,
            callback_group=MutuallyExclusiveCallbackGroup(),
        )

    @property
    def is_busy(self) -> bool:
        """Whether a goal is at work."""
        return self._current is not None

    def open(self) -> None:
        """Accept goals from now on."""
        self._is_open = True

    def close(self, reason: str = "the server is being shut down") -> None:
        """Accept no goals any more, and end all of them; `join` waits for the one at work."""
        with self._lock:
            self._is_open = False
            waiting, self._waiting = list(self._waiting.values()), {}
            current = self._current
        for goal in waiting:
            self._answer(goal, failed(UNKNOWN, reason))
        if current is not None:
            current.end(reason)

    def join(self, timeout: float) -> bool:
        """Wait for the end of the goal at work; whether it has ended."""
        thread = self._thread
        if thread is not None and thread is not threading.current_thread():
            thread.join(timeout)
            return not thread.is_alive()
        return True

    def destroy(self) -> None:
        """Take the action servers down."""
        for server in self._servers.values():
            server.destroy()
        self._servers = {}

    def tidy(self) -> None:
        """Answer waiting goals that were cancelled; to be called now and then while a goal is at work."""
        with self._lock:
            gone = [goal for goal in self._waiting.values() if goal.handle.is_cancel_requested]
            for goal in gone:
                del self._waiting[goal.kind]
        for goal in gone:
            self._answer(goal, failed(0, "cancelled before it began"))

    def _accept(self, kind: Any, handle: ServerGoalHandle[Any, Any, Any]) -> None:
        goal = Goal(kind, handle)
        refused: Goal | None = None
        replaced: Goal | None = None
        with self._lock:
            if not self._is_open:
                refused = goal
            elif self._current is None:
                self._current = goal
                before = self._thread
                self._thread = threading.Thread(target=self._work, args=(goal, before), name="docking-goal")
                self._thread.start()
            else:
                replaced = self._waiting.get(kind)
                self._waiting[kind] = goal
                if self._current.kind is kind:
                    self._current.end("preempted by a newer goal")
        if refused is not None:
            self._answer(refused, failed(UNKNOWN, "the server is not active"))
        if replaced is not None:
            self._answer(replaced, failed(UNKNOWN, "replaced by a newer goal before it began"))

    def _cancel(self, handle: ServerGoalHandle[Any, Any, Any]) -> CancelResponse:
        with self._lock:
            current = self._current
            if current is not None and current.handle == handle:
                current.end("cancelled")
                return CancelResponse.ACCEPT
            is_waiting = any(goal.handle == handle for goal in self._waiting.values())
        return CancelResponse.ACCEPT if is_waiting else CancelResponse.REJECT

    def _work(self, goal: Goal, before: threading.Thread | None) -> None:
        if before is not None:
            before.join()
        following: Goal | None = goal
        while following is not None:
            goal = following
            goal.began = time.monotonic()
            self._execute(goal)
            try:
                outcome = self._actions[goal.kind][1](goal)
            except Exception as error:  # the work has stopped the robot, whatever it was
                self._node.get_logger().error(f"{self._actions[goal.kind][0]}: {type(error).__name__}: {error}")
                outcome = failed(UNKNOWN, f"{type(error).__name__}: {error}")
            try:
                self._answer(goal, outcome)
            except Exception as error:  # the node may be gone; the next goal must not wait for ever
                self._node.get_logger().error(f"an answer cannot be sent: {type(error).__name__}: {error}")
            with self._lock:
                following = self._waiting.pop(goal.kind, None)
                if following is None and self._waiting:
                    following = self._waiting.pop(next(iter(self._waiting)))
                self._current = following

    @staticmethod
    def _execute(goal: Goal) -> None:
        """Its status; rclpy has no public way to say so without working in the executor's thread."""
        if goal.handle.status == GoalStatus.STATUS_ACCEPTED:
            with suppress(RCLError):
                goal.handle._update_state(GoalEvent.EXECUTE)

    def _answer(self, goal: Goal, outcome: GoalOutcome) -> None:
        """Its status and its result."""
        self._execute(goal)
        result = goal.kind.Result()
        told = {
            "success": outcome.success,
            "error_code": outcome.code,
            "error_msg": outcome.text,
            "num_retries": outcome.retries,
        }
        for name, value in told.items():
            if hasattr(result, name):
                setattr(result, name, value)
        handle = goal.handle
        with suppress(RCLError):  # the node may be going down
            if outcome.success:
                handle.succeed()
            elif handle.is_cancel_requested:
                handle.canceled()
            else:
                handle.abort()
        server = self._servers.get(goal.kind)
        if server is not None:
            server.notify_execute(handle, lambda _: result)
