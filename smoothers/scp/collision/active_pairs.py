"""Active pairs: which near pairs get rows in the next step, a separating plane each, or discs that push out."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from optdock.geometry.arrays import BoolArray, FloatArray, IntArray
    from smoothers.scp.collision.broad_phase import Pairs
    from smoothers.scp.collision.collision_scene import Scene
    from smoothers.scp.collision.narrow_phase import Clearance
    from smoothers.scp.settings import CollisionSettings

__all__ = ["ActivePairs", "active_pairs", "local_minima"]


class ActivePairs(NamedTuple):
    """Pairs to keep apart by planes, and deeply penetrating ones to push out by discs; ascending, Shape (n,), (m,)."""

    separated: IntArray
    penetrating: IntArray


def active_pairs(scene: Scene, found: Clearance, num_intervals: int, most: int) -> ActivePairs:
    """All near pairs, or of very many those that tell the most.

    While the path is not clear of many, a small obstacle gets planes only where a passing body comes closest: its rows
    in the neighbouring intervals say nearly the same, and would crowd out those of obstacles on the other side. Later,
    when the path slides along obstacles, all of its rows tell where to.

    Args:
        scene: Obstacles and body.
        found: Near pairs.
        num_intervals: Of the path; so many planes may always be.
        most: Planes are never more than this.
    """
    settings, worst = scene.settings, float(found.margin.min(initial=np.inf))
    deep = _deeply_penetrating(found.margin, worst, scene.body.width, settings)
    chosen = ~deep
    limit = min(most, max(settings.few_planes, num_intervals))
    if settings.thins_small_obstacles and worst < -settings.clear and np.count_nonzero(chosen) > limit:
        small = 2.0 * np.maximum(scene.box_half.x[0], scene.box_half.y[0]) < scene.body.width
        chosen &= ~small[found.pairs.obstacle] | local_minima(found.pairs, found.margin)
    planes = np.flatnonzero(chosen)
    if planes.size > limit:
        planes = np.sort(planes[np.argpartition(found.margin[planes], limit)[:limit]])
    return ActivePairs(planes, np.flatnonzero(deep))


def _deeply_penetrating(margin: FloatArray, worst: float, width: float, settings: CollisionSettings) -> BoolArray:
    """Pairs without a side; while one is far inside an obstacle its neighbours count as such too. Shape (p,)."""
    if worst >= -settings.deep * width:
        return np.zeros(margin.size, dtype=np.bool_)
    least = -settings.deep if worst >= -settings.very_deep else settings.near_deep
    deep: BoolArray = margin < least * width
    return deep


def local_minima(pairs: Pairs, margin: FloatArray) -> BoolArray:
    """Pairs whose body part is nowhere closer to the same obstacle in the intervals before and after. Shape (p,)."""
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
