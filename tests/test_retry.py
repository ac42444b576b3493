"""What decides whether a failed test may be tried again: few of them, once, by name."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
FLAKY = """
import pathlib
def test_{name}():
    seen = pathlib.Path(__file__).with_suffix(".{name}")
    if not seen.exists():
        seen.touch()
        raise AssertionError
"""


_ENDS = re.compile(r"^\d+ \w+.* in \d", re.MULTILINE)


def retried(folder, source, most=2):
    """Exit status, output, and how often pytest has run, for a file of tests."""
    (folder / "test_it.py").write_text(source)
    script, arguments = ROOT / ".ci" / "retry.py", ["-q", "--rootdir", ".", "test_it.py"]
    command = [sys.executable, str(script), "--most", str(most), "--", *arguments]
    environment = {**os.environ, "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}  # without them it starts in half the time
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    return done.returncode, done.stdout, len(_ENDS.findall(done.stdout))


@pytest.mark.parametrize(
    ("source", "status", "runs", "said"),
    [
        ("def test_a(): pass", 0, 1, ""),
        (FLAKY.format(name="a") + FLAKY.format(name="b"), 0, 2, "and passed: test_it.py::test_a, test_it.py::test_b"),
        (FLAKY.format(name="a") + "def test_b(): assert False", 1, 2, "and failed again, some or all"),
        ("".join(FLAKY.format(name=n) for n in "abc"), 1, 1, "3 tests failed, at most 2 may be tried again: none is"),
        ("import nothing_of_this_name", 2, 1, ""),
    ],
    ids=["passes", "flaky", "fails", "too many", "cannot be collected"],
)
def test_few_failures_are_tried_again_and_named(tmp_path, source, status, runs, said):
    code, out, count = retried(tmp_path, source)
    assert (code, count) == (status, runs), out
    assert said in out
    assert ("tried again" in out) == (bool(said))


def test_what_failed_in_an_earlier_run_does_not_count(tmp_path):
    retried(tmp_path, "def test_old(): assert False")
    assert retried(tmp_path, FLAKY.format(name="a"), most=1)[0] == 0
