"""The first iterate of the reference; its quality decides the number of iterations (10 instead of 20)."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray
    from optdock.timing.bounds import Bounds
    from optdock.timing.grid import Grid, Profile
    from optdock.timing.motion import State

__all__ = ["initial_guess"]

_SAMPLE = 0.02  # [s]
_SHARE = 0.9  # of the filtered profile: inside the limits
_BLEND = 0.6  # [s]: from the speed of a moving start


def initial_guess(grid: Grid, bounds: Bounds, profile: Profile, first: State, last: State) -> FloatArray:
    """v^2 at the knots, Shape (M + 1,) [m^2/s^2].

    The acceleration-limited profile, averaged over the time that jerk needs to swing from one drive limit to the
    other, and below the launch from the first state and the stop to the last.
    """
    limits = bounds.course.limits
    total = float(profile.time[-1])
    times = np.linspace(0.0, total, max(3, int(total / _SAMPLE) + 1))
    # Speed grows to its peak before the acceleration exceeds sqrt(peak * jerk): no higher drive limit is ever felt.
    felt = math.sqrt(limits.max_jerk * math.sqrt(float(profile.speed_squared.max())))
    half = 0.5 * (min(limits.max_acceleration, felt) + min(limits.max_deceleration, felt)) / limits.max_jerk
    samples = min(times.size, int(half * (times.size - 1) / total) + 1)
    mean = _box_mean(np.interp(times, profile.time, profile.speed_squared), samples)
    x = _SHARE * np.interp(grid.time, times, mean)
    if first.v > 0.0:
        share = np.minimum(1.0, (grid.time - grid.time[0]) / _BLEND)
        x = (1.0 - share) * first.v**2 + share * x
    jerk = bounds.jerk
    since, until = grid.time - grid.time[0], grid.time[-1] - grid.time
    launch = np.maximum(first.v + since * (first.a + 0.5 * jerk * since), 0.1 * first.v + 1e-4)
    stop = last.v + until * (-last.a + 0.5 * jerk * until)
    below: FloatArray = np.minimum(x, np.minimum(launch, stop) ** 2)
    return below


def _box_mean(values: FloatArray, half: int) -> FloatArray:
    """Mean over 2 half + 1 samples, zero beyond the ends."""
    total = np.cumsum(np.concatenate((np.zeros(half + 1), values, np.zeros(half))))
    mean: FloatArray = (total[2 * half + 1 :] - total[: -2 * half - 1]) / (2 * half + 1)
    return mean
