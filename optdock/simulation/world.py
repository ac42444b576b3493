"""A robot in a simulated world: a command goes in, what the sensors say comes out, and all of it is recorded."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from optdock.errors import InvalidValue
from optdock.geometry.arrays import FloatArray, FrozenArrays
from optdock.geometry.checked import member
from optdock.geometry.pose import Pose2, Twist2
from optdock.model.dock import DockDirection
from optdock.model.measurements import Measurements
from optdock.simulation.plant import check_not_negative, check_seed
from optdock.simulation.run import executed_clearance
from optdock.simulation.sensors import DockSensor, Odometry, PoseSensor

if TYPE_CHECKING:
    from optdock.geometry.obstacles import ObstacleSet
    from optdock.model.costmap import Costmap
    from optdock.model.measurements import Detection
    from optdock.simulation.plant import Plant

__all__ = ["Record", "Sensors", "SimulatedRobot", "Station"]

_TOUCHING = 1e-9  # [m]: rounding of a pose moved to the stop


@dataclass(frozen=True)
class Sensors:
    """What the robot carries; perfect by default, and without a detector of docks.

    Args:
        pose: Localization.
        odometry: Of the wheels.
        dock: Detector; None: none.
    """

    pose: PoseSensor = field(default_factory=PoseSensor)
    odometry: Odometry = field(default_factory=Odometry)
    dock: DockSensor | None = None


@dataclass(frozen=True)
class Station:
    """A dock that stops the robot and tells contact; geometry only, no forces.

    The stop is a plane across the dock's axis. It holds a robot that drives against it; what comes from the side or
    from behind passes, and is a collision with the station's outline if that is among the obstacles.

    Args:
        direction: Gear of the last motion, forward or backward.
        depth: How much deeper than docked the robot can be driven [m].
        half_width: Farther than this beside the axis there is no stop [m].
        switch_travel: Contact is told from this far before the stop [m].
        switch_cross: And within this beside the axis [m].
        switch_yaw: And within this heading error [rad].
        stalls: Whether the wheels stand still against the stop (weak motors), or slip: odometry then goes on.

    Raises:
        InvalidValue: Not forward or backward, or a length or angle is not a number, negative or not finite.
    """

    direction: DockDirection = DockDirection.FORWARD
    depth: float = 0.0
    half_width: float = 0.15
    switch_travel: float = 0.003
    switch_cross: float = 0.02
    switch_yaw: float = 0.1
    stalls: bool = True

    def __post_init__(self) -> None:
        object.__setattr__(self, "direction", member(DockDirection, self.direction, "station.direction"))
        if self.direction is DockDirection.AUTO:
            raise InvalidValue("station.direction: must be forward or backward, got auto")
        keys = ("depth", "half_width", "switch_travel", "switch_cross", "switch_yaw")
        check_not_negative(self, "station", keys)

    @property
    def stop(self) -> Pose2:
        """The farthest that the robot can be driven straight in, seen from the docked pose."""
        return Pose2(self.depth if self.direction is DockDirection.FORWARD else -self.depth, 0.0, 0.0)

    def past(self, pose: Pose2) -> float:
        """How far beyond the stop the robot is [m], seen from the docked pose; negative before it."""
        return (pose.x if self.direction is DockDirection.FORWARD else -pose.x) - self.depth

    def touched(self, pose: Pose2) -> bool:
        """Whether the switch is closed, seen from the docked pose."""
        aligned = abs(pose.y) <= self.switch_cross and abs(pose.yaw) <= self.switch_yaw
        return aligned and abs(self.past(pose)) <= self.switch_travel + _TOUCHING


@dataclass(frozen=True, eq=False)
class Record(FrozenArrays):
    """What happened; row k is the state at `times[k]` and the command given there.

    Attributes:
        times: Shape (n,) [s].
        poses: True poses, Shape (n, 3).
        twists: True body velocities: linear, angular, lateral, Shape (n, 3) [m/s, rad/s, m/s].
        commands: Linear and angular, Shape (n, 2) [m/s, rad/s]; zero in the last row.
        measured: Poses as measured, Shape (n, 3); NaN where there was none.
        odometry: Linear and angular as measured, Shape (n, 2) [m/s, rad/s].
        docks: True poses of the docked robot, Shape (n, 3).
        contact: What the switch said, Shape (n,); False where there is none.
        detections: As they were delivered.
        delivered: When, a time for each detection, Shape (m,) [s].
    """

    times: FloatArray
    poses: FloatArray
    twists: FloatArray
    commands: FloatArray
    measured: FloatArray
    odometry: FloatArray
    docks: FloatArray
    contact: np.ndarray[tuple[int], np.dtype[np.bool_]]
    detections: tuple[Detection, ...]
    delivered: FloatArray


class SimulatedRobot:
    """A plant, its sensors and a dock, on one clock that begins at 0.

    Each sensor has a random stream of its own: switching one off changes nothing in the others. The fixed frame is that
    of `start`, `dock_pose` and the obstacles; where the *stored* dock is, only the planner knows.

    Args:
        plant: What drives.
        start: True pose of the robot.
        dock_pose: True pose of the docked robot; may be set at any time to move the dock.
        sensors: What it measures with.
        obstacles: What it must not touch, the station's outline included.
        station: Stop and contact switch of the dock; None: neither, and contact is what the plant says of it.
        seed: Of the sensors' noise (a plant's slip has its own).
        start_twist: Steady body velocity in which the robot begins.

    Attributes:
        time: [s].
        state: Of the plant, true.
        dock_pose: See above.
        measurements: The latest.
        pose_sensor: For faults at a place instead of a time: `jump`.
        dock_sensor: Likewise `lose` and `displace_next`; None without a detector.

    Raises:
        InvalidValue: The seed is not a whole number >= 0.
    """

    def __init__(  # noqa: PLR0913 - one parameter for each part of the world
        self,
        plant: Plant,
        start: Pose2,
        dock_pose: Pose2,
        sensors: Sensors | None = None,
        obstacles: ObstacleSet | None = None,
        *,
        station: Station | None = None,
        seed: int = 0,
        start_twist: Twist2 | None = None,
    ) -> None:
        check_seed(seed, "world.seed")
        sensors = sensors or Sensors()
        self.plant, self.dock_pose, self.station = plant, dock_pose, station
        pose_seed, odometry_seed, dock_seed = np.random.SeedSequence(seed).spawn(3)
        self.pose_sensor = sensors.pose.reader(pose_seed)
        self.odometry = sensors.odometry.reader(odometry_seed)
        self.dock_sensor = None if sensors.dock is None else sensors.dock.reader(dock_seed)
        self.time = 0.0
        self.state = plant.moving(start, start_twist or Twist2())
        self._obstacles = [] if obstacles is None else [(0, obstacles)]
        self._costmap: Costmap | None = None
        self._rows: list[tuple[float, ...]] = []
        self._commands: list[tuple[float, float]] = []
        self._detections: list[tuple[float, Detection]] = []
        self.measurements = self._measure(0.0)

    def advance(self, command: Twist2, duration: float) -> Measurements:
        """Give a command, let `duration` [s] pass, and measure.

        Raises:
            InvalidValue: The duration is not finite and > 0.
        """
        before = self.state
        self.state = self.plant.step(before, command, duration)
        self.time += duration
        if self.station is not None:
            self._stop(before.pose, self.station)
        self._commands.append((command.linear, command.angular))
        self.measurements = self._measure(duration)
        return self.measurements

    def put(self, obstacles: ObstacleSet, costmap: Costmap | None = None) -> None:
        """Put obstacles into the world now; the next measurements show `costmap`."""
        self._obstacles.append((len(self._rows), obstacles))
        self._costmap = costmap or self._costmap

    @property
    def error(self) -> Pose2:
        """The robot seen from the docked pose, both true: along, cross [m] and yaw [rad]."""
        return self.state.pose.in_frame_of(self.dock_pose)

    def clearance(self) -> float:
        """Smallest signed distance of the true footprint and an obstacle so far [m], exact at the recorded poses."""
        poses = np.array([row[1:4] for row in self._rows])
        footprint = self.plant.robot.footprint
        found = (executed_clearance(footprint, poses[since:], those) for since, those in self._obstacles)
        return min((value for value in found), default=math.inf)

    def record(self) -> Record:
        """All until now."""
        rows = np.array(self._rows, dtype=np.float64)
        commands = np.array([*self._commands, (0.0, 0.0)], dtype=np.float64)
        delivered = np.array([time for time, _ in self._detections], dtype=np.float64)
        times, poses, twists, measured, odometry, docks, contact = np.split(rows, [1, 4, 7, 10, 12, 15], axis=1)
        return Record(
            times[:, 0],
            poses,
            twists,
            commands,
            measured,
            odometry,
            docks,
            contact[:, 0] > 0.0,
            tuple(detection for _, detection in self._detections),
            delivered,
        )

    def forget(self) -> None:
        """Drop what was recorded until now, so that a world may go on for days; `clearance` too begins anew."""
        self._rows = self._rows[-1:]
        self._commands.clear()
        self._detections.clear()
        self._obstacles = [(0, obstacles) for _, obstacles in self._obstacles[-1:]]

    def _stop(self, before: Pose2, station: Station) -> None:
        """Hold the robot where it has driven against the stop."""
        there = self.error
        beyond = station.past(there)
        if beyond <= 0.0 or abs(there.y) > station.half_width:
            return
        here = before.in_frame_of(self.dock_pose)
        ahead = -station.past(here)
        if ahead >= -_TOUCHING:
            share = max(ahead, 0.0) / (max(ahead, 0.0) + beyond)
            held = self.dock_pose @ Pose2(station.stop.x, here.y + share * (there.y - here.y), 0.0)
            yaw = before.yaw + share * (self.state.pose.yaw - before.yaw)
            held = Pose2(held.x, held.y, yaw)
            self.state = self.plant.stopped(self.state, held, stalled=station.stalls)

    def _measure(self, duration: float) -> Measurements:
        state, dock = self.state, self.dock_pose
        true, twist = state.pose, state.twist
        pose = self.pose_sensor.measure(self.time, true)
        odometry = self.odometry.measure(state.encoders, duration)
        detections = () if self.dock_sensor is None else self.dock_sensor.measure(self.time, true, dock)
        contact = state.contact if self.station is None else self.station.touched(self.error)
        told = (math.nan, math.nan, math.nan) if pose is None else (pose.x, pose.y, pose.yaw)
        motion = (true.x, true.y, true.yaw, twist.linear, twist.angular, twist.lateral)
        rest = (odometry.linear, odometry.angular, dock.x, dock.y, dock.yaw, float(bool(contact)))
        self._rows.append((self.time, *motion, *told, *rest))
        self._detections.extend((self.time, detection) for detection in detections)
        costmap, self._costmap = self._costmap, None
        return Measurements(self.time, pose, odometry, detections, contact, costmap)
