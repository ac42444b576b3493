"""Two simulated robots in one domain, each in a namespace, dock at the same time."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml
from action_msgs.msg import GoalStatus
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TwistStamped
from harness import Client, Lifecycle, Processes
from launch_stand_in import PACKAGE, launched
from nav2_msgs.action import DockRobot

ROBOTS = ("robot1", "robot2")
OFFSETS = {"robot1": [0.03, -0.04, 0.05], "robot2": [-0.02, 0.05, -0.04]}  # true docks relative to the stored ones
# The first robot has its own /tf; the second one has frames with a prefix in the /tf of all robots.
FRAMES = {
    "robot1": ("odom", "base_link", "camera_optical_frame"),
    "robot2": ("robot2/odom", "robot2/base_link", "robot2/camera_optical_frame"),
}
OWN_CLOCK = ("-r", "/clock:=clock")  # a simulated world waits for a busy machine, so that no two can have one clock


def parameter_file(robot: str, folder: Path) -> Path:
    """Write the parameters of the simulated world, with the frames of a robot, for plain node names."""
    found = yaml.safe_load((PACKAGE / "config" / "simulated_docking.yaml").read_text())
    odom, base, camera = FRAMES[robot]
    world, server = (found[name]["ros__parameters"] for name in ("simulated_robot", "docking_server"))
    world |= {"odom_frame": odom, "base_frame": base, "camera.frame": camera, "dock_offset": OFFSETS[robot]}
    world["speed"] = 1.0
    server |= {"fixed_frame": f"/{odom}", "base_frame": f"/{base}", "use_sim_time": True}
    path = folder / f"{robot}.yaml"
    path.write_text(yaml.safe_dump(found))
    return path


@pytest.fixture(scope="module")
def robots(module_process: Processes, client_node: Client, tmp_path_factory: pytest.TempPathFactory) -> Client:
    """Both robots and their docking servers, active."""
    folder = tmp_path_factory.mktemp("robots")
    for robot in ROBOTS:
        started = launched(
            "simulated_docking.launch.py",
            folder,
            params_file=str(parameter_file(robot, folder)),
            namespace=robot,
            remap_tf=str(robot == "robot1"),
        )
        for one in started:
            module_process(one.executable, args=[*one.arguments, *OWN_CLOCK])
    for robot in ROBOTS:
        life = Lifecycle(client_node, f"{robot}/docking_server")
        client_node.until(lambda life=life: life.state == "active", what=f"{robot}: active")
    return client_node


def told(reports: list[DiagnosticArray]) -> dict[str, float]:
    """Return the numbers of the newest report of a simulated robot."""
    return {item.key: float(item.value) for item in reports[-1].status[0].values if item.value not in {"True", "False"}}


def test_both_dock_at_once(robots: Client) -> None:
    reports = {robot: robots.heard(DiagnosticArray, f"/{robot}/simulated_robot/report") for robot in ROBOTS}
    commands = {robot: robots.heard(TwistStamped, f"/{robot}/cmd_vel", 1000) for robot in ROBOTS}
    diagnostics = robots.heard(DiagnosticArray, "/diagnostics", 100)
    goal = DockRobot.Goal(dock_id="bay", navigate_to_staging_pose=False)
    goals = {robot: robots.send(DockRobot, f"/{robot}/dock_robot", goal) for robot in ROBOTS}
    assert not any(one.is_done for one in goals.values())
    for robot in ROBOTS:
        reply = goals[robot].reply(90.0)
        assert (reply.status, reply.result.error_code) == (GoalStatus.STATUS_SUCCEEDED, 0), (robot, reply.result)
    for robot in ROBOTS:
        found = told(reports[robot])
        assert max(abs(found[name]) for name in ("along", "cross", "yaw")) < 0.01, (robot, found)
        assert {message.header.frame_id for message in commands[robot]} == {FRAMES[robot][1]}
        assert {status.name for status in reports[robot][-1].status} == {f"{robot}/simulated_robot: the truth"}
    names = {status.name for message in diagnostics for status in message.status}
    assert {f"{robot}/docking_server: state" for robot in ROBOTS} <= names


def test_commands_of_one_robot_do_not_reach_the_other(robots: Client) -> None:
    for robot in ROBOTS:
        topic = f"/{robot}/cmd_vel"
        assert [one.node_namespace for one in robots.get_publishers_info_by_topic(topic)] == [f"/{robot}"]
        others = [
            one.node_namespace
            for one in robots.get_subscriptions_info_by_topic(topic)
            if one.node_name != robots.get_name()
        ]
        assert others == [f"/{robot}"]
        clients = [name for name, _ in robots.get_client_names_and_types_by_node("docking_server", f"/{robot}")]
        assert f"/{robot}/navigate_to_pose/_action/send_goal" in clients
        assert all(name.startswith(f"/{robot}/") for name in clients)
    shared = {"/tf", "/tf_static", "/diagnostics", "/rosout", "/parameter_events"}
    listed = (robots.get_publisher_names_and_types_by_node, robots.get_subscriber_names_and_types_by_node)
    nodes = ((name, f"/{robot}") for robot in ROBOTS for name in ("docking_server", "simulated_robot"))
    names = {topic for node in nodes for topics_of in listed for topic, _ in topics_of(*node)}
    assert {name for name in names if not name.startswith(("/robot1/", "/robot2/"))} == shared
