"""True values of a hidden robot, by the names used in `optdock.calibration`."""

from __future__ import annotations

import dataclasses
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from experiments.calibration.robots import TRACK_WIDTH
from experiments.docking.field.drive import SUBSTEP
from experiments.docking.field.odometry import OdometryState

if TYPE_CHECKING:
    from experiments.calibration.robots import HiddenRobot
    from experiments.docking.field.drive import Drive
    from experiments.docking.field.odometry import Odometry

__all__ = ["truths"]

_INSTANT = 1e-9  # [s]: rounding of times that are sums
_CYCLES = 20_000  # number of samples of a mean: standard error of 0.01 ms
_MESSAGES = 400_000  # number of samples of mean ages, which vary over 20 ms and are correlated
# [m]: the estimated range is of the docked pose, the camera's range of its marker, see `MARKER`, `Camera`
_MARKER_BEYOND_CAMERA = 0.2


def truths(hidden: HiddenRobot, rate: float) -> dict[str, float]:
    """Return the values that the intervals should contain.

    Args:
        hidden: The robot.
        rate: Control cycles per second [Hz].
    """
    drive, camera, localization = hidden.world.drive, hidden.world.camera, hidden.world.localization
    # The odometry is stamped after its reading: relative to its stamps, all other events are later and detections
    # earlier by that delay.
    stamped = 0.5 * hidden.world.odometry.stamp_jitter
    latency = _latency(hidden, rate) + stamped
    slip = _slip_share(hidden)
    left, right = (radius / drive.wheel_radius for radius in hidden.radii)
    track = hidden.track_width / TRACK_WIDTH
    mean = 0.5 * (left + right)
    told_late = 0.5 * sum(camera.latency) if camera.stamped_on_arrival else 0.0
    jitter = camera.latency[1] - camera.latency[0] if camera.stamped_on_arrival else 0.0
    dock = hidden.layout.true_dock
    return {
        "command latency, linear": latency,
        "drive lag, linear": drive.lag,
        "command latency, angular": latency,
        "drive lag, angular": drive.lag,
        "dead band, left wheel": hidden.dead_bands[0],
        "dead band, right wheel": hidden.dead_bands[1],
        "twist window": hidden.world.odometry.window,
        "age of the odometry": _odometry_age(hidden, rate),
        "scale of the distance": mean * (1.0 - slip) - 1.0,
        "turn per metre": (right - left) / hidden.track_width * (1.0 - slip),
        "scale of turns": mean / track * (1.0 - slip) - 1.0,
        "detections late by": told_late - stamped,
        "left wheel's radius outside the plausible range": left * (1.0 - slip) - 1.0,
        "right wheel's radius outside the plausible range": right * (1.0 - slip) - 1.0,
        "track width outside the plausible range": track - 1.0,
        "detection sigma, position, at range 0": camera.sigmas(_MARKER_BEYOND_CAMERA)[0],
        "detection sigma, position, per range": camera.position_slope,
        "detection sigma, yaw, at range 0": camera.sigmas(_MARKER_BEYOND_CAMERA)[1],
        "detection sigma, yaw, per range": camera.yaw_slope,
        "jitter of the detections' stamps": np.hypot(jitter, 2.0 * stamped).item() / 12.0**0.5,
        "wrong detections": camera.outliers,
        "blind distance": camera.near if camera.near_loss == 1.0 else 0.0,
        "localization sigma, position": localization.drift,
        "localization sigma, yaw": localization.drift_yaw,
        "localization jumps": 1.0 / localization.jump_pause,
        "size of localization jumps": 0.5 * sum(localization.jump),
        "stored dock, x": dock.x,
        "stored dock, y": dock.y,
        "stored dock, yaw": dock.yaw,
    }


def _latency(hidden: HiddenRobot, rate: float) -> float:
    """Return the mean additional age of the active command compared with commands without latency [s].

    Commands stay in order, so the mean exceeds the mean latency; and a command becomes active at the next sub-step.
    """
    random, drive = np.random.default_rng(7), hidden.world.drive
    dropped = random.random(_CYCLES) < hidden.world.dropped_cycles
    sent = np.cumsum(np.where(dropped, 2.0, 1.0) / rate)
    arrived = np.maximum.accumulate(sent + random.uniform(*drive.latency, _CYCLES))
    got = random.random(_CYCLES) >= drive.command_loss
    times = np.arange(sent[0] + 1.0, sent[-1], SUBSTEP)
    in_force = sent[got][np.searchsorted(arrived[got], times + _INSTANT, side="right") - 1]
    half_steps = np.arange(sent[0] + 1.0, sent[-1], SUBSTEP) + 0.5 * SUBSTEP
    newest = sent[np.searchsorted(sent, half_steps, side="right") - 1]
    return float(np.mean(half_steps - in_force) - np.mean(half_steps - newest))


def _odometry_age(hidden: HiddenRobot, rate: float) -> float:
    """Return the mean age of the newest message by its stamp [s], without the window, which differs between robots."""
    world = hidden.world
    return _mean_age(dataclasses.replace(world.odometry, window=0.04), world.drive, rate, _MESSAGES)


@cache
def _mean_age(odometry: Odometry, drive: Drive, rate: float, cycles: int) -> float:
    state = OdometryState(odometry, drive, np.random.default_rng(8))
    readings = round(1.0 / (rate * odometry.period))
    total = 0.0
    for cycle in range(1, cycles):
        for reading in range(readings):
            state.read(((cycle - 1) * readings + reading + 1) * odometry.period, 0.0, 0.0)
        total += cycle / rate - state.newest(cycle / rate).stamp
    return total / (cycles - 1)


def _slip_share(hidden: HiddenRobot) -> float:
    """Return the lost share of a wheel's distance: in two of three bursts a wheel slips."""
    drive = hidden.world.drive
    duration, share = 0.5 * sum(drive.slip_duration), 0.5 * sum(drive.slip_share)
    return duration / (duration + 1.0 / drive.slip_rate) * share * 2.0 / 3.0
