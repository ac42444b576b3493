"""Goal projection: the smallest change of the variables that moves the end of the path onto its target.

Every iterate is projected by Newton steps of least norm on the three equations of the goal, within the bounds of the
variables, alternating with a projection onto the bound of the curvature rate. The result of a search is projected once
more as a clothoid spline, to rounding accuracy.
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
    """Return variables projected onto the goal, or limited in rate if that is impossible, and their roll-out."""
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
    """Return the variables after Newton steps of least norm within `bounds`, as long as the error contracts (S6)."""
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
    """Return the pseudo-inverse of the goal derivatives, Shape (size, 3), for variables that stay in their bounds."""
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
    """Return the last pose, Shape (3,), and the displacements that lead to it, Shape (2 num_intervals, 2) [m].

    There are two displacements per interval, one for each node of the quadrature of its headings.
    """
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
    """Return the derivatives of the last pose, Shape (3, size), from the moves of the roll-out."""
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
    """Return the variables, clipped to their bounds."""
    knots = variables.curvature.size
    return Variables(
        np.clip(variables.curvature, bounds.lower[:knots], bounds.upper[:knots]),
        np.clip(variables.lengths, bounds.lower[knots:], bounds.upper[knots:]),
    )


def limit_rate(basis: Basis, variables: Variables, bounds: VariableBounds) -> Variables:
    """Return variables limited to the largest curvature rate (S7); fixed curvatures are not changed.

    The result is the mean of the largest rate-bounded function below the curvature and the smallest one above it.
    """
    if not np.isfinite(bounds.rate):
        return variables
    curvature = variables.curvature.copy()
    for m, (first, last) in enumerate(zip(basis.first_knots, basis.last_knots, strict=True)):
        knots = np.arange(first, last + 1)
        # The factor keeps rounding below the bound.
        change = (1.0 - 1e-12) * bounds.rate * variables.lengths[m] / (last - first) * np.abs(knots[:, None] - knots)
        values = curvature[knots]
        for k in np.flatnonzero(bounds.lower[knots] == bounds.upper[knots]):
            values = np.clip(values, values[k] - change[k], values[k] + change[k])
        curvature[knots] = 0.5 * ((values + change).min(axis=1) + (values - change).max(axis=1))
    return Variables(curvature, variables.lengths)


def rate_is_kept(basis: Basis, variables: Variables, bounds: VariableBounds) -> bool:
    """Whether the curvature rate is within its bound."""
    slopes = basis.span_slopes @ variables.curvature
    return bool(np.all(np.abs(slopes) <= bounds.rate * variables.lengths[basis.span_gear] * (1.0 + 1e-12)))


def exact_path(nlp: NonlinearProgram, variables: Variables, final_straight: float) -> Path:
    """Return the path of clothoid splines and the final straight, whose end is the goal except for rounding (S20)."""
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
        error[:2] -= (
            error[2] * back * np.array([-np.sin(target[2]), np.cos(target[2])])
        )  # at the beginning of the straight
        jacobian = end_sensitivity(basis, variables, end_pose(basis, variables, ends.start, ends.signs)[1])
        flat = np.concatenate(variables)
        moved = flat - _bounded_inverse(jacobian, error, flat, nlp.bounds) @ error
        moved = np.clip(moved, nlp.bounds.lower, nlp.bounds.upper)
        variables = Variables(moved[: basis.num_knots], moved[basis.num_knots :])
        splines = _chained(basis, variables, ends, final_straight)
    return Path(tuple(ClothoidSegment(spline) for spline in splines))


def driven_path(nlp: NonlinearProgram, variables: Variables, final_straight: float = 0.0) -> Path:
    """Return the path of clothoid splines and a straight of a given length [m], without moving its end to the goal."""
    splines = _chained(nlp.basis, variables, nlp.ends, final_straight)
    return Path(tuple(ClothoidSegment(spline) for spline in splines))


def _chained(basis: Basis, variables: Variables, ends: Ends, final_straight: float) -> list[ClothoidSpline]:
    """Return one spline per gear, each from the end of the previous spline; the last spline includes the straight."""
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
