"""The harness keeps its promises: no process is left, whatever ends the run."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import pytest
from harness import DOMAINS, Processes, free_domain

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


def inner_run(folder: Path, then: str) -> subprocess.Popen[str]:
    """A run of pytest with a process that has a child and ignores ctrl-C."""
    sleeper = folder / "sleeper"
    sleeper.write_text(SLEEPER.format(python=sys.executable))
    sleeper.chmod(0o755)
    (folder / "test_inner.py").write_text(textwrap.dedent(TEST.format(folder=str(folder), then=then)))
    (folder / "conftest.py").write_text("from conftest_of_ours import *\n\nProcesses.grace = 0.5\n")
    ours = Path(__file__).parent
    (folder / "conftest_of_ours.py").write_text((ours / "conftest.py").read_text())
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", f"--rootdir={folder}", str(folder)]
    env = {**os.environ, "PYTHONPATH": f"{folder}:{ours}"}
    return subprocess.Popen(
        command, env=env, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, start_new_session=True
    )


def pids(folder: Path) -> list[int]:
    """Of the process and its child, once they run."""
    end = time.monotonic() + 20.0
    while not (folder / "pids").exists() or len((folder / "pids").read_text().split()) < 2:
        assert time.monotonic() < end
        time.sleep(0.02)
    return [int(word) for word in (folder / "pids").read_text().split()]


def gone(pid: int) -> bool:
    """Whether a process has ended; a zombie has."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] == "Z"
    except FileNotFoundError:
        return True


@pytest.mark.parametrize("end", ["failure", "ctrl-C"])
def test_nothing_is_left_over_and_the_log_is_shown(tmp_path: Path, end: str) -> None:
    run = inner_run(tmp_path, "assert False" if end == "failure" else "time.sleep(60)")
    both = pids(tmp_path)
    if end == "ctrl-C":
        run.send_signal(signal.SIGINT)
    said, _ = run.communicate(timeout=30)
    assert run.returncode != 0
    assert all(gone(pid) for pid in both), said
    if end == "failure":
        assert f"ready {both[0]}" in said


def test_a_killed_run_takes_its_processes_with_it(tmp_path: Path) -> None:
    run = inner_run(tmp_path, "time.sleep(60)")
    child, process = pids(tmp_path)
    run.kill()
    run.communicate()
    end = time.monotonic() + 5.0
    while not gone(process):
        assert time.monotonic() < end
        time.sleep(0.02)
    os.kill(child, signal.SIGKILL)  # of a program that leaves its own children alone


def test_a_process_that_does_not_end_shows_where_it_stands(tmp_path: Path) -> None:
    stubborn = tmp_path / "stubborn"
    stubborn.write_text(
        SLEEPER.format(python=sys.executable).replace("child.wait()", "def here():\n    child.wait()\nhere()")
    )
    stubborn.chmod(0o755)
    processes = Processes(tmp_path)
    try:
        process = processes(str(stubborn))
        process.wait_for("ready")
        with pytest.raises(AssertionError, match="still ran"):
            process.stop(timeout=0.2)
        assert "in here" in process.log()
    finally:
        processes.end()


def test_two_runs_at_once_have_different_domains(domain: int) -> None:
    found = [free_domain() for _ in range(3)]
    numbers = [number for number, _ in found]
    for _, keeper in found:
        keeper.close()
    assert len({domain, *numbers}) == 4
    assert all(number in DOMAINS for number in numbers)


def test_parameters_reach_a_process_in_a_file(tmp_path: Path) -> None:
    processes = Processes(tmp_path)
    try:
        cat = processes("/bin/echo", params={"a": 1.0, "block": {"b": True}})
        cat.wait_for("--params-file")
        assert cat.stop() == 0
        assert "b: true" in Path(cat.log().split()[-1]).read_text()
    finally:
        processes.end()
