from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.pose import Pose2
from optdock.model.limits import MotionLimits
from optdock.model.path import ClothoidSegment, Path


def _dense_ratios(trajectory, limits, zone) -> dict[str, float]:
    """Largest quotient of every quantity and its limit on a 1 ms grid plus all phase ends; nothing shared with the
    library's own check but the values it is about."""
    law = trajectory.time_law
    t = np.union1d(np.arange(0.0, law.duration, 1e-3), law.times)
    row = trajectory.sample_at(t)
    _s, v, a, _j = law.at(t).T
    k, rate = trajectory.path.curvature_at(row.s), trajectory.path.curvature_rate_at(row.s)
    top = np.where(trajectory.path.direction_at(row.s) > 0, limits.max_speed, limits.max_reverse_speed)
    slow = row.s >= trajectory.path.length - zone.distance
    wheel = np.maximum(np.abs(v + 0.5 * limits.track_width * v * k), np.abs(v - 0.5 * limits.track_width * v * k))
    ratios = {
        "speed": v / top,
        "zone": np.where(slow & (zone.distance > 0.0), v / zone.speed, 0.0),
        "backwards": np.where(v < -1e-12, np.inf, 0.0),
        "yaw rate": np.abs(v * k) / limits.max_yaw_rate,
        "lateral": v * v * np.abs(k) / limits.max_lateral_acceleration,
        "wheel": wheel / limits.max_wheel_speed,
        "yaw acceleration": np.abs(a * k + v * v * rate) / limits.max_yaw_acceleration,
        "lateral jerk": np.abs(2.0 * v * a * k + v**3 * rate) / limits.max_lateral_jerk,
        "acceleration": a / limits.max_acceleration,
        "deceleration": -a / limits.max_deceleration,
        "jerk": np.abs(law.jerks) / limits.max_jerk,
        "steering rate": _steering_rates(row, limits) / limits.max_steering_rate,
    }
    return {name: float(np.max(values)) for name, values in ratios.items()}


def _steering_rates(row, limits) -> np.ndarray:
    """Mean rates of the steering angle between samples, rests included: of the bicycle model that yaws as the samples
    do, in either gear; at rest the angle is unknown."""
    moving = np.abs(row.speed) > 1e-6
    angle = np.arctan(limits.wheelbase * row.yaw_rate[moving] / row.speed[moving])
    return np.append(np.abs(np.diff(angle)) / np.diff(row.t[moving]), 0.0)


def _least_duration(path, limits, zone) -> float:
    """A lower bound: speed caps and accelerations only, by forward and backward passes on a fine grid."""
    total, begin = 0.0, 0.0
    for segment in path.segments:
        s = np.linspace(0.0, segment.length, 8001)
        middle = 0.5 * (s[1:] + s[:-1])
        k, rate = np.abs(segment.curvature_at(middle)) + 1e-12, np.abs(segment.curvature_rate_at(middle))
        steering = (1.0 + (limits.wheelbase * k) ** 2) / np.maximum(limits.wheelbase * rate, 1e-9)
        cap = np.full(k.size, limits.max_speed if segment.direction > 0 else limits.max_reverse_speed)
        for other in (
            limits.max_yaw_rate / k,
            np.sqrt(limits.max_lateral_acceleration / k),
            limits.max_wheel_speed / (1.0 + 0.5 * limits.track_width * k),
            limits.max_steering_rate * steering,
            np.where(begin + middle >= path.length - zone.distance, zone.speed, np.inf),
        ):
            cap = np.minimum(cap, other)
        x = np.minimum(np.append(cap, 0.0), np.insert(cap, 0, 0.0)) ** 2
        rise, fall = 2.0 * limits.max_acceleration * s, 2.0 * limits.max_deceleration * s
        x = np.minimum.accumulate(x - rise) + rise
        v = np.sqrt(np.maximum(np.minimum.accumulate((x + fall)[::-1])[::-1] - fall, 0.0))
        total += float(np.sum(2.0 * np.diff(s) / np.maximum(v[1:] + v[:-1], 1e-9)))
        begin += segment.length
    return total


def _rests(trajectory) -> bool:
    """At rest, to rounding, at every cusp and at the end, which is the end of the path."""
    borders = trajectory.time_law.states
    stops = [*trajectory.path.cusps, trajectory.path.length]
    found = [np.min(np.abs(borders - [s, 0.0, 0.0]).max(axis=1)) for s in stops]
    return max(found) < 1e-9 and abs(borders[-1, 0] - trajectory.path.length) < 1e-9


def _spline(lengths, curvature, sign=1, start=None) -> ClothoidSegment:
    knots = np.concatenate(([0.0], np.cumsum(lengths)))
    return ClothoidSegment(ClothoidSpline(start or Pose2(0.0, 0.0, 0.0), knots, np.asarray(curvature, float), sign))


def _random_path(rng, gears=1, length=None, cell=0.1) -> Path:
    """Clothoid splines with a random walk of curvature: rate jumps at every knot, curvature jumps at cusps."""
    segments, pose = [], Pose2(0.0, 0.0, 0.0)
    sign = int(rng.choice((-1, 1)))
    for _ in range(gears):
        total = length or float(rng.uniform(0.5, 5.0))
        count = max(2, int(total / cell))
        steps = rng.uniform(0.5, 1.5, count)
        curvature = 2.0 * np.tanh(np.cumsum(rng.normal(0.0, 0.25, count + 1)) + rng.normal(0.0, 0.5))
        segments.append(_spline(steps * total / steps.sum(), curvature, sign, pose))
        sign, pose = -sign, Pose2.from_sequence(segments[-1].poses_at(total)[0])
    return Path(tuple(segments))


@pytest.fixture(scope="session")
def dense() -> SimpleNamespace:
    return SimpleNamespace(ratios=_dense_ratios, rests=_rests, least_duration=_least_duration)


@pytest.fixture(scope="session")
def make() -> SimpleNamespace:
    return SimpleNamespace(spline=_spline, random_path=_random_path)


@pytest.fixture(scope="session")
def all_limits() -> MotionLimits:
    return MotionLimits(
        max_speed=0.6,
        max_reverse_speed=0.35,
        max_acceleration=0.4,
        max_deceleration=0.5,
        max_jerk=1.2,
        max_yaw_rate=0.7,
        max_yaw_acceleration=1.2,
        max_lateral_acceleration=0.3,
        max_wheel_speed=0.65,
        track_width=0.4,
        max_lateral_jerk=0.6,
    )
