"""The window that the odometry's twist is a mean over, and how old the odometry is when it is used."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from optdock.calibration.statistics import LEAST_CLUSTERS, Quantity, clusters_of, fit, mean_of, unknown

if TYPE_CHECKING:
    from collections.abc import Sequence

    from optdock.calibration.recording import Recording
    from optdock.geometry.arrays import FloatArray, IntArray

__all__ = ["odometry_age", "twist_window"]

_STARTS = 0.03, 0.1, 0.2, 0.4  # [s]: the misfit has several minima where the speed hardly changes
_LONGEST = 1.0  # [s]: a twist that is older steers no robot
_LEAST_ACCELERATION = 0.05  # [m/s]: of a speed that changes by less, means over different windows are the same
_ROUGH = 0.1  # of the time between two poses
_CLUSTER = 2.0  # [s]: longer than the windows
_SPAN = 0.3  # [s] of a residual: longer than the usual windows, so that all of a change of speed is in it
_GRID = 0.002  # [s]: half of the jitter of stamps
_LEVER = 0.3  # [m] by which yaw rates are compared with speeds: about half of a robot's width


def twist_window(recordings: Sequence[Recording]) -> Quantity:
    """The time over which the twist is a mean of the odometry's own increments [s]."""
    name, unit = "twist window", "s"
    used = [one for one in recordings if len(one.odometry) > 20]
    if not used:
        return unknown(name, unit, "the odometry told no poses")
    changes = max(float(np.ptp(one.odometry_twists[:, 0])) for one in used)
    if changes < _LEAST_ACCELERATION:
        return unknown(name, unit, "the speed of the robot never changed")
    parts = [_Increments(one) for one in used]
    clusters = _clusters(parts)
    if len(np.unique(clusters)) < LEAST_CLUSTERS:
        return unknown(name, unit, f"the odometry was recorded for less than {_CLUSTER * (LEAST_CLUSTERS - 1):g} s")

    def residuals(values: FloatArray) -> FloatArray:
        return np.concatenate([part.residuals(float(values[0])) for part in parts])

    start = min(_STARTS, key=lambda window: float(np.sum(np.abs(residuals(np.array([window]))))))
    found = fit(residuals, (start,), clusters, (0.01,), bounds=((1e-3,), (_LONGEST,)))
    value, low, high = found.interval(0)
    if high - low > _LONGEST:
        return unknown(name, unit, "the twists fit with windows of any length", len(clusters))
    # Between two poses the way is taken as straight in time; what that does to means is a share of their distance.
    rough = _ROUGH * float(np.median(np.concatenate([np.diff(one.odometry[:, 0]) for one in used])))
    return Quantity(name, unit, value, max(low - rough, 0.0), high + rough, len(clusters), len(used))


def odometry_age(recordings: Sequence[Recording]) -> Quantity:
    """How old the newest pose of the odometry is in a control cycle, in the mean [s]."""
    name, unit = "age of the odometry", "s"
    ages = [one.odometry_ages for one in recordings if len(one.odometry_ages) > 20]
    if not ages:
        return unknown(name, unit, "no control cycle is recorded with the pose of the odometry that it used")
    # Means over 50 cycles are independent, as messages wait for each other for a few cycles only.
    blocks = [np.mean(part) for one in ages for part in np.array_split(one, max(1, len(one) // 50))]
    if len(blocks) < 2:
        return unknown(name, unit, "the recordings are shorter than 100 cycles")
    return Quantity(name, unit, *mean_of(np.array(blocks)), sum(map(len, ages)), len(ages))


class _Increments:
    """Way and yaw by the poses of one recording, and the integrals of the twists beside them.

    Integrals over a span are compared, as increments over a short window are mostly the jitter of the stamps.
    """

    def __init__(self, recording: Recording) -> None:
        self.stamps, poses = recording.path
        step, steps = np.diff(poses, axis=0), np.diff(self.stamps)
        middle = poses[:-1, 2] + 0.5 * step[:, 2]
        along = step[:, 0] * np.cos(middle) + step[:, 1] * np.sin(middle)
        ways = np.concatenate(([0.0], np.cumsum(along))), poses[:, 2] - poses[0, 2]
        told = recording.odometry_twists
        grid = np.arange(self.stamps[0], self.stamps[-1], _GRID)
        self._grid = grid
        self._ways = [np.interp(grid, self.stamps, way) for way in ways]
        self._summed = [np.concatenate(([0.0], np.cumsum(0.5 * (way[1:] + way[:-1]) * _GRID))) for way in self._ways]
        self._told = [np.concatenate(([0.0], np.cumsum(0.5 * (told[1:, k] + told[:-1, k]) * steps))) for k in range(2)]
        last = np.searchsorted(self.stamps, self.stamps + _SPAN)
        first = np.flatnonzero((self.stamps - _LONGEST > self.stamps[0]) & (last < len(self.stamps)))
        self.rows, self._ends = first, last[first]

    def residuals(self, window: float) -> FloatArray:
        """Integrals of the means over the window minus those of the twist, linear and angular, Shape (2 n,) [m]."""
        off = []
        for summed, told, scale in zip(self._summed, self._told, (1.0, _LEVER), strict=True):
            ahead, back = (np.interp(self.stamps - lag, self._grid, summed) for lag in (0.0, window))
            gap = (ahead - back) / window - told
            off.append(scale * (gap[self._ends] - gap[self.rows]))
        return np.concatenate(off)


def _clusters(parts: list[_Increments]) -> IntArray:
    """As `clusters_of`; each part has residuals of the way and, at the same times, of the turn."""
    found = clusters_of((part.stamps[part.rows] - part.stamps[0] for part in parts), _CLUSTER)
    return np.concatenate([number for number in found for _ in range(2)])
