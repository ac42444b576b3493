"""Clearance of poses that were driven."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from optdock.geometry.separation import separation

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray, IntArray
    from optdock.geometry.footprint import Footprint
    from optdock.obstacles import ObstacleSet

__all__ = ["executed_clearance"]

_BLOCK = 256  # poses per round, bounds the memory


def executed_clearance(footprint: Footprint, poses: FloatArray, obstacles: ObstacleSet) -> float:
    """Smallest signed distance between the footprint at any of the poses and any obstacle [m].

    Exact at the poses; what happens between them is not looked at (a certificate's duty).

    Args:
        footprint: The robot's outline.
        poses: Shape (n, 3).
        obstacles: What it must not touch; without any the clearance is infinite.
    """
    best = np.inf
    if len(obstacles) == 0:
        return best
    for block in np.array_split(poses, max(1, -(-len(poses) // _BLOCK))):
        at_least = obstacles.box_distance(block[:, :2]) - footprint.circumscribed_radius
        nearest = np.unravel_index([int(np.argmin(at_least))], at_least.shape)
        best = min(best, _smallest(footprint, block, obstacles, nearest))
        best = min(best, _smallest(footprint, block, obstacles, np.nonzero(at_least < best)))
    return best


def _smallest(footprint: Footprint, poses: FloatArray, obstacles: ObstacleSet, pairs: tuple[IntArray, ...]) -> float:
    """Smallest distance over (pose, obstacle) pairs; infinite without pairs."""
    rows, pieces = pairs[0], obstacles.pieces(pairs[1])
    found = [separation(body, poses[rows], pieces).distance for body in footprint.bodies]
    return float(np.min(np.concatenate(found), initial=np.inf))
