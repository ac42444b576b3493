"""Exact signed distance between convex polygons, for many pairs at once, with the axis that proves it.

For convex sets A and B every unit axis n gives a lower bound `min_A n.a - max_B n.b` of their signed distance, and
the best axis attains it ([Ericson2005] ch. 5.2). For polygons the best axis is an edge normal of either, or the
direction between two vertices; all of them are tried, so the distance is exact and the axis is its proof.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.geometry.pose import transform_points

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray

__all__ = ["ConvexBody", "ConvexPieces", "Separation", "separation"]


_MAX_PRODUCTS = 1_000_000  # of vertices met with vertices in one go; bounds the memory


class ConvexBody(NamedTuple):
    """A convex polygon in its own frame: vertices (n, 2) [m], outward normals (n, 2), offsets (n,) [m]."""

    vertices: FloatArray
    normals: FloatArray
    offsets: FloatArray


class ConvexPieces(NamedTuple):
    """Convex polygons in the world, one per row: vertices (m, k, 2) [m], normals (m, k, 2), offsets (m, k) [m]."""

    vertices: FloatArray
    normals: FloatArray
    offsets: FloatArray


class Separation(NamedTuple):
    """Signed distance (m,) [m], negative by the penetration depth, and unit axis (m, 2) from obstacle to body."""

    distance: FloatArray
    axis: FloatArray


def separation(body: ConvexBody, poses: FloatArray, pieces: ConvexPieces) -> Separation:
    """Signed distance of the body at pose i to piece i, for every i.

    Args:
        body: The moving polygon.
        poses: Shape (m, 3) [m, m, rad].
        pieces: The obstacle of each row.
    """
    block = max(1, _MAX_PRODUCTS // (len(body.vertices) * pieces.vertices.shape[1]))
    if len(poses) > block:
        rows = [slice(i, i + block) for i in range(0, len(poses), block)]
        parts = [separation(body, poses[one], ConvexPieces(*(column[one] for column in pieces))) for one in rows]
        return Separation(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))
    vertices = transform_points(poses, body.vertices)  # (m, v, 2)
    of_piece = _along_piece_normals(vertices, pieces)
    of_body = _along_body_normals(body, poses, pieces)
    of_vertices = _along_nearest_vertices(vertices, pieces.vertices)
    return _best(_best(of_piece, of_body), of_vertices)


def _best(first: Separation, second: Separation) -> Separation:
    better = second.distance > first.distance
    return Separation(
        np.where(better, second.distance, first.distance), np.where(better[:, None], second.axis, first.axis)
    )


def _along_piece_normals(vertices: FloatArray, pieces: ConvexPieces) -> Separation:
    normals = pieces.normals
    heights = normals[..., 0, None] * vertices[:, None, :, 0] + normals[..., 1, None] * vertices[:, None, :, 1]
    gaps = heights.min(axis=2) - pieces.offsets  # (m, k)
    rows, best = np.arange(gaps.shape[0]), np.argmax(gaps, axis=1)
    return Separation(gaps[rows, best], normals[rows, best])


def _along_body_normals(body: ConvexBody, poses: FloatArray, pieces: ConvexPieces) -> Separation:
    c, s = np.cos(poses[:, 2, None]), np.sin(poses[:, 2, None])
    x, y = pieces.vertices[..., 0] - poses[:, 0, None], pieces.vertices[..., 1] - poses[:, 1, None]
    local_x, local_y = c * x + s * y, c * y - s * x  # (m, k)
    heights = body.normals[:, 0, None] * local_x[:, None, :] + body.normals[:, 1, None] * local_y[:, None, :]
    gaps = heights.min(axis=2) - body.offsets  # (m, v)
    rows, best = np.arange(gaps.shape[0]), np.argmax(gaps, axis=1)
    normal = body.normals[best]
    axis = -np.column_stack(
        (c[:, 0] * normal[:, 0] - s[:, 0] * normal[:, 1], s[:, 0] * normal[:, 0] + c[:, 0] * normal[:, 1])
    )
    return Separation(gaps[rows, best], axis)


def _along_nearest_vertices(vertices: FloatArray, corners: FloatArray) -> Separation:
    dx = vertices[:, :, None, 0] - corners[:, None, :, 0]
    dy = vertices[:, :, None, 1] - corners[:, None, :, 1]  # (m, v, k)
    squared = (dx * dx + dy * dy).reshape(dx.shape[0], dx.shape[1] * dx.shape[2])
    rows, best = np.arange(squared.shape[0]), np.argmin(squared, axis=1)
    axis = np.column_stack((dx.reshape(squared.shape)[rows, best], dy.reshape(squared.shape)[rows, best]))
    length = np.sqrt(squared[rows, best])
    axis /= np.maximum(length, 1e-300)[:, None]
    low = (axis[:, 0, None] * vertices[..., 0] + axis[:, 1, None] * vertices[..., 1]).min(axis=1)
    high = (axis[:, 0, None] * corners[..., 0] + axis[:, 1, None] * corners[..., 1]).max(axis=1)
    # Coinciding vertices span no axis: they must never win against the edge normals.
    return Separation(np.where(length > 1e-12, low - high, -np.inf), axis)
