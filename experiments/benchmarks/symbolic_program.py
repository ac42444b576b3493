"""The nonlinear program of `CasadiSmoother` in CasADi's symbols: the oracle of its hand-written derivatives.

Roll-out, cost, goal error, rows of the curvature rate, and terms of a user. Clearance has no symbols, because its rows
depend on the nearest pairs. `experiments.benchmarks.ipopt_reference` solves the program with ipopt, and tests compare
its values and derivatives with those of `smoothers.scp`.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import casadi
import numpy as np

from smoothers.scp.basis import basis_for

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray
    from smoothers.scp.basis import Basis, Shape
    from smoothers.scp.cost import CostModel
    from smoothers.scp.term_rows import TermBound

__all__ = ["SymbolicModel", "cost_expression", "end_error", "model_for", "rate_rows", "term_expressions"]


class SymbolicModel(NamedTuple):
    """Symbolic path of one shape.

    Attributes:
        basis: Basis of the shape.
        variables: Knot curvatures, then gear lengths, Shape (size, 1).
        start: Start pose, Shape (3, 1).
        signs: Gears, Shape (num_gears, 1).
        poses: Node poses, Shape (num_nodes, 3).
        roll_out: Function of variables, start and signs that returns `poses`.
    """

    basis: Basis
    variables: casadi.SX
    start: casadi.SX
    signs: casadi.SX
    poses: casadi.SX
    roll_out: casadi.Function

    @property
    def curvature(self) -> casadi.SX:
        """Curvature at the knots, Shape (num_knots, 1)."""
        return self.variables[: self.basis.num_knots]

    @property
    def lengths(self) -> casadi.SX:
        """Gear lengths, Shape (num_gears, 1)."""
        return self.variables[self.basis.num_knots :]


@lru_cache(maxsize=16)
def model_for(shape: Shape) -> SymbolicModel:
    """Return the model of a shape, cached."""
    basis = basis_for(shape)
    variables = casadi.SX.sym("z", basis.size)
    start, signs = casadi.SX.sym("start", 3), casadi.SX.sym("signs", basis.num_gears)
    curvature, lengths = variables[: basis.num_knots], variables[basis.num_knots :]
    turned = _spread(basis.knot_members) @ lengths * curvature
    yaw = start[2] + _spread(basis.gauss_headings) @ turned
    weight = _spread(basis.gauss_shares) @ (lengths * signs)
    pairs = _spread(np.repeat(np.eye(basis.num_intervals), 2, axis=1))
    columns = []
    for i, move in enumerate((weight * casadi.cos(yaw), weight * casadi.sin(yaw))):
        path = casadi.vertcat(start[i], start[i] + casadi.cumsum(pairs @ move))
        columns.append(path[basis.position_of.tolist(), :])
    columns.append(start[2] + _spread(basis.node_headings) @ turned)
    poses = casadi.horzcat(*columns)
    roll_out = casadi.Function("roll_out", [variables, start, signs], [poses], ["z", "start", "signs"], ["poses"])
    return SymbolicModel(basis, variables, start, signs, poses, roll_out)


def _spread(matrix: FloatArray) -> casadi.DM:
    """Return a constant matrix in sparse form."""
    return casadi.sparsify(casadi.DM(matrix))


def end_error(model: SymbolicModel, target: FloatArray) -> casadi.SX:
    """Return the last pose minus the target, Shape (3, 1)."""
    return model.poses[-1, :].T - casadi.DM(target)


def rate_rows(model: SymbolicModel, bound: float) -> casadi.SX:
    """Return the curvature rate times the gear length minus its bound, and with the other sign: all must be <= 0."""
    slopes = _spread(model.basis.span_slopes) @ model.curvature
    allowed = bound * model.lengths[model.basis.span_gear.tolist(), :]
    return casadi.vertcat(slopes - allowed, -slopes - allowed)


def cost_expression(model: SymbolicModel, cost: CostModel) -> casadi.SX:
    """Return the cost of `smoothers.scp.cost` as an expression in the model's symbols."""
    basis, (bend, jerk) = cost.basis, cost.factors
    curvature, lengths = model.curvature, model.lengths
    total = casadi.sum1(lengths)
    value = cost.weights.length * total
    per_knot = _spread(basis.knot_members) @ lengths
    value += bend * casadi.dot(per_knot * curvature, _spread(basis.mass) @ curvature)
    # The curvature rate is constant in each span, which is 1 / spans of its gear.
    spans = np.array([count for count, _ in basis.shape])[basis.span_gear]
    eased = np.ones(spans.size) if cost.easing is None else cost.easing
    slopes = _spread(basis.span_slopes) @ curvature
    value += jerk * casadi.dot(casadi.DM(eased / spans) / lengths[basis.span_gear.tolist(), :], slopes**2)
    for last, first in zip(basis.last_knots[:-1].tolist(), basis.first_knots[1:].tolist(), strict=True):
        value += cost.turning_at_cusps * ((curvature[last] + curvature[first]) / cost.scales[0]) ** 2
    normals, positions = casadi.DM(cost.reference.normals), casadi.DM(cost.reference.positions)
    lateral = casadi.sum2(normals * (model.poses[:, :2] - positions))
    return value + cost.weights.tracking * total / basis.num_intervals * casadi.dot(lateral, lateral)


def term_expressions(model: SymbolicModel, bound: TermBound) -> tuple[casadi.SX, casadi.SX]:
    """Return the cost of the soft terms, and the hard terms at the nodes, Shape (num_nodes, hard terms)."""
    terms, points = bound.terms, _points(model, bound)
    soft = casadi.SX(0)
    for m, (spans, cells) in enumerate(model.basis.shape):
        mine = np.flatnonzero(model.basis.node_gear == m).tolist()
        weights = casadi.DM(np.array([0.5, *[1.0] * (spans * cells - 1), 0.5]) / (spans * cells))
        for term in terms.soft:
            residuals = _along(term.function.function, list(term.values.values()), points[mine, :])
            soft += term.weight * model.lengths[m] * casadi.dot(weights, residuals**2)
    hard = [_along(term.function.function, list(term.values.values()), points) for term in terms.hard]
    return soft, casadi.horzcat(casadi.SX(model.basis.num_nodes, 0), *hard)


def _points(model: SymbolicModel, bound: TermBound) -> casadi.SX:
    """Return the symbols of the terms at the nodes, Shape (num_nodes, 7)."""
    basis, rows = model.basis, []
    for node, (m, share) in enumerate(zip(basis.node_gear.tolist(), basis.fraction.tolist(), strict=True)):
        done = casadi.DM([[*[1.0] * m, share, *[0.0] * (basis.num_gears - m - 1)]])
        driven = done @ model.lengths
        left = casadi.sum1(model.lengths) - driven
        turned = model.poses[node, 2]
        yaw = turned - 2.0 * casadi.pi * casadi.floor(turned / (2.0 * casadi.pi) + 0.5)
        bend = casadi.DM(basis.node_curvatures[node : node + 1]) @ model.curvature
        gear = casadi.SX(float(bound.signs[m]))
        rows.append(casadi.horzcat(model.poses[node, :2], yaw, bend, bound.before + driven, bound.after + left, gear))
    return casadi.vertcat(*rows)


def _along(function: casadi.Function, values: list[float], points: casadi.SX) -> casadi.SX:
    return casadi.vertcat(*(function(points[node, :].T, casadi.DM(values))[0] for node in range(points.shape[0])))
