"""Every snippet of README, documentation and examples runs unchanged."""

import importlib
import re
import runpy
import sys

import pytest

from optdock.deadline import budget_clock
from tests.docs.snippets import PAGES, ROOT, blocks_of, run_page

EXAMPLES = sorted((ROOT / "examples").glob("[0-9]*.py"))
# `sh` is run here; `bash` needs ROS, and its parts that need no robot run with the tests of the ROS 2 package.
LANGUAGES = {"python", "sh", "yaml", "toml", "text", "xml", "bash"}
WITH_ROS = {"ros2.md", "bags.md"}
RUN = [page for page in PAGES if any(block.language in {"python", "sh"} for block in blocks_of(page))]


@pytest.fixture(autouse=True)
def slow_clock():
    """The printed figures are those of a quiet machine; a busy one takes up to three times the CPU time."""
    with budget_clock("cpu", rate=0.25):
        yield


@pytest.fixture(autouse=True)
def in_a_folder_of_its_own(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    before = set(sys.modules)
    yield
    for name in set(sys.modules) - before:
        if str(tmp_path) in str(getattr(sys.modules[name], "__file__", "")):
            del sys.modules[name]
    importlib.invalidate_caches()


@pytest.mark.parametrize("page", RUN, ids=[page.stem for page in RUN])
def test_the_snippets_of_a_page_run(page, tmp_path):
    marked = sum(1 for block in blocks_of(page) if block.reason and block.language in {"python", "sh"})
    written = sum(1 for block in blocks_of(page) if block.title and block.language == "python")
    wanted = sum(1 for block in blocks_of(page) if block.language in {"python", "sh"})
    assert run_page(page, tmp_path) == wanted - marked - written


def test_every_block_says_what_it_is():
    assert {
        page.name: block.line for page in PAGES for block in blocks_of(page) if block.language not in LANGUAGES
    } == {}


def test_commands_that_need_ros_stand_on_the_pages_about_ros():
    pages = {page.name for page in PAGES for block in blocks_of(page) if block.language in {"bash", "xml"}}
    assert pages == WITH_ROS


def test_few_blocks_are_not_run_and_each_says_why():
    marked = [(page.name, block.reason) for page in PAGES for block in blocks_of(page) if block.reason]
    assert len(marked) <= 2, marked
    assert all(len(reason) > 20 for _, reason in marked)


SHOWS = (
    "certified: ",
    "read back and proven again: True",
    "certified: ",
    "certified True",
    "of the new one",
    "certified: ",
    "docked after",
    "FailedToSmoothPath",
    "found by: ",
    "the proof holds: True",
    "at the true dock",
    "not proven",
)


@pytest.mark.parametrize(
    ("script", "shows"), list(zip(EXAMPLES, SHOWS, strict=True)), ids=[one.stem for one in EXAMPLES]
)
def test_an_example_runs_and_shows_what_it_promises(script, shows, capsys):
    runpy.run_path(str(script), run_name="__main__")
    assert shows in capsys.readouterr().out


def test_examples_are_numbered_short_and_say_what_they_are():
    assert [int(script.name[:2]) for script in EXAMPLES] == list(range(1, len(EXAMPLES) + 1))
    lengths = {script.name: len(script.read_text().splitlines()) for script in EXAMPLES}
    assert {name: lines for name, lines in lengths.items() if not 15 <= lines <= 40} == {}
    assert all(re.match(r'"""[A-Z].+\."""\n', script.read_text()) for script in EXAMPLES)
