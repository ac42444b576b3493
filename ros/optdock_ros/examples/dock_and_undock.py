"""Dock and undock, by the actions of Nav2's docking server."""

import sys

import rclpy
from action_msgs.msg import GoalStatus
from nav2_msgs.action import DockRobot, UndockRobot
from rclpy.action import ActionClient

rclpy.init()
node = rclpy.create_node("dock_and_undock")
for name, kind, fields in (
    ("dock_robot", DockRobot, {"dock_id": "bay", "navigate_to_staging_pose": False}),
    ("undock_robot", UndockRobot, {}),
):
    client = ActionClient(node, kind, name)
    client.wait_for_server()
    accepted = client.send_goal_async(kind.Goal(**fields))
    rclpy.spin_until_future_complete(node, accepted)
    finished = accepted.result().get_result_async()
    rclpy.spin_until_future_complete(node, finished)
    reply = finished.result()
    print(f"{name}: error code {reply.result.error_code} {reply.result.error_msg}")
    if reply.status != GoalStatus.STATUS_SUCCEEDED:
        sys.exit(1)
