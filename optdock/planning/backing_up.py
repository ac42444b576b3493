"""Guess for a robot that is too close to the dock to reach it: it stops, backs up, and approaches the dock again.

The guess consists of pieces of the running path, and is longer than necessary. Deformation shortens it and leads it to
the dock.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from optdock.geometry.clothoid import ClothoidSpline
from optdock.model.path import Path
from optdock.model.segments import ClothoidSegment

if TYPE_CHECKING:
    from optdock.geometry.pose import Pose2
    from optdock.model.limits import MotionLimits
    from optdock.model.problem import DockingProblem
    from optdock.planning.running_drive import BranchPoint

__all__ = ["backed_up", "transition_length"]

_SHORTEST = 0.021  # [m]: shorter gears are not deformed
_BEFORE_THE_END = 0.05  # [m]: distance from the end of the path beyond which the robot drives only to brake


def transition_length(before: Pose2, after: Pose2, limits: MotionLimits) -> float:
    """Return the length [m] of a curve that changes over to another straight line within the limits of curvature.

    An offset e takes 2 sqrt(e / k) with the largest curvature k and the cube root of 32 e / r with the largest
    curvature rate r; a change of heading h takes h / k and 2 sqrt(h / r).

    Args:
        before: Pose on the first line.
        after: Pose on the other line.
        limits: The limits.
    """
    gap = before.inverse() @ after
    offset, turn, most, rate = abs(gap.y), abs(gap.yaw), limits.max_curvature, limits.max_curvature_rate
    by_curvature = 2.0 * math.sqrt(offset / most) + turn / most
    return float(max(by_curvature, (32.0 * offset / rate) ** (1.0 / 3.0) + 2.0 * math.sqrt(turn / rate)))


def backed_up(joint: BranchPoint, problem: DockingProblem, least: float) -> Path | None:
    """Return a guess from the joint that backs up along the last gear of the running path.

    The result is None if the dock is so far ahead that the robot need not back up, or if there is no room.

    Args:
        joint: The joint, on the last gear of the path.
        problem: The problem from the joint.
        least: Braking distance [m].
    """
    path, needed = joint.path, transition_length(joint.path.end, problem.goal, problem.robot.limits)
    first, stop = float(path.segment_starts[-2]), joint.s
    straight = path.length - problem.dock.final_straight - _SHORTEST  # arc length at which the last curve may begin
    if straight - joint.s > needed:
        return None
    if not (joint.rests and not problem.start_curvature):
        farther = min(straight + 0.5 * needed, path.length - _BEFORE_THE_END)
        stop = min(max(joint.s + max(least, _SHORTEST), farther), path.length)
    back = max(min(stop - _SHORTEST, straight) - 0.5 * needed, first + _SHORTEST)
    last = path.segments[-1]
    is_room = back <= min(stop - _SHORTEST, straight) and not joint.s < stop < joint.s + 0.99 * _SHORTEST
    if not is_room or not isinstance(last, ClothoidSegment):
        return None
    before = path.piece(joint.s, stop).segments if stop > joint.s else ()
    backwards = _backwards(last.spline.piece(back - first, min(stop - first, last.length)))  # apart from rounding
    return Path((*before, ClothoidSegment(backwards), *path.piece(back).segments), path.frame)


def _backwards(spline: ClothoidSpline) -> ClothoidSpline:
    """Return the same curve, driven from its end to its start."""
    knots, curvature = spline.length - spline.knots[::-1], -spline.curvature[::-1]
    return ClothoidSpline(spline.end, knots, curvature, -spline.sign)
