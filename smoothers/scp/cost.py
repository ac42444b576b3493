"""The cost: length, curvature, curvature rate and distance to the input, with exact derivatives.

J = sum over gears of [w_L L + w_k / k_ref^2 * L * K'MK + w_r / r_ref^2 / L * K'SK]
    + w_t * (total length / intervals) * sum over nodes of (n_ref . (p - p_ref))^2
    + w_s * sum over cusps of ((k_after + k_before) / k_ref)^2

where M and S are the mass and stiffness of the basis. The terms are the length, the integral of curvature^2, the
integral of curvature rate^2, the squared lateral distance from the input path and, for steered wheels, the squared
change of steering at cusps, where constant wheel angles reverse the sign of the curvature. Near the ends of gears,
where a steered robot is slow and its wheels can follow sharper changes, the curvature rate has a lower weight
(`easing`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.geometry.arrays import product_of_columns
from optdock.geometry.lazy import cached_property
from smoothers.scp.rollout import in_order, squared

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray
    from optdock.model.path import Path
    from smoothers.scp.basis import Basis
    from smoothers.scp.rollout import Rollout, Sensitivity, Variables

__all__ = ["CostModel", "InputNodes", "Quadratic", "Weights"]


class Weights(NamedTuple):
    """Weights of length [1/m], curvature and curvature rate (relative to their references), and tracking [1/m^3]."""

    length: float = 1.0
    curvature: float = 0.4
    rate: float = 0.15
    tracking: float = 0.3


class InputNodes(NamedTuple):
    """Input path at the nodes: positions (n, 2) [m] and unit normals (n, 2)."""

    positions: FloatArray
    normals: FloatArray


class Quadratic(NamedTuple):
    """A convex quadratic model `gradient . step + step' hessian step / 2`; Shape (size,), (size, size)."""

    gradient: FloatArray
    hessian: FloatArray

    def plus(self, other: Quadratic) -> Quadratic:
        """Return the sum of two models."""
        return Quadratic(self.gradient + other.gradient, self.hessian + other.hessian)


@dataclass(frozen=True, eq=False)
class CostModel:
    """Cost function of one smoothing problem."""

    basis: Basis
    weights: Weights  # weights of the terms
    scales: tuple[float, float]  # reference curvature [1/m] and reference curvature rate [1/m^2]
    reference: InputNodes  # input path at the nodes
    # cost of steering by the reference curvature at rest [m]; 0 for robots without steered wheels
    turning_at_cusps: float = 0.0
    # weights of the curvature rate, at most 1, Shape (number of spans,); None: 1 everywhere
    easing: FloatArray | None = None

    @property
    def factors(self) -> tuple[float, float]:
        """Weights of the integrals of squared curvature and squared curvature rate."""
        return self.weights.curvature / self.scales[0] ** 2, self.weights.rate / self.scales[1] ** 2

    @cached_property
    def hessians(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Hessians by the knot curvatures: of bends per length, of jerks times length, and of turns at cusps.

        Shape (num_knots, num_knots) each; elements that are not next to the diagonal are 0.
        """
        bend, jerk = self.factors
        return 2.0 * bend * self.basis.mass, 2.0 * jerk * self._stiffness(), self._turning()

    def _stiffness(self) -> FloatArray:
        """Return the integrals over u of products of the slopes of hat functions, weighted by `easing`."""
        basis = self.basis
        if self.easing is None:
            return basis.stiffness
        spans = np.array([count for count, _ in basis.shape])[basis.span_gear]
        slopes = np.sqrt(self.easing / spans)[:, None] * basis.span_slopes
        return product_of_columns(slopes, slopes)

    def _turning(self) -> FloatArray:
        """Return the Hessian of the weighted squared changes of steering at cusps. Shape (num_knots, num_knots)."""
        basis = self.basis
        hessian = np.zeros((basis.num_knots, basis.num_knots))
        weight = math.sqrt(self.turning_at_cusps) / self.scales[0]
        for last, first in zip(basis.last_knots[:-1].tolist(), basis.first_knots[1:].tolist(), strict=True):
            hessian[last : first + 1, last : first + 1] = 2.0 * (weight * weight)
        return hessian

    def _lateral(self, rollout: Rollout) -> FloatArray:
        away = rollout.poses[:, :2] - self.reference.positions
        return away[:, 0] * self.reference.normals[:, 0] + away[:, 1] * self.reference.normals[:, 1]

    # Sums are evaluated in the order of their indices, as in the kernel `loop_kernel.c`.

    def value(self, variables: Variables, rollout: Rollout) -> float:
        """Return the cost J of given variables."""
        curvature, lengths = variables
        by_bend, by_jerk, by_turning = (in_order(one * curvature, 1) for one in self.hessians)
        per_knot = lengths[self.basis.knot_gear]
        by_curvature = per_knot * by_bend + by_jerk / per_knot + by_turning
        lateral, total = self._lateral(rollout), float(in_order(lengths))
        tracking = self.weights.tracking * total / self.basis.num_intervals * float(in_order(lateral * lateral))
        return self.weights.length * total + 0.5 * float(in_order(curvature * by_curvature)) + tracking

    def quadratic(self, variables: Variables, rollout: Rollout, by: Sensitivity) -> Quadratic:
        """Return the exact gradient, and a Hessian that is exact in the curvatures and Gauss-Newton for tracking."""
        basis, (curvature, lengths) = self.basis, variables
        bend, jerk, turning = self.hessians
        by_bend, by_jerk, by_turning = (in_order(one * curvature, 1) for one in self.hessians)
        per_knot, knots = lengths[basis.knot_gear], basis.num_knots
        share, lateral = self.weights.tracking / basis.num_intervals, self._lateral(rollout)
        normals = self.reference.normals
        scale = 2.0 * share * float(in_order(lengths))
        moved = normals[:, :1] * by.x + normals[:, 1:] * by.y
        gradient, hessian = in_order((scale * lateral)[:, None] * moved), scale * squared(moved)
        gradient[:knots] += per_knot * by_bend + by_jerk / per_knot + by_turning
        hessian[:knots, :knots] += per_knot * bend + jerk / per_knot + turning
        bends = in_order((0.5 * (curvature * by_bend))[:, None] * basis.knot_members)
        jerks = in_order((0.5 * (curvature * by_jerk))[:, None] * basis.knot_members)
        tracked = share * float(in_order(lateral * lateral))
        gradient[knots:] += self.weights.length + bends - jerks / lengths**2 + tracked
        cubed = lengths * lengths * lengths
        hessian.ravel()[knots * (basis.size + 1) :: basis.size + 1] += 2.0 * jerks / cubed
        return Quadratic(gradient, hessian)

    def of_clothoids(self, path: Path, final_straight: float) -> float:
        """Return J of a clothoid path, with the path itself as reference and without the final straight [m]."""
        bend, jerk = self.factors
        value = self.weights.length * (path.length - final_straight)
        for segment in path.segments:
            knots, curvature = segment.knots, segment.curvature_at(segment.knots)
            step, a, b = np.diff(knots), curvature[:-1], curvature[1:]
            value += bend * float(np.sum(step * (a * a + a * b + b * b)) / 3.0)
            value += jerk * float(np.sum((b - a) ** 2 / step))
        return float(value)
