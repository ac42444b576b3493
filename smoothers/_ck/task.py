"""One smoothing problem in the solver's terms."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable

    from optdock.geometry.arrays import FloatArray
    from optdock.limits import MotionLimits
    from smoothers._ck.closing import Bounds, Ends
    from smoothers._ck.layout import Layout
    from smoothers._ck.rollout import Variables
    from smoothers._ck.terms import CostModel
    from smoothers._ck.world import World

__all__ = ["CURVATURE_CAP", "Task", "curvature_bound", "no_restart", "reference_scales", "variable_bounds"]

CURVATURE_CAP = 20.0
"""Curvature that stands for an unlimited one [1/m]: a radius of 5 cm, below any wheeled robot's size."""

_CURVATURE_INSIDE = 0.999  # of the limit; goal closing may use the rest
_RATE_INSIDE = 0.99
_MIN_LENGTH = 0.02  # [m]: a gear never vanishes
_RATE_SCALE = 4.0  # [1/m]: reference rate per reference curvature where the rate is unlimited
_RELAXED_SCALE = 1.5  # [1/m]: reference curvature where curvature is unlimited


def no_restart(on_goal: bool) -> Task | None:  # noqa: ARG001, FBT001 - the form of Task.restart
    """Nothing else to try."""
    return None


@dataclass(frozen=True, eq=False)
class Task:
    """What the search works on.

    Args:
        layout: Shape of the path.
        ends: Start, target before the final straight, gears.
        bounds: What the accepted variables keep exactly.
        inner: The same a little tighter: what the steps aim at.
        cost: What is minimized.
        world: What must be kept clear of.
        initial: First variables.
        stretch: Largest change of a gear length per radian of the trust region [m].
        restart: What to try next where nothing is found, given whether the failed search ended on the goal; or None.
        buffer: Clearance aimed at above the requirement [m].
        trust: First bound of the heading changes of a step [rad].
        prox: First weight of the squared motion of a step.
        patience: Iterations within which an infeasible iterate must lose a good part of its shortfall.
    """

    layout: Layout
    ends: Ends
    bounds: Bounds
    inner: Bounds
    cost: CostModel
    world: World
    initial: Variables
    stretch: float
    restart: Callable[[bool], Task | None] = no_restart
    buffer: float = 8e-4
    trust: float = 0.45
    prox: float = 1.0
    patience: int = 4


def curvature_bound(limits: MotionLimits) -> float:
    """The curvature limit, capped where it is unlimited."""
    return min(limits.max_curvature, CURVATURE_CAP)


def reference_scales(limits: MotionLimits) -> tuple[float, float]:
    """Curvature and curvature rate that the cost counts as one."""
    curvature = limits.max_curvature if math.isfinite(limits.max_curvature) else _RELAXED_SCALE
    rate = limits.max_curvature_rate if math.isfinite(limits.max_curvature_rate) else _RATE_SCALE * curvature
    return curvature, rate


def variable_bounds(
    layout: Layout, limits: MotionLimits, lengths: FloatArray, *, start_curvature: float | None, straight_end: bool
) -> tuple[Bounds, Bounds]:
    """Exact bounds, and the inner ones that steps aim at.

    Args:
        layout: Shape of the path.
        limits: Curvature and curvature rate limits.
        lengths: Gear lengths of the input, Shape (num_gears,) [m].
        start_curvature: Fixed curvature at the start, or None.
        straight_end: Whether the curvature must end at zero.
    """
    from smoothers._ck.closing import Bounds

    found = []
    shortest, longest = np.minimum(_MIN_LENGTH, 0.5 * lengths), 4.0 * lengths + 20.0
    for inside, rate_inside in ((1.0, 1.0), (_CURVATURE_INSIDE, _RATE_INSIDE)):
        limit = np.full(layout.num_knots, inside * curvature_bound(limits))
        lower, upper = np.concatenate((-limit, shortest)), np.concatenate((limit, longest))
        if start_curvature is not None:
            lower[0] = upper[0] = start_curvature
        if straight_end:
            lower[layout.num_knots - 1] = upper[layout.num_knots - 1] = 0.0
        found.append(Bounds(lower, upper, rate_inside * limits.max_curvature_rate))
    return found[0], found[1]
