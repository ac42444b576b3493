"""The columns of a sampled motion, and by how much their numbers may differ from what they stand for."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray

__all__ = ["EXACT", "Rounding", "SampledMotion", "half_unit"]

EXACT = 1e-6  # [m], [rad], ...: numbers with more decimals than five are taken to this


class SampledMotion(NamedTuple):
    """A timed motion in columns of Shape (n,), n >= 2, SI units, finite; t increases.

    Speed, acceleration and jerk are negative in reverse.
    """

    t: FloatArray
    x: FloatArray
    y: FloatArray
    yaw: FloatArray
    speed: FloatArray
    acceleration: FloatArray
    jerk: FloatArray
    yaw_rate: FloatArray
    yaw_acceleration: FloatArray


class Rounding(NamedTuple):
    """By how much a number of each kind may differ from what it stands for."""

    place: float
    yaw: float
    speed: float
    acceleration: float
    jerk: float
    yaw_rate: float
    yaw_acceleration: float
    time: float

    @classmethod
    def of(cls, motion: SampledMotion) -> Rounding:
        """Half a unit of the last decimal of each kind of column; times on an even grid are exact."""
        steps = np.diff(motion.t)
        even = bool(np.ptp(steps) <= 1e-9 * steps[0])
        resolution = float(np.spacing(np.max(np.abs(motion.t))))
        return cls(
            place=half_unit(motion.x, motion.y),
            yaw=half_unit(motion.yaw),
            speed=half_unit(motion.speed),
            acceleration=half_unit(motion.acceleration),
            jerk=half_unit(motion.jerk),
            yaw_rate=half_unit(motion.yaw_rate),
            yaw_acceleration=half_unit(motion.yaw_acceleration),
            time=resolution if even else max(resolution, half_unit(motion.t, most=0.0)),
        )


def half_unit(*columns: FloatArray, most: float = EXACT) -> float:
    """Half a unit of the last decimal of these numbers, if they have three to five decimals; `most` otherwise."""
    for decimals in (3, 4, 5):
        if all(np.array_equal(np.round(column, decimals), column) for column in columns):
            return 0.5 * 10.0**-decimals
    return most
