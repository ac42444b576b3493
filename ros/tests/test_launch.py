"""The processes of the launch files, by a stand-in of `ros2 launch`, which cannot be installed from PyPI."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from launch_stand_in import PACKAGE, Started, launched

SERVERS = ["smoother_server", "docking_server"]


def options(started: Started, flag: str) -> list[str]:
    """Return the values of a repeated option."""
    return [value for key, value in zip(started.arguments, started.arguments[1:], strict=False) if key == flag]


def test_all_servers_with_the_default_file(tmp_path: Path) -> None:
    found = launched("servers.launch.py", tmp_path)
    assert [one.executable for one in found] == SERVERS
    for one in found:
        assert [Path(file) for file in options(one, "--params-file")] == [PACKAGE / "config" / "optdock.yaml"]
        assert {"__ns:=/", "cmd_vel:=cmd_vel"} <= {*options(one, "-r")}


def test_arguments_reach_the_nodes(tmp_path: Path) -> None:
    (docking,) = launched(
        "servers.launch.py",
        tmp_path,
        namespace="robot1",
        use_sim_time="true",
        autostart="True",
        smoother="false",
        cmd_vel_topic="cmd_vel_docking",
        log_level="debug",
    )
    assert docking.executable == "docking_server"
    values = yaml.safe_load(Path(options(docking, "--params-file")[1]).read_text())
    assert values == {"/robot1/docking_server": {"ros__parameters": {"use_sim_time": True, "autostart": True}}}
    names = {"__node:=docking_server", "__ns:=/robot1", "cmd_vel:=cmd_vel_docking", "/tf:=tf", "/tf_static:=tf_static"}
    assert {*options(docking, "-r")} == names
    assert options(docking, "--log-level") == ["debug"]


def test_transforms_of_all_robots(tmp_path: Path) -> None:
    found = launched("servers.launch.py", tmp_path, namespace="robot1", remap_tf="false")
    assert {*options(found[0], "-r")} == {"__node:=smoother_server", "__ns:=/robot1", "cmd_vel:=cmd_vel"}


def test_substitutions_in_the_file_are_evaluated(tmp_path: Path) -> None:
    """The stand-in evaluates none, and fails if they are not allowed for such a file."""
    file = tmp_path / "params.yaml"
    long = f"$(find-pkg-share my_robot)/{'a' * 100} $(env HOME)/docks.yaml"
    file.write_text(f"docking_server: {{ros__parameters: {{dock_database: {long}}}}}")
    (docking,) = launched("servers.launch.py", tmp_path, params_file=str(file), smoother="false", namespace="robot1")
    assert f"dock_database: {long}}}" in Path(options(docking, "--params-file")[0]).read_text()


def test_file_without_nodes_is_an_error(tmp_path: Path) -> None:
    file = tmp_path / "params.yaml"
    file.write_text("[a, b]")
    with pytest.raises(RuntimeError, match="params_file: must be a mapping"):
        launched("servers.launch.py", tmp_path, params_file=str(file), namespace="robot1")


def test_misspelt_argument_of_a_node_is_an_error(tmp_path: Path) -> None:
    broken = tmp_path / "broken.launch.py"
    text = (PACKAGE / "launch" / "servers.launch.py").read_text()
    broken.write_text(text.replace("executable=", "exec="))
    with pytest.raises(TypeError, match="exec"):
        launched(broken, tmp_path, params_file=str(PACKAGE / "config" / "optdock.yaml"))


def test_robot_and_server_in_the_simulated_world(tmp_path: Path) -> None:
    robot, server = launched("simulated_docking.launch.py", tmp_path, namespace="robot1")
    assert (robot.executable, server.executable) == ("simulated_robot", "docking_server")
    found = [yaml.safe_load(Path(options(one, "--params-file")[0]).read_text()) for one in (robot, server)]
    assert found[0] == found[1]
    assert set(found[0]) == {"/robot1/simulated_robot", "/robot1/docking_server"}
    assert len(options(robot, "--params-file")) == 1  # it has no parameter autostart
    assert "__ns:=/robot1" in options(robot, "-r")


@pytest.mark.parametrize(("given", "found"), [(None, "1"), ("2", "2")])
def test_linear_algebra_has_one_thread_unless_set(given: str | None, found: str) -> None:
    """The variable is set before NumPy is loaded."""
    code = "import sys, optdock_ros, os; assert 'numpy' not in sys.modules; print(os.environ['OMP_NUM_THREADS'])"
    env = {name: value for name, value in os.environ.items() if name != "OMP_NUM_THREADS"}
    env |= {} if given is None else {"OMP_NUM_THREADS": given}
    ended = subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True, check=True)
    assert ended.stdout.strip() == found


def test_everything_that_is_launched_is_installed() -> None:
    """Executables of the launch files are console scripts; launch and parameter files are data files."""
    setup = (PACKAGE / "setup.py").read_text()
    scripts = re.findall(r'"(\w+) = optdock_ros', setup)
    assert {*SERVERS, "simulated_robot"} == set(scripts)
    assert {path.suffix for path in (PACKAGE / "config").iterdir()} == {".yaml"}
    assert all(path.name.endswith(".launch.py") for path in (PACKAGE / "launch").glob("*.py"))
