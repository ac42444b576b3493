"""Nav2's servers with the smoother and docking servers of optdock, in Nav2's loopback simulation, without RViz."""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

SERVERS = {
    "map_server": "nav2_map_server",
    "planner_server": "nav2_planner",
    "controller_server": "nav2_controller",
    "behavior_server": "nav2_behaviors",
    "bt_navigator": "nav2_bt_navigator",
}  # each with an executable of its name
OURS = ("smoother_server", "docking_server")


def generate_launch_description() -> LaunchDescription:
    """Return the simulation, the servers, and one lifecycle manager for all."""
    share = FindPackageShare("nav2_bringup")
    stock = PathJoinSubstitution([share, "params", "nav2_params.yaml"])
    world = {"yaml_filename": PathJoinSubstitution([share, "maps", "tb3_sandbox.yaml"])}
    servers = [
        Node(package=package, executable=name, name=name, parameters=[stock, world] if "map" in name else [stock])
        for name, package in SERVERS.items()
    ]
    ours = IncludeLaunchDescription(
        PythonLaunchDescriptionSource(
            PathJoinSubstitution([FindPackageShare("optdock_ros"), "launch", "servers.launch.py"])
        ),
        launch_arguments={"params_file": str(Path(__file__).with_name("bringup.yaml"))}.items(),
    )
    simulation = Node(package="nav2_loopback_sim", executable="loopback_simulator", parameters=[stock])
    manager = Node(
        package="nav2_lifecycle_manager",
        executable="lifecycle_manager",
        name="lifecycle_manager_navigation",
        parameters=[{"autostart": True, "node_names": [*SERVERS, *OURS]}],
        output="screen",
    )
    return LaunchDescription([simulation, *servers, ours, manager])
