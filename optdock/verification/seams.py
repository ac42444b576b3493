"""The convex pieces of a footprint, and what holds them together.

Pieces that only meet leave a seam: an obstacle of a micrometre on it overlaps either piece by half a micrometre,
although it lies deep inside the footprint. So every seam is covered by a kite that reaches into both pieces.
"""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING

import numpy as np

from optdock.geometry.footprint import convex_body

if TYPE_CHECKING:
    from collections.abc import Iterator

    from optdock.geometry.arrays import FloatArray
    from optdock.geometry.footprint import Footprint
    from optdock.geometry.separation import ConvexBody

__all__ = ["joined_bodies"]


@functools.lru_cache(maxsize=64)
def joined_bodies(footprint: Footprint) -> tuple[ConvexBody, ...]:
    """The footprint's convex pieces and a kite over each of their seams; together they cover exactly the footprint."""
    return (*footprint.bodies, *(convex_body(kite) for kite in _kites(footprint.bodies)))


def _kites(bodies: tuple[ConvexBody, ...]) -> Iterator[FloatArray]:
    """Counter-clockwise quadrilaterals whose one diagonal is a seam and the other crosses it in the middle."""
    owner = {
        (tuple(a), tuple(b)): body.vertices
        for body in bodies
        for a, b in zip(body.vertices.tolist(), np.roll(body.vertices, -1, axis=0).tolist(), strict=True)
    }
    for (a, b), left in owner.items():
        right = owner.get((b, a))
        if right is not None and a < b:
            first, second = np.array(a), np.array(b)
            yield np.array([a, _into(right, second, first), b, _into(left, first, second)])


def _into(piece: FloatArray, a: FloatArray, b: FloatArray) -> FloatArray:
    """The furthest point at right angles to edge a-b from its middle, in the triangle with the piece's centre."""
    edge, arm = b - a, piece.mean(axis=0) - a
    squared = float(edge @ edge)
    along = float(edge @ arm) / squared
    height = float(edge[0] * arm[1] - edge[1] * arm[0]) / squared
    point: FloatArray = 0.5 * (a + b) + 0.5 * height / max(along, 1.0 - along) * np.array([-edge[1], edge[0]])
    return point
