"""How exact detections are as a function of range, how many are wrong, how late they are, and where they end."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.calibration.recorded_motion import Noise
from optdock.calibration.statistics import Quantity, share_of, student, unknown

if TYPE_CHECKING:
    from collections.abc import Sequence

    from optdock.calibration.recorded_motion import RecordedMotion, Seen, Smoothed
    from optdock.geometry.arrays import FloatArray, IntArray

__all__ = ["DetectionNoise", "detection_noise", "detection_quantities", "noise_of"]

# Wrong detections: of another tag, of another pose of the same one. Their spread is estimated too, from here on.
_WRONG = 0.08, 0.15  # [m], [rad]
_LEAST = 2e-4  # [m], [rad]: no detector is better
_FLOOR = 1e-12
_STRETCH = 1.0  # [s]: slip lasts for less


class DetectionNoise(NamedTuple):
    """What fits the residuals of detections best.

    Attributes:
        noise: Standard deviations.
        covariance: Of position, position slope, yaw, yaw slope and the square of the jitter, Shape (5, 5).
        wrong: How probably each detection is a wrong one, Shape (n,).
    """

    noise: Noise
    covariance: FloatArray
    wrong: FloatArray


def noise_of(seen: Sequence[Seen]) -> Noise:
    """The standard deviations alone."""
    return detection_noise(seen).noise


def detection_noise(seen: Sequence[Seen]) -> DetectionNoise:
    """Standard deviations of detections by maximum likelihood.

    A detection is a right one, with standard deviations that grow with the range and, by the jitter of its stamp, with
    the speed; or a wrong one, with large ones. The covariance is the sandwich of [Cameron2015], clustered by stretches
    of a second: what the wheels have slipped and the smoothed motion has not is in all detections of one.
    """
    from scipy.optimize import minimize

    residuals = np.concatenate([one.residuals for one in seen])
    ranges = np.concatenate([one.ranges for one in seen])
    velocity = np.concatenate([one.velocity for one in seen])
    left = 1.0 - np.concatenate([one.leverage for one in seen])

    def parts(x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Logarithms of the densities of right and wrong ones, Shape (n,) each."""
        spread = _variances(x, ranges, velocity) * left + _FLOOR
        far = np.array([x[5], x[5], x[6]]) ** 2 + spread
        share = 1.0 / (1.0 + np.exp(-x[7]))
        right, wrong = (-0.5 * np.sum(residuals**2 / var + np.log(2.0 * np.pi * var), axis=1) for var in (spread, far))
        return right + np.log1p(-share), wrong + np.log(share)

    scale = np.array([1e-3, 1e-3, 1e-3, 1e-3, 1e-4, 0.1, 0.1, 1.0])
    start = np.array([3e-3, 4e-3, 6e-3, 8e-3, 1e-4, *_WRONG, -3.0]) / scale

    def each(z: FloatArray) -> FloatArray:
        return np.logaddexp(*parts(z * scale))

    least = np.array([_LEAST, -0.05, _LEAST, -0.05, 0.0, 0.02, 0.03, -7.0]) / scale
    most = np.array([0.2, 0.2, 0.5, 0.5, 0.04, 0.5, 1.0, 0.0]) / scale

    def misfit(z: FloatArray) -> float:
        return -float(np.sum(each(z)))

    bounds = list(zip(least.tolist(), most.tolist(), strict=True))
    found = minimize(misfit, start, method="L-BFGS-B", bounds=bounds)
    z = found.x
    right, wrong = parts(z * scale)
    values = z * scale
    covariance = _sandwich(each, z, _stretches(seen))[:5, :5] * np.outer(scale[:5], scale[:5])
    position, position_slope, yaw, yaw_slope, square = values[:5].tolist()
    noise = Noise(position, position_slope, yaw, yaw_slope, max(square, 0.0) ** 0.5)
    return DetectionNoise(noise, covariance, 1.0 / (1.0 + np.exp(np.clip(right - wrong, -50, 50))))


def _variances(x: FloatArray, ranges: FloatArray, velocity: FloatArray) -> FloatArray:
    """Of right detections' x, y and yaw, Shape (n, 3); smooth also where a slope or the jitter is a little below 0."""
    position, yaw = (np.maximum(x[k] + x[k + 1] * ranges, _LEAST) for k in (0, 2))
    found: FloatArray = np.column_stack((position, position, yaw)) ** 2 + x[4] * velocity**2
    return np.maximum(found, _LEAST**2)


def _stretches(seen: Sequence[Seen]) -> IntArray:
    """Of each detection: which stretch of which recording it is of."""
    found: list[IntArray] = []
    count = 0
    for one in seen:
        number = np.floor((one.stamps - np.min(one.stamps, initial=np.inf)) / _STRETCH).astype(np.intp) + count
        count = int(number.max()) + 1 if len(number) else count
        found.append(number)
    return np.concatenate(found)


def _sandwich(each: object, z: FloatArray, clusters: IntArray) -> FloatArray:
    """Covariance of a maximum likelihood estimate whose terms depend on each other within clusters."""
    assert callable(each)
    step = 1e-3 * np.maximum(np.abs(z), 0.1)
    count = len(z)

    def slopes(at: FloatArray) -> FloatArray:
        return np.column_stack(
            [(each(at + row) - each(at - row)) / (2.0 * row[k]) for k, row in enumerate(np.diag(step))]
        )

    curvature = np.array(
        [
            np.sum(slopes(z + row) - slopes(z - row), axis=0) / (2.0 * row[k])
            for k, row in enumerate(np.diag(10.0 * step))
        ]
    )
    single = slopes(z)
    scores = np.zeros((int(clusters.max()) + 1, count))
    np.add.at(scores, clusters, single)
    inverse = np.linalg.pinv(-0.5 * (curvature + curvature.T), rcond=1e-10)
    found: FloatArray = inverse @ (scores.T @ scores) @ inverse
    assert found.shape == (count, count)
    return found


def detection_quantities(motion: RecordedMotion) -> list[Quantity]:
    """Delay, noise, share of wrong ones and blind distance of detections."""
    found = detection_noise([one.seen for one in motion.of])
    count, sources = len(found.wrong), len(motion.of)
    names = (
        ("detection sigma, position, at range 0", "m"), ("detection sigma, position, per range", "1"),
        ("detection sigma, yaw, at range 0", "rad"), ("detection sigma, yaw, per range", "rad/m"),
        ("jitter of the detections' stamps", "s"),
    )  # fmt: skip
    half = student(max(count - 8.0, 1.0)) * np.sqrt(np.maximum(np.diag(found.covariance), 0.0))
    ranges = np.concatenate([one.seen.ranges for one in motion.of])
    rows = []
    for k, (name, unit) in enumerate(names):
        value, off = float(found.noise[k]), float(half[k])
        if k in _SLOPES and float(np.ptp(ranges)) < _LEAST_RANGES:
            rows.append(unknown(name, unit, "the dock was always seen from the same distance", count))
        else:
            low, high = (value - off, value + off) if k != 4 else _roots(value**2, off)
            rows.append(Quantity(name, unit, value, low if k in _SLOPES else max(low, 0.0), high, count, sources))
    wrong = int(np.sum(found.wrong > 0.5))
    return [
        *rows,
        Quantity("wrong detections", "1", *share_of(wrong, count), count, sources),
        _blind(motion, found.wrong),
    ]


def _roots(value: float, off: float) -> tuple[float, float]:
    """Of the bounds of the square of a jitter; from the lower one what unseen slip of the wheels makes up is taken."""
    return max(value - off - _SLIPPED**2, 0.0) ** 0.5, (value + off) ** 0.5


_SLIPPED = 0.012  # [s]: 3 mm at 0.25 m/s, of slip that begins or ends within the 0.2 s of a cell of the motion


_SLOPES = 1, 3
_LEAST_RANGES = 0.3  # [m]
_MOST_MISSED = 3  # pictures on the last centimetres without a detection that are not yet blindness
_NEAR = 0.5  # [m] beyond the nearest detection, where it is counted how many pictures show the dock
_CHANCE = 0.05
_AS_NEAR = 0.01  # [m]: a robot that saw the dock from as near as that to where it stopped was not blind


def _blind(motion: RecordedMotion, wrong: FloatArray) -> Quantity:
    """The distance of the docked pose within which there are no detections.

    It is not above the range of the nearest detection; and it is not below the range at which so many pictures are
    missing already that chance, with the share of pictures that show the dock farther off, would hardly leave them out.
    """
    name, unit = "blind distance", "m"
    begins = np.cumsum([0, *(len(one.seen.ranges) for one in motion.of)])
    seen = [
        one.seen.ranges[wrong[begin:end] < 0.5]
        for one, begin, end in zip(motion.of, begins[:-1], begins[1:], strict=True)
    ]
    nearest = min((float(np.min(ranges)) for ranges in seen if len(ranges)), default=np.inf)
    if not np.isfinite(nearest):
        return unknown(name, unit, "all detections are wrong ones")
    pictures = [_pictures(one) for one in motion.of]
    passed = np.concatenate(pictures) if pictures else np.zeros(0)
    count, closest = sum(map(len, seen)), float(np.min(passed, initial=np.inf))
    missed = np.sort(passed[passed < nearest])[::-1]
    if len(missed) < _MOST_MISSED or nearest < closest + _AS_NEAR:
        return Quantity(name, unit, 0.0, 0.0, nearest, count, len(seen))
    beyond = sum(int(np.sum(ranges < nearest + _NEAR)) for ranges in seen)
    expected = int(np.sum((passed >= nearest) & (passed < nearest + _NEAR)))
    share = min(max(beyond / max(expected, 1), 0.1), 0.95)
    most = min(int(np.ceil(np.log(_CHANCE) / np.log(1.0 - share))), len(missed))
    # How well either range is known: by where the dock was seen, and by how far the robot drove while a stamp jitters.
    speeds = np.concatenate(
        [np.hypot(*one.seen.velocity[one.seen.ranges < nearest + _NEAR, :2].T) for one in motion.of]
    )
    still = motion.noise.sigmas(np.array([nearest]), np.zeros((1, 3)))[0, 0]
    off = 2.0 * float(np.hypot(still, motion.noise.jitter * np.median(speeds)))
    low = max(float(missed[most - 1]) - off, 0.0)
    return Quantity(name, unit, 0.5 * (low + nearest), low, nearest + off, count, len(seen))


def _pictures(one: Smoothed) -> FloatArray:
    """Distances from the docked pose at the times of the pictures, whatever they showed: until the robot stands."""
    stamps = one.recording.detections[:, 0]
    period = float(np.median(np.diff(stamps)))
    moving = np.flatnonzero(np.hypot(*np.diff(one.seen_from_dock[:, :2], axis=0).T) > 1e-5)
    if len(moving) == 0 or period <= 0.0:
        return np.zeros(0)
    times = np.arange(stamps[0], one.times[moving[-1]], period)
    away = np.hypot(one.seen_from_dock[:, 0], one.seen_from_dock[:, 1])
    found: FloatArray = np.interp(times, one.times, away)
    return found
