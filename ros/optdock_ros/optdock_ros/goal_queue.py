"""Action servers whose goals are worked on one at a time, in one worker thread.

A new goal preempts the active goal of the same action and waits for one of another action; of the waiting goals of an
action only the newest is kept. Nav2's docking server aborts a goal that preempts an approach; here it is carried out
after the robot has stopped. The executor's thread only accepts requests and sends results.
"""

from __future__ import annotations

import queue
import threading
import time
from concurrent.futures import Future
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

from action_msgs.msg import GoalStatus
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import GoalEvent, RCLError
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.duration import Duration
from rclpy.qos import QoSProfile

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from rclpy.action.server import ServerGoalHandle

    from optdock_ros.server import Server

__all__ = ["POLL", "Ended", "Goal", "GoalAction", "GoalOutcome", "GoalQueue", "done", "failed"]

T = TypeVar("T")

POLL = 0.05  # [s]: period at which the thread of a goal checks for messages, cancellations and reports
_CANCELLED = "cancelled"
_GOALS = QoSProfile(depth=100)  # requests that may arrive at once; the default, 10, drops the others without an answer


class GoalOutcome(NamedTuple):
    """Outcome of a goal: Nav2's error code, the reason, the approaches after the first one, and the result message."""

    success: bool
    code: int = 0
    text: str = ""
    retries: int = 0
    result: Any = None


def done(text: str = "", result: Any = None) -> GoalOutcome:
    """Return the outcome of a goal that was reached."""
    return GoalOutcome(success=True, text=text, result=result)


def failed(code: int, text: str, retries: int = 0) -> GoalOutcome:
    """Return the outcome of a goal that was not reached; code 0 without an error."""
    return GoalOutcome(success=False, code=code, text=text, retries=retries)


class Ended(Exception):
    """End of the work on a goal, with its outcome."""

    def __init__(self, outcome: GoalOutcome) -> None:
        super().__init__(outcome.text)
        self.outcome = outcome


class GoalAction(NamedTuple):
    """Name of an action, the work on its goals, and the error code of a goal that is preempted or deactivated."""

    name: str
    work: Callable[[Goal], GoalOutcome]
    code_of_end: int


class Goal:
    """A goal of an action of the type `kind`.

    Attributes:
        request: Goal message.
        ending: Reason why the goal is to end early; empty otherwise.
        changed: Event that is set if there is something new to report.
    """

    def __init__(self, kind: Any, action: GoalAction, handle: ServerGoalHandle[Any, Any, Any]) -> None:
        self.kind, self.action, self.handle = kind, action, handle
        self.request = handle.request
        self.ending = ""
        self.changed = threading.Event()
        self.is_answered = False
        self.began = time.monotonic()
        self._stop: Callable[[str], object] | None = None

    def end(self, reason: str) -> None:
        """End the goal early; the first reason is kept. Callable from any thread."""
        self.ending = self.ending or reason
        if self._stop is not None:
            self._stop(self.ending)
        self.changed.set()

    def on_end(self, stop: Callable[[str], object]) -> None:
        """Call `stop` with the reason when the goal is ended early, at once if it has been."""
        self._stop = stop
        if self.ending:
            stop(self.ending)

    def should_end(self) -> bool:
        """Whether the goal is to end early: a `cancel_checker`."""
        return bool(self.ending)

    def check_end(self) -> None:
        """Raise `Ended` if the goal is to end early."""
        if self.ending:
            raise Ended(self.stopped())

    def waits_for(self, condition: Callable[[], object], until: float) -> bool:
        """Whether a condition becomes true before a monotonic time [s]; raise `Ended` if the goal is to end early."""
        while not condition():
            self.check_end()
            if time.monotonic() > until:
                return False
            time.sleep(POLL)
        return True

    def stopped(self, where: str = "", retries: int = 0) -> GoalOutcome:
        """Return the outcome of a goal that was ended early."""
        code = 0 if self.ending.startswith(_CANCELLED) else self.action.code_of_end
        return failed(code, f"{self.ending}{where and ' '}{where}", retries)

    def publish_progress(self, state: int, retries: int = 0) -> None:
        """Publish Nav2's number of the state and the retries, for the fields that the action has."""
        passed = Duration(nanoseconds=int(1e9 * (time.monotonic() - self.began))).to_msg()
        message = _filled(self.kind.Feedback(), state=state, docking_time=passed, num_retries=retries)
        with suppress(RCLError):  # the goal may have ended
            self.handle.publish_feedback(message)


class GoalQueue:
    """The action servers of a node, and the thread that works on their goals; results are kept for a time [s]."""

    def __init__(self, node: Server[Any], actions: Mapping[Any, GoalAction], result_timeout: float = 10.0) -> None:
        self._node, self._actions = node, actions
        self._lock = threading.RLock()
        self._is_open = False
        self._current: Goal | None = None
        self._waiting: dict[Any, Goal] = {}
        self._is_idle = threading.Event()
        self._is_idle.set()
        self._start_worker()
        self._servers = {
            kind: ActionServer(
                node,
                kind,
                action.name,
                execute_callback=_no_result,
                goal_callback=lambda _: GoalResponse.ACCEPT if self._is_open else GoalResponse.REJECT,
                handle_accepted_callback=partial(self._accept, kind),
                cancel_callback=self._cancel,
                callback_group=MutuallyExclusiveCallbackGroup(),
                goal_service_qos_profile=_GOALS,
                result_timeout=max(1, round(result_timeout)),
            )
            for kind, action in actions.items()
        }

    def _start_worker(self) -> None:
        self._jobs: queue.SimpleQueue[Callable[[], object] | None] = queue.SimpleQueue()
        # A daemon: plugin code that does not return must not prevent the process from ending.
        threading.Thread(target=_work_off, args=(self._jobs,), name="goals", daemon=True).start()

    @property
    def is_busy(self) -> bool:
        """Whether a goal is being worked on."""
        return self._current is not None

    def call(self, work: Callable[[], T]) -> T:
        """Call `work` in the worker thread, wait, and return its result or raise its exception."""
        answer: Future[T] = Future()

        def _called() -> None:
            try:
                answer.set_result(work())
            except BaseException as error:
                answer.set_exception(error)

        self._jobs.put(_called)
        return answer.result()

    def accept_goals(self) -> None:
        """Start accepting goals."""
        self._is_open = True

    def close(self, reason: str) -> None:
        """Reject new goals and end all goals; `join` waits for the active goal."""
        with self._lock:
            self._is_open = False
            waiting, self._waiting = list(self._waiting.values()), {}
            current = self._current
        for goal in waiting:
            self._answer(goal, failed(goal.action.code_of_end, reason))
        if current is not None:
            current.end(reason)

    def join(self, patience: float) -> bool:
        """Wait until the work on all goals has returned, and return whether it did within `patience` [s].

        If not, the active goal is aborted, and a new thread replaces the worker thread.
        """
        if self._is_idle.wait(patience):
            return True
        with self._lock:
            goal, self._current = self._current, None
            self._jobs.put(None)
            self._start_worker()
            self._is_idle.set()
        if goal is not None:
            self._answer(goal, goal.stopped())
        return False

    def destroy(self) -> None:
        """Destroy the action servers and end the thread."""
        for server in self._servers.values():
            server.destroy()
        self._servers = {}
        self._jobs.put(None)

    def _accept(self, kind: Any, handle: ServerGoalHandle[Any, Any, Any]) -> None:
        goal = Goal(kind, self._actions[kind], handle)
        replaced: Goal | None = None
        with self._lock:
            is_open = self._is_open
            if is_open and self._current is None:
                self._current = goal
                self._is_idle.clear()
                self._jobs.put(partial(self._work, goal))
            elif is_open and self._current is not None:
                replaced = self._waiting.get(kind)
                self._waiting[kind] = goal
                if self._current.kind is kind:
                    self._current.end("preempted by a newer goal")
        if not is_open:
            self._answer(goal, failed(goal.action.code_of_end, "the server is not active"))
        if replaced is not None:
            self._answer(replaced, failed(goal.action.code_of_end, "replaced by a newer goal before it began"))

    def _cancel(self, handle: ServerGoalHandle[Any, Any, Any]) -> CancelResponse:
        with self._lock:
            current = self._current
            if current is not None and current.handle == handle:
                current.end(_CANCELLED)
                return CancelResponse.ACCEPT
            found = next((goal for goal in self._waiting.values() if goal.handle == handle), None)
            if found is None:
                return CancelResponse.REJECT
            found.end(f"{_CANCELLED} before it began")
        # rclpy marks the goal as canceling after this callback; it can be answered after that.
        executor = self._node.executor
        assert executor is not None, "it calls this method"
        executor.create_task(self._drop, found)
        return CancelResponse.ACCEPT

    def _drop(self, goal: Goal) -> None:
        """Answer a waiting goal that was cancelled."""
        with self._lock:
            is_waiting = self._waiting.get(goal.kind) is goal
            if is_waiting:
                del self._waiting[goal.kind]
        if is_waiting:
            self._answer(goal, goal.stopped())

    def _work(self, goal: Goal) -> None:
        """Work on a goal and on those that wait for its end, in the worker thread."""
        following: Goal | None = goal
        while following is not None:
            goal = following
            self._answer(goal, self._outcome(goal))
            with self._lock:
                if self._current is not goal:  # this thread was replaced by `join`
                    return
                following = self._waiting.pop(goal.kind, None)
                if following is None and self._waiting:
                    following = self._waiting.pop(next(iter(self._waiting)))
                self._current = following
                if following is None:
                    self._is_idle.set()

    def _outcome(self, goal: Goal) -> GoalOutcome:
        """Return the outcome of the work on a goal, also after an exception."""
        goal.began = time.monotonic()
        try:
            goal.check_end()
            _mark_executing(goal)
            return goal.action.work(goal)
        except Ended as ended:
            return ended.outcome
        except BaseException as error:  # plugins may raise anything, also SystemExit
            self._node.log_error(error, goal.action.name)
            return failed(goal.kind.Result.UNKNOWN, f"{type(error).__name__}: {error}")

    def _answer(self, goal: Goal, outcome: GoalOutcome) -> None:
        """Set the status of a goal and send its result; every goal ends here."""
        with self._lock:
            if goal.is_answered:
                return
            goal.is_answered = True
        try:
            handle = goal.handle
            result = goal.kind.Result() if outcome.result is None else outcome.result
            _filled(
                result,
                success=outcome.success,
                error_code=outcome.code,
                error_msg=outcome.text,
                num_retries=outcome.retries,
            )
            _mark_executing(goal)
            with suppress(RCLError):  # the node may be shutting down
                if outcome.success:
                    handle.succeed()
                elif handle.is_cancel_requested:
                    handle.canceled()
                else:
                    handle.abort()
            server = self._servers.get(goal.kind)
            if server is not None:
                server.notify_execute(handle, lambda _: result)
        except Exception as error:  # the node may have been destroyed; the next goal must not wait forever
            self._node.log_error(error, "a result cannot be sent")


def _work_off(jobs: queue.SimpleQueue[Callable[[], object] | None]) -> None:
    while (job := jobs.get()) is not None:
        job()


def _no_result(_handle: Any) -> Any:
    raise AssertionError("`GoalQueue._answer` sends all results")


def _mark_executing(goal: Goal) -> None:
    """Set the status; rclpy has no public way to do so outside the executor's thread."""
    if goal.handle.status == GoalStatus.STATUS_ACCEPTED:
        with suppress(RCLError):
            goal.handle._update_state(GoalEvent.EXECUTE)


def _filled(message: Any, **values: object) -> Any:
    """Set the fields that a message has; other distributions of Nav2 lack some of them."""
    for name, value in values.items():
        if hasattr(message, name):
            setattr(message, name, value)
    return message
