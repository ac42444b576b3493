"""Fixtures of the tests of the ROS package; `harness.py` describes their values."""

from __future__ import annotations

import functools
import os
from typing import TYPE_CHECKING

import pytest
from harness import Client, Lifecycle, Processes, free_domain, ros

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

LINES = 150  # of each process' log that a failure shows


@pytest.fixture(scope="session", autouse=True)
def domain(tmp_path_factory: pytest.TempPathFactory) -> Iterator[int]:
    """Domain id of this run or worker; its processes inherit it."""
    number, keeper = free_domain()
    logs = str(tmp_path_factory.mktemp("ros"))
    ours = {"ROS_DOMAIN_ID": str(number), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_LOG_DIR": logs}
    ours["OMP_NUM_THREADS"] = "1"
    with pytest.MonkeyPatch.context() as patch, keeper:
        patch.delenv("ROS_LOCALHOST_ONLY", raising=False)
        patch.delenv("ROS_STATIC_PEERS", raising=False)
        patch.delenv("ROS_DISTRO", raising=False)  # sets the type of cmd_vel, see test_nav2_parameters.py
        for name, value in ours.items():
            patch.setenv(name, value)
        yield number


@pytest.fixture(scope="module")
def context(domain: int) -> Iterator[None]:
    """`rclpy` initialised with its default context, for nodes inside this process."""
    with ros(domain):
        yield


@pytest.fixture(scope="module")
def client_node(context: None) -> Iterator[Client]:  # noqa: ARG001 - a node needs it
    """A client node that spins in its own thread."""
    client = Client(f"test_client_{os.getpid()}")
    yield client
    client.end()


@pytest.fixture
def process(tmp_path: object) -> Iterator[Processes]:
    """Starts a console script when called with its name, `params` and `args`; all processes end with the test."""
    processes = Processes(tmp_path)  # type: ignore[arg-type]
    yield processes
    processes.end()


@pytest.fixture(scope="module")
def module_process(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Processes]:
    """As `process`, for the processes of a module."""
    processes = Processes(tmp_path_factory.mktemp("processes"))
    yield processes
    processes.end()


@pytest.fixture(scope="module")
def lifecycle(client_node: Client) -> Callable[[str], Lifecycle]:
    """Makes a `Lifecycle` when called with a node's name."""
    return functools.partial(Lifecycle, client_node)


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_makereport() -> Iterator[None]:
    """Add the logs of the processes to the report of a failure."""
    outcome = yield
    report = outcome.get_result()  # type: ignore[attr-defined]
    if report.failed:
        for processes in Processes.everywhere:
            for one in processes.started:
                state = "running" if one.is_running else f"ended with {one.popen.returncode}"
                report.sections.append((f"{one.name} ({one.pid}, {state})", "\n".join(one.log().splitlines()[-LINES:])))
