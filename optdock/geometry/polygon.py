"""Simple polygons: orientation, convexity and decomposition into convex pieces."""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from optdock.errors import InvalidValue
from optdock.geometry.arrays import frozen_array, readonly
from optdock.geometry.pose import FARTHEST

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike
    from shapely.geometry.base import BaseGeometry

    from optdock.geometry.arrays import BoolArray, FloatArray, IntArray

__all__ = [
    "convex_cover",
    "convex_pieces",
    "edge_normals",
    "edge_planes",
    "is_convex",
    "signed_area",
    "simple_polygon",
    "strictly_convex",
]

_Point: TypeAlias = "tuple[float, float]"
_Ring: TypeAlias = "list[_Point]"
_DENT = 1e-9  # [m]: a polygon with dents up to this depth counts as its hull; far below all tolerances
# Rounding of the sum of all turns, 2 pi around a simple polygon [rad]; area relative to the squared extent, below which
# `simple_polygon` decides what has no area.
_TURN, _NARROW = 1e-6, 1e-6


def signed_area(vertices: FloatArray) -> float:
    """Return the shoelace area [m^2], positive for counter-clockwise vertices, Shape (n, 2) [m].

    >>> signed_area(np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [0.0, 1.0]]))
    2.0
    """
    x, y = (vertices - vertices[0]).T
    next_x, next_y = (np.concatenate((values[1:], values[:1])) for values in (x, y))  # np.roll takes ten times as long
    return 0.5 * float(np.dot(x, next_y) - np.dot(y, next_x))


def is_convex(vertices: FloatArray) -> bool:
    """Whether counter-clockwise vertices form a simple polygon that is convex up to dents of at most a nanometre.

    Straight angles are allowed. The depth of a dent is measured from the convex hull of all vertices, so several
    shallow dents cannot add up to a deep one.
    """
    before, after = _edges_at(vertices)
    cross = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
    dot = np.sum(before * after, axis=1)
    if abs(float(np.sum(np.arctan2(cross, dot))) - 2.0 * np.pi) > _TURN or np.any((cross <= 0.0) & (dot < 0.0)):
        return False
    dents = cross < 0.0
    if not dents.any():
        return True
    across = before + after  # from the vertex before to the one after
    if np.any(-cross[dents] > _DENT * np.hypot(across[dents, 0], across[dents, 1])):
        return False
    return _depth_of_dents(vertices) <= _DENT


def _edges_at(vertices: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the edges before and after every vertex."""
    after = np.concatenate((vertices[1:], vertices[:1])) - vertices
    return np.concatenate((after[-1:], after[:-1])), after


def _hull_members(vertices: FloatArray) -> IntArray:
    """Return the ascending indices of the corners of the convex hull ([Andrew1979])."""
    points = vertices.tolist()
    order = sorted(range(len(points)), key=points.__getitem__)
    members: set[int] = set()
    for chain in (order, order[::-1]):
        kept: list[int] = []
        for i in chain:
            while len(kept) > 1 and _cross(points[kept[-2]], points[kept[-1]], points[i]) <= 0.0:
                kept.pop()
            kept.append(i)
        members.update(kept)
    return np.array(sorted(members))


def _cross(a: Sequence[float], b: Sequence[float], c: Sequence[float]) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def _depth_of_dents(vertices: FloatArray) -> float:
    """Return an upper bound of the depth of all dents: the largest distance of a vertex from its hull edge [m]."""
    corners = _hull_members(vertices)
    index = np.arange(len(vertices))
    nearest = np.searchsorted(corners, index, side="right") - 1
    first = vertices[corners[nearest]]
    edge = vertices[corners[(nearest + 1) % corners.size]] - first
    arm = vertices - first
    depth = (edge[:, 0] * arm[:, 1] - edge[:, 1] * arm[:, 0]) / np.hypot(edge[:, 0], edge[:, 1])
    return float(np.max(np.abs(depth)))


def simple_polygon(vertices: ArrayLike, name: str) -> FloatArray:
    """Return a checked, read-only polygon, counter-clockwise and without repeated vertices. Shape (n, 2) [m].

    Args:
        vertices: Shape (n, 2) [m], either orientation, open or closed.
        name: Name of the polygon in error messages.

    Raises:
        InvalidValue: If there are fewer than three distinct vertices, no area, edges that cross or touch, NaN, or
            coordinates beyond 1e8 m.
    """
    points = frozen_array(vertices, name, columns=2)
    if points.size and np.max(np.abs(points)) > FARTHEST:
        raise InvalidValue(f"{name}: coordinates must be within +-{FARTHEST:g} m, got {np.max(np.abs(points)):g}")
    if points.shape[0]:
        points = points[np.any(points != np.roll(points, 1, axis=0), axis=1)]
    if points.shape[0] < 3:
        raise InvalidValue(f"{name}: a polygon needs at least 3 distinct vertices, got {points.shape[0]}")
    if signed_area(points) < 0.0:
        points = points[::-1]
    smallest = 1e-12 * float(np.max(np.ptp(points, axis=0))) ** 2
    arms = points - points[0]
    far = arms[np.argmax(np.sum(arms**2, axis=1))]
    is_straight = np.max(np.abs(far[0] * arms[:, 1] - far[1] * arms[:, 0])) <= smallest
    if not (is_straight or is_convex(points)):
        import shapely

        polygon = shapely.Polygon(points)
        if not shapely.is_valid(polygon):
            raise InvalidValue(f"{name}: must not cross or touch itself: {shapely.is_valid_reason(polygon)}")
    if is_straight or signed_area(points) <= smallest:
        raise InvalidValue(f"{name}: the polygon has no area")
    return readonly(np.ascontiguousarray(points))


def strictly_convex(polygons: Sequence[ArrayLike]) -> list[FloatArray | None]:
    """Return every valid polygon that is convex without straight angles, counter-clockwise, and None for all others.

    The polygons are those that `simple_polygon` and `convex_pieces` return, but all polygons with the same number of
    vertices are checked at once, which takes a twentieth of the time.
    """
    alike = defaultdict[int, list[int]](list)
    arrays = [_numbers(polygon) for polygon in polygons]
    for i, array in enumerate(arrays):
        if array is not None:
            alike[len(array)].append(i)
    found: list[FloatArray | None] = [None] * len(arrays)
    for rows in alike.values():
        vertices, accepted = _counter_clockwise(np.array([arrays[i] for i in rows], dtype=np.float64))
        for k in np.flatnonzero(accepted).tolist():
            found[rows[k]] = vertices[k]
    return found


def _numbers(polygon: ArrayLike) -> FloatArray | None:
    """Return numbers of Shape (n, 2), n >= 3, as an array, and None for anything else.

    The first vertex is left out if it is the last one too, and vertices that repeat the last one are left out.
    """
    try:
        array = np.asarray(polygon)
    except (TypeError, ValueError):
        return None
    if array.dtype.kind not in "iuf" or array.ndim != 2 or array.shape[1] != 2 or array.shape[0] < 3:
        return None
    points = array.tolist()
    first, end = int(points[0] == points[-1]), len(points)
    while end > 3 and points[end - 1] == points[end - 2]:
        end -= 1
    return array[first:end] if end - first >= 3 else None


def _counter_clockwise(vertices: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Return polygons, Shape (k, n, 2), counter-clockwise, and whether each is certainly valid and strictly convex."""
    with np.errstate(over="ignore", invalid="ignore"):
        arms = vertices - vertices[:, :1]
        area = 0.5 * np.sum(arms[:, :-1, 0] * arms[:, 1:, 1] - arms[:, :-1, 1] * arms[:, 1:, 0], axis=1)
        vertices = np.where(area[:, None, None] < 0.0, vertices[:, ::-1], vertices)
        after = np.roll(vertices, -1, axis=1) - vertices
        before = np.roll(after, 1, axis=1)
        cross = before[..., 0] * after[..., 1] - before[..., 1] * after[..., 0]
        turned = np.sum(np.arctan2(cross, np.sum(before * after, axis=2)), axis=1)
        extent = np.max(np.ptp(vertices, axis=1), axis=1)
        is_bounded = np.max(np.abs(vertices), axis=(1, 2)) <= FARTHEST  # not NaN
        is_convex = np.all(cross > 0.0, axis=1) & (np.abs(turned - 2.0 * np.pi) <= _TURN)
        return vertices, is_bounded & is_convex & (np.abs(area) > _NARROW * extent**2)


def edge_normals(vertices: FloatArray) -> FloatArray:
    """Return the outward unit normals of counter-clockwise edges (edge i starts at vertex i). Shape (..., n, 2).

    An edge of length zero, which results from padding, has the normal of the previous edge. If rounding has reduced a
    polygon to a point, its normals are arbitrary.
    """
    edges = np.roll(vertices, -1, axis=-2) - vertices
    size = np.max(np.abs(edges), axis=-1)
    count = vertices.shape[-2]
    # The edge before the first one is the last one, so an empty first edge needs a second pass.
    again = range(count) if count and np.any(size[..., 0] <= 0.0) else range(0)
    for i in (*range(1, count), *again):
        empty = size[..., i] <= 0.0
        edges[..., i, :] = np.where(empty[..., None], edges[..., i - 1, :], edges[..., i, :])
        size[..., i] = np.where(empty, size[..., i - 1], size[..., i])
    if len(again):
        edges, size = np.where(size[..., None] > 0.0, edges, 1.0), np.where(size > 0.0, size, 1.0)
    edges = edges / size[..., None]  # first scaled, because the length of a denormal edge has too few digits
    length = np.hypot(edges[..., 0], edges[..., 1])
    normals: FloatArray = np.stack((edges[..., 1], -edges[..., 0]), axis=-1) / length[..., None]
    return normals


def edge_planes(vertices: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the outward unit normals, Shape (..., n, 2), and the support of the polygon along each, Shape (..., n).

    The support is computed from all vertices and not only from the edge, so no part of the polygon is beyond any of the
    planes, even with dents or rounded normals.
    """
    normals = edge_normals(vertices)
    reach = np.full(vertices.shape[:-1], -np.inf)
    for i in range(vertices.shape[-2]):
        corner = vertices[..., i : i + 1, :]
        np.maximum(reach, np.sum(normals * corner, axis=-1), out=reach)
    return normals, reach


def convex_pieces(vertices: FloatArray) -> tuple[FloatArray, ...]:
    """Decompose a simple counter-clockwise polygon into convex counter-clockwise pieces that cover it.

    Dents are filled, so the pieces may exceed the polygon by up to a nanometre. Constrained Delaunay triangles are
    merged over shared edges while the union stays convex ([Hertel1983]: at most four times the minimum number of
    pieces).
    """
    if is_convex(vertices):
        return (_without_dents(vertices),)
    import shapely

    return convex_cover(shapely.Polygon(vertices))


def convex_cover(shape: BaseGeometry) -> tuple[FloatArray, ...]:
    """Return convex counter-clockwise pieces that cover a shapely polygon or multipolygon; holes are allowed."""
    import shapely

    triangles = shapely.constrained_delaunay_triangles(shape).geoms
    pieces = _merge_convex([_oriented(np.asarray(triangle.exterior.coords)[:-1]) for triangle in triangles])
    return tuple(_without_dents(np.array(piece)) for piece in pieces)


def _without_dents(vertices: FloatArray) -> FloatArray:
    """Return the hull of a polygon that is convex up to dents; a polygon without dents keeps its straight angles."""
    before, after = _edges_at(vertices)
    if np.all(before[:, 0] * after[:, 1] >= before[:, 1] * after[:, 0]):
        return readonly(np.array(vertices))
    return readonly(vertices[_hull_members(vertices)])


def _oriented(points: FloatArray) -> _Ring:
    return [(float(x), float(y)) for x, y in (points if signed_area(points) > 0.0 else points[::-1])]


def _merge_convex(rings: list[_Ring]) -> list[_Ring]:
    """Merge triangles over every diagonal whose removal gives a convex piece, in a single pass."""
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
    """Return the union of two rings over an edge, which runs from a to b in the first and from b to a in the second."""
    i, j = first.index(edge[1]), second.index(edge[0])
    return first[i:] + first[:i] + (second[j:] + second[:j])[1:-1]
