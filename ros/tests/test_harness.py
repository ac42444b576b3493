"""The harness leaves no process behind, however a run ends."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import textwrap
import threading
import time
from pathlib import Path
from typing import Any

import pytest
from harness import DOMAINS, Client, Processes, free_domain
from optdock_ros.navigator import answer_of
from rclpy.task import Future

TEST = """
    import sys, time
    from pathlib import Path

    def test_that_waits(process):
        sleeper = Path({folder!r}) / "sleeper"
        started = process(str(sleeper))
        started.wait_for("ready")
        (Path({folder!r}) / "pids").write_text(started.log().split()[1] + " " + str(started.pid))
        {then}
"""
SLEEPER = """#!{python}
import signal, subprocess, sys
signal.signal(signal.SIGINT, signal.SIG_IGN)
child = subprocess.Popen(["sleep", "300"])
print("ready", child.pid, flush=True)
child.wait()
"""
# A shell without job control lets the programs in its background ignore ctrl-C, and their children inherit this.
PYTEST = "import signal, sys, pytest; signal.signal(signal.SIGINT, signal.default_int_handler); sys.exit(pytest.main())"


def inner_run(folder: Path, then: str) -> tuple[subprocess.Popen[str], list[int]]:
    """Start a pytest run with a process that ignores ctrl-C and has a child; return also both process ids."""
    sleeper, pids, ours = folder / "sleeper", folder / "pids", Path(__file__).parent
    sleeper.write_text(SLEEPER.format(python=sys.executable))
    sleeper.chmod(0o755)
    (folder / "test_inner.py").write_text(textwrap.dedent(TEST.format(folder=str(folder), then=then)))
    (folder / "conftest.py").write_text("from conftest_of_ours import *\n\nProcesses.grace = 0.5\n")
    (folder / "conftest_of_ours.py").write_text((ours / "conftest.py").read_text())
    command = [sys.executable, "-c", PYTEST, "-q", "-p", "no:cacheprovider", f"--rootdir={folder}", str(folder)]
    env = {**os.environ, "PYTHONPATH": f"{folder}:{ours}"}
    run = subprocess.Popen(
        command, env=env, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, start_new_session=True
    )
    end = time.monotonic() + 20.0
    while not pids.exists() or len(pids.read_text().split()) < 2:
        assert time.monotonic() < end
        time.sleep(0.02)
    return run, [int(word) for word in pids.read_text().split()]


def gone(pid: int) -> bool:
    """Whether a process has ended; a zombie has."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] == "Z"
    except FileNotFoundError:
        return True


@pytest.mark.parametrize("end", ["failure", "ctrl-C"])
def test_no_process_is_left_and_the_log_is_shown(tmp_path: Path, end: str) -> None:
    run, both = inner_run(tmp_path, "assert False" if end == "failure" else "time.sleep(60)")
    if end == "ctrl-C":
        run.send_signal(signal.SIGINT)
    output, _ = run.communicate(timeout=30)
    assert run.returncode != 0
    assert all(gone(pid) for pid in both), output
    if end == "failure":
        assert f"ready {both[0]}" in output


def test_a_killed_run_ends_its_processes(tmp_path: Path) -> None:
    run, (child, process) = inner_run(tmp_path, "time.sleep(60)")
    run.kill()
    run.communicate()
    end = time.monotonic() + 5.0
    while not gone(process):
        assert time.monotonic() < end
        time.sleep(0.02)
    os.kill(child, signal.SIGKILL)  # of a program that does not end its own children


def test_two_runs_have_different_domains_and_parameters_are_passed_in_a_file(domain: int, tmp_path: Path) -> None:
    found = [free_domain() for _ in range(3)]
    for _, keeper in found:
        keeper.close()
    numbers = [number for number, _ in found]
    assert len({domain, *numbers}) == 4
    assert all(number in DOMAINS for number in numbers)
    processes = Processes(tmp_path)
    try:
        cat = processes("/bin/echo", params={"a": 1.0, "block": {"b": True}})
        cat.wait_for("--params-file")
        assert cat.stop() == 0
        assert "b: true" in Path(cat.log().split()[-1]).read_text()
    finally:
        processes.end()


def test_calls_of_action_clients_are_made_by_the_thread_of_the_executor(client_node: Client) -> None:
    callers = []

    def ask() -> Future[Any]:
        callers.append(threading.current_thread())
        answer: Future[Any] = Future()
        answer.set_result("answer")
        return answer

    assert client_node.wait(answer_of(client_node, ask)) == "answer"
    assert callers == [client_node._own_thread]
