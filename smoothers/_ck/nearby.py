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
    lower, upper = world.obstacles.lower, world.obstacles.upper
    gaps = []
    for axis, (low, high) in enumerate(_world_boxes(layout, frames)):
        gaps.append(np.maximum(low - upper[:, axis], lower[:, axis] - high))
    apart = np.maximum(_box_separation(*gaps), _in_body_frame(world, layout, rollout, frames))
    near = apart < reach
    if np.count_nonzero(near) > _MANY:
        near &= _nearest(apart, world)
    row, obstacle = np.nonzero(near)
    part, interval = np.divmod(row, layout.num_intervals)
    return Pairs(interval, part, obstacle)


def _world_boxes(layout: Layout, frames: Frames) -> list[tuple[FloatArray, FloatArray]]:
    """Along x and y: from where to where each part reaches in each interval, Shape (parts * intervals, 1) each."""
    left, shape, found = layout.left, (-1, layout.num_nodes), []
    for values in (frames.corners.x, frames.corners.y):
        low, high = values.min(axis=0).reshape(shape), values.max(axis=0).reshape(shape)
        low, high = np.minimum(low[:, left], low[:, left + 1]), np.maximum(high[:, left], high[:, left + 1])
        found.append((low.reshape(-1, 1), high.reshape(-1, 1)))
    return found


def _box_separation(x: FloatArray, y: FloatArray) -> FloatArray:
    """Lower bound of the signed distance from the gaps of boxes along x and y, all of one shape."""
    right, up = np.maximum(x, 0.0), np.maximum(y, 0.0)
    outside = np.sqrt(right * right + up * up)
    distance: FloatArray = outside + np.minimum(np.maximum(x, y), 0.0)
    return distance


def _in_body_frame(world: World, layout: Layout, rollout: Rollout, frames: Frames) -> FloatArray:
    """Separation of obstacles and body in the frame of the body at the left node, by the box of all that it sweeps.

    Obstacles count as their world boxes, whose extent along a direction (c, s) is |c| x + |s| y.

    Returns:
        Shape (parts * intervals, obstacles) [m].
    """
    middle, half = swept_boxes(world, layout, rollout, frames)
    parts = len(world.body.vertices)
    x, y, _ = np.tile(rollout.poses[layout.left], (parts, 1)).T
    c, s = (np.tile(values[layout.left], parts) for values in (frames.cosine, frames.sine))
    one = np.ones((1, len(world.obstacles)))
    # Products of matrices instead of many passes over arrays of this size.
    at, extent = np.vstack((*world.box_middle, one)), np.vstack((*world.box_half, one))
    gaps = []
    for (a, b), centre, reach in zip(((c, s), (-s, c)), middle, half, strict=True):
        offset = a * x + b * y + centre[:, 0]
        along = np.column_stack((a, b, -offset)) @ at
        gaps.append(np.abs(along) - np.column_stack((np.abs(a), np.abs(b), reach)) @ extent)
    return _box_separation(*gaps)


def swept_boxes(world: World, layout: Layout, rollout: Rollout, frames: Frames) -> tuple[Points, Points]:
    """Middle and half extent of what each part sweeps, in the left node's frame. Shape (parts * intervals, 1) [m]."""
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
        boxes.append((0.5 * (low + high).reshape(-1, 1), 0.5 * (high - low).reshape(-1, 1)))
    return Points(boxes[0][0], boxes[1][0]), Points(boxes[0][1], boxes[1][1])


def _nearest(apart: FloatArray, world: World) -> BoolArray:
    """The nearest few obstacles of every row.

    The bound is coarse, so more of those that might be too close are kept than of the others.

    Args:
        apart: Separation of every interval and part, Shape (rows, obstacles) [m].
        world: How many are wanted, and the required clearance.
    """
    few, many = (min(count, apart.shape[1]) for count in (world.per_interval, 4 * world.per_interval))
    ranked = np.partition(apart, (few - 1, many - 1), axis=1)
    close = (apart < world.rule.required + _SURELY_KEPT) & (apart <= ranked[:, many - 1 : many])
    nearest: BoolArray = (apart <= ranked[:, few - 1 : few]) | close
    return nearest
