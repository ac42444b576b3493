"""Odometry: encoder ticks, integrated with the assumed wheel radius and track width, late and partly repeated."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from optdock.geometry.pose import Pose2, Twist2

if TYPE_CHECKING:
    import numpy as np

    from experiments.docking.field.drive import Drive

__all__ = ["Odometry", "OdometryMessage", "OdometryState"]

_INSTANT = 1e-9  # [s]: rounding of times that are sums of sub-steps
_STRAIGHT = 1e-9  # [rad]: the chord of a smaller turn equals its arc


@dataclass(frozen=True)
class Odometry:
    """Parameters of the wheel odometry. Ranges are (lowest, highest) of a uniform distribution.

    Args:
        ticks: Encoder ticks per revolution.
        period: Time between two readings [s].
        window: Averaging time of the twist [s]; it delays a change of speed by half of it.
        delay: Delay of a message [s]; messages stay in order.
        stamp_jitter: Largest delay of the stamp after the reading [s].
        repeats: Share of the control cycles that receive the message of the previous cycle again [1].
        tells_pose: Whether the integrated pose is reported; the twist always is.
    """

    ticks: int = 4096
    period: float = 0.01
    window: float = 0.04
    delay: tuple[float, float] = (0.0, 0.02)
    stamp_jitter: float = 0.004
    repeats: float = 0.02
    tells_pose: bool = True


class OdometryMessage(NamedTuple):
    """Odometry message: stamp [s], pose in the odometry frame, and twist."""

    stamp: float
    pose: Pose2
    twist: Twist2


class OdometryState:
    """Encoder readings and queued messages.

    Args:
        odometry: Odometry parameters.
        drive: Drive with the assumed radius and width.
        random: Generator of delays, jitter and repeats.

    Attributes:
        pose: Pose of the latest reading, reported or not.
    """

    def __init__(self, odometry: Odometry, drive: Drive, random: np.random.Generator) -> None:
        self.odometry = odometry
        self._random = random
        self._per_tick = 2.0 * math.pi * drive.wheel_radius / odometry.ticks  # [m]
        self._width = drive.track_width
        self.pose = Pose2(0.0, 0.0, 0.0)
        readings = max(1, round(odometry.window / odometry.period))
        self._readings: deque[tuple[int, int]] = deque([(0, 0)], maxlen=readings + 1)
        self._window = readings * odometry.period
        self._told = OdometryMessage(0.0, self.pose, Twist2())
        self._under_way: deque[tuple[float, OdometryMessage]] = deque()

    def ticks_of(self, angle: float) -> int:
        """Return the whole encoder ticks of a wheel rotated by `angle` [rad]."""
        return math.floor(angle * self.odometry.ticks / (2.0 * math.pi))

    def read(self, time: float, left: float, right: float) -> None:
        """Read both encoders.

        Args:
            time: [s].
            left: Rotation angle of the left wheel [rad].
            right: Rotation angle of the right wheel [rad].
        """
        ticks = self.ticks_of(left), self.ticks_of(right)
        before = self._readings[-1]
        self._readings.append(ticks)
        self.pose = self._moved(self.pose, ticks[0] - before[0], ticks[1] - before[1])
        oldest = self._readings[0]
        way_left = self._per_tick * (ticks[0] - oldest[0])
        way_right = self._per_tick * (ticks[1] - oldest[1])
        twist = Twist2(
            0.5 * (way_left + way_right) / self._window, (way_right - way_left) / (self._width * self._window)
        )
        late, wait = self._random.random(2).tolist()
        stamp = time + late * self.odometry.stamp_jitter
        lowest, highest = self.odometry.delay
        arrival = stamp + lowest + wait * (highest - lowest)
        if self._under_way:
            arrival = max(arrival, self._under_way[-1][0])
        self._under_way.append((arrival, OdometryMessage(stamp, self.pose, twist)))

    def newest(self, time: float) -> OdometryMessage:
        """Return the newest message that has arrived, or the previous one again."""
        repeated = float(self._random.random()) < self.odometry.repeats
        while not repeated and self._under_way and self._under_way[0][0] <= time + _INSTANT:
            self._told = self._under_way.popleft()[1]
        return self._told

    def _moved(self, pose: Pose2, left: int, right: int) -> Pose2:
        """Return a pose advanced by the given ticks."""
        way, turn = 0.5 * self._per_tick * (left + right), self._per_tick * (right - left) / self._width
        half = 0.5 * turn
        chord = way * math.sin(half) / half if abs(half) > _STRAIGHT else way
        heading = pose.yaw + half
        return Pose2(pose.x + chord * math.cos(heading), pose.y + chord * math.sin(heading), pose.yaw + turn)
