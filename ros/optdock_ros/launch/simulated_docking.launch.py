"""The docking server and a simulated robot in front of its dock.

    ros2 launch optdock_ros simulated_docking.launch.py
    ros2 action send_goal /dock_robot nav2_msgs/action/DockRobot "{dock_id: bay, navigate_to_staging_pose: false}"
    ros2 service call /simulated_robot/reset std_srvs/srv/Trigger

In RViz: fixed frame map; /simulated_robot/obstacles, /docking_server/markers, /local_costmap/published_footprint.
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare


def generate_launch_description() -> LaunchDescription:
    """Return both nodes, with one parameter file."""
    share = FindPackageShare("optdock_ros")
    default_file = PathJoinSubstitution([share, "config", "simulated_docking.yaml"])
    params_file = LaunchConfiguration("params_file")
    docking = IncludeLaunchDescription(
        PythonLaunchDescriptionSource(PathJoinSubstitution([share, "launch", "servers.launch.py"])),
        launch_arguments={"params_file": params_file, "autostart": "true", "smoother": "false"}.items(),
    )
    robot = Node(package="optdock_ros", executable="simulated_robot", parameters=[params_file], output="screen")
    return LaunchDescription(
        [
            DeclareLaunchArgument("params_file", default_value=default_file, description="of robot and server"),
            robot,
            docking,
        ]
    )
