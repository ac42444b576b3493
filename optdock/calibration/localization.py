"""How far localization is off, how often it jumps, and where in the map the dock truly is.

A detection together with an estimate of the localization puts the dock in the map. Where that is, is the same in all
recordings; how it moves about is the error of the localization.
"""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.calibration.statistics import Quantity, mean_of, poisson_rate, student, unknown
from optdock.geometry.arrays import readonly
from optdock.geometry.pose import normalize_angle, wrap_angles

if TYPE_CHECKING:
    from optdock.calibration.recorded_motion import RecordedMotion, Smoothed
    from optdock.geometry.arrays import FloatArray

__all__ = ["LocalizationErrors", "docks_in_map", "localization_errors", "stored_dock"]

_NEAR = 0.3  # [s] between a detection and an estimate: the odometry leads over so long without an error that counts
_RIGHT = 4.0  # standard deviations: detections that are farther off are wrong ones
_BIN = 0.5  # [s]: medians over so long are exact to millimetres, and few localizations are told more slowly
_SIDE = 2  # bins on either side whose means are compared for a jump
_GAP = 1.5  # [s] between two bins, after which a change may be drift
_LEAST_JUMP = 0.025  # [m]: AMCL drifts by less than that in a second, mostly; else see `_by_drift`
_MOST_JUMP = 0.04  # [m]: where no less can be told from drift, jumps as particle filters make them cannot be counted
_TIMES_DRIFT = 3.5  # standard deviations of drift: by chance one change of 500 is more, of a hundred that are looked at
_BY_CHANCE = 3.5  # standard deviations of a change that detections make up
_EVERY = 1.0  # [s] between the values that the spread is computed of: their errors last for seconds
_LEAST = 12  # values in all
_UNKNOWN = 1.0  # [m], [rad]: standard deviation of what a jump may be, and of the dock
_IN_A_JUMP = 0.005  # [m] of drift and of detections that a size has in it


class LocalizationErrors(NamedTuple):
    """What is measured against the detections.

    Attributes:
        quantities: Spread, rate and size of jumps.
        series: Of each recording: stamps and errors of x, y [m], yaw [rad] at the robot, Shape (n, 4).
    """

    quantities: list[Quantity]
    series: list[FloatArray]


class Placed(NamedTuple):
    """Robot and dock in the map.

    Attributes:
        stamps: Of detections, Shape (n,) [s].
        robot: By localization, Shape (n, 3).
        dock: As then detected, Shape (n, 3).
        variances: Of the robot's x and y, each [m^2], and yaw [rad^2], where the dock is known; Shape (n, 2).
    """

    stamps: FloatArray
    robot: FloatArray
    dock: FloatArray
    variances: FloatArray


def docks_in_map(one: Smoothed, delay: float) -> Placed:
    """Where localization and each detection put the robot and the dock; wrong detections are left out.

    Args:
        one: A recording.
        delay: By which its detections are late [s].

    """
    told, seen = one.recording.localization, one.seen
    times, poses = one.recording.path
    stamps = seen.stamps - delay
    if len(told) < 2:
        return Placed(stamps[:0], seen.detected[:0], seen.detected[:0], seen.detected[:0, :2])
    near = np.clip(np.searchsorted(told[:, 0], stamps), 1, len(told) - 1)
    near = np.where(stamps - told[near - 1, 0] < told[near, 0] - stamps, near - 1, near)
    kept = np.all(np.abs(seen.residuals) < _RIGHT * seen.sigmas, axis=1)
    kept &= (np.abs(told[near, 0] - stamps) < _NEAR) & (stamps >= times[0]) & (stamps <= times[-1])
    then, now = (
        np.column_stack([np.interp(at[kept], times, poses[:, k]) for k in range(3)]) for at in (told[near, 0], stamps)
    )
    robot = _composed(told[near[kept], 1:], _seen_from(then, now))
    sigmas, ranges = seen.sigmas[kept], seen.ranges[kept]
    variances = sigmas[:, 0] ** 2 + (ranges * sigmas[:, 2]) ** 2, sigmas[:, 2] ** 2
    return Placed(stamps[kept], robot, _composed(robot, seen.detected[kept]), np.column_stack(variances))


def stored_dock(motion: RecordedMotion) -> list[Quantity]:
    """The dock's pose in the map, of the recordings whose dockings succeeded: a mean with Student's interval."""
    names = (("stored dock, x", "m"), ("stored dock, y", "m"), ("stored dock, yaw", "rad"))
    rows = [docks_in_map(one, float(motion.values[3])).dock for one in motion.of if one.recording.docked_at is not None]
    rows = [one for one in rows if len(one) > 0]
    count = sum(map(len, rows))
    if len(rows) < 2:
        reason = "no docking succeeded" if not rows else "one docking succeeded; its localization may have been off"
        return [unknown(name, unit, reason, count) for name, unit in names]
    first = float(rows[0][0, 2])
    poses = np.array(
        [[*np.mean(one[:, :2], axis=0), first + float(np.mean(wrap_angles(one[:, 2] - first)))] for one in rows]
    )
    kept = _without_outliers(poses)
    x, y, yaw = (Quantity(*name, *mean_of(kept[:, k]), count, len(kept)) for k, name in enumerate(names))
    whole = normalize_angle(yaw.value) - yaw.value
    yaw = dataclasses.replace(yaw, value=yaw.value + whole, low=yaw.low + whole, high=yaw.high + whole)
    return [x, y, yaw]


def _without_outliers(poses: FloatArray) -> FloatArray:
    """Poses near the median in every coordinate: all but those of another dock, or of a robot that was lost."""
    middle = np.median(poses, axis=0)
    spread = 1.4826 * np.median(np.abs(poses - middle), axis=0) + _USUAL
    kept: FloatArray = poses[np.all(np.abs(poses - middle) <= 6.0 * spread, axis=1)]
    return kept


# [m, m, rad]: a localization that agrees with itself better does so by chance
_USUAL = readonly(np.array([0.01, 0.01, 0.01]))


def localization_errors(motion: RecordedMotion) -> LocalizationErrors:
    """Spread and jumps of the localization."""
    names = (
        ("localization sigma, position", "m"), ("localization sigma, yaw", "rad"),
        ("localization jumps", "1/s"), ("size of localization jumps", "m"),
    )  # fmt: skip
    found = [docks_in_map(one, float(motion.values[3])) for one in motion.of]
    found = [one for one in found if len(one.stamps) > 0]
    if sum(len(one.stamps) for one in found) < _LEAST:
        reason = "localization and dock were hardly ever known at the same time"
        return LocalizationErrors([unknown(name, unit, reason) for name, unit in names], [])
    docks = np.concatenate([one.dock for one in found])
    first = float(docks[0, 2])
    dock = np.array([*np.median(docks[:, :2], axis=0), first + float(np.median(wrap_angles(docks[:, 2] - first)))])
    series = [_binned(one, dock, _BIN) for one in found]
    least = _by_drift(series)
    jumps = [_jumps(rows, least) for rows in series]
    sizes = np.array([size for one in jumps for _, size in one])
    steps = np.concatenate([np.diff(rows[:, 0]) for rows in series])
    exposure = max(float(np.sum(steps[steps < _GAP])), _BIN)
    thin = [_binned(one, dock, _EVERY) for one in found]
    cut = [[stamp for stamp, _ in one] for one in jumps]
    quantities = [
        _spread(names[0], thin, cut, (1, 2)),
        _spread(names[1], thin, cut, (3,)),
        _rate(names[2], len(sizes), exposure, least, len(series)),
        _size(names[3], sizes, exposure, len(series)),
    ]
    return LocalizationErrors(quantities, [rows[:, :4] for rows in series])


def _rate(name: tuple[str, str], jumps: int, exposure: float, least: float, sources: int) -> Quantity:
    if least > _MOST_JUMP:
        return unknown(*name, f"the localization wanders: no jump of less than {least:.2f} m could be told from that")
    return Quantity(*name, *poisson_rate(jumps, exposure), jumps, sources)


def _size(name: tuple[str, str], sizes: FloatArray, exposure: float, sources: int) -> Quantity:
    """The mean size of jumps."""
    if len(sizes) < 2:
        return unknown(*name, f"{len(sizes)} jumps in {exposure:.0f} s", len(sizes))
    value, low, high = mean_of(sizes)
    return Quantity(*name, value, max(low - _IN_A_JUMP, 0.0), high + _IN_A_JUMP, len(sizes), sources)


def _errors(robot: FloatArray, seen: FloatArray, dock: FloatArray) -> FloatArray:
    """Of the localization at the robot, x, y [m], yaw [rad] in the map, Shape (n, 3).

    Args:
        robot: In the map by localization, Shape (n, 3).
        seen: The dock in the map by these and detections, Shape (n, 3).
        dock: Where it is in the map, Shape (3,).
    """
    truly = _composed(np.broadcast_to(dock, seen.shape), _seen_from(seen, robot))
    return np.column_stack((robot[:, :2] - truly[:, :2], wrap_angles(robot[:, 2] - truly[:, 2])))


def _composed(frames: FloatArray, poses: FloatArray) -> FloatArray:
    """Poses in frames, seen from where the frames are given in, Shape (n, 3)."""
    c, s = np.cos(frames[:, 2]), np.sin(frames[:, 2])
    x, y = frames[:, 0] + c * poses[:, 0] - s * poses[:, 1], frames[:, 1] + s * poses[:, 0] + c * poses[:, 1]
    return np.column_stack((x, y, frames[:, 2] + poses[:, 2]))


def _seen_from(frames: FloatArray, poses: FloatArray) -> FloatArray:
    """Poses as seen from frames, Shape (n, 3)."""
    c, s = np.cos(frames[:, 2]), np.sin(frames[:, 2])
    x, y = poses[:, 0] - frames[:, 0], poses[:, 1] - frames[:, 1]
    return np.column_stack((c * x + s * y, c * y - s * x, poses[:, 2] - frames[:, 2]))


def _binned(one: Placed, dock: FloatArray, width: float) -> FloatArray:
    """Errors of the localization with a dock at a pose in the map, in means of bins of some width [s].

    Returns:
        Stamps, errors of x, y, yaw, and variances of what detections make of position and yaw, Shape (b, 6).
    """
    number = np.floor((one.stamps - one.stamps[0]) / width)
    errors, certain = _errors(one.robot, one.dock, dock), 1.0 / one.variances
    rows = []
    for bin_ in np.unique(number).tolist():
        inside = number == bin_
        weights = certain[inside][:, [0, 0, 1]]
        total = np.sum(weights, axis=0)
        mean = np.sum(weights * errors[inside], axis=0) / total
        rows.append([float(np.mean(one.stamps[inside])), *mean, *(1.0 / total[1:])])
    return np.array(rows)


def _by_drift(series: list[FloatArray]) -> float:
    """The size from which on a change is a jump [m]: changes by drift have the median that all of them have."""
    changes = np.array([size for rows in series for _, size, _ in _changes(rows)])
    if len(changes) == 0:
        return _LEAST_JUMP
    sigma = float(np.median(changes)) / math.sqrt(2.0 * math.log(2.0))  # of x and y each: a length is Rayleigh's
    return max(_LEAST_JUMP, _TIMES_DRIFT * sigma)


def _changes(rows: FloatArray) -> list[tuple[int, float, float]]:
    """Rows, how far the means before and after are apart, and by how much they are by chance, x and y each [m]."""
    found = []
    for k in range(_SIDE, len(rows) - _SIDE + 1):
        (before, one), (after, other) = _mean(rows[k - _SIDE : k]), _mean(rows[k : k + _SIDE])
        if rows[k, 0] - rows[k - 1, 0] < _GAP:
            found.append((k, math.hypot(*(after - before).tolist()), math.sqrt(one + other)))
    return found


def _jumps(rows: FloatArray, least: float) -> list[tuple[float, float]]:
    """Stamps and sizes [s, m] of jumps: where the means before and after differ, and most near by."""
    steps = np.zeros(len(rows))
    for k, size, chance in _changes(rows):
        if size > max(least, _BY_CHANCE * chance):
            steps[k] = size
    around = [float(np.max(steps[max(0, k - _SIDE) : k + _SIDE + 1])) for k in range(len(steps))]
    return [(float(rows[k, 0]), float(steps[k])) for k in np.flatnonzero((steps > 0.0) & (steps >= np.array(around)))]


def _mean(rows: FloatArray) -> tuple[FloatArray, float]:
    """Mean x and y by their variances, and the variance of each."""
    weights = 1.0 / rows[:, 4]
    mean: FloatArray = weights @ rows[:, 1:3] / np.sum(weights)
    return mean, float(1.0 / np.sum(weights))


def _spread(
    name: tuple[str, str], series: list[FloatArray], jumps: list[list[float]], columns: tuple[int, ...]
) -> Quantity:
    """Standard deviation of an error that drifts: a Gauss-Markov process, by maximum likelihood.

    Its correlation time and a white part, beside that of the detections, are estimated too; the dock and what each jump
    has added are not known. The interval is that of the profile of the likelihood ([Pawitan2001] ch. 3). A jump while
    the dock was not seen moves all that a recording shows; so the lower bound is that of a model in which recordings
    are off by offsets of their own, whose standard deviation is one more unknown.
    """
    from scipy.optimize import brentq, minimize_scalar

    process = _Process(series, jumps, columns)
    lowest, highest = _LIMITS

    def bound(limit: float, *, offsets: bool) -> tuple[float, float]:
        """The best standard deviation, and the end of its interval towards a limit, as logarithms."""

        def profile(logarithm: float) -> float:
            return process.profile(math.exp(logarithm), offsets=offsets)

        best = minimize_scalar(profile, bounds=(lowest, highest), method="bounded", options={"xatol": 0.02})
        # How far the likelihood falls to the end: Student's quantile instead of the normal one, as recordings are few.
        level, at = float(best.fun) + 0.5 * student(max(len(series) - 1.0, 1.0)) ** 2, float(best.x)
        if profile(limit) < level:
            return at, limit
        return at, float(brentq(lambda x: profile(x) - level, limit, at, xtol=0.02))

    at, high = bound(highest, offsets=False)
    count = sum(map(len, series))
    if high >= highest:
        reason = f"{count} s with detections, in {len(series)} drives, are too few for errors that last"
        return unknown(*name, reason, count)
    low = min(bound(lowest, offsets=True)[1], at)
    return Quantity(*name, math.exp(at), math.exp(low), math.exp(high), count, len(series))


_LIMITS = math.log(3e-4), math.log(0.3)  # [m] or [rad], of the standard deviation that is looked for
# Of correlation time, white part and offsets of recordings.
_OTHERS = (math.log(1.0), math.log(60.0)), (math.log(2e-4), math.log(0.01)), (math.log(2e-4), math.log(0.2))
_GUESS = math.log(10.0), math.log(0.003), math.log(0.01)  # as AMCL drifts, and as a second of detections is exact


class _Process:
    """The likelihood of errors of localization."""

    def __init__(self, series: list[FloatArray], jumps: list[list[float]], columns: tuple[int, ...]) -> None:
        number = np.repeat(np.arange(len(series)), [len(rows) for rows in series])
        rows = np.concatenate(series)
        self._values = rows[:, list(columns)]
        self._seen = np.diag(rows[:, 4 if columns[0] == 1 else 5])
        self._apart = np.abs(rows[:, 0, None] - rows[:, 0])
        self._together = number[:, None] == number
        self._known = np.full(self._apart.shape, _UNKNOWN**2)
        for k, stamps in enumerate(jumps):
            for stamp in stamps:
                after = ((number == k) & (rows[:, 0] >= stamp)).astype(np.float64)
                self._known += _UNKNOWN**2 * np.multiply.outer(after, after)

    def profile(self, sigma: float, *, offsets: bool) -> float:
        """Negative logarithm of the likelihood of a standard deviation, with the others as fit best."""
        from scipy.optimize import minimize

        def misfit(others: FloatArray) -> float:
            return self._misfit(sigma, others)

        count = 3 if offsets else 2
        return float(minimize(misfit, np.array(_GUESS[:count]), method="L-BFGS-B", bounds=_OTHERS[:count]).fun)

    def _misfit(self, sigma: float, others: FloatArray) -> float:
        from scipy.linalg import cho_factor, cho_solve

        lasting, white, *offsets = np.exp(others).tolist()
        lasts = sigma**2 * np.exp(-self._apart / lasting) + sum(offset**2 for offset in offsets)
        drifting = self._together * lasts
        factor = cho_factor(self._known + drifting + self._seen + white**2 * np.eye(len(self._apart)), lower=True)
        fits = float(np.sum(self._values * cho_solve(factor, self._values)))
        size: int = self._values.shape[1]
        return 0.5 * fits + size * float(np.sum(np.log(np.diag(factor[0]))))
