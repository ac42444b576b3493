"""Which obstacle the footprint may come near in which interval, by boxes: a coarse and cheap first look."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from smoothers._ck.axes import Points

if TYPE_CHECKING:
    from optdock.geometry.arrays import BoolArray, FloatArray, IntArray
    from smoothers._ck.layout import Layout
    from smoothers._ck.rollout import Rollout
    from smoothers._ck.world import World

__all__ = ["Frames", "Pairs", "frames_at", "swept_boxes", "swept_pairs"]

_MANY = 150  # pairs: below, none is dropped
_SURELY_KEPT = 0.01  # [m] beyond the required clearance
_TOGETHER = 6  # neighbouring intervals whose common box is looked at first


class Pairs(NamedTuple):
    """Interval, body part and obstacle of every near pair, Shape (p,) each."""

    interval: IntArray
    part: IntArray
    obstacle: IntArray


class Frames(NamedTuple):
    """The body at every node.

    Attributes:
        corners: World positions of all body vertices, one column per part and node, Shape (v, parts * nodes) [m].
        inward: Inward normals of the body's edges, likewise.
        cosine, sine: Of the yaw, Shape (nodes,).
    """

    corners: Points
    inward: Points
    cosine: FloatArray
    sine: FloatArray


def frames_at(world: World, poses: FloatArray) -> Frames:
    """The body at all poses, Shape (nodes, 3)."""
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    shape = (world.body.vertices.shape[1], -1)
    turned = []
    for points, sign in ((world.body.vertices, 1.0), (world.body.normals, -1.0)):
        x, y = sign * points[..., 0].T[..., None], sign * points[..., 1].T[..., None]  # (v, parts, 1)
        turned.append((c * x - s * y, s * x + c * y))
    corners = Points((poses[:, 0] + turned[0][0]).reshape(shape), (poses[:, 1] + turned[0][1]).reshape(shape))
    return Frames(corners, Points(turned[1][0].reshape(shape), turned[1][1].reshape(shape)), c, s)


def swept_pairs(world: World, layout: Layout, rollout: Rollout, frames: Frames, reach: float) -> Pairs:
    """Pairs within `reach` [m] by their boxes, in the world's frame and the body's; of each interval the nearest few.

    World boxes alone keep most obstacles around a body that stands askew.

    Args:
        world: Obstacles and body.
        layout: Shape of the path.
        rollout: The driven path.
        frames: The body at the nodes.
        reach: Pairs further apart are left out [m].
    """
    row, rock, apart = _by_world_boxes(world, _world_boxes(layout, frames), reach)
    apart = np.maximum(apart, _in_body_frame(world, layout, rollout, frames, (row, rock)))
    near = np.flatnonzero(apart < reach)
    if near.size > _MANY:
        near = near[_nearest(row[near], apart[near], world)]
    part, interval = np.divmod(row[near], layout.num_intervals)
    return Pairs(interval, part, rock[near])


def _world_boxes(layout: Layout, frames: Frames) -> list[tuple[FloatArray, FloatArray]]:
    """Along x and y: from where to where each part reaches in each interval, Shape (parts * intervals,) each."""
    left, shape, found = layout.left, (-1, layout.num_nodes), []
    for values in (frames.corners.x, frames.corners.y):
        low, high = values.min(axis=0).reshape(shape), values.max(axis=0).reshape(shape)
        low, high = np.minimum(low[:, left], low[:, left + 1]), np.maximum(high[:, left], high[:, left + 1])
        found.append((low.ravel(), high.ravel()))
    return found


def _by_world_boxes(
    world: World, boxes: list[tuple[FloatArray, FloatArray]], reach: float
) -> tuple[IntArray, IntArray, FloatArray]:
    """Rows of `boxes` and obstacles within `reach` [m], and their separation; some neighbouring rows at once first."""
    lower, upper, count = world.obstacles.lower, world.obstacles.upper, boxes[0][0].size
    starts = np.arange(0, count, _TOGETHER)
    close: BoolArray = np.ones((starts.size, len(lower)), dtype=np.bool_)
    for axis, (low, high) in enumerate(boxes):
        close &= (np.minimum.reduceat(low, starts) - reach)[:, None] < upper[:, axis]
        close &= (np.maximum.reduceat(high, starts) + reach)[:, None] > lower[:, axis]
    group, each = np.nonzero(close)
    expanded = ((group * _TOGETHER)[:, None] + np.arange(_TOGETHER)).ravel()
    inside = np.flatnonzero(expanded < count)  # the last group may be smaller
    row, rock = expanded[inside], np.repeat(each, _TOGETHER)[inside]
    gaps = [
        np.maximum(low[row] - upper[rock, axis], lower[rock, axis] - high[row])
        for axis, (low, high) in enumerate(boxes)
    ]
    near = np.flatnonzero(np.maximum(*gaps) < reach)
    return row[near], rock[near], _box_separation(*(gap[near] for gap in gaps))


def _box_separation(x: FloatArray, y: FloatArray) -> FloatArray:
    """Lower bound of the signed distance from the gaps of boxes along x and y, all of one shape."""
    right, up = np.maximum(x, 0.0), np.maximum(y, 0.0)
    outside = np.sqrt(right * right + up * up)
    distance: FloatArray = outside + np.minimum(np.maximum(x, y), 0.0)
    return distance


def _in_body_frame(
    world: World, layout: Layout, rollout: Rollout, frames: Frames, pairs: tuple[IntArray, IntArray]
) -> FloatArray:
    """Separation of obstacles and body in the frame of the body at the left node, by the box of all that it sweeps.

    Obstacles count as their world boxes, whose extent along a direction (c, s) is |c| x + |s| y.

    Args:
        world: Obstacles and body.
        layout: Shape of the path.
        rollout: The driven path.
        frames: The body at the nodes.
        pairs: Row (part and interval) and obstacle of each pair, Shape (p,) each.

    Returns:
        Shape (p,) [m].
    """
    row, rock = pairs
    middle, half = swept_boxes(world, layout, rollout, frames)
    node = layout.left[row % layout.num_intervals]
    c, s = frames.cosine[node], frames.sine[node]
    dx = world.box_middle.x[0, rock] - rollout.poses[node, 0]
    dy = world.box_middle.y[0, rock] - rollout.poses[node, 1]
    along = np.abs(c * dx + s * dy - middle.x[row]) - half.x[row]
    across = np.abs(c * dy - s * dx - middle.y[row]) - half.y[row]
    wide, high = world.box_half.x[0, rock], world.box_half.y[0, rock]
    c, s = np.abs(c), np.abs(s)
    return _box_separation(along - (c * wide + s * high), across - (s * wide + c * high))


def swept_boxes(world: World, layout: Layout, rollout: Rollout, frames: Frames) -> tuple[Points, Points]:
    """Middle and half extent of what each part sweeps, in the left node's frame. Shape (parts * intervals,) [m]."""
    left, shape = layout.left, (-1, len(world.body.vertices), layout.num_nodes)
    x = frames.corners.x.reshape(shape)[..., left + 1] - rollout.poses[left, 0]
    y = frames.corners.y.reshape(shape)[..., left + 1] - rollout.poses[left, 1]
    c, s = frames.cosine[left], frames.sine[left]
    turn = np.maximum(np.abs(rollout.curvature[left]), np.abs(rollout.curvature[left + 1]))
    # A vertex accelerates by at most this, and strays from its chord by an eighth of it times the step squared.
    bend = turn + world.body.radius * (turn**2 + np.abs(rollout.rate))
    stray = 0.125 * rollout.steps**2 * bend
    boxes = []
    for axis, at in ((0, c * x + s * y), (1, c * y - s * x)):
        low = np.minimum(at.min(axis=0), world.body.lower[:, axis, None]) - stray
        high = np.maximum(at.max(axis=0), world.body.upper[:, axis, None]) + stray
        boxes.append((0.5 * (low + high).ravel(), 0.5 * (high - low).ravel()))
    return Points(boxes[0][0], boxes[1][0]), Points(boxes[0][1], boxes[1][1])


def _nearest(row: IntArray, apart: FloatArray, world: World) -> BoolArray:
    """Which pairs are among the nearest few of their row.

    The bound is coarse, so more of those that might be too close are kept than of the others.

    Args:
        row: Interval and part of every pair, Shape (p,).
        apart: Their separation, Shape (p,) [m].
        world: How many are wanted, and the required clearance.
    """
    order = np.lexsort((apart, row))
    first = np.searchsorted(row[order], row)  # where the pairs of the same row begin
    rank = np.empty(row.size, dtype=np.int64)
    rank[order] = np.arange(row.size)
    rank -= first
    close = apart < world.rule.required + _SURELY_KEPT
    kept: BoolArray = (rank < world.per_interval) | close & (rank < 4 * world.per_interval)
    return kept
