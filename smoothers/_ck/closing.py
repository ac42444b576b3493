"""Goal closing: the smallest change of the variables that brings the end of the path onto its target."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from smoothers._ck.rollout import Variables, end_pose, end_sensitivity

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray
    from smoothers._ck.layout import Layout
    from smoothers._ck.rollout import Rollout

__all__ = ["Bounds", "Ends", "clipped", "close_goal", "least_norm_step", "rate_kept", "rate_limited"]

_MAX_STEPS = 5
_TOLERANCE = 1e-7
_CONTRACTION = 0.7
_RENEW = 1e-3  # error from which the old derivatives do for the remaining steps


@dataclass(frozen=True, eq=False)
class Ends:
    """Where the path begins and must end.

    Args:
        start: Shape (3,) [m, m, rad].
        target: Likewise.
        signs: Gears, Shape (num_gears,).
        reach: Error at the goal from which on Newton steps are not tried [m, rad].
    """

    start: FloatArray
    target: FloatArray
    signs: FloatArray
    reach: float = 0.5

    def error(self, rollout: Rollout) -> FloatArray:
        """Last pose minus target, Shape (3,)."""
        difference: FloatArray = rollout.poses[-1] - self.target
        return difference


@dataclass(frozen=True, eq=False)
class Bounds:
    """Bounds of the variables and of the curvature rate.

    Args:
        lower: Shape (size,), smallest knot curvatures and gear lengths.
        upper: Shape (size,).
        rate: Largest curvature rate [1/m^2]; may be infinite.
    """

    lower: FloatArray
    upper: FloatArray
    rate: float


def clipped(variables: Variables, bounds: Bounds) -> Variables:
    """Variables moved into their box."""
    knots = variables.curvature.size
    return Variables(
        np.clip(variables.curvature, bounds.lower[:knots], bounds.upper[:knots]),
        np.clip(variables.lengths, bounds.lower[knots:], bounds.upper[knots:]),
    )


def rate_limited(layout: Layout, variables: Variables, bounds: Bounds) -> Variables:
    """Curvatures moved as little as needed so that the rate keeps its bound; fixed ones stay.

    The mean of the largest rate-bounded function below and the smallest above: the identity where the bound holds.
    """
    if not np.isfinite(bounds.rate):
        return variables
    curvature = variables.curvature.copy()
    for m, (first, last) in enumerate(zip(layout.first_knots, layout.last_knots, strict=True)):
        knots = np.arange(first, last + 1)
        # Rounding must not leave the rate a little above its bound.
        change = (1.0 - 1e-12) * bounds.rate * variables.lengths[m] / (last - first) * np.abs(knots[:, None] - knots)
        values = curvature[knots]
        for k in np.flatnonzero(bounds.lower[knots] == bounds.upper[knots]):
            values = np.clip(values, values[k] - change[k], values[k] + change[k])
        curvature[knots] = 0.5 * ((values + change).min(axis=1) + (values - change).max(axis=1))
    return Variables(curvature, variables.lengths)


def rate_kept(layout: Layout, variables: Variables, bounds: Bounds) -> bool:
    """Whether the curvature rate keeps its bound."""
    slopes = layout.span_rows @ variables.curvature
    return bool(np.all(np.abs(slopes) <= bounds.rate * variables.lengths[layout.span_gear] * (1.0 + 1e-12)))


def close_goal(
    layout: Layout, variables: Variables, ends: Ends, bounds: Bounds, tolerance: float = _TOLERANCE
) -> Variables:
    """Up to five Newton steps of least norm; a step that does not contract the error is not taken.

    Args:
        layout: Shape of the path.
        variables: Where to begin.
        ends: Start and target.
        bounds: Variables stay inside.
        tolerance: Error at the goal that is small enough [m, rad].
    """
    pose, driven = end_pose(layout, variables, ends.start, ends.signs)
    error = pose - ends.target
    size, flat, knots = _largest(error), np.concatenate(variables), layout.num_knots
    solver: _LeastNorm | None = None
    for _ in range(_MAX_STEPS):
        if not tolerance <= size <= ends.reach:
            break
        if solver is None or size > _RENEW:
            solver = _LeastNorm.of(end_sensitivity(layout, variables, driven), error, flat, bounds)
        moved = np.clip(flat - solver.operator @ error, bounds.lower, bounds.upper)
        trial = Variables(moved[:knots], moved[knots:])
        pose, moves = end_pose(layout, trial, ends.start, ends.signs)
        found = pose - ends.target
        if _largest(found) > _CONTRACTION * size:
            break
        flat, variables, driven, error, size = moved, trial, moves, found, _largest(found)
    return variables


def _largest(error: FloatArray) -> float:
    return float(max(abs(error[0]), abs(error[1]), abs(error[2])))


class _LeastNorm(NamedTuple):
    """`operator @ error` is the smallest change of the variables that makes up for an error. Shape (size, 3)."""

    operator: FloatArray

    @classmethod
    def of(cls, jacobian: FloatArray, error: FloatArray, flat: FloatArray, bounds: Bounds) -> _LeastNorm:
        """Variables that would leave their bounds on the way are frozen, once."""
        free = bounds.upper > bounds.lower
        operator = _pseudo_inverse(jacobian * free)
        moved = flat - operator @ error
        outside = free & ((moved < bounds.lower) | (moved > bounds.upper))
        return cls(_pseudo_inverse(jacobian * (free & ~outside)) if outside.any() else operator)


def _pseudo_inverse(jacobian: FloatArray) -> FloatArray:
    normal = jacobian @ jacobian.T
    normal[np.arange(3), np.arange(3)] += 1e-12
    return np.asarray(np.linalg.solve(normal, jacobian).T, dtype=np.float64)


def least_norm_step(jacobian: FloatArray, error: FloatArray, flat: FloatArray, bounds: Bounds) -> FloatArray:
    """The smallest step with `jacobian step = -error` that leaves bounds alone. Shape (size,)."""
    return -_LeastNorm.of(jacobian, error, flat, bounds).operator @ error
