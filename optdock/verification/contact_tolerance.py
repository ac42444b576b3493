"""Contact tolerance: overlaps that are shallow for every piece but deep for the union of the pieces.

If no clearance is required, two convex pieces may overlap by the tolerance t of a certificate, because their
intersection then lies within t of the outline of either piece. But a footprint that is not convex, and obstacles that
touch each other, are unions of adjacent pieces. A needle between two touching boxes may overlap each box by only t, but
penetrate their union to any depth.

Therefore the *core* of a union must not overlap the other shape at all (equation C9 of docs/theory/certificate.md). The
core consists of the points that are at least d = 2 micrometres inside the union, where gaps between obstacles below 0.2
micrometres are regarded as closed. A core is covered by convex pieces. Convex sets with a separating axis share no
interior, and if no piece shares interior with the other shape, neither does their union. An overlap of t along some
axis leaves d - t between the core and the other shape, so contact is accepted. A convex footprint, and an obstacle that
touches no other obstacle, need no check, because t itself is the bound. Rounded corners of a core are approximated by
polygons inside the removed rim, so a computed core is never too small, except for the precision of the offset curves,
which is one hundredth of d.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from optdock.geometry.footprint import CORE_DEPTH
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.polygon import convex_cover
from optdock.geometry.pose import transform_points
from optdock.geometry.separation import separation
from optdock.verification.certificate import Memo

if TYPE_CHECKING:
    from collections.abc import Sequence

    from shapely.geometry.base import BaseGeometry

    from optdock.geometry.arrays import FloatArray
    from optdock.geometry.footprint import Footprint
    from optdock.geometry.separation import ConvexBody

__all__ = ["DEPTH", "deep_pairs", "deepest"]

DEPTH = CORE_DEPTH  # [m], twice the `TOLERANCE` of certificates: accepted contact is half of it away from the core
_CRACK = 1e-7  # [m]: half the width of gaps between obstacles that count as closed
_MARGIN = 0.1  # [m] around the box of interest, so that the edges of the box are no outline within it
_LATTICE = 0.25  # [m]: a core takes 10 to 40 ms among the cells of a map; poses of a search are centimetres apart
_MOST_CORES = 256  # per set of obstacles
_ARC = 4  # segments of a quarter circle
_APART = 1e-9  # [m]: far above the rounding of coordinates below 1000 km


_CORES: Memo[ObstacleSet, dict[tuple[bytes, bytes], ObstacleSet]] = Memo()


def deep_pairs(
    footprint: Footprint, obstacles: ObstacleSet, lower: FloatArray, upper: FloatArray
) -> tuple[tuple[tuple[ConvexBody, ...], ObstacleSet], ...]:
    """Return bodies with the obstacles that they must not overlap at all, in a box with corners of Shape (2,) [m].

    If the footprint is not convex, one pair is the core of the footprint and the obstacles. If obstacles touch each
    other, one pair is the footprint and the core of the obstacles.
    """
    pairs = (footprint.core, obstacles), (footprint.bodies, _obstacle_core(obstacles, lower, upper))
    return tuple((bodies, rocks) for bodies, rocks in pairs if bodies and len(rocks))


def deepest(footprint: Footprint, pose: FloatArray, obstacles: ObstacleSet) -> float:
    """Return an upper bound of the signed clearance at a pose, Shape (3,); 0 if no overlap exceeds `DEPTH`."""
    reach = footprint.circumscribed_radius
    pairs = deep_pairs(footprint, obstacles, pose[:2] - reach, pose[:2] + reach)
    smallest = min((_least_separation(bodies, pose, rocks) for bodies, rocks in pairs), default=0.0)
    return smallest - DEPTH if smallest < 0.0 else 0.0


def _least_separation(bodies: Sequence[ConvexBody], pose: FloatArray, obstacles: ObstacleSet) -> float:
    """Return the smallest separation of bodies at a pose from obstacles if any overlap, else a number >= 0.

    Pairs whose bounding boxes are more than `_APART` away from each other do not overlap and are omitted.
    """
    starts = np.cumsum([0, *(len(body.vertices) for body in bodies[:-1])])
    corners = transform_points(pose[None], np.concatenate([body.vertices for body in bodies]))[0]
    lower, upper = np.minimum.reduceat(corners, starts) - _APART, np.maximum.reduceat(corners, starts) + _APART
    meets = np.all((obstacles.lower <= upper[:, None]) & (obstacles.upper >= lower[:, None]), axis=2)
    found = [
        float(separation(body, np.tile(pose, (rows.size, 1)), obstacles.pieces(rows)).distance.min())
        for body, rows in zip(bodies, (np.flatnonzero(row) for row in meets), strict=True)
        if rows.size
    ]
    return min(found, default=0.0)


def _obstacle_core(obstacles: ObstacleSet, lower: FloatArray, upper: FloatArray) -> ObstacleSet:
    """Return convex pieces of the core of all obstacles that touch each other, in a box with a margin.

    The corners of the box are moved outwards to a lattice, so that neighbouring poses share the same core.
    """
    low, high = np.floor(lower / _LATTICE) * _LATTICE, np.ceil(upper / _LATTICE) * _LATTICE
    known = _CORES.recall(obstacles)
    if known is None:
        known = {}
        _CORES.keep(obstacles, known)
    key = low.tobytes(), high.tobytes()
    if key not in known:
        if len(known) >= _MOST_CORES:
            known.clear()
        known[key] = _core_in(obstacles, low - _MARGIN, high + _MARGIN)
    return known[key]


def _core_in(obstacles: ObstacleSet, low: FloatArray, high: FloatArray) -> ObstacleSet:
    """Return convex pieces of the core of the obstacles in a box, see `_obstacle_core`."""
    rows = obstacles.rows_in_box(low, high)
    rows = rows[_touching(obstacles.lower[rows], obstacles.upper[rows])]
    if rows.size == 0:
        return ObstacleSet.empty()
    import shapely

    middle = 0.5 * (low + high)  # offset curves are computed near the origin, where floats are most precise
    box = shapely.box(*(low - middle), *(high - middle))
    shapes = shapely.intersection(shapely.polygons(obstacles.vertices[rows] - middle), box)
    closed = shapely.union_all(shapely.buffer(shapes, _CRACK, join_style="mitre"))
    core: BaseGeometry = closed.buffer(-(DEPTH + _CRACK), quad_segs=_ARC)
    return ObstacleSet.from_pieces([piece + middle for piece in convex_cover(core)], "obstacles")


def _touching(lower: FloatArray, upper: FloatArray) -> FloatArray:
    """Return a mask of the boxes that touch another box, where narrow cracks count as closed. Shape (m,)."""
    order = np.argsort(lower[:, 0], kind="stable")
    touches = np.zeros(len(order), dtype=np.bool_)
    low, high = lower[order] - _CRACK, upper[order] + _CRACK
    for i in range(len(order) - 1):
        stop = int(np.searchsorted(low[:, 0], high[i, 0], side="right"))
        met = np.flatnonzero((low[i + 1 : stop, 1] <= high[i, 1]) & (high[i + 1 : stop, 1] >= low[i, 1])) + i + 1
        touches[met] = True
        touches[i] |= met.size > 0
    found: FloatArray = np.empty_like(touches)
    found[order] = touches
    return found
