"""An obstacle of a scene, with values that are computed once as long as its polygon does not change."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from optdock.geometry.arrays import FrozenArrays, digest, readonly
from optdock.geometry.polygon import convex_pieces, simple_polygon

if TYPE_CHECKING:
    from numpy.typing import ArrayLike
    from shapely.geometry.base import BaseGeometry

    from optdock.geometry.arrays import FloatArray

__all__ = ["EditedObstacle", "disc_of"]


@dataclass(frozen=True, eq=False)
class EditedObstacle(FrozenArrays):
    """A simple polygon; scenes that follow each other share the obstacles that have not changed.

    Args:
        vertices: Result of `simple_polygon`, Shape (n, 2) [m].
    """

    vertices: FloatArray

    @classmethod
    def of(cls, polygon: ArrayLike, row: int) -> EditedObstacle:
        """Return the obstacle number `row` with a polygon, Shape (n, 2) [m].

        Raises:
            InvalidValue: If the polygon is not simple; the message names the obstacle.
        """
        return cls(simple_polygon(polygon, f"obstacles[{row}]"))

    @functools.cached_property
    def pieces(self) -> tuple[FloatArray, ...]:
        """Convex pieces, Shape (k, 2) [m] each."""
        return convex_pieces(self.vertices)

    @functools.cached_property
    def points(self) -> tuple[tuple[float, float], ...]:
        """The vertices as pairs."""
        return tuple((x, y) for x, y in self.vertices.tolist())

    @functools.cached_property
    def digest(self) -> str:
        """Digest of the vertices."""
        return digest(self.vertices)

    @functools.cached_property
    def longer_edges(self) -> FloatArray:
        """Length of the longer of the two edges at each vertex, Shape (n,) [m]."""
        edges = np.hypot(*(np.roll(self.vertices, -1, axis=0) - self.vertices).T)
        return readonly(np.maximum(edges, np.roll(edges, 1)))

    @functools.cached_property
    def shape(self) -> BaseGeometry:
        """The polygon for shapely."""
        import shapely

        return shapely.Polygon(self.vertices)

    @functools.cached_property
    def disc(self) -> tuple[float, float, float]:
        """A point inside, and the largest distance of the outline from it: x, y and radius [m]."""
        return disc_of(self.shape)


def disc_of(shape: BaseGeometry) -> tuple[float, float, float]:
    """Return a point inside a shape, and the largest distance of its outline from the point: x, y and radius [m]."""
    import shapely

    at = shapely.point_on_surface(shape)
    x, y = shapely.get_coordinates(at)[0].tolist()
    return x, y, float(shapely.hausdorff_distance(at, shape))
