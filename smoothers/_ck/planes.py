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
from smoothers._ck.nearby import frames_at, swept_pairs

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray, IntArray
    from smoothers._ck.layout import Layout
    from smoothers._ck.nearby import Frames, Pairs
    from smoothers._ck.rollout import Rollout
    from smoothers._ck.world import Requirement, World

__all__ = ["Clearance", "clearance", "clearance_of"]


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
