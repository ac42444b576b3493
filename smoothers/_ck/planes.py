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

from smoothers._ck.axes import best_axes

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray, IntArray
    from smoothers._ck.layout import Layout
    from smoothers._ck.rollout import Rollout
    from smoothers._ck.world import Requirement, World

__all__ = ["Clearance", "Pairs", "clearance", "swept_pairs"]

_MANY = 200  # pairs: below, none is dropped
_PER_INTERVAL = 6


class Pairs(NamedTuple):
    """Interval, body part and obstacle of every near pair, Shape (p,) each."""

    interval: IntArray
    part: IntArray
    obstacle: IntArray


class Clearance(NamedTuple):
    """Near pairs and how far each is above the requirement.

    Attributes:
        pairs: Which interval, part, obstacle.
        hull: Shape (p, 2v, 2) [m], swept vertices, those of the left node first.
        axis: Shape (p, 2), unit, obstacle to robot.
        heights: Shape (p, 2v) [m], n.v less requirement and sag.
        top: Shape (p,) [m], largest n.q of the obstacle.
        margin: Shape (p,) [m], proven lower bound of clearance - required.
        required: At every node.
    """

    pairs: Pairs
    hull: FloatArray
    axis: FloatArray
    heights: FloatArray
    top: FloatArray
    margin: FloatArray
    required: Requirement


def swept_pairs(world: World, layout: Layout, rollout: Rollout, corners: FloatArray, reach: float) -> Pairs:
    """Pairs within `reach` [m] by their boxes, in the world's frame and in the body's; of each interval the nearest few.

    World boxes alone keep most obstacles around a body that stands askew.

    Args:
        world: Obstacles and body.
        layout: Shape of the path.
        rollout: The driven path.
        corners: Shape (nodes, parts, v, 2) [m], of the body at the nodes.
        reach: Pairs further apart are left out [m].
    """
    low, high = corners.min(axis=2), corners.max(axis=2)
    left = layout.left
    low = np.minimum(low[left], low[left + 1])[:, :, None]  # (intervals, parts, 1, 2)
    high = np.maximum(high[left], high[left + 1])[:, :, None]
    gap = np.maximum(low - world.obstacles.upper, world.obstacles.lower - high)
    near = (gap[..., 0] < reach) & (gap[..., 1] < reach)
    interval, part, obstacle = np.nonzero(near)
    pairs = Pairs(interval, part, obstacle)
    apart = np.maximum(_box_separation(gap[near]), _in_body_frame(world, layout, rollout, pairs))
    kept = np.flatnonzero(apart < reach)
    if kept.size > _MANY:
        kept = _nearest(interval[kept], apart[kept], kept)
    return Pairs(interval[kept], part[kept], obstacle[kept])


def _box_separation(gap: FloatArray) -> FloatArray:
    """Lower bound of the signed distance from the gaps of boxes along x and y. Shape (p,)."""
    outside = np.maximum(gap, 0.0)
    distance: FloatArray = np.where((gap > 0.0).any(axis=1), np.hypot(outside[:, 0], outside[:, 1]), gap.max(axis=1))
    return distance


def _in_body_frame(world: World, layout: Layout, rollout: Rollout, pairs: Pairs) -> FloatArray:
    """The same in the frame of the body at the left node, its box grown by the motion within the interval."""
    left = layout.left[pairs.interval]
    pose = rollout.poses[left]
    outline = world.obstacles.vertices[pairs.obstacle]
    x, y = outline[..., 0] - pose[:, :1], outline[..., 1] - pose[:, 1:2]
    c, s = np.cos(pose[:, 2:]), np.sin(pose[:, 2:])
    local = np.stack((c * x + s * y, c * y - s * x), axis=-1)
    turn = np.maximum(np.abs(rollout.curvature[left]), np.abs(rollout.curvature[left + 1]))
    grown = (rollout.steps[pairs.interval] * (1.0 + world.body.radius * turn))[:, None]
    body = world.body.vertices
    low, high = body.min(axis=1)[pairs.part], body.max(axis=1)[pairs.part]
    return _box_separation(np.maximum(local.min(axis=1) - high, low - local.max(axis=1)) - grown)


def _nearest(interval: IntArray, apart: FloatArray, kept: IntArray) -> IntArray:
    """Of every interval the `_PER_INTERVAL` pairs with the smallest separation."""
    order = np.lexsort((apart, interval))
    owner = interval[order]
    first = np.searchsorted(owner, owner)
    chosen: IntArray = kept[order[np.arange(owner.size) - first < _PER_INTERVAL]]
    return chosen


def corners_at(world: World, poses: FloatArray) -> FloatArray:
    """World positions of all body vertices at all poses. Shape (nodes, parts, v, 2) [m]."""
    body = world.body.vertices
    c, s = np.cos(poses[:, 2])[:, None, None], np.sin(poses[:, 2])[:, None, None]
    out = np.empty((len(poses), *body.shape))
    out[..., 0] = poses[:, 0, None, None] + c * body[..., 0] - s * body[..., 1]
    out[..., 1] = poses[:, 1, None, None] + s * body[..., 0] + c * body[..., 1]
    return out


def clearance(world: World, layout: Layout, rollout: Rollout, signs: FloatArray, reach: float) -> Clearance:
    """The near pairs of a driven path and their proven margins.

    Args:
        world: Obstacles and body.
        layout: Shape of the path.
        rollout: The driven path.
        signs: Gear of every gear segment, Shape (num_gears,).
        reach: Pairs further apart than this are left out [m].
    """
    required = world.required(rollout.poses[:, :2])
    corners = corners_at(world, rollout.poses)
    pairs = swept_pairs(world, layout, rollout, corners, reach)
    left = layout.left[pairs.interval]
    hull = np.concatenate((corners[left, pairs.part], corners[left + 1, pairs.part]), axis=1)
    axis = best_axes(world, rollout.poses[:, 2], left, pairs, hull)
    heights = axis[:, :1] * hull[..., 0] + axis[:, 1:] * hull[..., 1]
    heights -= _node_requirements(required, left, hull.shape[1] // 2)
    heights -= _sag(layout, rollout, signs, pairs, hull, axis)
    outline = world.obstacles.vertices[pairs.obstacle]
    top = (axis[:, :1] * outline[..., 0] + axis[:, 1:] * outline[..., 1]).max(axis=1)
    return Clearance(pairs, hull, axis, heights, top, heights.min(axis=1) - top, required)


def _node_requirements(required: Requirement, left: IntArray, count: int) -> FloatArray:
    """Requirement of every hull vertex; where another rule takes over within an interval, the larger of its ends."""
    first, last = required.value[left], required.value[left + 1]
    changes = required.rule[left] != required.rule[left + 1]
    larger = np.maximum(first, last)
    both = np.stack((np.where(changes, larger, first), np.where(changes, larger, last)), axis=1)
    return np.repeat(both, count, axis=1)


def _sag(
    layout: Layout, rollout: Rollout, signs: FloatArray, pairs: Pairs, hull: FloatArray, axis: FloatArray
) -> FloatArray:
    """How far every vertex may dip below its chord along the axis; the same for its two positions. Shape (p, 2v)."""
    left, count = layout.left[pairs.interval], hull.shape[1] // 2
    step, rate = rollout.steps[pairs.interval], rollout.rate[pairs.interval]
    sign = signs[layout.interval_gear[pairs.interval]]
    bends = []
    for node, points in ((left, hull[:, :count]), (left + 1, hull[:, count:])):
        pose, kappa = rollout.poses[node], rollout.curvature[node]
        arm = points - pose[:, None, :2]
        along = axis[:, :1] * arm[..., 0] + axis[:, 1:] * arm[..., 1]
        across = axis[:, 1:] * arm[..., 0] - axis[:, :1] * arm[..., 1]
        lateral = sign * kappa * (axis[:, 1] * np.cos(pose[:, 2]) - axis[:, 0] * np.sin(pose[:, 2]))
        bends.append(lateral[:, None] + rate[:, None] * across - (kappa * kappa)[:, None] * along)
    kappa = np.maximum(np.abs(rollout.curvature[left]), np.abs(rollout.curvature[left + 1]))[:, None]
    reach = np.hypot(arm[..., 0], arm[..., 1])
    third = np.abs(rate)[:, None] * (1.0 + 3.0 * kappa * reach) + kappa**2 * (1.0 + kappa * reach)
    bend = np.maximum(bends[0], bends[1]) + 0.5 * step[:, None] * third
    dip = 0.125 * step[:, None] ** 2 * np.maximum(bend, 0.0)
    return np.concatenate((dip, dip), axis=1)
