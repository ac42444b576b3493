"""Short drives with known time laws, for tests and benchmarks of controllers."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from optdock.errors import InvalidValue
from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.pose import Pose2
from optdock.model.constant_jerk import TimeLaw
from optdock.model.path import ClothoidSegment, Direction, Path
from optdock.model.trajectory import Trajectory

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["clothoid", "cusp_drive", "rest_to_rest", "s_curve_drive", "straight_drive"]


def clothoid(
    start: Pose2, knots: Sequence[float], curvature: Sequence[float], direction: Direction = Direction.FORWARD
) -> ClothoidSegment:
    """Return a segment from knots [m] and curvatures [1/m]."""
    return ClothoidSegment(ClothoidSpline(start, np.array(knots), np.array(curvature), int(direction)))


def rest_to_rest(
    segments: Sequence[ClothoidSegment], *, speed: float = 0.4, acceleration: float = 0.4, jerk: float = 2.0
) -> Trajectory:
    """Return a motion of seven constant-jerk phases per segment: accelerate to `speed` [m/s], cruise, brake to rest.

    Raises:
        InvalidValue: If a segment is too short for the speed, or the speed is too small for the acceleration.
    """
    ramp = acceleration / jerk
    hold = speed / acceleration - ramp
    durations: list[float] = []
    for segment in segments:
        cruise = segment.length / speed - (hold + 2.0 * ramp)
        if hold <= 0.0 or cruise <= 0.0:
            raise InvalidValue(f"drive: {segment.length} m is too short for {speed} m/s at {acceleration} m/s^2")
        durations += [ramp, hold, ramp, cruise, ramp, hold, ramp]
    jerks = np.tile([jerk, 0.0, -jerk, 0.0, -jerk, 0.0, jerk], len(segments))
    return Trajectory(Path(tuple(segments)), TimeLaw(np.array(durations), jerks))


def straight_drive(start: Pose2, direction: Direction = Direction.FORWARD, length: float = 2.0) -> Trajectory:
    """Return a motion along a straight line of `length` [m]."""
    return rest_to_rest([clothoid(start, [0.0, length], [0.0, 0.0], direction)])


def s_curve_drive(start: Pose2, direction: Direction = Direction.FORWARD) -> Trajectory:
    """Return a left and a right turn of 34 degrees with a smallest radius of 0.83 m, and half a metre straight."""
    return rest_to_rest([clothoid(start, [0.0, 0.5, 1.0, 1.5, 2.0, 2.5], [0.0, 1.2, 0.0, -1.2, 0.0, 0.0], direction)])


def cusp_drive(start: Pose2) -> Trajectory:
    """Return a motion forward through a left turn, then in reverse through a right turn and straight."""
    first = clothoid(start, [0.0, 0.6, 1.2], [0.0, 1.0, 0.0])
    second = clothoid(first.spline.end, [0.0, 0.6, 1.2, 2.0], [0.0, -1.0, 0.0, 0.0], Direction.REVERSE)
    return rest_to_rest([first, second])
