"""Clearance of the footprint swept along a roll-out: broad phase and narrow phase, in C or by NumPy.

The twin of the kernel is the sequence of `collision_scene.body_at_nodes`, `broad_phase` and `narrow_phase`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

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
    from optdock.geometry.arrays import FloatArray, IntArray
    from smoothers.scp.basis import Basis
    from smoothers.scp.collision.collision_scene import Scene
    from smoothers.scp.rollout import Rollout

__all__ = ["Room", "clearance_along"]

_KERNEL = Kernel("optdock_clearance_along", sizes=12, numbers=4)
assert (DOCKING, FULL, LEAVING, UNDOCKING) == (0, 1, 2, 3)  # constants of the kernel


class Room(NamedTuple):
    """Sizes of the kernel's arrays."""

    scene: int
    nodes: int
    corners: int  # of a swept hull
    pairs: int  # most pairs
    width: int  # numbers per pair
    work: int
    indices: int

    @classmethod
    def of(cls, scene: Scene, basis: Basis) -> Room:
        """Return the sizes for a scene and a basis."""
        settings, (count, k, _) = scene.settings, scene.obstacles.vertices.shape
        parts, v, _ = scene.body.vertices.shape
        nodes, rows = basis.num_nodes, parts * basis.num_intervals
        room = rows * count
        most = min(room, max(settings.few_pairs, rows * settings.nearest * settings.nearest_close))
        size = parts * (5 * v + 4) + count * (4 * k + 4) + RULE_NUMBERS
        work = 2 * parts * nodes * (v + 2) + 8 * rows + room + 8 * v + 2 * nodes
        return cls(size, nodes, 2 * v, most, 6 * v + 2 * k + 4, work, 4 * room + rows)

    def clearance(self, pairs: IntArray, out: FloatArray) -> Clearance:
        """Return the result of the kernel, as views of its arrays, which end with the last pair."""
        n = self.nodes
        p = (pairs.size - n) // 3
        required = Requirement(out[:n], out[n : 3 * n].reshape(n, 2), pairs[:n], out[3 * n : 4 * n])
        table = out[4 * n :].reshape(self.width, p)
        return Clearance(Pairs(*pairs[n:].reshape(3, p)), table[-1], required, table, self.corners)


def _by_kernel(scene: Scene, basis: Basis, rollout: Rollout, signs: FloatArray, reach: float) -> Clearance:
    settings, (count, k, _) = scene.settings, scene.obstacles.vertices.shape
    (parts, v, _), nodes, room = scene.body.vertices.shape, basis.num_nodes, Room.of(scene, basis)
    pairs, out = np.empty(nodes + 3 * room.pairs, dtype=np.int64), np.empty(4 * nodes + room.width * room.pairs)
    arrays = (
        (scene.packed, room.scene),
        (rollout.packed, 4 * nodes + 6 * basis.num_intervals),
        (signs, basis.num_gears),
        (basis.left, basis.num_intervals),
        (pairs, pairs.size),
        (out, out.size),
        (np.empty(room.work), room.work),
        (np.empty(room.indices, dtype=np.int64), room.indices),
    )
    counts = (parts, v, count, k, nodes, basis.num_intervals, settings.few_pairs, settings.nearest)
    selection = settings.nearest_close, settings.grouped_intervals, settings.lowest_vertices, settings.facing_edges
    close = scene.rule.required + settings.surely_kept
    p = _KERNEL((*counts, *selection), (scene.body.radius, reach, close, settings.lowest_slope), arrays)
    return room.clearance(pairs[: nodes + 3 * p], out[: 4 * nodes + room.width * p])


@twin_of(_by_kernel)
def clearance_along(scene: Scene, basis: Basis, rollout: Rollout, signs: FloatArray, reach: float) -> Clearance:
    """Return the proven margins of the pairs that the broad phase finds within `reach` [m].

    Args:
        scene: Obstacles, body and rule.
        basis: Shape of the path.
        rollout: The path.
        signs: Gears, Shape (num_gears,).
        reach: See `broad_phase`.
    """
    body = body_at_nodes(scene, rollout.poses)
    pairs = broad_phase(scene, basis, rollout, body, reach)
    return narrow_phase(scene, basis, rollout, signs, body, pairs)
