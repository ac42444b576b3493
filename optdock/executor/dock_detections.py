"""Detections of the dock, and the pose of the robot in its frame by the filter that takes them in."""

from __future__ import annotations

import math
from collections import deque
from typing import TYPE_CHECKING

import numpy as np

from optdock.executor.estimation import AHEAD, OdometryErrors, PoseFilter

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from optdock.executor.executor_settings import ExecutorSettings
    from optdock.geometry.arrays import FloatArray
    from optdock.geometry.pose import Pose2
    from optdock.model.measurements import Detection

__all__ = ["STALE", "DockDetections", "covariance_from_dock"]

_VAGUE = 1.0  # [m], [rad]: a less certain detection says nothing, and must not count
# [s]: a detection that is stamped farther ahead of the clock is not used; one that is less far counts as of now, and up
# to `AHEAD`, which is rounding, as it is stamped.
_CLOCKS_APART = 0.25
STALE = 1.0  # [s]: a detection that took longer says where the dock was
_LEAST_SIGMA = 2e-4, 2e-4  # [m], [rad]: no detector is better, and none may make the covariance singular
_LATE = 0.04  # [s]: a delay of the detections against the odometry that is said, where it is known that well
# Near the dock the next detection after a gap counts for more, as no mean of many will show what has slipped: a burst
# takes 2 to 6 tenths of a wheel's way.
_NEAR_DOCK, _USUAL_GAP = 0.25, 0.01  # [m]
_SLIP, _SLIP_TURN = 0.3, 0.6  # of the way beyond that gap [1], [rad/m]
_LOOKS = 2  # detections whose stamps are remembered
_JITTER = 0.01  # [s]: of the stamps of detections, by exposure and drivers


class DockDetections:
    """The robot in the frame of the dock.

    Args:
        stored: Where the dock should be, in the fixed frame.
        settings: Noises, and how far from there a dock may be detected.
        robot: The robot in the fixed frame.
        report: Takes the name of an event and its detail.

    Attributes:
        filter: The pose of the robot in the frame of the dock.
        count: Number of detections that were believed.
        rejected: Number of those that were not.
        seen_from: The smallest distance from the docked pose at which the dock has been seen [m]; infinite before.
        seen_yaw: Of the dock in the fixed frame, when it was seen last [rad].
        too_far: How far from the stored dock the last one was that was of another dock [m]; 0: there was none.
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
        self._now, self._way, self._way_seen = -math.inf, 0.0, 0.0  # [s], [m], and [m] when it was seen last
        self._stamps: deque[float] = deque(maxlen=_LOOKS)  # of detections that were believed [s]
        self._delay_was_said = self._ahead_was_said = False

    @property
    def is_any(self) -> bool:
        """Whether the dock has been detected at all."""
        return self.filter.accepted > 0

    @property
    def is_contradicted(self) -> bool:
        """Whether the newest detections agree with each other and not with the estimate."""
        return self._settings.use_detections and self.filter.is_contradicted

    @property
    def dock(self) -> Pose2:
        """The docked pose in the fixed frame."""
        return self._robot.pose @ self.filter.pose.inverse() if self.is_any else self._stored

    def moved_since_seen(self, times: int = 1) -> float:
        """How far the robot has moved since the last accepted detections.

        Args:
            times: How many of them, 1 or 2.

        Returns:
            Distance from where the first of these was taken [m]; infinite if it is not remembered.
        """
        seen = self._stamps[-times] if len(self._stamps) >= times else -math.inf
        if not seen >= self.filter.remembered_from:
            return math.inf
        return self.filter.pose.distance_to(self.filter.pose_at(seen))

    def update(self, found: Iterable[Detection], stamp: float, offset: float, way: float) -> None:
        """Take in new detections.

        Args:
            found: In any order, on the clock of the detections.
            stamp: Now, on the clock that never goes back [s].
            offset: What that clock is ahead of the one of the detections [s].
            way: Driven so far, by odometry [m].
        """
        self._now, self._way = stamp, way
        for late in sorted(found, key=lambda detection: detection.stamp):
            detection = self._by_our_clock(late._replace(stamp=late.stamp + offset))
            age, sigmas = self._now - detection.stamp, (detection.position_sigma, detection.yaw_sigma)
            verdict, before = "forgotten", self.filter.pose
            seen = detection.pose.inverse()
            if age <= STALE and all(0.0 <= sigma <= _VAGUE for sigma in sigmas):
                noise = covariance_from_dock(seen, *map(max, sigmas, _LEAST_SIGMA))
                verdict = self._take(detection, seen, noise)
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
        self._say_delay()

    def _by_our_clock(self, detection: Detection) -> Detection:
        """A detection as of this moment, where the clock that stamped it is ahead; its true delay is learned."""
        ahead = detection.stamp - self._now
        if not AHEAD < ahead <= _CLOCKS_APART:
            return detection
        if not self._ahead_was_said:
            self._ahead_was_said = True
            self._report("detections ahead of the clock", f"by {1e3 * ahead:.0f} ms; taken for those of this moment")
        return detection._replace(stamp=self._now)

    def _take(self, detection: Detection, seen: Pose2, noise: FloatArray) -> str:
        """Hand a detection to the filter, unless it shows a dock where none is stored."""
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

    def _say_delay(self) -> None:
        """Say once that detections come with stamps that do not fit the odometry, as far as the motion shows."""
        delay, sigma = float(self.filter.systematic[2]), math.sqrt(max(float(self.filter.covariance[5, 5]), 0.0))
        if not self._delay_was_said and abs(delay) > _LATE and sigma < 0.25 * abs(delay):
            self._delay_was_said = True
            self._report(
                "detections look late" if delay > 0.0 else "odometry looks late",
                f"by {1e3 * abs(delay):.0f} ms, with a standard deviation of {1e3 * sigma:.0f} ms",
            )


def covariance_from_dock(robot: Pose2, position_sigma: float, yaw_sigma: float) -> FloatArray:
    """Covariance of the robot in the frame of the dock, where the dock is known in the frame of the robot.

    With D the dock seen from the robot and T its inverse, an error of D's yaw swings the robot about the dock.

    Args:
        robot: T.
        position_sigma: Of D's x and y, each [m].
        yaw_sigma: Of D's yaw [rad].

    Returns:
        Shape (3, 3) [m, m, rad].
    """
    swing = np.array([-robot.y, robot.x, 1.0])
    found: FloatArray = yaw_sigma**2 * np.multiply.outer(swing, swing)
    found[0, 0] += position_sigma**2
    found[1, 1] += position_sigma**2
    return found
