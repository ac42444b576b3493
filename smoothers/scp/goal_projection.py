"""Goal projection: the smallest change of the variables that brings the end of the path onto its target.

Every iterate is projected, so that every one is drivable and nearly every one a candidate for the result: Newton steps
of least norm on the three equations of the goal, within the box of the variables, in turn with a projection onto the
bound of the curvature rate. The result of a search is projected once more as a clothoid spline, to rounding accuracy.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.pose import Pose2
from optdock.model.path import ClothoidSegment, Path
from smoothers.scp.rollout import Variables, roll_out

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray
    from smoothers.scp.basis import Basis
    from smoothers.scp.nlp import Ends, NonlinearProgram, VariableBounds
    from smoothers.scp.rollout import Rollout
    from smoothers.scp.settings import GoalProjectionSettings

__all__ = [
    "clipped",
    "driven_path",
    "end_pose",
    "end_sensitivity",
    "exact_path",
    "limit_rate",
    "onto_goal",
    "project_and_roll_out",
    "rate_is_kept",
]


def project_and_roll_out(nlp: NonlinearProgram, variables: Variables) -> tuple[Variables, Rollout]:
    """The variables on the goal, where that keeps the curvature rate, and driven; else as they are, within the rate."""
    basis, ends, settings = nlp.basis, nlp.ends, nlp.settings.projection
    variables = clipped(variables, nlp.bounds)
    projected = onto_goal(basis, variables, ends, nlp.bounds, settings)
    for _ in range(settings.alternations):
        if rate_is_kept(basis, projected, nlp.bounds):
            break
        projected = onto_goal(basis, limit_rate(basis, projected, nlp.inner_bounds), ends, nlp.bounds, settings)
    if not rate_is_kept(basis, projected, nlp.bounds):
        projected = limit_rate(basis, variables, nlp.inner_bounds)
    return projected, roll_out(basis, projected, ends.start, ends.signs)


def onto_goal(
    basis: Basis, variables: Variables, ends: Ends, bounds: VariableBounds, settings: GoalProjectionSettings
) -> Variables:
    """Some Newton steps of least norm; a step that does not contract the error is not taken.

    Args:
        basis: Shape of the path.
        variables: Where to begin.
        ends: Start and target.
        bounds: Variables stay inside.
        settings: Accuracy and number of steps.
    """
    pose, moves = end_pose(basis, variables, ends.start, ends.signs)
    error = pose - ends.target
    size, flat, knots = _largest(error), np.concatenate(variables), basis.num_knots
    inverse: FloatArray | None = None
    for _ in range(settings.max_steps):
        if not settings.tolerance <= size <= ends.reach:
            break
        if inverse is None or size > settings.renew:
            inverse = _bounded_inverse(end_sensitivity(basis, variables, moves), error, flat, bounds)
        moved = np.clip(flat - inverse @ error, bounds.lower, bounds.upper)
        trial = Variables(moved[:knots], moved[knots:])
        pose, driven = end_pose(basis, trial, ends.start, ends.signs)
        found = pose - ends.target
        if _largest(found) > settings.contraction * size:
            break
        flat, variables, moves, error, size = moved, trial, driven, found, _largest(found)
    return variables


def _largest(error: FloatArray) -> float:
    return float(max(abs(error[0]), abs(error[1]), abs(error[2])))


def _bounded_inverse(jacobian: FloatArray, error: FloatArray, flat: FloatArray, bounds: VariableBounds) -> FloatArray:
    """The matrix whose product with an error is the least change of the variables that makes up for it.

    Variables that would leave their bounds on the way are frozen, once.

    Args:
        jacobian: Derivatives of the last pose, Shape (3, size).
        error: Shape (3,) [m, m, rad].
        flat: The variables, Shape (size,).
        bounds: Of the variables.

    Returns:
        Shape (size, 3).
    """
    free = bounds.upper > bounds.lower
    inverse = _pseudo_inverse(jacobian * free)
    moved = flat - inverse @ error
    outside = free & ((moved < bounds.lower) | (moved > bounds.upper))
    return _pseudo_inverse(jacobian * (free & ~outside)) if outside.any() else inverse


def _pseudo_inverse(jacobian: FloatArray) -> FloatArray:
    normal = jacobian @ jacobian.T
    normal[np.arange(3), np.arange(3)] += 1e-12
    return np.asarray(np.linalg.solve(normal, jacobian).T, dtype=np.float64)


def end_pose(basis: Basis, variables: Variables, start: FloatArray, signs: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The last pose, Shape (3,), and the moves, Shape (2 num_intervals, 2), much cheaper than all poses."""
    curvature, lengths = variables
    turned = lengths[basis.knot_gear] * curvature
    yaw = start[2] + basis.gauss_headings @ turned
    weight = basis.gauss_shares @ (lengths * signs)
    moves = np.empty((yaw.size, 2))
    np.multiply(weight, np.cos(yaw), out=moves[:, 0])
    np.multiply(weight, np.sin(yaw), out=moves[:, 1])
    pose = np.array(start)
    pose[:2] += moves.sum(axis=0)
    pose[2] += basis.node_headings[-1] @ turned
    return pose, moves


def end_sensitivity(basis: Basis, variables: Variables, moves: FloatArray) -> FloatArray:
    """Derivatives of the last pose alone, much cheaper than those of all. Shape (3, size).

    Args:
        basis: Shape of the path.
        variables: Where it is.
        moves: Of the roll-out, Shape (2 num_intervals, 2) [m].
    """
    knots, lengths = basis.num_knots, variables.lengths[basis.knot_gear]
    masked = basis.knot_members * variables.curvature[:, None]
    weighted = moves.T @ basis.gauss_headings  # (2, num_knots)
    out = np.empty((3, basis.size))
    np.multiply(-weighted[1], lengths, out=out[0, :knots])
    np.multiply(weighted[0], lengths, out=out[1, :knots])
    out[0, knots:], out[1, knots:] = -weighted[1] @ masked, weighted[0] @ masked
    last = basis.node_headings[-1]
    out[2, :knots] = last * lengths
    out[2, knots:] = last @ masked
    out[:2, knots:] += (moves.T @ basis.gauss_members) / variables.lengths
    return out


def clipped(variables: Variables, bounds: VariableBounds) -> Variables:
    """Variables moved into their box."""
    knots = variables.curvature.size
    return Variables(
        np.clip(variables.curvature, bounds.lower[:knots], bounds.upper[:knots]),
        np.clip(variables.lengths, bounds.lower[knots:], bounds.upper[knots:]),
    )


def limit_rate(basis: Basis, variables: Variables, bounds: VariableBounds) -> Variables:
    """Curvatures moved as little as needed so that the rate keeps its bound; fixed ones stay.

    The mean of the largest rate-bounded function below and the smallest above: the identity where the bound holds.
    """
    if not np.isfinite(bounds.rate):
        return variables
    curvature = variables.curvature.copy()
    for m, (first, last) in enumerate(zip(basis.first_knots, basis.last_knots, strict=True)):
        knots = np.arange(first, last + 1)
        # Rounding must not leave the rate a little above its bound.
        change = (1.0 - 1e-12) * bounds.rate * variables.lengths[m] / (last - first) * np.abs(knots[:, None] - knots)
        values = curvature[knots]
        for k in np.flatnonzero(bounds.lower[knots] == bounds.upper[knots]):
            values = np.clip(values, values[k] - change[k], values[k] + change[k])
        curvature[knots] = 0.5 * ((values + change).min(axis=1) + (values - change).max(axis=1))
    return Variables(curvature, variables.lengths)


def rate_is_kept(basis: Basis, variables: Variables, bounds: VariableBounds) -> bool:
    """Whether the curvature rate keeps its bound."""
    slopes = basis.span_slopes @ variables.curvature
    return bool(np.all(np.abs(slopes) <= bounds.rate * variables.lengths[basis.span_gear] * (1.0 + 1e-12)))


def exact_path(nlp: NonlinearProgram, variables: Variables, final_straight: float) -> Path:
    """The clothoid splines of all gears, the last one with the final straight, closed onto the goal."""
    basis, ends, settings = nlp.basis, nlp.ends, nlp.settings.projection
    target = ends.target
    back = float(ends.signs[-1]) * final_straight
    goal = target + back * np.array([np.cos(target[2]), np.sin(target[2]), 0.0])
    variables = onto_goal(basis, variables, ends, nlp.bounds, replace(settings, tolerance=settings.polished))
    splines = _chained(basis, variables, ends, final_straight)
    for _ in range(settings.exact_steps):
        error = splines[-1].end.as_array() - goal
        if float(np.abs(error).max()) < settings.exact:
            break
        error[:2] -= error[2] * back * np.array([-np.sin(target[2]), np.cos(target[2])])  # seen before the straight
        jacobian = end_sensitivity(basis, variables, end_pose(basis, variables, ends.start, ends.signs)[1])
        flat = np.concatenate(variables)
        moved = flat - _bounded_inverse(jacobian, error, flat, nlp.bounds) @ error
        moved = np.clip(moved, nlp.bounds.lower, nlp.bounds.upper)
        variables = Variables(moved[: basis.num_knots], moved[basis.num_knots :])
        splines = _chained(basis, variables, ends, final_straight)
    return Path(tuple(ClothoidSegment(spline) for spline in splines))


def driven_path(nlp: NonlinearProgram, variables: Variables, final_straight: float = 0.0) -> Path:
    """The clothoid splines of all gears as they stand, wherever they end, and a straight of some length [m]."""
    splines = _chained(nlp.basis, variables, nlp.ends, final_straight)
    return Path(tuple(ClothoidSegment(spline) for spline in splines))


def _chained(basis: Basis, variables: Variables, ends: Ends, final_straight: float) -> list[ClothoidSpline]:
    """One spline per gear, each from the end of the one before, the straight at the last one's end."""
    pose = Pose2.from_sequence(ends.start)
    splines = []
    for m, (first, last) in enumerate(zip(basis.first_knots, basis.last_knots, strict=True)):
        knots = np.linspace(0.0, variables.lengths[m], last - first + 1)
        curvature = variables.curvature[first : last + 1]
        if m == basis.num_gears - 1 and final_straight > 0.0:
            knots, curvature = np.append(knots, knots[-1] + final_straight), np.append(curvature, 0.0)
        spline = ClothoidSpline(pose, knots, curvature, int(ends.signs[m]))
        splines.append(spline)
        pose = spline.end
    return splines
