"""Estimated poses of the robot and the dock, updated with every set of measurements.

Two filters use the same odometry. The first filter estimates the robot in the map, from the localization; the second
filter estimates the robot in the frame of the dock, from the detections. Accuracy at the dock depends only on the
second filter. The first filter is used for obstacles, and for a dock that has not been detected yet.
"""

from __future__ import annotations

import math
from collections import deque
from typing import TYPE_CHECKING

import numpy as np

from optdock.executor.pose_filter import AHEAD, DeadReckoning, OdometryErrors, PoseFilter
from optdock.geometry.pose import Pose2, normalize_angle

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from optdock.executor.executor_settings import ExecutorSettings
    from optdock.geometry.arrays import FloatArray
    from optdock.model.costmap import Costmap
    from optdock.model.measurements import Detection, Measurements

__all__ = ["DockDetections", "Perception", "covariance_from_dock"]

_MISSED = 0.5  # [s] without a measurement after which the gap is reported in the log
_STALE = 1.0  # [s]: older detections are not used
_VAGUE = 1.0  # [m], [rad]: detections with a larger standard deviation are not used
_LEAST_SIGMA = 2e-4, 2e-4  # [m], [rad]: keeps the covariance regular; smaller than the noise of any detector
# [s]: detections with stamps farther ahead of the clock are not used; stamps that are ahead by less, but by more than
# the rounding `AHEAD`, are replaced by the present stamp.
_CLOCKS_APART = 0.25
_LATE = 0.04  # [s]: estimated delay of the detections above which the delay is reported in the log
# Near the dock, wheel slip after a gap in the detections is added to the covariance, because too few detections follow
# to average it out: a slipping wheel loses 20 to 60 % of its travel.
_NEAR_DOCK, _USUAL_GAP = 0.25, 0.01  # [m]
_SLIP, _SLIP_TURN = 0.3, 0.6  # per distance beyond that gap [1], [rad/m]
_REMEMBERED_STAMPS = 2  # accepted detections whose stamps are kept
_JITTER = 0.01  # [s]: of the stamps of detections, by exposure and drivers


class Perception:
    """Estimated poses of the robot, of the dock, and of the robot relative to the dock.

    Attributes:
        stamp: Stamp of the last measurements on the monotonic clock [s].
        measurements: The last measurements.
        costmap: The newest costmap; None before the first.
        detections: Detections of the dock, and the robot in the frame of the dock.
        way: Distance driven, by odometry [m].
        forward: Signed distance driven by odometry, negative in reverse [m].
        turned: Signed angle turned to the left, by odometry [rad].
        has_twist: Whether the next measurements contain a body velocity.
    """

    def __init__(self, stored: Pose2, settings: ExecutorSettings, report: Callable[[str, str], None]) -> None:
        self._stored, self._settings, self._report = stored, settings, report
        self._reckoning: DeadReckoning | None = None
        self._robot = PoseFilter(OdometryErrors())
        self.detections = DockDetections(stored, settings, self._robot, report)
        self._dock = self.detections.filter
        self._noise = np.diag([settings.position_sigma**2, settings.position_sigma**2, settings.yaw_sigma**2])
        self._from_stored: tuple[Pose2 | None, Pose2] = None, stored  # the robot, and relative to the stored dock
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
        """Whether the pose of the robot has been measured."""
        return self._robot.started

    @property
    def robot(self) -> Pose2:
        """Pose of the robot in the fixed frame."""
        return self._robot.pose

    @property
    def pose_age(self) -> float:
        """Time [s] since a measured pose was accepted; infinite before the first accepted pose."""
        return self.stamp - self._robot.measured_at

    @property
    def way_unlocated(self) -> float:
        """Distance driven since the last pose of the localization [m]."""
        return self.way - self._way_located

    @property
    def twist_age(self) -> float:
        """Time [s] since the last new odometry with a body velocity; 0 before the first such odometry."""
        return max(self.stamp - self._twist_at, 0.0)

    @property
    def costmap_age(self) -> float:
        """Time [s] since the last costmap, even if unchanged, or since the first measurements without a costmap."""
        return 0.0 if self._costmap_at is None else self.stamp - self._costmap_at

    @property
    def sees_dock(self) -> bool:
        """Whether the dock has been detected."""
        return self.detections.is_any

    @property
    def detection_age(self) -> float:
        """Time [s] since the last accepted detection was taken; infinite before the first accepted detection."""
        return self.stamp - self._dock.measured_at

    @property
    def unseen_turn(self) -> float:
        """Rotation [rad] of the localization relative to the odometry since the last detection.

        A rotation by wheel slip changes the localization, but not the odometry.
        """
        return normalize_angle(self.dock.yaw - self.detections.seen_yaw) if self.sees_dock else 0.0

    @property
    def robot_from_dock(self) -> Pose2:
        """Pose of the robot relative to the docked pose; independent of the localization after the first detection."""
        if self._dock.accepted > 0:  # as `sees_dock`
            return self._dock.pose
        robot, from_stored = self._from_stored
        if robot is not self._robot.pose:
            robot = self._robot.pose
            from_stored = robot.in_frame_of(self._stored)
            self._from_stored = robot, from_stored
        return from_stored

    @property
    def dock(self) -> Pose2:
        """Docked pose in the fixed frame."""
        return self.detections.dock

    @property
    def sigma(self) -> tuple[float, float]:
        """Standard deviations of the dock relative to the robot.

        The values are the larger of along and across [m], and yaw [rad].
        """
        if not self._settings.use_detections and self._robot.started:
            spread = self._robot.covariance
            return math.sqrt(max(float(spread[0, 0]), float(spread[1, 1]))), math.sqrt(float(spread[2, 2]))
        if not self._dock.started:
            return self._settings.stored_position_sigma, self._settings.stored_yaw_sigma
        # The rotation of the robot about the dock by a yaw error does not move the dock in the frame of the robot.
        robot, spread = self._dock.pose, self._dock.covariance
        (xx, _, xt), (_, yy, yt), (tx, ty, tt) = spread[:3, :3].tolist()
        along = xx + robot.y * tx + (xt + robot.y * tt) * robot.y
        across = yy - robot.x * ty - (yt - robot.x * tt) * robot.x
        return math.sqrt(max(along, across)), math.sqrt(tt)

    def sigma_after(self, way: float) -> tuple[float, float, float]:
        """Return the standard deviations after a straight motion by `way` [m], negative in reverse.

        The values apply along [m], across [m] and in yaw [rad] in the frame of the dock, under the assumption that no
        further detection is made.
        """
        found = (self._dock if self._settings.use_detections else self._robot).after(way)
        if not self._settings.use_detections:  # independent of the orientation of the dock in the map
            found[0, 0] = found[1, 1] = max(found[0, 0], found[1, 1])
        along, cross, yaw = np.sqrt(np.diag(found)).tolist()
        return along, cross, yaw

    def update(self, measurements: Measurements, stamp: float, offset: float) -> None:
        """Process new measurements.

        Args:
            measurements: New measurements.
            stamp: Their stamp on the monotonic clock [s].
            offset: Monotonic clock minus the clock of the detections [s].
        """
        self.measurements, self.stamp = measurements, stamp
        odometry = measurements.odometry
        if self.has_twist and (odometry is None or odometry.stamp != self._odometry_stamp):
            self._twist_at = stamp  # a repeated odometry message, twist included, has no new information
        self._odometry_stamp = None if odometry is None else odometry.stamp
        if self._costmap_at is None or measurements.costmap is not None:
            self._costmap_at = stamp
        if measurements.costmap is not None and not _is_same(measurements.costmap, self.costmap):
            self.costmap = measurements.costmap
        if not self._locate(measurements):
            return
        if self._settings.use_detections:
            self.detections.update(measurements.detections, stamp, offset, self.way)
        self._report_lost()

    def _locate(self, measurements: Measurements) -> bool:
        """Update the pose of the robot in the map; return False if the pose has never been measured."""
        robot, stamp, pose = self._robot, self.stamp, measurements.pose
        measured_at = stamp if measurements.pose_stamp is None else measurements.pose_stamp
        if self._reckoning is None:
            if pose is not None:
                self._begin(measurements, pose, measured_at)
            return pose is not None
        step = self._reckoning.advance(stamp, measurements.twist, measurements.odometry)
        if self._reckoning.restarts != self._restarts:
            self._restarts = self._reckoning.restarts
            self._report("odometry restarted", "its frame has moved; the twists bridge the gap")
        robot.predict(stamp, step)
        self._dock.predict(stamp, step)
        self.way += math.hypot(step.x, step.y)
        self.forward += step.x
        self.turned += step.yaw
        if pose is not None and measured_at > self._pose_used:  # otherwise the pose was delivered twice, or too late
            self._pose_used, self._way_located = measured_at, self.way
            robot.correct(measured_at, pose, self._noise)
            self._check_jump()
        if not self.sees_dock:
            self._dock.place(self.robot_from_dock, self._stored_noise())
        return True

    def _begin(self, measurements: Measurements, pose: Pose2, measured_at: float) -> None:
        stamp = self.stamp
        self._reckoning = DeadReckoning(stamp, measurements.twist, measurements.odometry)
        passed = min(max(stamp - measured_at, 0.0), _STALE)
        self._robot.start(stamp, pose.moved(measurements.twist, passed), self._noise)
        self._dock.start(stamp, self.robot.in_frame_of(self._stored), self._stored_noise())
        self._robot.measured_at = self._pose_used = measured_at

    def _check_jump(self) -> None:
        jump = self._robot.jump
        if jump is None:
            return
        way = math.hypot(jump.x, jump.y)
        self._report("pose jumped", f"by {way:.3f} m and {jump.yaw:.3f} rad against the odometry")
        if self.sees_dock:
            # Either the localization has jumped, or the robot has been moved; the next detection shows which.
            self._dock.suppose(self._dock.pose @ jump, self._dock.covariance[:3, :3] + 4.0 * self._noise)

    def _stored_noise(self) -> FloatArray:
        """Return the covariance of the robot in the frame of the stored dock, which was not detected. Shape (3, 3)."""
        settings = self._settings
        return covariance_from_dock(self.robot_from_dock, settings.stored_position_sigma, settings.stored_yaw_sigma)

    def _report_lost(self) -> None:
        """Report once when poses or detections are missing, and once when they are available again."""
        lost = self.pose_age > _MISSED
        if lost != self._pose_was_lost:
            self._pose_was_lost = lost
            self._report("pose lost" if lost else "pose found", f"{self.pose_age:.2f} s old")
        lost = self.sees_dock and self.detection_age > _MISSED
        if lost != self._dock_was_lost:
            self._dock_was_lost = lost
            self._report("detection lost" if lost else "detection found", f"{self.detection_age:.2f} s old")


def _is_same(costmap: Costmap, known: Costmap | None) -> bool:
    """Whether two costmaps are equal; their values are compared, because a replay creates new objects."""
    if known is None or (costmap.resolution, costmap.origin) != (known.resolution, known.origin):
        return False
    return costmap is known or np.array_equal(costmap.data, known.data)


class DockDetections:
    """Estimate of the robot in the frame of the dock, from detections.

    Attributes:
        filter: Pose of the robot in the frame of the dock.
        count: Number of accepted detections.
        rejected: Number of rejected detections.
        seen_from: Smallest distance from the docked pose at which the dock was detected [m]; infinite before the first
            detection.
        seen_yaw: Yaw of the dock in the fixed frame at the last detection [rad].
        too_far: Distance of the last detection that was too far from the stored dock [m]; 0 without such a detection.
    """

    def __init__(
        self, stored: Pose2, settings: ExecutorSettings, robot: PoseFilter, report: Callable[[str, str], None]
    ) -> None:
        self._stored, self._settings, self._robot, self._report = stored, settings, robot, report
        self.filter = PoseFilter(
            OdometryErrors(
                along=settings.odometry_sigma,
                yaw_per_way=settings.odometry_straight_yaw_sigma,
                yaw_per_turn=settings.odometry_yaw_sigma,
                wander=settings.dock_drift,
                yaw_wander=0.0,
                scale=settings.odometry_scale_sigma,
                drift=settings.odometry_drift_sigma,
                delay=settings.detection_delay_sigma,
                jitter=_JITTER,
            ),
            confirmations=settings.dock_confirmations,
            fewer_when_close=1,
        )
        self.count = self.rejected = 0
        self.seen_from, self.seen_yaw, self.too_far = math.inf, 0.0, 0.0
        self._now, self._way, self._way_seen = -math.inf, 0.0, 0.0  # [s], [m], and [m] at the last detection
        self._stamps: deque[float] = deque(maxlen=_REMEMBERED_STAMPS)  # of accepted detections [s]
        self._delay_reported = self._ahead_reported = False

    @property
    def is_any(self) -> bool:
        """Whether the dock has been detected."""
        return self.filter.accepted > 0

    @property
    def is_contradicted(self) -> bool:
        """Whether the newest detections agree with each other but not with the estimate."""
        return self._settings.use_detections and self.filter.is_contradicted

    @property
    def dock(self) -> Pose2:
        """Docked pose in the fixed frame."""
        return self._robot.pose @ self.filter.pose.inverse() if self.is_any else self._stored

    def moved_since_seen(self, times: int = 1) -> float:
        """Return the distance from the position of the last detection (`times=2`: the last but one) [m]; may be inf."""
        seen = self._stamps[-times] if len(self._stamps) >= times else -math.inf
        if not seen >= self.filter.remembered_from:
            return math.inf
        return self.filter.pose.distance_to(self.filter.pose_at(seen))

    def update(self, found: Sequence[Detection], stamp: float, offset: float, way: float) -> None:
        """Process new detections.

        Args:
            found: Detections in any order, with stamps on the clock of the detections.
            stamp: Present time on the monotonic clock [s].
            offset: Monotonic clock minus the clock of the detections [s].
            way: Distance driven by odometry [m].
        """
        self._now, self._way = stamp, way
        if not found:
            return
        for late in sorted(found, key=lambda detection: detection.stamp):
            detection = self._not_ahead(late._replace(stamp=late.stamp + offset))
            age, sigmas = self._now - detection.stamp, (detection.position_sigma, detection.yaw_sigma)
            verdict, before = "forgotten", self.filter.pose
            seen = detection.pose.inverse()
            if age <= _STALE and all(0.0 <= sigma <= _VAGUE for sigma in sigmas):
                noise = covariance_from_dock(seen, *map(max, sigmas, _LEAST_SIGMA))
                verdict = self._correct(detection, seen, noise)
            if verdict == "forgotten":
                self._report("detection not used", f"it is {age:.3f} s old, its sigmas are {sigmas}")
            elif verdict == "rejected":
                self.rejected += 1
                gap = seen.in_frame_of(self.filter.pose_at(detection.stamp))
                self._report("detection rejected", f"{gap.x:.3f} m, {gap.y:.3f} m, {gap.yaw:.3f} rad off the estimate")
            elif verdict != "too far":
                self.count += 1
                place = self.filter.pose_at(detection.stamp)
                self.seen_from = min(self.seen_from, math.hypot(place.x, place.y))
                self.seen_yaw = self.dock.yaw
                self._stamps.append(detection.stamp)
                self._way_seen = self._way
                if verdict == "moved":
                    gap = self.filter.pose.in_frame_of(before).inverse()
                    self._report("dock moved", f"by {gap.x:.3f} m, {gap.y:.3f} m, {gap.yaw:.3f} rad")
        self._report_delay()

    def _not_ahead(self, detection: Detection) -> Detection:
        """Replace a stamp ahead of the clock by the present stamp; the filter estimates the true delay."""
        ahead = detection.stamp - self._now
        if not AHEAD < ahead <= _CLOCKS_APART:
            return detection
        if not self._ahead_reported:
            self._ahead_reported = True
            self._report("detections ahead of the clock", f"by {1e3 * ahead:.0f} ms; the present stamp is used")
        return detection._replace(stamp=self._now)

    def _correct(self, detection: Detection, seen: Pose2, noise: FloatArray) -> str:
        """Correct the filter with a detection, unless it is too far from the stored dock."""
        if not detection.stamp >= self._robot.remembered_from:
            return "forgotten"
        place = self._robot.pose_at(min(detection.stamp, self._now)) @ detection.pose
        far, most = place.distance_to(self._stored), self._settings.max_detection_offset
        is_far = far > most
        if is_far and not self.is_any:
            self.too_far = far
            self._report("detection too far", f"{far:.3f} m from the stored dock, max_detection_offset is {most:.3f} m")
            return "too far"
        is_near = self.is_any and math.hypot(seen.x, seen.y) < _NEAR_DOCK
        unseen = max(0.0, self._way - self._way_seen - _USUAL_GAP) if is_near else 0.0
        slip = _SLIP * unseen, _SLIP_TURN * unseen
        return self.filter.correct(detection.stamp, seen, noise, may_move=not is_far, slip=slip)

    def _report_delay(self) -> None:
        """Report once if the stamps of the detections do not fit the odometry."""
        delay, sigma = float(self.filter.systematic[2]), math.sqrt(max(float(self.filter.covariance[5, 5]), 0.0))
        if not self._delay_reported and abs(delay) > _LATE and sigma < 0.25 * abs(delay):
            self._delay_reported = True
            self._report(
                "detections look late" if delay > 0.0 else "odometry looks late",
                f"by {1e3 * abs(delay):.0f} ms, with a standard deviation of {1e3 * sigma:.0f} ms",
            )


def covariance_from_dock(robot: Pose2, position_sigma: float, yaw_sigma: float) -> FloatArray:
    """Return the robot's covariance in the frame of the dock, given the errors of the dock in the frame of the robot.

    Let D be the pose of the dock in the frame of the robot, and T the inverse of D. An error of D's yaw rotates the
    robot about the dock.

    Args:
        robot: T.
        position_sigma: Standard deviation of D's x and y, each [m].
        yaw_sigma: Standard deviation of D's yaw [rad].

    Returns:
        Shape (3, 3) [m, m, rad].
    """
    place, turn, x, y = position_sigma**2, yaw_sigma**2, robot.x, -robot.y
    across, along, off = turn * (x * y), turn * x, turn * y
    return np.array(
        ((turn * (y * y) + place, across, off), (across, turn * (x * x) + place, along), (off, along, turn))
    )
