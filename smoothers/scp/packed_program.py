"""The constants of a program as two arrays, for the kernel `loop_kernel.c`."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.geometry.arrays import readonly
from smoothers.scp.collision.clearance_along import Room
from smoothers.scp.collision.linearization import small_obstacles
from smoothers.scp.qp_step import numbers_before_rows, trusted_nodes
from smoothers.terms import SYMBOLS

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray, IntArray
    from smoothers.scp.nlp import NonlinearProgram

__all__ = ["PackedProgram", "packed"]


class PackedProgram(NamedTuple):
    """The constants of a program."""

    counts: IntArray  # in the order of `Counts` and `Program` of the kernel, Shape (any,)
    numbers: FloatArray  # in the order of `Numbers` and `Program`, Shape (any,)
    room: Room  # sizes of the arrays of the kernel for clearance
    results: int  # index of the cost in `Iterate.values`
    points: int  # numbers at the end of `Iterate.values` for the terms of the user
    work: int  # numbers that an evaluation needs
    trusted: int  # number of headings that the trust region bounds
    columns: int  # variables of a step: knots, gears and slacks
    rows: int  # constraints of a step before those of clearance
    before_rows: int  # numbers of `Linearization.values` before the rows
    of_step: tuple[int, int]  # numbers and integers that the kernel of a step needs, without the guess


def packed(nlp: NonlinearProgram) -> PackedProgram:
    """Return the constants of a program; the first integers and numbers are those of the kernel's structures."""
    basis, scene, near, step = nlp.basis, nlp.scene, nlp.scene.settings, nlp.settings.step
    (parts, v, _), (obstacles, k, _) = scene.body.vertices.shape, scene.obstacles.vertices.shape
    trusted = trusted_nodes(basis, step)
    selection = near.few_pairs, near.nearest, near.nearest_close, near.grouped_intervals
    edges = near.lowest_vertices, near.facing_edges
    active = near.few_planes, near.thins_small_obstacles, near.discs_per_node, near.most_discs
    projection = nlp.settings.projection
    sizes = basis.num_gears, basis.num_knots, basis.num_nodes, basis.num_intervals, parts, v, obstacles, k
    others = projection.max_steps, projection.alternations, step.zones, trusted.size
    is_limited, most = bool(np.isfinite(nlp.inner_bounds.rate)), step.clearance_rows[-1]
    has_terms = nlp.terms is not None
    counts = np.concatenate(
        (
            np.array((*sizes, *selection, *edges, *active, *others, is_limited, most, has_terms), dtype=np.int64),
            basis.divisions.ravel(),
            basis.left,
            trusted,
            small_obstacles(scene).astype(np.int64),
            scene.body.discs.counts,
        )
    )
    numbers = np.concatenate((_numbers(nlp), *_arrays(nlp)), axis=None)
    results = basis.size + 4 * basis.num_nodes + 6 * basis.num_intervals + 3 + step.zones
    columns, rows = basis.size + 6 + step.zones, 3 + trusted.size + (2 * basis.span_gear.size if is_limited else 0)
    room = Room.of(scene, basis)
    work = max(room.work, 12 * basis.size + results)
    before, n, m = numbers_before_rows(basis.size, trusted.size), columns, rows + most
    of_step = (n + 1) * (2 * n + 7) + 19 * n + 10 * n * n + m * n + 4 * m, 5 * n + 6 * m + 1
    arrays = readonly(counts), readonly(numbers)
    points = len(SYMBOLS) * basis.num_nodes if has_terms else 0
    return PackedProgram(*arrays, room, results, points, work, trusted.size, columns, rows, before, of_step)


def _numbers(nlp: NonlinearProgram) -> FloatArray:
    near, loop, step, scene = nlp.scene.settings, nlp.settings.loop, nlp.settings.step, nlp.scene
    projection, weights = nlp.settings.projection, nlp.cost.weights
    body = scene.body.radius, scene.body.width, scene.rule.required, scene.rule.required + near.surely_kept
    deep = near.clear, near.deep, near.very_deep, near.near_deep
    rows = near.support_slope, near.same_witness
    goal = projection.tolerance, projection.renew, projection.contraction, nlp.ends.reach
    rates = nlp.bounds.rate, nlp.inner_bounds.rate
    reach = loop.reach, loop.most_reach, loop.reach_per_motion, loop.least_reach
    slacks = step.curved_goal_slack, step.curved_clearance_slack, step.ridge
    others = loop.end_allowance, weights.length, weights.tracking, step.buffer_taper, step.yaw_motion
    driven = (0.0, 0.0) if nlp.terms is None else (nlp.terms.before, nlp.terms.after)
    return np.array((*body, near.lowest_slope, *deep, *rows, *goal, *rates, *reach, *others, *slacks, *driven))


def _arrays(nlp: NonlinearProgram) -> list[FloatArray]:
    ends, outer, inner, discs = nlp.ends, nlp.bounds, nlp.inner_bounds, nlp.scene.body.discs
    bounds = outer.lower, outer.upper, inner.lower, inner.upper
    cost = *nlp.cost.hessians, *nlp.cost.reference
    return [ends.start, ends.signs, ends.target, *bounds, *cost, discs.radii, discs.centres]
