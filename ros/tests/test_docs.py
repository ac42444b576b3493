"""The commands, files and tables of the ROS 2 pages, executed and compared with the nodes."""

from __future__ import annotations

import re
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
import yaml
from action_msgs.msg import GoalStatus
from diagnostic_msgs.msg import DiagnosticArray
from harness import Client, Lifecycle, Processes
from launch_stand_in import launched
from nav2_msgs.action import DockRobot, SmoothPath, UndockRobot
from optdock_ros import dock_plugins, docking_parameters, smoother_server
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter

from optdock import ros
from optdock.config.reference import _reference

if TYPE_CHECKING:
    from collections.abc import Iterator

ROOT = Path(__file__).parents[2]
HOWTO = (ROOT / "docs" / "howto" / "ros2.md").read_text(encoding="utf-8")
REFERENCE = (ROOT / "docs" / "reference" / "ros2.md").read_text(encoding="utf-8")
FENCE = re.compile(
    r"^```(?P<language>\w+)(?: title=\"(?P<title>[^\"]+)\")?\n(?P<body>.*?)^```$", re.MULTILINE | re.DOTALL
)
SPEED = 2.0  # of the simulated world, whose clock of its own waits for a busy machine


def section(page: str, title: str) -> str:
    """Return the text of a section."""
    level = re.search(rf"^(#+) {re.escape(title)}$", page, re.MULTILINE)
    assert level is not None, title
    following = re.search(rf"^#{{1,{len(level[1])}}} ", page[level.end() :], re.MULTILINE)
    return page[level.end() :][: following.start() if following else None]


def blocks(text: str, language: str) -> Iterator[tuple[str, str]]:
    """Return title and text of every code block of a language."""
    return ((found["title"] or "", found["body"]) for found in FENCE.finditer(text) if found["language"] == language)


def commands(text: str) -> list[list[str]]:
    """Return the words of the commands that begin with `ros2`, without `ros2`."""
    lines = (line for _, body in blocks(text, "bash") for line in body.splitlines())
    return [shlex.split(line)[1:] for line in lines if line.startswith("ros2 ")]


def file_of(title: str, folder: Path) -> Path:
    """Write a file of the page."""
    (body,) = (body for language in ("yaml", "python") for found, body in blocks(HOWTO, language) if found == title)
    path = folder / title
    path.write_text(body)
    return path


def message(kind: Any, text: str) -> Any:
    """Return a message with the fields of a YAML text."""
    made = kind()
    for name, value in (yaml.safe_load(text) or {}).items():
        setattr(made, name, value)
    return made


class Shell:
    """A stand-in of the command `ros2`."""

    def __init__(self, client: Client, process: Processes, folder: Path) -> None:
        self.client, self.process, self.folder = client, process, folder

    def __call__(self, words: list[str]) -> Any:
        """Run a command, without `ros2`."""
        words = [word for word in words if word not in {"--feedback", "--once"}]
        return getattr(self, "_".join(words[: 1 if words[0] in {"launch", "run"} else 2]))(*words[2:])

    def launch(self, file: str) -> None:
        """Start the processes of a launch file with a simulated clock."""
        for one in launched(file, self.folder):
            clock = ["-p", f"speed:={SPEED}"] if one.executable == "simulated_robot" else ["-p", "use_sim_time:=true"]
            self.process(one.executable, args=(*one.arguments, "--ros-args", *clock))
        self.topic_echo("/odom")  # a person is slower than a process

    def run(self, executable: str, *arguments: str) -> Any:
        """Start one process."""
        return self.process(executable, args=[str(self.folder / w) if w.endswith(".yaml") else w for w in arguments])

    def action_send_goal(self, name: str, kind: str, goal: str) -> Any:
        """Send a goal, and return its result."""
        found = ros.imported(kind)
        return self.client.send(found, name, message(found.Goal, goal)).reply(60.0)

    def topic_echo(self, topic: str) -> Any:
        """Return the next message."""
        kinds = self.client.until(
            lambda: dict(self.client.get_topic_names_and_types()).get(topic), what=f"the topic {topic}"
        )
        heard = self.client.heard(ros.imported(kinds[0]), topic)
        return self.client.until(lambda: heard, what=topic)[0]

    def service_call(self, name: str, kind: str) -> Any:
        """Call a service with an empty request."""
        return self.client.call(ros.imported(kind), name)

    def param_set(self, node: str, name: str, value: str) -> Any:
        """Set a parameter."""
        request = SetParameters.Request(parameters=[Parameter(name, value=yaml.safe_load(value)).to_parameter_msg()])
        return self.client.call(SetParameters, f"{node}/set_parameters", request).results[0]


def test_the_simulated_docking_of_the_page(client_node: Client, process: Processes, tmp_path: Path) -> None:
    shell = Shell(client_node, process, tmp_path)
    launch, dock, echo, undock, reset, fault = commands(section(HOWTO, "Try it without a robot"))
    shell(launch)
    docked = shell(dock)
    assert (docked.status, docked.result.error_code) == (GoalStatus.STATUS_SUCCEEDED, 0), docked.result
    report = shell(echo)
    assert isinstance(report, DiagnosticArray)
    told = {item.key: item.value for item in report.status[0].values}
    assert max(abs(float(told[name])) for name in ("along", "cross", "yaw")) < 0.01
    undocked = shell(undock)
    assert undocked.status == GoalStatus.STATUS_SUCCEEDED, undocked.result
    assert shell(reset).success
    assert shell(fault).successful


def test_the_file_of_the_page_starts_both_servers(client_node: Client, process: Processes, tmp_path: Path) -> None:
    file = file_of("nav2_params.yaml", tmp_path)
    for name, parameters in yaml.safe_load(file.read_text()).items():
        server = process(name, params=file)
        Lifecycle(client_node, name).up()
        assert "ERROR" not in server.log()
        assert topics_of(client_node, name, parameters["ros__parameters"]) - told_topics(name) == set()


# Every node has these.
OF_RCLPY = re.compile(
    r"/rosout|/parameter_events|/_action/|transition_event|/\w+_server/(get|set|list|describe|change)_"
)


def topics_of(client: Client, node: str, parameters: dict[str, Any]) -> set[str]:
    """Return the topics and services of a node; a topic that a parameter names has the name of the parameter."""
    asks = (
        client.get_publisher_names_and_types_by_node,
        client.get_subscriber_names_and_types_by_node,
        client.get_service_names_and_types_by_node,
    )
    found = {name for ask in asks for name, _ in client.until(lambda ask=ask: ask(node, "/"), what="topics")}  # type: ignore[misc]
    names = {name.removeprefix("/").removesuffix("_updates") for name in found if not OF_RCLPY.search(name)}
    assert len(names) > 4
    controller = {f"controller.{key}": value for key, value in parameters.get("controller", {}).items()}
    spoken = {value: key for key, value in {**parameters, **controller}.items() if key.endswith("_topic")}
    spoken |= {"global_costmap/costmap_raw": "costmap_topic"} if node == "smoother_server" else {"odom": "odom_topic"}
    spoken |= {"global_costmap/published_footprint": "footprint_topic"} if node == "smoother_server" else {}
    return {spoken.get(name, name.replace(f"{node}/", "~/")) for name in names}


def told_topics(node: str) -> set[str]:
    """Return the names in the first column of a section's tables."""
    rows = re.findall(r"^\| ([^|]+) \|", section(REFERENCE, node), re.MULTILINE)
    bond = {"bond"}  # told of all servers
    return bond | {name.removeprefix("/") for row in rows for name in re.findall(r"`([^`]+)`", row)}


def test_server_in_addition_to_nav2(client_node: Client, process: Processes, tmp_path: Path) -> None:
    file_of("beside.yaml", tmp_path)
    (run,) = (words for words in commands(HOWTO) if words[0] == "run" and words[1] == "optdock_ros")
    Shell(client_node, process, tmp_path)(run)
    goal = SmoothPath.Goal(smoother_id="certified")
    reply = client_node.send(SmoothPath, "optdock/smooth_path", goal).reply()
    assert reply.result.error_code == SmoothPath.Result.INVALID_PATH  # it has no poses; the smoother is known
    assert 'server_name="optdock/smooth_path"' in HOWTO


def test_server_in_a_namespace(client_node: Client, process: Processes, tmp_path: Path) -> None:
    """With the launch file the page's parameters arrive; without it the server says that they are missing."""
    text = section(HOWTO, "Several robots")
    (words,) = commands(text)
    arguments = dict(word.split(":=") for word in words[3:])
    file = file_of("nav2_params.yaml", tmp_path)
    (started,) = launched(words[2], tmp_path, **arguments | {"params_file": str(file)})
    server = process(started.executable, args=started.arguments)
    assert Lifecycle(client_node, "robot1/smoother_server").configure()
    assert "Created smoother: certified of type CasadiSmoother" in server.log()
    plain = process("docking_server", params=file, args=["-r", "__ns:=/robot1"])
    assert not Lifecycle(client_node, "robot1/docking_server").configure()
    ((_, told),) = blocks(text, "text")
    assert told.strip() in plain.log().replace(f"{tmp_path}/", "")


def test_the_launch_file_of_the_page(tmp_path: Path) -> None:
    """The argument `autostart` of the including launch file is that of the lifecycle manager."""
    nav2 = tmp_path / "params.yaml"
    nav2.write_text("docking_server: {ros__parameters: {use_sim_time: true}}")
    page = file_of("servers_of_optdock.launch.py", tmp_path)
    page.write_text(page.read_text().replace("/path/to/nav2_params.yaml", str(nav2)))
    started = launched(page, tmp_path, autostart="true", namespace="robot1")
    assert [one.executable for one in started] == ["smoother_server", "docking_server"]
    for one in started:
        (values,) = yaml.safe_load(Path(one.arguments[one.arguments.index("-r") :][7]).read_text()).values()
        assert values == {"ros__parameters": {"autostart": False}}


@pytest.mark.parametrize(
    ("model", "module"),
    [
        (docking_parameters.DockingParameters, "docking_parameters"),
        (docking_parameters.ControllerParameters, "docking_parameters"),
        (docking_parameters.DockParameters, "docking_parameters"),
        (dock_plugins.SimpleChargingDockParameters, "dock_plugins"),
        (smoother_server.SmootherServerParameters, "smoother_server"),
    ],
)
def test_tables_are_generated_from_the_models(model: Any, module: str) -> None:
    """The pages are generated from the source without rclpy; the models themselves are compared here."""
    sys.path.insert(0, str(ROOT / "docs" / "tools"))
    import generated

    sys.path.pop(0)
    assert _reference(generated.ros_models(module)[model.__name__]) == _reference(model)
    assert f"<!-- made: ros {module}.{model.__name__} -->" in REFERENCE


def codes(text: str) -> set[int]:
    """Return the codes in the first column of a section's tables."""
    return {int(code) for row in re.findall(r"^\| (\d+(?:, \d+)*) \|", text, re.MULTILINE) for code in row.split(", ")}


@pytest.mark.parametrize(
    ("action", "where"),
    [(SmoothPath, "smoother_server"), (DockRobot, "docking_server"),
     (UndockRobot, "docking_server")],
)  # fmt: skip
def test_every_code_of_an_action_is_explained(action: Any, where: str) -> None:
    names = [name for name in vars(type(action.Result)) | vars(action.Result) if name.isupper()]
    known = {value for name in names if type(value := getattr(action.Result, name)) is int}
    assert len(known) > 3
    assert known <= codes(section(REFERENCE, where))
