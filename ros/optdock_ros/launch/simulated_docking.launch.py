"""The docking server and a simulated robot in front of its dock; the other arguments are those of servers.launch.py.

    ros2 launch optdock_ros simulated_docking.launch.py
    ros2 action send_goal /dock_robot nav2_msgs/action/DockRobot "{dock_id: bay, navigate_to_staging_pose: false}"
    ros2 service call /simulated_robot/reset std_srvs/srv/Trigger

In RViz: fixed frame map; /simulated_robot/obstacles, /docking_server/markers, /local_costmap/published_footprint.
With `namespace:=robot1`, all these names begin with /robot1.
"""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource

HERE = Path(__file__).parent
DEFAULT_FILE = HERE.parent / "config" / "simulated_docking.yaml"
ARGUMENTS = {"autostart": "true", "smoother": "false", "simulated_robot": "true"}


def generate_launch_description() -> LaunchDescription:
    """Return both nodes, with one parameter file."""
    servers = PythonLaunchDescriptionSource(str(HERE / "servers.launch.py"))
    return LaunchDescription(
        [
            DeclareLaunchArgument("params_file", default_value=str(DEFAULT_FILE), description="of robot and server"),
            IncludeLaunchDescription(servers, launch_arguments=ARGUMENTS.items()),
        ]
    )
