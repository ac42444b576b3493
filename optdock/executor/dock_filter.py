"""Where the dock is, seen from the robot: late, noisy detections, joined by the odometry in between.

What must be exact at the dock is the robot's pose relative to it, and localization has no part in that: its error is
the same for both. So the dock is estimated in the frame of the odometry, in which the robot's pose is known at every
instant, also at the instant of a late detection. A detection then measures the dock directly, with the detector's
noise alone; what the odometry gets wrong while the robot drives lets the estimate forget [BarShalom2001]. The pose of
the localization is needed for nothing but the map: obstacles, and a dock that has not been seen yet.
"""

from __future__ import annotations

import bisect
import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.geometry.pose import Pose2, normalize_angle

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray
    from optdock.geometry.pose import Twist2
    from optdock.measurements import Detection

__all__ = ["DeadReckoning", "DockFilter", "PoseEstimate"]

GATE = 16.27  # squared Mahalanobis distance in three dimensions that one measurement of 1000 exceeds
_REMEMBERED = 2.0  # [s]: detections that are older come too late


class PoseEstimate:
    """A pose and its covariance, corrected by measurements of it; outliers are put aside until they agree.

    Args:
        mean: The first estimate.
        covariance: Shape (3, 3) [m, m, rad].
        confirmations: So many measurements in a row that do not fit, but fit each other, are believed.

    Attributes:
        mean: The estimate.
        covariance: Shape (3, 3).
        accepted: Number of measurements taken in.
    """

    def __init__(self, mean: Pose2, covariance: FloatArray, confirmations: int) -> None:
        self.mean, self.covariance, self.accepted = mean, covariance, 0
        self._confirmations = confirmations
        self._aside: list[Pose2] = []

    def restart(self, mean: Pose2, covariance: FloatArray) -> None:
        """Forget everything else."""
        self.mean, self.covariance = mean, covariance
        self._aside.clear()

    def correct(self, measured: Pose2, noise: FloatArray) -> str:
        """Take in a measurement with the covariance `noise`, Shape (3, 3); `accepted`, `rejected` or `moved`."""
        innovation = _difference(measured, self.mean)
        spread = self.covariance + noise
        weighed = np.linalg.solve(spread, np.column_stack((innovation, self.covariance)))
        if float(innovation @ weighed[:, 0]) <= GATE:
            change = self.covariance @ weighed[:, 0]
            self.mean = _shifted(self.mean, change)
            left = self.covariance - self.covariance @ weighed[:, 1:]
            self.covariance = 0.5 * (left + left.T)
            self._aside.clear()
            self.accepted += 1
            return "accepted"
        return self._put_aside(measured, noise)

    def _put_aside(self, measured: Pose2, noise: FloatArray) -> str:
        # Two measurements of one pose differ by twice their noise.
        fits = [pose for pose in self._aside if _distance(_difference(measured, pose), 2.0 * noise) <= GATE]
        self._aside = [*fits, measured] if len(fits) == len(self._aside) else [measured]
        count = len(self._aside)
        if count < self._confirmations:
            return "rejected"
        offsets = np.array([_difference(pose, measured) for pose in self._aside])
        self.restart(_shifted(measured, offsets.mean(axis=0)), noise / count)
        self.accepted += count
        return "moved"


def _difference(pose: Pose2, reference: Pose2) -> FloatArray:
    return np.array([pose.x - reference.x, pose.y - reference.y, normalize_angle(pose.yaw - reference.yaw)])


def _shifted(pose: Pose2, change: FloatArray) -> Pose2:
    return Pose2(pose.x + float(change[0]), pose.y + float(change[1]), pose.yaw + float(change[2]))


def _distance(difference: FloatArray, covariance: FloatArray) -> float:
    return float(difference @ np.linalg.solve(covariance, difference))


class _Reading(NamedTuple):
    stamp: float
    pose: Pose2
    twist: Twist2


class DeadReckoning:
    """The robot's pose by odometry alone, from where it began, now and a little while ago."""

    def __init__(self, stamp: float, twist: Twist2) -> None:
        self._readings = [_Reading(stamp, Pose2(0.0, 0.0, 0.0), twist)]

    @property
    def pose(self) -> Pose2:
        """Now."""
        return self._readings[-1].pose

    def advance(self, stamp: float, twist: Twist2) -> Twist2:
        """Go on to a new reading; the way since the last one as a twist over its time [m, rad]."""
        last = self._readings[-1]
        # Speeds change steadily between two readings, not all at once at the second.
        mean = type(twist)(0.5 * (last.twist.linear + twist.linear), 0.5 * (last.twist.angular + twist.angular))
        period = stamp - last.stamp
        self._readings.append(_Reading(stamp, last.pose.moved(mean, period), twist))
        if self._readings[0].stamp < stamp - 2.0 * _REMEMBERED:
            del self._readings[: bisect.bisect_left(self._readings, stamp - _REMEMBERED, key=lambda r: r.stamp)]
        return type(twist)(mean.linear * period, mean.angular * period)

    def at(self, stamp: float) -> Pose2 | None:
        """The pose at an earlier instant; None where it is forgotten, or has not come yet."""
        readings = self._readings
        if not readings[0].stamp <= stamp <= readings[-1].stamp + _AHEAD:
            return None
        i = bisect.bisect_right(readings, stamp, key=lambda r: r.stamp) - 1
        before = readings[i]
        if i + 1 == len(readings):
            return before.pose
        after = readings[i + 1]
        share = (stamp - before.stamp) / (after.stamp - before.stamp)
        mean = type(before.twist)(
            before.twist.linear + 0.5 * share * (after.twist.linear - before.twist.linear),
            before.twist.angular + 0.5 * share * (after.twist.angular - before.twist.angular),
        )
        return before.pose.moved(mean, stamp - before.stamp)


_LEAST_SIGMA = 2e-4, 2e-4  # [m], [rad]: no detector is better, and none may make the covariance singular
_AHEAD = 1e-3  # [s]: rounding of stamps


class DockFilter(PoseEstimate):
    """The docked robot's pose in the frame of the odometry.

    Args:
        stored: Where it should be, in that frame.
        position_sigma: Of that, each of x and y [m].
        yaw_sigma: [rad].
        confirmations: Detections in a row that agree with each other and not with the estimate, until it follows them.
    """

    def __init__(self, stored: Pose2, position_sigma: float, yaw_sigma: float, confirmations: int = 4) -> None:
        super().__init__(stored, np.diag([position_sigma**2, position_sigma**2, yaw_sigma**2]), confirmations)
        self.last_stamp = -math.inf

    def forget(self, robot: Pose2, along: float, turn: float, drift: float) -> None:
        """What motion makes uncertain: the dock as seen from a robot whose odometry errs.

        Args:
            robot: By odometry.
            along: Standard deviation of the way driven [m].
            turn: Of its turn [rad]; it swings the dock about the robot.
            drift: Of the dock's own motion [m].
        """
        c, s = math.cos(robot.yaw), math.sin(robot.yaw)
        ahead = np.array([c, s, 0.0])
        swing = np.array([robot.y - self.mean.y, self.mean.x - robot.x, 1.0])
        grown = along * along * np.multiply.outer(ahead, ahead) + turn * turn * np.multiply.outer(swing, swing)
        grown[0, 0] += drift * drift
        grown[1, 1] += drift * drift
        self.covariance = self.covariance + grown

    def widen(self, distance: float, turn: float) -> None:
        """Believe that the robot may have been moved by so much, unseen by its odometry [m, rad]."""
        self.covariance = self.covariance + np.diag([distance**2, distance**2, turn**2])

    def see(self, detection: Detection, robot: Pose2) -> str:
        """Take in a detection made at `robot`, by odometry; `accepted`, `rejected` or `moved`."""
        place, turn = max(detection.position_sigma, _LEAST_SIGMA[0]), max(detection.yaw_sigma, _LEAST_SIGMA[1])
        noise = np.diag([place**2, place**2, turn**2])
        verdict = self.correct(robot @ detection.pose, noise)
        if verdict != "rejected":
            self.last_stamp = detection.stamp
        return verdict

    @property
    def position_sigma(self) -> float:
        """Of x and y, the larger one [m]."""
        return math.sqrt(max(float(self.covariance[0, 0]), float(self.covariance[1, 1])))

    @property
    def yaw_sigma(self) -> float:
        """[rad]."""
        return math.sqrt(float(self.covariance[2, 2]))
