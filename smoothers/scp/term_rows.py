"""Terms in the program: the cost of soft terms, and hard terms as rows, at the nodes of the path.

A soft term with weight w and residual r adds the trapezoidal sum of w r^2 over the driven length, with the exact
gradient and the Hessian of Gauss-Newton. A hard term h >= 0 gives one row per node whose value can change its sign
within a step. Its values have the unit of clearances, so the shortfalls and rows of both can be combined.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.geometry.arrays import readonly
from optdock.geometry.pose import wrap_angles
from smoothers.scp.collision.linearization import ClearanceRows
from smoothers.scp.cost import Quadratic
from smoothers.scp.refusals import Refusal
from smoothers.scp.term_samples import samples_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from optdock.geometry.arrays import FloatArray, IntArray
    from optdock.model.path import Path
    from smoothers.scp.basis import Basis
    from smoothers.scp.rollout import Rollout, Sensitivity, Variables
    from smoothers.scp.term_functions import TermSet

__all__ = ["TermBound", "TermsAlong", "linearized_terms", "node_shares", "term_points", "terms_along", "tightened"]

_FLAT = 1e-9  # smaller derivatives by all variables give no row: the start is given
_TIGHTENED = 1.2  # times the shortfall between nodes
_MOST_ROWS = 48  # per hard term: the lowest values


@dataclass(frozen=True, eq=False)
class TermBound:
    """Terms along a path, or along a piece of a path."""

    terms: TermSet
    signs: FloatArray  # gears, Shape (num_gears,)
    before: float  # distance driven before the first node [m]
    after: float  # distance from the last node to the goal [m]: the final straight, and later pieces of the path
    bend: float  # largest change of a curvature [1/m]
    margins: FloatArray | float = 0.0  # values required of the hard terms at the nodes, Shape (num_nodes, hard terms)


class TermsAlong(NamedTuple):
    """Terms at the nodes of a path."""

    cost: float  # of the soft terms
    short: FloatArray  # largest shortfall of the hard terms, Shape (num_nodes,)
    points: FloatArray  # values of the symbols, Shape (num_nodes, 7)


def terms_along(bound: TermBound, basis: Basis, variables: Variables, rollout: Rollout) -> TermsAlong:
    """Return the terms along a path; values that are not finite are infinite costs and shortfalls."""
    points = term_points(bound, basis, variables, rollout)
    values = bound.terms.values(points)
    count = len(bound.terms.hard)
    hard, soft = values[:, :count] - bound.margins, values[:, count:]
    hard[~np.isfinite(hard)] = -np.inf
    short = -hard.min(axis=1, initial=np.inf)
    if not bound.terms.soft:
        return TermsAlong(0.0, short, points)
    share = node_shares(basis) * variables.lengths[basis.node_gear]
    cost = float(share @ (soft**2 @ bound.terms.weights))
    return TermsAlong(cost if np.isfinite(cost) else np.inf, short, points)


def term_points(bound: TermBound, basis: Basis, variables: Variables, rollout: Rollout) -> FloatArray:
    """Return the values of the symbols at the nodes, Shape (num_nodes, 7)."""
    done, lengths = _done(basis), variables.lengths
    points = np.empty((basis.num_nodes, 7))
    points[:, :2] = rollout.poses[:, :2]
    points[:, 2] = wrap_angles(rollout.poses[:, 2])
    points[:, 3] = rollout.curvature
    points[:, 4] = bound.before + done @ lengths
    points[:, 5] = bound.after + (1.0 - done) @ lengths
    points[:, 6] = bound.signs[basis.node_gear]
    return points


@lru_cache(maxsize=16)  # as `basis_for`, because the key keeps the basis
def _done(basis: Basis) -> FloatArray:
    """Return the share of each gear that is driven at each node, Shape (num_nodes, num_gears)."""
    gear, gears = basis.node_gear[:, None], np.arange(basis.num_gears)
    return readonly(np.where(gears == gear, basis.fraction[:, None], (gears < gear).astype(np.float64)))


@lru_cache(maxsize=16)  # as `basis_for`, because the key keeps the basis
def node_shares(basis: Basis) -> FloatArray:
    """Return the weights of the trapezoidal rule at the nodes, as shares of the length of each gear."""
    cells = np.bincount(basis.interval_gear, minlength=basis.num_gears)
    inner = (basis.fraction > 0.0) & (basis.fraction < 1.0)
    return readonly(np.where(inner, 1.0, 0.5) / cells[basis.node_gear])


def linearized_terms(
    bound: TermBound,
    basis: Basis,
    variables: Variables,
    points: FloatArray,
    by: Callable[[], Sensitivity],
    reach: float,
) -> tuple[Quadratic | None, ClearanceRows | None]:
    """Return the quadratic model of the soft terms, and the rows of the hard terms; None where there is nothing.

    Args:
        bound: Terms.
        basis: Basis.
        variables: Variables of the roll-out.
        points: Values of the symbols at the nodes.
        by: Returns the derivatives of the poses; only called if a term acts.
        reach: Motion of a node [m, rad] within which a hard term must change its sign to have a row.
    """
    terms = bound.terms
    values, slopes = terms.with_slopes(points)
    _require_numbers(terms, points, values)
    values[:, : len(terms.hard)] -= bound.margins
    count, rows, quadratic = len(terms.hard), list[ClearanceRows](), None
    within = np.array([reach, reach, reach, bound.bend, reach, reach])
    for k in range(count):
        near = np.flatnonzero(values[:, k] < np.abs(slopes[:, :, k]) @ within)
        if not near.size:
            continue
        if near.size > _MOST_ROWS:
            near = near[np.argpartition(values[near, k], _MOST_ROWS)[:_MOST_ROWS]]
        gradient = _by_variables(basis, by(), slopes[:, :, k], near)
        found = ClearanceRows(gradient, values[near, k], near)
        rows.append(found.subset(np.abs(gradient).max(axis=1, initial=0.0) > _FLAT))
    share = node_shares(basis)
    for k, weight in enumerate(terms.weights, count):
        residual = values[:, k]
        used = np.flatnonzero(residual)
        if not used.size:
            continue
        scale = 2.0 * weight * share[used] * variables.lengths[basis.node_gear[used]]
        moved = _by_variables(basis, by(), slopes[:, :, k], used)
        longer = np.bincount(basis.node_gear, weight * share * residual**2, minlength=basis.num_gears)
        gradient = (scale * residual[used]) @ moved
        gradient[basis.num_knots :] += longer
        added = Quadratic(gradient, moved.T @ (scale[:, None] * moved))
        quadratic = added if quadratic is None else quadratic.plus(added)
    joined = ClearanceRows(*(np.concatenate(parts) for parts in zip(*rows, strict=True))) if rows else None
    return quadratic, joined


def tightened(bound: TermBound, points: FloatArray, path: Path) -> TermBound:
    """Return the bound with larger margins at the nodes next to samples of `path` where a hard term is negative.

    Args:
        bound: Terms along the path or piece.
        points: Values of the symbols at the nodes.
        path: Exact path of these nodes, with the final straight.
    """
    count, straight = len(bound.terms.hard), float(path.driven - (points[-1, 4] - bound.before))
    samples, _ = samples_of(path, bound.before, bound.after - straight)
    values = bound.terms.values(samples)[:, :count]
    short = np.where(np.isfinite(values), np.maximum(-values, 0.0), 0.0)
    after = np.clip(np.searchsorted(points[:, 4], samples[:, 4]), 1, len(points) - 1)
    margins = np.zeros((len(points), count))
    for node in (after - 1, after):
        np.maximum.at(margins, node, _TIGHTENED * short)
    margins[[0, -1]] = 0.0  # the ends are given
    return replace(bound, margins=bound.margins + margins)


def _require_numbers(terms: TermSet, points: FloatArray, values: FloatArray) -> None:
    """Raise FailedToSmoothPath if a value is not a finite number: a path with such values is never improved."""
    if np.isfinite(values).all():
        return
    row, k = np.argwhere(~np.isfinite(values))[0]
    term, (x, y, yaw, _, s, *_) = (*terms.hard, *terms.soft)[k], points[row].tolist()
    message = f"the term {term.name!r} is not a finite number at s = {s:.3f} m on the first path of the search"
    raise Refusal("term", s, np.inf, "", message, np.array([x, y, yaw]), {"term": term.name}).error()


def _by_variables(basis: Basis, by: Sensitivity, slopes: FloatArray, node: IntArray) -> FloatArray:
    """Return the derivatives of a term at some nodes with respect to the variables, Shape (n, size)."""
    slope, knots = slopes[node], basis.num_knots
    out = np.zeros((len(node), basis.size))
    for i, column in enumerate((by.x, by.y, by.yaw)):
        if slope[:, i].any():
            out += slope[:, i : i + 1] * column[node]
    if slope[:, 3].any():
        out[:, :knots] += slope[:, 3:4] * basis.node_curvatures[node]
    if slope[:, 4:].any():
        done = _done(basis)[node]
        out[:, knots:] += slope[:, 4:5] * done + slope[:, 5:6] * (1.0 - done)
    return out
