"""Linearization: selection of active pairs, and their clearance as linear rows that are exact to first order.

Separating planes: each row constrains the point of the hull above the obstacle at a given tangent coordinate. This
point is a combination of two hull vertices, possibly at different nodes. Rows that keep whole vertices above a fixed
plane would also be safe, but would prevent a side of the body from pivoting around the corner of an obstacle.

Covering discs: if the body overlaps an obstacle deeply, the axes of least overlap of neighbouring intervals may point
to opposite sides. The centre line of the body crosses an obstacle only if the overlap is much deeper, so neighbouring
discs along the centre line are pushed to the same side. The signed distance of a disc to the obstacle is exact.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.kernels import Kernel, twin_of
from smoothers.scp.collision.narrow_phase import chords

if TYPE_CHECKING:
    from optdock.geometry.arrays import BoolArray, FloatArray, IntArray
    from smoothers.scp.basis import Basis
    from smoothers.scp.collision.broad_phase import Pairs
    from smoothers.scp.collision.collision_scene import Scene
    from smoothers.scp.collision.narrow_phase import Chords, Clearance
    from smoothers.scp.rollout import Rollout, Sensitivity
    from smoothers.scp.settings import CollisionSettings

__all__ = [
    "ActivePairs",
    "ClearanceRows",
    "active_pairs",
    "covering_disc_rows",
    "linearized_clearance",
    "local_minima",
    "separating_plane_rows",
    "small_obstacles",
]


class ActivePairs(NamedTuple):
    """Ascending indices of the pairs with planes, Shape (n,), and of deep overlaps with discs, Shape (m,)."""

    separated: IntArray
    penetrating: IntArray


def active_pairs(scene: Scene, found: Clearance, num_intervals: int, most: int) -> ActivePairs:
    """Return all near pairs, or a selection with at most `most` planes.

    While many pairs are in collision, a small obstacle has planes only in the intervals where the body comes closest.
    The rows of neighbouring intervals are nearly equal and would displace rows of other obstacles.
    """
    settings, worst = scene.settings, float(np.minimum.reduce(found.margin, initial=np.inf))
    deep = _deeply_penetrating(found.margin, worst, scene.body.width, settings)
    chosen = ~deep
    limit = min(most, max(settings.few_planes, num_intervals))
    if settings.thins_small_obstacles and worst < -settings.clear and np.count_nonzero(chosen) > limit:
        is_small = small_obstacles(scene)[found.pairs.obstacle]
        chosen &= ~is_small | local_minima(found.pairs, found.margin)
    (planes,) = chosen.nonzero()
    planes = planes[_smallest(found.margin[planes], limit)]
    return ActivePairs(planes, deep.nonzero()[0])


def small_obstacles(scene: Scene) -> BoolArray:
    """Return a mask of the obstacles that are smaller than the body is wide. Shape (number of obstacles,)."""
    extent = scene.obstacles.upper - scene.obstacles.lower
    small: BoolArray = np.maximum(extent[:, 0], extent[:, 1]) < scene.body.width
    return small


def _smallest(values: FloatArray, most: int) -> IntArray:
    """Return the ascending indices of the `most` smallest values, the first ones among equal values."""
    return np.sort(np.argsort(values, kind="stable")[:most])


def _deeply_penetrating(margin: FloatArray, worst: float, width: float, settings: CollisionSettings) -> BoolArray:
    """Return a mask of the pairs whose overlap is so deep that the correct side of the obstacle is ambiguous.

    The mask has Shape (p,). If any overlap is very deep, pairs with a small positive margin are also included.
    """
    if worst >= -settings.deep * width:
        return np.zeros(margin.size, dtype=np.bool_)
    least = -settings.deep if worst >= -settings.very_deep else settings.near_deep
    deep: BoolArray = margin < least * width
    return deep


def local_minima(pairs: Pairs, margin: FloatArray) -> BoolArray:
    """Return a mask of the pairs at local minima of the distance over neighbouring intervals. Shape (p,)."""
    order = np.lexsort((pairs.interval, pairs.obstacle, pairs.part))
    interval, part, obstacle = (np.diff(column[order]) for column in pairs)
    neighbours = (interval == 1) & (part == 0) & (obstacle == 0)
    value = margin[order]
    lowest = np.ones(margin.size, dtype=np.bool_)
    lowest[:-1] &= ~neighbours | (value[:-1] <= value[1:])
    lowest[1:] &= ~neighbours | (value[1:] <= value[:-1])
    result = np.empty(margin.size, dtype=np.bool_)
    result[order] = lowest
    return result


class ClearanceRows(NamedTuple):
    """Constraints `gradient . step + gap >= 0`: gradient (r, size), gap (r,) [m], and the node of each row (r,)."""

    gradient: FloatArray
    gap: FloatArray
    node: IntArray

    def subset(self, keep: IntArray | BoolArray) -> ClearanceRows:
        """Return the rows selected by `keep`."""
        return ClearanceRows(self.gradient[keep], self.gap[keep], self.node[keep])

    def joined(self, others: ClearanceRows) -> ClearanceRows:
        """Return these rows, followed by others."""
        return ClearanceRows(*(np.concatenate(both) for both in zip(self, others, strict=True)))

    def lowest(self, most: int) -> ClearanceRows:
        """Return the `most` rows with the smallest gaps."""
        return self if self.gap.size <= most else self.subset(_smallest(self.gap, most))


def linearized_clearance(
    scene: Scene, basis: Basis, rollout: Rollout, by: Sensitivity, found: Clearance, active: ActivePairs
) -> ClearanceRows:
    """Return the rows of the active pairs, except rows that depend only on the given start pose."""
    if found.margin.size == 0:
        return ClearanceRows(np.zeros((0, basis.size)), np.zeros(0), np.zeros(0, dtype=np.int64))
    rows = separating_plane_rows(basis, rollout, by, found, active.separated, scene.settings)
    if active.penetrating.size:
        pushing = covering_disc_rows(scene, basis, rollout, by, found, active.penetrating)
        rows = rows.joined(pushing)
    kept = rows.node > 0
    if kept.all():
        return rows
    kept[~kept] = np.abs(rows.gradient[~kept]).max(axis=1, initial=0.0) >= 1e-9
    return rows.subset(kept)


_KERNEL = Kernel("optdock_separating_plane_rows", sizes=8, numbers=3)


def _rows_native(
    basis: Basis,
    rollout: Rollout,
    by: Sensitivity,
    found: Clearance,
    chosen: IntArray,
    settings: CollisionSettings,
) -> ClearanceRows:
    (width, p), v2, count, size = found.table.shape, len(found.heights), chosen.size, basis.size
    k = len(found.outline.x)
    node, rows = np.empty(12 * count, np.int64), np.empty(3 * count * (size + 3) + 4 * (v2 + k))
    arrays = (
        (chosen, count),
        (found.pairs.interval, p),
        (basis.left, basis.num_intervals),
        (found.table, width * p),
        (rollout.poses, 3 * basis.num_nodes),
        (found.required.gradient, 2 * basis.num_nodes),
        (by.x, basis.num_nodes * size),
        (by.y, basis.num_nodes * size),
        (by.yaw, basis.num_nodes * size),
        (node, node.size),
        (rows, rows.size),
    )
    sizes = p, count, v2, k, basis.num_nodes, basis.num_intervals, size, settings.lowest_vertices
    many = _KERNEL(sizes, (settings.support_slope, settings.same_witness, settings.lowest_slope), arrays)
    if many < 0:
        raise IndexError("chosen: must be columns of the pairs")
    gap = 3 * count * size
    return ClearanceRows(rows[: many * size].reshape(many, size), rows[gap : gap + many], node[:many])


@twin_of(_rows_native)
def separating_plane_rows(
    basis: Basis,
    rollout: Rollout,
    by: Sensitivity,
    found: Clearance,
    chosen: IntArray,
    settings: CollisionSettings,
) -> ClearanceRows:
    """Return up to three separating-plane rows for every chosen pair of `found`."""
    picked = _witnesses(found, chosen, settings)
    place, pair = np.nonzero(picked.used)
    columns = chosen[pair]
    left = basis.left[found.pairs.interval[columns]]
    axis_x, axis_y = found.axis.x[0, columns], found.axis.y[0, columns]
    vertex = np.concatenate((picked.first[place, pair], picked.second[place, pair]))
    share = picked.share[place, pair]
    weight, both = np.concatenate((1.0 - share, share)), np.concatenate((columns, columns))
    node = np.concatenate((left, left)) + (vertex >= found.hull.x.shape[0] // 2)
    arm_x = found.hull.x[vertex, both] - rollout.poses[node, 0]
    arm_y = found.hull.y[vertex, both] - rollout.poses[node, 1]
    axis_x, axis_y = np.concatenate((axis_x, axis_x)), np.concatenate((axis_y, axis_y))
    slope = found.required.gradient[node]
    gradient = (weight * (axis_x - slope[:, 0]))[:, None] * by.x[node]
    gradient += (weight * (axis_y - slope[:, 1]))[:, None] * by.y[node]
    gradient += (weight * (axis_y * arm_x - axis_x * arm_y))[:, None] * by.yaw[node]
    half = len(left)
    return ClearanceRows(gradient[:half] + gradient[half:], picked.gap[place, pair], left)


class _Witness(NamedTuple):
    """Witness points on the hull: two vertices, share of the second, gap, and whether it is used; Shape (t, p) each."""

    first: IntArray
    second: IntArray
    share: FloatArray
    gap: FloatArray
    used: BoolArray


def _witnesses(found: Clearance, chosen: IntArray, settings: CollisionSettings) -> _Witness:
    axis, hull, outline = (points.columns(chosen) for points in (found.axis, found.hull, found.outline))
    along, height = hull.across(axis), found.heights[:, chosen]
    beside, tops = outline.across(axis), outline.along(axis)
    lower, upper = chords(along, height, settings), chords(beside, -tops, settings)
    low, high, meets = _shared_support(along, height, beside, tops, settings.support_slope)
    bottom = along[np.argmin(height, axis=0), np.arange(chosen.size)]
    place = np.where(meets, np.stack((np.clip(bottom, low, high), low, high)), bottom)
    ceiling = np.where(meets, _upper_side(upper, tops, place), found.top[chosen])
    first, second, share, level = _lower_side(lower, height, place)
    used = np.abs(place - place[0]) > settings.same_witness
    used[0] = True
    return _Witness(first, second, share, level - ceiling, used)


def _shared_support(
    along: FloatArray, height: FloatArray, beside: FloatArray, tops: FloatArray, slope: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the tangent range in which both sides are nearly flat, and whether it is not empty. Shape (p,) each."""
    columns = np.arange(along.shape[1])
    i, j = np.argmin(height, axis=0), np.argmax(tops, axis=0)
    of_hull = height <= height[i, columns] + slope * np.abs(along - along[i, columns]) + 1e-9
    of_obstacle = tops >= tops[j, columns] - slope * np.abs(beside - beside[j, columns]) - 1e-9
    low = np.maximum(np.where(of_hull, along, np.inf).min(axis=0), np.where(of_obstacle, beside, np.inf).min(axis=0))
    high = np.minimum(np.where(of_hull, along, -np.inf).max(axis=0), np.where(of_obstacle, beside, -np.inf).max(axis=0))
    return low, high, high >= low


def _upper_side(lines: Chords, tops: FloatArray, place: FloatArray) -> FloatArray:
    """Return the height of the obstacle's upper side at tangent coordinates `place`. Shape (t, p)."""
    share, spans = lines.levels(place[:, None])
    highest: FloatArray = np.where(spans, -lines.height - share * lines.rise, -np.inf).max(axis=1)
    return np.where(np.isfinite(highest), highest, tops.max(axis=0))


def _lower_side(
    lines: Chords, height: FloatArray, place: FloatArray
) -> tuple[IntArray, IntArray, FloatArray, FloatArray]:
    """Return vertices, share of the second, and height of the hull's lower side at `place`. Shape (t, p) each."""
    columns = np.arange(height.shape[1])
    share, spans = lines.levels(place[:, None])
    level = np.where(spans, lines.height + share * lines.rise, np.inf)  # (t, c, p)
    best = np.argmin(level, axis=1)
    times = np.arange(len(place))[:, None]
    picked, part = level[times, best, columns], share[times, best, columns]
    bottom = np.argmin(height, axis=0)
    lost = ~np.isfinite(picked)
    return (
        np.where(lost, bottom, lines.first[best, columns]),
        np.where(lost, bottom, lines.second[best, columns]),
        np.where(lost, 0.0, np.clip(part, 0.0, 1.0)),
        np.where(lost, height[bottom, columns], picked),
    )


def covering_disc_rows(
    scene: Scene, basis: Basis, rollout: Rollout, by: Sensitivity, found: Clearance, chosen: IntArray
) -> ClearanceRows:
    """Return rows that move the deepest discs of the chosen pairs out of their obstacles."""
    parts = [
        _part_rows(scene, rollout, basis, found, chosen[found.pairs.part[chosen] == b], b)
        for b in range(len(scene.body.vertices))
    ]
    node, arm, normal, gap = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    gradient = normal[:, :1] * by.x[node] + normal[:, 1:] * by.y[node]
    gradient += (normal[:, 1] * arm[:, 0] - normal[:, 0] * arm[:, 1])[:, None] * by.yaw[node]
    return ClearanceRows(gradient, gap - found.required.value[node], node)


def _part_rows(
    scene: Scene, rollout: Rollout, basis: Basis, found: Clearance, chosen: IntArray, part: int
) -> tuple[IntArray, FloatArray, FloatArray, FloatArray]:
    discs = scene.body.discs
    centres, radius = discs.centres[part, : discs.counts[part]], discs.radii[part]
    left = basis.left[found.pairs.interval[chosen]]
    both = np.concatenate((left, left + 1))
    count = len(scene.obstacles)
    node, obstacle = np.divmod(np.unique(both * count + np.tile(found.pairs.obstacle[chosen], 2)), count)
    yaw = rollout.poses[node, 2][:, None]
    c, s = np.cos(yaw), np.sin(yaw)
    arm = np.stack((c * centres[:, 0] - s * centres[:, 1], s * centres[:, 0] + c * centres[:, 1]), axis=-1)
    points = rollout.poses[node, None, :2] + arm
    distance, normal = _signed_distance(points, scene.obstacles.vertices[obstacle], scene.obstacles.normals[obstacle])
    order = np.argsort(distance, axis=1, kind="stable")[:, : scene.settings.discs_per_node]
    rows = np.arange(len(node))[:, None]
    flat = np.repeat(node, order.shape[1])
    gap = distance[rows, order].ravel() - radius
    return flat, arm[rows, order].reshape(-1, 2), normal[rows, order].reshape(-1, 2), gap


def _signed_distance(points: FloatArray, outline: FloatArray, normals: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the distance of points (p, d, 2) to polygons (p, k, 2), negative inside, and its gradient (p, d, 2)."""
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
