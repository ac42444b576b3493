"""Goal projection: the smallest change of the variables that moves the end of the path onto its target.

Every iterate is projected by Newton steps of least norm on the three equations of the goal, within the bounds of the
variables, alternating with a projection onto the bound of the curvature rate. The result of a search is projected once
more as a clothoid spline, to rounding accuracy.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.pose import Pose2
from optdock.kernels import Kernel, twin_of
from optdock.model.path import ClothoidSegment, Path
from smoothers.scp.rollout import Rollout, Variables, displacements, in_order, roll_out

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray
    from smoothers.scp.basis import Basis
    from smoothers.scp.nlp import Ends, NonlinearProgram, VariableBounds
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

_KERNEL = Kernel("optdock_project_and_roll_out", sizes=6, numbers=6)
_END_SENSITIVITY = Kernel("optdock_end_sensitivity", sizes=4, numbers=0)


def _project_native(nlp: NonlinearProgram, variables: Variables) -> tuple[Variables, Rollout]:
    settings, bounds = nlp.settings.projection, (nlp.bounds, nlp.inner_bounds)
    found, out = _run(nlp.basis, variables, nlp.ends, bounds, settings, settings.alternations)
    return found, Rollout.within(out[: 4 * nlp.basis.num_nodes + 6 * nlp.basis.num_intervals], nlp.basis)


@twin_of(_project_native)
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


def _run(
    basis: Basis,
    variables: Variables,
    ends: Ends,
    bounds: tuple[VariableBounds, VariableBounds],
    settings: GoalProjectionSettings,
    alternations: int,
) -> tuple[Variables, FloatArray]:
    """Return the result of the kernel and its array `out`; `bounds`: those of the result and the tighter ones."""
    size, count = basis.size, 4 * basis.num_nodes + 6 * basis.num_intervals
    limits = bounds[0].lower, bounds[0].upper, bounds[1].lower, bounds[1].upper
    given = np.concatenate((*variables, ends.start, ends.signs, ends.target, *limits))
    out = np.empty(count + 7 * size)
    arrays = (
        (basis.packed, 2 * (basis.num_intervals + basis.num_nodes) * basis.num_knots),
        (basis.divisions, 2 * basis.num_gears),
        (given, 5 * size + 6 + basis.num_gears),
        (out, count + 7 * size),
    )
    sizes = basis.num_gears, basis.num_knots, basis.num_nodes, basis.num_intervals, settings.max_steps, alternations
    numbers = settings.tolerance, settings.renew, settings.contraction, ends.reach, bounds[0].rate, bounds[1].rate
    _KERNEL(sizes, numbers, arrays)
    return Variables(out[count : count + basis.num_knots], out[count + basis.num_knots : count + size]), out


def _onto_goal_native(
    basis: Basis, variables: Variables, ends: Ends, bounds: VariableBounds, settings: GoalProjectionSettings
) -> Variables:
    return _run(basis, variables, ends, (bounds, bounds), settings, -1)[0]


@twin_of(_onto_goal_native)
def onto_goal(
    basis: Basis, variables: Variables, ends: Ends, bounds: VariableBounds, settings: GoalProjectionSettings
) -> Variables:
    """Return the variables after Newton steps of least norm within `bounds`, as long as the error contracts (S6)."""
    pose, moves = end_pose(basis, variables, ends.start, ends.signs)
    error = pose - ends.target
    size, flat = np.abs(error).max(), np.concatenate(variables)
    jacobian: FloatArray | None = None
    for _ in range(settings.max_steps):
        if not settings.tolerance <= size <= ends.reach:
            break
        if jacobian is None or size > settings.renew:
            jacobian = _restricted(end_sensitivity(basis, variables, moves), error, flat, bounds)
        moved = np.clip(flat - _least_norm(jacobian, error), bounds.lower, bounds.upper)
        trial = Variables(moved[: basis.num_knots], moved[basis.num_knots :])
        pose, driven = end_pose(basis, trial, ends.start, ends.signs)
        found = pose - ends.target
        if not np.abs(found).max() <= settings.contraction * size:
            break
        flat, variables, moves, error, size = moved, trial, driven, found, np.abs(found).max()
    return variables


def _restricted(jacobian: FloatArray, error: FloatArray, flat: FloatArray, bounds: VariableBounds) -> FloatArray:
    """Return the goal derivatives, Shape (3, size), without variables that are fixed or would leave their bounds."""
    free = bounds.upper > bounds.lower
    inside = jacobian * free
    moved = flat - _least_norm(inside, error)
    outside = free & ((moved < bounds.lower) | (moved > bounds.upper))
    return jacobian * (free & ~outside) if outside.any() else inside


def _least_norm(jacobian: FloatArray, error: FloatArray) -> FloatArray:
    """Return the change of least norm, Shape (size,), whose effect on the end is `error`, Shape (3,); 0 if singular."""
    a, b, c = _solved(in_order(jacobian[:, None] * jacobian, 2), error)
    change: FloatArray = jacobian[0] * a + jacobian[1] * b + jacobian[2] * c
    return change


def _solved(normal: FloatArray, error: FloatArray) -> tuple[float, float, float]:
    """Return the solution of a system of three equations with a symmetric matrix by its factors L D L'."""
    (a, _, _), (b, c, _), (d, e, f) = normal.tolist()
    x, y, z = error.tolist()
    a, c, f = a + 1e-12, c + 1e-12, f + 1e-12
    first, second = b / a, d / a
    c, e = c - first * b, e - second * b
    third = e / c if c > 0.0 else 0.0
    f = f - second * d - third * e
    if not (a > 0.0 and c > 0.0 and f > 0.0):
        return 0.0, 0.0, 0.0
    y = y - first * x
    z = z - second * x - third * y
    z = z / f
    y = y / c - third * z
    return x / a - first * y - second * z, y, z


def end_pose(basis: Basis, variables: Variables, start: FloatArray, signs: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the last pose, Shape (3,), and the displacements that lead to it, Shape (2 num_intervals, 2) [m].

    There are two displacements per interval, one for each node of the quadrature of its headings.
    """
    curvature, lengths = variables
    moves, pose = displacements(basis, variables, start, signs), np.array(start)
    pose[:2] = in_order(np.concatenate((start[None, :2], moves[::2] + moves[1::2])))
    pose[2] += in_order(basis.node_headings[-1] * (lengths[basis.knot_gear] * curvature))
    return pose, moves


def _end_sensitivity_native(basis: Basis, variables: Variables, moves: FloatArray) -> FloatArray:
    out = np.empty((3, basis.size))
    arrays = (
        (basis.packed, 2 * (basis.num_intervals + basis.num_nodes) * basis.num_knots),
        (basis.divisions, 2 * basis.num_gears),
        (np.concatenate(variables), basis.size),
        (moves, 4 * basis.num_intervals),
        (out, 3 * basis.size),
    )
    _END_SENSITIVITY((basis.num_gears, basis.num_knots, basis.num_nodes, basis.num_intervals), (), arrays)
    return out


@twin_of(_end_sensitivity_native)
def end_sensitivity(basis: Basis, variables: Variables, moves: FloatArray) -> FloatArray:
    """Return the derivatives of the last pose, Shape (3, size), from the moves of the roll-out."""
    knots, (curvature, lengths) = basis.num_knots, variables
    weighted = np.empty((3, knots))
    rows = basis.packed[: len(moves)]  # `gauss_headings`, stored by rows
    weighted[0], weighted[1] = -in_order(rows * moves[:, 1:]), in_order(rows * moves[:, :1])
    weighted[2] = basis.node_headings[-1]
    out = np.empty((3, basis.size))
    np.multiply(weighted, lengths[basis.knot_gear], out=out[:, :knots])
    for m, own in enumerate(basis.own_knots):
        out[:, knots + m] = in_order(weighted[:, own] * curvature[own], 1)
        out[:2, knots + m] += in_order(moves[basis.own_moves[m]]) / lengths[m]
    return out


def clipped(variables: Variables, bounds: VariableBounds) -> Variables:
    """Return the variables, clipped to their bounds."""
    knots = variables.curvature.size
    return Variables(
        np.minimum(np.maximum(variables.curvature, bounds.lower[:knots]), bounds.upper[:knots]),
        np.minimum(np.maximum(variables.lengths, bounds.lower[knots:]), bounds.upper[knots:]),
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
    slopes = np.abs(basis.slopes(variables.curvature))
    return bool(np.all(slopes <= bounds.rate * variables.lengths[basis.span_gear] * (1.0 + 1e-12)))


def exact_path(nlp: NonlinearProgram, variables: Variables, final_straight: float, frame: str = "") -> Path:
    """Return the path of clothoid splines and the final straight, whose end is the goal except for rounding (S20)."""
    basis, ends, settings = nlp.basis, nlp.ends, nlp.settings.projection
    (x, y, yaw), back = ends.target.tolist(), float(ends.signs[-1]) * final_straight
    c, s = np.cos(yaw), np.sin(yaw)
    variables = onto_goal(basis, variables, ends, nlp.bounds, settings.of_exact_path)
    splines = _chained(basis, variables, ends, final_straight)
    for _ in range(settings.exact_steps):
        end = splines[-1].end
        error = np.array((end.x - (x + back * c), end.y - (y + back * s), end.yaw - yaw))
        if np.maximum.reduce(np.abs(error)) < settings.exact:
            break
        error[:2] -= error[2] * back * np.array((-s, c))  # at the beginning of the straight
        jacobian = end_sensitivity(basis, variables, end_pose(basis, variables, ends.start, ends.signs)[1])
        flat = np.concatenate(variables)
        moved = flat - _least_norm(_restricted(jacobian, error, flat, nlp.bounds), error)
        moved = np.clip(moved, nlp.bounds.lower, nlp.bounds.upper)
        variables = Variables(moved[: basis.num_knots], moved[basis.num_knots :])
        splines = _chained(basis, variables, ends, final_straight)
    return Path(tuple([ClothoidSegment(spline) for spline in splines]), frame)


def driven_path(nlp: NonlinearProgram, variables: Variables, final_straight: float = 0.0) -> Path:
    """Return the path of clothoid splines and a straight of a given length [m], without moving its end to the goal."""
    splines = _chained(nlp.basis, variables, nlp.ends, final_straight)
    return Path(tuple(ClothoidSegment(spline) for spline in splines))


def _chained(basis: Basis, variables: Variables, ends: Ends, final_straight: float) -> list[ClothoidSpline]:
    """Return one spline per gear, each from the end of the previous spline; the last spline includes the straight."""
    pose, splines = Pose2(*ends.start.tolist()), []
    for own, length, sign in zip(basis.own_knots, variables.lengths.tolist(), ends.signs.tolist(), strict=True):
        count, is_extended = own.stop - own.start, own.stop == basis.num_knots and final_straight > 0.0
        knots, curvature = np.arange(count + is_extended) * (length / (count - 1)), np.zeros(count + is_extended)
        knots[count - 1 :] = length
        knots[count:] += final_straight
        curvature[:count] = variables.curvature[own]
        splines.append(ClothoidSpline(pose, knots, curvature, int(sign)))
        pose = splines[-1].end
    return splines
