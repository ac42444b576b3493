"""Given paths as candidates: a certified clothoid path is never exchanged for a costlier one, nor for none."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from optdock.geometry.clothoid import ClothoidSpline
from optdock.path import ClothoidSegment, Path

if TYPE_CHECKING:
    from optdock.problem import DockingProblem
    from smoothers._ck.terms import CostModel

__all__ = ["direct_line", "input_cost", "may_be_kept"]

_SAME_POSE = 1e-6  # [m, rad], as the certificate's
_ON_AXIS = 1e-7  # [m, rad]
_STAGING = 0.05  # [m]


def may_be_kept(path: Path, problem: DockingProblem) -> bool:
    """Whether it is a clothoid path between the right ends and within the limits; the certificate decides the rest."""
    if max(path.start.gap_to(problem.start), path.end.gap_to(problem.goal)) > _SAME_POSE:
        return False
    limits = problem.robot.limits
    for segment in path.segments:
        if not isinstance(segment, ClothoidSegment):
            return False
        curvature, knots = segment.spline.curvature, segment.knots
        rate = np.abs(np.diff(curvature) / np.diff(knots)).max()
        if np.abs(curvature).max() > limits.max_curvature or rate > limits.max_curvature_rate:
            return False
    return True


def direct_line(path: Path, problem: DockingProblem) -> Path | None:
    """The straight line to the goal, where the robot already stands on its axis and no further than needed; or None.

    From the staging pose nothing is left to optimize but the final straight, which the search takes for granted.
    """
    if len(path.segments) > 1:
        return None
    sign = int(path.segments[0].direction)
    seen = problem.goal.in_frame_of(problem.start)
    length = sign * seen.x
    off_axis = max(abs(seen.y), abs(seen.yaw)) > _ON_AXIS
    if off_axis or not 0.0 < length < problem.dock.final_straight + _STAGING:
        return None
    line = ClothoidSpline(problem.start, np.array([0.0, length]), np.zeros(2), sign)
    return Path((ClothoidSegment(line),), problem.frame)


def input_cost(path: Path, cost: CostModel, final_straight: float) -> float:
    """The cost of a clothoid path that is its own reference, without its final straight."""
    bend, jerk = cost.factors
    value = cost.weights.length * (path.length - final_straight)
    for segment in path.segments:
        knots, curvature = segment.knots, segment.curvature_at(segment.knots)
        step, a, b = np.diff(knots), curvature[:-1], curvature[1:]
        value += bend * float(np.sum(step * (a * a + a * b + b * b)) / 3.0)
        value += jerk * float(np.sum((b - a) ** 2 / step))
    return float(value)
