"""Nested ROS parameters and their faults, and the lifecycle of a server in this process."""

from __future__ import annotations

import array
import threading
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import pytest
from harness import Client, Lifecycle, spinning
from optdock_ros.nested_parameters import (
    BlockReader,
    ServerParameters,
    clearance_parameters,
    nested,
    parameters_of,
    plain,
    robot_parameters,
    unknown_names,
)
from optdock_ros.server import Server
from pydantic import Field
from rcl_interfaces.srv import DescribeParameters
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.parameter import Parameter
from std_msgs.msg import Empty

from optdock.errors import InvalidValue
from optdock.geometry.footprint import Footprint
from optdock.model.robot import Drive
from optdock.nav2.declared_parameters import Block

if TYPE_CHECKING:
    from collections.abc import Iterator

SUCCESS, FAILURE = TransitionCallbackReturn.SUCCESS, TransitionCallbackReturn.FAILURE


def test_names_with_dots_are_nested() -> None:
    flat = {"a": 1, "b.c": [1.0], "b.d.e": "x"}
    assert nested(flat) == {"a": 1, "b": {"c": [1.0], "d": {"e": "x"}}}
    for clash in ({"a": 1, "a.b": 2}, {"a.b": 2, "a": 1}):
        with pytest.raises(InvalidValue, match="both a value and a block"):
            nested(clash)


def test_values_are_plain() -> None:
    assert plain(array.array("d", [1.0])) == [1.0]
    assert plain(None) == []
    assert plain("x") == "x"


def test_unknown_names() -> None:
    block = {
        "costmap_topik": 1,
        "FollowPath": {},
        "use_sim_time": True,
        "introspection_mode": "",
        "k_phi": 1,
        "ours": 2,
    }
    faults, ignored = unknown_names(block, ("costmap_topic", "ours"), Block.CONTROLLER)
    assert faults == ["costmap_topik: unknown parameter; did you mean costmap_topic?"]
    assert ignored == ["FollowPath", "k_phi"]
    for theirs in ("odom_topic", "map_topic", "local_costmap_topic", "costmap_update_timeout", "bond_timeout"):
        assert unknown_names({theirs: 1}, ("costmap_topic", "costmap_timeout"), Block.CONTROLLER) == ([], [theirs])


def test_all_faults_are_reported_together() -> None:
    reader = BlockReader({"controller": 1.0})
    assert reader.attempt(lambda: clearance_parameters(0.1), None) is not None
    assert reader.attempt(lambda: clearance_parameters({"required": -1.0, "tapr": 1.0}), None) is None
    assert (reader.inner("controller"), reader.inner("robot")) == ({}, {})
    given = {"costmap_topic": 1, "costmap_topik": 2, "other": 3}
    assert reader.known(given, ["costmap_topic"], Block.CONTROLLER, "x") == {"costmap_topic": 1}
    assert reader.ignored == ["x.other"]
    with pytest.raises(InvalidValue) as caught:
        reader.check()
    assert "clearance.required" in str(caught.value)
    assert "clearance.tapr: unknown key; did you mean taper?" in str(caught.value)
    assert "x.costmap_topik: unknown parameter; did you mean costmap_topic?" in str(caught.value)
    assert "controller: must be a block of parameters, got 1.0" in str(caught.value)


def test_robot_block_in_the_scenario_format() -> None:
    said = robot_parameters({"drive": "ackermann", "limits": {"max_speed": 1, "wheelbase": 0.6, "max_curvature": 2}})
    assert said.footprint is None
    robot = said.robot(Footprint.from_radius(0.3))
    assert (robot.drive, robot.limits.max_speed, robot.limits.max_curvature) == (Drive.ACKERMANN, 1.0, 2.0)
    outline = robot_parameters({"footprint": "[[0.3, 0.2], [-0.3, 0.2], [-0.3, -0.2], [0.3, -0.2]]"}).footprint
    assert outline is not None
    assert outline.length == pytest.approx(0.6)


@pytest.mark.parametrize(
    ("block", "words"),
    [
        (
            {"limits": {"min_turning_radius": 0.5}},
            "robot.limits.min_turning_radius: unknown key; write max_curvature: 2",
        ),
        ({"limits": {"max_sped": 0.5}}, "robot.limits.max_sped: unknown key; did you mean max_speed?"),
        ({"radius": -0.2}, "robot.radius"),
        ({"footprint": "[[0, 0], [1, 1]]"}, "robot.footprint"),
        ({"limits": {"max_speed": "fast"}}, "robot.limits.max_speed: must be a number, got 'fast'"),
        ({"limits": {"max_speed": -1.0}, "drive": "legs"}, "robot.drive: must be"),
        (3.0, "robot: must be a block of parameters, got 3.0"),
    ],
)
def test_invalid_robot_block(block: object, words: str) -> None:
    with pytest.raises(InvalidValue) as caught:
        robot_parameters(block)
    assert words in str(caught.value)


class TriedParameters(ServerParameters):
    """Parameters of the server below."""

    speed: float = Field(1.0, gt=0, description="how fast [m/s]")
    topic: str = Field("somewhere", description="of something")
    names: tuple[str, ...] = Field(("a", "b"), description="of things")


@dataclass(frozen=True)
class Settings:
    """Settings of the server below."""

    own: Any
    seen: int


class Tried(Server[Settings]):
    """A server that records its method calls."""

    Parameters = TriedParameters
    fixed = frozenset({"topic"})

    def __init__(self, name: str, **kwargs: Any) -> None:
        self.diary: list[str] = []
        self.fails = ""
        self.heard = threading.Event()
        super().__init__(name, **kwargs)

    def check(self, block: dict[str, object]) -> Settings:
        """As `Server.check`."""
        return Settings(self.own_parameters(block), len(self.diary))

    def _note(self, word: str) -> None:
        self.diary.append(word)
        if self.fails == word:
            raise RuntimeError(f"{word} fails")

    def set_up(self) -> None:
        """As `Server.set_up`."""
        self._note("set_up")

    def start(self) -> None:
        """As `Server.start`."""
        self._note("start")

    def stop(self) -> None:
        """As `Server.stop`."""
        self._note("stop")

    def tear_down(self) -> None:
        """As `Server.tear_down`."""
        self._note("tear_down")

    def changed(self) -> None:
        """As `Server.changed`."""
        self._note(f"changed to {self.settings.own.speed}")


@pytest.fixture
def server(context: None) -> Iterator[Tried]:  # noqa: ARG001 - a node needs it
    """A server that is not spun."""
    made = Tried("tried", parameter_overrides=[Parameter("speed", value=2), Parameter("Other.x", value=1)])
    yield made
    made.destroy_node()


def test_integers_are_numbers_and_defaults_are_declared(server: Tried) -> None:
    assert parameters_of(server)["speed"] == 2
    assert parameters_of(server)["names"] == ["a", "b"]
    assert server.trigger_configure() == SUCCESS
    assert server.settings.own.speed == 2.0
    assert server.describe_parameter("speed").description == "how fast [m/s]"


@pytest.mark.parametrize("word", ["set_up", "start", "stop", "tear_down"])
def test_failed_transition_can_be_repeated(server: Tried, word: str) -> None:
    server.fails = word
    wanted = FAILURE if word == "set_up" else SUCCESS
    assert server.trigger_configure() == wanted
    if word == "set_up":
        assert server.diary == ["set_up", "tear_down"]
        server.fails = ""
        assert server.trigger_configure() == SUCCESS
    assert server.trigger_activate() == (FAILURE if word == "start" else SUCCESS)
    if word == "start":
        assert server.diary[-1] == "stop"
        server.fails = ""
        assert server.trigger_activate() == SUCCESS
    assert server.is_active
    assert server.trigger_deactivate() == SUCCESS
    assert not server.is_active
    assert server.trigger_cleanup() == SUCCESS
    assert server.diary[-2:] == ["stop", "tear_down"]


def test_shutdown_while_active_stops_first(server: Tried) -> None:
    server.trigger_configure()
    server.trigger_activate()
    assert server.trigger_shutdown() == SUCCESS
    assert server.diary[-1] == "stop", "what was made is given back when clients have had their results"
    server.end()
    assert server.diary[-2:] == ["stop", "tear_down"]
    assert server.diary.count("stop") == 1


def test_changes_are_applied_together_or_not_at_all(server: Tried) -> None:
    server.trigger_configure()
    changes = [Parameter("speed"), Parameter("names", value=["c"]), Parameter("Other.y", value=[1, 2])]
    block = parameters_of(server, changes)
    assert "speed" not in block, "an unset parameter is left out"
    assert (block["names"], block["Other"]) == (["c"], {"x": 1, "y": [1, 2]})
    before = server.settings
    for refused in (
        [Parameter("speed", value=3.0), Parameter("topic", value="elsewhere")],
        [Parameter("speed", value=3.0), Parameter("names", value=1)],
        [Parameter("speed", value=3.0), Parameter("nams", value=["c"])],
        [Parameter("speed", value=-1.0)],
        [Parameter("speed.x", value=1.0)],
    ):
        assert not server.set_parameters_atomically(refused).successful
        assert server.settings is before
        assert parameters_of(server)["speed"] == 2
    assert server.set_parameters_atomically([Parameter("topic", value="somewhere")]).successful
    assert server.set_parameters_atomically([Parameter("speed", value=3)]).successful
    assert server.settings.own.speed == 3.0
    assert server.diary[-1] == "changed to 3.0"
    server.trigger_cleanup()
    assert server.set_parameters_atomically([Parameter("speed", value=-1.0)]).successful
    assert server.trigger_configure() == FAILURE


def test_an_error_in_a_callback_does_not_end_the_server(client_node: Client, context: None) -> None:  # noqa: ARG001
    from optdock_ros.server import leave, spin
    from rclpy.executors import SingleThreadedExecutor

    made, executor = Tried("erring"), SingleThreadedExecutor()

    def _fails(_: Empty) -> None:
        made.heard.set()
        raise RuntimeError("in a callback")

    made.create_subscription(Empty, "trouble", _fails, 10)
    executor.add_node(made)
    thread = threading.Thread(target=spin, args=(executor,))
    thread.start()
    try:
        publisher = client_node.create_publisher(Empty, "trouble", 10)
        client_node.until(publisher.get_subscription_count)
        for _ in range(2):
            made.heard.clear()
            publisher.publish(Empty())
            assert made.heard.wait(5.0)
        Lifecycle(client_node, "erring").up()
        names = DescribeParameters.Request(names=["speed"])
        assert client_node.call(DescribeParameters, "/erring/describe_parameters", names).descriptors
    finally:
        executor.create_task(leave)
        thread.join()
        executor.shutdown()
        made.destroy_node()


def test_a_parameter_that_is_unset_has_its_default(server: Tried) -> None:
    for name in ("bond_heartbeat_period", "speed", "names"):
        assert server.set_parameters_atomically([Parameter(name)]).successful
    assert server.trigger_configure() == SUCCESS
    assert server.settings.own == TriedParameters()


def test_transitions_by_services(client_node: Client, context: None) -> None:  # noqa: ARG001
    made = Tried("walked")
    with spinning(made):
        life = Lifecycle(client_node, "walked")
        life.up()
        assert life.state == "active"
        assert life.shutdown()
        assert life.state == "finalized"
        client_node.until(lambda: made.diary[-1] == "tear_down", 5.0, "the end")
    assert made.diary == ["set_up", "start", "stop", "tear_down"]
