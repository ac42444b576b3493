"""Logs: equality after reading, errors with file and line, logs of crashed programs."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from optdock.cli import app
from optdock.errors import InvalidFile
from optdock.executor import ExecutorSettings
from optdock.executor.log import LogWriter, read_log
from optdock.executor.replay import replay
from optdock.geometry.pose import Pose2
from optdock.model.costmap import Costmap

from .conftest import NOISY, SLUGGISH, problem_with, run, simulated


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """The log of a docking with a retry, a costmap and a cancel; and what happened."""
    path = tmp_path_factory.mktemp("log") / "docking.log"
    free = Costmap(np.zeros((20, 30), dtype=np.uint8), 0.2, (-3.0, -2.0))

    def before(executor, world, measurements):
        if 1.0 < world.time < 1.03:
            return measurements._replace(costmap=free)
        if world.time > 4.0:
            executor.cancel()
        return None

    obstacles = [[[-1.0, 1.0], [0.0, 1.0], [0.0, 1.1]]]
    with LogWriter(path) as log:
        world = simulated(Pose2(-0.9, 0.1, 0.1), NOISY, SLUGGISH, seed=4)
        settings = ExecutorSettings(least_detections=2)
        docking = run(world, problem_with(Pose2(0.05, 0.03, 0.04), obstacles), settings, log=log, before=before)
    return path, docking


def test_everything_reads_back(written):
    path, docking = written
    found = read_log(path)
    assert not found.cut_off
    assert found.task.problem.fingerprint == docking.executor.problem.fingerprint
    assert found.task.problem.dock.tolerances == docking.executor.problem.dock.tolerances
    assert found.task.settings == docking.executor.settings
    assert [cycle.command for cycle in found.cycles] == [step.command for step in docking.steps]
    assert [event for cycle in found.cycles for event in cycle.events] == docking.events
    assert found.cycles[-1].ending == docking.ending
    assert replay(found).differs_at is None


def test_another_command_is_found(written, tmp_path):
    lines = written[0].read_text().splitlines()
    at = next(i for i, line in enumerate(lines[1:], start=1) if json.loads(line).get("command", [0.0])[0] > 0.1)
    value = json.loads(lines[at])
    value["command"][0] = float(np.nextafter(value["command"][0], 1.0))
    lines[at] = json.dumps(value)
    changed = tmp_path / "changed.log"
    changed.write_text("\n".join(lines) + "\n")
    differs = replay(read_log(changed)).differs_at
    assert differs is not None
    assert differs.line == at + 1
    result = CliRunner().invoke(app, ["replay", str(changed)])
    assert result.exit_code == 3
    assert f"changed.log:{at + 1}: the command is" in result.output


def test_command_line(written, tmp_path):
    result = CliRunner().invoke(app, ["replay", str(written[0]), "--plot", str(tmp_path / "docking.png")])
    assert result.exit_code == 0, result.output
    for said in ("ending", "cancelled", "bit for bit", "largest deviation", "plan new"):
        assert said in result.output
    assert (tmp_path / "docking.png").stat().st_size > 1000


def test_crash_leaves_a_log(written, tmp_path):
    text = written[0].read_text()
    crashed = tmp_path / "crashed.log"
    crashed.write_text(text[: len(text) // 2])
    found = read_log(crashed)
    assert found.cut_off
    assert found.cycles[-1].ending is None
    assert replay(found).differs_at is None
    assert "truncated" in CliRunner().invoke(app, ["replay", str(crashed)]).output


def damaged(lines, line, text):
    return "\n".join([*lines[: line - 1], text, *lines[line:]]) + "\n"


ASLEEP = '{"stamp": 1.0, "pose": null, "twist": [0, 0, 0], "command": [0, 0], "state": "asleep"}'


@pytest.mark.parametrize(
    ("line", "text", "message"),
    [
        (1, "{}", ":1: is damaged: format: Field required"),
        (1, "no json", ":1: is damaged: Invalid JSON"),
        (1, '{"problem": {"a": [' + "1," * 300_000 + "1]}}", ":1: is damaged: holds more than 300000 values"),
        (5, '{"planned": [' + "[]," * 300_000 + "1]}", ":5: is damaged: holds more than 300000 values"),
        (5, '{"stamp": 1.0', ":5: is damaged: Invalid JSON"),
        (5, '{"cancel": false}', ":5: is damaged: .*"),
        (7, ASLEEP, ":7: is damaged: 'asleep' is not a valid State"),
    ],
)
def test_damage_is_named(written, tmp_path, line, text, message):
    broken = tmp_path / "broken.log"
    broken.write_text(damaged(written[0].read_text().splitlines(), line, text))
    with pytest.raises(InvalidFile, match=message) as error:
        read_log(broken)
    assert str(broken) in str(error.value)


def test_another_problem_is_refused(written, tmp_path):
    lines = written[0].read_text().splitlines()
    value = json.loads(lines[0])
    value["problem"]["dock"]["pose"][0] += 0.1
    broken = tmp_path / "other.log"
    broken.write_text(damaged(lines, 1, json.dumps(value)))
    with pytest.raises(InvalidFile, match="other.log:1: is damaged: problem: differs from the logged one: .*dock"):
        read_log(broken)


def test_full_disk_stops_no_robot(tmp_path, monkeypatch, lawful):
    log = LogWriter(tmp_path / "full.log")

    def full(text):
        raise OSError(28, "No space left on device")

    def before(executor, world, measurements):
        if world.time > 0.5 and log._file is not None:
            monkeypatch.setattr(log._file, "write", full)

    docking = run(simulated(Pose2(-0.6, 0.0, 0.0)), problem_with(), log=log, before=before)
    assert lawful(docking).kind.succeeded
    assert [event.detail for event in docking.said("log failed")] == [log.failure]
    assert "No space left" in log.failure


def test_files_that_are_none(tmp_path):
    with pytest.raises(InvalidFile, match="cannot be read"):
        read_log(tmp_path / "none.log")
    (tmp_path / "empty.log").write_text("")
    with pytest.raises(InvalidFile, match="no complete line"):
        read_log(tmp_path / "empty.log")
    with pytest.raises(InvalidFile, match="cannot be written"):
        LogWriter(tmp_path)
