"""Actions that work on one goal at a time, in a thread of their own.

As with Nav2's SimpleActionServer a new goal takes the place of the one at work, which ends as aborted, and of one that
waits. The executor's thread only takes requests and sends answers, so that a cancellation is answered at once; whether
and when the work ends is the worker's part: it polls.
"""

from __future__ import annotations

import contextlib
import queue
import threading
import time
from typing import TYPE_CHECKING, Any

from rclpy.action.server import ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.task import Future

from optdock.errors import OptdockError

if TYPE_CHECKING:
    from collections.abc import Callable

    from rclpy.action.server import ServerGoalHandle
    from rclpy.node import Node

__all__ = ["GoalAction", "JobEnded", "Worker", "WorkerJob", "answer_of"]

_JOIN = 5.0  # [s] that a job has to end once it is asked to; ours poll every 5 ms, plugins of others may be slower


class JobEnded(OptdockError):
    """The work is to end: by its client, a newer goal, or the end of the server."""


class WorkerJob:
    """Something for the worker to do, and who may end it.

    Attributes:
        why_end: Why it should end; empty while it should go on.
    """

    def __init__(self, work: Callable[[WorkerJob], Any]) -> None:
        self._work = work
        self.why_end = ""
        self.is_done = threading.Event()
        self.result: Any = None
        self.error: BaseException | None = None
        self._told: list[Callable[[], None]] = []
        self._lock = threading.Lock()

    def end(self, why: str) -> None:
        """Ask for its end; the first reason counts."""
        self.why_end = self.why_end or why

    def should_end(self) -> bool:
        """Whether it is to end: a `cancel_checker`."""
        return bool(self.why_end)

    def look(self) -> None:
        """Go on only while the work is not to end.

        Raises:
            JobEnded: It is to end.
        """
        if self.why_end:
            raise JobEnded(self.why_end)

    def then(self, tell: Callable[[], None]) -> None:
        """Call this, in the worker's thread or at once, when it is done."""
        with self._lock:
            if not self.is_done.is_set():
                self._told.append(tell)
                return
        tell()

    def run(self) -> None:
        """Do it; what goes wrong is kept."""
        result, error = None, None
        try:
            self.look()
            result = self._work(self)
        except BaseException as raised:
            error = raised
        self._finish(result, error)

    def give_up(self) -> None:
        """Its work does not return: its waiters are told now, and a later result is ignored."""
        self._finish(None, JobEnded(self.why_end))

    def _finish(self, result: Any, error: BaseException | None) -> None:
        with self._lock:
            if self.is_done.is_set():
                return
            self.result, self.error = result, error
            self.is_done.set()
            told, self._told = self._told, []
        for tell in told:
            with contextlib.suppress(Exception):  # an executor that is gone needs no answer
                tell()


class Worker:
    """A thread that does one job after the other.

    Args:
        name: Of the thread.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._lock = threading.Lock()  # held for list operations only
        self._begin_thread()

    def begin(self, work: Callable[[WorkerJob], Any]) -> WorkerJob:
        """Do this after whatever is begun already."""
        job = WorkerJob(work)
        with self._lock:
            self._open.append(job)
            self._jobs.put(job)
        return job

    def do(self, work: Callable[[], Any]) -> Any:
        """Do this and wait for it; for the executor's thread only where the worker needs nothing of that."""
        job = self.begin(lambda _: work())
        job.is_done.wait()
        if job.error is not None:
            raise job.error
        return job.result

    def end_all(self, why: str) -> bool:
        """Ask for the end of everything that is begun, and wait for it.

        Returns:
            Whether all of it has ended. Where foreign code does not come back its thread is left to itself, a new one
            takes the place, and what was begun is given up.
        """
        with self._lock:
            jobs = list(self._open)
        for job in jobs:
            job.end(why)
        end = time.monotonic() + _JOIN
        ended = all(job.is_done.wait(max(0.0, end - time.monotonic())) for job in jobs)
        if not ended:
            with self._lock:
                self._jobs.put(None)
                self._begin_thread()
            for job in jobs:
                job.give_up()
        return ended

    def close(self) -> bool:
        """End all, and the thread.

        Returns:
            Whether everything has ended.
        """
        ended = self.end_all("the server shuts down")
        self._jobs.put(None)
        self._thread.join(_JOIN)
        return ended and not self._thread.is_alive()

    def _begin_thread(self) -> None:
        self._jobs: queue.SimpleQueue[WorkerJob | None] = queue.SimpleQueue()
        self._open: list[WorkerJob] = []
        # Code that never comes back must not keep a process from ending.
        self._thread = threading.Thread(target=self._loop, args=(self._jobs, self._open), name=self._name, daemon=True)
        self._thread.start()

    def _loop(self, jobs: queue.SimpleQueue[WorkerJob | None], begun: list[WorkerJob]) -> None:
        while (job := jobs.get()) is not None:
            job.run()
            with self._lock:
                begun.remove(job)


def answer_of(job: WorkerJob, node: Node) -> Future[None]:
    """Something to wait for in a callback, done when the job is; the executor does other things meanwhile.

    Args:
        job: The worker's.
        node: In whose executor that is.
    """
    executor = node.executor
    done: Future[None] = Future(executor=executor)

    def _tell() -> None:
        done.set_result(None)
        if executor is not None:
            executor.wake()  # a future alone does not end its wait

    job.then(_tell)
    return done


class GoalAction:
    """An action server whose goals a worker does, one at a time.

    Args:
        node: Whose action it is.
        kind: Type of the action.
        name: Name of the action.
        worker: Does the goals; several actions may share one.
        work: Makes a result from a goal and its job, in the worker's thread; it polls the job. Returns the result and
            whether the goal succeeded.
        ended: Makes a result that says why a goal was not worked on to its end.
        is_open: Whether goals are accepted.
        result_timeout: How long the result of a goal is kept for its client [s].
    """

    def __init__(  # noqa: PLR0913 - an action server has as many parts
        self,
        node: Node,
        kind: Any,
        name: str,
        *,
        worker: Worker,
        work: Callable[[Any, WorkerJob], tuple[Any, bool]],
        ended: Callable[[str], Any],
        is_open: Callable[[], bool],
        result_timeout: float = 10.0,
    ) -> None:
        self._node, self._worker, self._work, self._ended, self._is_open = node, worker, work, ended, is_open
        self._newest: WorkerJob | None = None
        self._jobs: dict[bytes, WorkerJob] = {}
        self._server = ActionServer(
            node,
            kind,
            name,
            self._execute,
            callback_group=ReentrantCallbackGroup(),
            goal_callback=self._accept,
            cancel_callback=self._cancel,
            result_timeout=max(1, round(result_timeout)),
        )

    def close(self) -> None:
        """Take the action away."""
        self._server.destroy()

    def _accept(self, _goal: Any) -> GoalResponse:
        return GoalResponse.ACCEPT if self._is_open() else GoalResponse.REJECT

    def _cancel(self, handle: ServerGoalHandle[Any, Any, Any]) -> CancelResponse:
        job = self._jobs.get(bytes(handle.goal_id.uuid))
        if job is not None:
            job.end("the goal was cancelled")
        return CancelResponse.ACCEPT

    async def _execute(self, handle: ServerGoalHandle[Any, Any, Any]) -> Any:
        """In the executor's thread: hand the goal to the worker, come back when it is done, and answer."""
        if self._newest is not None:
            self._newest.end("a newer goal has come")
        job = self._newest = self._worker.begin(lambda job: self._work(handle.request, job))
        key = bytes(handle.goal_id.uuid)
        self._jobs[key] = job
        if handle.is_cancel_requested:
            job.end("the goal was cancelled")
        await answer_of(job, self._node)
        del self._jobs[key]
        if self._newest is job:
            self._newest = None
        return self._answer(handle, job)

    def _answer(self, handle: ServerGoalHandle[Any, Any, Any], job: WorkerJob) -> Any:
        if job.error is None:
            result, succeeded = job.result
        else:
            result, succeeded = self._ended(job.why_end or str(job.error)), False
            if not job.why_end:
                self._node.get_logger().error(f"a goal failed: {job.error!r}")
        if handle.is_cancel_requested:
            handle.canceled()
        elif succeeded:
            handle.succeed()
        else:
            handle.abort()
        return result
