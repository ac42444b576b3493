"""Choice of the axis that separates a swept footprint from an obstacle best.

Arrays hold one pair per column, so that every reduction runs over contiguous memory.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from optdock.geometry.arrays import BoolArray, FloatArray, IntArray

__all__ = ["Points", "best_axes", "lowest_points", "turned_normals"]

_MAX_LOWEST = 8  # vertices that can carry the lower side of a hull


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

    Candidates: obstacle edge normals, body edge normals at both nodes, the direction between the closest vertices, the
    normals of the closest vertex' chord, and then the normal of the hull's edge over the obstacle's support point.
    Without that last one the predicted and the found separation differ to first order.

    Args:
        hull: Swept vertices, those of the left node first, Shape (2v, p).
        outline: Obstacle vertices, Shape (k, p).
        normals: Outward obstacle edge normals, Shape (k, p).
        inward: Inward body edge normals at both nodes, Shape (2v, p).
    """
    closest, chord = _vertex_axes(hull, outline, normals)
    axes = Points(
        np.concatenate((normals.x, inward.x, closest.x, chord.x, -chord.x)),
        np.concatenate((normals.y, inward.y, closest.y, chord.y, -chord.y)),
    )
    gaps = _gaps(axes, hull, outline)
    best = np.argmax(gaps, axis=0)
    return _refined(axes.at(best), gaps[best, np.arange(best.size)], hull, outline)


def turned_normals(body: Points, yaw: FloatArray) -> Points:
    """Inward body normals in the world; `body` holds outward ones. Shape (v, p)."""
    c, s = np.cos(yaw), np.sin(yaw)
    return Points(s * body.y - c * body.x, -s * body.x - c * body.y)


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


def lowest_points(along: FloatArray, height: FloatArray) -> IntArray | None:
    """Indices of the vertices that can carry the lower side of every hull, Shape (8, p); None for all."""
    if along.shape[0] <= _MAX_LOWEST:
        return None
    lowest = np.argmin(height, axis=0)
    tilted = height - 0.35 * np.abs(along - along[lowest, np.arange(lowest.size)])
    chosen: IntArray = np.argpartition(tilted, _MAX_LOWEST, axis=0)[:_MAX_LOWEST]
    return chosen


def _refined(axis: Points, gap: FloatArray, hull: Points, outline: Points) -> Points:
    """The normal of the hull's lower edge over the obstacle's support point, where that separates better."""
    support = outline.at(np.argmax(outline.along(axis), axis=0))
    place = support.across(axis)
    along, height = hull.across(axis), hull.along(axis)
    kept = lowest_points(along, height)
    if kept is not None:
        along, height = np.take_along_axis(along, kept, axis=0), np.take_along_axis(height, kept, axis=0)
    run, rise = along - along[:, None], height - height[:, None]  # from first to second index
    usable = run > 1e-12
    share = (place - along)[:, None] / np.where(usable, run, 1.0)
    spans = usable & (share >= 0.0) & (share <= 1.0)
    level = np.where(spans, height[:, None] + share * rise, np.inf).reshape(len(along) ** 2, gap.size)
    best = np.argmin(level, axis=0)
    columns = np.arange(best.size)
    edge_run, edge_rise = run.reshape(level.shape)[best, columns], rise.reshape(level.shape)[best, columns]
    found = np.isfinite(level[best, columns])
    length = np.where(found, np.hypot(edge_run, edge_rise), 1.0)
    # In the frame (tangent, axis) the edge runs along (run, rise): its upward normal is (-rise, run).
    a, b = edge_run / length, edge_rise / length
    edge = Points(a * axis.x + b * axis.y, a * axis.y - b * axis.x)
    better = found & (_gaps(edge, hull, outline)[0] > gap)
    return Points(np.where(better, edge.x, axis.x), np.where(better, edge.y, axis.y))
