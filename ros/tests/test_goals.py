"""The worker behind the actions, and how long goals are kept."""

from __future__ import annotations

import threading
import time
from typing import TYPE_CHECKING, Any

import pytest
from harness import spinning
from nav2_msgs.action import SmoothPath
from optdock_ros import goals
from optdock_ros.goals import GoalAction, JobEnded, Worker, WorkerJob
from rclpy.node import Node

if TYPE_CHECKING:
    from collections.abc import Iterator

    from harness import Client


@pytest.fixture
def worker() -> Iterator[Worker]:
    """A worker of its own."""
    made = Worker("worker")
    yield made
    made.close()


def until_asked(job: WorkerJob) -> None:
    """Work without an end."""
    while True:
        job.look()
        time.sleep(0.001)


def test_jobs_are_done_one_after_the_other_in_one_thread(worker: Worker) -> None:
    order: list[int] = []
    jobs = [worker.begin(lambda _, n=n: order.append(n) or threading.current_thread().name) for n in range(20)]
    assert [job.is_done.wait(5.0) and job.result for job in jobs] == ["worker"] * 20
    assert order == list(range(20))
    with pytest.raises(ZeroDivisionError):
        worker.do(lambda: 1 / 0)


def test_jobs_end_when_they_are_asked_to(worker: Worker) -> None:
    running, waiting = worker.begin(until_asked), worker.begin(until_asked)
    told: list[str] = []
    running.then(lambda: told.append("running"))
    assert worker.end_all("enough")
    for job in (running, waiting):
        assert isinstance(job.error, JobEnded)
        assert str(job.error) == "enough"
    waiting.then(lambda: told.append("waiting"))
    assert told == ["running", "waiting"]
    assert worker.do(lambda: 5) == 5


def test_code_that_does_not_come_back_is_left_behind(worker: Worker, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(goals, "_JOIN", 0.05)
    begun, release = threading.Event(), threading.Event()
    stuck = worker.begin(lambda _: begun.set() or release.wait(10.0))
    waiting = worker.begin(until_asked)
    assert begun.wait(5.0)
    assert not worker.end_all("enough")
    for job in (stuck, waiting):  # who waits for them is told so
        assert job.is_done.is_set()
        assert str(job.error) == "enough"
    assert worker.do(lambda: 7) == 7
    release.set()
    assert isinstance(stuck.error, JobEnded)


def test_results_are_kept_for_a_while_and_then_gone(client_node: Client, worker: Worker) -> None:
    """A goal's handle and result go after their time, or a server grows for as long as it lives."""
    node = Node("keeper")

    def _work(_goal: Any, _job: WorkerJob) -> tuple[Any, bool]:
        return SmoothPath.Result(), True

    action = GoalAction(
        node,
        SmoothPath,
        "kept_path",
        worker=worker,
        work=_work,
        ended=lambda _: SmoothPath.Result(),
        is_open=lambda: True,
        result_timeout=1.0,
    )
    with spinning(node):
        for _ in range(20):
            client_node.send(SmoothPath, "kept_path", SmoothPath.Goal()).reply()
        assert len(action._server._goal_handles) > 0
        client_node.until(lambda: not action._server._goal_handles, timeout=10.0, what="that all are gone")
        assert not action._server._result_futures
        assert not action._jobs
        action.close()
