"""Exact signed distance between convex polygons, for many pairs at once, with the separating axis.

For convex sets A and B every unit axis n gives a lower bound `min_A n.a - max_B n.b` of their signed distance, and the
best axis attains it ([Ericson2005] ch. 5.2). For polygons the best axis is an edge normal of either, or the direction
between two vertices. All of them are evaluated, so the distance is exact and the axis proves it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray, IntArray

__all__ = ["ConvexBody", "ConvexPieces", "Separation", "separation"]


_MAX_PRODUCTS = 1_000_000  # vertex pairs evaluated at once; bounds the memory


class ConvexBody(NamedTuple):
    """A convex polygon in its own frame: vertices (n, 2) [m], outward normals (n, 2), offsets (n,) [m]."""

    vertices: FloatArray
    normals: FloatArray
    offsets: FloatArray


class ConvexPieces(NamedTuple):
    """Convex polygons in the world, one per column, all Shape (k, m): vertices, outward normals and offsets [m].

    Pairs are along the last axis because reductions over few vertices are three times as fast in this layout.
    """

    x: FloatArray
    y: FloatArray
    normal_x: FloatArray
    normal_y: FloatArray
    offsets: FloatArray

    def columns(self, keep: slice | IntArray) -> ConvexPieces:
        """Return the polygons at `keep`."""
        return ConvexPieces(*(part[:, keep] for part in self))


class Separation(NamedTuple):
    """Signed distance (m,) [m], negative by the penetration depth, and unit axis (m, 2) from obstacle to body."""

    distance: FloatArray
    axis: FloatArray


def separation(body: ConvexBody, poses: FloatArray, pieces: ConvexPieces) -> Separation:
    """Return the signed distance of the body at pose i to piece i, for every i.

    Args:
        body: The moving polygon.
        poses: Shape (m, 3) [m, m, rad].
        pieces: The obstacle of each pose.
    """
    block = max(1, _MAX_PRODUCTS // (len(body.vertices) * len(pieces.x)))
    if len(poses) > block:
        spans = [slice(i, i + block) for i in range(0, len(poses), block)]
        parts = [separation(body, poses[one], pieces.columns(one)) for one in spans]
        return Separation(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))
    c, s = turn = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    x, y = body.vertices[:, :1], body.vertices[:, 1:]
    at = _Corners(poses[:, 0] + (c * x - s * y), poses[:, 1] + (s * x + c * y))
    best = _better(_along_piece_normals(at, pieces), _along_body_normals(body, poses, turn, pieces))
    best = _better(best, _along_nearest_vertices(at, pieces))
    return Separation(best.distance, np.column_stack((best.x, best.y)))


class _Corners(NamedTuple):
    """World coordinates of the body's vertices, Shape (v, m) [m]."""

    x: FloatArray
    y: FloatArray


class _Along(NamedTuple):
    """Distance and axis components, Shape (m,)."""

    distance: FloatArray
    x: FloatArray
    y: FloatArray


def _better(first: _Along, second: _Along) -> _Along:
    better = second.distance > first.distance
    return _Along(*(np.where(better, b, a) for a, b in zip(first, second, strict=True)))


def _along_piece_normals(at: _Corners, pieces: ConvexPieces) -> _Along:
    heights = pieces.normal_x[:, None] * at.x + pieces.normal_y[:, None] * at.y  # (k, v, m)
    gaps = heights.min(axis=1) - pieces.offsets  # (k, m)
    best, pair = np.argmax(gaps, axis=0), np.arange(gaps.shape[1])
    return _Along(gaps[best, pair], pieces.normal_x[best, pair], pieces.normal_y[best, pair])


def _along_body_normals(
    body: ConvexBody, poses: FloatArray, turn: tuple[FloatArray, FloatArray], pieces: ConvexPieces
) -> _Along:
    c, s = turn
    x, y = pieces.x - poses[:, 0], pieces.y - poses[:, 1]
    local_x, local_y = c * x + s * y, c * y - s * x  # (k, m)
    heights = body.normals[:, 0, None, None] * local_x + body.normals[:, 1, None, None] * local_y  # (v, k, m)
    gaps = heights.min(axis=1) - body.offsets[:, None]  # (v, m)
    best, pair = np.argmax(gaps, axis=0), np.arange(gaps.shape[1])
    normal_x, normal_y = body.normals[best].T
    return _Along(gaps[best, pair], s * normal_y - c * normal_x, -s * normal_x - c * normal_y)


def _along_nearest_vertices(at: _Corners, pieces: ConvexPieces) -> _Along:
    shape = (at.x.shape[0] * pieces.x.shape[0], at.x.shape[1])
    dx = (at.x[:, None] - pieces.x).reshape(shape)  # (v k, m)
    dy = (at.y[:, None] - pieces.y).reshape(shape)
    squared = dx * dx + dy * dy
    best, pair = np.argmin(squared, axis=0), np.arange(shape[1])
    length = np.sqrt(squared[best, pair])
    scale = 1.0 / np.maximum(length, 1e-300)
    x, y = dx[best, pair] * scale, dy[best, pair] * scale
    low = (x * at.x + y * at.y).min(axis=0)
    high = (x * pieces.x + y * pieces.y).max(axis=0)
    # Coinciding vertices define no axis and must never win against the edge normals.
    return _Along(np.where(length > 1e-12, low - high, -np.inf), x, y)
