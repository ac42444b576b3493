"""Errors as Nav2's checkers measure them: directly, so that one rounding step past a tolerance is outside."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from optdock.geometry.pose import Pose2, Twist2

__all__ = ["is_stopped", "yaw_error"]


def yaw_error(query: Pose2, goal: Pose2, *, symmetric: bool = False) -> float:
    """Smallest angle between the two headings [rad]; with `symmetric`, to the goal heading or its opposite."""
    return abs(math.remainder(query.yaw - goal.yaw, math.pi if symmetric else 2.0 * math.pi))


def is_stopped(velocity: Twist2, trans_stopped_velocity: float, rot_stopped_velocity: float) -> bool:
    """Whether speed [m/s], sideways included, and yaw rate [rad/s] are at most the given ones."""
    slow = math.hypot(velocity.linear, velocity.lateral) <= trans_stopped_velocity
    return slow and abs(velocity.angular) <= rot_stopped_velocity
