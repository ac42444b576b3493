"""Laser scans, and the points that they stand for."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from optdock.errors import InvalidValue
from optdock.geometry.arrays import FrozenArrays, readonly
from optdock.geometry.pose import transform_points

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray
    from optdock.geometry.pose import Pose2

__all__ = ["LaserScan"]

_BELOW_MAX = 1e-4  # [m]; Nav2 puts beams without return this far below range_max


@dataclass(frozen=True, eq=False)
class LaserScan(FrozenArrays):
    """One sweep of a range finder (ROS: `sensor_msgs/LaserScan`).

    Args:
        ranges: Shape (n,) [m]; +inf: nothing within range; NaN, -inf, or outside range_min..range_max: no measurement.
        angle_min: Direction of the first beam, counter-clockwise from the sensor's x axis [rad].
        angle_increment: Angle between beams [rad], negative for clockwise sensors.
        range_min: Shortest distance that counts [m].
        range_max: Longest distance that counts [m].

    Raises:
        InvalidValue: ranges has not one dimension, an angle is not finite, or not 0 <= range_min < range_max < inf.
    """

    ranges: FloatArray
    angle_min: float
    angle_increment: float
    range_min: float
    range_max: float

    def __post_init__(self) -> None:
        try:
            ranges = np.array(self.ranges, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise InvalidValue(f"scan.ranges: must be numbers, got {self.ranges!r}") from error
        if ranges.ndim != 1:
            raise InvalidValue(f"scan.ranges: must have shape (n,), got {ranges.shape}")
        for name in ("angle_min", "angle_increment"):
            if not math.isfinite(getattr(self, name)):
                raise InvalidValue(f"scan.{name}: must be finite, got {getattr(self, name)}")
        if not 0.0 <= self.range_min < self.range_max < math.inf:
            raise InvalidValue(f"scan: needs 0 <= range_min < range_max < inf, got {self.range_min}, {self.range_max}")
        object.__setattr__(self, "ranges", readonly(ranges))

    def points_from(self, sensor: Pose2, *, inf_is_valid: bool) -> FloatArray:
        """Ends of the measured beams in the world, Shape (m, 2) [m]; the others are dropped.

        Args:
            sensor: Pose of the sensor in the world.
            inf_is_valid: Whether a beam of +inf ends just below range_max; False drops it.
        """
        ranges = np.where(np.isposinf(self.ranges) & inf_is_valid, self.range_max - _BELOW_MAX, self.ranges)
        measured = np.nonzero((ranges >= self.range_min) & (ranges <= self.range_max))[0]
        angle = self.angle_min + measured * self.angle_increment
        local = ranges[measured, None] * np.column_stack((np.cos(angle), np.sin(angle)))
        points: FloatArray = transform_points(sensor.as_array()[None], local)[0]
        return points
