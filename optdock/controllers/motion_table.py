"""A trajectory as two tables, for its evaluation at a few times in every control cycle.

The time law has a row for each phase of constant jerk, and the path a row for each cell in which the curvature is
linear. `MotionTable.at` evaluates both in one call.
"""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.geometry.arrays import FrozenArrays, readonly
from optdock.geometry.clothoid import subdivided
from optdock.kernels import Kernel, twin_of
from optdock.model.constant_jerk import constant_jerk
from optdock.model.segments import TURN_RADIUS, ClothoidSegment, PolylineSegment, TurnSegment

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray
    from optdock.model.path import Path
    from optdock.model.trajectory import Trajectory

__all__ = ["MotionRow", "MotionTable", "evaluated", "motion_table"]

_PHASE, _CELL, _NODES = 5, 7, 5  # columns of a phase and of a cell; nodes of the quadrature in a cell
_MOST_TURNED = 0.5  # [rad] in a cell
_PLACES, _WEIGHTS = map(
    readonly, np.polynomial.legendre.leggauss(_NODES)
)  # error below 1e-15 of the length, see `geometry.clothoid`


class MotionRow(NamedTuple):
    """The motion at one time; speed and acceleration are negative in reverse.

    Arc length [m]; pose [m, m, rad]; speed [m/s]; acceleration [m/s^2]; yaw rate [rad/s]; yaw acceleration [rad/s^2];
    gear, 1, -1, or 0 in a turn in place; curvature [1/m].
    """

    s: float
    x: float
    y: float
    yaw: float
    speed: float
    acceleration: float
    yaw_rate: float
    yaw_acceleration: float
    gear: float
    curvature: float


class MotionTable(FrozenArrays):
    """A trajectory, prepared for its evaluation at a few times.

    Args:
        trajectory: The trajectory.
    """

    def __init__(self, trajectory: Trajectory) -> None:
        law, path = trajectory.time_law, trajectory.path
        self._ends = law.duration, path.length
        self._trajectory: Trajectory | None = None
        self._counts, self._table = (0, 0), readonly(np.zeros(0))
        if any(isinstance(segment, PolylineSegment) for segment in path.segments):
            self._trajectory = trajectory  # a polyline has no cells
            return
        cells = _cells(path)
        phases = np.column_stack((law.times[:-1], law.states[:-1], law.jerks))
        self._counts = len(phases), len(cells)
        self._table = readonly(np.concatenate((phases.ravel(), cells.ravel(), 1.0 + _PLACES, _WEIGHTS)))

    def rows(self, *times: float) -> list[MotionRow]:
        """Return the motion at each of the times [s]; see `at`."""
        return [MotionRow(*row) for row in self.at(np.array(times)).tolist()]

    def at(self, times: FloatArray) -> FloatArray:
        """Return the motion at times, clipped to [0, duration], equal to `Trajectory.sample_at` up to rounding.

        Args:
            times: Shape (n,) [s].

        Returns:
            Shape (n, 10), with the columns of `MotionRow`.
        """
        if self._trajectory is not None:
            row, path = self._trajectory.sample_at(times), self._trajectory.path
            motion = row.s, row.x, row.y, row.yaw, row.speed, row.acceleration, row.yaw_rate, row.yaw_acceleration
            return np.column_stack((*motion, path.direction_at(row.s), path.curvature_at(row.s)))
        return evaluated(self._table, self._counts, self._ends, times)


@functools.lru_cache(maxsize=16)  # a controller uses the present trajectory and those that take over
def motion_table(trajectory: Trajectory) -> MotionTable:
    """Return the table of a trajectory, cached."""
    return MotionTable(trajectory)


def _cells(path: Path) -> FloatArray:
    """Return s, x, y, yaw, curvature, its rate, and the gear at the begin of every cell, Shape (n, 7)."""
    found = []
    for begin, segment in zip(path.segment_starts[:-1].tolist(), path.segments, strict=True):
        if isinstance(segment, ClothoidSegment):
            bend = np.abs(segment.spline.curvature)
            turned = np.diff(segment.knots) * np.maximum(bend[:-1], bend[1:])
            s = subdivided(segment.knots, np.ceil(np.maximum(turned / _MOST_TURNED, 1.0)).astype(np.int64))
            curvature, poses = segment.curvature_at(s), segment.poses_at(s[:-1])
            rates = np.diff(curvature) / np.diff(s)
            gear = np.full(rates.size, float(segment.direction))
            found.append(np.column_stack((begin + s[:-1], poses, curvature[:-1], rates, gear)))
        elif isinstance(segment, TurnSegment):
            pose = segment.pose
            found.append(np.array([[begin, pose.x, pose.y, pose.yaw, np.sign(segment.turn) / TURN_RADIUS, 0.0, 0.0]]))
    return np.concatenate(found)


_EVALUATE = Kernel("optdock_motion_table", sizes=3, numbers=2)


def _evaluated_natively(
    table: FloatArray, counts: tuple[int, int], ends: tuple[float, float], times: FloatArray
) -> FloatArray:
    n, (phases, cells) = times.size, counts
    out = np.empty((n, len(MotionRow._fields)))
    size = _PHASE * phases + _CELL * cells + 2 * _NODES
    if _EVALUATE((n, phases, cells), ends, ((table, size), (times, n), (out, out.size))) < 0:
        raise ValueError("motion table: needs a phase and a cell")
    return out


@twin_of(_evaluated_natively)
def evaluated(table: FloatArray, counts: tuple[int, int], ends: tuple[float, float], times: FloatArray) -> FloatArray:
    """Return the motion at times; see `MotionTable.at`.

    Args:
        table: Phases, Shape (p, 5): time [s], distance [m], speed [m/s], acceleration [m/s^2] at the begin, jerk
            [m/s^3]; then cells, Shape (c, 7), see `_cells`; then places, 0 to 2, and weights of the quadrature in half
            a cell, Shape (5,) each.
        counts: p and c.
        ends: Duration [s] and length [m].
        times: Shape (n,) [s].

    Returns:
        Shape (n, 10).
    """
    (phases, cells), (duration, length) = counts, ends
    split = phases * _PHASE, phases * _PHASE + cells * _CELL, table.size - _NODES
    law, path, places, weights = np.split(table, split)
    law, path = law.reshape(phases, _PHASE), path.reshape(cells, _CELL)
    t = np.minimum(np.maximum(times, 0.0), duration)
    begin, s, v, a, jerk = law[law[1:, 0].searchsorted(t, side="right")].T
    s, v, a = constant_jerk(t - begin, s, v, a, jerk)
    s = np.minimum(np.maximum(s, 0.0), length)
    begin, x, y, yaw, curvature, rate, gear = path[path[1:, 0].searchsorted(s, side="right")].T
    step = s - begin
    half = 0.5 * step
    u = half[:, None] * places
    theta = yaw[:, None] + u * (curvature[:, None] + 0.5 * u * rate[:, None])
    x = x + gear * (half * (np.cos(theta) @ weights))
    y = y + gear * (half * (np.sin(theta) @ weights))
    yaw, curvature = yaw + step * (curvature + 0.5 * step * rate), curvature + step * rate
    turned = a * curvature + v * v * rate
    return np.column_stack((s, x, y, yaw, gear * v, gear * a, v * curvature, turned, gear, curvature))
