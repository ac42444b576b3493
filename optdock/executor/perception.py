"""What the robot knows of itself and of the dock, brought up to date by every set of measurements."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from optdock.estimation import PoseFilter
from optdock.executor.dock_filter import DeadReckoning, DockFilter

if TYPE_CHECKING:
    from collections.abc import Callable

    from optdock.costmap.costmap import Costmap
    from optdock.executor.settings import ExecutorSettings
    from optdock.geometry.pose import Pose2
    from optdock.measurements import Measurements

__all__ = ["Perception"]

_VAGUE = 1.0  # [m], [rad]: a detection that is no surer says nothing, and must not pass for one
_STALE = 1.0  # [s]: a detection that took longer says where the dock was


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
        detections: Number of detections that were believed.
        rejected: Number of those that were not.
    """

    def __init__(self, stored: Pose2, settings: ExecutorSettings, report: Callable[[str, str], None]) -> None:
        self._stored, self._settings, self._report = stored, settings, report
        self._robot = PoseFilter(settings.position_sigma, settings.yaw_sigma)
        self._reckoning: DeadReckoning | None = None
        self._dock: DockFilter | None = None
        self.measurements: Measurements | None = None
        self.stamp = -math.inf
        self.costmap: Costmap | None = None
        self._costmap_at: float | None = None
        self.detections = self.rejected = 0
        self._jumped_at = -math.inf
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
        """Since a measured pose was believed [s]; infinite before the first."""
        return self.stamp - self._robot.measured_at

    @property
    def costmap_age(self) -> float:
        """Since a costmap came, be it the same as before, or since the first measurements [s]."""
        return 0.0 if self._costmap_at is None else self.stamp - self._costmap_at

    @property
    def sees_dock(self) -> bool:
        """Whether it has been detected at all."""
        return self._dock is not None and self._dock.accepted > 0

    @property
    def detection_age(self) -> float:
        """Since the dock was seen [s]; infinite before."""
        return self.stamp - self._dock.last_stamp if self._dock is not None else math.inf

    @property
    def robot_from_dock(self) -> Pose2:
        """The robot seen from the docked pose; localization has no part in it once the dock is seen."""
        if self._dock is not None and self._reckoning is not None and self.sees_dock:
            return self._reckoning.pose.in_frame_of(self._dock.mean)
        return self.robot.in_frame_of(self._stored)

    @property
    def dock(self) -> Pose2:
        """The docked pose in the fixed frame."""
        return self.robot @ self.robot_from_dock.inverse() if self.sees_dock else self._stored

    @property
    def sigma(self) -> tuple[float, float]:
        """Of the robot seen from the dock: position, each of x and y [m], and yaw [rad]."""
        if not self._settings.use_detections and self._robot.started:
            spread = self._robot.covariance
            return math.sqrt(max(float(spread[0, 0]), float(spread[1, 1]))), math.sqrt(float(spread[2, 2]))
        if self._dock is None:
            return self._settings.stored_position_sigma, self._settings.stored_yaw_sigma
        return self._dock.position_sigma, self._dock.yaw_sigma

    def update(self, measurements: Measurements, stamp: float, offset: float) -> None:
        """Take in what was measured.

        Args:
            measurements: New.
            stamp: Theirs, on the clock that never goes back [s].
            offset: What that clock is ahead of the one of the detections [s].
        """
        self.measurements, before, self.stamp = measurements, self.stamp, stamp
        if self._costmap_at is None or measurements.costmap is not None:
            self._costmap_at = stamp
        if measurements.costmap is not None and not _is_same(measurements.costmap, self.costmap):
            self.costmap = measurements.costmap
        if not self._locate(measurements, stamp - before):
            return
        if self._settings.use_detections:
            self._see_dock(measurements, offset)
        self._say_what_is_lost()

    def _locate(self, measurements: Measurements, period: float) -> bool:
        """The robot's pose; False while there has never been one."""
        robot, settings, twist, stamp = self._robot, self._settings, measurements.twist, self.stamp
        if not robot.started and measurements.pose is None:
            return False
        first = not robot.started
        robot.update(stamp, measurements.pose, twist)
        if first or self._reckoning is None:
            self._reckoning = DeadReckoning(stamp, twist)
            stored = robot.pose.inverse() @ self._stored
            self._dock = DockFilter(stored, settings.stored_position_sigma, settings.stored_yaw_sigma)
            return True
        way = self._reckoning.advance(stamp, twist)
        if self._dock is not None:
            drift = settings.dock_drift * math.sqrt(period)
            along = settings.odometry_sigma * math.sqrt(abs(way.linear))
            turn = math.sqrt(settings.odometry_yaw_sigma**2 * abs(way.angular) + _STRAIGHT_YAW**2 * abs(way.linear))
            self._dock.forget(self._reckoning.pose, along, turn, drift)
            if self._dock.accepted == 0:
                self._dock.mean = self._reckoning.pose @ (robot.pose.inverse() @ self._stored)
        jump = robot.jump
        if jump is not None:
            self._report(
                "pose jumped", f"by {math.hypot(jump.x, jump.y):.3f} m and {jump.yaw:.3f} rad against the odometry"
            )
            if self._dock is not None and self.sees_dock:
                # Either localization has moved, or the robot has been; the next detection after it tells.
                self._dock.widen(math.hypot(jump.x, jump.y), abs(jump.yaw))
                self._jumped_at = stamp
        return True

    def _see_dock(self, measurements: Measurements, offset: float) -> None:
        assert self._dock is not None
        assert self._reckoning is not None
        for late in measurements.detections:
            detection = late._replace(stamp=late.stamp + offset)
            age = self.stamp - detection.stamp
            robot = self._reckoning.at(detection.stamp) if age <= _STALE else None
            sigmas = detection.position_sigma, detection.yaw_sigma
            if robot is None or not all(0.0 <= sigma <= _VAGUE for sigma in sigmas):
                self._report("detection not used", f"it is {age:.3f} s old, its sigmas are {sigmas}")
                continue
            if detection.stamp < self._jumped_at:
                continue
            before = self._dock.mean
            verdict = self._dock.see(detection, robot)
            if verdict == "rejected":
                self.rejected += 1
                gap = (robot @ detection.pose).in_frame_of(before)
                self._report("detection rejected", f"{gap.x:.3f} m, {gap.y:.3f} m, {gap.yaw:.3f} rad off the estimate")
                continue
            self.detections += 1
            if verdict == "moved":
                gap = self._dock.mean.in_frame_of(before)
                self._report("dock moved", f"by {gap.x:.3f} m, {gap.y:.3f} m, {gap.yaw:.3f} rad")

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


_MISSED = 0.5  # [s] without a measurement that is said in the log
_STRAIGHT_YAW = 0.005  # [rad/m^0.5], of odometry that drives straight: a wheel of 0.5 % more turns 5 mrad per metre
