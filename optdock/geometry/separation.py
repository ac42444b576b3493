"""Exact signed distance between convex polygons, for many pairs at once, with the separating axis.

For convex sets A and B every unit axis n gives a lower bound `min_A n.a - max_B n.b` of their signed distance, and the
best axis attains it ([Ericson2005] ch. 5.2). For polygons, the best axis is an edge normal of one of the two polygons,
or the direction between two vertices. The maximum over these axes is therefore the exact distance, and the axis that
attains the maximum proves it.

If both polygons have many corners, most edges are skipped. A vertex a of A bounds the gap along every n from above,
`min_A n.a' - max_B n.b <= n.a - max_B n.b`, so a normal whose bound is below a known gap cannot be the best axis.
Directions between vertices are evaluated only near the best edges. If A and B are apart, the gap as a function of the
direction has one maximum. No edge normal lies between this maximizing direction and the better of the two neighbouring
normals, so these two directions have the same nearest vertices.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from optdock.geometry.arrays import BoolArray, FloatArray, IntArray

__all__ = ["ConvexBody", "ConvexPieces", "Separation", "separation", "skips_edges"]


_MAX_PRODUCTS = 1_000_000  # vertex pairs evaluated at once; bounds the memory
_MANY = 1000  # products of corner counts above which most edges are skipped (56 instead of 153 us for 32 x 32)
_LIKELY = 6  # edges of each polygon that are evaluated first, and vertices near the best of them


class ConvexBody(NamedTuple):
    """A convex polygon in its own frame: vertices (n, 2) [m], outward normals (n, 2), offsets (n,) [m]."""

    vertices: FloatArray
    normals: FloatArray
    offsets: FloatArray


class ConvexPieces(NamedTuple):
    """Convex polygons in the world, one per column, all Shape (k, m): vertices, outward normals and offsets [m].

    Pairs are along the last axis, because reductions over few vertices are three times as fast in this layout.
    """

    x: FloatArray
    y: FloatArray
    normal_x: FloatArray
    normal_y: FloatArray
    offsets: FloatArray

    def columns(self, keep: slice | IntArray) -> ConvexPieces:
        """Return the polygons selected by `keep`."""
        return ConvexPieces(*(part[:, keep] for part in self))


class Separation(NamedTuple):
    """Signed distances and separating axes of pairs.

    `distance`: minus the penetration depth for an overlap, Shape (m,) [m]. `axis`: unit vectors from obstacle to body,
    Shape (m, 2).
    """

    distance: FloatArray
    axis: FloatArray


def separation(body: ConvexBody, poses: FloatArray, pieces: ConvexPieces) -> Separation:
    """Return the signed distance of the body at pose i to piece i, for every i.

    Args:
        body: The moving polygon.
        poses: Shape (m, 3) [m, m, rad].
        pieces: The obstacle of each pose.
    """
    is_many, corners = skips_edges(len(body.vertices), len(pieces.x)), len(body.vertices) * len(pieces.x)
    block = max(1, _MAX_PRODUCTS // (corners if not is_many else 4 * _LIKELY * (len(body.vertices) + len(pieces.x))))
    if len(poses) > block:
        spans = [slice(i, i + block) for i in range(0, len(poses), block)]
        parts = [separation(body, poses[one], pieces.columns(one)) for one in spans]
        return Separation(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))
    return _by_likely_axes(body, poses, pieces) if is_many else _by_all_axes(body, poses, pieces)


def skips_edges(first: int, second: int) -> bool:
    """Whether `separation` skips edges of polygons with these numbers of corners."""
    return first * second > _MANY and min(first, second) > 2 * _LIKELY


def _by_all_axes(body: ConvexBody, poses: FloatArray, pieces: ConvexPieces) -> Separation:
    turn = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    at = _corners(body, poses, turn)
    best = _better(_along_piece_normals(at, pieces), _along_body_normals(body, poses, turn, pieces))
    best = _better(best, _along_nearest_vertices(at, pieces))
    return _as_separation(best)


def _by_likely_axes(body: ConvexBody, poses: FloatArray, pieces: ConvexPieces) -> Separation:
    turn = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    at, corners = _corners(body, poses, turn), _Corners(pieces.x, pieces.y)
    edges = _BodyEdges(*_turned(body.normals, turn), body.offsets[:, None])
    edges = edges._replace(reach=edges.reach + edges.x * poses[:, 0] + edges.y * poses[:, 1])
    between = (mine.mean(axis=0) - theirs.mean(axis=0) for mine, theirs in zip(at, corners, strict=True))
    first, _ = _along_likely_normals(_Along(np.full(len(poses), -np.inf), *between), at, edges, pieces)
    best, left_out = _along_likely_normals(first, at, edges, pieces)
    height, depth = (best.x * points.x + best.y * points.y for points in (at, corners))
    depth[_repeated(corners)] = -np.inf
    low, high = _largest(-height)[0], _largest(depth)[0]
    best = _better(best, _along_nearest_vertices(at, pieces, _picked(at, low), _picked(corners, high)))
    found = _as_separation(best)
    open_pairs = np.flatnonzero(~(left_out <= best.distance))
    if open_pairs.size:
        found.distance[open_pairs], found.axis[open_pairs] = _by_all_axes(
            body, poses[open_pairs], pieces.columns(open_pairs)
        )
    return found


class _BodyEdges(NamedTuple):
    """World components of the body's normals and its support along them, Shape (v, m)."""

    x: FloatArray
    y: FloatArray
    reach: FloatArray


def _along_likely_normals(
    before: _Along, at: _Corners, edges: _BodyEdges, pieces: ConvexPieces
) -> tuple[_Along, FloatArray]:
    """Return the best gap of `before` and the likely normals, and an upper bound of all other gaps, Shape (m,)."""
    corners, pair = _Corners(pieces.x, pieces.y), np.arange(pieces.x.shape[1])
    near = _picked(at, np.argmin(before.x * at.x + before.y * at.y, axis=0))
    far = _picked(corners, np.argmax(before.x * corners.x + before.y * corners.y, axis=0))
    most = pieces.normal_x * near.x + pieces.normal_y * near.y - pieces.offsets
    most[np.roll(_repeated(corners), -1, axis=0)] = -np.inf
    theirs, left_out = _largest(most)
    mine, also_left_out = _largest(edges.x * far.x + edges.y * far.y - edges.reach)
    x, y = pieces.normal_x[theirs, pair], pieces.normal_y[theirs, pair]
    gaps = (x[:, None] * at.x + y[:, None] * at.y).min(axis=1) - pieces.offsets[theirs, pair]
    my_x, my_y = edges.x[mine, pair], edges.y[mine, pair]
    my_gaps = (my_x[:, None] * corners.x + my_y[:, None] * corners.y).min(axis=1) - edges.reach[mine, pair]
    gaps, x, y = (np.concatenate(rows) for rows in ((gaps, my_gaps), (x, -my_x), (y, -my_y)))
    k = np.argmax(gaps, axis=0)
    return _better(before, _Along(gaps[k, pair], x[k, pair], y[k, pair])), np.maximum(left_out, also_left_out)


def _repeated(corners: _Corners) -> BoolArray:
    """Return a mask of vertices repeated by padding, Shape (k, m); they must not displace others in a selection."""
    same: BoolArray = (corners.x == np.roll(corners.x, 1, axis=0)) & (corners.y == np.roll(corners.y, 1, axis=0))
    return same


def _corners(body: ConvexBody, poses: FloatArray, turn: tuple[FloatArray, FloatArray]) -> _Corners:
    x, y = _turned(body.vertices, turn)
    return _Corners(poses[:, 0] + x, poses[:, 1] + y)


def _turned(vectors: FloatArray, turn: tuple[FloatArray, FloatArray]) -> tuple[FloatArray, FloatArray]:
    """Return the world components, Shape (v, m) each, of body vectors, Shape (v, 2)."""
    x, y = vectors[:, :1], vectors[:, 1:]
    return turn[0] * x - turn[1] * y, turn[1] * x + turn[0] * y


def _largest(values: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return the rows of the `_LIKELY` largest values per column, and the largest of the other values, Shape (m,)."""
    order = np.argpartition(values, -_LIKELY - 1, axis=0)
    return order[-_LIKELY:], np.take_along_axis(values, order[-_LIKELY - 1 : -_LIKELY], axis=0)[0]


def _picked(points: _Corners, row: IntArray) -> _Corners:
    pair = np.arange(row.shape[-1])
    return _Corners(points.x[row, pair], points.y[row, pair])


class _Corners(NamedTuple):
    """World coordinates of vertices, Shape (v, m) [m]."""

    x: FloatArray
    y: FloatArray


class _Along(NamedTuple):
    """Gap along an axis, and the components of the axis, Shape (m,)."""

    distance: FloatArray
    x: FloatArray
    y: FloatArray


def _better(first: _Along, second: _Along) -> _Along:
    better = second.distance > first.distance
    distance = np.where(better, second.distance, first.distance)
    return _Along(distance, np.where(better, second.x, first.x), np.where(better, second.y, first.y))


def _as_separation(along: _Along) -> Separation:
    axis = np.empty((along.x.size, 2))
    axis[:, 0], axis[:, 1] = along.x, along.y
    return Separation(along.distance, axis)


def _along_piece_normals(at: _Corners, pieces: ConvexPieces) -> _Along:
    heights = pieces.normal_x[:, None] * at.x + pieces.normal_y[:, None] * at.y  # (k, v, m)
    gaps = heights.min(axis=1) - pieces.offsets  # (k, m)
    best, pair = gaps.argmax(axis=0), np.arange(gaps.shape[1])
    return _Along(gaps[best, pair], pieces.normal_x[best, pair], pieces.normal_y[best, pair])


def _along_body_normals(
    body: ConvexBody, poses: FloatArray, turn: tuple[FloatArray, FloatArray], pieces: ConvexPieces
) -> _Along:
    c, s = turn
    x, y = pieces.x - poses[:, 0], pieces.y - poses[:, 1]
    local_x, local_y = c * x + s * y, c * y - s * x  # (k, m)
    heights = body.normals[:, 0, None, None] * local_x + body.normals[:, 1, None, None] * local_y  # (v, k, m)
    gaps = heights.min(axis=1) - body.offsets[:, None]  # (v, m)
    best, pair = gaps.argmax(axis=0), np.arange(gaps.shape[1])
    normal_x, normal_y = body.normals[best].T
    return _Along(gaps[best, pair], s * normal_y - c * normal_x, -s * normal_x - c * normal_y)


def _along_nearest_vertices(
    at: _Corners, pieces: ConvexPieces, mine: _Corners | None = None, theirs: _Corners | None = None
) -> _Along:
    """Return the gap along the line through the nearest two vertices, of all or only of `mine` and `theirs`."""
    first, second = mine or at, theirs or _Corners(pieces.x, pieces.y)
    shape = (first.x.shape[0] * second.x.shape[0], first.x.shape[1])
    dx = (first.x[:, None] - second.x).reshape(shape)  # (v k, m)
    dy = (first.y[:, None] - second.y).reshape(shape)
    squared = dx * dx + dy * dy
    best, pair = squared.argmin(axis=0), np.arange(shape[1])
    length = np.sqrt(squared[best, pair])
    scale = 1.0 / np.maximum(length, 1e-300)
    x, y = dx[best, pair] * scale, dy[best, pair] * scale
    low = (x * at.x + y * at.y).min(axis=0)
    high = (x * pieces.x + y * pieces.y).max(axis=0)
    # Coinciding vertices define no axis and must never be preferred to the edge normals.
    return _Along(np.where(length > 1e-12, low - high, -np.inf), x, y)
