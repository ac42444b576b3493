"""Inevitable collision states [Fraichard2004]: a moving robot that comes too close to an obstacle before it can stop.

A robot in motion cannot reverse before it has stopped, and it drives at least the distance of full braking. On the
first s metres its curvature differs from that at the start by at most r s, with the largest curvature rate r. Compared
with the arc of constant curvature, its heading then differs by at most r s^2 / 2, its position by r s^3 / 6, and no
point of the robot is displaced by more than the sum of r s^3 / 6 and r s^2 / 2 times its distance from the origin (D7).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from optdock.geometry.obstacles import in_words
from optdock.timing.jerk_phases import MotionState
from optdock.timing.start_states import stopping_distance
from optdock.verification import compiled_clearances

if TYPE_CHECKING:
    from optdock.model.problem import DockingProblem

__all__ = ["inevitable_collision"]

_SPACING = 0.01  # [m] between the poses that are examined
_MARGIN = 1e-4  # [m]: more than all tolerances of the certificate


def inevitable_collision(problem: DockingProblem) -> str:
    """Return why every motion from a moving start violates the clearance, or an empty string if this is not proven.

    Args:
        problem: A problem whose start is in motion; nothing is proven about a robot at rest, or without a limit of the
            curvature rate.
    """
    limits, bend = problem.robot.limits, problem.start_curvature
    if problem.start_speed == 0.0 or bend is None or not math.isfinite(limits.max_curvature_rate):
        return ""
    gear = int(math.copysign(1.0, problem.start_speed))
    least = stopping_distance(MotionState(0.0, *problem.start_state(gear)), limits)
    if least == 0.0:
        return ""
    s = np.linspace(0.0, least, 2 + int(least / _SPACING))
    yaw = problem.start.yaw + bend * s
    along, middle = gear * s * np.sinc(bend * s / (2.0 * math.pi)), 0.5 * (problem.start.yaw + yaw)
    poses = np.column_stack((problem.start.x + along * np.cos(middle), problem.start.y + along * np.sin(middle), yaw))
    moved = limits.max_curvature_rate * s**3 / 6.0
    displaced = moved + limits.max_curvature_rate * s**2 / 2.0 * problem.robot.footprint.circumscribed_radius
    clearance, row = compiled_clearances(poses, problem.robot.footprint, problem.all_obstacles)
    from_goal = np.hypot(poses[:, 0] - problem.goal.x, poses[:, 1] - problem.goal.y)
    from_goal, from_start = (np.maximum(distance - moved, 0.0) for distance in (from_goal, np.abs(along)))
    rule, at_start = problem.path_clearance, float(clearance[0])
    relief = problem.start_run if at_start < rule.required else 0.0
    short = rule.required_at(from_goal, from_start, at_start, relief) - clearance - displaced
    worst = int(short.argmax())
    if not short[worst] > _MARGIN:
        return ""
    obstacle = in_words(problem.all_obstacles.name_of(int(row[worst])))
    return f"the robot needs {least:.3f} m to stop, and comes at least {short[worst]:.4f} m too close to {obstacle}"
