"""Ways away from a wall beside the robot: arcs of which each is the sharpest that is free.

A robot along a wall cannot turn away from it at full lock: its tail swings out and meets the wall. Where the tail may
come some millimetres closer, it can slide along the wall while heading and curvature grow exponentially, equation (R9)
of `docs/theory/search.md`. Short arcs, each as sharp as the wall allows, follow that.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from optdock.geometry.arrays import readonly
from optdock.planners.manoeuvres.arcs import advance

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray, IntArray
    from optdock.planners.manoeuvres.free_space import Effort, FreeSpace
    from optdock.planners.manoeuvres.tree import ArcTree

__all__ = ["sharpest_arcs"]

_LENGTH, _MOST = 0.25, 24  # of an arc, in circumscribed radii; arcs of a chain
# In curvatures of the smallest radius: those tried first, and what the sharpest that is free is then multiplied by.
_COARSE = readonly(2.0 ** -np.arange(0.0, 12.0))
_FINE = readonly(2.0 ** (-np.arange(-7.0, 5.0) / 8.0))
# Poses of an arc at a first look; of a length as the robot is wide, at a close one, and of any arc at most.
_GLANCE, _CLOSE, _MOST_POSES = 4, 60.0, 40
_AT_ONCE = 2000  # poses looked at in one go, a millisecond or two
_MARGIN = 1e-4  # [m]: so much a smoother needs, and more than an arc comes closer between two of these


def sharpest_arcs(tree: ArcTree, rows: IntArray, gears: FloatArray, space: FreeSpace, effort: Effort) -> IntArray:
    """Drive chains of arcs to either side until full lock is free; the rows of the nodes after arcs at full lock.

    Args:
        tree: Where they are added.
        rows: Nodes where chains begin, Shape (n,).
        gears: Signs of their lengths, Shape (n,).
        space: What is free.
        effort: How sharply and how closely.
    """
    node, sign, side = np.repeat(rows, 2), np.repeat(gears, 2), np.tile([1.0, -1.0], rows.size)
    length, full = _LENGTH * space.footprint.circumscribed_radius, 1.0 / effort.radius
    many = min(int(np.ceil(length * _CLOSE / space.width)), _MOST_POSES)
    glance, close = (length * np.arange(1, n + 1) / n for n in (_GLANCE, many))

    def sharpest(curvatures: FloatArray, stations: FloatArray, margin: float) -> IntArray:
        """The first column of curvatures, Shape (k, m), at which an arc is free, m where none is. Shape (k,)."""
        found = np.empty(node.size, dtype=np.int64)
        step = max(1, _AT_ONCE // (curvatures.shape[1] * stations.size))
        for some in (slice(k, k + step) for k in range(0, node.size, step)):
            space.poll()
            bends = side[some, None, None] * curvatures[some, :, None]
            poses = advance(tree.poses[node[some], None, None], sign[some, None, None] * stations, bends)
            free = space.is_free(poses.reshape(-1, 3), margin, effort.start_relief).reshape(poses.shape[:3])
            is_free = np.column_stack((free.all(axis=2), np.ones(len(free), dtype=np.bool_)))
            found[some] = is_free.argmax(axis=1)
        return found

    ends = [rows[:0]]
    for _ in range(_MOST):
        first = sharpest(np.tile(full * _COARSE, (node.size, 1)), glance, 0.0)
        finer = np.minimum(full * np.append(_COARSE, 0.0)[first, None] * _FINE, full)
        best = sharpest(finer, close, _MARGIN)
        kept = (first < _COARSE.size) & (best < _FINE.size)
        if not kept.any():
            break
        fresh = tree.add(node[kept], sign[kept] * length, side[kept] * finer[kept, best[kept]])
        is_full = np.abs(tree.curvatures[fresh]) == full
        ends.append(fresh[is_full])
        before = tree.parents[tree.parents[fresh]]  # two more arcs at full lock, where they are free
        node = fresh[~is_full | (before < 0) | (np.abs(tree.curvatures[before]) < full)]
        sign, side = tree.signs[node], np.sign(tree.curvatures[node])
    return np.concatenate(ends)
