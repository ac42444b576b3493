"""A robot of a field world of `experiments.docking.field`, with the topics of `simulated_robot`.

Wheels, encoders, localization, camera and station are those of the docking study: unequal wheels that slip, late
odometry, a localization that drifts and jumps, detections that are late, out of order, wrong or missing. The costmap
contains the posts and the station at their true places, as a scanner sees them from the estimated pose.

    world, spread, seed   parameters of the next run
    ~/reset               srv  Trigger: begins the run
    ~/report              out  DiagnosticArray: true errors at the dock, clearances
"""

from __future__ import annotations

import math
import sys
import time
from typing import TYPE_CHECKING

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PolygonStamped, PoseStamped, TwistStamped
from nav2_msgs.msg import Costmap
from nav_msgs.msg import Odometry
from optdock_ros.simulated_robot import LATCHED, MARKER_FACES, battery_state, quaternion, stamped, surroundings
from optdock_ros.simulation_parameters import about_z
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import BatteryState
from std_srvs.srv import Trigger
from tf2_msgs.msg import TFMessage

from experiments.docking.field.outcome import FieldTask
from experiments.docking.field.run import set_up
from optdock import ros, simulation
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import Pose2, Twist2, transform_points
from optdock.model.dock import DockDirection
from optdock.ros.transforms import quaternion_product

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray
    from optdock.model.measurements import Detection

PERIOD = 0.01  # [s] between two readings of the sensors
MARKER = 0.2  # [m] before the docked robot's origin: minus Nav2's default of external_detection_translation_x
TOLERANCE = 1.0  # [s] by which AMCL stamps its transform into the future: Nav2's default
CELL, SIDE = 0.05, 120  # [m], cells: a costmap of 6 m that contains the robot and the dock
EVERY = {"costmap": 0.2, "battery": 0.1, "report": 0.1}  # [s]
DELAY = 0.5  # [s] from contact to charging
BATTERY = {"battery.idle_current": -1.0, "battery.charging_current": 2.0}  # [A]
SUBSTEPS = 4  # between two poses whose clearance is measured: 20 ms, 5 mm at full speed


class FieldRobotNode(Node):
    """The node. A task that has not begun waits at its start."""

    def __init__(self) -> None:
        super().__init__("simulated_robot")
        for name, default in (("world", "field"), ("spread", "nav2"), ("seed", 0)):
            self.declare_parameter(name, default)
        latest = QoSProfile(depth=1)
        self._transforms = self.create_publisher(TFMessage, "/tf", 100)
        self._odometry = self.create_publisher(Odometry, "odom", 10)
        self._detections = self.create_publisher(PoseStamped, "detected_dock_pose", 10)
        self._battery = self.create_publisher(BatteryState, "battery_state", latest)
        self._costmap = self.create_publisher(Costmap, "local_costmap/costmap_raw", LATCHED)
        self._footprint = self.create_publisher(PolygonStamped, "local_costmap/published_footprint", latest)
        self._report = self.create_publisher(DiagnosticArray, "~/report", 10)
        self._begin()
        self.create_subscription(TwistStamped, "cmd_vel", self._on_command, latest)
        self.create_service(Trigger, "~/reset", self._on_reset)
        self.create_timer(PERIOD, self._step)

    def _begin(self) -> None:
        """Place the robot at the start of the run of the parameters."""
        world, spread, seed = (self.get_parameter(name).value for name in ("world", "spread", "seed"))
        self._layout, self._robot = set_up(FieldTask("", world, spread, 1.0 / PERIOD, seed))
        if not self._robot.world.localization.composed or not self._robot.world.station.has_switch:
            raise ValueError(f"world {world!r}: needs a localization by transforms and a contact")
        self._began, self._epoch = time.monotonic(), 1e-9 * self.get_clock().now().nanoseconds
        self._stamp, self._correction = -math.inf, Pose2(0.0, 0.0, 0.0)
        self._due = dict.fromkeys(EVERY, 0.0)
        self._measured = 0  # sub-steps with a measured clearance
        self._clearance = self._station_clearance = math.inf
        self._contact_since: float | None = None

    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._begin()
        response.success = True
        return response

    def _on_command(self, message: TwistStamped) -> None:
        self._robot.drive.send(Twist2(message.twist.linear.x, message.twist.angular.z))

    def _step(self) -> None:
        robot = self._robot
        robot.run(time.monotonic() - self._began)
        measured = robot.measure()
        self._publish_transforms(measured.pose)
        for detection in measured.detections:
            self._detections.publish(self._detected(detection))
        self._contact_since = (self._contact_since or robot.time) if measured.contact else None
        if self._is_due("costmap"):
            self._publish_costmap(robot.odometry.pose)
        if self._is_due("battery"):
            self._publish_battery()
        if self._is_due("report"):
            self._publish_report()
        for name, period in EVERY.items():
            while self._due[name] <= robot.time:
                self._due[name] += period

    def _publish_transforms(self, localized: Pose2 | None) -> None:
        """Publish new odometry, and a new or repeated correction of the odometry by the localization."""
        odometry = self._robot.odometry
        if odometry.stamp > self._stamp:
            self._stamp = odometry.stamp
            stamp, make = self._epoch + odometry.stamp, ros.odometry_message
            self._odometry.publish(make(ros.imported, odometry.pose, odometry.twist, "odom", "base_link", stamp))
            self._send("odom", "base_link", odometry.pose, stamp)
        if localized is None:
            return
        correction = localized @ odometry.pose.inverse()
        if correction.distance_to(self._correction) > 1e-9 or self._is_due("report"):
            self._correction = correction
            self._send("map", "odom", correction, self._epoch + self._robot.time + TOLERANCE)

    def _is_due(self, name: str) -> bool:
        return self._due[name] <= self._robot.time

    def _send(self, frame: str, child: str, pose: Pose2, stamp: float) -> None:
        self._transforms.publish(ros.transforms_message(ros.imported, [(frame, child, pose)], stamp))

    def _detected(self, detection: Detection) -> PoseStamped:
        """Return the pose of the marker in the robot's frame."""
        gear, turn = (1.0, 0.0) if self._layout.direction is DockDirection.FORWARD else (-1.0, math.pi)
        marker = detection.pose @ Pose2(gear * MARKER, 0.0, 0.0)
        message: PoseStamped = stamped(PoseStamped, self._epoch + detection.stamp, "base_link")
        message.pose.position.x, message.pose.position.y, message.pose.position.z = marker.x, marker.y, 0.3
        message.pose.orientation = quaternion(quaternion_product(about_z(marker.yaw + turn), MARKER_FACES))
        return message

    def _station(self) -> FloatArray:
        """Return the outline of the station at its true place."""
        outline = self._layout.problem.dock.footprint
        assert outline is not None
        return transform_points(self._robot.dock.as_array()[None], outline.vertices)[0]

    def _publish_costmap(self, here: Pose2) -> None:
        """Publish obstacles and outline at the pose of the odometry, with the time at which the scanner saw them."""
        posts = self._layout.problem.obstacles.vertices
        outlines = np.concatenate((posts, self._station()[None]))
        grid = surroundings(outlines, here, self._robot.pose, CELL, SIDE)
        stamp = self._epoch + self._stamp
        self._costmap.publish(ros.costmap_message(ros.imported, grid, "odom", stamp))
        outline = transform_points(here.as_array()[None], self._layout.problem.robot.footprint.vertices)[0]
        self._footprint.publish(ros.polygon_message(ros.imported, outline, "odom", stamp))

    def _publish_battery(self) -> None:
        since, time_now = self._contact_since, self._robot.time
        charges = since is not None and time_now - since >= DELAY
        self._battery.publish(battery_state(BATTERY, self._epoch + time_now, charges=charges))

    def _publish_report(self) -> None:
        robot, problem = self._robot, self._layout.problem
        poses = np.array(robot.poses[self._measured :: SUBSTEPS])[:, 1:]
        self._measured += SUBSTEPS * len(poses)
        outline, station = problem.robot.footprint, ObstacleSet.from_polygons([self._station()])
        if len(poses):
            self._clearance = min(self._clearance, simulation.executed_clearance(outline, poses, problem.obstacles))
            self._station_clearance = min(
                self._station_clearance, simulation.executed_clearance(outline, poses, station)
            )
        error = robot.error
        values: dict[str, object] = {
            "along": error.x, "cross": error.y, "yaw": error.yaw,
            "clearance": self._clearance, "station_clearance": self._station_clearance,
        }  # fmt: skip
        make, stamp = ros.diagnostics_message, self._epoch + robot.time
        self._report.publish(make(ros.imported, "the truth", "ok", "", values, stamp))


def main() -> int:
    """Run the process."""
    rclpy.init()
    try:
        rclpy.spin(FieldRobotNode())
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
