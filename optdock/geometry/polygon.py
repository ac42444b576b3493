"""Simple polygons: orientation, convexity and decomposition into convex pieces."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from optdock.errors import InvalidValue
from optdock.geometry.arrays import frozen_array, readonly

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from optdock.geometry.arrays import FloatArray

__all__ = ["convex_pieces", "edge_normals", "is_convex", "signed_area", "simple_polygon"]

_Point: TypeAlias = "tuple[float, float]"
_Ring: TypeAlias = "list[_Point]"
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
    pieces = _merge_convex([_oriented(np.asarray(triangle.exterior.coords)[:-1]) for triangle in triangles])
    return tuple(readonly(np.array(piece)) for piece in pieces)


def _oriented(points: FloatArray) -> _Ring:
    return [(float(x), float(y)) for x, y in (points if signed_area(points) > 0.0 else points[::-1])]


def _merge_convex(rings: list[_Ring]) -> list[_Ring]:
    """Join triangles over every diagonal that no corner needs; a diagonal once needed stays so, one pass is enough."""
    pieces = dict(enumerate(rings))
    owner = {edge: i for i, ring in pieces.items() for edge in _edges(ring)}
    for a, b in [edge for edge in owner if edge < edge[::-1]]:
        first, second = owner[a, b], owner.get((b, a), owner[a, b])
        union = _joined(pieces[first], pieces[second], (a, b)) if first != second else None
        if union is not None and is_convex(np.array(union)):
            del pieces[second]
            pieces[first] = union
            owner.update(dict.fromkeys(_edges(union), first))
    return list(pieces.values())


def _edges(ring: _Ring) -> list[tuple[_Point, _Point]]:
    return list(zip(ring, ring[1:] + ring[:1], strict=True))


def _joined(first: _Ring, second: _Ring, edge: tuple[_Point, _Point]) -> _Ring:
    """The union over an edge that runs from a to b in the first ring and from b to a in the second."""
    i, j = first.index(edge[1]), second.index(edge[0])
    return first[i:] + first[:i] + (second[j:] + second[:j])[1:-1]
