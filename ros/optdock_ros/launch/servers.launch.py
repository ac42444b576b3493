"""The servers of optdock as replacements of Nav2's servers of the same names.

    ros2 launch optdock_ros servers.launch.py params_file:=/path/to/nav2_params.yaml

Set `autostart` to true only without a lifecycle manager. With one, as in a Nav2 bringup, list the servers in its
`node_names`.
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

SERVERS = ("smoother", "docking")
SWITCHES = ("use_sim_time", "autostart")


def generate_launch_description() -> LaunchDescription:
    """Return the arguments and the nodes of the servers."""
    default_file = PathJoinSubstitution([FindPackageShare("optdock_ros"), "config", "optdock.yaml"])
    arguments = [
        DeclareLaunchArgument("params_file", default_value=default_file, description="parameters of all servers"),
        DeclareLaunchArgument("namespace", default_value="", description="of the nodes and their relative topics"),
        DeclareLaunchArgument("use_sim_time", default_value="false", description="time from /clock"),
        DeclareLaunchArgument("autostart", default_value="false", description="activate without a lifecycle manager"),
        DeclareLaunchArgument(
            "cmd_vel_topic", default_value="cmd_vel", description="topic of the docking server's commands"
        ),
        DeclareLaunchArgument("log_level", default_value="info", description="debug, info, warn or error"),
        *(DeclareLaunchArgument(name, default_value="true", description=f"start {name}_server") for name in SERVERS),
    ]
    given = {name: ParameterValue(LaunchConfiguration(name), value_type=bool) for name in SWITCHES}
    # As in Nav2's bringup, a robot in a namespace has its own transforms.
    remappings = [("/tf", "tf"), ("/tf_static", "tf_static"), ("cmd_vel", LaunchConfiguration("cmd_vel_topic"))]
    nodes = [
        Node(
            package="optdock_ros",
            executable=f"{name}_server",
            name=f"{name}_server",
            namespace=LaunchConfiguration("namespace"),
            parameters=[LaunchConfiguration("params_file"), given],
            remappings=remappings,
            arguments=["--ros-args", "--log-level", LaunchConfiguration("log_level")],
            output="screen",
            condition=IfCondition(LaunchConfiguration(name)),
        )
        for name in SERVERS
    ]
    return LaunchDescription([*arguments, *nodes])
