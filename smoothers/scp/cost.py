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
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

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

    @cached_property
    def _stiffness(self) -> FloatArray:
        """Return the integrals over u of products of the slopes of hat functions, weighted by `easing`."""
        basis = self.basis
        if self.easing is None:
            return basis.stiffness
        spans = np.array([count for count, _ in basis.shape])[basis.span_gear]
        slopes = np.sqrt(self.easing / spans)[:, None] * basis.span_slopes
        product: FloatArray = slopes.T @ slopes
        return product

    @cached_property
    def _turned(self) -> FloatArray:
        """Return weighted changes of steering at cusps, as a matrix for the knot curvatures. Shape (cusps, knots)."""
        basis = self.basis
        rows = np.zeros((basis.num_gears - 1, basis.num_knots))
        cusps = np.arange(basis.num_gears - 1)
        rows[cusps, basis.last_knots[:-1]] = 1.0
        rows[cusps, basis.first_knots[1:]] = 1.0
        return rows * math.sqrt(self.turning_at_cusps) / self.scales[0]

    @property
    def factors(self) -> tuple[float, float]:
        """Weights of the integrals of squared curvature and squared curvature rate."""
        return self.weights.curvature / self.scales[0] ** 2, self.weights.rate / self.scales[1] ** 2

    def _lateral(self, rollout: Rollout) -> FloatArray:
        away = rollout.poses[:, :2] - self.reference.positions
        return away[:, 0] * self.reference.normals[:, 0] + away[:, 1] * self.reference.normals[:, 1]

    def value(self, variables: Variables, rollout: Rollout) -> float:
        """Return the cost J of given variables."""
        curvature, lengths = variables
        bend, jerk = self.factors
        per_knot = lengths[self.basis.knot_gear]
        squares = per_knot * curvature * (self.basis.mass @ curvature)
        slopes = curvature * (self._stiffness @ curvature) / per_knot
        lateral, total = self._lateral(rollout), float(lengths.sum())
        tracking = self.weights.tracking * total / self.basis.num_intervals * float(lateral @ lateral)
        turned = self._turned @ curvature
        smooth = bend * squares.sum() + jerk * slopes.sum() + turned @ turned
        return float(self.weights.length * total + smooth + tracking)

    def quadratic(self, variables: Variables, rollout: Rollout, by: Sensitivity) -> Quadratic:
        """Return the exact gradient, and a Hessian that is exact in the curvatures and Gauss-Newton for tracking."""
        basis, (curvature, lengths) = self.basis, variables
        bend, jerk = self.factors
        per_knot, knots = lengths[basis.knot_gear], basis.num_knots
        of_mass, of_slope = basis.mass @ curvature, self._stiffness @ curvature
        gradient, hessian = np.empty(basis.size), np.zeros((basis.size, basis.size))
        gradient[:knots] = 2.0 * (bend * per_knot * of_mass + jerk / per_knot * of_slope)
        squares, slopes = (curvature * of_mass) @ basis.knot_members, (curvature * of_slope) @ basis.knot_members
        gradient[knots:] = self.weights.length + bend * squares - jerk * slopes / lengths**2
        hessian[:knots, :knots] = 2.0 * (bend * per_knot * basis.mass + (jerk / per_knot) * self._stiffness)
        gradient[:knots] += 2.0 * (self._turned.T @ (self._turned @ curvature))
        hessian[:knots, :knots] += 2.0 * (self._turned.T @ self._turned)
        index = np.arange(knots, basis.size)
        hessian[index, index] = 2.0 * jerk * slopes / lengths**3
        share = self.weights.tracking / basis.num_intervals
        lateral, scale = self._lateral(rollout), share * float(lengths.sum())
        normals = self.reference.normals
        moved = normals[:, :1] * by.x + normals[:, 1:] * by.y
        gradient += 2.0 * scale * (lateral @ moved)
        gradient[knots:] += share * float(lateral @ lateral)
        hessian += 2.0 * scale * (moved.T @ moved)
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
