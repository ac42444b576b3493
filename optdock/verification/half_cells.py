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

from optdock.deadline import never_late
from optdock.geometry.pose import transform_points
from optdock.geometry.separation import separation
from optdock.verification.contact import DEPTH, deepest

if TYPE_CHECKING:
    from collections.abc import Callable

    from optdock.geometry.arrays import FloatArray, IntArray
    from optdock.geometry.footprint import Footprint
    from optdock.geometry.pose import Pose2
    from optdock.geometry.separation import ConvexBody
    from optdock.obstacles import ObstacleSet

__all__ = [
    "HalfBounds",
    "HalfCells",
    "RoundedBody",
    "body_bounds",
    "half_cell_bounds",
    "pose_clearance",
    "pose_clearances",
    "rounded",
]


_MAX_CIRCLES = 3  # that stand for a body before it is looked at exactly
_NEARBY = 1.0  # [m]: obstacles further than this are looked at only when nothing is as near
_NEAREST = 8  # obstacles of a pose that are looked at first
_MAX_PAIRS = 200_000  # of a stretch and an obstacle looked at in one go; bounds memory and time
_MAX_CORNERS = 50_000  # of a body and an obstacle, met at all stretches looked at in one go; likewise


class HalfCells(NamedTuple):
    """Stretches that begin at known poses; n of them at k poses, as neighbours share theirs.

    `poses`: Shape (k, 3). `pose`: where each begins, Shape (n,). `velocity`: d pose / du there, into the stretch,
    Shape (n, 3). The others Shape (n,): `width` in u; bounds within the cell of |p'| `speed`, |yaw'| `turn`, |p''|
    `bend`, |yaw''| + yaw'^2 `twist`.
    """

    poses: FloatArray
    pose: IntArray
    velocity: FloatArray
    width: FloatArray
    speed: FloatArray
    turn: FloatArray
    bend: FloatArray
    twist: FloatArray

    def rows(self, keep: slice) -> tuple[HalfCells, IntArray]:
        """The stretches at `keep`, and which of the poses they still hold."""
        used, pose = np.unique(self.pose[keep], return_inverse=True)
        return HalfCells(self.poses[used], pose, *(column[keep] for column in self[2:])), used


class HalfBounds(NamedTuple):
    """Lower bound [m] and nearest obstacle row of every stretch, Shape (n,), and what was looked at exactly.

    `pose`, `obstacle`, `distance`: pose index, obstacle row, signed distance [m], Shape (m,) each.
    """

    bound: FloatArray
    row: IntArray
    pose: IntArray
    obstacle: IntArray
    distance: FloatArray

    def merged(self, other: HalfBounds) -> HalfBounds:
        """The smaller bound of the two, and both lists of poses."""
        mine = self.bound <= other.bound
        return HalfBounds(
            np.where(mine, self.bound, other.bound),
            np.where(mine, self.row, other.row),
            np.concatenate((self.pose, other.pose)),
            np.concatenate((self.obstacle, other.obstacle)),
            np.concatenate((self.distance, other.distance)),
        )


def half_cell_bounds(
    footprint: Footprint,
    stretches: HalfCells,
    obstacles: ObstacleSet,
    care: FloatArray,
    is_late: Callable[[], bool] = never_late,
) -> HalfBounds:
    """Bounds over all pieces of the footprint and all obstacles.

    Args:
        footprint: The moving outline.
        stretches: Where it moves.
        obstacles: At least one.
        care: Shape (n,) [m]: whatever may come closer than this is looked at exactly; the rest by box and circle.
        is_late: Asked between blocks of some milliseconds.
    """
    return body_bounds(_rounded_footprint(footprint), stretches, obstacles, care, is_late)


def body_bounds(
    bodies: tuple[RoundedBody, ...],
    stretches: HalfCells,
    obstacles: ObstacleSet,
    care: FloatArray,
    is_late: Callable[[], bool] = never_late,
) -> HalfBounds:
    """Likewise over bodies that move together, at least one; once `is_late()` bounds not begun with are -inf."""
    n = stretches.width.size
    corners = max(len(one.body.vertices) for one in bodies) + obstacles.vertices.shape[1]
    block = max(1, min(_MAX_PAIRS // len(obstacles), _MAX_CORNERS // corners))
    if n <= block:
        parts: list[HalfBounds] = []
        for body in bodies:
            if parts and is_late():
                return functools.reduce(HalfBounds.merged, [*parts, _nothing_known(n)])
            parts.append(_body_bounds(body, stretches, obstacles, care))
        return functools.reduce(HalfBounds.merged, parts)
    blocks: list[HalfBounds] = []
    for rows in (slice(start, start + block) for start in range(0, n, block)):
        if blocks and is_late():
            blocks.append(_nothing_known(n - rows.start))
            break
        some, used = stretches.rows(rows)
        found = body_bounds(bodies, some, obstacles, care[rows], is_late)
        blocks.append(found._replace(pose=used[found.pose]))
    return HalfBounds(*(np.concatenate(columns) for columns in zip(*blocks, strict=True)))


def _nothing_known(count: int) -> HalfBounds:
    none = np.zeros(0, dtype=np.int64)
    return HalfBounds(np.full(count, -np.inf), np.zeros(count, dtype=np.int64), none, none, np.zeros(0))


class RoundedBody(NamedTuple):
    """A convex body and circles that cover it: centres (k, 2) [m], common radius [m]; `reach` from the origin [m]."""

    body: ConvexBody
    centres: FloatArray
    radius: float
    reach: float


def rounded(bodies: tuple[ConvexBody, ...]) -> tuple[RoundedBody, ...]:
    """Bodies with what is needed to leave most obstacles out."""
    reach = (float(np.max(np.hypot(*body.vertices.T))) for body in bodies)
    return tuple(RoundedBody(body, *_covering_circles(body), far) for body, far in zip(bodies, reach, strict=True))


@functools.lru_cache(maxsize=64)
def _rounded_footprint(footprint: Footprint) -> tuple[RoundedBody, ...]:
    return rounded(footprint.bodies)


def _body_bounds(rounded: RoundedBody, stretches: HalfCells, obstacles: ObstacleSet, care: FloatArray) -> HalfBounds:
    body, reach = rounded.body, rounded.reach
    poses, width, n = stretches.poses, stretches.width, stretches.width.size
    travel = width * (stretches.speed + reach * stretches.turn)
    gaps = _box_gaps(rounded, poses, obstacles)
    within = np.full(len(poses), -np.inf)
    np.maximum.at(within, stretches.pose, care + travel)
    at, o = np.nonzero(~(gaps >= within[:, None]))
    exact = separation(body, poses[at], obstacles.pieces(o))
    bounds = gaps[stretches.pose] - travel[:, None]
    i, pair = _met(stretches.pose, at, len(poses))
    drift = _directional(body, poses[at[pair]], stretches.velocity[i], exact.axis[pair], width[i])
    stray = 0.5 * (stretches.bend + reach * stretches.twist)[i] * width[i] ** 2
    distance = exact.distance[pair]
    bounds[i, o[pair]] = np.minimum(distance, distance + drift - stray)
    bounds[np.isnan(bounds)] = -np.inf  # what is not a number proves nothing, and must not be lost in comparisons
    row = np.argmin(bounds, axis=1)
    return HalfBounds(bounds[np.arange(n), row], row, at, o, exact.distance)


def _met(pose: IntArray, at: IntArray, count: int) -> tuple[IntArray, IntArray]:
    """Every stretch with every pair of the pose where it begins: indices of stretches and of pairs, Shape (q,) each.

    Args:
        pose: Where each stretch begins.
        at: The pose of each pair, ascending.
        count: How many poses there are.
    """
    begin = np.searchsorted(at, np.arange(count + 1))
    size = (begin[1:] - begin[:-1])[pose]
    stretch = np.repeat(np.arange(pose.size), size)
    first = begin[pose] - (np.cumsum(size) - size)
    return stretch, np.arange(stretch.size) + first[stretch]


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


def _box_gaps(rounded: RoundedBody, poses: FloatArray, obstacles: ObstacleSet) -> FloatArray:
    """Lower bound of the clearance of every pose's body from every obstacle, by circles and boxes. Shape (n, m) [m].

    Where it is not positive the body may overlap the obstacle by more.
    """
    at = transform_points(poses, rounded.centres)  # (n, circles, 2)
    gaps = obstacles.box_distance(at[:, 0])
    for k in range(1, len(rounded.centres)):
        np.minimum(gaps, obstacles.box_distance(at[:, k]), out=gaps)
    gaps -= rounded.radius
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
    distance, row = pose_clearances(pose.as_array()[None], footprint, obstacles)
    return float(distance[0]), int(row[0])


def pose_clearances(
    poses: FloatArray, footprint: Footprint, obstacles: ObstacleSet, within: float = np.inf
) -> tuple[FloatArray, IntArray]:
    """Signed clearances of poses and the rows of their nearest obstacles, Shape (n,) [m] and (n,).

    The nearest few by box and circle are looked at first, then whatever else may be nearer than they are. Where a
    shallow overlap of pieces may hide a deep one of the wholes, that is looked for as well (see `contact`).

    Args:
        poses: Shape (n, 3).
        footprint: The outline.
        obstacles: May be empty.
        within: Where no obstacle is closer than this [m] the answer is (within, -1).
    """
    reach = footprint.circumscribed_radius + min(within, _NEARBY)
    rows = obstacles.rows_in_box(poses[:, :2].min(axis=0) - reach, poses[:, :2].max(axis=0) + reach)
    if rows.size < 0.5 * len(obstacles):
        best, found = _nearest(poses, footprint, obstacles.subset(rows), within)
        # What was left out is at least that far away.
        if within <= _NEARBY or bool(np.all(best <= _NEARBY)):
            return best, np.where(found >= 0, rows[found], -1) if rows.size else found
    return _nearest(poses, footprint, obstacles, within)


def _nearest(
    poses: FloatArray, footprint: Footprint, obstacles: ObstacleSet, within: float
) -> tuple[FloatArray, IntArray]:
    n, m = len(poses), len(obstacles)
    best: FloatArray = np.full(n, float(within))
    row: IntArray = np.full(n, -1)
    for one in _rounded_footprint(footprint) if m else ():
        apart = _box_gaps(one, poses, obstacles)
        count = min(m, _NEAREST)
        nearest = np.zeros((n, m), dtype=np.bool_)
        nearest[np.arange(n)[:, None], np.argpartition(apart, count - 1, axis=1)[:, :count]] = True
        for some in (nearest, ~nearest):
            i, o = np.nonzero(some & ~((apart >= best[:, None]) & (apart > 0.0)))
            if i.size == 0:
                continue
            found = np.full((n, m), np.inf)
            found[i, o] = separation(one.body, poses[i], obstacles.pieces(o)).distance
            k = np.argmin(found, axis=1)
            smallest = found[np.arange(n), k]
            row, best = np.where(smallest < best, k, row), np.minimum(smallest, best)
    for shallow in np.flatnonzero((best < 0.0) & (best > -DEPTH)).tolist():
        best[shallow] = min(best[shallow], deepest(footprint, poses[shallow], obstacles))
    return best, row
