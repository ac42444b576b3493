"""`simulated_robot`: a simulated robot in front of its dock, with the topics of a real one.

Drive, sensors and station are those of `optdock.simulation`, the world is a scenario file:

    cmd_vel                               in   TwistStamped, or Twist; the robot stops after `command_timeout`
    odom                                  out  Odometry: integrated encoders, with drift
    /tf                                   out  odom -> base_link, and map -> odom by localization
    /tf_static                            out  base_link -> camera
    detected_dock_pose                    out  PoseStamped: the dock's marker in the camera's frame, if visible
    battery_state, joint_states           out  the current flows in contact; wheels stall at the stop
    local_costmap/costmap_raw             out  Costmap: a window around the robot, when it has moved by a cell
    local_costmap/costmap_raw_updates     out  CostmapUpdate: otherwise the changes
    local_costmap/published_footprint     out  PolygonStamped: the outline at the pose of the odometry
    ~/truth                               out  Odometry: the true pose in the map, the true velocity
    ~/report                              out  DiagnosticArray: errors at the dock, clearance, contact, commands
    ~/obstacles                           out  MarkerArray
    ~/reset                               srv  Trigger: restarts the world with the current parameters
    /clock                                out  Clock, unless `speed` is 0

`simulation_parameters` lists the parameters; `faults.*` take effect at once, all others at the next `~/reset`.
"""

from __future__ import annotations

import math
import sys
import threading
import time
from typing import TYPE_CHECKING, Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Point, PolygonStamped, PoseStamped, Quaternion, TransformStamped, Twist, TwistStamped
from nav2_msgs.msg import Costmap, CostmapUpdate
from nav_msgs.msg import Odometry
from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import BatteryState, JointState
from std_srvs.srv import Trigger
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import Marker, MarkerArray

from optdock import ros, simulation
from optdock.errors import InvalidValue, OptdockError
from optdock.geometry.pose import Pose2, Twist2, arc_end, transform_points
from optdock.model.costmap import Costmap as Grid
from optdock.model.costs import LETHAL
from optdock.ros.transforms import quaternion_product, rotated
from optdock_ros.parameter_files import blocks_of, missing_parameters
from optdock_ros.simulation_parameters import PARAMETERS, SimulationParameters, about_z

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from rclpy.parameter import Parameter

    from optdock.geometry.arrays import FloatArray
    from optdock.geometry.obstacles import ObstacleSet
    from optdock.model.measurements import Detection
    from optdock.ros.transforms import Quaternion as Rotation

__all__ = ["SimulatedRobotNode", "main"]

SHARED = ("use_sim_time", "start_type_description_service", "qos_overrides")  # parameters of every node of rclpy
CATCH_UP = 0.25  # [s]: a longer delay means that the process was suspended; it is not simulated
REPORTS = 10.0  # [Hz]
DEFAULT_TRACK = 0.4  # [m], unless the scenario has one
CHARGED = 0.8  # [1]: state of charge that is published
ROLLING_TORQUE = 0.3  # [N m] of a rolling wheel
LATEST = QoSProfile(depth=1)
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
MARKER_FACES = (0.5, -0.5, -0.5, 0.5)  # z out of the dock, y up, x to the right as seen by the camera


class Topics:
    """The publishers."""

    def __init__(self, node: Node, *, has_clock: bool) -> None:
        publisher = node.create_publisher
        self.transforms = publisher(TFMessage, "/tf", 100)
        self.static_transforms = publisher(TFMessage, "/tf_static", LATCHED)
        self.odometry = publisher(Odometry, "odom", 10)
        self.detections = publisher(PoseStamped, "detected_dock_pose", 10)
        self.battery = publisher(BatteryState, "battery_state", LATEST)
        self.joints = publisher(JointState, "joint_states", 10)
        self.costmap = publisher(Costmap, "local_costmap/costmap_raw", LATCHED)
        self.costmap_updates = publisher(CostmapUpdate, "local_costmap/costmap_raw_updates", LATCHED)
        self.footprint = publisher(PolygonStamped, "local_costmap/published_footprint", LATEST)
        self.truth = publisher(Odometry, "~/truth", 10)
        self.report = publisher(DiagnosticArray, "~/report", 10)
        self.obstacles = publisher(MarkerArray, "~/obstacles", LATCHED)
        self.clock = publisher(Clock, "/clock", LATEST) if has_clock else None


class SimulatedRobotNode:
    """The node, whose world runs in a thread until `end`.

    Raises:
        OptdockError: If a parameter is invalid; the message names it.
    """

    def __init__(self) -> None:
        self.node = Node("simulated_robot", automatically_declare_parameters_from_overrides=True)
        for name, (default, description) in PARAMETERS.items():
            if not self.node.has_parameter(name):
                about = ParameterDescriptor(description=description, dynamic_typing=True)
                self.node.declare_parameter(name, default, about)
        why, is_elsewhere = missing_parameters(
            blocks_of(sys.argv), self.node.get_fully_qualified_name(), PARAMETERS, SHARED
        )
        if is_elsewhere:
            raise InvalidValue(f"{why}; the namespaces must be the same")
        self._lock = threading.Lock()
        self._ended = threading.Event()
        self.failed = False
        world = SimulationParameters(self._values(()))
        self._faults = world.block("faults")
        self._topics = Topics(self.node, has_clock=world.values["speed"] > 0.0)
        self._now = 0.0  # [s] since the start of the node
        self._odometry = Pose2(0.0, 0.0, 0.0)
        self._wheels = [0.0, 0.0]  # [rad]
        # A simulated clock must not begin at 0, which means that there is no time yet.
        self._epoch = 1000.0 if self._topics.clock else 1e-9 * self.node.get_clock().now().nanoseconds
        self._begin(world)
        self.node.create_service(Trigger, "~/reset", self._on_reset)
        if world.values["enable_stamped_cmd_vel"]:
            self.node.create_subscription(
                TwistStamped, "cmd_vel", lambda message: self._on_command(message.twist), LATEST
            )
        else:
            self.node.create_subscription(Twist, "cmd_vel", self._on_command, LATEST)
        self.node.add_on_set_parameters_callback(self._on_parameters)
        self._thread = threading.Thread(target=self._run, name="world")
        self._thread.start()

    def end(self) -> None:
        """Stop the world and join its thread."""
        self._ended.set()
        self._thread.join()

    # The world.

    def _begin(self, world: SimulationParameters) -> None:
        """Put the robot at its start; the odometry continues as for a robot that is lifted."""
        self._world, self._robot = world, world.robot()
        self._began = self._now
        self._command, self._commanded, self._commands, self._watchdog_stops = Twist2(), -math.inf, 0, 0
        self._is_held = False
        self._contact_since: float | None = None
        self._measured_twist = Twist2()
        self._window: Grid | None = None
        self._station = world.station()
        self._poses = [self._robot.state.pose]
        self._clearance, self._station_clearance = math.inf, math.inf
        self._due: dict[str, float] = {}
        solid = world.problem.obstacles + self._station
        self._seen = solid if world.values["costmap.station"] else world.problem.obstacles
        self._topics.obstacles.publish(markers(solid, world.values["map_frame"], self._stamp))
        self._topics.static_transforms.publish(TFMessage(transforms=[camera_transform(world, self._stamp)]))

    def _run(self) -> None:
        """Step the world in time; an exception ends the process, because a frozen simulation would be misleading."""
        period = 1.0 / self._world.values["rate"]
        pace = self._world.values["speed"] or 1.0
        origin, ticks = time.monotonic(), 0
        if self._topics.clock is None:  # the time that the start has taken is not simulated
            self._epoch = 1e-9 * self.node.get_clock().now().nanoseconds
        try:
            while not self._ended.is_set():
                pause = origin + (ticks + 1) * period / pace - time.monotonic()
                if pause > 0.0:
                    self._ended.wait(pause)
                late = max(0, math.floor(-pause * pace / period))
                if self._topics.clock is not None or late * period > CATCH_UP:
                    skipped, late = late * period, 0
                    origin += skipped / pace  # a simulated clock waits for a busy machine
                    if self._topics.clock is None:
                        self._epoch += skipped
                ticks += 1 + late
                with self._lock:
                    self._step((1 + late) * period)
        except Exception as error:
            if self.node.context.ok():
                self.failed = True
                self.node.get_logger().fatal(f"the simulated world has stopped: {error!r}")
                self.node.context.try_shutdown()

    def _step(self, duration: float) -> None:
        command = self._command
        if self._now - self._commanded > self._world.values["command_timeout"]:
            self._watchdog_stops += command != Twist2()
            self._command = command = Twist2()
        measured = self._robot.advance(command, duration)
        self._now += duration
        before, self._measured_twist = self._measured_twist, measured.twist
        mean = (0.5 * (before.linear + measured.twist.linear), 0.5 * (before.angular + measured.twist.angular), 0.0)
        self._odometry = Pose2(*arc_end(self._odometry.x, self._odometry.y, self._odometry.yaw, mean, duration))
        state = self._robot.state
        self._poses.append(state.pose)
        self._is_held = state.encoders == Twist2() and state.target != (0.0, 0.0) and bool(measured.contact)
        self._contact_since = None if not measured.contact else self._contact_since or self._now
        for side, rim in enumerate(self._rim_speeds()):
            self._wheels[side] += duration * rim / self._world.values["wheels.radius"]
        if self._topics.clock is not None:
            self._topics.clock.publish(Clock(clock=ros.stamp(ros.imported, self._stamp)))
        self._publish(measured.pose, measured.detections)

    def _rim_speeds(self) -> list[float]:
        """Return the speeds of the rims of both wheels [m/s]."""
        encoders = self._robot.state.encoders
        track = self._world.problem.robot.limits.track_width or DEFAULT_TRACK
        return [encoders.linear + 0.5 * sign * track * encoders.angular for sign in (-1.0, 1.0)]

    @property
    def _stamp(self) -> float:
        return self._epoch + self._now

    @property
    def _charges(self) -> bool:
        since = self._contact_since
        return since is not None and self._now - since >= self._world.values["battery.delay"]

    # Publishing.

    def _publish(self, measured: Pose2 | None, detections: Sequence[Detection]) -> None:
        values, faults, topics, stamp = self._world.values, self._faults, self._topics, self._stamp
        odom = values["odom_frame"]
        transforms: list[Any] = []
        if self._is_due("localization", values["localization.rate"]) and measured is not None:
            later = stamp + values["localization.transform_tolerance"]
            if not faults["localization"]:
                transforms += transform_of(values["map_frame"], odom, measured @ self._odometry.inverse(), later)
        if self._is_due("odometry", values["odometry.rate"]):
            self._publish_motion(stamp)
            transforms += transform_of(odom, values["base_frame"], self._odometry, stamp)
        if transforms and not faults["transforms"]:
            topics.transforms.publish(TFMessage(transforms=transforms))
        for detection in () if faults["detections"] else detections:
            topics.detections.publish(self._detected(detection))
        if self._is_due("costmap", values["costmap.rate"]) and not faults["costmap"]:
            self._publish_costmap(odom, stamp)
        if self._is_due("report", REPORTS):
            topics.battery.publish(battery_state(values, stamp, charges=self._charges))
            self._publish_report(stamp)

    def _publish_motion(self, stamp: float) -> None:
        """Publish odometry, the true motion, and the joint states."""
        values, state = self._world.values, self._robot.state
        odom, base, make = values["odom_frame"], values["base_frame"], ros.odometry_message
        if not self._faults["odometry"]:
            message = make(ros.imported, self._odometry, self._measured_twist, odom, base, stamp)
            self._topics.odometry.publish(message)
        truth = make(ros.imported, state.pose, state.twist, values["map_frame"], base, stamp)
        self._topics.truth.publish(truth)
        self._topics.joints.publish(self._joint_states(stamp))

    def _is_due(self, name: str, rate: float) -> bool:
        """Whether it is time for the next message of a rate; never at rate 0."""
        if rate == 0.0:
            return False
        due = self._due.get(name, self._now)
        if self._now < due - 1e-6:
            return False
        self._due[name] = due + max(1.0, math.ceil((self._now - due) * rate + 1e-6)) / rate
        return True

    def _detected(self, detection: Detection) -> PoseStamped:
        """Return the pose of the marker in the camera's frame."""
        world, (position, rotation) = self._world, self._world.camera
        marker = detection.pose @ Pose2(world.gear * world.values["marker.distance"], 0.0, 0.0)
        into = about_z(marker.yaw + world.approach_yaw)
        back = (-rotation[0], -rotation[1], -rotation[2], rotation[3])
        offset = (marker.x - position[0], marker.y - position[1], world.values["marker.height"] - position[2])
        message = stamped(PoseStamped, self._epoch + self._began + detection.stamp, world.values["camera.frame"])
        place = message.pose.position
        place.x, place.y, place.z = rotated(back, offset)
        message.pose.orientation = quaternion(quaternion_product(back, quaternion_product(into, MARKER_FACES)))
        return message

    def _joint_states(self, stamp: float) -> JointState:
        values, rims = self._world.values, self._rim_speeds()
        pushing = math.copysign(values["wheels.stall_effort"], self._robot.state.target[0])
        return stamped(
            JointState,
            stamp,
            name=["left_wheel_joint", "right_wheel_joint"],
            position=list(self._wheels),
            velocity=[rim / values["wheels.radius"] for rim in rims],
            effort=[pushing if self._is_held else math.copysign(ROLLING_TORQUE, rim) if rim else 0.0 for rim in rims],
        )

    def _publish_costmap(self, frame: str, stamp: float) -> None:
        """Publish the outline and, like Nav2, the whole window after it has moved, otherwise the changed part."""
        values, here = self._world.values, self._odometry
        cell = float(values["costmap.resolution"])
        window = surroundings(
            self._seen.vertices, here, self._robot.state.pose, cell, round(values["costmap.size"] / cell)
        )
        before, self._window = self._window, window
        if before is None or before.origin != window.origin or before.data.shape != window.data.shape:
            self._topics.costmap.publish(ros.costmap_message(ros.imported, window, frame, stamp))
        else:
            middle = len(window.data) // 2  # the robot's own cell, which is cleared in every scan
            changed = np.concatenate((np.argwhere(before.data != window.data), [[middle, middle]]))
            (y, x), (y_end, x_end) = changed.min(axis=0).tolist(), (changed.max(axis=0) + 1).tolist()
            part = stamped(CostmapUpdate, stamp, frame, x=x, y=y, size_x=x_end - x, size_y=y_end - y)
            part.data.frombytes(window.data[y:y_end, x:x_end].tobytes())
            self._topics.costmap_updates.publish(part)
        outline = transform_points(here.as_array()[None], self._world.problem.robot.footprint.vertices)[0]
        self._topics.footprint.publish(ros.polygon_message(ros.imported, outline, frame, stamp))

    def _publish_report(self, stamp: float) -> None:
        poses = np.array([pose.as_array() for pose in self._poses])
        self._poses.clear()
        self._robot.forget()
        problem, error, state = self._world.problem, self._robot.error, self._robot.state
        if len(poses):
            outline = problem.robot.footprint
            to_obstacles = simulation.executed_clearance(outline, poses, problem.obstacles)
            to_station = simulation.executed_clearance(outline, poses, self._station)
            self._clearance = min(self._clearance, to_obstacles)
            self._station_clearance = min(self._station_clearance, to_station)
        collided, contact = self._clearance < 0.0, self._contact_since is not None
        values: dict[str, object] = {
            "time": self._now - self._began,
            "along": error.x,
            "cross": error.y,
            "yaw": error.yaw,
            "clearance": self._clearance,
            "station_clearance": self._station_clearance,
            "speed": state.twist.linear,
            "yaw_rate": state.twist.angular,
            "contact": contact,
            "charging": self._charges,
            "commands": self._commands,
            "watchdog_stops": self._watchdog_stops,
        }
        name = f"{self.node.get_fully_qualified_name().lstrip('/')}: the truth"
        text = "collided" if collided else "in contact" if contact else "free"
        make = ros.diagnostics_message
        self._topics.report.publish(make(ros.imported, name, "error" if collided else "ok", text, values, stamp))

    # Callbacks.

    def _on_command(self, twist: Twist) -> None:
        command = (twist.linear.x, twist.angular.z)
        if not all(math.isfinite(value) for value in command):
            self.node.get_logger().error(f"cmd_vel: not finite, {command}; used as a stop", throttle_duration_sec=1.0)
            command = (0.0, 0.0)
        with self._lock:
            self._command, self._commanded = Twist2(*command), self._now
            self._commands += 1

    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        try:
            world = SimulationParameters(self._values(()))
        except OptdockError as error:
            response.success, response.message = False, str(error)
            return response
        with self._lock:
            self._begin(world)
        response.success = True
        return response

    def _on_parameters(self, parameters: Sequence[Parameter[Any]]) -> SetParametersResult:
        try:
            world = SimulationParameters(self._values(parameters))
        except OptdockError as error:
            return SetParametersResult(successful=False, reason=str(error))
        self._faults = world.block("faults")
        return SetParametersResult(successful=True)

    def _values(self, changed: Sequence[Parameter[Any]]) -> dict[str, Any]:
        """Return the parameters of the simulation after changes."""
        found = {name: parameter.value for name, parameter in self.node.get_parameters_by_prefix("").items()}
        found |= {parameter.name: parameter.value for parameter in changed}
        return {
            name: list(value) if isinstance(PARAMETERS.get(name, ("",))[0], list) else value
            for name, value in found.items()
            if name.partition(".")[0] not in SHARED
        }


def camera_transform(world: SimulationParameters, stamp: float) -> TransformStamped:
    """Return the transform from the base to the camera."""
    values, (position, rotation) = world.values, world.camera
    message = stamped(TransformStamped, stamp, values["base_frame"], child_frame_id=values["camera.frame"])
    shift = message.transform.translation
    shift.x, shift.y, shift.z = position
    message.transform.rotation = quaternion(rotation)
    return message


def battery_state(values: Mapping[str, Any], stamp: float, *, charges: bool) -> BatteryState:
    """Return the state of the battery with the current of the parameters."""
    message = stamped(BatteryState, stamp, present=True, voltage=24.0, percentage=CHARGED)
    name, status = "battery.idle_current", BatteryState.POWER_SUPPLY_STATUS_DISCHARGING
    if charges:
        name, status = "battery.charging_current", BatteryState.POWER_SUPPLY_STATUS_CHARGING
    message.current, message.power_supply_status = float(values[name]), status
    return message


def surroundings(outlines: FloatArray, here: Pose2, true: Pose2, cell: float, side: int) -> Grid:
    """Return the obstacles that are seen from the true pose, in a window around the pose of the odometry.

    Args:
        outlines: Polygons in the frame of the true pose, shape (m, k, 2) [m].
        here: Pose of the robot by the odometry.
        true: True pose.
        cell: Side length of a cell [m].
        side: Cells per side of the window.
    """
    corner = math.floor(here.x / cell) - side // 2, math.floor(here.y / cell) - side // 2
    cells = np.zeros((side, side), dtype=np.uint8)
    if len(outlines):
        believed = here @ true.inverse()
        seen = transform_points(believed.as_array()[None], outlines.reshape(-1, 2))[0].reshape(outlines.shape)
        columns, rows = (np.floor(points_along(seen, cell) / cell).astype(int) - corner).T
        inside = (columns >= 0) & (columns < side) & (rows >= 0) & (rows < side)
        cells[rows[inside], columns[inside]] = LETHAL
    return Grid(cells, cell, (corner[0] * cell, corner[1] * cell))


def points_along(outlines: FloatArray, step: float) -> FloatArray:
    """Return points on the edges of polygons, shape (n, 2), that are dense enough for cells of size `step`.

    Args:
        outlines: Shape (m, k, 2) [m].
        step: Size of the cells [m].
    """
    begins = outlines.reshape(-1, 2)
    ways = np.roll(outlines, -1, axis=1).reshape(-1, 2) - begins
    counts = np.maximum(1, np.ceil(4.0 * np.hypot(*ways.T) / step).astype(int))  # points a quarter of a cell apart
    shares = np.concatenate([np.arange(count) / count for count in counts.tolist()])
    found: FloatArray = np.repeat(begins, counts, axis=0) + shares[:, None] * np.repeat(ways, counts, axis=0)
    return found


def stamped(kind: Any, stamp: float, frame: str = "", **fields: object) -> Any:
    """Return a message of a type with a header."""
    message = kind(**fields)
    message.header.stamp, message.header.frame_id = ros.stamp(ros.imported, stamp), frame
    return message


def quaternion(rotation: Rotation) -> Quaternion:
    """Return a rotation (x, y, z, w) as a message."""
    return Quaternion(**dict(zip("xyzw", rotation, strict=True)))


def transform_of(frame: str, child: str, pose: Pose2, stamp: float) -> list[Any]:
    """Return a list with one TransformStamped."""
    message: TFMessage = ros.transforms_message(ros.imported, [(frame, child, pose)], stamp)
    return list(message.transforms)


def markers(obstacles: ObstacleSet, frame: str, stamp: float) -> MarkerArray:
    """Return the outlines of obstacles; all previous markers are deleted."""
    found = [stamped(Marker, stamp, frame, action=Marker.DELETEALL)]
    for number, outline in enumerate(obstacles.vertices):
        marker = stamped(Marker, stamp, frame, ns="obstacles", id=number, type=Marker.LINE_STRIP, action=Marker.ADD)
        marker.pose.orientation.w, marker.scale.x = 1.0, 0.01
        marker.color.r, marker.color.a = 0.8, 1.0
        marker.points = [Point(x=x, y=y, z=0.0) for x, y in [*outline.tolist(), outline[0].tolist()]]
        found.append(marker)
    return MarkerArray(markers=found)


def main() -> None:
    """Run the console script."""
    rclpy.init()
    try:
        robot = SimulatedRobotNode()
    except OptdockError as error:
        rclpy.try_shutdown()
        sys.exit(f"simulated_robot: {error}")
    executor = SingleThreadedExecutor()
    executor.add_node(robot.node)
    try:
        executor.spin()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        robot.end()
        executor.shutdown()
        rclpy.try_shutdown()
    sys.exit(1 if robot.failed else 0)
