"""Splines of piecewise linear curvature, as matrices that depend only on the numbers of spans and intervals.

Curvature is linear between knots, so the heading is linear in the knot curvatures: with `u` in [0, 1] along a gear of
length L, `yaw(u) = yaw_start + L * integral_0^u hats(t) dt . K`. The integrals do not depend on the problem, so a basis
is built only once per shape.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from optdock.geometry.arrays import FrozenArrays, readonly
from smoothers.scp.settings import DEFAULT_SETTINGS

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray, IntArray

__all__ = ["Basis", "Shape", "basis_for"]

Shape = tuple[tuple[int, int], ...]
"""Per gear: number of knot spans, and of collision intervals in each span."""

_GAUSS = readonly(np.array([0.5 - 0.5 / np.sqrt(3.0), 0.5 + 0.5 / np.sqrt(3.0)]))


@dataclass(frozen=True, eq=False)
class Basis(FrozenArrays):
    """Arrays that depend only on the numbers of spans and intervals.

    Nodes are interval ends; a cusp is a node of both of its gears.
    """

    shape: Shape  # per gear: knot spans and intervals per span
    num_knots: int  # totals over all gears
    num_gears: int
    num_nodes: int
    num_intervals: int
    size: int  # number of path variables: knot curvatures, then gear lengths
    knot_gear: IntArray  # gear of each knot, node, interval and span
    node_gear: IntArray
    interval_gear: IntArray
    span_gear: IntArray
    knot_members: FloatArray  # Shape (num_knots, num_gears), 1 where the knot belongs to the gear
    first_knots: IntArray  # indices for each gear, Shape (num_gears,)
    last_knots: IntArray
    last_nodes: IntArray
    left: IntArray  # node at which each interval begins; it ends at the next one
    position_of: IntArray  # interval boundary (0 to num_intervals) of each node
    fraction: FloatArray  # share of its gear's length at which each node lies
    gauss_headings: FloatArray  # Shape (2 num_intervals, num_knots), heading at the two Gauss points of each interval
    # Shape (2 num_intervals, num_gears), weight of each Gauss point as a share of its gear's length
    gauss_shares: FloatArray
    gauss_members: FloatArray  # Shape (2 num_intervals, num_gears), 1 where the Gauss point belongs to the gear
    node_headings: FloatArray  # Shape (num_nodes, num_knots), heading at the nodes
    node_curvatures: FloatArray  # Shape (num_nodes, num_knots), curvature at the nodes: the hat functions
    interval_slopes: FloatArray  # Shape (num_intervals, num_knots), curvature rate times gear length in each interval
    span_slopes: FloatArray  # Shape (number of spans, num_knots), the same once per span
    mass: FloatArray  # Shape (num_knots, num_knots), integrals of products of hats over u
    stiffness: FloatArray  # Shape (num_knots, num_knots), integrals of products of their slopes over u
    # Shape (num_knots, num_intervals), smoothed least squares from turned headings at the interval middles
    fit: FloatArray


@lru_cache(maxsize=16)  # of 0.3 MB for three gears; made in 1 to 4 ms
def basis_for(shape: Shape, fit_smoothing: float = DEFAULT_SETTINGS.resolution.fit_smoothing) -> Basis:
    """Return the basis of a shape, with read-only arrays; `fit_smoothing` weights the curvature rate in `fit`."""
    spans = np.array([q for q, _ in shape])
    cells = np.array([q * r for q, r in shape])
    gears = np.arange(len(spans))
    knot_gear, node_gear = np.repeat(gears, spans + 1), np.repeat(gears, cells + 1)
    last_knots, last_nodes = np.cumsum(spans + 1) - 1, np.cumsum(cells + 1) - 1
    gauss = [((np.arange(n)[:, None] + _GAUSS) / n).ravel() for n in cells]
    nodes = [np.arange(n + 1) / n for n in cells]
    middles = _heading_rows(spans, [(np.arange(n) + 0.5) / n for n in cells])
    slopes = _block_diagonal([q * np.diff(np.eye(q + 1), axis=0) for q in spans])
    stiffness = _block_diagonal([_stiffness(q) for q in spans])
    normal = middles.T @ middles + fit_smoothing * stiffness + 1e-9 * np.eye(middles.shape[1])
    arrays = {
        "knot_gear": knot_gear,
        "node_gear": node_gear,
        "interval_gear": np.repeat(gears, cells),
        "span_gear": np.repeat(gears, spans),
        "knot_members": (knot_gear[:, None] == gears).astype(np.float64),
        "first_knots": last_knots - spans,
        "last_knots": last_knots,
        "last_nodes": last_nodes,
        "left": np.delete(np.arange(node_gear.size), last_nodes),
        "position_of": np.arange(node_gear.size) - node_gear,
        "fraction": np.concatenate(nodes),
        "gauss_headings": _heading_rows(spans, gauss),
        "gauss_shares": _block_diagonal([np.full((2 * n, 1), 0.5 / n) for n in cells]),
        "gauss_members": _block_diagonal([np.ones((2 * n, 1)) for n in cells]),
        "node_headings": _heading_rows(spans, nodes),
        "node_curvatures": _block_diagonal([_hats(q, u) for q, u in zip(spans, nodes, strict=True)]),
        "interval_slopes": np.repeat(slopes, np.repeat(np.array([r for _, r in shape]), spans), axis=0),
        "span_slopes": slopes,
        "mass": _block_diagonal([_mass(q) for q in spans]),
        "stiffness": stiffness,
        "fit": np.linalg.solve(normal, middles.T),
    }
    knots, count = int(np.sum(spans + 1)), len(spans)
    return Basis(shape, knots, count, node_gear.size, int(np.sum(cells)), knots + count, **arrays)


def _hats(spans: int, u: FloatArray) -> FloatArray:
    """Return the hat functions on a uniform grid of [0, 1]. Shape (len(u), spans + 1)."""
    return np.maximum(0.0, 1.0 - np.abs(spans * u[:, None] - np.arange(spans + 1)))


def _hat_integrals(spans: int, u: FloatArray) -> FloatArray:
    """Return the integrals of the hat functions from 0 to u. Shape (len(u), spans + 1)."""
    t = np.clip(spans * u[:, None] - np.arange(spans + 1), -1.0, 1.0)
    area = np.where(t < 0.0, 0.5 * (1.0 + t) ** 2, 1.0 - 0.5 * (1.0 - t) ** 2)
    area[:, 0] -= 0.5
    integrals: FloatArray = area / spans
    return integrals


def _heading_rows(spans: IntArray, points: list[FloatArray]) -> FloatArray:
    """Return heading changes per unit of (gear length * knot curvature), summed over the preceding gears."""
    rows = []
    for m, u in enumerate(points):
        done = [np.tile(_hat_integrals(q, np.ones(1)), (u.size, 1)) for q in spans[:m]]
        ahead = [np.zeros((u.size, q + 1)) for q in spans[m + 1 :]]
        rows.append(np.hstack([*done, _hat_integrals(spans[m], u), *ahead]))
    return np.vstack(rows)


def _block_diagonal(parts: list[FloatArray]) -> FloatArray:
    out = np.zeros((sum(p.shape[0] for p in parts), sum(p.shape[1] for p in parts)))
    row = column = 0
    for part in parts:
        out[row : row + part.shape[0], column : column + part.shape[1]] = part
        row, column = row + part.shape[0], column + part.shape[1]
    return out


def _mass(spans: int) -> FloatArray:
    matrix = (4.0 * np.eye(spans + 1) + np.eye(spans + 1, k=1) + np.eye(spans + 1, k=-1)) / (6.0 * spans)
    matrix[0, 0] = matrix[-1, -1] = 1.0 / (3.0 * spans)
    return matrix


def _stiffness(spans: int) -> FloatArray:
    slopes = np.diff(np.eye(spans + 1), axis=0)
    product: FloatArray = spans * (slopes.T @ slopes)
    return product
