"""Tracking: the drivable path whose positions are nearest to the input's, whatever stands in the way.

A fit of headings leaves an input whose curvature switches within centimetres, as that of Reeds-Shepp paths does, since
errors of heading add up along the way. Least squares of positions cannot drift:

    minimize  w integral of (across^2 + a along^2) ds + w a' sum over cusps of |p - p_ref|^2 + smoothness + goal error

by Gauss-Newton steps within a trust region ([Nocedal2006] ch. 10), each one the search's own convex program under the
bounds of curvature and curvature rate, without a row of clearance. About a millisecond in all.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from smoothers.scp.collision.linearization import ClearanceRows
from smoothers.scp.cost import Quadratic
from smoothers.scp.goal_projection import end_sensitivity, limit_rate
from smoothers.scp.nlp import with_intervals
from smoothers.scp.qp_step import Penalties, Subproblem, solve_step, trusted_nodes
from smoothers.scp.rollout import Variables, roll_out, sensitivity

if TYPE_CHECKING:
    from collections.abc import Callable

    from optdock.geometry.arrays import FloatArray
    from smoothers.scp.nlp import NonlinearProgram
    from smoothers.scp.qp_step import ProgramPool
    from smoothers.scp.rollout import Rollout

__all__ = ["strayed", "track"]


def strayed(nlp: NonlinearProgram, rollout: Rollout) -> float:
    """How far a driven path is from the input, at the node where it is farthest from it [m]."""
    return float(np.hypot(*(rollout.poses[:, :2] - nlp.traced.positions).T).max())


def track(
    nlp: NonlinearProgram, pool: ProgramPool, variables: Variables, trust_region: float, is_late: Callable[[], bool]
) -> Variables:
    """The variables after some Gauss-Newton steps towards the input's positions.

    Args:
        nlp: Holds the input, the ends and the bounds.
        pool: Convex programs.
        variables: Where to begin.
        trust_region: First bound of the heading changes of a step [rad].
        is_late: Asked before every step; once it is True what is reached is returned.
    """
    settings, knots = nlp.settings.tracking, nlp.basis.num_knots
    nlp = with_intervals(nlp, [min(cells, settings.most_intervals) for _, cells in nlp.basis.shape])
    least_squares = _LeastSquares.of(nlp)
    current = least_squares.at(limit_rate(nlp.basis, variables, nlp.inner_bounds))
    penalties = Penalties(0.0, settings.goal_weight)
    around: Subproblem | None = None
    for _ in range(settings.most_steps):
        if is_late():
            break
        around = around or least_squares.linearized(current)
        step = solve_step(nlp, around, pool, trust_region, settings.proximal, penalties)
        if step is None:
            break
        moved = np.concatenate(current.variables) + step.change
        trial = least_squares.at(Variables(moved[:knots], moved[knots:]))
        if trial.merit >= current.merit:
            trust_region *= settings.trust_cut
            continue
        gain, current, around = current.merit - trial.merit, trial, None
        trust_region = min(settings.trust_growth * trust_region, settings.most_trust)
        if gain < settings.small_gain * current.merit or strayed(nlp, current.rollout) < settings.near:
            break
    return current.variables


class _Driven(NamedTuple):
    """Variables, the path that they drive, and the merit."""

    variables: Variables
    rollout: Rollout
    merit: float


@dataclass(frozen=True, eq=False)
class _LeastSquares:
    """The residuals of one program: at every node along two axes.

    Attributes:
        nlp: The program.
        axes: Across and along the input at the nodes, Shape (num_nodes, 2) each.
        weights: Of the squared residuals along either, Shape (num_nodes,) each.
        smoothness: Weight of the integral of the squared curvature rate, which decides what positions leave open.
    """

    nlp: NonlinearProgram
    axes: tuple[FloatArray, FloatArray]
    weights: tuple[FloatArray, FloatArray]
    smoothness: float

    @classmethod
    def of(cls, nlp: NonlinearProgram) -> _LeastSquares:
        settings, basis, normals = nlp.settings.tracking, nlp.basis, nlp.cost.reference.normals
        share = settings.weight * float(nlp.lengths.sum()) / basis.num_intervals
        across, along = np.full(basis.num_nodes, share), np.full(basis.num_nodes, share * settings.along)
        cusps = basis.last_nodes[:-1]
        across[cusps] = along[cusps] = share * settings.cusp
        axes = normals, np.column_stack((-normals[:, 1], normals[:, 0]))
        return cls(nlp, axes, (across, along), settings.smoothness * nlp.cost.factors[1])

    def at(self, variables: Variables) -> _Driven:
        """The variables, driven and judged."""
        nlp, basis = self.nlp, self.nlp.basis
        rollout = roll_out(basis, variables, nlp.ends.start, nlp.ends.signs)
        squares = sum(float(w @ r**2) for w, r in zip(self.weights, self._residuals(rollout), strict=True))
        slopes = variables.curvature * (basis.stiffness @ variables.curvature) / variables.lengths[basis.knot_gear]
        missed = float(np.abs(nlp.ends.error(rollout)).sum())
        merit = squares + self.smoothness * float(slopes.sum()) + nlp.settings.tracking.goal_weight * missed
        return _Driven(variables, rollout, merit)

    def linearized(self, current: _Driven) -> Subproblem:
        """The convex model at a driven path, without clearance."""
        nlp, basis, (variables, rollout, _) = self.nlp, self.nlp.basis, current
        by, knots = sensitivity(basis, variables, rollout), basis.num_knots
        stiffness = self.smoothness / variables.lengths[basis.knot_gear] * basis.stiffness
        gradient, hessian = np.zeros(basis.size), np.zeros((basis.size, basis.size))
        gradient[:knots], hessian[:knots, :knots] = 2.0 * (stiffness @ variables.curvature), 2.0 * stiffness
        for axis, weight, residual in zip(self.axes, self.weights, self._residuals(rollout), strict=True):
            moved = axis[:, :1] * by.x + axis[:, 1:] * by.y
            gradient += 2.0 * (weight * residual) @ moved
            hessian += 2.0 * moved.T @ (weight[:, None] * moved)
        goal = end_sensitivity(basis, variables, rollout.moves), nlp.ends.error(rollout)
        headings = by.yaw[trusted_nodes(basis, nlp.settings.step)]
        no_rows = ClearanceRows(np.zeros((0, basis.size)), np.zeros(0), np.zeros(0, dtype=np.int64))
        motion = np.eye(basis.size)
        return Subproblem(variables, Quadratic(gradient, hessian), motion, goal, headings, no_rows)

    def _residuals(self, rollout: Rollout) -> tuple[FloatArray, FloatArray]:
        away = rollout.poses[:, :2] - self.nlp.traced.positions
        across, along = (axis[:, 0] * away[:, 0] + axis[:, 1] * away[:, 1] for axis in self.axes)
        return across, along
