"""Families with little room: about twice the required clearance on either side, and no detour.

Each instance is feasible by its constructed motion: straight next to walls, turning elsewhere.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from experiments.families.motion import turn
from experiments.families.scene import (
    AMR_BACK,
    AMR_FRONT,
    CAR,
    GAP,
    Scene,
    amr_turn,
    box,
    forward,
    random_kinks,
    reverse,
    straight,
)

if TYPE_CHECKING:
    import numpy as np

    from optdock.geometry.arrays import FloatArray

__all__ = ["alcove", "car_bay", "corridor", "narrow_gap", "parallel", "reverse_alcove", "u_dock"]

_SIDE = 0.4  # half the robot's width and 10 cm [m]


def _alcove(depth: float) -> tuple[FloatArray, FloatArray]:
    """Return walls on both sides of an alcove that holds the first `depth` [m] of the robot."""
    mouth = 0.45 - depth
    return (
        box(mouth, _SIDE, 0.65, _SIDE + 1.2),
        box(mouth, -_SIDE - 1.2, 0.65, -_SIDE),
    )


def alcove(rng: np.random.Generator) -> Scene:
    """A dock at the back of an alcove in a wall, 10 cm wider than the robot on either side."""
    gear = forward(
        straight(rng.uniform(0.6, 0.9)),
        amr_turn(rng.uniform(0.5, 0.9)),
        straight(rng.uniform(0.3, 0.7)),
        amr_turn(-rng.uniform(0.4, 0.8)),
        straight(rng.uniform(1.1, 1.3)),
    )
    return Scene((gear,), AMR_FRONT, random_kinks(rng), _alcove(rng.uniform(0.4, 0.5)))


def reverse_alcove(rng: np.random.Generator) -> Scene:
    """The alcove, entered backward."""
    gear = reverse(
        straight(rng.uniform(0.6, 0.9)),
        amr_turn(rng.uniform(0.5, 0.9)),
        straight(rng.uniform(0.3, 0.6)),
        amr_turn(-rng.uniform(0.4, 0.8)),
        straight(rng.uniform(1.1, 1.3)),
    )
    depth = rng.uniform(0.4, 0.5)
    walls = tuple(wall * [-1.0, 1.0] for wall in _alcove(depth))
    return Scene((gear,), AMR_BACK, random_kinks(rng), walls)


def u_dock(rng: np.random.Generator) -> Scene:
    """A U-shaped dock with an arm on either side of the robot, reached by a quarter turn in front of them."""
    arm = rng.uniform(0.6, 0.7)
    low, high = 0.45 - arm, 0.45 + GAP
    dock = _u_shape(low, high)
    gear = forward(
        straight(rng.uniform(0.8, 1.2)),
        amr_turn(rng.uniform(1.2, 1.5), 1.3),
        straight(rng.uniform(1.15, 1.3)),
    )
    return Scene((gear,), dock, random_kinks(rng))


def _u_shape(low: float, high: float) -> FloatArray:
    import numpy as np

    outer, back = _SIDE + 0.06, high + 0.1
    return np.array(
        [
            [low, _SIDE],
            [high, _SIDE],
            [high, -_SIDE],
            [low, -_SIDE],
            [low, -outer],
            [back, -outer],
            [back, outer],
            [low, outer],
        ]
    )


def corridor(rng: np.random.Generator) -> Scene:
    """Along a corridor, then a quarter turn into a bay in its side."""
    gear = forward(straight(rng.uniform(1.6, 2.2)), amr_turn(-math.pi / 2.0, 1.3), straight(rng.uniform(0.95, 1.1)))
    motion = Scene((gear,), AMR_FRONT, ()).motion
    lane = motion.start.x  # the motion drives along x = lane, towards +y
    near, far = lane + 0.3 + rng.uniform(0.13, 0.18), lane - 0.3 - rng.uniform(0.32, 0.4)
    bay = rng.uniform(0.55, 0.6)
    walls = (
        box(far - 0.2, motion.start.y - 1.0, far, 1.6),
        box(near, motion.start.y - 1.0, 0.65, -bay),
        box(near, bay + 0.1, 0.65, 1.6),
    )
    return Scene((gear,), AMR_FRONT, random_kinks(rng), walls)


def narrow_gap(rng: np.random.Generator) -> Scene:
    """A wall with a gap 10 cm wider than the robot on either side, between two turns."""
    first, within = rng.uniform(0.6, 0.9), rng.uniform(1.5, 1.7)
    pieces = (
        straight(first),
        amr_turn(rng.uniform(0.3, 0.7)),
        straight(within),
        amr_turn(-rng.uniform(0.4, 0.8)),
        straight(rng.uniform(0.7, 0.9)),
    )
    gear = forward(*pieces)
    at = sum(piece.length for group in pieces[:2] for piece in group) + 0.5 * within
    gate = Scene((gear,), AMR_FRONT, ()).motion.pose_at(at)
    thick = rng.uniform(0.05, 0.15)
    walls = (box(-thick, _SIDE, thick, _SIDE + 1.5, gate), box(-thick, -_SIDE - 1.5, thick, -_SIDE, gate))
    return Scene((gear,), AMR_FRONT, random_kinks(rng, shift=0.03), walls)


def parallel(rng: np.random.Generator) -> Scene:
    """Parallel parking between two boxes: forward, back, forward."""
    last = rng.uniform(1.08, 1.15)
    swing = rng.uniform(0.85, 0.95)
    gears = (
        forward(straight(rng.uniform(0.8, 1.1))),
        reverse(straight(0.1), amr_turn(swing, 1.4), amr_turn(-swing, 1.4), straight(0.05)),
        forward(straight(last)),
    )
    rear = -last - 0.45 - rng.uniform(0.12, 0.16)
    kerb = -0.3 - rng.uniform(0.18, 0.22)
    obstacles = (box(rear - 0.9, -0.3, rear, 0.3), box(rear - 0.9, kerb - 0.1, 0.75, kerb))
    return Scene(gears, AMR_FRONT, random_kinks(rng, 3, 0.03), obstacles)


def car_bay(rng: np.random.Generator) -> Scene:
    """A car that parks backward between two cars: forward along the lane, one cusp, a quarter turn into the bay."""
    gears = (
        forward(straight(rng.uniform(4.0, 6.0))),
        reverse(straight(rng.uniform(0.3, 0.8)), turn(-math.pi / 2.0, 0.18, 0.3), straight(rng.uniform(3.6, 4.0))),
    )
    side = 1.0 + rng.uniform(0.4, 0.5)
    neighbours = (box(-0.9, side, 3.4, side + 1.8), box(-0.9, -side - 1.8, 3.4, -side))
    wall = box(-1.4, -1.0, -0.9 - GAP, 1.0)
    return Scene(gears, wall, random_kinks(rng, 2, 0.15), neighbours, CAR, spacing=0.1)
