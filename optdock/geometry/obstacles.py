"""Obstacles as convex polygons, stored for vectorized queries."""

from __future__ import annotations

import functools
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from optdock.errors import InvalidValue
from optdock.geometry.arrays import FrozenArrays, digest, frozen_array, readonly
from optdock.geometry.lazy import cached_property
from optdock.geometry.polygon import convex_pieces, edge_planes, simple_polygon, strictly_convex
from optdock.geometry.pose import transform_points
from optdock.geometry.separation import ConvexPieces

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike

    from optdock.geometry.arrays import BoolArray, FloatArray, IntArray
    from optdock.geometry.footprint import Footprint
    from optdock.geometry.pose import Pose2

__all__ = ["ObstacleSet", "box_distance", "in_words", "without_repeated"]


@dataclass(frozen=True, eq=False, repr=False)
class ObstacleSet(FrozenArrays):
    """Convex counter-clockwise polygons, padded to one vertex count by repeating the last vertex.

    Sets are created by `empty`, `from_polygons`, `from_rectangles` or `from_footprint`, and joined with `+`.

    Args:
        vertices: Shape (m, k, 2) [m].
        names: Names of the groups that the pieces belong to, for messages.
        group: Shape (m,), index of the group of each piece in `names`.

    Attributes:
        normals: Shape (m, k, 2), outward unit normals of the edges.
        offsets: Shape (m, k) [m], support of the piece along each normal.
        lower: Shape (m, 2) [m], lower corner of each bounding box.
        upper: Shape (m, 2) [m], upper corner of each bounding box.

    Raises:
        InvalidValue: If shapes do not match, a vertex is not finite, or a group index has no name.
    """

    vertices: FloatArray
    names: tuple[str, ...]
    group: IntArray
    normals: FloatArray = field(init=False, repr=False)
    offsets: FloatArray = field(init=False, repr=False)
    lower: FloatArray = field(init=False, repr=False)
    upper: FloatArray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        vertices = np.array(self.vertices, dtype=np.float64)
        group = np.array(self.group, dtype=np.int64)
        if vertices.ndim != 3 or vertices.shape[1] < 3 or vertices.shape[2] != 2 or group.shape != vertices.shape[:1]:
            raise InvalidValue(
                f"obstacles: need vertices of shape (m, k >= 3, 2) and m groups, got {vertices.shape}, {group.shape}"
            )
        if not np.all(np.isfinite(vertices)):
            raise InvalidValue("obstacles.vertices: must be finite")
        if group.size and not 0 <= group.min() <= group.max() < len(self.names):
            raise InvalidValue(
                f"obstacles.group: must be in 0..{len(self.names) - 1}, got {group.min()}..{group.max()}"
            )
        normals, offsets = edge_planes(vertices)
        self._hold(
            vertices=vertices,
            names=tuple(self.names),
            group=group,
            normals=normals,
            offsets=offsets,
            lower=vertices.min(axis=1, initial=np.inf),
            upper=vertices.max(axis=1, initial=-np.inf),
        )

    def _hold(self, names: tuple[str, ...], **arrays: FloatArray | IntArray) -> ObstacleSet:
        """Set every field once; no other object may reference the arrays."""
        vars(self).update(names=names, **{name: readonly(value) for name, value in arrays.items()})
        return self

    @cached_property
    def digest(self) -> str:
        """Digest of the polygons in their order."""
        return digest(self.vertices)

    def __repr__(self) -> str:
        named = list(dict.fromkeys(self.names))
        more = f" and {len(named) - 4} more" if len(named) > 4 else ""
        return f"<ObstacleSet of {len(self)} convex pieces{': ' if named else ''}{', '.join(named[:4])}{more}>"

    def __len__(self) -> int:
        return int(self.vertices.shape[0])

    @classmethod
    def of(cls, obstacles: ObstacleSet | Iterable[ArrayLike], name: str = "obstacles") -> ObstacleSet:
        """Return an obstacle set unchanged, or convert simple polygons with `from_polygons`.

        Raises:
            InvalidValue: If the argument is neither a set nor a list of polygons, or if a polygon is invalid; the
                message names the polygon.
        """
        if isinstance(obstacles, cls):
            return obstacles
        if isinstance(obstacles, str | Mapping) or not isinstance(obstacles, Iterable):
            raise InvalidValue(f"{name}: must be an ObstacleSet or a list of polygons, got {type(obstacles).__name__}")
        return cls.from_polygons(obstacles, name)

    @classmethod
    @functools.cache
    def empty(cls) -> ObstacleSet:
        """Return the empty set, which is always the same object."""
        return cls(np.zeros((0, 3, 2)), (), np.zeros(0, dtype=np.int64))

    @classmethod
    def from_polygons(cls, polygons: Iterable[ArrayLike], name: str = "obstacles") -> ObstacleSet:
        """Return the set of simple polygons, convex or not, of either orientation; polygon i is named `name[i]`.

        Raises:
            InvalidValue: If a polygon has fewer than three vertices, no area, crossing edges or NaN.
        """
        given = [*polygons]
        parts = [
            convex_pieces(simple_polygon(polygon, f"{name}[{i}]")) if convex is None else (convex,)
            for i, (polygon, convex) in enumerate(zip(given, strictly_convex(given), strict=True))
        ]
        return cls.from_decomposed(parts, name)

    @classmethod
    def from_decomposed(cls, polygons: Iterable[Sequence[FloatArray]], name: str = "obstacles") -> ObstacleSet:
        """Return the set of polygons that are given by their `convex_pieces`; polygon i is named `name[i]`."""
        parts = [*polygons]
        pieces = [piece for part in parts for piece in part]
        group = np.repeat(np.arange(len(parts)), np.array([len(part) for part in parts], dtype=np.int64))
        return _padded(pieces, tuple(f"{name}[{i}]" for i in range(len(parts))), group)

    @classmethod
    def from_rectangles(cls, lower: FloatArray, upper: FloatArray, name: str) -> ObstacleSet:
        """Return axis-aligned rectangles from lower and upper corners, Shape (m, 2) [m] each, all named `name`.

        Raises:
            InvalidValue: If the numbers of corners differ, or an upper corner is not above its lower corner.
        """
        lower, upper = (frozen_array(corners, name, columns=2) for corners in (lower, upper))
        if lower.shape != upper.shape:
            raise InvalidValue(f"{name}: needs as many lower as upper corners, got {len(lower)}, {len(upper)}")
        if not np.all(upper > lower):
            raise InvalidValue(f"{name}: every rectangle needs upper > lower")
        x0, y0, x1, y1 = lower[:, 0], lower[:, 1], upper[:, 0], upper[:, 1]
        corners = (np.column_stack(pair) for pair in ((x0, y0), (x1, y0), (x1, y1), (x0, y1)))
        return cls(np.stack(tuple(corners), axis=1), (name,), np.zeros(len(lower), dtype=np.int64))

    @classmethod
    def from_footprint(cls, footprint: Footprint, pose: Pose2, name: str) -> ObstacleSet:
        """Return the convex pieces of a footprint at a pose, in one group `name`."""
        return cls.from_pieces(
            [transform_points(pose.as_array()[None], body.vertices)[0] for body in footprint.bodies], name
        )

    @classmethod
    def from_pieces(cls, pieces: Sequence[FloatArray], name: str) -> ObstacleSet:
        """Return convex counter-clockwise pieces, Shape (n, 2) [m] each, in one group `name`."""
        return _padded(pieces, (name,), np.zeros(len(pieces), dtype=np.int64))

    def __add__(self, other: ObstacleSet) -> ObstacleSet:
        width = max(self.vertices.shape[1], other.vertices.shape[1])
        vertices = np.concatenate((_widen(self.vertices, width), _widen(other.vertices, width)))
        return ObstacleSet(
            vertices, self.names + other.names, np.concatenate((self.group, other.group + len(self.names)))
        )

    def subset(self, rows: IntArray | BoolArray) -> ObstacleSet:
        """Return the pieces in `rows`, with their names."""
        parts = ("vertices", "group", "normals", "offsets", "lower", "upper")
        return object.__new__(ObstacleSet)._hold(self.names, **{part: getattr(self, part)[rows] for part in parts})

    def in_box(self, lower: FloatArray, upper: FloatArray) -> ObstacleSet:
        """Return the pieces whose bounding boxes intersect the box from `lower` to `upper`, Shape (2,) [m] each."""
        rows = self.rows_in_box(lower, upper)
        return self if rows.size == len(self) else self.subset(rows)

    def near(self, places: FloatArray, reach: float) -> ObstacleSet:
        """Return the pieces whose bounding boxes are within `reach` [m] of one of the points, Shape (n, 2) [m]."""
        some = self.in_box(places.min(axis=0) - reach, places.max(axis=0) + reach)
        if len(some) == 0:
            return some
        rows = np.flatnonzero(box_distance(some, places).min(axis=0) <= reach)
        return some if rows.size == len(some) else some.subset(rows)

    def rows_in_box(self, lower: FloatArray, upper: FloatArray) -> IntArray:
        """Return the rows of the pieces that `in_box` selects, in ascending order."""
        return ((self.lower <= upper) & (self.upper >= lower)).all(axis=1).nonzero()[0]

    def rows_at(self, points: FloatArray) -> IntArray:
        """Return the row of a piece that contains or touches each point, Shape (n, 2) [m], or -1. Shape (n,)."""
        found = np.full(len(points), -1)
        near = self.rows_in_box(points.min(axis=0), points.max(axis=0)) if len(points) else np.zeros(0, dtype=np.int64)
        for row in near.tolist():
            heights = points @ self.normals[row].T - self.offsets[row]
            found[np.all(heights <= 0.0, axis=1)] = row
        return found

    def name_of(self, row: int) -> str:
        """Return the name of piece `row`, as used in files; messages use `in_words` of the name."""
        return self.names[int(self.group[row])]

    def pieces(self, rows: IntArray) -> ConvexPieces:
        """Return the polygons of `rows`, in this order, in the form required by `separation`."""
        return ConvexPieces(*self._columns[:, :, rows])

    @cached_property
    def _columns(self) -> FloatArray:
        """Vertices, normals and offsets with the pieces along the last axis, Shape (5, k, m)."""
        parts = (self.vertices[..., 0], self.vertices[..., 1], self.normals[..., 0], self.normals[..., 1], self.offsets)
        return readonly(np.stack([np.ascontiguousarray(part.T) for part in parts]))


def _widen(vertices: FloatArray, width: int) -> FloatArray:
    """Repeat the last vertex until there are `width` vertices; from Shape (..., n, 2) to Shape (..., width, 2)."""
    missing = width - vertices.shape[-2]
    if missing == 0:
        return vertices
    return np.concatenate((vertices, np.repeat(vertices[..., -1:, :], missing, axis=-2)), axis=-2)


def in_words(name: str) -> str:
    """Return the name of an obstacle for a message; files and the error details `where` use the unchanged name.

    >>> in_words("unknown"), in_words("dock")
    ('unknown cells of the map', 'dock')
    """
    return "unknown cells of the map" if name == "unknown" else name


def _padded(pieces: Sequence[FloatArray], names: tuple[str, ...], group: IntArray) -> ObstacleSet:
    """Return the set of convex pieces, padded to the same number of vertices."""
    width = max((len(piece) for piece in pieces), default=3)
    stack = [_widen(piece, width) for piece in pieces]
    return ObstacleSet(np.stack(stack) if stack else np.zeros((0, width, 2)), names, group)


def without_repeated(obstacles: ObstacleSet) -> ObstacleSet:
    """Return the set without duplicate pieces; the first of equal pieces is kept."""
    _, first = np.unique(obstacles.vertices.reshape(len(obstacles), -1), axis=0, return_index=True)
    return obstacles if first.size == len(obstacles) else obstacles.subset(np.sort(first))


def box_distance(obstacles: ObstacleSet, points: FloatArray) -> FloatArray:
    """Return the distance from each point to the bounding box of each obstacle, Shape (n, m) [m].

    `points` has Shape (n, 2) [m].
    """
    x, y = points[:, :1], points[:, 1:]
    across = np.maximum(np.maximum(obstacles.lower[:, 0] - x, x - obstacles.upper[:, 0]), 0.0)
    along = np.maximum(np.maximum(obstacles.lower[:, 1] - y, y - obstacles.upper[:, 1]), 0.0)
    distance: FloatArray = np.sqrt(across * across + along * along)
    return distance
