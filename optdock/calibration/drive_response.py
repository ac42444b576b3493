"""How a drive answers its commands: latency and first-order lag of speed and yaw rate, dead band of the wheels.

The commanded speed is delayed by the latency and then followed with a time constant,

    speed' = (gain * command(t - latency) - speed) / lag,

whose way between two readings of the odometry is compared with the way that they tell. The latency of single commands
is spread about the mean one, evenly as far as the answer knows: that smooths the answer as the lag does, so the spread
is estimated too.
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

_GRID = 0.005  # [s]: a tenth of the shortest lag of motors, so that the grid is not part of the answer
_SPAN = 0.1  # [s] of a residual: longer than the stamps of odometry jitter, shorter than any change of speed
_CLUSTER = 2.0  # [s]: residuals further apart than that have nothing in common, as the answer to a command takes less
# Latency [s], lag [s], gain [1], and the square of half the spread of the latency [s^2], from which the answer depends
# evenly down to 0.
_GUESS, _SCALE = (0.08, 0.1, 1.0, 5e-4), (0.02, 0.02, 0.02, 1e-3)
_LEAST_SPREAD = 4e-6  # [s^2]: 2 ms, which has no visible effect
_BOUNDS = (0.0, 1e-3, 0.2, _LEAST_SPREAD), (1.0, 2.0, 2.0, 0.04)
# [s]: lost commands, and latencies that are not spread evenly, move latency and lag against each other by about this.
_UNMODELLED = 0.0015
_MOST_UNCERTAIN = 0.5  # [s]: a larger uncertainty says nothing about a drive
_LEAST_CHANGE = 0.05, 0.1  # [m/s], [rad/s]: commands that change by less than this tell nothing of delays
_MOST_BAND, _BAND_STEP = 0.12, 0.001  # [m/s] of the dead bands that are looked at; motors beyond that are broken


class DriveResponse(NamedTuple):
    """What was found, and what the picture of it needs.

    Attributes:
        quantities: Latency and lag, linear and angular; dead bands.
        answers: Of each recording: times, Shape (n,), and linear and angular speed as told and as fitted, Shape (n, 4).
    """

    quantities: list[Quantity]
    answers: list[tuple[FloatArray, FloatArray]]


class _AxisRecording(NamedTuple):
    """One scalar drive in one recording: its commands, and the way that the odometry tells."""

    times: FloatArray
    commands: FloatArray
    stamps: FloatArray
    way: FloatArray
    first: IntArray  # rows of `stamps` where the spans of the residuals begin ...
    last: IntArray  # ... and end


def drive_response(recordings: Sequence[Recording]) -> DriveResponse:
    """Latency and lag of the drive, and the dead bands of its wheels, from commands against the odometry."""
    used = [one for one in recordings if len(one.path.times) > 20 and len(_axis(one, 0, (0.0, 0.0), 0.0).first)]
    width = max((one.track_width for one in used), default=0.0)
    bands, reason = (0.0, 0.0), _no_dead_bands(used, width)
    found_bands = [unknown(f"dead band, {name} wheel", "m/s", reason) for _, name in _SIDES]
    if not reason:
        for _ in range(2):  # with latency and lag of a drive without bands, and then of one with those
            found_bands = _dead_bands(used, bands, width)
            left, right = (one.value if one else 0.0 for one in found_bands)
            if bands == (left, right):
                break
            bands = left, right
    fits: list[Fit | None] = []
    quantities: list[Quantity] = []
    for index, name in enumerate(("linear", "angular")):
        found, rows = _fitted([_axis(one, index, bands, width) for one in used], name, _LEAST_CHANGE[index])
        fits.append(found)
        quantities += rows
    return DriveResponse([*quantities, *found_bands], [_answer(one, fits, bands, width) for one in used])


_SIDES = (-1.0, "left"), (1.0, "right")


def _no_dead_bands(used: list[Recording], width: float) -> str:
    """Why dead bands are unknown; empty where they are known."""
    if used and width == 0.0:
        return "the distance between the wheels, robot.limits.track_width, is not known"
    return _too_short([_axis(one, 0, (0.0, 0.0), 0.0) for one in used])


def _too_short(axes: list[_AxisRecording]) -> str:
    """Why there are too few residuals for intervals; empty where there are enough."""
    if axes and len(np.unique(_clusters(axes))) >= LEAST_CLUSTERS:
        return ""
    return f"commands and odometry were recorded for less than {_CLUSTER * (LEAST_CLUSTERS - 1):g} s"


def answered(times: FloatArray, commands: FloatArray, values: Sequence[float], at: FloatArray) -> FloatArray:
    """The way of a first-order drive that is late, from rest [m or rad], Shape (n,).

    Args:
        times: Of the commands, Shape (m,) [s]; each holds until the next one.
        commands: Shape (m,) [m/s or rad/s].
        values: Latency [s], lag [s], gain [1], square of half the spread of the latency [s^2].
        at: Times, Shape (n,) [s].
    """
    from scipy.signal import lfilter

    latency, lag, gain, spread = values
    half = math.sqrt(max(spread, 0.25 * _LEAST_SPREAD))
    begin, end = times[0], max(float(at[-1]), float(times[-1])) + _GRID
    grid = begin + _GRID * np.arange(int(np.ceil((end - begin) / _GRID)) + 1)
    # Of what was commanded, the integral and the integral of that: the mean over the spread needs the second.
    steps = np.diff(times)
    once = np.concatenate(([0.0], np.cumsum(commands[:-1] * steps)))
    twice = np.concatenate(([0.0], np.cumsum(once[:-1] * steps + 0.5 * commands[:-1] * steps**2)))

    def summed(at_times: FloatArray) -> FloatArray:
        row = np.maximum(np.searchsorted(times, at_times, side="right") - 1, 0)
        since = np.maximum(at_times - times[row], 0.0)
        found: FloatArray = twice[row] + since * (once[row] + 0.5 * commands[row] * since)
        return found

    asked = (summed(grid - latency + half) - summed(grid - latency - half)) / (2.0 * half)
    target = gain * np.diff(asked) / _GRID
    keep = np.exp(-_GRID / lag)
    speed = lfilter([0.0, 1.0 - keep], [1.0, -keep], target)
    way = target * _GRID + (speed - target) * lag * (1.0 - keep)  # exact within a step of the grid
    found: FloatArray = np.interp(at, grid, np.concatenate(([0.0], np.cumsum(way))))
    return found


def _fitted(axes: list[_AxisRecording], name: str, least_change: float) -> tuple[Fit | None, list[Quantity]]:
    rows = [(f"command latency, {name}", "s"), (f"drive lag, {name}", "s")]
    count = sum(len(axis.first) for axis in axes)
    changes = max((float(np.ptp(axis.commands)) for axis in axes), default=0.0)
    reason = _too_short(axes)
    if axes and changes < least_change:
        reason = "the robot was never told to turn" if name == "angular" else "the robot was never told to drive"
    if reason:
        return None, [unknown(row, unit, reason, count) for row, unit in rows]
    clusters = _clusters(axes)
    found = fit(lambda values: _residuals(axes, values), _GUESS, clusters, _SCALE, bounds=_BOUNDS)
    sources = sum(float(np.ptp(axis.commands)) >= least_change for axis in axes)
    return found, [_checked(row, unit, found.interval(k), count, sources) for k, (row, unit) in enumerate(rows)]


def _checked(name: str, unit: str, interval: tuple[float, float, float], count: int, sources: int) -> Quantity:
    value, low, high = interval
    if high - low > _MOST_UNCERTAIN:
        return unknown(name, unit, "the answers fit with latencies and lags of any length", count)
    return Quantity(name, unit, value, max(low - _UNMODELLED, 0.0), high + _UNMODELLED, count, sources)


def _residuals(axes: list[_AxisRecording], values: FloatArray) -> FloatArray:
    found = []
    for axis in axes:
        off = answered(axis.times, axis.commands, values.tolist(), axis.stamps) - axis.way
        found.append(off[axis.last] - off[axis.first])
    return np.concatenate(found)


def _clusters(axes: list[_AxisRecording]) -> IntArray:
    """Of each residual: which stretch of which recording it is of."""
    return np.concatenate(clusters_of((axis.stamps[axis.first] - axis.stamps[0] for axis in axes), _CLUSTER))


def _way(recording: Recording) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Stamps, way driven along the heading, and yaw, by the odometry; Shape (n,) each."""
    stamps, poses = recording.path
    step = np.diff(poses, axis=0)
    middle = poses[:-1, 2] + 0.5 * step[:, 2]
    along = step[:, 0] * np.cos(middle) + step[:, 1] * np.sin(middle)
    return stamps, np.concatenate(([0.0], np.cumsum(along))), poses[:, 2] - poses[0, 2]


def _limited(recording: Recording, bands: tuple[float, float], width: float) -> FloatArray:
    """Commands with wheels standing still that are commanded less than their dead bands, Shape (n, 2)."""
    rims = [recording.commands[:, 0] + 0.5 * side * width * recording.commands[:, 1] for side, _ in _SIDES]
    left, right = (np.where(np.abs(rim) < band, 0.0, rim) for rim, band in zip(rims, bands, strict=True))
    return np.column_stack((0.5 * (left + right), (right - left) / width))


def _axis(recording: Recording, index: int, bands: tuple[float, float], width: float) -> _AxisRecording:
    stamps, along, yaw = _way(recording)
    commands = _limited(recording, bands, width) if width > 0.0 else recording.commands
    return _spans(recording, commands[:, index], stamps, (along, yaw)[index])


def _wheel(recording: Recording, side: float, width: float) -> _AxisRecording:
    stamps, along, yaw = _way(recording)
    lever = 0.5 * side * width
    return _spans(recording, recording.commands[:, 0] + lever * recording.commands[:, 1], stamps, along + lever * yaw)


def _spans(recording: Recording, commands: FloatArray, stamps: FloatArray, way: FloatArray) -> _AxisRecording:
    inside = (stamps >= recording.times[0]) & (stamps <= recording.times[-1])
    stamps, way = stamps[inside], way[inside]
    last = np.searchsorted(stamps, stamps + _SPAN)
    first = np.flatnonzero(last < len(stamps))
    return _AxisRecording(recording.times, commands, stamps, way, first, last[first])


def _dead_bands(recordings: list[Recording], bands: tuple[float, float], width: float) -> list[Quantity]:
    """The speed below which each wheel stands still: the one with which the answer of the drive fits best.

    Its interval are the speeds that fit no worse than chance allows, the misfits being summed by clusters.

    Args:
        recordings: What was driven.
        bands: With which latency and lag are fitted first [m/s].
        width: Between the wheels [m].
    """
    linear = [_axis(one, 0, bands, width) for one in recordings]
    clusters = _clusters(linear)
    values = fit(lambda x: _residuals(linear, x), _GUESS, clusters, _SCALE, bounds=_BOUNDS).values
    tried, found = np.arange(0.0, _MOST_BAND, _BAND_STEP), []
    for side, wheel in _SIDES:
        axes = [_wheel(one, side, width) for one in recordings]
        title, unit, count = f"dead band, {wheel} wheel", "m/s", len(clusters)
        if max(float(np.max(np.abs(axis.commands))) for axis in axes) < _MOST_BAND:
            found.append(unknown(title, unit, "the wheel was never told to turn fast enough", count))
            continue
        misfits = _misfits(axes, tried, values)
        row = _lowest(misfits)
        worse = misfits - misfits[row]
        spread = np.sqrt(np.sum((worse - np.mean(worse, axis=1, keepdims=True)) ** 2, axis=1))
        fits = np.flatnonzero(np.sum(worse, axis=1) <= student(worse.shape[1] - 1.0) * spread + _ROUNDING)
        low, high = float(tried[fits[0]]) - _BAND_STEP, float(tried[fits[-1]]) + _BAND_STEP
        found.append(Quantity(title, unit, float(tried[row]), max(low, 0.0), high, count, len(axes)))
    return found


_ROUNDING = 1e-15  # [m^2] of sums of squares


def _misfits(axes: list[_AxisRecording], bands: FloatArray, values: FloatArray) -> FloatArray:
    """Sums of squared residuals of each cluster for each dead band, Shape (b, c) [m^2].

    A stretch with a slipping or stalled wheel counts no more than others: misfits beyond the usual ones are cut.
    """
    clusters, before = _clusters(axes), np.zeros(0)
    rows: list[FloatArray] = []
    for band in bands.tolist():
        moved = [axis._replace(commands=np.where(np.abs(axis.commands) < band, 0.0, axis.commands)) for axis in axes]
        commands = np.concatenate([axis.commands for axis in moved])
        is_new = not np.array_equal(commands, before)  # between two commands that were given nothing changes
        rows.append(np.bincount(clusters, _residuals(moved, values) ** 2).astype(np.float64) if is_new else rows[-1])
        before = commands
    found = np.array(rows)
    usual = float(np.percentile(np.min(found, axis=0), 90.0))
    misfits: FloatArray = np.minimum(found, 4.0 * usual + _ROUNDING)
    return misfits


def _lowest(misfits: FloatArray) -> int:
    """The row whose sum is lowest; of several, as where nothing was commanded between them, the middle one."""
    total = np.sum(misfits, axis=1)
    alike = np.flatnonzero(total <= float(np.min(total)) * (1.0 + 1e-9) + _ROUNDING)
    return int(alike[len(alike) // 2])


def _answer(
    recording: Recording, fits: list[Fit | None], bands: tuple[float, float], width: float
) -> tuple[FloatArray, FloatArray]:
    """Times, and linear and angular speed over 0.1 s, measured and fitted."""
    columns = []
    times = np.zeros(0)
    for index, found in enumerate(fits):
        axis = _axis(recording, index, bands, width)
        spans = axis.stamps[axis.last] - axis.stamps[axis.first]
        times = 0.5 * (axis.stamps[axis.last] + axis.stamps[axis.first])
        columns.append((axis.way[axis.last] - axis.way[axis.first]) / spans)
        if found is None:
            columns.append(np.full(len(spans), np.nan))
            continue
        way = answered(axis.times, axis.commands, found.values.tolist(), axis.stamps)
        columns.append((way[axis.last] - way[axis.first]) / spans)
    return times, np.column_stack(columns)
