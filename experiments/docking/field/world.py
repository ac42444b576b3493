"""Field world: applies commands, returns sensor measurements, and records the true state."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from experiments.docking.field.camera import Camera, CameraState
from experiments.docking.field.drive import SUBSTEP, Drive, DriveState
from experiments.docking.field.localization import Localization, LocalizationState
from experiments.docking.field.odometry import Odometry, OdometryMessage, OdometryState
from experiments.docking.field.station import Station, deepest, shown_in_costmap
from optdock.geometry.pose import Pose2, Twist2
from optdock.model.dock import DockDirection
from optdock.model.measurements import Measurements, OdometryPose

if TYPE_CHECKING:
    from collections.abc import Mapping

    from experiments.docking.cases import Layout
    from optdock.geometry.arrays import FloatArray
    from optdock.model.costmap import Costmap
    from optdock.model.measurements import Detection

__all__ = ["FieldRobot", "FieldWorld"]

MARKER = 0.45  # [m] before the docked robot's origin: the back of the station, 0.2 m before the docked camera
PUSHED_AT = 0.6  # [m] before the dock: distance of the robot at which the dock is pushed
TOUCHABLE = 0.5  # [m] between the robot and the docked pose; at larger distances no corner reaches the station's face
CELL, COSTMAP_PERIOD = 0.05, 0.5  # [m], [s] of a local costmap
COSTMAP_REACH = 3.0  # [m] from the dock: covers every start and the way to the staging pose, including the robot


@dataclass(frozen=True)
class FieldWorld:
    """Parameters of a robot, a dock and their imperfections.

    Args:
        name: Name in the tables.
        drive: Wheels and commands.
        odometry: Wheel odometry.
        localization: Localization in the map.
        camera: Dock detector.
        station: Docking station.
        direction: Gear into the dock, forward or backward.
        moved: Largest distance [m] and largest angle [rad] of the true dock from the stored dock.
        pushed: Displacement [m] and largest rotation [rad] of the dock when the robot is 0.6 m away from it.
        dropped_cycles: Share of dropped control cycles [1].
        costmap: Whether a local costmap shows the station.
        executor_settings: Settings of the executor that differ from its defaults, as for a calibrated robot.
    """

    name: str = "field"
    drive: Drive = field(default_factory=Drive)
    odometry: Odometry = field(default_factory=Odometry)
    localization: Localization = field(default_factory=Localization)
    camera: Camera = field(default_factory=Camera)
    station: Station = field(default_factory=Station)
    direction: DockDirection = DockDirection.FORWARD
    moved: tuple[float, float] = (0.1, math.radians(5.0))
    pushed: tuple[float, float] = (0.0, 0.0)
    dropped_cycles: float = 0.01
    costmap: bool = False
    executor_settings: Mapping[str, float] = field(default_factory=dict)


class FieldRobot:
    """The driving robot of a field world.

    Args:
        world: World parameters.
        layout: Problem and true dock pose.
        seed: Seed of all random numbers; equal seeds and commands give equal runs.

    Attributes:
        drive: True state.
        dock: True pose of the docked robot.
        measurements: Latest measurements.
        poses: True poses after every sub-step, rows of (time [s], x [m], y [m], yaw [rad]).
        docks: True dock poses with the time from which they hold, (time [s], pose).
        detections: Reported detections, (time [s], detection).
        reported: Reported poses, rows of (time [s], x [m], y [m], yaw [rad]).
    """

    def __init__(self, world: FieldWorld, layout: Layout, seed: int) -> None:
        streams = [np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(8)]
        self._cycles, self._pushes = streams[6], streams[7]
        self.world, self._layout = world, layout
        self._gear = 1.0 if world.direction is DockDirection.FORWARD else -1.0
        self.drive = DriveState(world.drive, layout.problem.start, (streams[0], streams[1], streams[2]))
        self._odometry = OdometryState(world.odometry, world.drive, streams[3])
        self._localization = LocalizationState(world.localization, streams[4])
        self._camera = CameraState(world.camera, Pose2(self._gear * MARKER, 0.0, 0.0), streams[5])
        self.dock = layout.true_dock
        self._corners = [(x, y) for x, y in layout.problem.robot.footprint.vertices.tolist()]
        self._substeps = 0
        self._per_reading = round(world.odometry.period / SUBSTEP)
        self._per_estimate = round(world.localization.period / SUBSTEP)
        self._per_picture = round(world.camera.period / SUBSTEP)
        # Sensors have independent clocks.
        self._phases = int(self._cycles.integers(self._per_estimate)), int(self._cycles.integers(self._per_picture))
        start = layout.problem.start
        self.poses: list[tuple[float, float, float, float]] = [(0.0, start.x, start.y, start.yaw)]
        self.docks: list[tuple[float, Pose2]] = [(0.0, self.dock)]
        self.detections: list[tuple[float, Detection]] = []
        self.reported: list[tuple[float, float, float, float]] = []
        self._costmap_at = 0.0
        self.odometry = OdometryMessage(0.0, self._odometry.pose, Twist2())
        self._localization.estimate(0.0, start, self._odometry.pose)
        self.measurements = self.measure()

    @property
    def time(self) -> float:
        """[s]."""
        return self._substeps * SUBSTEP

    @property
    def pose(self) -> Pose2:
        """True pose."""
        return Pose2(self.drive.x, self.drive.y, self.drive.yaw)

    @property
    def error(self) -> Pose2:
        """True pose of the robot relative to the docked pose: along, cross [m] and yaw [rad]."""
        return self.pose.in_frame_of(self.dock)

    def cycle(self, rate: float) -> float:
        """Return the time until the next control cycle [s]: one period, or two if a cycle is dropped.

        Raises:
            ValueError: If a period is not a whole number of sub-steps.
        """
        substeps = round(1.0 / (rate * SUBSTEP))
        if abs(substeps * SUBSTEP * rate - 1.0) > 1e-9 or substeps < 1:
            raise ValueError(f"rate: its period must be a multiple of {SUBSTEP} s, got {rate} Hz")
        dropped = float(self._cycles.random()) < self.world.dropped_cycles
        return (2 if dropped else 1) * substeps * SUBSTEP

    def advance(self, command: Twist2, rate: float) -> Measurements:
        """Send a command, and return the measurements at the next control cycle."""
        self.drive.send(command)
        self.run(self.time + self.cycle(rate))
        return self.measure()

    def run(self, until: float) -> None:
        """Advance the time up to `until` [s]."""
        end = round(until / SUBSTEP)
        while self._substeps < end:
            self._substep()

    def measure(self) -> Measurements:
        """Return the current measurements."""
        time = self.time
        self.odometry = message = self._odometry.newest(time)
        pose, stamp = self._localization.reported(time, message.pose)
        if pose is not None:
            self.reported.append((time, pose.x, pose.y, pose.yaw))
        detections = self._camera.arrived(time)
        self.detections.extend((time, one) for one in detections)
        station = self.world.station
        self.measurements = Measurements(
            time,
            pose,
            message.twist,
            detections,
            station.touched(self.error, self._gear) if station.has_switch else None,
            self._costmap(pose),
            OdometryPose(message.stamp, message.pose) if self.world.odometry.tells_pose else None,
            stamp,
        )
        return self.measurements

    def record(self) -> FloatArray:
        """Return true times and poses of all sub-steps, Shape (n, 4) [s, m, m, rad]."""
        return np.array(self.poses)

    def _substep(self) -> None:
        drive = self.drive
        before = drive.x, drive.y, drive.yaw
        drive.advance()
        self._substeps += 1
        self._meet_the_dock(before)
        count, time = self._substeps, drive.time
        self.poses.append((time, drive.x, drive.y, drive.yaw))
        if count % self._per_reading == 0:
            self._odometry.read(time, drive.left, drive.right)
        if count % self._per_estimate == self._phases[0]:
            self._localization.estimate(time, self.pose, self._odometry.pose)
        if count % self._per_picture == self._phases[1]:
            self._camera.take(time, self.pose, self.dock)

    def _meet_the_dock(self, before: tuple[float, float, float]) -> None:
        """Push the dock if the robot is close to it; stop the robot at the station."""
        drive, dock = self.drive, self.dock
        distance = math.hypot(drive.x - dock.x, drive.y - dock.y)
        if distance < PUSHED_AT and self.world.pushed != (0.0, 0.0) and len(self.docks) == 1:
            far, turn = self.world.pushed
            bearing, share = self._pushes.uniform(-math.pi, math.pi), float(self._pushes.uniform(-1.0, 1.0))
            self.dock = dock @ Pose2(far * math.cos(bearing), far * math.sin(bearing), share * turn)
            self.docks.append((drive.time, self.dock))
        if distance > TOUCHABLE:
            return
        depth, give = self._depth(drive.x, drive.y, drive.yaw), self.world.station.give
        if depth <= give:
            return
        was = self._depth(*before)
        if not -TOUCHABLE < was < depth:  # moving away, or approaching from the side
            return
        share = min(max(give - was, 0.0) / (depth - was), 1.0)
        held = [a + share * (b - a) for a, b in zip(before, (drive.x, drive.y, drive.yaw), strict=True)]
        drive.stall(*held)

    def _depth(self, x: float, y: float, yaw: float) -> float:
        """Return the depth of the foremost corner of a robot at a true pose beyond the station's face [m]."""
        dx, dy, there = x - self.dock.x, y - self.dock.y, self.dock.yaw
        c, s = math.cos(there), math.sin(there)
        return deepest((c * dx + s * dy, c * dy - s * dx, yaw - there), self._corners, self._gear)

    def _costmap(self, pose: Pose2 | None) -> Costmap | None:
        """Return the station as detected by the robot, in the fixed frame given by its localization."""
        if not self.world.costmap or pose is None or self.time < self._costmap_at:
            return None
        self._costmap_at = self.time + COSTMAP_PERIOD
        outline = self._layout.problem.dock.footprint
        assert outline is not None
        return shown_in_costmap(outline, pose @ self.pose.inverse() @ self.dock, CELL, COSTMAP_REACH)
