"""Linear clearance constraints: exact first-order change of the gap at the points that witness it.

A row moves the hull point over the obstacle at a tangent coordinate: a mix of two hull vertices, possibly of different
nodes. Holding only whole vertices above a fixed line would be safe too, but then no side could roll around a corner.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from smoothers._ck.axes import lowest_points

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray, IntArray
    from smoothers._ck.layout import Layout
    from smoothers._ck.planes import Clearance
    from smoothers._ck.rollout import Rollout, Sensitivity
    from smoothers._ck.world import World

__all__ = ["Rows", "empty_rows", "joined", "witness_rows"]

_SUPPORT_SLOPE = 0.35
_SAME_WITNESS = 0.005  # [m]


class Rows(NamedTuple):
    """Constraints `gradient . step + gap >= 0`: (r, size), (r,) [m], and the node each belongs to (r,)."""

    gradient: FloatArray
    gap: FloatArray
    node: IntArray


class _Witness(NamedTuple):
    """Hull points: two hull vertices, the share of the second, and the gap there; (p, t) each, and which count."""

    first: IntArray
    second: IntArray
    share: FloatArray
    gap: FloatArray
    used: FloatArray


def empty_rows(size: int) -> Rows:
    """No constraint."""
    return Rows(np.zeros((0, size)), np.zeros(0), np.zeros(0, dtype=np.int64))


def joined(first: Rows, second: Rows) -> Rows:
    """Both sets."""
    return Rows(*(np.concatenate(pair) for pair in zip(first, second, strict=True)))


def witness_rows(
    world: World, layout: Layout, rollout: Rollout, by: Sensitivity, found: Clearance, chosen: IntArray
) -> Rows:
    """Up to three rows for every chosen pair of `found`."""
    count = found.hull.shape[1] // 2
    picked = _witnesses(world, found, chosen)
    pair, place = np.nonzero(picked.used)
    left = layout.left[found.pairs.interval[chosen[pair]]]
    axis, hull = found.axis[chosen[pair]], found.hull[chosen[pair]]
    first, second, share = picked.first[pair, place], picked.second[pair, place], picked.share[pair, place]
    gradient = np.zeros((pair.size, layout.size))
    rows = np.arange(pair.size)
    for vertex, weight in ((first, 1.0 - share), (second, share)):
        node = left + (vertex >= count)
        arm = hull[rows, vertex] - rollout.poses[node, :2]
        slope = found.required.gradient[node]
        gradient += (weight * (axis[:, 0] - slope[:, 0]))[:, None] * by.x[node]
        gradient += (weight * (axis[:, 1] - slope[:, 1]))[:, None] * by.y[node]
        gradient += (weight * (axis[:, 1] * arm[:, 0] - axis[:, 0] * arm[:, 1]))[:, None] * by.yaw[node]
    return Rows(gradient, picked.gap[pair, place], left)


def _witnesses(world: World, found: Clearance, chosen: IntArray) -> _Witness:
    axis, hull, height = found.axis[chosen], found.hull[chosen], found.heights[chosen]
    outline = world.obstacles.vertices[found.pairs.obstacle[chosen]]
    along = -axis[:, 1:] * hull[..., 0] + axis[:, :1] * hull[..., 1]
    tops = axis[:, :1] * outline[..., 0] + axis[:, 1:] * outline[..., 1]
    beside = -axis[:, 1:] * outline[..., 0] + axis[:, :1] * outline[..., 1]
    low, high, meets = _shared_support(along, height, beside, tops)
    rows = np.arange(len(chosen))
    bottom = along[rows, np.argmin(height, axis=1)]
    place = np.column_stack((np.clip(bottom, low, high), low, high))
    place = np.where(meets[:, None], place, bottom[:, None])
    ceiling = np.where(meets[:, None], _upper_side(beside, tops, place), found.top[chosen][:, None])
    first, second, share, level = _lower_side(along, height, place)
    apart = np.abs(place - place[:, :1]) > _SAME_WITNESS
    used = np.column_stack((np.ones(len(chosen), dtype=bool), apart[:, 1:]))
    return _Witness(first, second, share, level - ceiling, used)


def _shared_support(
    along: FloatArray, height: FloatArray, beside: FloatArray, tops: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Tangent range over which both sides are nearly flat, and whether it is not empty. Shape (p,) each."""
    rows = np.arange(len(along))
    i, j = np.argmin(height, axis=1), np.argmax(tops, axis=1)
    of_hull = height <= (height[rows, i][:, None] + _SUPPORT_SLOPE * np.abs(along - along[rows, i][:, None]) + 1e-9)
    of_rock = tops >= (tops[rows, j][:, None] - _SUPPORT_SLOPE * np.abs(beside - beside[rows, j][:, None]) - 1e-9)
    low = np.maximum(np.where(of_hull, along, np.inf).min(axis=1), np.where(of_rock, beside, np.inf).min(axis=1))
    high = np.minimum(np.where(of_hull, along, -np.inf).max(axis=1), np.where(of_rock, beside, -np.inf).max(axis=1))
    return low, high, high >= low


def _upper_side(beside: FloatArray, tops: FloatArray, place: FloatArray) -> FloatArray:
    """Height of the obstacle's upper side at tangent coordinates `place`. Shape (p, t)."""
    level, _ = _chord_levels(beside, tops, place)
    highest: FloatArray = np.where(np.isnan(level), -np.inf, level).max(axis=2)
    return np.where(np.isfinite(highest), highest, tops.max(axis=1)[:, None])


def _lower_side(
    along: FloatArray, height: FloatArray, place: FloatArray
) -> tuple[IntArray, IntArray, FloatArray, FloatArray]:
    """Vertices, share of the second, and height of the hull's lower side at `place`. Shape (p, t) each."""
    rows = np.arange(len(along))[:, None]
    kept = lowest_points(along, height)
    along, height = along[rows, kept], height[rows, kept]
    level, share = _chord_levels(along, height, place)
    level = np.where(np.isnan(level), np.inf, level)
    best = np.argmin(level, axis=2)
    picked = np.take_along_axis(level, best[..., None], axis=2)[..., 0]
    part = np.take_along_axis(share, best[..., None], axis=2)[..., 0]
    first, second = kept[rows, best // kept.shape[1]], kept[rows, best % kept.shape[1]]
    bottom = kept[rows[:, 0], np.argmin(height, axis=1)][:, None]
    lost = ~np.isfinite(picked)
    floor = height.min(axis=1)[:, None]
    return (
        np.where(lost, bottom, first),
        np.where(lost, bottom, second),
        np.where(lost, 0.0, part),
        np.where(lost, floor, picked),
    )


def _chord_levels(along: FloatArray, height: FloatArray, place: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Height at `place` of the chord between every two points, NaN where it does not span; and the share of the second.

    Shape (p, t, k * k) each.
    """
    run = along[:, None, :] - along[:, :, None]
    rise = height[:, None, :] - height[:, :, None]
    usable = run > 1e-12
    inverse = 1.0 / np.where(usable, run, 1.0)
    share = (place[:, :, None, None] - along[:, None, :, None]) * inverse[:, None]
    spans = usable[:, None] & (share >= -1e-9) & (share <= 1.0 + 1e-9)
    level = np.where(spans, height[:, None, :, None] + share * rise[:, None], np.nan)
    flat = (len(along), place.shape[1], -1)
    return level.reshape(flat), np.clip(share, 0.0, 1.0).reshape(flat)
