"""The reference itself as the motion: its jerk is nearly constant between knots.

Within a cell of the reference acceleration is linear in s, so jerk x''/2 * v changes only with the speed. Two phases
per cell reproduce the states at both knots exactly.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray
    from optdock.timing.motion import Phases

__all__ = ["cell_phases"]


def cell_phases(s: FloatArray, v: FloatArray, a: FloatArray) -> Phases:
    """Two phases of equal duration for every cell between states, Shape (n,) each, that a spline of v^2 can join.

    From the gains of speed and acceleration over a cell of duration 2 h,
    j1 = Q - P / 2 and j2 = 3 P / 2 - Q with P = da / h, Q = (dv - 2 a h) / h^2.
    The distance is then (2 v + dv) h - da h^2 / 3, which gives h.
    """
    ds, dv, da = np.diff(s), np.diff(v), np.diff(a)
    pace = v[:-1] + v[1:]
    h = 2.0 * ds / (pace + np.sqrt(np.maximum(pace * pace - 4.0 / 3.0 * da * ds, 0.0)))
    gain, curve = da / h, (dv - 2.0 * a[:-1] * h) / (h * h)
    first, second = curve - 0.5 * gain, 1.5 * gain - curve
    phases = np.stack((np.repeat(h, 2), np.stack((first, second), axis=1).ravel()), axis=1)
    return tuple((duration, jerk) for duration, jerk in phases.tolist())
