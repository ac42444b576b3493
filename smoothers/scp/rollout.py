"""Poses of a curvature spline at fixed nodes (the roll-out), and their derivatives.

Headings are exact, `yaw = yaw_start + W (L K)`; positions are 2-point Gauss sums of `d L / (2 n) (cos yaw, sin yaw)`
over every interval and deviate from the clothoid by about 1e-9 m at most.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray
    from smoothers.scp.basis import Basis

__all__ = ["Rollout", "Sensitivity", "Variables", "roll_out", "sensitivity"]


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


class Sensitivity(NamedTuple):
    """Derivatives of the node poses with respect to the variables, Shape (num_nodes, size) each."""

    x: FloatArray
    y: FloatArray
    yaw: FloatArray


def roll_out(basis: Basis, variables: Variables, start: FloatArray, signs: FloatArray) -> Rollout:
    """Return the path from the pose `start`, Shape (3,), in the gears `signs`, Shape (num_gears,)."""
    curvature, lengths = variables
    turned = lengths[basis.knot_gear] * curvature
    gears = basis.interval_gear
    cells = np.bincount(gears, minlength=basis.num_gears)
    steps = (lengths / cells)[gears]
    yaw = start[2] + basis.gauss_headings @ turned
    weight = np.repeat(0.5 * steps * signs[gears], 2)
    moves = np.empty((yaw.size, 2))
    np.multiply(weight, np.cos(yaw), out=moves[:, 0])
    np.multiply(weight, np.sin(yaw), out=moves[:, 1])
    path = np.empty((basis.num_intervals + 1, 2))
    path[0] = start[:2]
    path[1:] = moves.reshape(-1, 2, 2).sum(axis=1)
    np.cumsum(path, axis=0, out=path)
    poses = np.empty((basis.num_nodes, 3))
    poses[:, :2] = path[basis.position_of]
    poses[:, 2] = start[2] + basis.node_headings @ turned
    rate = (basis.interval_slopes @ curvature) / lengths[gears]
    return Rollout(poses, basis.node_curvatures @ curvature, rate, steps, moves)


def sensitivity(basis: Basis, variables: Variables, rollout: Rollout) -> Sensitivity:
    """Return the derivatives of all node poses."""
    turns = _heading_derivatives(basis.gauss_headings, basis, variables)
    own = basis.num_knots + basis.interval_gear
    inverse = 1.0 / variables.lengths[basis.interval_gear]
    moved = rollout.moves.reshape(-1, 2, 2).sum(axis=1)
    columns = []
    for axis, by_yaw in ((0, -rollout.moves[:, 1]), (1, rollout.moves[:, 0])):
        change = np.zeros((basis.num_intervals + 1, basis.size))
        change[1:] = (by_yaw[:, None] * turns).reshape(basis.num_intervals, 2, -1).sum(axis=1)
        change[np.arange(1, basis.num_intervals + 1), own] += moved[:, axis] * inverse
        np.cumsum(change, axis=0, out=change)
        columns.append(change[basis.position_of])
    return Sensitivity(columns[0], columns[1], _heading_derivatives(basis.node_headings, basis, variables))


def _heading_derivatives(rows: FloatArray, basis: Basis, variables: Variables) -> FloatArray:
    """Return the derivatives of headings with respect to the variables, Shape (len(rows), size).

    `rows`: rows of heading integrals.
    """
    out = np.empty((rows.shape[0], basis.size))
    np.multiply(rows, variables.lengths[basis.knot_gear], out=out[:, : basis.num_knots])
    out[:, basis.num_knots :] = rows @ (basis.knot_members * variables.curvature[:, None])
    return out
