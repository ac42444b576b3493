"""Terms in the program: the cost of soft terms, and hard terms as rows, at the nodes of the path.

A soft term with weight w and residual r adds the trapezoidal sum of w r^2 over the driven length, with the exact
gradient and the Hessian of Gauss-Newton. A hard term h >= 0 gives one row per node whose value can change its sign
within a step. Its values have the unit of clearances, so the shortfalls and rows of both can be combined.
"""

from __future__ import annotations

import math
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
from smoothers.terms import SYMBOLS

if TYPE_CHECKING:
    from collections.abc import Callable, Container

    from optdock.geometry.arrays import FloatArray, IntArray
    from optdock.model.path import Path
    from smoothers.scp.basis import Basis
    from smoothers.scp.rollout import Rollout, Sensitivity, Variables
    from smoothers.scp.term_functions import TermSet

__all__ = [
    "TermBound",
    "TermsAlong",
    "linearized_terms",
    "node_shares",
    "require_numbers",
    "term_points",
    "terms_along",
    "tightened",
]

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
    values: FloatArray  # hard terms minus their margins, soft terms, Shape (num_nodes, terms)
    slopes: FloatArray  # derivatives by the symbols, see `TermSet.with_slopes`


def terms_along(bound: TermBound, basis: Basis, variables: Variables, rollout: Rollout) -> TermsAlong:
    """Return the terms along a path; values that are not finite are infinite costs and shortfalls."""
    terms, count = bound.terms, len(bound.terms.hard)
    values, slopes = terms.with_slopes(term_points(bound, basis, variables, rollout, terms.reads))
    values[:, :count] -= bound.margins
    short = -values[:, :count].min(axis=1, initial=np.inf)
    short[np.isnan(short)] = np.inf
    if not terms.soft:
        return TermsAlong(0.0, short, values, slopes)
    share = node_shares(basis) * variables.lengths[basis.node_gear]
    cost = float(share @ (values[:, count:] ** 2 @ terms.weights))
    return TermsAlong(cost if math.isfinite(cost) else math.inf, short, values, slopes)


def term_points(
    bound: TermBound,
    basis: Basis,
    variables: Variables,
    rollout: Rollout,
    reads: Container[str] = SYMBOLS,
) -> FloatArray:
    """Return the values of the symbols at the nodes, Shape (num_nodes, 7); those that are not in `reads` may be 0."""
    points = np.zeros((basis.num_nodes, len(SYMBOLS)))
    points[:, :2] = rollout.poses[:, :2]
    if "yaw" in reads:
        points[:, 2] = wrap_angles(rollout.poses[:, 2])
    points[:, 3] = rollout.curvature
    if "s" in reads:
        points[:, 4] = bound.before + _done(basis) @ variables.lengths
    if "remaining" in reads:
        points[:, 5] = bound.after + (1.0 - _done(basis)) @ variables.lengths
    if "gear" in reads:
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
    along: TermsAlong,
    by: Callable[[], Sensitivity],
    reach: float,
) -> tuple[Quadratic | None, ClearanceRows | None]:
    """Return the quadratic model of the soft terms, and the rows of the hard terms; None where there is nothing.

    Args:
        bound: Terms.
        basis: Basis.
        variables: Variables of the path.
        along: Terms along the path, finite numbers.
        by: Returns the derivatives of the poses; only called if a term acts.
        reach: Motion of a node [m, rad] within which a hard term must change its sign to have a row.
    """
    values, slopes, count = along.values, along.slopes, len(bound.terms.hard)
    within = np.array([reach, reach, reach, bound.bend, reach, reach])
    is_near, rows = values[:, :count] < within @ np.abs(slopes[:, :, :count]), list[ClearanceRows]()
    for k in np.flatnonzero(is_near.any(axis=0)).tolist():
        near = np.flatnonzero(is_near[:, k])
        if near.size > _MOST_ROWS:
            near = near[np.argpartition(values[near, k], _MOST_ROWS)[:_MOST_ROWS]]
        gradient = _by_variables(basis, by(), slopes[:, :, k], near)
        found = ClearanceRows(gradient, values[near, k], near)
        rows.append(found.subset(np.abs(gradient).max(axis=1, initial=0.0) > _FLAT))
    share, quadratic = node_shares(basis), None
    for k in (count + np.flatnonzero(values[:, count:].any(axis=0))).tolist():
        residual, weight = values[:, k], bound.terms.weights[k - count]
        used = np.flatnonzero(residual)
        scale = 2.0 * weight * share[used] * variables.lengths[basis.node_gear[used]]
        moved = _by_variables(basis, by(), slopes[:, :, k], used)
        longer = np.bincount(basis.node_gear, weight * share * residual**2, minlength=basis.num_gears)
        gradient = (scale * residual[used]) @ moved
        gradient[basis.num_knots :] += longer
        added = Quadratic(gradient, moved.T @ (scale[:, None] * moved))
        quadratic = added if quadratic is None else quadratic.plus(added)
    joined = ClearanceRows(*(np.concatenate(parts) for parts in zip(*rows, strict=True))) if rows else None
    return quadratic, joined


def tightened(bound: TermBound, basis: Basis, variables: Variables, path: Path) -> TermBound:
    """Return the bound with larger margins at the nodes next to samples of `path` where a hard term is negative.

    Args:
        bound: Terms along the path or piece.
        basis: Basis.
        variables: Variables of the path.
        path: Exact path of these variables, with the final straight.
    """
    count, driven = len(bound.terms.hard), bound.before + _done(basis) @ variables.lengths
    straight = float(path.driven - (driven[-1] - bound.before))
    samples, _ = samples_of(path, bound.before, bound.after - straight)
    values = bound.terms.values(samples)[:, :count]
    short = np.where(np.isfinite(values), np.maximum(-values, 0.0), 0.0)
    after = np.clip(np.searchsorted(driven, samples[:, 4]), 1, len(driven) - 1)
    margins = np.zeros((len(driven), count))
    for node in (after - 1, after):
        np.maximum.at(margins, node, _TIGHTENED * short)
    margins[[0, -1]] = 0.0  # the ends are given
    return replace(bound, margins=bound.margins + margins)


def require_numbers(bound: TermBound, basis: Basis, variables: Variables, rollout: Rollout, along: TermsAlong) -> None:
    """Raise FailedToSmoothPath if a value is not a finite number: a path with such values is never improved."""
    finite = np.isfinite(along.values)
    if finite.all():
        return
    row, k = np.argwhere(~finite)[0]
    x, y, yaw, _, s, *_ = term_points(bound, basis, variables, rollout)[row].tolist()
    term = (*bound.terms.hard, *bound.terms.soft)[k]
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
