"""Clearances of poses as in `proximity`, but in C where kernels are used.

Proofs of impossibility use `proximity` itself, because they depend on no compiled code of optdock.
"""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.geometry.arrays import readonly
from optdock.geometry.separation import skips_edges
from optdock.kernels import Kernel, twin_of
from optdock.verification.certificate import Memo
from optdock.verification.proximity import bounded_footprint, lower_where_deep, of_pieces

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray, IntArray
    from optdock.geometry.footprint import Footprint
    from optdock.geometry.obstacles import ObstacleSet
    from optdock.model.problem import DockingProblem

__all__ = ["EndClearances", "PackedFootprint", "compiled_clearances", "end_clearances", "packed_footprint"]


class PackedFootprint(NamedTuple):
    """The convex pieces of a footprint in the form for kernels.

    `sizes`: numbers of corners and circles of each, Shape (k, 2). `numbers`: radius, reach, vertices, normals, offsets
    and centres of each, one after the other. `corners`, `circles`: the largest numbers.
    """

    sizes: IntArray
    numbers: FloatArray
    corners: int
    circles: int


@functools.lru_cache(maxsize=64)
def packed_footprint(footprint: Footprint) -> PackedFootprint:
    """Return `bounded_footprint` in the form for kernels, cached."""
    bodies = bounded_footprint(footprint)
    sizes = np.array([(len(one.body.vertices), len(one.centres)) for one in bodies])
    parts = [((one.radius, one.reach), *one.body, one.centres) for one in bodies]
    numbers = np.concatenate([np.ravel(part) for body in parts for part in body])
    return PackedFootprint(readonly(sizes), readonly(numbers), int(sizes[:, 0].max()), int(sizes[:, 1].max()))


def compiled_clearances(
    poses: FloatArray, footprint: Footprint, obstacles: ObstacleSet, within: float = np.inf
) -> tuple[FloatArray, IntArray]:
    """Return the result of `proximity.pose_clearances`, Shape (n,) [m] and (n,)."""
    m, corners, _ = obstacles.vertices.shape
    by_numpy = m == 0 or poses.size == 0 or skips_edges(packed_footprint(footprint).corners, corners)
    best, row = (of_pieces if by_numpy else _of_pieces_chosen)(poses, footprint, obstacles, within)
    lower_where_deep(best, poses, footprint, obstacles)
    return best, row


_KERNEL = Kernel("optdock_clearances", sizes=6, numbers=0)


def _of_pieces_native(
    poses: FloatArray, footprint: Footprint, obstacles: ObstacleSet, within: float
) -> tuple[FloatArray, IntArray]:
    """Return the result of `of_pieces`, computed in C; its arrays are described there."""
    robot, n, (m, q, _) = packed_footprint(footprint), poses.shape[0], obstacles.vertices.shape
    best, row, turned = np.full(n, float(within)), np.empty(n, dtype=np.int64), np.empty((n, 2))
    turned[:, 0], turned[:, 1] = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    arrays = (
        (robot.sizes, robot.sizes.size),
        (robot.numbers, robot.numbers.size),
        (np.ascontiguousarray(poses), 3 * n),
        (turned, 2 * n),
        (obstacles.vertices, 2 * m * q),
        (obstacles.normals, 2 * m * q),
        (obstacles.offsets, m * q),
        (obstacles.lower, 2 * m),
        (obstacles.upper, 2 * m),
        (best, n),
        (row, n),
        (np.empty(size := m + 2 * (robot.corners + q + robot.circles)), size),
    )
    _KERNEL((n, m, robot.sizes.shape[0], q, robot.corners, robot.circles), (), arrays)
    return best, row


@twin_of(_of_pieces_native)
def _of_pieces_chosen(
    poses: FloatArray, footprint: Footprint, obstacles: ObstacleSet, within: float
) -> tuple[FloatArray, IntArray]:
    return of_pieces(poses, footprint, obstacles, within)


class EndClearances(NamedTuple):
    """Signed clearances of the start and the goal of a problem [m], and the rows of the obstacles nearest to them."""

    start: float
    nearest_to_start: int
    goal: float
    nearest_to_goal: int


def end_clearances(problem: DockingProblem) -> EndClearances:
    """Return the clearances of the start and the goal, cached with the problem; inf and -1 without obstacles."""
    known = _ENDS.recall(problem)
    if known is None:
        ends = np.stack((problem.start.as_array(), problem.goal.as_array()))
        distance, row = compiled_clearances(ends, problem.robot.footprint, problem.all_obstacles)
        known = EndClearances(float(distance[0]), int(row[0]), float(distance[1]), int(row[1]))
        _ENDS.keep(problem, known)
    return known


_ENDS: Memo[DockingProblem, EndClearances] = Memo()
