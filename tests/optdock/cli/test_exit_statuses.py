"""Every end of a command has one status, and the help and the reference say what it means."""

import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

from optdock import errors
from optdock.cli import app
from optdock.cli.exit_status import _STATUSES, EXIT_STATUSES, ExitStatus, status_of
from optdock.cli.importing import app as importing

ROOT = Path(__file__).resolve().parents[3]


def subclasses(cls):
    return [cls, *(found for inner in cls.__subclasses__() for found in subclasses(inner))]


def test_every_error_has_exactly_one_status():
    """Rows of the table that both know an error must agree, but for the last one, which knows all."""
    *rows, (base, _) = _STATUSES
    assert base is errors.OptdockError
    ours = [one for one in subclasses(errors.OptdockError) if one.__module__.partition(".")[0] == "optdock"]
    assert len(ours) > 30
    for error in ours:
        assert len({status for known, status in rows if issubclass(error, known)}) <= 1, error
        assert status_of(error) in EXIT_STATUSES


@pytest.mark.parametrize(
    ("error", "status"),
    [
        ("InvalidFile", 2),
        ("DockNotInDB", 2),
        ("InvalidMessage", 2),
        ("PluginError", 2),
        ("MissingExtra", 2),
        ("FailedToSmoothPath", 3),
        ("GoalOccupied", 3),
        ("CertificationFailed", 3),
        ("Cancelled", 3),
        ("NoMotionExists", 4),
        ("PlannerTimedOut", 5),
        ("SmootherTimedOut", 5),
        ("TimingTimedOut", 5),
    ],
)
def test_what_a_script_may_rely_on(error, status):
    assert status_of(getattr(errors, error)) == status


def test_the_table_is_whole():
    assert set(EXIT_STATUSES) == set(ExitStatus)
    assert [int(status) for status in ExitStatus] == [0, 1, 2, 3, 4, 5]
    assert {status for _, status in _STATUSES} | {ExitStatus.CERTIFIED, ExitStatus.UNEXPECTED} == set(ExitStatus)


def test_the_help_says_what_every_status_means():
    words = " ".join(CliRunner().invoke(app, ["--help"], env={"COLUMNS": "2000"}).stdout.split())
    for status, meaning in EXIT_STATUSES.items():
        assert f"{status:d} {meaning}" in words


def test_no_command_has_a_status_of_its_own():
    """A number in a `typer.Exit` would be a meaning that the table does not know."""
    found = []
    for source in (ROOT / "optdock" / "cli").glob("*.py"):
        for given in re.findall(r"typer\.Exit\((.*?)\)", source.read_text()):
            found.append(given)
            assert given in {"status", "ended"} or given.startswith("ExitStatus."), (source.name, given)
    assert len(found) > 5


COMMANDS = [*(command.callback.__name__ for command in app.registered_commands)]
IMPORTS = [f"import {command.callback.__name__}" for command in importing.registered_commands]
ARGUMENTS = {
    "compare": ["{}"],
    "certify": ["{}", "{}"],
    "bag": ["{}", "out.mcap"],
    "import tpcap": ["{}", "-o", "out.yaml"],
    "import obca": ["{}", "--scene", "parallel", "-o", "out.yaml"],
    "import nav2": ["--nav2-params", "{}", "--map", "{}", "--start", "0,0,0", "-o", "out.yaml"],
    "import bag": ["{}", "-o", "out"],
    "plugins": ["--nav2-params", "{}"],
}


@pytest.mark.parametrize("command", [name for name in (*COMMANDS, *IMPORTS) if name not in ("demo", "schema")])
def test_every_command_that_reads_ends_with_2_for_a_file_that_cannot_be_read(tmp_path, monkeypatch, command):
    monkeypatch.chdir(tmp_path)
    arguments = [part.format("none") for part in ARGUMENTS.get(command, ["{}"])]
    result = CliRunner().invoke(app, [*command.split(), *arguments])
    assert result.exit_code == ExitStatus.BAD_INPUT, result.output
    assert "none: cannot be read: No such file or directory" in result.stderr


def test_writing_where_nothing_can_be_written_is_bad_input(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("file").write_text("")
    assert CliRunner().invoke(app, ["schema", "--out", "file/schema.json"]).exit_code == ExitStatus.BAD_INPUT
