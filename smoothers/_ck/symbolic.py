"""The same roll-out and cost as symbols: for the ipopt reference, and the oracle of the hand-written derivatives."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import casadi
import numpy as np

from smoothers._ck.layout import layout_for

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray
    from smoothers._ck.layout import Layout, Shape
    from smoothers._ck.terms import CostModel

__all__ = ["SymbolicModel", "cost_expression", "model_for"]


class SymbolicModel(NamedTuple):
    """One shape's path as symbols.

    Attributes:
        variables: Knot curvatures, then gear lengths, Shape (size, 1).
        start: Start pose, Shape (3, 1).
        signs: Gears, Shape (num_gears, 1).
        poses: Node poses, Shape (num_nodes, 3).
        slopes: Curvature rate times gear length of every span, Shape (number of spans, 1).
        roll_out: Function of variables, start and signs that returns `poses`.
    """

    variables: casadi.SX
    start: casadi.SX
    signs: casadi.SX
    poses: casadi.SX
    slopes: casadi.SX
    roll_out: casadi.Function


@lru_cache(maxsize=16)
def model_for(shape: Shape) -> SymbolicModel:
    """The model of a shape, built once."""
    layout = layout_for(shape)
    variables = casadi.SX.sym("z", layout.size)
    start, signs = casadi.SX.sym("start", 3), casadi.SX.sym("signs", layout.num_gears)
    curvature, lengths = variables[: layout.num_knots], variables[layout.num_knots :]
    turned = _spread(layout.members) @ lengths * curvature
    yaw = start[2] + _spread(layout.gauss_rows) @ turned
    weight = _spread(layout.gauss_shares) @ (lengths * signs)
    pairs = _spread(np.repeat(np.eye(layout.num_intervals), 2, axis=1))
    columns = []
    for i, move in enumerate((weight * casadi.cos(yaw), weight * casadi.sin(yaw))):
        path = casadi.vertcat(start[i], start[i] + casadi.cumsum(pairs @ move))
        columns.append(path[layout.position_of.tolist(), :])
    columns.append(start[2] + _spread(layout.node_rows) @ turned)
    poses = casadi.horzcat(*columns)
    slopes = _spread(layout.span_rows) @ curvature
    roll_out = casadi.Function("roll_out", [variables, start, signs], [poses], ["z", "start", "signs"], ["poses"])
    return SymbolicModel(variables, start, signs, poses, slopes, roll_out)


def _spread(matrix: FloatArray) -> casadi.DM:
    """A constant matrix without its zeros."""
    return casadi.sparsify(casadi.DM(matrix))


def cost_expression(model: SymbolicModel, cost: CostModel) -> casadi.SX:
    """The cost of `terms` as an expression in the model's symbols."""
    layout: Layout = cost.layout
    bend, jerk = cost.factors
    curvature, lengths = model.variables[: layout.num_knots], model.variables[layout.num_knots :]
    total = casadi.sum1(lengths)
    value = cost.weights.length * total
    per_knot = _spread(layout.members) @ lengths
    value += bend * casadi.dot(per_knot * curvature, _spread(layout.mass) @ curvature)
    value += jerk * casadi.dot(curvature / per_knot, _spread(layout.stiffness) @ curvature)
    normals, positions = casadi.DM(cost.reference.normals), casadi.DM(cost.reference.positions)
    lateral = casadi.sum2(normals * (model.poses[:, :2] - positions))
    return value + cost.weights.tracking * total / layout.num_intervals * casadi.dot(lateral, lateral)
