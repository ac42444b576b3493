"""Choice of the axis that separates a swept footprint from an obstacle best.

Arrays hold one pair per column, so that every reduction runs over contiguous memory.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from optdock.geometry.arrays import BoolArray, FloatArray, IntArray

__all__ = ["Points", "best_axes", "chords"]

_MAX_LOWEST = 8  # vertices that can carry the lower side of a hull
_PAIRS = {count: np.triu_indices(count, 1) for count in range(2, _MAX_LOWEST + 1)}


class Points(NamedTuple):
    """Points or directions, one column per pair: x and y, Shape (k, p) each."""

    x: FloatArray
    y: FloatArray

    def columns(self, chosen: IntArray | BoolArray) -> Points:
        """The chosen pairs."""
        return Points(self.x[:, chosen], self.y[:, chosen])

    def along(self, axis: Points) -> FloatArray:
        """Heights along one axis per pair, Shape (1, p). Shape (k, p)."""
        heights: FloatArray = axis.x * self.x + axis.y * self.y
        return heights

    def across(self, axis: Points) -> FloatArray:
        """Coordinates along the axis turned left by 90 degrees. Shape (k, p)."""
        coordinates: FloatArray = axis.x * self.y - axis.y * self.x
        return coordinates

    def at(self, row: IntArray) -> Points:
        """One point per pair. Shape (1, p)."""
        columns = np.arange(row.size)
        return Points(self.x[row, columns][None], self.y[row, columns][None])


def best_axes(hull: Points, outline: Points, normals: Points, inward: Points) -> Points:
    """Unit axes, obstacle to robot, with the largest separation among the usual candidates. Shape (1, p).

    Candidates: obstacle edge normals, body edge normals at the left node, the direction between the closest vertices,
    the normals of the closest vertex' chord, and then the normal of the hull's edge over the obstacle's support point.
    Without that last one the predicted and the found separation differ to first order.

    Args:
        hull: Swept vertices, those of the left node first, Shape (2v, p).
        outline: Obstacle vertices, Shape (k, p).
        normals: Outward obstacle edge normals, Shape (k, p).
        inward: Inward body edge normals at the left node, Shape (v, p).
    """
    closest, chord = _vertex_axes(hull, outline, normals)
    axes = Points(
        np.concatenate((normals.x, inward.x, closest.x, chord.x, -chord.x)),
        np.concatenate((normals.y, inward.y, closest.y, chord.y, -chord.y)),
    )
    gaps = _gaps(axes, hull, outline)
    best = np.argmax(gaps, axis=0)
    return _refined(axes.at(best), gaps[best, np.arange(best.size)], hull, outline)


def _gaps(axes: Points, hull: Points, outline: Points) -> FloatArray:
    """Separation along every axis. Shape (a, p)."""
    low = (axes.x * hull.x[:, None] + axes.y * hull.y[:, None]).min(axis=0)
    top = (axes.x * outline.x[:, None] + axes.y * outline.y[:, None]).max(axis=0)
    gaps: FloatArray = low - top
    return gaps


def _vertex_axes(hull: Points, outline: Points, fallback: Points) -> tuple[Points, Points]:
    """Direction between the closest vertices, and a normal of the closest vertex' chord. Shape (1, p)."""
    dx = (hull.x[:, None] - outline.x).reshape(hull.x.shape[0] * outline.x.shape[0], hull.x.shape[1])
    dy = (hull.y[:, None] - outline.y).reshape(dx.shape)
    best = np.argmin(dx * dx + dy * dy, axis=0)
    count = hull.x.shape[0]
    vertex = best // outline.x.shape[0]
    here, there = hull.at(vertex), hull.at((vertex + count // 2) % count)
    safe = Points(fallback.x[:1], fallback.y[:1])
    return _unit(Points(dx, dy).at(best), safe), _unit(Points(here.y - there.y, there.x - here.x), safe)


def _unit(vectors: Points, fallback: Points) -> Points:
    """Vectors scaled to length 1; the fallback where they are too short to point anywhere."""
    length = np.hypot(vectors.x, vectors.y)
    short = length < 1e-9
    if not short.any():
        return Points(vectors.x / length, vectors.y / length)
    length = np.where(short, 1.0, length)
    return Points(np.where(short, fallback.x, vectors.x / length), np.where(short, fallback.y, vectors.y / length))


class Chords(NamedTuple):
    """Chords between the vertices of every hull that can carry its lower side, from left to right; Shape (c, p) each.

    `first`, `second`: vertex indices. `along`, `height`: of the first. `run`, `rise`: to the second, run >= 0.
    """

    first: IntArray
    second: IntArray
    along: FloatArray
    height: FloatArray
    run: FloatArray
    rise: FloatArray

    def levels(self, place: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Share of the second vertex at tangent coordinates `place`, and whether the chord spans it."""
        usable = self.run > 1e-12
        share = (place - self.along) / np.where(usable, self.run, 1.0)
        return share, usable & (share >= -1e-9) & (share <= 1.0 + 1e-9)


def chords(along: FloatArray, height: FloatArray) -> Chords:
    """All chords between points at tangent coordinates `along`, Shape (k, p); of many points only the lowest count."""
    columns = np.arange(along.shape[1])
    if along.shape[0] > _MAX_LOWEST:
        lowest = np.argmin(height, axis=0)
        tilted = height - 0.35 * np.abs(along - along[lowest, columns])
        kept = np.argpartition(tilted, _MAX_LOWEST, axis=0)[:_MAX_LOWEST]
        order = np.take_along_axis(kept, np.argsort(np.take_along_axis(along, kept, axis=0), axis=0), axis=0)
    else:
        order = np.argsort(along, axis=0)
    along, height = along[order, columns], height[order, columns]
    a, b = _PAIRS[len(order)]
    return Chords(order[a], order[b], along[a], height[a], along[b] - along[a], height[b] - height[a])


def _refined(axis: Points, gap: FloatArray, hull: Points, outline: Points) -> Points:
    """The normal of the hull's lower edge over the obstacle's support point, where that separates better."""
    support = outline.at(np.argmax(outline.along(axis), axis=0))
    lines = chords(hull.across(axis), hull.along(axis))
    share, spans = lines.levels(support.across(axis))
    level = np.where(spans, lines.height + share * lines.rise, np.inf)
    best, columns = np.argmin(level, axis=0), np.arange(gap.size)
    edge_run, edge_rise = lines.run[best, columns], lines.rise[best, columns]
    found = np.isfinite(level[best, columns])
    length = np.where(found, np.hypot(edge_run, edge_rise), 1.0)
    # In the frame (tangent, axis) the edge runs along (run, rise): its upward normal is (-rise, run).
    a, b = edge_run / length, edge_rise / length
    edge = Points(a * axis.x + b * axis.y, a * axis.y - b * axis.x)
    better = found & (_gaps(edge, hull, outline)[0] > gap)
    return Points(np.where(better, edge.x, axis.x), np.where(better, edge.y, axis.y))
