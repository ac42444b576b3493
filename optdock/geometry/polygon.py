"""Simple polygons: orientation, convexity and decomposition into convex pieces."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

import numpy as np

from optdock.errors import InvalidValue
from optdock.geometry.arrays import frozen_array, readonly

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from optdock.geometry.arrays import FloatArray

__all__ = ["convex_pieces", "edge_normals", "is_convex", "signed_area", "simple_polygon"]

_MERGE_EPS = 1e-12
_FARTHEST = 1e8  # [m]: beyond it squares overflow or millimetres vanish; no map on earth is that large


def signed_area(vertices: FloatArray) -> float:
    """Shoelace area [m^2], positive when the vertices run counter-clockwise. Shape (n, 2) [m].

    >>> signed_area(np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [0.0, 1.0]]))
    2.0
    """
    x, y = (vertices - vertices[0]).T
    return 0.5 * float(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1)))


def _turns(vertices: FloatArray) -> FloatArray:
    """Cross product of the edges before and after every vertex."""
    before = vertices - np.roll(vertices, 1, axis=0)
    after = np.roll(vertices, -1, axis=0) - vertices
    turns: FloatArray = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
    return turns


def is_convex(vertices: FloatArray) -> bool:
    """Whether counter-clockwise vertices form a simple convex polygon (straight angles allowed)."""
    edges = np.roll(vertices, -1, axis=0) - vertices
    scale = float(np.max(np.sum(edges**2, axis=1)))
    if np.any(_turns(vertices) < -1e-12 * scale):
        return False
    heading = np.arctan2(edges[:, 1], edges[:, 0])
    turned = np.sum(np.mod(np.roll(heading, -1) - heading + 1e-9, 2.0 * np.pi) - 1e-9)
    return bool(abs(turned - 2.0 * np.pi) < 1e-6)


def simple_polygon(vertices: ArrayLike, name: str) -> FloatArray:
    """A checked polygon: counter-clockwise, without repeated vertices, read-only. Shape (n, 2) [m].

    Args:
        vertices: Shape (n, 2) [m], either orientation, not closed or closed.
        name: What the polygon is called in error messages.

    Raises:
        InvalidValue: Fewer than three distinct vertices, no area, edges that cross or touch, NaN, beyond 1e8 m.
    """
    points = frozen_array(vertices, name, columns=2)
    if points.size and np.max(np.abs(points)) > _FARTHEST:
        raise InvalidValue(f"{name}: coordinates must be within +-{_FARTHEST:g} m, got {np.max(np.abs(points)):g}")
    if points.shape[0]:
        points = points[np.any(points != np.roll(points, 1, axis=0), axis=1)]
    if points.shape[0] < 3:
        raise InvalidValue(f"{name}: a polygon needs at least 3 distinct vertices, got {points.shape[0]}")
    if signed_area(points) < 0.0:
        points = points[::-1]
    extent = float(np.max(np.ptp(points, axis=0)))
    if not is_convex(points):
        _check_simple(points, name)
    if signed_area(points) <= 1e-12 * extent**2:
        raise InvalidValue(f"{name}: the polygon has no area")
    return readonly(np.ascontiguousarray(points))


def _check_simple(points: FloatArray, name: str) -> None:
    import shapely

    polygon = shapely.Polygon(points)
    if not shapely.is_valid(polygon):
        raise InvalidValue(f"{name}: must not cross or touch itself: {shapely.is_valid_reason(polygon)}")


def edge_normals(vertices: FloatArray) -> FloatArray:
    """Outward unit normals of counter-clockwise edges (edge i starts at vertex i). Shape (..., n, 2).

    An edge of length zero, as padding makes, takes the normal of the edge before it.
    """
    edges = np.roll(vertices, -1, axis=-2) - vertices
    length = np.hypot(edges[..., 0], edges[..., 1])
    for i in range(1, vertices.shape[-2]):
        empty = length[..., i] <= 0.0
        edges[..., i, :] = np.where(empty[..., None], edges[..., i - 1, :], edges[..., i, :])
        length[..., i] = np.where(empty, length[..., i - 1], length[..., i])
    normals: FloatArray = np.stack((edges[..., 1], -edges[..., 0]), axis=-1) / length[..., None]
    return normals


def convex_pieces(vertices: FloatArray) -> tuple[FloatArray, ...]:
    """A simple counter-clockwise polygon cut into convex counter-clockwise pieces that cover exactly it.

    Constrained Delaunay triangles, merged over shared edges while the union stays convex
    ([Hertel1983]: at most four times the minimum number of pieces).
    """
    if is_convex(vertices):
        return (vertices,)
    import shapely

    triangles = shapely.constrained_delaunay_triangles(shapely.Polygon(vertices)).geoms
    pieces = [_oriented(np.asarray(triangle.exterior.coords)[:-1]) for triangle in triangles]
    return tuple(readonly(np.ascontiguousarray(piece)) for piece in _merge_convex(pieces))


def _oriented(points: FloatArray) -> FloatArray:
    return points if signed_area(points) > 0.0 else points[::-1]


def _merge_convex(pieces: list[FloatArray]) -> list[FloatArray]:
    """Join pieces pairwise until no union is convex."""
    for i, j in itertools.combinations(range(len(pieces)), 2):
        union = _union_over_shared_edge(pieces[i], pieces[j])
        if union is not None and is_convex(union):
            rest = [piece for k, piece in enumerate(pieces) if k not in (i, j)]
            return _merge_convex([*rest, union])
    return pieces


def _union_over_shared_edge(first: FloatArray, second: FloatArray) -> FloatArray | None:
    """The two polygons joined over a common edge, or None where they share none."""
    for i in range(len(first)):
        a, b = first[i], first[(i + 1) % len(first)]
        for j in range(len(second)):
            c, d = second[j], second[(j + 1) % len(second)]
            if np.abs(a - d).max() <= _MERGE_EPS and np.abs(b - c).max() <= _MERGE_EPS:
                rest_first = np.roll(first, -(i + 1), axis=0)  # starts at b, ends at a
                rest_second = np.roll(second, -(j + 1), axis=0)[1:-1]  # between d and c
                return np.vstack((rest_first, rest_second))
    return None
