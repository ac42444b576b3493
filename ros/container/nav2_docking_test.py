"""Change Nav2's own test of its docking server so that it starts that of optdock, and print it.

    python3 nav2_docking_test.py test_docking_server.py > test_optdock_docking_server.py
    python3 -m pytest -s test_optdock_docking_server.py

The changes are those that documented differences require. Every original must occur exactly once, so that another
version of the test is refused.
"""

import sys
from pathlib import Path

CHANGES = (
    ("package='opennav_docking',", "package='optdock_ros',"),
    ("executable='opennav_docking',", "executable='docking_server',"),
    # Twist, which is Nav2's default on Jazzy; a footprint, which Nav2 needs only for collision detection.
    (
        "parameters=[{'wait_charge_timeout': 1.0,",
        "parameters=[{'wait_charge_timeout': 1.0, 'enable_stamped_cmd_vel': False, 'robot': {'radius': 0.2},",
    ),
    # The odometry, which Nav2 does not require.
    ("import BatteryState\n", "import BatteryState\nfrom nav_msgs.msg import Odometry\n"),
    (
        "        # Publish battery state\n",
        "        o = Odometry()\n"
        "        o.header, o.child_frame_id = t.header, t.child_frame_id\n"
        "        o.pose.pose.position.x, o.pose.pose.position.y = self.x, self.y\n"
        "        o.pose.pose.orientation = t.transform.rotation\n"
        "        o.twist.twist = self.command\n"
        "        self.odometry_pub.publish(o)\n"
        "        # Publish battery state\n",
    ),
    (
        "        # Create publisher for battery state message\n",
        "        self.odometry_pub = self.node.create_publisher(Odometry, 'odom', 10)\n"
        "        # Create publisher for battery state message\n",
    ),
    # A newer goal is executed; Nav2 aborts both.
    (
        "        self.assertEqual(self.action_result[0].status, GoalStatus.STATUS_ABORTED)\n"
        "        self.assertFalse(self.action_result[0].result.success)\n",
        "        self.assertEqual(self.action_result[0].status, GoalStatus.STATUS_SUCCEEDED)\n"
        "        self.assertTrue(self.action_result[0].result.success)\n",
    ),
    # The retry is therefore part of the second goal, and the third one finds the robot docked.
    (
        "        self.assertEqual(self.action_result[2].result.num_retries, 1)\n",
        "        self.assertEqual(self.action_result[0].result.num_retries, 1)\n",
    ),
)  # fmt: skip


def main() -> None:
    """Print the changed test."""
    text = Path(sys.argv[1]).read_text(encoding="utf-8")
    for old, new in CHANGES:
        if text.count(old) != 1:
            sys.exit(f"{sys.argv[1]}: occurs {text.count(old)} times, not once: {old!r}")
        text = text.replace(old, new)
    sys.stdout.write(text)


if __name__ == "__main__":
    main()
