"""Goal closing: the smallest change of the variables that brings the end of the path onto its target."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from smoothers._ck.rollout import Rollout, Variables, end_sensitivity, roll_out

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray
    from smoothers._ck.layout import Layout

__all__ = ["Bounds", "Ends", "clipped", "close_goal"]

_MAX_STEPS = 4
_TOLERANCE = 1e-7
_CONTRACTION = 0.7


@dataclass(frozen=True, eq=False)
class Ends:
    """Where the path begins and must end, Shape (3,) each, with the gears, Shape (num_gears,)."""

    start: FloatArray
    target: FloatArray
    signs: FloatArray

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


def close_goal(
    layout: Layout, variables: Variables, ends: Ends, bounds: Bounds, start: Rollout | None = None
) -> tuple[Variables, Rollout]:
    """Up to four Newton steps of least norm; a step that does not contract the error is not taken.

    Args:
        layout: Shape of the path.
        variables: Where to begin.
        ends: Start and target.
        bounds: Variables stay inside; those at a bound move away from it only.
        start: The roll-out of `variables`, when known.
    """
    rollout = roll_out(layout, variables, ends.start, ends.signs) if start is None else start
    error = ends.error(rollout)
    size = float(np.abs(error).max())
    knots = layout.num_knots
    for _ in range(_MAX_STEPS):
        if size < _TOLERANCE:
            break
        flat = np.concatenate(variables)
        step = _least_norm(end_sensitivity(layout, variables, rollout), error, flat, bounds)
        moved = np.clip(flat + step, bounds.lower, bounds.upper)
        trial = Variables(moved[:knots], moved[knots:])
        driven = roll_out(layout, trial, ends.start, ends.signs)
        found = ends.error(driven)
        found_size = float(np.abs(found).max())
        if found_size > _CONTRACTION * size:
            break
        variables, rollout, error, size = trial, driven, found, found_size
    return variables, rollout


def _least_norm(jacobian: FloatArray, error: FloatArray, flat: FloatArray, bounds: Bounds) -> FloatArray:
    """Step of least norm with `jacobian step = -error`; variables that would leave their bounds are frozen once."""
    free = bounds.upper > bounds.lower
    step = np.zeros(flat.size)
    for _ in range(2):
        part = jacobian * free
        normal = part @ part.T + 1e-12 * np.eye(3)
        step = part.T @ np.linalg.solve(normal, -error)
        outside = (flat + step < bounds.lower) | (flat + step > bounds.upper)
        if not np.any(outside & free):
            break
        free = free & ~outside
    return step
