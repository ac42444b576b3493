"""Choice of the axis that separates a swept footprint from an obstacle best."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray, IntArray
    from smoothers._ck.planes import Pairs
    from smoothers._ck.world import World

__all__ = ["best_axes", "lowest_points"]

_MAX_LOWEST = 8  # vertices that can carry the lower side of a hull


def best_axes(world: World, yaw: FloatArray, left: IntArray, pairs: Pairs, hull: FloatArray) -> FloatArray:
    """Unit axes, obstacle to robot, with the largest separation among the usual candidates. Shape (p, 2).

    Candidates: obstacle edge normals, body edge normals at both nodes, the direction between the closest vertices, the
    normals of the closest vertex' chord, and then the normal of the hull's edge over the obstacle's support point.
    Without that last one the predicted and the found separation differ to first order.
    """
    outline = world.obstacles.vertices[pairs.obstacle]
    normals = world.obstacles.normals[pairs.obstacle]
    closest, chord = _vertex_axes(hull, outline, normals)
    body = world.body.normals[pairs.part]
    axes = np.concatenate((normals, _turned(body, yaw[left]), _turned(body, yaw[left + 1]), closest, chord), axis=1)
    low = axes[..., 0, None] * hull[:, None, :, 0] + axes[..., 1, None] * hull[:, None, :, 1]
    top = axes[..., 0, None] * outline[:, None, :, 0] + axes[..., 1, None] * outline[:, None, :, 1]
    gaps = low.min(axis=2) - top.max(axis=2)
    rows, best = np.arange(len(gaps)), np.argmax(gaps, axis=1)
    return _refined(axes[rows, best], gaps[rows, best], hull, outline)


def _turned(normals: FloatArray, yaw: FloatArray) -> FloatArray:
    """Inward body normals in the world. Shape (p, v, 2)."""
    c, s = np.cos(yaw)[:, None], np.sin(yaw)[:, None]
    x, y = normals[..., 0], normals[..., 1]
    return np.stack((s * y - c * x, -s * x - c * y), axis=-1)


def _vertex_axes(hull: FloatArray, outline: FloatArray, fallback: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Direction between the closest vertices, (p, 1, 2), and both normals of the closest vertex' chord, (p, 2, 2)."""
    dx = hull[:, :, None, 0] - outline[:, None, :, 0]
    dy = hull[:, :, None, 1] - outline[:, None, :, 1]
    squared = (dx * dx + dy * dy).reshape(len(hull), hull.shape[1] * outline.shape[1])
    rows, best = np.arange(len(hull)), np.argmin(squared, axis=1)
    vertex = best // outline.shape[1]
    direct = np.column_stack((dx.reshape(squared.shape)[rows, best], dy.reshape(squared.shape)[rows, best]))
    other = (vertex + hull.shape[1] // 2) % hull.shape[1]
    along = hull[rows, other] - hull[rows, vertex]
    across = np.column_stack((-along[:, 1], along[:, 0]))
    direct, across = _unit(direct, fallback[:, 0]), _unit(across, fallback[:, 0])
    return direct[:, None], np.stack((across, -across), axis=1)


def _unit(vectors: FloatArray, fallback: FloatArray) -> FloatArray:
    """Vectors scaled to length 1; the fallback where they are too short to point anywhere."""
    length = np.hypot(vectors[:, 0], vectors[:, 1])
    short = length < 1e-9
    return np.where(short[:, None], fallback, vectors / np.where(short, 1.0, length)[:, None])


def lowest_points(along: FloatArray, height: FloatArray) -> IntArray:
    """Indices of the vertices that can carry the lower side of every hull, Shape (p, at most 8)."""
    count = along.shape[1]
    if count <= _MAX_LOWEST:
        return np.broadcast_to(np.arange(count), along.shape)
    rows, lowest = np.arange(len(along)), np.argmin(height, axis=1)
    tilted = height - 0.35 * np.abs(along - along[rows, lowest][:, None])
    chosen: IntArray = np.argpartition(tilted, _MAX_LOWEST, axis=1)[:, :_MAX_LOWEST]
    return chosen


def _refined(axis: FloatArray, gap: FloatArray, hull: FloatArray, outline: FloatArray) -> FloatArray:
    """The normal of the hull's lower edge over the obstacle's support point, where that separates better."""
    rows = np.arange(len(hull))
    tops = axis[:, :1] * outline[..., 0] + axis[:, 1:] * outline[..., 1]
    support = outline[rows, np.argmax(tops, axis=1)]
    place = -axis[:, 1] * support[:, 0] + axis[:, 0] * support[:, 1]
    along = -axis[:, 1:] * hull[..., 0] + axis[:, :1] * hull[..., 1]
    height = axis[:, :1] * hull[..., 0] + axis[:, 1:] * hull[..., 1]
    kept = lowest_points(along, height)
    along, height = along[rows[:, None], kept], height[rows[:, None], kept]
    run = along[:, None, :] - along[:, :, None]  # from a to b
    share = (place[:, None] - along)[:, :, None] / np.where(run > 1e-12, run, 1.0)
    spans = (run > 1e-12) & (share >= 0.0) & (share <= 1.0)
    rise = height[:, None, :] - height[:, :, None]
    level = np.where(spans, height[:, :, None] + share * rise, np.inf).reshape(len(hull), along.shape[1] ** 2)
    best = np.argmin(level, axis=1)
    found = np.isfinite(level[rows, best])
    run, rise = run.reshape(level.shape)[rows, best], rise.reshape(level.shape)[rows, best]
    # In the frame (tangent, axis) the edge runs along (run, rise): its upward normal is (-rise, run).
    length = np.hypot(run, rise)
    safe = np.where(length > 0.0, length, 1.0)
    tangent = np.column_stack((-axis[:, 1], axis[:, 0]))
    edge = ((-rise / safe)[:, None] * tangent) + (run / safe)[:, None] * axis
    low = (edge[:, :1] * hull[..., 0] + edge[:, 1:] * hull[..., 1]).min(axis=1)
    top = (edge[:, :1] * outline[..., 0] + edge[:, 1:] * outline[..., 1]).max(axis=1)
    better = found & (low - top > gap)
    return np.where(better[:, None], edge, axis)
