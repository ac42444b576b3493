"""The dense check that decides: every limit along a motion, whatever proposed it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray
    from optdock.timing.course import Course
    from optdock.timing.motion import Motion

__all__ = ["Ratios", "Worst", "motion_ratios", "refined_times", "worst_ratio"]

_PERIOD = 0.008  # [s]
_FINER = 16  # times: near a limit


class Worst(NamedTuple):
    """The largest quotient of a quantity and its limit, where it occurs, and what it means for time.

    Args:
        ratio: Largest quotient.
        s: Where [m].
        path: Factor on time that keeps speeds and yaw acceleration, whose limits depend on the path.
        drive: Factor on time that keeps acceleration and jerk.
        limit: Name of the limit where the ratio is above 1; empty where it is not.
    """

    ratio: float
    s: float
    path: float
    drive: float
    limit: str = ""

    @property
    def stretch(self) -> float:
        """Factor on time that keeps every limit: speeds fall with its first power, accelerations with its second."""
        return max(self.path, self.drive)


class Ratios(NamedTuple):
    """Quotients of quantities and limits at distances `s`, Shape (n,); lateral acceleration as its root.

    `drive` is of the acceleration at the first of these distances only: it is linear between them.
    """

    s: FloatArray
    speed: FloatArray
    yaw: FloatArray
    drive: FloatArray


def motion_ratios(course: Course, motion: Motion, times: FloatArray | None = None) -> Ratios:
    """All limits at time samples, at phase borders, and at every node of the course with the rates on both its sides.

    Between nodes curvature and its rate are linear and the motion is smooth, so the maxima sit at the nodes up to the
    time sampling; time samples alone would miss narrow features. At the nodes speed and acceleration are interpolated
    between time samples, wrong by at most period^2 * jerk / 8. Jerk is the caller's: it is the phases themselves.
    """
    t = motion.sample_times(_PERIOD) if times is None else times
    s, v, a = motion.at(t)
    s = np.minimum(np.maximum.accumulate(s), course.length)
    inner = course.s[1:-1]
    first, last = np.searchsorted(inner, (s[0], s[-1]))
    nodes = inner[first:last]
    node_v, node_a = np.interp(nodes, s, v), np.interp(nodes, s, a)
    points = course.points_at(s)
    speed = np.concatenate((v * points.slowness, node_v * _node_slowness(course, first, last)))
    yaw = _yaw_ratio(course, points.curvature, points.rate, v, a)
    curvature = course.curvature[1:-1][first:last]
    left = _yaw_ratio(course, curvature, course.rate_right[:-1][first:last], node_v, node_a)
    right = _yaw_ratio(course, curvature, course.rate_left[1:][first:last], node_v, node_a)
    return Ratios(
        np.concatenate((s, nodes)), speed, np.concatenate((yaw, np.maximum(left, right))), _drive_ratio(course, a)
    )


def _node_slowness(course: Course, first: int, last: int) -> FloatArray:
    slowness = course.slowness[1:-1][first:last]
    if not course.has_zone:
        return slowness
    slow = course.s[1:-1][first:last] >= course.zone_start
    return np.where(slow, np.maximum(slowness, 1.0 / course.zone_speed), slowness)


def _yaw_ratio(course: Course, curvature: FloatArray, rate: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
    """|a k + v^2 k'| over its limit."""
    ratio: FloatArray = np.abs(a * curvature + v * v * rate) * (1.0 / course.limits.max_yaw_acceleration)
    return ratio


def _drive_ratio(course: Course, a: FloatArray) -> FloatArray:
    return np.maximum(a * (1.0 / course.limits.max_acceleration), a * (-1.0 / course.limits.max_deceleration))


def refined_times(course: Course, motion: Motion, close: float) -> FloatArray:
    """The usual times, and half a millisecond apart wherever a limit of the path is used up to `close` or more."""
    t = motion.sample_times(_PERIOD)
    ratios = motion_ratios(course, motion, t)
    near = ratios.s[np.maximum(ratios.speed, np.sqrt(ratios.yaw)) > close]
    first = np.clip(np.searchsorted(motion.at(t)[0], near) - 1, 0, t.size - 2)
    spans = np.unique(np.concatenate((first, np.minimum(first + 1, t.size - 2), np.maximum(first - 1, 0))))
    steps = np.arange(1, _FINER) / _FINER
    return np.union1d(t, (t[spans, None] + (t[spans + 1] - t[spans])[:, None] * steps).ravel())


def worst_ratio(course: Course, motion: Motion, times: FloatArray | None = None) -> Worst:
    """The worst of all limits along a motion, jerk included; at `times`, Shape (n,) [s], instead of the usual ones."""
    ratios = motion_ratios(course, motion, times)
    largest = np.maximum(ratios.speed, ratios.yaw)
    np.maximum(largest[: ratios.drive.size], ratios.drive, out=largest[: ratios.drive.size])
    worst = int(np.argmax(largest))
    steepest = int(np.argmax(np.abs(motion.jerks)))
    jerk = abs(float(motion.jerks[steepest])) / course.limits.max_jerk
    path = max(float(ratios.speed.max()), math.sqrt(float(ratios.yaw.max())))
    drive = max(math.sqrt(max(0.0, float(ratios.drive.max()))), jerk ** (1.0 / 3.0))
    if jerk > largest[worst] * (1.0 + 1e-9):
        return Worst(jerk, float(motion.states[0, steepest]), path, drive, "max_jerk" if jerk > 1.0 else "")
    limit = _limit_name(course, motion, ratios, worst) if largest[worst] > 1.0 else ""
    return Worst(float(largest[worst]), float(ratios.s[worst]), path, drive, limit)


def _limit_name(course: Course, motion: Motion, ratios: Ratios, k: int) -> str:
    """The limit of which the k-th quotients, the largest of all, use most."""
    if k < ratios.drive.size and ratios.drive[k] >= max(ratios.speed[k], ratios.yaw[k]):
        rising = float(motion.states[2].max()) / course.limits.max_acceleration >= ratios.drive[k] * (1.0 - 1e-9)
        return "max_acceleration" if rising else "max_deceleration"
    return "max_yaw_acceleration" if ratios.yaw[k] >= ratios.speed[k] else course.cap_at(float(ratios.s[k]))[0]
