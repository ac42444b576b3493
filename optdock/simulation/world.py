"""Simulated robot, which receives commands and returns measurements, with a record of all values."""

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
from optdock.simulation.sensors import DockSensor, Odometry, PoseSensor
from optdock.verification import pose_clearances

if TYPE_CHECKING:
    from optdock.geometry.footprint import Footprint
    from optdock.geometry.obstacles import ObstacleSet
    from optdock.model.costmap import Costmap
    from optdock.model.measurements import Detection
    from optdock.simulation.plant import Plant

__all__ = ["Record", "Sensors", "SimulatedRobot", "Station", "executed_clearance"]

_TOUCHING = 1e-9  # [m]: rounding of a pose moved to the stop
_BLOCK = 256  # poses per round, which bounds the memory


@dataclass(frozen=True)
class Sensors:
    """Sensors of a robot; by default perfect, without a detector of the dock.

    Args:
        pose: Localization.
        odometry: Odometry of the wheels.
        dock: Detector of the dock; None: no detector.
    """

    pose: PoseSensor = field(default_factory=PoseSensor)
    odometry: Odometry = field(default_factory=Odometry)
    dock: DockSensor | None = None


@dataclass(frozen=True)
class Station:
    """Mechanical stop and contact switch of a dock, modelled without forces.

    The stop is a plane across the axis of the dock, and acts only on a robot that comes from the front. A robot that
    comes from the side or from behind passes through the plane. It collides with the outline of the station if the
    obstacles contain this outline.

    Args:
        direction: Gear of the last motion, forward or backward.
        depth: Distance of the stop beyond the docked pose [m].
        half_width: Half width of the stop [m].
        switch_travel: Distance before the stop within which the switch is closed [m].
        switch_cross: Largest lateral error with a closed switch [m].
        switch_yaw: Largest heading error with a closed switch [rad].
        stalls: Whether the wheels also stop (weak motors); otherwise they slip, and the odometry continues.

    Raises:
        InvalidValue: If the direction is not forward or backward, or a value is not a number, is negative, or is not
            finite.
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
        """Pose of the robot at the stop, relative to the docked pose."""
        return Pose2(self.depth if self.direction is DockDirection.FORWARD else -self.depth, 0.0, 0.0)

    def past(self, pose: Pose2) -> float:
        """Return the distance beyond the stop [m] of a pose relative to the docked pose; negative before it."""
        return (pose.x if self.direction is DockDirection.FORWARD else -pose.x) - self.depth

    def touched(self, pose: Pose2) -> bool:
        """Whether the switch is closed at a pose relative to the docked pose."""
        aligned = abs(pose.y) <= self.switch_cross and abs(pose.yaw) <= self.switch_yaw
        return aligned and abs(self.past(pose)) <= self.switch_travel + _TOUCHING


@dataclass(frozen=True, eq=False)
class Record(FrozenArrays):
    """Record of a simulation; row k contains the state at `times[k]` and the command given at that time.

    Attributes:
        times: Shape (n,) [s].
        poses: True poses, Shape (n, 3).
        twists: True body velocities: linear, angular, lateral, Shape (n, 3) [m/s, rad/s, m/s].
        commands: Linear and angular commands, Shape (n, 2) [m/s, rad/s]; zero in the last row.
        measured: Measured poses, Shape (n, 3).
        odometry: Measured linear and angular velocity, Shape (n, 2) [m/s, rad/s].
        docks: True docked poses, Shape (n, 3).
        contact: State of the contact switch, Shape (n,); False without a switch.
        detections: Detections in order of delivery.
        delivered: Time of delivery of each detection, Shape (m,) [s].
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
    """A plant, its sensors and a dock with a common clock, which begins at 0.

    Each sensor has a separate random stream, so a change of one sensor does not affect the others. `start`, `dock_pose`
    and the obstacles are given in the fixed frame. The stored dock, which only the planner uses, is not part of the
    simulation.

    Args:
        plant: Plant of the robot.
        start: True pose of the robot at the beginning.
        dock_pose: True docked pose; may be set at any time to move the dock.
        sensors: Sensors; None: perfect.
        obstacles: Obstacles, including the outline of the station.
        station: Stop and contact switch of the dock; None: the plant determines contact.
        seed: Seed of the sensors' noise; the slip of a plant has a separate seed.
        start_twist: Steady body velocity at the beginning.

    Attributes:
        time: Time [s].
        state: True state of the plant.
        measurements: Latest measurements.
        pose_sensor: Reader of the localization; `jump` displaces it.
        dock_sensor: Reader of the detector, with `lose` and `displace_next`; None without a detector.

    Raises:
        InvalidValue: If the seed is not a whole number >= 0.
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
        """Apply a command for `duration` [s] and return the resulting measurements.

        Raises:
            InvalidValue: If the duration is not finite and > 0.
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
        """Replace the obstacles; the next measurements contain `costmap`."""
        self._obstacles.append((len(self._rows), obstacles))
        self._costmap = costmap or self._costmap

    @property
    def error(self) -> Pose2:
        """True pose of the robot relative to the true docked pose: along, cross [m] and yaw [rad]."""
        return self.state.pose.in_frame_of(self.dock_pose)

    def clearance(self) -> float:
        """Return the smallest signed distance [m] between the recorded true footprints and any obstacle."""
        poses = np.array([row[1:4] for row in self._rows])
        footprint = self.plant.robot.footprint
        return min((executed_clearance(footprint, poses[i:], those) for i, those in self._obstacles), default=math.inf)

    def record(self) -> Record:
        """Return the record up to the present time."""
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
        """Clear the record, which bounds the memory of long runs; `clearance` is restarted."""
        self._rows = self._rows[-1:]
        self._commands.clear()
        self._detections.clear()
        self._obstacles = [(0, obstacles) for _, obstacles in self._obstacles[-1:]]

    def _stop(self, before: Pose2, station: Station) -> None:
        """Keep the robot at the stop after contact."""
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
        motion = (true.x, true.y, true.yaw, twist.linear, twist.angular, twist.lateral)
        rest = (odometry.linear, odometry.angular, dock.x, dock.y, dock.yaw, float(bool(contact)))
        self._rows.append((self.time, *motion, pose.x, pose.y, pose.yaw, *rest))
        self._detections.extend((self.time, detection) for detection in detections)
        costmap, self._costmap = self._costmap, None
        return Measurements(self.time, pose, odometry, detections, contact, costmap)


def executed_clearance(footprint: Footprint, poses: FloatArray, obstacles: ObstacleSet) -> float:
    """Return the smallest signed distance [m] between the footprint at any of the poses and any obstacle.

    The motion between the poses is not checked.

    Args:
        footprint: Footprint of the robot.
        poses: Shape (n, 3).
        obstacles: Obstacles; if there are none, the distance is infinite.
    """
    best = math.inf
    for block in np.array_split(poses, -(-len(poses) // _BLOCK)) if len(obstacles) and len(poses) else ():
        best = min(best, float(np.min(pose_clearances(block, footprint, obstacles, best)[0])))
    return best
