"""Infeasible families, each with a proof of its infeasibility."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from experiments.families.motion import turn
from experiments.families.open_floor import s_curve
from experiments.families.scene import (
    AMR_FRONT,
    FINAL_STRAIGHT,
    GAP,
    Scene,
    box,
    forward,
    post,
    random_kinks,
    straight,
)

if TYPE_CHECKING:
    import numpy as np

    from experiments.families.motion import Gear

__all__ = ["approach_blocked", "gap_blocked", "start_collision", "too_close"]


def too_close(rng: np.random.Generator) -> Scene:
    """The goal is too far to the side of the start for the minimum turning radius, in a room without space for a loop.

    In this room, the robot's centre keeps 0.3 m from the walls, which leaves less than 2 R = 1.33 m across. Reaching a
    heading of 90 degrees off the goal's heading and returning needs at least 2 R, so the heading stays within 90
    degrees. Then sin(yaw) changes by at most 1 / R per metre along x, and over d metres the robot moves sideways by at
    most 2 R (1 - cos a) with 2 R sin a = d. The lateral offset of the goal is larger.
    """
    aside, turned = rng.uniform(0.45, 0.6), rng.uniform(1.15, 1.25)
    # Two turns tighter than allowed, scaled to the offset, as reference of the raw path only.
    unscaled = Scene((_tight_s(turned, 1.0),), AMR_FRONT, ()).motion.start
    gear = _tight_s(turned, abs(unscaled.y) / aside)
    middle, half = 0.5 * Scene((gear,), AMR_FRONT, ()).motion.start.y, 0.94
    walls = (
        box(-3.5, middle + half, 0.65, middle + half + 0.1),
        box(-3.5, middle - half - 0.1, 0.65, middle - half),
    )
    back = box(0.45 + GAP, middle - half, 0.65, middle + half)
    return Scene((gear,), back, random_kinks(rng, shift=0.03), walls, feasible=False, reason="goal_unreachable")


def _tight_s(angle: float, sharpness: float) -> Gear:
    curvature, rate = 2.5 * sharpness, 40.0 * sharpness**2
    return forward(turn(angle, curvature, rate), turn(-angle, curvature, rate), straight(FINAL_STRAIGHT))


def gap_blocked(rng: np.random.Generator) -> Scene:
    """The only door to the dock's chamber is narrower than the robot, whose minimum width is 0.6 m."""
    first, second = rng.uniform(1.6, 2.0), rng.uniform(1.8, 2.2)
    bend = rng.uniform(-0.2, 0.2)
    gear = forward(straight(first), turn(bend, 1.0, 5.0), straight(0.3), turn(-bend, 1.0, 5.0), straight(second))
    door, half, room = -0.45 - rng.uniform(0.8, 1.1), rng.uniform(0.22, 0.27), 1.2
    walls = (
        box(door - 0.1, half, door + 0.1, room),
        box(door - 0.1, -room, door + 0.1, -half),
        box(door - 0.1, room, 0.65, room + 0.1),
        box(door - 0.1, -room - 0.1, 0.65, -room),
    )
    back = box(0.45 + GAP, -room, 0.65, room)
    return Scene((gear,), back, random_kinks(rng, shift=0.04), walls, feasible=False, reason="clearance")


def approach_blocked(rng: np.random.Generator) -> Scene:
    """A post behind the docked robot stands in the mandatory final straight."""
    gear = s_curve(rng, 0.4, 0.8)
    blocking = post(-0.45 - rng.uniform(0.17, 0.2), rng.uniform(-0.15, 0.15), 0.08, 6, rng.uniform(0.0, 1.0))
    return Scene((gear,), AMR_FRONT, random_kinks(rng), (blocking,), feasible=False, reason="approach_blocked")


def start_collision(rng: np.random.Generator) -> Scene:
    """An obstacle overlaps the robot at the start by 5 to 15 cm."""
    gear = s_curve(rng, 0.4, 0.8)
    start = Scene((gear,), AMR_FRONT, ()).motion.start
    depth, along = rng.uniform(0.05, 0.15), rng.uniform(-0.3, 0.3)
    side = math.copysign(1.0, rng.uniform(-1.0, 1.0))
    block = box(along - 0.15, 0.3 - depth, along + 0.15, 0.7, start)
    if side < 0.0:
        block = box(along - 0.15, -0.7, along + 0.15, -0.3 + depth, start)
    return Scene((gear,), AMR_FRONT, random_kinks(rng), (block,), feasible=False, reason="start_in_collision")
