"""Which near pairs get rows in the next step, and of which kind: separating planes, or discs that push out."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from optdock.geometry.arrays import BoolArray, FloatArray, IntArray
    from smoothers._ck.nearby import Pairs
    from smoothers._ck.planes import Clearance
    from smoothers._ck.world import World

__all__ = ["Watched", "local_minima", "watched_pairs"]

_FEWEST_PLANES = 80  # pairs: where there are more, not all of them get planes
_DEEP = 0.06  # of the body's width: overlap from which planes no longer tell the side
_VERY_DEEP = 0.18
_NEAR_DEEP = 0.15
_CLEAR = 1e-3  # [m]: a path with a smaller shortfall counts as clear


class Watched(NamedTuple):
    """Pairs with planes and pairs with discs, ascending, Shape (n,) and (m,)."""

    planes: IntArray
    discs: IntArray


def watched_pairs(world: World, found: Clearance, num_intervals: int, most: int) -> Watched:
    """All near pairs, or of very many those that tell the most.

    While the path is not clear of many, a small obstacle gets planes only where a passing body comes closest: its rows
    in the neighbouring intervals say nearly the same, and would crowd out those of obstacles on the other side. Later,
    when the path slides along obstacles, all of its rows tell where to.

    Args:
        world: Obstacles and body.
        found: At least one near pair.
        num_intervals: Of the path; so many planes may always be.
        most: Planes are never more than this.
    """
    worst = float(found.margin.min())
    deep = _deeply_overlapped(found.margin, worst, world.body.width)
    chosen = ~deep
    limit = min(most, max(_FEWEST_PLANES, num_intervals))
    if world.is_thinned and worst < -_CLEAR and np.count_nonzero(chosen) > limit:
        small = 2.0 * np.maximum(world.box_half.x[0], world.box_half.y[0]) < world.body.width
        chosen &= ~small[found.pairs.obstacle] | local_minima(found.pairs, found.margin)
    planes = np.flatnonzero(chosen)
    if planes.size > limit:
        planes = np.sort(planes[np.argpartition(found.margin[planes], limit)[:limit]])
    return Watched(planes, np.flatnonzero(deep))


def _deeply_overlapped(margin: FloatArray, worst: float, width: float) -> BoolArray:
    """Pairs without a side; while one is far inside an obstacle its neighbours count as such too. Shape (p,)."""
    if worst >= -_DEEP * width:
        return np.zeros(margin.size, dtype=np.bool_)
    deep: BoolArray = margin < (-_DEEP if worst >= -_VERY_DEEP else _NEAR_DEEP) * width
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
