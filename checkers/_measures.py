"""Measures of goal checkers, computed as in Nav2, so that the results agree with Nav2 up to rounding."""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable

    from optdock.geometry.pose import Pose2, Twist2

__all__ = ["is_stopped", "longer_than", "yaw_error"]


def yaw_error(query: Pose2, goal: Pose2, *, symmetric: bool = False) -> float:
    """Return the angle between two headings [rad]; if `symmetric`, to the goal heading or its opposite."""
    return abs(math.remainder(query.yaw - goal.yaw, math.pi if symmetric else 2.0 * math.pi))


def is_stopped(velocity: Twist2, trans_stopped_velocity: float, rot_stopped_velocity: float) -> bool:
    """Whether the speed [m/s], including the lateral speed, and the yaw rate [rad/s] are at most the given limits."""
    slow = math.hypot(velocity.linear, velocity.lateral) <= trans_stopped_velocity
    return slow and abs(velocity.angular) <= rot_stopped_velocity


def longer_than(path: Iterable[Pose2], limit: float) -> bool:
    """Whether a path is longer than `limit` [m], summed in driving order as in Nav2. 0 or 1 poses have length 0."""
    total = 0.0
    for before, after in itertools.pairwise(path):
        total += math.hypot(after.x - before.x, after.y - before.y)
        if total > limit:
            return True
    return False
