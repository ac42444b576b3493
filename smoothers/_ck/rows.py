"""Linear clearance constraints: exact first-order change of the gap at the points that witness it.

A row moves the hull point over the obstacle at a tangent coordinate: a mix of two hull vertices, possibly of different
nodes. Holding only whole vertices above a fixed line would be safe too, but then no side could roll around a corner.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from smoothers._ck.axes import chords

if TYPE_CHECKING:
    from optdock.geometry.arrays import BoolArray, FloatArray, IntArray
    from smoothers._ck.layout import Layout
    from smoothers._ck.planes import Clearance
    from smoothers._ck.rollout import Rollout, Sensitivity

__all__ = ["Rows", "empty_rows", "joined", "witness_rows"]

_SUPPORT_SLOPE = 0.35
_SAME_WITNESS = 0.005  # [m]


class Rows(NamedTuple):
    """Constraints `gradient . step + gap >= 0`: (r, size), (r,) [m], and the node each belongs to (r,)."""

    gradient: FloatArray
    gap: FloatArray
    node: IntArray

    def subset(self, keep: IntArray | BoolArray) -> Rows:
        """The rows at `keep`."""
        return Rows(self.gradient[keep], self.gap[keep], self.node[keep])


class _Witness(NamedTuple):
    """Hull points: two hull vertices, the share of the second, the gap there, and which count; Shape (t, p) each."""

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
    return Rows(
        np.concatenate((first.gradient, second.gradient)),
        np.concatenate((first.gap, second.gap)),
        np.concatenate((first.node, second.node)),
    )


def witness_rows(layout: Layout, rollout: Rollout, by: Sensitivity, found: Clearance, chosen: IntArray) -> Rows:
    """Up to three rows for every chosen pair of `found`."""
    picked = _witnesses(found, chosen)
    place, pair = np.nonzero(picked.used)
    columns = chosen[pair]
    left = layout.left[found.pairs.interval[columns]]
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
    return Rows(gradient[:half] + gradient[half:], picked.gap[place, pair], left)


def _witnesses(found: Clearance, chosen: IntArray) -> _Witness:
    axis, hull, outline = (points.columns(chosen) for points in (found.axis, found.hull, found.outline))
    along, height = hull.across(axis), found.heights[:, chosen]
    beside, tops = outline.across(axis), outline.along(axis)
    low, high, meets = _shared_support(along, height, beside, tops)
    bottom = along[np.argmin(height, axis=0), np.arange(chosen.size)]
    place = np.where(meets, np.stack((np.clip(bottom, low, high), low, high)), bottom)
    ceiling = np.where(meets, _upper_side(beside, tops, place), found.top[chosen])
    first, second, share, level = _lower_side(along, height, place)
    used = np.abs(place - place[0]) > _SAME_WITNESS
    used[0] = True
    return _Witness(first, second, share, level - ceiling, used)


def _shared_support(
    along: FloatArray, height: FloatArray, beside: FloatArray, tops: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Tangent range over which both sides are nearly flat, and whether it is not empty. Shape (p,) each."""
    columns = np.arange(along.shape[1])
    i, j = np.argmin(height, axis=0), np.argmax(tops, axis=0)
    of_hull = height <= height[i, columns] + _SUPPORT_SLOPE * np.abs(along - along[i, columns]) + 1e-9
    of_rock = tops >= tops[j, columns] - _SUPPORT_SLOPE * np.abs(beside - beside[j, columns]) - 1e-9
    low = np.maximum(np.where(of_hull, along, np.inf).min(axis=0), np.where(of_rock, beside, np.inf).min(axis=0))
    high = np.minimum(np.where(of_hull, along, -np.inf).max(axis=0), np.where(of_rock, beside, -np.inf).max(axis=0))
    return low, high, high >= low


def _upper_side(beside: FloatArray, tops: FloatArray, place: FloatArray) -> FloatArray:
    """Height of the obstacle's upper side at tangent coordinates `place`. Shape (t, p)."""
    lines = chords(beside, -tops)
    share, spans = lines.levels(place[:, None])
    highest: FloatArray = np.where(spans, -lines.height - share * lines.rise, -np.inf).max(axis=1)
    return np.where(np.isfinite(highest), highest, tops.max(axis=0))


def _lower_side(
    along: FloatArray, height: FloatArray, place: FloatArray
) -> tuple[IntArray, IntArray, FloatArray, FloatArray]:
    """Vertices, share of the second, and height of the hull's lower side at `place`. Shape (t, p) each."""
    lines, columns = chords(along, height), np.arange(along.shape[1])
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
