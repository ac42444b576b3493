"""Localization: spread and jumps of its errors, and the pose of the dock in the map.

A detection and a localization estimate together give the pose of the dock in the map. The true pose is the same in all
recordings, so variations of the computed pose are errors of the localization.
"""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.calibration.motion_smoother import relative_poses
from optdock.calibration.statistics import Quantity, mean_of, poisson_rate, student, unknown
from optdock.geometry.pose import normalize_angle, wrap_angles

if TYPE_CHECKING:
    from optdock.calibration.motion_smoother import RecordedMotion, Smoothed
    from optdock.geometry.arrays import FloatArray

__all__ = ["LocalizationErrors", "docks_in_map", "localization_errors", "stored_dock"]

_NEAR = 0.3  # [s] between a detection and an estimate: the error of the odometry over this time is negligible
_RIGHT = 4.0  # standard deviations beyond which a detection counts as wrong
_BIN = 0.5  # [s]: medians over this time are exact to millimetres, and few localizations are slower
_SIDE = 2  # bins on either side whose means are compared for a jump
_GAP = 1.5  # [s] between two bins, beyond which a change may be drift
_LEAST_JUMP = 0.025  # [m]: the drift of AMCL in one second is mostly smaller; otherwise see `_least_jump`
_MOST_JUMP = 0.04  # [m]: if smaller jumps cannot be distinguished from drift, jumps of particle filters are not counted
_TIMES_DRIFT = 3.5  # standard deviations of drift, exceeded by one change in 500; about a hundred are tested
_BY_CHANCE = 3.5  # standard deviations of a change due to noise of detections
_EVERY = 1.0  # [s] between the samples for the spread: the errors last for seconds
_LEAST = 12  # samples in total
_UNKNOWN = 1.0  # [m], [rad]: standard deviation of jumps and of the dock, weak priors
_IN_A_JUMP = 0.005  # [m]: drift and noise of detections contained in the size of a jump
_USUAL = 0.01  # [m], [rad]: smaller scatter of the dock between recordings is due to chance

# Logarithms of the limits of the standard deviation [m] or [rad], and of the correlation time [s], the white part and
# the offsets of recordings.
_LIMITS = math.log(3e-4), math.log(0.3)
_OTHERS = (math.log(1.0), math.log(60.0)), (math.log(2e-4), math.log(0.01)), (math.log(2e-4), math.log(0.2))
_GUESS = math.log(10.0), math.log(0.003), math.log(0.01)  # drift of AMCL, and noise of one second of detections


class LocalizationErrors(NamedTuple):
    """Errors of the localization, measured by the detections.

    Attributes:
        quantities: Spread of position and yaw, rate and size of jumps.
        series: For each recording: stamps and errors of x, y [m], yaw [rad] at the robot, Shape (n, 4).
    """

    quantities: list[Quantity]
    series: list[FloatArray]


class Placed(NamedTuple):
    """Robot and dock in the map at the times of detections.

    Attributes:
        stamps: Shape (n,) [s].
        robot: Pose of the robot by localization, Shape (n, 3).
        dock: Pose of the dock by localization and detection, Shape (n, 3).
        variances: Variances of the robot's x and y, each [m^2], and yaw [rad^2] due to a detection, Shape (n, 2).
    """

    stamps: FloatArray
    robot: FloatArray
    dock: FloatArray
    variances: FloatArray


def docks_in_map(one: Smoothed, delay: float) -> Placed:
    """Return the poses of robot and dock in the map at the times of all correct detections.

    Args:
        one: Smoothed recording.
        delay: Delay of the detections [s].
    """
    estimates, seen = one.recording.localization, one.seen
    times, poses = one.recording.path
    stamps = seen.stamps - delay
    if len(estimates) < 2:
        return Placed(stamps[:0], seen.detected[:0], seen.detected[:0], seen.detected[:0, :2])
    near = np.clip(np.searchsorted(estimates[:, 0], stamps), 1, len(estimates) - 1)
    near = np.where(stamps - estimates[near - 1, 0] < estimates[near, 0] - stamps, near - 1, near)
    kept = np.all(np.abs(seen.residuals) < _RIGHT * seen.sigmas, axis=1)
    kept &= (np.abs(estimates[near, 0] - stamps) < _NEAR) & (stamps >= times[0]) & (stamps <= times[-1])
    then, now = (
        np.column_stack([np.interp(at[kept], times, poses[:, k]) for k in range(3)])
        for at in (estimates[near, 0], stamps)
    )
    robot = _composed(estimates[near[kept], 1:], relative_poses(then, now))
    sigmas, ranges = seen.sigmas[kept], seen.ranges[kept]
    variances = sigmas[:, 0] ** 2 + (ranges * sigmas[:, 2]) ** 2, sigmas[:, 2] ** 2
    return Placed(stamps[kept], robot, _composed(robot, seen.detected[kept]), np.column_stack(variances))


def _composed(frames: FloatArray, poses: FloatArray) -> FloatArray:
    """Return poses, given relative to frames, in the common parent of these frames, Shape (n, 3)."""
    c, s = np.cos(frames[:, 2]), np.sin(frames[:, 2])
    x, y = frames[:, 0] + c * poses[:, 0] - s * poses[:, 1], frames[:, 1] + s * poses[:, 0] + c * poses[:, 1]
    return np.column_stack((x, y, frames[:, 2] + poses[:, 2]))


def stored_dock(motion: RecordedMotion) -> list[Quantity]:
    """Return the mean pose of the dock in the map over successful dockings, with Student's t intervals."""
    names = (("stored dock, x", "m"), ("stored dock, y", "m"), ("stored dock, yaw", "rad"))
    rows = [docks_in_map(one, motion.delay).dock for one in motion.of if one.recording.docked_at is not None]
    rows = [one for one in rows if len(one) > 0]
    count = sum(map(len, rows))
    if len(rows) < 2:
        reason = (
            "no docking succeeded"
            if not rows
            else "only one docking succeeded, so errors of its localization are unknown"
        )
        return [unknown(name, unit, reason, count) for name, unit in names]
    first = float(rows[0][0, 2])
    poses = np.array(
        [[*np.mean(one[:, :2], axis=0), first + float(np.mean(wrap_angles(one[:, 2] - first)))] for one in rows]
    )
    # Outliers are recordings at another dock, or of a robot that was lost.
    middle = np.median(poses, axis=0)
    spread = 1.4826 * np.median(np.abs(poses - middle), axis=0) + _USUAL
    kept = poses[np.all(np.abs(poses - middle) <= 6.0 * spread, axis=1)]
    x, y, yaw = (Quantity(*name, *mean_of(kept[:, k]), count, len(kept)) for k, name in enumerate(names))
    whole = normalize_angle(yaw.value) - yaw.value
    yaw = dataclasses.replace(yaw, value=yaw.value + whole, low=yaw.low + whole, high=yaw.high + whole)
    return [x, y, yaw]


def localization_errors(motion: RecordedMotion) -> LocalizationErrors:
    """Return spread and jumps of the localization."""
    position, yaw = ("localization sigma, position", "m"), ("localization sigma, yaw", "rad")
    rate, size = ("localization jumps", "1/s"), ("size of localization jumps", "m")
    found = [docks_in_map(one, motion.delay) for one in motion.of]
    found = [one for one in found if len(one.stamps) > 0]
    if sum(len(one.stamps) for one in found) < _LEAST:
        reason = "localization and detections hardly overlap in time"
        return LocalizationErrors([unknown(*name, reason) for name in (position, yaw, rate, size)], [])
    docks = np.concatenate([one.dock for one in found])
    first = float(docks[0, 2])
    dock = np.array([*np.median(docks[:, :2], axis=0), first + float(np.median(wrap_angles(docks[:, 2] - first)))])
    series = [_binned(one, dock, _BIN) for one in found]
    least = _least_jump(series)
    jumps = [_jumps(rows, least) for rows in series]
    thin = [_binned(one, dock, _EVERY) for one in found]
    cut = [[stamp for stamp, _ in one] for one in jumps]
    quantities = [
        _spread(position, thin, cut, (1, 2)),
        _spread(yaw, thin, cut, (3,)),
        *_jump_quantities(rate, size, series, jumps, least),
    ]
    return LocalizationErrors(quantities, [rows[:, :4] for rows in series])


def _binned(one: Placed, dock: FloatArray, width: float) -> FloatArray:
    """Return weighted means of the localization errors in bins of `width` [s] for a known dock, Shape (b, 6).

    The columns are stamps, errors of x, y, yaw, and variances of position and yaw due to the detections.
    """
    true = _composed(np.broadcast_to(dock, one.dock.shape), relative_poses(one.dock, one.robot))
    errors = np.column_stack((one.robot[:, :2] - true[:, :2], wrap_angles(one.robot[:, 2] - true[:, 2])))
    number, certain = np.floor((one.stamps - one.stamps[0]) / width), 1.0 / one.variances
    rows = []
    for bin_ in np.unique(number).tolist():
        inside = number == bin_
        weights = certain[inside][:, [0, 0, 1]]
        total = np.sum(weights, axis=0)
        mean = np.sum(weights * errors[inside], axis=0) / total
        rows.append([float(np.mean(one.stamps[inside])), *mean, *(1.0 / total[1:])])
    return np.array(rows)


def _changes(rows: FloatArray) -> list[tuple[int, float, float]]:
    """Return the index of each row, the distance between the means before and after it, and its sigma per axis [m]."""
    found = []
    for k in range(_SIDE, len(rows) - _SIDE + 1):
        (before, one), (after, other) = _mean(rows[k - _SIDE : k]), _mean(rows[k : k + _SIDE])
        if rows[k, 0] - rows[k - 1, 0] < _GAP:
            found.append((k, math.hypot(*(after - before).tolist()), math.sqrt(one + other)))
    return found


def _mean(rows: FloatArray) -> tuple[FloatArray, float]:
    """Return the weighted mean of x and y, and the variance of each."""
    weights = 1.0 / rows[:, 4]
    mean: FloatArray = weights @ rows[:, 1:3] / np.sum(weights)
    return mean, float(1.0 / np.sum(weights))


def _least_jump(series: list[FloatArray]) -> float:
    """Return the smallest change that counts as a jump [m]; the drift is estimated from the median change."""
    changes = np.array([size for rows in series for _, size, _ in _changes(rows)])
    if len(changes) == 0:
        return _LEAST_JUMP
    sigma = float(np.median(changes)) / math.sqrt(2.0 * math.log(2.0))  # per axis: a length is Rayleigh distributed
    return max(_LEAST_JUMP, _TIMES_DRIFT * sigma)


def _jumps(rows: FloatArray, least: float) -> list[tuple[float, float]]:
    """Return the stamps [s] and sizes [m] of jumps, which are local maxima of the significant changes."""
    steps = np.zeros(len(rows))
    for k, size, chance in _changes(rows):
        if size > max(least, _BY_CHANCE * chance):
            steps[k] = size
    around = [float(np.max(steps[max(0, k - _SIDE) : k + _SIDE + 1])) for k in range(len(steps))]
    return [(float(rows[k, 0]), float(steps[k])) for k in np.flatnonzero((steps > 0.0) & (steps >= np.array(around)))]


def _jump_quantities(
    rate: tuple[str, str],
    size: tuple[str, str],
    series: list[FloatArray],
    jumps: list[list[tuple[float, float]]],
    least: float,
) -> list[Quantity]:
    """Return the rate and the mean size of jumps."""
    sizes = np.array([size for one in jumps for _, size in one])
    steps = np.concatenate([np.diff(rows[:, 0]) for rows in series])
    exposure = max(float(np.sum(steps[steps < _GAP])), _BIN)
    if least > _MOST_JUMP:
        reason = f"jumps of less than {least:.2f} m cannot be distinguished from the drift of the localization"
        found = [unknown(*rate, reason)]
    else:
        found = [Quantity(*rate, *poisson_rate(len(sizes), exposure), len(sizes), len(series))]
    if len(sizes) < 2:
        return [*found, unknown(*size, f"{len(sizes)} jumps in {exposure:.0f} s", len(sizes))]
    value, low, high = mean_of(sizes)
    bounds = max(low - _IN_A_JUMP, 0.0), high + _IN_A_JUMP
    return [*found, Quantity(*size, value, *bounds, len(sizes), len(series))]


def _spread(
    name: tuple[str, str], series: list[FloatArray], jumps: list[list[float]], columns: tuple[int, ...]
) -> Quantity:
    """Return the standard deviation of a drifting error, a Gauss-Markov process, by maximum likelihood.

    The correlation time, and white noise in addition to the noise of the detections, are also estimated. The dock and
    the sizes of jumps are treated as unknown. The interval is computed from the profile likelihood ([Pawitan2001] ch.
    3). A jump before the dock is first detected shifts a whole recording, so the lower bound is computed by a model
    with one more unknown, the standard deviation of the offsets of recordings.
    """
    from scipy.optimize import brentq, minimize_scalar

    process = _Process(series, jumps, columns)
    lowest, highest = _LIMITS

    def bound(limit: float, *, offsets: bool) -> tuple[float, float]:
        """Return the logarithms of the estimate and of the bound towards `limit`."""

        def profile(logarithm: float) -> float:
            return process.profile(math.exp(logarithm), offsets=offsets)

        best = minimize_scalar(profile, bounds=(lowest, highest), method="bounded", options={"xatol": 0.02})
        # Student's quantile replaces the normal quantile, because there are few recordings.
        level, at = float(best.fun) + 0.5 * student(max(len(series) - 1.0, 1.0)) ** 2, float(best.x)
        if profile(limit) < level:
            return at, limit
        return at, float(brentq(lambda x: profile(x) - level, limit, at, xtol=0.02))

    at, high = bound(highest, offsets=False)
    count = sum(map(len, series))
    if high >= highest:
        reason = f"{count} s with detections, in {len(series)} drives, are too few for long-lasting errors"
        return unknown(*name, reason, count)
    low = min(bound(lowest, offsets=True)[1], at)
    return Quantity(*name, math.exp(at), math.exp(low), math.exp(high), count, len(series))


class _Process:
    """Likelihood function of the localization errors."""

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
        """Return the negative log profile likelihood of a standard deviation."""
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
