"""Broad phase: search by bounding boxes for body parts close to an obstacle in an interval [Ericson2005].

The search first uses axis-aligned boxes around six neighbouring intervals, then boxes around each interval, and then
boxes in the frame of the body, which are much tighter around a rotated body.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from smoothers.scp.collision.collision_scene import Points

if TYPE_CHECKING:
    from optdock.geometry.arrays import BoolArray, FloatArray, IntArray
    from smoothers.scp.basis import Basis
    from smoothers.scp.collision.collision_scene import BodyAtNodes, Scene
    from smoothers.scp.rollout import Rollout

__all__ = ["Pairs", "broad_phase", "swept_boxes"]


class Pairs(NamedTuple):
    """Indices of the interval, the body part and the obstacle of every pair found, Shape (p,) each."""

    interval: IntArray
    part: IntArray
    obstacle: IntArray


def broad_phase(scene: Scene, basis: Basis, rollout: Rollout, body: BodyAtNodes, reach: float) -> Pairs:
    """Return the pairs whose boxes are at most `reach` [m] apart; if too many, the nearest pairs of each interval."""
    row, obstacle, apart = _by_world_boxes(scene, _world_boxes(basis, body), reach)
    apart = np.maximum(apart, _in_body_frame(scene, basis, rollout, body, (row, obstacle)))
    near = np.flatnonzero(apart < reach)
    if near.size > scene.settings.few_pairs:
        near = near[_nearest(row[near], apart[near], scene)]
    part, interval = np.divmod(row[near], basis.num_intervals)
    return Pairs(interval, part, obstacle[near])


def _world_boxes(basis: Basis, body: BodyAtNodes) -> list[tuple[FloatArray, FloatArray]]:
    """Return the lower and upper bounds in x and y of each part in each interval, Shape (parts * intervals,) each."""
    left, shape, found = basis.left, (-1, basis.num_nodes), []
    for values in (body.corners.x, body.corners.y):
        low, high = values.min(axis=0).reshape(shape), values.max(axis=0).reshape(shape)
        low, high = np.minimum(low[:, left], low[:, left + 1]), np.maximum(high[:, left], high[:, left + 1])
        found.append((low.ravel(), high.ravel()))
    return found


def _by_world_boxes(
    scene: Scene, boxes: list[tuple[FloatArray, FloatArray]], reach: float
) -> tuple[IntArray, IntArray, FloatArray]:
    """Return the indices of boxes and obstacles at most `reach` [m] apart, and their separations.

    Groups of rows are tested first.
    """
    lower, upper, count = scene.obstacles.lower, scene.obstacles.upper, boxes[0][0].size
    together = scene.settings.grouped_intervals
    starts = np.arange(0, count, together)
    close: BoolArray = np.ones((starts.size, len(lower)), dtype=np.bool_)
    for axis, (low, high) in enumerate(boxes):
        close &= (np.minimum.reduceat(low, starts) - reach)[:, None] < upper[:, axis]
        close &= (np.maximum.reduceat(high, starts) + reach)[:, None] > lower[:, axis]
    group, each = np.nonzero(close)
    expanded = ((group * together)[:, None] + np.arange(together)).ravel()
    inside = np.flatnonzero(expanded < count)  # the last group may be smaller
    row, obstacle = expanded[inside], np.repeat(each, together)[inside]
    gaps = [
        np.maximum(low[row] - upper[obstacle, axis], lower[obstacle, axis] - high[row])
        for axis, (low, high) in enumerate(boxes)
    ]
    near = np.flatnonzero(np.maximum(*gaps) < reach)
    return row[near], obstacle[near], _box_separation(*(gap[near] for gap in gaps))


def _box_separation(x: FloatArray, y: FloatArray) -> FloatArray:
    """Return a lower bound of the signed distance, from the gaps between boxes along x and y."""
    right, up = np.maximum(x, 0.0), np.maximum(y, 0.0)
    outside = np.sqrt(right * right + up * up)
    distance: FloatArray = outside + np.minimum(np.maximum(x, y), 0.0)
    return distance


def _in_body_frame(
    scene: Scene, basis: Basis, rollout: Rollout, body: BodyAtNodes, pairs: tuple[IntArray, IntArray]
) -> FloatArray:
    """Return the separation [m] of swept body and obstacle box in the body frame at the left node. Shape (p,)."""
    row, obstacle = pairs
    middle, half = swept_boxes(scene, basis, rollout, body)
    node = basis.left[row % basis.num_intervals]
    c, s = body.cosine[node], body.sine[node]
    middle_of, half_of = scene.boxes
    dx = middle_of.x[0, obstacle] - rollout.poses[node, 0]
    dy = middle_of.y[0, obstacle] - rollout.poses[node, 1]
    along = np.abs(c * dx + s * dy - middle.x[row]) - half.x[row]
    across = np.abs(c * dy - s * dx - middle.y[row]) - half.y[row]
    wide, high = half_of.x[0, obstacle], half_of.y[0, obstacle]
    c, s = np.abs(c), np.abs(s)  # the extent of a box along a direction (c, s) is |c| x + |s| y
    return _box_separation(along - (c * wide + s * high), across - (s * wide + c * high))


def swept_boxes(scene: Scene, basis: Basis, rollout: Rollout, body: BodyAtNodes) -> tuple[Points, Points]:
    """Return centre and half extents of the area swept by each part, in the left node's frame. Shape (p,) [m]."""
    left, shape = basis.left, (-1, len(scene.body.vertices), basis.num_nodes)
    x = body.corners.x.reshape(shape)[..., left + 1] - rollout.poses[left, 0]
    y = body.corners.y.reshape(shape)[..., left + 1] - rollout.poses[left, 1]
    c, s = body.cosine[left], body.sine[left]
    turn = np.maximum(np.abs(rollout.curvature[left]), np.abs(rollout.curvature[left + 1]))
    # Bound of a vertex's second derivative; its distance from the chord is at most an eighth of that times step^2.
    bend = turn + scene.body.radius * (turn**2 + np.abs(rollout.rate))
    stray = 0.125 * rollout.steps**2 * bend
    boxes = []
    for axis, at in ((0, c * x + s * y), (1, c * y - s * x)):
        low = np.minimum(at.min(axis=0), scene.body.lower[:, axis, None]) - stray
        high = np.maximum(at.max(axis=0), scene.body.upper[:, axis, None]) + stray
        boxes.append((0.5 * (low + high).ravel(), 0.5 * (high - low).ravel()))
    return Points(boxes[0][0], boxes[1][0]), Points(boxes[0][1], boxes[1][1])


def _nearest(row: IntArray, apart: FloatArray, scene: Scene) -> BoolArray:
    """Return a mask of the nearest pairs of each row; additional pairs are kept if their clearance may be too small."""
    order = np.lexsort((apart, row))
    first = np.searchsorted(row[order], row)  # where the pairs of the same row begin
    rank = np.empty(row.size, dtype=np.int64)
    rank[order] = np.arange(row.size)
    rank -= first
    settings = scene.settings
    close = apart < scene.rule.required + settings.surely_kept
    kept: BoolArray = (rank < settings.nearest) | close & (rank < settings.nearest_close * settings.nearest)
    return kept
