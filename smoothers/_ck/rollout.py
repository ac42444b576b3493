"""Exact driving of a clothoid spline at fixed nodes, and its derivatives."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray
    from smoothers._ck.layout import Layout

__all__ = ["Rollout", "Sensitivity", "Variables", "end_pose", "end_sensitivity", "roll_out", "sensitivity"]


class Variables(NamedTuple):
    """Knot curvatures, Shape (num_knots,) [1/m], and gear lengths, Shape (num_gears,) [m]."""

    curvature: FloatArray
    lengths: FloatArray


class Rollout(NamedTuple):
    """A driven path.

    Attributes:
        poses: Shape (num_nodes, 3) [m, m, rad].
        curvature: Shape (num_nodes,) [1/m].
        rate: Shape (num_intervals,) [1/m^2], curvature rate, constant inside every interval.
        steps: Shape (num_intervals,) [m], interval lengths.
        moves: Shape (2 num_intervals, 2) [m], displacement by each Gauss point.
    """

    poses: FloatArray
    curvature: FloatArray
    rate: FloatArray
    steps: FloatArray
    moves: FloatArray


class Sensitivity(NamedTuple):
    """Derivatives of the node poses by the variables, Shape (num_nodes, size) each."""

    x: FloatArray
    y: FloatArray
    yaw: FloatArray


def roll_out(layout: Layout, variables: Variables, start: FloatArray, signs: FloatArray) -> Rollout:
    """Drive from `start`, Shape (3,), with the gears `signs`, Shape (num_gears,).

    Positions are 2-point Gauss sums over every interval; headings are exact.
    """
    curvature, lengths = variables
    turned = layout.per_knot(lengths) * curvature
    gears = layout.interval_gear
    cells = np.bincount(gears, minlength=layout.num_gears)
    steps = (lengths / cells)[gears]
    yaw = start[2] + layout.gauss_rows @ turned
    weight = np.repeat(0.5 * steps * signs[gears], 2)
    moves = np.empty((yaw.size, 2))
    np.multiply(weight, np.cos(yaw), out=moves[:, 0])
    np.multiply(weight, np.sin(yaw), out=moves[:, 1])
    path = np.empty((layout.num_intervals + 1, 2))
    path[0] = start[:2]
    path[1:] = moves.reshape(-1, 2, 2).sum(axis=1)
    np.cumsum(path, axis=0, out=path)
    poses = np.empty((layout.num_nodes, 3))
    poses[:, :2] = path[layout.position_of]
    poses[:, 2] = start[2] + layout.node_rows @ turned
    rate = (layout.slope_rows @ curvature) / lengths[gears]
    return Rollout(poses, layout.node_hats @ curvature, rate, steps, moves)


def end_pose(
    layout: Layout, variables: Variables, start: FloatArray, signs: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """The last pose, Shape (3,), and the moves, Shape (2 num_intervals, 2), much cheaper than all poses."""
    curvature, lengths = variables
    turned = layout.per_knot(lengths) * curvature
    yaw = start[2] + layout.gauss_rows @ turned
    weight = layout.gauss_shares @ (lengths * signs)
    moves = np.empty((yaw.size, 2))
    np.multiply(weight, np.cos(yaw), out=moves[:, 0])
    np.multiply(weight, np.sin(yaw), out=moves[:, 1])
    pose = np.array(start)
    pose[:2] += moves.sum(axis=0)
    pose[2] += layout.node_rows[-1] @ turned
    return pose, moves


def _turn_rows(rows: FloatArray, layout: Layout, variables: Variables) -> FloatArray:
    """Derivatives of headings by the variables, from heading rows. Shape (len(rows), size)."""
    out = np.empty((rows.shape[0], layout.size))
    np.multiply(rows, layout.per_knot(variables.lengths), out=out[:, : layout.num_knots])
    out[:, layout.num_knots :] = rows @ (layout.members * variables.curvature[:, None])
    return out


def sensitivity(layout: Layout, variables: Variables, rollout: Rollout) -> Sensitivity:
    """Derivatives of all node poses."""
    turns = _turn_rows(layout.gauss_rows, layout, variables)
    own = layout.num_knots + layout.interval_gear
    inverse = 1.0 / variables.lengths[layout.interval_gear]
    moved = rollout.moves.reshape(-1, 2, 2).sum(axis=1)
    columns = []
    for axis, by_yaw in ((0, -rollout.moves[:, 1]), (1, rollout.moves[:, 0])):
        change = np.zeros((layout.num_intervals + 1, layout.size))
        change[1:] = (by_yaw[:, None] * turns).reshape(layout.num_intervals, 2, -1).sum(axis=1)
        change[np.arange(1, layout.num_intervals + 1), own] += moved[:, axis] * inverse
        np.cumsum(change, axis=0, out=change)
        columns.append(change[layout.position_of])
    return Sensitivity(columns[0], columns[1], _turn_rows(layout.node_rows, layout, variables))


def end_sensitivity(layout: Layout, variables: Variables, moves: FloatArray) -> FloatArray:
    """Derivatives of the last pose alone, much cheaper. Shape (3, size).

    Args:
        layout: Shape of the path.
        variables: Where it is.
        moves: Of the roll-out, Shape (2 num_intervals, 2) [m].
    """
    knots, lengths = layout.num_knots, layout.per_knot(variables.lengths)
    masked = layout.members * variables.curvature[:, None]
    weighted = moves.T @ layout.gauss_rows  # (2, num_knots)
    out = np.empty((3, layout.size))
    np.multiply(-weighted[1], lengths, out=out[0, :knots])
    np.multiply(weighted[0], lengths, out=out[1, :knots])
    out[0, knots:], out[1, knots:] = -weighted[1] @ masked, weighted[0] @ masked
    last = layout.node_rows[-1]
    out[2, :knots] = last * lengths
    out[2, knots:] = last @ masked
    out[:2, knots:] += (moves.T @ layout.gauss_members) / variables.lengths
    return out
