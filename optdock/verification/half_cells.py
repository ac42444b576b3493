"""Lower bounds of the clearance over half cells: second-order conservative advancement.

Let n be the axis that attains the exact distance d of the footprint at u0 to an obstacle. A fixed axis is a valid
lower bound at every other u as well, and along n every footprint vertex v moves by at least
`n.v'(u0) du - M du^2 / 2`, M a bound of its acceleration. So at u0 + du the distance is at least

    d + min_v (n.v + n.v' du) - min_v n.v - M du^2 / 2                                    (*)

which is concave in du: over a stretch it is smallest at one of the two ends. Motion along a wall costs nothing, as
n.v' = 0 there; first-order advancement, which knows no direction, would have to creep.
"""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.geometry.pose import transform_points
from optdock.geometry.separation import separation
from optdock.verification.seams import joined_bodies

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray, IntArray
    from optdock.geometry.footprint import Footprint
    from optdock.geometry.pose import Pose2
    from optdock.geometry.separation import ConvexBody
    from optdock.obstacles import ObstacleSet

__all__ = ["HalfBounds", "HalfCells", "half_cell_bounds", "pose_clearance"]


_MAX_CIRCLES = 3  # that stand for a body before it is looked at exactly
_MAX_PAIRS = 300_000  # of a stretch and an obstacle looked at in one go; bounds the memory


class HalfCells(NamedTuple):
    """Stretches that begin at a known pose; n of them.

    `poses`: Shape (n, 3). `velocity`: d pose / du at that pose, into the stretch, Shape (n, 3). The others Shape (n,):
    `width` in u; bounds within the cell of |p'| `speed`, |yaw'| `turn`, |p''| `bend`, |yaw''| + yaw'^2 `twist`.
    """

    poses: FloatArray
    velocity: FloatArray
    width: FloatArray
    speed: FloatArray
    turn: FloatArray
    bend: FloatArray
    twist: FloatArray

    def rows(self, keep: slice) -> HalfCells:
        """The stretches at `keep`."""
        return HalfCells(*(column[keep] for column in self))


class HalfBounds(NamedTuple):
    """Lower bound [m] and nearest obstacle row of every stretch, Shape (n,), and what was looked at exactly.

    `stretch`, `obstacle`, `distance`: stretch index, obstacle row, signed distance [m] of a pose, Shape (m,) each.
    """

    bound: FloatArray
    row: IntArray
    stretch: IntArray
    obstacle: IntArray
    distance: FloatArray

    def merged(self, other: HalfBounds) -> HalfBounds:
        """The smaller bound of the two, and both lists of poses."""
        mine = ~(self.bound > other.bound)  # a bound that is not a number proves nothing: it must not be lost
        return HalfBounds(
            np.where(mine, self.bound, other.bound),
            np.where(mine, self.row, other.row),
            np.concatenate((self.stretch, other.stretch)),
            np.concatenate((self.obstacle, other.obstacle)),
            np.concatenate((self.distance, other.distance)),
        )


def half_cell_bounds(
    footprint: Footprint, stretches: HalfCells, obstacles: ObstacleSet, care: FloatArray
) -> HalfBounds:
    """Bounds over all pieces of the footprint and all obstacles.

    Args:
        footprint: The moving outline.
        stretches: Where it moves.
        obstacles: At least one.
        care: Shape (n,) [m]: whatever may come closer than this is looked at exactly; the rest by box and circle.
    """
    n, block = stretches.width.size, max(1, _MAX_PAIRS // len(obstacles))
    if n <= block:
        parts = [_body_bounds(body, stretches, obstacles, care) for body in joined_bodies(footprint)]
        return functools.reduce(HalfBounds.merged, parts)
    starts = range(0, n, block)
    rows = [slice(start, start + block) for start in starts]
    blocks = [half_cell_bounds(footprint, stretches.rows(one), obstacles, care[one]) for one in rows]
    shifted = (one._replace(stretch=one.stretch + start) for one, start in zip(blocks, starts, strict=True))
    return HalfBounds(*(np.concatenate(columns) for columns in zip(*shifted, strict=True)))


def _body_bounds(body: ConvexBody, stretches: HalfCells, obstacles: ObstacleSet, care: FloatArray) -> HalfBounds:
    poses, width = stretches.poses, stretches.width
    reach = float(np.max(np.hypot(*body.vertices.T)))
    travel = width * (stretches.speed + reach * stretches.turn)
    bounds = _box_gaps(body, poses, obstacles) - travel[:, None]
    i, o = np.nonzero(bounds < care[:, None])
    exact = separation(body, poses[i], obstacles.pieces(o))
    drift = _directional(body, poses[i], stretches.velocity[i], exact.axis, width[i])
    stray = 0.5 * (stretches.bend + reach * stretches.twist)[i] * width[i] ** 2
    bounds[i, o] = np.minimum(exact.distance, exact.distance + drift - stray)
    row = np.argmin(bounds, axis=1)
    return HalfBounds(bounds[np.arange(width.size), row], row, i, o, exact.distance)


def _directional(
    body: ConvexBody, poses: FloatArray, velocity: FloatArray, axis: FloatArray, width: FloatArray
) -> FloatArray:
    """First-order part of (*): min_v (n.v + n.v' du) - min_v n.v at du = width. Shape (m,) [m]."""
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    across, along = axis[:, 0] * c + axis[:, 1] * s, axis[:, 1] * c - axis[:, 0] * s  # the axis in the body's frame
    x, y = body.vertices[:, :1], body.vertices[:, 1:]
    height = across * x + along * y  # (v, m)
    rate = axis[:, 0] * velocity[:, 0] + axis[:, 1] * velocity[:, 1] + velocity[:, 2] * (along * x - across * y)
    change: FloatArray = (height + width * rate).min(axis=0) - height.min(axis=0)
    return change


def _box_gaps(body: ConvexBody, poses: FloatArray, obstacles: ObstacleSet) -> FloatArray:
    """Lower bound of the distance from every pose's body to every obstacle, by circles and boxes. Shape (n, m) [m]."""
    centres, radius = _covering_circles(body)
    at = transform_points(poses, centres)  # (n, circles, 2)
    gaps = obstacles.box_distance(at[:, 0])
    for k in range(1, len(centres)):
        np.minimum(gaps, obstacles.box_distance(at[:, k]), out=gaps)
    gaps -= radius
    return gaps


def _covering_circles(body: ConvexBody) -> tuple[FloatArray, float]:
    """Centres (k, 2) [m] and common radius [m] of circles that cover the body: one per square of its bounding box."""
    low, high = body.vertices.min(axis=0), body.vertices.max(axis=0)
    size = high - low
    longer = int(np.argmax(size))
    count = int(np.clip(np.ceil(size[longer] / max(size[1 - longer], 1e-300)), 1, _MAX_CIRCLES))
    centres = np.tile(0.5 * (low + high), (count, 1))
    centres[:, longer] = low[longer] + size[longer] * (np.arange(count) + 0.5) / count
    return centres, 0.5 * float(np.hypot(size[longer] / count, size[1 - longer]))


def pose_clearance(pose: Pose2, footprint: Footprint, obstacles: ObstacleSet) -> tuple[float, int]:
    """Signed clearance of one pose [m] and the row of the nearest obstacle; (inf, -1) without obstacles."""
    poses = pose.as_array()[None]
    best, row = np.inf, -1
    for body in joined_bodies(footprint):
        apart = _box_gaps(body, poses, obstacles)[0]
        order = np.argsort(apart)
        for chunk in (order[:8], order[8:]):
            rows = chunk[apart[chunk] < best]
            if rows.size == 0:
                continue
            distance = separation(body, np.repeat(poses, rows.size, axis=0), obstacles.pieces(rows)).distance
            k = int(np.argmin(distance))
            if distance[k] < best:
                best, row = float(distance[k]), int(rows[k])
    return best, row
