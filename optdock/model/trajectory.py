"""Trajectories: a path composed with a time law, `pose(t) = path(s(t))`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.geometry.arrays import FloatArray, FrozenArrays
from optdock.geometry.checked import exactly, sampling_step
from optdock.geometry.pose import Pose2, Twist2
from optdock.model.constant_jerk import TimeLaw
from optdock.model.path import Path

if TYPE_CHECKING:
    from numpy.typing import ArrayLike


__all__ = ["TimedPoses", "Trajectory", "TrajectorySamples", "TrajectoryState"]

_AT_REST = 1e-6  # [m/s], [m/s^2]: the tolerance of certificates at cusps


class TrajectoryState(NamedTuple):
    """Planned state at one instant; twist and acceleration are signed, negative in reverse."""

    t: float
    s: float
    pose: Pose2
    twist: Twist2
    acceleration: float
    yaw_acceleration: float
    jerk: float


class TrajectorySamples(NamedTuple):
    """Samples as columns of Shape (n,) in SI units; speed, acceleration and jerk are negative in reverse."""

    t: FloatArray
    s: FloatArray
    x: FloatArray
    y: FloatArray
    yaw: FloatArray
    speed: FloatArray
    acceleration: FloatArray
    jerk: FloatArray
    yaw_rate: FloatArray
    yaw_acceleration: FloatArray


class TimedPoses(NamedTuple):
    """A trajectory as arrays: `t`, Shape (n,) [s]; `poses`, Shape (n, 3) [m, m, rad]; and `twists`.

    `twists` has Shape (n, 2): speed along the heading, negative in reverse [m/s], and yaw rate [rad/s].
    """

    t: FloatArray
    poses: FloatArray
    twists: FloatArray


@dataclass(frozen=True, eq=False, repr=False)
class Trajectory(FrozenArrays):
    """A timed motion: a path, and a time law over its arc length.

    Args:
        path: The path.
        time_law: Distance over time, from 0 to the length of the path.

    Raises:
        InvalidValue: If the path or the time law has the wrong class. Subclasses are rejected because they could
            override poses or distances.
    """

    path: Path
    time_law: TimeLaw

    def __post_init__(self) -> None:
        exactly(Path, self.path, "trajectory.path")
        exactly(TimeLaw, self.time_law, "trajectory.time_law")

    def __repr__(self) -> str:
        return f"<Trajectory {self.duration:.3f} s over {self.path.driven:.3f} m>"

    @property
    def frame(self) -> str:
        """Name of the coordinate frame of the path; empty if unknown."""
        return self.path.frame

    @property
    def duration(self) -> float:
        """Total time [s]."""
        return self.time_law.duration

    def sample_at(self, t: ArrayLike) -> TrajectorySamples:
        """Evaluate the motion at times `t`, Shape (n,) [s], clipped to [0, duration]."""
        times = np.clip(np.atleast_1d(np.asarray(t, dtype=np.float64)), 0.0, self.duration)
        s, v, a, j = self.time_law.at(times).T
        s = np.clip(s, 0.0, self.path.length)
        poses, gear = self.path.poses_at(s), self.path.direction_at(s).astype(np.float64)
        curvature, rate = self.path.curvature_at(s), self.path.curvature_rate_at(s)
        if self.path.turns:  # the jerk in a turn is 0, also at its first instant, which rounding may put before it
            j = np.where(self.path.direction_at(self.time_law.phase_middles(times)) == 0, 0.0, j)
        x, y, yaw = poses.T
        return TrajectorySamples(
            times, s, x, y, yaw, gear * v, gear * a, gear * j, v * curvature, a * curvature + v * v * rate
        )

    def sample(self, period: float) -> TrajectorySamples:
        """Return samples at most `period` [s] apart, including the start, the end and the arrival at every cusp.

        Raises:
            InvalidValue: If the period is not a finite number > 0 or is far too small.
        """
        period = sampling_step(period, self.duration, "period")
        count = max(1, int(np.ceil(self.duration / period - 1e-9)))
        grid = np.minimum(np.arange(count + 1) * period, self.duration)
        return self.sample_at(np.unique(np.concatenate((grid, self.cusp_times))))

    def sampled(self, period: float) -> TimedPoses:
        """Return times, poses and twists every `period` [s]; the last sample is the end, at most one period later.

        Raises:
            InvalidValue: If the period is not a finite number > 0 or is far too small.
        """
        step = sampling_step(period, self.duration, "period")
        whole = int(np.ceil(self.duration / step * (1.0 - 1e-12)))  # rounding must not duplicate the end
        samples = self.sample_at(np.append(step * np.arange(max(whole, 1)), self.duration))
        poses = np.column_stack((samples.x, samples.y, samples.yaw))
        return TimedPoses(samples.t, poses, np.column_stack((samples.speed, samples.yaw_rate)))

    @property
    def cusp_times(self) -> FloatArray:
        """Times at which the robot arrives at the cusps, before any wait there; Shape (number of cusps,) [s]."""
        cusps, law = np.asarray(self.path.cusps), self.time_law
        borders = law.states[:, 0]
        nearest = np.argmin(np.abs(borders[:, None] - cusps[None, :]), axis=0) if cusps.size else np.zeros(0, np.int64)
        waits = (law.jerks == 0.0) & np.all(np.abs(law.states[:-1, 1:]) <= _AT_REST, axis=1)
        while np.any(late := waits[nearest - 1] & (nearest > 0)):
            nearest = nearest - late
        arrivals: FloatArray = law.times[nearest]
        return arrivals

    def at(self, t: float) -> TrajectoryState:
        """Return the state at time `t` [s], clipped to [0, duration]."""
        row = self.sample_at(t)
        return TrajectoryState(
            t=float(row.t[0]),
            s=float(row.s[0]),
            pose=Pose2(float(row.x[0]), float(row.y[0]), float(row.yaw[0])),
            twist=Twist2(float(row.speed[0]), float(row.yaw_rate[0])),
            acceleration=float(row.acceleration[0]),
            yaw_acceleration=float(row.yaw_acceleration[0]),
            jerk=float(row.jerk[0]),
        )
