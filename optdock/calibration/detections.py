"""Detections: noise as a function of range, share of wrong detections, blind distance."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from optdock.calibration.motion_smoother import detection_noise
from optdock.calibration.statistics import Quantity, share_of, student, unknown

if TYPE_CHECKING:
    from optdock.calibration.motion_smoother import RecordedMotion, Smoothed
    from optdock.geometry.arrays import FloatArray

__all__ = ["detection_quantities"]

_NOISE = (  # in the order of the fields of `Noise`: name, unit, and whether the value is a slope over the range
    ("detection sigma, position, at range 0", "m", False),
    ("detection sigma, position, per range", "1", True),
    ("detection sigma, yaw, at range 0", "rad", False),
    ("detection sigma, yaw, per range", "rad/m", True),
    ("jitter of the detections' stamps", "s", False),
)
_SLIPPED = 0.012  # [s]: 3 mm at 0.25 m/s, of slip that begins or ends within a cell of the smoothed motion
_LEAST_RANGES = 0.3  # [m]
_MOST_MISSED = 3  # frames without a detection over the last centimetres that may be missing by chance
_NEAR = 0.5  # [m] beyond the nearest detection, where the share of frames with a detection is counted
_CHANCE = 0.05
_AS_NEAR = 0.01  # [m]: a detection within this distance of the final place means that the detector was not blind there


def detection_quantities(motion: RecordedMotion) -> list[Quantity]:
    """Return noise, jitter of the stamps, share of wrong detections and blind distance."""
    found = detection_noise([one.seen for one in motion.of])
    count, sources = len(found.wrong), len(motion.of)
    half = student(max(count - 8.0, 1.0)) * np.sqrt(np.maximum(np.diag(found.covariance), 0.0))
    one_range = float(np.ptp(np.concatenate([one.seen.ranges for one in motion.of]))) < _LEAST_RANGES
    rows = []
    for (name, unit, is_slope), value, off in zip(_NOISE, found.noise[:5], half.tolist(), strict=True):
        if is_slope and one_range:
            rows.append(unknown(name, unit, "the dock was always detected from the same distance", count))
            continue
        low, high = value - off if is_slope else max(value - off, 0.0), value + off
        if name.startswith(
            "jitter"
        ):  # `off` refers to the square of the jitter; slip missing from the motion lowers the bound
            low, high = max(value**2 - off - _SLIPPED**2, 0.0) ** 0.5, (value**2 + off) ** 0.5
        rows.append(Quantity(name, unit, value, low, high, count, sources))
    wrong = int(np.sum(found.wrong > 0.5))
    return [
        *rows,
        Quantity("wrong detections", "1", *share_of(wrong, count), count, sources),
        _blind_distance(motion, found.wrong),
    ]


def _blind_distance(motion: RecordedMotion, wrong: FloatArray) -> Quantity:
    """Return the distance from the docked pose within which there are no detections.

    The upper bound is the range of the nearest detection. The lower bound is the range at which the number of frames
    without a detection is no longer explained by chance, given the share of frames with a detection at larger ranges.
    """
    name, unit = "blind distance", "m"
    begins = np.cumsum([0, *(len(one.seen.ranges) for one in motion.of)])
    seen = [
        one.seen.ranges[wrong[begin:end] < 0.5]
        for one, begin, end in zip(motion.of, begins[:-1], begins[1:], strict=True)
    ]
    nearest = min((float(np.min(ranges)) for ranges in seen if len(ranges)), default=np.inf)
    if not np.isfinite(nearest):
        return unknown(name, unit, "all detections are outliers")
    passed = np.concatenate([_frame_ranges(one) for one in motion.of])
    count, closest = sum(map(len, seen)), float(np.min(passed, initial=np.inf))
    missed = np.sort(passed[passed < nearest])[::-1]
    if len(missed) < _MOST_MISSED or nearest < closest + _AS_NEAR:
        return Quantity(name, unit, 0.0, 0.0, nearest, count, len(seen))
    beyond = sum(int(np.sum(ranges < nearest + _NEAR)) for ranges in seen)
    expected = int(np.sum((passed >= nearest) & (passed < nearest + _NEAR)))
    share = min(max(beyond / max(expected, 1), 0.1), 0.95)
    most = min(int(np.ceil(np.log(_CHANCE) / np.log(1.0 - share))), len(missed))
    # Uncertainty of either range: noise of the detection, and the distance driven during the jitter of a stamp.
    speeds = np.concatenate(
        [np.hypot(*one.seen.velocity[one.seen.ranges < nearest + _NEAR, :2].T) for one in motion.of]
    )
    still = motion.noise.sigmas(np.array([nearest]), np.zeros((1, 3)))[0, 0]
    off = 2.0 * float(np.hypot(still, motion.noise.jitter * np.median(speeds)))
    low = max(float(missed[most - 1]) - off, 0.0)
    return Quantity(name, unit, 0.5 * (low + nearest), low, nearest + off, count, len(seen))


def _frame_ranges(one: Smoothed) -> FloatArray:
    """Return the distances from the docked pose at all camera frames until the robot stops, Shape (n,) [m]."""
    stamps = one.recording.detections[:, 0]
    period = float(np.median(np.diff(stamps)))
    moving = np.flatnonzero(np.hypot(*np.diff(one.seen_from_dock[:, :2], axis=0).T) > 1e-5)
    if len(moving) == 0 or period <= 0.0:
        return np.zeros(0)
    times = np.arange(stamps[0], one.times[moving[-1]], period)
    away = np.hypot(one.seen_from_dock[:, 0], one.seen_from_dock[:, 1])
    found: FloatArray = np.interp(times, one.times, away)
    return found
