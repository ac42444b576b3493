"""`simulated_robot`: a robot before its dock behind the topics of a real one, to try the servers without one.

Drive, sensors and station are those of `optdock.simulation`; the world is a scenario file. What a base, a localization,
a detector of docks and Nav2's local costmap would publish is published here, with noise, latency and drop-outs:

    cmd_vel                               in   TwistStamped, or Twist; a command is good for `command_timeout`
    odom                                  out  Odometry: encoders, summed up; it drifts
    /tf                                   out  odom -> base_link, and map -> odom by localization
    /tf_static                            out  base_link -> camera
    detected_dock_pose                    out  PoseStamped: the dock's marker in the camera's frame, when it was seen
    battery_state, joint_states           out  the current flows in contact; wheels stall at the stop
    local_costmap/costmap_raw             out  Costmap: a window around the robot, whole when it has moved on by a cell
    local_costmap/costmap_raw_updates     out  CostmapUpdate: else what has changed
    local_costmap/published_footprint     out  PolygonStamped: the outline where odometry believes it is
    ~/truth                               out  Odometry: the true pose in the map, the true velocity
    ~/report                              out  DiagnosticArray: errors at the dock, clearance, contact, commands
    ~/obstacles                           out  MarkerArray
    ~/reset                               srv  Trigger: the world anew, by the parameters as they are then
    /clock                                out  Clock, where `speed` is not 0

`simulation_parameters` lists the parameters; those of `faults` act at once, all others at the next `~/reset`.
"""

from __future__ import annotations

import math
import sys
import threading
import time
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import rclpy
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import (
    Point,
    Point32,
    PolygonStamped,
    Pose,
    PoseStamped,
    Quaternion,
    TransformStamped,
    Twist,
    TwistStamped,
)
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

from optdock import simulation
from optdock.errors import OptdockError
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import Pose2, Twist2, arc_end, transform_points
from optdock.model.costs import LETHAL
from optdock.ros.transforms import quaternion_product, rotated
from optdock_ros.simulation_parameters import PARAMETERS, SimulationParameters, about_z

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rclpy.parameter import Parameter

    from optdock.geometry.arrays import FloatArray
    from optdock.model.measurements import Detection
    from optdock.ros.transforms import Quaternion as Rotation

__all__ = ["SimulatedRobotNode", "main"]

SHARED = ("use_sim_time", "start_type_description_service", "qos_overrides")  # every node of rclpy has these
CATCH_UP = 0.25  # [s]: a loop that is later than this was suspended; what it missed is not driven
REPORTS = 10.0  # [Hz]
DEFAULT_TRACK = 0.4  # [m], where the scenario's limits name none
CHARGED = 0.8  # [1], what the battery says of itself
ROLLING_TORQUE = 0.3  # [N m] of a wheel that is not held
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
MARKER_FACES = (0.5, -0.5, -0.5, 0.5)  # z out of the dock, y up, x to the right as the camera sees it


class LocalWindow(NamedTuple):
    """The local costmap as it was last published: its lower corner in cells, and its cells."""

    corner: tuple[int, int]
    cells: np.ndarray[Any, np.dtype[np.uint8]]


class Topics:
    """Everything that is published."""

    def __init__(self, node: Node, *, has_clock: bool) -> None:
        latest = QoSProfile(depth=1)
        self.transforms = node.create_publisher(TFMessage, "/tf", 100)
        self.static_transforms = node.create_publisher(TFMessage, "/tf_static", LATCHED)
        self.odometry = node.create_publisher(Odometry, "odom", 10)
        self.detections = node.create_publisher(PoseStamped, "detected_dock_pose", 10)
        self.battery = node.create_publisher(BatteryState, "battery_state", latest)
        self.joints = node.create_publisher(JointState, "joint_states", 10)
        self.costmap = node.create_publisher(Costmap, "local_costmap/costmap_raw", LATCHED)
        self.costmap_updates = node.create_publisher(CostmapUpdate, "local_costmap/costmap_raw_updates", LATCHED)
        self.footprint = node.create_publisher(PolygonStamped, "local_costmap/published_footprint", latest)
        self.truth = node.create_publisher(Odometry, "~/truth", 10)
        self.report = node.create_publisher(DiagnosticArray, "~/report", 10)
        self.obstacles = node.create_publisher(MarkerArray, "~/obstacles", LATCHED)
        self.clock = node.create_publisher(Clock, "/clock", latest) if has_clock else None


class SimulatedRobotNode:
    """The node; see the module. Its world goes on in a thread of its own until `end`.

    Raises:
        OptdockError: A parameter is wrong; the message says which.
    """

    def __init__(self) -> None:
        self.node = Node("simulated_robot", automatically_declare_parameters_from_overrides=True)
        for name, (default, description) in PARAMETERS.items():
            if not self.node.has_parameter(name):
                about = ParameterDescriptor(description=description, dynamic_typing=True)
                self.node.declare_parameter(name, default, about)
        self._lock = threading.Lock()
        self._ended = threading.Event()
        self.failed = False
        world = SimulationParameters(self._values(()))
        self._faults = world.block("faults")
        self._topics = Topics(self.node, has_clock=world.values["speed"] > 0.0)
        self._now = 0.0  # [s] since the node began
        self._odometry = Pose2(0.0, 0.0, 0.0)
        self._wheels = [0.0, 0.0]  # [rad]
        # A clock of its own does not begin at 0, which many take for "no time yet".
        self._epoch = 1000.0 if self._topics.clock else 1e-9 * self.node.get_clock().now().nanoseconds
        self._begin(world)
        self.node.create_service(Trigger, "~/reset", self._on_reset)
        latest = QoSProfile(depth=1)
        if world.values["enable_stamped_cmd_vel"]:
            self.node.create_subscription(TwistStamped, "cmd_vel", lambda told: self._on_command(told.twist), latest)
        else:
            self.node.create_subscription(Twist, "cmd_vel", self._on_command, latest)
        self.node.add_on_set_parameters_callback(self._on_parameters)
        self._thread = threading.Thread(target=self._run, name="world")
        self._thread.start()

    def end(self) -> None:
        """The world stops; returns when its thread has."""
        self._ended.set()
        self._thread.join()

    # The world

    def _begin(self, world: SimulationParameters) -> None:
        """The robot at its start; odometry goes on, as that of a robot which is lifted and put elsewhere."""
        self._world, self._robot = world, world.robot()
        self._began = self._now
        self._command, self._commanded, self._commands, self._watchdog_stops = Twist2(), -math.inf, 0, 0
        self._is_held = False
        self._contact_since: float | None = None
        self._measured_twist = Twist2()
        self._window: LocalWindow | None = None
        self._station = world.station()
        self._poses = [self._robot.state.pose]
        self._clearance, self._station_clearance = math.inf, math.inf
        self._due: dict[str, float] = {}
        solid = world.problem.obstacles + self._station
        self._seen = solid if world.values["costmap.station"] else world.problem.obstacles
        stamp = self._stamp(self._now)
        self._topics.obstacles.publish(markers(solid, world.values["map_frame"], stamp))
        base, (position, rotation) = world.values["base_frame"], world.camera
        camera = transform(stamp, base, world.values["camera.frame"], position, rotation)
        self._topics.static_transforms.publish(TFMessage(transforms=[camera]))

    def _run(self) -> None:
        """One step after the other, at their times; an error ends the process, for a world that stands still lies."""
        period = 1.0 / self._world.values["rate"]
        pace = self._world.values["speed"] or 1.0
        origin, ticks = time.monotonic(), 0
        if self._topics.clock is None:  # what it took to come here would be how old every stamp is
            self._epoch = 1e-9 * self.node.get_clock().now().nanoseconds
        try:
            while not self._ended.is_set():
                pause = origin + (ticks + 1) * period / pace - time.monotonic()
                if pause > 0.0:
                    self._ended.wait(pause)
                late = max(0, math.floor(-pause * pace / period))
                if self._topics.clock is not None or late * period > CATCH_UP:
                    skipped, late = late * period, 0
                    origin += skipped / pace  # a clock of its own waits for a busy machine
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
        told = self._robot.advance(command, duration)
        self._now += duration
        before, self._measured_twist = self._measured_twist, told.twist
        mean = (0.5 * (before.linear + told.twist.linear), 0.5 * (before.angular + told.twist.angular), 0.0)
        self._odometry = Pose2(*arc_end(self._odometry.x, self._odometry.y, self._odometry.yaw, mean, duration))
        state = self._robot.state
        self._poses.append(state.pose)
        self._is_held = state.encoders == Twist2() and state.target != (0.0, 0.0) and bool(told.contact)
        self._contact_since = None if not told.contact else self._contact_since or self._now
        track = self._world.problem.robot.limits.track_width or DEFAULT_TRACK
        for side, sign in ((0, -1.0), (1, 1.0)):
            rim = state.encoders.linear + 0.5 * sign * track * state.encoders.angular
            self._wheels[side] += duration * rim / self._world.values["wheels.radius"]
        self._publish(told.pose, told.detections)

    # What it says

    def _publish(self, measured: Pose2 | None, detections: Sequence[Detection]) -> None:
        values, faults, stamp = self._world.values, self._faults, self._stamp(self._now)
        if self._topics.clock is not None:
            self._topics.clock.publish(Clock(clock=stamp))
        transforms = []
        if self._is_due("localization", values["localization.rate"]) and measured is not None:
            transforms += [] if faults["localization"] else [self._localized(measured)]
        if self._is_due("odometry", values["odometry.rate"]):
            transforms.append(self._publish_motion(stamp))
        if transforms and not faults["transforms"]:
            self._topics.transforms.publish(TFMessage(transforms=transforms))
        for detection in () if faults["detections"] else detections:
            self._topics.detections.publish(self._detected(detection))
        if self._is_due("costmap", values["costmap.rate"]) and not faults["costmap"]:
            self._publish_costmap(stamp)
        if self._is_due("report", REPORTS):
            self._topics.battery.publish(self._battery_state(stamp))
            self._publish_report(stamp)

    def _localized(self, measured: Pose2) -> TransformStamped:
        """Where odometry began, as localization has it."""
        values, offset = self._world.values, measured @ self._odometry.inverse()
        later = self._stamp(self._now + values["localization.transform_tolerance"])
        frames = values["map_frame"], values["odom_frame"]
        return transform(later, *frames, (offset.x, offset.y, 0.0), about_z(offset.yaw))

    def _publish_motion(self, stamp: Time) -> TransformStamped:
        """Everything that goes at the rate of odometry; its transform is returned."""
        values, state, here = self._world.values, self._robot.state, self._odometry
        odom, base = values["odom_frame"], values["base_frame"]
        if not self._faults["odometry"]:
            self._topics.odometry.publish(odometry(stamp, odom, base, here, self._measured_twist))
        self._topics.truth.publish(odometry(stamp, values["map_frame"], base, state.pose, state.twist))
        self._topics.joints.publish(self._joint_states(stamp))
        return transform(stamp, odom, base, (here.x, here.y, 0.0), about_z(here.yaw))

    def _is_due(self, name: str, rate: float) -> bool:
        """Whether it is time for the next message of a rate; never at rate 0."""
        if rate == 0.0:
            return False
        due = self._due.get(name, self._now)
        if self._now < due - 1e-6:
            return False
        self._due[name] = due + max(1.0, math.ceil((self._now - due) * rate + 1e-6)) / rate
        return True

    def _stamp(self, seconds: float) -> Time:
        whole, nanoseconds = divmod(round(1e9 * (self._epoch + seconds)), 1_000_000_000)
        return Time(sec=whole, nanosec=nanoseconds)

    def _detected(self, detection: Detection) -> PoseStamped:
        """The marker where the camera has it."""
        world = self._world
        marker = detection.pose @ Pose2(world.gear * world.values["marker.distance"], 0.0, 0.0)
        into = about_z(marker.yaw + (0.0 if world.gear > 0.0 else math.pi))
        position, rotation = world.camera
        back = (-rotation[0], -rotation[1], -rotation[2], rotation[3])
        seen = rotated(
            back,
            (marker.x - position[0], marker.y - position[1], world.values["marker.height"] - position[2]),
        )
        message = PoseStamped()
        message.header.stamp = self._stamp(self._began + detection.stamp)
        message.header.frame_id = world.values["camera.frame"]
        message.pose = pose_message(seen, quaternion_product(back, quaternion_product(into, MARKER_FACES)))
        return message

    def _joint_states(self, stamp: Time) -> JointState:
        state, values = self._robot.state, self._world.values
        track = self._world.problem.robot.limits.track_width or DEFAULT_TRACK
        rims = [state.encoders.linear + 0.5 * sign * track * state.encoders.angular for sign in (-1.0, 1.0)]
        pushing = math.copysign(values["wheels.stall_effort"], state.target[0])
        efforts = [pushing if self._is_held else math.copysign(ROLLING_TORQUE, rim) if rim else 0.0 for rim in rims]
        message = JointState(
            name=["left_wheel_joint", "right_wheel_joint"], position=list(self._wheels), effort=efforts
        )
        message.header.stamp = stamp
        message.velocity = [rim / values["wheels.radius"] for rim in rims]
        return message

    def _battery_state(self, stamp: Time) -> BatteryState:
        block, charges = self._world.block("battery"), _charges(self._contact_since, self._now, self._world)
        message = BatteryState(present=True, voltage=24.0, percentage=CHARGED)
        message.header.stamp = stamp
        message.current = float(block["charging_current"] if charges else block["idle_current"])
        discharging, charging = BatteryState.POWER_SUPPLY_STATUS_DISCHARGING, BatteryState.POWER_SUPPLY_STATUS_CHARGING
        message.power_supply_status = charging if charges else discharging
        return message

    def _publish_costmap(self, stamp: Time) -> None:
        """As Nav2 does: the whole window where its place has changed, else the part that has; and the outline."""
        values, here = self._world.values, self._odometry
        frame, cell = values["odom_frame"], float(values["costmap.resolution"])
        window = self._surroundings(cell, round(values["costmap.size"] / cell))
        before, self._window = self._window, window
        side = len(window.cells)
        if before is None or before.corner != window.corner or before.cells.shape != window.cells.shape:
            whole = Costmap()
            whole.header.stamp, whole.header.frame_id = stamp, frame
            whole.metadata.layer, whole.metadata.resolution, whole.metadata.update_time = "master", cell, stamp
            whole.metadata.size_x = whole.metadata.size_y = side
            lower = whole.metadata.origin.position
            lower.x, lower.y = (cell * number for number in window.corner)
            whole.data.frombytes(window.cells.tobytes())
            self._topics.costmap.publish(whole)
        else:
            # At least the robot's own cell: a scanner clears it every time.
            changed = np.concatenate((np.argwhere(before.cells != window.cells), [[side // 2, side // 2]]))
            (y, x), (y_end, x_end) = changed.min(axis=0).tolist(), (changed.max(axis=0) + 1).tolist()
            part = CostmapUpdate(x=x, y=y, size_x=x_end - x, size_y=y_end - y)
            part.header.stamp, part.header.frame_id = stamp, frame
            part.data.frombytes(window.cells[y:y_end, x:x_end].tobytes())
            self._topics.costmap_updates.publish(part)
        outline = PolygonStamped()
        outline.header.stamp, outline.header.frame_id = stamp, frame
        placed = transform_points(here.as_array()[None], self._world.problem.robot.footprint.vertices)[0]
        outline.polygon.points = [Point32(x=x, y=y) for x, y in placed.tolist()]
        self._topics.footprint.publish(outline)

    def _surroundings(self, cell: float, side: int) -> LocalWindow:
        """What a scanner sees, from where the robot truly is, where odometry believes it."""
        here, outlines = self._odometry, self._seen.vertices
        corner = math.floor(here.x / cell) - side // 2, math.floor(here.y / cell) - side // 2
        cells = np.zeros((side, side), dtype=np.uint8)
        if len(outlines):
            believed = here @ self._robot.state.pose.inverse()
            seen = transform_points(believed.as_array()[None], outlines.reshape(-1, 2))[0].reshape(outlines.shape)
            columns, rows = (np.floor(points_along(seen, cell) / cell).astype(int) - corner).T
            inside = (columns >= 0) & (columns < side) & (rows >= 0) & (rows < side)
            cells[rows[inside], columns[inside]] = LETHAL
        return LocalWindow(corner, cells)

    def _publish_report(self, stamp: Time) -> None:
        poses = np.array([pose.as_array() for pose in self._poses])
        self._poses.clear()
        self._robot.forget()
        outline, problem = self._world.problem.robot.footprint, self._world.problem
        if len(poses):
            found = simulation.executed_clearance(outline, poses, problem.obstacles)
            self._clearance = min(self._clearance, found)
            found = simulation.executed_clearance(outline, poses, self._station)
            self._station_clearance = min(self._station_clearance, found)
        error, state = self._robot.error, self._robot.state
        collided = self._clearance < 0.0
        values = {
            "time": self._now - self._began,
            "along": error.x,
            "cross": error.y,
            "yaw": error.yaw,
            "clearance": self._clearance,
            "station_clearance": self._station_clearance,
            "speed": state.twist.linear,
            "yaw_rate": state.twist.angular,
            "contact": self._contact_since is not None,
            "charging": self._contact_since is not None
            and self._now - self._contact_since >= self._world.values["battery.delay"],
            "commands": self._commands,
            "watchdog_stops": self._watchdog_stops,
        }
        status = DiagnosticStatus(
            level=DiagnosticStatus.ERROR if collided else DiagnosticStatus.OK,
            name=f"{self.node.get_name()}: the truth",
            message="collided" if collided else "in contact" if values["contact"] else "free",
            values=[KeyValue(key=key, value=repr(value)) for key, value in values.items()],
        )
        message = DiagnosticArray(status=[status])
        message.header.stamp = stamp
        self._topics.report.publish(message)

    # What it is told

    def _on_command(self, twist: Twist) -> None:
        command = (twist.linear.x, twist.angular.z)
        if not all(math.isfinite(value) for value in command):
            self.node.get_logger().error(f"cmd_vel: not finite, {command}: taken for a stop", throttle_duration_sec=1.0)
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
        """All parameters but those of every node, some of them about to change."""
        found = {name: parameter.value for name, parameter in self.node.get_parameters_by_prefix("").items()}
        found |= {parameter.name: parameter.value for parameter in changed}
        ours = {name: value for name, value in found.items() if name.partition(".")[0] not in SHARED}
        return {
            name: list(value) if isinstance(PARAMETERS.get(name, ("",))[0], list) else value
            for name, value in ours.items()
        }


def _charges(contact_since: float | None, now: float, world: SimulationParameters) -> bool:
    """Whether the charger has been in contact for so long that its current flows."""
    return contact_since is not None and now - contact_since >= world.values["battery.delay"]


def points_along(outlines: FloatArray, step: float) -> FloatArray:
    """Points on the edges of polygons, close enough that no cell of size `step` that an edge crosses is left out.

    Args:
        outlines: Shape (m, k, 2) [m].
        step: [m].
    """
    begins = outlines.reshape(-1, 2)
    ways = np.roll(outlines, -1, axis=1).reshape(-1, 2) - begins
    # A quarter of a cell: an edge that cuts off less than that of a corner is not seen by a scanner either.
    counts = np.maximum(1, np.ceil(4.0 * np.hypot(*ways.T) / step).astype(int))
    shares = np.concatenate([np.arange(count) / count for count in counts.tolist()])
    found: FloatArray = np.repeat(begins, counts, axis=0) + shares[:, None] * np.repeat(ways, counts, axis=0)
    return found


def pose_message(position: Sequence[float], rotation: Rotation) -> Pose:
    """A pose from numbers."""
    x, y, z = position
    return Pose(
        position=Point(x=x, y=y, z=z),
        orientation=Quaternion(x=rotation[0], y=rotation[1], z=rotation[2], w=rotation[3]),
    )


def transform(stamp: Time, frame: str, child: str, position: Sequence[float], rotation: Rotation) -> TransformStamped:
    """A transform from numbers."""
    message = TransformStamped(child_frame_id=child)
    message.header.stamp, message.header.frame_id = stamp, frame
    shift = message.transform.translation
    shift.x, shift.y, shift.z = position
    x, y, z, w = rotation
    message.transform.rotation = Quaternion(x=x, y=y, z=z, w=w)
    return message


def odometry(stamp: Time, frame: str, child: str, pose: Pose2, twist: Twist2) -> Odometry:
    """Pose and body velocity."""
    message = Odometry(child_frame_id=child)
    message.header.stamp, message.header.frame_id = stamp, frame
    message.pose.pose = pose_message((pose.x, pose.y, 0.0), about_z(pose.yaw))
    message.twist.twist.linear.x, message.twist.twist.linear.y = twist.linear, twist.lateral
    message.twist.twist.angular.z = twist.angular
    return message


def markers(obstacles: ObstacleSet, frame: str, stamp: Time) -> MarkerArray:
    """The outlines of obstacles, after everything that was there before is gone."""
    found = [Marker(action=Marker.DELETEALL)]
    for number, outline in enumerate(obstacles.vertices):
        marker = Marker(ns="obstacles", id=number, type=Marker.LINE_STRIP, action=Marker.ADD)
        marker.header.frame_id, marker.header.stamp = frame, stamp
        marker.pose.orientation.w, marker.scale.x = 1.0, 0.01
        marker.color.r, marker.color.a = 0.8, 1.0
        marker.points = [Point(x=x, y=y, z=0.0) for x, y in [*outline.tolist(), outline[0].tolist()]]
        found.append(marker)
    found[0].header.frame_id = frame
    return MarkerArray(markers=found)


def main() -> None:
    """Until ctrl-C."""
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
