"""Families with room to move: the raw path violates bounds, the scene is not tight.

Each instance is feasible by its constructed motion: straights and turns within the limits, ending at the goal, with
every obstacle outside of the swept area.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from experiments.families.motion import Gear, Kink
from experiments.families.scene import (
    AMR,
    AMR_BACK,
    AMR_FRONT,
    GAP,
    Scene,
    amr_turn,
    box,
    forward,
    post,
    random_kinks,
    reverse,
    straight,
    swept_area,
)
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.model.path import Path
from optdock.model.robot import Robot

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray

__all__ = [
    "angled_hexagon",
    "clutter",
    "collision",
    "long_approach",
    "many_obstacles",
    "open_s",
    "pillar",
    "reverse_cusp",
]


def s_curve(rng: np.random.Generator, low: float, high: float) -> Gear:
    """Return a left turn, a right turn, by angles between `low` and `high` [rad], and a straight into the dock."""
    left, right = rng.uniform(low, high), rng.uniform(low, high)
    return forward(
        straight(rng.uniform(0.3, 0.7)),
        amr_turn(left),
        straight(rng.uniform(0.5, 1.0)),
        amr_turn(-right),
        straight(rng.uniform(0.6, 0.9)),
    )


def open_s(rng: np.random.Generator) -> Scene:
    """An S-shaped approach to a free-standing dock."""
    return Scene((s_curve(rng, 0.5, 1.0),), AMR_FRONT, random_kinks(rng))


def reverse_cusp(rng: np.random.Generator) -> Scene:
    """Forward across the front of the dock, then backward into it: one cusp."""
    gears = (
        forward(straight(rng.uniform(0.5, 0.9)), amr_turn(-rng.uniform(0.2, 0.8)), straight(rng.uniform(0.2, 0.4))),
        reverse(straight(rng.uniform(0.1, 0.3)), amr_turn(-rng.uniform(0.7, 1.1)), straight(rng.uniform(1.0, 1.3))),
    )
    return Scene(gears, AMR_BACK, random_kinks(rng, 2, 0.04))


def pillar(rng: np.random.Generator) -> Scene:
    """A pillar close to the approach, on the inner side of the last turn."""
    scene = Scene((s_curve(rng, 0.5, 0.9),), AMR_FRONT, random_kinks(rng))
    radius = rng.uniform(0.1, 0.2)
    beside = _beside(scene.motion, rng.uniform(0.45, 0.7), -(0.3 + radius + rng.uniform(0.1, 0.16)))
    return Scene(scene.gears, scene.dock, scene.kinks, (_post_at(beside, radius, rng),))


def _beside(motion: Path, share: float, offset: float) -> Pose2:
    """Return the pose `offset` [m] to the left of the motion at a share of its length."""
    return motion.pose_at(share * motion.length) @ Pose2(0.0, offset, 0.0)


def _post_at(pose: Pose2, radius: float, rng: np.random.Generator) -> FloatArray:
    return post(pose.x, pose.y, radius, 8, rng.uniform(0.0, 1.0))


def long_approach(rng: np.random.Generator) -> Scene:
    """Twelve metres with gentle bends, and four pillars along them."""
    gear = forward(
        straight(rng.uniform(2.0, 2.5)),
        amr_turn(rng.uniform(0.3, 0.6), 0.6),
        straight(rng.uniform(2.3, 2.8)),
        amr_turn(-rng.uniform(0.5, 0.9), 0.6),
        straight(rng.uniform(2.0, 2.4)),
        amr_turn(rng.uniform(0.2, 0.4), 0.6),
        straight(rng.uniform(1.4, 1.8)),
    )
    motion = Scene((gear,), AMR_FRONT, ()).motion
    sides = ((0.2, 1.0), (0.4, -1.0), (0.6, 1.0), (0.8, -1.0))
    radius = 0.15
    posts = tuple(
        _post_at(_beside(motion, share, side * (0.3 + radius + rng.uniform(0.12, 0.3))), radius, rng)
        for share, side in sides
    )
    return Scene((gear,), AMR_FRONT, random_kinks(rng, shift=0.15), posts)


def collision(rng: np.random.Generator) -> Scene:
    """A raw path straight through a pillar; the motion swerves around it."""
    angle = rng.uniform(0.85, 0.95)
    gear = forward(
        straight(rng.uniform(0.5, 0.8)),
        amr_turn(angle),
        amr_turn(-2.0 * angle),
        amr_turn(angle),
        straight(rng.uniform(0.7, 1.0)),
    )
    motion = Scene((gear,), AMR_FRONT, ()).motion
    # The swerve is symmetric: its heading in the middle is the goal's.
    before, after = gear.pieces[0].length, gear.pieces[-1].length
    top = motion.pose_at(before + 0.5 * (motion.length - before - after))
    radius = rng.uniform(0.12, 0.16)
    centre = top @ Pose2(rng.uniform(-0.05, 0.05), -(0.3 + radius + rng.uniform(0.09, 0.13)), 0.0)
    (kink,) = random_kinks(rng)
    middle = motion.pose_at(0.5 * motion.length)
    back_to_the_line = Kink(kink.angle, -(middle.y - rng.uniform(0.02, 0.06)) / max(0.5, math.cos(middle.yaw)))
    return Scene((gear,), AMR_FRONT, (back_to_the_line,), (_post_at(centre, radius, rng),))


HEXAGON = np.array([[0.5, 0.0], [0.25, 0.33], [-0.25, 0.33], [-0.5, 0.0], [-0.25, -0.33], [0.25, -0.33]])


def angled_hexagon(rng: np.random.Generator) -> Scene:
    """A six-sided robot whose front fits into a wedge between two slanted jaws; a wall along the approach."""
    jaw = HEXAGON[:2] + GAP * np.array([[1.5, 0.0], [0.8, 0.6]])  # front and side of the robot, moved away from it
    end = np.array([[0.75, jaw[1, 1]]])
    upper = np.vstack((jaw, end))
    wedge = np.vstack((upper, (upper * [1.0, -1.0])[:0:-1]))
    scene = Scene((s_curve(rng, 0.4, 0.8),), wedge, random_kinks(rng), robot=Robot(Footprint(HEXAGON), AMR.limits))
    wall = _beside(scene.motion, rng.uniform(0.35, 0.5), 0.33 + rng.uniform(0.27, 0.32))
    return Scene(scene.gears, wedge, scene.kinks, (box(-0.4, 0.0, 0.4, 0.1, wall),), scene.robot)


def _free_of(scene: Scene, polygons: list[FloatArray]) -> tuple[FloatArray, ...]:
    """Return the polygons that do not touch the grown swept area of the motion."""
    import shapely

    area = swept_area(scene.robot, scene.motion)
    return tuple(polygon for polygon in polygons if not shapely.intersects(area, shapely.Polygon(polygon)))


def many_obstacles(rng: np.random.Generator) -> Scene:
    """Thirty convex polygons around the approach, the nearest about 8 cm from the swept area."""
    scene = Scene((s_curve(rng, 0.5, 0.9),), AMR_FRONT, random_kinks(rng))
    kept: tuple[FloatArray, ...] = ()
    while len(kept) < 30:
        kept += _free_of(scene, [_random_post(scene.motion, rng, 0.45, 1.3) for _ in range(40)])
    return Scene(scene.gears, scene.dock, scene.kinks, kept[:30])


def _random_post(motion: Path, rng: np.random.Generator, near: float, far: float) -> FloatArray:
    """Return a polygon with 3 to 7 corners, between `near` and `far` [m] to either side of the motion."""
    offset = math.copysign(rng.uniform(near, far), rng.uniform(-1.0, 1.0))
    at = _beside(motion, rng.uniform(-0.05, 0.95), offset)
    return post(at.x, at.y, rng.uniform(0.06, 0.22), int(rng.uniform(3.0, 8.0)), rng.uniform(0.0, 6.0))


def clutter(rng: np.random.Generator) -> Scene:
    """Obstacles around the approach, given only as occupied 5 cm cells of a grid."""
    scene = Scene((s_curve(rng, 0.4, 0.8),), AMR_FRONT, random_kinks(rng))
    blobs = tuple(_random_post(scene.motion, rng, 0.35, 1.2) for _ in range(45))
    return Scene(scene.gears, scene.dock, scene.kinks, blobs, cell=0.05)
