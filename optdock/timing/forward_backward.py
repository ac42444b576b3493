"""Forward-backward pass: the fastest speed profile within acceleration limits, without a jerk limit."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.timing.jerk_phases import MotionState

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray
    from optdock.timing.path_limits import ReferenceBounds

__all__ = ["SLOWEST", "SpeedProfile", "forward_backward_pass"]

SLOWEST = 1e-4  # [m/s]: least mean speed of a cell in the pseudo time, because the speed at the ends is zero


class SpeedProfile(NamedTuple):
    """Acceleration-limited speeds at the nodes of the limits: v^2 [m^2/s^2] and pseudo time [s], Shape (n,)."""

    speed_squared: FloatArray
    time: FloatArray


def forward_backward_pass(bounds: ReferenceBounds, start: MotionState) -> SpeedProfile:
    """Return the largest v^2 under caps and acceleration limits; turning limits are applied as speed caps at a = 0.

    The time-optimal v^2 is the largest function below the maximum velocity curve whose slope 2 a is between -2 D and
    2 A. This function is computed by one sweep forward and one sweep backward [Bobrow1985].
    """
    limits, drive, cell = bounds.limits, bounds.limits.drive, bounds.ceiling
    x = np.minimum(np.concatenate((cell, [0.0])), np.concatenate(([start.v * start.v], cell)))
    rise, fall = 2.0 * drive.max_acceleration * limits.s, 2.0 * drive.max_deceleration * limits.s
    x = np.minimum.accumulate(x - rise) + rise
    x = (np.minimum.accumulate((x + fall)[::-1]))[::-1] - fall
    x = np.maximum(x, 0.0)
    v = np.sqrt(x)
    gain = 2.0 * (limits.s[1:] - limits.s[:-1]) / np.maximum(v[:-1] + v[1:], SLOWEST)
    return SpeedProfile(x, np.concatenate(([0.0], gain.cumsum())))
