"""Drive response: latency and first-order lag of speed and yaw rate, dead band of the wheels.

After the latency, the drive follows the commanded speed with a time constant,

    speed' = (gain * command(t - latency) - speed) / lag,

and the distance travelled between two poses of the odometry is compared with the measured distance. The latency of
individual commands is assumed to be uniformly distributed about its mean. The spread of the latency smooths the
response in the same way as the lag, so the spread is also estimated.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.calibration.statistics import LEAST_CLUSTERS, Quantity, clusters_of, fit, student, unknown

if TYPE_CHECKING:
    from collections.abc import Sequence

    from optdock.calibration.recording import Recording
    from optdock.calibration.statistics import Fit
    from optdock.geometry.arrays import FloatArray, IntArray

__all__ = ["DriveResponse", "answered", "drive_response"]

_GRID = 0.005  # [s]: a tenth of the shortest lag of motors, so that the grid has no effect on the response
_SPAN = 0.1  # [s] of a residual: longer than the jitter of stamps, shorter than any change of speed
_CLUSTER = 2.0  # [s]: longer than the response to a command, so that residuals farther apart are independent
# Latency [s], lag [s], gain [1], square of half the spread of the latency [s^2]; the square makes the response smooth
# in the parameter down to 0.
_GUESS, _SCALE = (0.08, 0.1, 1.0, 5e-4), (0.02, 0.02, 0.02, 1e-3)
_LEAST_SPREAD = 4e-6  # [s^2]: 2 ms, which has no visible effect
_BOUNDS = (0.0, 1e-3, 0.2, _LEAST_SPREAD), (1.0, 2.0, 2.0, 0.04)
_UNMODELLED = 0.0015  # [s]: error of latency and lag due to lost commands and other distributions of the latency
_MOST_UNCERTAIN = 0.5  # [s]: a longer interval is useless
_LEAST_CHANGE = {"linear": 0.05, "angular": 0.1}  # [m/s], [rad/s]: commands that change by less show no delays
_MOST_BAND, _BAND_STEP = 0.12, 0.001  # [m/s]: dead bands that are tried
_ROUNDING = 1e-15  # [m^2] of sums of squares
_WHEELS = (("left", -1.0), ("right", 1.0))


class DriveResponse(NamedTuple):
    """Estimates of the drive, and the data of its response for the picture.

    Attributes:
        quantities: Latency and lag, linear and angular; dead bands.
        answers: For each recording: times, Shape (n,), and linear and angular speed, each measured and fitted,
            Shape (n, 4).
    """

    quantities: list[Quantity]
    answers: list[tuple[FloatArray, FloatArray]]


class _Axis(NamedTuple):
    """Linear drive, angular drive or one wheel in one recording: commands, odometry, and spans of the residuals."""

    times: FloatArray
    commands: FloatArray
    stamps: FloatArray
    way: FloatArray
    first: IntArray  # rows of `stamps` at the beginning of each span
    last: IntArray  # rows at the end of each span


def drive_response(recordings: Sequence[Recording]) -> DriveResponse:
    """Estimate latency and lag of the drive and the dead bands of its wheels, from commands and odometry."""
    used = [one for one in recordings if len(one.path.times) > 20 and len(_axis(one, "linear").first)]
    width = max((one.track_width for one in used), default=0.0)
    bands = (0.0, 0.0)
    reason = _too_short([_axis(one, "linear") for one in used])
    if used and width == 0.0:
        reason = "the distance between the wheels, robot.limits.track_width, is unknown"
    found_bands = [unknown(f"dead band, {name} wheel", "m/s", reason) for name, _ in _WHEELS]
    if not reason:
        for _ in range(2):  # latency and lag are fitted first without dead bands, then with the dead bands found
            found_bands = _dead_bands(used, bands, width)
            left, right = (one.value if one else 0.0 for one in found_bands)
            if bands == (left, right):
                break
            bands = left, right
    fits: dict[str, Fit | None] = {}
    quantities: list[Quantity] = []
    for name in _LEAST_CHANGE:
        fits[name], rows = _latency_and_lag([_axis(one, name, bands, width) for one in used], name)
        quantities += rows
    return DriveResponse([*quantities, *found_bands], [_speeds(one, fits, bands, width) for one in used])


def _too_short(axes: list[_Axis]) -> str:
    """Return the reason why there are too few residuals for intervals; empty if there are enough."""
    if axes and len(np.unique(_clusters(axes))) >= LEAST_CLUSTERS:
        return ""
    return f"commands and odometry were recorded for less than {_CLUSTER * (LEAST_CLUSTERS - 1):g} s"


def answered(times: FloatArray, commands: FloatArray, values: Sequence[float], at: FloatArray) -> FloatArray:
    """Return the distance travelled by a first-order drive with latency, from rest [m or rad], Shape (n,).

    Args:
        times: Times of the commands, Shape (m,) [s]; each command holds until the next one.
        commands: Commanded speeds, Shape (m,) [m/s or rad/s].
        values: Latency [s], lag [s], gain [1], square of half the spread of the latency [s^2].
        at: Times of the result, Shape (n,) [s].
    """
    from scipy.signal import lfilter

    latency, lag, gain, spread = values
    half = math.sqrt(max(spread, 0.25 * _LEAST_SPREAD))
    begin, end = times[0], max(float(at[-1]), float(times[-1])) + _GRID
    grid = begin + _GRID * np.arange(int(np.ceil((end - begin) / _GRID)) + 1)
    # Integral and double integral of the commands; the mean over the spread of the latency needs the second.
    steps = np.diff(times)
    once = np.concatenate(([0.0], np.cumsum(commands[:-1] * steps)))
    twice = np.concatenate(([0.0], np.cumsum(once[:-1] * steps + 0.5 * commands[:-1] * steps**2)))

    def summed(at_times: FloatArray) -> FloatArray:
        row = np.maximum(np.searchsorted(times, at_times, side="right") - 1, 0)
        since = np.maximum(at_times - times[row], 0.0)
        found: FloatArray = twice[row] + since * (once[row] + 0.5 * commands[row] * since)
        return found

    mean = (summed(grid - latency + half) - summed(grid - latency - half)) / (2.0 * half)
    target = gain * np.diff(mean) / _GRID
    keep = np.exp(-_GRID / lag)
    speed = lfilter([0.0, 1.0 - keep], [1.0, -keep], target)
    way = target * _GRID + (speed - target) * lag * (1.0 - keep)  # exact within a step of the grid
    found: FloatArray = np.interp(at, grid, np.concatenate(([0.0], np.cumsum(way))))
    return found


def _latency_and_lag(axes: list[_Axis], name: str) -> tuple[Fit | None, list[Quantity]]:
    """Return the fit and the quantities of one axis; the fit is None if the commands do not determine it."""
    rows = (f"command latency, {name}", f"drive lag, {name}")
    count = sum(len(axis.first) for axis in axes)
    changes = [float(np.ptp(axis.commands)) for axis in axes]
    reason = _too_short(axes)
    if axes and max(changes) < _LEAST_CHANGE[name]:
        reason = (
            "the recordings contain no turning commands"
            if name == "angular"
            else "the recordings contain no driving commands"
        )
    if reason:
        return None, [unknown(row, "s", reason, count) for row in rows]
    found = _fit(axes)
    sources = sum(change >= _LEAST_CHANGE[name] for change in changes)
    quantities = []
    for k, row in enumerate(rows):
        value, low, high = found.interval(k)
        if high - low > _MOST_UNCERTAIN:
            quantities.append(
                unknown(row, "s", "the response is consistent with latencies and lags of any length", count)
            )
        else:
            low, high = max(low - _UNMODELLED, 0.0), high + _UNMODELLED
            quantities.append(Quantity(row, "s", value, low, high, count, sources))
    return found, quantities


def _fit(axes: list[_Axis]) -> Fit:
    return fit(lambda values: _residuals(axes, values), _GUESS, _clusters(axes), _SCALE, bounds=_BOUNDS)


def _residuals(axes: list[_Axis], values: FloatArray) -> FloatArray:
    found = []
    for axis in axes:
        off = answered(axis.times, axis.commands, values.tolist(), axis.stamps) - axis.way
        found.append(off[axis.last] - off[axis.first])
    return np.concatenate(found)


def _clusters(axes: list[_Axis]) -> IntArray:
    """Return the cluster index of each residual."""
    return np.concatenate(clusters_of((axis.stamps[axis.first] - axis.stamps[0] for axis in axes), _CLUSTER))


def _axis(recording: Recording, name: str, bands: tuple[float, float] = (0.0, 0.0), width: float = 0.0) -> _Axis:
    """Return the linear or angular drive; if `width` is positive, wheels stop below their dead bands [m/s]."""
    linear, angular = recording.commands.T
    if width > 0.0:
        rims = [linear + 0.5 * side * width * angular for _, side in _WHEELS]
        left, right = (np.where(np.abs(rim) < band, 0.0, rim) for rim, band in zip(rims, bands, strict=True))
        linear, angular = 0.5 * (left + right), (right - left) / width
    stamps, (along, yaw) = recording.path.times, recording.path.ways
    commands, way = (linear, along) if name == "linear" else (angular, yaw)
    return _spans(recording, commands, stamps, way)


def _wheel(recording: Recording, side: float, width: float) -> _Axis:
    """Return the drive of one wheel."""
    along, yaw = recording.path.ways
    lever = 0.5 * side * width
    commands = recording.commands[:, 0] + lever * recording.commands[:, 1]
    return _spans(recording, commands, recording.path.times, along + lever * yaw)


def _spans(recording: Recording, commands: FloatArray, stamps: FloatArray, way: FloatArray) -> _Axis:
    inside = (stamps >= recording.times[0]) & (stamps <= recording.times[-1])
    stamps, way = stamps[inside], way[inside]
    last = np.searchsorted(stamps, stamps + _SPAN)
    first = np.flatnonzero(last < len(stamps))
    return _Axis(recording.times, commands, stamps, way, first, last[first])


def _dead_bands(recordings: list[Recording], bands: tuple[float, float], width: float) -> list[Quantity]:
    """Return the dead band [m/s] of each wheel, which is the best fit of the speed below which the wheel does not move.

    The interval contains all speeds whose misfit, summed by clusters, is not significantly worse than the best misfit.

    Args:
        recordings: Recordings with commands and odometry.
        bands: Dead bands with which latency and lag are fitted [m/s].
        width: Distance between the wheels [m].
    """
    linear = [_axis(one, "linear", bands, width) for one in recordings]
    values, count = _fit(linear).values, len(_clusters(linear))
    tried, found = np.arange(0.0, _MOST_BAND, _BAND_STEP), []
    for wheel, side in _WHEELS:
        axes = [_wheel(one, side, width) for one in recordings]
        title, unit = f"dead band, {wheel} wheel", "m/s"
        if max(float(np.max(np.abs(axis.commands))) for axis in axes) < _MOST_BAND:
            found.append(unknown(title, unit, "no command was fast enough for this wheel", count))
            continue
        misfits = _misfits(axes, tried, values)
        # Between two commanded speeds all dead bands fit equally: the middle one is the estimate.
        total = np.sum(misfits, axis=1)
        best = np.flatnonzero(total <= float(np.min(total)) * (1.0 + 1e-9) + _ROUNDING)
        row = int(best[len(best) // 2])
        worse = misfits - misfits[row]
        spread = np.sqrt(np.sum((worse - np.mean(worse, axis=1, keepdims=True)) ** 2, axis=1))
        fits = np.flatnonzero(np.sum(worse, axis=1) <= student(worse.shape[1] - 1.0) * spread + _ROUNDING)
        low, high = float(tried[fits[0]]) - _BAND_STEP, float(tried[fits[-1]]) + _BAND_STEP
        found.append(Quantity(title, unit, float(tried[row]), max(low, 0.0), high, count, len(axes)))
    return found


def _misfits(axes: list[_Axis], bands: FloatArray, values: FloatArray) -> FloatArray:
    """Return the sums of squared residuals for each dead band and cluster, Shape (b, c) [m^2].

    Sums above four times the usual sum are clipped, because a wheel may slip or stall.
    """
    clusters, before = _clusters(axes), np.zeros(0)
    rows: list[FloatArray] = []
    for band in bands.tolist():
        moved = [axis._replace(commands=np.where(np.abs(axis.commands) < band, 0.0, axis.commands)) for axis in axes]
        commands = np.concatenate([axis.commands for axis in moved])
        is_new = not np.array_equal(commands, before)
        rows.append(np.bincount(clusters, _residuals(moved, values) ** 2).astype(np.float64) if is_new else rows[-1])
        before = commands
    found = np.array(rows)
    usual = float(np.percentile(np.min(found, axis=0), 90.0))
    misfits: FloatArray = np.minimum(found, 4.0 * usual + _ROUNDING)
    return misfits


def _speeds(
    recording: Recording, fits: dict[str, Fit | None], bands: tuple[float, float], width: float
) -> tuple[FloatArray, FloatArray]:
    """Return times, and the measured and fitted linear and angular speeds, averaged over 0.1 s."""
    columns = []
    times = np.zeros(0)
    for name, found in fits.items():
        axis = _axis(recording, name, bands, width)
        spans = axis.stamps[axis.last] - axis.stamps[axis.first]
        times = 0.5 * (axis.stamps[axis.last] + axis.stamps[axis.first])
        columns.append((axis.way[axis.last] - axis.way[axis.first]) / spans)
        if found is None:
            columns.append(np.full(len(spans), np.nan))
            continue
        way = answered(axis.times, axis.commands, found.values.tolist(), axis.stamps)
        columns.append((way[axis.last] - way[axis.first]) / spans)
    return times, np.column_stack(columns)
