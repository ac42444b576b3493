"""Parameter files in namespaces: their blocks, the rewriting at launch, and servers whose parameters are missing."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from harness import Client, Lifecycle, Processes
from launch_stand_in import PACKAGE, Started, launched
from optdock_ros.parameter_files import blocks_of, missing_parameters
from rclpy.node import Node

from optdock.nav2.declared_parameters import Block, names_of

SMOOTHERS = "smoother_server: {ros__parameters: {smoother_plugins: [a, b], a: {tolerance: 1e-9}, b: {plugin: '1e-9'}}}"


def missing(tmp_path: Path, text: str, node: str = "/robot1/smoother_server") -> tuple[str, bool]:
    file = tmp_path / "params.yaml"
    file.write_text(text)
    blocks = blocks_of(["--ros-args", "--params-file", str(file)])
    return missing_parameters(blocks, node, {"smoother_plugins"}, {*names_of(Block.ANY_NODE), "autostart"})


@pytest.mark.parametrize(
    "text",
    [
        "robot1: {smoother_server: {ros__parameters: {a: 1}}}",
        "/robot1/smoother_server: {ros__parameters: {a: 1}}",
        "robot1/smoother_server: {ros__parameters: {a: 1}}",
        "/**/smoother_server: {ros__parameters: {a: 1}}",
        "/*/smoother_server: {ros__parameters: {a: 1}}",
        "/**: {ros__parameters: {smoother_plugins: [a]}}",
        "/robot1/*: {ros__parameters: {smoother_plugins: [a]}}",
        "{smoother_server: {ros__parameters: {a: 1}}, /**: {ros__parameters: {smoother_plugins: [a]}}}",
        "/**: {ros__parameters: {use_sim_time: true}}",  # nothing that could be missing
        "",
    ],
)
def test_parameters_of_the_node_are_found(tmp_path: Path, text: str) -> None:
    assert missing(tmp_path, text) == ("", False)


@pytest.mark.parametrize(
    ("text", "known"),
    [
        (SMOOTHERS, "/smoother_server"),
        (f"{SMOOTHERS}\n/**: {{ros__parameters: {{use_sim_time: true, other: 1}}}}", "/smoother_server"),
        (f"{SMOOTHERS}\n/robot1/smoother_server: {{ros__parameters: {{autostart: true}}}}", "/smoother_server"),
        ("robot2: {smoother_server: {ros__parameters: {a: 1}}}", "/robot2/smoother_server"),
        ("/*/*/smoother_server: {ros__parameters: {a: 1}}", "/*/*/smoother_server"),
    ],
)
def test_parameters_in_another_namespace_are_named(tmp_path: Path, text: str, known: str) -> None:
    why, is_elsewhere = missing(tmp_path, text)
    assert is_elsewhere
    assert why == f"{tmp_path}/params.yaml: has no parameters of /robot1/smoother_server, but of {known}"


def test_nodes_of_a_file_without_the_server_are_listed(tmp_path: Path) -> None:
    text = "local_costmap: {local_costmap: {ros__parameters: {a: 1}}}\nbt_navigator: {ros__parameters: {a: 1}}"
    why, is_elsewhere = missing(tmp_path, text)
    assert not is_elsewhere
    assert why.endswith("but of /bt_navigator, /local_costmap/local_costmap")


def parameters_of(started: Started) -> tuple[str, dict[str, object]]:
    """Return the full name and the parameters of a node with the command line of a process."""
    node = Node(
        started.executable,
        cli_args=list(started.arguments),
        use_global_arguments=False,
        automatically_declare_parameters_from_overrides=True,
    )
    found = {name: parameter.value for name, parameter in node.get_parameters_by_prefix("").items()}
    name = node.get_fully_qualified_name()
    node.destroy_node()
    return name, found


PLAIN = """
smoother_server:
  ros__parameters:
    use_sim_time: true
    smoother_plugins: [certified, simple]
    certified: {plugin: CasadiSmoother, max_curvature: 1.5}
    simple: {plugin: "nav2_smoother::SimpleSmoother", tolerance: 1e-9, w_data: .25}
"""


@pytest.mark.parametrize(
    ("text", "arguments", "node"),
    [
        (PLAIN, {}, "/smoother_server"),
        (PLAIN, {"namespace": "robot1"}, "/robot1/smoother_server"),
        (PLAIN, {"namespace": "/fleet/robot1/"}, "/fleet/robot1/smoother_server"),
        (PLAIN, {"namespace": "robot1", "ros_namespace": "/robot1"}, "/robot1/smoother_server"),
        (PLAIN, {"namespace": "robot1", "ros_namespace": "/fleet"}, "/fleet/robot1/smoother_server"),
        (PLAIN, {"ros_namespace": "/robot1"}, "/robot1/smoother_server"),
        (PLAIN.replace("smoother_server", "/**"), {"namespace": "robot1"}, "/robot1/smoother_server"),
        (PLAIN.replace("smoother_s", "/robot1/smoother_s"), {"namespace": "robot1"}, "/robot1/smoother_server"),
        (PLAIN.replace("smoother_s", "robot1/smoother_s"), {"namespace": "robot1"}, "/robot1/smoother_server"),
        ("robot1:" + PLAIN.replace("\n", "\n  "), {"namespace": "robot1"}, "/robot1/smoother_server"),
    ],
)  # fmt: skip
@pytest.mark.usefixtures("context")
def test_parameters_arrive_in_the_namespace(tmp_path: Path, text: str, arguments: dict[str, str], node: str) -> None:
    file = tmp_path / "nav2_params.yaml"
    file.write_text(text)
    (started,) = launched("servers.launch.py", tmp_path, params_file=str(file), docking="false", **arguments)
    name, found = parameters_of(started)
    assert name == node
    assert found["smoother_plugins"] == ["certified", "simple"]
    assert (found["simple.tolerance"], found["simple.w_data"], found["certified.max_curvature"]) == (1e-9, 0.25, 1.5)
    assert found["use_sim_time"] is True


@pytest.mark.usefixtures("context")
@pytest.mark.parametrize("namespace", ["", "robot1"])
@pytest.mark.parametrize("given", ["true", "False", ""])
def test_argument_overrides_the_switch_of_the_file(tmp_path: Path, given: str, namespace: str) -> None:
    file = tmp_path / "nav2_params.yaml"
    switch = "{ros__parameters: {use_sim_time: true, autostart: false}}"
    file.write_text(f"smoother_server: {switch}\n/**: {switch}\n")
    arguments = {"params_file": str(file), "use_sim_time": given, "autostart": "1", "namespace": namespace}
    (started,) = launched("servers.launch.py", tmp_path, docking="false", **arguments)
    _, found = parameters_of(started)
    assert (found["use_sim_time"], found["autostart"]) == (given != "False", True)


def test_files_of_a_launch_are_removed_at_its_end(tmp_path: Path) -> None:
    """In a process of its own, because they are removed when it ends."""
    code = f"""
import sys
from pathlib import Path
sys.path.insert(0, {str(Path(__file__).parent)!r})
from launch_stand_in import launched
found = launched("servers.launch.py", Path({str(tmp_path)!r}), namespace="robot1")
files = [one.arguments[one.arguments.index("--params-file") + 1] for one in found]
assert all(Path(file).is_file() for file in files)
print("\\n".join(files))
"""
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert len(ended.stdout.split()) == 2
    assert not any(Path(file).parent.exists() for file in ended.stdout.split())


@pytest.mark.parametrize(
    ("arguments", "named"),
    [({"namespace": "robot1", "autostart": "perhaps"}, "autostart"), ({"remap_tf": ""}, "remap_tf")],
)
def test_argument_that_is_no_boolean_is_an_error(tmp_path: Path, arguments: dict[str, str], named: str) -> None:
    with pytest.raises(RuntimeError, match=f"{named}: must be true or false"):
        launched("servers.launch.py", tmp_path, **arguments)


@pytest.mark.parametrize("executable", ["smoother_server", "docking_server"])
def test_server_without_its_parameters_is_not_configured(
    process: Processes, client_node: Client, executable: str
) -> None:
    """Without the launch file nothing moves the blocks into the namespace."""
    server = process(executable, params=PACKAGE / "config" / "optdock.yaml", args=["-r", "__ns:=/robot1"])
    assert not Lifecycle(client_node, f"/robot1/{executable}").configure()
    assert f"optdock.yaml: has no parameters of /robot1/{executable}, but of /{executable};" in server.log()


def test_server_that_is_not_in_the_file_warns(process: Processes, client_node: Client, tmp_path: Path) -> None:
    file = tmp_path / "nav2_params.yaml"
    file.write_text("bt_navigator: {ros__parameters: {robot_base_frame: base_link}}")
    server = process("smoother_server", params=file)
    assert Lifecycle(client_node, "/smoother_server").configure()
    assert "nav2_params.yaml: has no parameters of /smoother_server, but of /bt_navigator; all" in server.log()
    assert "smoother_plugins: is not set; the only smoother is nav2_smoother::SimpleSmoother" in server.log()
