"""The moving reference: a trajectory played back at a rate between 0 and 1 that changes smoothly."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.geometry.pose import Pose2, Twist2

if TYPE_CHECKING:
    from optdock.limits import MotionLimits
    from optdock.trajectory import Trajectory

__all__ = ["Reference", "ReferenceState"]

_AT_REST = 1e-6  # [m/s]: a standing reference may change its rate at once
_AT_START = 0.05  # [m]: a robot nearer to the start than this begins there
_SAMPLES = 400  # for the peak speed and the nearest point


class ReferenceState(NamedTuple):
    """The reference at one instant.

    `speed`, `acceleration`: of the trajectory itself, along its travel, at rate 1 [m/s, m/s^2]; where it turns in place
    those of its yaw [rad/s, rad/s^2]. `gear`: 1 or -1, 0 where it turns in place; `turn`: 1 or -1 there, 0 elsewhere.
    `previewed`: velocity a little later, scaled by the rate; zero beyond the end.
    """

    pose: Pose2
    gear: float
    turn: float
    speed: float
    acceleration: float
    previewed: Twist2

    def lag_of(self, error: Pose2) -> float:
        """How far along the travel, or along the turn, the reference is ahead of a robot that sees it at `error`."""
        return error.x * self.gear + error.yaw * self.turn


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
        driven = trajectory.path.direction_at(trajectory.time_law.states[:, 0]) != 0
        v, a = (np.max(np.abs(trajectory.time_law.states[driven, i]), initial=0.0) for i in (1, 2))
        self.peak_speed, self.peak_acceleration = max(float(np.max(np.abs(grid.speed))), float(v)), float(a)
        self._grid = grid

    @property
    def finished(self) -> bool:
        """Whether the trajectory's end is reached."""
        return self.time >= self.trajectory.duration

    def state(self, preview: float) -> ReferenceState:
        """The reference now, and its velocity `preview` seconds from now at the present rate."""
        ahead = self.time + self.rate * preview
        row = self.trajectory.sample_at((self.time, ahead))
        speed = float(row.speed[0])
        gear = (
            math.copysign(1.0, speed) if abs(speed) > _AT_REST else float(self.trajectory.path.direction_at(row.s)[0])
        )
        turn = math.copysign(1.0, float(self.trajectory.path.curvature_at(row.s)[0])) if gear == 0.0 else 0.0
        share = self.rate if ahead < self.trajectory.duration else 0.0
        return ReferenceState(
            pose=Pose2(float(row.x[0]), float(row.y[0]), float(row.yaw[0])),
            gear=gear,
            turn=turn,
            speed=abs(speed) + turn * float(row.yaw_rate[0]),
            acceleration=gear * float(row.acceleration[0]) + turn * float(row.yaw_acceleration[0]),
            previewed=Twist2(share * float(row.speed[1]), share * float(row.yaw_rate[1])),
        )

    def join(self, pose: Pose2, linear: float) -> None:
        """Begin at the trajectory's start, or at the nearest point of its first gear when the robot is not there.

        Later gears may pass closer by; to begin there would leave the manoeuvre out. The rate begins such that the
        reference is no faster than the robot at `linear` m/s.
        """
        cusps = self.trajectory.cusp_times
        mine = self._grid.t <= cusps[0] if cusps.size else np.ones(self._grid.t.size, dtype=bool)
        distance = np.hypot(self._grid.x[mine] - pose.x, self._grid.y[mine] - pose.y)
        first = 0 if distance[0] <= _AT_START else int(np.argmin(distance))
        self.time, speed = float(self._grid.t[first]), float(self._grid.speed[first])
        if abs(speed) > _AT_REST:
            self.rate = min(1.0, max(0.0, linear / speed))

    def advance(
        self, now: ReferenceState, period: float, target_rate: float, limits: MotionLimits, settling: float
    ) -> None:
        """Let `period` seconds pass while the rate approaches `target_rate` with the time constant `settling` [s]."""
        before = self.rate
        if now.speed <= _AT_REST or abs(target_rate - before) < 1e-6:
            self.rate = before = target_rate
        else:
            turning = limits.turning.acceleration
            bounds = (turning, turning) if now.turn else (limits.max_acceleration, limits.max_deceleration)
            lowest, highest = _rate_bounds(now.speed, before**2 * now.acceleration, bounds)
            wanted = (target_rate - before) / max(settling, period)
            self.rate = min(1.0, max(0.0, before + period * min(max(wanted, lowest), highest)))
        self.time = min(self.trajectory.duration, self.time + 0.5 * (before + self.rate) * period)


def _rate_bounds(speed: float, acceleration: float, limits: tuple[float, float]) -> tuple[float, float]:
    """Bounds of d rate/dt [1/s] that keep the played-back acceleration and deceleration within their limits."""
    rise, fall = limits
    return min(0.0, -(fall + acceleration) / speed), max(0.0, (rise - acceleration) / speed)
