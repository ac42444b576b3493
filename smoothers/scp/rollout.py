"""Poses of a curvature spline at fixed nodes (the roll-out), and their derivatives.

Headings are exact, `yaw = yaw_start + W (L K)`; positions are 2-point Gauss sums of `d L / (2 n) (cos yaw, sin yaw)`
over every interval and deviate from the clothoid by about 1e-9 m at most. Sums are evaluated in the order of their
indices, as in the kernel `rollout_kernel.c`.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.kernels import Kernel, twin_of

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray
    from smoothers.scp.basis import Basis

__all__ = [
    "Rollout",
    "Sensitivity",
    "Variables",
    "displacements",
    "in_order",
    "roll_out",
    "sensitivity",
    "squared",
    "squared_motion",
]

_ROLL_OUT = Kernel("optdock_roll_out", sizes=4, numbers=0)
_SENSITIVITY = Kernel("optdock_sensitivity", sizes=4, numbers=0)


class Variables(NamedTuple):
    """Knot curvatures, Shape (num_knots,) [1/m], and gear lengths, Shape (num_gears,) [m]."""

    curvature: FloatArray
    lengths: FloatArray


class Rollout(NamedTuple):
    """Path that results from given variables, at the nodes."""

    poses: FloatArray  # Shape (num_nodes, 3) [m, m, rad]
    curvature: FloatArray  # Shape (num_nodes,) [1/m]
    rate: FloatArray  # Shape (num_intervals,) [1/m^2], curvature rate, constant inside every interval
    steps: FloatArray  # Shape (num_intervals,) [m], interval lengths
    moves: FloatArray  # Shape (2 num_intervals, 2) [m], displacement by each Gauss point
    packed: FloatArray  # memory of the arrays above, in this order, Shape (4 num_nodes + 6 num_intervals,)

    @classmethod
    def within(cls, packed: FloatArray, basis: Basis) -> Rollout:
        """Return the roll-out whose arrays are views of `packed`."""
        a, b, c = 4 * basis.num_nodes, basis.num_intervals, 2 * basis.num_intervals
        poses = packed[: a - basis.num_nodes].reshape(basis.num_nodes, 3)
        moves = packed[a + c :].reshape(c, 2)
        return cls(poses, packed[a - basis.num_nodes : a], packed[a : a + b], packed[a + b : a + c], moves, packed)


class Sensitivity(NamedTuple):
    """Derivatives of the node poses with respect to the variables, Shape (num_nodes, size) each."""

    x: FloatArray
    y: FloatArray
    yaw: FloatArray


def in_order(terms: FloatArray, axis: int = 0) -> FloatArray:
    """Return the sums along an axis, evaluated in the order of the indices, so that kernels round equally."""
    # Along the axis of the largest stride NumPy adds in this order; along the last axis in memory it adds pairwise.
    is_outer = terms.ndim > 1 and terms.strides[axis] == max(terms.strides) and min(terms.shape) > 1
    sums: FloatArray = terms.sum(axis=axis) if is_outer else np.add.accumulate(terms, axis=axis).take(-1, axis)
    return sums


def squared(rows: FloatArray) -> FloatArray:
    """Return the sum of the products of each row with itself, in the order of the rows. Shape (size, size)."""
    return in_order(rows[:, :, None] * rows[:, None])


def squared_motion(by: Sensitivity, yaw_motion: float) -> FloatArray:
    """Return the sum of the squared motions of the nodes, with a weight of squared angles [m^2]. Shape (size, size)."""
    x, y, yaw = (part[:, :, None] * part[:, None] for part in (by.x, by.y, math.sqrt(yaw_motion) * by.yaw))
    return in_order(x + y + yaw)


def displacements(basis: Basis, variables: Variables, start: FloatArray, signs: FloatArray) -> FloatArray:
    """Return the displacement by each Gauss point, Shape (2 num_intervals, 2) [m] (S4)."""
    curvature, lengths = variables
    yaw = start[2] + in_order(basis.gauss_headings * (lengths[basis.knot_gear] * curvature), 1)
    weight = basis.gauss_shares @ (lengths * signs)  # one term each
    moves = np.empty((yaw.size, 2))
    np.multiply(weight, np.cos(yaw), out=moves[:, 0])
    np.multiply(weight, np.sin(yaw), out=moves[:, 1])
    return moves


def _roll_out_native(basis: Basis, variables: Variables, start: FloatArray, signs: FloatArray) -> Rollout:
    count = 4 * basis.num_nodes + 6 * basis.num_intervals
    packed, given = np.empty(count), np.concatenate((*variables, start, signs))
    arrays = (
        (basis.packed, 2 * (basis.num_intervals + basis.num_nodes) * basis.num_knots),
        (basis.divisions, 2 * basis.num_gears),
        (given, basis.size + 3 + basis.num_gears),
        (packed, count),
        (np.empty(basis.num_knots), basis.num_knots),
    )
    _ROLL_OUT((basis.num_gears, basis.num_knots, basis.num_nodes, basis.num_intervals), (), arrays)
    return Rollout.within(packed, basis)


@twin_of(_roll_out_native)
def roll_out(basis: Basis, variables: Variables, start: FloatArray, signs: FloatArray) -> Rollout:
    """Return the path from the pose `start`, Shape (3,), in the gears `signs`, Shape (num_gears,)."""
    curvature, lengths = variables
    gears = basis.interval_gear
    found = Rollout.within(np.empty(4 * basis.num_nodes + 6 * basis.num_intervals), basis)
    found.moves[:] = displacements(basis, variables, start, signs)
    path = np.empty((basis.num_intervals + 1, 2))
    path[0] = start[:2]
    path[1:] = found.moves[::2] + found.moves[1::2]
    np.add.accumulate(path, axis=0, out=path)
    found.poses[:, :2] = path[basis.position_of]
    found.poses[:, 2] = start[2] + in_order(basis.node_headings * (lengths[basis.knot_gear] * curvature), 1)
    found.curvature[:] = in_order(basis.node_curvatures * curvature, 1) + 0.0  # no negative zeros
    found.steps[:] = (lengths / basis.divisions[:, 1])[gears]
    found.rate[:] = basis.slopes(curvature)[basis.interval_span] / lengths[gears]
    return found


def _sensitivity_native(basis: Basis, variables: Variables, rollout: Rollout) -> Sensitivity:
    out, work = np.empty((3, basis.num_nodes, basis.size)), 4 * basis.size
    arrays = (
        (basis.packed, 2 * (basis.num_intervals + basis.num_nodes) * basis.num_knots),
        (basis.divisions, 2 * basis.num_gears),
        (np.concatenate(variables), basis.size),
        (rollout.moves, 4 * basis.num_intervals),
        (out, out.size),
        (np.empty(work), work),
    )
    _SENSITIVITY((basis.num_gears, basis.num_knots, basis.num_nodes, basis.num_intervals), (), arrays)
    return Sensitivity(*out)


@twin_of(_sensitivity_native)
def sensitivity(basis: Basis, variables: Variables, rollout: Rollout) -> Sensitivity:
    """Return the derivatives of all node poses (S5); the arrays are consecutive in memory."""
    turns = _heading_derivatives(basis.gauss_headings, basis, variables)
    own = basis.num_knots + basis.interval_gear
    inverse = 1.0 / variables.lengths[basis.interval_gear]
    moves, out = rollout.moves, np.empty((3, basis.num_nodes, basis.size))
    for axis, by_yaw in ((0, -moves[:, 1]), (1, moves[:, 0])):
        change = np.zeros((basis.num_intervals + 1, basis.size))
        each = by_yaw[:, None] * turns
        change[1:] = each[::2] + each[1::2]
        change[np.arange(1, basis.num_intervals + 1), own] += (moves[::2, axis] + moves[1::2, axis]) * inverse
        np.add.accumulate(change, axis=0, out=change)
        out[axis] = change[basis.position_of]
    out[2] = _heading_derivatives(basis.node_headings, basis, variables)
    return Sensitivity(*out)


def _heading_derivatives(rows: FloatArray, basis: Basis, variables: Variables) -> FloatArray:
    """Return the derivatives of headings with respect to the variables, Shape (len(rows), size).

    `rows`: rows of heading integrals.
    """
    out = np.empty((rows.shape[0], basis.size))
    np.multiply(rows, variables.lengths[basis.knot_gear], out=out[:, : basis.num_knots])
    for m, own in enumerate(basis.own_knots):
        out[:, basis.num_knots + m] = in_order(rows[:, own] * variables.curvature[own], 1)
    return out
