"""Where the robot is: measured poses, filtered by what odometry says of the motion between them.

An extended Kalman filter of (x, y, yaw) ([Thrun2005] ch. 3 and 7): odometry moves the estimate along arcs, and a
measured pose corrects it by as much as the two covariances say. A measurement outside the gate is left out; when a few
in a row lie outside and agree with each other, the world has moved and not the robot: the estimate jumps there, and
says so.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections import deque
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.errors import InvalidValue
from optdock.geometry.checked import finite_number
from optdock.geometry.pose import Pose2, Twist2, normalize_angle

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray

__all__ = ["PoseFilter"]

_GATE = 16.27  # 99.9 percent of chi-squared with three degrees of freedom
_ALWAYS_NEAR = (
    0.005,
    0.01,
)  # [m], [rad]: no measurement is left out for less
_AGREEING = 4  # measurements in a row that lie outside, at one place: 40 ms at 100 Hz, 200 ms at 20 Hz
_RESTING_DRIFT = (5e-4, 5e-4)  # [m/s^0.5], [rad/s^0.5]: lets a standing robot follow a localization that wanders
_TURN_DRIFT = 0.01  # [rad/rad^0.5], of odometry that turns
_MEMORY = 1.0  # [s] of motion that is remembered, for what arrives late


class PoseFilter:
    """Pose of the robot from measured poses and twists, at any rate.

    Args:
        position_sigma: Standard deviation of a measured x or y [m].
        yaw_sigma: Of a measured yaw [rad].
        position_drift: Of odometry, after a metre [m/m^0.5]; it grows with the square root of the way.
        yaw_drift: Likewise [rad/m^0.5].

    Attributes:
        covariance: Of x, y and yaw in the fixed frame, Shape (3, 3).
        jump: How far the last update moved the estimate at once, as seen from where it was; None where it did not jump.
        rejected: Measurements in a row that were left out, up to now.

    Raises:
        InvalidValue: A standard deviation is negative or not finite.
    """

    def __init__(
        self, position_sigma: float, yaw_sigma: float, *, position_drift: float = 0.003, yaw_drift: float = 0.003
    ) -> None:
        sigmas = {
            "position_sigma": position_sigma, "yaw_sigma": yaw_sigma,
            "position_drift": position_drift, "yaw_drift": yaw_drift,
        }  # fmt: skip
        for name, value in sigmas.items():
            if not finite_number(value, f"pose filter: {name}") >= 0.0:
                raise InvalidValue(f"pose filter: {name}: must be >= 0, got {value}")
        self._noise = np.diag([position_sigma**2, position_sigma**2, yaw_sigma**2])
        self._drift = position_drift, yaw_drift
        self.covariance: FloatArray = self._noise.copy()
        self.jump: Pose2 | None = None
        self.rejected = 0
        self._estimate: Pose2 | None = None
        self._twist = Twist2()
        self._measured_at = -math.inf
        self._outside: list[_Outside] = []
        # Dead reckoning: what lies back is the estimate now, moved back, so that it never stands in an older frame.
        self._stamps: deque[float] = deque()
        self._reckoned: deque[Pose2] = deque()

    @property
    def started(self) -> bool:
        """Whether there is an estimate."""
        return self._estimate is not None

    @property
    def pose(self) -> Pose2:
        """The estimate at the last stamp.

        Raises:
            InvalidValue: There has been no measured pose yet.
        """
        if self._estimate is None:
            raise InvalidValue("pose filter: has no pose yet; the first update must bring one")
        return self._estimate

    @property
    def stamp(self) -> float:
        """Of the last update [s]; -inf before the first."""
        return self._stamps[-1] if self._stamps else -math.inf

    @property
    def measured_at(self) -> float:
        """Stamp of the last measured pose that was believed [s]; -inf before the first."""
        return self._measured_at

    def update(self, stamp: float, measured: Pose2 | None, twist: Twist2) -> Pose2:
        """The estimate at `stamp`; an update of the same stamp as the last changes nothing.

        Args:
            stamp: When pose and twist were measured [s], on a monotonic clock.
            measured: The pose; None where there is none this time.
            twist: Body velocity of the odometry.

        Raises:
            InvalidValue: The clock went back, or the first update brings no pose.
        """
        stamp = finite_number(stamp, "pose filter: stamp")
        if stamp < self.stamp:
            raise InvalidValue(f"pose filter: the clock went back, from {self.stamp} s to {stamp} s")
        if stamp == self.stamp:
            return self.pose
        self.jump = None
        if self._estimate is None:
            if measured is None:
                return self.pose  # which says what is missing
            self._estimate, self._measured_at = measured, stamp
            self._remember(stamp, measured)
        else:
            step = self._predict(stamp - self.stamp, twist)
            self._remember(stamp, self._reckoned[-1] @ step)
            if measured is not None:
                self._correct(stamp, measured)
        self._twist = twist
        return self.pose

    def pose_at(self, stamp: float) -> Pose2:
        """Where the robot was at `stamp` [s], as it is known now; later than the last update, where it will be.

        Of the past there is a second; what lies further back is refused.

        Raises:
            InvalidValue: It lies further back, or there has been no measured pose yet.
        """
        pose, last = self.pose, self.stamp
        if stamp >= last:
            return pose.moved(self._twist, stamp - last)
        if stamp < self._stamps[0]:
            raise InvalidValue(
                f"pose filter: the motion is remembered from {self._stamps[0]} s on, asked for {stamp} s"
            )
        after = bisect_right(self._stamps, stamp)
        before = self._reckoned[after - 1]
        share = (stamp - self._stamps[after - 1]) / (self._stamps[after] - self._stamps[after - 1])
        step = self._reckoned[after].in_frame_of(before)
        then = before.moved(_arc(step), share)
        return pose @ (self._reckoned[-1].inverse() @ then)

    def _predict(self, period: float, twist: Twist2) -> Pose2:
        """Move on by the mean of the velocities at both ends, which is exact to second order; the step made."""
        mean = Twist2(
            0.5 * (self._twist.linear + twist.linear),
            0.5 * (self._twist.angular + twist.angular),
            0.5 * (self._twist.lateral + twist.lateral),
        )
        before = self.pose
        step = Pose2(0.0, 0.0, 0.0).moved(mean, period)
        after = self._estimate = before @ step
        way, turn = period * math.hypot(mean.linear, mean.lateral), period * abs(mean.angular)
        place = self._drift[0] ** 2 * way + _RESTING_DRIFT[0] ** 2 * period
        yaw = self._drift[1] ** 2 * way + _TURN_DRIFT**2 * turn + _RESTING_DRIFT[1] ** 2 * period
        slope = np.array([[1.0, 0.0, before.y - after.y], [0.0, 1.0, after.x - before.x], [0.0, 0.0, 1.0]])
        self.covariance = slope @ self.covariance @ slope.T + np.diag([place, place, yaw])
        return step

    def _remember(self, stamp: float, reckoned: Pose2) -> None:
        self._stamps.append(stamp)
        self._reckoned.append(reckoned)
        while len(self._stamps) > 2 and self._stamps[1] <= stamp - _MEMORY:
            self._stamps.popleft()
            self._reckoned.popleft()

    def _correct(self, stamp: float, measured: Pose2) -> None:
        pose = self.pose
        miss = np.array([measured.x - pose.x, measured.y - pose.y, normalize_angle(measured.yaw - pose.yaw)])
        spread = self.covariance + self._noise
        near = math.hypot(miss[0], miss[1]) <= _ALWAYS_NEAR[0] and abs(miss[2]) <= _ALWAYS_NEAR[1]
        if not near and float(miss @ np.linalg.solve(spread, miss)) > _GATE:
            self._outlie(stamp, measured)
            return
        gain = self.covariance @ np.linalg.inv(spread)
        x, y, yaw = (gain @ miss).tolist()
        self._estimate = Pose2(pose.x + x, pose.y + y, pose.yaw + yaw)
        rest = np.eye(3) - gain
        self.covariance = rest @ self.covariance @ rest.T + gain @ self._noise @ gain.T
        self._believe(stamp)

    def _outlie(self, stamp: float, measured: Pose2) -> None:
        """A measurement outside the gate: an outlier, or one of the first after a jump."""
        pose, reckoned = self.pose, self._reckoned[-1]
        seen = [miss.moved_on(reckoned).in_frame_of(measured) for miss in self._outside]
        gate = math.sqrt(2.0 * _GATE)
        place = max(gate * math.sqrt(self._noise[0, 0]), _ALWAYS_NEAR[0])
        turn = max(gate * math.sqrt(self._noise[2, 2]), _ALWAYS_NEAR[1])
        if not all(math.hypot(each.x, each.y) <= place and abs(each.yaw) <= turn for each in seen):
            self._outside.clear()
            seen.clear()
        self._outside.append(_Outside(measured, reckoned))
        self.rejected += 1
        if len(self._outside) < _AGREEING:
            return
        x, y, yaw = np.sum([each.as_array() for each in seen], axis=0) / _AGREEING
        self._estimate = measured @ Pose2(x, y, yaw)
        self.jump = self._estimate.in_frame_of(pose)
        self.covariance = self._noise.copy()
        self._believe(stamp)

    def _believe(self, stamp: float) -> None:
        self._measured_at, self.rejected = stamp, 0
        self._outside.clear()


class _Outside(NamedTuple):
    """A measured pose outside the gate, and where dead reckoning was then."""

    measured: Pose2
    reckoned: Pose2

    def moved_on(self, reckoned: Pose2) -> Pose2:
        """Where it would be now, dead reckoning being at `reckoned`."""
        return self.measured @ (self.reckoned.inverse() @ reckoned)


def _arc(step: Pose2) -> Twist2:
    """The constant twist that makes `step` in one second, its inverse: `Pose2.moved`."""
    half = 0.5 * normalize_angle(step.yaw)
    grow = half / math.sin(half) if abs(half) > 1e-9 else 1.0
    c, s = math.cos(half), math.sin(half)
    return Twist2(grow * (c * step.x + s * step.y), 2.0 * half, grow * (c * step.y - s * step.x))
