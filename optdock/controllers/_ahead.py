"""The collision check of a controller: the stretch that the robot cannot help driving any more."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from optdock.errors import NoValidControl
from optdock.surroundings import obstacles_near
from optdock.verification import pose_clearances

if TYPE_CHECKING:
    from optdock.geometry.pose import Pose2, Twist2
    from optdock.lifecycle import PluginContext
    from optdock.limits import MotionLimits

__all__ = ["require_free_stop"]

_SPACING = 0.05  # [m] between the poses that are looked at; no robot is so short that a post fits between them
_DEEPER = 1e-6  # [m]: a robot that touches something may drive on as long as it does not go deeper


def require_free_stop(
    context: PluginContext, pose: Pose2, command: Twist2, limits: MotionLimits, period: float, tolerance: float
) -> None:
    """Refuse a command after which the robot could no longer stop before it is `tolerance` deep in something.

    One period of the command, then braking along its arc: the poses on that way are looked at, with the whole
    footprint, among everything that the context holds, its costmaps as they are now. A plan that ends in contact with
    the dock brakes no harder than this, so noise and control errors up to the tolerance do not stop it.

    Args:
        context: Surroundings; without a footprint nothing is checked.
        pose: Measured.
        command: To be given now.
        limits: How hard the robot can brake.
        period: Until the next command [s].
        tolerance: Accepted depth [m].

    Raises:
        NoValidControl: As described; `where` holds the obstacle and the depth.
    """
    if context.footprint is None:
        return
    speed = abs(command.linear)
    time = period + 0.5 * speed / limits.max_deceleration  # braking covers half of what the command would
    centre, reach = np.array([pose.x, pose.y]), context.footprint.circumscribed_radius + speed * time
    obstacles = obstacles_near(context, centre - reach, centre + reach)
    if len(obstacles) == 0:
        return
    times = np.linspace(0.0, time, 2 + math.ceil(speed * time / _SPACING))
    poses = np.array([pose.moved(command, float(t)).as_array() for t in times])
    clearance, row = pose_clearances(poses, context.footprint, obstacles, within=0.0)
    worst = int(np.argmin(clearance))
    if clearance[worst] < min(-tolerance, clearance[0] - _DEEPER):
        depth, obstacle = -float(clearance[worst]), obstacles.name_of(int(row[worst]))
        raise NoValidControl(
            f"{context.name}: collision ahead: even braking now, the footprint goes {depth:.3f} m into {obstacle}, "
            f"more than collision_tolerance = {tolerance} m",
            where={"obstacle": obstacle, "depth": depth},
        )
