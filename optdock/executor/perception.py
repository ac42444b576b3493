"""The estimated poses of robot and dock, updated by every set of measurements.

The robot is estimated twice by the same filter over the same odometry: in the map, from the localization, and in the
frame of the dock, from the detections. What must be exact at the dock is the second, in which the localization has no
part; the first is needed for obstacles, and for a dock that has not been seen yet.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.executor.dock_detections import STALE, DockDetections, covariance_from_dock
from optdock.executor.estimation import DeadReckoning, OdometryErrors, PoseFilter
from optdock.geometry.pose import Pose2, normalize_angle

if TYPE_CHECKING:
    from collections.abc import Callable

    from optdock.executor.executor_settings import ExecutorSettings
    from optdock.geometry.arrays import FloatArray
    from optdock.model.costmap import Costmap
    from optdock.model.measurements import Measurements

__all__ = ["Perception", "Sigma"]

_MISSED = 0.5  # [s] without a measurement that is said in the log


class Sigma(NamedTuple):
    """Standard deviations in the frame of the dock: along, across [m] and yaw [rad]."""

    along: float
    cross: float
    yaw: float


class Perception:
    """Robot, dock, and the one relative to the other.

    Args:
        stored: Where the dock should be, in the fixed frame.
        settings: Noises, and whether detections count.
        report: Takes the name of an event and its detail.

    Attributes:
        stamp: Of the last measurements, on the clock that never goes back [s].
        measurements: The last ones.
        costmap: The newest one; None before the first.
        detections: Of the dock, and the robot in its frame.
        way: Driven so far, by odometry [m].
        forward: Driven forward so far, less the way in reverse, by odometry [m].
        turned: Turned so far, by odometry, to the left [rad].
        has_twist: Whether the measurements that come next have a body velocity of the odometry.
    """

    def __init__(self, stored: Pose2, settings: ExecutorSettings, report: Callable[[str, str], None]) -> None:
        self._stored, self._settings, self._report = stored, settings, report
        self._reckoning: DeadReckoning | None = None
        self._robot = PoseFilter(OdometryErrors())
        self.detections = DockDetections(stored, settings, self._robot, report)
        self._dock = self.detections.filter
        self._noise = np.diag([settings.position_sigma**2, settings.position_sigma**2, settings.yaw_sigma**2])
        self._pose_used, self._restarts = -math.inf, 0
        self.measurements: Measurements | None = None
        self.stamp = -math.inf
        self.costmap: Costmap | None = None
        self._costmap_at: float | None = None
        self.way = self._way_located = self.forward = self.turned = 0.0
        self.has_twist, self._twist_at = True, math.inf
        self._odometry_stamp: float | None = None
        self._pose_was_lost = self._dock_was_lost = False

    @property
    def started(self) -> bool:
        """Whether the robot knows where it is."""
        return self._robot.started

    @property
    def robot(self) -> Pose2:
        """In the fixed frame."""
        return self._robot.pose

    @property
    def pose_age(self) -> float:
        """Since a measured pose was accepted [s]; infinite before the first."""
        return self.stamp - self._robot.measured_at

    @property
    def way_unlocated(self) -> float:
        """Way driven since the last pose of the localization [m]."""
        return self.way - self._way_located

    @property
    def twist_age(self) -> float:
        """Since the last body velocity of the odometry, and a new pose where it has poses [s]; 0 before the first."""
        return max(self.stamp - self._twist_at, 0.0)

    @property
    def costmap_age(self) -> float:
        """Since a costmap came, be it the same as before, or since the first measurements [s]."""
        return 0.0 if self._costmap_at is None else self.stamp - self._costmap_at

    @property
    def sees_dock(self) -> bool:
        """Whether it has been detected at all."""
        return self.detections.is_any

    @property
    def detection_age(self) -> float:
        """Since the dock was seen [s]; infinite before."""
        return self.stamp - self._dock.measured_at

    @property
    def unseen_turn(self) -> float:
        """How far the localization has turned against the odometry since the dock was seen [rad].

        A wheel that slips turns the robot unseen by its odometry; the localization sees it.
        """
        return normalize_angle(self.dock.yaw - self.detections.seen_yaw) if self.sees_dock else 0.0

    @property
    def robot_from_dock(self) -> Pose2:
        """The robot seen from the docked pose; localization has no part in it once the dock is seen."""
        return self._dock.pose if self.sees_dock else self.robot.in_frame_of(self._stored)

    @property
    def dock(self) -> Pose2:
        """The docked pose in the fixed frame."""
        return self.detections.dock

    @property
    def sigma(self) -> tuple[float, float]:
        """Of the dock seen from the robot: position, the larger one of along and across [m], and yaw [rad]."""
        if not self._settings.use_detections and self._robot.started:
            spread = self._robot.covariance
            return math.sqrt(max(float(spread[0, 0]), float(spread[1, 1]))), math.sqrt(float(spread[2, 2]))
        if not self._dock.started:
            return self._settings.stored_position_sigma, self._settings.stored_yaw_sigma
        # What the yaw makes of the place is no doubt of where the dock is, seen from here.
        robot, spread = self._dock.pose, self._dock.covariance[:3, :3]
        swing = np.array([[1.0, 0.0, robot.y], [0.0, 1.0, -robot.x]])
        place = swing @ spread @ swing.T
        return math.sqrt(max(float(place[0, 0]), float(place[1, 1]))), math.sqrt(float(spread[2, 2]))

    def sigma_after(self, way: float) -> Sigma:
        """Of the robot in the frame of the dock, after a straight way without another detection.

        Args:
            way: Forward [m], negative in reverse.
        """
        found = (self._dock if self._settings.use_detections else self._robot).after(way)
        if not self._settings.use_detections:  # whichever way the dock lies in the map
            found[0, 0] = found[1, 1] = max(found[0, 0], found[1, 1])
        return Sigma(*np.sqrt(np.diag(found)).tolist())

    def update(self, measurements: Measurements, stamp: float, offset: float) -> None:
        """Take in what was measured.

        Args:
            measurements: New.
            stamp: Theirs, on the clock that never goes back [s].
            offset: What that clock is ahead of the one of the detections [s].
        """
        self.measurements, self.stamp = measurements, stamp
        odometry = measurements.odometry
        if self.has_twist and (odometry is None or odometry.stamp != self._odometry_stamp):
            self._twist_at = stamp  # a repeated odometry message gives no new information, nor does its twist
        self._odometry_stamp = None if odometry is None else odometry.stamp
        if self._costmap_at is None or measurements.costmap is not None:
            self._costmap_at = stamp
        if measurements.costmap is not None and not _is_same(measurements.costmap, self.costmap):
            self.costmap = measurements.costmap
        if not self._locate(measurements):
            return
        if self._settings.use_detections:
            self.detections.update(measurements.detections, stamp, offset, self.way)
        self._say_what_is_lost()

    def _locate(self, measurements: Measurements) -> bool:
        """The robot in the map; False while its pose has never been measured."""
        robot, stamp, pose = self._robot, self.stamp, measurements.pose
        measured_at = stamp if measurements.pose_stamp is None else measurements.pose_stamp
        if self._reckoning is None:
            if pose is not None:
                self._begin(measurements, pose, measured_at)
            return pose is not None
        step = self._reckoning.advance(stamp, measurements.twist, measurements.odometry)
        if self._reckoning.restarts != self._restarts:
            self._restarts = self._reckoning.restarts
            self._report("odometry began anew", "its frame has moved; the twist tells the way in between")
        robot.predict(stamp, step)
        self._dock.predict(stamp, step)
        self.way += math.hypot(step.x, step.y)
        self.forward += step.x
        self.turned += step.yaw
        if pose is not None and measured_at > self._pose_used:  # else delivered twice, or too late
            self._pose_used, self._way_located = measured_at, self.way
            robot.correct(measured_at, pose, self._noise)
            self._look_at_jump()
        if not self.sees_dock:
            self._dock.place(robot.pose.in_frame_of(self._stored), self._stored_noise())
        return True

    def _begin(self, measurements: Measurements, pose: Pose2, measured_at: float) -> None:
        stamp = self.stamp
        self._reckoning = DeadReckoning(stamp, measurements.twist, measurements.odometry)
        passed = min(max(stamp - measured_at, 0.0), STALE)
        self._robot.start(stamp, pose.moved(measurements.twist, passed), self._noise)
        self._dock.start(stamp, self.robot.in_frame_of(self._stored), self._stored_noise())
        self._robot.measured_at = self._pose_used = measured_at

    def _look_at_jump(self) -> None:
        jump = self._robot.jump
        if jump is None:
            return
        way = math.hypot(jump.x, jump.y)
        self._report("pose jumped", f"by {way:.3f} m and {jump.yaw:.3f} rad against the odometry")
        if self.sees_dock:
            # The localization has moved; or the robot has been, as the next detection then tells.
            self._dock.suppose(self._dock.pose @ jump, self._dock.covariance[:3, :3] + 4.0 * self._noise)

    def _stored_noise(self) -> FloatArray:
        """Covariance of the robot in the frame of the dock as it is stored, Shape (3, 3)."""
        settings = self._settings
        return covariance_from_dock(
            self._robot.pose.in_frame_of(self._stored), settings.stored_position_sigma, settings.stored_yaw_sigma
        )

    def _say_what_is_lost(self) -> None:
        """Say once when poses or detections stop coming, and when they come again."""
        lost = self.pose_age > _MISSED
        if lost != self._pose_was_lost:
            self._pose_was_lost = lost
            self._report("pose lost" if lost else "pose found", f"{self.pose_age:.2f} s old")
        lost = self.sees_dock and self.detection_age > _MISSED
        if lost != self._dock_was_lost:
            self._dock_was_lost = lost
            self._report("detection lost" if lost else "detection found", f"{self.detection_age:.2f} s old")


def _is_same(costmap: Costmap, known: Costmap | None) -> bool:
    """Whether it shows the same, by its cells: a replay has other objects."""
    if known is None or (costmap.resolution, costmap.origin) != (known.resolution, known.origin):
        return False
    return costmap is known or np.array_equal(costmap.data, known.data)
