"""How far localization is off, how often it jumps, and where in the map the dock truly is.

The robot is known from the dock by its smoothed motion. Whatever else the localization says is its own error, and one
thing that is common to all recordings: the dock's pose in the map.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.calibration.statistics import Quantity, mean_of, poisson_rate, unknown
from optdock.geometry.pose import Pose2, normalize_angle

if TYPE_CHECKING:
    from collections.abc import Sequence

    from optdock.calibration.motion import Smoothed
    from optdock.geometry.arrays import FloatArray

__all__ = ["LocalizationErrors", "docks_in_map", "localization_errors", "stored_dock"]

_SEEN_WITHIN = 0.5  # [s]: without a detection for longer the odometry alone says where the robot is
_GAP = 1.0  # [s] between two estimates, after which a change may be drift
_SIDE = 3  # estimates on either side whose medians are compared for a jump
_LEAST_JUMP = 0.02  # [m]: AMCL drifts by less than that in half a second, and so does odometry that slips
_EVERY = 1.0  # [s] between the estimates that the spread is computed of: their errors last for seconds
_LEAST = 12  # estimates in all
_UNKNOWN = 1.0  # [m], [rad]: standard deviation of what a jump may be, and of the dock
_LIKELY = 3.841 / 2.0  # by how much the logarithm of the likelihood falls at the ends of the interval: chi2(1) / 2


class LocalizationErrors(NamedTuple):
    """What is measured against the smoothed motion.

    Attributes:
        quantities: Spread, rate and size of jumps.
        series: Of each recording: stamps and errors of x, y [m], yaw [rad] against the mean dock, Shape (n, 4).
    """

    quantities: list[Quantity]
    series: list[FloatArray]


def docks_in_map(one: Smoothed) -> FloatArray:
    """Stamps, and where each estimate of the localization puts the dock in the map, Shape (n, 4)."""
    rows = one.recording.localization
    seen = one.recording.detections[:, 0]
    inside = (rows[:, 0] >= one.times[0]) & (rows[:, 0] <= one.times[-1])
    rows = rows[inside]
    after = np.clip(np.searchsorted(seen, rows[:, 0]), 1, len(seen) - 1)
    near = np.minimum(np.abs(seen[after] - rows[:, 0]), np.abs(rows[:, 0] - seen[after - 1])) < _SEEN_WITHIN
    rows = rows[near]
    robot = _at(one, rows[:, 0])
    yaw = rows[:, 3] - robot[:, 2]
    c, s = np.cos(yaw), np.sin(yaw)
    x, y = rows[:, 1] - c * robot[:, 0] + s * robot[:, 1], rows[:, 2] - s * robot[:, 0] - c * robot[:, 1]
    return np.column_stack((rows[:, 0], x, y, yaw))


def stored_dock(of: Sequence[Smoothed]) -> list[Quantity]:
    """The dock's pose in the map, of the recordings whose dockings succeeded: a mean with Student's interval."""
    names = (("stored dock, x", "m"), ("stored dock, y", "m"), ("stored dock, yaw", "rad"))
    rows = [docks_in_map(one) for one in of if one.recording.docked_at is not None]
    rows = [one for one in rows if len(one) > 0]
    if len(rows) < 2:
        reason = "no docking succeeded" if not rows else "one successful docking: localization may have been off"
        return [unknown(name, unit, reason, len(rows)) for name, unit in names]
    first = float(rows[0][0, 3])
    poses = np.array(
        [
            [
                *np.mean(one[:, 1:3], axis=0),
                np.mean(first + np.remainder(one[:, 3] - first + math.pi, 2 * math.pi) - math.pi),
            ]
            for one in rows
        ]
    )
    kept = _without_outliers(poses)
    count = sum(map(len, rows))
    found = [Quantity(name, unit, *mean_of(kept[:, k]), count, len(kept)) for k, (name, unit) in enumerate(names)]
    shift = normalize_angle(found[2].value) - found[2].value
    yaw = found[2]
    found[2] = Quantity(yaw.name, yaw.unit, yaw.value + shift, yaw.low + shift, yaw.high + shift, count, len(kept))
    return found


def _without_outliers(poses: FloatArray) -> FloatArray:
    """Poses within six robust standard deviations of the median in every coordinate: all, where none is of another dock."""
    middle = np.median(poses, axis=0)
    spread = 1.4826 * np.median(np.abs(poses - middle), axis=0) + np.array([0.01, 0.01, 0.01])
    kept: FloatArray = poses[np.all(np.abs(poses - middle) <= 6.0 * spread, axis=1)]
    return kept


def localization_errors(of: Sequence[Smoothed]) -> LocalizationErrors:
    """Spread and jumps of the localization."""
    names = (
        ("localization sigma, position", "m"), ("localization sigma, yaw", "rad"),
        ("localization jumps", "1/s"), ("size of localization jumps", "m"),
    )  # fmt: skip
    docks = [(one, docks_in_map(one)) for one in of]
    docks = [(one, rows) for one, rows in docks if len(rows) >= 2 * _SIDE]
    if sum(len(rows) for _, rows in docks) < _LEAST:
        reason = "localization and dock were hardly ever known at the same time"
        return LocalizationErrors([unknown(name, unit, reason) for name, unit in names], [])
    first = docks[0][1][0, 3]
    middle = np.median(np.concatenate([rows for _, rows in docks])[:, 1:3], axis=0)
    yaws = np.concatenate([np.remainder(rows[:, 3] - first + math.pi, 2 * math.pi) - math.pi for _, rows in docks])
    dock = Pose2(*middle.tolist(), first + float(np.median(yaws)))
    series = [_errors(one, rows, dock) for one, rows in docks]
    jumps = [_jumps(rows) for rows in series]
    sizes = np.array([size for found in jumps for _, size in found])
    exposure = sum(float(np.sum(steps[steps < _GAP])) for steps in (np.diff(rows[:, 0]) for rows in series))
    count = sum(map(len, series))
    cut = [[stamp for stamp, _ in found] for found in jumps]
    quantities = [
        _spread(names[0], series, cut, (1, 2), count),
        _spread(names[1], series, cut, (3,), count),
        Quantity(*names[2], *poisson_rate(len(sizes), max(exposure, 1e-3)), count, len(series)),
        Quantity(*names[3], *mean_of(sizes), len(sizes), len(series))
        if len(sizes) > 1
        else unknown(*names[3], f"{len(sizes)} jumps in {exposure:.0f} s", len(sizes)),
    ]
    return LocalizationErrors(quantities, series)


def _at(one: Smoothed, stamps: FloatArray) -> FloatArray:
    yaw = np.unwrap(one.seen_from_dock[:, 2])
    columns = one.seen_from_dock[:, 0], one.seen_from_dock[:, 1], yaw
    return np.column_stack([np.interp(stamps, one.times, column) for column in columns])


def _errors(one: Smoothed, rows: FloatArray, dock: Pose2) -> FloatArray:
    """Of the localization at the robot, with a dock at a pose in the map: stamps, x, y, yaw, Shape (n, 4)."""
    robot = _at(one, rows[:, 0])
    turned = rows[:, 3] - dock.yaw
    off = np.remainder(turned + math.pi, 2.0 * math.pi) - math.pi
    there = np.array([(dock @ Pose2(*pose)).as_array() for pose in robot.tolist()])
    c, s = np.cos(rows[:, 3]), np.sin(rows[:, 3])
    x = rows[:, 1] + c * robot[:, 0] - s * robot[:, 1] - there[:, 0]
    y = rows[:, 2] + s * robot[:, 0] + c * robot[:, 1] - there[:, 1]
    return np.column_stack((rows[:, 0], x, y, off))


def _jumps(rows: FloatArray) -> list[tuple[float, float]]:
    """Stamps and sizes [s, m] of jumps: where the medians before and after differ, and most near by."""
    steps = np.zeros(len(rows))
    for k in range(_SIDE, len(rows) - _SIDE + 1):
        if rows[k, 0] - rows[k - 1, 0] < _GAP:
            change = np.median(rows[k : k + _SIDE, 1:3], axis=0) - np.median(rows[k - _SIDE : k, 1:3], axis=0)
            steps[k] = math.hypot(*change.tolist())
    usual = float(np.median(steps[steps > 0.0])) if np.any(steps > 0.0) else 0.0
    least = max(_LEAST_JUMP, 3.5 * usual)
    found = []
    for k in np.flatnonzero(steps > least).tolist():
        if steps[k] >= np.max(steps[max(0, k - _SIDE) : k + _SIDE + 1]):
            found.append((float(rows[k, 0]), float(steps[k])))
    return found


def _spread(
    name: tuple[str, str], series: list[FloatArray], jumps: list[list[float]], columns: tuple[int, ...], count: int
) -> Quantity:
    """Standard deviation of an error that drifts: a Gauss-Markov process, by maximum likelihood.

    Its correlation time and a white part are estimated too; the dock and what each jump has added are not known. The
    interval is that of the profile of the likelihood.
    """
    from scipy.linalg import cho_factor, cho_solve
    from scipy.optimize import brentq, minimize, minimize_scalar

    thin = [_thinned(rows) for rows in series]
    number = np.repeat(np.arange(len(thin)), [len(rows) for rows in thin])
    rows = np.concatenate(thin)
    apart = np.abs(rows[:, 0, None] - rows[:, 0])
    together = number[:, None] == number
    known = np.full(apart.shape, _UNKNOWN**2)
    for k, stamps in enumerate(jumps):
        for stamp in stamps:
            after = ((number == k) & (rows[:, 0] >= stamp)).astype(np.float64)
            known += _UNKNOWN**2 * np.multiply.outer(after, after)
    values = rows[:, list(columns)]

    def misfit(sigma: float, others: FloatArray) -> float:
        """Negative logarithm of the likelihood."""
        lasting, white = np.exp(others).tolist()
        cov = known + sigma**2 * together * np.exp(-apart / lasting) + (white**2 + 1e-10) * np.eye(len(rows))
        factor = cho_factor(cov, lower=True)
        fits = float(np.sum(values * cho_solve(factor, values)))
        return 0.5 * fits + len(columns) * float(np.sum(np.log(np.diag(factor[0]))))

    guess = np.log([10.0, 0.003])
    limits = [(math.log(1.0), math.log(60.0)), (math.log(2e-4), math.log(0.05))]

    def profile(logarithm: float) -> float:
        sigma = math.exp(logarithm)
        return float(minimize(lambda x: misfit(sigma, x), guess, method="L-BFGS-B", bounds=limits).fun)

    lowest, highest = math.log(3e-4), math.log(0.3)
    best = minimize_scalar(profile, bounds=(lowest, highest), method="bounded", options={"xatol": 0.02})
    level = float(best.fun) + _LIKELY

    def end(limit: float) -> float:
        if profile(limit) < level:
            return limit
        return float(brentq(lambda x: profile(x) - level, limit, float(best.x), xtol=0.02))

    low, high = end(lowest), end(highest)
    if high >= highest:
        return unknown(*name, f"{len(series)} recordings are too short for an error that lasts for seconds", count)
    return Quantity(*name, math.exp(best.x), math.exp(low), math.exp(high), count, len(series))


def _thinned(rows: FloatArray) -> FloatArray:
    kept, last = [], -math.inf
    for row in rows:
        if row[0] >= last + _EVERY:
            kept.append(row)
            last = row[0]
    return np.array(kept)
