"""Proximity queries: the clearance of a pose, computed by a broad phase and an exact narrow phase.

The broad phase ([Ericson2005] ch. 2) computes a lower bound of every distance, from circles that cover a body to the
bounding boxes of the obstacles. For the pairs that the broad phase cannot decide, the narrow phase computes the signed
distance of convex polygons and the axis that attains it (`geometry.separation`). If a shallow overlap of pieces may
hide a deep overlap of their unions, the unions are also checked (`contact_tolerance`).
"""

from __future__ import annotations

import functools
import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.geometry.arrays import frozen
from optdock.geometry.obstacles import box_distance
from optdock.geometry.pose import transform_points
from optdock.geometry.separation import separation
from optdock.verification.contact_tolerance import DEPTH, deepest

if TYPE_CHECKING:
    from collections.abc import Sequence

    from optdock.geometry.arrays import FloatArray, IntArray
    from optdock.geometry.footprint import Footprint
    from optdock.geometry.obstacles import ObstacleSet
    from optdock.geometry.pose import Pose2
    from optdock.geometry.separation import ConvexBody

__all__ = [
    "BoundedBody",
    "bounded",
    "bounded_footprint",
    "broad_phase",
    "lower_where_deep",
    "of_pieces",
    "pose_clearance",
    "pose_clearances",
]

_MAX_CIRCLES = 3  # per body; more circles take longer than the narrow phase that they save
_NEARBY = 1.0  # [m]: obstacles farther than this are evaluated only if no other is as near
_NEAREST = 8  # obstacles per pose that the narrow phase evaluates first; the others only if they may be nearer


def pose_clearance(pose: Pose2, footprint: Footprint, obstacles: ObstacleSet) -> tuple[float, int]:
    """Return the signed clearance of one pose [m] and the row of the nearest obstacle; (inf, -1) without obstacles."""
    distance, row = pose_clearances(pose.as_array()[None], footprint, obstacles)
    return float(distance[0]), int(row[0])


def pose_clearances(
    poses: FloatArray,
    footprint: Footprint,
    obstacles: ObstacleSet,
    within: float = np.inf,
    *,
    checks_unions: bool = True,
) -> tuple[FloatArray, IntArray]:
    """Return the signed clearances of poses and the rows of their nearest obstacles, Shape (n,) [m] and (n,).

    Args:
        poses: Shape (n, 3).
        footprint: The outline.
        obstacles: May be empty.
        within: If no obstacle is closer than this [m], the result is (within, -1).
        checks_unions: Whether overlaps that are shallow for every piece are checked for deep overlaps of the unions,
            see `contact_tolerance`. A search for guesses, which are certified afterwards, can omit this check.
    """
    best, row = of_pieces(poses, footprint, obstacles, within)
    if checks_unions:
        lower_where_deep(best, poses, footprint, obstacles)
    return best, row


def lower_where_deep(clearances: FloatArray, poses: FloatArray, footprint: Footprint, obstacles: ObstacleSet) -> None:
    """Lower those clearances, Shape (n,), that are shallow overlaps for every piece but deep ones of the unions."""
    for shallow in ((clearances < 0.0) & (clearances > -DEPTH)).nonzero()[0].tolist():
        clearances[shallow] = min(clearances[shallow], deepest(footprint, poses[shallow], obstacles))


def of_pieces(
    poses: FloatArray, footprint: Footprint, obstacles: ObstacleSet, within: float
) -> tuple[FloatArray, IntArray]:
    """Return the result of `pose_clearances` without the check of unions."""
    reach = footprint.circumscribed_radius + min(within, _NEARBY)
    rows = obstacles.rows_in_box(poses[:, :2].min(axis=0) - reach, poses[:, :2].max(axis=0) + reach)
    if rows.size < 0.5 * len(obstacles) and np.isfinite(poses).all():
        best, found = _nearest(poses, footprint, obstacles.subset(rows), within)
        # The omitted obstacles are at least `_NEARBY` away.
        if within <= _NEARBY or bool(np.all(best <= _NEARBY)):
            return best, np.where(found >= 0, rows[found], -1) if rows.size else found
    return _nearest(poses, footprint, obstacles, within)


def _nearest(
    poses: FloatArray, footprint: Footprint, obstacles: ObstacleSet, within: float
) -> tuple[FloatArray, IntArray]:
    """Evaluate the obstacles that are nearest in the broad phase first, then all others that may be nearer.

    Of obstacles at the same distance the first one is returned.
    """
    n, m = len(poses), len(obstacles)
    best: FloatArray = np.full(n, float(within))
    row: IntArray = np.full(n, -1)
    for body in bounded_footprint(footprint) if m else ():
        apart = broad_phase(body, poses, obstacles)
        count = min(m, _NEAREST)
        nearest = np.zeros((n, m), dtype=np.bool_)
        nearest[np.arange(n)[:, None], apart.argpartition(count - 1, axis=1)[:, :count]] = True
        found, known = np.full((n, m), np.inf), best
        for some in (nearest, ~nearest):
            i, o = (some & ~((apart > known[:, None]) & (apart > 0.0))).nonzero()
            if i.size:
                found[i, o] = separation(body.body, poses[i], obstacles.pieces(o)).distance
                known = np.minimum(known, found.min(axis=1))
        k = found.argmin(axis=1)
        smallest = found[np.arange(n), k]
        row, best = np.where(smallest < best, k, row), np.minimum(smallest, best)
    return best, row


class BoundedBody(NamedTuple):
    """A convex body and its bounding circles: centres (k, 2) [m], common radius [m]; `reach` from the origin [m]."""

    body: ConvexBody
    centres: FloatArray
    radius: float
    reach: float


def bounded(bodies: tuple[ConvexBody, ...]) -> tuple[BoundedBody, ...]:
    """Return bodies with their bounding circles."""
    if not bodies:
        return ()
    corners = np.concatenate([body.vertices for body in bodies])
    starts = np.cumsum([0, *(len(body.vertices) for body in bodies[:-1])])
    lower, upper = np.minimum.reduceat(corners, starts), np.maximum.reduceat(corners, starts)
    reach = np.maximum.reduceat(np.hypot(*corners.T), starts)
    boxes = zip(bodies, lower.tolist(), upper.tolist(), reach.tolist(), strict=True)
    return tuple(BoundedBody(body, *_bounding_circles(low, high), far) for body, low, high, far in boxes)


@functools.lru_cache(maxsize=64)
def bounded_footprint(footprint: Footprint) -> tuple[BoundedBody, ...]:
    """Return the convex pieces of a footprint with their bounding circles, cached."""
    return frozen(bounded(footprint.bodies))


def broad_phase(body: BoundedBody, poses: FloatArray, obstacles: ObstacleSet) -> FloatArray:
    """Return lower bounds of the distances of a body at every pose, Shape (n, 3), to every obstacle. Shape (n, m) [m].

    If a bound is not positive, the overlap of the body and the obstacle may be deeper than the bound.
    """
    at = transform_points(poses, body.centres)  # (n, circles, 2)
    gaps = box_distance(obstacles, at[:, 0])
    for k in range(1, len(body.centres)):
        np.minimum(gaps, box_distance(obstacles, at[:, k]), out=gaps)
    gaps -= body.radius
    return gaps


def _bounding_circles(low: Sequence[float], high: Sequence[float]) -> tuple[FloatArray, float]:
    """Return centres (k, 2) [m] and radius [m] of circles that each cover one part of a box with corners (2,) [m]."""
    size = high[0] - low[0], high[1] - low[1]
    longer = int(size[1] > size[0])
    length, width = size[longer], size[1 - longer]
    count = max(1, math.ceil(min(length / max(width, 1e-300), _MAX_CIRCLES)))
    centres = np.array([[0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1])]] * count)
    centres[:, longer] = [low[longer] + length * (k + 0.5) / count for k in range(count)]
    return centres, 0.5 * float(np.hypot(length / count, width))
