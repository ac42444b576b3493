"""Every entry point and every name of the front door is used by a snippet, an example, an experiment or a server."""

import re
from importlib.metadata import entry_points
from pathlib import Path

import pytest

import optdock
from optdock.plugins.registry import INTERFACES

ROOT = Path(__file__).parents[2]
FENCES = re.compile(r"^```(?:python|sh|yaml)[^\n]*\n(.*?)^```", re.MULTILINE | re.DOTALL)
PLUGINS = sorted(entry.name for kind in INTERFACES for entry in entry_points(group=f"optdock.{kind}"))


def what_runs():
    """Return the text of snippets, examples, experiments and servers, and the defaults of commands and calls."""
    for page in (*(ROOT / "docs").rglob("*.md"), ROOT / "README.md"):
        yield from FENCES.findall(page.read_text(encoding="utf-8"))
    for folder, pattern in (
        ("examples", "*.py"),
        ("examples", "*.yaml"),
        ("experiments", "*.py"),
        ("ros/optdock_ros", "*.py"),
    ):
        yield from (path.read_text(encoding="utf-8") for path in (ROOT / folder).rglob(pattern) if path.is_file())
    defaults = re.compile(r"^(?:DEFAULT\w*|PLAIN_TIMING)[^\n]* = .*$", re.MULTILINE)
    for path in (ROOT / "optdock").rglob("*.py"):
        yield from defaults.findall(path.read_text(encoding="utf-8"))


RUN = "\n".join(what_runs())


@pytest.mark.parametrize("name", PLUGINS)
def test_every_entry_point_is_run_somewhere(name):
    assert re.search(rf"\b{name}\b", RUN)


@pytest.mark.parametrize("name", sorted(optdock.__all__))
def test_every_name_of_the_front_door_is_used_somewhere(name):
    assert re.search(rf"\b{name}\b", RUN)


def test_unused_name_is_found():
    assert len(PLUGINS) >= 17
    assert not re.search(r"\bGracefulController\b", RUN)
