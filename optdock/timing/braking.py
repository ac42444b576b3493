"""Full braking: the motion that no other can undercut, and how close it comes to the limits.

Among all controls from a start state full braking (jerk -J to -D, hold, +J to rest) gives the smallest speed at every
distance: compare da/ds = j / v. So the speed caps can be kept if and only if the full-braking curve stays below them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from optdock.timing.motion import Motion, State
from optdock.timing.moves import Box, full_stop

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray
    from optdock.timing.course import Course

__all__ = ["Braking", "stop_box"]

_PERIOD = 0.004  # [s]
_TIGHT_YAW = 0.95  # of the yaw acceleration: a start beyond it is planned without margins until it is below


def stop_box(course: Course) -> Box:
    """The drive's own bounds."""
    limits = course.limits
    return Box(course.drive.max_speed, limits.max_acceleration, limits.max_deceleration, limits.max_jerk)


class Braking:
    """Full braking from a start state on a course.

    Args:
        course: The gear.
        start: Moving forward, or at rest with acceleration > 0.

    Attributes:
        motion: The braking motion; it may end beyond the course.
        times: Where it is looked at: phase borders, a grid, every node of the course, Shape (n,) [s].
        states: Distance, speed, acceleration there, Shape (3, n).
        path_ratios: Quotients with limits of the path that no motion from this start keeps better, Shape (n,): the
            speed caps; the speed beyond which no acceleration keeps the yaw acceleration,
            v^2 = (al + |k| * (D if k k' > 0 else A)) / |k'|; the yaw acceleration at the start itself.
        drive_ratios: Quotients of the acceleration, which full braking leads into its limits as fast as it can.
    """

    def __init__(self, course: Course, start: State) -> None:
        self.motion = Motion.of(start, full_stop(start, stop_box(course)))
        inside = course.s[(course.s > 0.0) & (course.s < self.motion.end.s)]
        grid = self.motion.sample_times(_PERIOD)
        self.times = np.union1d(grid, self.motion.crossing_times(inside)) if inside.size else grid
        self.states = self.motion.at(self.times)
        s, v, a = self.states
        limits, points = course.limits, course.points_at(np.clip(s, 0.0, course.length))
        self._yaw = np.abs(a * points.curvature + v * v * points.rate) * (1.0 / limits.max_yaw_acceleration)
        relief = np.where(points.curvature * points.rate > 0.0, limits.max_deceleration, limits.max_acceleration)
        spare = limits.max_yaw_acceleration + np.abs(points.curvature) * relief
        self._course, self._cap_ratios = course, v * points.slowness
        self.path_ratios = np.maximum(self._cap_ratios, v * np.sqrt(np.abs(points.rate) / spare))
        self.path_ratios[0] = max(self.path_ratios[0], self._yaw[0])
        self.drive_ratios = np.maximum(a / limits.max_acceleration, -a / limits.max_deceleration)

    def broken_limit(self, k: int) -> tuple[str, str]:
        """The limit that decides at the k-th of `times`: its name, and in words by how much and where it is broken."""
        s, v, a = (float(value) for value in self.states[:, k])
        ratio, limits = float(self.ratios[k]), self._course.limits
        place = f"at s = {self._course.begin + s:.4f} m is {ratio:.4g} times"
        if self.drive_ratios[k] > self.path_ratios[k]:
            name = "max_acceleration" if a > 0.0 else "max_deceleration"
            return name, f"acceleration {a:.4g} m/s^2 {place} {name} = {getattr(limits, name):.4g} m/s^2"
        name, words = "max_yaw_acceleration", f"max_yaw_acceleration = {limits.max_yaw_acceleration:.4g} rad/s^2"
        if k == 0 and self._yaw[0] >= ratio:
            return name, f"yaw acceleration {self._yaw[0] * limits.max_yaw_acceleration:.4g} rad/s^2 {place} {words}"
        if self._cap_ratios[k] >= ratio:
            name, words = self._course.cap_at(min(max(s, 0.0), self._course.length))
        return name, f"speed {v:.4g} m/s {place} what {words} allows"

    @property
    def ratios(self) -> FloatArray:
        """The larger of both quotients, Shape (n,)."""
        larger: FloatArray = np.maximum(self.path_ratios, self.drive_ratios)
        return larger

    def tight_length(self, slack: float) -> float:
        """How far from the start braking is within `slack`, relative, of the limits: no room for margins there [m]."""
        tight = np.flatnonzero(self.path_ratios > 1.0 - slack)
        turning = np.flatnonzero(self._yaw <= _TIGHT_YAW)
        last = max(int(tight[-1]) + 1 if tight.size else 0, int(turning[0]) if turning.size else self.times.size)
        return float(self.states[0, min(last, self.times.size - 1)])
