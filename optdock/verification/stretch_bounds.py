"""Lower bounds of the clearance over stretches of motion: second-order conservative advancement [Mirtich1996].

The axis that attains the exact distance at a pose gives a lower bound of the distance along the motion near this pose
(equation C5 of docs/theory/certificate.md). Distant obstacles are excluded by a broad phase.
"""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.deadline import never_late
from optdock.geometry.separation import separation, skips_edges
from optdock.kernels import Kernel, twin_of
from optdock.verification.proximity import broad_phase

if TYPE_CHECKING:
    from collections.abc import Callable

    from optdock.geometry.arrays import FloatArray, IntArray
    from optdock.geometry.obstacles import ObstacleSet
    from optdock.geometry.separation import ConvexBody
    from optdock.verification.proximity import BoundedBody

__all__ = ["AdvanceBounds", "Advances", "advance_bounds", "most_at_once"]

_MAX_PAIRS = 200_000  # of an advance and an obstacle evaluated at once; bounds memory and time
_MAX_CORNERS = 50_000  # of body and obstacle times advances evaluated at once; bounds memory and time


class Advances(NamedTuple):
    """Stretches of motion from known poses: n stretches from k poses, because neighbouring stretches share poses.

    `poses`: Shape (k, 3). `pose`: initial pose of each stretch, Shape (n,). `velocity`: d pose / du at this pose, in
    the direction of the stretch, Shape (n, 3). The others have Shape (n,): `width` in u, and bounds within the cell:
    `speed` of |p'|, `turn` of |yaw'|, `bend` of |p''|, `twist` of |yaw''| + yaw'^2.
    """

    poses: FloatArray
    pose: IntArray
    velocity: FloatArray
    width: FloatArray
    speed: FloatArray
    turn: FloatArray
    bend: FloatArray
    twist: FloatArray

    def rows(self, keep: slice) -> tuple[Advances, IntArray]:
        """Return the stretches selected by `keep`, and the rows of their poses."""
        used, pose = np.unique(self.pose[keep], return_inverse=True)
        return Advances(self.poses[used], pose, *(column[keep] for column in self[2:])), used


class AdvanceBounds(NamedTuple):
    """Lower bound [m] and nearest obstacle row of every stretch, Shape (n,), and the exactly evaluated pairs.

    `pose`, `obstacle`, `distance`: pose index, obstacle row, signed distance [m], Shape (m,) each.
    """

    bound: FloatArray
    row: IntArray
    pose: IntArray
    obstacle: IntArray
    distance: FloatArray

    def merged(self, other: AdvanceBounds) -> AdvanceBounds:
        """Return the smaller of the two bounds, and both lists of pairs."""
        mine = self.bound <= other.bound
        return AdvanceBounds(
            np.where(mine, self.bound, other.bound),
            np.where(mine, self.row, other.row),
            np.concatenate((self.pose, other.pose)),
            np.concatenate((self.obstacle, other.obstacle)),
            np.concatenate((self.distance, other.distance)),
        )


def advance_bounds(
    bodies: tuple[BoundedBody, ...],
    advances: Advances,
    obstacles: ObstacleSet,
    exact_within: FloatArray,
    is_late: Callable[[], bool] = never_late,
) -> AdvanceBounds:
    """Compute lower bounds of the clearance over stretches of motion by equation (C5).

    Args:
        bodies: At least one convex body; all bodies move together.
        advances: The stretches.
        obstacles: At least one.
        exact_within: Shape (n,) [m]: the narrow phase evaluates pairs that may come closer than this; the broad phase
            bounds the others.
        is_late: Polled between blocks of a few milliseconds. Once it is True, the remaining bounds are -inf.
    """
    n, block = advances.width.size, most_at_once(bodies, len(obstacles), obstacles.vertices.shape[1])
    if n <= block:
        parts: list[AdvanceBounds] = []
        for body in bodies:
            if parts and is_late():
                return functools.reduce(AdvanceBounds.merged, [*parts, _nothing_known(n)])
            parts.append(_body_bounds(body, advances, obstacles, exact_within))
        return functools.reduce(AdvanceBounds.merged, parts)
    blocks: list[AdvanceBounds] = []
    for rows in (slice(start, start + block) for start in range(0, n, block)):
        if blocks and is_late():
            blocks.append(_nothing_known(n - rows.start))
            break
        some, used = advances.rows(rows)
        found = advance_bounds(bodies, some, obstacles, exact_within[rows], is_late)
        blocks.append(found._replace(pose=used[found.pose]))
    return AdvanceBounds(*(np.concatenate(columns) for columns in zip(*blocks, strict=True)))


def most_at_once(bodies: tuple[BoundedBody, ...], obstacles: int, corners: int) -> int:
    """Return the number of stretches that are evaluated at once among >= 1 obstacles with so many corners each."""
    corners += max(len(one.body.vertices) for one in bodies)
    return max(1, min(_MAX_PAIRS // obstacles, _MAX_CORNERS // corners))


def _nothing_known(count: int) -> AdvanceBounds:
    none = np.zeros(0, dtype=np.int64)
    return AdvanceBounds(np.full(count, -np.inf), np.zeros(count, dtype=np.int64), none, none, np.zeros(0))


_KERNEL = Kernel("optdock_advance_bounds", sizes=6, numbers=2)


def _body_bounds_native(
    bounded: BoundedBody, advances: Advances, obstacles: ObstacleSet, exact_within: FloatArray
) -> AdvanceBounds:
    """Return the result of `_body_bounds`, computed in C; its arrays are described there."""
    body, n, k, m = bounded.body, advances.width.size, len(advances.poses), len(obstacles)
    corners, q, circles = len(body.vertices), obstacles.vertices.shape[1], len(bounded.centres)
    yaw = advances.poses[:, 2]
    bound, row = np.empty(n), np.empty(n, dtype=np.int64)
    distance, found = np.empty(k * m), np.empty((2, k * m), dtype=np.int64)
    arrays = (
        (np.concatenate([part.ravel() for part in (*body, bounded.centres)]), 5 * corners + 2 * circles),
        (np.ascontiguousarray(advances.poses), 3 * k),
        (np.stack((np.cos(yaw), np.sin(yaw)), axis=-1), 2 * k),
        (advances.pose, n),
        (np.concatenate((advances.velocity.T, advances[3:])), 8 * n),
        (np.ascontiguousarray(exact_within), n),
        (obstacles.vertices, 2 * m * q),
        (obstacles.normals, 2 * m * q),
        (obstacles.offsets, m * q),
        (obstacles.lower, 2 * m),
        (obstacles.upper, 2 * m),
        (bound, n),
        (row, n),
        (distance, k * m),
        (found[0], k * m),
        (found[1], k * m),
        (np.empty(size := m + 2 * (corners + q + circles)), size),
        (np.empty(size := m + n + k + 1, dtype=np.int64), size),
    )
    pairs = _KERNEL((n, k, m, corners, q, circles), (bounded.radius, bounded.reach), arrays)
    if pairs < 0:
        raise IndexError("advances.pose: must be rows of advances.poses")
    return AdvanceBounds(bound, row, found[0, :pairs], found[1, :pairs], distance[:pairs])


@twin_of(_body_bounds_native)
def _body_bounds_chosen(
    bounded: BoundedBody, advances: Advances, obstacles: ObstacleSet, exact_within: FloatArray
) -> AdvanceBounds:
    return _body_bounds_numpy(bounded, advances, obstacles, exact_within)


def _body_bounds(
    bounded: BoundedBody, advances: Advances, obstacles: ObstacleSet, exact_within: FloatArray
) -> AdvanceBounds:
    # The kernel evaluates all edges; of pairs with many corners the twin skips most.
    has_many = skips_edges(len(bounded.body.vertices), obstacles.vertices.shape[1])
    return (_body_bounds_numpy if has_many else _body_bounds_chosen)(bounded, advances, obstacles, exact_within)


def _body_bounds_numpy(
    bounded: BoundedBody, advances: Advances, obstacles: ObstacleSet, exact_within: FloatArray
) -> AdvanceBounds:
    body, reach = bounded.body, bounded.reach
    poses, width, n = advances.poses, advances.width, advances.width.size
    travel = width * (advances.speed + reach * advances.turn)
    gaps = broad_phase(bounded, poses, obstacles)
    within = np.full(len(poses), -np.inf)
    np.maximum.at(within, advances.pose, exact_within + travel)
    at, o = np.nonzero(~(gaps >= within[:, None]))
    exact = separation(body, poses[at], obstacles.pieces(o))
    bounds = gaps[advances.pose] - travel[:, None]
    i, pair = _met(advances.pose, at, len(poses))
    drift = _directional(body, poses[at[pair]], advances.velocity[i], exact.axis[pair], width[i])
    stray = 0.5 * (advances.bend + reach * advances.twist)[i] * width[i] ** 2
    distance = exact.distance[pair]
    bounds[i, o[pair]] = np.minimum(distance, distance + drift - stray)
    bounds[np.isnan(bounds)] = -np.inf  # NaN is no proof and must not be lost in comparisons
    row = np.argmin(bounds, axis=1)
    return AdvanceBounds(bounds[np.arange(n), row], row, at, o, exact.distance)


def _met(pose: IntArray, at: IntArray, count: int) -> tuple[IntArray, IntArray]:
    """Combine each stretch with all pairs of its initial pose; return the indices of stretches and pairs, Shape (q,).

    Args:
        pose: Initial pose of each stretch.
        at: Pose of each pair, ascending.
        count: Number of poses.
    """
    begin = np.searchsorted(at, np.arange(count + 1))
    size = (begin[1:] - begin[:-1])[pose]
    stretch = np.repeat(np.arange(pose.size), size)
    first = begin[pose] - (np.cumsum(size) - size)
    return stretch, np.arange(stretch.size) + first[stretch]


def _directional(
    body: ConvexBody, poses: FloatArray, velocity: FloatArray, axis: FloatArray, width: FloatArray
) -> FloatArray:
    """Return the first-order part of (C5): min_v (n.v + n.v' du) - min_v n.v at du = width. Shape (m,) [m]."""
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    across, along = axis[:, 0] * c + axis[:, 1] * s, axis[:, 1] * c - axis[:, 0] * s  # the axis in the body's frame
    x, y = body.vertices[:, :1], body.vertices[:, 1:]
    height = across * x + along * y  # (v, m)
    rate = axis[:, 0] * velocity[:, 0] + axis[:, 1] * velocity[:, 1] + velocity[:, 2] * (along * x - across * y)
    change: FloatArray = (height + width * rate).min(axis=0) - height.min(axis=0)
    return change
