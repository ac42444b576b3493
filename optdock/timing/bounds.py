"""The limits that the near-optimal method plans with: the course's own, less margins that keep the check satisfied."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.geometry.arrays import readonly

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray, IntArray
    from optdock.timing.course import Course

__all__ = ["Bounds", "Margins", "Tightening"]


_JUMP_SHARE = 0.004  # of the yaw acceleration: smaller jumps of v^2 * rate are left to the margins


class Margins(NamedTuple):
    """Shares of the limits that the planner leaves unused.

    Args:
        reference_speed: Of the speed caps, in the reference; room for the corners that ruckig cuts.
        reference_yaw: Of the yaw acceleration, in the reference.
        reference_jerk: Of the jerk, in the reference.
        reference_drive: Of acceleration and deceleration, in the reference: ruckig refuses a state beyond them.
        check: Of the speed caps, when pieces are accepted; twice that of the yaw acceleration.
    """

    reference_speed: float = 0.003
    reference_yaw: float = 0.02
    reference_jerk: float = 0.015
    reference_drive: float = 0.003
    check: float = 0.001


class Tightening(NamedTuple):
    """A stretch [m] in which speeds are to be smaller by `factor` than the limits allow."""

    left: float
    right: float
    factor: float


@dataclass(frozen=True, eq=False)
class Bounds:
    """Per cell of a course: what the reference may use, and what pieces are checked against.

    Args:
        course: The gear.
        margins: Shares of the limits left unused.
        relief: Up to this distance no margin is taken: full braking from a moving start leaves none [m].
        tightenings: Stretches to take slower.

    Attributes:
        speed_squared: Bound on v^2 in each cell, for the reference, Shape (n - 1,) [m^2/s^2].
        yaw: Bound on the yaw acceleration in each cell, for the reference, Shape (n - 1,) [rad/s^2].
        cap_squared: v^2 at which a cell meets its speed caps, no margin, Shape (n - 1,) [m^2/s^2].
        jumps: Indices of the inner nodes where the curvature rate jumps by so much that it matters.
    """

    course: Course
    margins: Margins = field(default_factory=Margins)
    relief: float = 0.0
    tightenings: tuple[Tightening, ...] = ()
    speed_squared: FloatArray = field(init=False, repr=False)
    yaw: FloatArray = field(init=False, repr=False)
    cap_squared: FloatArray = field(init=False, repr=False)
    jumps: IntArray = field(init=False, repr=False)
    _left: FloatArray = field(init=False, repr=False)
    _slope: FloatArray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        course, margins = self.course, self.margins
        left, right = course.slowness[:-1], course.slowness[1:]
        if course.has_zone:
            slow = np.where(course.s[:-1] >= course.zone_start, 1.0 / course.zone_speed, 0.0)
            left, right = np.maximum(left, slow), np.maximum(right, slow)
        table = np.stack((course.curvature[:-1], course.rate_left, left))
        ends = np.stack((course.curvature[1:], course.rate_right, right))
        relieved = course.s[:-1] < self.relief
        factor = self._factors()
        cap = np.maximum(left, right) ** -2.0
        speed = (factor * np.where(relieved, 1.0 - 1e-4, 1.0 - margins.reference_speed)) ** 2
        yaw = factor**2 * np.where(relieved, 1.0 - 1e-3, 1.0 - margins.reference_yaw)
        jump = np.abs(course.rate_left[1:] - course.rate_right[:-1]) * np.minimum(cap[1:], cap[:-1])
        jumps = np.flatnonzero(jump > _JUMP_SHARE * course.limits.max_yaw_acceleration) + 1
        object.__setattr__(self, "jumps", jumps)
        for name, value in (
            ("cap_squared", cap),
            ("speed_squared", cap * speed),
            ("yaw", np.minimum(course.limits.max_yaw_acceleration, 1e12) * yaw),
            ("_left", table),
            ("_slope", (ends - table) / np.diff(course.s)),
        ):
            object.__setattr__(self, name, readonly(value))

    def _factors(self) -> FloatArray:
        s = self.course.s
        factor: FloatArray = np.ones(s.size - 1)
        for stretch in self.tightenings:
            inside = (s[1:] > stretch.left) & (s[:-1] < stretch.right)
            factor = np.where(inside, np.minimum(factor, stretch.factor), factor)
        return factor

    @property
    def jerk(self) -> float:
        """Bound on the jerk in the reference [m/s^3]."""
        return self.course.limits.max_jerk * (1.0 - self.margins.reference_jerk)

    def curve_at(self, s: FloatArray) -> FloatArray:
        """Curvature, its rate, and slowness, linear in each cell. Shape (3, n)."""
        cell = self.course.cells_at(s)
        values: FloatArray = self._left[:, cell] + self._slope[:, cell] * (s - self.course.s[cell])
        return values

    def excess_at(self, s: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
        """By how much time would have to be stretched there for the checked limits to hold; > 1 is too fast.

        Shape (n,). Speeds scale with 1 / c, accelerations with 1 / c^2.
        """
        curvature, rate, slowness = self.curve_at(s)
        yaw = np.abs(a * curvature + v * v * rate) * (1.0 / self.course.limits.max_yaw_acceleration)
        return self._checked(s, np.maximum(v * slowness, np.sqrt(yaw)))

    def jump_excess_at(self, nodes: IntArray, v: FloatArray, a: FloatArray) -> FloatArray:
        """As `excess_at`, at `nodes`, of the yaw acceleration with the rates on both their sides. Shape (n,)."""
        course = self.course
        turn, square = a * course.curvature[nodes], v * v
        left, right = course.rate_right[nodes - 1], course.rate_left[nodes]
        yaw = np.maximum(np.abs(turn + square * left), np.abs(turn + square * right))
        return self._checked(course.s[nodes], np.sqrt(yaw * (1.0 / course.limits.max_yaw_acceleration)))

    def _checked(self, s: FloatArray, excess: FloatArray) -> FloatArray:
        share = 1.0 / (1.0 - self.margins.check)
        return excess * (np.where(s < self.relief, 1.0, share) if self.relief > 0.0 else share)
