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
from optdock.geometry.lazy import cached_property
from optdock.geometry.pose import wrap_angles
from optdock.kernels import Kernel, twin_of
from smoothers.scp.collision.linearization import ClearanceRows
from smoothers.scp.qp_step import NOTHING_ADDED, Additions
from smoothers.scp.refusals import Refusal
from smoothers.scp.rollout import sensitivity
from smoothers.scp.term_samples import samples_of
from smoothers.terms import SYMBOLS

if TYPE_CHECKING:
    from optdock.geometry.arrays import BoolArray, FloatArray, IntArray
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

_ALONG = Kernel("optdock_terms_along", sizes=4, numbers=2)
_LINEARIZED = Kernel("optdock_linearized_terms", sizes=7, numbers=3)
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
    reach: float  # motion of a node [m, rad] within which a hard term must change its sign to have a row
    bend: float  # the same for a curvature [1/m]
    margins: FloatArray | None = None  # values required of the hard terms at the nodes, Shape (num_nodes, hard terms)

    @cached_property
    def packed(self) -> FloatArray:
        """Weights of the soft terms, and margins."""
        weights = self.terms.weights
        return readonly(weights if self.margins is None else np.concatenate((weights, self.margins), axis=None))


class TermsAlong(NamedTuple):
    """Terms at the nodes of a path."""

    cost: float  # of the soft terms
    short: FloatArray  # largest shortfall of the hard terms, Shape (num_nodes,)
    worst: float  # largest of them
    acts: bool  # whether the linearization has rows or costs, or a value is not a number
    # Hard terms minus their margins and soft terms, then their derivatives by each symbol, Shape (num_nodes, 7 terms).
    table: FloatArray

    @property
    def values(self) -> FloatArray:
        """Hard terms minus their margins, soft terms, Shape (num_nodes, terms)."""
        return self.table[:, : self.table.shape[1] // len(SYMBOLS)]

    @property
    def slopes(self) -> FloatArray:
        """Derivatives by the symbols, Shape (num_nodes, 6, terms); 0 if they are not finite."""
        nodes, width = self.table.shape
        return self.table[:, width // len(SYMBOLS) :].reshape(nodes, -1, width // len(SYMBOLS))


def term_points(bound: TermBound, basis: Basis, variables: Variables, rollout: Rollout) -> FloatArray:
    """Return the values of the symbols at the nodes, Shape (num_nodes, 7).

    The kernel of `loop.evaluated` computes them by `optdock_term_points`.
    """
    s = bound.before + _done(basis) @ variables.lengths
    remaining = bound.after + (1.0 - _done(basis)) @ variables.lengths
    yaw, gear = wrap_angles(rollout.poses[:, 2]), bound.signs[basis.node_gear]
    return np.column_stack((rollout.poses[:, :2], yaw, rollout.curvature, s, remaining, gear))


def terms_along(bound: TermBound, basis: Basis, lengths: FloatArray, points: FloatArray) -> TermsAlong:
    """Return the terms along a path; values that are not finite are infinite costs and shortfalls.

    Args:
        bound: Terms.
        basis: Basis.
        lengths: Lengths of the gears, Shape (num_gears,) [m].
        points: Result of `term_points`.
    """
    return _reduced(bound, basis, lengths, bound.terms.with_slopes(points))


def _reduced_natively(bound: TermBound, basis: Basis, lengths: FloatArray, table: FloatArray) -> TermsAlong:
    nodes, hard, terms, out = basis.num_nodes, len(bound.terms.hard), bound.terms.count, np.empty(basis.num_nodes + 2)
    margins = 0 if bound.margins is None else nodes * hard
    arrays = (
        (basis.divisions, 2 * basis.num_gears),
        (bound.packed, terms - hard + margins),
        (lengths, basis.num_gears),
        (table, len(SYMBOLS) * nodes * terms),
        (out, nodes + 2),
    )
    acts = _ALONG((basis.num_gears, hard, terms - hard, margins), (bound.reach, bound.bend), arrays)
    return TermsAlong(out.item(nodes), out[:nodes], out.item(nodes + 1), acts != 0, table)


@twin_of(_reduced_natively, lambda bound, basis, lengths, table: (bound, basis, lengths, table.copy()))
def _reduced(bound: TermBound, basis: Basis, lengths: FloatArray, table: FloatArray) -> TermsAlong:
    """Return the terms with the values of `TermSet.with_slopes`, which becomes the table of the result."""
    terms, count = bound.terms, len(bound.terms.hard)
    found = TermsAlong(0.0, np.empty(0), -np.inf, acts=False, table=table)
    values, slopes = found.values, found.slopes
    slopes[~np.isfinite(slopes)] = 0.0
    if bound.margins is not None:
        values[:, :count] -= bound.margins
    lowest = values[:, :count].min(axis=1, initial=np.inf)
    short = np.where(np.isnan(lowest), np.inf, -lowest)
    residuals = values[:, count:]
    with np.errstate(over="ignore"):
        cost = float(node_shares(basis) * lengths[basis.node_gear] @ (residuals**2 @ terms.weights))
    acts = bool(_is_near(bound, found).any() or residuals.any())
    return TermsAlong(cost if math.isfinite(cost) else math.inf, short, float(short.max()), acts, table)


def _is_near(bound: TermBound, along: TermsAlong) -> BoolArray:
    """Return where a hard term can change its sign within a step or is not a number, Shape (num_nodes, hard terms)."""
    count = len(bound.terms.hard)
    within = np.array([bound.reach, bound.reach, bound.reach, bound.bend, bound.reach, bound.reach])
    changes = (within[:, None] * np.abs(along.slopes[:, :, :count])).sum(axis=1)
    near: BoolArray = ~(along.values[:, :count] >= changes)
    return near


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


def _linearized_natively(
    bound: TermBound, basis: Basis, variables: Variables, rollout: Rollout, along: TermsAlong
) -> Additions:
    nodes, size, hard, terms = basis.num_nodes, basis.size, len(bound.terms.hard), bound.terms.count
    most, work = hard * min(_MOST_ROWS, nodes), (3 * nodes + 5) * size
    costs = np.empty(size + size * size if terms > hard else 0)
    rows, node = np.empty((most, 1 + size)), np.empty(most, dtype=np.int64)
    arrays = (
        (basis.packed, 2 * (basis.num_intervals + nodes) * basis.num_knots),
        (basis.divisions, 2 * basis.num_gears),
        (np.concatenate(variables), size),
        (rollout.moves, 4 * basis.num_intervals),
        (along.table, len(SYMBOLS) * nodes * terms),
        (bound.terms.weights, terms - hard),
        (costs, costs.size),
        (rows, rows.size),
        (node, most),
        (np.empty(work), work),
    )
    sizes = basis.num_gears, basis.num_knots, nodes, basis.num_intervals, hard, terms - hard, _MOST_ROWS
    found = _LINEARIZED(sizes, (bound.reach, bound.bend, _FLAT), arrays)
    return Additions(costs, rows[:found], node[:found])


@twin_of(_linearized_natively)
def linearized_terms(
    bound: TermBound, basis: Basis, variables: Variables, rollout: Rollout, along: TermsAlong
) -> Additions:
    """Return the rows of the hard terms, and the quadratic model of the soft terms if there are any.

    Args:
        bound: Terms.
        basis: Basis.
        variables: Variables of the path.
        rollout: The path at the nodes.
        along: Terms along the path, finite numbers.
    """
    values, slopes, hard = along.values, along.slopes, len(bound.terms.hard)
    by, is_near = sensitivity(basis, variables, rollout), _is_near(bound, along)
    rows = NOTHING_ADDED._replace(rows=np.empty((0, 1 + basis.size)))
    for k in range(hard):
        near = np.flatnonzero(is_near[:, k])
        found = ClearanceRows(_by_variables(basis, by, slopes[:, :, k], near), values[near, k], near).lowest(_MOST_ROWS)
        rows = rows.with_rows(found.subset(np.abs(found.gradient).max(axis=1, initial=0.0) > _FLAT))
    if not bound.terms.soft:
        return rows
    share, everywhere = node_shares(basis), np.arange(basis.num_nodes)
    gradient, hessian = np.zeros(basis.size), np.zeros((basis.size, basis.size))
    for k, term_weight in enumerate(bound.terms.weights.tolist(), hard):
        residual, weight = values[:, k], term_weight * share
        moved = _by_variables(basis, by, slopes[:, :, k], everywhere)
        scale = np.where(residual != 0.0, 2.0 * weight * variables.lengths[basis.node_gear], 0.0)
        gradient += (scale * residual) @ moved
        gradient[basis.num_knots :] += np.bincount(basis.node_gear, weight * residual**2, minlength=basis.num_gears)
        hessian += moved.T @ (scale[:, None] * moved)
    return rows._replace(costs=np.concatenate((gradient, hessian), axis=None))


def tightened(bound: TermBound, basis: Basis, variables: Variables, path: Path, allowance: float) -> TermBound:
    """Return the bound with larger margins at the nodes next to samples of `path` where a hard term is negative.

    On the final straight only `s` can change, by the same amount as at the last node. A term that is negative there
    must exceed its decrease on the straight at the last node.

    Args:
        bound: Terms along the path or piece.
        basis: Basis.
        variables: Variables of the path.
        path: Exact path of these variables, with the final straight.
        allowance: Shortfall that the search allows at the last node.
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
    margins[[0, -1]] = 0.0  # the poses of the ends are given
    if bound.margins is not None:
        margins += bound.margins
    is_short = (short[samples[:, 4] >= driven[-1]] > 0.0).any(axis=0)
    for k in np.flatnonzero(is_short).tolist():
        at_last = float(np.interp(driven[-1], samples[:, 4], values[:, k]))
        margins[-1, k] = at_last - values[samples[:, 4] >= driven[-1], k].min() + allowance
    return replace(bound, margins=margins)


def require_numbers(bound: TermBound, points: FloatArray, along: TermsAlong) -> None:
    """Raise FailedToSmoothPath if a value is not a finite number: a path with such values is never improved."""
    if along.cost < np.inf and along.worst < np.inf:
        return
    finite = np.isfinite(along.values)
    if finite.all():
        return
    row, k = np.argwhere(~finite)[0]
    x, y, yaw, _, s, *_ = points[row].tolist()
    term = (*bound.terms.hard, *bound.terms.soft)[k]
    message = f"the term {term.name!r} is not a finite number at s = {s:.3f} m on the first path of the search"
    raise Refusal("term", s, np.inf, "", message, np.array([x, y, yaw]), {"term": term.name}).error()


def _by_variables(basis: Basis, by: Sensitivity, slopes: FloatArray, node: IntArray) -> FloatArray:
    """Return the derivatives of a term at some nodes with respect to the variables, Shape (n, size)."""
    slope, knots, done = slopes[node], basis.num_knots, _done(basis)[node]
    out: FloatArray = slope[:, :1] * by.x[node] + slope[:, 1:2] * by.y[node] + slope[:, 2:3] * by.yaw[node]
    out[:, :knots] += slope[:, 3:4] * basis.node_curvatures[node]
    out[:, knots:] += slope[:, 4:5] * done + slope[:, 5:6] * (1.0 - done)
    return out
