"""Odometry: scales and drift, the wheel errors that cause them, window of the twist, and age of the poses."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from optdock.calibration.statistics import LEAST_CLUSTERS, Quantity, clusters_of, fit, mean_of, unknown
from optdock.geometry.pose import wrap_angles

if TYPE_CHECKING:
    from collections.abc import Sequence

    from optdock.calibration.motion_smoother import RecordedMotion
    from optdock.calibration.recording import Recording
    from optdock.geometry.arrays import FloatArray, IntArray

__all__ = ["odometry_age", "odometry_quantities", "twist_window"]

_LEAST_TRIP, _LEAST_TURN = 0.3, 0.3  # [m], [rad] in total: over less, an error of 10 % is not visible

_STARTS = 0.03, 0.1, 0.2, 0.4  # [s]: the misfit has several minima at nearly constant speed
_LONGEST = 1.0  # [s]: a twist that is older is useless for control
_LEAST_CHANGE = 0.05  # [m/s]: means over different windows are equal if the speed changes by less
_ROUGH = 0.1  # of the time between two poses
_CLUSTER = 2.0  # [s]: longer than the windows
_SPAN = 0.3  # [s] of a residual: longer than the usual windows, so that it contains a whole change of speed
_GRID = 0.002  # [s]: half of the jitter of stamps
_LEVER = 0.3  # [m] by which yaw rates are compared with speeds: about half of a robot's width


def odometry_quantities(motion: RecordedMotion, track_width: float) -> list[Quantity]:
    """Return the scales of distances and turns, the turn per metre and the delay of the detections.

    If the track width is known, also return the errors of the wheel radii and of the track width.

    Args:
        motion: Smoothed recordings.
        track_width: Distance between the wheels [m]; 0 if unknown.
    """
    ways = [np.diff(one.seen_from_dock, axis=0) for one in motion.of]
    way = sum(float(np.sum(np.hypot(step[:, 0], step[:, 1]))) for step in ways)
    turned = sum(float(np.sum(np.abs(wrap_angles(step[:, 2])))) for step in ways)
    half = 0.5 * track_width
    rows = [  # each a linear combination of scale, drift, turn scale and delay
        ("scale of the distance", "1", (1.0, 0.0, 0.0, 0.0)),
        ("turn per metre", "rad/m", (0.0, 1.0, 0.0, 0.0)),
        ("scale of turns", "1", (0.0, 0.0, 1.0, 0.0)),
        ("detections late by", "s", (0.0, 0.0, 0.0, 1.0)),
        ("left wheel's radius outside the plausible range", "1", (1.0, -half, 0.0, 0.0)),
        ("right wheel's radius outside the plausible range", "1", (1.0, half, 0.0, 0.0)),
        ("track width outside the plausible range", "1", (1.0, 0.0, -1.0, 0.0)),
    ]
    count = 3 * sum(len(one.seen.ranges) for one in motion.of)
    found = []
    for name, unit, weights in rows:
        reason = _missing(name, way, turned, track_width)
        if reason:
            found.append(unknown(name, unit, reason, count))
            continue
        slope = np.array([weights])
        value = float((slope @ motion.values)[0])
        spread = 1.96 * math.sqrt(float((slope @ motion.covariance @ slope.T)[0, 0]))
        found.append(Quantity(name, unit, value, value - spread, value + spread, count, len(motion.of)))
    return found


def _missing(name: str, way: float, turned: float, track_width: float) -> str:
    """Return the reason why a quantity is unknown; empty if it is known."""
    if way < _LEAST_TRIP:
        return f"the robot drove only {way:.2f} m while the dock was detected"
    if turned < _LEAST_TURN and name in ("scale of turns", "track width outside the plausible range"):
        return f"the robot turned by only {turned:.2f} rad while the dock was detected"
    if track_width == 0.0 and name.endswith("plausible range"):
        return "the distance between the wheels, robot.limits.track_width, is unknown"
    return ""


def odometry_age(recordings: Sequence[Recording]) -> Quantity:
    """Return the mean age [s] of the newest odometry pose in a control cycle."""
    name, unit = "age of the odometry", "s"
    ages = [one.odometry_ages for one in recordings if len(one.odometry_ages) > 20]
    if not ages:
        return unknown(name, unit, "no control cycle is recorded with the pose of the odometry that it used")
    # Means over 50 cycles are independent, because messages delay each other for a few cycles only.
    blocks = [np.mean(part) for one in ages for part in np.array_split(one, max(1, len(one) // 50))]
    if len(blocks) < 2:
        return unknown(name, unit, "the recordings are shorter than 100 cycles")
    return Quantity(name, unit, *mean_of(np.array(blocks)), sum(map(len, ages)), len(ages))


def twist_window(recordings: Sequence[Recording]) -> Quantity:
    """Return the time [s] over which increments of the odometry are averaged to obtain the twist."""
    name, unit = "twist window", "s"
    used = [one for one in recordings if len(one.odometry) > 20]
    if not used:
        return unknown(name, unit, "the odometry contains no poses")
    changes = max(float(np.ptp(one.odometry_twists[:, 0])) for one in used)
    if changes < _LEAST_CHANGE:
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
        return unknown(name, unit, "the twists are consistent with windows of any length", len(clusters))
    # The distance is interpolated linearly between two poses; the error of means is a share of the time between them.
    rough = _ROUGH * float(np.median(np.concatenate([np.diff(one.odometry[:, 0]) for one in used])))
    return Quantity(name, unit, value, max(low - rough, 0.0), high + rough, len(clusters), len(used))


class _Increments:
    """Distance and yaw in one recording, computed from the poses and from integrals of the twists.

    Integrals over a span are compared, because the jitter of the stamps dominates increments over a short window.
    """

    def __init__(self, recording: Recording) -> None:
        path = recording.path
        self.stamps, steps = path.times, np.diff(path.times)
        twists = recording.odometry_twists
        self._grid = np.arange(self.stamps[0], self.stamps[-1], _GRID)
        ways = [np.interp(self._grid, self.stamps, way) for way in path.ways]
        self._summed = [np.concatenate(([0.0], np.cumsum(0.5 * (way[1:] + way[:-1]) * _GRID))) for way in ways]
        self._integrals = [
            np.concatenate(([0.0], np.cumsum(0.5 * (twists[1:, k] + twists[:-1, k]) * steps))) for k in range(2)
        ]
        last = np.searchsorted(self.stamps, self.stamps + _SPAN)
        self.rows = np.flatnonzero((self.stamps - _LONGEST > self.stamps[0]) & (last < len(self.stamps)))
        self._ends = last[self.rows]

    def residuals(self, window: float) -> FloatArray:
        """Return integrals of the window means minus integrals of the twists, linear and angular, Shape (2 n,) [m]."""
        off = []
        for summed, integral, scale in zip(self._summed, self._integrals, (1.0, _LEVER), strict=True):
            ahead, back = (np.interp(self.stamps - lag, self._grid, summed) for lag in (0.0, window))
            gap = (ahead - back) / window - integral
            off.append(scale * (gap[self._ends] - gap[self.rows]))
        return np.concatenate(off)


def _clusters(parts: list[_Increments]) -> IntArray:
    """Return the cluster indices of the residuals; each part has a linear and an angular residual at every time."""
    found = clusters_of((part.stamps[part.rows] - part.stamps[0] for part in parts), _CLUSTER)
    return np.concatenate([number for number in found for _ in range(2)])
