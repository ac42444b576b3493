"""Localization in a map, similar to AMCL: low rate, latency, and an error that drifts and jumps."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from optdock.geometry.pose import Pose2

if TYPE_CHECKING:
    import numpy as np

__all__ = ["Localization", "LocalizationState"]

_INSTANT = 1e-9  # [s]: rounding of times that are sums of sub-steps


@dataclass(frozen=True)
class Localization:
    """Parameters of the localization in the fixed frame. Ranges are (lowest, highest) of a uniform distribution.

    The error is a displacement of the true pose in the fixed frame: a Gauss-Markov process, plus an offset that every
    second jump adds and the next jump removes.

    Args:
        period: Time between two estimates [s].
        latency: Latency of each estimate [s].
        drift: Standard deviation of the drifting error in x and y [m].
        drift_yaw: Standard deviation of the drifting error in yaw [rad].
        drift_time: Correlation time of the drift [s].
        jump_pause: Mean time between two jumps [s]; infinite: none.
        jump: Distance of a jump [m].
        jump_yaw: Largest rotation of a jump [rad].
        lost_for: Duration of one loss of localization per run [s].
        lost_from: Start time of the loss [s].
        composed: Whether the reported pose is the newest correction of the odometry applied to the newest odometry,
            without a separate stamp, as in a lookup of the transforms map, odom and base; otherwise each estimate is
            reported once, with the stamp of its measurement.
    """

    period: float = 0.2
    latency: float = 0.15
    drift: float = 0.015
    drift_yaw: float = math.radians(0.3)
    drift_time: float = 10.0
    jump_pause: float = 12.0
    jump: tuple[float, float] = (0.03, 0.05)
    jump_yaw: float = math.radians(1.0)
    lost_for: float = 0.0
    lost_from: tuple[float, float] = (2.0, 8.0)
    composed: bool = True


class _Estimate(NamedTuple):
    """One estimate: measurement time and arrival time [s], the pose, and the resulting origin of the odometry."""

    stamp: float
    arrival: float
    pose: Pose2
    correction: Pose2


class LocalizationState:
    """Localization that queues its estimates until they arrive.

    Args:
        localization: Localization parameters.
        random: Generator of drift, jumps and the loss.
    """

    def __init__(self, localization: Localization, random: np.random.Generator) -> None:
        self.localization, self._random = localization, random
        deviations = localization.drift, localization.drift, localization.drift_yaw
        self._deviations = deviations
        self._drift = [sigma * float(random.standard_normal()) for sigma in deviations]
        self._keep = math.exp(-localization.period / localization.drift_time)
        self._offset: Pose2 | None = None
        self._next_jump = self._wait()
        lowest, highest = localization.lost_from
        self._lost_from = lowest + float(random.random()) * (highest - lowest)
        self._under_way: deque[_Estimate] = deque()
        self._correction: Pose2 | None = None

    def estimate(self, time: float, true: Pose2, odometry: Pose2) -> None:
        """Take a measurement.

        Args:
            time: [s].
            true: True pose.
            odometry: Odometry pose at the same time.
        """
        self._wander(time)
        x, y, yaw = self._drift
        jumped = self._offset or Pose2(0.0, 0.0, 0.0)
        pose = Pose2(true.x + x + jumped.x, true.y + y + jumped.y, true.yaw + yaw + jumped.yaw)
        found = _Estimate(time, time + self.localization.latency, pose, pose @ odometry.inverse())
        self._under_way.append(found)
        if self._correction is None:  # the robot stood there long before the start of the run
            self._correction = found.correction

    def reported(self, time: float, odometry: Pose2) -> tuple[Pose2 | None, float | None]:
        """Return the reported pose, and its stamp if it has a separate one [s].

        Args:
            time: Time of the control cycle [s].
            odometry: Newest odometry pose.
        """
        newest = None
        while self._under_way and self._under_way[0].arrival <= time + _INSTANT:
            newest = self._under_way.popleft()
            self._correction = newest.correction
        if 0.0 <= time - self._lost_from < self.localization.lost_for:
            return None, None
        if self.localization.composed:
            return (None if self._correction is None else self._correction @ odometry), None
        return (None, None) if newest is None else (newest.pose, newest.stamp)

    def _wait(self) -> float:
        pause = self.localization.jump_pause
        return float(self._random.exponential(pause)) if math.isfinite(pause) else math.inf

    def _wander(self, time: float) -> None:
        """Advance the drift of the error, and jump if a jump is due."""
        fresh = math.sqrt(1.0 - self._keep**2)
        steps = self._random.standard_normal(3).tolist()
        self._drift = [
            self._keep * value + fresh * sigma * step
            for value, sigma, step in zip(self._drift, self._deviations, steps, strict=True)
        ]
        if time < self._next_jump:
            return
        lowest, highest = self.localization.jump
        far, bearing, turn = self._random.random(3).tolist()
        distance, angle = lowest + far * (highest - lowest), 2.0 * math.pi * bearing
        there = Pose2(
            distance * math.cos(angle), distance * math.sin(angle), (2.0 * turn - 1.0) * self.localization.jump_yaw
        )
        self._offset = there if self._offset is None else None
        self._next_jump = time + self._wait()
