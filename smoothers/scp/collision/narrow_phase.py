"""Narrow phase: separating planes between obstacles and the footprint swept between two neighbouring nodes.

For an interval with end poses k and k + 1, let H be the vertices of the footprint at both poses. For a unit axis n from
obstacle to robot, a vertex falls below the chord of its two positions by at most `sag = h^2 / 8 * max(g'', 0)`, where
g'' is the second derivative of its coordinate along n. The area that the vertex sweeps is therefore at least

    min over H of (n.v - required - sag) - max over the obstacle of n.q

above the requirement. This is a lower bound for any n, also between the nodes. g'' is evaluated at both ends. Within
the interval it differs from its value at the nearer end by at most (h / 2) * M3, with M3 = |rate| (1 + 3 |k| r) + k^2
(1 + |k| r).

The axis n is the best of the candidates of the separating axis theorem ([Ericson2005], 5.2), refined once. The hulls
over two neighbouring nodes are used as in [Schulman2014]. Arrays contain one pair per column, which makes reductions
contiguous in memory.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.geometry.arrays import readonly
from smoothers.scp.collision.collision_scene import LEAVING, Points

if TYPE_CHECKING:
    from collections.abc import Iterator

    from optdock.geometry.arrays import BoolArray, FloatArray, IntArray
    from smoothers.scp.basis import Basis
    from smoothers.scp.collision.broad_phase import Pairs
    from smoothers.scp.collision.collision_scene import BodyAtNodes, Requirement, Scene
    from smoothers.scp.rollout import Rollout
    from smoothers.scp.settings import CollisionSettings

__all__ = ["Chords", "Clearance", "best_separating_axes", "chords", "most_sag", "narrow_phase", "sag"]

_CACHED = 100_000  # numbers, 0.8 MB: blocks of this size stay in the processor's cache (8 times as fast)


class Clearance(NamedTuple):
    """Pairs of a robot part and a nearby obstacle, with margins above the required clearance; one pair per column."""

    pairs: Pairs  # interval, part and obstacle
    margin: FloatArray  # Shape (p,) [m], proven lower bound of clearance - required
    required: Requirement  # at every node
    table: FloatArray  # memory of the properties below, in this order, and of `margin`, Shape (6v + 2k + 4, p)
    vertices: int  # number of vertices of a hull, 2v

    @property
    def hull(self) -> Points:
        """Swept vertices, those of the left node first, Shape (2v, p) [m]."""
        return Points(self.table[: self.vertices], self.table[self.vertices : 2 * self.vertices])

    @property
    def axis(self) -> Points:
        """Unit vector from the obstacle to the robot, Shape (1, p)."""
        return Points(*self.table[2 * self.vertices : 2 * self.vertices + 2, None])

    @property
    def heights(self) -> FloatArray:
        """Heights n.v of the hull along the axis, less requirement and sag, Shape (2v, p) [m]."""
        return self.table[2 * self.vertices + 2 : 3 * self.vertices + 2]

    @property
    def outline(self) -> Points:
        """Obstacle vertices, Shape (k, p) [m]."""
        rows = self.table[3 * self.vertices + 2 : -2]
        return Points(rows[: len(rows) // 2], rows[len(rows) // 2 :])

    @property
    def top(self) -> FloatArray:
        """Largest n.q of the obstacle, Shape (p,) [m]."""
        top: FloatArray = self.table[-2]
        return top


def narrow_phase(
    scene: Scene, basis: Basis, rollout: Rollout, signs: FloatArray, body: BodyAtNodes, pairs: Pairs
) -> Clearance:
    """Return the proven margin of every pair; `signs` are the gears, Shape (num_gears,)."""
    left = basis.left[pairs.interval]
    column = pairs.part * basis.num_nodes + left
    hull, inward = _both_ends(body.corners, column), body.inward.columns(column)
    outline, normals = scene.outline.columns(pairs.obstacle), scene.edge_normals.columns(pairs.obstacle)
    axis = best_separating_axes(hull, outline, normals, inward, scene.settings)
    along = hull.along(axis)
    sign = signs[basis.interval_gear[pairs.interval]]
    dip = sag(
        scene, rollout, pairs, _AxisCoordinates(np.stack((left, left + 1)), sign, axis, along, hull.across(axis)), body
    )
    heights = along - _node_requirements(body.required, left, len(dip))
    heights[: len(dip)] -= dip
    heights[len(dip) :] -= dip
    top = outline.along(axis).max(axis=0)
    rows = (*hull, *axis, heights, *outline, top[None], (heights.min(axis=0) - top)[None])
    table = np.concatenate(rows)
    return Clearance(pairs, table[-1], body.required, table, len(heights))


def _both_ends(points: Points, column: IntArray) -> Points:
    """Stack the columns of the left nodes above the columns of the right nodes."""
    both = np.concatenate((column, column + 1))
    count, size = points.x.shape[0], column.size
    return Points(
        *(
            values[:, both].reshape(count, 2, size).transpose(1, 0, 2).reshape(2 * count, size)
            for values in (points.x, points.y)
        )
    )


def _node_requirements(required: Requirement, left: IntArray, count: int) -> FloatArray:
    """Return the requirement of every hull vertex, which covers all points of the chord between the two nodes.

    Every part of the rule is convex in the distance, and the part with the smallest value applies. If the part changes
    within an interval, the larger of the values at both ends is safe. Next to the start only the right end is raised,
    because the left pose is given.
    """
    first, last = required.value[left], required.value[left + 1]
    changes = required.rule[left] != required.rule[left + 1]
    from_start = changes & (required.rule[left] == LEAVING)
    larger = np.maximum(first, last)
    first = np.where(changes & ~from_start, larger, first)
    last = np.where(from_start, required.leaving[left + 1], np.where(changes, larger, last))
    return np.repeat(np.stack((first, last)), count, axis=0)


class _AxisCoordinates(NamedTuple):
    """Pairs in coordinates of their axes: end nodes (2, p), gear (p,), axis, hull along and across the axis (2v, p)."""

    nodes: IntArray
    sign: FloatArray
    axis: Points
    along: FloatArray
    across: FloatArray


def sag(scene: Scene, rollout: Rollout, pairs: Pairs, frame: _AxisCoordinates, body: BodyAtNodes) -> FloatArray:
    """Return the bound by which every vertex may fall below its chord along the axis. Shape (v, p) [m]."""
    axis, nodes = frame.axis, frame.nodes
    step, rate = rollout.steps[pairs.interval], rollout.rate[pairs.interval]
    x, y, kappa = rollout.poses[nodes, 0], rollout.poses[nodes, 1], rollout.curvature[nodes]
    shape = (2, len(frame.along) // 2, step.size)
    along = frame.along.reshape(shape) - (axis.x * x + axis.y * y)[:, None]
    across = frame.across.reshape(shape) - (axis.x * y - axis.y * x)[:, None]
    lateral = frame.sign * kappa * (axis.y * body.cosine[nodes] - axis.x * body.sine[nodes])
    # n . R90 arm is minus the arm's coordinate across n.
    bend = (lateral[:, None] - rate * across - (kappa * kappa)[:, None] * along).max(axis=0)
    most, reach = np.abs(kappa).max(axis=0), scene.body.reach[pairs.part].T
    third = np.abs(rate) * (1.0 + 3.0 * most * reach) + most**2 * (1.0 + most * reach)
    dip: FloatArray = 0.125 * step**2 * np.maximum(bend + 0.5 * step * third, 0.0)
    return dip


def most_sag(rollout: Rollout, radius: float) -> float:
    """Return an estimate of the largest sag [m] of a vertex within `radius` [m] of the origin of the body."""
    turn, rate = np.abs(rollout.curvature).max(), np.abs(rollout.rate).max()
    return float(0.125 * rollout.steps.max() ** 2 * (turn + radius * (turn**2 + rate)))


def best_separating_axes(
    hull: Points, outline: Points, normals: Points, inward: Points, settings: CollisionSettings
) -> Points:
    """Return the unit axes from obstacle to robot with the largest separation among the candidates. Shape (1, p).

    The candidates are the edge normals of the obstacle, the edge normals of the body at the left node, the direction
    between the closest vertices, the normals of the chord of the closest vertex, and the normal of the hull's edge over
    the obstacle's support point. Without the last candidate, predicted and actual separation would differ to first
    order.

    Args:
        hull: Swept vertices, with the vertices of the left node first, Shape (2v, p).
        outline: Obstacle vertices, Shape (k, p).
        normals: Outward obstacle edge normals, Shape (k, p).
        inward: Inward body edge normals at the left node, Shape (v, p).
        settings: Numbers of body edges and of hull vertices that are candidates.
    """
    closest, chord = _vertex_axes(hull, outline, normals)
    vertex = _stacked(closest, chord, Points(-chord.x, -chord.y))
    of_outline, of_vertices = _gaps(normals, hull, outline), _gaps(vertex, hull, outline)
    if inward.x.shape[0] > settings.facing_edges:
        axes, gaps = _stacked(normals, vertex), np.concatenate((of_outline, of_vertices))
        along = inward.along(axes.at(np.argmax(gaps, axis=0)))
        most = np.argsort(-along, axis=0, kind="stable")[: settings.facing_edges]  # as in the kernel
        inward = Points(np.take_along_axis(inward.x, most, axis=0), np.take_along_axis(inward.y, most, axis=0))
    axes = _stacked(normals, inward, vertex)
    gaps = np.concatenate((of_outline, _gaps(inward, hull, outline), of_vertices))
    best = np.argmax(gaps, axis=0)
    return _refined(axes.at(best), gaps[best, np.arange(best.size)], hull, outline, settings)


def _stacked(*points: Points) -> Points:
    """Stack the rows of several sets of vectors."""
    return Points(*(np.concatenate(values) for values in zip(*points, strict=True)))


def _gaps(axes: Points, hull: Points, outline: Points) -> FloatArray:
    """Return the separation along every axis. Shape (a, p)."""
    low = np.empty(axes.x.shape)
    top = np.empty(axes.x.shape)
    for some in _blocks(axes.x.shape[0] * max(hull.x.shape[0], outline.x.shape[0]), axes.x.shape[1]):
        x, y = axes.x[:, some], axes.y[:, some]
        low[:, some] = (x * hull.x[:, None, some] + y * hull.y[:, None, some]).min(axis=0)
        top[:, some] = (x * outline.x[:, None, some] + y * outline.y[:, None, some]).max(axis=0)
    return low - top


def _blocks(size: int, count: int) -> Iterator[slice]:
    """Yield slices of columns of `size` numbers each that fit in the cache."""
    step = max(1, _CACHED // size)
    return (slice(start, start + step) for start in range(0, count, step))


def _vertex_axes(hull: Points, outline: Points, fallback: Points) -> tuple[Points, Points]:
    """Return the direction between the closest vertices, and a normal of the closest vertex's chord. Shape (1, p)."""
    vertex, corner = _closest(hull, outline)
    here, there, count = hull.at(vertex), outline.at(corner), hull.x.shape[0]
    other = hull.at((vertex + count // 2) % count)
    safe = Points(fallback.x[:1], fallback.y[:1])
    direct = _unit(Points(here.x - there.x, here.y - there.y), safe)
    return direct, _unit(Points(here.y - other.y, other.x - here.x), safe)


def _closest(hull: Points, outline: Points) -> tuple[IntArray, IntArray]:
    """Return the indices of the closest vertices of every hull and its obstacle, Shape (p,) each."""
    size = hull.x.shape[0] * outline.x.shape[0]
    best = np.empty(hull.x.shape[1], dtype=np.int64)
    for some in _blocks(size, best.size):
        dx = hull.x[:, None, some] - outline.x[:, some]
        dy = hull.y[:, None, some] - outline.y[:, some]
        best[some] = np.argmin((dx * dx + dy * dy).reshape(size, -1), axis=0)
    vertex, corner = np.divmod(best, outline.x.shape[0])
    return vertex, corner


def _unit(vectors: Points, fallback: Points) -> Points:
    """Return vectors scaled to length 1, or the fallback for vectors shorter than 1e-9."""
    length = np.hypot(vectors.x, vectors.y)
    short = length < 1e-9
    if not short.any():
        return Points(vectors.x / length, vectors.y / length)
    length = np.where(short, 1.0, length)
    return Points(np.where(short, fallback.x, vectors.x / length), np.where(short, fallback.y, vectors.y / length))


class Chords(NamedTuple):
    """Chords between the vertices of every hull that may form its lower side, from left to right; Shape (c, p) each.

    `first`, `second`: vertex indices. `along`, `height`: coordinates of the first vertex. `run`, `rise`: differences to
    the second vertex, run >= 0.
    """

    first: IntArray
    second: IntArray
    along: FloatArray
    height: FloatArray
    run: FloatArray
    rise: FloatArray

    def levels(self, place: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Return the share of the second vertex at tangent coordinates `place`, and whether the chord reaches them."""
        usable = self.run > 1e-12
        share = (place - self.along) / np.where(usable, self.run, 1.0)
        return share, usable & (share >= -1e-9) & (share <= 1.0 + 1e-9)


def chords(along: FloatArray, height: FloatArray, settings: CollisionSettings) -> Chords:
    """Return all chords between points at tangent coordinates `along`, Shape (k, p), or the lowest of them."""
    columns = np.arange(along.shape[1])
    if along.shape[0] > settings.lowest_vertices:
        lowest = np.argmin(height, axis=0)
        tilted = height - settings.lowest_slope * np.abs(along - along[lowest, columns])
        kept = np.argpartition(tilted, settings.lowest_vertices, axis=0)[: settings.lowest_vertices]
        beside = np.take_along_axis(along, kept, axis=0)
        order = np.take_along_axis(kept, np.argsort(beside, axis=0, kind="stable"), axis=0)
    else:
        order = np.argsort(along, axis=0, kind="stable")  # as in the kernels
    along, height = along[order, columns], height[order, columns]
    a, b = _all_pairs(len(order))
    return Chords(order[a], order[b], along[a], height[a], along[b] - along[a], height[b] - height[a])


@cache
def _all_pairs(count: int) -> tuple[IntArray, IntArray]:
    """Return the indices of all pairs among `count` elements."""
    first, second = np.triu_indices(count, 1)
    return readonly(first), readonly(second)


def _refined(axis: Points, gap: FloatArray, hull: Points, outline: Points, settings: CollisionSettings) -> Points:
    """Return the normal of the hull's lower edge over the obstacle's support point if it separates more, or `axis`."""
    support = outline.at(np.argmax(outline.along(axis), axis=0))
    lines = chords(hull.across(axis), hull.along(axis), settings)
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
