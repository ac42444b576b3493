"""The moving reference: a trajectory played back at a rate between 0 and 1 that changes smoothly."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from optdock.geometry.pose import Pose2, Twist2

if TYPE_CHECKING:
    from optdock.limits import MotionLimits
    from optdock.trajectory import Trajectory

__all__ = ["Reference"]

_SETTLING = 0.2  # [s], time constant with which the rate approaches its target
_AT_REST = 1e-6  # [m/s]: a standing reference may change its rate at once
_SAMPLES = 400  # for the peak speed and the nearest point


class Reference:
    """Where the robot should be now: `trajectory` at time `time`, which runs at `rate` seconds per second.

    A rate below 1 scales the speed by the rate and every acceleration by its square, so a trajectory within its
    limits stays within them. A change of rate adds `speed * d rate/dt`; it is bounded so that the sum
    `rate^2 * acceleration + speed * d rate/dt` stays within the limits too.
    """

    def __init__(self, trajectory: Trajectory) -> None:
        self.trajectory = trajectory
        self.time = 0.0
        self.rate = 1.0
        grid = trajectory.sample_at(np.linspace(0.0, trajectory.duration, _SAMPLES))
        # Speed peaks lie at phase borders or inside a phase; the grid adds what the borders miss.
        self.peak_speed = max(float(np.max(np.abs(grid.speed))), float(np.max(trajectory.time_law.states[:, 1])))
        self.peak_acceleration = float(np.max(np.abs(trajectory.time_law.states[:, 2])))
        self._grid = grid

    @property
    def finished(self) -> bool:
        """Whether the trajectory's end is reached."""
        return self.time >= self.trajectory.duration

    @property
    def pose(self) -> Pose2:
        """The reference pose now."""
        return self.trajectory.at(self.time).pose

    @property
    def gear(self) -> int:
        """1 forward, -1 reverse."""
        s = self.trajectory.time_law.at(self.time)[0, 0]
        return int(self.trajectory.path.direction_at(s)[0])

    def jump_to_nearest(self, pose: Pose2) -> None:
        """Set the time to that of the trajectory's point nearest to `pose`."""
        distance = np.hypot(self._grid.x - pose.x, self._grid.y - pose.y)
        self.time = float(self._grid.t[int(np.argmin(distance))])

    def match_speed(self, linear: float) -> None:
        """Begin at the rate at which the reference is no faster than a robot at `linear` m/s."""
        speed = self.trajectory.at(self.time).twist.linear
        if abs(speed) > _AT_REST:
            self.rate = min(1.0, max(0.0, linear / speed))

    def velocity(self, preview: float) -> Twist2:
        """The reference velocity `preview` seconds from now at the present rate."""
        ahead = self.time + self.rate * preview
        if ahead >= self.trajectory.duration:
            return Twist2()
        twist = self.trajectory.at(ahead).twist
        return Twist2(self.rate * twist.linear, self.rate * twist.angular)

    def advance(self, period: float, target_rate: float, limits: MotionLimits, *, urgent: bool = False) -> None:
        """Let `period` seconds pass while the rate approaches `target_rate`, at once when `urgent`."""
        _, speed, acceleration, _ = self.trajectory.time_law.at(self.time)[0]
        before = self.rate
        if speed <= _AT_REST or abs(target_rate - before) < 1e-6:
            self.rate = before = target_rate
        else:
            lowest, highest = _rate_bounds(speed, before**2 * acceleration, limits)
            wanted = (target_rate - before) / (period if urgent else _SETTLING)
            self.rate = min(1.0, max(0.0, before + period * min(max(wanted, lowest), highest)))
        self.time = min(self.trajectory.duration, self.time + 0.5 * (before + self.rate) * period)


def _rate_bounds(speed: float, acceleration: float, limits: MotionLimits) -> tuple[float, float]:
    """Bounds of d rate/dt [1/s] that keep the played-back acceleration within the limits."""
    lowest = min(0.0, -(limits.max_deceleration + acceleration) / speed)
    return lowest, max(0.0, (limits.max_acceleration - acceleration) / speed)
