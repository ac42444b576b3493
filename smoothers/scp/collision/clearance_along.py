"""Clearance of the footprint swept along a roll-out: broad phase and narrow phase, in C or by NumPy.

The twin of the kernel is the sequence of `collision_scene.body_at_nodes`, `broad_phase` and `narrow_phase`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from optdock.kernels import Kernel, twin_of
from smoothers.scp.collision.broad_phase import Pairs, broad_phase
from smoothers.scp.collision.collision_scene import (
    DOCKING,
    FULL,
    LEAVING,
    RULE_NUMBERS,
    UNDOCKING,
    Requirement,
    body_at_nodes,
)
from smoothers.scp.collision.narrow_phase import Clearance, narrow_phase

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray
    from smoothers.scp.basis import Basis
    from smoothers.scp.collision.collision_scene import Scene
    from smoothers.scp.rollout import Rollout

__all__ = ["clearance_along"]

_KERNEL = Kernel("optdock_clearance_along", sizes=11, numbers=4)
assert (DOCKING, FULL, LEAVING, UNDOCKING) == (0, 1, 2, 3)  # constants of the kernel


def clearance_along(scene: Scene, basis: Basis, rollout: Rollout, signs: FloatArray, reach: float) -> Clearance:
    """Return the proven margins of the pairs that the broad phase finds within `reach` [m].

    Args:
        scene: Obstacles, body and rule.
        basis: Shape of the path.
        rollout: The path.
        signs: Gears, Shape (num_gears,).
        reach: See `broad_phase`.
    """
    # The kernel evaluates all edges of the body; of many edges the twin selects some.
    has_many_edges = scene.body.vertices.shape[1] > scene.settings.facing_edges
    return (_by_numpy if has_many_edges else _along)(scene, basis, rollout, signs, reach)


def _by_numpy(scene: Scene, basis: Basis, rollout: Rollout, signs: FloatArray, reach: float) -> Clearance:
    body = body_at_nodes(scene, rollout.poses)
    pairs = broad_phase(scene, basis, rollout, body, reach)
    return narrow_phase(scene, basis, rollout, signs, body, pairs)


def _by_kernel(scene: Scene, basis: Basis, rollout: Rollout, signs: FloatArray, reach: float) -> Clearance:
    settings, (count, k, _) = scene.settings, scene.obstacles.vertices.shape
    parts, v, _ = scene.body.vertices.shape
    nodes, rows = basis.num_nodes, parts * basis.num_intervals
    room = rows * count
    most = min(room, max(settings.few_pairs, rows * settings.nearest * settings.nearest_close))
    width = 6 * v + 2 * k + 4
    found, out = np.empty(nodes + 3 * most, dtype=np.int64), np.empty(4 * nodes + width * most)
    size = 2 * parts * nodes * (v + 2) + 8 * rows + room + 8 * v + 2 * nodes
    arrays = (
        (scene.packed, parts * (5 * v + 4) + count * (4 * k + 4) + RULE_NUMBERS),
        (rollout.packed, 4 * nodes + 6 * basis.num_intervals),
        (signs, basis.num_gears),
        (basis.left, basis.num_intervals),
        (found, found.size),
        (out, out.size),
        (np.empty(size), size),
        (np.empty(4 * room + rows, dtype=np.int64), 4 * room + rows),
    )
    counts = (parts, v, count, k, nodes, basis.num_intervals, settings.few_pairs, settings.nearest)
    selection = (settings.nearest_close, settings.grouped_intervals, settings.lowest_vertices)
    close = scene.rule.required + settings.surely_kept
    p = _KERNEL((*counts, *selection), (scene.body.radius, reach, close, settings.lowest_slope), arrays)
    gradient = out[nodes : 3 * nodes].reshape(nodes, 2)
    required = Requirement(out[:nodes], gradient, found[:nodes], out[3 * nodes : 4 * nodes])
    table = out[4 * nodes : 4 * nodes + width * p].reshape(width, p)
    return Clearance.within(table, 2 * v, Pairs(*found[nodes : nodes + 3 * p].reshape(3, p)), required)


_along = twin_of(_by_kernel)(_by_numpy)
