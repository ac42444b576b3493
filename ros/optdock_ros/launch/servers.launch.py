"""The servers of optdock as replacements of Nav2's servers of the same names.

    ros2 launch optdock_ros servers.launch.py params_file:=/path/to/nav2_params.yaml namespace:=robot1

Set `autostart` to true only without a lifecycle manager. With one, as in a Nav2 bringup, list the servers in its
`node_names`. The parameter file is that of Nav2; in a namespace its nodes are moved into the namespace, as Nav2's
bringup does, except for those that are already in it and those whose names begin with / or *, such as `/**`.
"""

from __future__ import annotations

import atexit
import shutil
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import yaml
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterFile

if TYPE_CHECKING:
    from collections.abc import Mapping

    from launch import LaunchContext

CONFIG = Path(__file__).parents[1] / "config"
EXECUTABLES = {"simulated_robot": "simulated_robot", "smoother": "smoother_server", "docking": "docking_server"}
STARTED = {"smoother": "true", "docking": "true", "simulated_robot": "false"}
SWITCHES = ("use_sim_time", "autostart")
BOOLEANS = {"true": True, "1": True, "false": False, "0": False}  # as in conditions of `launch`


def generate_launch_description() -> LaunchDescription:
    """Return the arguments and the nodes of the servers."""
    arguments = {
        "params_file": (str(CONFIG / "optdock.yaml"), "parameters of all servers"),
        "namespace": ("", "namespace of the nodes and of their relative topics"),
        "use_sim_time": ("", "time from /clock; empty: as in the file"),
        "autostart": ("", "activate without a lifecycle manager; empty: as in the file"),
        "cmd_vel_topic": ("cmd_vel", "topic of the docking server's commands"),
        "remap_tf": ("true", "transforms in the namespace, as in Nav2's bringup; false: /tf of all robots"),
        "log_level": ("info", "debug, info, warn or error"),
        **{name: (started, f"start {EXECUTABLES[name]}") for name, started in STARTED.items()},
    }
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=description)
        for name, (default, description) in arguments.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=nodes)])


def nodes(context: LaunchContext) -> list[Node]:
    """Return the nodes for the values of the arguments."""
    given = context.launch_configurations
    namespace = absolute(given["namespace"], given.get("ros_namespace", ""))
    switches = {name: is_true(name, given[name]) for name in SWITCHES if given[name]}
    file = parameter_file(Path(given["params_file"]), namespace, switches)
    remappings = [("cmd_vel", given["cmd_vel_topic"])]
    if is_true("remap_tf", given["remap_tf"]):
        remappings += [("/tf", "tf"), ("/tf_static", "tf_static")]
    return [
        Node(
            package="optdock_ros",
            executable=executable,
            name=executable,
            namespace=namespace or "/",
            parameters=[file, switches] if switches and name != "simulated_robot" else [file],
            remappings=remappings,
            arguments=["--ros-args", "--log-level", given["log_level"]],
            output="screen",
        )
        for name, executable in EXECUTABLES.items()
        if is_true(name, given[name])
    ]


def is_true(name: str, value: str) -> bool:
    """Return the value of an argument as a boolean."""
    if value.lower() not in BOOLEANS:
        raise RuntimeError(f"{name}: must be true or false, got {value!r}")
    return BOOLEANS[value.lower()]


def absolute(namespace: str, pushed: str) -> str:
    """Return the absolute namespace of the nodes, empty for the root.

    Nav2's bringup both pushes its namespace (`PushROSNamespace`) and hands it on; it is then applied once.
    """
    own, outer = (f"/{path.strip('/')}".rstrip("/") for path in (namespace, pushed))
    return own if namespace.startswith("/") or not outer else outer if outer.endswith(own) else outer + own


def parameter_file(file: Path, namespace: str, switches: Mapping[str, bool]) -> ParameterFile:
    """Return a parameter file with the nodes in a namespace and with the values of switches.

    Substitutions in it, such as $(find-pkg-share name), are evaluated as in Nav2's bringup. A new file exists until the
    end of the launch.
    """
    text = file.read_text(encoding="utf-8")
    path = file
    if namespace or switches:
        folder = tempfile.mkdtemp(prefix="optdock_ros_")
        atexit.register(shutil.rmtree, folder, ignore_errors=True)
        path = Path(folder) / file.name
        path.write_text(rewritten(text, namespace, switches), encoding="utf-8")
    return ParameterFile(str(path), allow_substs="$(" in text)


def rewritten(text: str, namespace: str, switches: Mapping[str, bool]) -> str:
    """Return the text of a parameter file with the nodes in a namespace and with the values of switches.

    It is edited as YAML nodes, because Python's values of YAML are not those of ROS: `1e-9` is text in Python.
    """
    document = yaml.compose(text, yaml.SafeLoader)
    if not isinstance(document, yaml.MappingNode):
        raise RuntimeError("params_file: must be a mapping of node names")
    set_switches(document, switches)
    root = namespace.split("/")[1] if namespace else ""
    for key, _ in document.value:
        if root and key.value[:1] not in ("/", "*") and key.value.split("/")[0] != root:
            key.value = f"{namespace}/{key.value}"
    # Long lines, because a substitution must stay on one line.
    return yaml.serialize(document, Dumper=yaml.SafeDumper, allow_unicode=True, width=sys.maxsize)


def set_switches(block: yaml.MappingNode, switches: Mapping[str, bool]) -> None:
    """Replace the values of switches in all nodes of a parameter file."""
    for key, value in block.value:
        if key.value == "ros__parameters":
            value.value = [
                (name, yaml.ScalarNode("tag:yaml.org,2002:bool", str(switches[name.value]).lower()))
                if name.value in switches
                else (name, old)
                for name, old in value.value
            ]
        elif isinstance(value, yaml.MappingNode):
            set_switches(value, switches)
