"""Push-out rows: discs that fill the body, with exact signed distance to the obstacles.

Where the body overlaps an obstacle deeply, the axis of least overlap of neighbouring intervals may point to opposite
sides. The centre line of the body crosses an obstacle much later than the body does, so its discs agree on the side.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from smoothers._ck.rows import Rows, empty_rows

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray, IntArray
    from smoothers._ck.layout import Layout
    from smoothers._ck.planes import Clearance
    from smoothers._ck.rollout import Rollout, Sensitivity
    from smoothers._ck.world import World

__all__ = ["disc_centres", "disc_rows"]

_DEEPEST = 2  # discs per node and obstacle
_MOST_DISCS = 32  # of a part; the discs of a thinner one leave gaps between them, which the planes see when it is out


def disc_centres(vertices: FloatArray) -> tuple[FloatArray, float]:
    """Centres (d, 2) [m] along the longer side of a body part's box, at most `_MOST_DISCS`, and their radius [m].

    Args:
        vertices: Shape (v, 2) [m].
    """
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    extent, middle = high - low, 0.5 * (low + high)
    long = int(np.argmax(extent))
    radius = 0.5 * float(extent.min())
    half = 0.5 * float(extent.max()) - radius
    count = int(np.clip(np.ceil(2.0 * half / max(radius, 1e-9)) + 1.0, 1, _MOST_DISCS))
    centres = np.tile(middle, (count, 1))
    centres[:, long] += np.linspace(-half, half, count)
    return centres, radius


def _signed_distance(points: FloatArray, outline: FloatArray, normals: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Distance of points (p, d, 2) to polygons (p, k, 2), negative inside, and its gradient (p, d, 2)."""
    edge = np.roll(outline, -1, axis=1) - outline
    away = points[:, :, None] - outline[:, None]
    along = (away * edge[:, None]).sum(axis=3) / np.maximum((edge * edge).sum(axis=2), 1e-18)[:, None]
    rest = away - np.clip(along, 0.0, 1.0)[..., None] * edge[:, None]
    length = np.hypot(rest[..., 0], rest[..., 1])
    near = np.argmin(length, axis=2)[..., None]
    outside = np.take_along_axis(length, near, axis=2)[..., 0]
    toward = np.take_along_axis(rest, near[..., None], axis=2)[:, :, 0] / np.maximum(outside, 1e-9)[..., None]
    depth = (away * normals[:, None]).sum(axis=3)
    side = np.argmax(depth, axis=2)
    deepest = np.take_along_axis(depth, side[..., None], axis=2)[..., 0]
    inside = deepest < 0.0
    normal = normals[np.arange(len(normals))[:, None], side]
    return np.where(inside, deepest, outside), np.where(inside[..., None], normal, toward)


def disc_rows(
    world: World, layout: Layout, rollout: Rollout, by: Sensitivity, found: Clearance, chosen: IntArray
) -> Rows:
    """Rows that move the deepest discs of the chosen pairs out of their obstacles."""
    if chosen.size == 0:
        return empty_rows(layout.size)
    parts = [
        _part_rows(world, rollout, layout, found, chosen[found.pairs.part[chosen] == b], b)
        for b in range(len(world.body.vertices))
    ]
    node, arm, normal, gap = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    gradient = normal[:, :1] * by.x[node] + normal[:, 1:] * by.y[node]
    gradient += (normal[:, 1] * arm[:, 0] - normal[:, 0] * arm[:, 1])[:, None] * by.yaw[node]
    return Rows(gradient, gap - found.required.value[node], node)


def _part_rows(
    world: World, rollout: Rollout, layout: Layout, found: Clearance, chosen: IntArray, part: int
) -> tuple[IntArray, FloatArray, FloatArray, FloatArray]:
    centres, radius = disc_centres(world.body.vertices[part])
    left = layout.left[found.pairs.interval[chosen]]
    both = np.concatenate((left, left + 1))
    count = len(world.obstacles)
    node, rock = np.divmod(np.unique(both * count + np.tile(found.pairs.obstacle[chosen], 2)), count)
    yaw = rollout.poses[node, 2][:, None]
    c, s = np.cos(yaw), np.sin(yaw)
    arm = np.stack((c * centres[:, 0] - s * centres[:, 1], s * centres[:, 0] + c * centres[:, 1]), axis=-1)
    points = rollout.poses[node, None, :2] + arm
    distance, normal = _signed_distance(points, world.obstacles.vertices[rock], world.obstacles.normals[rock])
    order = np.argsort(distance, axis=1)[:, :_DEEPEST]
    rows = np.arange(len(node))[:, None]
    flat = np.repeat(node, order.shape[1])
    gap = distance[rows, order].ravel() - radius
    return flat, arm[rows, order].reshape(-1, 2), normal[rows, order].reshape(-1, 2), gap
