"""Separating lines between obstacles and the footprint swept between two neighbouring nodes.

For an interval with end poses k and k + 1 let H be the vertices of the footprint at both. For a unit axis n from
obstacle to robot a vertex dips below the chord of its two positions by at most `sag = h^2 / 8 * max(g'', 0)`, where g''
is the second derivative of its height along n. So everything the vertex sweeps is at least

    min over H of (n.v - required - sag) - max over the obstacle of n.q

above the requirement: a lower bound for ANY n, between the nodes too. g'' is taken at both ends; within the interval it
changes by at most (h / 2) * M3 from the nearer end, M3 = |rate| (1 + 3 |k| r) + k^2 (1 + |k| r).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from smoothers._ck.axes import Points, best_axes

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray, IntArray
    from smoothers._ck.layout import Layout
    from smoothers._ck.rollout import Rollout
    from smoothers._ck.world import Requirement, World

__all__ = ["Clearance", "Frames", "Pairs", "clearance", "clearance_of", "frames_at", "swept_pairs"]

_MANY = 150  # pairs: below, none is dropped
_SURELY_KEPT = 0.01  # [m] beyond the required clearance


class Pairs(NamedTuple):
    """Interval, body part and obstacle of every near pair, Shape (p,) each."""

    interval: IntArray
    part: IntArray
    obstacle: IntArray


class Clearance(NamedTuple):
    """Near pairs and how far each is above the requirement; one column per pair.

    Attributes:
        pairs: Which interval, part, obstacle.
        hull: Swept vertices, those of the left node first, Shape (2v, p) [m].
        axis: Unit, obstacle to robot, Shape (1, p).
        heights: Shape (2v, p) [m], n.v less requirement and sag.
        outline: Obstacle vertices, Shape (k, p) [m].
        top: Shape (p,) [m], largest n.q of the obstacle.
        margin: Shape (p,) [m], proven lower bound of clearance - required.
        required: At every node.
    """

    pairs: Pairs
    hull: Points
    axis: Points
    heights: FloatArray
    outline: Points
    top: FloatArray
    margin: FloatArray
    required: Requirement


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


def clearance(world: World, layout: Layout, rollout: Rollout, signs: FloatArray, reach: float) -> Clearance:
    """The near pairs of a driven path and their proven margins.

    Args:
        world: Obstacles and body.
        layout: Shape of the path.
        rollout: The driven path.
        signs: Gear of every gear segment, Shape (num_gears,).
        reach: Pairs further apart than this are left out [m].
    """
    frames = frames_at(world, rollout.poses)
    pairs = swept_pairs(world, layout, rollout, frames, reach)
    return _margins(world, layout, rollout, signs, pairs, frames)


def clearance_of(world: World, layout: Layout, rollout: Rollout, signs: FloatArray, pairs: Pairs) -> Clearance:
    """The proven margins of given pairs."""
    return _margins(world, layout, rollout, signs, pairs, frames_at(world, rollout.poses))


def _margins(
    world: World, layout: Layout, rollout: Rollout, signs: FloatArray, pairs: Pairs, frames: Frames
) -> Clearance:
    required = world.required(rollout.poses[:, :2])
    left = layout.left[pairs.interval]
    column = pairs.part * layout.num_nodes + left
    hull, inward = _both_ends(frames.corners, column), frames.inward.columns(column)
    outline, normals = world.outline.columns(pairs.obstacle), world.edge_normals.columns(pairs.obstacle)
    axis = best_axes(hull, outline, normals, inward)
    along = hull.along(axis)
    sign = signs[layout.interval_gear[pairs.interval]]
    dip = _sag(world, rollout, pairs, _Seen(np.stack((left, left + 1)), sign, axis, along, hull.across(axis)), frames)
    heights = along - _node_requirements(required, left, len(dip))
    heights[: len(dip)] -= dip
    heights[len(dip) :] -= dip
    top = outline.along(axis).max(axis=0)
    return Clearance(pairs, hull, axis, heights, outline, top, heights.min(axis=0) - top, required)


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


def _both_ends(points: Points, column: IntArray) -> Points:
    """The columns of the left nodes above those of the right nodes."""
    both = np.concatenate((column, column + 1))
    count, size = points.x.shape[0], column.size
    return Points(
        *(
            values[:, both].reshape(count, 2, size).transpose(1, 0, 2).reshape(2 * count, size)
            for values in (points.x, points.y)
        )
    )


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
    left, shape = layout.left, (-1, layout.num_nodes)
    lower, upper = world.obstacles.lower, world.obstacles.upper
    gaps = []
    for axis, values in enumerate((frames.corners.x, frames.corners.y)):
        low, high = values.min(axis=0).reshape(shape), values.max(axis=0).reshape(shape)
        low = np.minimum(low[:, left], low[:, left + 1]).reshape(-1, 1)
        high = np.maximum(high[:, left], high[:, left + 1]).reshape(-1, 1)
        gaps.append(np.maximum(low - upper[:, axis], lower[:, axis] - high))
    apart = np.maximum(_box_separation(*gaps), _in_body_frame(world, layout, rollout, frames))
    kept = np.flatnonzero(apart < reach)
    if kept.size > _MANY:
        kept = _nearest(apart, reach, world)
    row, obstacle = np.divmod(kept, len(world.obstacles))
    part, interval = np.divmod(row, layout.num_intervals)
    return Pairs(interval, part, obstacle)


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
    middle, half = _swept_boxes(world, layout, rollout, frames)
    parts = len(world.body.vertices)
    x, y, _ = np.tile(rollout.poses[layout.left], (parts, 1)).T[..., None]
    c, s = (np.tile(values[layout.left], parts)[:, None] for values in (frames.cosine, frames.sine))
    dx, dy = world.box_middle.x - x, world.box_middle.y - y
    wide, high = world.box_half.x, world.box_half.y
    along = np.abs(c * dx + s * dy - middle.x) - half.x
    across = np.abs(c * dy - s * dx - middle.y) - half.y
    c, s = np.abs(c), np.abs(s)
    return _box_separation(along - (c * wide + s * high), across - (s * wide + c * high))


def _swept_boxes(world: World, layout: Layout, rollout: Rollout, frames: Frames) -> tuple[Points, Points]:
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


def _nearest(apart: FloatArray, reach: float, world: World) -> IntArray:
    """Flat indices of the nearest few obstacles of every row within `reach` [m].

    The bound is coarse, so more of those that might be too close are kept than of the others.

    Args:
        apart: Separation of every interval and part, Shape (rows, obstacles) [m].
        reach: Pairs further apart are left out [m].
        world: How many are wanted, and the required clearance.
    """
    few, many = world.per_interval, 4 * world.per_interval
    count = apart.shape[1]
    row = np.arange(len(apart)).reshape(-1, 1)
    nearest = (
        np.argpartition(apart, many, axis=1)[:, :many] if count > many else np.tile(np.arange(count), (len(row), 1))
    )
    nearest = np.take_along_axis(nearest, np.argsort(apart[row, nearest], axis=1), axis=1)
    found = apart[row, nearest]
    close = found < world.rule.required + _SURELY_KEPT
    close[:, :few] = found[:, :few] < reach
    chosen: IntArray = (row * count + nearest)[close]
    return chosen


def _node_requirements(required: Requirement, left: IntArray, count: int) -> FloatArray:
    """Requirement of every hull vertex, such that the chord between the two nodes is nowhere below the requirement.

    Every rule is at most linear in distance and the smallest one counts, so where another takes over within an interval
    the larger of its ends is safe. Next to the start only the right end may be raised: the left one is given.
    """
    first, last = required.value[left], required.value[left + 1]
    changes = required.rule[left] != required.rule[left + 1]
    from_start = changes & (required.rule[left] == 2)
    larger = np.maximum(first, last)
    first = np.where(changes & ~from_start, larger, first)
    last = np.where(from_start, required.relieved[left + 1], np.where(changes, larger, last))
    return np.repeat(np.stack((first, last)), count, axis=0)


class _Seen(NamedTuple):
    """Pairs seen along their axes: end nodes (2, p), gear (p,), axis, hull vertices along and across it (2v, p)."""

    nodes: IntArray
    sign: FloatArray
    axis: Points
    along: FloatArray
    across: FloatArray


def _sag(world: World, rollout: Rollout, pairs: Pairs, seen: _Seen, frames: Frames) -> FloatArray:
    """How far every vertex may dip below its chord along the axis. Shape (v, p)."""
    axis, nodes = seen.axis, seen.nodes
    step, rate = rollout.steps[pairs.interval], rollout.rate[pairs.interval]
    x, y, kappa = rollout.poses[nodes, 0], rollout.poses[nodes, 1], rollout.curvature[nodes]
    shape = (2, len(seen.along) // 2, step.size)
    along = seen.along.reshape(shape) - (axis.x * x + axis.y * y)[:, None]
    across = seen.across.reshape(shape) - (axis.x * y - axis.y * x)[:, None]
    lateral = seen.sign * kappa * (axis.y * frames.cosine[nodes] - axis.x * frames.sine[nodes])
    # n . R90 arm is minus the arm's coordinate across n.
    bend = (lateral[:, None] - rate * across - (kappa * kappa)[:, None] * along).max(axis=0)
    most, reach = np.abs(kappa).max(axis=0), world.body.reach[pairs.part].T
    third = np.abs(rate) * (1.0 + 3.0 * most * reach) + most**2 * (1.0 + most * reach)
    dip: FloatArray = 0.125 * step**2 * np.maximum(bend + 0.5 * step * third, 0.0)
    return dip
