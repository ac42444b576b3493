"""Recorded motions after smoothing, and the standard deviations of what they were smoothed from."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from optdock.calibration.recording import Recording
    from optdock.geometry.arrays import FloatArray

__all__ = ["Noise", "RecordedMotion", "Seen", "Smoothed"]

_LEAST_SIGMA = 2e-4  # [m], [rad]: no detector is better


class Noise(NamedTuple):
    """Standard deviations of detections and of slip.

    Attributes:
        position: Of detected x and y at range 0, each [m].
        position_slope: What a metre of range adds [1].
        yaw: Of the detected yaw at range 0 [rad].
        yaw_slope: Likewise [rad/m].
        jitter: Of the stamps [s].
        slip: Of the way after a metre [m/m^0.5].
        slip_yaw: Of the heading after a metre [rad/m^0.5].
    """

    position: float = 0.004
    position_slope: float = 0.005
    yaw: float = 0.008
    yaw_slope: float = 0.01
    jitter: float = 0.01
    slip: float = 0.02
    slip_yaw: float = 0.04

    def sigmas(self, ranges: FloatArray, velocity: FloatArray) -> FloatArray:
        """Of x, y [m] and yaw [rad] of detections, Shape (n, 3).

        Args:
            ranges: Distance of the dock, Shape (n,) [m].
            velocity: Of the dock as the robot sees it, Shape (n, 3) [m/s, m/s, rad/s].
        """
        position = np.maximum(self.position + self.position_slope * ranges, _LEAST_SIGMA)
        yaw = np.maximum(self.yaw + self.yaw_slope * ranges, _LEAST_SIGMA)
        found: FloatArray = np.sqrt(np.column_stack((position, position, yaw)) ** 2 + (self.jitter * velocity) ** 2)
        return found


class Seen(NamedTuple):
    """Detections of one recording, beside what the smoothed motion makes of them.

    Attributes:
        stamps: As told, Shape (n,) [s].
        detected: The docked pose seen from the robot, Shape (n, 3).
        sigmas: Of x, y [m], yaw [rad], as estimated, Shape (n, 3).
        ranges: Distance of the docked pose, Shape (n,) [m].
        velocity: Of the dock as the robot sees it, Shape (n, 3) [m/s, m/s, rad/s].
        residuals: Detected minus expected: x, y [m], yaw [rad], in the robot's frame, Shape (n, 3).
        leverage: Share of each residual's variance that the fit has taken away, Shape (n, 3).
    """

    stamps: FloatArray
    detected: FloatArray
    sigmas: FloatArray
    ranges: FloatArray
    velocity: FloatArray
    residuals: FloatArray
    leverage: FloatArray


class Smoothed(NamedTuple):
    """One recording with its odometry corrected.

    Attributes:
        recording: Which.
        times: Of the odometry, Shape (n,) [s].
        seen_from_dock: The robot in the frame of the dock, Shape (n, 3).
        seen: Its detections.
    """

    recording: Recording
    times: FloatArray
    seen_from_dock: FloatArray
    seen: Seen


class RecordedMotion(NamedTuple):
    """What is common to all recordings.

    Attributes:
        values: Scale [1], drift [rad/m], turn scale [1], delay [s], Shape (4,).
        covariance: Of them, Shape (4, 4); 1.96 standard deviations are half of a 95 % confidence interval.
        noise: Of detections and slip.
        of: The recordings that it is of.
    """

    values: FloatArray
    covariance: FloatArray
    noise: Noise
    of: tuple[Smoothed, ...]
